//! Apps in a headset, without a window.

use std::time::{Duration, Instant};

use bevy::app::PluginsState;
use bevy::camera::Exposure;
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::log::LogPlugin;
use bevy::prelude::*;
use bevy::window::ExitCondition;
use bevy::winit::WinitPlugin;
use bevy_holovol::VolumeStatistics;
use bevy_holovol::interaction::InteractionMarksPlugin;
use bevy_holovol::prelude::*;
use bevy_holovol::xr::{
    CapturedFrame, EyeCapture, EyeView, Headset, HeadsetState, HeadsetStatus, MixedRealitySettings,
};
use glam::{DMat4, DVec4};
use holovol_volume::{Geometry, TransferFunction, TransferPoint, Volume, Voxels};

/// Until something that has to happen has happened on the slowest machine.
const PATIENCE: Duration = Duration::from_secs(240);

/// An app on the headset, its environment white and dark to meshes, its tones unmapped.
pub fn app(settings: MixedRealitySettings) -> App {
    let headset = Headset::connect("holovol test").expect("the simulated headset");
    let mut app = App::new();
    app.add_plugins(
        headset.plugins(
            DefaultPlugins
                .set(WindowPlugin {
                    primary_window: None,
                    exit_condition: ExitCondition::DontExit,
                    ..default()
                })
                .disable::<LogPlugin>()
                .disable::<WinitPlugin>(),
        ),
    );
    // Without hands its marks cost nothing.
    app.add_plugins((HolovolPlugins, InteractionMarksPlugin));
    app.insert_resource(settings);
    app.insert_resource(ClearColor(Color::BLACK));
    app.insert_resource(VolumeEnvironment {
        lights_meshes: false,
        is_sky: false,
        intensity: 1.0 / Exposure::default().exposure(),
        ..default()
    });
    while app.plugins_state() == PluginsState::Adding {
        bevy::tasks::tick_global_task_pools_on_main_thread();
    }
    app.finish();
    app.cleanup();
    app
}

pub fn settings() -> MixedRealitySettings {
    MixedRealitySettings {
        tonemapping: Tonemapping::None,
        render: VolumeRenderSettings {
            mode: VolumeRenderMode::Fresh,
            ..default()
        },
        // Software is too slow for any pace.
        volume_resolution: None,
        // Expected noise is that of equal samples.
        foveation: None,
        exits_app: false,
        ..default()
    }
}

/// A volume of one value, `size` m along each side.
pub fn solid(size: Vec3) -> Volume {
    let spacing = size.to_array().map(|metres| f64::from(metres) / 4.0);
    let geometry = Geometry::from_spacing(spacing);
    Volume::new(Voxels::U8(vec![255; 64]), [4, 4, 4], 1.0, 0.0, geometry).expect("a volume")
}

pub fn function(sigma_t: f64, albedo: [f64; 3]) -> TransferFunction {
    TransferFunction::new(vec![TransferPoint {
        s: 0.0,
        sigma_t,
        albedo,
        emission: [0.0; 3],
        roughness: 0.5,
        specular: 0.0,
    }])
    .expect("a point")
}

pub fn spawn_volume(
    app: &mut App,
    volume: Volume,
    function: TransferFunction,
    place: Transform,
) -> Entity {
    let mut volumes = app.world_mut().resource_mut::<Assets<VolumeAsset>>();
    let volume = volumes.add(volume);
    let mut functions = app
        .world_mut()
        .resource_mut::<Assets<TransferFunctionAsset>>();
    let function = functions.add(TransferFunctionAsset::from_function(function));
    let medium = VolumeMedium {
        window: Some((0.0, 255.0)),
        ..default()
    };
    let parts = (Volume3d(volume), VolumeMaterial3d(function), medium, place);
    app.world_mut().spawn(parts).id()
}

pub fn status(app: &App) -> HeadsetStatus {
    app.world().resource::<HeadsetStatus>().clone()
}

#[track_caller]
pub fn run_until(app: &mut App, what: &str, mut is_so: impl FnMut(&App) -> bool) {
    let start = Instant::now();
    while !is_so(app) {
        app.update();
        assert!(
            start.elapsed() < PATIENCE,
            "never {what}: {:?}, {:?}",
            status(app),
            app.world().resource::<VolumeStatistics>().get()
        );
    }
}

#[track_caller]
pub fn focus(app: &mut App) {
    run_until(app, "focused", |app| {
        status(app).state == HeadsetState::Focused
    });
}

/// Until the volume is uploaded, compiled for, and has been traced for a few frames.
#[track_caller]
pub fn show(app: &mut App) {
    focus(app);
    let dispatches = |app: &App| {
        let statistics = app.world().resource::<VolumeStatistics>().get();
        assert_eq!(statistics.errors, Vec::<String>::new());
        statistics.dispatches
    };
    let before = dispatches(app);
    run_until(app, "shown", |app| dispatches(app) > before + 5);
}

#[track_caller]
pub fn capture(app: &mut App) -> CapturedFrame {
    let capture = app.world().resource::<EyeCapture>().clone();
    capture.request();
    let mut found = None;
    run_until(app, "captured", |_| {
        found = capture.take();
        found.is_some()
    });
    found.expect("just found")
}

/// Rows of linear RGBA; of pictures of 8 bits.
pub fn linear(frame: &CapturedFrame, eye: usize) -> Vec<[f32; 4]> {
    let decode = |byte: u8| {
        let s = f32::from(byte) / 255.0;
        if s <= 0.04045 {
            s / 12.92
        } else {
            ((s + 0.055) / 1.055).powf(2.4)
        }
    };
    frame.pixels[eye]
        .chunks(4)
        .map(|pixel| {
            let [r, g, b] = [0, 1, 2].map(|c| decode(pixel[c]));
            [r, g, b, f32::from(pixel[3]) / 255.0]
        })
        .collect()
}

/// By the definition of a field of view, apart from what the app does.
pub fn projection(view: &EyeView) -> DMat4 {
    let tan = |angle: f32| f64::from(angle).tan();
    let (l, r) = (tan(view.fov.left), tan(view.fov.right));
    let (d, u) = (tan(view.fov.down), tan(view.fov.up));
    let x = DVec4::new(2.0, 0.0, l + r, 0.0) / (r - l);
    let y = DVec4::new(0.0, 2.0, d + u, 0.0) / (u - d);
    let near = DVec4::new(0.0, 0.0, 0.0, 0.1);
    DMat4::from_cols(x, y, near, -DVec4::Z).transpose()
}

pub fn world_from_eye(view: &EyeView) -> DMat4 {
    let rotation = view.pose.rotation.as_dquat();
    let translation = Vec3::from(view.pose.translation).as_dvec3();
    DMat4::from_rotation_translation(rotation, translation)
}

/// Pixels from the top left at which an eye should see a point.
pub fn project(view: &EyeView, size: [u32; 2], point: Vec3) -> [f64; 2] {
    let eye = world_from_eye(view).inverse();
    let clip = projection(view) * eye * point.as_dvec3().extend(1.0);
    let [x, y] = [clip.x / clip.w, clip.y / clip.w];
    let [width, height] = size.map(f64::from);
    [width * (0.5 + 0.5 * x), height * (0.5 - 0.5 * y)]
}
