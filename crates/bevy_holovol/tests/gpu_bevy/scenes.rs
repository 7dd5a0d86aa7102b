//! Scenes seen through Bevy are those that `holovol render` makes, within noise.

use std::path::{Path, PathBuf};

use bevy::camera::Exposure;
use bevy::prelude::*;
use bevy_holovol::prelude::*;
use bevy_holovol::{MAX_VIEWS, SceneParts};
use holovol_render::{Gpu, TraceOptions, Tracer};
use holovol_scene::Scene;

use crate::app::*;

pub const TESTS: &[crate::Test] = &[
    ("small_scenes_equal_the_offline_renderer", small_scenes),
    (
        "reference_scenes_equal_the_offline_renderer",
        reference_scenes,
    ),
];

const SIZE: u32 = 48;
const SAMPLES: u32 = 64;

fn scene_files(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return Vec::new();
    };
    let is_scene = |path: &PathBuf| {
        let name = path.to_string_lossy();
        name.ends_with(".json") && !name.ends_with(".ref.json")
    };
    let mut files: Vec<_> = entries
        .flatten()
        .map(|e| e.path())
        .filter(is_scene)
        .collect();
    files.sort();
    files
}

pub fn offline(gpu: &Gpu, scene: &Scene, seed: u64, samples: u32) -> Vec<[f32; 4]> {
    let options = TraceOptions { seed, ..default() };
    let mut tracer = Tracer::new(gpu, scene, &options).expect("a scene");
    tracer.accumulate(samples).expect("samples");
    tracer.read_image().expect("an image")
}

/// An app that shows a scene, and what its camera draws into.
pub fn stage(scene: Scene, samples: u32) -> (App, Handle<Image>) {
    let mut app = app();
    let parts = SceneParts::new(scene);
    let unit = 1.0 / bevy_holovol::environment::DEFAULT_INTENSITY;
    let entity = spawn_volume(&mut app, solid(Vec3::ONE), parts.transfer_function);
    let volume = app
        .world_mut()
        .resource_mut::<Assets<VolumeAsset>>()
        .add(parts.volume);
    app.world_mut()
        .entity_mut(entity)
        .insert((Volume3d(volume), parts.medium));
    let map = app
        .world_mut()
        .resource_mut::<Assets<EnvironmentAsset>>()
        .add(parts.environment);
    app.insert_resource(VolumeEnvironment {
        intensity: parts.intensity,
        rotation_y: parts.rotation_y,
        lights_meshes: false,
        is_sky: false,
        ..VolumeEnvironment::from_map(map)
    });
    let target = target(&mut app, parts.size.x, parts.size.y);
    let settings = VolumeRenderSettings {
        samples: 16,
        max_samples: samples,
        ..parts.settings
    };
    let camera = spawn_camera(&mut app, &target, 1.0, settings);
    app.world_mut().entity_mut(camera).insert((
        parts.camera,
        Projection::Perspective(parts.projection),
        // exposure() = 1 / (1.2 · 2^ev100)
        Exposure {
            ev100: -(1.2 * unit).log2(),
        },
    ));
    (app, target)
}

fn in_bevy(scene: Scene) -> Vec<[f32; 4]> {
    let (mut app, target) = stage(scene, SAMPLES);
    finish(&mut app);
    read(&mut app, &target).pixels
}

/// (mean, relMSE against b's long render) of radiance.
pub fn measures(image: &[[f32; 4]], truth: &[[f32; 4]]) -> (f64, f64) {
    let count = (3 * image.len()) as f64;
    let pairs = || {
        image
            .iter()
            .zip(truth)
            .flat_map(|(a, b)| (0..3).map(|c| (f64::from(a[c]), f64::from(b[c]))))
    };
    let mean = pairs().map(|(a, _)| a).sum::<f64>() / count;
    let error = pairs()
        .map(|(a, b)| (a - b).powi(2) / (b * b + 0.01))
        .sum::<f64>()
        / count;
    (mean, error)
}

fn compare(path: &Path) {
    let gpu = Gpu::new(None).expect("an adapter");
    let mut scene = holovol_scene::load(path, &mut |_progress| {}).expect("a scene file");
    scene.camera.width = SIZE;
    scene.camera.height = SIZE;
    let truth = offline(&gpu, &scene, 1, 16 * SAMPLES);
    let (mean, noise) = measures(&offline(&gpu, &scene, 2, SAMPLES), &truth);
    let (true_mean, _) = measures(&truth, &truth);
    let (found, error) = measures(&in_bevy(scene), &truth);
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    eprintln!(
        "{name}: mean {found:.5} (offline {mean:.5}, truth {true_mean:.5}), relMSE {error:.3e} \
         (offline {noise:.3e})"
    );
    // Means of some thousand pixels; 16-bit floats round to 5e-4. Noise of one run varies by some
    // tens of per cent where a few bright pixels make it.
    let drift = (found / true_mean - 1.0).abs();
    let chance = 3.0 * (mean / true_mean - 1.0).abs() + 0.01;
    assert!(
        drift < chance,
        "{name}: mean {found} instead of {true_mean}"
    );
    assert!(
        error < 1.5 * noise + 1e-5,
        "{name}: relMSE {error} where {noise} is noise"
    );
}

/// Scenes that come with the sources.
pub fn small_scene_files() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/scenes");
    let files = scene_files(&folder);
    assert!(!files.is_empty(), "{} has scenes", folder.display());
    files
}

/// Scenes of real scans, where they are at hand.
pub fn reference_scene_files() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/reference");
    scene_files(&folder)
}

fn small_scenes() {
    const { assert!(MAX_VIEWS >= 2, "both eyes in one dispatch") };
    for file in small_scene_files() {
        compare(&file);
    }
}

fn reference_scenes() {
    let files = reference_scene_files();
    if files.is_empty() {
        eprintln!("skipped: ../shared/reference has no scenes");
    }
    for file in files {
        compare(&file);
    }
}
