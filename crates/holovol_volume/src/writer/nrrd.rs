use std::io::{self, Write};

use glam::DVec3;

use super::write_stored;
use crate::{Volume, VoxelKind, Voxels};

/// The type of the values, which NRRD holds without a scaling.
enum Values {
    AsStored(&'static str),
    I8,
    U8,
    I16,
    U16,
    I32,
    F64,
}

fn values(volume: &Volume) -> Values {
    if (volume.slope(), volume.intercept()) == (1.0, 0.0) {
        return Values::AsStored(match volume.voxels().kind() {
            VoxelKind::U8 => "uint8",
            VoxelKind::I8 => "int8",
            VoxelKind::U16 => "uint16",
            VoxelKind::I16 => "int16",
            VoxelKind::F32 => "float",
        });
    }
    let is_whole = volume.slope().fract() == 0.0
        && volume.intercept().fract() == 0.0
        && volume.voxels().kind() != VoxelKind::F32;
    let [low, high] = volume.range();
    let fits = |a: f64, b: f64| is_whole && a <= low && high <= b;
    if fits(0.0, 255.0) {
        Values::U8
    } else if fits(-128.0, 127.0) {
        Values::I8
    } else if fits(0.0, 65_535.0) {
        Values::U16
    } else if fits(-32_768.0, 32_767.0) {
        Values::I16
    } else if fits(f64::from(i32::MIN), f64::from(i32::MAX)) {
        Values::I32
    } else {
        Values::F64
    }
}

pub(super) fn write(volume: &Volume, out: &mut dyn Write) -> io::Result<()> {
    let values = values(volume);
    let kind = match values {
        Values::AsStored(name) => name,
        Values::I8 => "int8",
        Values::U8 => "uint8",
        Values::I16 => "int16",
        Values::U16 => "uint16",
        Values::I32 => "int32",
        Values::F64 => "double",
    };
    let [nx, ny, nz] = volume.dims();
    let geometry = volume.geometry();
    let vector = |v: DVec3| format!("({},{},{})", v.x, v.y, v.z);
    let mm = geometry.metres_from_index * 1e3;
    let space = if geometry.oriented {
        "right-anterior-superior"
    } else {
        "3D-right-handed"
    };
    writeln!(out, "NRRD0004")?;
    writeln!(out, "type: {kind}")?;
    writeln!(out, "dimension: 3")?;
    writeln!(out, "sizes: {nx} {ny} {nz}")?;
    writeln!(out, "space: {space}")?;
    writeln!(
        out,
        "space directions: {} {} {}",
        vector(mm.x_axis),
        vector(mm.y_axis),
        vector(mm.z_axis)
    )?;
    writeln!(out, "space origin: {}", vector(geometry.origin * 1e3))?;
    writeln!(out, "space units: \"mm\" \"mm\" \"mm\"")?;
    writeln!(out, "kinds: domain domain domain")?;
    if let Some(unit) = volume.unit() {
        writeln!(out, "sample units: {unit}")?;
    }
    writeln!(out, "endian: little")?;
    writeln!(out, "encoding: raw")?;
    for (number, label) in volume.labels().unwrap_or_default().iter().enumerate() {
        let name: String = label.name.chars().filter(|c| !c.is_control()).collect();
        writeln!(out, "Segment{number}_ID:=Segment_{number}")?;
        writeln!(out, "Segment{number}_Name:={name}")?;
        writeln!(out, "Segment{number}_LabelValue:={}", label.value)?;
        if let Some([r, g, b]) = label.color {
            writeln!(out, "Segment{number}_Color:={r} {g} {b}")?;
        }
    }
    writeln!(out)?;
    // The integers are exact: they were checked to fit.
    match values {
        Values::AsStored(_) => write_stored(volume.voxels(), out),
        Values::U8 => each(volume, |v| (v as u8).to_le_bytes(), out),
        Values::I8 => each(volume, |v| (v as i8).to_le_bytes(), out),
        Values::U16 => each(volume, |v| (v as u16).to_le_bytes(), out),
        Values::I16 => each(volume, |v| (v as i16).to_le_bytes(), out),
        Values::I32 => each(volume, |v| (v as i32).to_le_bytes(), out),
        Values::F64 => each(volume, f64::to_le_bytes, out),
    }
}

/// Writes values after scaling.
fn each<const N: usize>(
    volume: &Volume,
    bytes: impl Fn(f64) -> [u8; N],
    out: &mut dyn Write,
) -> io::Result<()> {
    let voxels: &Voxels = volume.voxels();
    for index in 0..voxels.len() {
        let value = volume.slope() * voxels.stored(index) + volume.intercept();
        out.write_all(&bytes(value))?;
    }
    out.flush()
}
