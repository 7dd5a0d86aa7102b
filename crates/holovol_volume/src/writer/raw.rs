use std::io::{self, Write};
use std::path::Path;

use super::write_stored;
use crate::{NumberType, RawLayout, Volume, VoxelKind};

pub(super) fn write(volume: &Volume, path: &Path, out: &mut dyn Write) -> io::Result<()> {
    let number = match volume.voxels().kind() {
        VoxelKind::U8 => NumberType::U8,
        VoxelKind::I8 => NumberType::I8,
        VoxelKind::U16 => NumberType::U16,
        VoxelKind::I16 => NumberType::I16,
        VoxelKind::F32 => NumberType::F32,
    };
    let mut layout = RawLayout::new(volume.dims(), number);
    let geometry = volume.geometry();
    let mm = geometry.metres_from_index * 1e3;
    layout.slope = volume.slope();
    layout.intercept = volume.intercept();
    if geometry.oriented {
        layout.directions_ras_mm = Some(mm.to_cols_array_2d());
        layout.origin_ras_mm = Some((geometry.origin * 1e3).to_array());
    } else if geometry.is_diagonal() {
        layout.spacing_mm = Some([mm.x_axis.x, mm.y_axis.y, mm.z_axis.z]);
    } else {
        layout.directions_world_mm = Some(mm.to_cols_array_2d());
    }
    let sidecar = serde_json::to_string_pretty(&layout).map_err(io::Error::other)?;
    std::fs::write(RawLayout::sidecar_path(path), sidecar + "\n")?;
    write_stored(volume.voxels(), out)
}
