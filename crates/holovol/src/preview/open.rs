//! Opening what is dropped, named, or made by the program itself.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::JoinHandle;

use bevy::diagnostic::FrameCount;
use bevy::prelude::*;
use bevy_holovol::SceneParts;
use bevy_holovol::environment::DEFAULT_INTENSITY;
use bevy_holovol::prelude::*;
use holovol_light::EnvironmentMap;
use holovol_scene::{Background, Scene, SceneFile};
use holovol_volume::{CancelFlag, Content, ReadOptions, TransferFunctionFile, VolumeError};

use super::camera::Orbit;
use super::lights::Overview;
use super::look::{Light, LightSource, Look};
use super::presets::Preset;
use super::recovery::Restored;
use super::settings::Settings;
use super::studio::{Scan, Studio};
use super::{FirstFiles, Session, Status};
use crate::demo;
use crate::kinds::FileKind;
use crate::light::{self, Panorama};

pub(crate) struct OpenPlugin;

impl Plugin for OpenPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<Opening>()
            .add_systems(PostStartup, open_first)
            .add_systems(Update, (dropped, finish, begin_history).chain());
    }
}

/// What the window begins with is nothing to undo.
fn begin_history(mut studio: ResMut<Studio>, opening: Res<Opening>, mut has_begun: Local<bool>) {
    if !*has_begun && studio.scan.is_some() && !opening.is_busy() {
        *has_begun = true;
        let Studio { look, history, .. } = &mut *studio;
        history.begin(look);
    }
}

/// What is being read, one after the other.
#[derive(Resource, Default)]
pub(crate) struct Opening {
    /// What the program makes itself, before all else.
    own: Option<Own>,
    waiting: Vec<Wish>,
    reading: Option<Reading>,
    /// A file of several volumes, until one of them is chosen.
    pub(crate) choosing: Option<Choosing>,
}

/// A file or folder to open, and which of its volumes.
#[derive(Clone)]
struct Wish {
    path: PathBuf,
    choice: Option<String>,
}

/// What a person is asked.
pub(crate) struct Choosing {
    pub(crate) path: PathBuf,
    /// What there are several of: series, grids.
    pub(crate) what: &'static str,
    pub(crate) contents: Vec<Content>,
}

#[derive(Clone, Copy, PartialEq)]
enum Own {
    Room,
    Phantom,
}

impl Own {
    fn name(self) -> &'static str {
        match self {
            Self::Room => "the light of a room",
            Self::Phantom => "a head phantom in a room",
        }
    }

    fn make(self) -> Result<Opened, String> {
        match self {
            Self::Room => Ok(Opened::Room(demo::environment())),
            Self::Phantom => {
                let scene = demo::scene_in_memory().map_err(|failure| failure.to_string())?;
                let mut opened = OpenedScene::new(scene);
                // Its values are names of materials; slices show these apart.
                opened.scan.grey = [2.0, -14.0];
                Ok(Opened::Scene(Box::new(opened)))
            }
        }
    }
}

struct Reading {
    name: String,
    /// Of what a person opened.
    path: Option<PathBuf>,
    /// For what can be stopped.
    cancel: Option<CancelFlag>,
    progress: Arc<[AtomicU64; 2]>,
    thread: JoinHandle<Result<Opened, String>>,
}

enum Opened {
    Scene(Box<OpenedScene>),
    Volume(Box<Scan>),
    TransferFunction(TransferFunctionFile),
    Environment(Box<OpenedLight>),
    Choosing(Choosing),
    /// The light for scans that come without one.
    Room(EnvironmentMap),
}

struct OpenedScene {
    parts: SceneParts,
    scan: Scan,
    light: Option<PathBuf>,
    exposure_ev: f64,
    is_sky: bool,
}

impl OpenedScene {
    fn new(scene: Scene) -> Self {
        let parts = SceneParts::new(scene);
        let scan = Scan::new(parts.volume.clone());
        Self {
            parts,
            scan,
            light: None,
            exposure_ev: 0.0,
            is_sky: true,
        }
    }
}

struct OpenedLight {
    panorama: Panorama,
    /// What shows chalk in it just below white.
    exposure_ev: f64,
    /// Its file, if that holds the light itself.
    path: Option<PathBuf>,
}

impl Opening {
    /// Reads a file or folder once those before it are read.
    pub(crate) fn open(&mut self, path: PathBuf) {
        self.waiting.push(Wish { path, choice: None });
    }

    pub(crate) fn can_cancel(&self) -> bool {
        let is_stoppable = |reading: &Reading| reading.cancel.is_some();
        self.reading.as_ref().is_some_and(is_stoppable)
    }

