//! A frame of the headset in the render world: begun, looked through as late as it goes, drawn, and
//! handed over. Nothing here waits for the runtime's good will: whatever fails ends the session and
//! leaves the app going.

use bevy::prelude::*;
use bevy::render::Extract;
use bevy::render::render_asset::RenderAssets;
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy::render::texture::GpuImage;
use bevy::render::view::ExtractedView;

use super::HeadsetBlend;
use super::blit::Blitter;
use super::capture::EyeCapture;
use super::cost::FrameCost;
use super::eyes::{self, EyeCamera, EyeImages, MixedRealityOrigin};
use super::graphics::Submission;
use super::pose::EyeView;
use super::session::CurrentFrame;

/// What the render world knows of the frame.
#[derive(Resource, Default)]
pub(crate) struct RenderFrame {
    current: CurrentFrame,
    root: GlobalTransform,
    images: Option<EyeImages>,
    is_begun: bool,
    /// What the frame is drawn and submitted with.
    latched: Option<[EyeView; 2]>,
}

pub(crate) fn extract(
    mut frame: ResMut<RenderFrame>,
    current: Extract<Res<CurrentFrame>>,
    images: Extract<Option<Res<EyeImages>>>,
    origin: Extract<Query<&GlobalTransform, With<MixedRealityOrigin>>>,
    cost: Res<FrameCost>,
) {
    let _counting = cost.count();
    frame.current = current.clone();
    frame.images = images.as_deref().cloned();
    frame.root = origin.single().copied().unwrap_or_default();
}

/// Begins the frame and gives the eyes their latest poses and fields of view.
pub(crate) fn begin(
    mut frame: ResMut<RenderFrame>,
    mut views: Query<(&mut ExtractedView, &EyeCamera)>,
    cost: Res<FrameCost>,
) {
    let _counting = cost.count();
    let frame = &mut *frame;
    frame.is_begun = false;
    frame.latched = None;
    let (Some(shared), Some(timing)) = (&frame.current.shared, frame.current.timing) else {
        return;
    };
    frame.is_begun = shared.begin();
    if !frame.is_begun || !timing.should_render || frame.current.views.is_none() {
        return;
    }
    frame.latched = shared.locate(timing.display_time).or(frame.current.views);
    let Some(latched) = &frame.latched else {
        return;
    };
    for (mut extracted, eye) in &mut views {
        if let Some(view) = latched.get(eye.0) {
            extracted.world_from_view = eyes::world_from_eye(&frame.root, view);
            extracted.clip_from_view = eyes::clip_from_view(view.fov);
            extracted.clip_from_world = None;
        }
    }
}

/// Hands over what the eyes have drawn.
pub(crate) fn submit(
    mut frame: ResMut<RenderFrame>,
    images: Res<RenderAssets<GpuImage>>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
    mut blitter: ResMut<Blitter>,
    capture: Res<EyeCapture>,
    cost: Res<FrameCost>,
) {
    let _counting = cost.count();
    let frame = &mut *frame;
    // The session may go with this.
    let current = std::mem::take(&mut frame.current);
    let (Some(shared), Some(timing), true) = (&current.shared, current.timing, frame.is_begun)
    else {
        return;
    };
    frame.is_begun = false;
    let drawn = frame.images.as_ref().and_then(|eyes| {
        let [left, right] = [0, 1].map(|eye: usize| images.get(&eyes.images[eye]));
        Some([left?, right?])
    });
    let mut frames = shared.frames();
    let mut submission = None;
    if let (Some(views), Some(drawn)) = (&frame.latched, drawn) {
        match frames.acquire() {
            Ok(texture) => {
                let sources = drawn.map(|image| &*image.texture_view);
                let (device, queue) = (device.wgpu_device(), &queue.0);
                match blitter.draw(device, queue, sources, &texture) {
                    Ok(()) => {
                        capture.take_from(device, queue, &texture, views, timing.display_time);
                        submission = Some(Submission {
                            space: &shared.space,
                            views,
                            has_opacity: shared.blend == HeadsetBlend::Alpha,
                        });
                    }
                    Err(error) => error_once!("{error}"),
                }
                if let Err(result) = frames.release() {
                    shared.fail("xrReleaseSwapchainImage", result);
                    submission = None;
                }
            }
            Err(result) => shared.fail("xrAcquireSwapchainImage", result),
        }
    }
    if let Err(result) = frames.end(timing.display_time, shared.blend_mode, submission.as_ref()) {
        shared.fail("xrEndFrame", result);
    }
}
