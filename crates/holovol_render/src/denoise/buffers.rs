//! What a denoiser keeps on the device.

use wgpu::BufferUsages as Usage;

use super::uniforms::DenoiseUniform;
use super::{COUNTS, KEYS, STATE, TILE, TILES};
use crate::{Gpu, RenderError};

pub(super) struct Buffers {
    pub(super) sizes: Vec<[u32; 2]>,
    pub(super) uniform: wgpu::Buffer,
    pub(super) state: wgpu::Buffer,
    pub(super) keys: wgpu::Buffer,
    pub(super) counts: wgpu::Buffer,
    pub(super) tiles: wgpu::Buffer,
    pub(super) output: wgpu::Buffer,
}

impl Buffers {
    pub(super) fn new(gpu: &Gpu, sizes: &[[u32; 2]]) -> Result<Self, RenderError> {
        let count = |side: u32| {
            let of = |[width, height]: &[u32; 2]| {
                u64::from(width.div_ceil(side)) * u64::from(height.div_ceil(side))
            };
            sizes.iter().map(of).sum::<u64>()
        };
        let (pixels, tiles) = (count(1), count(TILE));
        let bytes = pixels * (16 * (STATE + KEYS + 1) + 8 * COUNTS) + 16 * TILES * tiles;
        let limits = gpu.device.limits();
        let limit = limits
            .max_storage_buffer_binding_size
            .min(limits.max_buffer_size);
        if 16 * STATE * pixels > limit {
            return Err(RenderError::OutOfMemory {
                what: "denoising".into(),
                bytes,
            });
        }
        gpu.scoped("denoising", bytes, || {
            let usage = Usage::STORAGE | Usage::COPY_SRC;
            Self {
                sizes: sizes.to_vec(),
                uniform: gpu.empty(
                    "holovol denoise",
                    size_of::<DenoiseUniform>() as u64,
                    Usage::UNIFORM | Usage::COPY_DST,
                ),
                state: gpu.empty("holovol denoise state", 16 * STATE * pixels, usage),
                keys: gpu.empty("holovol denoise keys", 16 * KEYS * pixels, usage),
                counts: gpu.empty("holovol denoise counts", 8 * COUNTS * pixels, usage),
                tiles: gpu.empty("holovol denoise tiles", 16 * TILES * tiles, usage),
                output: gpu.empty("holovol denoised", 16 * pixels, usage),
            }
        })
    }
}
