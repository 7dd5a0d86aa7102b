//! The whole of it without a window: a view that was saved is, rendered from its file, the view.

use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use bevy::app::PluginsState;
use bevy::camera::{Exposure, RenderTarget};
use bevy::core_pipeline::tonemapping::{DebandDither, Tonemapping};
use bevy::log::LogPlugin;
use bevy::prelude::*;
use bevy::render::RenderPlugin;
use bevy::render::gpu_readback::{Readback, ReadbackComplete};
use bevy::render::pipelined_rendering::PipelinedRenderingPlugin;
use bevy::render::render_resource::{TextureFormat, TextureUsages};
use bevy::window::ExitCondition;
use bevy::winit::WinitPlugin;
use bevy_holovol::VolumeStatistics;
use bevy_holovol::prelude::*;
use glam::DVec3;
use holovol_light::EnvironmentMap;
use holovol_render::{Gpu, TraceOptions, Tracer};
use holovol_scene::SceneFile;
use holovol_volume::{Geometry, TransferPoint, Volume, Voxels};

use super::Session;
use super::camera::Orbit;
use super::look::{Light, LightSource, Look};
use super::open::Opening;
use super::pictures::{Order, Pictures};
use super::scene_io::{self, Viewpoint};
use super::studio::{Scan, Studio, StudioPlugin};
use crate::room_camera::{RoomCamera, RoomCameraPlugin, Source};

const SIZE: u32 = 40;
const SAMPLES: u32 = 256;

/// Without an adapter there is nothing to compare.
pub(crate) fn has_adapter() -> bool {
    let found = Gpu::new(None).is_ok();
    let is_required = std::env::var_os("HOLOVOL_REQUIRE_GPU").is_some_and(|value| value == "1");
    assert!(found || !is_required, "there is no graphics adapter");
    if !found {
        eprintln!("ignored: there is no graphics adapter");
    }
    found
}

pub(super) fn blob() -> Scan {
    const N: usize = 12;
    let value = |index: usize| {
        let at = [index % N, index / N % N, index / (N * N)].map(|i| i as f64 - 5.5);
        let radius = (at[0] * at[0] + 1.5 * at[1] * at[1] + at[2] * at[2]).sqrt();
        (at[0] * 4.0 + 30.0 * (5.0 - radius)).clamp(0.0, 200.0) as u8
    };
    let voxels = Voxels::U8((0..N * N * N).map(value).collect());
    let geometry = Geometry::from_spacing([0.01, 0.012, 0.008]);
    let volume = Volume::new(voxels, [N as u32; 3], 2.0, -100.0, geometry).expect("a volume");
    Scan::new(VolumeAsset::new(volume))
}

/// Bright on one side, warm on the other.
fn room() -> EnvironmentMap {
    let texel = |i: usize| match i % 16 {
        3 | 4 => [9.0, 8.0, 7.0],
        10..=13 => [0.5, 0.3, 0.1],
        _ => [0.2, 0.25, 0.3],
    };
    EnvironmentMap::new(16, 8, (0..128).map(texel).collect())
}

pub(super) fn look(map: Handle<EnvironmentAsset>) -> Look {
    let point = |s, sigma_t, albedo| TransferPoint {
        s,
        sigma_t,
        albedo,
        emission: [0.02, 0.0, 0.05],
        roughness: 0.3,
        specular: 0.04,
    };
    Look {
        window: [-60.0, 180.0],
        points: vec![
            point(0.1, 0.0, [0.9, 0.5, 0.3]),
            point(0.5, 0.4, [0.9, 0.5, 0.3]),
            point(0.9, 1.0, [0.4, 0.8, 0.9]),
        ],
        optical_depth_scale: Some(30.0),
        density: 0.7,
        gradient_factor: 2.0,
        phase_g: 0.2,
        light: Light {
            source: LightSource::Map {
                map,
                path: None,
                name: "room".into(),
            },
            rotation_deg: 40.0,
            stops: 0.5,
            is_sky: false,
        },
        max_scatters: Some(3),
        ..Look::default()
    }
}

