//! Rectangles that hands press: with a fingertip, or from afar with a ray and a pinch.

use bevy::math::{Isometry3d, Vec2, Vec3};

use super::{Hand, Hands, Squeeze, pose_of};

/// m in front of a rectangle within which a fingertip points at it.
const NEAR: f32 = 0.1;
/// m beside it that still count.
const MARGIN: f32 = 0.01;
/// m in front of it from which a fingertip that pressed lets go, and from which one may press.
const LIFT: f32 = 0.01;
/// m behind it from which on a finger isn't pressing any more: it came from elsewhere.
const THROUGH: f32 = 0.08;
/// m from which rays reach it.
const FARTHEST: f32 = 4.0;

/// A rectangle in the world: +x to its right, +y up, seen from +z.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Surface {
    /// Its middle.
    pub pose: Isometry3d,
    /// m from there to the right and the upper edge.
    pub half_size: Vec2,
}

impl Surface {
    fn local(&self, point: Vec3) -> Vec3 {
        let inverse = self.pose.inverse();
        Vec3::from(inverse.transform_point(point))
    }

    /// (0, 0) top left, (1, 1) bottom right.
    fn place(&self, local: Vec3) -> Vec2 {
        let half = self.half_size.max(Vec2::splat(1e-6));
        let place = Vec2::new(local.x, -local.y) / half;
        (0.5 + 0.5 * place).clamp(Vec2::ZERO, Vec2::ONE)
    }

    /// In the world: (0, 0) is top left, (1, 1) bottom right.
    pub fn point(&self, place: Vec2) -> Vec3 {
        let local = self.half_size * Vec2::new(2.0 * place.x - 1.0, 1.0 - 2.0 * place.y);
        self.pose * local.extend(0.0)
    }

    fn holds(&self, local: Vec3, margin: f32) -> bool {
        local.x.abs() <= self.half_size.x + margin && local.y.abs() <= self.half_size.y + margin
    }
}

/// What the hands do to a surface in a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SurfaceTouch {
    /// Which hand points at it, 0 left, 1 right.
    pub hand: Option<usize>,
    /// Where: (0, 0) top left, (1, 1) bottom right; stays within while it is pressed.
    pub place: Vec2,
    /// Whether by a fingertip, not by its ray.
    pub is_near: bool,
    /// Whether it is pressed.
    pub is_pressed: bool,
    /// Since this frame.
    pub just_pressed: bool,
    /// Until this frame.
    pub just_released: bool,
}

/// How a hand meets a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Meeting {
    /// m of the fingertip in front of it.
    Finger(f32),
    Ray,
}

/// Follows what the hands do to one surface.
#[derive(Clone, Copy, Debug, Default)]
pub struct Touching {
    squeezes: [Squeeze; 2],
    /// Fingertips that were in front of it: only those press.
    was_before: [bool; 2],
    /// The hand that presses, and whether by its finger.
    pressing: Option<(usize, bool)>,
    place: Vec2,
}

