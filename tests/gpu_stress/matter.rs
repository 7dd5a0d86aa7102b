//! Extinction, albedo, light and transfer functions at their limits.

use glam::{DMat4, DVec3};
use holovol_light::EnvironmentMap;
use holovol_volume::TransferPoint;

use crate::fields::*;
use crate::gpu::{
    Test, assert_agree, assert_clean, assert_mean, effort, image, mean_and_deviation, options,
    picture, reference, statistics, tracer,
};

const ROUNDING: f64 = 1e-4;

pub fn tests() -> Vec<Test> {
    vec![
        (
            "optical_depths_of_twelve_decades_have_their_opacity",
            optical_depths_of_twelve_decades_have_their_opacity,
        ),
        (
            "loose_majorants_round_nothing_away",
            loose_majorants_round_nothing_away,
        ),
        (
            "extinctions_of_thirteen_decades_have_their_opacity",
            extinctions_of_thirteen_decades_have_their_opacity,
        ),
        ("black_matter_gives_no_light", black_matter_gives_no_light),
        (
            "black_environment_gives_no_light",
            black_environment_gives_no_light,
        ),
        ("empty_matter_is_not_there", empty_matter_is_not_there),
        ("extreme_light_stays_finite", extreme_light_stays_finite),
        (
            "vertical_steps_are_where_their_points_are",
            vertical_steps_are_where_their_points_are,
        ),
        (
            "transfer_functions_of_any_length_agree",
            transfer_functions_of_any_length_agree,
        ),
        ("reversed_window_mirrors", reversed_window_mirrors),
        ("narrow_peaks_are_not_missed", narrow_peaks_are_not_missed),
    ]
}

fn optical_depths_of_twelve_decades_have_their_opacity() {
    // Two voxels that differ, so that collisions are weighed: opacity is an expectation. Thinner
    // matter is met so rarely that noise hides it, hence a majorant far above it.
    for depth in [1e-6, 1e-4, 1e-2, 1.0, 30.0, 1e4, 1e6] {
        let mut scene = scene(
            volume([4, 4, 16], |at| f64::from(u8::from(at.z > 0.5))),
            vec![point(0.0, depth, 0.5), point(1.0, depth, 0.5)],
        );
        if depth < 0.1 {
            // A vertical line in s that the field passes in no time lifts the majorant to 20.
            scene.transfer_function = transfer_function(vec![
                point(0.0, depth, 0.5),
                point(0.5, depth, 0.5),
                point(0.5, 20.0, 0.5),
                point(0.5, depth, 0.5),
                point(1.0, depth, 0.5),
            ]);
        }
        let image = picture(&scene, &options(), effort(256));
        let expected = -f64::exp_m1(-depth);
        assert_mean(&format!("depth {depth:e}"), &image, 3, expected, ROUNDING);
    }
}

fn loose_majorants_round_nothing_away() {
    // A vertical line in s that the field passes in no time lifts the majorant far above what is
    // there: each collision then takes off less than f32 keeps of a transmittance.
    for (depth, majorant, spp) in [(2.0, 2e4, 16), (2.0, 2e5, 4), (1.0, 2e6, 1)] {
        let mut scene = scene(
            volume([4, 4, 4], |at| f64::from(u8::from(at.z > 0.5))),
            vec![
                point(0.0, depth, 0.5),
                point(0.5, depth, 0.5),
                point(0.5, majorant, 0.5),
                point(0.5, depth, 0.5),
                point(1.0, depth, 0.5),
            ],
        );
        (scene.camera.width, scene.camera.height) = (8, 8);
        let image = picture(&scene, &options(), spp);
        let what = format!("depth {depth} under a majorant of {majorant:e}");
        assert_mean(&what, &image, 3, -f64::exp_m1(-depth), ROUNDING);
        // Per sample a standard deviation of about 2 %: a bias of 1 % shows.
        let (mean, deviation) = mean_and_deviation(&image)[3];
        assert!(deviation < 0.005, "{what}: {mean} ± {deviation}");
    }
}

