//! The passes that follow the guides, in both modes.

use super::{FADE_FRAMES, TILE, workgroups};
use crate::layout::{storage, uniform};
use crate::light_grid::SettleKernel;
use crate::shader::{ShaderDefs, ShaderFile, shader_file};
use crate::{Gpu, RenderError};

pub(crate) const HOLOVOL: ShaderFile = shader_file!("holovol/holovol.wgsl");
pub(crate) const PAPER: ShaderFile = shader_file!("paper/paper.wgsl");

/// Compiled passes of a mode, in their order.
pub(super) struct Passes {
    layout: wgpu::BindGroupLayout,
    pipelines: Vec<(&'static str, wgpu::ComputePipeline)>,
    pub(super) settle: Option<SettleKernel>,
}

pub(crate) fn pass_defs(radius: u32) -> ShaderDefs {
    vec![("RADIUS", radius), ("FADE_FRAMES", FADE_FRAMES)]
}

impl Passes {
    /// The entry points of the paper's mode or ours.
    pub(super) fn entries(paper: bool) -> &'static [&'static str] {
        if paper {
            return &["near", "first_step", "second_step"];
        }
        &[
            "reproject",
            "add_rows",
            "judge",
            "blend",
            "stereo",
            "prefilter",
            "gather",
        ]
    }

    /// Compiles all passes of a mode, or `only` one.
    pub(super) fn new(
        gpu: &Gpu,
        paper: bool,
        radius: u32,
        only: Option<&'static str>,
    ) -> Result<Self, RenderError> {
        let types = [uniform()].into_iter().chain([storage(false); 4]).chain([
            storage(true),
            storage(false),
            storage(false),
        ]);
        let types: Vec<_> = (16..).zip(types).collect();
        let layout = gpu.numbered_layout("holovol denoise", &types)?;
        let file = if paper { &PAPER } else { &HOLOVOL };
        let defs = pass_defs(radius.min(8));
        let pipelines = Self::entries(paper)
            .iter()
            .filter(|&&entry| only.is_none_or(|only| only == entry))
            .map(|&entry| Ok((entry, gpu.pipeline(file, &defs, entry, &layout)?)))
            .collect::<Result<_, RenderError>>()?;
        let settles = !paper && only.is_none();
        Ok(Self {
            layout,
            pipelines,
            settle: settles.then(|| SettleKernel::new(gpu)).transpose()?,
        })
    }

    /// Records them for eyes of these sizes. Buffers: uniform, state, keys, counts, tiles, samples,
    /// output, lights.
    pub(super) fn record(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        sizes: &[[u32; 2]],
        buffers: [&wgpu::Buffer; 8],
    ) -> Result<(), RenderError> {
        let group = gpu.scoped("denoising", 0, || {
            let resources = (16..).zip(buffers.map(|buffer| buffer.as_entire_binding()));
            gpu.numbered_group("holovol denoise", &self.layout, resources)
        })?;
        let [x, y] = workgroups(sizes);
        let eyes = sizes.len() as u32;
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("holovol denoise"),
            timestamp_writes: None,
        });
        pass.set_bind_group(0, &group, &[]);
        for (name, pipeline) in &self.pipelines {
            pass.set_pipeline(pipeline);
            match *name {
                "reproject" => pass.dispatch_workgroups(x.div_ceil(TILE), y, eyes),
                "judge" => pass.dispatch_workgroups((x * y).div_ceil(64), eyes, 1),
                "add_rows" => pass.dispatch_workgroups((x * y * eyes).div_ceil(64), 1, 1),
                _ => pass.dispatch_workgroups(x, y, eyes),
            }
        }
        Ok(())
    }
}
