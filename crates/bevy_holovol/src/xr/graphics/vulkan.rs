//! Vulkan, through `XR_KHR_vulkan_enable2`.

use std::ptr;

use ash::vk::{self, Handle as _};
use bevy::render::render_resource::TextureFormat;
use bevy_mod_openxr::graphics::GraphicsExt;
use bevy_mod_openxr::types::{AppInfo, WgpuGraphics};
use holovol_render::wgpu::{self, hal};
use openxr::{FrameStream, FrameWaiter, Session, Vulkan};

use super::super::HeadsetError;
use super::super::runtime::Runtime;
use super::Api;

/// The device in use, as numbers: what Vulkan calls dispatchable handles.
#[derive(Clone, Copy)]
pub(crate) struct Handles {
    instance: usize,
    physical_device: usize,
    device: usize,
    queue_family_index: u32,
    queue_index: u32,
}

/// Opens the device that the runtime wants, with all features it has.
pub(super) fn open_device(runtime: &Runtime) -> Result<(Handles, WgpuGraphics), HeadsetError> {
    let app = AppInfo::default();
    let (parts, info) = Vulkan::init_graphics(&app, &runtime.instance, runtime.system, None)
        .map_err(|error| HeadsetError::Device(error.to_string()))?;
    let handles = Handles {
        instance: info.instance.expose_provenance(),
        physical_device: info.physical_device.expose_provenance(),
        device: info.device.expose_provenance(),
        queue_family_index: info.queue_family_index,
        queue_index: info.queue_index,
    };
    Ok((handles, parts))
}

impl Handles {
    /// A session on this device. It keeps the device.
    ///
    /// After the loss of an instance, the new one gets the device that was made for the former: the
    /// specification wants device and instance of one system, not of one `XrInstance`, as long as the
    /// runtime names the same physical device. If it doesn't, that is an error.
    #[expect(
        unsafe_code,
        reason = "handles of the graphics device cross to the runtime"
    )]
    pub(super) fn create_session(
        &self,
        runtime: &Runtime,
        device: &wgpu::Device,
    ) -> Result<(Session<Vulkan>, FrameWaiter, FrameStream<Vulkan>), HeadsetError> {
        // Runtimes refuse sessions of who hasn't asked.
        runtime
            .instance
            .graphics_requirements::<Vulkan>(runtime.system)
            .map_err(HeadsetError::of("xrGetVulkanGraphicsRequirements2KHR"))?;
        let pointer = ptr::with_exposed_provenance::<std::ffi::c_void>;
        // SAFETY: the instance lives as long as `device`, which the caller has.
        let wanted = unsafe {
            runtime
                .instance
                .vulkan_graphics_device(runtime.system, pointer(self.instance))
        }
        .map_err(HeadsetError::of("xrGetVulkanGraphicsDevice2KHR"))?;
        if wanted.addr() != self.physical_device {
            return Err(HeadsetError::OtherDevice);
        }
        let info = openxr::vulkan::SessionCreateInfo {
            instance: pointer(self.instance),
            physical_device: pointer(self.physical_device),
            device: pointer(self.device),
            queue_family_index: self.queue_family_index,
            queue_index: self.queue_index,
        };
        // SAFETY: the handles are those of `device`, which the session keeps.
        unsafe {
            runtime.instance.create_session_with_guard::<Vulkan>(
                runtime.system,
                &info,
                Box::new(device.clone()),
            )
        }
        .map_err(HeadsetError::of("xrCreateSession"))
    }
}

impl Api for Vulkan {
    fn format(format: TextureFormat) -> Option<Self::Format> {
        Self::from_wgpu_format(format)
    }

    #[expect(unsafe_code, reason = "an image of the runtime becomes a texture")]
    fn import(
        image: Self::SwapchainImage,
        device: &wgpu::Device,
        format: TextureFormat,
        [width, height]: [u32; 2],
    ) -> Result<wgpu::Texture, HeadsetError> {
        let size = wgpu::Extent3d {
            width,
            height,
            depth_or_array_layers: 2,
        };
        let hal_descriptor = hal::TextureDescriptor {
            label: Some("holovol headset"),
            size,
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: wgpu::TextureUses::COLOR_TARGET | wgpu::TextureUses::COPY_SRC,
            memory_flags: hal::MemoryFlags::empty(),
            view_formats: Vec::new(),
        };
        let descriptor = wgpu::TextureDescriptor {
            label: Some("holovol headset"),
            size,
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        };
        // SAFETY: the image was made by the runtime with these sizes, this format and these usages,
        // and outlives the texture. Without a callback wgpu would destroy the image, which isn't ours.
        unsafe {
            let hal_device = device
                .as_hal::<hal::api::Vulkan>()
                .ok_or_else(|| HeadsetError::Device("it is no Vulkan device".into()))?;
            let texture = hal_device.texture_from_raw(
                vk::Image::from_raw(image),
                &hal_descriptor,
                Some(Box::new(|| {})),
                hal::vulkan::TextureMemory::External,
            );
            Ok(device.create_texture_from_hal::<hal::api::Vulkan>(texture, &descriptor))
        }
    }
}
