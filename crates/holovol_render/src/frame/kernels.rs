//! Compiled variants of the tracer.

use crate::shader::ShaderDefs;
use crate::trace::{TRACE, layout};
use crate::variants::Variants;
use crate::{Gpu, Interpolation, RenderError};

/// What one variant of the tracer consists of.
#[derive(Clone)]
pub(crate) struct FrameKernels {
    pub(crate) trace: wgpu::ComputePipeline,
    pub(crate) resume: wgpu::ComputePipeline,
}

/// What decides a variant, its layout included.
#[derive(Clone, PartialEq, Eq, Hash)]
struct Key {
    defs: ShaderDefs,
    filtered: bool,
    slices: bool,
}

/// The tracer's compiled variants on one device; all volumes share them.
///
/// Asking for one never waits: it is compiled on a worker, and until then another serves.
pub struct Kernels(Variants<Key, FrameKernels>);

impl Kernels {
    /// Starts the worker; it ends with this.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn new(gpu: &Gpu) -> Result<Self, RenderError> {
        let gpu = gpu.clone();
        Variants::new("holovol kernels", move |key| compile(&gpu, key)).map(Self)
    }

    /// A variant if it is there; else it will be compiled.
    pub(crate) fn get(
        &self,
        defs: &ShaderDefs,
        interpolation: Interpolation,
        slices: bool,
    ) -> Result<Option<FrameKernels>, RenderError> {
        self.0.get(&Key {
            defs: defs.clone(),
            filtered: interpolation == Interpolation::Hardware,
            slices,
        })
    }

    /// Waits until all variants that were asked for are compiled: for tests and servers.
    pub fn wait(&self) {
        self.0.wait();
    }
}

fn compile(gpu: &Gpu, key: &Key) -> Result<FrameKernels, RenderError> {
    let interpolation = if key.filtered {
        Interpolation::Hardware
    } else {
        Interpolation::Exact
    };
    let layout = layout(gpu, interpolation, key.slices)?;
    Ok(FrameKernels {
        trace: gpu.pipeline(&TRACE, &key.defs, "trace", &layout)?,
        resume: gpu.pipeline(&TRACE, &key.defs, "resume", &layout)?,
    })
}
