//! Vulkan, through `XR_KHR_vulkan_enable2`: the runtime makes instance and device, with what it
//! needs besides what wgpu asks for.

mod hooks;

use std::ffi::{CStr, c_void};
use std::{fmt, ptr};

use ash::vk::{self, Handle as _};
use bevy::render::render_resource::TextureFormat;
use holovol_render::wgpu::{self, hal};
use openxr::sys::platform::VkGetInstanceProcAddr;
use openxr::{FrameStream, FrameWaiter, Session, Vulkan, sys};

use super::super::HeadsetError;
use super::super::runtime::Runtime;
use super::queue::exclusively;
use super::{Api, DeviceParts};

pub(crate) use hooks::submissions;

/// As wgpu asks for, where it can be had.
const WANTED_VERSION: openxr::Version = openxr::Version::new(1, 3, 0);

/// The device in use, as numbers: what Vulkan calls dispatchable handles.
#[derive(Clone, Copy)]
pub(crate) struct Handles {
    instance: usize,
    physical_device: usize,
    device: usize,
    queue_family_index: u32,
    queue_index: u32,
}

fn failed(what: &'static str) -> impl Fn(&dyn fmt::Display) -> HeadsetError {
    move |error| HeadsetError::Device(format!("{what}: {error}"))
}

/// Opens the device that the runtime wants, with all features it has, experimental ones left out.
#[expect(
    unsafe_code,
    reason = "instance and device of the runtime become wgpu's"
)]
pub(super) fn open_device(runtime: &Runtime) -> Result<(Handles, DeviceParts), HeadsetError> {
    // SAFETY: what has the loader's name is the loader.
    let entry = unsafe { ash::Entry::load() }.map_err(|e| failed("the Vulkan loader")(&e))?;
    let version = choose_version(runtime, &entry)?;
    let flags = wgpu::InstanceFlags::empty().with_env();
    let extensions = hal::vulkan::Instance::desired_extensions(&entry, version, flags)
        .map_err(|e| failed("Vulkan's extensions")(&e))?;
    let instance = create_instance(runtime, &entry, version, &extensions)?;
    let instance_pointer = ptr::with_exposed_provenance(instance.handle().as_raw() as usize);
    // SAFETY: the instance was made by this runtime.
    let physical_device = unsafe {
        runtime
            .instance
            .vulkan_graphics_device(runtime.system, instance_pointer)
    }
    .map_err(HeadsetError::of("xrGetVulkanGraphicsDevice2KHR"))?
    .expose_provenance();
    let physical = vk::PhysicalDevice::from_raw(physical_device as u64);
    // SAFETY: it belongs to the instance.
    let families = unsafe { instance.get_physical_device_queue_family_properties(physical) };
    let wanted = vk::QueueFlags::GRAPHICS | vk::QueueFlags::COMPUTE;
    let queue_family_index = families
        .iter()
        .position(|family| family.queue_flags.contains(wanted))
        .ok_or_else(|| failed("the device")(&"it has no queue for both graphics and compute"))?
        as u32;
    let handles = |device: &ash::Device| Handles {
        instance: instance.handle().as_raw() as usize,
        physical_device,
        device: device.handle().as_raw() as usize,
        queue_family_index,
        queue_index: 0,
    };
    // SAFETY: made with these extensions for this version; wgpu destroys it when it is done.
    let hal_instance = unsafe {
        hal::vulkan::Instance::from_raw(
            entry.clone(),
            instance.clone(),
            version,
            0,
            None,
            extensions,
            flags,
            Default::default(),
            has_optimus(&entry),
            None,
        )
    }
    .map_err(|e| failed("Vulkan's instance")(&e))?;
    let exposed = hal_instance
        .expose_adapter(physical)
        .ok_or_else(|| failed("the device")(&"wgpu can't use it"))?;
    let features = exposed.features - wgpu::Features::all_experimental_mask();
    let limits = exposed.capabilities.limits.clone();
    let extensions = exposed.adapter.required_device_extensions(features);
    let device = create_device(
        runtime,
        &entry,
        &instance,
        physical,
        &exposed.adapter,
        &extensions,
        features,
        queue_family_index,
    )?;
    let handles = handles(&device);
    // SAFETY: made with these extensions and features; wgpu destroys it when it is done.
    unsafe {
        let open = exposed
            .adapter
            .device_from_raw(
                device,
                None,
                &extensions,
                features,
                &limits,
                &wgpu::MemoryHints::Performance,
                queue_family_index,
                0,
            )
            .map_err(|e| failed("the device")(&e))?;
        let instance = wgpu::Instance::from_hal::<hal::api::Vulkan>(hal_instance);
        let adapter = instance.create_adapter_from_hal(exposed);
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("holovol headset"),
            required_features: features,
            required_limits: limits,
            memory_hints: wgpu::MemoryHints::Performance,
            ..Default::default()
        };
        let (device, queue) = adapter
            .create_device_from_hal(open, &descriptor)
            .map_err(|e| failed("the device")(&e))?;
        let parts = DeviceParts {
            instance,
            adapter,
            device,
            queue,
        };
        Ok((handles, parts))
    }
}

