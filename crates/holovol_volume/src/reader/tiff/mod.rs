//! TIFF stacks: pages are slices; OME-TIFF and ImageJ say what else they are.
//!
//! Of several channels and times one is read. Pages are decoded by the `tiff` crate; what stands
//! in `ImageDescription` is understood here. Rows go down in an image: index j is y all the same.

mod description;
mod pixels;
mod tables;

use std::io::BufReader;
use std::path::PathBuf;

use tiff::decoder::{Decoder, Limits};
use tiff::tags::{SampleFormat, Tag};
use tiff::{ColorType, TiffError};

use super::options::{Content, chosen};
use super::placement::{METRES_PER_MM, checked_spacing};
use super::select::numbered;
use super::source::{Source, SourceCursor};
use super::{Input, NumberType, Progress, ReadOptions, VolumeReader, limits};
use crate::{Geometry, SourceFormat, Volume, VolumeError, Voxels};
use description::Description;
use pixels::Reading;

/// More channels and times than this are not listed one by one.
const LISTED_MAX: usize = 1000;

/// More pages than this are damage.
const PAGES_MAX: usize = 1 << 20;

/// Room for the tables of the smallest files.
const TABLE_BYTES_MIN: usize = 256 << 10;

/// Largest packed strip or tile.
const CHUNK_BYTES_MAX: usize = 1 << 30;

/// Descriptions with the places of a million planes are this long.
const TAG_BYTES_MAX: usize = 64 << 20;

type PageDecoder<'a> = Decoder<BufReader<SourceCursor<'a>>>;

/// Reads TIFF.
#[derive(Clone, Copy, Debug)]
pub struct TiffReader;

impl VolumeReader for TiffReader {
    fn name(&self) -> &'static str {
        "TIFF"
    }

    fn extensions(&self) -> &'static [&'static str] {
        &[".tif", ".tiff"]
    }

    fn recognises(&self, first_bytes: &[u8]) -> bool {
        [b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"]
            .iter()
            .any(|magic| first_bytes.starts_with(*magic))
    }

    fn read(
        &self,
        input: Input<'_>,
        options: &ReadOptions,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Volume, VolumeError> {
        Stack::open(input)?.read(options, progress)
    }

    fn contents(
        &self,
        input: Input<'_>,
        _options: &ReadOptions,
    ) -> Result<Vec<Content>, VolumeError> {
        let contents = Stack::open(input)?.contents();
        Ok(if contents.len() > 1 {
            contents
        } else {
            Vec::new()
        })
    }
}

/// The layout that the pages of a stack share.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Page {
    width: u32,
    height: u32,
    samples: u16,
    bits: u8,
    number: PageNumber,
    planar: bool,
    /// Low values are to be bright: the crate turns numbers over, which is undone.
    white_is_zero: bool,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum PageNumber {
    Plain(NumberType),
    Half,
}

impl PageNumber {
    fn bytes(self) -> usize {
        match self {
            Self::Plain(number) => number.bytes(),
            Self::Half => 2,
        }
    }
}

impl Page {
    fn len(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Bytes of a page with all its samples.
    fn stored_bytes(&self) -> usize {
        let samples = if self.planar { 1 } else { self.samples.into() };
        self.len()
            .saturating_mul(self.number.bytes())
            .saturating_mul(samples)
    }
}

struct Stack<'a> {
    path: PathBuf,
    source: Source<'a>,
    page: Page,
    description: Description,
    /// Pages of the stack's layout, by their numbers in the file.
    pages: Vec<usize>,
    /// ImageJ's: where the planes lie, one after the other.
    planes_at: Option<u64>,
    /// Tag 259: 1 for none.
    compression: u16,
    big_endian: bool,
    spacing: [Option<f64>; 3],
    notices: Vec<String>,
}

fn tiff_error(path: &std::path::Path, error: TiffError) -> VolumeError {
    match error {
        TiffError::IoError(source) => VolumeError::decoding(path, source),
        TiffError::UnsupportedError(what) => VolumeError::Unsupported {
            path: path.into(),
            what: what.to_string(),
            way_out: "save it as 8, 16 or 32 bits per sample, uncompressed or with deflate or LZW"
                .into(),
        },
        other => VolumeError::Field {
            path: path.into(),
            format: "TIFF",
            field: "a page".into(),
            found: format!("damaged ({other})"),
            expected: "a readable image; get a good copy of the file".into(),
        },
    }
}

fn decoder<'a>(source: &Source<'a>) -> Result<PageDecoder<'a>, TiffError> {
    let mut limits = Limits::default();
    // Pages are decoded into our own memory; the crate's is for tables, an entry of which takes 32
    // bytes there and 4 in the file.
    limits.decoding_buffer_size = (source.length() as usize)
        .saturating_mul(2)
        .saturating_add(TABLE_BYTES_MIN);
    limits.intermediate_buffer_size = CHUNK_BYTES_MAX.min(source.length() as usize);
    limits.ifd_value_size = TAG_BYTES_MAX.min(source.length() as usize);
    let reader = BufReader::with_capacity(64 << 10, source.cursor(0));
    Ok(Decoder::new(reader)?.with_limits(limits))
}

