//! The light that samples find at places of the volume, gathered over pixels, frames and eyes: a
//! guide for the denoiser (docs/denoising.md).

#[cfg(any(test, feature = "testing"))]
#[doc(hidden)]
pub mod cpu;

use std::sync::atomic::{AtomicU64, Ordering};

use bytemuck::{Pod, Zeroable};
use wgpu::BufferUsages as Usage;

use crate::layout::{storage, uniform};
use crate::shader::{ShaderFile, shader_file};
use crate::{Gpu, RenderError};

pub(crate) const SETTLE: ShaderFile = shader_file!("settle.wgsl");

/// Cells at most: as many as memory and a pass over all of them are cheap for.
const MOST_CELLS: u64 = 1 << 20;
/// Picks that a cell's mean counts for, at most: light may move slowly without anybody telling.
const MOST_PICKS: f32 = 1024.0;
/// Picks of a cell that a frame of history counts for.
const PICKS_OF_FRAME: f32 = 8.0;
const CELL_BYTES: u64 = 8;
const WORKGROUP: u64 = 64;
/// Workgroups in a row: every device takes so many.
const ROW: u64 = 1 << 14;

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct SettleUniform {
    pub(crate) size: [u32; 4],
    pub(crate) kept: f32,
    pub(crate) most: f32,
    padding: [u32; 2],
}

/// Texels along a side of a cell, a power of two, and cells along x, y, z.
fn cells_of(texels: [u32; 3]) -> (u32, [u32; 3]) {
    let cells = |per: u32| texels.map(|n| n.div_ceil(per));
    let fits = |&per: &u32| {
        let cells = cells(per).map(u128::from);
        cells.iter().product::<u128>() <= u128::from(MOST_CELLS)
    };
    let mut sides = (0..32).map(|shift| 1 << shift);
    let per = sides.find(fits).unwrap_or(1 << 31);
    (per, cells(per))
}

fn count(size: [u32; 3]) -> u64 {
    size.iter().map(|&n| u64::from(n)).product()
}

/// What a frame's samples add up, in the tracer.
pub(crate) struct FreshLight {
    pub(crate) texels_per_cell: u32,
    size: [u32; 3],
    /// The present frame's number; 0 before the first.
    frame: u64,
    /// Two words per cell.
    pub(crate) sums: wgpu::Buffer,
}

impl FreshLight {
    /// For a volume of so many texels.
    pub(crate) fn new(gpu: &Gpu, texels: [u32; 3]) -> Result<Self, RenderError> {
        let (texels_per_cell, size) = cells_of(texels);
        let bytes = CELL_BYTES * count(size);
        let usage = Usage::STORAGE | Usage::COPY_DST;
        let sums = gpu.scoped("the light grid", bytes, || {
            gpu.empty("holovol fresh light", bytes, usage)
        })?;
        Ok(Self {
            texels_per_cell,
            size,
            frame: 0,
            sums,
        })
    }

    /// Before a frame's samples.
    pub(crate) fn clear(&mut self, encoder: &mut wgpu::CommandEncoder) {
        // Other tracers' frames are others.
        static FRAMES: AtomicU64 = AtomicU64::new(0);
        self.frame = 1 + FRAMES.fetch_add(1, Ordering::Relaxed);
        encoder.clear_buffer(&self.sums, 0, None);
    }
}

/// Takes frames into grids.
pub(crate) struct SettleKernel {
    layout: wgpu::BindGroupLayout,
    settle: wgpu::ComputePipeline,
    smooth: wgpu::ComputePipeline,
}

impl SettleKernel {
    pub(crate) fn new(gpu: &Gpu) -> Result<Self, RenderError> {
        let types = [uniform(), storage(true), storage(false), storage(false)];
        let layout = gpu.bind_group_layout("holovol light grid", &types)?;
        let pipeline = |entry| gpu.pipeline(&SETTLE, &Vec::new(), entry, &layout);
        Ok(Self {
            settle: pipeline("settle")?,
            smooth: pipeline("smooth_few")?,
            layout,
        })
    }
}