/// The newest that wgpu wants, the loader has, and the runtime takes.
#[expect(unsafe_code, reason = "a question to the Vulkan loader")]
fn choose_version(runtime: &Runtime, entry: &ash::Entry) -> Result<u32, HeadsetError> {
    let requirements = runtime
        .instance
        .graphics_requirements::<Vulkan>(runtime.system)
        .map_err(HeadsetError::of("xrGetVulkanGraphicsRequirements2KHR"))?;
    // SAFETY: nothing is asked of it but the version.
    let loader = unsafe { entry.try_enumerate_instance_version() }
        .ok()
        .flatten()
        .unwrap_or(vk::API_VERSION_1_0);
    let [most, least, wanted] = [
        requirements.max_api_version_supported,
        requirements.min_api_version_supported,
        WANTED_VERSION,
    ]
    .map(|version| vk::make_api_version(0, version.major().into(), version.minor().into(), 0));
    let version = wanted.min(loader).min(most.max(least));
    if version < least {
        let message = "the headset's runtime wants a newer Vulkan than there is";
        return Err(failed("Vulkan")(&message));
    }
    Ok(version)
}

#[expect(unsafe_code, reason = "the runtime makes the Vulkan instance")]
fn create_instance(
    runtime: &Runtime,
    entry: &ash::Entry,
    version: u32,
    extensions: &[&CStr],
) -> Result<ash::Instance, HeadsetError> {
    let names: Vec<_> = extensions.iter().map(|name| name.as_ptr()).collect();
    let application = vk::ApplicationInfo::default()
        .application_name(c"holovol")
        .engine_name(c"holovol")
        .api_version(version);
    let info = vk::InstanceCreateInfo::default()
        .application_info(&application)
        .enabled_extension_names(&names);
    // SAFETY: `info` and all that it points to live through the call.
    unsafe {
        let raw = runtime
            .instance
            .create_vulkan_instance(
                runtime.system,
                proc_addr(entry),
                ptr::from_ref(&info).cast::<c_void>(),
            )
            .map_err(HeadsetError::of("xrCreateVulkanInstanceKHR"))?
            .map_err(|result| failed("Vulkan's instance")(&vk::Result::from_raw(result)))?;
        let handle = vk::Instance::from_raw(raw.expose_provenance() as u64);
        Ok(hooks::load_instance(entry, handle))
    }
}

