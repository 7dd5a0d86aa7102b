//! What a data set says of its image: checked, and with everything that hangs on a frame.

use std::io;
use std::path::PathBuf;

use flate2::read::DeflateDecoder;
use glam::DVec3;

use super::dataset::{DECIMALS_BYTES_MAX, Dataset, Failure, PixelData};
use super::files::unpacked_max;
use super::header::{Frame, HeaderFailure, Image, Photometric, Pixels, Start};
use super::syntax::{Codec, Syntax};
use super::tags::{self, Tag};
use crate::reader::input::{DEFLATE_RATIO_MAX, read_at_most};
use crate::{HeaderWindow, VolumeError};

/// Deflated headers are unpacked up to here first, then eight times as far.
const INFLATED_FIRST: u64 = 64 << 10;

/// Where there are more frames than this, each has at least [`FRAME_BYTES_MIN`] bytes of the file.
const TINY_FRAMES_MAX: u64 = 1024;
const FRAME_BYTES_MIN: u64 = 512;

/// The first `at_most` unpacked bytes of a data set that is deflated.
pub(super) fn inflated(bytes: &[u8], at_most: u64) -> io::Result<Vec<u8>> {
    read_at_most(DeflateDecoder::new(bytes), at_most)
}

/// Describes the image of one file.
pub(super) struct HeaderReader {
    pub path: PathBuf,
    pub file: usize,
    /// Bytes, unpacked.
    pub file_length: u64,
    /// Bytes that it takes in its folder or archive.
    pub stored: u64,
}

impl HeaderReader {
    pub fn error(&self, field: &str, found: impl Into<String>, expected: &str) -> VolumeError {
        VolumeError::Field {
            path: self.path.clone(),
            format: "DICOM",
            field: field.into(),
            found: found.into(),
            expected: expected.into(),
        }
    }

    pub fn image(
        &self,
        bytes: &[u8],
        start: Start,
        complete: bool,
    ) -> Result<Option<Image>, HeaderFailure> {
        let (uid, at) = Dataset::parse_meta(bytes, start.at)?;
        let (syntax, unreadable) = match &uid {
            Some(uid) => match Syntax::from_uid(uid) {
                Ok(syntax) => (syntax, None),
                // Compressed files have their elements in explicit VR.
                Err(name) => (
                    Syntax::guess(bytes.get(at..).unwrap_or_default()),
                    Some(format!("its pixels are compressed with {name}")),
                ),
            },
            None => (Syntax::guess(bytes.get(at..).unwrap_or_default()), None),
        };
        if !syntax.deflated {
            let (dataset, data) = Dataset::parse(bytes, at, syntax.encoding(), complete)?;
            return Ok(self.describe(&dataset, data, syntax, unreadable, self.file_length)?);
        }
        if !complete {
            return Err(Failure::Short.into());
        }
        // No more is unpacked than up to the pixels.
        let packed = bytes.get(at..).unwrap_or_default();
        let limit = unpacked_max(packed.len() as u64);
        let mut wanted = INFLATED_FIRST;
        loop {
            let unpacked = inflated(packed, wanted)
                .map_err(|source| VolumeError::decoding(&self.path, source))?;
            let complete = (unpacked.len() as u64) < wanted;
            match Dataset::parse(&unpacked, 0, syntax.encoding(), complete) {
                Ok((dataset, data)) => {
                    let length = (packed.len() as u64).saturating_mul(DEFLATE_RATIO_MAX);
                    return Ok(self.describe(&dataset, data, syntax, unreadable, length)?);
                }
                Err(Failure::Short) if !complete => {
                    if wanted >= limit {
                        return Err(self.header_too_long(limit).into());
                    }
                    wanted = wanted.saturating_mul(8).min(limit);
                }
                Err(failure) => return Err(failure.into()),
            }
        }
    }

    /// What to tell of a header that goes on beyond what may be unpacked for it.
    pub fn header_too_long(&self, limit: u64) -> VolumeError {
        self.error(
            "data set",
            format!("longer than {limit} bytes before its pixels come"),
            "a header that is no larger than four times the packed file; unpack it first",
        )
    }

