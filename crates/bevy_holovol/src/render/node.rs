//! What is recorded: the depth of meshes, the paths of all views, and each view's images.

use bevy::core_pipeline::core_3d::CORE_3D_DEPTH_FORMAT;
use bevy::core_pipeline::prepass::{
    AlphaMask3dPrepass, MOTION_VECTOR_PREPASS_FORMAT, NORMAL_PREPASS_FORMAT, Opaque3dPrepass,
};
use bevy::ecs::schedule::ScheduleLabel;
use bevy::prelude::*;
use bevy::render::camera::ExtractedCamera;
use bevy::render::diagnostic::RecordDiagnostics;
use bevy::render::render_phase::ViewBinnedRenderPhases;
use bevy::render::render_resource::{
    Extent3d, LoadOp, Operations, RenderPassColorAttachment, RenderPassDepthStencilAttachment,
    RenderPassDescriptor, StoreOp, TextureDimension, TextureUsages,
};
use bevy::render::renderer::{CurrentView, RenderContext, ViewQuery};
use bevy::render::sync_world::MainEntity;
use bevy::render::view::{ExtractedView, ViewDepthTexture, ViewTarget};
use holovol_render::{CompositePlace, DepthSource, Gpu, RenderError, wgpu};

use super::VolumeStatistics;
use super::denoise::Denoising;
use super::prepare::{VolumeGpu, composite_target, viewport_size};

/// Runs once for each view in which meshes overlap a volume, before Bevy's cameras.
#[derive(ScheduleLabel, Debug, Clone, PartialEq, Eq, Hash, Default)]
pub(super) struct VolumeDepth;

/// What a view's meshes are drawn into.
#[derive(Clone)]
pub(super) struct DepthTarget {
    shape: DepthTargetShape,
    depth: wgpu::TextureView,
    /// Only to fit pipelines of cameras with further prepasses.
    normals: Option<wgpu::TextureView>,
    motion_vectors: Option<wgpu::TextureView>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct DepthTargetShape {
    pub(super) size: [u32; 2],
    pub(super) samples: u32,
    pub(super) normals: bool,
    pub(super) motion_vectors: bool,
}

impl DepthTarget {
    pub(super) fn new(gpu: &Gpu, shape: DepthTargetShape) -> Result<Self, RenderError> {
        let [width, height] = shape.size;
        let texture = |format, usage| {
            let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
                label: Some("holovol depth of meshes"),
                size: Extent3d {
                    width,
                    height,
                    depth_or_array_layers: 1,
                },
                mip_level_count: 1,
                sample_count: shape.samples,
                dimension: TextureDimension::D2,
                format,
                usage: usage | TextureUsages::RENDER_ATTACHMENT,
                view_formats: &[],
            });
            texture.create_view(&Default::default())
        };
        let scratch = |format| texture(format, TextureUsages::empty());
        let bytes = 4 * u64::from(width) * u64::from(height) * u64::from(shape.samples);
        gpu.scoped("the depth of meshes", bytes, || Self {
            shape,
            depth: texture(CORE_3D_DEPTH_FORMAT, TextureUsages::TEXTURE_BINDING),
            normals: shape.normals.then(|| scratch(NORMAL_PREPASS_FORMAT)),
            motion_vectors: shape
                .motion_vectors
                .then(|| scratch(MOTION_VECTOR_PREPASS_FORMAT)),
        })
    }

    pub(super) fn shape(&self) -> DepthTargetShape {
        self.shape
    }
}

/// Runs [`VolumeDepth`] for the views that the plan names.
pub(super) fn drive_mesh_depth(world: &mut World) {
    let gpu = world.resource::<VolumeGpu>();
    let Some(inner) = &gpu.0 else {
        return;
    };
    let views: Vec<_> = inner
        .depth_plan
        .iter()
        .map(|planned| planned.view)
        .collect();
    for view in views {
        world.insert_resource(CurrentView(view));
        world.run_schedule(VolumeDepth);
        world.remove_resource::<CurrentView>();
    }
}

