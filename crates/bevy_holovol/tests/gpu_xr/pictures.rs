//! What the headset is given: against renderings of the same views outside any frame.

use std::sync::{Arc, Mutex};

use bevy::prelude::*;
use bevy_holovol::VolumeStatistics;
use bevy_holovol::prelude::*;
use bevy_holovol::xr::{
    CapturedFrame, EyeCamera, HeadsetBlend, MixedRealitySettings, RawView, TamperedViews,
};
use glam::{DMat4, DVec3};
use holovol_light::EnvironmentMap;
use holovol_render::{
    FrameTracer, Gpu, GpuEnvironment, GpuVolume, Interpolation, Kernels, Medium, SampleShares,
    TraceOptions, View, ViewFrame,
};
use holovol_volume::{TransferFunction, Volume};

use crate::app::*;

pub const TESTS: &[crate::Test] = &[
    (
        "each_eye_gets_what_its_view_renders_offline",
        each_eye_gets_what_its_view_renders,
    ),
    ("large_images_are_right", large_images_are_right),
    (
        "what_is_drawn_is_what_was_located_last",
        what_is_drawn_is_what_was_located_last,
    ),
    (
        "denoised_eyes_are_nearer_to_what_their_views_render",
        denoised_eyes_are_nearer,
    ),
    (
        "eyes_see_a_point_where_it_projects_to",
        eyes_see_a_point_where_it_projects_to,
    ),
    (
        "over_a_room_opacity_comes_along_or_not",
        over_a_room_opacity_comes_along_or_not,
    ),
];

pub const ALBEDO: [f64; 3] = [0.8, 0.5, 0.3];
/// Samples per pixel of a frame, and of the rendering that it is compared with.
pub const SAMPLES: u32 = 16;
pub const REFERENCE_SAMPLES: u32 = 256;
/// m; the simulated head is 1.6 m above the floor.
const PLACE: Vec3 = Vec3::new(0.05, 1.55, -0.9);

pub fn scene(settings: MixedRealitySettings) -> (App, Volume, TransferFunction, Transform) {
    let mut app = app(MixedRealitySettings {
        render: bevy_holovol::VolumeRenderSettings {
            samples: SAMPLES,
            ..settings.render
        },
        ..settings
    });
    let volume = || solid(Vec3::new(0.5, 0.4, 0.3));
    let matter = function(6.0, ALBEDO);
    let place = Transform::from_translation(PLACE).with_rotation(Quat::from_rotation_y(0.4));
    spawn_volume(&mut app, volume(), matter.clone(), place);
    (app, volume(), matter, place)
}

/// Linear premultiplied RGBA of both eyes.
pub fn offline(
    frame: &CapturedFrame,
    volume: &Volume,
    matter: &TransferFunction,
    place: Transform,
    samples: u32,
) -> [Vec<[f32; 4]>; 2] {
    offline_with(
        frame,
        volume,
        matter,
        place,
        [samples.min(32), samples],
        None,
    )
}

/// The same, so many samples at a time and in all, of which blocks may get shares.
pub fn offline_with(
    frame: &CapturedFrame,
    volume: &Volume,
    matter: &TransferFunction,
    place: Transform,
    [at_once, samples]: [u32; 2],
    shares: Option<&Arc<SampleShares>>,
) -> [Vec<[f32; 4]>; 2] {
    let gpu = Gpu::new(None).expect("an adapter");
    let world_from_local = DMat4::from_scale_rotation_translation(
        place.scale.as_dvec3(),
        place.rotation.as_dquat(),
        place.translation.as_dvec3(),
    );
    let medium = Medium {
        window: [0.0, 255.0],
        world_from_unit_cube: world_from_local * volume.world_from_unit_cube(),
        transfer_function: matter.clone(),
        phase_g: 0.0,
        gradient_factor: 0.0,
        max_scatters: Some(1),
        clip_planes: Vec::new(),
        environment_rotation_y: 0.0,
        environment_scale: 1.0,
    };
    let light = GpuEnvironment::new(&gpu, &EnvironmentMap::constant([1.0; 3])).expect("light");
    let voxels = GpuVolume::new(&gpu, volume, Interpolation::Exact, false).expect("voxels");
    let kernels = Arc::new(Kernels::new(&gpu).expect("kernels"));
    let mut tracer = FrameTracer::new(
        &gpu,
        kernels,
        Arc::new(voxels),
        Arc::new(light),
        medium,
        TraceOptions::default(),
    )
    .expect("a tracer");
    tracer.wait_for_kernels();
    tracer.set_views(&[frame.size; 2]).expect("room");
    for slot in 0..2 {
        tracer.set_shares(slot, shares).expect("room");
    }
    let frames = [0, 1].map(|slot| {
        let view = &frame.views[slot];
        ViewFrame {
            slot,
            view: View::from_projection(world_from_eye(view), projection(view), frame.size),
            samples: at_once,
            max_samples: samples,
            restart: false,
            mesh_depth: None,
        }
    });
    while frames.iter().any(|frame| tracer.wants(frame)) {
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        tracer.record(&mut encoder, &frames, None).expect("work");
        gpu.queue.submit([encoder.finish()]);
        gpu.device
            .poll(holovol_render::wgpu::PollType::wait_indefinitely())
            .expect("a device");
    }
    [0, 1].map(|slot| tracer.read_image(slot).expect("an image"))
}

