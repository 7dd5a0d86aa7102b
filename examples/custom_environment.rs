//! A light map made in code, that turns; meshes and sky follow.

use bevy::prelude::*;
use bevy_holovol::EnvironmentMap;
use bevy_holovol::prelude::*;

fn main() -> AppExit {
    App::new()
        .add_plugins((DefaultPlugins, HolovolPlugins))
        .add_systems(Startup, setup)
        .add_systems(Update, turn)
        .run()
}

/// A blue sky over grey ground, and a lamp of 20° that is far brighter.
fn map() -> EnvironmentMap {
    let (width, height) = (128, 64);
    let texel = |i: usize| {
        let u = (0.5 + (i % width) as f64) / width as f64;
        let v = (0.5 + (i / width) as f64) / height as f64;
        let direction = EnvironmentMap::direction_from_uv([u, v]);
        let lamp = bevy::math::DVec3::new(1.0, 1.0, 1.0).normalize();
        if direction.dot(lamp) > 10f64.to_radians().cos() {
            [60.0, 50.0, 35.0]
        } else if direction.y > 0.0 {
            [0.2, 0.35, 0.7]
        } else {
            [0.15, 0.14, 0.12]
        }
    };
    EnvironmentMap::new(width, height, (0..width * height).map(texel).collect())
}

fn setup(
    mut commands: Commands,
    assets: Res<AssetServer>,
    mut environments: ResMut<Assets<EnvironmentAsset>>,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    // Live light is this asset, replaced as often as there is news.
    let map = environments.add(EnvironmentAsset::new(map()));
    commands.insert_resource(VolumeEnvironment::from_map(map));
    commands.spawn((
        Volume3d(assets.load("head.nrrd")),
        VolumeMaterial3d(assets.load("head.tf.json")),
        Transform::from_xyz(-0.08, 0.0, 0.0),
    ));
    commands.spawn((
        Mesh3d(meshes.add(Sphere::new(0.06))),
        MeshMaterial3d(materials.add(Color::WHITE)),
        Transform::from_xyz(0.14, 0.0, 0.0),
    ));
    commands.spawn((
        Camera3d::default(),
        VolumeRenderSettings::default(),
        Transform::from_xyz(0.1, 0.1, 0.6).looking_at(Vec3::ZERO, Vec3::Y),
    ));
}

fn turn(time: Res<Time>, mut environment: ResMut<VolumeEnvironment>) {
    environment.rotation_y = 0.3 * time.elapsed_secs();
}
