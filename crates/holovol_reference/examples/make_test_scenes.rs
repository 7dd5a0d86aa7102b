//! Makes what the scene files in `tests/scenes` need, and renders their references.
//!
//! `cargo run --release -p holovol_reference --example make_test_scenes -- tests/scenes 4096 [SCENE…]`

use std::error::Error;
use std::f64::consts::TAU;
use std::fs;
use std::io::Write;
use std::ops::ControlFlow;
use std::path::Path;

use glam::DVec3;
use holovol_reference::{Image, ReferenceInfo, Settings, measures, render};

type Outcome<T = ()> = Result<T, Box<dyn Error>>;

fn main() -> Outcome {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, spp, only @ ..] = arguments.as_slice() else {
        return Err("usage: make_test_scenes FOLDER SPP [SCENE…]".into());
    };
    let (folder, spp) = (Path::new(folder), spp.parse()?);
    make_volumes(folder)?;
    room().write_exr(&folder.join("room.exr"))?;
    for entry in folder.read_dir()? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let stem = name.strip_suffix(".json").filter(|s| !s.ends_with(".ref"));
        if stem.is_some_and(|stem| only.is_empty() || only.iter().any(|scene| scene == stem)) {
            make_reference(&path, spp)?;
        }
    }
    Ok(())
}

fn make_reference(path: &Path, spp: u32) -> Outcome {
    let scene = holovol_scene::load(path, &mut |_| {})?;
    let settings = Settings {
        spp,
        // Tests use small seeds: their noise must not be the reference's own.
        seed: 0x5eed_0f0a_c1e5,
        ..Default::default()
    };
    let film = render(&scene, &settings, &mut |_| ControlFlow::Continue(()))?;
    let image = film.image();
    let [r, g, b, opacity] = measures::mean(&image);
    let info = ReferenceInfo {
        spp: spp.into(),
        error_floor_relmse: measures::expected_relmse(&film),
        relmse: "mean over pixels and channels of (a-b)^2 / (b^2 + 0.01)".into(),
        mean_rgb: [r, g, b],
        mean_opacity: opacity,
    };
    image.write_exr(&path.with_extension("ref.exr"))?;
    let text = serde_json::to_string_pretty(&info)? + "\n";
    fs::write(path.with_extension("ref.json"), text)?;
    println!("{}: {info:?}", path.display());
    Ok(())
}

/// A dim room with a window, a lamp, and the sun in one texel, brighter than f16 can hold.
fn room() -> Image {
    let (width, height) = (32u32, 16u32);
    let pixels = (0..width * height).map(|i| {
        let (x, y) = (i % width, i / width);
        let [r, g, b] = match (x, y) {
            (22, 4) => [90_000.0, 80_000.0, 65_000.0],
            (4..8, 5..9) => [2500.0, 3000.0, 3600.0],
            (14..16, 2) => [6000.0, 4500.0, 2500.0],
            (_, 0..8) => [180.0 + 10.0 * y as f32, 200.0, 240.0],
            _ => [110.0, 90.0 + 3.0 * x as f32, 60.0],
        };
        [r, g, b, 1.0]
    });
    Image::new(width, height, pixels.collect())
}

