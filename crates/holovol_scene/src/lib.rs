//! What holovol renders, and the scene files that say it.
//!
//! A [`Scene`] is a volume, a transfer function, light, a camera and an integrator, all in
//! memory: the GPU kernels and the f64 reference both render it. [`SceneFile`] is its JSON form;
//! [`load`] reads one with everything it names, and a [`Sequence`] gives the frames of an animated
//! one.

mod camera;
mod file;

pub use camera::{Camera, PixelRays};
pub use file::{
    AnimationEntry, Background, CameraEntry, EnvironmentEntry, IntegratorEntry, OutputEntry,
    SceneError, SceneFile, Sequence, StereoEntry, SwitchEntry, ToneMapping, TransferFunctionEntry,
    VolumeEntry, load,
};

use glam::{DMat4, DVec3, DVec4};
use holovol_light::EnvironmentMap;
use holovol_volume::{TransferFunction, Volume};

/// Everything that decides the picture of a volume.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The scalar field.
    pub volume: Volume,
    /// Values at which s is 0 and 1, data units; may be reversed, not equal.
    pub window: [f64; 2],
    /// World metres from unit-cube coordinates.
    pub world_from_unit_cube: DMat4,
    /// Extinction, albedo, emission and surface over s.
    pub transfer_function: TransferFunction,
    /// Mean cosine g of the Henyey–Greenstein phase function; > 0 scatters forward.
    pub phase_g: f64,
    /// k of the gradient-surface blend P = 1 − exp(−k·|∇s|·h); 0 turns the surface off.
    pub gradient_factor: f64,
    /// Planes (n, w) in world space: what lies at n·x + w < 0 of one is left out, for light and view
    /// alike. n need not have length 1.
    pub clip_planes: Vec<DVec4>,
    /// Light from all around.
    pub environment: Environment,
    /// The view.
    pub camera: Camera,
    /// How paths are made.
    pub integrator: Integrator,
}

/// An environment map as it stands in the scene.
#[derive(Clone, Debug)]
pub struct Environment {
    /// The radiance map, in its own frame.
    pub map: EnvironmentMap,
    /// Turn about +y, radians, counter-clockwise seen from above.
    pub rotation_y: f64,
    /// Factor on the map's radiance, ≥ 0.
    pub scale: f64,
}

impl Environment {
    /// Direction of the map's own frame from one of the world.
    pub fn map_from_world(&self, direction: DVec3) -> DVec3 {
        let (sin, cos) = self.rotation_y.sin_cos();
        let DVec3 { x, y, z } = direction;
        DVec3::new(cos * x - sin * z, y, sin * x + cos * z)
    }

    /// Scaled radiance from a world direction, in f64.
    pub fn radiance(&self, direction: DVec3) -> [f64; 3] {
        self.map
            .radiance(self.map_from_world(direction))
            .map(|c| c * self.scale)
    }
}

/// How paths are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Integrator {
    /// Paths have at most this many scatterings; `None` is unlimited.
    pub max_scatters: Option<u32>,
}

impl Default for Integrator {
    fn default() -> Self {
        Self {
            max_scatters: Some(1),
        }
    }
}

impl Scene {
    /// s of a value in data units.
    pub fn s_from_value(&self, value: f64) -> f64 {
        (value - self.window[0]) / (self.window[1] - self.window[0])
    }

    /// The smallest voxel spacing in world metres: h of the gradient-surface blend.
    pub fn min_spacing(&self) -> f64 {
        let dims = self.volume.dims();
        (0..3)
            .map(|axis| {
                self.world_from_unit_cube.col(axis).truncate().length() / f64::from(dims[axis])
            })
            .fold(f64::INFINITY, f64::min)
    }
}