#[expect(unsafe_code, reason = "the runtime makes the Vulkan device")]
#[expect(clippy::too_many_arguments, reason = "all that a device consists of")]
fn create_device(
    runtime: &Runtime,
    entry: &ash::Entry,
    instance: &ash::Instance,
    physical: vk::PhysicalDevice,
    adapter: &hal::vulkan::Adapter,
    extensions: &[&'static CStr],
    features: wgpu::Features,
    queue_family_index: u32,
) -> Result<ash::Device, HeadsetError> {
    let names: Vec<_> = extensions.iter().map(|name| name.as_ptr()).collect();
    let queues = [vk::DeviceQueueCreateInfo::default()
        .queue_family_index(queue_family_index)
        .queue_priorities(&[1.0])];
    let mut enabled = adapter.physical_device_features(extensions, features);
    let info = enabled
        .add_to_device_create(vk::DeviceCreateInfo::default().queue_create_infos(&queues))
        .enabled_extension_names(&names);
    let physical = ptr::with_exposed_provenance(physical.as_raw() as usize);
    // SAFETY: `info` and all that it points to live through the call.
    unsafe {
        let raw = runtime
            .instance
            .create_vulkan_device(
                runtime.system,
                proc_addr(entry),
                physical,
                ptr::from_ref(&info).cast::<c_void>(),
            )
            .map_err(HeadsetError::of("xrCreateVulkanDeviceKHR"))?
            .map_err(|result| failed("the device")(&vk::Result::from_raw(result)))?;
        let handle = vk::Device::from_raw(raw.expose_provenance() as u64);
        hooks::add_device(entry, instance, handle, queue_family_index)
            .ok_or_else(|| failed("the device")(&"its driver lacks functions of Vulkan 1.0"))
    }
}

/// The same function as openxr types it.
#[expect(unsafe_code, reason = "two crates' types of one function")]
fn proc_addr(entry: &ash::Entry) -> VkGetInstanceProcAddr {
    let function: vk::PFN_vkGetInstanceProcAddr = entry.static_fn().get_instance_proc_addr;
    // SAFETY: both are `vkGetInstanceProcAddr`: a dispatchable handle is a pointer.
    unsafe { std::mem::transmute::<vk::PFN_vkGetInstanceProcAddr, VkGetInstanceProcAddr>(function) }
}

/// wgpu minds Nvidia's layer for laptops.
#[expect(unsafe_code, reason = "a question to the Vulkan loader")]
fn has_optimus(entry: &ash::Entry) -> bool {
    // SAFETY: nothing is asked of it but names.
    let layers = unsafe { entry.enumerate_instance_layer_properties() }.unwrap_or_default();
    let is_optimus =
        |layer: &vk::LayerProperties| layer.layer_name_as_c_str() == Ok(c"VK_LAYER_NV_optimus");
    layers.iter().any(is_optimus)
}

impl Handles {
    /// As long as the device is there, its handle is no other's.
    #[expect(unsafe_code, reason = "a look at the device behind wgpu's")]
    pub(super) fn is_of(&self, device: &wgpu::Device) -> bool {
        // SAFETY: nothing is done with it.
        let device = unsafe { device.as_hal::<hal::api::Vulkan>() };
        let handle = device.map(|device| device.raw_device().handle().as_raw() as usize);
        handle == Some(self.device)
    }

    /// A session on this device. It keeps the device.
    ///
    /// After the loss of an instance, the new one gets the device that was made for the former: what
    /// counts is the physical device that the runtime names.
    ///
    /// # Errors
    /// [`HeadsetError::OtherDevice`] if that is another, or if the runtime doesn't take a device that
    /// was made for another instance.
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
        let pointer = ptr::with_exposed_provenance::<c_void>;
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
        let guard = Box::new(device.clone());
        // SAFETY: the handles are those of `device`, which the session keeps.
        exclusively(|| unsafe {
            runtime
                .instance
                .create_session_with_guard::<Vulkan>(runtime.system, &info, guard)
        })
        .map_err(|result| match result {
            sys::Result::ERROR_GRAPHICS_DEVICE_INVALID => HeadsetError::OtherDevice,
            _ => HeadsetError::of("xrCreateSession")(result),
        })
    }
}

impl Api for Vulkan {
    fn format(format: TextureFormat) -> Option<Self::Format> {
        let format = match format {
            TextureFormat::Rgba8UnormSrgb => vk::Format::R8G8B8A8_SRGB,
            TextureFormat::Bgra8UnormSrgb => vk::Format::B8G8R8A8_SRGB,
            TextureFormat::Rgba16Float => vk::Format::R16G16B16A16_SFLOAT,
            TextureFormat::Depth32Float => vk::Format::D32_SFLOAT,
            TextureFormat::Depth16Unorm => vk::Format::D16_UNORM,
            _ => return None,
        };
        u32::try_from(format.as_raw()).ok()
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
        let drawn = if format.has_depth_aspect() {
            wgpu::TextureUses::DEPTH_STENCIL_WRITE
        } else {
            wgpu::TextureUses::COLOR_TARGET
        };
        let hal_descriptor = hal::TextureDescriptor {
            label: Some("holovol headset"),
            size,
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: drawn | wgpu::TextureUses::COPY_SRC,
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
        // and outlives the texture. Without a callback wgpu would destroy the image, which isn't
        // ours.
        unsafe {
            let hal_device = device
                .as_hal::<hal::api::Vulkan>()
                .ok_or_else(|| failed("the device")(&"it is no Vulkan device"))?;
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
