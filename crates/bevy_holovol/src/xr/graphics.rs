//! Between graphics interfaces and the rest: all that depends on which one it is.
//!
//! [`GraphicsApi`] opens sessions, [`Frames`] hands pictures over; beyond this file and its backends
//! nothing knows of Vulkan. A backend for Direct3D 12, which Holographic Remoting needs, is one more
//! [`Api`] and one more variant: device from the LUID that the runtime names, import of
//! `ID3D12Resource`s through wgpu-hal.

mod queue;
// wgpu has no Vulkan on Apple's systems, nor have they OpenXR runtimes.
#[cfg(not(target_vendor = "apple"))]
mod vulkan;

use std::sync::Arc;

use bevy::render::render_resource::TextureFormat;
use bevy::render::renderer::{
    RenderAdapter, RenderAdapterInfo, RenderDevice, RenderInstance, RenderQueue, WgpuWrapper,
};
use bevy::render::settings::RenderCreation;
use holovol_render::wgpu;
use openxr::{
    AnyGraphics, CompositionLayerFlags, CompositionLayerProjection, CompositionLayerProjectionView,
    EnvironmentBlendMode, Extent2Di, Fovf, FrameStream, FrameWaiter, Offset2Di, Rect2Di, Session,
    Space, Swapchain, SwapchainCreateFlags, SwapchainCreateInfo, SwapchainSubImage,
    SwapchainUsageFlags, Time, sys,
};

use super::HeadsetError;
use super::pose::{EyeView, posef};
use super::runtime::Runtime;
pub(crate) use queue::Exclusive;
use queue::exclusively;

/// Formats of pictures, the best first.
const FORMATS: [TextureFormat; 3] = [
    TextureFormat::Rgba8UnormSrgb,
    TextureFormat::Bgra8UnormSrgb,
    TextureFormat::Rgba16Float,
];
/// Of depth. With reversed depth 16 bits still tell 1 mm at 1 m apart, and headsets stream those.
const DEPTH_FORMATS: [TextureFormat; 2] =
    [TextureFormat::Depth32Float, TextureFormat::Depth16Unorm];

/// The device that the runtime wants, and where it comes from.
#[derive(Clone)]
pub(crate) struct DeviceParts {
    pub(crate) instance: wgpu::Instance,
    pub(crate) adapter: wgpu::Adapter,
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
}

/// How often wgpu has submitted to queues that it shares with runtimes: for tests.
pub fn queue_submissions() -> u64 {
    #[cfg(not(target_vendor = "apple"))]
    {
        vulkan::submissions()
    }
    #[cfg(target_vendor = "apple")]
    0
}

impl DeviceParts {
    /// For Bevy to render with.
    pub(crate) fn into_creation(self) -> RenderCreation {
        let info = self.adapter.get_info();
        RenderCreation::manual(
            RenderDevice::from(self.device),
            RenderQueue(Arc::new(WgpuWrapper::new(self.queue))),
            RenderAdapterInfo(WgpuWrapper::new(info)),
            RenderAdapter(Arc::new(WgpuWrapper::new(self.adapter))),
            RenderInstance(Arc::new(WgpuWrapper::new(self.instance))),
        )
    }
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

    /// Whether it is the device in use. wgpu's own comparison tells devices of one instance apart,
    /// and no others.
    pub(crate) fn is_of(&self, device: &wgpu::Device) -> bool {
        match *self {
            #[cfg(not(target_vendor = "apple"))]
            Self::Vulkan(ref handles) => handles.is_of(device),
        }
    }

    /// A session on the device in use, which must be the one that the runtime wants.
    pub(crate) fn open_session(
        &self,
        runtime: &Runtime,
        device: &wgpu::Device,
        size: [u32; 2],
        wants_depth: bool,
    ) -> Result<OpenSession, HeadsetError> {
        match *self {
            #[cfg(not(target_vendor = "apple"))]
            Self::Vulkan(ref handles) => {
                let (session, waiter, stream) = handles.create_session(runtime, device)?;
                let keeps = Exclusive::new(session.clone().into_any_graphics());
                OpenSession::new(keeps, session, waiter, stream, device, size, wants_depth)
            }
        }
    }
}

/// A graphics interface.
trait Api: openxr::Graphics + Send + Sync + 'static {
    /// Its number for a format.
    fn format(format: TextureFormat) -> Option<Self::Format>;

    /// The runtime's image with two layers, of colour or of depth by its format, as a texture that
    /// is drawn into and copied from. The texture doesn't own the image.
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
    pub(crate) depth_format: Option<TextureFormat>,
    pub(crate) size: [u32; 2],
    /// Dropped last: what keeps the session until all else of it is gone.
    pub(crate) keeps: Exclusive<Session<AnyGraphics>>,
}

