//! Four cameras in one window: one dispatch traces all of them.

use bevy::camera::Viewport;
use bevy::prelude::*;
use bevy_holovol::prelude::*;

/// Which quarter of the window a camera fills, from the top left.
#[derive(Component)]
struct Quarter(UVec2);

fn main() -> AppExit {
    App::new()
        .add_plugins((DefaultPlugins, HolovolPlugins))
        .add_systems(Startup, setup)
        .add_systems(Update, place)
        .run()
}

fn setup(mut commands: Commands, assets: Res<AssetServer>) {
    commands.spawn((
        Volume3d(assets.load("head.nrrd")),
        VolumeMaterial3d(assets.load("head.tf.json")),
    ));
    let eyes = [Vec3::Z, Vec3::X, Vec3::Y, Vec3::new(0.6, 0.4, 0.7)];
    for (i, eye) in (0..).zip(eyes) {
        let up = if eye == Vec3::Y { Vec3::NEG_Z } else { Vec3::Y };
        commands.spawn((
            Camera3d::default(),
            Camera {
                order: i,
                clear_color: if i == 0 {
                    default()
                } else {
                    ClearColorConfig::None
                },
                ..default()
            },
            Quarter(UVec2::new(i as u32 % 2, i as u32 / 2)),
            VolumeRenderSettings::default(),
            Transform::from_translation(0.55 * eye).looking_at(Vec3::ZERO, up),
        ));
    }
}

fn place(windows: Query<&Window, Changed<Window>>, mut cameras: Query<(&Quarter, &mut Camera)>) {
    for window in &windows {
        let size = (window.physical_size() / 2).max(UVec2::ONE);
        for (quarter, mut camera) in &mut cameras {
            camera.viewport = Some(Viewport {
                physical_position: quarter.0 * size,
                physical_size: size,
                ..default()
            });
        }
    }
}
