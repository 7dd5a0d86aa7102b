use std::any::TypeId;
use std::collections::HashMap;
use std::sync::Arc;

use bevy::camera::visibility::VisibleEntities;
use bevy::prelude::*;
use bevy::render::Extract;
use bevy::render::sync_world::MainEntity;
use glam::DMat4;
use holovol_light::EnvironmentMap;
use holovol_render::Medium;
use holovol_volume::{TransferFunction, TransferPoint, Volume};

use super::mesh_overlap::{MeshOverlaps, MeshesInside};
use super::shown::ShownAssets;
use super::{RightEyeOf, VolumeRenderMode, VolumeRenderSettings};
use crate::clip_plane::{ClipPlaneData, planes_of};
use crate::environment::CurrentMap;
use crate::{
    TransferFunctionAsset, Volume3d, VolumeAsset, VolumeClipPlane, VolumeEnvironment, VolumeMedium,
};

/// What the render world knows of volumes; made anew in every frame, of shared data.
#[derive(Resource, Default)]
pub(super) struct ExtractedScene {
    pub(super) environment: Option<Arc<EnvironmentMap>>,
    pub(super) volumes: Vec<ExtractedVolume>,
    pub(super) views: Vec<ExtractedVolumeView>,
}

pub(super) struct ExtractedVolume {
    pub(super) entity: MainEntity,
    pub(super) volume: Arc<Volume>,
    /// Scatterings are the views' to say.
    pub(super) medium: Medium,
}

pub(super) struct ExtractedVolumeView {
    pub(super) entity: MainEntity,
    pub(super) settings: VolumeRenderSettings,
    /// The left eye to this one, if both are denoised.
    pub(super) left_eye: Option<MainEntity>,
    /// What it sees, and what meshes are inside.
    pub(super) volumes: Vec<(MainEntity, Option<MeshesInside>)>,
}

type VolumeData<'a> = (Entity, &'a GlobalTransform, &'a VolumeMedium);

type ViewData<'a> = (
    Entity,
    &'a Camera,
    &'a VolumeRenderSettings,
    &'a VisibleEntities,
    Option<&'a RightEyeOf>,
);

#[expect(clippy::too_many_arguments, reason = "all that a volume consists of")]
pub(super) fn extract_volumes(
    mut scene: ResMut<ExtractedScene>,
    mut edges: Local<HashMap<Entity, f64>>,
    environment: Extract<Option<Res<VolumeEnvironment>>>,
    map: Extract<Option<Res<CurrentMap>>>,
    volumes: Extract<Query<VolumeData, With<Volume3d>>>,
    is_volume: Extract<Query<(), With<Volume3d>>>,
    planes: Extract<Query<ClipPlaneData, With<VolumeClipPlane>>>,
    parents: Extract<Query<&ChildOf>>,
    views: Extract<Query<ViewData>>,
    assets: Extract<Res<ShownAssets>>,
    overlaps: Extract<Res<MeshOverlaps>>,
) {
    // Without the plugin of the environment all is lit by uniform white light.
    let environment = environment.as_deref().cloned().unwrap_or_default();
    match map.as_deref() {
        Some(map) => scene.environment.clone_from(&map.0),
        None if scene.environment.is_none() => {
            scene.environment = Some(Arc::new(EnvironmentMap::constant([1.0; 3])));
        }
        None => {}
    }
    scene.volumes.clear();
    for (entity, transform, medium) in &volumes {
        let (asset, function) = (assets.volume(entity), assets.function(entity));
        let (Some(asset), Some(transfer_function)) = (asset, function) else {
            continue;
        };
        let edge = steady(&mut edges, entity, longest_edge(asset, transform));
        let clip_planes = planes_of(entity, &planes, &parents, &is_volume);
        scene.volumes.push(ExtractedVolume {
            entity: entity.into(),
            volume: Arc::clone(asset.volume()),
            medium: Medium {
                clip_planes,
                ..medium_of(
                    asset,
                    transform,
                    edge,
                    transfer_function,
                    medium,
                    &environment,
                )
            },
        });
    }
    edges.retain(|entity, _| volumes.contains(*entity));
    scene.views.clear();
    for (entity, camera, settings, visible, eye) in &views {
        if !camera.is_active {
            continue;
        }
        let seen = visible.get(TypeId::of::<Volume3d>()).iter();
        scene.views.push(ExtractedVolumeView {
            entity: entity.into(),
            settings: settings.clone(),
            left_eye: eye.map(|eye| eye.0.into()),
            volumes: seen
                .map(|&volume| (volume.into(), overlaps.get(entity, volume)))
                .collect(),
        });
    }
    join_eyes(&mut scene.views);
}

