//! Passes over whole images, one triangle each; whatever they need on the device is kept.
//!
//! The cameras draw into images of their own, which are copied into the headset's: they can be
//! smaller than those, can be mirrored, and stay when a session goes in mid-frame; and the headset's
//! image is held for the time of one small pass only.

use std::collections::HashMap;

use bevy::prelude::*;
use bevy::render::render_resource::TextureFormat;
use bevy::render::renderer::RenderDevice;
use holovol_render::wgpu;

/// What a pass does to its image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum ScreenPass {
    /// Into another size and format.
    Copy,
    /// Maps tones of what is premultiplied by an opacity that comes along.
    Alpha,
    /// The same, for light that is added: without opacity.
    Additive,
}

/// What passes need on the device.
#[derive(Resource)]
pub(crate) struct Screen {
    layout: wgpu::BindGroupLayout,
    module: wgpu::ShaderModule,
    sampler: wgpu::Sampler,
    pipelines: HashMap<(ScreenPass, TextureFormat), wgpu::RenderPipeline>,
    /// Of what has been drawn from in this frame or the last.
    sources: HashMap<wgpu::TextureView, Source>,
}

struct Source {
    group: wgpu::BindGroup,
    is_used: bool,
}

/// What the device said.
#[derive(Debug, thiserror::Error)]
#[error("a pass over an eye's image failed: {0}")]
pub(crate) struct ScreenError(String);

impl FromWorld for Screen {
    fn from_world(world: &mut World) -> Self {
        let device = world.resource::<RenderDevice>().wgpu_device();
        let entry = |binding, ty| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::FRAGMENT,
            ty,
            count: None,
        };
        let texture = wgpu::BindingType::Texture {
            sample_type: wgpu::TextureSampleType::Float { filterable: true },
            view_dimension: wgpu::TextureViewDimension::D2,
            multisampled: false,
        };
        let sampler = wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering);
        Self {
            layout: device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some("holovol headset"),
                entries: &[entry(0, texture), entry(1, sampler)],
            }),
            module: device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some("holovol headset"),
                source: wgpu::ShaderSource::Wgsl(include_str!("screen.wgsl").into()),
            }),
            sampler: device.create_sampler(&wgpu::SamplerDescriptor {
                label: Some("holovol headset"),
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                ..Default::default()
            }),
            pipelines: HashMap::new(),
            sources: HashMap::new(),
        }
    }
}

impl Screen {
    /// Makes what a pass needs, unless it is there.
    pub(crate) fn prepare(
        &mut self,
        device: &wgpu::Device,
        pass: ScreenPass,
        source: &wgpu::TextureView,
        format: TextureFormat,
    ) -> Result<(), ScreenError> {
        if let (Some(source), true) = (
            self.sources.get_mut(source),
            self.pipelines.contains_key(&(pass, format)),
        ) {
            source.is_used = true;
            return Ok(());
        }
        let scope = device.push_error_scope(wgpu::ErrorFilter::Validation);
        self.pipelines
            .entry((pass, format))
            .or_insert_with(|| pipeline(device, &self.layout, &self.module, pass, format));
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("holovol headset"),
            layout: &self.layout,
            entries: &[
                wgpu::BindGroupEntry {
                    binding: 0,
                    resource: wgpu::BindingResource::TextureView(source),
                },
                wgpu::BindGroupEntry {
                    binding: 1,
                    resource: wgpu::BindingResource::Sampler(&self.sampler),
                },
            ],
        });
        let is_used = true;
        self.sources
            .insert(source.clone(), Source { group, is_used });
        match bevy::tasks::block_on(scope.pop()) {
            None => Ok(()),
            Some(error) => {
                self.sources.remove(source);
                self.pipelines.remove(&(pass, format));
                Err(ScreenError(error.to_string()))
            }
        }
    }

    /// Draws what was prepared; nothing if it wasn't.
    pub(crate) fn draw(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        pass: ScreenPass,
        source: &wgpu::TextureView,
        target: &wgpu::TextureView,
        format: TextureFormat,
    ) {
        let (Some(source), Some(pipeline)) = (
            self.sources.get(source),
            self.pipelines.get(&(pass, format)),
        ) else {
            return;
        };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("holovol headset"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: target,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                    store: wgpu::StoreOp::Store,
                },
            })],
            depth_stencil_attachment: None,
            timestamp_writes: None,
            occlusion_query_set: None,
            multiview_mask: None,
        });
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &source.group, &[]);
        pass.draw(0..3, 0..1);
    }

    /// Lets go of what this frame hasn't drawn from.
    pub(crate) fn end_frame(&mut self) {
        self.sources
            .retain(|_, source| std::mem::take(&mut source.is_used));
    }
}

fn pipeline(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    module: &wgpu::ShaderModule,
    pass: ScreenPass,
    format: TextureFormat,
) -> wgpu::RenderPipeline {
    let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some("holovol headset"),
        bind_group_layouts: &[Some(layout)],
        immediate_size: 0,
    });
    let additive = [("is_additive", 1.0)];
    let (entry_point, constants): (_, &[_]) = match pass {
        ScreenPass::Copy => ("copy", &[]),
        ScreenPass::Alpha => ("room", &[]),
        ScreenPass::Additive => ("room", &additive),
    };
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("holovol headset"),
        layout: Some(&layout),
        vertex: wgpu::VertexState {
            module,
            entry_point: Some("vertex"),
            compilation_options: Default::default(),
            buffers: &[],
        },
        primitive: Default::default(),
        depth_stencil: None,
        multisample: Default::default(),
        fragment: Some(wgpu::FragmentState {
            module,
            entry_point: Some(entry_point),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants,
                ..Default::default()
            },
            targets: &[Some(format.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}
