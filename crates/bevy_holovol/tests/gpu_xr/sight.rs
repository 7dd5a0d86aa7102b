//! Samples where the eyes look, and none where they see nothing.

use std::sync::Arc;

use bevy::math::Isometry3d;
use bevy::prelude::*;
use bevy_holovol::xr::{EyeCamera, Foveation, MixedRealitySettings, SyntheticSight};
use bevy_holovol::{VolumeSampling, VolumeStatistics};
use holovol_render::SampleShares;

use crate::app::*;
use crate::pictures::{
    ALBEDO, REFERENCE_SAMPLES, SAMPLES, blocks, greatest_z, offline, offline_with, scene,
};

pub const TESTS: &[crate::Test] = &[
    (
        "fewer_samples_beside_the_gaze_leave_the_mean",
        fewer_samples_beside_the_gaze,
    ),
    (
        "unequal_shares_leave_the_mean",
        unequal_shares_leave_the_mean,
    ),
    (
        "what_nobody_sees_is_not_traced",
        what_nobody_sees_is_not_traced,
    ),
];

/// Samples of a frame, both eyes'.
fn samples_of_a_frame(app: &mut App) -> u64 {
    let samples = |app: &App| app.world().resource::<VolumeStatistics>().get().samples;
    let before = samples(app);
    app.update();
    samples(app) - before
}

fn sampling(app: &mut App, eye: usize) -> VolumeSampling {
    let mut eyes = app.world_mut().query::<(&EyeCamera, &VolumeSampling)>();
    let found = eyes.iter(app.world()).find(|(camera, _)| camera.0 == eye);
    found.expect("an eye").1.clone()
}

fn fewer_samples_beside_the_gaze() {
    // At the left edge of the volume, which begins 0.3 rad from there to be sampled less.
    let gaze = Isometry3d::from_rotation(Quat::from_rotation_y(0.5));
    let (mut app, volume, matter, place) = scene(MixedRealitySettings {
        foveation: Some(Foveation::default()),
        synthetic_sight: Some(Arc::new(SyntheticSight {
            hidden: [Arc::new([]), Arc::new([])],
            gaze: Some(gaze),
        })),
        ..settings()
    });
    show(&mut app);
    let full = 2 * 320 * 240 * u64::from(SAMPLES);
    let spent = samples_of_a_frame(&mut app);
    let frame = capture(&mut app);
    let gazes = [0, 1].map(|eye| sampling(&mut app, eye).gaze.x);
    app.world_mut()
        .resource_mut::<MixedRealitySettings>()
        .foveation = None;
    app.update();
    let equal = capture(&mut app);
    let saved = 1.0 - spent as f64 / full as f64;
    eprintln!("{saved:.2} of all samples saved");
    assert!((0.2..0.75).contains(&saved), "{saved}");
    let width = frame.size[0] as usize;
    let [r, g, b] = ALBEDO;
    // The head moves: each picture has its own reference.
    let reference = |frame| offline(frame, &volume, &matter, place, REFERENCE_SAMPLES);
    let [few, all] = [(&frame, reference(&frame)), (&equal, reference(&equal))];
    let colors = |picture: &[[f32; 4]]| {
        let picture = picture.iter().map(|[r, g, b, _]| [*r, *g, *b, 0.0]);
        let picture: Vec<_> = picture.collect();
        blocks(&picture, width)
    };
    let mean = |blocks: &[[f64; 4]]| blocks.iter().map(|b| b[0]).sum::<f64>();
    for eye in 0..2 {
        assert!(gazes[eye] < 0.5, "to the left");
        let [found, equal] = [&few, &all].map(|(frame, _)| colors(&linear(frame, eye)));
        let [expected, expected_equal] = [&few, &all].map(|(_, reference)| colors(&reference[eye]));
        // The least that a pixel gets.
        let samples = [SAMPLES / 4, REFERENCE_SAMPLES];
        let z = greatest_z(&found, &expected, [r, g, b, 0.0], samples);
        // Pictures of 8 bits are rounded, whoever gets how many samples.
        let rounding = mean(&equal) / mean(&expected_equal);
        let ratio = mean(&found) / mean(&expected) / rounding;
        eprintln!("eye {eye}: z up to {z:.2}, {ratio:.4} of the light, {rounding:.4} by rounding");
        assert!(z < 3.0, "{z}");
        // What they are rounded to depends on their noise; that there is no bias is tested below.
        assert!((ratio - 1.0).abs() < 0.012, "{ratio}");
    }
}

