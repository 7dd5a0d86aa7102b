//! A metal ring that turns through a volume: each hides what is behind it, in the same light.

use bevy::prelude::*;
use bevy_holovol::prelude::*;

#[derive(Component)]
struct Ring;

fn main() -> AppExit {
    App::new()
        .add_plugins((DefaultPlugins, HolovolPlugins))
        .insert_resource(VolumeEnvironment::from_radiance(LinearRgba::rgb(
            0.9, 0.8, 0.7,
        )))
        .add_systems(Startup, setup)
        .add_systems(Update, turn)
        .run()
}

fn setup(
    mut commands: Commands,
    assets: Res<AssetServer>,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    commands.spawn((
        Volume3d(assets.load("head.nrrd")),
        VolumeMaterial3d(assets.load("head.tf.json")),
    ));
    commands.spawn((
        Ring,
        Mesh3d(meshes.add(Torus::new(0.085, 0.1))),
        MeshMaterial3d(materials.add(StandardMaterial {
            base_color: Color::srgb(0.9, 0.7, 0.3),
            metallic: 1.0,
            perceptual_roughness: 0.3,
            ..default()
        })),
    ));
    commands.spawn((
        Camera3d::default(),
        VolumeRenderSettings::default(),
        Transform::from_xyz(0.3, 0.15, 0.45).looking_at(Vec3::ZERO, Vec3::Y),
    ));
}

fn turn(time: Res<Time>, mut rings: Query<&mut Transform, With<Ring>>) {
    for mut ring in &mut rings {
        ring.rotation = Quat::from_rotation_x(0.6 * time.elapsed_secs());
    }
}
