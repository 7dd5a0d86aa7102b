use crate::layout::storage;
use crate::shader::{ShaderFile, shader_file};
use crate::trace::{Buffers, GpuCounters, QUEUE_CAPACITY, WORKGROUP_SIZE};
use crate::{Gpu, RenderError};

pub(crate) const RESUME: ShaderFile = shader_file!("resume.wgsl");

/// Sizes, on the device, the dispatches that go on with saved paths.
pub(super) struct Resume {
    layout: wgpu::BindGroupLayout,
    /// Before a dispatch that goes on with saved paths, and before the last such.
    pub(super) pipelines: [wgpu::ComputePipeline; 2],
    pub(super) workgroups: wgpu::Buffer,
    pub(super) bind_group: wgpu::BindGroup,
}

impl Resume {
    pub(super) fn new(gpu: &Gpu, buffers: &Buffers) -> Result<Self, RenderError> {
        let layout = gpu.bind_group_layout("holovol resume", &[storage(false), storage(false)])?;
        let defs = vec![
            ("COUNTERS", (size_of::<GpuCounters>() / 4) as u32),
            ("SAVED_PATHS", GpuCounters::SAVED_PATHS),
            ("RESUMED_PATHS", GpuCounters::RESUMED_PATHS),
            ("UNLIMITED", GpuCounters::UNLIMITED),
            ("QUEUE_CAPACITY", QUEUE_CAPACITY),
            ("WORKGROUP_SIZE", WORKGROUP_SIZE),
        ];
        let pipeline = |entry| gpu.pipeline(&RESUME, &defs, entry, &layout);
        let pipelines = [pipeline("count")?, pipeline("count_last")?];
        let workgroups = gpu.scoped("saved paths", 12, || {
            let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::INDIRECT;
            gpu.empty("holovol resume", 12, usage)
        })?;
        let bind_group = bind_group(gpu, &layout, buffers, &workgroups)?;
        Ok(Self {
            layout,
            pipelines,
            workgroups,
            bind_group,
        })
    }

    /// Takes other buffers; nothing is compiled again.
    pub(super) fn set_buffers(&mut self, gpu: &Gpu, buffers: &Buffers) -> Result<(), RenderError> {
        self.bind_group = bind_group(gpu, &self.layout, buffers, &self.workgroups)?;
        Ok(())
    }
}

fn bind_group(
    gpu: &Gpu,
    layout: &wgpu::BindGroupLayout,
    buffers: &Buffers,
    workgroups: &wgpu::Buffer,
) -> Result<wgpu::BindGroup, RenderError> {
    let resources = [
        buffers.counters.as_entire_binding(),
        workgroups.as_entire_binding(),
    ];
    gpu.scoped("saved paths", 0, || {
        gpu.bind_group("holovol resume", layout, resources)
    })
}