/// Means of 16 × 16 blocks.
pub fn blocks(pixels: &[[f32; 4]], width: usize) -> Vec<[f64; 4]> {
    let height = pixels.len() / width;
    let mut blocks = Vec::new();
    for top in (0..height).step_by(16) {
        for left in (0..width).step_by(16) {
            let mut sum = [0.0; 4];
            let (bottom, right) = ((top + 16).min(height), (left + 16).min(width));
            for pixel in (top..bottom).flat_map(|y| &pixels[y * width..][left..right]) {
                for (sum, value) in sum.iter_mut().zip(pixel) {
                    *sum += f64::from(*value);
                }
            }
            blocks.push(sum.map(|s| s / ((bottom - top) * (right - left)) as f64));
        }
    }
    blocks
}

/// How far apart in standard deviations at most: a sample is between 0 and 1.2 × `most` (roulette
/// gives those that live on up to 0.2 more), which bounds its variance by m·(1.2 most − m), m its
/// mean.
pub fn greatest_z(
    found: &[[f64; 4]],
    expected: &[[f64; 4]],
    most: [f64; 4],
    samples: [u32; 2],
) -> f64 {
    /// Of a mean of rounded 8-bit values, linear.
    const ROUNDING: f64 = 1.5e-3;
    let mut greatest: f64 = 0.0;
    for (found, expected) in found.iter().zip(expected) {
        for c in 0..4 {
            let variance = (expected[c] * (1.2 * most[c] - expected[c])).max(0.0);
            let per_block: f64 = samples.iter().map(|n| 1.0 / f64::from(*n)).sum();
            let sigma = (variance * per_block / 256.0).sqrt();
            greatest = greatest.max((found[c] - expected[c]).abs() / (sigma + ROUNDING));
        }
    }
    greatest
}

/// Those of a picture and of what it is compared with.
const COUNTS: [u32; 2] = [SAMPLES, REFERENCE_SAMPLES];

fn each_eye_gets_what_its_view_renders() {
    let (mut app, volume, matter, place) = scene(settings());
    show(&mut app);
    for _ in 0..2 {
        let frame = capture(&mut app);
        assert_drawn_as_submitted(&frame, &volume, &matter, place, COUNTS);
    }
}

/// What a HoloLens 2 has, once: 2.7 million pixels.
fn large_images_are_right() {
    const FEW: [u32; 2] = [2, 8];
    let (mut app, volume, matter, place) = scene(MixedRealitySettings {
        eye_size: Some(UVec2::new(1440, 936)),
        ..settings()
    });
    let mut eyes = app.world_mut().resource_mut::<MixedRealitySettings>();
    eyes.render.samples = FEW[0];
    show(&mut app);
    let frame = capture(&mut app);
    assert_eq!(frame.size, [1440, 936]);
    assert_drawn_as_submitted(&frame, &volume, &matter, place, FEW);
}

/// The first answer for a display time, which the main world gets, is elsewhere and narrower.
fn move_first_answer(time: i64, view: &mut RawView) {
    static LAST: Mutex<(i64, u32)> = Mutex::new((0, 0));
    let mut last = LAST.lock().expect("no panic");
    if last.0 != time {
        *last = (time, 0);
    }
    last.1 += 1;
    // Both eyes.
    if last.1 <= 2 {
        if let Some(position) = &mut view.position {
            position[0] += 0.1;
        }
        view.fov.left *= 0.9;
    }
}