fn orbit() -> Orbit {
    Orbit::looking(
        Vec3::new(0.005, 0.0, 0.002),
        Vec3::new(0.12, 0.08, 0.25),
        Vec3::Y,
    )
}

/// An app that shows the blob as the window's does, on an image; with that image.
fn app() -> (App, Handle<Image>) {
    app_with(|_: &mut App| {})
}

pub(crate) fn app_with(more: impl Plugin) -> (App, Handle<Image>) {
    let mut app = App::new();
    app.add_plugins(
        DefaultPlugins
            .set(WindowPlugin {
                primary_window: None,
                exit_condition: ExitCondition::DontExit,
                ..default()
            })
            .set(RenderPlugin {
                synchronous_pipeline_compilation: true,
                ..default()
            })
            .disable::<LogPlugin>()
            .disable::<PipelinedRenderingPlugin>()
            .disable::<WinitPlugin>(),
    );
    app.add_plugins((HolovolPlugins, StudioPlugin, more));
    while app.plugins_state() == PluginsState::Adding {
        bevy::tasks::tick_global_task_pools_on_main_thread();
    }
    app.finish();
    app.cleanup();
    app.insert_resource(ClearColor(Color::BLACK));
    let world = app.world_mut();
    let scan = blob();
    let volume = world
        .resource_mut::<Assets<VolumeAsset>>()
        .add(scan.asset.clone());
    let mut maps = world.resource_mut::<Assets<EnvironmentAsset>>();
    let map = maps.add(EnvironmentAsset::new(room()));
    let mut target = Image::new_target_texture(SIZE, SIZE, TextureFormat::Rgba32Float, None);
    target.texture_descriptor.usage |= TextureUsages::COPY_SRC;
    let target = world.resource_mut::<Assets<Image>>().add(target);
    let volume = world.spawn(Volume3d(volume)).id();
    let camera = world
        .spawn((
            Camera3d::default(),
            RenderTarget::Image(target.clone().into()),
            Tonemapping::None,
            DebandDither::Disabled,
            Msaa::Off,
            Projection::Perspective(PerspectiveProjection {
                fov: 0.5,
                near: 0.002,
                ..default()
            }),
            orbit().transform(),
            VolumeRenderSettings {
                samples: 16,
                max_samples: SAMPLES,
                ..default()
            },
        ))
        .id();
    world.insert_resource(Session {
        volume,
        camera,
        name: "blob".into(),
        status: None,
        frames_left: None,
    });
    world.insert_resource(Studio {
        look: look(map),
        scan: Some(scan),
        ..default()
    });
    (app, target)
}

#[test]
fn a_camera_lights_what_is_shown_until_another_light_is_chosen() {
    if !has_adapter() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let [good, bad] = ["a.png", "b.png"].map(|name| folder.path().join(name));
    let grey = image::Rgb([90; 3]);
    image::RgbImage::from_pixel(64, 32, grey)
        .save(&good)
        .expect("a picture");
    std::fs::write(&bad, "no picture").expect("a file");
    let (mut app, _) = app_with(RoomCameraPlugin(Source::Frames(vec![good, bad])));
    app.init_resource::<Opening>();
    let wait_for = |app: &mut App, is_done: &dyn Fn(&World) -> bool| {
        let started = Instant::now();
        while !is_done(app.world()) {
            assert!(started.elapsed() < Duration::from_secs(60), "nothing came");
            std::thread::sleep(Duration::from_millis(2));
            app.update();
        }
    };
    let source = |world: &World| world.resource::<Studio>().look.light.source.clone();
    let is_camera = |world: &World| world.resource::<RoomCamera>().is(&source(world));
    assert!(!is_camera(app.world()));
    wait_for(&mut app, &is_camera);
    app.update();
    let world = app.world();
    let map = world.resource::<LiveLight>().map().clone();
    let environment = world.resource::<VolumeEnvironment>();
    assert_eq!(environment.source, EnvironmentSource::Map(map.clone()));
    // Chalk in light from everywhere is as bright as the light.
    let seen = world.resource::<Assets<EnvironmentAsset>>().get(&map);
    let radiance = f64::from(seen.expect("its map").map().texels()[0][1]);
    let shown = world.resource::<Studio>().look.exposure_ev.exp2() * radiance;
    assert!((shown - 0.9).abs() < 0.02, "{shown}");
    wait_for(&mut app, &|world| {
        let problem = world.resource::<RoomCamera>().problem();
        problem.is_some_and(|problem| problem.contains("b.png"))
    });

    // The user's own choice stays while the camera goes on.
    let white = LightSource::Constant([1.0; 3]);
    app.world_mut().resource_mut::<Studio>().look.light.source = white.clone();
    let frames = app.world().resource::<LiveLight>().frames;
    wait_for(&mut app, &|world| {
        world.resource::<LiveLight>().frames > frames + 2
    });
    assert_eq!(source(app.world()), white);
    let environment = app.world().resource::<VolumeEnvironment>();
    let is_white = matches!(environment.source, EnvironmentSource::Constant(_));
    assert!(is_white, "{:?}", environment.source);
}

