//! The scan that is shown, how it is shown, and how that gets into Bevy's scene.

use std::path::PathBuf;

use bevy::camera::Exposure;
use bevy::prelude::*;
use bevy_holovol::prelude::*;
use glam::{DMat4, DVec3};
use holovol_volume::{Histogram, Volume};

use super::Session;
use super::look::{History, LightSource, Look};

pub(crate) struct StudioPlugin;

impl Plugin for StudioPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<Studio>()
            .init_resource::<Applied>()
            .add_systems(PostUpdate, apply.before(TransformSystems::Propagate));
    }
}

/// What is looked at, and how.
#[derive(Resource, Default)]
pub(crate) struct Studio {
    pub(crate) look: Look,
    pub(crate) history: History,
    pub(crate) scan: Option<Scan>,
    /// Scans opened so far: tells one from another.
    pub(crate) opened: u32,
}

/// A volume with what the panel wants to know of it.
#[derive(Clone, Debug)]
pub(crate) struct Scan {
    /// Its file or folder, unless the program made it.
    pub(crate) path: Option<PathBuf>,
    /// Which of the file's volumes.
    pub(crate) choice: Option<String>,
    pub(crate) asset: VolumeAsset,
    pub(crate) histogram: Histogram,
    /// What slices show as black and white.
    pub(crate) grey: [f64; 2],
}

impl Scan {
    /// Counts values: not for the main thread.
    pub(crate) fn new(asset: VolumeAsset) -> Self {
        Self {
            path: None,
            choice: None,
            histogram: asset.volume().histogram(),
            grey: asset
                .volume()
                .header_window()
                .unwrap_or_else(|| asset.volume().auto_window()),
            asset,
        }
    }

    pub(crate) fn volume(&self) -> &Volume {
        self.asset.volume()
    }

    pub(crate) fn world_from_unit_cube(&self) -> DMat4 {
        self.asset.local_from_unit_cube()
    }

    /// Its axes are the patient's: the file says so, and it stands as the file has it.
    pub(crate) fn is_patient(&self) -> bool {
        let (here, in_file) = (
            self.world_from_unit_cube(),
            self.volume().world_from_unit_cube(),
        );
        let stands = (0..3).all(|axis| {
            let [here, in_file] =
                [here, in_file].map(|m| m.col(axis).truncate().normalize_or_zero());
            here.dot(in_file) > 0.9999
        });
        self.volume().geometry().oriented && stands
    }

    pub(crate) fn longest_edge(&self) -> f64 {
        let matrix = self.world_from_unit_cube();
        let edge = |axis| matrix.col(axis).truncate().length();
        edge(0).max(edge(1)).max(edge(2))
    }

    pub(crate) fn middle(&self) -> DVec3 {
        self.world_from_unit_cube()
            .transform_point3(DVec3::splat(0.5))
    }

    /// Half of the box's diagonal, metres.
    pub(crate) fn radius(&self) -> f64 {
        let matrix = self.world_from_unit_cube();
        let square = |axis| matrix.col(axis).truncate().length_squared();
        0.5 * (square(0) + square(1) + square(2)).sqrt()
    }
}

/// The look that the scene has.
#[derive(Resource, Default)]
pub(crate) struct Applied {
    look: Option<Look>,
    planes: Vec<Entity>,
}

impl Applied {
    pub(crate) fn is_behind(&self, look: &Look) -> bool {
        self.look.as_ref() != Some(look)
    }
}

type VolumeParts<'a> = (
    &'a mut Volume3d,
    &'a mut VolumeMaterial3d,
    &'a mut VolumeMedium,
);

#[expect(clippy::too_many_arguments, reason = "all that shows the look")]
/// Takes what changed in the look to the components that show it.
pub(crate) fn apply(
    mut commands: Commands,
    studio: Res<Studio>,
    session: Res<Session>,
    mut applied: ResMut<Applied>,
    mut transfer_functions: ResMut<Assets<TransferFunctionAsset>>,
    mut environment: ResMut<VolumeEnvironment>,
    mut parts: Query<VolumeParts>,
    mut cameras: Query<(&mut VolumeRenderSettings, Option<&Exposure>)>,
    mut transforms: Query<&mut Transform, With<VolumeClipPlane>>,
) {
    let look = &studio.look;
    if !applied.is_behind(look) {
        return;
    }
    let Ok((_, mut material, mut medium)) = parts.get_mut(session.volume) else {
        return;
    };
    medium.set_if_neq(look.medium());
    if let Some(file) = look.transfer_function() {
        let same = transfer_functions.get(&material.0).is_some_and(|asset| {
            asset.file().transfer_function == file.transfer_function
                && asset.file().optical_depth_scale == file.optical_depth_scale
        });
        if !same {
            material.0 = transfer_functions.add(TransferFunctionAsset::new(file));
        }
    }
    environment.set_if_neq(VolumeEnvironment {
        source: match &look.light.source {
            LightSource::Constant([r, g, b]) => {
                EnvironmentSource::Constant(LinearRgba::rgb(*r, *g, *b))
            }
            LightSource::Map { map, .. } => EnvironmentSource::Map(map.clone()),
        },
        intensity: look.intensity(),
        rotation_y: look.light.rotation_deg.to_radians() as f32,
        // Before there is a scan the light is nothing that anybody chose.
        is_sky: look.light.is_sky && studio.scan.is_some(),
        // There are no meshes here.
        lights_meshes: false,
    });
    if let Ok((mut settings, exposure)) = cameras.get_mut(session.camera) {
        if settings.max_scatters != look.max_scatters {
            settings.max_scatters = look.max_scatters;
        }
        if exposure.map(|exposure| exposure.ev100) != Some(look.exposure().ev100) {
            commands.entity(session.camera).insert(look.exposure());
        }
    }
    let planes = studio
        .scan
        .as_ref()
        .map(|scan| look.clip_planes(scan.world_from_unit_cube()))
        .unwrap_or_default();
    let transforms_wanted: Vec<_> = planes.into_iter().map(VolumeClipPlane::transform).collect();
    if transforms_wanted.len() == applied.planes.len() {
        for (&entity, transform) in applied.planes.iter().zip(transforms_wanted) {
            if let Ok(mut old) = transforms.get_mut(entity) {
                old.set_if_neq(transform);
            }
        }
    } else {
        for entity in applied.planes.drain(..) {
            commands.entity(entity).despawn();
        }
        applied.planes = transforms_wanted
            .into_iter()
            .map(|transform| {
                let plane = (VolumeClipPlane, transform, ChildOf(session.volume));
                commands.spawn(plane).id()
            })
            .collect();
    }
    applied.look = Some(look.clone());
}