impl OpenSession {
    // Parameters are dropped from the last to the first.
    fn new<G: Api>(
        keeps: Exclusive<Session<AnyGraphics>>,
        session: Session<G>,
        waiter: FrameWaiter,
        stream: FrameStream<G>,
        device: &wgpu::Device,
        size: [u32; 2],
        wants_depth: bool,
    ) -> Result<Self, HeadsetError>
    where
        G::Format: PartialEq + std::fmt::Debug,
    {
        let offered = session
            .enumerate_swapchain_formats()
            .map_err(HeadsetError::of("xrEnumerateSwapchainFormats"))?;
        let usage = SwapchainUsageFlags::COLOR_ATTACHMENT | SwapchainUsageFlags::SAMPLED;
        let color = Images::new(&session, device, &offered, &FORMATS, usage, size)?;
        let color = color.ok_or_else(|| HeadsetError::NoFormat {
            wanted: format!("{FORMATS:?}"),
            found: format!("{offered:?}"),
        })?;
        let depth = if wants_depth {
            let usage = SwapchainUsageFlags::DEPTH_STENCIL_ATTACHMENT;
            Images::new(&session, device, &offered, &DEPTH_FORMATS, usage, size)?
        } else {
            None
        };
        Ok(Self {
            session: session.into_any_graphics(),
            waiter,
            format: color.format,
            depth_format: depth.as_ref().map(|depth| depth.format),
            frames: Box::new(FramesOf {
                device: device.clone(),
                color,
                depth,
                stream,
                size,
            }),
            size,
            keeps,
        })
    }
}

/// An image of the headset with a layer for each eye, the left one first.
#[derive(Clone)]
pub(crate) struct EyeLayers {
    pub(crate) texture: wgpu::Texture,
    pub(crate) views: [wgpu::TextureView; 2],
}

impl EyeLayers {
    fn new(texture: wgpu::Texture) -> Self {
        let views = [0, 1].map(|layer| {
            texture.create_view(&wgpu::TextureViewDescriptor {
                dimension: Some(wgpu::TextureViewDimension::D2),
                base_array_layer: layer,
                array_layer_count: Some(1),
                ..Default::default()
            })
        });
        Self { texture, views }
    }
}

/// What a frame is drawn into.
#[derive(Clone)]
pub(crate) struct EyeTargets {
    pub(crate) color: EyeLayers,
    /// Where the compositor takes depth.
    pub(crate) depth: Option<EyeLayers>,
}

/// The depth of a frame, and how to read it: 1 lies `near` m away along the eye's axis, 0 at
/// infinity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SubmittedDepth {
    pub(crate) near: f32,
}

/// What a frame shows.
pub(crate) struct Submission<'a> {
    pub(crate) space: &'a Space,
    pub(crate) views: &'a [EyeView; 2],
    /// The images' opacity counts.
    pub(crate) has_opacity: bool,
    /// Their depth, if it was drawn.
    pub(crate) depth: Option<SubmittedDepth>,
}

/// The pictures of a session, one frame after the other.
pub(crate) trait Frames: Send {
    /// Work on the frame begins.
    fn begin(&mut self) -> Result<(), sys::Result>;

    /// The textures to draw into, once the compositor has let go of them.
    fn acquire(&mut self) -> Result<EyeTargets, sys::Result>;

    /// All that draws into the textures has been submitted.
    fn release(&mut self) -> Result<(), sys::Result>;

    /// The frame is done; without a submission it shows nothing.
    fn end(
        &mut self,
        time: Time,
        blend_mode: EnvironmentBlendMode,
        submission: Option<&Submission<'_>>,
    ) -> Result<(), sys::Result>;
}

/// A swapchain with its images. Fields are dropped in this order.
struct Images<G: openxr::Graphics> {
    layers: Vec<EyeLayers>,
    swapchain: Exclusive<Swapchain<G>>,
    format: TextureFormat,
    /// Between [`Frames::acquire`] and [`Frames::release`].
    is_acquired: bool,
}

impl<G: Api> Images<G> {
    /// In the first of the `wanted` formats that is offered.
    fn new(
        session: &Session<G>,
        device: &wgpu::Device,
        offered: &[G::Format],
        wanted: &[TextureFormat],
        usage: SwapchainUsageFlags,
        size: [u32; 2],
    ) -> Result<Option<Self>, HeadsetError>
    where
        G::Format: PartialEq,
    {
        let found = wanted
            .iter()
            .filter_map(|&format| Some((format, G::format(format)?)))
            .find(|(_, number)| offered.contains(number));
        let Some((format, number)) = found else {
            return Ok(None);
        };
        let info = SwapchainCreateInfo {
            create_flags: SwapchainCreateFlags::EMPTY,
            // Copied from for mirrors and tests.
            usage_flags: usage | SwapchainUsageFlags::TRANSFER_SRC,
            format: number,
            sample_count: 1,
            width: size[0],
            height: size[1],
            face_count: 1,
            array_size: 2,
            mip_count: 1,
        };
        let swapchain = exclusively(|| session.create_swapchain(&info).map(Exclusive::new))
            .map_err(HeadsetError::of("xrCreateSwapchain"))?;
        let layers = swapchain
            .enumerate_images()
            .map_err(HeadsetError::of("xrEnumerateSwapchainImages"))?
            .into_iter()
            .map(|image| G::import(image, device, format, size).map(EyeLayers::new))
            .collect::<Result<Vec<_>, _>>()?;
        Ok(Some(Self {
            layers,
            swapchain,
            format,
            is_acquired: false,
        }))
    }

