//! Apps without windows, whose cameras draw into images that are read back.

use std::sync::{Arc, Mutex};

use bevy::app::{Plugins, PluginsState};
use bevy::camera::{Exposure, RenderTarget};
use bevy::core_pipeline::tonemapping::{DebandDither, Tonemapping};
use bevy::log::LogPlugin;
use bevy::prelude::*;
use bevy::render::RenderPlugin;
use bevy::render::error_handler::{RenderErrorHandler, RenderErrorPolicy};
use bevy::render::gpu_readback::{Readback, ReadbackComplete};
use bevy::render::pipelined_rendering::PipelinedRenderingPlugin;
use bevy::render::render_resource::{PollType, TextureFormat, TextureUsages};
use bevy::render::renderer::RenderDevice;
use bevy::window::ExitCondition;
use bevy::winit::WinitPlugin;
use bevy_holovol::VolumeStatistics;
use bevy_holovol::prelude::*;
use bevy_holovol::render::Statistics;
use holovol_volume::{Geometry, TransferFunction, TransferPoint, Volume, Voxels};

/// Frames within which everything is uploaded, compiled and filtered on the slowest machine.
const PATIENCE: usize = 20_000;

/// Everything but a window; rendering in step with updates.
pub fn app() -> App {
    app_with(HolovolPlugins)
}

/// The same with other plugins of ours.
pub fn app_with<M>(plugins: impl Plugins<M>) -> App {
    app_on(AssetPlugin::default(), plugins)
}

/// The same with assets from elsewhere.
pub fn app_on<M>(files: AssetPlugin, plugins: impl Plugins<M>) -> App {
    app_that(true, files, plugins)
}

/// The same; Bevy's own pipelines may be compiled beside the frames, as in apps.
pub fn app_that<M>(waits_for_pipelines: bool, files: AssetPlugin, plugins: impl Plugins<M>) -> App {
    let mut app = App::new();
    app.add_plugins((DefaultPlugins
        .set(files)
        .set(WindowPlugin {
            primary_window: None,
            exit_condition: ExitCondition::DontExit,
            ..default()
        })
        .set(RenderPlugin {
            synchronous_pipeline_compilation: waits_for_pipelines,
            ..default()
        })
        .disable::<LogPlugin>()
        .disable::<PipelinedRenderingPlugin>()
        .disable::<WinitPlugin>(),));
    app.add_plugins(plugins);
    while app.plugins_state() == PluginsState::Adding {
        bevy::tasks::tick_global_task_pools_on_main_thread();
    }
    app.finish();
    app.cleanup();
    app.insert_resource(ClearColor(Color::BLACK));
    // Meshes and sky stay dark unless a test is about them.
    app.insert_resource(VolumeEnvironment {
        lights_meshes: false,
        is_sky: false,
        intensity: unit_intensity(),
        ..default()
    });
    app
}

/// cd/m² that show as 1 at the default exposure.
pub fn unit_intensity() -> f32 {
    1.0 / Exposure::default().exposure()
}

/// A volume of one value, `size` m along each side.
pub fn solid(size: Vec3) -> Volume {
    let spacing = size.to_array().map(|metres| f64::from(metres) / 4.0);
    let geometry = Geometry::from_spacing(spacing);
    Volume::new(Voxels::U8(vec![255; 64]), [4, 4, 4], 1.0, 0.0, geometry).expect("a volume")
}

pub fn matter(sigma_t: f64, albedo: f64) -> TransferFunctionAsset {
    let point = TransferPoint {
        s: 0.0,
        sigma_t,
        albedo: [albedo; 3],
        emission: [0.0; 3],
        roughness: 0.5,
        specular: 0.0,
    };
    TransferFunctionAsset::from_function(TransferFunction::new(vec![point]).expect("a point"))
}

pub fn medium() -> VolumeMedium {
    VolumeMedium {
        window: Some((0.0, 255.0)),
        ..default()
    }
}

pub fn spawn_volume(app: &mut App, volume: Volume, matter: TransferFunctionAsset) -> Entity {
    let volume = app
        .world_mut()
        .resource_mut::<Assets<VolumeAsset>>()
        .add(volume);
    let mut assets = app
        .world_mut()
        .resource_mut::<Assets<TransferFunctionAsset>>();
    let matter = assets.add(matter);
    let parts = (Volume3d(volume), VolumeMaterial3d(matter), medium());
    app.world_mut().spawn(parts).id()
}

/// An image that cameras can draw into and that can be read.
pub fn target(app: &mut App, width: u32, height: u32) -> Handle<Image> {
    let mut image = Image::new_target_texture(width, height, TextureFormat::Rgba32Float, None);
    image.texture_descriptor.usage |= TextureUsages::COPY_SRC;
    app.world_mut().resource_mut::<Assets<Image>>().add(image)
}

/// A camera on +z that looks at the origin, with nothing between radiance and image.
pub fn spawn_camera(
    app: &mut App,
    target: &Handle<Image>,
    distance: f32,
    settings: VolumeRenderSettings,
) -> Entity {
    let projection = PerspectiveProjection {
        fov: 0.3,
        near: 0.05,
        ..default()
    };
    let parts = (
        Camera3d::default(),
        RenderTarget::Image(target.clone().into()),
        Projection::Perspective(projection),
        Transform::from_xyz(0.0, 0.0, distance).looking_at(Vec3::ZERO, Vec3::Y),
        Tonemapping::None,
        DebandDither::Disabled,
        Msaa::Off,
        settings,
    );
    app.world_mut().spawn(parts).id()
}

pub fn settings(max_samples: u32) -> VolumeRenderSettings {
    VolumeRenderSettings {
        samples: 16,
        max_samples,
        ..default()
    }
}

