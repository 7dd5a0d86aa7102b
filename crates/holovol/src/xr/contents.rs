//! What is shown where there is no window: read from files before the headset is put on.

use std::path::{Path, PathBuf};

use bevy::prelude::*;
use bevy_holovol::SceneParts;
use bevy_holovol::prelude::*;
use holovol_light::EnvironmentMap;
use holovol_volume::TransferFunctionFile;

use crate::{Exit, Failure, demo};

/// A volume in its light.
#[derive(Resource, Clone)]
pub(super) struct Contents {
    volume: VolumeAsset,
    matter: TransferFunctionAsset,
    medium: VolumeMedium,
    environment: EnvironmentAsset,
    intensity: f32,
    rotation_y: f32,
}

impl Contents {
    /// Of these files, the later ones over the earlier; without a volume among them it is the
    /// phantom, without light the phantom's room.
    pub(super) fn read(files: &[PathBuf]) -> Result<Self, Failure> {
        let mut contents = Self::of_scene(demo::scene_in_memory()?);
        for file in files {
            contents.add(file)?;
        }
        Ok(contents)
    }

    fn of_scene(scene: holovol_scene::Scene) -> Self {
        let parts = SceneParts::new(scene);
        Self {
            volume: parts.volume,
            matter: parts.transfer_function,
            medium: parts.medium,
            environment: parts.environment,
            intensity: parts.intensity,
            rotation_y: parts.rotation_y,
        }
    }

    fn add(&mut self, path: &Path) -> Result<(), Failure> {
        let name = path.to_string_lossy().to_lowercase();
        let progress = &mut |_| {};
        if name.ends_with(".tf.json") {
            let file = TransferFunctionFile::load(path)
                .map_err(|error| Failure::new(Exit::Input, error.to_string()))?;
            if let Some([low, high]) = file.window {
                self.medium.window = Some((low, high));
            }
            self.matter = TransferFunctionAsset::new(file);
        } else if name.ends_with(".json") {
            *self = Self::of_scene(holovol_scene::load(path, progress)?);
        } else if name.ends_with(".hdr") || name.ends_with(".exr") {
            self.environment = EnvironmentAsset::new(EnvironmentMap::load(path)?);
            self.rotation_y = 0.0;
        } else {
            let volume = holovol_volume::open(path, progress)?;
            let [low, high] = volume.auto_window();
            for notice in volume.notices() {
                eprintln!("{}: {notice}", path.display());
            }
            self.medium = VolumeMedium {
                window: Some((low, high)),
                gradient_factor: 2.0,
                ..default()
            };
            self.matter = TransferFunctionAsset::default();
            self.volume = VolumeAsset::new(volume);
        }
        Ok(())
    }
}

/// `Startup`
pub(super) fn spawn(
    mut commands: Commands,
    contents: Res<Contents>,
    mut volumes: ResMut<Assets<VolumeAsset>>,
    mut functions: ResMut<Assets<TransferFunctionAsset>>,
    mut environments: ResMut<Assets<EnvironmentAsset>>,
    mut environment: ResMut<VolumeEnvironment>,
) {
    let contents = contents.clone();
    environment.source = EnvironmentSource::Map(environments.add(contents.environment));
    environment.intensity = contents.intensity;
    environment.rotation_y = contents.rotation_y;
    commands.spawn((
        Volume3d(volumes.add(contents.volume)),
        VolumeMaterial3d(functions.add(contents.matter)),
        contents.medium,
    ));
    commands.remove_resource::<Contents>();
}
