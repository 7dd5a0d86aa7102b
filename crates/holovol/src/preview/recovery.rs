//! A graphics device that is lost, or runs out of memory: the window is opened anew with the view
//! that it had.
//!
//! Bevy can open another device, but the panel's renderer keeps buffers of the old one. So the
//! program starts itself again.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, PoisonError};
use std::time::{Instant, SystemTime};

use bevy::prelude::*;
use bevy::render::error_handler::{ErrorType, RenderError, RenderErrorHandler, RenderErrorPolicy};
use bevy::render::render_resource::PollType;
use bevy::render::renderer::RenderDevice;
use bevy::render::{Render, RenderApp, RenderSystems};
use serde::{Deserialize, Serialize};

use super::camera::Orbit;
use super::look::{LightSource, Look};
use super::panel::viewpoint;
use super::scene_io;
use super::studio::Studio;
use super::{Session, Status};
use crate::{Exit, Failure, output};

pub(crate) struct RecoveryPlugin {
    /// Those of the command line.
    pub(crate) size: [u32; 2],
    /// `--camera`.
    pub(crate) camera: Option<String>,
    pub(crate) restored: Option<Restored>,
}

/// What a window that ends leaves to the next one.
#[derive(Resource, Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Restored {
    /// A scene file; none for what the program makes itself.
    scene: Option<PathBuf>,
    /// The scene's own light could not be named: the light that is there stays.
    pub(crate) keeps_light: bool,
    /// Why there is another window, for its user.
    reason: String,
    /// Windows before this one, of late.
    attempts: u32,
}

/// What a restart needs; the hook of panics has no other way to it.
static VIEW: Mutex<View> = Mutex::new(View {
    size: [1280, 800],
    camera: None,
    attempts: 0,
    started: None,
    scene: None,
});

struct View {
    size: [u32; 2],
    camera: Option<String>,
    attempts: u32,
    started: Option<Instant>,
    scene: Option<(String, bool)>,
}

/// More windows than this that end within [`SOON`] are not worth another.
const MOST: u32 = 3;
const SOON: f32 = 60.0;

impl Plugin for RecoveryPlugin {
    fn build(&self, app: &mut App) {
        let attempts = self
            .restored
            .as_ref()
            .map_or(0, |restored| restored.attempts);
        *view() = View {
            size: self.size,
            camera: self.camera.clone(),
            attempts,
            started: Some(Instant::now()),
            scene: None,
        };
        if let Some(restored) = &self.restored {
            app.insert_resource(restored.clone())
                .add_systems(PostStartup, tell);
        }
        app.insert_resource(RenderErrorHandler(handle))
            .add_systems(Last, remember);
        if let Some(app) = app.get_sub_app_mut(RenderApp) {
            app.add_systems(Render, notice.in_set(RenderSystems::PostCleanup));
        }
        restart_after_panics();
    }
}

fn view() -> std::sync::MutexGuard<'static, View> {
    VIEW.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Bevy looks for a lost device before each frame, but the device tells of it only when polled.
fn notice(device: Res<RenderDevice>) {
    // One that can't be polled is found lost in what follows.
    let _ = device.wgpu_device().poll(PollType::Poll);
}

fn handle(error: &RenderError, _: &mut World, _: &mut World) -> RenderErrorPolicy {
    let what = match error.ty {
        ErrorType::DeviceLost => "The graphics device was lost: its driver crashed, or it slept.",
        ErrorType::OutOfMemory => "The graphics device ran out of memory.",
        ErrorType::Validation | ErrorType::Internal => "The graphics device refused a command.",
    };
    restart(what)
}

/// What is found lost within a frame ends in a panic of the graphics library.
fn restart_after_panics() {
    let before = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        before(panic);
        let is_graphics = |place: &std::panic::Location| {
            Path::new(place.file()).components().any(|part| {
                let part = part.as_os_str().to_string_lossy();
                part.starts_with("wgpu")
            })
        };
        if panic.location().is_some_and(is_graphics) {
            restart("The graphics device failed in the middle of a frame.");
        }
    }));
}

/// Keeps the view as a scene, whenever it changes.
fn remember(
    studio: Res<Studio>,
    session: Res<Session>,
    cameras: Query<super::panel::CameraParts>,
    mut last: Local<Option<(Look, Orbit)>>,
) {
    let Ok(camera) = cameras.get(session.camera) else {
        return;
    };
    let orbit = *camera.0;
    let is_same = |(look, place): &(Look, Orbit)| *look == studio.look && *place == orbit;
    if last.as_ref().is_some_and(is_same) {
        return;
    }
    *last = Some((studio.look.clone(), orbit));
    view().scene = scene(&studio, viewpoint(camera));
}

/// The view as a scene with absolute paths, and whether its light has no file.
fn scene(studio: &Studio, view: Option<scene_io::Viewpoint>) -> Option<(String, bool)> {
    let scan = studio.scan.as_ref().filter(|scan| scan.path.is_some())?;
    let mut file = scene_io::scene_file(&studio.look, scan, &view?);
    file.volume.path = std::path::absolute(&file.volume.path).ok()?;
    let mut keeps_light = false;
    match &studio.look.light.source {
        LightSource::Map {
            path: Some(path), ..
        } => file.environment.path = Some(std::path::absolute(path).ok()?),
        LightSource::Map { path: None, .. } => {
            keeps_light = true;
            file.environment.path = None;
            file.environment.constant = Some([1.0; 3]);
        }
        LightSource::Constant(_) => {}
    }
    Some((file.to_json().ok()?, keeps_light))
}

