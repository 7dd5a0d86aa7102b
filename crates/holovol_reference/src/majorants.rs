//! Upper bounds of the extinction, cell by cell, and the walk of a ray through them.

use std::ops::ControlFlow;

use glam::DVec3;
use rayon::prelude::*;

use crate::field::{Extinction, Field, Stored};

/// Voxels along each side of a cell: a lookup costs this tracer several cell steps, so its cells
/// are finer than the kernels' own.
pub const CELL: usize = 4;

/// Majorants on a grid of cells; cell c covers the texel coordinates [`CELL`]·[c, c+1).
pub struct Majorants {
    dims: [usize; 3],
    /// 1/m, x fastest.
    values: Vec<f64>,
    /// Corners of the cells with any extinction, texel coordinates; `None` if there are none.
    occupied: Option<[DVec3; 2]>,
}

impl Majorants {
    pub fn new<T: Stored>(field: &Field<'_, T>, extinction: &Extinction) -> Self {
        let size = field.dims();
        let dims = size.map(|n| n.div_ceil(CELL));
        // A point of the cell lies between voxels CELL·c − 1 and CELL·(c + 1).
        let span = |c: usize, n: usize| (CELL * c).saturating_sub(1)..=(CELL * (c + 1)).min(n - 1);
        let layers: Vec<Vec<f64>> = (0..dims[2])
            .into_par_iter()
            .map(|cz| {
                let mut layer = Vec::with_capacity(dims[0] * dims[1]);
                for cy in 0..dims[1] {
                    for cx in 0..dims[0] {
                        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
                        for z in span(cz, size[2]) {
                            for y in span(cy, size[1]) {
                                for x in span(cx, size[0]) {
                                    let s = field.voxel([x, y, z]);
                                    low = low.min(s);
                                    high = high.max(s);
                                }
                            }
                        }
                        layer.push(extinction.bound(low, high));
                    }
                }
                layer
            })
            .collect();
        let mut majorants = Self {
            dims,
            values: layers.concat(),
            occupied: None,
        };
        majorants.occupied = majorants.occupied_box(size);
        majorants
    }

    fn occupied_box(&self, size: [usize; 3]) -> Option<[DVec3; 2]> {
        let (mut low, mut high) = ([usize::MAX; 3], [0; 3]);
        for (index, _) in self.values.iter().enumerate().filter(|(_, v)| **v > 0.0) {
            let [nx, ny, _] = self.dims;
            let cell = [index % nx, index / nx % ny, index / (nx * ny)];
            for axis in 0..3 {
                low[axis] = low[axis].min(cell[axis] * CELL);
                high[axis] = high[axis].max(((cell[axis] + 1) * CELL).min(size[axis]));
            }
        }
        let corner = |texel: [usize; 3]| DVec3::from_array(texel.map(|n| n as f64));
        (low[0] != usize::MAX).then(|| [corner(low), corner(high)])
    }

    /// Where a ray is inside the box of occupied cells: t_in ≥ 0 and t_out > t_in.
    fn clip(&self, origin: DVec3, direction: DVec3) -> Option<(f64, f64)> {
        let [low, high] = self.occupied?;
        let (mut t_in, mut t_out) = (0.0f64, f64::INFINITY);
        for axis in 0..3 {
            let (o, d) = (origin[axis], direction[axis]);
            if d == 0.0 {
                if !(o >= low[axis] && o <= high[axis]) {
                    return None;
                }
                continue;
            }
            let (a, b) = ((low[axis] - o) / d, (high[axis] - o) / d);
            t_in = t_in.max(a.min(b));
            t_out = t_out.min(a.max(b));
        }
        (t_in < t_out && t_out.is_finite()).then_some((t_in, t_out))
    }

    /// Calls `visit(point, length, majorant)` for each non-empty cell along a ray, in order:
    /// `point` is where the ray enters it (texel coordinates), `length` the way inside in units of
    /// `direction`'s parameter. Ends early on `Break`.
    #[inline]
    pub fn walk<B>(
        &self,
        origin: DVec3,
        direction: DVec3,
        mut visit: impl FnMut(DVec3, f64, f64) -> ControlFlow<B>,
    ) -> Option<B> {
        let (t_in, t_out) = self.clip(origin, direction)?;
        // From here t counts from the entry, so that far origins cost no digits.
        let origin = origin + direction * t_in;
        let t_out = t_out - t_in;
        let mut cell = [0usize; 3];
        let mut next = [f64::INFINITY; 3];
        let boundary = |cell: usize, axis: usize| {
            let ahead = cell + usize::from(direction[axis] > 0.0);
            ((ahead * CELL) as f64 - origin[axis]) / direction[axis]
        };
        for axis in 0..3 {
            // `as` saturates: a point a rounding error outside is put into the border cell.
            cell[axis] = ((origin[axis] / CELL as f64) as usize).min(self.dims[axis] - 1);
            if direction[axis] != 0.0 {
                next[axis] = boundary(cell[axis], axis);
            }
        }
        let mut t = 0.0;
        loop {
            let axis = if next[0] <= next[1] && next[0] <= next[2] {
                0
            } else if next[1] <= next[2] {
                1
            } else {
                2
            };
            let t_exit = next[axis].min(t_out);
            if t_exit > t {
                let majorant =
                    self.values[cell[0] + self.dims[0] * (cell[1] + self.dims[1] * cell[2])];
                if majorant > 0.0
                    && let ControlFlow::Break(found) =
                        visit(origin + direction * t, t_exit - t, majorant)
                {
                    return Some(found);
                }
                t = t_exit;
            }
            if t >= t_out {
                return None;
            }
            if direction[axis] > 0.0 {
                cell[axis] += 1;
                if cell[axis] == self.dims[axis] {
                    return None;
                }
            } else if cell[axis] == 0 {
                return None;
            } else {
                cell[axis] -= 1;
            }
            next[axis] = boundary(cell[axis], axis);
        }
    }
}
