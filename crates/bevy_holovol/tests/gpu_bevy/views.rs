//! Cameras, targets and viewports that come, go and change.

use bevy::camera::visibility::RenderLayers;
use bevy::camera::{RenderTarget, Viewport};
use bevy::prelude::*;
use bevy::window::WindowRef;
use bevy_holovol::VolumeSampling;

use crate::app::*;

pub const TESTS: &[crate::Test] = &[
    (
        "a_target_that_grows_on_seldom_needs_other_room",
        a_target_that_grows,
    ),
    ("viewports_move_and_change_size", viewports_change),
    ("cameras_come_and_go", cameras_come_and_go),
    (
        "each_camera_sees_the_volumes_of_its_layers",
        each_camera_sees_its_layers,
    ),
    ("a_window_without_a_surface_harms_nothing", no_surface),
    (
        "fewer_samples_of_one_view_are_not_another_views",
        samples_of_one_view,
    ),
];

/// A black block, a quarter of the height of what a camera sees, before white.
fn stage() -> App {
    let mut app = app();
    app.insert_resource(ClearColor(Color::WHITE));
    spawn_volume(&mut app, solid(Vec3::splat(0.3)), matter(200.0, 0.0));
    app
}

fn middle_is_dark(picture: &Picture, [left, top, width, height]: [usize; 4]) -> bool {
    let [x, y] = [left + width / 2, top + height / 2];
    picture.mean([x - 1, y - 1, x + 1, y + 1]).x < 0.05
}

/// As a window does that is dragged larger.
fn a_target_that_grows() {
    let mut app = stage();
    let first = target(&mut app, 24, 24);
    let camera = spawn_camera(&mut app, &first, 4.0, settings(16));
    finish(&mut app);
    let before = statistics(&app).resizes;
    let mut last = first;
    for step in 1..=20 {
        last = target(&mut app, 24 + 2 * step, 24 + step);
        let entity = RenderTarget::Image(last.clone().into());
        app.world_mut().entity_mut(camera).insert(entity);
        app.update();
        finish(&mut app);
    }
    let resizes = statistics(&app).resizes - before;
    assert!(resizes <= 2, "other room {resizes} times");
    let picture = read(&mut app, &last);
    assert!(middle_is_dark(&picture, [0, 0, 64, 44]));
    assert_near("beside it", picture.mean([0, 0, 64, 4]).x, 1.0, 1e-3);
}

fn viewports_change() {
    let mut app = stage();
    let target = target(&mut app, 64, 48);
    let camera = spawn_camera(&mut app, &target, 4.0, settings(16));
    finish(&mut app);
    assert!(middle_is_dark(&read(&mut app, &target), [0, 0, 64, 48]));
    for [left, top, width, height] in [
        [0, 0, 32, 48],
        [32, 0, 32, 48],
        [40, 24, 24, 24],
        [3, 5, 57, 37],
        [0, 0, 64, 48],
    ] {
        let mut camera = app.world_mut().get_mut::<Camera>(camera);
        camera.as_mut().expect("a camera").viewport = Some(Viewport {
            physical_position: UVec2::new(left, top),
            physical_size: UVec2::new(width, height),
            ..default()
        });
        app.update();
        finish(&mut app);
        let picture = read(&mut app, &target);
        let place = [left, top, width, height].map(|n| n as usize);
        assert!(middle_is_dark(&picture, place), "{place:?}");
        // All that is dark lies around the middle of the viewport.
        let half = place[3] / 4;
        let [x, y] = [place[0] + place[2] / 2, place[1] + place[3] / 2];
        for (index, pixel) in picture.pixels.iter().enumerate() {
            let [dx, dy] = [(index % 64).abs_diff(x), (index / 64).abs_diff(y)];
            assert!(
                pixel[0] > 0.9 || (dx <= half && dy <= half),
                "{place:?}: dark at {} {}",
                index % 64,
                index / 64
            );
        }
    }
}

