//! From a series to a volume: every frame decoded into its place, by all cores.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use super::codec::{self, Numbers};
use super::convert::{Conversion, Extremes, Stored, StoredKind};
use super::files::Files;
use super::frames::FrameFile;
use super::header::{Image, Photometric};
use super::series::{Series, Study};
use super::stack::Slice;
use super::syntax::Codec;
use crate::reader::{Progress, ReadOptions, limits, parallel};
use crate::{HeaderWindow, SourceFormat, Volume, VolumeError, Voxels};

/// Pixels that would be packed better than so many times have to be seen first.
const PROVEN_RATIO: u64 = 64;

pub(super) fn load(
    files: &dyn Files,
    study: &Study,
    series: &Series,
    path: &Path,
    options: &ReadOptions,
    progress: &mut dyn FnMut(Progress),
) -> Result<Volume, VolumeError> {
    let stack = &series.stack;
    let image_of = |slice: &Slice| study.images.get(slice.image);
    let Some(first) = stack.slices.first() else {
        return Err(VolumeError::NothingFound {
            path: path.into(),
            files: study.files,
            reasons: String::new(),
        });
    };
    let image = image_of(first).ok_or_else(|| VolumeError::Changed { path: path.into() })?;
    let scaling = |slice: &Slice| (slice.frame.slope, slice.frame.intercept);
    let same_scaling = stack
        .slices
        .iter()
        .all(|slice| scaling(slice) == scaling(first));
    let pixels = image.pixels;
    let kind = StoredKind::of(&pixels, same_scaling);

    let fill = options.fill_missing_slices && !stack.gaps.is_empty();
    let count = if fill {
        stack.filled_count()
    } else {
        stack.slices.len()
    };
    let bytes = pixels
        .count()
        .checked_mul(kind.bytes() as u64)
        .and_then(|bytes| bytes.checked_mul(count as u64));
    limits::check_voxel_bytes(path, bytes, options)?;
    for slice in &stack.slices {
        if let Some(image) = image_of(slice) {
            check_claim(image, || files.name(image.file))?;
        }
    }

    let loading = Loading {
        files,
        study,
        stack: &stack.slices,
        places: places(stack.slices.len(), if fill { &stack.gaps } else { &[] }),
        frame_len: pixels.count() as usize,
        count,
        path,
        options,
        same_scaling,
        rounded: AtomicBool::new(false),
        padding: AtomicU64::new(0),
        falls: scaling(first).0 < 0.0,
    };
    let voxels = match kind {
        StoredKind::U8 => loading.voxels(progress).map(Voxels::U8),
        StoredKind::I8 => loading.voxels(progress).map(Voxels::I8),
        StoredKind::U16 => loading.voxels(progress).map(Voxels::U16),
        StoredKind::I16 => loading.voxels(progress).map(Voxels::I16),
        StoredKind::F32 => loading.voxels(progress).map(Voxels::F32),
    };
    // First, since a change may be why it failed.
    for image in stack.slices.iter().filter_map(image_of) {
        files.check_unchanged(image.file)?;
    }
    let voxels = voxels?;
    let rounded = loading.rounded.load(Ordering::Relaxed) || fill;
    let padding = loading.padding.load(Ordering::Relaxed);

    let (slope, intercept) = if same_scaling {
        scaling(first)
    } else {
        (1.0, 0.0)
    };
    let geometry = if fill {
        stack.filled_geometry()
    } else {
        stack.geometry
    };
    let dims = [
        pixels.columns.into(),
        pixels.rows.into(),
        u32::try_from(count).unwrap_or(u32::MAX),
    ];
    let mut volume = Volume::new(voxels, dims, slope, intercept, geometry)?
        .with_rounded(rounded)
        .with_source_format(SourceFormat {
            name: "DICOM",
            numbers: match (pixels.float, pixels.bits_allocated, pixels.signed) {
                (true, 64, _) => "f64",
                (true, ..) => "f32",
                (_, 8, false) => "u8",
                (_, 8, true) => "i8",
                (_, 16, false) => "u16",
                (_, 16, true) => "i16",
                (_, _, false) => "u32",
                (_, _, true) => "i32",
            },
        });
    let windows = windows(study, &stack.slices, image, &volume);
    volume = volume
        .with_header_windows(windows)
        .with_unit(image.unit.unwrap_or_default())
        .with_padding(padding);
    if padding > 0 {
        volume = volume.with_notice(format!(
            "{padding} voxels are padding, where nothing was measured: they have the lowest value"
        ));
    }
    for notice in notices(study, series, image, fill, same_scaling) {
        volume = volume.with_notice(notice);
    }
    Ok(volume)
}