    /// Gives up what is being read; false if there is nothing that can be stopped.
    pub(crate) fn cancel(&mut self) -> bool {
        let cancel = self
            .reading
            .as_ref()
            .and_then(|reading| reading.cancel.as_ref());
        if let Some(cancel) = cancel {
            cancel.cancel();
            self.waiting.clear();
        }
        cancel.is_some()
    }

    /// Asks which of the volumes of a file is wanted, also where one is read without asking.
    pub(crate) fn ask(&mut self, path: PathBuf) {
        self.begin(file_name(&path), move |_| {
            let contents = holovol_volume::contents(&path, &ReadOptions::default())
                .map_err(|error| error.to_string())?;
            Ok(Opened::Choosing(Choosing {
                path,
                what: "volumes",
                contents,
            }))
        });
    }

    /// Reads the volume of this number, from 1, of the file that is asked about.
    pub(crate) fn choose(&mut self, number: usize) {
        if let Some(choosing) = self.choosing.take() {
            self.waiting.push(Wish {
                path: choosing.path,
                choice: Some(number.to_string()),
            });
        }
    }

    pub(crate) fn is_busy(&self) -> bool {
        let waits = self.choosing.is_none() && !self.waiting.is_empty();
        self.reading.is_some() || waits || self.own.is_some()
    }

    /// Name of what is being read, and the part of it that is (0 … 1), if that is known.
    pub(crate) fn progress(&self) -> Option<(&str, Option<f32>)> {
        let Some(reading) = &self.reading else {
            return self.own.map(|own| (own.name(), None));
        };
        let [done, total] = [0, 1].map(|i: usize| reading.progress[i].load(Ordering::Relaxed));
        let part = (total > 0).then(|| (done as f64 / total as f64) as f32);
        Some((&reading.name, part))
    }

    fn begin(
        &mut self,
        name: String,
        read: impl FnOnce(&[AtomicU64; 2]) -> Result<Opened, String> + Send + 'static,
    ) {
        let progress = Arc::new([const { AtomicU64::new(0) }; 2]);
        let told = Arc::clone(&progress);
        self.reading = Some(Reading {
            name,
            path: None,
            cancel: None,
            progress,
            // Not on Bevy's workers: the window's own pipelines are compiled by these meanwhile.
            thread: std::thread::spawn(move || read(&told)),
        });
    }
}

/// What a name says of its file; the readers themselves go by content.
fn read(wish: Wish, cancel: CancelFlag, told: &[AtomicU64; 2]) -> Result<Opened, String> {
    let path = wish.path.as_path();
    let progress = &mut |progress: holovol_volume::Progress| {
        told[0].store(progress.bytes, Ordering::Relaxed);
        told[1].store(progress.total_bytes, Ordering::Relaxed);
    };
    match FileKind::of(path) {
        FileKind::TransferFunction => {
            let file = TransferFunctionFile::load(path).map_err(|error| error.to_string())?;
            Ok(Opened::TransferFunction(file))
        }
        FileKind::Scene => {
            let scene = holovol_scene::load(path, progress).map_err(|error| error.to_string())?;
            let file = SceneFile::read(path).map_err(|error| error.to_string())?;
            let base = path.parent().unwrap_or(Path::new(""));
            let overview = Overview::new(&scene.environment.map);
            let scale = scene.environment.scale;
            let mut opened = OpenedScene::new(scene);
            opened.scan.path = Some(base.join(&file.volume.path));
            opened.scan.choice = file.volume.choice;
            opened.light = file.environment.path.map(|light| base.join(light));
            if let Some(output) = &file.output {
                opened.is_sky = output.background == Background::Environment;
            }
            let exposure = file.output.and_then(|output| output.exposure_ev);
            let auto = || overview.exposure_ev() - scale.max(f64::MIN_POSITIVE).log2();
            opened.exposure_ev = exposure.unwrap_or_else(auto);
            Ok(Opened::Scene(Box::new(opened)))
        }
        FileKind::Panorama { is_hdr } => {
            let panorama = light::panorama(path).map_err(|failure| failure.to_string())?;
            Ok(Opened::Environment(Box::new(OpenedLight {
                exposure_ev: Overview::new(&panorama.map).exposure_ev(),
                panorama,
                path: is_hdr.then(|| path.into()),
            })))
        }
        FileKind::Volume => {
            let mut options = ReadOptions::default().with_cancel(cancel);
            options.choice.clone_from(&wish.choice);
            let volume = match holovol_volume::open_with(path, &options, progress) {
                Err(VolumeError::Choose { what, contents, .. }) => {
                    return Ok(Opened::Choosing(Choosing {
                        path: path.into(),
                        what,
                        contents,
                    }));
                }
                result => result.map_err(|error| error.to_string())?,
            };
            let mut scan = Scan::new(VolumeAsset::new(volume));
            scan.path = Some(path.into());
            scan.choice = wish.choice;
            Ok(Opened::Volume(Box::new(scan)))
        }
    }
}

