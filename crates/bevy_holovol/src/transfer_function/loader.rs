use bevy::asset::io::Reader;
use bevy::asset::{AssetLoader, LoadContext};
use bevy::reflect::TypePath;
use holovol_volume::{TransferFunctionFile, TransferFunctionFileError};

use super::TransferFunctionAsset;

/// Loads `*.tf.json` files; with Bevy's `file_watcher` they are loaded again when they change.
#[derive(Clone, Copy, Debug, Default, TypePath)]
pub struct TransferFunctionLoader;

/// Why a transfer function could not be loaded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TransferFunctionLoaderError {
    /// The file could not be read.
    #[error("cannot read the transfer function: {0}")]
    Io(#[from] std::io::Error),
    /// It is not UTF-8.
    #[error("{path}: not a text file: {source}")]
    Text {
        /// The file.
        path: String,
        /// Where it breaks off.
        source: std::string::FromUtf8Error,
    },
    /// It is not a transfer function.
    #[error(transparent)]
    Content(#[from] TransferFunctionFileError),
}

impl AssetLoader for TransferFunctionLoader {
    type Asset = TransferFunctionAsset;
    type Settings = ();
    type Error = TransferFunctionLoaderError;

    async fn load(
        &self,
        reader: &mut dyn Reader,
        _settings: &(),
        context: &mut LoadContext<'_>,
    ) -> Result<TransferFunctionAsset, TransferFunctionLoaderError> {
        let mut bytes = Vec::new();
        reader.read_to_end(&mut bytes).await?;
        let path = context.path().to_string();
        let text =
            String::from_utf8(bytes).map_err(|source| TransferFunctionLoaderError::Text {
                path: path.clone(),
                source,
            })?;
        let file = TransferFunctionFile::parse(&text, path.as_ref())?;
        Ok(TransferFunctionAsset::new(file))
    }

    fn extensions(&self) -> &[&str] {
        &["tf.json"]
    }
}
