//! NRRD, attached (`.nrrd`) and detached (`.nhdr` and a data file), versions 1 to 5.
//!
//! Encodings raw, gzip, bzip2, ascii and hex; data in one file, in a list or a numbered series of
//! them. Where an axis is not space (vector components, time) its first entry is read, or the one
//! that was chosen. Segmentations (`.seg.nrrd`) are told as labels.

mod axes;
mod filters;
mod header;

use std::io::BufRead;

use super::decode::{self, Decoded, Layout};
use super::options::Content;
use super::{Input, Progress, ReadOptions, VolumeReader, select};
use crate::{SourceFormat, Volume, VolumeError};
use axes::Axes;
use filters::{HexBytes, TextNumbers};
use header::{DataFile, Encoding, Header};

/// Reads NRRD.
#[derive(Clone, Copy, Debug)]
pub struct NrrdReader;

impl VolumeReader for NrrdReader {
    fn name(&self) -> &'static str {
        "NRRD"
    }

    fn extensions(&self) -> &'static [&'static str] {
        &[".nrrd", ".nhdr"]
    }

    fn recognises(&self, first_bytes: &[u8]) -> bool {
        first_bytes.starts_with(b"NRRD")
    }

    fn read(
        &self,
        mut input: Input<'_>,
        options: &ReadOptions,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Volume, VolumeError> {
        let header = Header::read(&mut input)?;
        let encoding = header.encoding()?;
        let number = header.number_type()?;
        let mut notices = Vec::new();
        let axes = Axes::new(&header, &mut notices)?;
        let geometry = axes.geometry(&header, &mut notices)?;
        let layout = Layout {
            number,
            big_endian: match encoding {
                Encoding::Text => cfg!(target_endian = "big"),
                _ if number.bytes() == 1 => false,
                _ => header.big_endian()?,
            },
            dims: axes.dims(&header)?,
        };

        let data = match header.data_file()? {
            DataFile::Attached => decoded(input, &header, encoding, &layout, &axes)?,
            DataFile::One(name) => {
                let data = input.open_sibling(&name)?;
                decoded(data, &header, encoding, &layout, &axes)?
            }
            DataFile::Several(names) => several(&input, names, &header, encoding, &layout, &axes)?,
        };
        let reduced = axes.reduced();
        let entries = reduced.first().map_or(1, |&(steps, _)| steps);
        let entry = select::entry(options, data.path(), entries, "entry", "volume")?;
        let mut chosen = std::iter::once(entry).chain(std::iter::repeat(0));
        let mut data = reduced.iter().fold(data, |data, &(steps, numbers)| {
            let block = numbers.saturating_mul(number.bytes() as u64);
            data.entry_along_axis(block, steps, chosen.next().unwrap_or(0))
        });
        let Decoded {
            voxels,
            notices: lost,
            rounded,
        } = decode::read_voxels(&mut data, &layout, options, progress)?;
        notices.extend(lost);
        if reduced.is_empty() {
            notices.extend(decode::check_end(&mut data)?);
        }

        if entry > 0 {
            notices.push(format!(
                "of the slowest of those axes this is entry {}",
                entry + 1
            ));
        }
        let mut volume = Volume::new(voxels, layout.dims, 1.0, 0.0, geometry)?
            .with_rounded(rounded)
            .with_source_format(SourceFormat {
                name: self.name(),
                numbers: number.name(),
            });
        if let Some(labels) = header.labels() {
            volume = volume.with_labels(labels);
        }
        if let Some(unit) = header.field("sample units") {
            volume = volume.with_unit(unit.trim_matches('"'));
        }
        Ok(notices.into_iter().fold(volume, Volume::with_notice))
    }

    fn contents(
        &self,
        mut input: Input<'_>,
        _options: &ReadOptions,
    ) -> Result<Vec<Content>, VolumeError> {
        let header = Header::read(&mut input)?;
        let axes = Axes::new(&header, &mut Vec::new())?;
        Ok(match axes.reduced().first() {
            Some(&(steps, _)) => select::contents(steps, "entry"),
            None => Vec::new(),
        })
    }
}

