use super::pieces::{AT_HAND, BEFORE_HAND, CORNER, LINE};
use super::*;
use crate::interaction::{InteractionPlugin, PointerHand, PointerHandPlugin};

fn app() -> App {
    let mut app = App::new();
    app.add_plugins((
        MinimalPlugins,
        AssetPlugin::default(),
        TransformPlugin,
        InteractionPlugin,
        InteractionMarksPlugin,
    ))
    .init_asset::<Mesh>()
    .init_asset::<StandardMaterial>();
    app
}

fn set(app: &mut App, hand: Hand) {
    app.insert_resource(Hands([Hand::default(), hand]));
    app.update();
}

/// Those that are seen.
fn marks(app: &mut App) -> Vec<Transform> {
    let mut marks = app
        .world_mut()
        .query_filtered::<(&Transform, &Visibility), With<Mark>>();
    let marks = marks.iter(app.world());
    let seen = marks.filter(|(_, visibility)| **visibility != Visibility::Hidden);
    seen.map(|(transform, _)| *transform).collect()
}

fn thing(app: &mut App) -> Entity {
    let aabb = Aabb {
        half_extents: Vec3::splat(0.1).into(),
        ..default()
    };
    let place = Transform::from_xyz(0.0, 1.0, -1.0).with_scale(Vec3::splat(2.0));
    app.world_mut()
        .spawn((Graspable::default(), aabb, place))
        .id()
}

fn at(place: Vec3) -> Hand {
    Hand {
        grip: Some(Isometry3d::from_translation(place)),
        ..default()
    }
}

#[test]
fn without_hands_nothing_is_made() {
    let mut app = app();
    thing(&mut app);
    app.update();
    assert_eq!(marks(&mut app), []);
    assert_eq!(app.world().resource::<Assets<Mesh>>().len(), 0);
}

#[test]
fn the_box_under_a_hand_is_drawn_outside_it_and_goes_with_the_hand() {
    let mut app = app();
    thing(&mut app);
    let corner = Vec3::new(0.2, 1.2, -0.8);
    set(&mut app, at(corner));
    let seen = marks(&mut app);
    // The hand, 12 edges, 20 handles.
    assert_eq!(seen.len(), 33);
    for mark in seen.iter().filter(|mark| mark.translation != corner) {
        let (middle, half) = (mark.translation, 0.5 * mark.scale);
        let apart = (middle - Vec3::new(0.0, 1.0, -1.0)).abs() - half;
        assert!(apart.max_element() > 0.2, "{mark:?}");
    }
    let largest = |app: &mut App| {
        let sizes = marks(app).into_iter().map(|mark| mark.scale.min_element());
        sizes.fold(0.0, f32::max)
    };
    assert!((largest(&mut app) - AT_HAND * CORNER).abs() < 1e-6);
    set(&mut app, at(Vec3::new(0.0, 5.0, 0.0)));
    assert_eq!(marks(&mut app).len(), 1, "the hand only");
    set(&mut app, Hand::default());
    assert_eq!(marks(&mut app), []);
}

#[test]
fn rays_end_at_what_they_point_at() {
    let mut app = app();
    let ray = |app: &mut App| -> f32 {
        let marks = marks(app);
        let lengths = marks
            .iter()
            .filter(|m| m.scale.x == LINE && m.scale.y == LINE);
        lengths.map(|mark| mark.scale.z).fold(0.0, f32::max)
    };
    let pointing = Hand {
        aim: Some(Isometry3d::from_xyz(0.0, 1.0, 0.0)),
        ..default()
    };
    set(&mut app, pointing);
    assert!((ray(&mut app) - (RAY - BEFORE_HAND)).abs() < 1e-6);
    app.world_mut().spawn((
        TouchPanel::new(Vec2::splat(0.2)),
        GlobalTransform::from_xyz(0.0, 1.0, -3.0),
    ));
    set(&mut app, pointing);
    assert!((ray(&mut app) - (3.0 - BEFORE_HAND)).abs() < 1e-5);
    set(&mut app, Hand::default());
    assert_eq!(ray(&mut app), 0.0);
}

#[test]
fn a_plane_has_its_square_in_hand_and_after() {
    let mut app = app();
    let plane = (
        VolumeClipPlane,
        HandPlane::new(1),
        InheritedVisibility::VISIBLE,
    );
    let plane = app.world_mut().spawn(plane).id();
    set(&mut app, at(Vec3::Y));
    assert_eq!(marks(&mut app).len(), 1 + 5);
    // A pinch puts it down, and the hand goes.
    let pinched = Hand {
        squeeze: 1.0,
        ..at(Vec3::Y)
    };
    set(&mut app, pinched);
    set(&mut app, Hand::default());
    assert!(app.world().get::<HandPlane>(plane).is_none());
    assert_eq!(marks(&mut app).len(), 5);
    app.world_mut().despawn(plane);
    app.update();
    assert_eq!(marks(&mut app), []);
}

#[test]
fn a_mouse_has_the_same() {
    let mut app = app();
    app.add_plugins(PointerHandPlugin);
    thing(&mut app);
    app.insert_resource(PointerHand {
        ray: Some(Ray3d::new(Vec3::Y, Dir3::NEG_Z)),
        is_pressed: false,
    });
    app.update();
    // The box, the ray and its end.
    assert_eq!(marks(&mut app).len(), 32 + 2);
}

#[test]
fn the_menu_has_its_buttons_and_icons() {
    let mut app = app();
    app.init_resource::<CurrentMenu>();
    let icon = app
        .world_mut()
        .resource_mut::<Assets<Mesh>>()
        .add(Rectangle::default());
    app.insert_resource(MenuFace {
        icons: [Some(icon.clone()), None, Some(icon)],
        ..default()
    });
    let eyes = Vec3::new(0.0, 1.6, 0.0);
    app.insert_resource(crate::interaction::Viewer(Some(
        Isometry3d::from_translation(eyes),
    )));
    let place = Vec3::new(-0.1, 1.5, -0.4);
    let palm = Quat::from_rotation_arc(Vec3::X, (eyes - place).normalize());
    let left = Hand {
        grip: Some(Isometry3d::new(place, palm)),
        ..default()
    };
    app.insert_resource(Hands([left, Hand::default()]));
    app.insert_resource(bevy::time::TimeUpdateStrategy::ManualDuration(
        std::time::Duration::from_millis(50),
    ));
    for _ in 0..12 {
        app.update();
    }
    // The hand, the plate, three buttons, two icons.
    assert_eq!(marks(&mut app).len(), 1 + 1 + 3 + 2);
}
