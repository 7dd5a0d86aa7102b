//! What a DICOM file says of its image, frame by frame.

use glam::DVec3;

use super::dataset::{Failure, PixelData};
use super::describe::HeaderReader;
use super::files::{Files, unpacked_max};
use super::syntax::Syntax;
use crate::{HeaderWindow, VolumeError};

/// Most headers fit; longer ones are read again with eight times as much.
const FIRST_BYTES: u64 = 8 << 10;

/// The preamble and `DICM`.
const PREAMBLE: usize = 128;

/// How dark and bright are written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Photometric {
    /// The lowest value is white.
    Monochrome1,
    Monochrome2,
    /// Not one number per pixel.
    Other(String),
}

/// The numbers in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Pixels {
    pub rows: u16,
    pub columns: u16,
    pub bits_allocated: u16,
    pub bits_stored: u16,
    pub high_bit: u16,
    pub signed: bool,
    /// `Float Pixel Data`, 32 or 64 bits.
    pub float: bool,
}

impl Pixels {
    pub fn count(&self) -> u64 {
        u64::from(self.rows) * u64::from(self.columns)
    }

    /// Bytes of an uncompressed frame.
    pub fn frame_bytes(&self) -> u64 {
        self.count() * u64::from(self.bits_allocated / 8)
    }
}

/// A file that holds an image.
#[derive(Clone, Debug)]
pub(super) struct Image {
    pub file: usize,
    pub syntax: Syntax,
    /// Why this image can't be decoded.
    pub unreadable: Option<String>,
    pub data: PixelData,
    /// Bytes that the pixel data can have at most.
    pub data_bytes: u64,
    pub pixels: Pixels,
    pub photometric: Photometric,
    /// Stored values from the first to the second are no image.
    pub padding: Option<[i64; 2]>,
    /// Tells copies of a file; never shown.
    pub instance_uid: String,
    /// Tells series apart; never shown.
    pub series_uid: String,
    pub series_number: f64,
    pub modality: String,
    /// Of the values after scaling.
    pub unit: Option<&'static str>,
    pub description: String,
    pub is_localizer: bool,
    pub has_lut: bool,
    pub windows: Vec<HeaderWindow>,
    pub frames: Vec<Frame>,
}

/// A slice.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Frame {
    /// In its file, from 0.
    pub index: u32,
    /// Of the first pixel's centre, mm, LPS.
    pub position: Option<DVec3>,
    /// Directions along which the column and the row index grow.
    pub axes: Option<[DVec3; 2]>,
    /// Between columns and between rows, mm.
    pub spacing: Option<[f64; 2]>,
    pub thickness: Option<f64>,
    pub between: Option<f64>,
    pub slope: f64,
    pub intercept: f64,
    pub instance: f64,
    pub location: Option<f64>,
    pub echo: f64,
    /// Diffusion weighting, s/mm².
    pub b_value: f64,
    pub temporal: f64,
    pub acquisition: f64,
}

/// Reads the header of a file; `None` if it is not DICOM or holds no image.
///
/// # Errors
/// If it is DICOM and damaged, or can't be read at all.
pub(super) fn read(files: &dyn Files, index: usize) -> Result<Option<Image>, VolumeError> {
    let stored = files.stored_bytes(index);
    let limit = unpacked_max(stored);
    let mut wanted = FIRST_BYTES;
    loop {
        let file = files.open(index, wanted)?;
        let bytes = file
            .source
            .read_vec(0, wanted)
            .map_err(|source| VolumeError::decoding(&files.name(index), source))?;
        let complete = bytes.len() as u64 >= file.length;
        let Some(start) = Start::find(&bytes) else {
            return Ok(None);
        };
        let reader = HeaderReader {
            path: files.name(index),
            file: index,
            file_length: file.length,
            stored,
        };
        match reader.image(&bytes, start, complete) {
            Ok(image) => return Ok(image),
            Err(HeaderFailure::Volume(error)) => return Err(*error),
            Err(HeaderFailure::Bytes(Failure::Short)) if !complete => {
                if (bytes.len() as u64) < wanted {
                    return Err(VolumeError::Changed { path: reader.path });
                }
                if wanted >= limit {
                    return Err(reader.header_too_long(limit));
                }
                wanted = wanted.saturating_mul(8).min(limit);
            }
            // Anything can begin with a small group number.
            Err(HeaderFailure::Bytes(_)) if start.is_guess => return Ok(None),
            Err(HeaderFailure::Bytes(Failure::Short)) => {
                return Err(VolumeError::TruncatedHeader {
                    path: reader.path,
                    format: "DICOM",
                });
            }
            Err(HeaderFailure::Bytes(Failure::Damaged(what))) => {
                return Err(reader.error(
                    "data set",
                    format!("damaged ({what})"),
                    "whole elements; get a good copy of the file, or move it out of the folder",
                ));
            }
        }
    }
}

/// Where the first element is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Start {
    pub at: usize,
    /// No magic bytes: it only looks like a data set.
    is_guess: bool,
}

impl Start {
    pub fn find(bytes: &[u8]) -> Option<Self> {
        if bytes
            .get(PREAMBLE..)
            .unwrap_or_default()
            .starts_with(b"DICM")
        {
            return Some(Self {
                at: PREAMBLE + 4,
                is_guess: false,
            });
        }
        // Old files have no preamble: the first element is of group 2 or 8, and short.
        let [group @ (2 | 8), 0, _, 0, rest @ ..] = bytes else {
            return None;
        };
        let length_or_vr = *rest.first_chunk::<4>()?;
        let is_vr = length_or_vr.iter().take(2).all(u8::is_ascii_uppercase);
        let is_length = *group == 8 && u32::from_le_bytes(length_or_vr) <= 64;
        (is_vr || is_length).then_some(Self {
            at: 0,
            is_guess: true,
        })
    }
}

pub(super) enum HeaderFailure {
    Bytes(Failure),
    Volume(Box<VolumeError>),
}

impl From<Failure> for HeaderFailure {
    fn from(failure: Failure) -> Self {
        Self::Bytes(failure)
    }
}

impl From<VolumeError> for HeaderFailure {
    fn from(error: VolumeError) -> Self {
        Self::Volume(Box::new(error))
    }
}
