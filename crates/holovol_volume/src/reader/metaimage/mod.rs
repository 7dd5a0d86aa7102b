//! MetaImage, `.mha` and `.mhd` with its data file: raw or zlib, either byte order.
//!
//! `TransformMatrix` holds the direction of one axis after the other in LPS, as ITK writes it.
//! Of several channels or a fourth axis the first is read, or the one that was chosen.

mod header;

use std::io::BufReader;

use flate2::bufread::ZlibDecoder;

use super::decode::{self, Decoded, Layout};
use super::input::DEFLATE_RATIO_MAX;
use super::{Input, Progress, ReadOptions, VolumeReader, select};
use crate::{SourceFormat, Volume, VolumeError};
use header::{DataFile, Header};

pub(super) use header::numbered;

/// Reads MetaImage.
#[derive(Clone, Copy, Debug)]
pub struct MetaImageReader;

impl VolumeReader for MetaImageReader {
    fn name(&self) -> &'static str {
        "MetaImage"
    }

    fn extensions(&self) -> &'static [&'static str] {
        &[".mhd", ".mha"]
    }

    fn recognises(&self, first_bytes: &[u8]) -> bool {
        // The keys come in any order, but `NDims` or `ObjectType` is first with every writer.
        let start = first_bytes.trim_ascii_start();
        ["ObjectType", "NDims", "Comment"].iter().any(|key| {
            start
                .strip_prefix(key.as_bytes())
                .is_some_and(|rest| rest.trim_ascii_start().starts_with(b"="))
        })
    }

    fn read(
        &self,
        mut input: Input<'_>,
        options: &ReadOptions,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Volume, VolumeError> {
        let header = Header::read(&mut input)?;
        let mut notices = Vec::new();
        let number = header.number_type()?;
        let dims = header.dims()?;
        let geometry = header.geometry(&mut notices)?;
        let sizes = header.sizes()?;
        let layout = Layout {
            number,
            big_endian: header.flag(&["ElementByteOrderMSB", "BinaryDataByteOrderMSB"])?,
            dims,
        };
        let channels = header.channels()?;
        let numbers = sizes
            .iter()
            .fold(channels, |product, &n| product.saturating_mul(n));
        let stored_bytes = numbers.saturating_mul(number.bytes() as u64);
        let packed = header.flag(&["CompressedData"])?;

        let is_local = matches!(header.data_file()?, DataFile::Local);
        let mut data = match header.data_file()? {
            DataFile::Local => input,
            DataFile::One(name) => input.open_sibling(name)?,
            DataFile::List(names) => {
                let names = if names.is_empty() {
                    header::list(&mut input)?
                } else {
                    names
                };
                let each = stored_bytes / (names.len() as u64).max(1);
                input.open_siblings(names, header.skip()?.unwrap_or(0), each)?
            }
        };
        match (header.skip()?, data.exact_length()) {
            (Some(bytes), Some(_)) => data.skip(bytes)?,
            (Some(0), None) | (Some(_), None) => {}
            (None, Some(length)) if !packed => data.skip(length.saturating_sub(stored_bytes))?,
            (None, _) => {
                return Err(header.error(
                    "HeaderSize",
                    "-1 with packed data",
                    "the bytes before the data",
                ));
            }
        }
        if packed {
            let at_most = data
                .at_most()
                .map(|packed| packed.saturating_mul(DEFLATE_RATIO_MAX));
            data = data.filtered(at_most, |bytes| ZlibDecoder::new(BufReader::new(bytes)));
        }
        let rest = sizes.iter().skip(3).product::<u64>();
        let entry = select::entry(
            options,
            data.path(),
            channels.max(rest),
            "channel",
            "volume",
        )?;
        let number_bytes = number.bytes() as u64;
        let voxels: u64 = dims.iter().map(|&n| u64::from(n)).product();
        let mut data = if channels > 1 {
            data.entry_along_axis(number_bytes, channels, entry)
        } else if rest > 1 {
            data.entry_along_axis(voxels.saturating_mul(number_bytes), rest, entry)
        } else {
            data
        };
        let Decoded {
            voxels,
            notices: lost,
            rounded,
        } = decode::read_voxels(&mut data, &layout, options, progress)?;
        notices.extend(lost);
        if channels > 1 || rest > 1 {
            let what = if channels > 1 { "channels" } else { "volumes" };
            let number = channels.max(rest);
            notices.push(select::notice(number, what, entry));
        } else if !is_local || !packed {
            notices.extend(decode::check_end(&mut data)?);
        }
        let volume = Volume::new(voxels, dims, 1.0, 0.0, geometry)?
            .with_rounded(rounded)
            .with_source_format(SourceFormat {
                name: self.name(),
                numbers: number.name(),
            });
        Ok(notices.into_iter().fold(volume, Volume::with_notice))
    }
}
