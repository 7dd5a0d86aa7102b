//! Volumes in the user's room: a headset through OpenXR.
//!
//! [`Headset::connect`] finds a runtime and opens the graphics device that it wants; the app is then
//! built on that:
//!
//! ```no_run
//! use bevy::prelude::*;
//! use bevy_holovol::prelude::*;
//! use bevy_holovol::xr::Headset;
//!
//! fn main() -> AppExit {
//!     let mut app = App::new();
//!     match Headset::connect("my app") {
//!         Ok(headset) => app.add_plugins(headset.plugins(DefaultPlugins)),
//!         Err(missing) => {
//!             eprintln!("{missing}");
//!             app.add_plugins(DefaultPlugins)
//!         }
//!     };
//!     app.add_plugins(HolovolPlugins).run()
//! }
//! ```
//!
//! # What happens in a frame
//!
//! `First` waits until the runtime wants the next frame and places the eyes, so that everything
//! that follows sees them. In the render world, before views are prepared, the runtime is asked for
//! poses *and* fields of view once more, for the same display time; with these the frame is drawn
//! and submitted. The eyes are two cameras ([`EyeCamera`]) like any other, with images of their own;
//! one group of dispatches traces both.
//!
//! # When things go wrong
//!
//! Nothing in the frame panics on what a runtime says. A session that is lost is opened again; so is
//! the connection to a runtime that dies, as soon as it is back (looked for every second, on a
//! worker): on the same graphics device, or on the one that it wants instead, with which Bevy goes on
//! then. Meanwhile the app goes on, its window with it. Poses that are none leave the eyes where they
//! were.
//!
//! # Limits
//!
//! - Vulkan only. Two views only.

mod anchors;
mod capture;
mod cost;
mod error;
mod eyes;
mod frame;
mod graphics;
mod input;
mod output;
mod pace;
mod pose;
mod runtime;
mod screen;
mod session;
mod sight;
mod simulate;

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bevy::app::PluginGroupBuilder;
use bevy::camera::visibility::RenderLayers;
use bevy::core_pipeline::schedule::{Core3d, Core3dSystems};
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::prelude::*;
use bevy::render::extract_component::ExtractComponentPlugin;
use bevy::render::pipelined_rendering::PipelinedRenderingPlugin;
use bevy::render::render_resource::TextureFormat;
use bevy::render::{
    ExtractSchedule, GpuResourceAppExt, Render, RenderApp, RenderPlugin, RenderSystems,
};
use openxr::EnvironmentBlendMode;

pub use capture::{CapturedFrame, EyeCapture};
#[doc(hidden)]
pub use cost::{CostOwner, FrameCost};
pub use error::HeadsetError;
pub use eyes::{EyeCamera, EyeImages, HeadPose, MixedRealityOrigin, before};
#[doc(hidden)]
pub use graphics::queue_submissions;
pub use pose::{EyeView, FieldOfView};
#[doc(hidden)]
pub use pose::{RawView, TamperedViews};
#[doc(hidden)]
pub use sight::SyntheticSight;
pub use simulate::{SimulatedHeadset, SimulationError};

use crate::render::view_depth::ViewDepths;
use crate::{InteractionPlugin, VolumeRenderMode, VolumeRenderSettings};
use graphics::{DeviceParts, GraphicsApi};
use runtime::Runtime;
use session::{Connection, CurrentFrame, Link};

/// A headset, and the graphics device that its runtime wants.
pub struct Headset {
    app_name: String,
    runtime: Runtime,
    api: GraphicsApi,
    parts: DeviceParts,
    eye_size: [u32; 2],
}

impl Headset {
    /// Finds a runtime with a headset and opens its graphics device. `app_name` is what the runtime
    /// shows to the user.
    ///
    /// # Errors
    /// Says what is missing and how to get it.
    pub fn connect(app_name: &str) -> Result<Self, HeadsetError> {
        // Longer names make openxr panic; NUL ends them.
        let app_name: String = app_name.chars().filter(|c| *c != '\0').take(30).collect();
        let runtime = Runtime::find(&app_name)?;
        let eye_size = runtime.eye_size(None, 1.0)?;
        let (api, parts) = GraphicsApi::open_device(&runtime)?;
        Ok(Self {
            app_name,
            runtime,
            api,
            parts,
            eye_size,
        })
    }

    /// Name and version of the runtime.
    pub fn runtime(&self) -> &str {
        &self.runtime.name
    }

    /// What the runtime calls the headset.
    pub fn system_name(&self) -> &str {
        &self.runtime.system_name
    }

