//! How sessions begin, end, and are lost.

use std::sync::atomic::{AtomicBool, Ordering};

use bevy::ecs::change_detection::Tick;
use bevy::prelude::*;
use bevy::render::error_handler::{RenderErrorHandler, RenderErrorPolicy};
use bevy::render::render_resource::PollType;
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy_holovol::VolumeStatistics;
use bevy_holovol::prelude::*;
use bevy_holovol::xr::{
    FieldOfView, FrameCost, HeadsetBlend, HeadsetRequest, HeadsetState, MixedRealitySettings,
    RawView, RefusedDevices, TamperedViews, queue_submissions,
};

use crate::SIMULATION;
use crate::allocations;
use crate::app::*;

pub const TESTS: &[crate::Test] = &[
    (
        "three_hundred_frames_and_a_clean_stop_twice_in_one_process",
        three_hundred_frames_twice,
    ),
    (
        "a_session_can_be_started_again_in_one_app",
        a_session_can_be_started_again,
    ),
    (
        "a_dead_runtime_is_reconnected_to",
        a_dead_runtime_is_reconnected_to,
    ),
    (
        "a_runtime_that_wants_another_device_gets_it",
        another_device,
    ),
    (
        "a_runtime_that_refuses_its_own_device_gets_no_further_ones",
        endless_refusal,
    ),
    (
        "a_handler_inserted_in_every_frame_is_not_asked_about_our_change_of_device",
        answered_by_the_app,
    ),
    (
        "a_lost_device_is_replaced_by_one_of_the_runtime",
        lost_device,
    ),
    (
        "workers_and_the_runtime_take_turns_at_the_queue",
        shared_queue,
    ),
    (
        "unusable_views_draw_nothing_and_harm_nothing",
        unusable_views,
    ),
    (
        "a_frame_takes_one_and_a_half_milliseconds_at_most_and_allocates_nothing",
        overhead,
    ),
];

fn with_volume(settings: MixedRealitySettings) -> App {
    let mut app = app(settings);
    let place = Transform::from_xyz(0.0, 1.6, -1.0);
    let matter = function(20.0, [0.8; 3]);
    spawn_volume(&mut app, solid(Vec3::splat(0.3)), matter, place);
    app
}

#[track_caller]
fn stop(app: &mut App) {
    app.world_mut().write_message(HeadsetRequest::Stop);
    run_until(app, "ended", |app| status(app).state == HeadsetState::Ended);
}

fn three_hundred_frames_twice() {
    for _ in 0..2 {
        let mut app = with_volume(settings());
        show(&mut app);
        let begin = status(&app);
        assert_eq!(begin.blend, HeadsetBlend::Opaque, "Monado's only one");
        assert!(begin.is_tracked);
        let dispatches = app.world().resource::<VolumeStatistics>().get().dispatches;
        for frame in 1..=300 {
            app.update();
            let now = status(&app);
            assert_eq!(now.frames, begin.frames + frame);
            assert_eq!(now.state, HeadsetState::Focused);
            assert_eq!(now.problem, None);
        }
        let statistics = app.world().resource::<VolumeStatistics>().get();
        assert!(
            statistics.dispatches >= dispatches + 300,
            "traced each time"
        );
        assert_eq!(statistics.counters, default());
        assert_eq!(status(&app).sessions, 1);
        stop(&mut app);
        let frames = status(&app).frames;
        for _ in 0..3 {
            app.update();
        }
        assert_eq!(status(&app).frames, frames, "no frames without a session");
    }
}

fn a_session_can_be_started_again() {
    let mut app = with_volume(settings());
    show(&mut app);
    stop(&mut app);
    app.world_mut().write_message(HeadsetRequest::Start);
    focus(&mut app);
    assert_eq!(status(&app).sessions, 2);
    assert_eq!(status(&app).reconnections, 0);
    stop(&mut app);
}