fn what_is_drawn_is_what_was_located_last() {
    let (mut app, volume, matter, place) = scene(MixedRealitySettings {
        tampered_views: Some(TamperedViews(move_first_answer)),
        ..settings()
    });
    show(&mut app);
    let frame = capture(&mut app);
    let [left, right] = frame.views.map(|view| view.fov);
    assert!((left.left + right.right).abs() < 1e-3, "{left:?} {right:?}");
    assert_drawn_as_submitted(&frame, &volume, &matter, place, COUNTS);
}

fn assert_drawn_as_submitted(
    frame: &CapturedFrame,
    volume: &Volume,
    matter: &TransferFunction,
    place: Transform,
    samples: [u32; 2],
) {
    let width = frame.size[0] as usize;
    assert_eq!(frame.pixels[0].len(), 4 * width * frame.size[1] as usize);
    // The opaque eye's opacity says nothing.
    let no_opacity = |[r, g, b, _]: [f32; 4]| [r, g, b, 0.0];
    let seen = |picture: Vec<[f32; 4]>| {
        blocks(
            &picture.into_iter().map(no_opacity).collect::<Vec<_>>(),
            width,
        )
    };
    let expected = offline(frame, volume, matter, place, samples[1]).map(seen);
    let found = [0, 1].map(|eye| seen(linear(frame, eye)));
    let [r, g, b] = ALBEDO;
    let most = [r, g, b, 0.0];
    for eye in 0..2 {
        let z = greatest_z(&found[eye], &expected[eye], most, samples);
        let z_of_other = greatest_z(&found[eye], &expected[1 - eye], most, samples);
        eprintln!("eye {eye}: z up to {z:.2}; against the other eye's view {z_of_other:.1}");
        assert!(z < 3.0, "{z}");
        assert!(z_of_other > 20.0, "the eyes see alike: {z_of_other}");
    }
}

/// Relative squared error of radiance.
fn relmse(found: &[[f32; 4]], expected: &[[f32; 4]]) -> f64 {
    let pairs = found
        .iter()
        .zip(expected)
        .flat_map(|(a, b)| (0..3).map(move |c| (f64::from(a[c]), f64::from(b[c]))));
    let sum: f64 = pairs.map(|(a, b)| (a - b).powi(2) / (b * b + 0.01)).sum();
    sum / (3 * expected.len()) as f64
}

/// Two samples per pixel and frame, from views that are located anew after the main world has seen
/// them: the history of both eyes must be that of what was drawn.
fn denoised_eyes_are_nearer() {
    const FRAMES: u64 = 12;
    let [fresh, denoised] = [VolumeRenderMode::Fresh, VolumeRenderMode::Denoised].map(|mode| {
        let (mut app, volume, matter, place) = scene(MixedRealitySettings {
            tampered_views: Some(TamperedViews(move_first_answer)),
            ..settings()
        });
        show(&mut app);
        let mut eyes = app
            .world_mut()
            .query::<(&EyeCamera, &mut VolumeRenderSettings)>();
        for (_, mut eye) in eyes.iter_mut(app.world_mut()) {
            (eye.mode, eye.samples) = (mode, 2);
        }
        let statistics = |app: &App| app.world().resource::<VolumeStatistics>().get();
        let is_denoised = mode == VolumeRenderMode::Denoised;
        let before = statistics(&app);
        run_until(&mut app, "shown for a while", |app| {
            let now = statistics(app);
            assert_eq!(now.errors, Vec::<String>::new());
            if is_denoised {
                now.denoised >= before.denoised + 2 * FRAMES
            } else {
                now.dispatches > before.dispatches + 10
            }
        });
        let frame = capture(&mut app);
        let expected = offline(&frame, &volume, &matter, place, REFERENCE_SAMPLES);
        let found = [0, 1].map(|eye| linear(&frame, eye));
        let mean = |image: &[[f32; 4]]| image.iter().map(|p| f64::from(p[0])).sum::<f64>();
        for eye in 0..2 {
            let ratio = mean(&found[eye]) / mean(&expected[eye]);
            assert!((ratio - 1.0).abs() < 0.02, "{mode:?}, eye {eye}: {ratio}");
        }
        let other = relmse(&found[0], &expected[1]);
        let errors = [0, 1].map(|eye| relmse(&found[eye], &expected[eye]));
        eprintln!("{mode:?}: relMSE {errors:?}, to the other eye's view {other:.2e}");
        assert!(errors[0] < 0.5 * other, "the eyes see alike");
        errors
    });
    for eye in 0..2 {
        // 18 to 28 times; without history 12 to 14.
        assert!(15.0 * denoised[eye] < fresh[eye], "{denoised:?}, {fresh:?}");
    }
}

