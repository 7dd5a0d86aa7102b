//! Measures how fast volumes are read, against reading (and unpacking) their bytes alone.
//!
//! `cargo run --release -p holovol_volume --example read_speed -- FILE_OR_FOLDER…`
//!
//! For each: seconds and megabytes of voxels per second, the best of some runs with a warm cache;
//! likewise for the bytes alone (`cat` into memory; for gzip, flate2 over them), and the ratio.
//!
//! With `-` in place of files, reads the volume that each line of the standard input names, once,
//! and prints its seconds: `tests/expected/speed.py` takes turns with others' work so.

use std::io::Read;
use std::path::{Path, PathBuf};
use std::time::Instant;

const RUNS: usize = 7;

fn best(mut run: impl FnMut() -> usize) -> (f64, usize) {
    let mut best = f64::INFINITY;
    let mut size = 0;
    for _ in 0..RUNS {
        let start = Instant::now();
        size = run();
        best = best.min(start.elapsed().as_secs_f64());
    }
    (best, size)
}

/// The files that hold the bytes: those of a folder, or the data file of a detached header.
fn files(path: &Path) -> Vec<PathBuf> {
    if let Ok(entries) = std::fs::read_dir(path) {
        return entries.flatten().map(|entry| entry.path()).collect();
    }
    let raw = path.with_extension("raw");
    let detached = path
        .extension()
        .is_some_and(|end| end == "mhd" || end == "nhdr");
    vec![if detached { raw } else { path.into() }]
}

fn bytes_alone(files: &[PathBuf]) -> usize {
    let mut size = 0;
    for path in files {
        let packed = std::fs::read(path).unwrap_or_default();
        size += if packed.starts_with(&[0x1f, 0x8b]) {
            let mut unpacked = Vec::new();
            let mut decoder = flate2::read::GzDecoder::new(packed.as_slice());
            decoder.read_to_end(&mut unpacked).unwrap_or_default()
        } else {
            packed.len()
        };
    }
    size
}

/// Reads what the lines of the standard input name.
fn serve() -> std::io::Result<()> {
    for line in std::io::stdin().lines() {
        let path = PathBuf::from(line?);
        let start = Instant::now();
        let volume = holovol_volume::open(&path, &mut |_| {}).map_err(std::io::Error::other)?;
        println!("{:.6}", start.elapsed().as_secs_f64());
        drop(volume);
    }
    Ok(())
}

fn main() -> std::io::Result<()> {
    if std::env::args_os().nth(1).is_some_and(|name| name == "-") {
        return serve();
    }
    println!(
        "{:>10} {:>8} {:>10} {:>8} {:>6}",
        "read, s", "MB/s", "bytes, s", "MB/s", "ratio"
    );
    for path in std::env::args_os().skip(1).map(PathBuf::from) {
        let files = files(&path);
        let (alone, size) = best(|| bytes_alone(&files));
        let (seconds, voxels) = best(|| match holovol_volume::open(&path, &mut |_| {}) {
            Ok(volume) => volume.voxels().len() * volume.voxels().kind().bytes(),
            Err(error) => {
                eprintln!("{error}");
                0
            }
        });
        let rate = |size: usize, seconds: f64| size as f64 / 1e6 / seconds;
        println!(
            "{seconds:>10.4} {:>8.0} {alone:>10.4} {:>8.0} {:>6.2}  {}",
            rate(voxels, seconds),
            rate(size, alone),
            alone / seconds,
            path.display()
        );
    }
    Ok(())
}