fn kill(app: &mut App) {
    let mut simulation = SIMULATION.lock().expect("no panic");
    simulation.as_mut().expect("a service").kill();
    run_until(app, "lost", |app| status(app).state == HeadsetState::Lost);
}

fn revive() {
    let mut simulation = SIMULATION.lock().expect("no panic");
    let simulation = simulation.as_mut().expect("a service");
    simulation.restart().expect("it starts again");
}

#[track_caller]
fn assert_drawn(app: &mut App) {
    let frame = capture(app);
    for eye in 0..2 {
        // Neither black nor the sky.
        let is_grey = |pixel: &&[f32; 4]| (0.1..0.9).contains(&pixel[0]);
        let grey = linear(&frame, eye).iter().filter(is_grey).count();
        assert!(grey > 1000, "the volume is drawn: {grey}");
    }
}

fn a_dead_runtime_is_reconnected_to() {
    let mut app = with_volume(settings());
    show(&mut app);
    kill(&mut app);
    assert!(status(&app).problem.is_some());
    // The app goes on, and looks for the runtime in vain.
    for _ in 0..300 {
        app.update();
    }
    assert_eq!(status(&app).state, HeadsetState::Lost);
    revive();
    show(&mut app);
    let now = status(&app);
    assert_eq!((now.reconnections, now.sessions), (1, 2));
    assert_eq!((now.device_changes, now.problem), (0, None));
    assert_drawn(&mut app);
    stop(&mut app);
}

fn device(app: &App) -> RenderDevice {
    app.world().resource::<RenderDevice>().clone()
}

/// When Bevy got it.
fn device_tick(app: &App) -> Tick {
    let device = app.world().get_resource_ref::<RenderDevice>();
    device.expect("a device").last_changed()
}

/// Where a piece of metal hangs, above the volume.
const MESH: Vec3 = Vec3::new(0.0, 2.0, -1.0);

fn spawn_mesh(app: &mut App) {
    let world = app.world_mut();
    let mesh = Rectangle::new(0.2, 0.2);
    let mesh = world.resource_mut::<Assets<Mesh>>().add(mesh);
    let metal = StandardMaterial {
        base_color: LinearRgba::gray(0.5).into(),
        metallic: 1.0,
        ..default()
    };
    let metal = world.resource_mut::<Assets<StandardMaterial>>().add(metal);
    let place = Transform::from_translation(MESH);
    world.spawn((Mesh3d(mesh), MeshMaterial3d(metal), place));
}

/// White sky, and what metal reflects of it: by our maps, and by a table that Bevy moves to the device
/// and forgets.
#[track_caller]
fn wait_for_light(app: &mut App) {
    let mut seen = [0.0; 2];
    for _ in 0..200 {
        let frame = capture(app);
        let picture = linear(&frame, 1);
        let [x, y] = project(&frame.views[1], frame.size, MESH).map(|c| c as usize);
        seen = [0, x + frame.size[0] as usize * y].map(|pixel| picture[pixel][0]);
        if seen[0] > 0.95 && (seen[1] - 0.5).abs() < 0.04 {
            return;
        }
    }
    panic!("sky and mesh: {seen:?}");
}

/// Monado has but one device; that of the former instance counts as another than it wants.
fn another_device() {
    let mut app = with_volume(MixedRealitySettings {
        refused_devices: RefusedDevices::OfFormerRuntimes,
        ..settings()
    });
    spawn_mesh(&mut app);
    let mut environment = app.world_mut().resource_mut::<VolumeEnvironment>();
    (environment.is_sky, environment.lights_meshes) = (true, true);
    show(&mut app);
    wait_for_light(&mut app);
    // Twice: as well from a device that Bevy was handed.
    for changes in 1..=2 {
        let former = device_tick(&app);
        kill(&mut app);
        revive();
        run_until(&mut app, "on another device", |app| {
            status(app).device_changes == changes
        });
        assert_ne!(device_tick(&app), former);
        show(&mut app);
        let now = status(&app);
        assert_eq!((now.reconnections, now.sessions), (changes, changes + 1));
        assert_eq!((now.device_changes, now.problem), (changes, None));
        wait_for_light(&mut app);
        assert_drawn(&mut app);
    }
    // Where that isn't wanted the headset stays dark, and says why.
    let former = device_tick(&app);
    kill(&mut app);
    let mut settings = app.world_mut().resource_mut::<MixedRealitySettings>();
    settings.may_replace_device = false;
    revive();
    run_until(&mut app, "refused", |app| {
        let problem = status(app).problem;
        problem.is_some_and(|problem| problem.contains("another graphics device"))
    });
    assert_eq!(device_tick(&app), former);
}

