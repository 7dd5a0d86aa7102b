//! A menu at the hand: shown while the user looks into that hand's palm, pressed with the other.

use bevy::math::{Isometry3d, Mat3, Quat, Vec2, Vec3};

use super::{Hand, Hands, Surface, SurfaceTouch, Touching, pose_of};

/// Buttons, one below the other.
pub const MENU_BUTTONS: usize = 3;
/// m, half of the width and of the height.
pub const MENU_HALF_SIZE: Vec2 = Vec2::new(0.05, 0.045);
/// Cosines between palm and eyes at which it comes and goes.
const SHOW: f32 = 0.8;
const HIDE: f32 = 0.5;
/// s that it takes to come, so that it doesn't at a wave, and to go.
const COMING: f32 = 0.25;
const GOING: f32 = 0.3;
/// m from the eyes within which hands have a menu.
const REACH: [f32; 2] = [0.15, 0.9];
/// m from the hand, on the side of the little finger.
const BESIDE: f32 = 0.11;
/// s in which it follows the hand to 63 %.
const SMOOTHING: f32 = 0.08;

/// What the menu does.
#[derive(Clone, Copy, Debug, Default)]
pub struct HandMenu {
    /// The hand that has it, and whether it is there yet.
    carrier: Option<usize>,
    is_shown: bool,
    /// s that it has been looked for, or away from.
    changing_for: f32,
    surface: Surface,
    touching: Touching,
    touch: SurfaceTouch,
}

impl HandMenu {
    /// Goes on by `dt` s; returns the button that is pressed, from the top.
    pub fn update(
        &mut self,
        hands: &Hands,
        busy: [bool; 2],
        head: Option<Isometry3d>,
        dt: f32,
    ) -> Option<usize> {
        let dt = if dt.is_finite() {
            dt.clamp(0.0, 0.25)
        } else {
            0.0
        };
        let facing = |hand: usize| -> f32 {
            let pose = pose_of(&hands.0[hand], None).filter(|_| !busy[hand]);
            pose.zip(head)
                .map_or(-1.0, |(pose, head)| facing(hand, pose, head))
        };
        let is_wanted = match self.carrier {
            Some(hand) if self.is_shown => facing(hand) > HIDE,
            _ => {
                // The left one first: most press with the right.
                let hand = [0, 1].into_iter().find(|hand| facing(*hand) > SHOW);
                if hand != self.carrier {
                    self.changing_for = 0.0;
                }
                self.carrier = hand;
                hand.is_some()
            }
        };
        let was_shown = self.is_shown;
        if is_wanted == self.is_shown {
            self.changing_for = 0.0;
        } else {
            self.changing_for += dt;
            let limit = if self.is_shown { GOING } else { COMING };
            if self.changing_for >= limit {
                self.is_shown = is_wanted;
                self.changing_for = 0.0;
                self.touching = Touching::default();
            }
        }
        self.touch = SurfaceTouch::default();
        let carrier = self.carrier.filter(|_| self.is_shown)?;
        if let (Some(pose), Some(head)) = (pose_of(&hands.0[carrier], None), head) {
            self.follow(
                carrier,
                pose,
                head,
                if was_shown { dt } else { f32::INFINITY },
            );
        }
        // The hand that has it doesn't press it.
        let mut others = *hands;
        others.0[carrier] = Hand::default();
        self.touch = self.touching.update(&others, busy, &self.surface);
        let button = (self.touch.place.y * MENU_BUTTONS as f32) as usize;
        self.touch
            .just_pressed
            .then_some(button.min(MENU_BUTTONS - 1))
    }

    /// Where it is, while it is shown.
    pub fn surface(&self) -> Option<Surface> {
        self.is_shown.then_some(self.surface)
    }

    /// What the other hand does to it.
    pub fn touch(&self) -> SurfaceTouch {
        self.touch
    }

    /// The button that is pointed at, from the top.
    pub fn hovered(&self) -> Option<usize> {
        self.touch.hand?;
        let button = (self.touch.place.y * MENU_BUTTONS as f32) as usize;
        Some(button.min(MENU_BUTTONS - 1))
    }

    /// Whether a hand is at the menu, and so at nothing else.
    pub fn has(&self, hand: usize) -> bool {
        self.touch.hand == Some(hand) || (self.is_shown && self.carrier == Some(hand))
    }

    fn follow(&mut self, carrier: usize, pose: Isometry3d, head: Isometry3d, dt: f32) {
        let (place, eyes) = (Vec3::from(pose.translation), Vec3::from(head.translation));
        let right = head.rotation * Vec3::X;
        let inward = if carrier == 0 { right } else { -right };
        let wanted = place + BESIDE * inward;
        let Some(rotation) = facing_rotation(eyes - wanted) else {
            return;
        };
        let part = 1.0 - (-dt / SMOOTHING).exp();
        let now = self.surface.pose;
        self.surface = Surface {
            pose: Isometry3d::new(
                Vec3::from(now.translation).lerp(wanted, part),
                now.rotation.slerp(rotation, part).normalize(),
            ),
            half_size: MENU_HALF_SIZE,
        };
    }
}