/// What has been gathered: linear RGBA.
fn accumulated(app: &mut App, target: &Handle<Image>) -> Vec<[f32; 4]> {
    const PATIENCE: usize = 20_000;
    let found = Arc::new(Mutex::new(None));
    let mut reader = None;
    for _ in 0..PATIENCE {
        app.update();
        let statistics = app.world().resource::<VolumeStatistics>().get();
        assert_eq!(statistics.errors, Vec::<String>::new());
        if statistics.is_waiting {
            std::thread::sleep(Duration::from_millis(5));
        }
        if !statistics.is_done {
            continue;
        }
        if reader.is_none() {
            // What is done is in the target one frame later.
            app.update();
            let result = Arc::clone(&found);
            let readback = app.world_mut().spawn(Readback::texture(target.clone()));
            let mut readback = readback;
            readback.observe(move |event: On<ReadbackComplete>| {
                *result.lock().expect("no panic") = Some(event.data.clone());
            });
            reader = Some(readback.id());
        }
        let Some(bytes) = found.lock().expect("no panic").take() else {
            continue;
        };
        let row = bytes.len() / SIZE as usize;
        let number = |at: usize| {
            f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
        };
        let pixel = |x: usize, y: usize| std::array::from_fn(|c| number(y * row + 16 * x + 4 * c));
        let side = 0..SIZE as usize;
        return side
            .clone()
            .flat_map(|y| side.clone().map(move |x| (x, y)))
            .map(|(x, y)| pixel(x, y))
            .collect();
    }
    panic!("nothing was read back");
}

pub(super) fn viewpoint() -> Viewpoint {
    let orbit = orbit();
    Viewpoint {
        transform: orbit.transform(),
        distance: orbit.distance,
        fov: 0.5,
        size: UVec2::splat(SIZE),
        exposure: Exposure::default().exposure() * bevy_holovol::environment::DEFAULT_INTENSITY,
    }
}

/// What `holovol render` makes of a file.
fn rendered(path: &Path, seed: u64, samples: u32) -> Vec<[f32; 4]> {
    let scene = holovol_scene::load(path, &mut |_| {}).expect("a scene file");
    let gpu = Gpu::new(None).expect("an adapter");
    let options = TraceOptions { seed, ..default() };
    let mut tracer = Tracer::new(&gpu, &scene, &options).expect("a scene");
    tracer.accumulate(samples).expect("samples");
    tracer.read_image().expect("an image")
}

/// Mean, and mean squared difference from `truth`, of exposed radiance.
fn measures(image: &[[f32; 4]], truth: &[[f32; 4]], exposure: f32) -> [f64; 2] {
    let count = (3 * image.len()) as f64;
    let [mut mean, mut error] = [0.0; 2];
    for (a, b) in image.iter().zip(truth) {
        for c in 0..3 {
            let (a, b) = (f64::from(a[c]), f64::from(b[c] * exposure));
            mean += a / count;
            error += (a - b).powi(2) / count;
        }
    }
    [mean, error]
}