    fn describe(
        &self,
        dataset: &Dataset<'_>,
        data: Option<PixelData>,
        syntax: Syntax,
        mut unreadable: Option<String>,
        length: u64,
    ) -> Result<Option<Image>, VolumeError> {
        let Some(data) = data else {
            return Ok(None);
        };
        let needed = |tag: Tag, name: &str| {
            dataset
                .unsigned(tag)
                .ok_or_else(|| self.error(name, "missing", "this field in every image"))
        };
        let photometric = match dataset.text(tags::PHOTOMETRIC).as_deref() {
            Some("MONOCHROME1") => Photometric::Monochrome1,
            Some("MONOCHROME2") | None => Photometric::Monochrome2,
            Some(other) => Photometric::Other(other.chars().take(16).collect()),
        };
        let bits_allocated = needed(tags::BITS_ALLOCATED, "Bits Allocated (0028,0100)")?;
        let bits_stored = dataset
            .unsigned(tags::BITS_STORED)
            .unwrap_or(bits_allocated);
        let pixels = Pixels {
            rows: needed(tags::ROWS, "Rows (0028,0010)")?,
            columns: needed(tags::COLUMNS, "Columns (0028,0011)")?,
            bits_allocated,
            bits_stored,
            high_bit: dataset
                .unsigned(tags::HIGH_BIT)
                .unwrap_or(bits_stored.saturating_sub(1)),
            signed: dataset.unsigned(tags::PIXEL_REPRESENTATION) == Some(1),
            float: data.tag != tags::PIXEL_DATA,
        };
        let samples = dataset.unsigned(tags::SAMPLES_PER_PIXEL).unwrap_or(1);
        if unreadable.is_none() {
            unreadable = match (&photometric, samples, bits_allocated) {
                (Photometric::Other(name), _, _) => Some(format!("it is in colour ({name})")),
                (_, 1, 8 | 16 | 32) => None,
                (_, 1, 64) if pixels.float => None,
                (_, 1, bits) => Some(format!("its pixels have {bits} bits")),
                _ => Some("it is in colour".into()),
            };
        }
        if unreadable.is_none() {
            self.check(&pixels)?;
        }
        let frames = match dataset.decimals(tags::NUMBER_OF_FRAMES) {
            Ok(None) => 1,
            Ok(Some(list)) if list.first().is_some_and(|&n| n >= 1.0) => {
                list.first().map_or(1, |&n| n as u64)
            }
            _ => {
                return Err(self.error(
                    "Number of Frames (0028,0008)",
                    "no whole number above 0",
                    "1 or more",
                ));
            }
        };
        let available = data
            .length
            .unwrap_or(u64::MAX)
            .min(length.saturating_sub(data.offset));
        let frame_bytes = match syntax.codec {
            Codec::Native => pixels.frame_bytes().max(1),
            // An item's header, and something in it.
            _ => 8,
        };
        if unreadable.is_none() && frames.saturating_mul(frame_bytes) > available {
            return Err(VolumeError::Truncated {
                path: self.path.clone(),
                expected: frames.saturating_mul(frame_bytes),
                available,
            });
        }
        // What is known of a frame takes memory, too.
        let stored = self.stored.min(self.file_length);
        if frames > TINY_FRAMES_MAX && stored / frames < FRAME_BYTES_MIN {
            return Err(self.error(
                "Number of Frames (0028,0008)",
                format!("{frames} frames in {stored} bytes"),
                "frames that hold more than a few pixels",
            ));
        }
        let frames = self.frames(dataset, frames as usize)?;
        let text = |tag: Tag| dataset.text(tag).unwrap_or_default();
        let first = |tag: Tag| self.number(dataset, tag);
        let shown = |text: String| -> String {
            text.chars().filter(|c| !c.is_control()).take(64).collect()
        };
        Ok(Some(Image {
            file: self.file,
            syntax,
            unreadable,
            data,
            data_bytes: available,
            pixels,
            photometric,
            padding: padding(dataset, &pixels),
            instance_uid: text(tags::SOP_INSTANCE),
            series_uid: text(tags::SERIES_INSTANCE),
            series_number: first(tags::SERIES_NUMBER)?.unwrap_or(0.0),
            modality: shown(text(tags::MODALITY)),
            description: shown(text(tags::SERIES_DESCRIPTION)),
            is_localizer: text(tags::IMAGE_TYPE).to_uppercase().contains("LOCALIZER"),
            has_lut: !dataset.items(tags::MODALITY_LUT_SEQUENCE).is_empty(),
            unit: unit(dataset),
            windows: self.windows(dataset)?,
            frames,
        }))
    }

