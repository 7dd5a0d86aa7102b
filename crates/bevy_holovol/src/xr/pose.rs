//! What runtimes say of the eyes, made safe to draw with.
//!
//! Tracking starts late, stops and lies: quaternions of zeros, NaN, fields of view of 0. What is
//! usable of a view is taken, the rest stays as it last was; until an eye has had both a pose and a
//! field of view it isn't drawn at all.

use std::f32::consts::FRAC_PI_2;

use bevy::math::{Isometry3d, Mat4, Quat, Vec3};
use openxr::{Posef, Quaternionf, Vector3f};

/// Half-angles beyond ±89.5° have no useful tangent.
const WIDEST: f32 = FRAC_PI_2 - 0.0087;
/// Fields of view below 0.06° are none.
const NARROWEST: f32 = 0.001;
/// m from the tracking origin; beyond, a pose is garbage.
const FARTHEST: f32 = 1e5;
/// Quaternions within this of unit length are normalized, others are no rotation.
const LENGTH_TOLERANCE: f32 = 0.1;

/// Where the edges of an eye's image are, radians from straight ahead; left and down are negative
/// as a rule, but need not be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldOfView {
    /// Of the left edge, less than that of the right.
    pub left: f32,
    /// Of the right edge.
    pub right: f32,
    /// Of the upper edge.
    pub up: f32,
    /// Of the lower edge, less than that of the upper.
    pub down: f32,
}

impl FieldOfView {
    /// Whether it can be projected with: finite, less than 90° to each side, and not empty.
    pub fn is_usable(&self) -> bool {
        let Self {
            left,
            right,
            up,
            down,
        } = *self;
        let is_angle = |angle: f32| angle.is_finite() && angle.abs() <= WIDEST;
        [left, right, up, down].into_iter().all(is_angle)
            && right - left >= NARROWEST
            && up - down >= NARROWEST
    }

    /// Bevy's projection: reversed depth, far plane at infinity, `near` in m.
    pub fn clip_from_view(&self, near: f32) -> Mat4 {
        let [left, right, up, down] =
            [self.left, self.right, self.up, self.down].map(|angle| f64::from(angle).tan());
        let (width, height) = (right - left, up - down);
        let columns = [
            [2.0 / width, 0.0, 0.0, 0.0],
            [0.0, 2.0 / height, 0.0, 0.0],
            [(right + left) / width, (up + down) / height, 0.0, -1.0],
            [0.0, 0.0, f64::from(near), 0.0],
        ];
        Mat4::from_cols_array_2d(&columns.map(|column| column.map(|x| x as f32)))
    }
}

/// An eye that can be drawn: in tracking space, metres, −z ahead, +y up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EyeView {
    /// Tracking space from the eye.
    pub pose: Isometry3d,
    /// What the eye's image covers.
    pub fov: FieldOfView,
}

/// A view as a runtime gives it.
#[doc(hidden)]
#[derive(Clone, Copy, Debug)]
pub struct RawView {
    /// x, y, z, w; `None` where the runtime says that it isn't tracked.
    pub orientation: Option<[f32; 4]>,
    /// m.
    pub position: Option<[f32; 3]>,
    /// As it comes.
    pub fov: FieldOfView,
}

/// Spoils what the runtime says of the eyes at a display time, in ns: for tests.
#[doc(hidden)]
#[derive(Clone, Copy, Debug)]
pub struct TamperedViews(pub fn(i64, &mut RawView));

/// What is known of an eye so far.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct EyeHistory {
    orientation: Option<Quat>,
    position: Option<Vec3>,
    fov: Option<FieldOfView>,
}

impl EyeHistory {
    /// Takes in what is usable, and returns the eye once all of it is known.
    pub(crate) fn update(&mut self, raw: &RawView) -> Option<EyeView> {
        self.orientation = raw.orientation.and_then(rotation).or(self.orientation);
        self.position = raw.position.and_then(place).or(self.position);
        if raw.fov.is_usable() {
            self.fov = Some(raw.fov);
        }
        self.view()
    }

    pub(crate) fn view(&self) -> Option<EyeView> {
        Some(EyeView {
            pose: Isometry3d::new(self.position?, self.orientation?),
            fov: self.fov?,
        })
    }
}

/// A rotation, unless the quaternion is none.
pub(crate) fn rotation(quaternion: [f32; 4]) -> Option<Quat> {
    let quaternion = Quat::from_array(quaternion);
    let length = quaternion.length();
    let is_rotation = length.is_finite() && (length - 1.0).abs() <= LENGTH_TOLERANCE;
    is_rotation.then(|| quaternion.normalize())
}

