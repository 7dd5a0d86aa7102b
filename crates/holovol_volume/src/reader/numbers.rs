use bytemuck::Pod;

use crate::VoxelKind;

/// The type of the numbers in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NumberType {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
}

impl NumberType {
    pub fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::U8 => "u8",
            Self::I8 => "i8",
            Self::U16 => "u16",
            Self::I16 => "i16",
            Self::U32 => "u32",
            Self::I32 => "i32",
            Self::U64 => "u64",
            Self::I64 => "i64",
            Self::F32 => "f32",
            Self::F64 => "f64",
        }
    }
}

/// A number of 4 or 8 bytes, to be kept in something smaller where that is exact.
pub(super) trait WideNumber: Pod {
    fn swapped(self) -> Self;

    /// The same number, if it is an integer that fits 16 bits, signed or not.
    fn small_integer(self) -> Option<i32>;

    /// The nearest f32 (finite for finite numbers), and how far it is off.
    fn to_f32(self) -> (f32, f64);
}

macro_rules! wide_integer {
    ($($number:ty),*) => {$(
        impl WideNumber for $number {
            fn swapped(self) -> Self {
                self.swap_bytes()
            }

            fn small_integer(self) -> Option<i32> {
                i32::try_from(self).ok().filter(|n| SMALL_INTEGERS.contains(n))
            }

            fn to_f32(self) -> (f32, f64) {
                let rounded = self as f32;
                // i128 holds every rounded 64-bit number exactly.
                (rounded, (rounded as i128 - self as i128).unsigned_abs() as f64)
            }
        }
    )*};
}
wide_integer!(u32, i32, u64, i64);

impl WideNumber for f32 {
    fn swapped(self) -> Self {
        Self::from_bits(self.to_bits().swap_bytes())
    }

    fn small_integer(self) -> Option<i32> {
        // The cast saturates and turns NaN into 0, neither of which survives the comparison.
        let integer = self as i32;
        (integer as f32 == self && SMALL_INTEGERS.contains(&integer)).then_some(integer)
    }

    fn to_f32(self) -> (f32, f64) {
        (self, 0.0)
    }
}

impl WideNumber for f64 {
    fn swapped(self) -> Self {
        Self::from_bits(self.to_bits().swap_bytes())
    }

    fn small_integer(self) -> Option<i32> {
        let integer = self as i32;
        (f64::from(integer) == self && SMALL_INTEGERS.contains(&integer)).then_some(integer)
    }

    fn to_f32(self) -> (f32, f64) {
        if !self.is_finite() {
            return (self as f32, 0.0);
        }
        let rounded = self.clamp(f64::from(f32::MIN), f64::from(f32::MAX)) as f32;
        (rounded, (f64::from(rounded) - self).abs())
    }
}

const SMALL_INTEGERS: std::ops::RangeInclusive<i32> = i16::MIN as i32..=u16::MAX as i32;

/// The smallest type that holds all integers of a range.
pub(super) fn smallest_kind(low: i32, high: i32) -> VoxelKind {
    let fits = |a: i32, b: i32| a <= low && high <= b;
    if fits(0, 255) {
        VoxelKind::U8
    } else if fits(-128, 127) {
        VoxelKind::I8
    } else if fits(0, 65_535) {
        VoxelKind::U16
    } else if fits(-32_768, 32_767) {
        VoxelKind::I16
    } else {
        VoxelKind::F32
    }
}