/// Cosine between a palm's direction and the eyes; −1 out of reach. By the grip's convention +x
/// leaves the left palm and enters the right one.
fn facing(hand: usize, pose: Isometry3d, head: Isometry3d) -> f32 {
    let palm = pose.rotation * if hand == 0 { Vec3::X } else { Vec3::NEG_X };
    let to_eyes = Vec3::from(head.translation - pose.translation);
    let distance = to_eyes.length();
    let ahead = head.rotation * Vec3::NEG_Z;
    // Behind the head nobody looks.
    let is_seen = (REACH[0]..=REACH[1]).contains(&distance) && ahead.dot(-to_eyes) > 0.0;
    if is_seen {
        palm.dot(to_eyes) / distance
    } else {
        -1.0
    }
}

/// +z along a direction, +y as near to up as can be.
fn facing_rotation(direction: Vec3) -> Option<Quat> {
    let z = direction.try_normalize()?;
    let x = Vec3::Y.cross(z).try_normalize()?;
    Some(Quat::from_mat3(&Mat3::from_cols(x, z.cross(x), z)))
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f32 = 1.0 / 72.0;

    fn head() -> Option<Isometry3d> {
        Some(Isometry3d::from_xyz(0.0, 1.6, 0.0))
    }

    /// A left hand before the eyes whose palm is turned away from them by an angle.
    fn left(away: f32) -> Hand {
        let place = Vec3::new(-0.1, 1.5, -0.4);
        let to_eyes = (Vec3::new(0.0, 1.6, 0.0) - place).normalize();
        let palm = Quat::from_rotation_arc(Vec3::X, to_eyes);
        let rotation = (Quat::from_rotation_y(away) * palm).normalize();
        Hand {
            grip: Some(Isometry3d::new(place, rotation)),
            ..Hand::default()
        }
    }

    fn run(menu: &mut HandMenu, hands: &Hands, seconds: f32) -> Option<usize> {
        let mut pressed = None;
        for _ in 0..(seconds / DT).ceil() as u32 {
            pressed = menu.update(hands, [false; 2], head(), DT).or(pressed);
        }
        pressed
    }

    #[test]
    fn it_comes_with_the_palm_and_goes_with_it() {
        let mut menu = HandMenu::default();
        let hands = |away| Hands([left(away), Hand::default()]);
        run(&mut menu, &hands(1.2), 1.0);
        assert_eq!(menu.surface(), None, "the back of the hand");
        run(&mut menu, &hands(0.0), 0.1);
        assert_eq!(menu.surface(), None, "a wave");
        run(&mut menu, &hands(0.0), 0.3);
        let surface = menu.surface().expect("the palm");
        let place = Vec3::from(surface.pose.translation);
        assert!(place.x > -0.05, "on the side of the little finger: {place}");
        let to_eyes = (Vec3::new(0.0, 1.6, 0.0) - place).normalize();
        assert!(
            (surface.pose.rotation * Vec3::Z).dot(to_eyes) > 0.999,
            "it faces the eyes"
        );
        run(&mut menu, &hands(0.9), 1.0);
        assert!(menu.surface().is_some(), "somewhat turned");
        run(&mut menu, &hands(1.4), 0.4);
        assert_eq!(menu.surface(), None);
    }

    #[test]
    fn the_other_hand_presses_buttons() {
        for button in 0..MENU_BUTTONS {
            let mut menu = HandMenu::default();
            let hands = |poke| {
                Hands([
                    left(0.0),
                    Hand {
                        poke,
                        ..Hand::default()
                    },
                ])
            };
            run(&mut menu, &hands(None), 1.0);
            let surface = menu.surface().expect("shown");
            let y = MENU_HALF_SIZE.y * (2.0 / 3.0) * (1.0 - button as f32);
            let tip = |z: f32| Some(surface.pose * Vec3::new(0.0, y, z));
            assert_eq!(run(&mut menu, &hands(tip(0.03)), DT), None);
            assert_eq!(menu.hovered(), Some(button));
            assert!(menu.has(1) && menu.has(0));
            assert_eq!(run(&mut menu, &hands(tip(-0.004)), DT), Some(button));
            assert_eq!(run(&mut menu, &hands(tip(-0.004)), 0.2), None, "once");
        }
    }

    #[test]
    fn the_hand_that_has_it_presses_nothing() {
        let mut menu = HandMenu::default();
        let mut hand = left(0.0);
        run(&mut menu, &Hands([hand, Hand::default()]), 1.0);
        let surface = menu.surface().expect("shown");
        for z in [0.03, -0.004] {
            hand.poke = Some(surface.pose * Vec3::new(0.0, 0.0, z));
            assert_eq!(run(&mut menu, &Hands([hand, Hand::default()]), DT), None);
        }
    }

    #[test]
    fn without_head_or_hands_there_is_none() {
        let mut menu = HandMenu::default();
        let hands = Hands([left(0.0), Hand::default()]);
        run(&mut menu, &hands, 1.0);
        for _ in 0..60 {
            menu.update(&hands, [false; 2], None, DT);
        }
        assert_eq!(menu.surface(), None);
        run(&mut menu, &hands, 1.0);
        assert!(menu.surface().is_some());
        menu.update(&Hands::default(), [true; 2], head(), f32::NAN);
        run(&mut menu, &Hands::default(), 1.0);
        assert_eq!(menu.surface(), None);
    }
}