/// Draws a view's opaque meshes once more, into our own depth, and turns that into metres.
pub(super) fn draw_mesh_depth(
    world: &World,
    view: ViewQuery<&ExtractedView>,
    opaque: Res<ViewBinnedRenderPhases<Opaque3dPrepass>>,
    alpha_mask: Res<ViewBinnedRenderPhases<AlphaMask3dPrepass>>,
    gpu: Res<VolumeGpu>,
    mut ctx: RenderContext,
) {
    let entity = view.entity();
    let extracted = view.into_inner();
    let Some(inner) = &gpu.0 else {
        return;
    };
    let (Some(planned), Some(opaque), Some(alpha_mask)) = (
        inner
            .depth_plan
            .iter()
            .find(|planned| planned.view == entity),
        opaque.get(&extracted.retained_view_entity),
        alpha_mask.get(&extracted.retained_view_entity),
    ) else {
        return;
    };
    let target = &planned.target;
    let DepthTargetShape { size, samples, .. } = target.shape;
    let mut color_attachments: Vec<_> = [&target.normals, &target.motion_vectors]
        .into_iter()
        .map(|scratch| {
            scratch.as_ref().map(|view| RenderPassColorAttachment {
                view,
                depth_slice: None,
                resolve_target: None,
                ops: Operations {
                    load: LoadOp::Clear(Default::default()),
                    store: StoreOp::Discard,
                },
            })
        })
        .chain([None, None])
        .collect();
    if color_attachments.iter().all(Option::is_none) {
        color_attachments.clear();
    }
    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let mut pass = ctx.begin_tracked_render_pass(RenderPassDescriptor {
        label: Some("holovol depth of meshes"),
        color_attachments: &color_attachments,
        depth_stencil_attachment: Some(RenderPassDepthStencilAttachment {
            view: &target.depth,
            depth_ops: Some(Operations {
                load: LoadOp::Clear(0.0),
                store: StoreOp::Store,
            }),
            stencil_ops: None,
        }),
        timestamp_writes: None,
        occlusion_query_set: None,
        multiview_mask: None,
    });
    let span = diagnostics.pass_span(&mut pass, "holovol_mesh_depth");
    pass.set_viewport(0.0, 0.0, size[0] as f32, size[1] as f32, 0.0, 1.0);
    if !opaque.is_empty()
        && let Err(error) = opaque.render(&mut pass, world, entity)
    {
        error_once!("opaque meshes have no depth: {error:?}");
    }
    if !alpha_mask.is_empty()
        && let Err(error) = alpha_mask.render(&mut pass, world, entity)
    {
        error_once!("masked meshes have no depth: {error:?}");
    }
    span.end(&mut pass);
    drop(pass);
    let source = DepthSource {
        texture: &target.depth,
        samples,
        viewport: [0, 0, size[0], size[1]],
        clip_from_view: extracted.clip_from_view.as_dmat4(),
    };
    let first = planned.layers.first;
    if let Err(error) = inner
        .mesh_depth
        .record(ctx.command_encoder(), &source, first)
    {
        error_once!("{error}");
    }
}

/// Traces all views of each volume, and takes the noise out.
pub(super) fn trace_volumes(
    mut gpu: ResMut<VolumeGpu>,
    statistics: Res<VolumeStatistics>,
    mut traced_frames: Local<u64>,
    mut ctx: RenderContext,
) {
    let Some(inner) = &mut gpu.0 else {
        return;
    };
    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let (plan, mesh_depth) = (&inner.plan, &inner.mesh_depth);
    let (mut is_done, mut is_waiting) = (true, false);
    let (mut dispatches, mut samples, mut denoised, mut least) = (0, 0, 0, u32::MAX);
    let mut counters = holovol_render::Counters::default();
    let mut errors = Vec::new();
    for (key, tracing) in &mut inner.tracings {
        let Some((tracer, denoisings)) = tracing.tracer_mut() else {
            is_done = false;
            continue;
        };
        let frames: Vec<_> = plan
            .iter()
            .filter(|planned| planned.key == *key)
            .map(|planned| planned.frame)
            .collect();
        let mut is_traced = false;
        if frames.iter().any(|frame| tracer.wants(frame)) {
            is_done = false;
            let encoder = ctx.command_encoder();
            let span = diagnostics.time_span(encoder, "holovol_trace");
            match tracer.record(encoder, &frames, Some(mesh_depth)) {
                Ok(work) => {
                    dispatches += u64::from(work.dispatches);
                    samples += work.samples;
                    is_waiting |= work.is_waiting;
                    is_traced = !work.is_waiting;
                }
                Err(error) => errors.push(error.to_string()),
            }
            span.end(encoder);
        } else {
            tracer.pass_over(&frames);
        }
        // While the tracer's kernels are compiled there is nothing to denoise.
        let is_planned = |d: &&mut Denoising| d.is_planned() && is_traced;
        for denoising in denoisings.iter_mut().filter(is_planned) {
            let encoder = ctx.command_encoder();
            let span = diagnostics.time_span(encoder, "holovol_denoise");
            match denoising.record(encoder, tracer) {
                Ok(images) => denoised += images,
                Err(error) => errors.push(error.to_string()),
            }
            span.end(encoder);
        }
        for planned in plan.iter().filter(|planned| planned.key == *key) {
            let slot = planned.frame.slot;
            let found = denoisings.iter().find_map(|d| d.samples(planned.camera));
            let traced = || tracer.image(slot).map_or(0, |image| image.samples);
            least = least.min(found.unwrap_or_else(traced));
        }
        let counted = tracer.counters();
        counters.majorant_violations += counted.majorant_violations;
        counters.nonfinite_samples += counted.nonfinite_samples;
    }
    let least = if least == u32::MAX { 0 } else { least };
    if samples > 0 {
        *traced_frames += 1;
        // Seldom, but enough to see in a log whether an app gets on.
        if traced_frames.is_power_of_two() {
            debug!("frame {} traced: {least} samples per pixel", *traced_frames);
        }
    }
    statistics.update(|statistics| {
        statistics.dispatches += dispatches;
        statistics.samples += samples;
        statistics.denoised += denoised;
        statistics.samples_per_pixel = least;
        statistics.is_waiting |= is_waiting;
        statistics.is_done = is_done && !statistics.is_waiting && !plan.is_empty();
        statistics.counters = counters;
        statistics.errors.extend(errors);
    });
}

