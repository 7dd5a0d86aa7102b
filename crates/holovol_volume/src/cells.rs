use crate::Volume;

/// Voxels along each side of a cell of the majorant grid.
pub const CELL_SIZE: u32 = 8;

/// Smallest and largest stored number that trilinear interpolation can meet in each 8³ cell.
///
/// Cell c covers the texel coordinates [8c, 8c+8) per axis, in which voxel i spans [i, i+1), so
/// its lookups touch voxels 8c−1 … 8c+8, clamped to the volume.
#[derive(Clone, Debug, PartialEq)]
pub struct CellRanges {
    /// Cells along x, y, z.
    pub dims: [u32; 3],
    /// Minimum and maximum per cell, x fastest.
    pub ranges: Vec<[f32; 2]>,
}

impl CellRanges {
    /// Cells needed for a volume of these dimensions.
    pub fn dims_for(volume_dims: [u32; 3]) -> [u32; 3] {
        volume_dims.map(|n| n.div_ceil(CELL_SIZE))
    }

    /// The plain version of what the GPU computes.
    pub fn new(volume: &Volume) -> Self {
        let dims = Self::dims_for(volume.dims());
        let [nx, ny, _] = volume.dims().map(|n| n as usize);
        let mut ranges = Vec::with_capacity(dims.iter().map(|&n| n as usize).product());
        for cz in 0..dims[2] {
            for cy in 0..dims[1] {
                for cx in 0..dims[0] {
                    let cell = [cx, cy, cz];
                    let span: [std::ops::RangeInclusive<usize>; 3] = std::array::from_fn(|axis| {
                        let start = cell[axis] * CELL_SIZE;
                        let last = (start + CELL_SIZE).min(volume.dims()[axis] - 1);
                        start.saturating_sub(1) as usize..=last as usize
                    });
                    let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
                    for z in span[2].clone() {
                        for y in span[1].clone() {
                            for x in span[0].clone() {
                                let stored = volume.voxels().stored(x + nx * (y + ny * z)) as f32;
                                low = low.min(stored);
                                high = high.max(stored);
                            }
                        }
                    }
                    ranges.push([low, high]);
                }
            }
        }
        Self { dims, ranges }
    }
}
