//! Frames: what is done, and what is not.

use std::path::Path;
use std::sync::Arc;

use bevy::camera::RenderTarget;
use bevy::camera::visibility::RenderLayers;
use bevy::prelude::*;
use bevy::render::render_resource::PollType;
use bevy_holovol::prelude::*;

use holovol_render::{
    FrameTracer, Gpu, GpuEnvironment, GpuVolume, Kernels, Medium, TraceOptions, View, ViewFrame,
};

use crate::app::*;

pub const TESTS: &[crate::Test] = &[
    (
        "a_finished_view_costs_nothing",
        a_finished_view_costs_nothing,
    ),
    (
        "changes_begin_anew_and_upload_only_themselves",
        changes_begin_anew,
    ),
    ("volumes_come_and_go", volumes_come_and_go),
    (
        "the_nearer_volume_covers_the_farther",
        the_nearer_volume_covers_the_farther,
    ),
    ("targets_change_size", targets_change_size),
    (
        "resolution_scale_keeps_the_brightness",
        resolution_scale_keeps_the_brightness,
    ),
    (
        "views_of_different_scatterings_stand_side_by_side",
        different_scatterings,
    ),
    ("clip_planes_open_a_volume", clip_planes_open_a_volume),
    ("fresh_frames_never_end", fresh_frames_never_end),
    (
        "a_lost_device_is_recovered_from",
        a_lost_device_is_recovered_from,
    ),
    ("plugins_take_half_a_millisecond_at_most", overhead),
];

fn a_finished_view_costs_nothing() {
    let mut app = app();
    spawn_volume(&mut app, solid(Vec3::ONE), matter(3.0, 0.8));
    let target = target(&mut app, 24, 24);
    spawn_camera(&mut app, &target, 4.0, settings(64));
    finish(&mut app);
    let before = statistics(&app);
    assert_eq!(before.samples_per_pixel, 64);
    assert_eq!(before.samples, 64 * 24 * 24);
    for _ in 0..10 {
        app.update();
    }
    let after = statistics(&app);
    assert_eq!(after.dispatches, before.dispatches);
    assert_eq!(
        (after.samples, after.uploads),
        (before.samples, before.uploads)
    );
    assert!(after.frames >= before.frames + 10);
}

fn changes_begin_anew() {
    let mut app = app();
    let volume = spawn_volume(&mut app, solid(Vec3::ONE), matter(1.0, 0.0));
    let target = target(&mut app, 24, 24);
    let camera = spawn_camera(&mut app, &target, 4.0, settings(64));
    app.insert_resource(ClearColor(Color::WHITE));
    finish(&mut app);
    let dense = |app: &mut App| read(app, &target).mean([10, 10, 14, 14]).x;
    assert_near("1 m of 1/m", dense(&mut app), (-1f32).exp(), 0.01);
    let uploads = statistics(&app).uploads;

    let material = app
        .world()
        .get::<VolumeMaterial3d>(volume)
        .expect("matter")
        .0
        .clone();
    let mut assets = app
        .world_mut()
        .resource_mut::<Assets<TransferFunctionAsset>>();
    assets
        .insert(&material, matter(2.0, 0.0))
        .expect("a handle in use");
    finish(&mut app);
    assert_near("1 m of 2/m", dense(&mut app), (-2f32).exp(), 0.01);

    app.world_mut()
        .get_mut::<VolumeMedium>(volume)
        .expect("a medium")
        .density = 0.25;
    finish(&mut app);
    assert_near("1 m of 0.5/m", dense(&mut app), (-0.5f32).exp(), 0.01);

    app.world_mut()
        .get_mut::<Transform>(volume)
        .expect("a place")
        .scale
        .z = 2.0;
    finish(&mut app);
    assert_near("2 m of 0.5/m", dense(&mut app), (-1f32).exp(), 0.01);
    assert_eq!(
        statistics(&app).uploads,
        uploads,
        "neither voxels nor light were new"
    );

    let samples = statistics(&app).samples;
    app.world_mut()
        .get_mut::<VolumeRenderSettings>(camera)
        .expect("settings")
        .reset = true;
    finish(&mut app);
    assert_eq!(statistics(&app).samples, samples + 64 * 24 * 24, "once");
    let settings = app
        .world()
        .get::<VolumeRenderSettings>(camera)
        .expect("settings");
    assert!(!settings.reset, "a reset clears itself");

    app.insert_resource(VolumeEnvironment::from_radiance(LinearRgba::rgb(
        1.0, 0.0, 0.0,
    )));
    finish(&mut app);
    assert_eq!(statistics(&app).uploads, uploads + 1, "other light");
}