/// It would answer that Bevy should open a device of its own, on which nobody waits.
fn answered_by_the_app() {
    let mut app = with_volume(MixedRealitySettings {
        refused_devices: RefusedDevices::OfFormerRuntimes,
        ..settings()
    });
    app.add_systems(Update, |mut commands: Commands| {
        commands.insert_resource(RenderErrorHandler(|_, _, _| {
            RenderErrorPolicy::Recover(default())
        }));
    });
    show(&mut app);
    kill(&mut app);
    revive();
    run_until(&mut app, "on another device", |app| {
        status(app).device_changes == 1
    });
    show(&mut app);
    assert_eq!(status(&app).problem, None);
    assert_drawn(&mut app);
    stop(&mut app);
}

/// Bevy begins anew a few times, not at every look for the runtime; later sessions open all the same.
fn endless_refusal() {
    let mut app = with_volume(settings());
    show(&mut app);
    let refuse = |app: &mut App, refused| {
        let mut settings = app.world_mut().resource_mut::<MixedRealitySettings>();
        settings.refused_devices = refused;
    };
    kill(&mut app);
    refuse(&mut app, RefusedDevices::All);
    revive();
    run_until(&mut app, "refused for good", |app| {
        status(app).device_changes >= 3
    });
    // It is looked for every second.
    let start = std::time::Instant::now();
    while start.elapsed().as_secs() < 5 {
        app.update();
    }
    let now = status(&app);
    assert_eq!((now.device_changes, now.reconnections), (3, 0));
    assert!(now.problem.is_some());
    refuse(&mut app, RefusedDevices::None);
    show(&mut app);
    let now = status(&app);
    assert_eq!((now.device_changes, now.reconnections), (3, 1));
    assert_eq!(now.problem, None);
    assert_drawn(&mut app);
    stop(&mut app);
}

/// What Bevy then opens by itself isn't one that the runtime could use.
fn lost_device() {
    let mut app = with_volume(settings());
    app.insert_resource(RenderErrorHandler(|_, _, _| {
        RenderErrorPolicy::Recover(default())
    }));
    show(&mut app);
    let former = device(&app);
    former.poll(PollType::wait_indefinitely()).expect("polled");
    former.wgpu_device().destroy();
    former.poll(PollType::wait_indefinitely()).expect("polled");
    run_until(&mut app, "on another device", |app| {
        status(app).device_changes == 1
    });
    show(&mut app);
    assert_eq!(status(&app).problem, None);
    assert_drawn(&mut app);
    stop(&mut app);
}

fn shared_queue() {
    let mut app = with_volume(settings());
    show(&mut app);
    let queue = app.world().resource::<RenderQueue>().clone();
    let is_done = AtomicBool::new(false);
    let before = queue_submissions();
    let submitted = std::thread::scope(|scope| {
        let worker = scope.spawn(|| {
            let mut submitted = 0;
            while !is_done.load(Ordering::Relaxed) {
                queue.submit([]);
                submitted += 1;
            }
            submitted
        });
        for _ in 0..60 {
            app.update();
        }
        is_done.store(true, Ordering::Relaxed);
        worker.join().expect("no panic")
    });
    let counted = queue_submissions() - before;
    eprintln!("{submitted} submissions of a worker during 60 frames");
    assert!(submitted > 60, "{submitted}");
    // The frames' own as well: all of wgpu's way to the queue is guarded.
    assert!(counted >= submitted + 60, "{counted} of {submitted}");
    assert_eq!(status(&app).state, HeadsetState::Focused);
    assert_eq!(status(&app).problem, None);
    stop(&mut app);
}

