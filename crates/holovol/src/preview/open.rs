//! Opening what is dropped, named, or made by the program itself.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use bevy::prelude::*;
use bevy::tasks::{AsyncComputeTaskPool, Task, futures::check_ready};
use bevy_holovol::SceneParts;
use bevy_holovol::prelude::*;
use holovol_light::EnvironmentMap;
use holovol_volume::TransferFunctionFile;

use super::camera::Orbit;
use super::{FirstFiles, Session, Status};
use crate::demo;

pub(crate) struct OpenPlugin;

impl Plugin for OpenPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<Opening>()
            .add_systems(PostStartup, open_first)
            .add_systems(Update, (dropped, finish).chain());
    }
}

/// What is being read, one after the other.
#[derive(Resource, Default)]
pub(crate) struct Opening {
    waiting: Vec<PathBuf>,
    reading: Option<Reading>,
}

struct Reading {
    name: String,
    progress: Arc<[AtomicU64; 2]>,
    task: Task<Result<Opened, String>>,
}

enum Opened {
    Scene(Box<SceneParts>),
    Volume(Box<VolumeAsset>),
    TransferFunction(TransferFunctionAsset),
    Environment(EnvironmentAsset),
}

impl Opening {
    /// Reads a file or folder once those before it are read.
    pub(crate) fn open(&mut self, path: PathBuf) {
        self.waiting.push(path);
    }

    pub(crate) fn is_busy(&self) -> bool {
        self.reading.is_some() || !self.waiting.is_empty()
    }

    /// Name of what is being read, and the part of it that is (0 … 1), if that is known.
    pub(crate) fn progress(&self) -> Option<(&str, Option<f32>)> {
        let reading = self.reading.as_ref()?;
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
            progress,
            task: AsyncComputeTaskPool::get().spawn(async move { read(&told) }),
        });
    }
}

/// What a name says of its file; the readers themselves go by content.
fn read(path: &Path, told: &[AtomicU64; 2]) -> Result<Opened, String> {
    let name = path.to_string_lossy().to_lowercase();
    let progress = &mut |progress: holovol_volume::Progress| {
        told[0].store(progress.bytes, Ordering::Relaxed);
        told[1].store(progress.total_bytes, Ordering::Relaxed);
    };
    if name.ends_with(".tf.json") {
        let file = TransferFunctionFile::load(path).map_err(|error| error.to_string())?;
        Ok(Opened::TransferFunction(TransferFunctionAsset::new(file)))
    } else if name.ends_with(".json") {
        let scene = holovol_scene::load(path, progress).map_err(|error| error.to_string())?;
        Ok(Opened::Scene(Box::new(SceneParts::new(scene))))
    } else if name.ends_with(".hdr") || name.ends_with(".exr") {
        let map = EnvironmentMap::load(path).map_err(|error| error.to_string())?;
        Ok(Opened::Environment(EnvironmentAsset::new(map)))
    } else {
        let volume = holovol_volume::open(path, progress).map_err(|error| error.to_string())?;
        Ok(Opened::Volume(Box::new(VolumeAsset::new(volume))))
    }
}

/// The files of the command line, or a phantom in a room.
fn open_first(mut opening: ResMut<Opening>, files: Res<FirstFiles>) {
    opening.waiting.clone_from(&files.0);
    // A file of light or matter alone shows itself on the phantom.
    let is_volume = |path: &PathBuf| {
        let name = path.to_string_lossy().to_lowercase();
        ![".tf.json", ".hdr", ".exr"]
            .iter()
            .any(|end| name.ends_with(end))
    };
    if !files.0.iter().any(is_volume) {
        opening.begin("a head phantom".into(), |_| {
            let scene = demo::scene_in_memory().map_err(|failure| failure.to_string())?;
            Ok(Opened::Scene(Box::new(SceneParts::new(scene))))
        });
    }
}

fn dropped(mut events: MessageReader<FileDragAndDrop>, mut opening: ResMut<Opening>) {
    for event in events.read() {
        if let FileDragAndDrop::DroppedFile { path_buf, .. } = event {
            opening.open(path_buf.clone());
        }
    }
}

