//! A look at a file's directories before the `tiff` crate reserves memory for what they claim.
//!
//! The crate keeps 32 bytes per value of a table, whatever it takes in the file, reads the first
//! directory before it can be told a limit, and reserves rows as long as a tile claims to be.

use std::path::Path;

use super::super::source::Source;
use crate::VolumeError;

/// More entries than this has no directory; the crate knows some seventy tags.
const ENTRIES_MAX: u64 = 4096;

/// A table may have one value per so many bytes of the file, beside [`VALUES_MIN`].
///
/// With its offset and its length in the file, a strip or tile has more: what is packed of it.
const BYTES_PER_VALUE: u64 = 32;
const VALUES_MIN: u64 = 4096;

/// Larger sides of tiles than this, and than the page's, are damage.
const TILE_SIDE_MAX: u64 = 16 << 10;

const IMAGE_WIDTH: u16 = 256;
const IMAGE_LENGTH: u16 = 257;
const COMPRESSION: u16 = 259;
const IMAGE_DESCRIPTION: u16 = 270;
const SAMPLES_PER_PIXEL: u16 = 277;
const TILE_WIDTH: u16 = 322;
const TILE_LENGTH: u16 = 323;

/// Tags of which the crate, or we, read the values.
const READ: [u16; 23] = [
    254,
    IMAGE_WIDTH,
    IMAGE_LENGTH,
    258,
    COMPRESSION,
    262,
    IMAGE_DESCRIPTION,
    273,
    SAMPLES_PER_PIXEL,
    278,
    279,
    282,
    283,
    284,
    317,
    TILE_WIDTH,
    TILE_LENGTH,
    324,
    325,
    338,
    339,
    347,
    530,
];

/// How numbers are written.
#[derive(Clone, Copy)]
struct Format {
    big_endian: bool,
    /// BigTIFF: counts and offsets have 8 bytes.
    is_big: bool,
}

impl Format {
    fn number(self, bytes: &[u8]) -> u64 {
        let digit = |number: u64, &byte: &u8| number << 8 | u64::from(byte);
        if self.big_endian {
            bytes.iter().fold(0, digit)
        } else {
            bytes.iter().rev().fold(0, digit)
        }
    }

    fn offset_bytes(self) -> usize {
        if self.is_big { 8 } else { 4 }
    }
}

/// One directory entry.
struct Entry {
    tag: u16,
    kind: u16,
    count: u64,
    /// The value, if it is a single one and stands here.
    value: u64,
}

/// Checks all directories of a file.
///
/// # Errors
/// If they overlap or loop, or claim more than such a file can hold.
pub(super) fn check(source: &Source<'_>, path: &Path) -> Result<(), VolumeError> {
    let field = |field: &str, found: String, expected: &str| VolumeError::Field {
        path: path.into(),
        format: "TIFF",
        field: field.into(),
        found,
        expected: format!("{expected}; get a good copy of the file"),
    };
    let read = |offset: u64, bytes: u64| {
        source
            .read_vec(offset, bytes)
            .map_err(|error| VolumeError::decoding(path, error))
    };
    let header = read(0, 16)?;
    let [order, _, rest @ ..] = header.as_slice() else {
        // The crate tells what is wrong with so short a file.
        return Ok(());
    };
    let mut format = Format {
        big_endian: *order == b'M',
        is_big: false,
    };
    format.is_big = format.number(rest.get(..2).unwrap_or_default()) == 43;
    let wide = format.offset_bytes();
    let first = if format.is_big { 8 } else { 4 };
    let mut at = format.number(header.get(first..first + wide).unwrap_or_default());
    // Directories that don't overlap take no more than the file: this ends loops, too.
    let mut left = source.length();
    while at != 0 {
        let count_bytes = if format.is_big { 8 } else { 2 };
        let count = format.number(&read(at, count_bytes)?);
        if count > ENTRIES_MAX {
            return Err(field(
                "a directory",
                format!("of {count} entries"),
                "at most 4096 entries",
            ));
        }
        let entry_bytes = 4 + 2 * wide as u64;
        let bytes = count * entry_bytes + wide as u64;
        let entries = read(at.saturating_add(count_bytes), bytes)?;
        let is_cut = (entries.len() as u64) < bytes;
        let (listed, next) = entries.split_at(entries.len().min((count * entry_bytes) as usize));
        let listed: Vec<Entry> = listed
            .chunks_exact(entry_bytes as usize)
            .map(|entry| entry_of(entry, format))
            .collect();
        // The crate passes over 8 of the 16 bytes of such an entry, and reads all after it askew.
        let is_unknown = |entry: &&Entry| format.is_big && !matches!(entry.kind, 1..=13 | 16..=18);
        if let Some(entry) = listed.iter().find(is_unknown) {
            return Err(field(
                "a directory",
                format!("an entry of type {} (tag {})", entry.kind, entry.tag),
                "BigTIFF's types, 1 to 13 and 16 to 18",
            ));
        }
        check_page(&listed, source.length())
            .map_err(|(name, found, expected)| field(name, found, expected))?;
        if is_cut {
            // That it is, the crate tells.
            return Ok(());
        }
        left = left.checked_sub(count_bytes + bytes).ok_or_else(|| {
            field(
                "the list of pages",
                "longer than the file".into(),
                "pages of their own, each listed once",
            )
        })?;
        at = format.number(next);
    }
    Ok(())
}