/// Refuses frames that the bytes of a file can't hold, however they are compressed.
fn check_claim(image: &Image, name: impl Fn() -> PathBuf) -> Result<(), VolumeError> {
    let claimed = image
        .pixels
        .count()
        .saturating_mul(image.frames.len() as u64);
    let most = codec::most_pixels(image.syntax.codec, &image.pixels, image.data_bytes);
    if claimed <= most {
        return Ok(());
    }
    Err(VolumeError::Field {
        path: name(),
        format: "DICOM",
        field: "Pixel Data (7FE0,0010)".into(),
        found: format!("{} bytes for {claimed} pixels", image.data_bytes),
        expected: "as many bytes as such pixels take at least; get a good copy of the file".into(),
    })
}

/// For every place in the volume the slice that goes there; `None` where one is missing.
fn places(slices: usize, gaps: &[(usize, usize)]) -> Vec<Option<usize>> {
    let mut gaps = gaps.iter().peekable();
    let mut places = Vec::new();
    for slice in 0..slices {
        if let Some((_, missing)) = gaps.next_if(|(index, _)| *index == slice) {
            places.extend(std::iter::repeat_n(None, *missing));
        }
        places.push(Some(slice));
    }
    places
}

struct Loading<'a> {
    files: &'a dyn Files,
    study: &'a Study,
    stack: &'a [Slice],
    places: Vec<Option<usize>>,
    frame_len: usize,
    /// Slices in the volume.
    count: usize,
    path: &'a Path,
    options: &'a ReadOptions,
    same_scaling: bool,
    rounded: AtomicBool,
    /// Voxels.
    padding: AtomicU64,
    /// The higher a number, the lower the value.
    falls: bool,
}

impl<'a> Loading<'a> {
    fn voxels<T: Stored>(&self, progress: &mut dyn FnMut(Progress)) -> Result<Vec<T>, VolumeError> {
        let length = self.frame_len * self.count;
        // Files of several frames are opened once.
        let opened: Vec<OnceLock<FrameFile<'a>>> =
            self.study.images.iter().map(|_| OnceLock::new()).collect();
        self.prove_claim(size_of::<T>())?;
        let mut voxels = bytemuck::allocation::try_zeroed_slice_box::<T>(length)
            .map_err(|()| VolumeError::TooLarge {
                path: self.path.into(),
                bytes: (length * size_of::<T>()) as u64,
                limit: "the memory that is free".into(),
            })?
            .into_vec();
        let frame_bytes = (self.frame_len * size_of::<T>()) as u64;
        let total_bytes = frame_bytes * self.stack.len() as u64;
        let mut bytes = 0;
        let mut extremes = Extremes::default();
        let work = voxels
            .chunks_exact_mut(self.frame_len)
            .zip(&self.places)
            .filter_map(|(chunk, slice)| Some((chunk, self.stack.get((*slice)?)?)));
        parallel::for_each(
            work,
            |(chunk, slice)| {
                if self.options.cancel.is_cancelled() {
                    return Err(VolumeError::Cancelled {
                        path: self.path.into(),
                    });
                }
                self.frame(chunk, slice, &opened)
            },
            |of_frame| {
                extremes = extremes.and(of_frame);
                bytes += frame_bytes;
                progress(Progress { bytes, total_bytes });
                Ok(())
            },
        )?;
        // Padding counts as the lowest of what was measured, as NaN does.
        if let (1.., Some([low, high])) = (extremes.padding, extremes.ends) {
            self.replace_padding(&mut voxels, if self.falls { high } else { low });
        }
        self.padding.store(extremes.padding, Ordering::Relaxed);
        self.interpolate(&mut voxels);
        Ok(voxels)
    }

    /// Decodes one frame to see whether there are such frames, before memory for all is taken:
    /// where pixels would be packed very well.
    fn prove_claim(&self, voxel_bytes: usize) -> Result<(), VolumeError> {
        let image_of = |slice: &Slice| self.study.images.get(slice.image);
        let (Some(first), Some(image)) =
            (self.stack.first(), self.stack.first().and_then(image_of))
        else {
            return Ok(());
        };
        let images = self.stack.iter().filter_map(image_of);
        let held = images.map(|image| image.data_bytes / image.frames.len().max(1) as u64);
        let held = held.fold(0, u64::saturating_add);
        let claimed = (self.frame_len * self.count * voxel_bytes) as u64;
        if image.syntax.codec == Codec::Native || claimed / PROVEN_RATIO <= held {
            return Ok(());
        }
        let file = FrameFile::open(self.files, image)?;
        self.unpacked(&file, image, first).map(|_| ())
    }

