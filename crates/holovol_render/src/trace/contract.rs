//! Runs single functions of the tracer's kernel, under a scene's own bindings and definitions.

use bytemuck::Zeroable;
use holovol_scene::Scene;

use super::uniforms::DispatchUniform;
use super::{TraceOptions, Tracer, WORKGROUP_SIZE};
use crate::shader::{ShaderFile, shader_file};
use crate::{Gpu, RenderError};

/// Four vectors, in or out of one lane.
pub type Lane = [[f32; 4]; 4];

pub(crate) const CONTRACT: ShaderFile = shader_file!("contract.wgsl");

/// A tracer whose buffers carry the inputs and outputs of single functions.
pub struct Contract {
    gpu: Gpu,
    tracer: Tracer,
    lanes: u32,
}

impl Contract {
    /// Prepares up to `lanes` calls at once on the bindings of a scene.
    ///
    /// # Errors
    /// As [`Tracer::new`].
    pub fn new(
        gpu: &Gpu,
        scene: &Scene,
        options: &TraceOptions,
        lanes: u32,
    ) -> Result<Self, RenderError> {
        let mut scene = scene.clone();
        // Two accumulators and three guides per pixel make room for four vectors a lane.
        scene.camera.width = 2 * lanes;
        scene.camera.height = 1;
        let options = TraceOptions {
            guides: true,
            ..options.clone()
        };
        Ok(Self {
            gpu: gpu.clone(),
            tracer: Tracer::new(gpu, &scene, &options)?,
            lanes,
        })
    }

    /// The tracer.
    pub fn tracer(&self) -> &Tracer {
        &self.tracer
    }

    /// Calls an entry point of `contract.wgsl` once for each input.
    ///
    /// # Errors
    /// If the kernel doesn't compile or the device is lost.
    ///
    /// # Panics
    /// If there are more inputs than lanes.
    pub fn call(&mut self, entry: &str, inputs: &[Lane]) -> Result<Vec<Lane>, RenderError> {
        assert!(inputs.len() <= self.lanes as usize, "a lane for each input");
        let tracer = &mut self.tracer;
        let defs = tracer.defs.clone();
        let layout = &tracer.layout;
        let pipeline = self.gpu.pipeline(&CONTRACT, &defs, entry, layout)?;
        let contents = bytemuck::cast_slice(inputs);
        self.gpu
            .queue
            .write_buffer(&tracer.resources.accumulators, 0, contents);
        let uniform = DispatchUniform {
            budget: inputs.len() as u32,
            ..DispatchUniform::zeroed()
        };
        let groups = (inputs.len() as u32).div_ceil(WORKGROUP_SIZE);
        tracer.submit(&uniform, &pipeline, (0, 0), [groups, 1])?;
        let bytes = self.gpu.read_buffer(
            "outputs",
            &tracer.resources.guides,
            size_of_val(inputs) as u64,
        )?;
        Ok(bytemuck::pod_collect_to_vec(&bytes))
    }
}