fn volumes_come_and_go() {
    let mut app = app();
    app.insert_resource(ClearColor(Color::WHITE));
    let target = target(&mut app, 24, 24);
    let camera = spawn_camera(&mut app, &target, 4.0, settings(16));
    let centre = |app: &mut App| read(app, &target).mean([11, 11, 13, 13]).x;
    assert_near("no volume", centre(&mut app), 1.0, 1e-3);
    for _ in 0..2 {
        let volume = spawn_volume(&mut app, solid(Vec3::ONE), matter(100.0, 0.0));
        finish(&mut app);
        assert_near("a volume", centre(&mut app), 0.0, 1e-3);
        app.world_mut()
            .entity_mut(volume)
            .insert(Visibility::Hidden);
        assert_near("hidden", centre(&mut app), 1.0, 1e-3);
        app.world_mut()
            .entity_mut(volume)
            .insert(Visibility::Visible);
        finish(&mut app);
        assert_near("shown", centre(&mut app), 0.0, 1e-3);
        app.world_mut()
            .entity_mut(volume)
            .insert(RenderLayers::layer(3));
        assert_near("in another layer", centre(&mut app), 1.0, 1e-3);
        app.world_mut()
            .entity_mut(camera)
            .insert(RenderLayers::from_layers(&[0, 3]));
        finish(&mut app);
        assert_near("in a layer that is seen", centre(&mut app), 0.0, 1e-3);
        app.world_mut().entity_mut(camera).remove::<RenderLayers>();
        app.world_mut().despawn(volume);
        assert_near("gone", centre(&mut app), 1.0, 1e-3);
    }
    app.world_mut().despawn(camera);
    for _ in 0..3 {
        app.update();
    }
}

/// A thin grey veil before a black block, and the block before the veil.
fn the_nearer_volume_covers_the_farther() {
    let mut app = app();
    app.insert_resource(ClearColor(Color::WHITE));
    let block = spawn_volume(
        &mut app,
        solid(Vec3::new(1.0, 1.0, 0.2)),
        matter(500.0, 0.0),
    );
    let veil = spawn_volume(
        &mut app,
        solid(Vec3::new(1.0, 1.0, 0.2)),
        matter(500.0, 0.5),
    );
    let place = |app: &mut App, entity, z| {
        *app.world_mut()
            .get_mut::<Transform>(entity)
            .expect("a place") = Transform::from_xyz(0.0, 0.0, z);
    };
    let target = target(&mut app, 24, 24);
    spawn_camera(&mut app, &target, 4.0, settings(32));
    place(&mut app, veil, 0.5);
    place(&mut app, block, -0.5);
    finish(&mut app);
    let lit = read(&mut app, &target).mean([10, 10, 14, 14]).x;
    assert!(lit > 0.05, "the lit volume is in front: {lit}");
    place(&mut app, veil, -0.5);
    place(&mut app, block, 0.5);
    finish(&mut app);
    let dark = read(&mut app, &target).mean([10, 10, 14, 14]).x;
    assert_near("the black volume is in front", dark, 0.0, 1e-3);
}

