//! DICOM: a file, or the series in a folder or an archive.
//!
//! Frames are sorted by their position along the slice normal, whatever the files are called. The
//! steps between the first and the last slice become the volume's third axis, so that a tilted
//! gantry gives a shear. The elements are read by a parser of our own, which never looks at who
//! the patient is; pixels are decoded by `jpeg-decoder`, `hayro-jpeg2000` and our own RLE and
//! JPEG-LS.

mod codec;
mod convert;
mod dataset;
mod describe;
mod files;
mod frames;
mod header;
mod jpeg_ls;
mod load;
mod rle;
mod series;
mod stack;
mod syntax;
mod tags;

use std::path::Path;

pub(super) use files::{Files, OpenFile};

use super::options::Content;
use super::{Input, Progress, ReadOptions, VolumeReader};
use crate::{Volume, VolumeError};
use files::{FolderFiles, SingleFile};
use header::Start;
use series::Study;

/// Reads DICOM files; folders of them are read by [`open_with`](crate::open_with).
#[derive(Clone, Copy, Debug)]
pub struct DicomReader;

impl VolumeReader for DicomReader {
    fn name(&self) -> &'static str {
        "DICOM"
    }

    fn extensions(&self) -> &'static [&'static str] {
        &[".dcm", ".dicom", ".ima"]
    }

    fn recognises(&self, first_bytes: &[u8]) -> bool {
        Start::find(first_bytes).is_some()
    }

    fn read(
        &self,
        input: Input<'_>,
        options: &ReadOptions,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Volume, VolumeError> {
        let file = single(input)?;
        read_files(&file, &file.path, options, progress)
    }

    fn contents(
        &self,
        input: Input<'_>,
        options: &ReadOptions,
    ) -> Result<Vec<Content>, VolumeError> {
        let file = single(input)?;
        list_files(&file, &file.path, options)
    }
}

fn single(input: Input<'_>) -> Result<SingleFile<'_>, VolumeError> {
    Ok(SingleFile {
        path: input.path().to_path_buf(),
        source: input.into_source()?,
    })
}

/// Reads the series in files.
pub(super) fn read_files(
    files: &dyn Files,
    path: &Path,
    options: &ReadOptions,
    progress: &mut dyn FnMut(Progress),
) -> Result<Volume, VolumeError> {
    let study = Study::find(files, path, &options.cancel)?;
    let series = study.choose(path, options)?;
    load::load(files, &study, series, path, options, progress)
}

/// What series there are in files.
pub(super) fn list_files(
    files: &dyn Files,
    path: &Path,
    options: &ReadOptions,
) -> Result<Vec<Content>, VolumeError> {
    let study = Study::find(files, path, &options.cancel)?;
    Ok(study.series.into_iter().map(|s| s.content).collect())
}

/// Reads the series in a folder and the folders in it.
pub(super) fn read_folder(
    folder: &Path,
    options: &ReadOptions,
    progress: &mut dyn FnMut(Progress),
) -> Result<Volume, VolumeError> {
    read_files(&find(folder, options)?, folder, options, progress)
}

/// What series there are in a folder and the folders in it.
pub(super) fn list_folder(
    folder: &Path,
    options: &ReadOptions,
) -> Result<Vec<Content>, VolumeError> {
    list_files(&find(folder, options)?, folder, options)
}

fn find(folder: &Path, options: &ReadOptions) -> Result<FolderFiles, VolumeError> {
    FolderFiles::find(folder, &|| {
        if options.cancel.is_cancelled() {
            Err(VolumeError::Cancelled {
                path: folder.into(),
            })
        } else {
            Ok(())
        }
    })
}
