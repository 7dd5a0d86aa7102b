//! Depth of what a view sees, for compositors that move pictures to later poses.
//!
//! [`ViewDepth::record`] draws it into a depth buffer that may be a runtime's: opaque meshes as the
//! caller has drawn them, volumes at the mean depth of what makes them opaque, by a march without
//! noise; where they let more than [`LEAST_OPACITY`] through they leave none. Reversed depth: 1 is
//! near. Costs one march per pixel of the target.

use std::collections::HashMap;

use bytemuck::{Pod, Zeroable};
use glam::DMat4;

use crate::layout::{majorants, storage, texture_2d_array, texture_3d, uniform};
use crate::shader::{ShaderDefs, ShaderFile, compose, shader_file};
use crate::trace::shader_defs;
use crate::{FrameTracer, Gpu, Interpolation, Medium, RenderError};

pub(crate) const VIEW_DEPTH: ShaderFile = shader_file!("view_depth.wgsl");

/// Opacity from which on a volume has a depth, percent.
const LEAST_OPACITY_PERCENT: u32 = 5;
/// Opacity from which on a volume has a depth.
pub const LEAST_OPACITY: f32 = LEAST_OPACITY_PERCENT as f32 / 100.0;

/// `ViewDepth` of view_depth.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub(crate) struct ViewDepthUniform {
    pub clip: [f32; 4],
    pub place: [u32; 4],
}

/// Where depth is drawn.
#[derive(Clone, Copy, Debug)]
pub struct ViewDepthTarget<'a> {
    /// All of it is drawn; without samples.
    pub view: &'a wgpu::TextureView,
    /// Without stencil.
    pub format: wgpu::TextureFormat,
    /// Pixels across and down.
    pub size: [u32; 2],
    /// The projection of the view; it sees the whole target.
    pub clip_from_view: DMat4,
}

/// Draws depth into depth buffers; what it needs on the device is kept.
pub struct ViewDepth {
    gpu: Gpu,
    pipelines: HashMap<Variant, (wgpu::BindGroupLayout, wgpu::RenderPipeline)>,
    /// One for each draw of a frame.
    draws: Vec<Draw>,
    drawn: usize,
    no_mesh: wgpu::TextureView,
}

#[derive(Clone, Copy, PartialEq, Eq, Hash)]
struct Variant {
    format: wgpu::TextureFormat,
    volume: Option<VolumeVariant>,
}

#[derive(Clone, Copy, PartialEq, Eq, Hash)]
struct VolumeVariant {
    slices: bool,
    filtered: bool,
    cell_size: u32,
}

/// One draw's uniform, and its bind group while what it holds stays.
struct Draw {
    uniform: wgpu::Buffer,
    contents: Option<ViewDepthUniform>,
    bound: Option<Bound>,
}

struct Bound {
    variant: Variant,
    mesh: wgpu::TextureView,
    /// Voxels and transfer function; the rest comes and goes with them.
    volume: Option<(wgpu::TextureView, wgpu::Buffer, wgpu::Buffer)>,
    group: wgpu::BindGroup,
}

impl ViewDepth {
    /// Nothing is compiled yet.
    ///
    /// # Errors
    /// If the device fails.
    pub fn new(gpu: &Gpu) -> Result<Self, RenderError> {
        let no_mesh = gpu.scoped("view depth", 4, || {
            gpu.device.create_texture(&wgpu::TextureDescriptor {
                label: Some("holovol no mesh"),
                size: wgpu::Extent3d::default(),
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format: wgpu::TextureFormat::Depth32Float,
                usage: wgpu::TextureUsages::TEXTURE_BINDING
                    | wgpu::TextureUsages::RENDER_ATTACHMENT,
                view_formats: &[],
            })
        })?;
        Ok(Self {
            gpu: gpu.clone(),
            pipelines: HashMap::new(),
            draws: Vec::new(),
            drawn: 0,
            no_mesh: no_mesh.create_view(&Default::default()),
        })
    }

    /// A frame begins: what was drawn so far may be drawn over.
    pub fn begin_frame(&mut self) {
        self.drawn = 0;
    }