    /// `DefaultPlugins`, or the like, on this headset's graphics device, and
    /// [`MixedRealityPlugin`]. Frames aren't pipelined: that would add one to the latency.
    pub fn plugins(self, plugins: impl PluginGroup) -> PluginGroupBuilder {
        let device = self.parts.device.clone();
        let plugins = plugins.build().set(RenderPlugin {
            render_creation: self.parts.into_creation(),
            ..default()
        });
        let plugins = if plugins.contains::<PipelinedRenderingPlugin>() {
            plugins.disable::<PipelinedRenderingPlugin>()
        } else {
            plugins
        };
        plugins.add(MixedRealityPlugin {
            eye_size: UVec2::from(self.eye_size),
            connection: Mutex::new(Some(Connection {
                app_name: self.app_name,
                api: self.api,
                device,
                is_in_use: true,
                is_device_of_runtime: true,
                device_tries: 0,
                is_found_again: false,
                link: Link::Found(self.runtime, None),
                has_ended: false,
            })),
        })
    }
}

/// Shows the world in a headset; comes with [`Headset::plugins`].
///
/// Spawns a [`MixedRealityOrigin`] with two [`EyeCamera`]s. Settings are in
/// [`MixedRealitySettings`], what happens in [`HeadsetStatus`].
pub struct MixedRealityPlugin {
    eye_size: UVec2,
    connection: Mutex<Option<Connection>>,
}

/// How the world is shown in a headset. What isn't said otherwise can change at any time.
#[derive(Resource, Clone, Debug)]
pub struct MixedRealitySettings {
    /// Ways in which pictures meet the room, the preferred one first; asked when a session opens.
    /// By default [`HeadsetBlend::Alpha`], [`HeadsetBlend::Additive`], [`HeadsetBlend::Opaque`].
    pub blend_preference: Vec<HeadsetBlend>,
    /// Of both eyes, at the start: afterwards it is a component of theirs. By default 2 samples
    /// per frame, denoised, each eye with what the other knows.
    pub render: VolumeRenderSettings,
    /// What the eyes see, at the start; by default layer 0.
    pub layers: RenderLayers,
    /// Where the room isn't seen; over a room it is Khronos PBR Neutral, as by default.
    pub tonemapping: Tonemapping,
    /// Of the images that the eyes draw into; by default `Rgba8UnormSrgb`.
    pub eye_format: TextureFormat,
    /// Pixels of the eyes' images, if not as many as the runtime recommends; asked when a session
    /// opens.
    pub eye_size: Option<UVec2>,
    /// Factor on these, along each axis, 0.1 to 8 and as far as the runtime allows; asked when a
    /// session opens. 1 by default.
    pub resolution_scale: f32,
    /// Gives the compositor the depth of what is seen, where it takes it: it then moves pictures to
    /// the latest pose more truly. Costs one march through the volume per pixel. Asked when a
    /// session opens; true by default.
    pub has_depth_layer: bool,
    /// Bounds within which [`VolumeRenderSettings::resolution_scale`] of the eyes follows the
    /// headset's pace: less when frames come late, more when they have long been in time. `None`
    /// leaves it alone. 0.4 to 1 by default.
    pub volume_resolution: Option<[f32; 2]>,
    /// Where that isn't enough for long, the headset is asked for fewer frames a second, no fewer
    /// than this; as many as at first again when there is time. `None` leaves its rate alone. 60 by
    /// default.
    pub least_refresh_rate: Option<f32>,
    /// Spends fewer samples where the eyes see less; `None` spends as many everywhere.
    pub foveation: Option<Foveation>,
    /// Draws as for such a headset, though the session is what it is: for previews and tests. Asked
    /// when a session opens.
    pub simulated_blend: Option<HeadsetBlend>,
    #[doc(hidden)]
    pub tampered_views: Option<TamperedViews>,
    #[doc(hidden)]
    pub synthetic_sight: Option<Arc<SyntheticSight>>,
    /// Keeps what is [`Graspable`](crate::interaction::Graspable), and no other's child, where it
    /// was put down in the room, by anchors of the headset where it has them
    /// ([`HeadsetStatus::has_anchors`]); true by default.
    pub locks_to_world: bool,
    /// Gives Bevy another graphics device where a runtime that was lost and found again wants one:
    /// all on the device is made anew then, as after [any loss of
    /// it](bevy::render::error_handler::RenderErrorPolicy::Recover). For apps whose plugins all stand
    /// that; else the headset stays dark, and [`HeadsetStatus::problem`] says why. True by default.
    pub may_replace_device: bool,
    #[doc(hidden)]
    pub refused_devices: RefusedDevices,
    /// Ends the app with the session, when that ends by the user's will; true by default.
    pub exits_app: bool,
}