/// Finds the pairs: what one eye of a pair sees is traced for both, so that they stay together while
/// a volume is at the border of one.
fn join_eyes(views: &mut [ExtractedVolumeView]) {
    let mut taken = Vec::new();
    for right in 0..views.len() {
        let Some(left_eye) = views[right].left_eye.take() else {
            continue;
        };
        let Some(left) = views.iter().position(|view| view.entity == left_eye) else {
            continue;
        };
        let [a, b] = [left, right].map(|i| &views[i].settings);
        let fits = [a, b].iter().all(|s| s.mode == VolumeRenderMode::Denoised)
            && a.denoiser == b.denoiser
            && a.max_scatters == b.max_scatters;
        if left == right || !fits || taken.contains(&left) || taken.contains(&right) {
            continue;
        }
        taken.extend([left, right]);
        views[right].left_eye = Some(left_eye);
        for (from, to) in [(left, right), (right, left)] {
            for (volume, _) in views[from].volumes.clone() {
                if views[to].volumes.iter().all(|(other, _)| *other != volume) {
                    views[to].volumes.push((volume, None));
                }
            }
        }
    }
}

/// A length that changes by no more than rounding does not change: extinctions that go by it would
/// be other ones in every frame in which a volume turns.
fn steady(lengths: &mut HashMap<Entity, f64>, of: Entity, length: f64) -> f64 {
    const ROUNDING: f64 = 1e-5;
    let known = lengths.entry(of).or_insert(length);
    if (length - *known).abs() > ROUNDING * known.abs() {
        *known = length;
    }
    *known
}

fn placement(asset: &VolumeAsset, transform: &GlobalTransform) -> DMat4 {
    DMat4::from(transform.affine().as_daffine3()) * asset.local_from_unit_cube()
}

/// Metres.
fn longest_edge(asset: &VolumeAsset, transform: &GlobalTransform) -> f64 {
    let world_from_unit_cube = placement(asset, transform);
    let edge = |axis| world_from_unit_cube.col(axis).truncate().length();
    edge(0).max(edge(1)).max(edge(2))
}

fn medium_of(
    asset: &VolumeAsset,
    transform: &GlobalTransform,
    longest_edge: f64,
    transfer_function: &TransferFunctionAsset,
    medium: &VolumeMedium,
    environment: &VolumeEnvironment,
) -> Medium {
    let volume = asset.volume();
    let file = transfer_function.file();
    let window = medium
        .window
        .map(|(low, high)| [low, high])
        .or(file.window)
        .or(volume.header_window())
        .unwrap_or(volume.range());
    let function = file.for_volume_size(longest_edge);
    Medium {
        window,
        world_from_unit_cube: placement(asset, transform),
        transfer_function: scaled(&function, medium.density, medium.emission_intensity),
        phase_g: medium.phase_g,
        gradient_factor: medium.gradient_factor,
        max_scatters: Some(1),
        clip_planes: Vec::new(),
        environment_rotation_y: f64::from(environment.rotation_y),
        environment_scale: f64::from(environment.intensity).max(0.0),
    }
}

/// Extinctions and emissions times these; as it is if they are not finite and ≥ 0.
fn scaled(function: &TransferFunction, density: f64, emission: f64) -> TransferFunction {
    let has_emission = function
        .points()
        .iter()
        .any(|point| point.emission != [0.0; 3]);
    if density == 1.0 && !has_emission {
        return function.clone();
    }
    let points = function.points().iter().map(|point| TransferPoint {
        sigma_t: point.sigma_t * density,
        emission: point.emission.map(|e| e * emission),
        ..*point
    });
    TransferFunction::new(points.collect()).unwrap_or_else(|_| function.clone())
}
