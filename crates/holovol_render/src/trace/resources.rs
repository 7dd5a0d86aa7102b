//! What the kernel is bound to: buffers, textures and the groups that hold them.

use holovol_light::EnvironmentSampler;
use holovol_scene::Scene;
use wgpu::BufferUsages as Usage;
use wgpu::util::DeviceExt;

use super::uniforms::{DispatchUniform, SceneUniform, transfer_points};
use super::variant::{QUEUE_CAPACITY, SAVED_PATH_VECTORS};
use super::{GpuCounters, Interpolation, TraceOptions};
use crate::layout::{storage, texture_2d, texture_2d_array, texture_3d, uniform};
use crate::{Gpu, GpuVolume, MajorantGrid, RenderError};

/// The tracer's buffers that the host writes or reads, and its bind groups.
pub(super) struct Resources {
    pub(super) layout: wgpu::BindGroupLayout,
    /// Two, that differ in which path queue is read and which is written.
    pub(super) bind_groups: [wgpu::BindGroup; 2],
    pub(super) dispatch: wgpu::Buffer,
    pub(super) accumulators: wgpu::Buffer,
    pub(super) guides: wgpu::Buffer,
    pub(super) counters: wgpu::Buffer,
}

impl Resources {
    pub(super) fn new(
        gpu: &Gpu,
        scene: &Scene,
        options: &TraceOptions,
        volume: &GpuVolume,
        majorants: &MajorantGrid,
        sampler: Option<&EnvironmentSampler>,
    ) -> Result<Self, RenderError> {
        let layout = layout(gpu, options.interpolation, volume.slices)?;
        let environment = upload_environment(gpu, scene)?;
        let alias: Vec<[u32; 2]> = match sampler {
            Some(sampler) => {
                let entries = sampler.entries().iter();
                entries
                    .map(|entry| [entry.threshold.to_bits(), entry.alias])
                    .collect()
            }
            None => vec![[0, 0]],
        };
        let scene_uniform = SceneUniform::new(scene, volume, majorants.cells(), sampler);
        let points = transfer_points(&scene.transfer_function);
        let pixels = u64::from(scene.camera.width) * u64::from(scene.camera.height);
        let queue = u64::from(QUEUE_CAPACITY) * u64::from(SAVED_PATH_VECTORS + options.picks) * 16;
        let guide_bytes = if options.guides { 48 * pixels } else { 48 };
        let bytes = 32 * pixels + 2 * queue + guide_bytes;
        gpu.scoped("the image", bytes, || {
            let filled = |label, contents, usage| {
                gpu.device
                    .create_buffer_init(&wgpu::util::BufferInitDescriptor {
                        label: Some(label),
                        contents,
                        usage,
                    })
            };
            let empty = |label, size, usage| {
                gpu.device.create_buffer(&wgpu::BufferDescriptor {
                    label: Some(label),
                    size,
                    usage,
                    mapped_at_creation: false,
                })
            };
            let scene_buffer = filled(
                "holovol scene",
                bytemuck::bytes_of(&scene_uniform),
                Usage::UNIFORM,
            );
            let points = filled(
                "holovol points",
                bytemuck::cast_slice(&points),
                Usage::STORAGE,
            );
            let alias = filled(
                "holovol light",
                bytemuck::cast_slice(&alias),
                Usage::STORAGE,
            );
            let dispatch = empty(
                "holovol dispatch",
                size_of::<DispatchUniform>() as u64,
                Usage::UNIFORM | Usage::COPY_DST,
            );
            let readable = Usage::STORAGE | Usage::COPY_SRC | Usage::COPY_DST;
            let accumulators = empty("holovol image", 32 * pixels, readable);
            let guides = empty("holovol guides", guide_bytes, readable);
            let counters = empty(
                "holovol counters",
                size_of::<GpuCounters>() as u64,
                readable,
            );
            let queues = [0, 1].map(|_| empty("holovol paths", queue, Usage::STORAGE));
            let filter = match options.interpolation {
                Interpolation::Exact => wgpu::FilterMode::Nearest,
                Interpolation::Hardware => wgpu::FilterMode::Linear,
            };
            let field_sampler = gpu.device.create_sampler(&wgpu::SamplerDescriptor {
                label: Some("holovol volume"),
                mag_filter: filter,
                min_filter: filter,
                ..Default::default()
            });
            let bind_groups = [[0, 1], [1, 0]].map(|[resumed, saved]: [usize; 2]| {
                let resources = [
                    scene_buffer.as_entire_binding(),
                    dispatch.as_entire_binding(),
                    wgpu::BindingResource::TextureView(&volume.view),
                    wgpu::BindingResource::Sampler(&field_sampler),
                    wgpu::BindingResource::TextureView(&majorants.view),
                    majorants.occupied.as_entire_binding(),
                    points.as_entire_binding(),
                    wgpu::BindingResource::TextureView(&environment),
                    alias.as_entire_binding(),
                    accumulators.as_entire_binding(),
                    counters.as_entire_binding(),
                    queues[resumed].as_entire_binding(),
                    queues[saved].as_entire_binding(),
                    guides.as_entire_binding(),
                ];
                gpu.bind_group("holovol trace", &layout, resources)
            });
            (bind_groups, dispatch, accumulators, guides, counters)
        })
        .map(
            |(bind_groups, dispatch, accumulators, guides, counters)| Self {
                layout,
                bind_groups,
                dispatch,
                accumulators,
                guides,
                counters,
            },
        )
    }
}