impl<'a> Stack<'a> {
    fn open(input: Input<'a>) -> Result<Self, VolumeError> {
        let path = input.path().to_path_buf();
        let source = input.into_source()?;
        tables::check(&source, &path)?;
        let error = |error| tiff_error(&path, error);
        let mut decoder = decoder(&source).map_err(error)?;
        let page = page(&mut decoder, &path)?;
        let text = decoder
            .find_tag(Tag::ImageDescription)
            .ok()
            .flatten()
            .and_then(|value| value.into_string().ok());
        let resolution = [Tag::XResolution, Tag::YResolution].map(|tag| {
            let value = decoder.find_tag(tag).ok().flatten()?;
            match value {
                tiff::decoder::ifd::Value::Rational(n, d) if n > 0 && d > 0 => {
                    Some(f64::from(n) / f64::from(d))
                }
                _ => None,
            }
        });
        let first_strip: Option<u64> = decoder
            .find_tag_unsigned_vec(Tag::StripOffsets)
            .ok()
            .flatten()
            .and_then(|offsets| offsets.first().copied());
        let compression: Option<u16> = decoder.find_tag_unsigned(Tag::Compression).ok().flatten();
        let compression = compression.unwrap_or(1);
        if let Some(name) = tables::unread_compression(compression) {
            return Err(VolumeError::Unsupported {
                path,
                what: format!("its pages are compressed with {name}"),
                way_out: "save it uncompressed, or with deflate (ZIP), LZW or PackBits".into(),
            });
        }
        let big_endian = decoder.byte_order() == tiff::tags::ByteOrder::BigEndian;

        let mut pages = vec![0];
        let mut others = 0;
        let mut number = 0;
        while decoder.more_images() && number < PAGES_MAX {
            decoder.next_image().map_err(error)?;
            number += 1;
            let is_reduced = decoder
                .find_tag_unsigned::<u32>(Tag::NewSubfileType)
                .ok()
                .flatten()
                .is_some_and(|kind| kind & 1 == 1);
            match self::page(&mut decoder, &path) {
                Ok(other) if other == page && !is_reduced => pages.push(number),
                _ => others += 1,
            }
        }
        drop(decoder);
        let mut notices = Vec::new();
        if others > 0 {
            notices.push(format!(
                "{others} pages of another size or type (thumbnails, say) are left out"
            ));
        }
        let parsed = text
            .as_deref()
            .and_then(|text| Description::parse(text, source.length()));
        let mut planes_at = None;
        let mut description = match parsed {
            Some(description) => {
                let planes = description.planes();
                if description.is_imagej
                    && pages.len() == 1
                    && planes.is_some_and(|planes| planes > 1)
                    && compression == 1
                {
                    planes_at = first_strip;
                }
                if planes_at.is_none() && planes != Some(pages.len()) {
                    notices.push(format!(
                        "the description counts {} planes, the file has {} pages: taken as slices",
                        planes.unwrap_or(usize::MAX),
                        pages.len()
                    ));
                    Description {
                        spacing: description.spacing,
                        is_imagej: description.is_imagej,
                        ..Description::plain(pages.len())
                    }
                } else {
                    description
                }
            }
            None => Description::plain(pages.len()),
        };
        if let Some(other) = description.elsewhere.take() {
            return Err(VolumeError::Unsupported {
                path,
                what: format!("its planes lie in several files ({other:?}, …)"),
                way_out: "save it as a single OME-TIFF".into(),
            });
        }
        let mut spacing = description.spacing;
        if description.is_imagej {
            for (length, resolution) in spacing.iter_mut().zip(resolution) {
                *length = (*length)
                    .zip(resolution)
                    .map(|(unit, per_unit)| unit / per_unit);
            }
        }
        Ok(Self {
            path,
            source,
            page,
            description,
            pages,
            planes_at,
            compression,
            big_endian,
            spacing,
            notices,
        })
    }