    /// Draws one view. `meshes` is the depth of opaque meshes, reversed, drawn with the same
    /// projection, in any size and without samples; `volumes` are tracers with the slot of this
    /// view, which must be that of their last record.
    ///
    /// Compiles a small shader for the first volume of a kind.
    ///
    /// # Errors
    /// If the device fails.
    pub fn record<'a>(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        target: &ViewDepthTarget<'_>,
        meshes: Option<&wgpu::TextureView>,
        volumes: impl Iterator<Item = (&'a FrameTracer, usize)>,
    ) -> Result<(), RenderError> {
        let first = self.drawn;
        if meshes.is_some() {
            self.prepare(target, meshes, None)?;
        }
        for volume in volumes {
            self.prepare(target, meshes, Some(volume))?;
        }
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("holovol view depth"),
            color_attachments: &[],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: target.view,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(0.0),
                    store: wgpu::StoreOp::Store,
                }),
                stencil_ops: None,
            }),
            timestamp_writes: None,
            occlusion_query_set: None,
            multiview_mask: None,
        });
        for draw in &self.draws[first..self.drawn] {
            if let Some(bound) = &draw.bound
                && let Some((_, pipeline)) = self.pipelines.get(&bound.variant)
            {
                pass.set_pipeline(pipeline);
                pass.set_bind_group(0, &bound.group, &[]);
                pass.draw(0..3, 0..1);
            }
        }
        Ok(())
    }

    /// Brings the next draw to what it is to draw.
    fn prepare(
        &mut self,
        target: &ViewDepthTarget<'_>,
        meshes: Option<&wgpu::TextureView>,
        volume: Option<(&FrameTracer, usize)>,
    ) -> Result<(), RenderError> {
        let variant = Variant {
            format: target.format,
            volume: volume.map(|(tracer, _)| VolumeVariant::of(tracer)),
        };
        if !self.pipelines.contains_key(&variant) {
            let made = self.pipeline(variant, volume.map(|(tracer, _)| tracer))?;
            self.pipelines.insert(variant, made);
        }
        let gpu = &self.gpu;
        if self.drawn == self.draws.len() {
            let size = size_of::<ViewDepthUniform>() as u64;
            let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
            self.draws.push(Draw {
                uniform: gpu.scoped("view depth", size, || {
                    gpu.empty("holovol view depth", size, usage)
                })?,
                contents: None,
                bound: None,
            });
        }
        let draw = &mut self.draws[self.drawn];
        let uniform = ViewDepthUniform::new(target, meshes.is_some(), volume.map(|v| v.1));
        if draw.contents != Some(uniform) {
            let contents = bytemuck::bytes_of(&uniform);
            gpu.queue.write_buffer(&draw.uniform, 0, contents);
            draw.contents = Some(uniform);
        }
        let mesh = meshes.unwrap_or(&self.no_mesh);
        let tracer = volume.map(|(tracer, _)| tracer);
        if !draw.holds(variant, mesh, tracer) {
            draw.bound = None;
            let (layout, _) = &self.pipelines[&variant];
            let group = gpu.scoped("view depth", 0, || {
                let place = [
                    (16, draw.uniform.as_entire_binding()),
                    (17, wgpu::BindingResource::TextureView(mesh)),
                ];
                let matter = tracer.map(FrameTracer::matter);
                let volume = matter.as_ref().map(|matter| {
                    [
                        (0, matter.buffers.scene.as_entire_binding()),
                        (2, wgpu::BindingResource::TextureView(&matter.volume.view)),
                        (
                            3,
                            wgpu::BindingResource::Sampler(&matter.buffers.field_sampler),
                        ),
                        (
                            4,
                            wgpu::BindingResource::TextureView(&matter.majorants.view),
                        ),
                        (5, matter.majorants.occupied.as_entire_binding()),
                        (6, matter.buffers.points.as_entire_binding()),
                        (14, matter.buffers.views.as_entire_binding()),
                    ]
                });
                let resources = volume.into_iter().flatten().chain(place);
                gpu.numbered_group("holovol view depth", layout, resources)
            })?;
            draw.bound = Some(Bound {
                variant,
                mesh: mesh.clone(),
                volume: tracer.map(identity),
                group,
            });
        }
        self.drawn += 1;
        Ok(())
    }

    fn pipeline(
        &self,
        variant: Variant,
        tracer: Option<&FrameTracer>,
    ) -> Result<(wgpu::BindGroupLayout, wgpu::RenderPipeline), RenderError> {
        let gpu = &self.gpu;
        let shader = compose(&VIEW_DEPTH, &variant.defs(gpu, tracer))?;
        let mut types = vec![
            (16, uniform()),
            (
                17,
                wgpu::BindingType::Texture {
                    sample_type: wgpu::TextureSampleType::Depth,
                    view_dimension: wgpu::TextureViewDimension::D2,
                    multisampled: false,
                },
            ),
        ];
        if let Some(volume) = variant.volume {
            types.extend(volume.types());
        }
        let entries: Vec<_> = types
            .into_iter()
            .map(|(binding, ty)| wgpu::BindGroupLayoutEntry {
                binding,
                visibility: wgpu::ShaderStages::FRAGMENT,
                ty,
                count: None,
            })
            .collect();
        // Meshes first, whatever is there; volumes where they are nearer.
        let (entry_point, compare) = match variant.volume {
            None => ("meshes", wgpu::CompareFunction::Always),
            Some(_) => ("volume", wgpu::CompareFunction::GreaterEqual),
        };
        gpu.scoped(VIEW_DEPTH.path, 0, || {
            let device = &gpu.device;
            let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some("holovol view depth"),
                entries: &entries,
            });
            let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(VIEW_DEPTH.path),
                source: wgpu::ShaderSource::Naga(std::borrow::Cow::Owned(shader)),
            });
            let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some("holovol view depth"),
                bind_group_layouts: &[Some(&layout)],
                immediate_size: 0,
            });
            let pipeline = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some("holovol view depth"),
                layout: Some(&pipeline_layout),
                vertex: wgpu::VertexState {
                    module: &module,
                    entry_point: Some("vertex"),
                    compilation_options: Default::default(),
                    buffers: &[],
                },
                primitive: Default::default(),
                depth_stencil: Some(wgpu::DepthStencilState {
                    format: variant.format,
                    depth_write_enabled: Some(true),
                    depth_compare: Some(compare),
                    stencil: Default::default(),
                    bias: Default::default(),
                }),
                multisample: Default::default(),
                fragment: Some(wgpu::FragmentState {
                    module: &module,
                    entry_point: Some(entry_point),
                    compilation_options: Default::default(),
                    targets: &[],
                }),
                multiview_mask: None,
                cache: None,
            });
            (layout, pipeline)
        })
    }
}

