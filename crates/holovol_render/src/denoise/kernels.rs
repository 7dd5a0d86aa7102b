//! What is compiled for denoisers, on a thread of its own.

use std::sync::Arc;

use wgpu::BindingResource as Resource;

use super::passes::Passes;
use super::{DenoiseSettings, GUIDES, pass_defs};
use crate::frame::Matter;
use crate::layout::{majorants, storage, texture_2d_array, texture_3d, uniform};
use crate::shader::ShaderDefs;
use crate::trace::{Surroundings, shader_defs};
use crate::variants::Variants;
use crate::{Gpu, Interpolation, Medium, RenderError};

/// Definitions that change the march; others would compile it again for nothing.
const USED: &[&str] = &[
    "CELL_SIZE",
    "TRANSFER_POINTS",
    "UNROLLED_POINTS",
    "HARDWARE_INTERPOLATION",
    "SLICES",
    "SURFACE",
    "MESH_DEPTH",
    "LIGHT_GRID",
    "CLIP_PLANES",
    "CLIP_PLANES_MAX",
    "VIEWS_MAX",
];

/// What files that the march imports ask for and it doesn't use.
const UNUSED: [(&str, u32); 2] = [("SAVED_PATH_VECTORS", 16), ("STATISTICS", 0)];

#[derive(Clone, PartialEq, Eq, Hash)]
enum Key {
    Passes {
        paper: bool,
        radius: u32,
    },
    Guides {
        defs: ShaderDefs,
        filtered: bool,
        slices: bool,
    },
}

#[derive(Clone)]
enum Compiled {
    Passes(Arc<Passes>),
    Guides(GuideKernel),
}

/// The march for guides, as a volume needs it.
#[derive(Clone)]
pub(super) struct GuideKernel {
    layout: wgpu::BindGroupLayout,
    pipeline: wgpu::ComputePipeline,
}

/// What is compiled for denoisers on one device; all share it, whatever their mode.
///
/// Nothing is compiled before a [`Denoiser`](super::Denoiser) asks for it, and asking never waits.
pub struct DenoiseKernels {
    gpu: Gpu,
    variants: Variants<Key, Compiled>,
}

impl DenoiseKernels {
    /// Starts the worker; it ends with this.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn new(gpu: &Gpu) -> Result<Self, RenderError> {
        let device = gpu.clone();
        let compile = move |key: &Key| match key {
            &Key::Passes { paper, radius } => {
                let passes = Passes::new(&device, paper, radius, None)?;
                Ok(Compiled::Passes(Arc::new(passes)))
            }
            Key::Guides {
                defs,
                filtered,
                slices,
            } => GuideKernel::new(&device, defs, *filtered, *slices).map(Compiled::Guides),
        };
        Ok(Self {
            gpu: gpu.clone(),
            variants: Variants::new("holovol denoiser kernels", compile)?,
        })
    }

    /// Waits until all that was asked for is compiled.
    pub fn wait(&self) {
        self.variants.wait();
    }

    /// The passes of a mode, once they are compiled.
    pub(super) fn passes(
        &self,
        settings: &DenoiseSettings,
    ) -> Result<Option<Arc<Passes>>, RenderError> {
        let key = Key::Passes {
            paper: settings.is_paper(),
            radius: settings.pass_radius(),
        };
        Ok(match self.variants.get(&key)? {
            Some(Compiled::Passes(passes)) => Some(passes),
            _ => None,
        })
    }

    /// The march for this volume, once it is compiled; with `general` one that fits any medium.
    pub(super) fn guides(
        &self,
        medium: &Medium,
        matter: &Matter<'_>,
        general: bool,
    ) -> Result<Option<GuideKernel>, RenderError> {
        let other = general.then(Medium::general);
        let surroundings = Surroundings {
            mesh_depth: general || matter.surroundings.mesh_depth,
            // What serves for a while does without.
            light_grid: !general && matter.surroundings.light_grid,
            ..matter.surroundings
        };
        let medium = other.as_ref().unwrap_or(medium);
        let mut defs = shader_defs(&self.gpu, medium, matter.options, surroundings);
        defs.retain(|(name, _)| USED.contains(name));
        let key = Key::Guides {
            defs,
            filtered: matter.options.interpolation == Interpolation::Hardware,
            slices: matter.volume.slices,
        };
        Ok(match self.variants.get(&key)? {
            Some(Compiled::Guides(kernel)) => Some(kernel),
            _ => None,
        })
    }
}

impl GuideKernel {
    fn new(
        gpu: &Gpu,
        defs: &ShaderDefs,
        filtered: bool,
        slices: bool,
    ) -> Result<Self, RenderError> {
        let sampler = if filtered {
            wgpu::SamplerBindingType::Filtering
        } else {
            wgpu::SamplerBindingType::NonFiltering
        };
        let field = if slices {
            texture_2d_array(false)
        } else {
            texture_3d(filtered)
        };
        let layout = gpu.numbered_layout(
            "holovol guides",
            &[
                (0, uniform()),
                (2, field),
                (3, wgpu::BindingType::Sampler(sampler)),
                (4, majorants()),
                (5, storage(true)),
                (6, storage(true)),
                (14, uniform()),
                (15, texture_2d_array(false)),
                (16, uniform()),
                (18, storage(false)),
                (23, storage(false)),
                (24, storage(true)),
            ],
        )?;
        let mut all = defs.clone();
        all.extend(UNUSED);
        all.extend(pass_defs(0));
        let pipeline = gpu.pipeline(&GUIDES, &all, "march", &layout)?;
        Ok(Self { layout, pipeline })
    }

    /// Records the march over eyes of these sizes; buffers: uniform, lights, keys.
    pub(super) fn record(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        matter: &Matter<'_>,
        sizes: &[[u32; 2]],
        [uniform, lights, keys]: [&wgpu::Buffer; 3],
        light_grid: Option<&wgpu::Buffer>,
    ) -> Result<(), RenderError> {
        // Something that can be read, where there is no grid.
        let light = light_grid.unwrap_or(&matter.buffers.points);
        let group = gpu.scoped("guides", 0, || {
            let resources = [
                (0, matter.buffers.scene.as_entire_binding()),
                (2, Resource::TextureView(&matter.volume.view)),
                (3, Resource::Sampler(&matter.buffers.field_sampler)),
                (4, Resource::TextureView(&matter.majorants.view)),
                (5, matter.majorants.occupied.as_entire_binding()),
                (6, matter.buffers.points.as_entire_binding()),
                (14, matter.buffers.views.as_entire_binding()),
                (15, Resource::TextureView(matter.mesh_depth)),
                (16, uniform.as_entire_binding()),
                (18, keys.as_entire_binding()),
                (23, lights.as_entire_binding()),
                (24, light.as_entire_binding()),
            ];
            gpu.numbered_group("holovol guides", &self.layout, resources)
        })?;
        let mut pass = super::compute_pass(encoder, "holovol guides");
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &group, &[]);
        let [x, y] = super::workgroups(sizes);
        pass.dispatch_workgroups(x, y, sizes.len() as u32);
        Ok(())
    }
}
