use bytemuck::{Pod, Zeroable};
use glam::{DMat3, DMat4, DVec3};
use holovol_light::EnvironmentSampler;
use holovol_scene::Scene;
use holovol_volume::TransferFunction;

use crate::GpuVolume;

/// `Scene` of bindings.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(crate) struct SceneUniform {
    pub ray_origin: [f32; 4],
    pub ray_origin_dx: [f32; 4],
    pub ray_origin_dy: [f32; 4],
    pub ray_texel: [f32; 4],
    pub ray_texel_dx: [f32; 4],
    pub ray_texel_dy: [f32; 4],
    pub ray_world: [f32; 4],
    pub ray_world_dx: [f32; 4],
    pub ray_world_dy: [f32; 4],
    pub forward: [f32; 4],
    pub texel_from_world_x: [f32; 4],
    pub texel_from_world_y: [f32; 4],
    pub texel_from_world_z: [f32; 4],
    pub dims: [u32; 4],
    pub extent: [f32; 4],
    pub cells: [u32; 4],
    pub field: [f32; 4],
    pub environment: [f32; 4],
    pub environment_size: [f32; 4],
    pub transfer_density: [[f32; 4]; UNROLLED_POINTS],
}

/// Transfer functions of more points are searched instead of unrolled.
pub(crate) const UNROLLED_POINTS: usize = 16;

/// `Dispatch` of bindings.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(crate) struct DispatchUniform {
    pub tile_origin: [u32; 2],
    pub tile_size: [u32; 2],
    pub image_size: [u32; 2],
    pub sample_start: u32,
    pub sample_end: u32,
    pub seed: u32,
    pub budget: u32,
    pub resumed_paths: u32,
    pub queue_capacity: u32,
}

/// `TransferPoint` of bindings.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(crate) struct GpuTransferPoint {
    pub density: [f32; 4],
    pub albedo: [f32; 4],
    pub emission: [f32; 4],
}

fn vec4(v: DVec3, w: f64) -> [f32; 4] {
    [v.x as f32, v.y as f32, v.z as f32, w as f32]
}

impl SceneUniform {
    /// Composes everything in f64, so that f32 kernels lose nothing far from the origin.
    pub fn new(
        scene: &Scene,
        volume: &GpuVolume,
        cells: [u32; 3],
        sampler: Option<&EnvironmentSampler>,
    ) -> Self {
        let extent = DVec3::from_array(volume.extent(scene.volume.dims()));
        let texel_from_world = DMat4::from_scale(extent) * scene.world_from_unit_cube.inverse();
        let rotation = DMat3::from_mat4(texel_from_world);
        let world = scene.camera.pixel_rays(DMat4::IDENTITY);
        let texel = scene.camera.pixel_rays(texel_from_world);
        let depth = near_depth(scene);
        let at_depth = |direction: DVec3| depth * direction;
        let points = scene.transfer_function.points().len() as u32;
        let [x, y, z] = volume.texels();
        let s_from_texel = volume.s_from_texel(&scene.volume, scene.window);
        let mut transfer_density = [[0.0; 4]; UNROLLED_POINTS];
        for (density, point) in transfer_density
            .iter_mut()
            .zip(transfer_points(&scene.transfer_function))
        {
            *density = point.density;
        }
        let environment = &scene.environment;
        let (sin, cos) = environment.rotation_y.sin_cos();
        let environment_size = match environment.map.as_constant() {
            Some(radiance) => {
                let [r, g, b] = radiance.map(|c| (f64::from(c) * environment.scale) as f32);
                [r, g, b, 0.0]
            }
            None => {
                let map = &environment.map;
                let normalisation = sampler.map_or(0.0, EnvironmentSampler::normalisation);
                [
                    map.width() as f32,
                    map.height() as f32,
                    normalisation as f32,
                    0.0,
                ]
            }
        };
        Self {
            ray_origin: vec4(texel.origin + at_depth(texel.direction), 0.0),
            ray_origin_dx: vec4(at_depth(texel.direction_dx), 0.0),
            ray_origin_dy: vec4(at_depth(texel.direction_dy), 0.0),
            ray_texel: vec4(texel.direction, 0.0),
            ray_texel_dx: vec4(texel.direction_dx, 0.0),
            ray_texel_dy: vec4(texel.direction_dy, 0.0),
            ray_world: vec4(world.direction, 0.0),
            ray_world_dx: vec4(world.direction_dx, 0.0),
            ray_world_dy: vec4(world.direction_dy, 0.0),
            forward: vec4(scene.camera.axes()[2], depth),
            texel_from_world_x: vec4(rotation.row(0), 0.0),
            texel_from_world_y: vec4(rotation.row(1), 0.0),
            texel_from_world_z: vec4(rotation.row(2), 0.0),
            dims: [x, y, z, points],
            extent: vec4(extent, 0.0),
            cells: [
                cells[0],
                cells[1],
                cells[2],
                scene.integrator.max_scatters.unwrap_or(u32::MAX),
            ],
            field: [
                s_from_texel[0] as f32,
                s_from_texel[1] as f32,
                scene.phase_g as f32,
                (scene.gradient_factor * scene.min_spacing()) as f32,
            ],
            environment: [cos as f32, sin as f32, environment.scale as f32, 0.0],
            environment_size,
            transfer_density,
        }
    }
}

/// Depth of a plane in front of the camera and before the volume, from which rays may start:
/// near the volume, their texel coordinates are small numbers, which f32 keeps well.
fn near_depth(scene: &Scene) -> f64 {
    let camera = &scene.camera;
    let [_, _, forward] = camera.axes();
    let nearest = (0..8u32)
        .map(|corner| {
            let unit = DVec3::new(
                f64::from(corner & 1),
                f64::from(corner >> 1 & 1),
                f64::from(corner >> 2 & 1),
            );
            (scene.world_from_unit_cube.transform_point3(unit) - camera.eye).dot(forward)
        })
        .fold(f64::INFINITY, f64::min);
    nearest.max(0.0)
}

/// The points as kernels want them; never empty.
pub(crate) fn transfer_points(transfer_function: &TransferFunction) -> Vec<GpuTransferPoint> {
    let points = transfer_function.points();
    let rgbw = |rgb: [f64; 3], w: f64| [rgb[0] as f32, rgb[1] as f32, rgb[2] as f32, w as f32];
    let next = points.iter().skip(1).chain(points.last());
    points
        .iter()
        .zip(next)
        .map(|(point, next)| {
            let distance = next.s as f32 - point.s as f32;
            let inverse = if distance > 0.0 {
                (1.0 / distance).min(f32::MAX)
            } else {
                0.0
            };
            let change = (next.sigma_t - point.sigma_t) as f32;
            GpuTransferPoint {
                density: [point.s as f32, point.sigma_t as f32, change, inverse],
                albedo: rgbw(point.albedo, point.roughness),
                emission: rgbw(point.emission, point.specular),
            }
        })
        .collect()
}

/// What kernels hash of a seed. Seeds below 2³² stay distinct; above, no pattern makes two alike.
pub(crate) fn kernel_seed(seed: u64) -> u32 {
    // The finaliser of MurmurHash3 (Appleby 2011), which keeps 0.
    let mut high = (seed >> 32) as u32;
    high = (high ^ high >> 16).wrapping_mul(0x85eb_ca6b);
    high = (high ^ high >> 13).wrapping_mul(0xc2b2_ae35);
    seed as u32 ^ high ^ high >> 16
}