    fn acquire(&mut self) -> Result<EyeLayers, sys::Result> {
        let index = exclusively(|| self.swapchain.acquire_image())?;
        // Without the queue, by specification. openxr 0.21 can't tell a timeout from success, so
        // there is none; a lost runtime ends it.
        self.swapchain.wait_image(openxr::Duration::INFINITE)?;
        self.is_acquired = true;
        let layers = self.layers.get(index as usize).cloned();
        layers.ok_or(sys::Result::ERROR_RUNTIME_FAILURE)
    }

    fn release(&mut self) -> Result<(), sys::Result> {
        if std::mem::take(&mut self.is_acquired) {
            exclusively(|| self.swapchain.release_image())?;
        }
        Ok(())
    }
}

impl<G: openxr::Graphics> Images<G> {
    fn part<'a>(&'a self, eye: usize, [width, height]: [u32; 2]) -> SwapchainSubImage<'a, G> {
        SwapchainSubImage::new()
            .swapchain(&self.swapchain)
            .image_array_index(eye as u32)
            .image_rect(Rect2Di {
                offset: Offset2Di { x: 0, y: 0 },
                extent: Extent2Di {
                    width: width as i32,
                    height: height as i32,
                },
            })
    }
}

/// Fields are dropped in this order: textures, the images behind them, the session.
struct FramesOf<G: openxr::Graphics> {
    device: wgpu::Device,
    color: Images<G>,
    depth: Option<Images<G>>,
    stream: FrameStream<G>,
    size: [u32; 2],
}

impl<G: Api> Frames for FramesOf<G> {
    fn begin(&mut self) -> Result<(), sys::Result> {
        exclusively(|| self.stream.begin())
    }

    fn acquire(&mut self) -> Result<EyeTargets, sys::Result> {
        Ok(EyeTargets {
            color: self.color.acquire()?,
            depth: self.depth.as_mut().map(Images::acquire).transpose()?,
        })
    }

    fn release(&mut self) -> Result<(), sys::Result> {
        self.color.release()?;
        self.depth.as_mut().map_or(Ok(()), Images::release)
    }

    fn end(
        &mut self,
        time: Time,
        blend_mode: EnvironmentBlendMode,
        submission: Option<&Submission<'_>>,
    ) -> Result<(), sys::Result> {
        let Some(submission) = submission else {
            return exclusively(|| self.stream.end(time, blend_mode, &[]));
        };
        let depth = self.depth.as_ref().zip(submission.depth);
        // What the views below point to.
        let depths = depth.map(|(images, depth)| {
            [0, 1].map(|eye| depth_info(images.part(eye, self.size), depth))
        });
        let views = [0, 1].map(|eye: usize| {
            let view = &submission.views[eye];
            let shown = CompositionLayerProjectionView::new()
                .pose(posef(&view.pose))
                .fov(fovf(view))
                .sub_image(self.color.part(eye, self.size));
            with_depth(shown, depths.as_ref().map(|depths| &depths[eye]))
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
        exclusively(|| self.stream.end(time, blend_mode, &[&layer]))
    }
}

fn depth_info<G: openxr::Graphics>(
    part: SwapchainSubImage<'_, G>,
    depth: SubmittedDepth,
) -> sys::CompositionLayerDepthInfoKHR {
    sys::CompositionLayerDepthInfoKHR {
        ty: sys::CompositionLayerDepthInfoKHR::TYPE,
        next: std::ptr::null(),
        sub_image: part.into_raw(),
        min_depth: 0.0,
        max_depth: 1.0,
        // Reversed: the least depth is farthest away.
        near_z: f32::INFINITY,
        far_z: depth.near,
    }
}

/// openxr has no builder for chains.
#[expect(
    unsafe_code,
    reason = "a chain of structures of the runtime's interface"
)]
fn with_depth<'a, G: openxr::Graphics>(
    view: CompositionLayerProjectionView<'a, G>,
    depth: Option<&'a sys::CompositionLayerDepthInfoKHR>,
) -> CompositionLayerProjectionView<'a, G> {
    let mut raw = view.into_raw();
    raw.next = depth.map_or(std::ptr::null(), |depth| std::ptr::from_ref(depth).cast());
    // SAFETY: the same view, and what it now points to lives as long as the view.
    unsafe { CompositionLayerProjectionView::from_raw(raw) }
}

impl<G: openxr::Graphics> Drop for FramesOf<G> {
    fn drop(&mut self) {
        // The runtime frees the images: nothing may be drawing into them. A lost device is idle.
        let _ = self.device.poll(wgpu::PollType::wait_indefinitely());
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
