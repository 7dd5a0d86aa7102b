//! From stored numbers to voxels.

use bytemuck::Pod;

use super::header::Pixels;

/// A type that frames are kept in.
pub(super) trait Stored: Pod + PartialOrd + Send + Sync {
    /// From the low bits of a masked number; sign extension is done.
    fn from_stored(number: i64) -> Self;

    /// From a number with its slice's own scaling.
    fn from_scaled(number: f64) -> Self;

    fn to_f64(self) -> f64;

    /// What takes the place of padding for now.
    fn is_padding(self, padding: [i64; 2]) -> bool;
}

macro_rules! stored {
    ($($number:ty),*) => {$(
        impl Stored for $number {
            fn from_stored(number: i64) -> Self {
                number as Self
            }

            fn from_scaled(number: f64) -> Self {
                number as Self
            }

            fn to_f64(self) -> f64 {
                f64::from(self)
            }

            fn is_padding(self, [first, last]: [i64; 2]) -> bool {
                let number = f64::from(self);
                first as f64 <= number && number <= last as f64
            }
        }
    )*};
}
stored!(u8, i8, u16, i16, f32);

/// How a slice's numbers become voxels.
pub(super) struct Conversion {
    pub pixels: Pixels,
    /// The slice's own slope and intercept, if slices differ.
    pub scaling: Option<(f64, f64)>,
    pub padding: Option<[i64; 2]>,
}

#[derive(Clone, Copy)]
pub(super) enum StoredKind {
    U8,
    I8,
    U16,
    I16,
    F32,
}

impl StoredKind {
    pub fn of(pixels: &Pixels, same_scaling: bool) -> Self {
        match (pixels.bits_allocated, pixels.signed) {
            _ if pixels.float || !same_scaling => Self::F32,
            (8, false) => Self::U8,
            (8, true) => Self::I8,
            (16, false) => Self::U16,
            (16, true) => Self::I16,
            _ => Self::F32,
        }
    }

    pub fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::F32 => 4,
        }
    }
}

impl Conversion {
    /// Whether voxels are the file's bytes as they are.
    pub fn is_copy<T: Stored>(&self, big_endian: bool) -> bool {
        let same_order =
            self.pixels.bits_allocated == 8 || big_endian == cfg!(target_endian = "big");
        let whole = self.pixels.bits_stored == self.pixels.bits_allocated;
        let same_type = size_of::<T>() == usize::from(self.pixels.bits_allocated / 8)
            && (size_of::<T>() < 4 || self.pixels.float);
        same_order && same_type && self.scaling.is_none() && (whole || self.pixels.float)
    }

    /// The stored number: bits beyond it taken off, its sign extended.
    pub fn number(&self, bits: u32) -> i64 {
        let stored = u32::from(self.pixels.bits_stored).clamp(1, 32);
        let low_bit = (u32::from(self.pixels.high_bit) + 1).saturating_sub(stored);
        let number = i64::from(bits >> low_bit.min(31)) & ((1i64 << stored) - 1);
        if self.pixels.signed {
            number << (64 - stored) >> (64 - stored)
        } else {
            number
        }
    }

    pub fn is_padding(&self, number: i64) -> bool {
        self.padding
            .is_some_and(|[first, last]| (first..=last).contains(&number))
    }
}

/// The ends of the stored numbers that are no padding, and how many are padding.
#[derive(Clone, Copy)]
pub(super) struct Extremes<T> {
    pub ends: Option<[T; 2]>,
    pub padding: u64,
}

impl<T> Default for Extremes<T> {
    fn default() -> Self {
        Self {
            ends: None,
            padding: 0,
        }
    }
}

impl<T: Stored> Extremes<T> {
    pub fn of(chunk: &[T], conversion: &Conversion) -> Self {
        let Some(padding) = conversion.padding else {
            return Self::default();
        };
        if conversion.scaling.is_some() {
            // With a scaling of its own, a slice of integers has NaN for padding.
            let is_padding = |voxel: &&T| !conversion.pixels.float && voxel.to_f64().is_nan();
            return Self {
                ends: None,
                padding: chunk.iter().filter(is_padding).count() as u64,
            };
        }
        chunk.iter().fold(Self::default(), |extremes, &voxel| {
            extremes.and(if voxel.is_padding(padding) {
                Self {
                    ends: None,
                    padding: 1,
                }
            } else {
                Self {
                    ends: Some([voxel; 2]),
                    padding: 0,
                }
            })
        })
    }

    pub fn and(self, other: Self) -> Self {
        let ends = match (self.ends, other.ends) {
            (Some([low, high]), Some([low_too, high_too])) => Some([
                if low_too < low { low_too } else { low },
                if high_too > high { high_too } else { high },
            ]),
            (ends, others) => ends.or(others),
        };
        Self {
            ends,
            padding: self.padding + other.padding,
        }
    }
}
