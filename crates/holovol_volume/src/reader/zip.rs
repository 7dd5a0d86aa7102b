//! ZIP archives: of a DICOM folder, or of a single volume file.

use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use flate2::CrcReader;
use flate2::bufread::DeflateDecoder;
use zip::CompressionMethod;
use zip::read::ZipArchive;
use zip::result::ZipError;

use super::dicom::{self, Files, OpenFile};
use super::input::{DEFLATE_RATIO_MAX, read_at_most};
use super::options::Content;
use super::source::{Source, SourceCursor};
use super::{Input, Progress, ReadOptions, VolumeReader, readers};
use crate::{Volume, VolumeError};

/// Members beyond this are no slices.
const MEMBER_BYTES_MAX: u64 = 16 << 30;

/// There may be a member per so many bytes of an archive, beside [`MEMBERS_MIN`]: the list of them
/// takes some hundred bytes of memory each.
const BYTES_PER_MEMBER: u64 = 256;
const MEMBERS_MIN: u64 = 1024;

/// Where the record that ends an archive can be: it has 22 bytes, a comment of up to 64 KiB, and
/// before it the 20 bytes that say where ZIP64's is.
const END_BYTES_MAX: u64 = (64 << 10) + 22 + 20;

const ZIP64_END: &[u8] = b"PK\x06\x06";
const ZIP64_BYTES: usize = 56;

/// Where ZIP64's record of the end can be: where it is said to be, and wherever it is found.
fn zip64_places(tail: &[u8], length: u64) -> Vec<u64> {
    let start = length - tail.len() as u64;
    let said = tail
        .windows(16)
        .filter(|window| window.starts_with(b"PK\x06\x07"))
        .map(|locator| u64::from_le_bytes(std::array::from_fn(|i| locator[8 + i])));
    let found = tail
        .windows(ZIP64_END.len())
        .zip(start..)
        .filter(|(window, _)| *window == ZIP64_END)
        .map(|(_, place)| place);
    said.chain(found).collect()
}

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

/// Compares the check sum of a member that is read to its end.
struct Checked<R> {
    bytes: CrcReader<R>,
    check_sum: u32,
}

impl<R: Read> Checked<R> {
    fn new(bytes: R, check_sum: u32) -> Self {
        Self {
            bytes: CrcReader::new(bytes),
            check_sum,
        }
    }
}

impl<R: Read> Read for Checked<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.bytes.read(buffer)?;
        if count == 0 && !buffer.is_empty() && self.bytes.crc().sum() != self.check_sum {
            let error = "the check sum of this member of the archive does not match";
            return Err(io::Error::new(io::ErrorKind::InvalidData, error));
        }
        Ok(count)
    }
}

/// What can't be read of an archive: what isn't understood is not damaged.
fn failure(path: &Path, error: ZipError) -> VolumeError {
    let what = match error {
        ZipError::UnsupportedArchive(what) if what == ZipError::PASSWORD_REQUIRED => {
            "a member of the archive that is locked with a password".into()
        }
        ZipError::InvalidPassword => "a member of the archive that is locked".into(),
        ZipError::UnsupportedArchive(what) => format!("this archive ({what})"),
        ZipError::CompressionMethodNotSupported(method) => {
            format!("a member of the archive that is packed by method {method}")
        }
        error => {
            return VolumeError::Damaged {
                path: path.into(),
                source: io::Error::other(error),
            };
        }
    };
    VolumeError::Unsupported {
        path: path.into(),
        what,
        way_out: "unpack it with another program and open what was in it".into(),
    }
}

/// The members of an archive.
struct ZipFiles<'a> {
    path: PathBuf,
    source: Source<'a>,
    archive: ZipArchive<SourceCursor<'a>>,
    members: Vec<Member>,
}

/// A member that is a file.
struct Member {
    index: usize,
    name: String,
    /// Bytes, as the archive claims.
    size: u64,
    packed: u64,
}

