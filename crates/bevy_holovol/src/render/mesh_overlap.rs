//! Which volumes have meshes inside them: only those need depth.

use std::any::TypeId;
use std::collections::{HashMap, HashSet};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;

use bevy::asset::AssetEventSystems;
use bevy::camera::primitives::Aabb;
use bevy::camera::visibility::{NoFrustumCulling, VisibilitySystems, VisibleEntities};
use bevy::ecs::system::SystemParam;
use bevy::mesh::morph::{MeshMorphWeights, MorphWeights};
use bevy::mesh::skinning::SkinnedMesh;
use bevy::pbr::{PreprocessPipelines, SpecializedPrepassMaterialPipelineCache};
use bevy::prelude::*;
use bevy::render::render_resource::PipelineCache;
use bevy::render::sync_world::MainEntity;
use bevy::render::view::RetainedViewEntity;
use glam::{DAffine3, DMat4, DVec3};

use super::VolumeRenderSettings;
use super::shown::{FollowAssets, ShownAssets};
use crate::{Volume3d, VolumeAsset};

/// Meshes, each with a number that is another one once it has moved or changed.
pub(super) type MeshesInside = Arc<[(MainEntity, u64)]>;

/// Per camera and volume, the meshes inside; nothing where there are none.
#[derive(Resource, Default)]
pub(crate) struct MeshOverlaps {
    inside: HashMap<(Entity, Entity), MeshesInside>,
    /// Of each mesh that is inside a volume, the frame in which it last changed.
    changed_in: HashMap<Entity, u64>,
    frame: u64,
}

impl MeshOverlaps {
    pub(super) fn get(&self, camera: Entity, volume: Entity) -> Option<MeshesInside> {
        self.inside.get(&(camera, volume)).cloned()
    }
}

pub(super) fn build(app: &mut App) {
    app.init_resource::<MeshOverlaps>().add_systems(
        PostUpdate,
        find.after(VisibilitySystems::CheckVisibility)
            .after(AssetEventSystems)
            .after(FollowAssets),
    );
}

type MeshData<'a> = (
    Ref<'a, GlobalTransform>,
    Ref<'a, Mesh3d>,
    Option<&'a Aabb>,
    Has<NoFrustumCulling>,
    Option<&'a SkinnedMesh>,
    Option<Ref<'a, MeshMorphWeights>>,
);

/// What bends a mesh though the mesh itself stays.
#[derive(SystemParam)]
struct Bending<'w, 's> {
    joints: Query<'w, 's, Ref<'static, GlobalTransform>>,
    morphs: Query<'w, 's, Ref<'static, MorphWeights>>,
}

impl Bending<'_, '_> {
    fn is_changed(&self, skin: Option<&SkinnedMesh>, morph: Option<Ref<MeshMorphWeights>>) -> bool {
        let moved = |joint: &Entity| self.joints.get(*joint).is_ok_and(|j| j.is_changed());
        skin.is_some_and(|skin| skin.joints.iter().any(moved))
            || morph.is_some_and(|morph| match &*morph {
                MeshMorphWeights::Reference(weights) => {
                    morph.is_changed() || self.morphs.get(*weights).is_ok_and(|w| w.is_changed())
                }
                MeshMorphWeights::Value { .. } => morph.is_changed(),
            })
    }
}

