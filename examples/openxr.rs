//! In a headset, if there is one: a volume that floats before the user and can be taken in hand.

use bevy::prelude::*;
use bevy::winit::WinitSettings;
use bevy_holovol::prelude::*;
use bevy_holovol::xr::{HeadPose, Headset};

fn main() -> AppExit {
    let mut app = App::new();
    match Headset::connect("holovol example") {
        Ok(headset) => app.add_plugins((headset.plugins(DefaultPlugins), HolovolPlugins)),
        Err(missing) => {
            eprintln!("{missing}\nUntil then, here is a window.");
            app.add_plugins((DefaultPlugins, HolovolPlugins))
                .add_systems(Startup, spawn_window_camera)
        }
    };
    // The headset paces frames, whether the window has the focus or not.
    app.insert_resource(WinitSettings::continuous())
        .insert_resource(VolumeEnvironment::from_radiance(LinearRgba::rgb(
            0.6, 0.7, 1.0,
        )))
        .add_systems(Startup, spawn_volume)
        .add_systems(
            Update,
            place_before_user.run_if(resource_exists::<HeadPose>),
        )
        .run()
}

fn spawn_volume(mut commands: Commands, assets: Res<AssetServer>) {
    commands.spawn((
        Volume3d(assets.load("head.nrrd")),
        VolumeMaterial3d(assets.load("head.tf.json")),
        Graspable::default(),
    ));
}

fn spawn_window_camera(mut commands: Commands) {
    commands.spawn((
        Camera3d::default(),
        VolumeRenderSettings::default(),
        Transform::from_xyz(0.3, 0.1, 0.5).looking_at(Vec3::ZERO, Vec3::Y),
    ));
}

/// Once, as soon as it is known where the user is.
fn place_before_user(
    head: Res<HeadPose>,
    mut volume: Single<&mut Transform, With<Volume3d>>,
    mut is_done: Local<bool>,
) {
    if let (Some(head), false) = (head.0, *is_done) {
        **volume = bevy_holovol::xr::before(head, 0.6);
        *is_done = true;
    }
}