/// Takes in what has been read, and goes on with the next.
fn finish(mut opening: ResMut<Opening>, mut session: ResMut<Session>, mut show: Show) {
    if let Some(reading) = &mut opening.reading {
        let Some(result) = check_ready(&mut reading.task) else {
            return;
        };
        let name = std::mem::take(&mut reading.name);
        opening.reading = None;
        match result {
            Ok(opened) => show.show(&mut session, name, opened),
            Err(error) => session.status = Some(Status::Failed(error)),
        }
    }
    if !opening.waiting.is_empty() {
        let path = opening.waiting.remove(0);
        let name = path.file_name().unwrap_or(path.as_os_str());
        let name = name.to_string_lossy().into_owned();
        opening.begin(name, move |told| read(&path, told));
    }
}

#[derive(bevy::ecs::system::SystemParam)]
struct Show<'w, 's> {
    volumes: ResMut<'w, Assets<VolumeAsset>>,
    transfer_functions: ResMut<'w, Assets<TransferFunctionAsset>>,
    environments: ResMut<'w, Assets<EnvironmentAsset>>,
    environment: ResMut<'w, VolumeEnvironment>,
    shown: Query<
        'w,
        's,
        (
            &'static mut Volume3d,
            &'static mut VolumeMaterial3d,
            &'static mut VolumeMedium,
        ),
    >,
    cameras: Query<
        'w,
        's,
        (
            &'static mut Orbit,
            &'static mut VolumeRenderSettings,
            &'static mut Projection,
        ),
    >,
}

impl Show<'_, '_> {
    fn show(&mut self, session: &mut Session, name: String, opened: Opened) {
        let Ok((mut volume, mut material, mut medium)) = self.shown.get_mut(session.volume) else {
            return;
        };
        session.status = None;
        match opened {
            Opened::Scene(parts) => {
                *medium = parts.medium;
                material.0 = self.transfer_functions.add(parts.transfer_function);
                volume.0 = self.volumes.add(parts.volume);
                self.environment.source =
                    EnvironmentSource::Map(self.environments.add(parts.environment));
                self.environment.intensity = parts.intensity;
                self.environment.rotation_y = parts.rotation_y;
                if let Ok((mut orbit, mut settings, mut projection)) =
                    self.cameras.get_mut(session.camera)
                {
                    *orbit = Orbit::looking(parts.target, parts.camera.translation);
                    settings.max_scatters = parts.settings.max_scatters;
                    if let Projection::Perspective(perspective) = &mut *projection {
                        perspective.fov = parts.projection.fov;
                    }
                }
                session.name = name;
            }
            Opened::Volume(asset) => {
                let [low, high] = asset.volume().auto_window();
                *medium = VolumeMedium {
                    window: Some((low, high)),
                    gradient_factor: 2.0,
                    ..default()
                };
                material.0 = self
                    .transfer_functions
                    .add(TransferFunctionAsset::default());
                let matrix = asset.local_from_unit_cube();
                let size = [0, 1, 2].map(|i| matrix.col(i).truncate().length_squared());
                let diagonal = size.iter().sum::<f64>().sqrt() as f32;
                for notice in asset.volume().notices() {
                    session.status = Some(Status::Done(notice.clone()));
                }
                volume.0 = self.volumes.add(*asset);
                if let Ok((mut orbit, _, mut projection)) = self.cameras.get_mut(session.camera) {
                    let eye = Vec3::new(0.55, 0.25, 1.1).normalize() * 1.7 * diagonal;
                    *orbit = Orbit::looking(Vec3::ZERO, eye);
                    if let Projection::Perspective(perspective) = &mut *projection {
                        perspective.fov = std::f32::consts::FRAC_PI_4;
                    }
                }
                session.name = name;
            }
            Opened::TransferFunction(asset) => {
                // A window of its own belongs to it; else that of the scan stays.
                if let Some([low, high]) = asset.file().window {
                    medium.window = Some((low, high));
                }
                material.0 = self.transfer_functions.add(asset);
                session.status = Some(Status::Done(format!("{name} is the transfer function")));
            }
            Opened::Environment(asset) => {
                self.environment.source = EnvironmentSource::Map(self.environments.add(asset));
                session.status = Some(Status::Done(format!("{name} is the light")));
            }
        }
    }
}
