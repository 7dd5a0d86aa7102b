//! A transfer function made in code, and changed while the app runs.

use bevy::prelude::*;
use bevy_holovol::prelude::*;
use bevy_holovol::{TransferFunction, TransferPoint};

fn main() -> AppExit {
    App::new()
        .add_plugins((DefaultPlugins, HolovolPlugins))
        .add_systems(Startup, setup)
        .add_systems(Update, sweep)
        .run()
}

/// Everything from a value on is opaque, in a colour that goes from red to white.
fn from_value_on(value: f64) -> TransferFunctionAsset {
    let point = |s, sigma_t, albedo| TransferPoint {
        s,
        sigma_t,
        albedo,
        emission: [0.0; 3],
        roughness: 0.5,
        specular: 0.04,
    };
    let points = vec![
        point(value, 0.0, [0.8, 0.1, 0.1]),
        point(value + 0.05, 3000.0, [0.9, 0.5, 0.4]),
        point(value + 0.3, 3000.0, [0.95, 0.95, 0.9]),
    ];
    let function = TransferFunction::new(points).expect("points in order");
    TransferFunctionAsset::from_function(function)
}

fn setup(
    mut commands: Commands,
    assets: Res<AssetServer>,
    mut transfer_functions: ResMut<Assets<TransferFunctionAsset>>,
) {
    commands.spawn((
        Volume3d(assets.load("head.nrrd")),
        VolumeMaterial3d(transfer_functions.add(from_value_on(0.2))),
        VolumeMedium {
            gradient_factor: 3.0,
            ..default()
        },
    ));
    commands.spawn((
        Camera3d::default(),
        VolumeRenderSettings::default(),
        Transform::from_xyz(0.3, 0.1, 0.5).looking_at(Vec3::ZERO, Vec3::Y),
    ));
}

/// Bevy's change detection carries the new points to the GPU; nothing else is uploaded.
fn sweep(
    time: Res<Time>,
    materials: Query<&VolumeMaterial3d>,
    mut transfer_functions: ResMut<Assets<TransferFunctionAsset>>,
) {
    let value = 0.4 + 0.25 * (0.5 * time.elapsed_secs_f64()).sin();
    for material in &materials {
        if let Some(mut asset) = transfer_functions.get_mut(&material.0) {
            *asset = from_value_on(value);
        }
    }
}