fn targets_change_size() {
    let mut app = app();
    app.insert_resource(ClearColor(Color::WHITE));
    spawn_volume(&mut app, solid(Vec3::ONE), matter(100.0, 0.0));
    let first = target(&mut app, 24, 24);
    let camera = spawn_camera(&mut app, &first, 4.0, settings(16));
    finish(&mut app);
    for (width, height) in [(40, 30), (7, 5), (1, 3), (64, 8)] {
        let next = target(&mut app, width, height);
        app.world_mut()
            .entity_mut(camera)
            .insert(RenderTarget::Image(next.clone().into()));
        finish(&mut app);
        let picture = read(&mut app, &next);
        let [x, y] = [width as usize / 2, height as usize / 2];
        assert_near("the middle", picture.mean([x, y, x + 1, y + 1]).x, 0.0, 0.1);
    }
}

fn resolution_scale_keeps_the_brightness() {
    let mut app = app();
    spawn_volume(&mut app, solid(Vec3::new(3.0, 3.0, 1.0)), matter(1.0, 0.8));
    let target = target(&mut app, 40, 30);
    let camera = spawn_camera(&mut app, &target, 4.0, settings(256));
    finish(&mut app);
    let full = read(&mut app, &target).middle().x;
    for scale in [0.25, 0.6, 1.5] {
        let mut settings = app
            .world_mut()
            .get_mut::<VolumeRenderSettings>(camera)
            .expect("settings");
        settings.resolution_scale = scale;
        finish(&mut app);
        let found = read(&mut app, &target).middle().x;
        assert_near(&format!("scale {scale}"), found / full, 1.0, 0.02);
    }
}

/// With no scattering at all a volume is black; beside it stands one that scatters.
fn different_scatterings() {
    let mut app = app();
    spawn_volume(&mut app, solid(Vec3::ONE), matter(20.0, 1.0));
    let targets = [Some(0), Some(1), None].map(|max_scatters| {
        let target = target(&mut app, 24, 24);
        let settings = VolumeRenderSettings {
            max_scatters,
            ..settings(64)
        };
        spawn_camera(&mut app, &target, 4.0, settings);
        target
    });
    finish(&mut app);
    let [none, one, all] = targets.map(|target| read(&mut app, &target).mean([10, 10, 14, 14]).x);
    assert_near("no scattering", none, 0.0, 1e-6);
    assert!(one > 0.1 && all > 1.5 * one, "one {one}, unlimited {all}");
}

fn clip_planes_open_a_volume() {
    let mut app = app();
    app.insert_resource(ClearColor(Color::WHITE));
    let volume = spawn_volume(&mut app, solid(Vec3::ONE), matter(1.0, 0.0));
    let other = spawn_volume(&mut app, solid(Vec3::ONE), matter(1.0, 0.0));
    app.world_mut()
        .get_mut::<Transform>(other)
        .expect("a place")
        .translation
        .x = 50.0;
    // The plane's +y, turned to +z, points to the camera: what is nearer goes.
    let turned = Quat::from_rotation_x(std::f32::consts::FRAC_PI_2);
    let lid = Transform::from_xyz(0.0, 0.0, 0.2).with_rotation(turned);
    let plane = app.world_mut().spawn((VolumeClipPlane, lid)).id();
    let target = target(&mut app, 24, 24);
    spawn_camera(&mut app, &target, 4.0, settings(64));
    let centre = |app: &mut App| {
        finish(app);
        read(app, &target).mean([10, 10, 14, 14]).x
    };
    assert_near("0.7 m are left", centre(&mut app), (-0.7f32).exp(), 0.01);
    app.world_mut().entity_mut(plane).insert(ChildOf(volume));
    assert_near("as its child", centre(&mut app), (-0.7f32).exp(), 0.01);
    app.world_mut().entity_mut(plane).insert(ChildOf(other));
    assert_near("another volume's", centre(&mut app), (-1f32).exp(), 0.01);
    app.world_mut()
        .entity_mut(plane)
        .insert((ChildOf(volume), Visibility::Hidden));
    assert_near("hidden", centre(&mut app), (-1f32).exp(), 0.01);
}

