//! `holovol xr`: scans in the user's room.
//!
//! Where there is a display, the preview's window stays beside the headset: same volume, same panel,
//! a view of its own. Without one the headset is all there is. In the room there are a menu at the
//! hand and a panel.

mod actions;
mod hands;
mod mirror;
mod panel;
mod picture;
mod place;

use std::time::Duration;

use bevy::app::{PluginGroupBuilder, ScheduleRunnerPlugin};
use bevy::camera::Exposure;
use bevy::log::LogPlugin;
use bevy::prelude::*;
use bevy::window::{ExitCondition, PresentMode};
use bevy::winit::{WinitPlugin, WinitSettings};
use bevy_egui::{EguiGlobalSettings, EguiPlugin};
use bevy_holovol::interaction::HandRecording;
use bevy_holovol::prelude::*;
use bevy_holovol::xr::{
    EyeCamera, Headset, HeadsetBlend, HeadsetRequest, MixedRealityOrigin, MixedRealitySettings,
    SimulatedHeadset,
};

use crate::cli::{PreviewArgs, XrArgs, XrBlend};
use crate::preview::studio::Studio;
use crate::room_camera::{RoomCamera, RoomCameraPlugin, Source};
use crate::{Exit, Failure, preview};

/// Shows scans in a headset until its session ends.
pub(crate) fn run(args: &XrArgs) -> Result<(), Failure> {
    preview::check_files(&args.files)?;
    let simulation = if args.simulate {
        let started = SimulatedHeadset::start(true);
        Some(started.map_err(|error| Failure::new(Exit::NoHeadset, error.to_string()))?)
    } else {
        None
    };
    // With threads, no headset could be simulated any more.
    let wanted = Wanted {
        camera: args.camera.as_deref().map(Source::find).transpose()?,
        hands: args.hands.as_deref().map(hands::read).transpose()?,
    };
    let headset = match Headset::connect("holovol") {
        Ok(headset) => headset,
        Err(missing) if args.window => {
            eprintln!("{missing}\nOpening a window instead.");
            return preview::run(&args.preview());
        }
        Err(missing) => {
            let files = args.files.iter().map(|file| format!(" {}", file.display()));
            let message = format!(
                "{missing}\nWithout a headset, a window shows the same: holovol preview{}\nA \
                 simulated headset needs Monado only: holovol xr --simulate",
                files.collect::<String>()
            );
            return Err(Failure::new(Exit::NoHeadset, message));
        }
    };
    eprintln!("{} on {}", headset.system_name(), headset.runtime());
    let has_window = preview::has_display() && args.out.is_none() && !args.no_window;
    let refused = preview::Refused::default();
    let exit = if has_window {
        let mut app = preview::app(&args.preview(), |plugins| headset.plugins(plugins));
        join(&mut app, args, wanted);
        app.add_plugins(mirror::MirrorPlugin {
            is_open: args.simulate,
        });
        // The headset paces frames, not the window.
        app.insert_resource(WinitSettings::continuous())
            .add_systems(Startup, |mut windows: Query<&mut Window>| {
                for mut window in &mut windows {
                    window.present_mode = PresentMode::AutoNoVsync;
                }
            })
            .run()
    } else {
        let mut app = without_window(|plugins| headset.plugins(plugins));
        app.insert_resource(refused.clone());
        preview::add_studio(&mut app, &args.files);
        join(&mut app, args, wanted);
        app.run()
    };
    drop(simulation);
    let refused = refused.0.lock().ok().and_then(|mut refused| refused.take());
    if let Some(problem) = refused {
        return Err(Failure::new(Exit::Input, problem));
    }
    match exit {
        AppExit::Success => Ok(()),
        AppExit::Error(code) if i32::from(code.get()) == Exit::Interrupted as i32 => {
            Err(Failure::new(Exit::Interrupted, "stopped"))
        }
        AppExit::Error(_) => Err(Failure::new(
            Exit::Device,
            "the headset went dark after an error of the graphics device; what it said is above",
        )),
    }
}

impl XrArgs {
    fn preview(&self) -> PreviewArgs {
        PreviewArgs {
            files: self.files.clone(),
            size: [1280, 800],
            camera: self.camera.clone(),
            frames: None,
            restore: None,
        }
    }
}

/// What is read before the headset is looked for.
struct Wanted {
    camera: Option<Source>,
    hands: Option<HandRecording>,
}