/// A position, unless it is beyond reason.
pub(crate) fn place(position: [f32; 3]) -> Option<Vec3> {
    let position = Vec3::from(position);
    (position.is_finite() && position.abs().max_element() <= FARTHEST).then_some(position)
}

/// As the runtime takes it.
pub(crate) fn posef(pose: &Isometry3d) -> Posef {
    let [x, y, z, w] = pose.rotation.to_array();
    let [px, py, pz] = pose.translation.to_array();
    Posef {
        orientation: Quaternionf { x, y, z, w },
        position: Vector3f {
            x: px,
            y: py,
            z: pz,
        },
    }
}

/// Between the eyes.
pub(crate) fn head(eyes: &[EyeView; 2]) -> Isometry3d {
    let [left, right] = eyes.map(|eye| eye.pose);
    Isometry3d::new(
        Vec3::from(left.translation + right.translation) / 2.0,
        left.rotation.slerp(right.rotation, 0.5),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::math::{Vec2, Vec4};

    const FOV: FieldOfView = FieldOfView {
        left: -0.9,
        right: 0.6,
        up: 0.7,
        down: -0.8,
    };

    fn raw(orientation: [f32; 4], position: [f32; 3], fov: FieldOfView) -> RawView {
        RawView {
            orientation: Some(orientation),
            position: Some(position),
            fov,
        }
    }

    const AHEAD: [f32; 4] = [0.0, 0.0, 0.0, 1.0];

    #[test]
    fn edges_of_the_field_of_view_are_edges_of_the_image() {
        let clip_from_view = FOV.clip_from_view(0.05);
        let edge = |x: f32, y: f32| {
            let clip = clip_from_view * Vec4::new(2.0 * x.tan(), 2.0 * y.tan(), -2.0, 1.0);
            Vec2::new(clip.x, clip.y) / clip.w
        };
        assert!((edge(FOV.left, FOV.up) - Vec2::new(-1.0, 1.0)).length() < 1e-5);
        assert!((edge(FOV.right, FOV.down) - Vec2::new(1.0, -1.0)).length() < 1e-5);
        let near = clip_from_view * Vec4::new(0.0, 0.0, -0.05, 1.0);
        assert!((near.z / near.w - 1.0).abs() < 1e-6, "1 is near");
    }

    #[test]
    fn a_symmetric_projection_is_that_of_glam() {
        let half = 0.4_f32;
        let fov = FieldOfView {
            left: -half,
            right: half,
            up: half,
            down: -half,
        };
        let expected = Mat4::perspective_infinite_reverse_rh(2.0 * half, 1.0, 0.1);
        assert!(fov.clip_from_view(0.1).abs_diff_eq(expected, 1e-6));
    }

    #[test]
    fn unusable_parts_leave_the_former_ones() {
        let mut eye = EyeHistory::default();
        let flat = FieldOfView {
            left: 0.0,
            right: 0.0,
            up: 0.0,
            down: 0.0,
        };
        assert_eq!(eye.update(&raw([0.0; 4], [0.0; 3], FOV)), None);
        assert!(eye.update(&raw(AHEAD, [f32::NAN; 3], flat)).is_some());
        // The position of the first one was usable, and so is its field of view.
        let first = eye.view().expect("all known");
        assert_eq!(first.fov, FOV);
        for bad in [
            raw([f32::NAN; 4], [1.0; 3], flat),
            raw([0.0; 4], [f32::INFINITY; 3], FOV),
            raw([0.5, 0.0, 0.0, 0.0], [1e9; 3], flat),
        ] {
            let view = eye.update(&bad).expect("what was known stays");
            assert_eq!(view.pose.rotation, Quat::IDENTITY);
            assert!(Vec3::from(view.pose.translation).is_finite());
            assert_eq!(view.fov, FOV);
        }
        let untracked = RawView {
            orientation: None,
            position: None,
            fov: flat,
        };
        assert!(eye.update(&untracked).is_some());
    }

    #[test]
    fn quaternions_are_normalized() {
        let quat = rotation([0.0, 0.0, 0.0, 1.05]).expect("nearly one");
        assert!((quat.length() - 1.0).abs() < 1e-6);
    }

    #[test]
    fn fields_of_view_without_a_tangent_are_none() {
        for (left, right) in [(-1.7, 1.0), (0.3, 0.3), (0.5, -0.5), (f32::NAN, 0.5)] {
            let fov = FieldOfView { left, right, ..FOV };
            assert!(!fov.is_usable(), "{left} to {right}");
        }
        assert!(FOV.is_usable());
    }
}
