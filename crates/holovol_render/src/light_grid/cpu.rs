//! Twins of `settle.wgsl` and `lookup.wgsl`.

use glam::{UVec3, Vec3};

use super::{FreshLight, LightGrid, MOST_PICKS, PICKS_OF_FRAME, SettleKernel, cells_of};
use crate::{Gpu, RenderError};

const LIGHT_STEPS: f32 = 128.0;
/// Picks of a frame that a cell takes.
const PICKS_TAKEN: u32 = 65536;
/// Picks that the mean of the 27 cells around counts for.
const AROUND: f32 = 32.0;

/// Texels along a side of a cell of such a volume, and cells along x, y, z.
pub fn cells(texels: [u32; 3]) -> (u32, UVec3) {
    let (per, size) = cells_of(texels);
    (per, UVec3::from_array(size))
}

/// A cell, given as mean light and picks, with this frame's picks and the sum of their light.
pub fn settle([mean, picks]: [f32; 2], [count, sum]: [u32; 2], kept_frames: f32) -> [f32; 2] {
    let known = picks.min((PICKS_OF_FRAME * kept_frames).min(MOST_PICKS));
    if count == 0 {
        return [mean, known];
    }
    let fresh = count.min(PICKS_TAKEN) as f32;
    let all = known + fresh;
    let mean = mean + (sum as f32 / LIGHT_STEPS - fresh * mean) / all;
    [mean.max(0.0), all.min(MOST_PICKS)]
}

/// A cell of the grid as guides see it: of few picks toward the mean of the 27 around.
pub fn smooth(grid: &[[f32; 2]], size: UVec3, cell: UVec3) -> [f32; 2] {
    let at = |cell: UVec3| grid[(cell.x + size.x * (cell.y + size.y * cell.z)) as usize];
    let [own, picks] = at(cell);
    if picks == 0.0 || picks >= MOST_PICKS {
        return [own, picks];
    }
    let mut sum = [0.0; 2];
    for k in 0..27 {
        let there = cell + UVec3::new(k % 3, k / 3 % 3, k / 9);
        if there.cmpge(UVec3::ONE).all() && (there - 1).cmplt(size).all() {
            let [light, picks] = at(there - 1);
            sum[0] += picks * light;
            sum[1] += picks;
        }
    }
    [
        (picks * own + AROUND * sum[0] / sum[1]) / (picks + AROUND),
        picks,
    ]
}

/// Trilinear between the cells that are known, and their weight; in cells from the volume's corner.
pub fn light_at(grid: &[[f32; 2]], size: UVec3, place: Vec3) -> [f32; 2] {
    let p = place - 0.5;
    let (base, f) = (p.floor(), p - p.floor());
    let mut sum = [0.0; 2];
    for k in 0..8 {
        let offset = UVec3::new(k & 1, (k >> 1) & 1, k >> 2);
        let side = |axis: usize| match offset[axis] {
            0 => 1.0 - f[axis],
            _ => f[axis],
        };
        let cell =
            (base.as_ivec3() + offset.as_ivec3()).clamp(glam::IVec3::ZERO, size.as_ivec3() - 1);
        let cell = cell.as_uvec3();
        let [light, picks] = grid[(cell.x + size.x * (cell.y + size.y * cell.z)) as usize];
        if picks > 0.0 {
            let weight = side(0) * side(1) * side(2);
            sum[0] += weight * light;
            sum[1] += weight;
        }
    }
    [sum[0] / sum[1].max(1e-20), sum[1]]
}

/// What the kernels make of a grid and a frame: the grid, and as guides see it.
///
/// # Errors
/// If a kernel doesn't compile or the device is lost.
pub fn settle_on_device(
    gpu: &Gpu,
    texels: [u32; 3],
    grid: &[[f32; 2]],
    fresh: &[[u32; 2]],
    kept_frames: f32,
) -> Result<[Vec<[f32; 2]>; 2], RenderError> {
    let mut sums = FreshLight::new(gpu, texels)?;
    let mut settled = LightGrid::new(gpu, &sums)?;
    sums.frame += 1;
    gpu.queue
        .write_buffer(&sums.sums, 0, bytemuck::cast_slice(fresh));
    gpu.queue
        .write_buffer(&settled.settled, 0, bytemuck::cast_slice(grid));
    let kernel = SettleKernel::new(gpu)?;
    let mut encoder = gpu.device.create_command_encoder(&Default::default());
    settled.record_settling(gpu, &mut encoder, &kernel, &sums, kept_frames)?;
    gpu.queue.submit([encoder.finish()]);
    Ok([settled.read(gpu, false)?, settled.read(gpu, true)?])
}