    /// The numbers of a compressed frame.
    fn unpacked(
        &self,
        file: &FrameFile<'_>,
        image: &Image,
        slice: &Slice,
    ) -> Result<Numbers, VolumeError> {
        let path = || self.files.name(image.file);
        let bytes = file
            .compressed(slice.frame.index)
            .map_err(|error| VolumeError::io(&path(), error))?;
        codec::decode(image.syntax.codec, &bytes, &image.pixels).map_err(|problem| {
            VolumeError::Field {
                path: path(),
                format: "DICOM",
                field: "Pixel Data (7FE0,0010)".into(),
                found: format!(
                    "not to be decoded in frame {}: {problem}",
                    slice.frame.index + 1
                ),
                expected: "a whole compressed image; get a good copy of the file".into(),
            }
        })
    }

    /// Decodes a frame into its place.
    fn frame<T: Stored>(
        &self,
        chunk: &mut [T],
        slice: &Slice,
        opened: &[OnceLock<FrameFile<'a>>],
    ) -> Result<Extremes<T>, VolumeError> {
        let changed = || VolumeError::Changed {
            path: self.path.into(),
        };
        let image = self.study.images.get(slice.image).ok_or_else(changed)?;
        let path = || self.files.name(image.file);
        let own;
        let file = if image.frames.len() > 1 {
            let cell = opened.get(slice.image).ok_or_else(changed)?;
            match cell.get() {
                Some(file) => file,
                // Two threads may open it at once; one of them wins.
                None => {
                    let file = FrameFile::open(self.files, image)?;
                    cell.get_or_init(|| file)
                }
            }
        } else {
            own = FrameFile::open(self.files, image)?;
            &own
        };
        let conversion = Conversion {
            pixels: image.pixels,
            scaling: (!self.same_scaling).then_some((slice.frame.slope, slice.frame.intercept)),
            padding: image.padding,
        };
        let frame_bytes = image.pixels.frame_bytes();
        if image.syntax.codec == Codec::Native {
            let at = frame_bytes * u64::from(slice.frame.index);
            let truncated = |available: usize| VolumeError::Truncated {
                path: path(),
                expected: frame_bytes,
                available: available as u64,
            };
            let io = |error| VolumeError::io(&path(), error);
            if conversion.is_copy::<T>(image.syntax.big_endian) {
                let bytes: &mut [u8] = bytemuck::cast_slice_mut(chunk);
                let read = file.read_native(at, bytes).map_err(io)?;
                if read < bytes.len() {
                    return Err(truncated(read));
                }
            } else {
                let mut bytes = vec![0; frame_bytes as usize];
                let read = file.read_native(at, &mut bytes).map_err(io)?;
                if read < bytes.len() {
                    return Err(truncated(read));
                }
                self.convert_bytes(&conversion, &bytes, image.syntax.big_endian, chunk);
            }
        } else {
            match self.unpacked(file, image, slice)? {
                Numbers::Bytes(bytes) => self.convert_bytes(&conversion, &bytes, false, chunk),
                Numbers::Words(words) => {
                    for (to, word) in chunk.iter_mut().zip(words) {
                        *to = self.convert(&conversion, word.into());
                    }
                }
            }
        }
        Ok(Extremes::of(chunk, &conversion))
    }

    fn convert_bytes<T: Stored>(
        &self,
        conversion: &Conversion,
        bytes: &[u8],
        big_endian: bool,
        chunk: &mut [T],
    ) {
        fn words<const N: usize>(bytes: &[u8], big: bool) -> impl Iterator<Item = [u8; N]> {
            bytes.as_chunks().0.iter().map(move |&word: &[u8; N]| {
                let mut word = word;
                if big {
                    word.reverse();
                }
                word
            })
        }
        let places = chunk.iter_mut();
        match (conversion.pixels.float, conversion.pixels.bits_allocated) {
            (true, 64) => {
                for (to, word) in places.zip(words(bytes, big_endian)) {
                    *to = self.float(conversion, f64::from_le_bytes(word));
                }
            }
            (true, _) => {
                for (to, word) in places.zip(words(bytes, big_endian)) {
                    *to = self.float(conversion, f32::from_le_bytes(word).into());
                }
            }
            (_, 8) => {
                for (to, &byte) in places.zip(bytes) {
                    *to = self.convert(conversion, byte.into());
                }
            }
            (_, 16) => {
                for (to, word) in places.zip(words(bytes, big_endian)) {
                    *to = self.convert(conversion, u16::from_le_bytes(word).into());
                }
            }
            _ => {
                for (to, word) in places.zip(words(bytes, big_endian)) {
                    *to = self.convert(conversion, u32::from_le_bytes(word));
                }
            }
        }
    }

    /// A voxel from the bits of a pixel.
    fn convert<T: Stored>(&self, conversion: &Conversion, bits: u32) -> T {
        let number = conversion.number(bits);
        let Some((slope, intercept)) = conversion.scaling else {
            if size_of::<T>() == 4 && T::from_stored(number).to_f64() != number as f64 {
                self.rounded.store(true, Ordering::Relaxed);
            }
            return T::from_stored(number);
        };
        if conversion.is_padding(number) {
            return T::from_scaled(f64::NAN);
        }
        self.float_scaled(slope * number as f64 + intercept)
    }

    fn float<T: Stored>(&self, conversion: &Conversion, number: f64) -> T {
        let (slope, intercept) = conversion.scaling.unwrap_or((1.0, 0.0));
        self.float_scaled(slope * number + intercept)
    }

    fn float_scaled<T: Stored>(&self, number: f64) -> T {
        let kept = T::from_scaled(number);
        if number.is_finite() && kept.to_f64() != number {
            self.rounded.store(true, Ordering::Relaxed);
        }
        kept
    }

    fn replace_padding<T: Stored>(&self, voxels: &mut [T], value: T) {
        let chunks = voxels.chunks_exact_mut(self.frame_len).zip(&self.places);
        for (chunk, slice) in chunks {
            let image = slice
                .and_then(|slice| self.stack.get(slice))
                .and_then(|slice| self.study.images.get(slice.image));
            let Some(padding) = image.and_then(|image| image.padding) else {
                continue;
            };
            for voxel in chunk.iter_mut().filter(|voxel| voxel.is_padding(padding)) {
                *voxel = value;
            }
        }
    }

    /// Fills the missing slices by linear interpolation between their neighbours.
    fn interpolate<T: Stored>(&self, voxels: &mut [T]) {
        let there: Vec<usize> = (0..self.places.len())
            .filter(|&place| self.places.get(place).is_some_and(Option::is_some))
            .collect();
        for (&before, &after) in there.iter().zip(there.iter().skip(1)) {
            for place in before + 1..after {
                let weight = (place - before) as f64 / (after - before) as f64;
                for pixel in 0..self.frame_len {
                    let at = |place: usize| {
                        let index = place * self.frame_len + pixel;
                        voxels.get(index).map_or(0.0, |voxel| voxel.to_f64())
                    };
                    let value = at(before) + (at(after) - at(before)) * weight;
                    let value = if size_of::<T>() < 4 {
                        value.round()
                    } else {
                        value
                    };
                    if let Some(voxel) = voxels.get_mut(place * self.frame_len + pixel) {
                        *voxel = T::from_scaled(value);
                    }
                }
            }
        }
    }
}

/// The windows of the middle slice, turned over where low values are to be bright.
fn windows(study: &Study, slices: &[Slice], image: &Image, volume: &Volume) -> Vec<HeaderWindow> {
    let middle = slices
        .get(slices.len() / 2)
        .and_then(|slice| study.images.get(slice.image))
        .unwrap_or(image);
    let mut windows = middle.windows.clone();
    windows.dedup();
    if image.photometric == Photometric::Monochrome1 {
        if windows.is_empty() {
            windows.push(HeaderWindow {
                window: volume.range(),
                name: String::new(),
            });
        }
        for window in &mut windows {
            window.window.reverse();
        }
        windows.retain(|window| window.window[0] != window.window[1]);
    }
    windows
}

fn notices(
    study: &Study,
    series: &Series,
    image: &Image,
    fill: bool,
    same_scaling: bool,
) -> Vec<String> {
    let mut notices = series.stack.notices.clone();
    if !series.stack.gaps.is_empty() {
        notices.push(if fill {
            "missing slices are interpolated from their neighbours".into()
        } else {
            "slices are spread evenly over their whole extent, so that it is squeezed where they \
             are missing; they can be interpolated on demand"
                .into()
        });
    }
    if image.photometric == Photometric::Monochrome1 {
        notices.push("MONOCHROME1: low values are to be bright, so the window is reversed".into());
    }
    if image.has_lut {
        notices.push("the modality lookup table is not applied: values are as stored".into());
    }
    if !same_scaling {
        notices.push("slices have scalings of their own: values are kept as f32".into());
    }
    if study.files == 1 && series.stack.slices.len() == 1 {
        notices.push("this is a single slice: name its folder to read the series".into());
    }
    let hidden: usize = study.unreadable.iter().map(|(_, count)| count).sum();
    if let Some((reason, _)) = study.unreadable.first() {
        notices.push(format!("{hidden} images are left out ({reason})"));
    }
    notices
}
