//! Twin of `majorant.wgsl`.

use glam::{IVec3, UVec3, Vec3};
use holovol_volume::TransferFunction;

use super::range_maximum_table;

const RANGE_MARGIN: f32 = 1e-6;
const MAJORANT_MARGIN: f32 = 1.000_001;
const SEGMENT_MARGIN: f32 = 9.5e-7;

/// Majorants of all cells, x fastest.
#[derive(Clone, Debug)]
pub struct Majorants {
    /// Voxels along a cell's side.
    pub cell_size: u32,
    /// Texel coordinates at which the unit cube ends.
    pub extent: Vec3,
    /// Cells along x, y, z.
    pub cells: UVec3,
    /// 1/m.
    pub sigma_maj: Vec<f32>,
    /// Lowest occupied cell, and one past the highest; `i32::MAX` and 0 if none is.
    pub occupied: [IVec3; 2],
}

/// Smallest and largest texel that interpolation can meet in each cell, x fastest.
pub fn cell_ranges(texels: &[f32], dims: [u32; 3], cell_size: u32) -> Vec<[f32; 2]> {
    let cells = dims.map(|n| n.div_ceil(cell_size));
    let span = |axis: usize, cell: u32| {
        let start = cell * cell_size;
        start.saturating_sub(1)..=(start + cell_size).min(dims[axis] - 1)
    };
    let mut ranges = Vec::new();
    for cz in 0..cells[2] {
        for cy in 0..cells[1] {
            for cx in 0..cells[0] {
                let mut range = [f32::INFINITY, f32::NEG_INFINITY];
                for z in span(2, cz) {
                    for y in span(1, cy) {
                        for x in span(0, cx) {
                            let texel = texels[(x + dims[0] * (y + dims[1] * z)) as usize];
                            range = [range[0].min(texel), range[1].max(texel)];
                        }
                    }
                }
                ranges.push(range);
            }
        }
    }
    ranges
}

/// A transfer function's points as the kernel searches them.
struct Points {
    points: Vec<[f32; 2]>,
    table: Vec<f32>,
}

impl Points {
    /// sigma_t at s, and the larger end of the segment that s lies within, 0 at a point.
    fn sigma_t(&self, s: f32) -> [f32; 2] {
        let after = self.points.partition_point(|point| point[0] <= s);
        let low = self.points[after.max(1) - 1];
        let high = self.points[after.min(self.points.len() - 1)];
        let t = if high[0] > low[0] {
            ((s - low[0]) / (high[0] - low[0])).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let larger = if t > 0.0 { low[1].max(high[1]) } else { 0.0 };
        [low[1] + (high[1] - low[1]) * t, larger]
    }

    fn bound(&self, low: f32, high: f32) -> f32 {
        let (a, b) = (self.sigma_t(low), self.sigma_t(high));
        let margin = SEGMENT_MARGIN * a[1].max(b[1]);
        MAJORANT_MARGIN * self.largest(low, high, a[0].max(b[0])) + margin
    }

    fn largest(&self, low: f32, high: f32, ends: f32) -> f32 {
        let first = self.points.partition_point(|point| point[0] < low);
        let end = self.points.partition_point(|point| point[0] <= high);
        if end <= first {
            return ends;
        }
        let k = (end - first).ilog2() as usize;
        let row = &self.table[k * self.points.len()..];
        ends.max(row[first]).max(row[end - (1 << k)])
    }
}

impl Majorants {
    /// Of cells with these ranges, on s = (texel − x) · y.
    pub fn new(
        ranges: &[[f32; 2]],
        texels: [u32; 3],
        cell_size: u32,
        transfer_function: &TransferFunction,
        [zero, scale]: [f32; 2],
    ) -> Self {
        let points: Vec<_> = transfer_function
            .points()
            .iter()
            .map(|point| [point.s as f32, point.sigma_t as f32])
            .collect();
        let sigma_t: Vec<_> = points.iter().map(|point| point[1]).collect();
        let points = Points {
            points,
            table: range_maximum_table(&sigma_t),
        };
        let sigma_maj: Vec<_> = ranges
            .iter()
            .map(|range| {
                let [a, b] = range.map(|texel| (texel - zero) * scale);
                let (low, high) = (a.min(b), a.max(b));
                let size = low.abs().max(high.abs()).max(1.0);
                let margin = if low == high {
                    0.0
                } else {
                    RANGE_MARGIN * size
                };
                points.bound(low - margin, high + margin)
            })
            .collect();
        let cells = UVec3::from_array(texels.map(|n| n.div_ceil(cell_size)));
        let place = |i: usize| {
            let (i, nx, ny) = (i as u32, cells.x, cells.y);
            UVec3::new(i % nx, i / nx % ny, i / (nx * ny)).as_ivec3()
        };
        let taken = |&i: &usize| sigma_maj[i] > 0.0;
        let taken = (0..sigma_maj.len()).filter(taken).map(place);
        let occupied = taken.fold([IVec3::MAX, IVec3::ZERO], |[low, high], cell| {
            [low.min(cell), high.max(cell + 1)]
        });
        Self {
            cell_size,
            extent: UVec3::from_array(texels).as_vec3(),
            cells,
            sigma_maj,
            occupied,
        }
    }

    /// Majorant of a cell, 1/m.
    pub fn at(&self, cell: IVec3) -> f32 {
        let cell = cell.as_uvec3();
        self.sigma_maj[(cell.x + self.cells.x * (cell.y + self.cells.y * cell.z)) as usize]
    }
}
