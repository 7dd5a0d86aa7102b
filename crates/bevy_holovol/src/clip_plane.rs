//! Planes that cut volumes open.

use bevy::prelude::*;
use glam::{DVec3, DVec4};

use crate::Volume3d;

/// A plane that cuts volumes: through the entity's origin, and what lies on the side of its local
/// +y is left out, for light and view alike.
///
/// As a descendant of a [`Volume3d`] it moves with that volume and cuts only it; elsewhere it cuts
/// all volumes. Up to 8 planes cut one volume; despawn a plane, or hide it, to close the volume.
#[derive(Component, Reflect, Clone, Copy, Debug, Default)]
#[reflect(Component, Default, Clone, Debug)]
#[require(Transform, Visibility)]
pub struct VolumeClipPlane;

impl VolumeClipPlane {
    /// Where a plane stands that keeps what has n·x + w ≥ 0, as scenes and
    /// [`SceneParts`](crate::SceneParts) have it: (n, w), n of length 1.
    pub fn transform(plane: DVec4) -> Transform {
        let normal = plane.truncate();
        Transform {
            translation: (normal * -plane.w).as_vec3(),
            rotation: Quat::from_rotation_arc(Vec3::Y, -normal.as_vec3()),
            scale: Vec3::ONE,
        }
    }
}

/// (n, w) with n·x + w ≥ 0 for what stays.
pub(crate) fn plane_of(transform: &GlobalTransform) -> Option<DVec4> {
    // A normal turns by the inverse transpose.
    let matrix = transform.affine().matrix3.as_dmat3();
    let normal = (matrix.inverse().transpose() * DVec3::NEG_Y).normalize_or_zero();
    let at = transform.translation().as_dvec3();
    let is_plane = normal.is_finite() && normal != DVec3::ZERO && at.is_finite();
    is_plane.then(|| normal.extend(-normal.dot(at)))
}

pub(crate) type ClipPlaneData<'a> = (Entity, &'a GlobalTransform, &'a InheritedVisibility);

/// The planes that cut a volume.
pub(crate) fn planes_of(
    volume: Entity,
    planes: &Query<ClipPlaneData, With<VolumeClipPlane>>,
    parents: &Query<&ChildOf>,
    volumes: &Query<(), With<Volume3d>>,
) -> Vec<DVec4> {
    let cuts = |plane: Entity| {
        let owner = parents.iter_ancestors(plane).find(|&e| volumes.contains(e));
        owner.is_none_or(|owner| owner == volume)
    };
    planes
        .iter()
        .filter(|(plane, _, visibility)| visibility.get() && cuts(*plane))
        .filter_map(|(_, transform, _)| plane_of(transform))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn height(transform: Transform, point: DVec3) -> f64 {
        plane_of(&transform.into()).unwrap().dot(point.extend(1.0))
    }

    #[test]
    fn a_plane_stands_where_its_numbers_say() {
        for normal in [DVec3::X, DVec3::NEG_Y, DVec3::new(0.6, 0.0, -0.8)] {
            let plane = normal.extend(0.3);
            let found = plane_of(&VolumeClipPlane::transform(plane).into()).unwrap();
            assert!((found - plane).length() < 1e-6, "{found} {plane}");
        }
    }

    #[test]
    fn what_lies_above_is_left_out() {
        let lid = Transform::from_xyz(0.0, 2.0, 0.0);
        assert!(height(lid, DVec3::new(5.0, 1.9, 3.0)) > 0.0);
        assert!(height(lid, DVec3::new(5.0, 2.1, 3.0)) < 0.0);
        let tilted = lid.with_rotation(Quat::from_rotation_z(-std::f32::consts::FRAC_PI_2));
        assert!(
            height(tilted, DVec3::new(0.1, 9.0, 0.0)) < 0.0,
            "+y is turned to +x"
        );
        let stretched = tilted.with_scale(Vec3::new(3.0, 0.1, 1.0));
        assert!((height(stretched, DVec3::new(-0.25, 0.0, 0.0)) - 0.25).abs() < 1e-6);
        assert_eq!(plane_of(&Transform::from_scale(Vec3::ZERO).into()), None);
    }
}
