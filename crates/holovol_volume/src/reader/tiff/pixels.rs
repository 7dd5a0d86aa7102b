//! From pages to voxels.

use std::io::{self, Read};
use std::sync::Mutex;

use bytemuck::Pod;
use half::f16;

use super::super::decode::{self, Decoded, Layout};
use super::super::{Input, NumberType, Progress, ReadOptions, parallel};
use super::{PageDecoder, PageNumber, Stack, decoder, tiff_error};
use crate::VolumeError;

/// Small parts keep all cores busy to the end.
const PARTS_PER_CORE: usize = 4;

/// One sample of each pixel of a stack, being read.
pub(super) struct Reading<'s, 'a> {
    pub(super) stack: &'s Stack<'a>,
    pub(super) sample: usize,
    pub(super) options: &'s ReadOptions,
}

impl Reading<'_, '_> {
    fn cancelled(&self) -> VolumeError {
        VolumeError::Cancelled {
            path: self.stack.path.clone(),
        }
    }

    /// Decodes pages straight into the volume, by all cores.
    pub(super) fn parallel<T: Pod + Send>(
        &self,
        slices: &[usize],
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Vec<T>, VolumeError> {
        let length = self.stack.page.len() * slices.len();
        let mut voxels = bytemuck::allocation::try_zeroed_slice_box::<T>(length)
            .map_err(|()| VolumeError::TooLarge {
                path: self.stack.path.clone(),
                bytes: (length * size_of::<T>()) as u64,
                limit: "the memory that is free".into(),
            })?
            .into_vec();
        let mut work: Vec<(usize, &mut [T])> = slices
            .iter()
            .copied()
            .zip(voxels.chunks_exact_mut(self.stack.page.len()))
            .collect();
        work.sort_by_key(|(page, _)| *page);
        let cores = std::thread::available_parallelism().map_or(1, |n| n.get());
        let part = work.len().div_ceil(cores * PARTS_PER_CORE).max(1);
        let mut parts: Vec<Vec<(usize, &mut [T])>> = Vec::new();
        for item in work {
            match parts.last_mut() {
                Some(last) if last.len() < part => last.push(item),
                _ => parts.push(vec![item]),
            }
        }
        let total_bytes = (length * size_of::<T>()) as u64;
        let mut bytes = 0;
        let spare = Mutex::new(Vec::new());
        parallel::for_each(
            parts.into_iter(),
            |part| {
                let lock = || spare.lock().unwrap_or_else(|error| error.into_inner());
                let taken = lock().pop();
                let mut buffer: Vec<u8> = taken.unwrap_or_default();
                let mut pages = Pages::new(self.stack)?;
                let mut done = 0;
                for (page, chunk) in part {
                    if self.options.cancel.is_cancelled() {
                        return Err(self.cancelled());
                    }
                    let chunk: &mut [u8] = bytemuck::cast_slice_mut(chunk);
                    done += chunk.len() as u64;
                    pages.read(page, self.sample, chunk, &mut buffer)?;
                }
                lock().push(buffer);
                Ok(done)
            },
            |done| {
                bytes += done;
                progress(Progress { bytes, total_bytes });
                Ok(())
            },
        )?;
        Ok(voxels)
    }

    /// Decodes one page after the other, into the smallest type that holds all.
    pub(super) fn in_order(
        &self,
        slices: &[usize],
        dims: [u32; 3],
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Decoded, VolumeError> {
        let page = self.stack.page;
        let (number, is_half) = match page.number {
            PageNumber::Plain(number) => (number, false),
            PageNumber::Half => (NumberType::F32, true),
        };
        let bytes = page.len() as u64 * slices.len() as u64 * number.bytes() as u64;
        let layout = Layout {
            number,
            big_endian: match self.stack.planes_at {
                Some(_) if !is_half => self.stack.big_endian,
                _ => cfg!(target_endian = "big"),
            },
            dims,
        };
        let pages = PagesInOrder {
            pages: match self.stack.planes_at {
                Some(_) => None,
                None => Some(Pages::new(self.stack)?),
            },
            stack: self.stack,
            slices: slices.iter(),
            sample: self.sample,
            current: Vec::new(),
            at: 0,
            buffer: Vec::new(),
        };
        let mut input = Input::from_reader(&self.stack.path, pages, bytes);
        decode::read_voxels(&mut input, &layout, self.options, progress)
    }
}

/// Pages of a file, best read in ascending order.
struct Pages<'s, 'a> {
    stack: &'s Stack<'a>,
    decoder: PageDecoder<'a>,
    /// The page that the decoder stands at.
    at: usize,
}

impl<'s, 'a> Pages<'s, 'a> {
    fn new(stack: &'s Stack<'a>) -> Result<Self, VolumeError> {
        Ok(Self {
            decoder: decoder(&stack.source).map_err(|error| tiff_error(&stack.path, error))?,
            stack,
            at: 0,
        })
    }

    /// Fills `out` with one sample of each pixel of the `page`-th page of the stack.
    fn read(
        &mut self,
        page: usize,
        sample: usize,
        out: &mut [u8],
        buffer: &mut Vec<u8>,
    ) -> Result<(), VolumeError> {
        let error = |error| tiff_error(&self.stack.path, error);
        let Some(&page) = self.stack.pages.get(page) else {
            return Err(VolumeError::Field {
                path: self.stack.path.clone(),
                format: "TIFF",
                field: "ImageDescription".into(),
                found: format!("a plane on page {}", page + 1),
                expected: format!("at most {} pages", self.stack.pages.len()),
            });
        };
        if page < self.at {
            *self = Self::new(self.stack)?;
        }
        while self.at < page {
            self.decoder.next_image().map_err(error)?;
            self.at += 1;
        }
        let layout = self.stack.page;
        if layout.samples == 1 {
            self.decoder.read_image_bytes(out).map_err(error)?;
            if layout.white_is_zero {
                out.iter_mut().for_each(|byte| *byte = !*byte);
            }
            return Ok(());
        }
        if layout.planar {
            // All planes, of which one is kept: the crate reads them from the first on.
            buffer.resize(out.len() * (sample + 1), 0);
            self.decoder.read_image_bytes(buffer).map_err(error)?;
            let plane = buffer.chunks_exact(out.len()).nth(sample);
            if let Some(plane) = plane {
                out.copy_from_slice(plane);
            }
            return Ok(());
        }
        buffer.resize(layout.stored_bytes(), 0);
        self.decoder.read_image_bytes(buffer).map_err(error)?;
        let width = layout.number.bytes();
        let pixels = buffer.chunks_exact(width * usize::from(layout.samples));
        for (to, pixel) in out.chunks_exact_mut(width).zip(pixels) {
            if let Some(from) = pixel.chunks_exact(width).nth(sample) {
                to.copy_from_slice(from);
            }
        }
        Ok(())
    }
}

/// The bytes of pages, one after the other.
struct PagesInOrder<'s, 'a> {
    /// `None` where the planes lie one after the other anyway.
    pages: Option<Pages<'s, 'a>>,
    stack: &'s Stack<'a>,
    slices: std::slice::Iter<'s, usize>,
    sample: usize,
    current: Vec<u8>,
    at: usize,
    buffer: Vec<u8>,
}

impl PagesInOrder<'_, '_> {
    /// The next page as numbers; false at the end.
    fn next(&mut self) -> io::Result<bool> {
        let Some(&slice) = self.slices.next() else {
            return Ok(false);
        };
        let page = self.stack.page;
        self.at = 0;
        self.current.resize(page.len() * page.number.bytes(), 0);
        match &mut self.pages {
            Some(pages) => pages
                .read(slice, self.sample, &mut self.current, &mut self.buffer)
                .map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error.to_string()))?,
            None => {
                let offset = self.stack.planes_at.unwrap_or(0);
                let at = offset.saturating_add(slice as u64 * self.current.len() as u64);
                let count = self.stack.source.read_at(at, &mut self.current)?;
                if count < self.current.len() {
                    return Err(io::ErrorKind::UnexpectedEof.into());
                }
            }
        }
        if page.number == PageNumber::Half {
            let swap = self.pages.is_none() && self.stack.big_endian != cfg!(target_endian = "big");
            let halves = self.current.as_chunks::<2>().0.iter();
            self.current = halves
                .flat_map(|&[a, b]| {
                    let bytes = if swap { [b, a] } else { [a, b] };
                    f16::from_ne_bytes(bytes).to_f32().to_ne_bytes()
                })
                .collect();
        }
        Ok(true)
    }
}

impl Read for PagesInOrder<'_, '_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.at == self.current.len() && !self.next()? {
            return Ok(0);
        }
        let rest = self.current.get(self.at..).unwrap_or_default();
        let count = rest.len().min(buffer.len());
        if let (Some(to), Some(from)) = (buffer.get_mut(..count), rest.get(..count)) {
            to.copy_from_slice(from);
        }
        self.at += count;
        Ok(count)
    }
}