pub fn statistics(app: &App) -> Statistics {
    app.world().resource::<VolumeStatistics>().get()
}

/// Takes Bevy's device away, and has it open another one in the next frames.
pub fn lose_device(app: &mut App) {
    app.insert_resource(RenderErrorHandler(|_, _, _| {
        RenderErrorPolicy::Recover(default())
    }));
    // Bevy 0.19 keeps the buffers that it reads back with for ten frames, and takes them for the
    // other device's then.
    for _ in 0..15 {
        app.update();
    }
    let device = app.world().resource::<RenderDevice>().clone();
    // What Bevy reads back of its own is taken in before: its callbacks don't expect to lose it.
    device.poll(PollType::wait_indefinitely()).expect("polled");
    device.wgpu_device().destroy();
    // Bevy hears of it before the next frame; in the middle of one it may panic itself.
    device.poll(PollType::wait_indefinitely()).expect("polled");
}

/// Updates until all images are done.
#[track_caller]
pub fn finish(app: &mut App) {
    for _ in 0..PATIENCE {
        app.update();
        let statistics = statistics(app);
        assert_eq!(statistics.errors, Vec::<String>::new());
        if statistics.is_done {
            let counters = statistics.counters;
            assert_eq!(
                [counters.majorant_violations, counters.nonfinite_samples],
                [0, 0]
            );
            return;
        }
        if statistics.is_waiting {
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
    }
    panic!("not done: {:?}", statistics(app));
}

/// What is in a target after a few frames more: linear RGBA.
#[track_caller]
pub fn read(app: &mut App, target: &Handle<Image>) -> Picture {
    // What has just been spawned or changed is drawn first.
    for _ in 0..3 {
        app.update();
    }
    let size = size_of_target(app, target);
    let found = Arc::new(Mutex::new(None));
    let result = Arc::clone(&found);
    let reader = app
        .world_mut()
        .spawn(Readback::texture(target.clone()))
        .observe(move |event: On<ReadbackComplete>| {
            *result.lock().expect("no panic") = Some(event.data.clone());
        })
        .id();
    for _ in 0..PATIENCE {
        app.update();
        if let Some(bytes) = found.lock().expect("no panic").take() {
            app.world_mut().despawn(reader);
            return Picture::new(&bytes, size);
        }
    }
    panic!("nothing was read back");
}

fn size_of_target(app: &App, target: &Handle<Image>) -> UVec2 {
    let images = app.world().resource::<Assets<Image>>();
    images.get(target).expect("a target").size()
}

/// Brightness in the middle of a target, frame by frame from now on.
pub struct Watch(Arc<Mutex<Vec<f32>>>);

impl Watch {
    pub fn begin(app: &mut App, target: &Handle<Image>) -> Self {
        let size = size_of_target(app, target);
        let seen = Arc::new(Mutex::new(Vec::new()));
        let all = Arc::clone(&seen);
        app.world_mut()
            .spawn(Readback::texture(target.clone()))
            .observe(move |event: On<ReadbackComplete>| {
                let picture = Picture::new(&event.data, size);
                let [x, y] = [size.x as usize / 2, size.y as usize / 2];
                let middle = picture.mean([x - 2, y - 2, x + 2, y + 2]).x;
                all.lock().expect("no panic").push(middle);
            });
        // What is on its way is of frames before.
        for _ in 0..3 {
            app.update();
        }
        seen.lock().expect("no panic").clear();
        Self(seen)
    }

    /// Fails if there was a brighter frame than this since the last look.
    #[track_caller]
    pub fn assert_at_most(&self, what: &str, most: f32) {
        let seen = std::mem::take(&mut *self.0.lock().expect("no panic"));
        assert!(!seen.is_empty(), "{what}: no frame was seen");
        let brightest = seen.iter().copied().fold(0.0, f32::max);
        let frames = seen.iter().filter(|value| **value > most).count();
        assert!(
            brightest <= most,
            "{what}: {brightest} in {frames} of {} frames",
            seen.len()
        );
    }
}

pub struct Picture {
    pub width: usize,
    pub pixels: Vec<[f32; 4]>,
}

impl Picture {
    fn new(bytes: &[u8], size: UVec2) -> Self {
        let row = bytes.len() / size.y as usize;
        let pixels = (0..size.y as usize).flat_map(|y| {
            let row = &bytes[y * row..][..16 * size.x as usize];
            row.chunks(16).map(|pixel| {
                std::array::from_fn(|c| {
                    let four = [0, 1, 2, 3].map(|i| pixel[4 * c + i]);
                    f32::from_le_bytes(four)
                })
            })
        });
        Self {
            width: size.x as usize,
            pixels: pixels.collect(),
        }
    }

    /// Mean over [left, right) × [top, bottom).
    pub fn mean(&self, [left, top, right, bottom]: [usize; 4]) -> Vec4 {
        let mut sum = glam::DVec4::ZERO;
        for y in top..bottom {
            for x in left..right {
                sum += Vec4::from(self.pixels[x + self.width * y]).as_dvec4();
            }
        }
        (sum / ((right - left) * (bottom - top)) as f64).as_vec4()
    }

    pub fn height(&self) -> usize {
        self.pixels.len() / self.width
    }

    /// Mean over the middle half.
    pub fn middle(&self) -> Vec4 {
        let [w, h] = [self.width, self.height()];
        self.mean([w / 4, h / 4, 3 * w / 4, 3 * h / 4])
    }
}

#[track_caller]
pub fn assert_near(what: &str, found: f32, expected: f32, tolerance: f32) {
    assert!(
        (found - expected).abs() <= tolerance,
        "{what}: {found}, expected {expected} ± {tolerance}"
    );
}