/// As the tracer sums them, without any rounding: of frames of 4 samples every other block gets 1,
/// the others 3.
fn unequal_shares_leave_the_mean() {
    let (mut app, volume, matter, place) = scene(settings());
    show(&mut app);
    let frame = capture(&mut app);
    let is_poor = |x: usize, y: usize| (x / 8 + y / 8).is_multiple_of(2);
    let shares = SampleShares::new(frame.size, |[x, y], _| {
        if is_poor(x as usize, y as usize) {
            63
        } else {
            191
        }
    });
    let few = offline_with(
        &frame,
        &volume,
        &matter,
        place,
        [4, 512],
        Some(&Arc::new(shares)),
    );
    let all = offline_with(&frame, &volume, &matter, place, [32, 512], None);
    for eye in 0..2 {
        for poor in [true, false] {
            let sum = |picture: &[[f32; 4]]| -> f64 {
                let pixels = picture.iter().enumerate();
                let of = pixels.filter(|(i, _)| is_poor(i % 320, i / 320) == poor);
                of.map(|(_, pixel)| f64::from(pixel[0])).sum()
            };
            let [few, all] = [sum(&few[eye]), sum(&all[eye])];
            let ratio = few / all;
            eprintln!("eye {eye}, poor {poor}: {ratio:.5} of the light");
            assert!(all > 500.0 && (ratio - 1.0).abs() < 0.003, "{ratio}");
        }
    }
}

fn what_nobody_sees_is_not_traced() {
    let (mut app, volume, matter, place) = scene(settings());
    show(&mut app);
    let light = |picture: &[[f32; 4]], columns: std::ops::Range<usize>| -> f64 {
        let rows = picture.chunks(320);
        let pixels = rows.flat_map(|row| &row[columns.clone()]);
        pixels.map(|pixel| f64::from(pixel[0])).sum()
    };
    // The head moves on while a kernel is compiled: until the mask still lies across the light.
    for attempt in 1.. {
        let part = hide_what_is_right_of_the_light(&mut app);
        // The kernel for it may have to be compiled.
        show(&mut app);
        let full = 2 * 320 * 240 * u64::from(SAMPLES);
        let saved = 1.0 - samples_of_a_frame(&mut app) as f64 / full as f64;
        let frame = capture(&mut app);
        let [left, right] = [0, 1].map(|eye: usize| linear(&frame, eye));
        let [all_left, all_right] = offline(&frame, &volume, &matter, place, SAMPLES);
        let middle = (320.0 * part) as usize;
        eprintln!("{saved:.2} of all samples saved; hidden from {middle} on");
        let expected = f64::from(1.0 - part) / 2.0;
        assert!((expected - saved).abs() < 0.06, "{saved}, {expected}");
        // A block beyond the margin of another.
        assert_eq!(light(&left, middle + 24..320), 0.0);
        let ratio = light(&right, 0..320) / light(&all_right, 0..320);
        assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
        let sides = [middle + 24..320, 0..middle].map(|side| light(&all_left, side));
        if sides.iter().any(|light| *light < 100.0) {
            assert!(attempt < 20, "the head never stands still: {sides:.0?}");
            continue;
        }
        let ratio = light(&left, 0..middle) / sides[1];
        assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
        break;
    }
}

/// Hides from the left eye what is right of the middle of the light that it sees now; gives where
/// that is, of its image's width.
fn hide_what_is_right_of_the_light(app: &mut App) -> f32 {
    let frame = capture(app);
    let (mut sum, mut weight) = (0.0, 0.0);
    for (i, pixel) in linear(&frame, 0).iter().enumerate() {
        // The surroundings of the mask before this one are black, too.
        sum += (i % 320) as f32 * pixel[0];
        weight += pixel[0];
    }
    let fov = frame.views[0].fov;
    let (left, right) = (fov.left.tan(), fov.right.tan());
    let part = sum / weight / 320.0;
    let edge = left + part * (right - left);
    let far = 40.0;
    let half = [[
        Vec2::new(edge, -far),
        Vec2::new(far, 0.0),
        Vec2::new(edge, far),
    ]];
    app.world_mut()
        .resource_mut::<MixedRealitySettings>()
        .synthetic_sight = Some(Arc::new(SyntheticSight {
        hidden: [Arc::new(half), Arc::new([])],
        gaze: None,
    }));
    part
}
