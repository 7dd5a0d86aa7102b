//! The light of the room that volumes, and by default meshes, stand in.

mod light;
mod live;
mod loader;

use std::sync::Arc;

use bevy::prelude::*;
use holovol_light::EnvironmentMap;

pub(crate) use light::CurrentMap;
pub use live::{LiveCamera, LiveFrame, LiveLight, LiveLightPlugin, LivePicture};
pub use loader::{EnvironmentLoader, EnvironmentLoaderError};

/// cd/m² of radiance 1: what makes a map of ordinary brightness show at Bevy's default exposure.
pub const DEFAULT_INTENSITY: f32 = 1000.0;

/// The environment as a resource and asset, the loader of `.hdr` and `.exr` maps, and the light and
/// sky that meshes get of it.
pub struct VolumeEnvironmentPlugin;

impl Plugin for VolumeEnvironmentPlugin {
    fn build(&self, app: &mut App) {
        app.init_asset::<EnvironmentAsset>()
            .register_asset_reflect::<EnvironmentAsset>()
            .init_asset_loader::<EnvironmentLoader>()
            .init_resource::<VolumeEnvironment>()
            .init_resource::<light::Filtering>()
            .init_resource::<CurrentMap>()
            .add_systems(PostUpdate, light::update_map);
        // Without Bevy's renderer there are no images and no meshes to light.
        if app.world().contains_resource::<Assets<Image>>() {
            let lights = (light::filter, light::apply)
                .chain()
                .after(light::update_map);
            app.add_systems(PostUpdate, lights);
        }
    }

    fn finish(&self, app: &mut App) {
        if let Some(mut images) = app.world_mut().get_resource_mut::<Assets<Image>>() {
            light::keep_tables(&mut images);
        }
    }
}

/// Light from all around, for all volumes and, by default, for the meshes that cameras with
/// [`VolumeRenderSettings`](crate::VolumeRenderSettings) see.
///
/// By default uniform white light. Unlike Bevy's `EnvironmentMapLight` the map is used as it is,
/// unfiltered and in 32-bit floats, suns included.
#[derive(Resource, Reflect, Clone, Debug, PartialEq)]
#[reflect(Resource, Default, Clone, Debug, PartialEq)]
pub struct VolumeEnvironment {
    /// Where the light comes from.
    pub source: EnvironmentSource,
    /// Luminance in cd/m² of radiance 1; [`DEFAULT_INTENSITY`] by default. As with Bevy's lights
    /// the camera's `Exposure` decides how bright that shows.
    pub intensity: f32,
    /// Turn about +y, radians, counter-clockwise seen from above.
    pub rotation_y: f32,
    /// Gives the cameras Bevy's `EnvironmentMapLight` of it as soon as there is a `Mesh3d`. One that
    /// you insert, before or after, or change or remove, stays as you leave it; switch this off and
    /// on to have ours again.
    pub lights_meshes: bool,
    /// Gives the cameras Bevy's `Skybox` of it, with the same precedence: what you do to a camera's
    /// own stays. [`WithoutSky`] leaves it off one camera.
    pub is_sky: bool,
}

impl Default for VolumeEnvironment {
    fn default() -> Self {
        Self {
            source: EnvironmentSource::default(),
            intensity: DEFAULT_INTENSITY,
            rotation_y: 0.0,
            lights_meshes: true,
            is_sky: true,
        }
    }
}

impl VolumeEnvironment {
    /// The light of a map, as it is.
    pub fn from_map(map: Handle<EnvironmentAsset>) -> Self {
        Self {
            source: EnvironmentSource::Map(map),
            ..Default::default()
        }
    }

    /// The same radiance from everywhere.
    pub fn from_radiance(radiance: LinearRgba) -> Self {
        Self {
            source: EnvironmentSource::Constant(radiance),
            ..Default::default()
        }
    }
}

/// On a camera: the environment isn't its sky, though it lights what the camera sees. Headsets
/// through which the room itself is seen have it.
#[derive(Component, Reflect, Clone, Copy, Debug, Default, PartialEq, Eq)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
pub struct WithoutSky;

/// Where the light of a [`VolumeEnvironment`] comes from.
///
/// Live light is a map whose asset is replaced as often as there is a new one: everything follows.
/// [`LiveLightPlugin`] does that from a 360° camera.
#[derive(Reflect, Clone, Debug, PartialEq)]
#[reflect(Default, Clone, Debug, PartialEq)]
pub enum EnvironmentSource {
    /// The same from everywhere; alpha is ignored.
    Constant(LinearRgba),
    /// A latitude–longitude map.
    Map(Handle<EnvironmentAsset>),
}

impl Default for EnvironmentSource {
    fn default() -> Self {
        Self::Constant(LinearRgba::WHITE)
    }
}

/// A latitude–longitude radiance map; cloning shares its texels.
#[derive(Asset, Reflect, Clone, Debug)]
#[reflect(opaque)]
#[reflect(Clone, Debug)]
pub struct EnvironmentAsset(Arc<EnvironmentMap>);

impl EnvironmentAsset {
    /// A map that is already in memory.
    pub fn new(map: EnvironmentMap) -> Self {
        Self(Arc::new(map))
    }

    /// The map.
    pub fn map(&self) -> &Arc<EnvironmentMap> {
        &self.0
    }
}

impl From<EnvironmentMap> for EnvironmentAsset {
    fn from(map: EnvironmentMap) -> Self {
        Self::new(map)
    }
}