    /// Channels of the description times samples of a pixel, times times.
    fn count(&self) -> usize {
        let channels = self
            .description
            .channels
            .saturating_mul(self.page.samples.into());
        channels
            .saturating_mul(self.description.times)
            .min(PAGES_MAX)
    }

    /// The first of them.
    fn contents(&self) -> Vec<Content> {
        let description = &self.description;
        let samples = usize::from(self.page.samples);
        let mut contents = Vec::new();
        for time in 0..description.times {
            for channel in 0..description.channels * samples {
                let name = description.channel_names.get(channel / samples);
                let mut what = format!("channel {}", channel + 1);
                if description.times > 1 {
                    what.push_str(&format!(", time {}", time + 1));
                }
                contents.push(Content {
                    name: if description.times == 1 && samples == 1 {
                        name.cloned().unwrap_or_default()
                    } else {
                        String::new()
                    },
                    description: what,
                    ..Content::default()
                });
                if contents.len() >= LISTED_MAX {
                    return contents;
                }
            }
        }
        contents
    }

    fn read(
        mut self,
        options: &ReadOptions,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Volume, VolumeError> {
        let contents = self.contents();
        let index = match &options.choice {
            None => 0,
            Some(choice) => chosen(choice, &contents)
                .or_else(|| Some(numbered(choice, self.count() as u64)? as usize))
                .ok_or_else(|| VolumeError::NoSuchChoice {
                    path: self.path.clone(),
                    choice: choice.clone(),
                    contents: contents.clone(),
                })?,
        };
        let samples = usize::from(self.page.samples);
        let per_time = self.description.channels * samples;
        let (time, channel) = (index / per_time, index % per_time);
        let (channel, sample) = (channel / samples, channel % samples);
        let slices: Vec<usize> = (0..self.description.slices)
            .map(|slice| self.description.page(slice, channel, time))
            .collect();
        let dims = [
            self.page.width,
            self.page.height,
            u32::try_from(slices.len()).unwrap_or(u32::MAX),
        ];
        let bytes = (self.page.len() as u64)
            .checked_mul(slices.len() as u64)
            .and_then(|count| count.checked_mul(self.page.number.bytes() as u64));
        let bytes = limits::check_voxel_bytes(&self.path, bytes, options)?;
        let available = tables::most_unpacked(self.source.length(), self.compression);
        if available < bytes {
            return Err(VolumeError::Truncated {
                path: self.path.clone(),
                expected: bytes,
                available,
            });
        }
        if contents.len() > 1 {
            self.notices.push(format!(
                "the file has {} channels and times: this is number {}; another can be chosen",
                self.count(),
                index + 1
            ));
        }
        let reading = Reading {
            stack: &self,
            sample,
            options,
        };
        let (voxels, rounded) = match (self.planes_at, self.page.number) {
            (None, PageNumber::Plain(NumberType::U8)) => {
                (Voxels::U8(reading.parallel(&slices, progress)?), false)
            }
            (None, PageNumber::Plain(NumberType::I8)) => {
                (Voxels::I8(reading.parallel(&slices, progress)?), false)
            }
            (None, PageNumber::Plain(NumberType::U16)) => {
                (Voxels::U16(reading.parallel(&slices, progress)?), false)
            }
            (None, PageNumber::Plain(NumberType::I16)) => {
                (Voxels::I16(reading.parallel(&slices, progress)?), false)
            }
            _ => {
                let decoded = reading.in_order(&slices, dims, progress)?;
                self.notices.extend(decoded.notices);
                (decoded.voxels, decoded.rounded)
            }
        };
        let geometry = self.geometry();
        let mut volume = Volume::new(voxels, dims, 1.0, 0.0, geometry)?
            .with_rounded(rounded)
            .with_source_format(SourceFormat {
                name: "TIFF",
                numbers: match self.page.number {
                    PageNumber::Plain(number) => number.name(),
                    PageNumber::Half => "f16",
                },
            });
        let [low, high] = volume.range();
        if self.page.white_is_zero && low < high {
            volume = volume
                .with_header_window([high, low])
                .with_notice("WhiteIsZero: low values are to be bright, so the window is reversed");
        }
        Ok(self.notices.into_iter().fold(volume, Volume::with_notice))
    }

    fn geometry(&mut self) -> Geometry {
        let [x, y, z] = self.spacing;
        if x.is_none() && y.is_none() && z.is_none() {
            self.notices
                .push("the file gives no spacings: taken as 1 mm".into());
            return Geometry::from_spacing([METRES_PER_MM; 3]);
        }
        // A stack without a depth has its pixels' width.
        let missing = x.or(y).or(z).unwrap_or(f64::NAN);
        if z.is_none() && self.description.slices > 1 {
            self.notices
                .push("the file gives no distance of slices: taken as the pixels' width".into());
        }
        let lengths = [x, y, z].map(|length| length.unwrap_or(missing));
        Geometry::from_spacing(checked_spacing(
            lengths,
            1.0,
            "spacing (m)",
            &mut self.notices,
        ))
    }
}

/// The layout of the page that a decoder stands at.
fn page(decoder: &mut PageDecoder<'_>, path: &std::path::Path) -> Result<Page, VolumeError> {
    let error = |error| tiff_error(path, error);
    let unsupported = |what: String| VolumeError::Unsupported {
        path: path.into(),
        what,
        way_out: "save it as 8, 16 or 32 bits per sample".into(),
    };
    let (width, height) = decoder.dimensions().map_err(error)?;
    let color = decoder.colortype().map_err(error)?;
    if matches!(color, ColorType::Palette(_)) {
        return Err(unsupported(
            "its pixels are numbers of colours in a palette".into(),
        ));
    }
    let bits = color.bit_depth();
    let samples: u16 = decoder
        .find_tag_unsigned(Tag::SamplesPerPixel)
        .map_err(error)?
        .unwrap_or(1);
    let format = decoder
        .find_tag_unsigned_vec::<u16>(Tag::SampleFormat)
        .map_err(error)?
        .and_then(|formats| formats.first().copied())
        .unwrap_or(1);
    let planar: Option<u16> = decoder
        .find_tag_unsigned(Tag::PlanarConfiguration)
        .map_err(error)?;
    let number = match (SampleFormat::from_u16_exhaustive(format), bits) {
        (SampleFormat::Uint | SampleFormat::Void, 8) => PageNumber::Plain(NumberType::U8),
        (SampleFormat::Uint | SampleFormat::Void, 16) => PageNumber::Plain(NumberType::U16),
        (SampleFormat::Uint | SampleFormat::Void, 32) => PageNumber::Plain(NumberType::U32),
        (SampleFormat::Uint | SampleFormat::Void, 64) => PageNumber::Plain(NumberType::U64),
        (SampleFormat::Int, 8) => PageNumber::Plain(NumberType::I8),
        (SampleFormat::Int, 16) => PageNumber::Plain(NumberType::I16),
        (SampleFormat::Int, 32) => PageNumber::Plain(NumberType::I32),
        (SampleFormat::Int, 64) => PageNumber::Plain(NumberType::I64),
        (SampleFormat::IEEEFP, 16) => PageNumber::Half,
        (SampleFormat::IEEEFP, 32) => PageNumber::Plain(NumberType::F32),
        (SampleFormat::IEEEFP, 64) => PageNumber::Plain(NumberType::F64),
        (_, bits) => {
            return Err(unsupported(format!(
                "its samples have {bits} bits and format {format}"
            )));
        }
    };
    let photometric: Option<u16> = decoder
        .find_tag_unsigned(Tag::PhotometricInterpretation)
        .map_err(error)?;
    let white_is_zero = photometric == Some(0);
    if white_is_zero && format == SampleFormat::IEEEFP.to_u16() {
        // 1 − x can't be undone exactly.
        return Err(unsupported("its fractions are marked WhiteIsZero".into()));
    }
    if samples == 0 || width == 0 || height == 0 {
        return Err(unsupported("a page without pixels".into()));
    }
    Ok(Page {
        width,
        height,
        samples,
        bits,
        number,
        planar: planar == Some(2) && samples > 1,
        white_is_zero,
    })
}
