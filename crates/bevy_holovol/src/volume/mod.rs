//! Volumes: the voxels, where they stand, and the files they come from.

mod files;
mod loader;

use std::sync::Arc;

use bevy::camera::primitives::Aabb;
use bevy::camera::visibility::{VisibilityClass, VisibilitySystems, add_visibility_class};
use bevy::prelude::*;
use glam::{DMat4, DVec3};
use holovol_volume::Volume;

pub use files::{VolumeFiles, VolumeLoadProgress};
pub use loader::{VolumeLoader, VolumeLoaderError};

use crate::{VolumeClipPlane, VolumeMaterial3d};

/// Volumes as components and assets, and the loaders of all formats that `holovol_volume` reads.
pub struct VolumePlugin;

impl Plugin for VolumePlugin {
    fn build(&self, app: &mut App) {
        app.init_asset::<VolumeAsset>()
            .register_asset_reflect::<VolumeAsset>()
            .init_asset_loader::<VolumeLoader>()
            .register_type::<Volume3d>()
            .register_type::<VolumeMedium>()
            .register_type::<VolumeClipPlane>()
            .init_resource::<files::Loads>()
            .add_systems(PreUpdate, files::finish_loads)
            .add_systems(
                PostUpdate,
                update_bounds.in_set(VisibilitySystems::CalculateBounds),
            );
    }
}

/// A volume in the scene, path-traced for every camera with
/// [`VolumeRenderSettings`](crate::VolumeRenderSettings).
///
/// It has the size that its file says, in metres, centred on the entity: the patient's left to +x,
/// superior to +y, anterior to +z. The entity's transform comes on top.
///
/// With another handle, or once its asset is replaced, the former voxels are shown until the new ones
/// are on the device; nothing with the default handle, or an asset that was removed.
///
/// Not to be confused with Bevy's `audio::Volume`, which is loudness, nor with `FogVolume`, which
/// is drawn by ray marching.
#[derive(Component, Reflect, Clone, Debug, Default, PartialEq, Eq, Deref, DerefMut)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
#[require(Transform, Visibility, VisibilityClass, VolumeMaterial3d, VolumeMedium)]
#[component(on_add = add_visibility_class::<Volume3d>)]
pub struct Volume3d(pub Handle<VolumeAsset>);

/// What a [`Volume3d`] is made of besides its transfer function.
#[derive(Component, Reflect, Clone, Debug, PartialEq)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
pub struct VolumeMedium {
    /// Values at which the transfer function's s is 0 and 1, in the data's units; may be reversed,
    /// not equal. `None` takes that of the transfer function, else of the file, else the whole
    /// range.
    pub window: Option<(f64, f64)>,
    /// Mean cosine g of the Henyey–Greenstein phase function, −1 < g < 1; > 0 scatters forward.
    /// (Bevy's `PhaseFunction` is for the atmosphere.) Default 0.
    pub phase_g: f64,
    /// k of the blend with a surface where values change fast; 0, the default, is none.
    pub gradient_factor: f64,
    /// Factor on extinctions; 1 by default. A volume whose transform scales it by f looks the same
    /// at 1/f.
    pub density: f64,
    /// Luminance in cd/m² of emission 1; 1000 by default, as
    /// [`VolumeEnvironment::intensity`](crate::VolumeEnvironment::intensity).
    pub emission_intensity: f64,
}

impl Default for VolumeMedium {
    fn default() -> Self {
        Self {
            window: None,
            phase_g: 0.0,
            gradient_factor: 0.0,
            density: 1.0,
            emission_intensity: f64::from(crate::environment::DEFAULT_INTENSITY),
        }
    }
}

/// Voxels and where their file places them; cloning shares them.
#[derive(Asset, Reflect, Clone, Debug)]
#[reflect(opaque)]
#[reflect(Clone, Debug)]
pub struct VolumeAsset {
    volume: Arc<Volume>,
    local_from_unit_cube: DMat4,
}

impl VolumeAsset {
    /// A volume that is already in memory.
    pub fn new(volume: Volume) -> Self {
        Self {
            local_from_unit_cube: volume.world_from_unit_cube(),
            volume: Arc::new(volume),
        }
    }

    /// The same voxels, placed otherwise than their file says.
    pub fn with_placement(mut self, local_from_unit_cube: DMat4) -> Self {
        self.local_from_unit_cube = local_from_unit_cube;
        self
    }

    /// The volume.
    pub fn volume(&self) -> &Arc<Volume> {
        &self.volume
    }

    /// Metres from unit-cube coordinates, in the entity's space.
    pub fn local_from_unit_cube(&self) -> DMat4 {
        self.local_from_unit_cube
    }

    /// Corners of the unit cube in the entity's space.
    fn corners(&self) -> [DVec3; 8] {
        let matrix = self.local_from_unit_cube();
        std::array::from_fn(|corner| {
            let bit = |i: usize| (corner >> i & 1) as f64;
            matrix.transform_point3(DVec3::new(bit(0), bit(1), bit(2)))
        })
    }
}

impl From<Volume> for VolumeAsset {
    fn from(volume: Volume) -> Self {
        Self::new(volume)
    }
}

/// Gives volumes the box that Bevy culls by, once they are loaded or have changed.
fn update_bounds(
    mut commands: Commands,
    mut events: MessageReader<AssetEvent<VolumeAsset>>,
    assets: Res<Assets<VolumeAsset>>,
    volumes: Query<(Entity, Ref<Volume3d>, Has<Aabb>)>,
) {
    let changed: Vec<_> = events
        .read()
        .filter_map(|event| match event {
            AssetEvent::Added { id } | AssetEvent::Modified { id } => Some(*id),
            _ => None,
        })
        .collect();
    for (entity, volume, has_aabb) in &volumes {
        if has_aabb && !volume.is_changed() && !changed.contains(&volume.id()) {
            continue;
        }
        if let Some(asset) = assets.get(&volume.0) {
            let points = asset.corners().map(|corner| corner.as_vec3());
            if let Some(aabb) = Aabb::enclosing(points) {
                commands.entity(entity).try_insert(aabb);
            }
        }
    }
}
