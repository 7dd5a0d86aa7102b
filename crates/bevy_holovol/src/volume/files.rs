//! Opening files and folders anywhere on the disk, with progress that can be shown.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use bevy::asset::AssetHandleProvider;
use bevy::ecs::system::SystemParam;
use bevy::prelude::*;
use bevy::tasks::{AsyncComputeTaskPool, Task, futures::check_ready};
use holovol_volume::{CancelFlag, ReadOptions, Volume, VolumeError};

use super::VolumeAsset;

/// Opens volume files and folders that lie anywhere, off the main thread.
///
/// ```
/// # use bevy::prelude::*;
/// # use bevy_holovol::prelude::*;
/// fn open(mut commands: Commands, mut files: VolumeFiles) {
///     commands.spawn(Volume3d(files.open("/data/scan.nii.gz")));
/// }
/// # let mut app = App::new();
/// # app.add_plugins((MinimalPlugins, AssetPlugin::default()));
/// # app.add_plugins((bevy_holovol::VolumePlugin, bevy_holovol::TransferFunctionPlugin));
/// # app.add_systems(Startup, open).update();
/// ```
#[derive(SystemParam)]
pub struct VolumeFiles<'w> {
    assets: Res<'w, Assets<VolumeAsset>>,
    loads: ResMut<'w, Loads>,
}

/// How far a file has been read.
#[derive(Clone, Debug)]
pub struct VolumeLoadProgress {
    /// The file or folder.
    pub path: PathBuf,
    /// Bytes of voxels so far.
    pub bytes: u64,
    /// Bytes of voxels in all; 0 while unknown.
    pub total_bytes: u64,
    /// Why it could not be read. [`VolumeError::Choose`] lists what
    /// [`ReadOptions::choice`] can choose from.
    pub error: Option<Arc<VolumeError>>,
}

/// What is being read, and what could not be.
#[derive(Resource, Default)]
pub(super) struct Loads(Vec<Load>);

struct Load {
    path: PathBuf,
    handle: Handle<VolumeAsset>,
    progress: Arc<[AtomicU64; 2]>,
    cancel: CancelFlag,
    task: Option<Task<Result<Volume, VolumeError>>>,
    error: Option<Arc<VolumeError>>,
}

impl VolumeFiles<'_> {
    /// Begins to read a file or folder; the handle's asset is there once that is done.
    pub fn open(&mut self, path: impl AsRef<Path>) -> Handle<VolumeAsset> {
        self.open_with(path, ReadOptions::default())
    }

    /// [`Self::open`] with a choice among several volumes, a limit, or the layout of a file without
    /// a header.
    pub fn open_with(
        &mut self,
        path: impl AsRef<Path>,
        options: ReadOptions,
    ) -> Handle<VolumeAsset> {
        let path = path.as_ref().to_owned();
        let provider: AssetHandleProvider = self.assets.get_handle_provider();
        let handle = provider.reserve_handle().typed::<VolumeAsset>();
        let progress = Arc::new([const { AtomicU64::new(0) }; 2]);
        let (file, told) = (path.clone(), Arc::clone(&progress));
        let cancel = options.cancel.clone();
        let task = AsyncComputeTaskPool::get().spawn(async move {
            holovol_volume::open_with(&file, &options, &mut |progress| {
                told[0].store(progress.bytes, Ordering::Relaxed);
                told[1].store(progress.total_bytes, Ordering::Relaxed);
            })
        });
        self.loads.0.push(Load {
            path,
            handle: handle.clone(),
            progress,
            cancel,
            task: Some(task),
            error: None,
        });
        handle
    }

    /// How far a handle of [`Self::open`] has come; `None` once its asset is there, or if it came
    /// from elsewhere.
    pub fn progress(&self, handle: &Handle<VolumeAsset>) -> Option<VolumeLoadProgress> {
        let load = self.loads.0.iter().find(|load| load.handle == *handle)?;
        Some(load.progress())
    }

    /// Everything that is being read, and what could not be.
    pub fn all(&self) -> impl Iterator<Item = VolumeLoadProgress> {
        self.loads.0.iter().map(Load::progress)
    }

    /// Stops reading for this handle, within some megabytes, and forgets why it could not be read.
    pub fn cancel(&mut self, handle: &Handle<VolumeAsset>) {
        self.loads.0.retain(|load| {
            let is_other = load.handle != *handle;
            if !is_other {
                load.cancel.cancel();
            }
            is_other
        });
    }
}

impl Load {
    fn progress(&self) -> VolumeLoadProgress {
        let [bytes, total_bytes] = [0, 1].map(|i: usize| self.progress[i].load(Ordering::Relaxed));
        VolumeLoadProgress {
            path: self.path.clone(),
            bytes,
            total_bytes,
            error: self.error.clone(),
        }
    }
}

pub(super) fn finish_loads(mut loads: ResMut<Loads>, mut assets: ResMut<Assets<VolumeAsset>>) {
    if loads.0.is_empty() {
        return;
    }
    loads.0.retain_mut(|load| {
        let Some(result) = load.task.as_mut().and_then(check_ready) else {
            return true;
        };
        load.task = None;
        match result {
            Ok(volume) => {
                let inserted = assets.insert(&load.handle, VolumeAsset::new(volume));
                if let Err(error) = inserted {
                    debug!("{}: {error}", load.path.display());
                }
                false
            }
            Err(error) => {
                error!("{error}");
                load.error = Some(Arc::new(error));
                true
            }
        }
    });
}