/// Which of Bevy's graphics devices are treated as if the runtime refused them: for tests, on the one
/// device that a machine may have.
#[doc(hidden)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RefusedDevices {
    #[default]
    None,
    /// All that were not opened for the runtime in use.
    OfFormerRuntimes,
    All,
}

impl Default for MixedRealitySettings {
    fn default() -> Self {
        Self {
            blend_preference: vec![
                HeadsetBlend::Alpha,
                HeadsetBlend::Additive,
                HeadsetBlend::Opaque,
            ],
            render: VolumeRenderSettings {
                mode: VolumeRenderMode::Denoised,
                samples: 2,
                ..default()
            },
            layers: RenderLayers::default(),
            tonemapping: Tonemapping::KhronosPbrNeutral,
            eye_format: TextureFormat::Rgba8UnormSrgb,
            eye_size: None,
            resolution_scale: 1.0,
            has_depth_layer: true,
            volume_resolution: Some([0.4, 1.0]),
            least_refresh_rate: Some(60.0),
            foveation: Some(Foveation::default()),
            simulated_blend: None,
            tampered_views: None,
            synthetic_sight: None,
            locks_to_world: true,
            may_replace_device: true,
            refused_devices: RefusedDevices::None,
            exits_app: true,
        }
    }
}

impl MixedRealitySettings {
    fn resolution_factor(&self) -> f32 {
        if self.resolution_scale.is_finite() {
            self.resolution_scale.clamp(0.1, 8.0)
        } else {
            1.0
        }
    }
}

/// Fewer samples where the eyes see less: unbiased, see [`VolumeSampling`](crate::VolumeSampling),
/// noisier there. Angles in radians from where the eyes look.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Foveation {
    /// Up to there pixels get all samples; 0.3 by default.
    pub fovea: f32,
    /// From there on they get [`Self::periphery`] of them; 0.6 by default.
    pub far: f32,
    /// Part of the samples, 0 to 1; 0.25 by default. Each pixel gets one at least.
    pub periphery: f32,
    /// Whether it goes where the eyes look, if the headset knows; else it is straight ahead. True by
    /// default.
    pub follows_gaze: bool,
}

impl Default for Foveation {
    fn default() -> Self {
        Self {
            fovea: 0.3,
            far: 0.6,
            periphery: 0.25,
            follows_gaze: true,
        }
    }
}

/// How pictures meet the room.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum HeadsetBlend {
    /// The room is seen where the picture isn't opaque.
    Alpha,
    /// The picture's light is added to the room's; black is nothing.
    Additive,
    /// The picture is all that is seen: the environment stands for the room.
    #[default]
    Opaque,
}

impl HeadsetBlend {
    fn mode(self) -> EnvironmentBlendMode {
        match self {
            Self::Alpha => EnvironmentBlendMode::ALPHA_BLEND,
            Self::Additive => EnvironmentBlendMode::ADDITIVE,
            Self::Opaque => EnvironmentBlendMode::OPAQUE,
        }
    }

    /// The first of these that is offered; else what is offered first.
    fn choose(
        preference: &[Self],
        offered: &[EnvironmentBlendMode],
    ) -> Option<(Self, EnvironmentBlendMode)> {
        let all = [Self::Alpha, Self::Additive, Self::Opaque];
        let find = |mode: &EnvironmentBlendMode| all.into_iter().find(|b| b.mode() == *mode);
        preference
            .iter()
            .copied()
            .find(|blend| offered.contains(&blend.mode()))
            .or_else(|| offered.iter().find_map(find))
            .map(|blend| (blend, blend.mode()))
    }
}

/// What becomes of the headset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum HeadsetState {
    /// There is no session: the runtime is gone and is looked for.
    #[default]
    Lost,
    /// The headset isn't worn, or another app has it.
    Idle,
    /// It begins.
    Starting,
    /// Frames are paced, and not shown.
    Synchronized,
    /// Frames are shown; hands are another app's.
    Visible,
    /// Frames are shown, and hands are ours.
    Focused,
    /// It ends.
    Stopping,
    /// It has ended by the user's will, until [`HeadsetRequest::Start`].
    Ended,
}

/// Asks something of the headset.
#[derive(Message, Clone, Copy, Debug, PartialEq, Eq)]
pub enum HeadsetRequest {
    /// Opens a session after one that has ended.
    Start,
    /// Ends the session, as soon as the runtime agrees.
    Stop,
}