fn fresh_frames_never_end() {
    let mut app = app();
    spawn_volume(&mut app, solid(Vec3::ONE), matter(3.0, 0.8));
    let target = target(&mut app, 24, 24);
    let fresh = VolumeRenderSettings {
        mode: VolumeRenderMode::Fresh,
        samples: 2,
        ..default()
    };
    spawn_camera(&mut app, &target, 4.0, fresh);
    while statistics(&app).samples == 0 {
        app.update();
    }
    let pictures = [0, 1].map(|_| {
        app.update();
        assert_eq!(statistics(&app).samples_per_pixel, 2);
        read(&mut app, &target)
    });
    assert_ne!(
        pictures[0].pixels, pictures[1].pixels,
        "other noise in every frame"
    );
}

/// Bevy opens another device, if the app tells it to; volumes are there again.
fn a_lost_device_is_recovered_from() {
    for mode in [VolumeRenderMode::Progressive, VolumeRenderMode::Denoised] {
        lose_a_device(mode);
    }
}

fn lose_a_device(mode: VolumeRenderMode) {
    let mut app = app();
    app.insert_resource(ClearColor(Color::WHITE));
    spawn_volume(&mut app, solid(Vec3::ONE), matter(2.0, 0.0));
    let target = target(&mut app, 24, 24);
    let settings = VolumeRenderSettings {
        mode,
        ..settings(64)
    };
    spawn_camera(&mut app, &target, 4.0, settings);
    finish(&mut app);
    let uploads = statistics(&app).uploads;
    lose_device(&mut app);
    let mut updates = 0;
    while statistics(&app).uploads == uploads {
        app.update();
        std::thread::sleep(std::time::Duration::from_millis(5));
        updates += 1;
        assert!(updates < 5000, "nothing is uploaded again");
    }
    finish(&mut app);
    let seen = read(&mut app, &target).mean([10, 10, 14, 14]).x;
    assert_near("on another device", seen, (-2f32).exp(), 0.01);
}

/// CPU time of Bevy's own threads so far, seconds: the main one's and its pools'. Those on which
/// software Vulkan draws are left out. `None` where the system doesn't tell.
fn bevy_seconds() -> Option<f64> {
    let main = std::fs::read_to_string("/proc/self/comm").ok()?;
    let mut sum = 0.0;
    for task in std::fs::read_dir("/proc/self/task").ok()?.flatten() {
        let name = std::fs::read_to_string(task.path().join("comm")).unwrap_or_default();
        if name == main || name.contains("Task Po") {
            let times = std::fs::read_to_string(task.path().join("schedstat")).ok()?;
            sum += times.split(' ').next()?.parse::<f64>().ok()? * 1e-9;
        }
    }
    Some(sum)
}

