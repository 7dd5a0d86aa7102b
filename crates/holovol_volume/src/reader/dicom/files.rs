//! Where the files of a series are: in a folder, in an archive, or in memory.

use std::collections::HashSet;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::VolumeError;
use crate::reader::input::Stamp;
use crate::reader::source::Source;

/// Folders deeper than this are a loop.
const DEPTH_MAX: usize = 64;

/// Any file may be unpacked up to here.
const UNPACKED_MIN: u64 = 2 << 20;

/// More files than this are no study.
const FILES_MAX: usize = 2_000_000;

/// Files by number, to be read by several threads at once.
pub(in crate::reader) trait Files: Sync {
    fn count(&self) -> usize;

    /// What messages call the file.
    fn name(&self, index: usize) -> PathBuf;

    /// Opens a file, unpacking it if need be.
    ///
    /// `at_most`: no more than this is needed of it; what comes after may be missing. A second
    /// opening fails with [`VolumeError::Changed`] if the file has changed since the first.
    fn open(&self, index: usize, at_most: u64) -> Result<OpenFile<'_>, VolumeError>;

    /// Bytes that a file takes where it is; [`u64::MAX`] where it isn't packed.
    fn stored_bytes(&self, _index: usize) -> u64 {
        u64::MAX
    }

    /// Whether a file is as it was when it was found. What others watch over, is.
    ///
    /// # Errors
    /// [`VolumeError::Changed`] if it isn't.
    fn check_unchanged(&self, _index: usize) -> Result<(), VolumeError> {
        Ok(())
    }
}

/// How many bytes of a file may be unpacked for anything but plain pixels: a small archive may
/// claim a header of gigabytes. What isn't packed may be read whole.
pub(super) fn unpacked_max(stored: u64) -> u64 {
    stored.saturating_mul(4).max(UNPACKED_MIN)
}

/// An opened file.
pub(in crate::reader) struct OpenFile<'a> {
    pub source: Source<'a>,
    /// Bytes of the whole file, whatever of it is there.
    pub length: u64,
}

/// One file that is already open.
pub(super) struct SingleFile<'a> {
    pub path: PathBuf,
    pub source: Source<'a>,
}

impl Files for SingleFile<'_> {
    fn count(&self) -> usize {
        1
    }

    fn name(&self, _index: usize) -> PathBuf {
        self.path.clone()
    }

    fn open(&self, _index: usize, _at_most: u64) -> Result<OpenFile<'_>, VolumeError> {
        Ok(OpenFile {
            source: self.source.clone(),
            length: self.source.length(),
        })
    }
}

/// All regular files in a folder and the folders in it.
pub(super) struct FolderFiles {
    files: Vec<FolderFile>,
}

struct FolderFile {
    path: PathBuf,
    stamp: Stamp,
}

impl FolderFiles {
    /// Finds the files, in the order of their paths. Folders that links lead to again are passed
    /// over.
    ///
    /// # Errors
    /// If a folder can't be read, or there are more files than any study has.
    pub fn find(
        folder: &Path,
        go_on: &dyn Fn() -> Result<(), VolumeError>,
    ) -> Result<Self, VolumeError> {
        let mut files = Vec::new();
        let mut seen = HashSet::new();
        let mut folders = vec![(folder.to_path_buf(), 0)];
        while let Some((folder, depth)) = folders.pop() {
            go_on()?;
            let error = |source| VolumeError::io(&folder, source);
            let real = std::fs::canonicalize(&folder).map_err(error)?;
            if !seen.insert(real) || depth > DEPTH_MAX {
                continue;
            }
            for entry in std::fs::read_dir(&folder).map_err(error)? {
                let path = entry.map_err(error)?.path();
                // A link that leads nowhere is nobody's slice.
                let Ok(metadata) = std::fs::metadata(&path) else {
                    continue;
                };
                if metadata.is_dir() {
                    folders.push((path, depth + 1));
                } else if metadata.is_file() {
                    let stamp = Stamp::of(&metadata);
                    files.push(FolderFile { path, stamp });
                }
            }
            if files.len() > FILES_MAX {
                return Err(VolumeError::Unsupported {
                    path: folder,
                    what: format!("this folder has more than {FILES_MAX} files"),
                    way_out: "name the folder of one series".into(),
                });
            }
        }
        files.sort_by(|a, b| a.path.cmp(&b.path));
        Ok(Self { files })
    }
}

impl Files for FolderFiles {
    fn count(&self) -> usize {
        self.files.len()
    }

    fn name(&self, index: usize) -> PathBuf {
        self.files
            .get(index)
            .map_or_else(PathBuf::new, |file| file.path.clone())
    }

    fn open(&self, index: usize, _at_most: u64) -> Result<OpenFile<'_>, VolumeError> {
        let missing = || VolumeError::io(Path::new(""), io::ErrorKind::NotFound.into());
        let entry = self.files.get(index).ok_or_else(missing)?;
        let error = |source| VolumeError::io(&entry.path, source);
        let file = File::open(&entry.path).map_err(error)?;
        let metadata = file.metadata().map_err(error)?;
        if Stamp::of(&metadata) != entry.stamp {
            return Err(VolumeError::Changed {
                path: entry.path.clone(),
            });
        }
        Ok(OpenFile {
            source: Source::File(Arc::new(file), entry.stamp.length),
            length: entry.stamp.length,
        })
    }

    fn check_unchanged(&self, index: usize) -> Result<(), VolumeError> {
        match self.files.get(index) {
            Some(file) => file.stamp.check(&file.path),
            None => Ok(()),
        }
    }
}
