//! Bind group layouts and groups: entry i is binding i, for compute.

use wgpu::{BindingType, BufferBindingType, TextureSampleType, TextureViewDimension};

use crate::{Gpu, RenderError};

pub(crate) fn uniform() -> BindingType {
    buffer(BufferBindingType::Uniform)
}

pub(crate) fn storage(read_only: bool) -> BindingType {
    buffer(BufferBindingType::Storage { read_only })
}

fn buffer(ty: BufferBindingType) -> BindingType {
    BindingType::Buffer {
        ty,
        has_dynamic_offset: false,
        min_binding_size: None,
    }
}

pub(crate) fn texture_3d(filterable: bool) -> BindingType {
    texture(TextureViewDimension::D3, filterable)
}

pub(crate) fn texture_2d_array(filterable: bool) -> BindingType {
    texture(TextureViewDimension::D2Array, filterable)
}

/// A texture without levels that is read texel by texel. llvmpipe reads sampled textures more
/// slowly: it finds each lane's level.
pub(crate) fn texels(
    format: wgpu::TextureFormat,
    view_dimension: TextureViewDimension,
) -> BindingType {
    BindingType::StorageTexture {
        access: wgpu::StorageTextureAccess::ReadOnly,
        format,
        view_dimension,
    }
}

/// Of every kernel that walks from cell to cell.
pub(crate) fn majorants() -> BindingType {
    texels(wgpu::TextureFormat::R32Float, TextureViewDimension::D3)
}

pub(crate) fn texture_2d_array_uint() -> BindingType {
    sampled(TextureViewDimension::D2Array, TextureSampleType::Uint)
}

fn texture(view_dimension: TextureViewDimension, filterable: bool) -> BindingType {
    sampled(view_dimension, TextureSampleType::Float { filterable })
}

fn sampled(view_dimension: TextureViewDimension, sample_type: TextureSampleType) -> BindingType {
    BindingType::Texture {
        sample_type,
        view_dimension,
        multisampled: false,
    }
}

impl Gpu {
    /// A buffer that holds `contents`; call it within an error scope.
    ///
    /// Written through the queue: mapping a buffer of a device that has just been lost would panic.
    pub(crate) fn filled(
        &self,
        label: &str,
        contents: &[u8],
        usage: wgpu::BufferUsages,
    ) -> wgpu::Buffer {
        let usage = usage | wgpu::BufferUsages::COPY_DST;
        let buffer = self.empty(label, contents.len() as u64, usage);
        self.queue.write_buffer(&buffer, 0, contents);
        buffer
    }

    /// A buffer of zeros; call it within an error scope.
    pub(crate) fn empty(&self, label: &str, size: u64, usage: wgpu::BufferUsages) -> wgpu::Buffer {
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size,
            usage,
            mapped_at_creation: false,
        })
    }

    pub(crate) fn bind_group_layout(
        &self,
        label: &str,
        types: &[BindingType],
    ) -> Result<wgpu::BindGroupLayout, RenderError> {
        let types: Vec<_> = (0..).zip(types.iter().copied()).collect();
        self.numbered_layout(label, &types)
    }

    /// As [`Gpu::bind_group_layout`], with the binding's number beside each.
    pub(crate) fn numbered_layout(
        &self,
        label: &str,
        types: &[(u32, BindingType)],
    ) -> Result<wgpu::BindGroupLayout, RenderError> {
        let entries: Vec<_> = types
            .iter()
            .map(|&(binding, ty)| wgpu::BindGroupLayoutEntry {
                binding,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty,
                count: None,
            })
            .collect();
        self.scoped(label, 0, || {
            self.device
                .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                    label: Some(label),
                    entries: &entries,
                })
        })
    }

    pub(crate) fn bind_group<'a>(
        &self,
        label: &str,
        layout: &wgpu::BindGroupLayout,
        resources: impl IntoIterator<Item = wgpu::BindingResource<'a>>,
    ) -> wgpu::BindGroup {
        self.numbered_group(label, layout, (0..).zip(resources))
    }

    /// As [`Gpu::bind_group`], with the binding's number beside each.
    pub(crate) fn numbered_group<'a>(
        &self,
        label: &str,
        layout: &wgpu::BindGroupLayout,
        resources: impl IntoIterator<Item = (u32, wgpu::BindingResource<'a>)>,
    ) -> wgpu::BindGroup {
        let entries: Vec<_> = resources
            .into_iter()
            .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource })
            .collect();
        self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(label),
            layout,
            entries: &entries,
        })
    }
}
