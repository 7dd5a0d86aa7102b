//! `holovol preview`: a window in which scans are looked at.

mod camera;
pub(crate) mod lights;
pub(crate) mod look;
mod measure;
pub(crate) mod open;
mod overlay;
mod panel;
mod pictures;
mod pointer;
pub(crate) mod presets;
mod quality;
mod recovery;
mod scene_io;
pub(crate) mod settings;
mod slice_views;
mod slices;
pub(crate) mod studio;
#[cfg(test)]
pub(crate) mod tests;
mod transfer;

use std::path::PathBuf;
#[cfg(feature = "xr")]
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bevy::app::PluginGroupBuilder;
use bevy::camera::CameraOutputMode;
use bevy::camera::visibility::RenderLayers;
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::log::LogPlugin;
use bevy::prelude::*;
use bevy::render::render_resource::BlendState;
use bevy::window::{PresentMode, RequestRedraw, WindowResolution};
use bevy::winit::{UpdateMode, WinitSettings};
use bevy_egui::{EguiGlobalSettings, EguiPlugin, PrimaryEguiContext};
use bevy_holovol::prelude::*;

use self::recovery::{RecoveryPlugin, Restored};
use crate::cli::PreviewArgs;
use crate::room_camera::{RoomCamera, RoomCameraPlugin, Source};
use crate::{Exit, Failure};

/// What is shown, and what became of the last wish.
#[derive(Resource)]
pub(crate) struct Session {
    volume: Entity,
    camera: Entity,
    /// What is in the window, as its title says.
    name: String,
    /// The last thing that went wrong, or well, in plain words.
    status: Option<Status>,
    /// Ends the app after as many frames: for tests.
    frames_left: Option<u32>,
}

enum Status {
    Done(String),
    Failed(String),
}

/// Between frames where there is nothing to do, and where there is nothing to see of what is done.
const ASLEEP: Duration = Duration::from_secs(1);
const LOOKING_ON: Duration = Duration::from_millis(100);

/// Files that the command line names, opened at the start.
#[derive(Resource)]
struct FirstFiles(Vec<PathBuf>);

/// Opens the window and works until it is closed.
pub(crate) fn run(args: &PreviewArgs) -> Result<(), Failure> {
    if !has_display() {
        return Err(Failure::new(
            Exit::Usage,
            "there is no display to open a window on; `holovol demo` and `holovol render` make \
             pictures without one",
        ));
    }
    let restored = args.restore.as_deref().map(Restored::read).transpose()?;
    let mut args = args.clone();
    if let Some(restored) = &restored {
        args.files = restored.files();
    }
    check_files(&args.files)?;
    let camera = args.camera.as_deref().map(Source::find).transpose()?;
    // Bevy ends the process if there is no adapter: that is found out before, and said kindly.
    holovol_render::Gpu::new(None)?;
    let mut app = app(&args, |plugins| plugins);
    app.add_plugins(RecoveryPlugin {
        size: args.size,
        camera: args.camera,
        restored,
    });
    if let Some(camera) = camera {
        app.add_plugins(RoomCameraPlugin(camera));
    }
    match app.run() {
        AppExit::Success => Ok(()),
        AppExit::Error(code) if i32::from(code.get()) == Exit::Interrupted as i32 => {
            Err(Failure::new(Exit::Interrupted, "stopped"))
        }
        AppExit::Error(_) => Err(Failure::new(
            Exit::Device,
            "the window closed after an error of the graphics device; what it said is above",
        )),
    }
}

/// Refuses files that aren't there before anything is opened.
pub(crate) fn check_files(files: &[PathBuf]) -> Result<(), Failure> {
    for file in files {
        if !file.exists() {
            let message = format!("{}: there is no such file or folder", file.display());
            return Err(Failure::new(Exit::Input, message));
        }
    }
    Ok(())
}

/// The window's app. `adapt` may put Bevy's plugins on another graphics device.
pub(crate) fn app(
    args: &PreviewArgs,
    adapt: impl FnOnce(PluginGroupBuilder) -> PluginGroupBuilder,
) -> App {
    let [width, height] = args.size;
    let window = Window {
        title: "holovol".into(),
        name: Some("holovol".into()),
        resolution: WindowResolution::new(width, height),
        present_mode: PresentMode::AutoVsync,
        ..default()
    };
    let mut app = App::new();
    let plugins = DefaultPlugins
        .set(WindowPlugin {
            primary_window: Some(window),
            ..default()
        })
        .set(LogPlugin {
            // Not what concerns only those who write such programs.
            filter: "warn,bevy_render::renderer=error,bevy_asset::io=error,winit=error".into(),
            ..default()
        });
    app.add_plugins((adapt(plugins), EguiPlugin::default(), HolovolPlugins))
        .insert_resource(WinitSettings {
            focused_mode: UpdateMode::reactive(ASLEEP),
            unfocused_mode: UpdateMode::reactive_low_power(ASLEEP),
        })
        .insert_resource(FirstFiles(args.files.clone()))
        .insert_resource(FrameLimit(args.frames))
        // Else it is the first camera that is found, which may be a headset's.
        .insert_resource(EguiGlobalSettings {
            auto_create_primary_context: false,
            ..default()
        })
        .add_plugins((
            camera::CameraPlugin,
            open::OpenPlugin,
            panel::PanelPlugin,
            pointer::PointerPlugin,
            quality::QualityPlugin,
            studio::StudioPlugin,
        ))
        .insert_resource(settings::Settings::load())
        .init_resource::<pictures::Pictures>()
        .add_systems(Startup, setup)
        .add_systems(Last, (title, keep_drawing, end_after_frames));
    app
}

