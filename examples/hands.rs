//! A mouse as the hand that takes a volume: its box and handles, as in a headset. The right button
//! puts a cutting plane where the volume is, which can be taken, too.

use bevy::prelude::*;
use bevy_holovol::interaction::{
    InteractionMarksPlugin, InteractionPlugin, PointerHand, PointerHandPlugin,
};
use bevy_holovol::prelude::*;

fn main() -> AppExit {
    App::new()
        .add_plugins((
            DefaultPlugins,
            HolovolPlugins,
            InteractionPlugin,
            InteractionMarksPlugin,
            PointerHandPlugin,
        ))
        .insert_resource(VolumeEnvironment::from_radiance(LinearRgba::rgb(
            0.6, 0.7, 1.0,
        )))
        .add_systems(Startup, setup)
        .add_systems(First, point)
        .add_systems(Update, put_plane)
        .run()
}

fn setup(mut commands: Commands, assets: Res<AssetServer>) {
    commands.spawn((
        Volume3d(assets.load("head.nrrd")),
        VolumeMaterial3d(assets.load("head.tf.json")),
        Graspable::default(),
    ));
    commands.spawn((
        Camera3d::default(),
        VolumeRenderSettings {
            mode: VolumeRenderMode::Denoised,
            ..default()
        },
        Transform::from_xyz(0.3, 0.2, 0.6).looking_at(Vec3::ZERO, Vec3::Y),
    ));
}

/// The ray under the cursor.
fn point(
    window: Single<&Window>,
    camera: Single<(&Camera, &GlobalTransform), With<Camera3d>>,
    buttons: Res<ButtonInput<MouseButton>>,
    mut hand: ResMut<PointerHand>,
) {
    let (camera, transform) = *camera;
    let cursor = window.cursor_position();
    hand.ray = cursor.and_then(|at| camera.viewport_to_world(transform, at).ok());
    hand.is_pressed = buttons.pressed(MouseButton::Left);
}

fn put_plane(
    mut commands: Commands,
    buttons: Res<ButtonInput<MouseButton>>,
    volume: Single<&Transform, With<Volume3d>>,
    planes: Query<Entity, With<VolumeClipPlane>>,
) {
    if !buttons.just_pressed(MouseButton::Right) {
        return;
    }
    for plane in &planes {
        commands.entity(plane).despawn();
    }
    if planes.is_empty() {
        let tilted = Transform::from_translation(volume.translation)
            .with_rotation(Quat::from_rotation_z(-0.7));
        let handle = bevy::camera::primitives::Aabb {
            half_extents: Vec3::splat(0.06).into(),
            ..default()
        };
        let graspable = Graspable {
            has_handles: false,
            ..default()
        };
        commands.spawn((VolumeClipPlane, tilted, graspable, handle));
    }
}
