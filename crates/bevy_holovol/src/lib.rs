//! Path-traced scientific and medical volumes for [Bevy](https://bevy.org).
//!
//! Add [`HolovolPlugins`], spawn a [`Volume3d`] and put [`VolumeRenderSettings`] on a camera; the
//! volume is lit by the [`VolumeEnvironment`], which by default also lights meshes:
//!
//! ```no_run
//! use bevy::prelude::*;
//! use bevy_holovol::prelude::*;
//!
//! fn main() {
//!     App::new()
//!         .add_plugins((DefaultPlugins, HolovolPlugins))
//!         .add_systems(Startup, |mut commands: Commands, assets: Res<AssetServer>| {
//!             commands.spawn((
//!                 Volume3d(assets.load("head.nrrd")),
//!                 VolumeMaterial3d(assets.load("head.tf.json")),
//!             ));
//!             commands.spawn((
//!                 Camera3d::default(),
//!                 VolumeRenderSettings::default(),
//!                 Transform::from_xyz(0.0, 0.1, 0.6).looking_at(Vec3::ZERO, Vec3::Y),
//!             ));
//!         })
//!         .run();
//! }
//! ```
//!
//! # How a frame goes
//!
//! Before Bevy's cameras run, the depth of opaque meshes is drawn for each view in which a mesh
//! overlaps a volume, from the same pose and in the same frame; then one dispatch traces all views
//! of a volume, and paths end at that depth; denoised views pass through the denoiser, two eyes
//! ([`RightEyeOf`]) together. In each view's `Core3d` the images are laid over the
//! opaque pass, before transparent meshes: scene-referred radiance times the camera's exposure, so
//! that Bevy tone-maps everything once. A resting view gathers samples until it has
//! [`max_samples`](VolumeRenderSettings::max_samples); from then on a frame costs no tracing. What is
//! shown stays until what takes its place is loaded, uploaded and compiled.
//!
//! [`VolumeStatistics`] tells what was done and what is waited for, also why a volume isn't there.
//!
//! # Limits
//!
//! - Several volumes are traced apart and laid over each other from the farthest to the nearest, by
//!   the distance of their centres. That is right while their boxes don't overlap; they cast no
//!   shadows on each other.
//! - Meshes hide what is behind them, but cast no shadows into volumes, nor volumes onto meshes.
//! - Meshes of a deferred prepass, and those that a camera with
//!   [`OcclusionCulling`](bevy::render::occlusion_culling::OcclusionCulling) has just found, end no
//!   paths inside a volume.
//! - A mask of a mesh's material that changes, though the mesh doesn't, begins no image anew:
//!   [`VolumeRenderSettings::reset`] does.
//! - At most [`MAX_VIEWS`] cameras see one volume.

pub mod clip_plane;
pub mod environment;
pub mod interaction;
pub mod render;
pub mod scene;
pub mod transfer_function;
pub mod volume;
#[cfg(feature = "xr")]
pub mod xr;

use bevy::app::{PluginGroup, PluginGroupBuilder};

pub use clip_plane::VolumeClipPlane;
pub use environment::{
    EnvironmentAsset, EnvironmentSource, LiveCamera, LiveFrame, LiveLight, LiveLightPlugin,
    LivePicture, VolumeEnvironment, VolumeEnvironmentPlugin, WithoutSky,
};
pub use holovol_render::{Counters, MAX_VIEWS};
pub use interaction::{Graspable, InteractionPlugin};
pub use render::{
    RightEyeOf, VolumeDenoiser, VolumeRenderMode, VolumeRenderPlugin, VolumeRenderSettings,
    VolumeRenderSystems, VolumeSampling, VolumeStatistics,
};
pub use scene::SceneParts;
pub use transfer_function::{TransferFunctionAsset, TransferFunctionPlugin, VolumeMaterial3d};
pub use volume::{
    Volume3d, VolumeAsset, VolumeFiles, VolumeLoadProgress, VolumeMedium, VolumePlugin,
};

// What volumes, transfer functions and light are made of in code.
pub use holovol_light::EnvironmentMap;
pub use holovol_volume::{
    Geometry, ReadOptions, TransferFunction, TransferFunctionFile, TransferPoint, Volume,
    VolumeError, Voxels,
};

/// All that most apps use.
pub mod prelude {
    pub use crate::{
        EnvironmentAsset, EnvironmentSource, Graspable, HolovolPlugins, LiveLight, LiveLightPlugin,
        RightEyeOf, TransferFunctionAsset, Volume3d, VolumeAsset, VolumeClipPlane, VolumeDenoiser,
        VolumeEnvironment, VolumeFiles, VolumeMaterial3d, VolumeMedium, VolumeRenderMode,
        VolumeRenderSettings,
    };
}

/// Everything that shows volumes; each part can be used, or left out, on its own.
///
/// | plugin | what it adds |
/// |---|---|
/// | [`VolumePlugin`] | [`Volume3d`], clip planes, loaders of volume files |
/// | [`TransferFunctionPlugin`] | [`VolumeMaterial3d`], loader of `*.tf.json` |
/// | [`VolumeEnvironmentPlugin`] | [`VolumeEnvironment`], its light and sky for meshes |
/// | [`VolumeRenderPlugin`] | [`VolumeRenderSettings`]: the path tracer in Bevy's frame |
///
/// Added apart: [`LiveLightPlugin`], which follows a 360° camera, and [`InteractionPlugin`], for
/// volumes that are taken in hand.
pub struct HolovolPlugins;

impl PluginGroup for HolovolPlugins {
    fn build(self) -> PluginGroupBuilder {
        PluginGroupBuilder::start::<Self>()
            .add(VolumePlugin)
            .add(TransferFunctionPlugin)
            .add(VolumeEnvironmentPlugin)
            .add(VolumeRenderPlugin)
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_readme_shows_the_smallest_example_to_the_letter() {
        let example = include_str!("../../../examples/minimal.rs");
        assert!(include_str!("../../../README.md").contains(example));
    }
}
