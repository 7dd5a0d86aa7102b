//! Which volumes have meshes inside them: only those need depth.

use std::any::TypeId;
use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash, Hasher};

use bevy::camera::primitives::Aabb;
use bevy::camera::visibility::{NoFrustumCulling, VisibleEntities};
use bevy::mesh::skinning::SkinnedMesh;
use bevy::prelude::*;
use glam::{DAffine3, DMat4, DVec3};

use super::VolumeRenderSettings;
use crate::{Volume3d, VolumeAsset};

/// Per camera and volume: what the meshes inside are like. Another number, other meshes; none: no
/// mesh.
#[derive(Resource, Default)]
pub(crate) struct MeshOverlaps(HashMap<(Entity, Entity), u64>);

impl MeshOverlaps {
    pub(crate) fn get(&self, camera: Entity, volume: Entity) -> Option<u64> {
        self.0.get(&(camera, volume)).copied()
    }
}

type MeshData<'a> = (
    Ref<'a, GlobalTransform>,
    Ref<'a, Mesh3d>,
    Option<&'a Aabb>,
    Has<NoFrustumCulling>,
    Has<SkinnedMesh>,
);

/// Tests the boxes of all meshes that a camera sees against those of its volumes.
pub(super) fn find(
    mut overlaps: ResMut<MeshOverlaps>,
    mut mesh_events: MessageReader<AssetEvent<Mesh>>,
    cameras: Query<(Entity, &VisibleEntities), With<VolumeRenderSettings>>,
    volumes: Query<(&GlobalTransform, &Volume3d)>,
    meshes: Query<MeshData>,
    assets: Res<Assets<VolumeAsset>>,
    mut changes: Local<u64>,
) {
    if mesh_events
        .read()
        .any(|event| matches!(event, AssetEvent::Modified { .. }))
    {
        *changes += 1;
    }
    overlaps.0.clear();
    for (camera, visible) in &cameras {
        for &volume in visible.get(TypeId::of::<Volume3d>()) {
            let Ok((transform, handle)) = volumes.get(volume) else {
                continue;
            };
            let Some(asset) = assets.get(&handle.0) else {
                continue;
            };
            let cube_from_world = cube_from_world(transform, asset);
            let mut inside = DefaultHasher::new();
            let mut is_any = false;
            for &mesh in visible.get(TypeId::of::<Mesh3d>()) {
                let Ok((transform, mesh3d, aabb, unbounded, skinned)) = meshes.get(mesh) else {
                    continue;
                };
                let is_inside = unbounded
                    || aabb.is_none_or(|aabb| overlaps_cube(cube_from_world, &transform, aabb));
                if is_inside {
                    is_any = true;
                    if transform.is_changed() || mesh3d.is_changed() || skinned {
                        *changes += 1;
                    }
                    mesh.hash(&mut inside);
                }
            }
            if is_any {
                changes.hash(&mut inside);
                overlaps.0.insert((camera, volume), inside.finish());
            }
        }
    }
}

fn cube_from_world(transform: &GlobalTransform, asset: &VolumeAsset) -> DAffine3 {
    let world_from_local = DMat4::from(transform.affine().as_daffine3());
    DAffine3::from_mat4((world_from_local * asset.local_from_unit_cube()).inverse())
}

/// Whether a mesh's box, seen from the unit cube, meets it; too large rather than too small.
fn overlaps_cube(cube_from_world: DAffine3, mesh: &GlobalTransform, aabb: &Aabb) -> bool {
    let cube_from_mesh = cube_from_world * mesh.affine().as_daffine3();
    let centre = cube_from_mesh.transform_point3(aabb.center.as_dvec3());
    let edges = cube_from_mesh.matrix3;
    let half = aabb.half_extents.as_dvec3();
    let half =
        edges.x_axis.abs() * half.x + edges.y_axis.abs() * half.y + edges.z_axis.abs() * half.z;
    let is_apart =
        (centre - half).cmpgt(DVec3::ONE).any() || (centre + half).cmplt(DVec3::ZERO).any();
    // A mesh that can't be placed counts.
    !is_apart
}

#[cfg(test)]
mod tests {
    use super::*;

    fn overlaps(transform: Transform) -> bool {
        let aabb = Aabb::from_min_max(Vec3::splat(-0.5), Vec3::splat(0.5));
        overlaps_cube(DAffine3::IDENTITY, &transform.into(), &aabb)
    }

    #[test]
    fn boxes_meet_or_not() {
        assert!(overlaps(Transform::from_xyz(0.5, 0.5, 0.5)));
        assert!(overlaps(Transform::from_xyz(1.4, 0.5, 0.5)));
        assert!(!overlaps(Transform::from_xyz(1.6, 0.5, 0.5)));
        let eighth = Quat::from_rotation_y(std::f32::consts::FRAC_PI_4);
        assert!(overlaps(
            Transform::from_xyz(1.6, 0.5, 0.5).with_rotation(eighth)
        ));
        assert!(!overlaps(
            Transform::from_xyz(0.5, -0.6, 0.5).with_rotation(eighth)
        ));
        assert!(overlaps(Transform::from_scale(Vec3::splat(100.0))));
    }
}
