//! What the targets share.

use std::path::Path;

use holovol_volume::{Input, ReadOptions, VolumeReader};

/// Reads bytes as a volume; of any that is sound, everything else has to be sound, too.
pub fn read_volume(reader: &dyn VolumeReader, bytes: &[u8]) {
    // Packed zeros may claim gigabytes truthfully; that is not what is sought here.
    let options = ReadOptions::default().with_max_voxel_bytes(16 << 20);
    let Ok(input) = Input::from_bytes(Path::new("fuzz"), bytes).gunzip_if_packed() else {
        return;
    };
    let Ok(volume) = reader.read(input, &options, &mut |_| {}) else {
        return;
    };
    let voxels: u64 = volume.dims().iter().map(|&n| u64::from(n)).product();
    assert_eq!(voxels, volume.voxels().len() as u64);
    let [low, high] = volume.auto_window();
    assert!(low < high && low.is_finite() && high.is_finite());
    assert!(volume.range().iter().all(|edge| edge.is_finite()));
    let world = volume.world_from_unit_cube();
    assert!(world.is_finite() && world.determinant() != 0.0);
}
