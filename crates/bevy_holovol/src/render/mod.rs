//! The path tracer in Bevy's frame.

mod denoise;
mod extract;
mod mesh_overlap;
mod node;
mod plan;
mod prepare;
mod sampling;
mod settings;
mod shown;
mod tracing;
#[cfg(feature = "xr")]
pub(crate) mod view_depth;

use bevy::core_pipeline::core_3d::{main_opaque_pass_3d, main_transparent_pass_3d};
use bevy::core_pipeline::schedule::{Core3d, Core3dSystems, camera_driver};
use bevy::pbr::{
    PreprocessPipelines, clear_indirect_parameters_metadata, early_gpu_preprocess,
    early_prepass_build_indirect_parameters, unpack_bins,
};
use bevy::prelude::*;
use bevy::render::extract_component::ExtractComponentPlugin;
use bevy::render::renderer::{RenderGraph, RenderGraphSystems};
use bevy::render::{ExtractSchedule, GpuResourceAppExt, Render, RenderApp, RenderSystems};

#[cfg(feature = "xr")]
pub(crate) use prepare::VolumeGpu;
pub use sampling::VolumeSampling;
pub use settings::{
    RightEyeOf, Statistics, VolumeDenoiser, VolumeRenderMode, VolumeRenderSettings,
    VolumeStatistics,
};

/// Traces volumes for every camera with [`VolumeRenderSettings`].
pub struct VolumeRenderPlugin;

/// What happens to volumes in the render world.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum VolumeRenderSystems {
    /// `Render`, in `RenderSystems::PrepareResources`: uploads what changed.
    Prepare,
    /// `RenderGraph`, before `camera_driver`: the depth of meshes, then the paths of all views, then
    /// denoising.
    Trace,
    /// `Core3d`, between opaque and transparent meshes: images over what is drawn.
    Composite,
}

impl Plugin for VolumeRenderPlugin {
    fn build(&self, app: &mut App) {
        let statistics = VolumeStatistics::default();
        app.register_type::<VolumeRenderSettings>()
            .register_type::<RightEyeOf>()
            .insert_resource(statistics.clone())
            .add_plugins(ExtractComponentPlugin::<VolumeSampling>::default())
            .init_resource::<settings::PendingResets>()
            .add_systems(First, settings::clear_resets)
            .add_systems(Last, settings::note_resets);
        if app.get_sub_app(RenderApp).is_none() {
            return;
        }
        shown::build(app);
        mesh_overlap::build(app);
        app.sub_app_mut(RenderApp)
            .insert_resource(statistics)
            .init_resource::<extract::ExtractedScene>()
            .init_resource::<sampling::SamplingMaps>()
            .init_schedule(node::VolumeDepth)
            .add_systems(ExtractSchedule, extract::extract_volumes)
            .add_systems(
                Render,
                prepare::prepare_volumes
                    .in_set(VolumeRenderSystems::Prepare)
                    .in_set(RenderSystems::PrepareResources),
            )
            .add_systems(
                node::VolumeDepth,
                (
                    (
                        clear_indirect_parameters_metadata,
                        unpack_bins,
                        early_gpu_preprocess,
                        early_prepass_build_indirect_parameters,
                    )
                        .chain()
                        .run_if(resource_exists::<PreprocessPipelines>),
                    node::draw_mesh_depth,
                )
                    .chain(),
            )
            .add_systems(
                RenderGraph,
                (
                    plan::plan_frame,
                    node::drive_mesh_depth,
                    node::trace_volumes,
                )
                    .chain()
                    .in_set(VolumeRenderSystems::Trace)
                    .in_set(RenderGraphSystems::Render)
                    .before(camera_driver),
            )
            .add_systems(
                Core3d,
                node::composite_volumes
                    .in_set(VolumeRenderSystems::Composite)
                    .in_set(Core3dSystems::MainPass)
                    .after(main_opaque_pass_3d)
                    .before(main_transparent_pass_3d),
            );
    }

    fn finish(&self, app: &mut App) {
        if let Some(render_app) = app.get_sub_app_mut(RenderApp) {
            // Again after a lost device: everything is uploaded anew from the extracted scene.
            render_app.init_gpu_resource::<prepare::VolumeGpu>();
        }
    }
}
