//! What volumes and transfer functions say of themselves, against plain computations.

mod cells;
mod statistics;
mod transfer_function;

use holovol_volume::{Geometry, Volume, Voxels};

fn volume(voxels: Voxels, dims: [u32; 3], slope: f64, intercept: f64) -> Volume {
    let geometry = Geometry::from_spacing([1e-3; 3]);
    Volume::new(voxels, dims, slope, intercept, geometry).unwrap_or_else(|error| panic!("{error}"))
}

/// A row of voxels.
fn row(voxels: Voxels, slope: f64, intercept: f64) -> Volume {
    let length = voxels.len() as u32;
    volume(voxels, [length, 1, 1], slope, intercept)
}