    fn check(&self, pixels: &Pixels) -> Result<(), VolumeError> {
        if pixels.count() == 0 {
            return Err(self.error("Rows and Columns (0028,0010)", "0", "1 or more"));
        }
        if pixels.float {
            return Ok(());
        }
        let stored = pixels.bits_stored;
        if stored == 0 || stored > pixels.bits_allocated {
            return Err(self.error(
                "Bits Stored (0028,0101)",
                stored.to_string(),
                "1 to Bits Allocated",
            ));
        }
        if pixels.high_bit + 1 < stored || pixels.high_bit >= pixels.bits_allocated {
            return Err(self.error(
                "High Bit (0028,0102)",
                pixels.high_bit.to_string(),
                "Bits Stored − 1",
            ));
        }
        Ok(())
    }

    /// The first of the numbers in a text element.
    fn number(&self, dataset: &Dataset<'_>, tag: Tag) -> Result<Option<f64>, VolumeError> {
        Ok(self
            .numbers(dataset, tag)?
            .and_then(|list| list.first().copied()))
    }

    fn numbers(&self, dataset: &Dataset<'_>, tag: Tag) -> Result<Option<Vec<f64>>, VolumeError> {
        dataset.decimals(tag).map_err(|text| {
            let field = format!("({:04X},{:04X})", tag >> 16, tag & 0xffff);
            if text.len() > DECIMALS_BYTES_MAX {
                let found = format!("{} bytes long", text.len());
                return self.error(&field, found, "no more numbers than there are frames");
            }
            // Damage could have put anything there: only what can be part of a number is shown.
            let numeric = |c: char| c.is_ascii_digit() || "+-.eE\\ ".contains(c);
            let found = if text.chars().all(numeric) {
                format!("{:?}", text.chars().take(64).collect::<String>())
            } else {
                format!("a text of {} characters", text.chars().count())
            };
            self.error(&field, found, "numbers")
        })
    }

    /// Finite vectors of a position or an orientation.
    fn vectors<const N: usize>(
        &self,
        dataset: Option<&Dataset<'_>>,
        tag: Tag,
    ) -> Result<Option<[DVec3; N]>, VolumeError> {
        let Some(dataset) = dataset else {
            return Ok(None);
        };
        let Some(list) = self.numbers(dataset, tag)? else {
            return Ok(None);
        };
        if list.len() != 3 * N {
            let field = format!("({:04X},{:04X})", tag >> 16, tag & 0xffff);
            let found = format!("{} numbers", list.len());
            return Err(self.error(&field, found, &format!("{} numbers", 3 * N)));
        }
        let at = |i: usize| list.get(i).copied().unwrap_or(0.0);
        Ok(Some(std::array::from_fn(|i| {
            DVec3::new(at(3 * i), at(3 * i + 1), at(3 * i + 2))
        })))
    }

