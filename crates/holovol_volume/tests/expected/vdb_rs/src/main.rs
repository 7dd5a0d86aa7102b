//! Writes what `vdb-rs` reads of a grid, as f32 in the machine's byte order: three voxel
//! sizes; then x, y, z, side and value of each active tile and voxel.
//!
//! `cargo run --release -- FILE GRID >VALUES`

use std::fs::File;
use std::io::{BufReader, BufWriter, Write};

use vdb_rs::{Map, VdbReader};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let (Some(path), Some(name)) = (arguments.next(), arguments.next()) else {
        return Err("usage: vdb_rs_values FILE GRID".into());
    };
    let mut reader = VdbReader::new(BufReader::new(File::open(path)?))?;
    let grid = reader.read_grid::<f32>(&name)?;
    let voxel_size = match &grid.transform {
        Map::UniformScaleMap { voxel_size, .. } => voxel_size.to_array(),
        other => return Err(format!("another transform: {other:?}").into()),
    };
    let mut out = BufWriter::new(std::io::stdout().lock());
    let mut put = |number: f32| out.write_all(&number.to_ne_bytes());
    for size in voxel_size {
        put(size as f32)?;
    }
    for (place, value, level) in grid.iter() {
        for number in place.to_array().into_iter().chain([level.scale(), value]) {
            put(number)?;
        }
    }
    out.flush()?;
    Ok(())
}
