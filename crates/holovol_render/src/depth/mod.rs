//! Depth of opaque meshes, in metres, for paths to end at.
//!
//! A caller's depth buffers use reversed depth (1 near, 0 far), as Bevy's do. They are copied into
//! layers of one texture that [`FrameTracer`](crate::FrameTracer) reads, so that all views of a
//! dispatch are bound at once, multisampled or not.

use bytemuck::{Pod, Zeroable};
use glam::DMat4;

use crate::layout::uniform;
use crate::shader::{ShaderFile, shader_file};
use crate::{Gpu, RenderError};

pub(crate) const DEPTH: ShaderFile = shader_file!("depth.wgsl");

/// Where a view's depth lies in [`MeshDepth`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DepthLayers {
    /// First layer.
    pub first: u32,
    /// Layers, one for each sample of multisampling.
    pub count: u32,
    /// Pixels across and down.
    pub size: [u32; 2],
}

impl DepthLayers {
    /// All but where they lie: that hangs on the other views.
    pub(crate) fn shape(self) -> (u32, [u32; 2]) {
        (self.count, self.size)
    }
}

/// One view's depth buffer.
#[derive(Clone, Copy, Debug)]
pub struct DepthSource<'a> {
    /// A `Depth32Float` texture with binding usage.
    pub texture: &'a wgpu::TextureView,
    /// Samples per pixel.
    pub samples: u32,
    /// Left, top, width and height of the view in the texture, pixels.
    pub viewport: [u32; 4],
    /// The projection that the depth was drawn with.
    pub clip_from_view: DMat4,
}

/// `Source` of depth.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct SourceUniform {
    pub view_z: [f32; 4],
    pub view_w: [f32; 4],
    pub viewport: [u32; 4],
    pub layers: [u32; 4],
}

/// Depth of opaque meshes for a group of views.
pub struct MeshDepth {
    gpu: Gpu,
    layouts: [wgpu::BindGroupLayout; 2],
    pipelines: [wgpu::ComputePipeline; 2],
    texture: Option<wgpu::Texture>,
    view: Option<wgpu::TextureView>,
}

impl MeshDepth {
    /// Compiles the two small kernels; no memory yet.
    ///
    /// # Errors
    /// If the device fails.
    pub fn new(gpu: &Gpu) -> Result<Self, RenderError> {
        let layout = |multisampled| {
            gpu.bind_group_layout(
                "holovol mesh depth",
                &[
                    uniform(),
                    wgpu::BindingType::Texture {
                        sample_type: wgpu::TextureSampleType::Depth,
                        view_dimension: wgpu::TextureViewDimension::D2,
                        multisampled,
                    },
                    wgpu::BindingType::StorageTexture {
                        access: wgpu::StorageTextureAccess::WriteOnly,
                        format: wgpu::TextureFormat::R32Float,
                        view_dimension: wgpu::TextureViewDimension::D2Array,
                    },
                ],
            )
        };
        let layouts = [layout(false)?, layout(true)?];
        let pipeline = |multisampled: usize| {
            let defs = vec![("MULTISAMPLED", multisampled as u32)];
            gpu.pipeline(&DEPTH, &defs, "depth", &layouts[multisampled])
        };
        Ok(Self {
            gpu: gpu.clone(),
            pipelines: [pipeline(0)?, pipeline(1)?],
            layouts,
            texture: None,
            view: None,
        })
    }

    /// Makes room for `layers` layers of `size` pixels; keeps what is large enough.
    ///
    /// # Errors
    /// If the device has no room.
    pub fn reserve(&mut self, size: [u32; 2], layers: u32) -> Result<(), RenderError> {
        let fits = self.texture.as_ref().is_some_and(|texture| {
            texture.width() >= size[0]
                && texture.height() >= size[1]
                && texture.depth_or_array_layers() >= layers
        });
        if fits || layers == 0 {
            return Ok(());
        }
        let device = &self.gpu.device;
        let bytes = 4 * u64::from(size[0]) * u64::from(size[1]) * u64::from(layers);
        let (texture, view) = self.gpu.scoped("the depth of meshes", bytes, || {
            let texture = device.create_texture(&wgpu::TextureDescriptor {
                label: Some("holovol mesh depth"),
                size: wgpu::Extent3d {
                    width: size[0].max(1),
                    height: size[1].max(1),
                    depth_or_array_layers: layers,
                },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format: wgpu::TextureFormat::R32Float,
                usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::STORAGE_BINDING,
                view_formats: &[],
            });
            let view = texture.create_view(&wgpu::TextureViewDescriptor {
                dimension: Some(wgpu::TextureViewDimension::D2Array),
                ..Default::default()
            });
            (texture, view)
        })?;
        self.texture = Some(texture);
        self.view = Some(view);
        Ok(())
    }

    /// Copies a view's depth into layers that [`Self::reserve`] has made room for.
    ///
    /// # Errors
    /// If the device fails.
    pub fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        source: &DepthSource<'_>,
        first_layer: u32,
    ) -> Result<DepthLayers, RenderError> {
        let Some(view) = &self.view else {
            return Ok(DepthLayers::default());
        };
        let view_from_clip = source.clip_from_view.inverse();
        let row = |i| view_from_clip.row(i).as_vec4().to_array();
        let uniform = SourceUniform {
            view_z: row(2),
            view_w: row(3),
            viewport: source.viewport,
            layers: [first_layer, source.samples, 0, 0],
        };
        let multisampled = usize::from(source.samples > 1);
        let bind_group = self.gpu.scoped("the depth of meshes", 0, || {
            let contents = bytemuck::bytes_of(&uniform);
            let usage = wgpu::BufferUsages::UNIFORM;
            let uniform = self.gpu.filled("holovol mesh depth", contents, usage);
            let resources = [
                uniform.as_entire_binding(),
                wgpu::BindingResource::TextureView(source.texture),
                wgpu::BindingResource::TextureView(view),
            ];
            let layout = &self.layouts[multisampled];
            self.gpu.bind_group("holovol mesh depth", layout, resources)
        })?;
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("holovol mesh depth"),
            timestamp_writes: None,
        });
        pass.set_pipeline(&self.pipelines[multisampled]);
        pass.set_bind_group(0, &bind_group, &[]);
        let [_, _, width, height] = source.viewport;
        pass.dispatch_workgroups(width.div_ceil(8), height.div_ceil(8), 1);
        Ok(DepthLayers {
            first: first_layer,
            count: source.samples,
            size: [width, height],
        })
    }

    pub(crate) fn view(&self) -> Option<&wgpu::TextureView> {
        self.view.as_ref()
    }
}
