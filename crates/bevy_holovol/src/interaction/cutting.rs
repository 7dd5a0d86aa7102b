//! A plane in the hand that cuts volumes open, like a board held flat.

use bevy::camera::primitives::Aabb;
use bevy::math::{Isometry3d, Quat, Vec3};
use bevy::prelude::*;

use super::{Graspable, Hands, Squeeze, pose_of};

/// s in which it follows the hand to 63 %: hands tremble, cuts shouldn't.
const SMOOTHING: f32 = 0.05;
/// m around its middle within which a plane that was put down is taken again.
const HANDLE: f32 = 0.06;

/// On a [`VolumeClipPlane`](crate::VolumeClipPlane): the plane lies in a hand, and what the back of
/// that hand is turned to is cut away. A pinch of that hand leaves it where it is; from then on it is
/// [`Graspable`] at its middle.
///
/// As a plane that isn't a child of anything it cuts all volumes.
#[derive(Component, Clone, Copy, Debug)]
pub struct HandPlane {
    hand: usize,
    squeeze: Squeeze,
    has_followed: bool,
}

impl HandPlane {
    /// In the left hand (0) or the right one (1).
    pub fn new(hand: usize) -> Self {
        Self {
            hand: hand.min(1),
            squeeze: Squeeze::default(),
            has_followed: false,
        }
    }

    /// Which hand it lies in.
    pub fn hand(&self) -> usize {
        self.hand
    }

    /// Where it goes by `dt` s; true if it is put down there.
    fn update(&mut self, hands: &Hands, now: Isometry3d, dt: f32) -> (Isometry3d, bool) {
        let hand = &hands.0[self.hand];
        let Some(grip) = pose_of(hand, None) else {
            return (now, false);
        };
        // A pinch that goes on since before leaves nothing.
        let was_followed = std::mem::replace(&mut self.has_followed, true);
        let is_put_down = self.squeeze.begins(hand.squeeze) && was_followed;
        let part = if was_followed {
            let dt = if dt.is_finite() {
                dt.clamp(0.0, 0.25)
            } else {
                0.0
            };
            1.0 - (-dt / SMOOTHING).exp()
        } else {
            1.0
        };
        let wanted = Isometry3d::new(grip.translation, grip.rotation * from_hand(self.hand));
        let place = Vec3::from(now.translation).lerp(wanted.translation.into(), part);
        let rotation = now.rotation.slerp(wanted.rotation, part).normalize();
        (Isometry3d::new(place, rotation), is_put_down)
    }
}

/// Turns +y, where is cut, to the back of the hand: −x of the left grip, +x of the right one.
fn from_hand(hand: usize) -> Quat {
    let back = if hand == 0 { Vec3::NEG_X } else { Vec3::X };
    Quat::from_rotation_arc(Vec3::Y, back)
}

pub(super) fn follow_hands(
    mut commands: Commands,
    time: Res<Time>,
    hands: Res<Hands>,
    mut planes: Query<(Entity, &mut HandPlane, &mut Transform), Without<ChildOf>>,
) {
    for (entity, mut plane, mut transform) in &mut planes {
        let now = transform.to_isometry();
        let (pose, is_put_down) = plane.update(&hands, now, time.delta_secs());
        if pose != now {
            transform.translation = pose.translation.into();
            transform.rotation = pose.rotation;
        }
        if is_put_down {
            let handle = Aabb {
                half_extents: Vec3::splat(HANDLE).into(),
                ..default()
            };
            let graspable = Graspable {
                has_handles: false,
                ..default()
            };
            commands
                .entity(entity)
                .remove::<HandPlane>()
                .insert((graspable, handle));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Hand, InteractionPlugin};
    use super::*;
    use crate::VolumeClipPlane;
    use crate::clip_plane::plane_of;

    fn hands(hand: usize, grip: Isometry3d, squeeze: f32) -> Hands {
        let mut hands = Hands::default();
        hands.0[hand] = Hand {
            grip: Some(grip),
            squeeze,
            ..Hand::default()
        };
        hands
    }

    /// Thumbs up, fingers ahead: the left palm looks to the right, the right one to the left.
    #[test]
    fn the_back_of_the_hand_cuts() {
        for (hand, side) in [(0, -1.0), (1, 1.0)] {
            let mut plane = HandPlane::new(hand);
            let at = Isometry3d::from_xyz(0.1, 1.2, -0.4);
            let (pose, _) = plane.update(&hands(hand, at, 0.0), Isometry3d::IDENTITY, 0.01);
            let equation = plane_of(&Transform::from_isometry(pose).into()).expect("a plane");
            let height = |x: f32| {
                let point = Vec3::new(0.1 + x, 1.0, -0.7).as_dvec3();
                equation.dot(point.extend(1.0))
            };
            assert!(
                height(0.05 * side) < 0.0,
                "hand {hand}: behind its back is cut"
            );
            assert!(
                height(-0.05 * side) > 0.0,
                "hand {hand}: before its palm is kept"
            );
        }
    }

    #[test]
    fn it_follows_smoothly_and_stays_while_the_hand_is_lost() {
        let mut plane = HandPlane::new(1);
        let at = |x: f32| hands(1, Isometry3d::from_xyz(x, 0.0, 0.0), 0.0);
        let (first, _) = plane.update(&at(1.0), Isometry3d::IDENTITY, 0.01);
        assert_eq!(first.translation.x, 1.0, "taken where the hand is");
        let (next, _) = plane.update(&at(2.0), first, SMOOTHING);
        let expected = 2.0 - (-1.0_f32).exp();
        assert!((next.translation.x - expected).abs() < 1e-5, "{next:?}");
        assert_eq!(plane.update(&Hands::default(), next, 0.1), (next, false));
    }

    #[test]
    fn a_pinch_puts_it_down_and_the_next_takes_it_again() {
        let mut app = App::new();
        app.add_plugins((MinimalPlugins, InteractionPlugin));
        let plane = app
            .world_mut()
            .spawn((VolumeClipPlane, HandPlane::new(1)))
            .id();
        let at = |app: &mut App, x: f32, squeeze: f32| {
            app.insert_resource(hands(1, Isometry3d::from_xyz(x, 0.0, 0.0), squeeze));
            for _ in 0..40 {
                app.update();
                std::thread::sleep(std::time::Duration::from_millis(5));
            }
            app.world()
                .get::<Transform>(plane)
                .expect("it")
                .translation
                .x
        };
        // The pinch that took it, from a menu, is still there.
        assert!((at(&mut app, 0.2, 1.0) - 0.2).abs() < 0.02);
        assert!((at(&mut app, 0.3, 0.0) - 0.3).abs() < 0.02);
        assert!(app.world().get::<HandPlane>(plane).is_some());
        at(&mut app, 0.3, 1.0);
        assert!(app.world().get::<HandPlane>(plane).is_none(), "put down");
        assert!((at(&mut app, 0.9, 0.0) - 0.3).abs() < 0.02, "it stays");
        at(&mut app, 0.3, 0.0);
        at(&mut app, 0.3, 1.0);
        assert!((at(&mut app, 0.6, 1.0) - 0.6).abs() < 0.02, "taken again");
    }
}
