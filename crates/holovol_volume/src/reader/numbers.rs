use bytemuck::Pod;
use serde::{Deserialize, Serialize};

use crate::VoxelKind;

/// The type of the numbers in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NumberType {
    /// Unsigned, 8 bits.
    U8,
    /// Signed, 8 bits.
    I8,
    /// Unsigned, 16 bits.
    U16,
    /// Signed, 16 bits.
    I16,
    /// Unsigned, 32 bits.
    U32,
    /// Signed, 32 bits.
    I32,
    /// Unsigned, 64 bits.
    U64,
    /// Signed, 64 bits.
    I64,
    /// IEEE float, 32 bits.
    F32,
    /// IEEE float, 64 bits.
    F64,
}

impl NumberType {
    /// Size of one number in bytes.
    pub fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }

    /// The name that Rust and NumPy users know: `u8` to `f64`.
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

impl std::str::FromStr for NumberType {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        Ok(match name.trim().to_lowercase().as_str() {
            "u8" | "uint8" => Self::U8,
            "i8" | "int8" => Self::I8,
            "u16" | "uint16" => Self::U16,
            "i16" | "int16" => Self::I16,
            "u32" | "uint32" => Self::U32,
            "i32" | "int32" => Self::I32,
            "u64" | "uint64" => Self::U64,
            "i64" | "int64" => Self::I64,
            "f32" | "float32" => Self::F32,
            "f64" | "float64" => Self::F64,
            _ => return Err("expected u8, i8, u16, i16, u32, i32, u64, i64, f32 or f64".into()),
        })
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
