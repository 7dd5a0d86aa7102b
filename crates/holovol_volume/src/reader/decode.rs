use std::collections::TryReserveError;
use std::io::{BufRead, Read};

use bytemuck::{Pod, Zeroable};

use super::numbers::{NumberType, WideNumber, smallest_kind};
use super::source::Source;
use super::{CancelFlag, Input, Progress, ReadOptions, parallel};
use crate::{VolumeError, VoxelKind, Voxels};

/// Voxels are read in pieces of this many bytes: memory grows with what arrives.
const CHUNK_BYTES: usize = 1 << 20;

/// Below this the threads would cost more than they save.
const PARALLEL_BYTES_MIN: u64 = 2 << 20;

/// Progress is told after this many bytes.
const PROGRESS_BYTES: u64 = 4 << 20;

/// How the voxels of a file are written.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layout {
    pub number: NumberType,
    pub big_endian: bool,
    /// Along x, y, z; none of them 0.
    pub dims: [u32; 3],
}

impl Layout {
    /// Bytes of voxels, if a machine can count them.
    pub fn voxel_bytes(&self) -> Option<u64> {
        let count = self
            .dims
            .iter()
            .try_fold(1u64, |product, &n| product.checked_mul(n.into()))?;
        // Wide numbers may need a second buffer of f32, so stay clear of the address space's end.
        count
            .checked_mul(8)
            .filter(|&bytes| bytes <= isize::MAX as u64)?;
        count.checked_mul(self.number.bytes() as u64)
    }
}

/// Voxels and remarks on what reading them cost.
pub(super) struct Decoded {
    pub voxels: Voxels,
    pub notices: Vec<String>,
    /// Whether values had to be rounded.
    pub rounded: bool,
}

/// Reads voxels into the smallest type that holds them exactly, f32 where none does.
///
/// Peak memory is at most 1.5 × the result, plus a megabyte.
pub(super) fn read_voxels(
    input: &mut Input<'_>,
    layout: &Layout,
    options: &ReadOptions,
    progress: &mut dyn FnMut(Progress),
) -> Result<Decoded, VolumeError> {
    let too_large = |bytes, limit: String| VolumeError::TooLarge {
        path: input.path().into(),
        bytes,
        limit,
    };
    let bytes = layout
        .voxel_bytes()
        .ok_or_else(|| too_large(u64::MAX, "the address space".into()))?;
    if let Some(limit) = options.max_voxel_bytes.filter(|&limit| bytes > limit) {
        return Err(too_large(bytes, format!("the limit of {limit}")));
    }
    if let Some(available) = input.at_most().filter(|&available| available < bytes) {
        return Err(VolumeError::Truncated {
            path: input.path().into(),
            expected: bytes,
            available,
        });
    }
    let mut reading = Reading {
        total: (bytes / layout.number.bytes() as u64) as usize,
        total_bytes: bytes,
        done_bytes: 0,
        told_bytes: 0,
        // What a regular file really holds can be reserved at once.
        reserve_all: input.exact_length().is_some(),
        swap: layout.big_endian != cfg!(target_endian = "big"),
        input,
        progress,
        cancel: &options.cancel,
    };
    let mut notices = Vec::new();
    let voxels = reading.voxels(layout.number, &mut notices);
    // First, since a change may be why it failed.
    input.check_unchanged()?;
    Ok(Decoded {
        voxels: voxels?,
        // The only thing that this function has to tell.
        rounded: !notices.is_empty(),
        notices,
    })
}

/// Reads on after the last voxel, so that a gzip stream's check sum gets compared.
///
/// Returns a notice if the file goes on.
pub(super) fn check_end(input: &mut Input<'_>) -> Result<Option<String>, VolumeError> {
    let mut rest = [0; 4096];
    match input.read(&mut rest) {
        Ok(0) => Ok(None),
        Ok(_) => Ok(Some(
            "the file goes on after its last voxel; what follows is ignored".into(),
        )),
        Err(error) => Err(VolumeError::decoding(input.path(), error)),
    }
}

