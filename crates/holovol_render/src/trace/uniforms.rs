use bytemuck::{Pod, Zeroable};
use glam::{DMat3, DMat4, DVec3, DVec4};
use holovol_volume::TransferFunction;

use super::environment::GpuEnvironment;
use super::{Medium, View};
use crate::GpuVolume;

/// `Scene` of bindings.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(crate) struct SceneUniform {
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
    pub clip: [[f32; 4]; Medium::MAX_CLIP_PLANES],
}

/// Views that one dispatch can trace.
pub const MAX_VIEWS: usize = 8;

/// `View` of bindings.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(crate) struct ViewUniform {
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
    /// Width, height, first pixel in the accumulators, seed.
    pub image: [u32; 4],
    /// First sample, one past the last; of an image of few samples a power of two that holds them,
    /// else 0; unused.
    pub samples: [u32; 4],
    /// Width, height, first layer, layers.
    pub mesh_depth: [u32; 4],
}

/// Transfer functions of more points are searched instead of unrolled.
pub(crate) const UNROLLED_POINTS: usize = 16;

/// `Dispatch` of bindings.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(crate) struct DispatchUniform {
    pub tile_origin: [u32; 2],
    pub tile_size: [u32; 2],
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

/// Texel coordinates from world metres.
fn texel_from_world(medium: &Medium, volume: &GpuVolume) -> DMat4 {
    let extent = DVec3::from_array(volume.extent());
    DMat4::from_scale(extent) * medium.world_from_unit_cube.inverse()
}

impl SceneUniform {
    /// Composes everything in f64, so that f32 kernels lose nothing far from the origin.
    pub fn new(
        medium: &Medium,
        volume: &GpuVolume,
        cells: [u32; 3],
        environment: &GpuEnvironment,
    ) -> Self {
        let texel_from_world = texel_from_world(medium, volume);
        let rotation = DMat3::from_mat4(texel_from_world);
        let points = medium.transfer_function.points().len() as u32;
        let [x, y, z] = volume.texels();
        let s_from_texel = volume.s_from_texel(medium.window);
        let mut transfer_density = [[0.0; 4]; UNROLLED_POINTS];
        for (density, point) in transfer_density
            .iter_mut()
            .zip(transfer_points(&medium.transfer_function))
        {
            *density = point.density;
        }
        // A plane meets n·x + w with x = M·texel: its row vector times M.
        let world_from_texel = texel_from_world.inverse();
        // A plane at infinity leaves everything.
        let mut clip = [[0.0, 0.0, 0.0, 1.0]; Medium::MAX_CLIP_PLANES];
        for (clip, plane) in clip.iter_mut().zip(&medium.clip_planes) {
            let length = plane.truncate().length();
            let plane: DVec4 = world_from_texel.transpose() * (*plane / length);
            *clip = vec4(plane.truncate(), plane.w);
        }
        let (sin, cos) = medium.environment_rotation_y.sin_cos();
        let scale = medium.environment_scale;
        let mean = environment.mean_radiance() * scale;
        let per_mean = if mean > 0.0 {
            (1.0 / mean).clamp(1e-30, 1e30) as f32
        } else {
            0.0
        };
        let max_scatters = medium.max_scatters.unwrap_or(u32::MAX);
        Self {
            texel_from_world_x: vec4(rotation.row(0), 0.0),
            texel_from_world_y: vec4(rotation.row(1), 0.0),
            texel_from_world_z: vec4(rotation.row(2), 0.0),
            dims: [x, y, z, points],
            extent: vec4(DVec3::from_array(volume.extent()), 0.0),
            cells: [cells[0], cells[1], cells[2], max_scatters],
            field: [
                s_from_texel[0] as f32,
                s_from_texel[1] as f32,
                medium.phase_g as f32,
                (medium.gradient_factor * medium.min_spacing(volume.dims())) as f32,
            ],
            environment: [cos as f32, sin as f32, scale as f32, per_mean],
            environment_size: environment.size_or_radiance(scale),
            transfer_density,
            clip,
        }
    }
}

impl ViewUniform {
    /// A view of a volume; pixels, samples and mesh depth are left to the caller.
    pub fn new(view: &View, medium: &Medium, volume: &GpuVolume) -> Self {
        let texel_from_world = texel_from_world(medium, volume);
        let depth = near_depth(view, medium);
        let texel_point = |v| texel_from_world.transform_point3(v);
        let texel = |v| texel_from_world.transform_vector3(v);
        let at_depth =
            |origin: DVec3, direction: DVec3| vec4(texel(origin + depth * direction), 0.0);
        Self {
            ray_origin: vec4(texel_point(view.origin + depth * view.direction), 0.0),
            ray_origin_dx: at_depth(view.origin_dx, view.direction_dx),
            ray_origin_dy: at_depth(view.origin_dy, view.direction_dy),
            ray_texel: vec4(texel(view.direction), 0.0),
            ray_texel_dx: vec4(texel(view.direction_dx), 0.0),
            ray_texel_dy: vec4(texel(view.direction_dy), 0.0),
            ray_world: vec4(view.direction, 0.0),
            ray_world_dx: vec4(view.direction_dx, 0.0),
            ray_world_dy: vec4(view.direction_dy, 0.0),
            forward: vec4(view.forward, depth),
            image: [view.size[0], view.size[1], 0, 0],
            samples: [0; 4],
            mesh_depth: [0; 4],
        }
    }
}

/// Depth of a plane in front of the camera and before the volume, from which rays may start:
/// near the volume, their texel coordinates are small numbers, which f32 keeps well.
fn near_depth(view: &View, medium: &Medium) -> f64 {
    let depth = |corner: DVec3| (corner - view.origin).dot(view.forward);
    let nearest = medium
        .corners()
        .map(depth)
        .into_iter()
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