/// Shows files as the window does, in an app without one: a volume, its matter and its light, but no
/// camera.
#[cfg(feature = "xr")]
pub(crate) fn add_studio(app: &mut App, files: &[PathBuf]) {
    app.insert_resource(FirstFiles(files.to_vec()))
        // Neither read nor written down: nobody sees them.
        .insert_resource(settings::Settings::default())
        .init_resource::<Refused>()
        .add_plugins((open::OpenPlugin, studio::StudioPlugin))
        .add_systems(Startup, |mut commands: Commands| {
            let volume = commands.spawn(Volume3d::default()).id();
            commands.insert_resource(Session {
                volume,
                camera: Entity::PLACEHOLDER,
                name: String::new(),
                status: None,
                frames_left: None,
            });
        })
        .add_systems(Update, tell);
}

/// Why a file that was named isn't shown, where there is no window to say so.
#[cfg(feature = "xr")]
#[derive(Resource, Clone, Default)]
pub(crate) struct Refused(pub(crate) Arc<Mutex<Option<String>>>);

/// What the window would say goes to the terminal; what can't be opened ends the app.
#[cfg(feature = "xr")]
fn tell(
    mut session: ResMut<Session>,
    opening: Res<open::Opening>,
    refused: Res<Refused>,
    mut exit: MessageWriter<AppExit>,
) {
    let problem = match (session.status.take(), &opening.choosing) {
        (Some(Status::Failed(problem)), _) => problem,
        (_, Some(choosing)) => {
            let path = choosing.path.display();
            let line = |(i, content): (usize, &holovol_volume::Content)| {
                format!("\n  {}: {} {}", i + 1, content.name, content.description)
            };
            let lines = choosing.contents.iter().enumerate().map(line);
            format!(
                "{path} holds several {}; `holovol convert` with --choice makes a file of one:{}",
                choosing.what,
                lines.collect::<String>()
            )
        }
        (Some(Status::Done(text)), None) => return eprintln!("{text}"),
        (None, None) => return,
    };
    *refused.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(problem);
    exit.write(AppExit::from_code(Exit::Input as u8));
}

/// Whether windows can be opened; elsewhere than on Unix they always can.
pub(crate) fn has_display() -> bool {
    let is_set = |name| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    !cfg!(all(unix, not(target_os = "macos"))) || is_set("DISPLAY") || is_set("WAYLAND_DISPLAY")
}

#[derive(Resource)]
struct FrameLimit(Option<u32>);

fn setup(mut commands: Commands, limit: Res<FrameLimit>) {
    // The panel has the whole window, and a camera of its own; the scan what it leaves free.
    commands.spawn((
        PrimaryEguiContext,
        Camera2d,
        RenderLayers::none(),
        Camera {
            order: 1,
            output_mode: CameraOutputMode::Write {
                blend_state: Some(BlendState::ALPHA_BLENDING),
                clear_color: ClearColorConfig::None,
            },
            clear_color: ClearColorConfig::Custom(Color::NONE),
            ..default()
        },
    ));
    let volume = commands.spawn(Volume3d::default()).id();
    let camera = commands
        .spawn((
            Camera3d::default(),
            Tonemapping::KhronosPbrNeutral,
            VolumeRenderSettings {
                max_samples: quality::RESTING_SAMPLES,
                ..default()
            },
            camera::Orbit::default(),
            // As pictures have it where there is no sky.
            Camera {
                clear_color: ClearColorConfig::Custom(Color::BLACK),
                ..default()
            },
        ))
        .id();
    commands.insert_resource(Session {
        volume,
        camera,
        name: String::new(),
        status: None,
        frames_left: limit.0,
    });
}

fn title(session: Res<Session>, mut windows: Query<&mut Window>) {
    for mut window in &mut windows {
        let title = if session.name.is_empty() {
            "holovol".to_owned()
        } else {
            format!("{} — holovol", session.name)
        };
        if window.title != title {
            window.title = title;
        }
    }
}

#[expect(clippy::too_many_arguments, reason = "all that there can be to do")]
/// Asks for the next frame while there is something to see; else the app sleeps.
fn keep_drawing(
    statistics: Res<bevy_holovol::VolumeStatistics>,
    opening: Res<open::Opening>,
    session: Res<Session>,
    studio: Res<studio::Studio>,
    applied: Res<studio::Applied>,
    pictures: Res<pictures::Pictures>,
    quality: Res<quality::Quality>,
    room_camera: Option<Res<RoomCamera>>,
    mut settings: ResMut<WinitSettings>,
    mut redraw: MessageWriter<RequestRedraw>,
) {
    let numbers = statistics.get();
    let is_unfinished = studio.scan.is_some() && (!numbers.is_done || quality.is_paused());
    let is_waiting = is_unfinished && numbers.is_waiting;
    let is_changing = applied.is_behind(&studio.look) || session.frames_left.is_some();
    if is_unfinished && !is_waiting || pictures.progress().is_some() || is_changing {
        redraw.write(RequestRedraw);
    }
    // Frames that only tell of work would hold it up. A camera's light comes by itself.
    let is_looking_on = is_waiting || opening.is_busy() || room_camera.is_some();
    let pace = if is_looking_on { LOOKING_ON } else { ASLEEP };
    let WinitSettings {
        focused_mode,
        unfocused_mode,
    } = &mut *settings;
    for mode in [focused_mode, unfocused_mode] {
        // A headset's frames are paced by it.
        if let UpdateMode::Reactive { wait, .. } = mode {
            *wait = pace;
        }
    }
}

fn end_after_frames(mut session: ResMut<Session>, mut exit: MessageWriter<AppExit>) {
    if let Some(left) = &mut session.bypass_change_detection().frames_left {
        *left = left.saturating_sub(1);
        if *left == 0 {
            exit.write(AppExit::Success);
        }
    }
}