/// The files of the command line, or a phantom in a room.
fn open_first(mut opening: ResMut<Opening>, files: Res<FirstFiles>) {
    for path in &files.0 {
        opening.open(path.clone());
    }
    // A file of light or matter alone shows itself on the phantom.
    let is_volume =
        |path: &PathBuf| matches!(FileKind::of(path), FileKind::Scene | FileKind::Volume);
    opening.own = Some(if files.0.iter().any(is_volume) {
        Own::Room
    } else {
        Own::Phantom
    });
}

fn dropped(mut events: MessageReader<FileDragAndDrop>, mut opening: ResMut<Opening>) {
    let files = events.read().filter_map(|event| match event {
        FileDragAndDrop::DroppedFile { path_buf, .. } => Some(path_buf.clone()),
        _ => None,
    });
    for path in as_folder(files.collect()) {
        opening.open(path);
    }
}

/// Slices of a series that are dropped one by one are their folder.
fn as_folder(files: Vec<PathBuf>) -> Vec<PathBuf> {
    let is_slice = |path: &PathBuf| {
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        path.is_file() && matches!(extension.as_deref(), None | Some("dcm" | "ima"))
    };
    let folder = files.first().and_then(|path| path.parent());
    let is_series = files.len() > 1
        && files.iter().all(|path| path.parent() == folder)
        && files.iter().all(is_slice);
    match folder {
        Some(folder) if is_series => vec![folder.into()],
        _ => files,
    }
}

/// Takes in what has been read, and goes on with the next.
fn finish(
    mut opening: ResMut<Opening>,
    mut session: ResMut<Session>,
    mut show: Show,
    frames: Res<FrameCount>,
) {
    /// The window is seen, and says what is going on, before all cores are taken.
    const FRAMES_FIRST: u32 = 4;
    if frames.0 < FRAMES_FIRST {
        return;
    }
    let is_reading = |reading: &Reading| !reading.thread.is_finished();
    if opening.reading.as_ref().is_some_and(is_reading) {
        return;
    }
    if let Some(reading) = opening.reading.take() {
        let (name, path) = (reading.name, reading.path);
        let result = reading.thread.join().unwrap_or_else(|_| {
            Err(format!(
                "{name} could not be read, by a mistake of this program; please report it with \
                 the file's format"
            ))
        });
        match result {
            Ok(Opened::Choosing(choosing)) if choosing.contents.len() < 2 => {
                session.status = Some(Status::Done(format!("{name} holds one volume only")));
            }
            Ok(Opened::Choosing(choosing)) => opening.choosing = Some(choosing),
            Ok(opened) => show.take(&mut session, name, path.as_deref(), opened),
            Err(error) => session.status = Some(Status::Failed(error)),
        }
    }
    if let Some(own) = opening.own.take() {
        opening.begin(own.name().into(), move |_| own.make());
    } else if opening.choosing.is_none() && !opening.waiting.is_empty() {
        let wish = opening.waiting.remove(0);
        let path = wish.path.clone();
        let cancel = CancelFlag::default();
        let is_volume = FileKind::of(&path) == FileKind::Volume;
        let stop = is_volume.then(|| cancel.clone());
        opening.begin(file_name(&path), move |told| read(wish, cancel, told));
        if let Some(reading) = &mut opening.reading {
            reading.path = Some(path);
            reading.cancel = stop;
        }
    }
}

#[derive(bevy::ecs::system::SystemParam)]
struct Show<'w, 's> {
    restored: Option<ResMut<'w, Restored>>,
    studio: ResMut<'w, Studio>,
    settings: ResMut<'w, Settings>,
    volumes: ResMut<'w, Assets<VolumeAsset>>,
    environments: ResMut<'w, Assets<EnvironmentAsset>>,
    shown: Query<'w, 's, &'static mut Volume3d>,
    cameras: Query<'w, 's, (&'static mut Orbit, &'static mut Projection)>,
}

impl Show<'_, '_> {
    fn take(&mut self, session: &mut Session, name: String, path: Option<&Path>, opened: Opened) {
        let Some(path) = path else {
            return self.show(session, name, opened);
        };
        let restored = self.restored.as_deref_mut();
        if restored.is_some_and(|restored| restored.forget(path)) {
            self.restore(session, opened);
        } else {
            self.show(session, name, opened);
            self.settings.note_recent(path);
        }
    }

    /// The view of a window that had to end.
    fn restore(&mut self, session: &mut Session, opened: Opened) {
        let name = match &opened {
            Opened::Scene(opened) => opened.scan.path.as_deref().map(file_name),
            _ => None,
        };
        let room = self.studio.look.light.source.clone();
        self.show(session, name.unwrap_or_default(), opened);
        if let Some(restored) = &self.restored {
            if restored.keeps_light {
                self.studio.look.light.source = room;
            }
            session.status = Some(restored.status());
        }
        let studio = &mut *self.studio;
        studio.history.begin(&studio.look);
    }

