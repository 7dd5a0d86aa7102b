use std::sync::LazyLock;

use bevy::asset::io::Reader;
use bevy::asset::{AssetLoader, LoadContext};
use bevy::reflect::TypePath;
use holovol_volume::{Input, ReadOptions, VolumeError, readers};

use super::VolumeAsset;

/// Loads every format that `holovol_volume` reads from a single file.
///
/// For files anywhere on the disk, files that name others, folders, and progress that can be shown,
/// see [`VolumeFiles`](super::VolumeFiles).
#[derive(Clone, Copy, Debug, Default, TypePath)]
pub struct VolumeLoader;

/// Why a volume could not be loaded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VolumeLoaderError {
    /// The asset could not be read.
    #[error("cannot read the volume: {0}")]
    Io(#[from] std::io::Error),
    /// It is not a volume.
    #[error(transparent)]
    Content(#[from] VolumeError),
}

/// As Bevy wants them: without the leading dot.
static EXTENSIONS: LazyLock<Vec<&'static str>> = LazyLock::new(|| {
    let all = readers().iter().flat_map(|reader| reader.extensions());
    all.map(|end| end.trim_start_matches('.')).collect()
});

impl AssetLoader for VolumeLoader {
    type Asset = VolumeAsset;
    type Settings = ();
    type Error = VolumeLoaderError;

    async fn load(
        &self,
        reader: &mut dyn Reader,
        _settings: &(),
        context: &mut LoadContext<'_>,
    ) -> Result<VolumeAsset, VolumeLoaderError> {
        let mut bytes = Vec::new();
        reader.read_to_end(&mut bytes).await?;
        let name = context.path().to_string();
        let input = Input::from_bytes(name.as_ref(), &bytes);
        let volume = holovol_volume::read(input, &ReadOptions::default(), &mut |_progress| {})?;
        Ok(VolumeAsset::new(volume))
    }

    fn extensions(&self) -> &[&str] {
        &EXTENSIONS
    }
}