impl Touching {
    /// Goes on by a frame. Hands that are busy don't point.
    pub fn update(&mut self, hands: &Hands, busy: [bool; 2], surface: &Surface) -> SurfaceTouch {
        let squeezed: [bool; 2] =
            std::array::from_fn(|i| self.squeezes[i].update(hands.0[i].squeeze));
        let meetings: [_; 2] = std::array::from_fn(|i| {
            let meeting = meet(&hands.0[i], surface);
            let pressing = self.pressing.is_some_and(|(hand, _)| hand == i);
            meeting.filter(|_| pressing || !busy[i])
        });
        let mut touch = SurfaceTouch::default();
        // Who presses goes on until it lets go; its place may leave the rectangle.
        if let Some((hand, by_finger)) = self.pressing {
            let goes_on = match (by_finger, finger(&hands.0[hand], surface)) {
                (true, Some(local)) => {
                    self.place = surface.place(local);
                    local.z < LIFT && local.z > -THROUGH
                }
                (true, None) => false,
                (false, _) => {
                    if let Some(local) = ray(&hands.0[hand], surface) {
                        self.place = surface.place(local);
                    }
                    squeezed[hand] && hands.0[hand].aim.is_some()
                }
            };
            touch = SurfaceTouch {
                hand: Some(hand),
                place: self.place,
                is_near: by_finger,
                is_pressed: goes_on,
                just_pressed: false,
                just_released: !goes_on,
            };
            if !goes_on {
                self.pressing = None;
            }
        } else {
            // Fingers before rays; of two the right one.
            let fingers = [1, 0].into_iter().filter_map(|i| match meetings[i] {
                Some((place, Meeting::Finger(height))) => Some((i, place, Some(height))),
                _ => None,
            });
            let rays = [1, 0].into_iter().filter_map(|i| match meetings[i] {
                Some((place, Meeting::Ray)) => Some((i, place, None)),
                _ => None,
            });
            if let Some((hand, place, height)) = fingers.chain(rays).next() {
                let presses = match height {
                    Some(height) => height <= 0.0 && self.was_before[hand],
                    None => self.squeezes[hand].has_begun(),
                };
                self.place = place;
                if presses {
                    self.pressing = Some((hand, height.is_some()));
                }
                touch = SurfaceTouch {
                    hand: Some(hand),
                    place,
                    is_near: height.is_some(),
                    is_pressed: presses,
                    just_pressed: presses,
                    just_released: false,
                };
            }
        }
        for (hand, was_before) in self.was_before.iter_mut().enumerate() {
            *was_before = match finger(&hands.0[hand], surface) {
                // Between, it stays what it was.
                Some(local) if surface.holds(local, MARGIN) => {
                    local.z >= LIFT || (*was_before && local.z > 0.0)
                }
                _ => false,
            };
        }
        touch
    }
}

/// A fingertip, in the surface's coordinates.
fn finger(hand: &Hand, surface: &Surface) -> Option<Vec3> {
    let tip = hand.poke.filter(|tip| tip.is_finite())?;
    Some(surface.local(tip))
}

/// Where a ray meets the surface's plane from the front.
fn ray(hand: &Hand, surface: &Surface) -> Option<Vec3> {
    let aim = pose_of(hand, Some(0.0))?;
    let origin = surface.local(aim.translation.into());
    let direction = surface.pose.rotation.inverse() * (aim.rotation * Vec3::NEG_Z);
    let along = -origin.z / direction.z;
    let is_met = origin.z > 0.0 && direction.z < -1e-3 && along <= FARTHEST;
    is_met.then(|| origin + along * direction)
}

