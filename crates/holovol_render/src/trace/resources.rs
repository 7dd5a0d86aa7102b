//! What the kernel is bound to: buffers, textures and the groups that hold them.

use std::num::NonZero;
use std::ops::Range;

use wgpu::{BufferUsages as Usage, TextureFormat as Format, TextureViewDimension as Dimension};

use super::environment::GpuEnvironment;
use super::uniforms::{DispatchUniform, MAX_VIEWS, SceneUniform, ViewUniform, transfer_points};
use super::variant::{QUEUE_CAPACITY, SAVED_PATH_VECTORS};
use super::{GpuCounters, Interpolation, Medium, TraceOptions};
use crate::layout::{
    majorants, storage, texels, texture_2d_array, texture_2d_array_uint, texture_3d, uniform,
};
use crate::light_grid::FreshLight;
use crate::{Gpu, GpuVolume, MajorantGrid, RenderError};

/// Two sums of four channels.
pub(crate) const PIXEL_BYTES: u64 = 32;
/// Three vectors, see [`super::Guide`].
pub(crate) const GUIDE_BYTES: u64 = 48;

/// What is bound besides the volume and the environment.
pub(crate) struct Buffers {
    pub(crate) scene: wgpu::Buffer,
    pub(crate) dispatch: wgpu::Buffer,
    pub(crate) views: wgpu::Buffer,
    pub(crate) points: wgpu::Buffer,
    pub(crate) accumulators: wgpu::Buffer,
    pub(crate) guides: wgpu::Buffer,
    has_guides: bool,
    pub(crate) counters: wgpu::Buffer,
    queues: [wgpu::Buffer; 2],
    pub(crate) field_sampler: wgpu::Sampler,
    /// 1 × 1, while no mesh is in the way.
    no_mesh_depth: wgpu::TextureView,
    /// Likewise, while every pixel gets all samples.
    no_shares: wgpu::TextureView,
    /// Likewise, without a light grid.
    no_light_grid: wgpu::Buffer,
}

