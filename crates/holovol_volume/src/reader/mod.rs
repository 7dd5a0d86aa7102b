//! Reading volumes from files: one [`VolumeReader`] per format, chosen by content, then by name.
//!
//! The parsers are our own. Checked first: `nifti` 0.18 knows no NIfTI-2, reserves what the header
//! claims, casts scaled values back to the stored type (a `u8` file with slope 2.008 wraps) and
//! panics on a negative `pixdim`; for NRRD the registry has no maintained reader.

mod decode;
mod error;
mod input;
mod nifti;
mod nrrd;
mod numbers;
mod placement;

use std::path::Path;

pub use error::VolumeError;
pub use input::Input;
pub use nifti::NiftiReader;
pub use nrrd::NrrdReader;

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

impl ReadOptions {
    /// The same options with a limit on the bytes of voxels.
    pub fn with_max_voxel_bytes(mut self, bytes: u64) -> Self {
        self.max_voxel_bytes = Some(bytes);
        self
    }
}

/// Reads one family of files. Further formats join by implementing it and standing in [`readers`].
pub trait VolumeReader: Sync {
    /// The format's name, as in messages: `NIfTI`.
    fn name(&self) -> &'static str;

    /// File name endings, lower case, with the dot: `[".nii", ".nii.gz"]`.
    fn extensions(&self) -> &'static [&'static str];

    /// Whether a file that begins with these bytes (1024 or fewer) is of this format, whatever it
    /// is called. A gzip wrapper is already off.
    fn recognises(&self, first_bytes: &[u8]) -> bool;

    /// Reads the volume, telling its progress at least every few megabytes.
    ///
    /// # Errors
    /// A [`VolumeError`] that names the file, the field and the way out.
    fn read(
        &self,
        input: Input<'_>,
        options: &ReadOptions,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Volume, VolumeError>;
}

/// All known formats.
pub fn readers() -> &'static [&'static dyn VolumeReader] {
    &[&NiftiReader, &NrrdReader]
}

fn supported_formats() -> String {
    let format = |reader: &&dyn VolumeReader| {
        format!("{} ({})", reader.name(), reader.extensions().join(", "))
    };
    readers().iter().map(format).collect::<Vec<_>>().join(", ")
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
    options: &ReadOptions,
    progress: &mut dyn FnMut(Progress),
) -> Result<Volume, VolumeError> {
    read(Input::open(path)?, options, progress)
}

/// Reads a volume from any input, see [`open_with`].
///
/// # Errors
/// See [`VolumeError`].
pub fn read(
    input: Input<'_>,
    options: &ReadOptions,
    progress: &mut dyn FnMut(Progress),
) -> Result<Volume, VolumeError> {
    let mut input = input.gunzip_if_packed()?;
    let first = input.peek()?;
    let name = input.path().to_string_lossy().to_lowercase();
    let by_content = readers().iter().find(|reader| reader.recognises(&first));
    let by_name = || {
        readers()
            .iter()
            .find(|reader| reader.extensions().iter().any(|end| name.ends_with(end)))
    };
    if first.is_empty() {
        return Err(unknown_format(&input, "the file is empty"));
    }
    match by_content.or_else(by_name) {
        Some(reader) => reader.read(input, options, progress),
        None => Err(unknown_format(&input, "its format is not known")),
    }
}

fn unknown_format(input: &Input<'_>, found: &str) -> VolumeError {
    VolumeError::UnknownFormat {
        path: input.path().into(),
        found: found.into(),
    }
}