/// What an app in a headset has besides its volume.
fn join(app: &mut App, args: &XrArgs, wanted: Wanted) {
    app.insert_resource(MixedRealitySettings {
        render: VolumeRenderSettings {
            mode: VolumeRenderMode::Denoised,
            samples: args.samples,
            ..default()
        },
        simulated_blend: args.blend.map(|blend| match blend {
            XrBlend::Alpha => HeadsetBlend::Alpha,
            XrBlend::Additive => HeadsetBlend::Additive,
            XrBlend::Opaque => HeadsetBlend::Opaque,
        }),
        resolution_scale: args.resolution,
        // Pictures may take their time.
        volume_resolution: args.picture_prefix().is_none().then_some([0.4, 1.0]),
        ..default()
    })
    .insert_resource(Ending(args.frames))
    .add_plugins((
        place::PlacePlugin,
        actions::ActionPlugin,
        panel::RoomPanelPlugin {
            is_open: args.panel,
        },
    ))
    .add_systems(Update, follow_look)
    .add_systems(Last, end_after_frames);
    if let Some(source) = wanted.camera {
        app.add_plugins(RoomCameraPlugin(source))
            .insert_resource(CameraTurn(args.camera_turn.to_radians()))
            .add_systems(Update, turn_light);
    }
    if let Some(recording) = wanted.hands {
        app.add_plugins(hands::PlayPlugin(recording));
    }
    // Simulated heads have seen enough after one picture.
    if let Some(out) = args.picture_prefix() {
        app.insert_resource(picture::Wanted::new(out, args.frames.unwrap_or(30)))
            .add_systems(Last, picture::take);
    }
}

impl XrArgs {
    /// Where pictures go, if any are wanted.
    fn picture_prefix(&self) -> Option<std::path::PathBuf> {
        let is_silent = !preview::has_display() || self.no_window;
        let default = (self.simulate && is_silent).then(|| "holovol-xr".into());
        self.out.clone().or(default)
    }
}

/// What the camera's panorama is turned by about +y, radians, against the tracking space.
#[derive(Resource)]
struct CameraTurn(f32);

/// The camera stands in the room; the user's place in the world is turned against it.
fn turn_light(
    turn: Res<CameraTurn>,
    camera: Res<RoomCamera>,
    origin: Query<&Transform, With<MixedRealityOrigin>>,
    mut studio: ResMut<Studio>,
) {
    if !camera.is(&studio.look.light.source) {
        return;
    }
    let yaw = origin
        .single()
        .map_or(0.0, |o| o.rotation.to_euler(EulerRot::YXZ).0);
    let degrees = f64::from((yaw + turn.0).to_degrees());
    if (studio.look.light.rotation_deg - degrees).abs() > 1e-4 {
        studio.look.light.rotation_deg = degrees;
    }
}

/// What of the look belongs to cameras, for the eyes.
fn follow_look(
    mut commands: Commands,
    studio: Res<Studio>,
    mut eyes: Query<(Entity, &mut VolumeRenderSettings, Option<&Exposure>), With<EyeCamera>>,
) {
    let look = &studio.look;
    let wanted = look.exposure();
    for (eye, mut settings, exposure) in &mut eyes {
        if settings.max_scatters != look.max_scatters {
            settings.max_scatters = look.max_scatters;
        }
        if exposure.map(|exposure| exposure.ev100) != Some(wanted.ev100) {
            commands.entity(eye).insert(wanted);
        }
    }
}

fn without_window(on_headset: impl FnOnce(PluginGroupBuilder) -> PluginGroupBuilder) -> App {
    let plugins = DefaultPlugins
        .build()
        .set(WindowPlugin {
            primary_window: None,
            exit_condition: ExitCondition::DontExit,
            ..default()
        })
        .set(LogPlugin {
            filter: "warn,bevy_render::renderer=error".into(),
            ..default()
        })
        .disable::<WinitPlugin>();
    let mut app = App::new();
    app.add_plugins((
        on_headset(plugins),
        // The headset paces frames.
        ScheduleRunnerPlugin::run_loop(Duration::ZERO),
        EguiPlugin::default(),
        HolovolPlugins,
    ))
    // Only the panel in the room has one.
    .insert_resource(EguiGlobalSettings {
        auto_create_primary_context: false,
        ..default()
    });
    app
}

/// Frames to draw, for tests.
#[derive(Resource)]
struct Ending(Option<u32>);

fn end_after_frames(
    ending: Res<Ending>,
    wanted: Option<Res<picture::Wanted>>,
    status: Res<bevy_holovol::xr::HeadsetStatus>,
    mut requests: MessageWriter<HeadsetRequest>,
    mut is_asked: Local<bool>,
) {
    let has_time = ending
        .0
        .is_none_or(|frames| status.frames < u64::from(frames));
    if !has_time && wanted.is_none() && !*is_asked {
        *is_asked = true;
        requests.write(HeadsetRequest::Stop);
    }
}
