//! Reading volumes from files: one [`VolumeReader`] per format, chosen by content, then by name.
//!
//! The parsers are our own. Checked first: `nifti` 0.18 knows no NIfTI-2, reserves what the header
//! claims, casts scaled values back to the stored type (a `u8` file with slope 2.008 wraps) and
//! panics on a negative `pixdim`; for NRRD the registry has no maintained reader.

mod decode;
mod dicom;
mod error;
mod input;
mod limits;
mod metaimage;
mod nifti;
mod nrrd;
mod numbers;
mod options;
mod parallel;
mod placement;
mod raw;
mod select;
mod source;
mod threaded;
mod tiff;
mod vdb;
mod zip;

use std::path::Path;

pub use dicom::DicomReader;
pub use error::VolumeError;
pub use input::Input;
pub use metaimage::MetaImageReader;
pub use nifti::NiftiReader;
pub use nrrd::NrrdReader;
pub use numbers::NumberType;
pub use options::{CancelFlag, Content, Progress, ReadOptions};
pub use raw::{Endian, RawLayout};
pub use tiff::TiffReader;
pub use vdb::VdbReader;
pub use zip::ZipReader;

use crate::Volume;

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

    /// The volumes that [`ReadOptions::choice`] can choose from, in the order of their numbers;
    /// empty where there is only one.
    ///
    /// # Errors
    /// If the file can't be read far enough to tell.
    fn contents(
        &self,
        input: Input<'_>,
        options: &ReadOptions,
    ) -> Result<Vec<Content>, VolumeError> {
        let _ = (input, options);
        Ok(Vec::new())
    }
}

/// All known formats.
pub fn readers() -> &'static [&'static dyn VolumeReader] {
    &[
        &NiftiReader,
        &NrrdReader,
        &MetaImageReader,
        &DicomReader,
        &VdbReader,
        &TiffReader,
        &ZipReader,
    ]
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
/// A folder is read as the DICOM series in it; a file with a sidecar (see [`RawLayout`]), or with
/// [`ReadOptions::raw`], as voxels without a header.
///
/// # Errors
/// See [`VolumeError`]; of several series or grids none of which is chosen
/// [`VolumeError::Choose`], which lists them.
pub fn open_with(
    path: &Path,
    options: &ReadOptions,
    progress: &mut dyn FnMut(Progress),
) -> Result<Volume, VolumeError> {
    if path.is_dir() {
        return dicom::read_folder(path, options, progress)
            .map_err(|error| error.within(path, "DICOM"));
    }
    let input = Input::open(path)?;
    let sidecar = match options.raw {
        Some(_) => None,
        None => RawLayout::from_sidecar(path)?,
    };
    if let Some(layout) = options.raw.as_ref().or(sidecar.as_ref()) {
        return raw::read(input, layout, options, progress);
    }
    read(input, options, progress)
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
    if let Some(layout) = &options.raw {
        return raw::read(input, layout, options, progress);
    }
    let (path, stamp) = (input.path().to_path_buf(), input.stamp());
    let (reader, input) = find_reader(input)?;
    let volume = reader.read(input, options, progress);
    // First, since a change may be why it failed.
    if let Some(stamp) = stamp {
        stamp.check(&path)?;
    }
    volume.map_err(|error| error.within(&path, reader.name()))
}

/// The volumes in a file or folder that [`ReadOptions::choice`] can choose from; empty where there
/// is only one.
///
/// # Errors
/// See [`VolumeError`].
pub fn contents(path: &Path, options: &ReadOptions) -> Result<Vec<Content>, VolumeError> {
    if path.is_dir() {
        return dicom::list_folder(path, options);
    }
    if options.raw.is_some() || RawLayout::from_sidecar(path)?.is_some() {
        return Ok(Vec::new());
    }
    let (reader, input) = find_reader(Input::open(path)?)?;
    reader.contents(input, options)
}

fn find_reader(input: Input<'_>) -> Result<(&'static dyn VolumeReader, Input<'_>), VolumeError> {
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
        Some(reader) => Ok((*reader, input)),
        None => Err(unknown_format(&input, "its format is not known")),
    }
}

fn unknown_format(input: &Input<'_>, found: &str) -> VolumeError {
    VolumeError::UnknownFormat {
        path: input.path().into(),
        found: found.into(),
    }
}