/// What the plugins add to a frame beside the kernels: systems, extraction, and the pass that lays
/// the image over the view. Frames without our plugins, and the tracer by itself, are taken off.
fn overhead() {
    const FRAMES: u32 = 20;
    // On a machine that is busy with something else, moments in which nothing is added are rare.
    const ROUNDS: [usize; 2] = [50, 500];
    const MOST: f64 = 0.5;
    let stage = |mode, medium| {
        let mut app = app();
        spawn_volume(&mut app, solid(Vec3::ONE), medium);
        let target = target(&mut app, 4, 4);
        let settings = VolumeRenderSettings {
            mode,
            ..settings(16)
        };
        spawn_camera(&mut app, &target, 4.0, settings);
        if mode == VolumeRenderMode::Progressive {
            finish(&mut app);
        }
        while statistics(&app).samples == 0 {
            app.update();
        }
        app
    };
    let mut resting = stage(VolumeRenderMode::Progressive, matter(3.0, 0.8));
    let mut tracing = stage(VolumeRenderMode::Fresh, matter(0.0, 0.8));
    // Settings bring HDR and a prepass along: all have them, ours alone differs.
    let mut without = app_with(());
    let target_without = target(&mut without, 4, 4);
    spawn_camera(&mut without, &target_without, 4.0, settings(16));
    for _ in 0..50 {
        without.update();
    }
    let mut bare = BareTracer::new();
    let dispatches = statistics(&tracing).dispatches;

    // What else the machine does can only add: the least of each is what it costs.
    let mut least = [f64::INFINITY; 4];
    let ours =
        |[without, resting, tracing, bare]: [f64; 4]| [resting - without, tracing - without - bare];
    let mut rounds = 0;
    while rounds < ROUNDS[0]
        || rounds < ROUNDS[1] && ours(least).iter().any(|&milliseconds| milliseconds >= MOST)
    {
        rounds += 1;
        let per_frame = |frame: &mut dyn FnMut()| {
            let start = bevy_seconds()?;
            for _ in 0..FRAMES {
                frame();
            }
            Some(1e3 * (bevy_seconds()? - start) / f64::from(FRAMES))
        };
        let milliseconds = [
            per_frame(&mut || without.update()),
            per_frame(&mut || resting.update()),
            per_frame(&mut || tracing.update()),
            per_frame(&mut || bare.frame()),
        ];
        for (least, milliseconds) in least.iter_mut().zip(milliseconds) {
            let Some(milliseconds) = milliseconds else {
                eprintln!("skipped: this system doesn't tell the CPU time of threads");
                return;
            };
            *least = least.min(milliseconds);
        }
    }
    let traced = statistics(&tracing).dispatches - dispatches;
    assert!(traced >= u64::from(FRAMES) * rounds as u64, "{traced}");
    let [resting, tracing] = ours(least);
    let [without, .., bare] = least;
    eprintln!(
        "{resting:.3} ms a frame at rest, {tracing:.3} ms while tracing (without {without:.3}, \
         bare tracer {bare:.3}; {rounds} rounds)"
    );
    assert!(
        resting < MOST && tracing < MOST,
        "{resting:.3}, {tracing:.3}"
    );
}

/// Traces a frame of 4 × 4 pixels as an app without Bevy would.
struct BareTracer {
    gpu: Gpu,
    tracer: FrameTracer,
    view: ViewFrame,
}

impl BareTracer {
    fn new() -> Self {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/scenes/furnace.json");
        let scene = holovol_scene::load(&path, &mut |_| {}).expect("a scene");
        let gpu = Gpu::new(None).expect("an adapter");
        let kernels = Arc::new(Kernels::new(&gpu).expect("kernels"));
        let options = TraceOptions::default();
        let volume = GpuVolume::new(&gpu, &scene.volume, options.interpolation, false);
        let environment = GpuEnvironment::new(&gpu, &scene.environment.map);
        let mut tracer = FrameTracer::new(
            &gpu,
            kernels,
            Arc::new(volume.expect("a volume")),
            Arc::new(environment.expect("light")),
            Medium::from_scene(&scene),
            options,
        )
        .expect("a tracer");
        tracer.set_views(&[[4, 4]]).expect("a view");
        tracer.wait_for_kernels();
        let mut camera = scene.camera;
        (camera.width, camera.height) = (4, 4);
        let view = ViewFrame {
            slot: 0,
            view: View::from_camera(&camera),
            samples: 1,
            max_samples: u32::MAX,
            restart: true,
            mesh_depth: None,
        };
        Self { gpu, tracer, view }
    }

    fn frame(&mut self) {
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        let recorded = self.tracer.record(&mut encoder, &[self.view], None);
        recorded.expect("a frame");
        self.gpu.queue.submit([encoder.finish()]);
        self.gpu.device.poll(PollType::Poll).expect("a device");
    }
}
