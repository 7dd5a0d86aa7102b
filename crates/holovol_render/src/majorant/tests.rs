use holovol_volume::{CellRanges, Geometry, TransferFunction, TransferPoint, Volume, Voxels};

use super::cpu::{Majorants, cell_ranges};
use super::*;
use crate::shader::tests::assert_same_layout;
use crate::shared::random::{pcg3d, unit_float};

#[test]
fn params_lie_in_memory_as_the_kernel_reads_them() {
    for slices in [0, 1] {
        let defs = vec![("CELL_SIZE", 8), ("SLICES", slices)];
        assert_same_layout!(&MAJORANT, &defs, "Params", Params { dims, cells, field });
    }
}

fn random(i: u32, stream: u32) -> f32 {
    unit_float(pcg3d([i, stream, 0x6a09_e667])[0])
}

/// Every run of 2^k values, cut at the end.
#[test]
fn range_maximum_table_is_brute_force() {
    for count in [1usize, 2, 3, 7, 8, 9, 31, 100] {
        let values: Vec<_> = (0..count as u32).map(|i| random(i, count as u32)).collect();
        let table = range_maximum_table(&values);
        assert_eq!(table.len(), count * (1 + count.ilog2() as usize));
        for (row, row_values) in table.chunks(count).enumerate() {
            for (i, &found) in row_values.iter().enumerate() {
                let run = &values[i..(i + (1 << row)).min(count)];
                let expected = run.iter().copied().fold(f32::MIN, f32::max);
                assert_eq!(found, expected, "{count} values, row {row}, entry {i}");
            }
        }
    }
}

fn volume(dims: [u32; 3], stream: u32) -> Volume {
    let count = dims.iter().product::<u32>();
    let voxels = (0..count).map(|i| random(i, stream)).collect();
    Volume::new(
        Voxels::F32(voxels),
        dims,
        1.0,
        0.0,
        Geometry::from_spacing([1e-3; 3]),
    )
    .unwrap()
}

#[test]
fn ranges_are_those_of_the_volume_crate() {
    for (stream, dims) in [[1, 1, 1], [1, 1, 19], [8, 9, 7], [17, 5, 23], [16, 16, 16]]
        .iter()
        .enumerate()
    {
        let volume = volume(*dims, stream as u32);
        let Voxels::F32(texels) = volume.voxels() else {
            unreachable!()
        };
        let expected = CellRanges::new(&volume);
        assert_eq!(cell_ranges(texels, *dims, 8), expected.ranges, "{dims:?}");
    }
}

/// A sorted transfer function of `count` points with steps and repeated points.
fn transfer_function(count: u32, stream: u32) -> TransferFunction {
    let mut s: Vec<_> = (0..count)
        .map(|i| (f64::from(random(i, stream)) * 12.0).round() / 8.0 - 0.25)
        .collect();
    s.sort_by(f64::total_cmp);
    let points = s.iter().zip(0..).map(|(&s, i)| TransferPoint {
        s,
        sigma_t: 100.0 * f64::from(random(i, stream + 1000) - 0.4).max(0.0),
        albedo: [1.0; 3],
        emission: [0.0; 3],
        roughness: 0.5,
        specular: 0.0,
    });
    TransferFunction::new(points.collect()).unwrap()
}

/// No value between a cell's extremes has a larger extinction than its majorant, which is no
/// larger than it needs to be.
#[test]
fn majorants_bound_their_cells_tightly() {
    let dims = [17, 9, 12];
    for stream in 0..24 {
        let volume = volume(dims, stream);
        let Voxels::F32(texels) = volume.voxels() else {
            unreachable!()
        };
        let ranges = cell_ranges(texels, dims, 8);
        let count = [1, 2, 3, 5, 40, 1000][stream as usize % 6];
        let function = transfer_function(count, stream);
        let window = if stream % 2 == 0 {
            [0.0, 1.0]
        } else {
            [1.0, -1.0]
        };
        let majorants = Majorants::new(&ranges, dims, 8, &function, window);
        for (range, &sigma_maj) in ranges.iter().zip(&majorants.sigma_maj) {
            let [a, b] = range.map(|texel| f64::from((texel - window[0]) * window[1]));
            let (low, high) = (a.min(b), a.max(b));
            let exact = function.max_sigma_t(low, high);
            assert!(f64::from(sigma_maj) >= exact, "{sigma_maj} under {exact}");
            let wider = function.max_sigma_t(low - 2e-6, high + 2e-6);
            assert!(
                f64::from(sigma_maj) <= 1.0001 * wider,
                "{sigma_maj} over {wider}"
            );
        }
    }
}

/// Air at the foot of a ramp is skipped, not walked through with a majorant of next to nothing.
#[test]
fn constant_cells_at_the_foot_of_a_ramp_are_empty() {
    let mut points = transfer_function(1, 0).points().to_vec();
    points[0] = TransferPoint {
        s: 0.3,
        sigma_t: 0.0,
        ..points[0]
    };
    points.push(TransferPoint {
        s: 0.7,
        sigma_t: 50.0,
        ..points[0]
    });
    let function = TransferFunction::new(points).unwrap();
    let ranges = [[0.3, 0.3], [0.1, 0.2], [0.3, 0.31]];
    let majorants = Majorants::new(&ranges, [24, 8, 8], 8, &function, [0.0, 1.0]);
    assert_eq!(majorants.sigma_maj[..2], [0.0, 0.0]);
    assert!(majorants.sigma_maj[2] > 0.0);
    assert_eq!(
        majorants.occupied,
        [glam::ivec3(2, 0, 0), glam::ivec3(3, 1, 1)]
    );
}
