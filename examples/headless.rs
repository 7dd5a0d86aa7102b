//! Without a window: renders a volume to `head.png` and ends.

use std::time::Duration;

use bevy::app::ScheduleRunnerPlugin;
use bevy::camera::RenderTarget;
use bevy::prelude::*;
use bevy::render::render_resource::TextureFormat;
use bevy::render::view::screenshot::{Screenshot, ScreenshotCaptured, save_to_disk};
use bevy::window::ExitCondition;
use bevy::winit::WinitPlugin;
use bevy_holovol::VolumeStatistics;
use bevy_holovol::prelude::*;

#[derive(Resource)]
struct Target(Handle<Image>);

fn main() -> AppExit {
    App::new()
        .add_plugins((
            DefaultPlugins
                .set(WindowPlugin {
                    primary_window: None,
                    exit_condition: ExitCondition::DontExit,
                    ..default()
                })
                .disable::<WinitPlugin>(),
            ScheduleRunnerPlugin::run_loop(Duration::ZERO),
            HolovolPlugins,
        ))
        .add_systems(Startup, setup)
        .add_systems(Update, save_when_done)
        .run()
}

fn setup(mut commands: Commands, assets: Res<AssetServer>, mut images: ResMut<Assets<Image>>) {
    let format = TextureFormat::Rgba8UnormSrgb;
    let target = images.add(Image::new_target_texture(256, 256, format, None));
    commands.spawn((
        Volume3d(assets.load("head.nrrd")),
        VolumeMaterial3d(assets.load("head.tf.json")),
    ));
    commands.spawn((
        Camera3d::default(),
        RenderTarget::Image(target.clone().into()),
        VolumeRenderSettings {
            max_samples: 64,
            ..default()
        },
        Transform::from_xyz(0.3, 0.1, 0.5).looking_at(Vec3::ZERO, Vec3::Y),
    ));
    commands.insert_resource(Target(target));
}

/// The view rests, so that it gathers samples until it has `max_samples`.
fn save_when_done(
    mut commands: Commands,
    statistics: Res<VolumeStatistics>,
    target: Res<Target>,
    mut is_taken: Local<bool>,
) {
    if statistics.get().is_done && !*is_taken {
        *is_taken = true;
        commands
            .spawn(Screenshot::image(target.0.clone()))
            .observe(save_to_disk("head.png"))
            .observe(
                |_: On<ScreenshotCaptured>, mut exit: MessageWriter<AppExit>| {
                    exit.write(AppExit::Success);
                },
            );
    }
}