impl<'a> ZipFiles<'a> {
    fn open(input: Input<'a>) -> Result<Self, VolumeError> {
        let path = input.path().to_path_buf();
        let source = input.into_source()?;
        let damaged = |error| failure(&path, error);
        let members_max = source.length() / BYTES_PER_MEMBER + MEMBERS_MIN;
        let check = |count: u64| {
            if count <= members_max {
                return Ok(());
            }
            Err(VolumeError::Unsupported {
                path: path.clone(),
                what: format!(
                    "this archive claims {count} members in {} bytes",
                    source.length()
                ),
                way_out: "unpack it and name the folder of one series".into(),
            })
        };
        // Before the list of members is read: the record at the end claims their number.
        let tail = source
            .read_vec(source.length().saturating_sub(END_BYTES_MAX), END_BYTES_MAX)
            .map_err(|error| VolumeError::io(&path, error))?;
        for end in tail
            .windows(12)
            .filter(|end| end.starts_with(b"PK\x05\x06"))
        {
            if let [.., here_0, here_1, all_0, all_1] = *end {
                let here = u16::from_le_bytes([here_0, here_1]);
                check(here.max(u16::from_le_bytes([all_0, all_1])).into())?;
            }
        }
        for place in zip64_places(&tail, source.length()) {
            let mut record = [0; ZIP64_BYTES];
            let read = source.read_at(place, &mut record).unwrap_or(0);
            if read == ZIP64_BYTES && record.starts_with(ZIP64_END) {
                let number =
                    |at: usize| u64::from_le_bytes(std::array::from_fn(|i| record[at + i]));
                check(number(24).max(number(32)))?;
            }
        }
        let mut archive = ZipArchive::new(source.cursor(0)).map_err(damaged)?;
        check(archive.len() as u64)?;
        let mut members = Vec::new();
        for index in 0..archive.len() {
            let member = archive.by_index_raw(index).map_err(damaged)?;
            if member.is_file() {
                let name = member.name().map_err(damaged)?.into_owned();
                members.push(Member {
                    index,
                    name,
                    // Deflate can't pack more into a byte.
                    size: member
                        .size()
                        .min(member.compressed_size().saturating_mul(DEFLATE_RATIO_MAX)),
                    packed: member.compressed_size(),
                });
            }
        }
        Ok(Self {
            path,
            source,
            archive,
            members,
        })
    }

    /// The only member that is named like a volume of another format. Beside each file, macOS
    /// archives one named `._…` that holds none.
    fn volume_file(&self) -> Option<usize> {
        let is_volume = |name: &str| {
            let name = name.to_lowercase();
            if name
                .rsplit('/')
                .next()
                .is_some_and(|own| own.starts_with("._"))
            {
                return false;
            }
            readers()
                .iter()
                .filter(|reader| !matches!(reader.name(), "DICOM" | "ZIP"))
                .any(|reader| reader.extensions().iter().any(|end| name.ends_with(end)))
        };
        let mut volumes = self
            .members
            .iter()
            .enumerate()
            .filter(|(_, member)| is_volume(&member.name));
        let (first, _) = volumes.next()?;
        volumes.next().is_none().then_some(first)
    }

    /// A member's content. It is unpacked in memory that grows with what arrives.
    fn unpacked(&self, index: usize, at_most: u64) -> Result<Vec<u8>, VolumeError> {
        let name = self.name(index);
        let missing = || VolumeError::io(&name, io::ErrorKind::NotFound.into());
        let member = self.members.get(index).ok_or_else(missing)?;
        // The archive's list of members is shared by its clones.
        let mut archive = self.archive.clone();
        let mut file = archive
            .by_index(member.index)
            .map_err(|error| failure(&name, error))?;
        let wanted = at_most.min(member.size).min(MEMBER_BYTES_MAX);
        let bytes = read_at_most(file.by_ref(), wanted)
            .map_err(|source| VolumeError::decoding(&name, source))?;
        // The check sum is compared where the crate is asked for what follows the last byte.
        if wanted == member.size {
            file.read(&mut [0])
                .map_err(|source| VolumeError::decoding(&name, source))?;
        }
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
        let member = self.members.get(index).ok_or_else(missing)?;
        let size = member.size;
        let mut archive = self.archive.clone();
        let file = archive
            .by_index(member.index)
            .map_err(|error| failure(&name, error))?;
        let start = file.data_start().ok_or_else(missing)?;
        let packed = file.compressed_size();
        let (method, check_sum) = (file.compression(), file.crc32());
        drop(file);
        let bytes = BufReader::new(self.source.cursor(start)).take(packed);
        Ok(if method == CompressionMethod::Stored {
            let checked = Checked::new(bytes, check_sum);
            Input::from_reader(&name, checked, size.min(packed))
        } else {
            let at_most = size.min(packed.saturating_mul(DEFLATE_RATIO_MAX));
            let checked = Checked::new(DeflateDecoder::new(bytes), check_sum);
            Input::from_reader(&name, checked, at_most)
        })
    }
}

impl Files for ZipFiles<'_> {
    fn count(&self) -> usize {
        self.members.len()
    }

    fn name(&self, index: usize) -> PathBuf {
        let name = self.members.get(index).map(|member| member.name.as_str());
        Path::new(&self.path).join(name.unwrap_or_default())
    }

    fn open(&self, index: usize, at_most: u64) -> Result<OpenFile<'_>, VolumeError> {
        let bytes = self.unpacked(index, at_most)?;
        Ok(OpenFile {
            length: self.members.get(index).map_or(0, |member| member.size),
            source: Source::Owned(Arc::new(bytes)),
        })
    }

    fn stored_bytes(&self, index: usize) -> u64 {
        self.members.get(index).map_or(0, |member| member.packed)
    }
}
