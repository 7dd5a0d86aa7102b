//! A frame of the headset in the render world: begun, looked through as late as it goes, drawn, and
//! handed over. Nothing here waits for the runtime's good will: whatever fails ends the session and
//! leaves the app going.

use bevy::core_pipeline::prepass::ViewPrepassTextures;
use bevy::prelude::*;
use bevy::render::Extract;
use bevy::render::render_asset::RenderAssets;
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy::render::sync_world::MainEntity;
use bevy::render::texture::GpuImage;
use bevy::render::view::ExtractedView;
use holovol_render::{ViewDepthTarget, wgpu};

use super::HeadsetBlend;
use super::capture::EyeCapture;
use super::cost::FrameCost;
use super::eyes::{self, EyeCamera, EyeImages, MixedRealityOrigin};
use super::graphics::{EyeLayers, EyeTargets, Submission, SubmittedDepth};
use super::pose::EyeView;
use super::screen::{Screen, ScreenPass};
use super::session::CurrentFrame;
use crate::render::VolumeGpu;
use crate::render::view_depth::ViewDepths;

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

type DrawnEye<'a> = (
    &'a EyeCamera,
    &'a MainEntity,
    &'a ExtractedView,
    Option<&'a ViewPrepassTextures>,
    &'a Msaa,
);

/// Hands over what the eyes have drawn.
#[expect(clippy::too_many_arguments, reason = "all that a frame consists of")]
pub(crate) fn submit(
    mut frame: ResMut<RenderFrame>,
    images: Res<RenderAssets<GpuImage>>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
    eyes: Query<DrawnEye>,
    volumes: Option<Res<VolumeGpu>>,
    mut depths: ResMut<ViewDepths>,
    mut screen: ResMut<Screen>,
    capture: Res<EyeCapture>,
    cost: Res<FrameCost>,
) {
    let _counting = cost.count();
    screen.end_frame();
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
            Ok(targets) => {
                let (device, queue) = (device.wgpu_device(), &queue.0);
                let sources = drawn.map(|image| &*image.texture_view);
                let prepared = prepare(&mut screen, device, &targets.color, sources);
                if let Err(error) = &prepared {
                    error_once!("{error}");
                }
                let _in_driver = cost.in_driver();
                let mut encoder = device.create_command_encoder(&Default::default());
                for (source, target) in sources.iter().zip(&targets.color.views) {
                    let format = targets.color.texture.format();
                    screen.draw(&mut encoder, ScreenPass::Copy, source, target, format);
                }
                let depth = draw_depth(
                    &mut depths,
                    volumes.as_deref(),
                    &mut encoder,
                    &eyes,
                    &targets,
                );
                queue.submit([encoder.finish()]);
                if prepared.is_ok() {
                    let near = eyes::NEAR;
                    let depth = depth.then_some(SubmittedDepth { near });
                    let time = timing.display_time;
                    capture.take_from(device, queue, &targets, views, depth, time);
                    submission = Some(Submission {
                        space: &shared.space,
                        views,
                        has_opacity: shared.blend == HeadsetBlend::Alpha,
                        depth,
                    });
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

fn prepare(
    screen: &mut Screen,
    device: &wgpu::Device,
    color: &EyeLayers,
    sources: [&wgpu::TextureView; 2],
) -> Result<(), super::screen::ScreenError> {
    for source in sources {
        screen.prepare(device, ScreenPass::Copy, source, color.texture.format())?;
    }
    Ok(())
}

/// Depth of both eyes; false if not both have one.
fn draw_depth(
    depths: &mut ViewDepths,
    volumes: Option<&VolumeGpu>,
    encoder: &mut wgpu::CommandEncoder,
    eyes: &Query<DrawnEye>,
    targets: &EyeTargets,
) -> bool {
    let (Some(layers), Some(volumes)) = (&targets.depth, volumes) else {
        return false;
    };
    depths.begin_frame();
    let mut drawn = [false; 2];
    for (eye, camera, view, prepass, msaa) in eyes {
        // Depth of several samples has no mean.
        let (Some(layer), 1) = (layers.views.get(eye.0), msaa.samples()) else {
            continue;
        };
        let meshes = prepass.and_then(ViewPrepassTextures::depth_view);
        let target = ViewDepthTarget {
            view: layer,
            format: layers.texture.format(),
            size: [layers.texture.width(), layers.texture.height()],
            clip_from_view: view.clip_from_view.as_dmat4(),
        };
        match depths.draw(
            volumes,
            encoder,
            *camera,
            meshes.map(|view| &**view),
            &target,
        ) {
            Ok(is_drawn) => drawn[eye.0] = is_drawn,
            Err(error) => error_once!("{error}"),
        }
    }
    drawn == [true; 2]
}
