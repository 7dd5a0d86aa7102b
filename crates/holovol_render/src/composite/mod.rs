//! Lays volumes over what a view has drawn.
//!
//! The image is blended as it is: premultiplied radiance times the view's exposure, so that tone
//! mapping comes later and once. The depth test hides it behind meshes in front of the volume; no
//! depth is written.

use std::collections::HashMap;

use bytemuck::{Pod, Zeroable};
use glam::{DMat4, DVec3};

use crate::shader::{ShaderFile, compose, shader_file};
use crate::trace::corners;
use crate::{Denoiser, FrameImage, FrameTracer, Gpu, RenderError, View};

pub(crate) const COMPOSITE: ShaderFile = shader_file!("composite.wgsl");

/// What is drawn into.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct CompositeTarget {
    /// Of the colour attachment; should be of floats.
    pub format: wgpu::TextureFormat,
    /// Samples per pixel.
    pub samples: u32,
    /// Of the depth attachment, if there is one; reversed depth: 1 is near.
    pub depth_format: Option<wgpu::TextureFormat>,
}

/// Where and how bright an image is laid.
#[derive(Clone, Copy, Debug)]
pub struct CompositePlace {
    /// Left, top, width and height in the target, pixels.
    pub viewport: [u32; 4],
    /// The projection of the depth attachment.
    pub clip_from_view: DMat4,
    /// Factor on radiance.
    pub exposure: f32,
}

/// `Composite` of composite.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub(crate) struct CompositeUniform {
    pub origin: [f32; 4],
    pub origin_dx: [f32; 4],
    pub origin_dy: [f32; 4],
    pub direction: [f32; 4],
    pub direction_dx: [f32; 4],
    pub direction_dy: [f32; 4],
    pub clip: [f32; 4],
    pub viewport: [f32; 4],
    pub image: [u32; 4],
    pub scale: [f32; 4],
}

/// How many vectors there are of each pixel, to be added up: the tracer's two sums, or one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Vectors {
    One = 1,
    Two = 2,
}

impl CompositeUniform {
    fn new(
        image: &FrameImage,
        vectors: Vectors,
        world_from_unit_cube: DMat4,
        place: &CompositePlace,
    ) -> Self {
        let cube_from_world = world_from_unit_cube.inverse();
        let [_, _, width, height] = place.viewport;
        let view = image.view.resized([width, height]);
        let vector = |v: DVec3| {
            let v = cube_from_world.transform_vector3(v);
            [v.x as f32, v.y as f32, v.z as f32, 0.0]
        };
        let origin = cube_from_world.transform_point3(view.origin);
        // Along −z of the view.
        let clip = |row: usize| {
            let row = place.clip_from_view.row(row);
            [-row.z as f32, row.w as f32]
        };
        let [[z, z0], [w, w0]] = [clip(2), clip(3)];
        // One vector is read twice.
        let reads = if vectors == Vectors::One { 2 } else { 1 };
        let per_sample = 1.0 / (image.samples.max(1) * reads) as f32;
        Self {
            origin: [origin.x as f32, origin.y as f32, origin.z as f32, 0.0],
            origin_dx: vector(view.origin_dx),
            origin_dy: vector(view.origin_dy),
            direction: vector(view.direction),
            direction_dx: vector(view.direction_dx),
            direction_dy: vector(view.direction_dy),
            clip: [z, z0, w, w0],
            viewport: place.viewport.map(|n| n as f32),
            image: [
                image.size[0],
                image.size[1],
                image.first_pixel,
                vectors as u32,
            ],
            scale: [place.exposure * per_sample, per_sample, 0.0, 0.0],
        }
    }
}

/// What [`Compositor::draw`] needs of an image; kept, it is made anew only if the image moves to
/// another buffer.
#[derive(Debug)]
pub struct CompositeBinding {
    /// From where the image was seen, and where its volume was.
    view: View,
    world_from_unit_cube: DMat4,
    contents: CompositeUniform,
    uniform: wgpu::Buffer,
    pixels: wgpu::Buffer,
    bind_group: wgpu::BindGroup,
}

impl CompositeBinding {
    /// Pixels [left, top, right, bottom] of a view of this size that the image may cover.
    pub fn bounds(&self, size: [u32; 2]) -> Option<[u32; 4]> {
        let corners = corners(self.world_from_unit_cube);
        self.view.resized(size).bounds(&corners)
    }

    /// The middle of its volume, world metres.
    pub fn centre(&self) -> DVec3 {
        self.world_from_unit_cube
            .transform_point3(DVec3::splat(0.5))
    }
}

/// Draws images of [`FrameTracer`]s into render passes.
pub struct Compositor {
    gpu: Gpu,
    layout: wgpu::BindGroupLayout,
    module: wgpu::ShaderModule,
    pipelines: HashMap<CompositeTarget, wgpu::RenderPipeline>,
}

