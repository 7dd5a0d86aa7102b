//! Meshes among volumes, and the depth that the compositor gets.

use bevy::prelude::*;
use bevy_holovol::xr::{CapturedFrame, EyeView, HeadsetState, MixedRealitySettings};

use crate::app::*;

pub const TESTS: &[crate::Test] = &[
    (
        "meshes_hide_volumes_and_are_seen_through_them_in_both_eyes",
        meshes_hide_and_are_seen_through,
    ),
    (
        "submitted_depth_is_the_distance",
        submitted_depth_is_the_distance,
    ),
    ("depth_can_be_left_out", depth_can_be_left_out),
];

/// 1/m, of a volume that only absorbs.
const SIGMA: f32 = 4.0;
/// The volume's middle and size, m; the simulated head is 1.6 m above the floor.
const MIDDLE: Vec3 = Vec3::new(0.0, 1.6, -1.0);
const SIZE: Vec3 = Vec3::new(0.5, 0.4, 0.3);
const BOX: f32 = 0.06;

fn spawn_box(app: &mut App, at: Vec3) -> Entity {
    let mut meshes = app.world_mut().resource_mut::<Assets<Mesh>>();
    let mesh = meshes.add(Cuboid::from_length(BOX));
    let mut materials = app.world_mut().resource_mut::<Assets<StandardMaterial>>();
    let material = materials.add(StandardMaterial {
        base_color: Color::WHITE,
        unlit: true,
        ..default()
    });
    let place = Transform::from_translation(at);
    let parts = (Mesh3d(mesh), MeshMaterial3d(material), place);
    app.world_mut().spawn(parts).id()
}

/// Of a box, what faces the user.
fn face(at: Vec3) -> Vec3 {
    at + Vec3::Z * (BOX / 2.0)
}

/// m of volume before a point, as an eye sees it.
fn covered(view: &EyeView, point: Vec3) -> f32 {
    let eye = Vec3::from(view.pose.translation);
    let at_z = |z: f32| eye + (point - eye) * ((z - eye.z) / (point.z - eye.z));
    let (front, back) = (MIDDLE.z + SIZE.z / 2.0, MIDDLE.z - SIZE.z / 2.0);
    if point.z >= front {
        return 0.0;
    }
    at_z(front).distance(at_z(point.z.max(back)))
}

/// Mean of 5 × 5 pixels around a point.
fn brightness(frame: &CapturedFrame, eye: usize, point: Vec3) -> f32 {
    let picture = linear(frame, eye);
    let [x, y] = project(&frame.views[eye], frame.size, point).map(|n| n as usize);
    let pixels = (y - 2..=y + 2).flat_map(|y| (x - 2..=x + 2).map(move |x| (x, y)));
    let sum: f32 = pixels
        .map(|(x, y)| picture[y * frame.size[0] as usize + x][0])
        .sum();
    sum / 25.0
}

fn meshes_hide_and_are_seen_through() {
    let mut settings = settings();
    settings.render.samples = 64;
    let mut app = app(settings);
    let place = Transform::from_translation(MIDDLE);
    spawn_volume(
        &mut app,
        solid(SIZE),
        function(f64::from(SIGMA), [0.0; 3]),
        place,
    );
    // Before it, in it at two depths, behind it.
    let places = [
        Vec3::new(-0.1, 1.55, -0.7),
        Vec3::new(0.12, 1.68, -0.93),
        Vec3::new(-0.12, 1.68, -1.05),
        Vec3::new(0.12, 1.52, -1.3),
    ];
    for at in places {
        spawn_box(&mut app, at);
    }
    show(&mut app);
    let frame = capture(&mut app);
    for eye in 0..2 {
        let found = places.map(|at| brightness(&frame, eye, face(at)));
        let expected = places.map(|at| (-SIGMA * covered(&frame.views[eye], face(at))).exp());
        eprintln!("eye {eye}: {found:.3?}, expected {expected:.3?}");
        for (found, expected) in found.into_iter().zip(expected) {
            assert!((found - expected).abs() < 0.02, "{found}, {expected}");
        }
        assert_eq!(expected[0], 1.0);
        assert!(expected[1] > expected[2] + 0.2 && expected[2] > expected[3] + 0.1);
    }
    // The other eye's places are elsewhere: what was looked at was each eye's own.
    let [left, right] = [0, 1].map(|eye: usize| {
        let [x, _] = project(&frame.views[eye], frame.size, face(places[0]));
        x
    });
    assert!(left - right > 8.0, "{left} {right}");
}