fn extinctions_of_thirteen_decades_have_their_opacity() {
    for sigma_t in [1e-6, 1e-3, 1.0, 1e3, 1e7] {
        let size = 1.0 / sigma_t;
        let mut scene = homogeneous(sigma_t, 0.5);
        scene.world_from_unit_cube =
            DMat4::from_scale(DVec3::splat(size)) * scene.world_from_unit_cube;
        scene.camera = beam(DVec3::new(0.0, 0.0, 3.0 * size), DVec3::ZERO);
        let image = picture(&scene, &options(), effort(256));
        let what = format!("{sigma_t:e} per metre");
        assert_mean(&what, &image, 3, -f64::exp_m1(-1.0), ROUNDING);
    }
}

fn black_matter_gives_no_light() {
    let mut scene = homogeneous(2.0, 0.0);
    for max_scatters in [Some(1), None] {
        scene.integrator.max_scatters = max_scatters;
        let image = picture(&scene, &options(), effort(128));
        assert!(image.pixels().iter().all(|pixel| pixel[..3] == [0.0; 3]));
        assert_mean("black matter", &image, 3, -f64::exp_m1(-2.0), ROUNDING);
    }
}

fn black_environment_gives_no_light() {
    let mut scene = blob_scene();
    scene.camera = beam(DVec3::new(0.0, 0.0, 3.0), DVec3::ZERO);
    scene.transfer_function = transfer_function(vec![point(0.0, 2.0, 0.9)]);
    scene.integrator.max_scatters = None;
    for map in [
        EnvironmentMap::constant([0.0; 3]),
        EnvironmentMap::new(4, 2, vec![[0.0; 3]; 8]),
    ] {
        scene.environment.map = map;
        let image = picture(&scene, &options(), effort(128));
        assert!(image.pixels().iter().all(|pixel| pixel[..3] == [0.0; 3]));
        assert_mean("black light", &image, 3, -f64::exp_m1(-2.0), ROUNDING);
    }
    // Blue alone is light; so is one texel of the last row.
    let mut texels = vec![[0.0; 3]; 32];
    texels[31] = [0.0, 0.0, 5.0];
    scene.environment.map = EnvironmentMap::new(8, 4, texels);
    let mean = mean_and_deviation(&picture(&scene, &options(), effort(16)));
    assert!(mean[2].0 > 0.01 && mean[0].0 == 0.0, "{mean:?}");
}

fn empty_matter_is_not_there() {
    let mut scene = homogeneous(0.0, 1.0);
    scene.integrator.max_scatters = None;
    let image = picture(&scene, &options(), 4);
    assert!(image.pixels().iter().all(|pixel| *pixel == [0.0; 4]));
}

fn extreme_light_stays_finite() {
    let mut texels = vec![[0.2, 0.3, 0.4]; 32 * 16];
    texels[100] = [1e9; 3];
    texels[511] = [f32::INFINITY, f32::NAN, -1.0];
    texels[0] = [f32::NAN; 3];
    for g in [0.0, 0.999, -0.999] {
        let mut scene = blob_scene();
        // The infinite texel is as bright as numbers allow: scaled to what can be summed.
        scene.environment.map = EnvironmentMap::new(32, 16, texels.clone());
        scene.environment.scale = 1e-9;
        scene.phase_g = g;
        scene.gradient_factor = 5.0;
        scene.integrator.max_scatters = None;
        let image = picture(&scene, &options(), effort(32));
        assert!(
            image.pixels().iter().flatten().all(|c| c.is_finite()),
            "g {g}"
        );
        assert!(image.pixels().iter().any(|pixel| pixel[0] > 0.0), "g {g}");
    }
}

