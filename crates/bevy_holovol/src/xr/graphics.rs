//! Between graphics interfaces and the rest: all that depends on which one it is.
//!
//! [`GraphicsApi`] opens sessions, [`Frames`] hands pictures over; beyond this file and its backends
//! nothing knows of Vulkan. A backend for Direct3D 12, which Holographic Remoting needs, is one more
//! [`Api`] and one more variant: device from the LUID that the runtime names, import of
//! `ID3D12Resource`s through wgpu-hal.

// wgpu has no Vulkan on Apple's systems, nor have they OpenXR runtimes.
#[cfg(not(target_vendor = "apple"))]
mod vulkan;

use bevy::render::render_resource::TextureFormat;
use holovol_render::wgpu;
use openxr::{
    AnyGraphics, CompositionLayerFlags, CompositionLayerProjection, CompositionLayerProjectionView,
    EnvironmentBlendMode, Extent2Di, Fovf, FrameStream, FrameWaiter, Offset2Di, Posef, Quaternionf,
    Rect2Di, Session, Space, Swapchain, SwapchainCreateFlags, SwapchainCreateInfo,
    SwapchainSubImage, SwapchainUsageFlags, Time, Vector3f, sys,
};

use super::HeadsetError;
use super::pose::EyeView;
use super::runtime::Runtime;

/// Formats of pictures, the best first.
const FORMATS: [TextureFormat; 3] = [
    TextureFormat::Rgba8UnormSrgb,
    TextureFormat::Bgra8UnormSrgb,
    TextureFormat::Rgba16Float,
];

/// The device that the runtime wants, and where it comes from.
pub(crate) struct DeviceParts {
    pub(crate) instance: wgpu::Instance,
    pub(crate) adapter: wgpu::Adapter,
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
}

/// The device in use, as the runtime knows it.
#[derive(Clone)]
pub(crate) enum GraphicsApi {
    #[cfg(not(target_vendor = "apple"))]
    Vulkan(vulkan::Handles),
}

impl GraphicsApi {
    /// Opens the device that the runtime wants.
    pub(crate) fn open_device(runtime: &Runtime) -> Result<(Self, DeviceParts), HeadsetError> {
        #[cfg(not(target_vendor = "apple"))]
        {
            let (handles, parts) = vulkan::open_device(runtime)?;
            Ok((Self::Vulkan(handles), parts))
        }
        #[cfg(target_vendor = "apple")]
        Err(HeadsetError::NoVulkan {
            runtime: runtime.name.clone(),
        })
    }

    /// A session on the device in use, which must be the one that the runtime wants.
    pub(crate) fn open_session(
        &self,
        runtime: &Runtime,
        device: &wgpu::Device,
        size: [u32; 2],
    ) -> Result<OpenSession, HeadsetError> {
        match *self {
            #[cfg(not(target_vendor = "apple"))]
            Self::Vulkan(ref handles) => {
                let (session, waiter, stream) = handles.create_session(runtime, device)?;
                OpenSession::new(session, waiter, stream, device, size)
            }
        }
    }
}

/// A graphics interface.
trait Api: openxr::Graphics + Send + Sync + 'static {
    /// Its number for a format.
    fn format(format: TextureFormat) -> Option<Self::Format>;

    /// The runtime's image with two layers as a texture that is drawn into and copied from. The
    /// texture doesn't own the image.
    fn import(
        image: Self::SwapchainImage,
        device: &wgpu::Device,
        format: TextureFormat,
        size: [u32; 2],
    ) -> Result<wgpu::Texture, HeadsetError>;
}

/// A session and what goes with it.
pub(crate) struct OpenSession {
    pub(crate) session: Session<AnyGraphics>,
    pub(crate) waiter: FrameWaiter,
    pub(crate) frames: Box<dyn Frames>,
    pub(crate) format: TextureFormat,
    pub(crate) size: [u32; 2],
}

impl OpenSession {
    fn new<G: Api>(
        session: Session<G>,
        waiter: FrameWaiter,
        stream: FrameStream<G>,
        device: &wgpu::Device,
        size: [u32; 2],
    ) -> Result<Self, HeadsetError>
    where
        G::Format: PartialEq + std::fmt::Debug,
    {
        let offered = session
            .enumerate_swapchain_formats()
            .map_err(HeadsetError::of("xrEnumerateSwapchainFormats"))?;
        let (format, number) = FORMATS
            .into_iter()
            .filter_map(|format| Some((format, G::format(format)?)))
            .find(|(_, number)| offered.contains(number))
            .ok_or_else(|| HeadsetError::NoFormat {
                wanted: format!("{FORMATS:?}"),
                found: format!("{offered:?}"),
            })?;
        let swapchain = session
            .create_swapchain(&SwapchainCreateInfo {
                create_flags: SwapchainCreateFlags::EMPTY,
                // Copied from for mirrors and tests.
                usage_flags: SwapchainUsageFlags::COLOR_ATTACHMENT
                    | SwapchainUsageFlags::SAMPLED
                    | SwapchainUsageFlags::TRANSFER_SRC,
                format: number,
                sample_count: 1,
                width: size[0],
                height: size[1],
                face_count: 1,
                array_size: 2,
                mip_count: 1,
            })
            .map_err(HeadsetError::of("xrCreateSwapchain"))?;
        let images = swapchain
            .enumerate_images()
            .map_err(HeadsetError::of("xrEnumerateSwapchainImages"))?
            .into_iter()
            .map(|image| G::import(image, device, format, size))
            .collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            session: session.into_any_graphics(),
            waiter,
            frames: Box::new(FramesOf {
                device: device.clone(),
                images,
                swapchain,
                stream,
                size,
                is_acquired: false,
            }),
            format,
            size,
        })
    }
}