#[test]
fn a_saved_view_rendered_from_its_file_is_the_view() {
    if !has_adapter() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("view.json");
    let (mut app, target) = app();
    let image = accumulated(&mut app, &target);

    let view = viewpoint();
    let studio = app.world().resource::<Studio>();
    let scan = studio.scan.as_ref().unwrap();
    let file = scene_io::scene_file(&studio.look, scan, &view);
    let written = scene_io::save(file, scan, &studio.look.light.source, Some(&room()), &path);
    assert_eq!(written.unwrap().len(), 3, "scene, scan and light");

    let truth = rendered(&path, 1, 16 * SAMPLES);
    let scaled = |image: Vec<[f32; 4]>| -> Vec<[f32; 4]> {
        image.iter().map(|p| p.map(|c| c * view.exposure)).collect()
    };
    let [offline_mean, noise] =
        measures(&scaled(rendered(&path, 2, SAMPLES)), &truth, view.exposure);
    let [mean, error] = measures(&image, &truth, view.exposure);
    let [true_mean, _] = measures(&scaled(truth.clone()), &truth, view.exposure);
    eprintln!("mean {mean} (offline {offline_mean}, truth {true_mean}), {error:e} ({noise:e})");
    assert!(true_mean > 0.02, "something is seen: {true_mean}");
    assert!((mean / true_mean - 1.0).abs() < 0.01, "{mean}, {true_mean}");
    assert!(
        error < 1.5 * noise + 1e-7,
        "error {error:e} where {noise:e} is noise"
    );
}

#[test]
fn a_resting_view_costs_nothing_and_an_edit_begins_anew() {
    if !has_adapter() {
        return;
    }
    let (mut app, target) = app();
    accumulated(&mut app, &target);
    let numbers = |app: &App| app.world().resource::<VolumeStatistics>().get();
    let before = numbers(&app);
    for _ in 0..5 {
        app.update();
    }
    let after = numbers(&app);
    assert_eq!(
        [after.dispatches, after.samples, after.uploads],
        [before.dispatches, before.samples, before.uploads]
    );
    app.world_mut().resource_mut::<Studio>().look.density = 2.0;
    for _ in 0..4 {
        app.update();
    }
    assert!(numbers(&app).samples > after.samples);
}

#[test]
fn pictures_are_cut_as_the_view_is_and_keep_opacity() {
    if !has_adapter() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let scan = blob();
    let mut look = look(Handle::default());
    look.planes.push(super::look::Plane {
        normal: DVec3::Y,
        offset: 0.0,
        is_on: true,
    });
    let view = viewpoint();
    let path = folder.path().join("view.exr");
    let order = |path: &Path, clip| Order {
        scene: SceneFile {
            clip,
            ..scene_io::scene_file(&look, &scan, &view)
        },
        volume: scan.volume().clone(),
        map: Arc::new(room()),
        pictures: vec![(view.camera(), path.to_owned())],
        samples: 16,
    };
    let mean_opacity = |clip| {
        let mut pictures = Pictures::default();
        pictures.begin(order(&path, clip)).unwrap();
        let outcome = loop {
            if let Some(outcome) = pictures.outcome() {
                break outcome;
            }
            std::thread::sleep(std::time::Duration::from_millis(10));
        };
        outcome.unwrap();
        let image = holovol_reference::Image::read_exr(&path).unwrap();
        let opacity: f64 = image.pixels().iter().map(|p| f64::from(p[3])).sum();
        opacity / image.pixels().len() as f64
    };
    let whole = mean_opacity(Vec::new());
    let half = mean_opacity(scene_io::scene_file(&look, &scan, &view).clip);
    assert!(
        whole > 0.1 && half > 0.2 * whole && half < 0.9 * whole,
        "{half} of {whole}"
    );

    let nowhere = folder.path().join("missing/view.exr");
    let failure = Pictures::default()
        .begin(order(&nowhere, Vec::new()))
        .unwrap_err();
    assert!(failure.to_string().contains("does not exist"), "{failure}");
}
