//! A volume, light, and a camera.

use bevy::prelude::*;
use bevy_holovol::prelude::*;

fn main() -> AppExit {
    App::new()
        .add_plugins((DefaultPlugins, HolovolPlugins))
        .insert_resource(VolumeEnvironment::from_radiance(LinearRgba::rgb(
            0.6, 0.7, 1.0,
        )))
        .add_systems(Startup, setup)
        .run()
}

fn setup(mut commands: Commands, assets: Res<AssetServer>) {
    commands.spawn((
        Volume3d(assets.load("head.nrrd")),
        VolumeMaterial3d(assets.load("head.tf.json")),
    ));
    commands.spawn((
        Camera3d::default(),
        VolumeRenderSettings::default(),
        Transform::from_xyz(0.3, 0.1, 0.5).looking_at(Vec3::ZERO, Vec3::Y),
    ));
}