/// What there is to say about the headset; read only.
#[derive(Resource, Clone, Debug, Default)]
pub struct HeadsetStatus {
    /// What becomes of it.
    pub state: HeadsetState,
    /// Name and version of the runtime.
    pub runtime: String,
    /// What the runtime calls the headset.
    pub headset: String,
    /// How pictures meet the room.
    pub blend: HeadsetBlend,
    /// Pixels of the headset's images.
    pub eye_size: UVec2,
    /// Whether the compositor gets depth as well.
    pub has_depth_layer: bool,
    /// Whether the headset knows where the eyes look.
    pub has_gaze: bool,
    /// Whether the headset has anchors, which hold things at their places in the room.
    pub has_anchors: bool,
    /// Whether the eyes' poses and fields of view are known.
    pub is_tracked: bool,
    /// Frames that the runtime has paced since the start.
    pub frames: u64,
    /// Time between two of them.
    pub period: Duration,
    /// Sessions opened since the start.
    pub sessions: u32,
    /// Runtimes found again since the start.
    pub reconnections: u32,
    /// Graphics devices that Bevy was given since the start, for runtimes that wanted another.
    pub device_changes: u32,
    /// How often the user made tracking space anew.
    pub recenterings: u32,
    /// Why there is no session, in plain words.
    pub problem: Option<String>,
    last_display_time: i64,
}

impl Plugin for MixedRealityPlugin {
    fn build(&self, app: &mut App) {
        let connection = self
            .connection
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        let Some(connection) = connection else {
            return;
        };
        if !app.is_plugin_added::<InteractionPlugin>() {
            app.add_plugins(InteractionPlugin);
        }
        let capture = EyeCapture::default();
        let cost = FrameCost::default();
        app.insert_resource(connection)
            .insert_resource(capture.clone())
            .insert_resource(cost.clone())
            .insert_resource(HeadsetStatus {
                eye_size: self.eye_size,
                ..default()
            })
            .init_resource::<MixedRealitySettings>()
            .init_resource::<CurrentFrame>()
            .init_resource::<session::Successor>()
            .init_resource::<HeadPose>()
            .add_message::<HeadsetRequest>()
            .add_plugins((
                ExtractComponentPlugin::<EyeCamera>::default(),
                ExtractComponentPlugin::<output::RoomOutput>::default(),
            ))
            .add_systems(PreStartup, eyes::spawn)
            .add_systems(
                First,
                (
                    session::update,
                    eyes::update,
                    anchors::follow,
                    sight::update,
                    pace::keep,
                )
                    .chain(),
            )
            .add_systems(Last, session::listen);
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else {
            return;
        };
        render_app
            .insert_resource(capture)
            .insert_resource(cost)
            .init_resource::<frame::RenderFrame>()
            .add_systems(ExtractSchedule, frame::extract)
            .add_systems(
                Render,
                (
                    frame::begin
                        .after(RenderSystems::ExtractCommands)
                        .before(RenderSystems::PrepareAssets)
                        .before(RenderSystems::PrepareViews),
                    frame::submit
                        .after(RenderSystems::Render)
                        .before(RenderSystems::Cleanup),
                ),
            )
            .add_systems(Core3d, output::map_tones.in_set(Core3dSystems::PostProcess));
    }

    fn finish(&self, app: &mut App) {
        if let Some(render_app) = app.get_sub_app_mut(RenderApp) {
            render_app
                .init_gpu_resource::<screen::Screen>()
                .init_gpu_resource::<ViewDepths>();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_offered_preference_is_taken() {
        use EnvironmentBlendMode as Mode;
        let preference = MixedRealitySettings::default().blend_preference;
        let choose = |offered: &[Mode]| HeadsetBlend::choose(&preference, offered).map(|b| b.0);
        assert_eq!(
            choose(&[Mode::OPAQUE, Mode::ADDITIVE, Mode::ALPHA_BLEND]),
            Some(HeadsetBlend::Alpha)
        );
        assert_eq!(choose(&[Mode::ADDITIVE]), Some(HeadsetBlend::Additive));
        assert_eq!(choose(&[Mode::OPAQUE]), Some(HeadsetBlend::Opaque));
        assert_eq!(choose(&[]), None);
        let only_opaque = HeadsetBlend::choose(&[HeadsetBlend::Opaque], &[Mode::ADDITIVE]);
        assert_eq!(only_opaque, Some((HeadsetBlend::Additive, Mode::ADDITIVE)));
    }
}