fn layout(
    gpu: &Gpu,
    interpolation: Interpolation,
    slices: bool,
) -> Result<wgpu::BindGroupLayout, RenderError> {
    let filtered = interpolation == Interpolation::Hardware;
    let sampler = if filtered {
        wgpu::SamplerBindingType::Filtering
    } else {
        wgpu::SamplerBindingType::NonFiltering
    };
    let entries = [
        uniform(),
        uniform(),
        if slices {
            texture_2d_array(false)
        } else {
            texture_3d(filtered)
        },
        wgpu::BindingType::Sampler(sampler),
        texture_3d(false),
        storage(true),
        storage(true),
        texture_2d(false),
        storage(true),
        storage(false),
        storage(false),
        storage(true),
        storage(false),
        storage(false),
    ];
    gpu.bind_group_layout("holovol trace", &entries)
}

/// The map as 32-bit floats: suns pass what 16 bits hold. One texel if it is constant.
fn upload_environment(gpu: &Gpu, scene: &Scene) -> Result<wgpu::TextureView, RenderError> {
    let map = &scene.environment.map;
    let constant = map.as_constant().is_some();
    let (width, height) = if constant {
        (1, 1)
    } else {
        (map.width() as u32, map.height() as u32)
    };
    let limit = gpu.device.limits().max_texture_dimension_2d;
    if width > limit || height > limit {
        return Err(RenderError::Scene {
            field: "environment",
            reason: format!("map of {width} × {height}: this device holds at most {limit} a side"),
        });
    }
    let texels: Vec<[f32; 4]> = map.texels()[..width as usize * height as usize]
        .iter()
        .map(|&[r, g, b]| [r, g, b, 0.0])
        .collect();
    gpu.scoped("the environment", 16 * texels.len() as u64, || {
        let texture = gpu.device.create_texture_with_data(
            &gpu.queue,
            &wgpu::TextureDescriptor {
                label: Some("holovol environment"),
                size: wgpu::Extent3d {
                    width,
                    height,
                    depth_or_array_layers: 1,
                },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format: wgpu::TextureFormat::Rgba32Float,
                usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
                view_formats: &[],
            },
            wgpu::util::TextureDataOrder::LayerMajor,
            bytemuck::cast_slice(&texels),
        );
        texture.create_view(&Default::default())
    })
}