/// m along the eye's axis.
fn axial(view: &EyeView, point: Vec3) -> f32 {
    let in_eye = world_from_eye(view)
        .inverse()
        .transform_point3(point.as_dvec3());
    -in_eye.z as f32
}

/// What the compositor takes the pixel at a point for.
fn depth_at(frame: &CapturedFrame, eye: usize, point: Vec3) -> f32 {
    let [x, y] = project(&frame.views[eye], frame.size, point).map(|n| n as usize);
    let depths = frame.depths.as_ref().expect("depth");
    depths[eye][y * frame.size[0] as usize + x]
}

fn submitted_depth_is_the_distance() {
    let mut app = app(settings());
    // Nearly all light is absorbed within 1 mm; a fog that holds back 20 % within 0.3 m; a faint one
    // of 3 %; and meshes: before the first, in the fog, behind the faint one.
    let dense = Vec3::new(0.0, 1.6, -1.0);
    let fog = Vec3::new(-0.35, 1.6, -1.2);
    let faint = Vec3::new(0.35, 1.6, -1.2);
    let size = Vec3::new(0.2, 0.2, 0.3);
    for (middle, sigma) in [(dense, 4000.0), (fog, 0.744), (faint, 0.1)] {
        let place = Transform::from_translation(middle);
        spawn_volume(&mut app, solid(size), function(sigma, [0.5; 3]), place);
    }
    let before = Vec3::new(0.05, 1.57, -0.8);
    let within = Vec3::new(-0.38, 1.65, -1.06);
    let behind = Vec3::new(0.38, 1.57, -1.6);
    for at in [before, within, behind] {
        spawn_box(&mut app, at);
    }
    show(&mut app);
    run_until(&mut app, "all traced", |app| {
        let statistics = app.world().resource::<bevy_holovol::VolumeStatistics>();
        !statistics.get().is_waiting
    });
    let frame = capture(&mut app);
    assert!(status(&app).has_depth_layer);
    for eye in 0..2 {
        let view = &frame.views[eye];
        let check = |what: &str, point: Vec3, expected: f32, tolerance: f32| {
            let found = depth_at(&frame, eye, point);
            eprintln!("eye {eye}, {what}: {found:.4} m, expected {expected:.4} m");
            assert!(
                (found - expected).abs() < tolerance,
                "{what}: {found}, {expected}"
            );
        };
        for at in [before, behind] {
            check("a mesh", face(at), axial(view, face(at)), 1e-3);
        }
        let front = dense + Vec3::new(-0.04, 0.03, size.z / 2.0);
        check("a dense volume", front, axial(view, front), 2e-3);
        // Absorption grows weaker with depth: its mean is a little before the middle.
        let sigma = 0.744 * size.z;
        let part = 1.0 / sigma - 1.0 / (sigma.exp() - 1.0);
        let mean = fog + Vec3::new(0.02, -0.05, (0.5 - part) * size.z);
        check("a fog", mean, axial(view, mean), 6e-3);
        // Before that mesh too little of the fog lies to have a depth.
        check(
            "a mesh in a fog",
            face(within),
            axial(view, face(within)),
            1e-3,
        );
        let nothing = Vec3::new(0.28, 1.62, -1.05);
        assert_eq!(depth_at(&frame, eye, nothing), f32::INFINITY, "too faint");
        assert_eq!(
            depth_at(&frame, eye, Vec3::new(0.0, 1.9, -1.0)),
            f32::INFINITY
        );
    }
    let before = status(&app).frames;
    for _ in 0..5 {
        app.update();
    }
    let now = status(&app);
    assert_eq!(
        (now.state, now.problem),
        (HeadsetState::Focused, None),
        "it is taken"
    );
    assert_eq!(now.frames, before + 5);
}

fn depth_can_be_left_out() {
    let mut app = app(MixedRealitySettings {
        has_depth_layer: false,
        ..settings()
    });
    let place = Transform::from_translation(MIDDLE);
    spawn_volume(&mut app, solid(SIZE), function(20.0, [0.5; 3]), place);
    show(&mut app);
    assert!(!status(&app).has_depth_layer);
    assert_eq!(capture(&mut app).depths, None);
}
