use std::io::{self, Write};

use super::write_stored;
use crate::{Volume, VoxelKind};

/// Beyond this NIfTI-1 has no dimension.
const DIM_MAX_ONE: u32 = i16::MAX as u32;

/// A length that went through metres and back may be off by this part.
const ROUND_TRIP: f64 = 1e-12;

const CODE_MM: u8 = 2;
const CODE_SCANNER: i16 = 1;
const INTENT_LABEL: i16 = 1002;

/// Header and the four bytes after it, in the older version where that is exact.
pub(super) fn header(volume: &Volume) -> Result<Vec<u8>, &'static str> {
    let geometry = volume.geometry();
    if !geometry.oriented && !geometry.is_diagonal() {
        return Err("the format can't hold directions without a patient");
    }
    let mm = geometry.metres_from_index * 1e3;
    let origin = geometry.origin * 1e3;
    let spacing = geometry.spacing().map(|length| length * 1e3);
    let rows: [[f64; 4]; 3] =
        std::array::from_fn(|row| [mm.x_axis[row], mm.y_axis[row], mm.z_axis[row], origin[row]]);
    let short = |number: f64| {
        let near = f64::from(number as f32);
        (near - number).abs() <= ROUND_TRIP * number.abs()
    };
    let exact = |number: f64| f64::from(number as f32) == number;
    let placed = if geometry.oriented {
        rows.as_flattened().iter().copied().all(short)
    } else {
        spacing.into_iter().all(short)
    };
    let is_one = placed
        && exact(volume.slope())
        && exact(volume.intercept())
        && volume.dims().iter().all(|&n| n <= DIM_MAX_ONE);
    let datatype: i16 = match volume.voxels().kind() {
        VoxelKind::U8 => 2,
        VoxelKind::I8 => 256,
        VoxelKind::I16 => 4,
        VoxelKind::U16 => 512,
        VoxelKind::F32 => 16,
    };
    let bits = 8 * volume.voxels().kind().bytes() as i16;
    let sform = if geometry.oriented { CODE_SCANNER } else { 0 };
    let intent = if volume.labels().is_some() {
        INTENT_LABEL
    } else {
        0
    };
    let dims = volume.dims();

    let mut bytes = Bytes(vec![0; if is_one { 352 } else { 544 }]);
    if is_one {
        bytes.put(0, &348i32.to_le_bytes());
        bytes.put(40, &3i16.to_le_bytes());
        for (axis, dim) in dims.into_iter().chain([1; 4]).enumerate() {
            bytes.put(42 + 2 * axis, &(dim as i16).to_le_bytes());
        }
        bytes.put(68, &intent.to_le_bytes());
        bytes.put(70, &datatype.to_le_bytes());
        bytes.put(72, &bits.to_le_bytes());
        bytes.put(76, &1f32.to_le_bytes());
        for (axis, length) in spacing.into_iter().enumerate() {
            bytes.put(80 + 4 * axis, &(length as f32).to_le_bytes());
        }
        bytes.put(108, &352f32.to_le_bytes());
        bytes.put(112, &(volume.slope() as f32).to_le_bytes());
        bytes.put(116, &(volume.intercept() as f32).to_le_bytes());
        bytes.put(123, &[CODE_MM]);
        bytes.put(254, &sform.to_le_bytes());
        for (index, number) in rows.as_flattened().iter().enumerate() {
            bytes.put(280 + 4 * index, &(*number as f32).to_le_bytes());
        }
        bytes.put(344, b"n+1\0");
    } else {
        bytes.put(0, &540i32.to_le_bytes());
        bytes.put(4, b"n+2\0\r\n\x1a\n");
        bytes.put(12, &datatype.to_le_bytes());
        bytes.put(14, &bits.to_le_bytes());
        bytes.put(16, &3i64.to_le_bytes());
        for (axis, dim) in dims.into_iter().chain([1; 4]).enumerate() {
            bytes.put(24 + 8 * axis, &i64::from(dim).to_le_bytes());
        }
        bytes.put(104, &1f64.to_le_bytes());
        for (axis, length) in spacing.into_iter().enumerate() {
            bytes.put(112 + 8 * axis, &length.to_le_bytes());
        }
        bytes.put(168, &544i64.to_le_bytes());
        bytes.put(176, &volume.slope().to_le_bytes());
        bytes.put(184, &volume.intercept().to_le_bytes());
        bytes.put(348, &i32::from(sform).to_le_bytes());
        for (index, number) in rows.as_flattened().iter().enumerate() {
            bytes.put(400 + 8 * index, &number.to_le_bytes());
        }
        bytes.put(500, &i32::from(CODE_MM).to_le_bytes());
        bytes.put(504, &i32::from(intent).to_le_bytes());
    }
    Ok(bytes.0)
}

struct Bytes(Vec<u8>);

impl Bytes {
    fn put(&mut self, at: usize, bytes: &[u8]) {
        if let Some(place) = self.0.get_mut(at..at + bytes.len()) {
            place.copy_from_slice(bytes);
        }
    }
}

pub(super) fn write(header: &[u8], volume: &Volume, out: &mut dyn Write) -> io::Result<()> {
    out.write_all(header)?;
    write_stored(volume.voxels(), out)
}