fn cameras_come_and_go() {
    let mut app = stage();
    let targets = [0, 1].map(|_| target(&mut app, 24, 24));
    // The second sees the block smaller.
    let spawn = |app: &mut App, i: usize| {
        let distance = 4.0 + 3.0 * i as f32;
        spawn_camera(app, &targets[i], distance, settings(16))
    };
    let [first, mut second] = [0, 1].map(|i| spawn(&mut app, i));
    let dark = |app: &mut App, i: usize| {
        app.update();
        finish(app);
        let picture = read(app, &targets[i]);
        picture.pixels.iter().filter(|p| p[0] < 0.05).count()
    };
    let expected = [0, 1].map(|i| dark(&mut app, i));
    assert!(
        0 < expected[1] && expected[1] < expected[0],
        "{expected:?} pixels"
    );
    let activate = |app: &mut App, is_active| {
        let mut camera = app.world_mut().get_mut::<Camera>(first);
        camera.as_mut().expect("a camera").is_active = is_active;
    };
    for _ in 0..2 {
        app.world_mut().despawn(second);
        assert_eq!(dark(&mut app, 0), expected[0], "alone");
        second = spawn(&mut app, 1);
        activate(&mut app, false);
        assert_eq!(dark(&mut app, 1), expected[1], "while the other is off");
        activate(&mut app, true);
        assert_eq!([0, 1].map(|i| dark(&mut app, i)), expected, "both again");
    }
}

/// One volume for each of two cameras, where the other has nothing.
fn each_camera_sees_its_layers() {
    let mut app = app();
    app.insert_resource(ClearColor(Color::WHITE));
    let targets = [1, 2].map(|layer| {
        let volume = spawn_volume(&mut app, solid(Vec3::splat(0.3)), matter(200.0, 0.0));
        let place = Transform::from_xyz(0.4 * (2.0 * layer as f32 - 3.0), 0.0, 0.0);
        let target = target(&mut app, 48, 24);
        let camera = spawn_camera(&mut app, &target, 4.0, settings(16));
        let layers = RenderLayers::layer(layer);
        app.world_mut()
            .entity_mut(volume)
            .insert((place, layers.clone()));
        app.world_mut().entity_mut(camera).insert(layers);
        target
    });
    finish(&mut app);
    for (own, target) in targets.iter().enumerate() {
        let picture = read(&mut app, target);
        // 1.2 m are 24 pixels high: ±0.4 m lie 8 pixels from the middle.
        for (side, place) in [[12, 8, 8, 8], [28, 8, 8, 8]].into_iter().enumerate() {
            assert_eq!(middle_is_dark(&picture, place), side == own, "{own} {side}");
        }
    }
}

/// As windows are that have just been opened, or are minimised.
fn no_surface() {
    let mut app = stage();
    let window = Window {
        visible: false,
        ..default()
    };
    let window = app.world_mut().spawn(window).id();
    let target = target(&mut app, 24, 24);
    let to_window = spawn_camera(&mut app, &target, 4.0, settings(16));
    let windowed = RenderTarget::Window(WindowRef::Entity(window));
    app.world_mut().entity_mut(to_window).insert(windowed);
    spawn_camera(&mut app, &target, 4.0, settings(16));
    finish(&mut app);
    let all = [0, 0, 24, 24];
    assert!(middle_is_dark(&read(&mut app, &target), all));
    app.world_mut()
        .get_mut::<Window>(window)
        .expect("a window")
        .resolution
        .set(1.0, 1.0);
    finish(&mut app);
    app.world_mut().despawn(window);
    for _ in 0..3 {
        app.update();
    }
    assert!(middle_is_dark(&read(&mut app, &target), all));
}

/// As of a window beside a headset that saves samples, whose images are smaller.
fn samples_of_one_view() {
    let mut app = stage();
    let small = target(&mut app, 24, 24);
    let eye = spawn_camera(&mut app, &small, 4.0, settings(16));
    let sampling = VolumeSampling {
        fovea: 0.1,
        far: 0.2,
        periphery: 0.25,
        ..default()
    };
    app.world_mut().entity_mut(eye).insert(sampling);
    let large = target(&mut app, 96, 96);
    spawn_camera(&mut app, &large, 4.0, settings(16));
    finish(&mut app);
    assert!(middle_is_dark(&read(&mut app, &small), [0, 0, 24, 24]));
    assert!(middle_is_dark(&read(&mut app, &large), [0, 0, 96, 96]));
}