fn vertical_steps_are_where_their_points_are() {
    // s rises from 1/16 to 15/16 over 7/8 of a metre. Of coincident points the later one holds:
    // 3 per metre where s ≥ ½, nothing below.
    let step = vec![
        point(0.5, 0.0, 0.0),
        point(0.5, 1.0, 0.0),
        point(0.5, 3.0, 0.0),
    ];
    let mut scene = scene(volume([8, 1, 1], |at| at.x), step);
    scene.camera = beam(DVec3::new(3.0, 0.0, 0.0), DVec3::ZERO);
    let image = picture(&scene, &options(), effort(256));
    assert_mean("step", &image, 3, -f64::exp_m1(-1.5), ROUNDING);

    // A field that is exactly at the step: the later point holds, and the majorant knows.
    scene.volume = volume([9, 9, 9], |_| 0.5);
    let image = picture(&scene, &options(), effort(256));
    assert_mean("at the step", &image, 3, -f64::exp_m1(-3.0), ROUNDING);

    // A spike of no width is not met; but it lifts majorants far above all that is.
    scene.volume = volume([8, 1, 1], |at| at.x);
    scene.transfer_function = transfer_function(vec![
        point(0.0, 1.0, 0.0),
        point(0.5, 1.0, 0.0),
        point(0.5, 1e3, 0.0),
        point(0.5, 1.0, 0.0),
        point(1.0, 1.0, 0.0),
    ]);
    let image = picture(&scene, &options(), effort(64));
    assert_mean("spike", &image, 3, -f64::exp_m1(-1.0), ROUNDING);
}

/// The same function from ever more points: few are unrolled in the kernel, many searched.
fn transfer_functions_of_any_length_agree() {
    let mut scene = blob_scene();
    let spp = effort(512);
    let expected = reference(&scene, spp);
    let few = scene.transfer_function.clone();
    for count in [9, 100, 1000] {
        let mut points: Vec<TransferPoint> = (0..count)
            .map(|i| {
                let s = f64::from(i) / f64::from(count - 1);
                let m = few.eval(s);
                point(s, m.sigma_t, m.albedo[0])
            })
            .collect();
        points.extend_from_slice(few.points());
        points.sort_by(|a, b| a.s.total_cmp(&b.s));
        scene.transfer_function = transfer_function(points);
        let what = format!("{count} points");
        assert_agree(
            &what,
            &statistics(&what, &scene, &options(), spp / 16),
            &expected,
        );
    }
    // A single one holds everywhere.
    scene.transfer_function = transfer_function(vec![point(0.3, 2.0, 0.7)]);
    assert_agree(
        "one point",
        &statistics("one point", &scene, &options(), spp / 16),
        &reference(&scene, spp),
    );
}

fn reversed_window_mirrors() {
    let mut scene = blob_scene();
    scene.gradient_factor = 1.0;
    let spp = effort(512);
    let expected = reference(&scene, spp);
    scene.window = [1.0, 0.0];
    let points = scene.transfer_function.points().iter().rev();
    let mirrored = points.map(|p| TransferPoint { s: 1.0 - p.s, ..*p });
    scene.transfer_function = transfer_function(mirrored.collect());
    let ours = statistics("reversed", &scene, &options(), spp / 16);
    assert_agree("reversed window", &ours, &expected);
}

/// Points far closer together than voxels differ, in a window far wider than the data.
fn narrow_peaks_are_not_missed() {
    let mut scene = scene(
        volume([32, 3, 3], |at| at.x),
        vec![
            point(0.0, 0.0, 0.0),
            point(0.3, 0.0, 0.0),
            point(0.3005, 2000.0, 0.0),
            point(0.301, 0.0, 0.0),
        ],
    );
    scene.camera = beam(DVec3::new(3.0, 0.0, 0.0), DVec3::ZERO);
    // A triangle of height 2000 and width 0.001 m.
    let mut tracer = tracer(&scene, &options());
    tracer.accumulate(effort(512)).expect("samples");
    assert_clean("peak", &tracer.counters());
    // s has 24 bits, of which the peak's width keeps 14.
    assert_mean("peak", &image(&tracer), 3, -f64::exp_m1(-1.0), 1e-3);
}
