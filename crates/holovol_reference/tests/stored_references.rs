//! The tracer against stored pictures: those of an independent renderer over real scans in
//! `../shared/reference`, and the repository's own small ones in `tests/scenes`.
//!
//! `HOLOVOL_NIGHTLY=1` renders with many more samples and the seed in `HOLOVOL_SEED`, else one from
//! the clock; it is printed.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use holovol_reference::measures::relmse;
use holovol_reference::statistics::{BlockStatistics, agreement};
use holovol_reference::{Image, Settings, StoredReference, render};

/// p-value that all scenes of a suite together fall below by chance once in a million runs.
const SIGNIFICANCE: f64 = 1e-6;

fn is_nightly() -> bool {
    std::env::var_os("HOLOVOL_NIGHTLY").is_some_and(|value| value == "1")
}

fn seed() -> u64 {
    if !is_nightly() {
        return 1;
    }
    if let Ok(text) = std::env::var("HOLOVOL_SEED") {
        return text.parse().expect("HOLOVOL_SEED must be a whole number");
    }
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    now.map_or(1, |since| since.as_nanos() as u64)
}

/// Scene files that have a reference beside them, sorted.
fn scenes(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = folder.read_dir() else {
        return Vec::new();
    };
    let mut scenes: Vec<PathBuf> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| {
            path.extension()
                .is_some_and(|extension| extension == "json")
        })
        .filter(|path| path.with_extension("ref.exr").is_file())
        .collect();
    scenes.sort();
    scenes
}

/// Renders a scene; describes the disagreement with its reference if there is one.
fn check(path: &Path, spp: u32, scenes: usize) -> Result<(), String> {
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    let stored = StoredReference::read(path).map_err(|error| error.to_string())?;
    let scene = holovol_scene::load(path, &mut |_| {}).map_err(|error| error.to_string())?;
    let settings = Settings {
        spp,
        seed: seed(),
        ..Default::default()
    };
    let start = Instant::now();
    let film = render(&scene, &settings, &mut |_| ControlFlow::Continue(()))
        .map_err(|error| format!("{name}: {error}"))?;
    let seconds = start.elapsed().as_secs_f64();

    let image = film.image();
    let ours = BlockStatistics::from_film(&film);
    let floor = stored.info.error_floor_relmse;
    let theirs = BlockStatistics::from_reference(&stored.image, floor, stored.info.spp, &ours)
        .map_err(|error| format!("{name}: {error}"))?;
    let verdict = agreement(&ours, &theirs).map_err(|error| format!("{name}: {error}"))?;
    let noise = relmse(&image, &stored.image).map_err(|error| format!("{name}: {error}"))?;
    let samples = f64::from(spp) * image.pixels().len() as f64;
    eprintln!(
        "{name}: {verdict}; relMSE × spp {:.3}, {:.0} samples/s, {spp} spp, seed {}",
        (noise - floor) * f64::from(spp),
        samples / seconds,
        settings.seed
    );
    if verdict.holds(SIGNIFICANCE / scenes as f64) {
        return Ok(());
    }
    let kept = keep(&name, &image, &stored.image);
    Err(format!(
        "{name} differs from its reference: {verdict}; {kept}"
    ))
}

/// Writes picture, reference and error for a look at what went wrong.
fn keep(name: &str, image: &Image, reference: &Image) -> String {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let pairs = image.pixels().iter().zip(reference.pixels());
    let error = pairs.map(|(a, b)| std::array::from_fn(|c| (a[c] - b[c]).abs()));
    let error = Image::new(image.width(), image.height(), error.collect());
    for (what, picture) in [
        ("image", image),
        ("reference", reference),
        ("error", &error),
    ] {
        let path = folder.join(format!("{name}.{what}.exr"));
        if let Err(problem) = picture.write_exr(&path) {
            return problem.to_string();
        }
    }
    format!("see {name}.*.exr in {}", folder.display())
}

fn check_all(paths: &[PathBuf], spp: u32) {
    let failures: Vec<String> = paths
        .iter()
        .filter_map(|path| check(path, spp, paths.len()).err())
        .collect();
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn real_scans_agree_with_an_independent_renderer() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/reference");
    let paths = scenes(&folder);
    if paths.is_empty() {
        eprintln!("skipped: no scenes in ../shared/reference");
        return;
    }
    check_all(&paths, if is_nightly() { 256 } else { 8 });
}

#[test]
fn small_scenes_agree_with_their_stored_pictures() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/scenes");
    let paths = scenes(&folder);
    assert!(
        paths.len() >= 8,
        "scenes are missing in {}",
        folder.display()
    );
    check_all(&paths, if is_nightly() { 4096 } else { 64 });
}
