//! Composing kernels from WGSL files, specialised by shader definitions.

use std::borrow::Cow;
use std::collections::HashMap;

use naga::valid::Capabilities;
use naga_oil::compose::{
    ComposableModuleDescriptor, Composer, NagaModuleDescriptor, ShaderDefValue, ShaderType,
};

use crate::{Gpu, RenderError};

/// Values that specialise a kernel; `u32` for all: 0 and 1 are false and true.
pub(crate) type ShaderDefs = Vec<(&'static str, u32)>;

/// A WGSL file, by path relative to `src/`.
pub(crate) struct ShaderFile {
    pub path: &'static str,
    pub source: &'static str,
}

macro_rules! shader_file {
    ($path:literal) => {
        $crate::shader::ShaderFile {
            path: $path,
            source: include_str!($path),
        }
    };
}
pub(crate) use shader_file;

/// Files that kernels import, each after those that it imports itself.
pub(crate) const SHARED: &[ShaderFile] = &[
    shader_file!("shared/random.wgsl"),
    shader_file!("shared/bindings.wgsl"),
    shader_file!("shared/field.wgsl"),
    shader_file!("shared/transfer_function.wgsl"),
    shader_file!("shared/phase_function.wgsl"),
    shader_file!("shared/surface.wgsl"),
    shader_file!("shared/environment.wgsl"),
    shader_file!("shared/walk.wgsl"),
    shader_file!("shared/scattering.wgsl"),
    shader_file!("light_grid/cells.wgsl"),
    shader_file!("light_grid/insert.wgsl"),
    shader_file!("light_grid/lookup.wgsl"),
    crate::trace::PATH,
    shader_file!("denoise/common.wgsl"),
    shader_file!("denoise/holovol/between.wgsl"),
];

#[cfg(any(test, feature = "testing"))]
use crate::testing::source;

#[cfg(not(any(test, feature = "testing")))]
fn source(file: &ShaderFile) -> Cow<'static, str> {
    Cow::Borrowed(file.source)
}

#[cfg(test)]
pub(crate) mod tests;

/// Composes a kernel with what it imports and validates it; needs no GPU.
pub(crate) fn compose(file: &ShaderFile, defs: &ShaderDefs) -> Result<naga::Module, RenderError> {
    let failed = |reason: String| RenderError::Internal {
        what: file.path.into(),
        reason,
    };
    let defs: HashMap<String, ShaderDefValue> = defs
        .iter()
        .map(|&(name, value)| (name.to_owned(), ShaderDefValue::UInt(value)))
        .collect();
    let mut composer = Composer::default().with_capabilities(
        Capabilities::SUBGROUP
            | Capabilities::TEXTURE_AND_SAMPLER_BINDING_ARRAY
            | Capabilities::SHADER_FLOAT16_IN_FLOAT32,
    );
    for shared in SHARED {
        let added = composer.add_composable_module(ComposableModuleDescriptor {
            source: &source(shared),
            file_path: shared.path,
            shader_defs: defs.clone(),
            ..Default::default()
        });
        if let Err(error) = added {
            return Err(failed(error.emit_to_string(&composer)));
        }
    }
    composer
        .make_naga_module(NagaModuleDescriptor {
            source: &source(file),
            file_path: file.path,
            shader_type: ShaderType::Wgsl,
            shader_defs: defs,
            ..Default::default()
        })
        .map_err(|error| failed(error.emit_to_string(&composer)))
}

impl Gpu {
    /// Compiles a composed kernel.
    #[expect(
        unsafe_code,
        reason = "graphics interop: the kernels prove their own bounds and loop ends, as Bevy's do"
    )]
    pub(crate) fn pipeline(
        &self,
        file: &ShaderFile,
        defs: &ShaderDefs,
        entry_point: &str,
        layout: &wgpu::BindGroupLayout,
    ) -> Result<wgpu::ComputePipeline, RenderError> {
        let module = compose(file, defs)?;
        self.scoped(file.path, 0, || {
            // SAFETY: every index is clamped or masked by the kernel itself and every loop ends
            // after a bounded number of rounds (see trace.wgsl), which the tests run through.
            let module = unsafe {
                self.device.create_shader_module_trusted(
                    wgpu::ShaderModuleDescriptor {
                        label: Some(file.path),
                        source: wgpu::ShaderSource::Naga(Cow::Owned(module)),
                    },
                    wgpu::ShaderRuntimeChecks::unchecked(),
                )
            };
            let layout = self
                .device
                .create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                    label: Some(file.path),
                    bind_group_layouts: &[Some(layout)],
                    immediate_size: 0,
                });
            self.device
                .create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                    label: Some(file.path),
                    layout: Some(&layout),
                    module: &module,
                    entry_point: Some(entry_point),
                    compilation_options: wgpu::PipelineCompilationOptions {
                        zero_initialize_workgroup_memory: false,
                        ..Default::default()
                    },
                    cache: None,
                })
        })
    }
}
