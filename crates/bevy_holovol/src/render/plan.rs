//! What a frame wants of the tracers, decided from poses as late as they come.

use bevy::core_pipeline::prepass::ViewPrepassTextures;
use bevy::prelude::*;
use bevy::render::camera::ExtractedCamera;
use bevy::render::sync_world::MainEntity;
use bevy::render::view::ExtractedView;
use glam::DMat4;
use holovol_render::{DepthLayers, View, ViewFrame};

use super::denoise::{self, WantedDenoising};
use super::extract::ExtractedScene;
use super::mesh_overlap::DrawableMeshes;
use super::node::{DepthTarget, DepthTargetShape};
use super::prepare::{TracerKey, VolumeGpu, viewport_size};
use super::sampling::SamplingMaps;
use super::{VolumeRenderMode, VolumeSampling, VolumeStatistics};

/// What one view wants of one volume.
pub(super) struct PlannedView {
    pub(super) key: TracerKey,
    pub(super) camera: MainEntity,
    pub(super) frame: ViewFrame,
    pub(super) denoising: Option<WantedDenoising>,
}

/// A view whose meshes may end paths.
struct MeshView {
    view: Entity,
    camera: MainEntity,
    layers: DepthLayers,
    shape: DepthTargetShape,
}

/// A view whose meshes' depth is to be drawn.
pub(super) struct PlannedDepth {
    pub(super) view: Entity,
    pub(super) layers: DepthLayers,
    pub(super) target: DepthTarget,
}

type PlannedCamera<'a> = (
    Entity,
    &'a MainEntity,
    &'a ExtractedCamera,
    &'a ExtractedView,
    &'a Msaa,
    Option<&'a ViewPrepassTextures>,
    Option<&'a VolumeSampling>,
);

/// Decides what each view wants, and which need depth.
pub(super) fn plan_frame(
    mut gpu: ResMut<VolumeGpu>,
    scene: Res<ExtractedScene>,
    cameras: Query<PlannedCamera>,
    drawable: DrawableMeshes,
    mut sampling_maps: ResMut<SamplingMaps>,
    statistics: Res<VolumeStatistics>,
) {
    let Some(inner) = &mut gpu.0 else {
        return;
    };
    inner.plan.clear();
    inner.depth_plan.clear();
    let mut layers_used = 0;
    let mut mesh_views = Vec::new();
    for wanted in &scene.views {
        let Some((entity, camera, extracted, view, msaa, prepass, sampling)) =
            cameras.iter().find(|camera| *camera.1 == wanted.entity)
        else {
            continue;
        };
        let viewport = viewport_size(view);
        let settings = &wanted.settings;
        let size = settings.image_size(viewport);
        let (_, rotation, translation) = view.world_from_view.to_scale_rotation_translation();
        let world_from_view =
            DMat4::from_rotation_translation(rotation.as_dquat(), translation.as_dvec3());
        let clip_from_view = view.clip_from_view.as_dmat4();
        let pose = View::from_projection(world_from_view, clip_from_view, size);
        let has_depth = prepass.is_some_and(|p| p.depth.is_some() && p.deferred.is_none());
        let overlaps: Vec<_> = wanted
            .volumes
            .iter()
            .map(|(_, meshes)| {
                let meshes = meshes.as_ref().filter(|_| has_depth)?;
                drawable.depth_of(&view.retained_view_entity, meshes)
            })
            .collect();
        let layers = overlaps.iter().any(Option::is_some).then(|| {
            let first = layers_used;
            layers_used += msaa.samples();
            DepthLayers {
                first,
                count: msaa.samples(),
                size: viewport,
            }
        });
        if let (Some(layers), Some(prepass)) = (layers, prepass) {
            mesh_views.push(MeshView {
                view: entity,
                camera: *camera,
                layers,
                shape: DepthTargetShape {
                    size: viewport,
                    samples: msaa.samples(),
                    normals: prepass.normal.is_some(),
                    motion_vectors: prepass.motion_vectors.is_some(),
                },
            });
        }
        let shares = sampling_maps.get(*camera, sampling, size);
        for ((volume, _), overlap) in wanted.volumes.iter().zip(overlaps) {
            let key = (*volume, settings.max_scatters);
            let Some(tracing) = inner.tracings.get_mut(&key) else {
                continue;
            };
            let Some(slot) = tracing.slot_of(*camera, size) else {
                continue;
            };
            let meshes_changed = std::mem::replace(&mut tracing.overlaps[slot], overlap) != overlap;
            let is_fresh = settings.mode == VolumeRenderMode::Fresh;
            let is_denoised = settings.mode == VolumeRenderMode::Denoised;
            if let Some((tracer, _)) = tracing.tracer_mut()
                && let Err(error) = tracer.set_shares(slot, shares.as_ref())
            {
                error_once!("{error}");
            }
            inner.plan.push(PlannedView {
                key,
                camera: *camera,
                frame: ViewFrame {
                    slot,
                    view: pose,
                    samples: settings.samples,
                    max_samples: settings.max_samples,
                    restart: settings.reset || meshes_changed || is_fresh,
                    mesh_depth: layers.filter(|_| overlap.is_some()),
                },
                denoising: is_denoised.then_some(WantedDenoising {
                    denoiser: settings.denoiser,
                    left_eye: wanted.left_eye,
                    meshes_changed,
                    reset: settings.reset,
                    exposure: extracted.exposure,
                }),
            });
        }
    }
    let plan = &inner.plan;
    let is_planned = |name: &(MainEntity, TracerKey)| {
        plan.iter()
            .any(|planned| (planned.camera, planned.key) == *name)
    };
    inner.bindings.retain(|name, _| is_planned(name));
    statistics.update(|statistics| denoise::plan(inner, &scene.views, statistics));
    for mesh_view in mesh_views {
        let wants_depth = inner.plan.iter().any(|planned| {
            let tracer = inner.tracings.get(&planned.key).and_then(|t| t.tracer());
            planned.camera == mesh_view.camera
                && planned.frame.mesh_depth.is_some()
                && tracer.is_some_and(|tracer| tracer.wants(&planned.frame))
        });
        if !wants_depth {
            continue;
        }
        match inner.depth_target(mesh_view.shape) {
            Ok(target) => inner.depth_plan.push(PlannedDepth {
                view: mesh_view.view,
                layers: mesh_view.layers,
                target,
            }),
            Err(error) => error_once!("{error}"),
        }
    }
    sampling_maps.end_frame();
    let plan = &inner.depth_plan;
    inner
        .depth_targets
        .retain(|target| plan.iter().any(|p| p.target.shape() == target.shape()));
    if let Some(largest) = inner
        .depth_plan
        .iter()
        .map(|d| d.layers.size)
        .reduce(|a, b| [a[0].max(b[0]), a[1].max(b[1])])
        && let Err(error) = inner.mesh_depth.reserve(largest, layers_used)
    {
        error_once!("{error}");
        inner.depth_plan.clear();
        for planned in &mut inner.plan {
            planned.frame.mesh_depth = None;
        }
    }
    let depth_passes = inner.depth_plan.len() as u64;
    statistics.update(|statistics| {
        statistics.frames += 1;
        statistics.depth_passes += depth_passes;
    });
}