    fn frames(&self, dataset: &Dataset<'_>, count: usize) -> Result<Vec<Frame>, VolumeError> {
        let nothing = Dataset::default();
        let shared = dataset.item(tags::SHARED_GROUPS).unwrap_or(&nothing);
        let groups = dataset.items(tags::FRAME_GROUPS);
        let offsets = self.numbers(dataset, tags::GRID_FRAME_OFFSETS)?;
        let detector = dataset.item(tags::DETECTOR_SEQUENCE);
        // Doses have a scaling under a name of its own.
        let dose = self.number(dataset, tags::DOSE_GRID_SCALING)?;
        let mut frames = Vec::new();
        for index in 0..count {
            let own = groups.get(index).unwrap_or(&nothing);
            let group = |tag: Tag| own.item(tag).or_else(|| shared.item(tag));
            let measures = group(tags::PIXEL_MEASURES_SEQUENCE).unwrap_or(dataset);
            let transform = group(tags::PIXEL_TRANSFORM_SEQUENCE).unwrap_or(dataset);
            let content = group(tags::FRAME_CONTENT_SEQUENCE);
            let plane = |sequence: Tag| group(sequence).or(detector).unwrap_or(dataset);
            let or_top = |found: Option<f64>, tag: Tag| match found {
                Some(found) => Ok(Some(found)),
                None => self.number(dataset, tag),
            };

            let axes = self.vectors::<2>(
                Some(plane(tags::PLANE_ORIENTATION_SEQUENCE)),
                tags::ORIENTATION,
            )?;
            let axes = match axes {
                Some(axes) => Some(axes),
                None => self.vectors::<2>(Some(dataset), tags::ORIENTATION)?,
            };
            let position =
                self.vectors::<1>(Some(plane(tags::PLANE_POSITION_SEQUENCE)), tags::POSITION)?;
            let position = match position {
                Some(position) => Some(position),
                None => self.vectors::<1>(Some(dataset), tags::POSITION)?,
            };
            let mut spacing = self.numbers(measures, tags::PIXEL_SPACING)?;
            if spacing.is_none() {
                spacing = self.numbers(dataset, tags::IMAGER_PIXEL_SPACING)?;
            }
            let spacing = match spacing.as_deref() {
                Some(&[rows, columns]) => Some([columns, rows]),
                _ => None,
            };
            let between = or_top(
                self.number(measures, tags::SPACING_BETWEEN_SLICES)?,
                tags::SPACING_BETWEEN_SLICES,
            )?;
            let axes = axes.map(|axes| axes.map(DVec3::normalize_or_zero));
            let mut position = position.map(|[position]| position);
            // Frames that share one position are a distance apart.
            if group(tags::PLANE_POSITION_SEQUENCE).is_none()
                && let (Some(first), Some([row, column])) = (position, axes)
                && count > 1
            {
                // Offsets that don't begin with 0 are places along the patient's z (C.8.8.3.2).
                let offset = offsets
                    .as_ref()
                    .and_then(|offsets| Some(offsets.get(index)? - offsets.first()?))
                    .or(between.map(|between| between * index as f64));
                position = offset.map(|offset| first + row.cross(column) * offset);
            }
            let echo = group(tags::MR_ECHO_SEQUENCE)
                .and_then(|echo| echo.double(tags::EFFECTIVE_ECHO_TIME));
            let b_value = match group(tags::MR_DIFFUSION_SEQUENCE) {
                Some(diffusion) => diffusion.double(tags::B_VALUE),
                None => dataset.double(tags::B_VALUE),
            };
            frames.push(Frame {
                index: index as u32,
                position,
                axes,
                spacing,
                thickness: or_top(
                    self.number(measures, tags::SLICE_THICKNESS)?,
                    tags::SLICE_THICKNESS,
                )?,
                between,
                slope: dose
                    .or(or_top(
                        self.number(transform, tags::RESCALE_SLOPE)?,
                        tags::RESCALE_SLOPE,
                    )?)
                    .filter(|&slope| slope != 0.0)
                    .unwrap_or(1.0),
                intercept: or_top(
                    self.number(transform, tags::RESCALE_INTERCEPT)?,
                    tags::RESCALE_INTERCEPT,
                )?
                .unwrap_or(0.0),
                instance: self.number(dataset, tags::INSTANCE_NUMBER)?.unwrap_or(0.0),
                location: self.number(dataset, tags::SLICE_LOCATION)?,
                echo: match echo {
                    Some(echo) if echo.is_finite() => echo,
                    _ => self.number(dataset, tags::ECHO_TIME)?.unwrap_or(0.0),
                },
                b_value: b_value.filter(|b| b.is_finite()).unwrap_or(0.0),
                temporal: match content
                    .and_then(|content| content.unsigned_32(tags::TEMPORAL_POSITION_INDEX))
                {
                    Some(index) => f64::from(index),
                    None => self
                        .number(dataset, tags::TEMPORAL_POSITION)?
                        .unwrap_or(0.0),
                },
                acquisition: self
                    .number(dataset, tags::ACQUISITION_NUMBER)?
                    .unwrap_or(0.0),
            });
        }
        Ok(frames)
    }