impl Buffers {
    /// Room for images of `pixels` pixels in all.
    pub(crate) fn new(gpu: &Gpu, pixels: u64, options: &TraceOptions) -> Result<Self, RenderError> {
        let pixels = pixels.max(1);
        let queue = u64::from(QUEUE_CAPACITY) * u64::from(SAVED_PATH_VECTORS + options.picks) * 16;
        let guide_bytes = GUIDE_BYTES * if options.guides { pixels } else { 1 };
        let image_bytes = PIXEL_BYTES * pixels;
        let limit = gpu.device.limits().max_buffer_size;
        if image_bytes.max(guide_bytes) > limit {
            let per_pixel = image_bytes.max(guide_bytes) / pixels;
            return Err(RenderError::Scene {
                field: "camera",
                reason: format!(
                    "an image of {pixels} pixels: this device holds at most {}; make it smaller",
                    limit / per_pixel
                ),
            });
        }
        let bytes = image_bytes + 2 * queue + guide_bytes;
        gpu.scoped("the image", bytes, || {
            let written = Usage::UNIFORM | Usage::COPY_DST;
            let readable = Usage::STORAGE | Usage::COPY_SRC | Usage::COPY_DST;
            let filter = match options.interpolation {
                Interpolation::Exact => wgpu::FilterMode::Nearest,
                Interpolation::Hardware => wgpu::FilterMode::Linear,
            };
            let nothing = |label, format| {
                let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
                    label: Some(label),
                    size: wgpu::Extent3d::default(),
                    mip_level_count: 1,
                    sample_count: 1,
                    dimension: wgpu::TextureDimension::D2,
                    format,
                    usage: wgpu::TextureUsages::TEXTURE_BINDING,
                    view_formats: &[],
                });
                texture.create_view(&wgpu::TextureViewDescriptor {
                    dimension: Some(wgpu::TextureViewDimension::D2Array),
                    ..Default::default()
                })
            };
            let views = (MAX_VIEWS * size_of::<ViewUniform>()) as u64;
            Self {
                scene: gpu.empty("holovol scene", size_of::<SceneUniform>() as u64, written),
                dispatch: gpu.empty(
                    "holovol dispatch",
                    size_of::<DispatchUniform>() as u64,
                    written,
                ),
                views: gpu.empty("holovol views", views, written),
                points: gpu.empty("holovol points", 48, Usage::STORAGE),
                accumulators: gpu.empty("holovol image", image_bytes, readable),
                guides: gpu.empty("holovol guides", guide_bytes, readable),
                has_guides: options.guides,
                counters: gpu.empty(
                    "holovol counters",
                    size_of::<GpuCounters>() as u64,
                    readable,
                ),
                queues: [0, 1].map(|_| gpu.empty("holovol paths", queue, Usage::STORAGE)),
                field_sampler: gpu.device.create_sampler(&wgpu::SamplerDescriptor {
                    label: Some("holovol volume"),
                    mag_filter: filter,
                    min_filter: filter,
                    ..Default::default()
                }),
                no_mesh_depth: nothing("holovol no mesh depth", wgpu::TextureFormat::R32Float),
                no_light_grid: gpu.empty("holovol no light grid", 8, Usage::STORAGE),
                no_shares: nothing("holovol no shares", wgpu::TextureFormat::R8Uint),
            }
        })
    }

    /// How many pixels there is room for.
    pub(crate) fn pixels(&self) -> u64 {
        self.accumulators.size() / PIXEL_BYTES
    }

    /// A texture of mesh depth, or one texel in its place.
    pub(crate) fn mesh_depth<'a>(
        &'a self,
        texture: Option<&'a wgpu::TextureView>,
    ) -> &'a wgpu::TextureView {
        texture.unwrap_or(&self.no_mesh_depth)
    }

    /// Writes what a medium says; its points take another buffer.
    pub(crate) fn set_medium(
        &mut self,
        gpu: &Gpu,
        medium: &Medium,
        volume: &GpuVolume,
        majorants: &MajorantGrid,
        environment: &GpuEnvironment,
    ) -> Result<(), RenderError> {
        let scene = SceneUniform::new(medium, volume, majorants.cells(), environment);
        let points = transfer_points(&medium.transfer_function);
        let contents = bytemuck::cast_slice(&points);
        self.points = gpu.scoped("the transfer function", contents.len() as u64, || {
            gpu.queue
                .write_buffer(&self.scene, 0, bytemuck::bytes_of(&scene));
            gpu.filled("holovol points", contents, Usage::STORAGE)
        })?;
        Ok(())
    }

    /// Two groups, that differ in which path queue is read and which is written. Of the image and
    /// the guides they hold `pixels`.
    #[expect(clippy::too_many_arguments, reason = "all that the kernel is bound to")]
    pub(crate) fn bind_groups(
        &self,
        gpu: &Gpu,
        layout: &wgpu::BindGroupLayout,
        volume: &GpuVolume,
        majorants: &MajorantGrid,
        environment: &GpuEnvironment,
        mesh_depth: Option<&wgpu::TextureView>,
        shares: Option<&wgpu::TextureView>,
        fresh_light: Option<&FreshLight>,
        pixels: Range<u64>,
    ) -> Result<[wgpu::BindGroup; 2], RenderError> {
        let part = |buffer, bytes_per_pixel| {
            wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                buffer,
                offset: bytes_per_pixel * pixels.start,
                size: NonZero::new(bytes_per_pixel * (pixels.end - pixels.start)),
            })
        };
        let guides = || match self.has_guides {
            true => part(&self.guides, GUIDE_BYTES),
            false => self.guides.as_entire_binding(),
        };
        let mesh_depth = self.mesh_depth(mesh_depth);
        let shares = shares.unwrap_or(&self.no_shares);
        let fresh_light = fresh_light.map_or(&self.no_light_grid, |fresh| &fresh.sums);
        gpu.scoped("the image", 0, || {
            [[0, 1], [1, 0]].map(|[resumed, saved]: [usize; 2]| {
                let resources = [
                    self.scene.as_entire_binding(),
                    self.dispatch.as_entire_binding(),
                    wgpu::BindingResource::TextureView(&volume.view),
                    wgpu::BindingResource::Sampler(&self.field_sampler),
                    wgpu::BindingResource::TextureView(&majorants.view),
                    majorants.occupied.as_entire_binding(),
                    self.points.as_entire_binding(),
                    wgpu::BindingResource::TextureView(&environment.view),
                    wgpu::BindingResource::TextureView(&environment.alias),
                    part(&self.accumulators, PIXEL_BYTES),
                    self.counters.as_entire_binding(),
                    self.queues[resumed].as_entire_binding(),
                    self.queues[saved].as_entire_binding(),
                    guides(),
                    self.views.as_entire_binding(),
                    wgpu::BindingResource::TextureView(mesh_depth),
                    wgpu::BindingResource::TextureView(shares),
                    fresh_light.as_entire_binding(),
                ];
                gpu.bind_group("holovol trace", layout, resources)
            })
        })
    }
}

pub(crate) fn layout(
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
        majorants(),
        storage(true),
        storage(true),
        texels(Format::Rgba32Float, Dimension::D2),
        texels(Format::Rg32Uint, Dimension::D2),
        storage(false),
        storage(false),
        storage(true),
        storage(false),
        storage(false),
        uniform(),
        texture_2d_array(false),
        texture_2d_array_uint(),
        storage(false),
    ];
    gpu.bind_group_layout("holovol trace", &entries)
}
