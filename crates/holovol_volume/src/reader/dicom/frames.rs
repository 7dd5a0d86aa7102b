//! The bytes of frames in a file.

use std::sync::Arc;

use super::dataset::Dataset;
use super::describe::inflated;
use super::files::{Files, unpacked_max};
use super::header::{Image, Start};
use super::syntax::Codec;
use super::tags;
use crate::VolumeError;
use crate::reader::source::Source;

/// An item's tag and length.
const ITEM_HEADER: u64 = 8;

/// Fragments of less than this, on average, are damage where there are more than so many.
const FRAGMENT_BYTES_MIN: u64 = 64;
const SMALL_FRAGMENTS_MAX: usize = 4096;

/// A file whose frames can be read.
pub(super) struct FrameFile<'a> {
    source: Source<'a>,
    /// Of uncompressed frames: the first one's offset.
    offset: u64,
    /// Of compressed frames: places of the fragments of each.
    fragments: Vec<Vec<(u64, u64)>>,
}

impl<'a> FrameFile<'a> {
    /// Opens the file of an image.
    pub fn open(files: &'a dyn Files, image: &Image) -> Result<Self, VolumeError> {
        // Of a packed file no more is unpacked than its frames can need.
        let frames = image.frames.len() as u64;
        let needed = match image.syntax.codec {
            _ if image.syntax.deflated => u64::MAX,
            Codec::Native => frames.saturating_mul(image.pixels.frame_bytes()),
            // Nobody gains much by packing them once more.
            _ => unpacked_max(files.stored_bytes(image.file)),
        };
        let file = files.open(image.file, needed.saturating_add(image.data.offset))?;
        let mut source = file.source;
        let path = || files.name(image.file);
        if image.syntax.deflated {
            let bytes = source
                .read_vec(0, u64::MAX)
                .map_err(|error| VolumeError::io(&path(), error))?;
            let changed = || VolumeError::Changed { path: path() };
            let start = Start::find(&bytes).ok_or_else(changed)?;
            let (_, at) = Dataset::parse_meta(&bytes, start.at).map_err(|_| changed())?;
            let at_most = frames
                .saturating_mul(image.pixels.frame_bytes())
                .saturating_add(image.data.offset);
            let unpacked = inflated(bytes.get(at..).unwrap_or_default(), at_most)
                .map_err(|error| VolumeError::decoding(&path(), error))?;
            source = Source::Owned(Arc::new(unpacked));
        }
        let fragments = match image.syntax.codec {
            Codec::Native => Vec::new(),
            _ => fragments(&source, image).map_err(|what| VolumeError::Field {
                path: path(),
                format: "DICOM",
                field: "Pixel Data (7FE0,0010)".into(),
                found: what.into(),
                expected: "compressed frames; get a good copy of the file".into(),
            })?,
        };
        Ok(Self {
            source,
            offset: image.data.offset,
            fragments,
        })
    }

    /// Fills a buffer with a part of the uncompressed pixels; returns fewer bytes at the end.
    pub fn read_native(&self, at: u64, buffer: &mut [u8]) -> std::io::Result<usize> {
        self.source.read_at(self.offset.saturating_add(at), buffer)
    }

    /// The bytes of a compressed frame.
    pub fn compressed(&self, frame: u32) -> std::io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        for &(offset, length) in self.fragments.get(frame as usize).into_iter().flatten() {
            bytes.extend(self.source.read_vec(offset, length)?);
        }
        Ok(bytes)
    }
}

/// Finds the fragments of every frame.
fn fragments(source: &Source<'_>, image: &Image) -> Result<Vec<Vec<(u64, u64)>>, &'static str> {
    let mut at = image.data.offset;
    let mut next = || -> Result<Option<(u64, u64)>, &'static str> {
        let mut header = [0; ITEM_HEADER as usize];
        let count = source.read_at(at, &mut header).map_err(|_| "unreadable")?;
        if count < header.len() {
            return Err("cut off");
        }
        let [t0, t1, t2, t3, length @ ..] = header;
        let tag =
            u32::from(u16::from_le_bytes([t0, t1])) << 16 | u32::from(u16::from_le_bytes([t2, t3]));
        let length = u64::from(u32::from_le_bytes(length));
        let offset = at + ITEM_HEADER;
        match tag {
            tags::ITEM => {}
            tags::SEQUENCE_END => return Ok(None),
            _ => return Err("not made of items"),
        }
        if offset + length > source.length() {
            return Err("cut off");
        }
        at = offset + length;
        Ok(Some((offset, length)))
    };
    let table = next()?.ok_or("empty")?;
    let mut all = Vec::new();
    while let Some(fragment) = next()? {
        all.push(fragment);
        let bytes = fragment.0 - image.data.offset;
        if all.len() > SMALL_FRAGMENTS_MAX && bytes / (all.len() as u64) < FRAGMENT_BYTES_MIN {
            return Err("made of thousands of empty items");
        }
    }
    let frames = image.frames.len();
    if frames == 1 {
        return Ok(vec![all]);
    }
    if all.len() == frames {
        return Ok(all.into_iter().map(|fragment| vec![fragment]).collect());
    }
    // Frames of several fragments begin where the offset table says.
    let table = source
        .read_vec(table.0, table.1)
        .map_err(|_| "unreadable")?;
    let (offsets, _) = table.as_chunks::<4>();
    if offsets.len() != frames {
        return Err("without a table of where its frames begin");
    }
    let first = all.first().ok_or("empty")?.0 - ITEM_HEADER;
    let starts: Vec<u64> = offsets
        .iter()
        .map(|offset| first + u64::from(u32::from_le_bytes(*offset)))
        .collect();
    let mut grouped = vec![Vec::new(); frames];
    let mut frame = 0;
    for fragment in all {
        while starts
            .get(frame + 1)
            .is_some_and(|&start| start <= fragment.0 - ITEM_HEADER)
        {
            frame += 1;
        }
        if let Some(group) = grouped.get_mut(frame) {
            group.push(fragment);
        }
    }
    Ok(grouped)
}