/// Starts the program again in the place of this one, unless that was done too often.
fn restart(reason: &str) -> ! {
    let view = view();
    let is_soon = view
        .started
        .is_some_and(|started| started.elapsed().as_secs_f32() < SOON);
    let attempts = if is_soon { view.attempts + 1 } else { 1 };
    if attempts > MOST {
        eprintln!("error: {reason} That happened {attempts} times within minutes; giving up.");
        std::process::exit(Exit::Device as i32);
    }
    let handed = hand_over(&view, reason, attempts).and_then(|file| {
        let program = std::env::current_exe()?;
        let [width, height] = view.size;
        let mut command = Command::new(program);
        command
            .args([
                "preview",
                "--size",
                &format!("{width}x{height}"),
                "--restore",
            ])
            .arg(file);
        if let Some(camera) = &view.camera {
            command.args(["--camera", camera]);
        }
        replace(&mut command)
    });
    if let Err(error) = handed {
        eprintln!("error: {reason} The window could not be opened anew: {error}");
    }
    std::process::exit(Exit::Device as i32);
}

/// Writes down what the next window shall show.
fn hand_over(view: &View, reason: &str, attempts: u32) -> std::io::Result<PathBuf> {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    let name = format!(
        "holovol-{}-{}",
        std::process::id(),
        since.unwrap_or_default().as_nanos()
    );
    let base = std::env::temp_dir().join(name);
    let write = |text: &str, path: &Path| {
        output::write_text(text, path).map_err(|failure| std::io::Error::other(failure.to_string()))
    };
    let scene = match &view.scene {
        Some((json, _)) => {
            let path = base.with_extension("json");
            write(json, &path)?;
            Some(path)
        }
        None => None,
    };
    let restored = Restored {
        scene,
        keeps_light: view.scene.as_ref().is_some_and(|scene| scene.1),
        reason: reason.into(),
        attempts,
    };
    let path = base.with_extension("restore");
    write(&serde_json::to_string(&restored)?, &path)?;
    Ok(path)
}

#[cfg(unix)]
fn replace(command: &mut Command) -> std::io::Result<()> {
    use std::os::unix::process::CommandExt;
    Err(command.exec())
}

#[cfg(not(unix))]
fn replace(command: &mut Command) -> std::io::Result<()> {
    command.spawn()?;
    Ok(())
}

impl Restored {
    /// Takes over from the last window, whose files it removes.
    pub(crate) fn read(path: &Path) -> Result<Self, Failure> {
        let input =
            |error: String| Failure::new(Exit::Input, format!("{}: {error}", path.display()));
        let text = std::fs::read_to_string(path).map_err(|error| input(error.to_string()))?;
        let restored = serde_json::from_str(&text).map_err(|error| input(error.to_string()))?;
        let _ = std::fs::remove_file(path);
        Ok(restored)
    }

    pub(crate) fn files(&self) -> Vec<PathBuf> {
        self.scene.iter().cloned().collect()
    }

    /// Whether this file was only made to restore from: it is removed once it is read.
    pub(crate) fn forget(&mut self, path: &Path) -> bool {
        let is_it = self.scene.as_deref() == Some(path);
        if is_it {
            let _ = std::fs::remove_file(path);
            self.scene = None;
        }
        is_it
    }

    pub(crate) fn status(&self) -> Status {
        Status::Failed(format!("{} The window was opened anew.", self.reason))
    }
}

fn tell(mut session: ResMut<Session>, restored: Res<Restored>) {
    session.status = Some(restored.status());
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::preview::tests::{blob, look, viewpoint};

    #[test]
    fn a_window_hands_its_view_to_the_next() {
        let mut studio = Studio {
            look: look(Handle::default()),
            scan: Some(blob()),
            ..default()
        };
        // What the program makes itself has no file to come back to.
        assert_eq!(scene(&studio, Some(viewpoint())), None);
        studio.scan.as_mut().unwrap().path = Some("scans/blob.nrrd".into());
        let view = View {
            size: [640, 480],
            camera: None,
            attempts: 0,
            started: None,
            scene: scene(&studio, Some(viewpoint())),
        };
        let file = hand_over(&view, "The device was lost.", 2).unwrap();
        let mut restored = Restored::read(&file).unwrap();
        assert!(!file.exists());
        assert_eq!(restored.attempts, 2);
        assert!(restored.keeps_light, "the room has no file");
        let [scene] = &restored.files()[..] else {
            panic!("one scene")
        };
        let read = holovol_scene::SceneFile::read(scene).unwrap();
        assert_eq!(read.volume.window, Some(studio.look.window));
        assert!(read.volume.path.is_absolute());
        assert_eq!(read.environment.constant, Some([1.0; 3]));
        assert!(restored.forget(scene));
        assert!(!scene.exists() && restored.files().is_empty());
    }
}
