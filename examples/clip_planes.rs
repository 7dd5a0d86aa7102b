//! A plane that cuts a volume open, and moves through it.

use bevy::prelude::*;
use bevy_holovol::prelude::*;

fn main() -> AppExit {
    App::new()
        .add_plugins((DefaultPlugins, HolovolPlugins))
        .add_systems(Startup, setup)
        .add_systems(Update, slide)
        .run()
}

fn setup(mut commands: Commands, assets: Res<AssetServer>) {
    commands.spawn((
        Volume3d(assets.load("head.nrrd")),
        VolumeMaterial3d(assets.load("head.tf.json")),
        // A child moves with the volume and cuts only that: what lies above it goes.
        children![VolumeClipPlane],
    ));
    commands.spawn((
        Camera3d::default(),
        VolumeRenderSettings::default(),
        Transform::from_xyz(0.2, 0.35, 0.4).looking_at(Vec3::ZERO, Vec3::Y),
    ));
}

fn slide(time: Res<Time>, mut planes: Query<&mut Transform, With<VolumeClipPlane>>) {
    for mut plane in &mut planes {
        let phase = 0.5 * time.elapsed_secs();
        plane.translation.y = 0.08 * phase.cos();
        plane.rotation = Quat::from_rotation_x(0.3 * phase.sin());
    }
}
