//! Reading volumes from files: one [`VolumeReader`] per format, chosen by name and content.

use std::path::{Path, PathBuf};

use crate::Volume;

/// How far a reader has come.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Progress {
    /// Bytes of voxels read so far.
    pub bytes: u64,
    /// Bytes of voxels in all.
    pub total_bytes: u64,
}

/// What a user may ask of a reader.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct ReadOptions {
    /// Refuse a file whose voxels need more bytes than this.
    pub max_voxel_bytes: Option<u64>,
}

/// Reads one family of files. Further formats join by implementing it and standing in [`readers`].
pub trait VolumeReader: Sync {
    /// The format's name, as in messages: `NIfTI`.
    fn name(&self) -> &'static str;

    /// File name endings, lower case, with the dot: `[".nii", ".nii.gz"]`.
    fn extensions(&self) -> &'static [&'static str];

    /// Whether a file that begins with these bytes is of this format, whatever it is called.
    fn recognises(&self, first_bytes: &[u8]) -> bool;

    /// Reads the volume, telling its progress at least every few megabytes.
    ///
    /// # Errors
    /// A [`VolumeError`] that names the file, the field and the way out.
    fn read(
        &self,
        path: &Path,
        options: &ReadOptions,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Volume, VolumeError>;
}

/// All known formats.
pub fn readers() -> &'static [&'static dyn VolumeReader] {
    &[]
}

/// Why a volume could not be read or made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VolumeError {
    /// The file could not be opened or read.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The number of voxels does not fit the dimensions.
    #[error("dimensions {dims:?} do not go with {voxels} voxels")]
    Dimensions {
        /// Dimensions along x, y, z.
        dims: [u64; 3],
        /// Voxels that came.
        voxels: usize,
    },
    /// Slope or intercept is not finite.
    #[error("values are scaled by slope {slope} and intercept {intercept}, which must be finite")]
    Scaling {
        /// Slope.
        slope: f64,
        /// Intercept.
        intercept: f64,
    },
}

/// Reads a volume with default options.
///
/// # Errors
/// See [`VolumeError`].
pub fn open(path: &Path, progress: &mut dyn FnMut(Progress)) -> Result<Volume, VolumeError> {
    open_with(path, &ReadOptions::default(), progress)
}

/// Reads a volume: the format is found by the file's first bytes, else by its name.
///
/// # Errors
/// See [`VolumeError`].
pub fn open_with(
    path: &Path,
    _options: &ReadOptions,
    _progress: &mut dyn FnMut(Progress),
) -> Result<Volume, VolumeError> {
    Err(VolumeError::Io {
        path: path.into(),
        source: std::io::ErrorKind::Unsupported.into(),
    })
}
