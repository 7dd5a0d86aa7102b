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

/// The lowest number that is no padding, and whether there is padding.
#[derive(Clone, Copy)]
pub(super) struct Lowest<T> {
    pub value: Option<T>,
    pub has_padding: bool,
}

impl<T> Default for Lowest<T> {
    fn default() -> Self {
        Self {
            value: None,
            has_padding: false,
        }
    }
}

impl<T: Stored> Lowest<T> {
    pub fn of(chunk: &[T], conversion: &Conversion) -> Self {
        // With a scaling of its own, a slice has NaN for padding.
        let Some(padding) = conversion.padding.filter(|_| conversion.scaling.is_none()) else {
            return Self::default();
        };
        chunk.iter().fold(Self::default(), |lowest, &voxel| {
            lowest.and(if voxel.is_padding(padding) {
                Self {
                    value: None,
                    has_padding: true,
                }
            } else {
                Self {
                    value: Some(voxel),
                    has_padding: false,
                }
            })
        })
    }

    pub fn and(self, other: Self) -> Self {
        Self {
            value: match (self.value, other.value) {
                (Some(a), Some(b)) => Some(if b < a { b } else { a }),
                (a, b) => a.or(b),
            },
            has_padding: self.has_padding || other.has_padding,
        }
    }
}