impl Variant {
    /// Edits of a medium change none of these: they must not compile anything.
    fn defs(&self, gpu: &Gpu, tracer: Option<&FrameTracer>) -> ShaderDefs {
        let options = Default::default();
        let matter = tracer.map(FrameTracer::matter);
        let (options, surroundings) = match &matter {
            Some(matter) => (matter.options, matter.surroundings),
            None => (&options, Default::default()),
        };
        // Its transfer function isn't unrolled, and its planes are as many as there can be.
        let mut defs = shader_defs(gpu, &Medium::general(), options, surroundings);
        defs.push(("LEAST_OPACITY_PERCENT", LEAST_OPACITY_PERCENT));
        defs
    }
}

impl VolumeVariant {
    fn of(tracer: &FrameTracer) -> Self {
        let matter = tracer.matter();
        Self {
            slices: matter.volume.slices,
            filtered: matter.options.interpolation == Interpolation::Hardware,
            cell_size: matter.options.cell_size,
        }
    }

    fn types(self) -> [(u32, wgpu::BindingType); 7] {
        let sampler = if self.filtered {
            wgpu::SamplerBindingType::Filtering
        } else {
            wgpu::SamplerBindingType::NonFiltering
        };
        let field = if self.slices {
            texture_2d_array(false)
        } else {
            texture_3d(self.filtered)
        };
        [
            (0, uniform()),
            (2, field),
            (3, wgpu::BindingType::Sampler(sampler)),
            (4, majorants()),
            (5, storage(true)),
            (6, storage(true)),
            (14, uniform()),
        ]
    }
}

impl Draw {
    fn holds(
        &self,
        variant: Variant,
        mesh: &wgpu::TextureView,
        tracer: Option<&FrameTracer>,
    ) -> bool {
        self.bound.as_ref().is_some_and(|bound| {
            bound.variant == variant && bound.mesh == *mesh && bound.volume == tracer.map(identity)
        })
    }
}

/// What tells a tracer's bindings from others.
fn identity(tracer: &FrameTracer) -> (wgpu::TextureView, wgpu::Buffer, wgpu::Buffer) {
    let matter = tracer.matter();
    (
        matter.volume.view.clone(),
        matter.buffers.points.clone(),
        matter.buffers.views.clone(),
    )
}

impl ViewDepthUniform {
    fn new(target: &ViewDepthTarget<'_>, has_meshes: bool, slot: Option<usize>) -> Self {
        // Along −z of the view.
        let clip = |row: usize| {
            let row = target.clip_from_view.row(row);
            [-row.z as f32, row.w as f32]
        };
        let [[z, z0], [w, w0]] = [clip(2), clip(3)];
        let [width, height] = target.size;
        Self {
            clip: [z, z0, w, w0],
            place: [
                width,
                height,
                slot.unwrap_or(0) as u32,
                u32::from(has_meshes),
            ],
        }
    }
}
