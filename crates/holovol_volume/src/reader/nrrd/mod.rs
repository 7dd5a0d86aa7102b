//! NRRD, attached (`.nrrd`) and detached (`.nhdr` and a data file), versions 1 to 5.
//!
//! Encodings raw, gzip, ascii and hex. Where an axis is not space (vector components, time) its
//! first entry is read. Data spread over several files and bzip2 are refused.

mod axes;
mod filters;
mod header;

use std::io::BufRead;

use super::decode::{self, Decoded, Layout};
use super::{Input, Progress, ReadOptions, VolumeReader};
use crate::{SourceFormat, Volume, VolumeError};
use axes::Axes;
use filters::{FirstAlongAxis, HexBytes, TextNumbers};
use header::{Encoding, Header};

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
            Some(name) => input.open_sibling(name)?,
            None => input,
        };
        let data = decoded(data, &header, encoding, &layout, &axes)?;
        let reduced = axes.reduced();
        let mut data = reduced.iter().fold(data, |data, &(steps, numbers)| {
            let block = numbers.saturating_mul(number.bytes() as u64);
            let at_most = data.at_most();
            data.filtered(at_most, |bytes| FirstAlongAxis::new(bytes, block, steps))
        });
        let Decoded {
            voxels,
            notices: lost,
        } = decode::read_voxels(&mut data, &layout, options, progress)?;
        notices.extend(lost);
        if reduced.is_empty() {
            notices.extend(decode::check_end(&mut data)?);
        }

        let volume = Volume::new(voxels, layout.dims, 1.0, 0.0, geometry)?.with_source_format(
            SourceFormat {
                name: self.name(),
                numbers: number.name(),
            },
        );
        Ok(notices.into_iter().fold(volume, Volume::with_notice))
    }
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
    if encoding == Encoding::Gzip {
        data = data.gunzip();
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
        Encoding::Raw | Encoding::Gzip => data,
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