fn make_volumes(folder: &Path) -> Outcome {
    let centred = |at: DVec3| at - DVec3::splat(0.5);

    // A smooth lopsided bump; 32-bit float, gzip.
    let blob = |at: DVec3| {
        let d = centred(at) * DVec3::new(1.0, 1.2, 0.9);
        let ripple = 0.8 + 0.2 * (TAU * (at.x + 0.6 * at.y)).sin();
        (-9.0 * d.length_squared()).exp() * ripple * edge(at)
    };
    let values = sample([20, 20, 20], blob);
    let bytes = values.iter().flat_map(|v| (*v as f32).to_le_bytes());
    write_nrrd(folder, "blob", "float", [20, 20, 20], None, bytes.collect())?;

    // Nested shells around a core; unsigned 8-bit.
    let shells = |at: DVec3| {
        let r = (centred(at) * DVec3::new(1.0, 1.1, 1.25)).length();
        (0.5 + 0.5 * (26.0 * r).cos()) * (1.2 - 2.0 * r).max(0.0) * edge(at)
    };
    let values = sample([28, 28, 28], shells);
    let bytes = values.iter().map(|v| (v * 255.0) as u8);
    write_nrrd(
        folder,
        "shells",
        "uchar",
        [28, 28, 28],
        None,
        bytes.collect(),
    )?;

    // Veins of marble; signed 16-bit.
    let marble = |at: DVec3| {
        let p = at * 6.0;
        let swirl = p.x + 1.4 * (0.9 * p.y).sin() + 0.8 * (1.3 * p.z + p.x).cos();
        (0.5 + 0.5 * (2.2 * swirl).sin()) * (1.1 - centred(at).length())
    };
    let values = sample([24, 24, 24], marble);
    let bytes = values
        .iter()
        .flat_map(|v| ((v * 1300.0 - 400.0) as i16).to_le_bytes());
    write_nrrd(
        folder,
        "marble",
        "short",
        [24, 24, 24],
        None,
        bytes.collect(),
    )?;

    // Three unlike corners and a bar, sheared and anisotropic; unsigned 16-bit, big-endian.
    let skew = |at: DVec3| {
        let spot = |place: [f64; 3], radius: f64| {
            (1.0 - (at - DVec3::from_array(place)).length() / radius).max(0.0)
        };
        let bar = (1.0 - 6.0 * (at.y - 0.3).hypot(at.z - 0.5)).max(0.0);
        spot([0.2, 0.25, 0.2], 0.25)
            + 0.7 * spot([0.8, 0.7, 0.3], 0.3)
            + spot([0.3, 0.75, 0.8], 0.35)
            + 0.6 * bar
    };
    let values = sample([20, 12, 28], skew);
    let bytes = values
        .iter()
        .flat_map(|v| ((v * 65_535.0) as u16).to_be_bytes());
    let directions = "(-11,2,0) (3,14,2) (0,-1.5,8)";
    write_nrrd(
        folder,
        "skew",
        "ushort",
        [20, 12, 28],
        Some(directions),
        bytes.collect(),
    )
}

/// Falls to 0 at the cube's faces.
fn edge(at: DVec3) -> f64 {
    let inside = DVec3::splat(0.5) - (at - DVec3::splat(0.5)).abs();
    (8.0 * inside.min_element()).clamp(0.0, 1.0)
}

fn sample([nx, ny, nz]: [u32; 3], field: impl Fn(DVec3) -> f64) -> Vec<f64> {
    let size = DVec3::new(nx.into(), ny.into(), nz.into());
    let voxels = (0..nx * ny * nz).map(|i| {
        let index = [i % nx, i / nx % ny, i / (nx * ny)];
        field((DVec3::from_array(index.map(f64::from)) + 0.5) / size)
    });
    voxels.collect()
}

/// Gzip for 32-bit float, raw for the rest, so that readers meet both.
fn write_nrrd(
    folder: &Path,
    name: &str,
    kind: &str,
    [nx, ny, nz]: [u32; 3],
    directions: Option<&str>,
    bytes: Vec<u8>,
) -> Outcome {
    let (encoding, data) = if kind == "float" {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
        encoder.write_all(&bytes)?;
        ("gzip", encoder.finish()?)
    } else {
        ("raw", bytes)
    };
    let (endian, place) = match directions {
        Some(directions) => (
            "big",
            format!("space: left-posterior-superior\nspace directions: {directions}\n"),
        ),
        None => ("little", "spacings: 1 1 1\n".into()),
    };
    let header = format!(
        "NRRD0004\ntype: {kind}\ndimension: 3\nsizes: {nx} {ny} {nz}\n{place}endian: {endian}\nencoding: {encoding}\n\n"
    );
    let file = [header.into_bytes(), data].concat();
    Ok(fs::write(folder.join(format!("{name}.nrrd")), file)?)
}