    fn show(&mut self, session: &mut Session, name: String, opened: Opened) {
        session.status = None;
        match opened {
            Opened::Scene(opened) => {
                let parts = opened.parts;
                let map = self.environments.add(parts.environment);
                let stops = (parts.intensity / DEFAULT_INTENSITY).log2();
                let function = parts.transfer_function.file();
                let mut look = Look {
                    window: parts.medium.window.map_or([0.0, 1.0], |(a, b)| [a, b]),
                    gradient_factor: parts.medium.gradient_factor,
                    phase_g: parts.medium.phase_g,
                    light: Light {
                        source: LightSource::Map {
                            map,
                            name: match &opened.light {
                                Some(path) => file_name(path),
                                None => "demo room".into(),
                            },
                            path: opened.light,
                        },
                        rotation_deg: f64::from(parts.rotation_y).to_degrees(),
                        stops: f64::from(stops),
                        is_sky: opened.is_sky,
                    },
                    exposure_ev: opened.exposure_ev,
                    max_scatters: parts.settings.max_scatters,
                    points: function.transfer_function.points().to_vec(),
                    optical_depth_scale: function.optical_depth_scale,
                    ..Look::default()
                };
                look.set_cuts(&parts.clip_planes, opened.scan.world_from_unit_cube());
                let up = parts.camera.up().as_vec3();
                let orbit = Orbit::looking(parts.target, parts.camera.translation, up);
                self.begin(session, name, opened.scan, look);
                self.place_camera(session, orbit, parts.projection.fov);
            }
            Opened::Volume(scan) => {
                let mut look = Look {
                    // The light stays: this scan stands in the same room as the last.
                    light: self.studio.look.light.clone(),
                    exposure_ev: self.studio.look.exposure_ev,
                    ..Look::default()
                };
                Preset::Automatic.apply(&mut look, &scan);
                let notices = scan.volume().notices();
                session.status = (!notices.is_empty()).then(|| Status::Done(notices.join("\n")));
                let distance = 3.4 * scan.radius() as f32;
                let eye = Vec3::new(0.55, 0.25, 1.1).normalize() * distance;
                let middle = scan.middle().as_vec3();
                self.begin(session, name, *scan, look);
                let orbit = Orbit::looking(middle, middle + eye, Vec3::Y);
                self.place_camera(session, orbit, std::f32::consts::FRAC_PI_4);
            }
            Opened::TransferFunction(file) => {
                self.studio.look.set_transfer_function(&file);
                session.status = Some(Status::Done(format!("{name} is the transfer function")));
            }
            Opened::Environment(light) => {
                self.light(light.panorama.map, light.path, name.clone());
                let look = &mut self.studio.look;
                look.exposure_ev = light.exposure_ev - look.light.stops;
                let mut lines = vec![format!("{name} is the light")];
                lines.extend(light.panorama.notes);
                session.status = Some(Status::Done(lines.join("\n")));
            }
            Opened::Room(map) => {
                self.light(map, None, "demo room".into());
                // Nobody chose what was there before.
                let studio = &mut *self.studio;
                studio.history.begin(&studio.look);
            }
            // That is asked before.
            Opened::Choosing(_) => {}
        }
    }

    fn light(&mut self, map: EnvironmentMap, path: Option<PathBuf>, name: String) {
        let map = self.environments.add(EnvironmentAsset::new(map));
        self.studio.look.light.source = LightSource::Map { map, path, name };
    }

    fn begin(&mut self, session: &mut Session, name: String, scan: Scan, look: Look) {
        if let Ok(mut volume) = self.shown.get_mut(session.volume) {
            volume.0 = self.volumes.add(scan.asset.clone());
        }
        session.name = name;
        self.studio.history.begin(&look);
        self.studio.look = look;
        self.studio.scan = Some(scan);
        self.studio.opened += 1;
    }

    fn place_camera(&mut self, session: &Session, orbit: Orbit, fov: f32) {
        if let Ok((mut old, mut projection)) = self.cameras.get_mut(session.camera) {
            *old = orbit;
            if let Projection::Perspective(perspective) = &mut *projection {
                perspective.fov = fov;
            }
        }
    }
}

fn file_name(path: &Path) -> String {
    let name = path.file_name().unwrap_or(path.as_os_str());
    name.to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slices_that_are_dropped_together_are_their_folder() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, "").unwrap();
            path
        };
        let slices = vec![place("1.dcm"), place("IM0002")];
        assert_eq!(as_folder(slices.clone()), [folder.path()]);
        assert_eq!(as_folder(vec![slices[0].clone()]), slices[..1]);
        let mixed = vec![slices[0].clone(), place("head.nii")];
        assert_eq!(as_folder(mixed.clone()), mixed);
    }
}