/// The voxels' bytes in several files, each of which has the same part of them.
fn several(
    input: &Input<'_>,
    names: Vec<String>,
    header: &Header,
    encoding: Encoding,
    layout: &Layout,
    axes: &Axes,
) -> Result<Input<'static>, VolumeError> {
    if encoding != Encoding::Raw || header.skip("line skip")? != 0 {
        return Err(header.unsupported(
            "data in several files that are packed, or begin with lines to skip, can't be read",
            "join the files into one (`unu save -e gzip`)",
        ));
    }
    let skip = header.skip("byte skip")?;
    let skip = u64::try_from(skip)
        .map_err(|_| header.error("byte skip", skip.to_string(), "0 or more bytes"))?;
    let numbers = axes
        .sizes
        .iter()
        .fold(1u64, |product, &n| product.saturating_mul(n));
    let bytes = numbers.saturating_mul(layout.number.bytes() as u64);
    let count = names.len() as u64;
    if count == 0 || bytes % count != 0 {
        return Err(header.error(
            "data file",
            format!("{count} files"),
            format!("files that share {bytes} bytes evenly"),
        ));
    }
    input.open_siblings(names, skip, bytes / count)
}

/// The voxels' bytes: what is to be skipped skipped, what is encoded decoded.
fn decoded<'a>(
    mut data: Input<'a>,
    header: &Header,
    encoding: Encoding,
    layout: &Layout,
    axes: &Axes,
) -> Result<Input<'a>, VolumeError> {
    let lines = header.skip("line skip")?;
    if lines < 0 {
        return Err(header.error("line skip", lines.to_string(), "0 or more lines"));
    }
    for _ in 0..lines {
        if !skip_line(&mut data)? {
            break;
        }
    }
    // Lines are skipped in what is packed, bytes in what was packed.
    match encoding {
        Encoding::Gzip => data = data.gunzip(),
        Encoding::Bzip2 => {
            // Bzip2 has no bound worth the name: 45 bytes can hold 900,000.
            data = data.filtered(None, bzip2::bufread::MultiBzDecoder::new);
        }
        Encoding::Raw | Encoding::Text | Encoding::Hex => {}
    }
    match header.skip("byte skip")? {
        bytes @ 0.. => data.skip(bytes.unsigned_abs())?,
        -1 if encoding == Encoding::Raw => {
            let numbers = axes
                .sizes
                .iter()
                .fold(1u64, |product, &n| product.saturating_mul(n));
            let voxels = numbers.saturating_mul(layout.number.bytes() as u64);
            let length = data.exact_length().ok_or_else(|| {
                header.unsupported(
                    "`byte skip: -1` in a packed file can't be read",
                    "unpack the file first",
                )
            })?;
            data.skip(length.saturating_sub(voxels))?;
        }
        bytes => {
            return Err(header.error(
                "byte skip",
                bytes.to_string(),
                "0 or more bytes; -1 (data at the file's end) only with raw encoding",
            ));
        }
    }
    let number_bytes = layout.number.bytes() as u64;
    let left = data.at_most();
    Ok(match encoding {
        Encoding::Raw | Encoding::Gzip | Encoding::Bzip2 => data,
        Encoding::Text => {
            // A number takes a digit and a separator.
            let at_most = left.map(|text| text.div_ceil(2).saturating_mul(number_bytes));
            data.filtered(at_most, |text| TextNumbers::new(text, layout.number))
        }
        Encoding::Hex => data.filtered(left.map(|digits| digits / 2), HexBytes),
    })
}

/// Leaves out the rest of a line; false at the end of the input.
fn skip_line(data: &mut Input<'_>) -> Result<bool, VolumeError> {
    loop {
        let path = data.path().to_path_buf();
        let buffer = data
            .fill_buf()
            .map_err(|source| VolumeError::decoding(&path, source))?;
        if buffer.is_empty() {
            return Ok(false);
        }
        let end = buffer.iter().position(|&byte| byte == b'\n');
        let bytes = end.map_or(buffer.len(), |end| end + 1);
        data.consume(bytes);
        if end.is_some() {
            return Ok(true);
        }
    }
}
