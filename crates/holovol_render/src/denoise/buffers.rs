//! What a denoiser keeps on the device.

use wgpu::BufferUsages as Usage;

use super::uniforms::DenoiseUniform;
use super::{COUNTS, KEYS, LIGHTS, STATE, TILE, TILES};
use crate::{Gpu, RenderError};

pub(super) struct Buffers {
    /// Of the last frame's images.
    pub(super) sizes: Vec<[u32; 2]>,
    /// Pixels and tiles that there is room for.
    pub(super) room: [u32; 2],
    pub(super) uniform: wgpu::Buffer,
    pub(super) state: wgpu::Buffer,
    pub(super) lights: wgpu::Buffer,
    pub(super) keys: wgpu::Buffer,
    pub(super) counts: wgpu::Buffer,
    pub(super) tiles: wgpu::Buffer,
    pub(super) output: wgpu::Buffer,
}

impl Buffers {
    /// Makes room for images of `sizes`, and for all that the tracer has `rooms` for.
    pub(super) fn new(
        gpu: &Gpu,
        sizes: &[[u32; 2]],
        rooms: &[[u32; 2]],
    ) -> Result<Self, RenderError> {
        let limits = gpu.device.limits();
        let limit = limits
            .max_storage_buffer_binding_size
            .min(limits.max_buffer_size);
        let is_too_much = |sizes| 16 * STATE.max(LIGHTS).max(KEYS) * count(sizes, 1) > limit;
        // Of rooms that are too large the part that is used now.
        let rooms = if is_too_much(rooms) { sizes } else { rooms };
        let [pixels, tiles] = [1, TILE].map(|side| count(sizes, side).max(count(rooms, side)));
        let bytes = pixels * (16 * (STATE + LIGHTS + KEYS + 1) + 8 * COUNTS) + 16 * TILES * tiles;
        if is_too_much(sizes) {
            return Err(RenderError::OutOfMemory {
                what: "denoising".into(),
                bytes,
            });
        }
        gpu.scoped("denoising", bytes, || {
            let usage = Usage::STORAGE | Usage::COPY_SRC;
            Self {
                sizes: sizes.to_vec(),
                room: [pixels as u32, tiles as u32],
                uniform: gpu.empty(
                    "holovol denoise",
                    size_of::<DenoiseUniform>() as u64,
                    Usage::UNIFORM | Usage::COPY_DST,
                ),
                state: gpu.empty("holovol denoise state", 16 * STATE * pixels, usage),
                lights: gpu.empty("holovol denoise lights", 16 * LIGHTS * pixels, usage),
                keys: gpu.empty("holovol denoise keys", 16 * KEYS * pixels, usage),
                counts: gpu.empty("holovol denoise counts", 8 * COUNTS * pixels, usage),
                tiles: gpu.empty("holovol denoise tiles", 16 * TILES * tiles, usage),
                output: gpu.empty("holovol denoised", 16 * pixels, usage),
            }
        })
    }

    /// Whether there is room for such images, and not far too much.
    pub(super) fn fits(&self, sizes: &[[u32; 2]], rooms: &[[u32; 2]]) -> bool {
        let [pixels, tiles] = self.room.map(u64::from);
        let needed = count(sizes, 1).max(count(rooms, 1));
        count(sizes, 1) <= pixels && count(sizes, TILE) <= tiles && pixels <= 2 * needed
    }

    /// Of the last frame's images.
    pub(super) fn pixels(&self) -> usize {
        count(&self.sizes, 1) as usize
    }
}

/// Squares of so many pixels a side in images of these sizes.
fn count(sizes: &[[u32; 2]], side: u32) -> u64 {
    let of = |[width, height]: &[u32; 2]| {
        u64::from(width.div_ceil(side)) * u64::from(height.div_ceil(side))
    };
    sizes.iter().map(of).sum()
}
