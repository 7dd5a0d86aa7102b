//! Twin of `field.wgsl`, with exact interpolation.

use glam::{DMat3, DMat4, DVec3, IVec3, Mat3, Vec3};
use holovol_scene::Scene;
use holovol_volume::{Volume, VoxelKind};
use wgpu::TextureFormat;

/// A scalar field as kernels see it.
#[derive(Clone, Debug)]
pub struct Field {
    texels: Vec<f32>,
    dims: IVec3,
    /// s = (texel − x) · y.
    s_from_texel: [f32; 2],
    /// Rows turn world directions into texels per metre.
    texel_from_world: [Vec3; 3],
}

/// Texels of a volume in the format that holds it, and stored = scale · texel + offset.
pub fn texels(volume: &Volume, format: TextureFormat) -> (Vec<f32>, f64, f64) {
    let (scale, offset) = match (format, volume.voxels().kind()) {
        (TextureFormat::R8Unorm, VoxelKind::I8) => (255.0, -128.0),
        (TextureFormat::R8Unorm, _) => (255.0, 0.0),
        (TextureFormat::R16Unorm, VoxelKind::I16) => (65535.0, -32768.0),
        (TextureFormat::R16Unorm, _) => (65535.0, 0.0),
        _ => (1.0, 0.0),
    };
    let stored = (0..volume.voxels().len()).map(|i| volume.voxels().stored(i));
    let texels = stored.map(|x| ((x - offset) / scale) as f32).collect();
    (texels, scale, offset)
}

impl Field {
    /// The field of a scene whose volume is held in a texture of this format.
    pub fn new(scene: &Scene, format: TextureFormat) -> Self {
        let volume = &scene.volume;
        let (texels, scale, offset) = texels(volume, format);
        let [low, high] = scene.window;
        let stored = (low - volume.intercept()) / volume.slope();
        let dims = DVec3::from_array(volume.dims().map(f64::from));
        let matrix = DMat4::from_scale(dims) * scene.world_from_unit_cube.inverse();
        let rows = DMat3::from_mat4(matrix).transpose();
        Self {
            texels,
            dims: dims.as_ivec3(),
            s_from_texel: [
                ((stored - offset) / scale) as f32,
                (scale * volume.slope() / (high - low)) as f32,
            ],
            texel_from_world: rows
                .to_cols_array_2d()
                .map(|row| DVec3::from(row).as_vec3()),
        }
    }

    fn texel(&self, at: IVec3) -> f32 {
        let at = at.clamp(IVec3::ZERO, self.dims - 1);
        self.texels[(at.x + self.dims.x * (at.y + self.dims.y * at.z)) as usize]
    }

    /// s at a texel coordinate.
    pub fn at(&self, texel: Vec3) -> f32 {
        let corner = texel - 0.5;
        let weight = corner - corner.floor();
        let base = corner.floor().as_ivec3();
        let lerp = |a: f32, b: f32, t: f32| a + (b - a) * t;
        let along_x = |y, z| {
            let low = base + IVec3::new(0, y, z);
            lerp(self.texel(low), self.texel(low + IVec3::X), weight.x)
        };
        let along_y = |z| lerp(along_x(0, z), along_x(1, z), weight.y);
        let value = lerp(along_y(0), along_y(1), weight.z);
        (value - self.s_from_texel[0]) * self.s_from_texel[1]
    }

    /// World-space gradient of s, 1/m.
    pub fn gradient(&self, texel: Vec3) -> Vec3 {
        let difference = |axis: Vec3| 0.5 * (self.at(texel + axis) - self.at(texel - axis));
        let per_texel = Mat3::IDENTITY.to_cols_array_2d().map(Vec3::from);
        let rows = self.texel_from_world.iter().zip(per_texel);
        rows.map(|(&row, axis)| difference(axis) * row).sum()
    }
}
