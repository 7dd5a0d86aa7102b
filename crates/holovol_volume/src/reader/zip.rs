//! ZIP archives: of a DICOM folder, or of a single volume file.

use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use flate2::bufread::DeflateDecoder;
use zip::CompressionMethod;
use zip::read::ZipArchive;

use super::dicom::{self, Files, OpenFile};
use super::input::DEFLATE_RATIO_MAX;
use super::options::Content;
use super::source::{Source, SourceCursor};
use super::{Input, Progress, ReadOptions, VolumeReader, readers};
use crate::{Volume, VolumeError};

/// A packed archive that is itself packed may not be larger than this.
const PACKED_MAX: u64 = 4 << 30;

/// Members beyond this are no slices.
const MEMBER_BYTES_MAX: u64 = 16 << 30;

/// More members than this are no study.
const MEMBERS_MAX: usize = 2_000_000;

/// Reads ZIP archives.
#[derive(Clone, Copy, Debug)]
pub struct ZipReader;

impl VolumeReader for ZipReader {
    fn name(&self) -> &'static str {
        "ZIP"
    }

    fn extensions(&self) -> &'static [&'static str] {
        &[".zip"]
    }

    fn recognises(&self, first_bytes: &[u8]) -> bool {
        first_bytes.starts_with(b"PK\x03\x04") || first_bytes.starts_with(b"PK\x05\x06")
    }

    fn read(
        &self,
        input: Input<'_>,
        options: &ReadOptions,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Volume, VolumeError> {
        let files = ZipFiles::open(input)?;
        match files.volume_file() {
            Some(index) => {
                let member = files.member(index)?;
                super::read(member, options, progress)
            }
            None => dicom::read_files(&files, &files.path, options, progress),
        }
    }

    fn contents(
        &self,
        input: Input<'_>,
        options: &ReadOptions,
    ) -> Result<Vec<Content>, VolumeError> {
        let files = ZipFiles::open(input)?;
        match files.volume_file() {
            Some(index) => {
                let (reader, member) = super::find_reader(files.member(index)?)?;
                reader.contents(member, options)
            }
            None => dicom::list_files(&files, &files.path, options),
        }
    }
}

/// The members of an archive.
struct ZipFiles<'a> {
    path: PathBuf,
    source: Source<'a>,
    archive: ZipArchive<SourceCursor<'a>>,
    /// Name and unpacked bytes of each member that is a file.
    members: Vec<(usize, String, u64)>,
}

impl<'a> ZipFiles<'a> {
    fn open(input: Input<'a>) -> Result<Self, VolumeError> {
        let path = input.path().to_path_buf();
        let source = input.into_source(PACKED_MAX)?;
        let damaged = |error: zip::result::ZipError| VolumeError::Damaged {
            path: path.clone(),
            source: io::Error::other(error),
        };
        let mut archive = ZipArchive::new(source.cursor(0)).map_err(damaged)?;
        if archive.len() > MEMBERS_MAX {
            return Err(VolumeError::Unsupported {
                path,
                what: format!("this archive has more than {MEMBERS_MAX} members"),
                way_out: "unpack it and name the folder of one series".into(),
            });
        }
        let mut members = Vec::new();
        for index in 0..archive.len() {
            let member = archive.by_index_raw(index).map_err(damaged)?;
            if member.is_file() {
                let name = member.name().map_err(damaged)?.into_owned();
                members.push((index, name, member.size()));
            }
        }
        Ok(Self {
            path,
            source,
            archive,
            members,
        })
    }

    /// The only member that is named like a volume of another format.
    fn volume_file(&self) -> Option<usize> {
        let is_volume = |name: &str| {
            let name = name.to_lowercase();
            readers()
                .iter()
                .filter(|reader| !matches!(reader.name(), "DICOM" | "ZIP"))
                .any(|reader| reader.extensions().iter().any(|end| name.ends_with(end)))
        };
        let mut volumes = self
            .members
            .iter()
            .enumerate()
            .filter(|(_, (_, name, _))| is_volume(name));
        let (first, _) = volumes.next()?;
        volumes.next().is_none().then_some(first)
    }

    /// A member's content. It is unpacked in memory that grows with what arrives.
    fn unpacked(&self, index: usize, at_most: u64) -> Result<Vec<u8>, VolumeError> {
        let name = self.name(index);
        let missing = || VolumeError::io(&name, io::ErrorKind::NotFound.into());
        let &(member, _, size) = self.members.get(index).ok_or_else(missing)?;
        // The archive's list of members is shared by its clones.
        let mut archive = self.archive.clone();
        let mut file = archive
            .by_index(member)
            .map_err(|error| VolumeError::Damaged {
                path: name.clone(),
                source: io::Error::other(error),
            })?;
        let mut bytes = Vec::new();
        let wanted = at_most.min(size).min(MEMBER_BYTES_MAX);
        file.by_ref()
            .take(wanted)
            .read_to_end(&mut bytes)
            .map_err(|source| VolumeError::decoding(&name, source))?;
        if (bytes.len() as u64) < wanted {
            return Err(VolumeError::Truncated {
                path: name,
                expected: wanted,
                available: bytes.len() as u64,
            });
        }
        Ok(bytes)
    }

    /// A member that is unpacked as it is read.
    fn member(&self, index: usize) -> Result<Input<'a>, VolumeError> {
        let name = self.name(index);
        let missing = || VolumeError::io(&name, io::ErrorKind::NotFound.into());
        let &(member, _, size) = self.members.get(index).ok_or_else(missing)?;
        let mut archive = self.archive.clone();
        let damaged = |error: zip::result::ZipError| VolumeError::Damaged {
            path: name.clone(),
            source: io::Error::other(error),
        };
        let file = archive.by_index(member).map_err(damaged)?;
        let start = file.data_start().ok_or_else(missing)?;
        let packed = file.compressed_size();
        let method = file.compression();
        drop(file);
        let bytes = BufReader::new(self.source.cursor(start)).take(packed);
        Ok(if method == CompressionMethod::Stored {
            Input::from_reader(&name, bytes, size.min(packed))
        } else {
            let at_most = size.min(packed.saturating_mul(DEFLATE_RATIO_MAX));
            Input::from_reader(&name, DeflateDecoder::new(bytes), at_most)
        })
    }
}

impl Files for ZipFiles<'_> {
    fn count(&self) -> usize {
        self.members.len()
    }

    fn name(&self, index: usize) -> PathBuf {
        let name = self.members.get(index).map(|(_, name, _)| name.as_str());
        Path::new(&self.path).join(name.unwrap_or_default())
    }

    fn open(&self, index: usize, at_most: u64) -> Result<OpenFile<'_>, VolumeError> {
        let bytes = self.unpacked(index, at_most)?;
        Ok(OpenFile {
            length: self.members.get(index).map_or(0, |(_, _, size)| *size),
            source: Source::Owned(Arc::new(bytes)),
        })
    }
}