/// What a frame shows.
pub(crate) struct Submission<'a> {
    pub(crate) space: &'a Space,
    pub(crate) views: &'a [EyeView; 2],
    /// The images' opacity counts.
    pub(crate) has_opacity: bool,
}

/// The pictures of a session, one frame after the other.
pub(crate) trait Frames: Send {
    /// Work on the frame begins.
    fn begin(&mut self) -> Result<(), sys::Result>;

    /// The texture to draw into, once the compositor has let go of it: layer 0 is the left eye's.
    fn acquire(&mut self) -> Result<wgpu::Texture, sys::Result>;

    /// All that draws into the texture has been submitted.
    fn release(&mut self) -> Result<(), sys::Result>;

    /// The frame is done; without a submission it shows nothing.
    fn end(
        &mut self,
        time: Time,
        blend_mode: EnvironmentBlendMode,
        submission: Option<&Submission<'_>>,
    ) -> Result<(), sys::Result>;
}

/// Fields are dropped in this order: textures, the images behind them, the session.
struct FramesOf<G: openxr::Graphics> {
    device: wgpu::Device,
    images: Vec<wgpu::Texture>,
    swapchain: Swapchain<G>,
    stream: FrameStream<G>,
    size: [u32; 2],
    /// Between [`Frames::acquire`] and [`Frames::release`].
    is_acquired: bool,
}

impl<G: Api> Frames for FramesOf<G> {
    fn begin(&mut self) -> Result<(), sys::Result> {
        self.stream.begin()
    }

    fn acquire(&mut self) -> Result<wgpu::Texture, sys::Result> {
        let index = self.swapchain.acquire_image()?;
        // openxr 0.21 can't tell a timeout from success, so there is none; a lost runtime ends it.
        self.swapchain.wait_image(openxr::Duration::INFINITE)?;
        self.is_acquired = true;
        let image = self.images.get(index as usize).cloned();
        image.ok_or(sys::Result::ERROR_RUNTIME_FAILURE)
    }

    fn release(&mut self) -> Result<(), sys::Result> {
        if std::mem::take(&mut self.is_acquired) {
            self.swapchain.release_image()?;
        }
        Ok(())
    }

    fn end(
        &mut self,
        time: Time,
        blend_mode: EnvironmentBlendMode,
        submission: Option<&Submission<'_>>,
    ) -> Result<(), sys::Result> {
        let Some(submission) = submission else {
            return self.stream.end(time, blend_mode, &[]);
        };
        let rect = Rect2Di {
            offset: Offset2Di { x: 0, y: 0 },
            extent: Extent2Di {
                width: self.size[0] as i32,
                height: self.size[1] as i32,
            },
        };
        let swapchain = &self.swapchain;
        let views = [0, 1].map(|eye: usize| {
            let view = &submission.views[eye];
            CompositionLayerProjectionView::new()
                .pose(posef(view))
                .fov(fovf(view))
                .sub_image(
                    SwapchainSubImage::new()
                        .swapchain(swapchain)
                        .image_array_index(eye as u32)
                        .image_rect(rect),
                )
        });
        let flags = if submission.has_opacity {
            CompositionLayerFlags::BLEND_TEXTURE_SOURCE_ALPHA
        } else {
            CompositionLayerFlags::EMPTY
        };
        let layer = CompositionLayerProjection::new()
            .layer_flags(flags)
            .space(submission.space)
            .views(&views);
        self.stream.end(time, blend_mode, &[&layer])
    }
}

impl<G: openxr::Graphics> Drop for FramesOf<G> {
    fn drop(&mut self) {
        // The runtime frees the images: nothing may be drawing into them. A lost device is idle.
        let _ = self.device.poll(wgpu::PollType::wait_indefinitely());
    }
}

fn posef(view: &EyeView) -> Posef {
    let [x, y, z, w] = view.pose.rotation.to_array();
    let [px, py, pz] = view.pose.translation.to_array();
    Posef {
        orientation: Quaternionf { x, y, z, w },
        position: Vector3f {
            x: px,
            y: py,
            z: pz,
        },
    }
}

fn fovf(view: &EyeView) -> Fovf {
    Fovf {
        angle_left: view.fov.left,
        angle_right: view.fov.right,
        angle_up: view.fov.up,
        angle_down: view.fov.down,
    }
}