fn entry_of(bytes: &[u8], format: Format) -> Entry {
    let wide = format.offset_bytes();
    let number = |from: usize, length: usize| {
        format.number(bytes.get(from..from + length).unwrap_or_default())
    };
    let kind = number(2, 2) as u16;
    let value_bytes = (value_bytes(kind) as usize).min(wide);
    Entry {
        tag: number(0, 2) as u16,
        kind,
        count: number(4, wide),
        value: number(4 + wide, value_bytes),
    }
}

/// Bytes of a value in the file.
fn value_bytes(kind: u16) -> u64 {
    match kind {
        3 | 8 => 2,
        4 | 9 | 11 | 13 => 4,
        5 | 10 | 12 | 16..=18 => 8,
        _ => 1,
    }
}

type Problem = (&'static str, String, &'static str);

fn check_page(entries: &[Entry], length: u64) -> Result<(), Problem> {
    let value = |tag: u16| {
        let entry = entries.iter().find(|entry| entry.tag == tag)?;
        Some(entry.value)
    };
    for entry in entries.iter().filter(|entry| READ.contains(&entry.tag)) {
        // Text takes its own length twice.
        let is_text = entry.tag == IMAGE_DESCRIPTION && entry.kind == 2;
        let most = if is_text {
            length
        } else {
            (length / BYTES_PER_VALUE + VALUES_MIN).min(length / value_bytes(entry.kind))
        };
        if entry.count > most.max(1) {
            return Err((
                "a table",
                format!("{} values long (tag {})", entry.count, entry.tag),
                "no more values than such a file can hold",
            ));
        }
    }
    let samples = value(SAMPLES_PER_PIXEL).unwrap_or(1);
    for (side, of_page) in [(TILE_WIDTH, IMAGE_WIDTH), (TILE_LENGTH, IMAGE_LENGTH)] {
        let page = value(of_page).unwrap_or(0);
        if let Some(tile) = value(side)
            && (tile > TILE_SIDE_MAX.max(page.saturating_mul(2)))
        {
            return Err((
                "TileWidth or TileLength",
                format!("{tile} for a page of {page}"),
                "tiles no larger than their page",
            ));
        }
    }
    // A row of all samples is unpacked at once. Deflate makes at most 1032 bytes of one.
    let row = value(TILE_WIDTH)
        .or(value(IMAGE_WIDTH))
        .unwrap_or(0)
        .saturating_mul(samples);
    if samples > 1 && row > length.saturating_mul(4).saturating_add(1 << 20) {
        return Err((
            "SamplesPerPixel",
            format!("{samples}, {row} samples per row"),
            "rows that such a file can hold",
        ));
    }
    Ok(())
}

/// The name of a compression that can't be read.
pub(super) fn unread_compression(compression: u16) -> Option<String> {
    let name = match compression {
        1 | 5 | 8 | 32_773 | 32_946 => return None,
        2..=4 => "a fax code",
        6 | 7 | 33_003 | 33_005 | 34_712 => "JPEG or JPEG 2000",
        34_887 => "LERC",
        34_925 => "LZMA",
        50_000 => "Zstandard",
        50_001 | 34_927 => "WebP",
        50_002 | 52_546 => "JPEG XL",
        other => return Some(format!("number {other}, which is not known")),
    };
    Some(name.into())
}

/// How many bytes of pixels a file of `length` bytes may at most hold.
pub(super) fn most_unpacked(length: u64, compression: u16) -> u64 {
    let ratio = match compression {
        1 => 1,
        // LZW: a string of up to 4096 bytes per 12 bits.
        5 => 2731,
        // Deflate, under two numbers.
        8 | 32_946 => super::super::input::DEFLATE_RATIO_MAX,
        // PackBits: a run of 128 in two bytes.
        _ => 64,
    };
    length.saturating_mul(ratio)
}
