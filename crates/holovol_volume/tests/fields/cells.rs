use glam::DVec3;
use holovol_volume::{CELL_SIZE, CellRanges, Voxels};

use crate::volume;

/// Rising along every axis, so that a cell's extremes lie on its border, and a little noisy.
fn rough_slope([nx, ny, nz]: [u32; 3]) -> Vec<f32> {
    (0..nx * ny * nz)
        .map(|i| {
            let noise = (i.wrapping_mul(2_654_435_761) >> 8) as f32 / (1 << 24) as f32;
            (i % nx + i / nx % ny + i / nx / ny) as f32 + noise
        })
        .collect()
}

/// The trilinear field may not leave its cell's range, not even on the cell's faces.
#[test]
fn ranges_hold_every_sample() {
    for dims in [
        [19u32, 8, 9],
        [1, 1, 40],
        [17, 16, 1],
        [1, 1, 1],
        [7, 23, 5],
    ] {
        let field = volume(Voxels::F32(rough_slope(dims)), dims, 1.0, 0.0);
        let cells = CellRanges::new(&field);
        assert_eq!(cells.dims, dims.map(|n| n.div_ceil(8)));
        assert_eq!(
            cells.ranges.len(),
            cells.dims.iter().product::<u32>() as usize
        );
        let mut index = 0;
        for cz in 0..cells.dims[2] {
            for cy in 0..cells.dims[1] {
                for cx in 0..cells.dims[0] {
                    let [low, high] = cells.ranges[index].map(f64::from);
                    index += 1;
                    for i in 0..12 * 12 * 12 {
                        let part =
                            [i % 12, i / 12 % 12, i / 144].map(|n| f64::from(n) * 8.0 / 11.0);
                        let texel = DVec3::new(cx.into(), cy.into(), cz.into()) * 8.0
                            + DVec3::from_array(part);
                        let value = field.sample(texel / DVec3::from_array(dims.map(f64::from)));
                        assert!(
                            low - 1e-12 <= value && value <= high + 1e-12,
                            "{texel}: {value}"
                        );
                    }
                }
            }
        }
    }
}

/// And no wider than needed: one bright voxel shows in just those cells whose samples see it.
#[test]
fn ranges_are_tight() {
    let n = 3 * CELL_SIZE;
    for bright in 0..n {
        let mut voxels = vec![0u8; n as usize];
        voxels[bright as usize] = 200;
        for axis in 0..3 {
            let mut dims = [1; 3];
            dims[axis] = n;
            let field = volume(Voxels::U8(voxels.clone()), dims, 0.5, 1.0);
            let cells = CellRanges::new(&field);
            for (cell, &[low, high]) in cells.ranges.iter().enumerate() {
                let seen = (0..=1000).any(|i| {
                    let texel = (cell as f64 + (f64::from(i) / 1000.0).min(1.0 - 1e-9)) * 8.0;
                    let mut at = DVec3::splat(0.5);
                    at[axis] = texel / f64::from(n);
                    field.sample(at) > 1.0
                });
                assert_eq!(high == 200.0, seen, "voxel {bright}, cell {cell}");
                assert_eq!(low, 0.0, "ranges are of stored numbers");
            }
        }
    }
}