struct Reading<'a, 'b> {
    input: &'a mut Input<'b>,
    progress: &'a mut dyn FnMut(Progress),
    /// Numbers in all.
    total: usize,
    total_bytes: u64,
    done_bytes: u64,
    told_bytes: u64,
    reserve_all: bool,
    swap: bool,
    cancel: &'a CancelFlag,
}

impl<'b> Reading<'_, 'b> {
    /// All voxels, as they are kept.
    fn voxels(
        &mut self,
        number: NumberType,
        notices: &mut Vec<String>,
    ) -> Result<Voxels, VolumeError> {
        Ok(match number {
            NumberType::U8 => Voxels::U8(self.same_type(|n: u8| n)?),
            NumberType::I8 => Voxels::I8(self.same_type(|n: i8| n)?),
            NumberType::U16 => Voxels::U16(self.same_type(u16::swap_bytes)?),
            NumberType::I16 => Voxels::I16(self.same_type(i16::swap_bytes)?),
            NumberType::U32 => self.narrowed::<u32>(number, notices)?,
            NumberType::I32 => self.narrowed::<i32>(number, notices)?,
            NumberType::U64 => self.narrowed::<u64>(number, notices)?,
            NumberType::I64 => self.narrowed::<i64>(number, notices)?,
            NumberType::F32 => self.narrowed::<f32>(number, notices)?,
            NumberType::F64 => self.narrowed::<f64>(number, notices)?,
        })
    }

    /// Fills a piece of the voxels, in the machine's byte order after `swap_bytes`.
    fn fill<T: Pod>(
        &mut self,
        piece: &mut [T],
        swap_bytes: impl Fn(T) -> T,
    ) -> Result<(), VolumeError> {
        self.check_cancelled()?;
        let mut filled = 0;
        let mut rest: &mut [u8] = bytemuck::cast_slice_mut(piece);
        while !rest.is_empty() {
            match self.input.read(rest) {
                Ok(0) => return Err(self.truncated(filled)),
                Ok(bytes) => {
                    filled += bytes as u64;
                    rest = rest.get_mut(bytes..).unwrap_or_default();
                }
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => {
                    return Err(self.truncated(filled));
                }
                Err(error) => return Err(VolumeError::decoding(self.input.path(), error)),
            }
        }
        if self.swap && size_of::<T>() > 1 {
            for number in piece.iter_mut() {
                *number = swap_bytes(*number);
            }
        }
        self.tell(filled);
        Ok(())
    }

    /// The error where the input ends, `more` bytes after the last ones that were counted.
    fn truncated(&self, more: u64) -> VolumeError {
        VolumeError::Truncated {
            path: self.input.path().into(),
            expected: self.total_bytes,
            available: self.done_bytes + more,
        }
    }

    /// Makes room for `more` numbers: at least doubles, never exceeds the total.
    fn reserve<T>(&self, numbers: &mut Vec<T>, more: usize) -> Result<(), VolumeError> {
        let done = numbers.len();
        if numbers.capacity() - done >= more {
            return Ok(());
        }
        let room = if self.reserve_all {
            self.total - done
        } else {
            more.max(done).min(self.total - done)
        };
        numbers
            .try_reserve_exact(room)
            .map_err(|_: TryReserveError| VolumeError::TooLarge {
                path: self.input.path().into(),
                bytes: self.total_bytes,
                limit: "the memory that is free".into(),
            })
    }

    /// Reads what lies in a file as it is, by all cores: copying out of the system's cache and
    /// touching new memory cost more than one core can do.
    fn same_type_from<T: Pod + Send>(
        &mut self,
        source: &Source<'b>,
        at: u64,
        swap_bytes: impl Fn(T) -> T + Sync,
    ) -> Result<Vec<T>, VolumeError> {
        let mut numbers = bytemuck::allocation::try_zeroed_slice_box::<T>(self.total)
            .map_err(|()| VolumeError::TooLarge {
                path: self.input.path().into(),
                bytes: self.total_bytes,
                limit: "the memory that is free".into(),
            })?
            .into_vec();
        let path = self.input.path().to_path_buf();
        let piece = PROGRESS_BYTES as usize / size_of::<T>();
        let (cancel, swap, total_bytes) = (self.cancel, self.swap, self.total_bytes);
        let mut done_bytes = 0;
        parallel::for_each(
            numbers.chunks_mut(piece).enumerate(),
            |(index, piece)| {
                if cancel.is_cancelled() {
                    return Err(VolumeError::Cancelled { path: path.clone() });
                }
                let bytes: &mut [u8] = bytemuck::cast_slice_mut(piece);
                let offset = index as u64 * PROGRESS_BYTES;
                let read = source
                    .read_at(at + offset, bytes)
                    .map_err(|error| VolumeError::io(&path, error))?;
                if read < bytes.len() {
                    return Err(VolumeError::Truncated {
                        path: path.clone(),
                        expected: total_bytes,
                        available: offset + read as u64,
                    });
                }
                if swap && size_of::<T>() > 1 {
                    for number in piece.iter_mut() {
                        *number = swap_bytes(*number);
                    }
                }
                Ok(read as u64)
            },
            |read| {
                done_bytes += read;
                (self.progress)(Progress {
                    bytes: done_bytes,
                    total_bytes,
                });
                Ok(())
            },
        )?;
        self.input.pass(source, at + total_bytes);
        Ok(numbers)
    }

    fn same_type<T: Pod + Zeroable + Send>(
        &mut self,
        swap_bytes: impl Fn(T) -> T + Sync,
    ) -> Result<Vec<T>, VolumeError> {
        if let Some((source, at)) = self.input.direct()
            && self.total_bytes >= PARALLEL_BYTES_MIN
        {
            return self.same_type_from(&source, at, swap_bytes);
        }
        let mut numbers: Vec<T> = Vec::new();
        while numbers.len() < self.total {
            let done = numbers.len();
            // Straight out of the unpacking thread's buffer, into memory that is touched once.
            let wanted = (self.total - done) * size_of::<T>();
            let there = match self.input.fill_buf() {
                Ok(buffer) => buffer.len().min(wanted) / size_of::<T>(),
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => 0,
                Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => {
                    return Err(self.truncated(0));
                }
                Err(error) => return Err(VolumeError::decoding(self.input.path(), error)),
            };
            if there > 0 {
                self.reserve(&mut numbers, there)?;
                self.append(&mut numbers, there, &swap_bytes)?;
                continue;
            }
            // A number that lies in two buffers, or the end.
            let mut number = [T::zeroed()];
            self.fill(&mut number, &swap_bytes)?;
            self.reserve(&mut numbers, 1)?;
            numbers.extend(number);
        }
        Ok(numbers)
    }

    /// Appends `count` numbers that the input's buffer holds.
    fn append<T: Pod>(
        &mut self,
        numbers: &mut Vec<T>,
        count: usize,
        swap_bytes: impl Fn(T) -> T,
    ) -> Result<(), VolumeError> {
        self.check_cancelled()?;
        let path = self.input.path().to_path_buf();
        let buffer = self
            .input
            .fill_buf()
            .map_err(|error| VolumeError::decoding(&path, error))?;
        let bytes = count * size_of::<T>();
        let bytes = buffer.get(..bytes).unwrap_or_default();
        let done = numbers.len();
        match bytemuck::try_cast_slice(bytes) {
            Ok(aligned) => numbers.extend_from_slice(aligned),
            Err(_) => {
                let each = bytes.chunks_exact(size_of::<T>());
                numbers.extend(each.map(bytemuck::pod_read_unaligned::<T>));
            }
        }
        let bytes = bytes.len();
        self.input.consume(bytes);
        if self.swap && size_of::<T>() > 1 {
            for number in numbers.iter_mut().skip(done) {
                *number = swap_bytes(*number);
            }
        }
        self.tell(bytes as u64);
        Ok(())
    }

    fn check_cancelled(&self) -> Result<(), VolumeError> {
        if self.cancel.is_cancelled() {
            return Err(VolumeError::Cancelled {
                path: self.input.path().into(),
            });
        }
        Ok(())
    }

    /// Counts bytes, and tells the progress now and then.
    fn tell(&mut self, bytes: u64) {
        self.done_bytes += bytes;
        if self.done_bytes - self.told_bytes >= PROGRESS_BYTES
            || self.done_bytes == self.total_bytes
        {
            self.told_bytes = self.done_bytes;
            (self.progress)(Progress {
                bytes: self.done_bytes,
                total_bytes: self.total_bytes,
            });
        }
    }

    fn narrowed<T: WideNumber>(
        &mut self,
        number: NumberType,
        notices: &mut Vec<String>,
    ) -> Result<Voxels, VolumeError> {
        let mut voxels = Voxels::U8(Vec::new());
        let mut integers = (i32::MAX, i32::MIN);
        let (mut rounded, mut largest_error) = (0u64, 0.0f64);
        let mut chunk: Vec<T> = Vec::new();
        while voxels.len() < self.total {
            let piece = (self.total - voxels.len()).min(CHUNK_BYTES / size_of::<T>());
            chunk.resize(piece, T::zeroed());
            self.fill(&mut chunk, T::swapped)?;

            if voxels.kind() != VoxelKind::F32 {
                let range = chunk.iter().try_fold(integers, |(low, high), number| {
                    number.small_integer().map(|n| (low.min(n), high.max(n)))
                });
                let kind = range.map_or(VoxelKind::F32, |(low, high)| smallest_kind(low, high));
                integers = range.unwrap_or(integers);
                if kind != voxels.kind() {
                    voxels = self.widened(&voxels, kind, piece)?;
                }
            }
            let integer = |number: &T| number.small_integer().unwrap_or(0);
            match &mut voxels {
                Voxels::U8(v) => {
                    self.reserve(v, piece)?;
                    v.extend(chunk.iter().map(|n| integer(n) as u8));
                }
                Voxels::I8(v) => {
                    self.reserve(v, piece)?;
                    v.extend(chunk.iter().map(|n| integer(n) as i8));
                }
                Voxels::U16(v) => {
                    self.reserve(v, piece)?;
                    v.extend(chunk.iter().map(|n| integer(n) as u16));
                }
                Voxels::I16(v) => {
                    self.reserve(v, piece)?;
                    v.extend(chunk.iter().map(|n| integer(n) as i16));
                }
                Voxels::F32(v) => {
                    self.reserve(v, piece)?;
                    v.extend(chunk.iter().map(|n| {
                        let (nearest, error) = n.to_f32();
                        rounded += u64::from(error > 0.0);
                        largest_error = largest_error.max(error);
                        nearest
                    }));
                }
            }
        }
        if rounded > 0 {
            notices.push(format!(
                "{} values are kept as f32: {rounded} of {} are rounded, by at most {largest_error:.3e}",
                number.name(),
                self.total
            ));
        }
        Ok(voxels)
    }

    /// The voxels so far in a wider type that holds them exactly, with room for more.
    fn widened(
        &self,
        voxels: &Voxels,
        kind: VoxelKind,
        more: usize,
    ) -> Result<Voxels, VolumeError> {
        macro_rules! widen {
            ($variant:ident, $number:ty) => {{
                let mut wider = Vec::new();
                self.reserve(&mut wider, voxels.len() + more)?;
                match voxels {
                    Voxels::U8(v) => wider.extend(v.iter().map(|&n| n as $number)),
                    Voxels::I8(v) => wider.extend(v.iter().map(|&n| n as $number)),
                    Voxels::U16(v) => wider.extend(v.iter().map(|&n| n as $number)),
                    Voxels::I16(v) => wider.extend(v.iter().map(|&n| n as $number)),
                    Voxels::F32(v) => wider.extend(v.iter().map(|&n| n as $number)),
                }
                Voxels::$variant(wider)
            }};
        }
        Ok(match kind {
            VoxelKind::U8 => widen!(U8, u8),
            VoxelKind::I8 => widen!(I8, i8),
            VoxelKind::U16 => widen!(U16, u16),
            VoxelKind::I16 => widen!(I16, i16),
            VoxelKind::F32 => widen!(F32, f32),
        })
    }
}
