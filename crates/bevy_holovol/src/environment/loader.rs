use bevy::asset::io::Reader;
use bevy::asset::{AssetLoader, LoadContext};
use bevy::reflect::TypePath;
use holovol_light::{EnvironmentMap, LightError};

use super::EnvironmentAsset;

/// Loads Radiance `.hdr` and OpenEXR `.exr` maps as [`EnvironmentAsset`]s.
///
/// Bevy's own loaders of these endings give `Image`s; which runs is decided by the handle's type.
#[derive(Clone, Copy, Debug, Default, TypePath)]
pub struct EnvironmentLoader;

/// Why a map could not be loaded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EnvironmentLoaderError {
    /// The asset could not be read.
    #[error("cannot read the environment map: {0}")]
    Io(#[from] std::io::Error),
    /// It is not such a map.
    #[error(transparent)]
    Content(#[from] LightError),
}

impl AssetLoader for EnvironmentLoader {
    type Asset = EnvironmentAsset;
    type Settings = ();
    type Error = EnvironmentLoaderError;

    async fn load(
        &self,
        reader: &mut dyn Reader,
        _settings: &(),
        context: &mut LoadContext<'_>,
    ) -> Result<EnvironmentAsset, EnvironmentLoaderError> {
        let mut bytes = Vec::new();
        reader.read_to_end(&mut bytes).await?;
        let name = context.path().to_string();
        let map = EnvironmentMap::from_bytes(name.as_ref(), &bytes)?;
        Ok(EnvironmentAsset::new(map))
    }

    fn extensions(&self) -> &[&str] {
        &["hdr", "exr"]
    }
}
