//! Pictures that meet a real room: takes the place of Bevy's tone mapping in views whose opacity
//! counts.

use std::collections::HashMap;

use bevy::prelude::*;
use bevy::render::extract_component::ExtractComponent;
use bevy::render::render_resource::TextureFormat;
use bevy::render::renderer::{RenderContext, RenderDevice, ViewQuery};
use bevy::render::view::ViewTarget;
use holovol_render::wgpu;

use super::cost::FrameCost;

/// On a camera without tone mapping of its own: its picture is laid over a room.
#[derive(Component, ExtractComponent, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum RoomOutput {
    /// Premultiplied by opacity, which comes along.
    Alpha,
    /// Premultiplied; light that is added needs no opacity.
    Additive,
}

/// The pass, for each kind and format that was met.
#[derive(Resource)]
pub(crate) struct OutputPipelines {
    layout: wgpu::BindGroupLayout,
    module: wgpu::ShaderModule,
    pipelines: HashMap<(RoomOutput, TextureFormat), wgpu::RenderPipeline>,
}

impl FromWorld for OutputPipelines {
    fn from_world(world: &mut World) -> Self {
        let device = world.resource::<RenderDevice>().wgpu_device();
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("holovol room output"),
            entries: &[wgpu::BindGroupLayoutEntry {
                binding: 0,
                visibility: wgpu::ShaderStages::FRAGMENT,
                ty: wgpu::BindingType::Texture {
                    sample_type: wgpu::TextureSampleType::Float { filterable: false },
                    view_dimension: wgpu::TextureViewDimension::D2,
                    multisampled: false,
                },
                count: None,
            }],
        });
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("holovol room output"),
            source: wgpu::ShaderSource::Wgsl(include_str!("output.wgsl").into()),
        });
        Self {
            layout,
            module,
            pipelines: HashMap::new(),
        }
    }
}

/// `Render`: compiles what the views need.
pub(crate) fn prepare(
    mut pipelines: ResMut<OutputPipelines>,
    device: Res<RenderDevice>,
    views: Query<(&ViewTarget, &RoomOutput)>,
    cost: Res<FrameCost>,
) {
    let _counting = cost.count();
    for (target, output) in &views {
        let OutputPipelines {
            layout,
            module,
            pipelines,
        } = &mut *pipelines;
        let format = target.main_texture_format();
        pipelines
            .entry((*output, format))
            .or_insert_with(|| pipeline(device.wgpu_device(), layout, module, *output, format));
    }
}

/// `Core3d`, where Bevy maps tones.
pub(crate) fn map_tones(
    view: ViewQuery<(&ViewTarget, &RoomOutput)>,
    pipelines: Res<OutputPipelines>,
    mut ctx: RenderContext,
    cost: Res<FrameCost>,
) {
    let _counting = cost.count();
    let (target, output) = view.into_inner();
    let key = (*output, target.main_texture_format());
    let Some(pipeline) = pipelines.pipelines.get(&key) else {
        return;
    };
    let post_process = target.post_process_write();
    let device = ctx.render_device().wgpu_device();
    let bind_group = device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("holovol room output"),
        layout: &pipelines.layout,
        entries: &[wgpu::BindGroupEntry {
            binding: 0,
            resource: wgpu::BindingResource::TextureView(post_process.source),
        }],
    });
    let mut pass = ctx
        .command_encoder()
        .begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("holovol room output"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: post_process.destination,
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
    pass.set_bind_group(0, &bind_group, &[]);
    pass.draw(0..3, 0..1);
}

fn pipeline(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    module: &wgpu::ShaderModule,
    output: RoomOutput,
    format: TextureFormat,
) -> wgpu::RenderPipeline {
    let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some("holovol room output"),
        bind_group_layouts: &[Some(layout)],
        immediate_size: 0,
    });
    let is_additive = f64::from(u8::from(output == RoomOutput::Additive));
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("holovol room output"),
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
            entry_point: Some("fragment"),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants: &[("is_additive", is_additive)],
                ..Default::default()
            },
            targets: &[Some(format.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}
