//! Scenes of `holovol render` as Bevy's components.

use bevy::prelude::*;
use glam::{DVec3, DVec4};
use holovol_scene::{Camera as SceneCamera, Scene};

use crate::environment::DEFAULT_INTENSITY;
use crate::{
    EnvironmentAsset, TransferFunctionAsset, VolumeAsset, VolumeMedium, VolumeRenderSettings,
};

/// What a [`Scene`] consists of, ready to be spawned.
///
/// Radiance 1 of the scene is [`DEFAULT_INTENSITY`] cd/m² here. With an `Exposure` whose
/// `exposure()` is its inverse, a camera shows the numbers that `holovol render` writes.
#[derive(Clone, Debug)]
pub struct SceneParts {
    /// The voxels, placed as the scene says.
    pub volume: VolumeAsset,
    /// Extinctions in 1/m.
    pub transfer_function: TransferFunctionAsset,
    /// Window, phase function, surface.
    pub medium: VolumeMedium,
    /// Where [`VolumeClipPlane`](crate::VolumeClipPlane)s stand that cut it, as (n, w) with
    /// n·x + w ≥ 0 for what stays.
    pub clip_planes: Vec<DVec4>,
    /// The light's map.
    pub environment: EnvironmentAsset,
    /// cd/m² of radiance 1 of the map.
    pub intensity: f32,
    /// Turn of the map about +y, radians.
    pub rotation_y: f32,
    /// Pose of the camera.
    pub camera: Transform,
    /// What the camera looks at.
    pub target: Vec3,
    /// Its vertical field of view.
    pub projection: PerspectiveProjection,
    /// Scatterings; the rest is the default.
    pub settings: VolumeRenderSettings,
    /// Pixels across and down.
    pub size: UVec2,
}

impl SceneParts {
    /// Takes a scene apart.
    pub fn new(scene: Scene) -> Self {
        let [low, high] = scene.window;
        Self {
            medium: VolumeMedium {
                window: Some((low, high)),
                phase_g: scene.phase_g,
                gradient_factor: scene.gradient_factor,
                ..default()
            },
            transfer_function: TransferFunctionAsset::from_function(scene.transfer_function),
            volume: VolumeAsset::new(scene.volume).with_placement(scene.world_from_unit_cube),
            clip_planes: scene.clip_planes,
            environment: EnvironmentAsset::new(scene.environment.map),
            intensity: scene.environment.scale as f32 * DEFAULT_INTENSITY,
            rotation_y: scene.environment.rotation_y as f32,
            camera: pose(&scene.camera),
            target: scene.camera.target.as_vec3(),
            projection: PerspectiveProjection {
                fov: scene.camera.fov_y as f32,
                aspect_ratio: scene.camera.width as f32 / scene.camera.height as f32,
                // Scans are looked at from near.
                near: 0.01 * scene.camera.eye.distance(scene.camera.target) as f32,
                ..default()
            },
            settings: VolumeRenderSettings {
                max_scatters: scene.integrator.max_scatters,
                ..default()
            },
            size: UVec2::new(scene.camera.width, scene.camera.height),
        }
    }
}

fn pose(camera: &SceneCamera) -> Transform {
    let [right, up, forward]: [DVec3; 3] = camera.axes();
    let rotation = glam::DMat3::from_cols(right, up, -forward);
    Transform {
        translation: camera.eye.as_vec3(),
        rotation: glam::DQuat::from_mat3(&rotation).as_quat(),
        scale: Vec3::ONE,
    }
}