/// Lays a view's volumes over its opaque pass, the farthest first.
pub(super) fn composite_volumes(
    view: ViewQuery<(
        &ExtractedCamera,
        &ExtractedView,
        &ViewTarget,
        &ViewDepthTexture,
        &Msaa,
        &MainEntity,
    )>,
    mut gpu: ResMut<VolumeGpu>,
    mut ctx: RenderContext,
) {
    let (camera, extracted, target, depth, msaa, entity) = view.into_inner();
    let Some(inner) = &mut gpu.0 else {
        return;
    };
    let viewport = extracted.viewport.to_array();
    let place = CompositePlace {
        viewport,
        clip_from_view: extracted.clip_from_view.as_dmat4(),
        exposure: camera.exposure,
    };
    let eye = extracted.world_from_view.translation().as_dvec3();
    let mut images = Vec::new();
    for planned in inner
        .plan
        .iter()
        .filter(|planned| planned.camera == *entity)
    {
        let Some(tracing) = inner.tracings.get(&planned.key) else {
            continue;
        };
        let Some(tracer) = tracing.tracer() else {
            continue;
        };
        let name = (*entity, planned.key);
        let former = inner.bindings.remove(&name);
        let compositor = &inner.compositor;
        let denoised = tracing.denoisings.iter().find_map(|d| d.image(*entity));
        let bound = match denoised {
            Some((denoiser, eye)) => compositor.bind_denoised(denoiser, eye, &place, former),
            None => compositor.bind(tracer, planned.frame.slot, &place, former),
        };
        match bound {
            Ok(Some(binding)) => {
                let seen = binding.bounds(viewport_size(extracted));
                let distance = binding.centre().distance(eye);
                images.extend(seen.map(|seen| (distance, seen, name)));
                inner.bindings.insert(name, binding);
            }
            Ok(None) => {}
            Err(error) => error_once!("{error}"),
        }
    }
    if images.is_empty() {
        return;
    }
    images.sort_by(|a, b| b.0.total_cmp(&a.0));
    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let mut pass = ctx.begin_tracked_render_pass(RenderPassDescriptor {
        label: Some("holovol composite"),
        color_attachments: &[Some(target.get_color_attachment())],
        depth_stencil_attachment: Some(depth.get_attachment(StoreOp::Store)),
        timestamp_writes: None,
        occlusion_query_set: None,
        multiview_mask: None,
    });
    let span = diagnostics.pass_span(&mut pass, "holovol_composite");
    let [x, y, width, height] = viewport;
    pass.set_viewport(x as f32, y as f32, width as f32, height as f32, 0.0, 1.0);
    let composite_target = composite_target(extracted, msaa);
    for (_, [left, top, right, bottom], name) in &images {
        let Some(binding) = inner.bindings.get(name) else {
            continue;
        };
        pass.set_scissor_rect(x + left, y + top, right - left, bottom - top);
        let compositor = &inner.compositor;
        compositor.draw(pass.wgpu_pass(), composite_target, binding);
    }
    span.end(&mut pass);
}
