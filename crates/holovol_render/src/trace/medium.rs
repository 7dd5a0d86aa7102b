use glam::{DMat4, DVec3, DVec4};
use holovol_scene::Scene;
use holovol_volume::{TransferFunction, TransferPoint};

use super::uniforms::UNROLLED_POINTS;

/// Everything of a scene but the voxels, the light's map and the camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Medium {
    /// Values at which s is 0 and 1, data units; may be reversed, not equal.
    pub window: [f64; 2],
    /// World metres from unit-cube coordinates.
    pub world_from_unit_cube: DMat4,
    /// Extinction, albedo, emission and surface over s.
    pub transfer_function: TransferFunction,
    /// Mean cosine g of the Henyey–Greenstein phase function; > 0 scatters forward.
    pub phase_g: f64,
    /// k of the gradient-surface blend; 0 turns the surface off.
    pub gradient_factor: f64,
    /// Paths have at most this many scatterings; `None` is unlimited.
    pub max_scatters: Option<u32>,
    /// Up to [`Medium::MAX_CLIP_PLANES`] planes in world space: what lies at n·x + w < 0 of a
    /// plane (n, w) is left out, for light and view alike. n need not have length 1.
    pub clip_planes: Vec<DVec4>,
    /// Turn of the environment about +y, radians, counter-clockwise seen from above.
    pub environment_rotation_y: f64,
    /// Factor on the environment's radiance, ≥ 0.
    pub environment_scale: f64,
}

impl Medium {
    /// As many planes cut one volume.
    pub const MAX_CLIP_PLANES: usize = holovol_scene::SceneFile::MAX_CLIP_PLANES;

    /// That of a scene.
    pub fn from_scene(scene: &Scene) -> Self {
        Self {
            window: scene.window,
            world_from_unit_cube: scene.world_from_unit_cube,
            transfer_function: scene.transfer_function.clone(),
            phase_g: scene.phase_g,
            gradient_factor: scene.gradient_factor,
            max_scatters: scene.integrator.max_scatters,
            clip_planes: scene.clip_planes.clone(),
            environment_rotation_y: scene.environment.rotation_y,
            environment_scale: scene.environment.scale,
        }
    }

    /// One that uses everything: its kernel renders any other.
    pub(crate) fn general() -> Self {
        let point = TransferPoint {
            s: 0.0,
            sigma_t: 1.0,
            albedo: [1.0; 3],
            emission: [1.0; 3],
            roughness: 1.0,
            specular: 1.0,
        };
        Self {
            window: [0.0, 1.0],
            world_from_unit_cube: DMat4::IDENTITY,
            transfer_function: TransferFunction::new(vec![point; UNROLLED_POINTS + 1])
                .expect("points that are valid"),
            phase_g: 0.5,
            gradient_factor: 1.0,
            max_scatters: None,
            clip_planes: vec![DVec4::W; Self::MAX_CLIP_PLANES],
            environment_rotation_y: 0.0,
            environment_scale: 1.0,
        }
    }

    /// The smallest voxel spacing in world metres: h of the gradient-surface blend.
    pub(crate) fn min_spacing(&self, dims: [u32; 3]) -> f64 {
        (0..3)
            .map(|axis| {
                self.world_from_unit_cube.col(axis).truncate().length() / f64::from(dims[axis])
            })
            .fold(f64::INFINITY, f64::min)
    }

    /// Corners of the unit cube in the world.
    pub fn corners(&self) -> [DVec3; 8] {
        corners(self.world_from_unit_cube)
    }
}

/// Corners of the unit cube in the world.
pub(crate) fn corners(world_from_unit_cube: DMat4) -> [DVec3; 8] {
    std::array::from_fn(|corner| {
        let bit = |i: usize| (corner >> i & 1) as f64;
        world_from_unit_cube.transform_point3(DVec3::new(bit(0), bit(1), bit(2)))
    })
}
