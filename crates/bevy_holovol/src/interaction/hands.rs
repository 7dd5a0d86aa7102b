//! What hands and controllers have in common: where they grasp, where they point, how firmly.

use bevy::math::{Isometry3d, Vec3};
use bevy::prelude::Resource;

/// Joints of a hand, in the order of `XR_EXT_hand_tracking`.
pub const JOINT_COUNT: usize = 26;
/// The wrist.
pub const WRIST: usize = 1;
/// The thumb's tip.
pub const THUMB_TIP: usize = 5;
/// The knuckle of the index finger.
pub const INDEX_KNUCKLE: usize = 7;
/// The index finger's tip.
pub const INDEX_TIP: usize = 10;
/// The knuckle of the little finger.
pub const LITTLE_KNUCKLE: usize = 22;

/// m between the tips of thumb and index finger at which they touch for certain, and at which they
/// do not at all; people's fingers are 15 mm thick.
const PINCH_CLOSED: f32 = 0.015;
const PINCH_OPEN: f32 = 0.06;

/// A hand or a controller, in the world's coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Hand {
    /// Where it grasps: between thumb and index finger, or a controller's grip. `None` while it
    /// isn't tracked.
    pub grip: Option<Isometry3d>,
    /// Where it points: along −z.
    pub aim: Option<Isometry3d>,
    /// 0: open, 1: pinched or pressed.
    pub squeeze: f32,
    /// What it presses buttons with.
    pub poke: Option<Vec3>,
}

/// Left and right; as they are in this frame.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq)]
pub struct Hands(pub [Hand; 2]);

impl Hands {
    /// The same hands elsewhere, such as from tracking space to the world.
    pub fn moved(self, by: Isometry3d) -> Self {
        Self(self.0.map(|hand| Hand {
            grip: hand.grip.map(|grip| by * grip),
            aim: hand.aim.map(|aim| by * aim),
            poke: hand.poke.map(|poke| by * poke),
            ..hand
        }))
    }
}

impl Hand {
    /// Of the joints that are tracked: place and orientation of each. A hand is tracked when thumb,
    /// index finger and wrist are. Joints that aren't finite aren't tracked.
    pub fn from_joints(joints: &[Option<Isometry3d>; JOINT_COUNT], head: Option<Vec3>) -> Self {
        let joint = |index: usize| {
            let joint = joints[index].filter(|joint| {
                joint.translation.is_finite()
                    && joint.rotation.is_finite()
                    && joint.rotation.is_normalized()
            })?;
            Some(Vec3::from(joint.translation))
        };
        let (Some(thumb), Some(index), Some(wrist)) =
            (joint(THUMB_TIP), joint(INDEX_TIP), joint(WRIST))
        else {
            return Self::default();
        };
        let gap = thumb.distance(index);
        let squeeze = ((PINCH_OPEN - gap) / (PINCH_OPEN - PINCH_CLOSED)).clamp(0.0, 1.0);
        let pinch = (thumb + index) / 2.0;
        // Knuckles are steadier than the tips that are pinching.
        let knuckles = joint(INDEX_KNUCKLE).zip(joint(LITTLE_KNUCKLE));
        let across = knuckles.map_or(thumb - index, |(index, little)| index - little);
        let forward = knuckles.map_or(pinch - wrist, |(index, little)| {
            (index + little) / 2.0 - wrist
        });
        let Some(rotation) = looking(forward, across) else {
            return Self::default();
        };
        // A ray from the shoulder through the pinch is steadier than the hand's own direction.
        let from = head.map(|head| head - Vec3::new(0.0, 0.2, 0.0));
        let direction = from.map_or(forward, |shoulder| pinch - shoulder);
        let aim = looking(direction, Vec3::Y)
            .or(Some(rotation))
            .map(|rotation| Isometry3d::new(pinch, rotation));
        Self {
            grip: Some(Isometry3d::new(pinch, rotation)),
            aim,
            squeeze,
            poke: Some(index),
        }
    }
}

/// −z along `forward`, +y as near to `up` as can be.
fn looking(forward: Vec3, up: Vec3) -> Option<bevy::math::Quat> {
    let back = -forward.try_normalize()?;
    let right = up.cross(back).try_normalize()?;
    let matrix = bevy::math::Mat3::from_cols(right, back.cross(right), back);
    Some(bevy::math::Quat::from_mat3(&matrix))
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::math::Quat;

    fn joints(gap: f32) -> [Option<Isometry3d>; JOINT_COUNT] {
        let mut joints = [None; JOINT_COUNT];
        let at = |x: f32, y: f32, z: f32| Some(Isometry3d::from_xyz(x, y, z));
        joints[WRIST] = at(0.0, 1.0, 0.0);
        joints[THUMB_TIP] = at(-gap / 2.0, 1.0, -0.1);
        joints[INDEX_TIP] = at(gap / 2.0, 1.0, -0.1);
        joints[INDEX_KNUCKLE] = at(0.0, 1.03, -0.08);
        joints[LITTLE_KNUCKLE] = at(0.0, 0.97, -0.08);
        joints
    }

    #[test]
    fn fingers_that_touch_are_a_pinch() {
        let squeeze = |gap| Hand::from_joints(&joints(gap), None).squeeze;
        assert_eq!(squeeze(0.01), 1.0);
        assert_eq!(squeeze(0.08), 0.0);
        assert!((0.2..0.8).contains(&squeeze(0.0375)));
    }

    #[test]
    fn hands_point_away_from_the_shoulder() {
        let head = Vec3::new(0.0, 1.2, 1.0);
        let hand = Hand::from_joints(&joints(0.01), Some(head));
        let aim = hand.aim.expect("tracked");
        let ahead = aim.rotation * Vec3::NEG_Z;
        assert!((ahead - Vec3::NEG_Z).length() < 1e-5, "{ahead}");
        let grip = hand.grip.expect("tracked");
        assert!((grip.rotation * Vec3::NEG_Z - Vec3::NEG_Z).length() < 1e-5);
    }

    #[test]
    fn joints_that_are_none_make_no_hand() {
        for bad in [
            None,
            Some(Isometry3d::from_xyz(f32::NAN, 0.0, 0.0)),
            Some(Isometry3d {
                rotation: Quat::from_xyzw(0.0, 0.0, 0.0, 0.0),
                translation: Default::default(),
            }),
        ] {
            let mut joints = joints(0.01);
            joints[INDEX_TIP] = bad;
            assert_eq!(Hand::from_joints(&joints, None), Hand::default());
        }
        let all_in_one_place = [Some(Isometry3d::IDENTITY); JOINT_COUNT];
        assert_eq!(Hand::from_joints(&all_in_one_place, None), Hand::default());
    }
}
