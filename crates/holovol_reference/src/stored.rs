use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::{Image, ImageError};

/// What is known of a stored reference picture: the `.ref.json` beside it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReferenceInfo {
    /// Samples per pixel it was made with.
    pub spp: u64,
    /// Its own noise: expected relMSE against the truth.
    pub error_floor_relmse: f64,
    /// How `error_floor_relmse` is defined, in words.
    #[serde(default)]
    pub relmse: String,
    /// Mean over all pixels.
    pub mean_rgb: [f64; 3],
    /// Mean over all pixels.
    pub mean_opacity: f64,
}

/// A scene's stored reference: `scene.ref.exr` and `scene.ref.json` beside `scene.json`.
#[derive(Clone, Debug)]
pub struct StoredReference {
    /// The picture.
    pub image: Image,
    /// What is known of it.
    pub info: ReferenceInfo,
}

/// Why a stored reference could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoredError {
    /// The picture.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// The description could not be opened.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The description is not what was expected.
    #[error(
        "{}: {source}; expected spp, error_floor_relmse, mean_rgb and mean_opacity",
        path.display()
    )]
    Json {
        /// The file.
        path: PathBuf,
        /// What the parser said.
        source: serde_json::Error,
    },
}

impl StoredReference {
    /// Reads the reference of a scene file.
    ///
    /// # Errors
    /// If one of the two files is missing or damaged.
    pub fn read(scene: &Path) -> Result<Self, StoredError> {
        let path = scene.with_extension("ref.json");
        let text = std::fs::read_to_string(&path).map_err(|source| StoredError::Io {
            path: path.clone(),
            source,
        })?;
        let info =
            serde_json::from_str(&text).map_err(|source| StoredError::Json { path, source })?;
        let image = Image::read_exr(&scene.with_extension("ref.exr"))?;
        Ok(Self { image, info })
    }
}
