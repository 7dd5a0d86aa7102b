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

pub(crate) fn texture_2d(filterable: bool) -> BindingType {
    texture(TextureViewDimension::D2, filterable)
}

fn texture(view_dimension: TextureViewDimension, filterable: bool) -> BindingType {
    BindingType::Texture {
        sample_type: TextureSampleType::Float { filterable },
        view_dimension,
        multisampled: false,
    }
}

impl Gpu {
    pub(crate) fn bind_group_layout(
        &self,
        label: &str,
        types: &[BindingType],
    ) -> Result<wgpu::BindGroupLayout, RenderError> {
        let entries: Vec<_> = types
            .iter()
            .zip(0..)
            .map(|(&ty, binding)| wgpu::BindGroupLayoutEntry {
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
        let entries: Vec<_> = resources
            .into_iter()
            .zip(0..)
            .map(|(resource, binding)| wgpu::BindGroupEntry { binding, resource })
            .collect();
        self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(label),
            layout,
            entries: &entries,
        })
    }
}