fn eyes_see_a_point_where_it_projects_to() {
    let mut settings = settings();
    settings.render.samples = 64;
    let mut app = app(settings);
    let point = Vec3::new(-0.1, 1.5, -0.8);
    spawn_volume(
        &mut app,
        solid(Vec3::splat(0.02)),
        function(3e3, [0.8; 3]),
        Transform::from_translation(point),
    );
    show(&mut app);
    let frame = capture(&mut app);
    let seen = [0, 1].map(|eye: usize| {
        let picture = linear(&frame, eye);
        let mut sum = [0.0; 3];
        for (i, pixel) in picture.iter().enumerate() {
            let (x, y) = (i % frame.size[0] as usize, i / frame.size[0] as usize);
            let weight = f64::from(pixel[0]);
            sum[0] += weight * (x as f64 + 0.5);
            sum[1] += weight * (y as f64 + 0.5);
            sum[2] += weight;
        }
        assert!(sum[2] > 1.0, "nothing is seen");
        [sum[0] / sum[2], sum[1] / sum[2]]
    });
    let expected = [0, 1].map(|eye: usize| project(&frame.views[eye], frame.size, point));
    let disparity = |at: [[f64; 2]; 2]| at[0][0] - at[1][0];
    eprintln!("seen at {seen:.2?}, expected at {expected:.2?}");
    for eye in 0..2 {
        for axis in 0..2 {
            assert!((seen[eye][axis] - expected[eye][axis]).abs() < 0.5);
        }
    }
    assert!((disparity(seen) - disparity(expected)).abs() < 0.5);
    let eyes = frame.views.map(|view| Vec3::from(view.pose.translation));
    let apart = eyes[0].distance(eyes[1]);
    assert!((0.05..0.08).contains(&apart), "{apart} m between the eyes");
    let right_of_left = world_from_eye(&frame.views[0])
        .inverse()
        .transform_point3(eyes[1].as_dvec3());
    assert!(right_of_left.x > 0.05 && right_of_left.abs().cmplt(DVec3::splat(0.1)).all());
}

fn over_a_room_opacity_comes_along_or_not() {
    for blend in [HeadsetBlend::Alpha, HeadsetBlend::Additive] {
        let (mut app, volume, matter, place) = scene(MixedRealitySettings {
            simulated_blend: Some(blend),
            ..settings()
        });
        // A sky, and a background: neither may be seen.
        app.insert_resource(ClearColor(Color::srgb(1.0, 0.0, 0.0)));
        app.world_mut()
            .resource_mut::<bevy_holovol::VolumeEnvironment>()
            .is_sky = true;
        show(&mut app);
        let frame = capture(&mut app);
        let picture = linear(&frame, 0);
        assert_eq!(picture[0], [0.0; 4], "the room is the background");
        let mean = |channel: usize, of: &[[f32; 4]]| {
            of.iter().map(|p| f64::from(p[channel])).sum::<f64>() / of.len() as f64
        };
        let expected = offline(&frame, &volume, &matter, place, REFERENCE_SAMPLES);
        if blend == HeadsetBlend::Alpha {
            let [found, expected] = [mean(3, &picture), mean(3, &expected[0])];
            assert!((found / expected - 1.0).abs() < 0.01, "{found}, {expected}");
            for [r, g, b, a] in &picture {
                assert!(
                    r.max(*g).max(*b) <= a + 0.01,
                    "premultiplied: {r} {g} {b} {a}"
                );
            }
        } else {
            assert!(picture.iter().all(|pixel| pixel[3] == 0.0), "no opacity");
        }
        let expected: Vec<_> = expected[0].iter().copied().map(mapped).collect();
        let ratios = [0, 1, 2].map(|c| mean(c, &picture) / mean(c, &expected));
        eprintln!("{blend:?}: {ratios:.3?} of what is expected");
        for ratio in ratios {
            assert!((ratio - 1.0).abs() < 0.02, "{blend:?}: {ratios:?}");
        }
    }
}

/// Khronos PBR Neutral below its knee, of a premultiplied pixel.
fn mapped([r, g, b, a]: [f32; 4]) -> [f32; 4] {
    if a == 0.0 {
        return [0.0; 4];
    }
    let color = [r, g, b].map(|c| c / a);
    let least = color.into_iter().fold(f32::INFINITY, f32::min);
    let offset = if least < 0.08 {
        least - 6.25 * least * least
    } else {
        0.04
    };
    assert!(color.into_iter().all(|c| c - offset < 0.8), "{color:?}");
    let [r, g, b] = color.map(|c| (c - offset) * a);
    [r, g, b, a]
}
