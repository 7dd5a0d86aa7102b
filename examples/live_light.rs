//! A volume in the light of a 360° camera; here a virtual one, in a room whose lamp blinks.

use std::time::{Duration, Instant};

use bevy::prelude::*;
use bevy_holovol::prelude::*;
use bevy_holovol::{LiveCamera, LiveFrame, LivePicture};
use holovol_camera::{Exposure, VirtualCamera};
use holovol_light::EnvironmentMap;
use holovol_light::lens::Calibration;

/// Pixels across of each fisheye.
const PICTURE: usize = 256;

fn main() -> AppExit {
    App::new()
        .add_plugins((
            DefaultPlugins,
            HolovolPlugins,
            LiveLightPlugin {
                calibration: Some(Calibration::nominal([PICTURE; 2], 195.0)),
                ..default()
            },
        ))
        .add_systems(Startup, setup)
        .add_systems(Update, tell)
        .run()
}

fn setup(mut commands: Commands, assets: Res<AssetServer>, live: Res<LiveLight>) {
    commands.spawn((
        Volume3d(assets.load("head.nrrd")),
        VolumeMaterial3d(assets.load("head.tf.json")),
    ));
    commands.spawn((
        Camera3d::default(),
        VolumeRenderSettings::default(),
        Transform::from_xyz(0.1, 0.1, 0.6).looking_at(Vec3::ZERO, Vec3::Y),
    ));
    let live = live.camera();
    std::thread::spawn(move || film(&live));
}

/// What a camera's thread does: alternates two exposures, until the app has ended.
fn film(live: &LiveCamera) {
    let camera = VirtualCamera {
        size: PICTURE,
        ..default()
    };
    let rooms = [false, true].map(room);
    for shot in 0_u64.. {
        let ev = if shot % 2 == 0 { 0.0 } else { -6.0 };
        let room = &rooms[(shot / 60 % 2) as usize];
        let Ok(mut shots) = camera.shoot(room, &[Exposure::Fixed(ev)], shot) else {
            return;
        };
        let pictures = shots.remove(0).pictures;
        let is_wanted = live.send(LiveFrame {
            picture: LivePicture::Fisheyes { pictures },
            ev: Some(ev),
            captured: Instant::now(),
        });
        if !is_wanted {
            return;
        }
        std::thread::sleep(Duration::from_millis(33));
    }
}

/// A dim room with a window, and a lamp.
fn room(lamp_is_on: bool) -> EnvironmentMap {
    let (width, height) = (256, 128);
    let texel = |i: usize| match (i % width, i / width) {
        (180..184, 30..34) if lamp_is_on => [900.0, 700.0, 400.0],
        (40..70, 40..70) => [2.0, 3.0, 4.0],
        (_, 64..) => [0.15, 0.12, 0.1],
        _ => [0.2; 3],
    };
    EnvironmentMap::new(width, height, (0..width * height).map(texel).collect())
}

fn tell(live: Res<LiveLight>) {
    if live.light_change > 0.0 {
        info!(
            "the light changed by {:.2}: {} small lights, ±{:.2} EV",
            live.light_change,
            live.lights.len(),
            live.sigma_ev
        );
    }
}