/// Tests the boxes of all meshes that a camera sees against those of its volumes.
fn find(
    mut overlaps: ResMut<MeshOverlaps>,
    mut mesh_events: MessageReader<AssetEvent<Mesh>>,
    cameras: Query<(Entity, &VisibleEntities), With<VolumeRenderSettings>>,
    volumes: Query<&GlobalTransform, With<Volume3d>>,
    meshes: Query<MeshData>,
    bending: Bending,
    assets: Res<ShownAssets>,
) {
    let edited: HashSet<_> = mesh_events
        .read()
        .filter_map(|event| match event {
            AssetEvent::Added { id } | AssetEvent::Modified { id } => Some(*id),
            _ => None,
        })
        .collect();
    let overlaps = &mut *overlaps;
    overlaps.inside.clear();
    overlaps.frame += 1;
    let before = std::mem::take(&mut overlaps.changed_in);
    for (camera, visible) in &cameras {
        for &volume in visible.get(TypeId::of::<Volume3d>()) {
            let Ok(transform) = volumes.get(volume) else {
                continue;
            };
            let Some(asset) = assets.volume(volume) else {
                continue;
            };
            let cube_from_world = cube_from_world(transform, asset);
            let mut inside = Vec::new();
            for &mesh in visible.get(TypeId::of::<Mesh3d>()) {
                let Ok((transform, mesh3d, aabb, unbounded, skin, morph)) = meshes.get(mesh) else {
                    continue;
                };
                let is_inside = unbounded
                    || aabb.is_none_or(|aabb| overlaps_cube(cube_from_world, &transform, aabb));
                if !is_inside {
                    continue;
                }
                let is_changed = transform.is_changed()
                    || mesh3d.is_changed()
                    || edited.contains(&mesh3d.id())
                    || bending.is_changed(skin, morph);
                let changed_in = match is_changed {
                    true => overlaps.frame,
                    // What it did while nobody looked isn't known.
                    false => before.get(&mesh).copied().unwrap_or(overlaps.frame),
                };
                overlaps.changed_in.insert(mesh, changed_in);
                inside.push((mesh.into(), changed_in));
            }
            if !inside.is_empty() {
                // A camera lists what it sees in no order.
                inside.sort_unstable_by_key(|(mesh, _): &(MainEntity, u64)| mesh.id());
                overlaps.inside.insert((camera, volume), inside.into());
            }
        }
    }
}

/// Which meshes Bevy can draw into a view's depth by now: they come late while their mesh or
/// material is loaded, or their pipeline compiled.
#[derive(SystemParam)]
pub(super) struct DrawableMeshes<'w> {
    pipelines: Option<Res<'w, SpecializedPrepassMaterialPipelineCache>>,
    preprocess: Option<Res<'w, PreprocessPipelines>>,
    cache: Res<'w, PipelineCache>,
}

impl DrawableMeshes<'_> {
    /// What a view's depth shows of these meshes; `None` if nothing. Another number, another depth.
    pub(super) fn depth_of(&self, view: &RetainedViewEntity, meshes: &MeshesInside) -> Option<u64> {
        let of_view = self.pipelines.as_ref()?.get(view)?;
        let mut shown = DefaultHasher::new();
        let mut is_any = false;
        for (mesh, changed_in) in meshes.iter() {
            let Some((_, pipeline, _)) = of_view.get(mesh) else {
                continue;
            };
            if self.cache.get_render_pipeline(*pipeline).is_some() {
                is_any = true;
                (mesh, changed_in, pipeline.id()).hash(&mut shown);
            }
        }
        if !is_any {
            return None;
        }
        self.preprocess_pipelines_there().hash(&mut shown);
        Some(shown.finish())
    }

    /// Without these Bevy draws no mesh whose draws are made on the device.
    fn preprocess_pipelines_there(&self) -> usize {
        let Some(all) = &self.preprocess else {
            return 0;
        };
        let ids = [
            all.bin_unpacking.pipeline_id,
            all.direct_preprocess.pipeline_id,
            all.gpu_frustum_culling_preprocess.pipeline_id,
            all.early_gpu_occlusion_culling_preprocess.pipeline_id,
            all.gpu_frustum_culling_build_indexed_indirect_params
                .pipeline_id,
            all.gpu_frustum_culling_build_non_indexed_indirect_params
                .pipeline_id,
            all.early_phase.reset_indirect_batch_sets.pipeline_id,
            all.early_phase
                .gpu_occlusion_culling_build_indexed_indirect_params
                .pipeline_id,
            all.early_phase
                .gpu_occlusion_culling_build_non_indexed_indirect_params
                .pipeline_id,
        ];
        let ids = ids.into_iter().flatten();
        ids.filter(|id| self.cache.get_compute_pipeline(*id).is_some())
            .count()
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
