//! Scenes on disk with references by an independent renderer.

use std::path::{Path, PathBuf};

use holovol_reference::measures::{mean, relmse};
use holovol_reference::statistics::BlockStatistics;
use holovol_reference::{Image, StoredReference};
use holovol_render::{Interpolation, TraceOptions};
use holovol_scene::Scene;

use crate::gpu::{
    Test, assert_agree, assert_clean, effort, image, options, picture, pictures, tracer,
};

pub fn tests() -> Vec<Test> {
    vec![
        ("small_scenes_agree_with_their_references", || {
            all_agree("tests/scenes", 24)
        }),
        ("real_scans_agree_with_their_references", || {
            all_agree("../shared/reference", 4)
        }),
        (
            "error_falls_with_the_square_root_of_samples",
            error_falls_with_the_square_root_of_samples,
        ),
        (
            "well_spread_samples_beat_white_noise",
            well_spread_samples_beat_white_noise,
        ),
        (
            "hardware_interpolation_stays_close",
            hardware_interpolation_stays_close,
        ),
    ]
}

/// Scenes of a folder relative to the workspace, by name.
fn scenes(folder: &str) -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let Ok(entries) = std::fs::read_dir(root.join(folder)) else {
        return Vec::new();
    };
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let is_scene = |path: &PathBuf| {
        let name = path.to_string_lossy();
        name.ends_with(".json") && !name.ends_with(".ref.json")
    };
    let mut paths: Vec<_> = paths.filter(is_scene).collect();
    paths.sort();
    paths
}

#[track_caller]
fn load(path: &Path) -> (Scene, StoredReference) {
    let scene = holovol_scene::load(path, &mut |_| {}).expect("a scene that can be read");
    let reference = StoredReference::read(path).expect("a reference beside it");
    (scene, reference)
}

/// The scene of this name under `tests/scenes`.
fn small(name: &str) -> (Scene, StoredReference) {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/scenes");
    load(&root.join(name).with_extension("json"))
}

fn floor(reference: &StoredReference) -> f64 {
    reference.info.error_floor_relmse
}

/// The mean of pictures of independent seeds.
fn mean_image(images: &[Image]) -> Image {
    let n = images.len() as f64;
    let [width, height] = [images[0].width(), images[0].height()];
    let pixel = |i: usize| {
        std::array::from_fn(|c| {
            let sum: f64 = images
                .iter()
                .map(|image| f64::from(image.pixels()[i][c]))
                .sum();
            (sum / n) as f32
        })
    };
    Image::new(
        width,
        height,
        (0..images[0].pixels().len()).map(pixel).collect(),
    )
}

/// Block means differ by no more than chance; and the mean of n seeds has an nth of their relMSE.
fn all_agree(folder: &str, spp: u32) {
    let scenes = scenes(folder);
    if scenes.is_empty() {
        // The project's own scenes are always there; those of `../shared` are at developers' only.
        assert!(folder.starts_with("../shared"), "no scenes in {folder}");
        eprintln!("skipped: no scenes in {folder}");
    }
    for path in scenes {
        let name = path.file_stem().map(|s| s.to_string_lossy().into_owned());
        let name = name.unwrap_or_default();
        let (scene, reference) = load(&path);
        let spp = effort(spp);
        let images = pictures(&name, &scene, &options(), spp);
        let ours = BlockStatistics::from_seeds(&images, spp.into()).expect("equal sizes");
        let theirs = BlockStatistics::from_reference(
            &reference.image,
            floor(&reference),
            reference.info.spp,
            &ours,
        );
        assert_agree(&name, &ours, &theirs.expect("equal sizes"));

        let error = |image: &Image| relmse(image, &reference.image).expect("equal sizes");
        let n = images.len() as f64;
        let one = images.iter().map(error).sum::<f64>() / n - floor(&reference);
        let all = error(&mean_image(&images)) - floor(&reference);
        let ratio = n * all / one;
        eprintln!(
            "{name}: relMSE {one:.3e} of one seed, {all:.3e} of {n}; their ratio × {n}: {ratio:.3}"
        );
        // The reference's own floor is an estimate: 10 % of it are left open.
        let slack = n * 0.1 * floor(&reference) / one;
        assert!(
            ratio < 1.2 + slack,
            "{name}: {ratio}, an error that does not average out"
        );
    }
}

fn error_falls_with_the_square_root_of_samples() {
    for name in ["blob_sun", "sheared", "surface", "inside"] {
        let (scene, reference) = small(name);
        let mut tracer = tracer(&scene, &options());
        let mut errors = Vec::new();
        for more in [4, 12, 48, 192] {
            tracer.accumulate(more).expect("samples");
            let error = relmse(&image(&tracer), &reference.image).expect("equal sizes");
            errors.push((error - floor(&reference)) * tracer.samples_per_pixel() as f64);
        }
        assert_clean(name, &tracer.counters());
        eprintln!("{name}: relMSE × samples {errors:.3?} at 4, 16, 64, 256 samples");
        for pair in errors.windows(2) {
            assert!(
                pair[1] < 1.25 * pair[0],
                "{name}: {errors:?} does not fall as 1/samples"
            );
        }
    }
}

fn well_spread_samples_beat_white_noise() {
    for name in ["blob_sun", "sheared", "mirrored", "inside"] {
        let (scene, reference) = small(name);
        for spp in [1, 2, 4] {
            let error = |white_noise: bool| {
                let options = TraceOptions {
                    white_noise,
                    ..options()
                };
                let images = pictures(name, &scene, &options, spp);
                let sum: f64 = images
                    .iter()
                    .map(|image| relmse(image, &reference.image).expect("equal sizes"))
                    .sum();
                sum / images.len() as f64
            };
            let ratio = error(false) / error(true);
            eprintln!("{name}, {spp} samples: relMSE is {ratio:.3} of white noise's");
            assert!(ratio < 1.0, "{name}, {spp} samples: {ratio}");
        }
    }
}
/// Off by 5e-7 on Mesa's software Vulkan, which filters in f32; texture units with 8-bit weights
/// may do worse, but not visibly.
fn hardware_interpolation_stays_close() {
    for name in ["blob_sun", "sheared", "surface"] {
        let (scene, _) = small(name);
        let with = |interpolation| {
            let options = TraceOptions {
                interpolation,
                ..options()
            };
            picture(&scene, &options, effort(256))
        };
        let exact = mean(&with(Interpolation::Exact));
        let fast = mean(&with(Interpolation::Hardware));
        for c in 0..4 {
            let bias = (fast[c] - exact[c]) / exact[c];
            eprintln!("{name}: channel {c} is off by {bias:.2e}");
            assert!(bias.abs() < 0.01, "{name}: channel {c} is off by {bias}");
        }
    }
}