impl Compositor {
    /// Compiles the shader.
    ///
    /// # Errors
    /// If the device fails.
    pub fn new(gpu: &Gpu) -> Result<Self, RenderError> {
        let shader = compose(&COMPOSITE, &Vec::new())?;
        let entry = |binding, ty| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::FRAGMENT,
            ty,
            count: None,
        };
        let entries = [
            entry(0, crate::layout::uniform()),
            entry(1, crate::layout::storage(true)),
        ];
        let (layout, module) = gpu.scoped(COMPOSITE.path, 0, || {
            let layout = gpu
                .device
                .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                    label: Some("holovol composite"),
                    entries: &entries,
                });
            let module = gpu
                .device
                .create_shader_module(wgpu::ShaderModuleDescriptor {
                    label: Some(COMPOSITE.path),
                    source: wgpu::ShaderSource::Naga(std::borrow::Cow::Owned(shader)),
                });
            (layout, module)
        })?;
        Ok(Self {
            gpu: gpu.clone(),
            layout,
            module,
            pipelines: HashMap::new(),
        })
    }

    /// Compiles the pipeline for a target, unless it is there.
    ///
    /// # Errors
    /// If the device fails.
    pub fn prepare(&mut self, target: CompositeTarget) -> Result<(), RenderError> {
        if self.pipelines.contains_key(&target) {
            return Ok(());
        }
        let premultiplied = wgpu::BlendComponent {
            src_factor: wgpu::BlendFactor::One,
            dst_factor: wgpu::BlendFactor::OneMinusSrcAlpha,
            operation: wgpu::BlendOperation::Add,
        };
        let device = &self.gpu.device;
        let pipeline = self.gpu.scoped(COMPOSITE.path, 0, || {
            let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some("holovol composite"),
                bind_group_layouts: &[Some(&self.layout)],
                immediate_size: 0,
            });
            device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some("holovol composite"),
                layout: Some(&layout),
                vertex: wgpu::VertexState {
                    module: &self.module,
                    entry_point: Some("vertex"),
                    compilation_options: Default::default(),
                    buffers: &[],
                },
                primitive: Default::default(),
                depth_stencil: target.depth_format.map(|format| wgpu::DepthStencilState {
                    format,
                    depth_write_enabled: Some(false),
                    depth_compare: Some(wgpu::CompareFunction::GreaterEqual),
                    stencil: Default::default(),
                    bias: Default::default(),
                }),
                multisample: wgpu::MultisampleState {
                    count: target.samples,
                    ..Default::default()
                },
                fragment: Some(wgpu::FragmentState {
                    module: &self.module,
                    entry_point: Some("fragment"),
                    compilation_options: Default::default(),
                    targets: &[Some(wgpu::ColorTargetState {
                        format: target.format,
                        blend: Some(wgpu::BlendState {
                            color: premultiplied,
                            alpha: premultiplied,
                        }),
                        write_mask: wgpu::ColorWrites::ALL,
                    })],
                }),
                multiview_mask: None,
                cache: None,
            })
        })?;
        self.pipelines.insert(target, pipeline);
        Ok(())
    }

    /// What [`Self::draw`] needs of a tracer's image; `None` while it has no samples. `former` is
    /// that of the same image in the last frame, which is brought up to date: one and the same
    /// binding serves one draw of a frame.
    ///
    /// # Errors
    /// If the device fails.
    pub fn bind(
        &self,
        tracer: &FrameTracer,
        slot: usize,
        place: &CompositePlace,
        former: Option<CompositeBinding>,
    ) -> Result<Option<CompositeBinding>, RenderError> {
        let Some(image) = tracer.image(slot) else {
            return Ok(None);
        };
        let placement = tracer.image_placement(slot);
        let vectors = Vectors::Two;
        let pixels = tracer.accumulators();
        self.bind_image(&image, vectors, placement, pixels, place, former)
            .map(Some)
    }

    /// As [`Self::bind`], of an eye's image that a denoiser has made.
    ///
    /// # Errors
    /// If the device fails.
    pub fn bind_denoised(
        &self,
        denoiser: &Denoiser,
        eye: usize,
        place: &CompositePlace,
        former: Option<CompositeBinding>,
    ) -> Result<Option<CompositeBinding>, RenderError> {
        let (Some(image), Some(medium), Some(output)) =
            (denoiser.image(eye), denoiser.medium(), denoiser.output())
        else {
            return Ok(None);
        };
        let placement = medium.world_from_unit_cube;
        let vectors = Vectors::One;
        self.bind_image(&image, vectors, placement, output, place, former)
            .map(Some)
    }

    fn bind_image(
        &self,
        image: &FrameImage,
        vectors: Vectors,
        world_from_unit_cube: DMat4,
        pixels: &wgpu::Buffer,
        place: &CompositePlace,
        former: Option<CompositeBinding>,
    ) -> Result<CompositeBinding, RenderError> {
        let contents = CompositeUniform::new(image, vectors, world_from_unit_cube, place);
        let bytes = bytemuck::bytes_of(&contents);
        if let Some(mut binding) = former.filter(|former| former.pixels == *pixels) {
            if binding.contents != contents {
                self.gpu.queue.write_buffer(&binding.uniform, 0, bytes);
                binding.contents = contents;
            }
            binding.view = image.view;
            binding.world_from_unit_cube = world_from_unit_cube;
            return Ok(binding);
        }
        self.gpu.scoped(COMPOSITE.path, bytes.len() as u64, || {
            let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
            let uniform = self.gpu.filled("holovol composite", bytes, usage);
            let resources = [uniform.as_entire_binding(), pixels.as_entire_binding()];
            let layout = &self.layout;
            let bind_group = self.gpu.bind_group("holovol composite", layout, resources);
            CompositeBinding {
                view: image.view,
                world_from_unit_cube,
                contents,
                uniform,
                pixels: pixels.clone(),
                bind_group,
            }
        })
    }

    /// Lays an image over what is there; nothing if [`Self::prepare`] wasn't called for the target.
    pub fn draw(
        &self,
        pass: &mut wgpu::RenderPass<'_>,
        target: CompositeTarget,
        binding: &CompositeBinding,
    ) {
        if let Some(pipeline) = self.pipelines.get(&target) {
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, &binding.bind_group, &[]);
            pass.draw(0..3, 0..1);
        }
    }
}