    /// The display windows, in data units.
    fn windows(&self, dataset: &Dataset<'_>) -> Result<Vec<HeaderWindow>, VolumeError> {
        let groups = dataset.items(tags::FRAME_GROUPS);
        let middle = groups.get(groups.len() / 2);
        let shared = dataset.item(tags::SHARED_GROUPS);
        let source = [middle, shared]
            .into_iter()
            .flatten()
            .find_map(|groups| groups.item(tags::FRAME_WINDOW_SEQUENCE))
            .unwrap_or(dataset);
        let centers = self
            .numbers(source, tags::WINDOW_CENTER)?
            .unwrap_or_default();
        let widths = self
            .numbers(source, tags::WINDOW_WIDTH)?
            .unwrap_or_default();
        let names = source.text(tags::WINDOW_EXPLANATION).unwrap_or_default();
        let mut names = names.split('\\');
        let function = source.text(tags::VOI_FUNCTION).unwrap_or_default();
        // LINEAR counts in whole numbers: DICOM PS3.3, C.11.2.1.2.1.
        let half = if function.is_empty() || function == "LINEAR" {
            0.5
        } else {
            0.0
        };
        Ok(centers
            .into_iter()
            .zip(widths)
            .map(|(center, width)| {
                let name = names.next().unwrap_or_default().trim();
                let reach = (width / 2.0 - half).max(0.0);
                HeaderWindow {
                    window: [center - half - reach, center - half + reach],
                    name: name.chars().filter(|c| !c.is_control()).take(32).collect(),
                }
            })
            .filter(|window| window.window[0] < window.window[1])
            .collect())
    }
}

/// The unit of the scaled values: of the terms that DICOM defines (C.11.1.1.2, C.8.9.1.1.3,
/// C.8.8.3), so that nothing else that a file writes there is shown.
fn unit(dataset: &Dataset<'_>) -> Option<&'static str> {
    let shared = dataset.item(tags::SHARED_GROUPS);
    let first = dataset.items(tags::FRAME_GROUPS).first();
    let transform = |group: Option<&'_ Dataset<'_>>| {
        group?
            .item(tags::PIXEL_TRANSFORM_SEQUENCE)?
            .text(tags::RESCALE_TYPE)
    };
    let of_scaling = dataset
        .text(tags::RESCALE_TYPE)
        .or_else(|| transform(first))
        .or_else(|| transform(shared));
    let is = |tag: Tag, value: &str| dataset.text(tag).is_some_and(|text| text == value);
    let is_scaled = dataset.text(tags::RESCALE_SLOPE).is_some()
        || [first, shared].into_iter().flatten().any(|group| {
            group
                .item(tags::PIXEL_TRANSFORM_SEQUENCE)
                .is_some_and(|transform| transform.text(tags::RESCALE_SLOPE).is_some())
        });
    Some(match of_scaling.as_deref() {
        Some("HU" | "HU_MOD") => "HU",
        Some("OD") => "10⁻³ OD",
        Some("MGML") => "mg/ml",
        Some("PCT") => "%",
        Some("ED") => "10²³/ml",
        _ if is(tags::UNITS, "BQML") => "Bq/ml",
        _ if is(tags::UNITS, "GML") => "g/ml",
        _ if is(tags::UNITS, "CNTS") => "counts",
        _ if is(tags::DOSE_UNITS, "GY") => "Gy",
        // CT's images must name it if it is another (C.8.2.1); they do if they are scaled at all.
        None if is(tags::MODALITY, "CT") && is_scaled => "HU",
        _ => return None,
    })
}

/// The stored values that mean "nothing was measured here".
fn padding(dataset: &Dataset<'_>, pixels: &Pixels) -> Option<[i64; 2]> {
    let value = |tag: Tag| {
        dataset.unsigned(tag).map(|bits| {
            if pixels.signed {
                i64::from(bits as i16)
            } else {
                i64::from(bits)
            }
        })
    };
    let first = value(tags::PIXEL_PADDING)?;
    let last = value(tags::PIXEL_PADDING_LIMIT).unwrap_or(first);
    Some([first.min(last), first.max(last)])
}
