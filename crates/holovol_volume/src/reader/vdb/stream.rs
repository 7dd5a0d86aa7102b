//! Numbers and strings of an OpenVDB file, and blocks of values as it packs them.

use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::PathBuf;

use flate2::read::ZlibDecoder;

use super::blosc;
use crate::VolumeError;
use crate::reader::source::SourceCursor;

/// Longer names and metadata are damage.
const STRING_BYTES_MAX: u32 = 1 << 20;

/// `COMPRESS_…` of openvdb/io/Compression.h.
const COMPRESS_ZIP: u32 = 1;
pub(super) const COMPRESS_ACTIVE_MASK: u32 = 2;
const COMPRESS_BLOSC: u32 = 4;

pub(super) struct Stream<'a> {
    bytes: BufReader<SourceCursor<'a>>,
    /// Of the next byte.
    at: u64,
    path: PathBuf,
    length: u64,
}

impl<'a> Stream<'a> {
    pub fn new(cursor: SourceCursor<'a>, path: PathBuf, length: u64) -> Self {
        Self {
            bytes: BufReader::with_capacity(256 << 10, cursor),
            at: 0,
            path,
            length,
        }
    }

    /// Offset of the next byte.
    pub fn position(&self) -> u64 {
        self.at
    }

    pub fn error(
        &self,
        field: &str,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> VolumeError {
        VolumeError::Field {
            path: self.path.clone(),
            format: "OpenVDB",
            field: field.into(),
            found: found.into(),
            expected: expected.into(),
        }
    }

    pub fn unsupported(&self, what: impl Into<String>, way_out: &str) -> VolumeError {
        VolumeError::Unsupported {
            path: self.path.clone(),
            what: what.into(),
            way_out: way_out.into(),
        }
    }

    pub fn go_to(&mut self, offset: i64, field: &str) -> Result<(), VolumeError> {
        let inside = u64::try_from(offset).ok().filter(|&at| at <= self.length);
        let Some(at) = inside else {
            return Err(self.error(
                field,
                offset.to_string(),
                format!(
                    "an offset within the file's {} bytes; it may be cut short: get a complete copy",
                    self.length
                ),
            ));
        };
        self.at = at;
        self.bytes
            .seek(SeekFrom::Start(at))
            .map(|_| ())
            .map_err(|source| VolumeError::io(&self.path, source))
    }

    pub fn fill(&mut self, buffer: &mut [u8]) -> Result<(), VolumeError> {
        self.at += buffer.len() as u64;
        self.bytes.read_exact(buffer).map_err(|source| {
            if source.kind() == std::io::ErrorKind::UnexpectedEof {
                VolumeError::Damaged {
                    path: self.path.clone(),
                    source: std::io::Error::new(source.kind(), "the file ends too early"),
                }
            } else {
                VolumeError::io(&self.path, source)
            }
        })
    }

    pub fn array<const N: usize>(&mut self) -> Result<[u8; N], VolumeError> {
        let mut array = [0; N];
        self.fill(&mut array)?;
        Ok(array)
    }

    pub fn u8(&mut self) -> Result<u8, VolumeError> {
        Ok(u8::from_le_bytes(self.array()?))
    }

    pub fn u32(&mut self) -> Result<u32, VolumeError> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    pub fn i32(&mut self) -> Result<i32, VolumeError> {
        Ok(i32::from_le_bytes(self.array()?))
    }

    pub fn i64(&mut self) -> Result<i64, VolumeError> {
        Ok(i64::from_le_bytes(self.array()?))
    }

    pub fn f64(&mut self) -> Result<f64, VolumeError> {
        Ok(f64::from_le_bytes(self.array()?))
    }

    pub fn string(&mut self, field: &str) -> Result<String, VolumeError> {
        let length = self.u32()?;
        let bytes = self.vec(u64::from(length), u64::from(STRING_BYTES_MAX), field)?;
        Ok(String::from_utf8_lossy(&bytes).into_owned())
    }

    /// Bytes whose number the file claims; refused if there can't be as many.
    fn vec(&mut self, length: u64, at_most: u64, field: &str) -> Result<Vec<u8>, VolumeError> {
        if length > at_most.min(self.length) {
            return Err(self.error(
                field,
                format!("{length} bytes long"),
                format!("at most {}", at_most.min(self.length)),
            ));
        }
        let mut bytes = vec![0; length as usize];
        self.fill(&mut bytes)?;
        Ok(bytes)
    }

    /// As many bytes as the format has here.
    pub fn vec_exact(&mut self, length: usize) -> Result<Vec<u8>, VolumeError> {
        let mut bytes = vec![0; length];
        self.fill(&mut bytes)?;
        Ok(bytes)
    }

    /// Passes over names, types and values of metadata.
    pub fn skip_metadata(&mut self) -> Result<(), VolumeError> {
        for _ in 0..self.u32()? {
            self.string("metadata name")?;
            self.string("metadata type")?;
            self.string("metadata value")?;
        }
        Ok(())
    }

    /// A block of `length` bytes, unpacked as `compression` says.
    pub fn block(&mut self, length: usize, compression: u32) -> Result<Vec<u8>, VolumeError> {
        if compression & (COMPRESS_ZIP | COMPRESS_BLOSC) == 0 {
            return self.vec(length as u64, u64::MAX, "values");
        }
        let packed = self.i64()?;
        if packed <= 0 {
            // What doesn't shrink is stored as it is.
            if packed.unsigned_abs() != length as u64 {
                return Err(self.error(
                    "values",
                    format!("{} bytes long", packed.unsigned_abs()),
                    format!("{length} bytes"),
                ));
            }
            return self.vec(length as u64, u64::MAX, "values");
        }
        let packed = self.vec(packed.unsigned_abs(), u64::MAX, "packed values")?;
        let damaged = |what: String| {
            self.error(
                "packed values",
                format!("damaged ({what})"),
                "whole blocks; get a good copy of the file",
            )
        };
        if compression & COMPRESS_BLOSC != 0 {
            return blosc::decompress(&packed, length).map_err(damaged);
        }
        let mut unpacked = Vec::with_capacity(length);
        ZlibDecoder::new(packed.as_slice())
            .take(length as u64 + 1)
            .read_to_end(&mut unpacked)
            .map_err(|error| damaged(error.to_string()))?;
        if unpacked.len() == length {
            Ok(unpacked)
        } else {
            Err(damaged(format!("{} bytes", unpacked.len())))
        }
    }
}