fn meet(hand: &Hand, surface: &Surface) -> Option<(Vec2, Meeting)> {
    if let Some(local) = finger(hand, surface)
        && surface.holds(local, MARGIN)
        && local.z <= NEAR
        && local.z >= -THROUGH
    {
        return Some((surface.place(local), Meeting::Finger(local.z)));
    }
    let local = ray(hand, surface).filter(|local| surface.holds(*local, 0.0))?;
    Some((surface.place(local), Meeting::Ray))
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::math::Quat;

    fn surface() -> Surface {
        Surface {
            pose: Isometry3d::new(Vec3::new(0.0, 1.0, -1.0), Quat::IDENTITY),
            half_size: Vec2::new(0.2, 0.1),
        }
    }

    fn right(hand: Hand) -> Hands {
        Hands([Hand::default(), hand])
    }

    /// A fingertip at a place of the surface, and so far before it.
    fn poke(x: f32, y: f32, height: f32) -> Hands {
        right(Hand {
            poke: Some(Vec3::new(x, 1.0 + y, -1.0 + height)),
            ..Hand::default()
        })
    }

    fn point(yaw: f32, squeeze: f32) -> Hands {
        let aim = Isometry3d::new(Vec3::new(0.0, 1.0, 0.0), Quat::from_rotation_y(yaw));
        right(Hand {
            aim: Some(aim),
            squeeze,
            ..Hand::default()
        })
    }

    const FREE: [bool; 2] = [false; 2];

    #[test]
    fn a_finger_presses_once_it_goes_through_from_the_front() {
        let mut touching = Touching::default();
        let mut at = |height: f32| touching.update(&poke(0.1, 0.05, height), FREE, &surface());
        assert_eq!(at(0.2).hand, None, "too far");
        let hover = at(0.05);
        assert_eq!((hover.hand, hover.is_pressed), (Some(1), false));
        assert!(
            hover.place.distance(Vec2::new(0.75, 0.25)) < 1e-5,
            "{}",
            hover.place
        );
        assert!(!at(0.005).is_pressed, "not yet");
        let press = at(-0.002);
        assert!(press.just_pressed && press.is_pressed);
        let held = at(0.005);
        assert!(
            held.is_pressed && !held.just_pressed,
            "a finger that trembles"
        );
        let release = at(0.02);
        assert!(release.just_released && !release.is_pressed);
        assert!(!at(0.02).just_released);
    }

    #[test]
    fn a_finger_from_behind_or_beside_presses_nothing() {
        let mut touching = Touching::default();
        for height in [-0.05, -0.01, -0.001] {
            assert!(
                !touching
                    .update(&poke(0.0, 0.0, height), FREE, &surface())
                    .is_pressed
            );
        }
        // Beside it in front, then sideways into it.
        let mut touching = Touching::default();
        for (x, height) in [(0.3, 0.02), (0.3, -0.01), (0.1, -0.01)] {
            assert!(
                !touching
                    .update(&poke(x, 0.0, height), FREE, &surface())
                    .is_pressed
            );
        }
    }

    #[test]
    fn a_pinch_presses_where_the_ray_points_and_drags() {
        let mut touching = Touching::default();
        let mut at = |yaw: f32, squeeze| touching.update(&point(yaw, squeeze), FREE, &surface());
        let hover = at(-0.1_f32.atan(), 0.0);
        assert!(
            hover.place.distance(Vec2::new(0.75, 0.5)) < 1e-4,
            "{}",
            hover.place
        );
        assert!(at(-0.1_f32.atan(), 1.0).just_pressed);
        // Beyond its edge, it stays within and pressed.
        let dragged = at(-0.4, 1.0);
        assert!(dragged.is_pressed && dragged.place.distance(Vec2::new(1.0, 0.5)) < 1e-4);
        assert!(at(-0.4, 0.0).just_released);
        assert_eq!(at(-0.4, 0.0).hand, None);
    }

    #[test]
    fn pinches_that_began_elsewhere_press_nothing() {
        let mut touching = Touching::default();
        touching.update(&point(-0.5, 1.0), FREE, &surface());
        assert!(
            !touching
                .update(&point(0.0, 1.0), FREE, &surface())
                .is_pressed
        );
        touching.update(&point(0.0, 0.0), FREE, &surface());
        assert!(
            touching
                .update(&point(0.0, 1.0), FREE, &surface())
                .just_pressed
        );
    }

    #[test]
    fn busy_hands_and_the_back_press_nothing() {
        let mut touching = Touching::default();
        let busy = [false, true];
        touching.update(&point(0.0, 0.0), busy, &surface());
        assert_eq!(
            touching.update(&point(0.0, 1.0), busy, &surface()).hand,
            None
        );
        let turned = Surface {
            pose: Isometry3d::new(Vec3::new(0.0, 1.0, -1.0), Quat::from_rotation_y(3.1)),
            ..surface()
        };
        let mut touching = Touching::default();
        assert_eq!(touching.update(&point(0.0, 0.0), FREE, &turned).hand, None);
    }

    #[test]
    fn a_hand_that_is_lost_lets_go() {
        let mut touching = Touching::default();
        for height in [0.02, -0.01] {
            touching.update(&poke(0.0, 0.0, height), FREE, &surface());
        }
        let lost = touching.update(&Hands::default(), FREE, &surface());
        assert!(lost.just_released);
        let nan = right(Hand {
            poke: Some(Vec3::NAN),
            squeeze: f32::NAN,
            ..Hand::default()
        });
        assert_eq!(touching.update(&nan, FREE, &surface()).hand, None);
    }
}