/// Late at first, and then a different kind of garbage in every frame.
fn spoil(time: i64, view: &mut RawView) {
    use std::sync::atomic::AtomicU32;
    static CALLS: AtomicU32 = AtomicU32::new(0);
    let call = CALLS.fetch_add(1, Ordering::Relaxed);
    assert!(time > 0);
    if call < 40 {
        (view.orientation, view.position) = (None, None);
        return;
    }
    let flat = FieldOfView {
        left: 0.0,
        right: 0.0,
        up: 0.0,
        down: 0.0,
    };
    match call % 7 {
        0 => view.orientation = Some([f32::NAN; 4]),
        1 => view.orientation = Some([0.0; 4]),
        2 => view.position = Some([f32::NAN, 0.0, f32::INFINITY]),
        3 => view.fov = flat,
        4 => view.fov.left = f32::NAN,
        5 => (view.orientation, view.position) = (None, None),
        _ => {}
    }
}

fn unusable_views() {
    let mut app = with_volume(MixedRealitySettings {
        tampered_views: Some(TamperedViews(spoil)),
        ..settings()
    });
    // Neither what NaN becomes in 8 bits nor the volume.
    let grey = 0.25;
    app.insert_resource(ClearColor(Color::linear_rgb(grey, grey, grey)));
    show(&mut app);
    for _ in 0..60 {
        app.update();
        let now = status(&app);
        assert_eq!(now.state, HeadsetState::Focused, "{:?}", now.problem);
    }
    let frame = capture(&mut app);
    for eye in 0..2 {
        assert!(frame.views[eye].pose.rotation.is_normalized());
        assert!(frame.views[eye].fov.is_usable());
        let picture = linear(&frame, eye);
        let seen = picture.iter().filter(|p| (p[0] - grey).abs() > 0.05);
        assert!(seen.count() > 100, "the volume is drawn");
        // The sides see none of it.
        let corner = picture[0];
        assert!((corner[0] - grey).abs() < 0.01, "{corner:?}");
    }
    let counters = app.world().resource::<VolumeStatistics>().get().counters;
    assert_eq!(counters.nonfinite_samples, 0);
    stop(&mut app);
}

/// CPU time of the headset's systems, both worlds'.
fn overhead() {
    const FRAMES: u32 = 200;
    let mut app = with_volume(settings());
    show(&mut app);
    let cost = app.world().resource::<FrameCost>().clone();
    // What is made once is made.
    for _ in 0..20 {
        app.update();
    }
    cost.measure();
    let allocations = allocations::made();
    for _ in 0..FRAMES {
        app.update();
    }
    let [ours, driver] = allocations::made_since(allocations).map(|n| n as f64 / f64::from(FRAMES));
    eprintln!("{ours} allocations of our systems a frame, {driver} of what they make wgpu do");
    assert_eq!(ours, 0.0);
    assert!(driver < 200.0, "{driver}");
    let Some(nanoseconds) = cost.nanoseconds() else {
        eprintln!("no bound on time: this system doesn't tell the CPU time of threads");
        if cfg!(target_os = "linux") {
            panic!("Linux does");
        }
        stop(&mut app);
        return;
    };
    let ms = 1e-6 * nanoseconds as f64 / f64::from(FRAMES);
    eprintln!("{ms:.3} ms of CPU time a frame");
    assert!(ms > 0.01, "nothing was measured");
    assert!(ms < 1.5, "{ms} ms");
    stop(&mut app);
}