/// What a denoiser has seen of a volume's light.
pub(crate) struct LightGrid {
    size: [u32; 3],
    pub(crate) texels_per_cell: u32,
    /// The frame that was taken in last.
    frame: u64,
    /// Whether one was since it knew nothing.
    pub(crate) is_known: bool,
    /// Per cell mean light, in the environment's mean radiance, and the picks that it is of.
    settled: wgpu::Buffer,
    /// The same, as guides see it.
    pub(crate) smoothed: wgpu::Buffer,
    uniform: wgpu::Buffer,
}

impl LightGrid {
    /// Knows nothing yet.
    pub(crate) fn new(gpu: &Gpu, fresh: &FreshLight) -> Result<Self, RenderError> {
        let bytes = CELL_BYTES * count(fresh.size);
        gpu.scoped("the light grid", 2 * bytes, || {
            let usage = Usage::STORAGE | Usage::COPY_SRC | Usage::COPY_DST;
            let size = size_of::<SettleUniform>() as u64;
            Self {
                size: fresh.size,
                texels_per_cell: fresh.texels_per_cell,
                frame: 0,
                is_known: false,
                settled: gpu.empty("holovol light grid", bytes, usage),
                smoothed: gpu.empty("holovol smoothed light grid", bytes, usage),
                uniform: gpu.empty("holovol settling", size, Usage::UNIFORM | Usage::COPY_DST),
            }
        })
    }

    /// Whether it is of a volume like this one.
    pub(crate) fn fits(&self, fresh: &FreshLight) -> bool {
        self.size == fresh.size
    }

    pub(crate) fn forget(&mut self, encoder: &mut wgpu::CommandEncoder) {
        self.is_known = false;
        encoder.clear_buffer(&self.settled, 0, None);
        encoder.clear_buffer(&self.smoothed, 0, None);
    }

    /// Mean light and picks of all cells, as they are or as guides see them; waits for them.
    pub(crate) fn read(&self, gpu: &Gpu, smoothed: bool) -> Result<Vec<[f32; 2]>, RenderError> {
        let buffer = if smoothed {
            &self.smoothed
        } else {
            &self.settled
        };
        let bytes = gpu.read_buffer("the light grid", buffer, buffer.size())?;
        Ok(bytemuck::pod_collect_to_vec(&bytes))
    }

    /// Takes a frame in, unless it has; what was known before counts for so many frames at most.
    pub(crate) fn record_settling(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        kernel: &SettleKernel,
        fresh: &FreshLight,
        kept_frames: f32,
    ) -> Result<(), RenderError> {
        if self.frame == fresh.frame {
            return Ok(());
        }
        let [x, y, z] = self.size;
        let uniform = SettleUniform {
            size: [x, y, z, count(self.size) as u32],
            kept: (PICKS_OF_FRAME * kept_frames).min(MOST_PICKS),
            most: MOST_PICKS,
            padding: [0; 2],
        };
        let bytes = bytemuck::bytes_of(&uniform);
        gpu.queue.write_buffer(&self.uniform, 0, bytes);
        let group = gpu.scoped("the light grid", 0, || {
            let buffers = [&self.uniform, &fresh.sums, &self.settled, &self.smoothed];
            let resources = buffers.map(|buffer| buffer.as_entire_binding());
            gpu.bind_group("holovol light grid", &kernel.layout, resources)
        })?;
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("holovol light grid"),
            timestamp_writes: None,
        });
        pass.set_bind_group(0, &group, &[]);
        let groups = count(self.size).div_ceil(WORKGROUP);
        let rows = groups.div_ceil(ROW);
        for pipeline in [&kernel.settle, &kernel.smooth] {
            pass.set_pipeline(pipeline);
            pass.dispatch_workgroups(groups.min(ROW) as u32, rows as u32, 1);
        }
        self.frame = fresh.frame;
        self.is_known = true;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_as_small_as_fits() {
        assert_eq!(cells_of([64, 64, 64]), (1, [64; 3]));
        assert_eq!(cells_of([101, 101, 101]), (1, [101; 3]));
        assert_eq!(cells_of([102, 102, 102]), (2, [51; 3]));
        assert_eq!(cells_of([512, 512, 174]), (4, [128, 128, 44]));
        assert_eq!(cells_of([4096, 4096, 4096]), (64, [64; 3]));
        assert_eq!(cells_of([1, 1, u32::MAX]), (1 << 12, [1, 1, 1 << 20]));
    }
}
