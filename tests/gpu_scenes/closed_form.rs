//! Scenes whose pictures are known without a renderer.

use std::f64::consts::PI;

use glam::{DMat4, DVec3};
use holovol_light::EnvironmentMap;
use holovol_render::TraceOptions;
use holovol_scene::{Environment, Scene};

use crate::fields::*;
use crate::gpu::{SIGMAS, Test, assert_mean, effort, mean_and_deviation, options, picture};

/// f32 along a path of a few steps.
const ROUNDING: f64 = 3e-5;

pub fn tests() -> Vec<Test> {
    vec![
        ("slab_has_its_transmittance", slab_has_its_transmittance),
        (
            "ramp_has_the_transmittance_of_its_integral",
            ramp_has_the_transmittance_of_its_integral,
        ),
        (
            "glowing_slab_has_its_closed_form",
            glowing_slab_has_its_closed_form,
        ),
        (
            "emission_is_collected_at_every_collision",
            emission_is_collected_at_every_collision,
        ),
        (
            "single_scattering_is_its_integral_in_a_box",
            single_scattering_is_its_integral_in_a_box,
        ),
        (
            "single_scattering_is_its_integral_in_a_sphere",
            single_scattering_is_its_integral_in_a_sphere,
        ),
        ("white_furnace_loses_nothing", white_furnace_loses_nothing),
        (
            "white_furnace_with_surfaces_gains_nothing",
            white_furnace_with_surfaces_gains_nothing,
        ),
        (
            "bright_texel_shines_from_where_it_is",
            bright_texel_shines_from_where_it_is,
        ),
        (
            "mirrored_volume_lies_where_its_matrix_says",
            mirrored_volume_lies_where_its_matrix_says,
        ),
    ]
}

#[track_caller]
fn assert_opacity(what: &str, scene: &Scene, spp: u32, depth: f64) {
    let image = picture(scene, &options(), effort(spp));
    assert_mean(what, &image, 3, -f64::exp_m1(-depth), ROUNDING);
}

fn slab_has_its_transmittance() {
    for (depth, spp) in [(1e-2, 2048), (0.3, 256), (1.0, 256), (4.0, 64)] {
        let mut scene = homogeneous(depth, 0.0);
        assert_opacity("slab", &scene, spp, depth);
        // Three times as long, off the origin, and seen along another axis.
        scene.world_from_unit_cube = DMat4::from_translation(DVec3::new(-1.5, 0.0, 0.0))
            * DMat4::from_scale(DVec3::new(3.0, 0.1, 0.2));
        scene.camera = beam(DVec3::new(5.0, 0.05, 0.1), DVec3::new(0.0, 0.05, 0.1));
        assert_opacity("long slab", &scene, spp, 3.0 * depth);
    }
}

fn ramp_has_the_transmittance_of_its_integral() {
    // s rises from 0 to 1 over half a metre, and extinction as a tent of height 4: its mean is 2.
    let tent = vec![
        point(0.0, 0.0, 0.0),
        point(0.5, 4.0, 0.0),
        point(1.0, 0.0, 0.0),
    ];
    let step = |at: DVec3| f64::from(u8::from(at.x > 0.5));
    let mut scene = scene(volume([2, 1, 1], step), tent);
    scene.camera = beam(DVec3::new(3.0, 0.0, 0.0), DVec3::ZERO);
    assert_opacity("ramp", &scene, 256, 1.0);
}

fn glowing_slab_has_its_closed_form() {
    for depth in [0.1, 1.0, 5.0] {
        let mut glowing = point(0.0, depth, 0.0);
        glowing.emission = [2.0, 0.5, 0.0];
        let mut scene = scene(volume([1, 1, 1], |_| 0.0), vec![glowing]);
        scene.environment = uniform_light(3.0);
        let opacity = -f64::exp_m1(-depth);
        for max_scatters in [Some(0), Some(1), None] {
            scene.integrator.max_scatters = max_scatters;
            let image = picture(&scene, &options(), effort(512));
            assert_mean("glowing slab", &image, 0, 2.0 * opacity, ROUNDING);
            assert_mean("glowing slab", &image, 1, 0.5 * opacity, ROUNDING);
            assert_eq!(mean_and_deviation(&image)[2].0, 0.0);
        }
    }
}

fn emission_is_collected_at_every_collision() {
    // Nothing escapes from deep inside an opaque medium: E (1 + a + … + aⁿ).
    let albedo = 0.6f64;
    let mut glowing = point(0.0, 1e4, albedo);
    glowing.emission = [1.0; 3];
    let mut scene = scene(volume([1, 1, 1], |_| 0.0), vec![glowing]);
    scene.camera = beam(DVec3::ZERO, DVec3::new(0.0, 0.0, -1.0));
    scene.environment = uniform_light(0.0);
    for n in [Some(0), Some(1), Some(2), Some(5), None] {
        scene.integrator.max_scatters = n;
        let left = n.map_or(0.0, |n| albedo.powi(n as i32 + 1));
        let image = picture(&scene, &options(), effort(1024));
        let expected = (1.0 - left) / (1.0 - albedo);
        assert_mean(&format!("{n:?} scatterings"), &image, 0, expected, ROUNDING);
    }
}

fn henyey_greenstein(g: f64, cosine: f64) -> f64 {
    (1.0 - g * g) / (4.0 * PI * (1.0 + g * g - 2.0 * g * cosine).powf(1.5))
}

/// Light of a few directions only: a lobe about an axis, given by a function and a map of it.
fn lobe(direction: DVec3) -> f64 {
    0.2 + (1.0 + direction.dot(DVec3::new(0.48, 0.6, 0.64))).powi(2)
}

fn lobe_light() -> Environment {
    let (width, height) = (256, 128);
    let texel = |i: usize| {
        let uv = [
            ((i % width) as f64 + 0.5) / width as f64,
            ((i / width) as f64 + 0.5) / height as f64,
        ];
        [lobe(EnvironmentMap::direction_from_uv(uv)) as f32; 3]
    };
    Environment {
        map: EnvironmentMap::new(width, height, (0..width * height).map(texel).collect()),
        rotation_y: 0.0,
        scale: 1.0,
    }
}

/// Singly scattered light of a homogeneous convex body along a ray that is `length` long in it,
/// by the midpoint rule; `exit` gives the way out from a point.
fn single_scattering(
    origin: DVec3,
    direction: DVec3,
    length: f64,
    [sigma_t, albedo, g]: [f64; 3],
    exit: impl Fn(DVec3, DVec3) -> f64,
) -> f64 {
    const VIEW: usize = 48;
    const THETA: usize = 96;
    const PHI: usize = 192;
    let mut sum = 0.0;
    for i in 0..VIEW {
        let t = (i as f64 + 0.5) / VIEW as f64 * length;
        let at = origin + t * direction;
        let mut light = 0.0;
        for j in 0..THETA {
            // Equal steps of the cosine: equal solid angles.
            let y = (j as f64 + 0.5) / THETA as f64 * 2.0 - 1.0;
            let radius = (1.0 - y * y).sqrt();
            for k in 0..PHI {
                let (sin, cos) = ((k as f64 + 0.5) / PHI as f64 * 2.0 * PI).sin_cos();
                let wi = DVec3::new(radius * cos, y, radius * sin);
                let phase = henyey_greenstein(g, direction.dot(wi));
                light += phase * lobe(wi) * (-sigma_t * exit(at, wi)).exp();
            }
        }
        sum += (-sigma_t * t).exp() * light;
    }
    sigma_t * albedo * sum * length / VIEW as f64 * 4.0 * PI / (THETA * PHI) as f64
}

/// All ways of choosing light directions, for a scene that needs no surface.
fn strategies() -> [TraceOptions; 3] {
    [[1, 0], [0, 1], [1, 1]].map(|candidates| TraceOptions {
        light_candidates: Some(candidates),
        ..options()
    })
}

fn single_scattering_is_its_integral_in_a_box() {
    let medium = [1.5, 0.8, 0.4];
    let mut scene = homogeneous(medium[0], medium[1]);
    scene.phase_g = medium[2];
    scene.environment = lobe_light();
    scene.camera = beam(DVec3::new(0.1, 0.2, 3.0), DVec3::new(0.1, 0.2, 0.0));
    let exit = |at: DVec3, wi: DVec3| {
        let to_face = |axis: usize| (0.5 - at[axis] * wi[axis].signum()) / wi[axis].abs();
        to_face(0).min(to_face(1)).min(to_face(2))
    };
    let origin = DVec3::new(0.1, 0.2, 0.5);
    let expected = single_scattering(origin, -DVec3::Z, 1.0, medium, exit);
    for options in strategies() {
        // So many that a fault of 5 % in one of two mixed densities (1 % of the sum) is seen.
        let image = picture(&scene, &options, effort(4096));
        // The midpoint rule and the map's own resolution.
        assert_mean("box", &image, 0, expected, 2e-3);
    }
}

fn single_scattering_is_its_integral_in_a_sphere() {
    const RADIUS: f64 = 0.4;
    let medium = [3.0, 0.9, -0.5];
    let ball = vec![point(RADIUS, medium[0], medium[1]), point(RADIUS, 0.0, 0.0)];
    let from_centre = |at: DVec3| (at - 0.5).length();
    let mut scene = scene(volume([48, 48, 48], from_centre), ball);
    scene.phase_g = medium[2];
    scene.environment = lobe_light();
    let aside = 0.15;
    scene.camera = beam(DVec3::new(aside, 0.0, 3.0), DVec3::new(aside, 0.0, 0.0));
    let half = (RADIUS * RADIUS - aside * aside).sqrt();
    let exit = |at: DVec3, wi: DVec3| {
        let middle = -at.dot(wi);
        middle + (middle * middle + RADIUS * RADIUS - at.length_squared()).sqrt()
    };
    let origin = DVec3::new(aside, 0.0, half);
    let expected = single_scattering(origin, -DVec3::Z, 2.0 * half, medium, exit);
    for options in strategies() {
        let image = picture(&scene, &options, effort(128));
        // Distances interpolated between voxels are too long by up to 3e-4 of the radius.
        assert_mean("sphere", &image, 0, expected, 4e-3);
        assert_mean(
            "sphere",
            &image,
            3,
            -f64::exp_m1(-2.0 * half * medium[0]),
            2e-3,
        );
    }
}

/// Light that is the same from everywhere, as a colour and as a map that is not quite constant:
/// kernels treat the latter as any other map.
fn furnaces() -> [Environment; 2] {
    let mut texels = vec![[1.0; 3]; 16 * 8];
    texels[3 * 16 + 5] = [1.001; 3];
    let mut map = uniform_light(1.0);
    map.map = EnvironmentMap::new(16, 8, texels);
    [uniform_light(1.0), map]
}

fn white_furnace_loses_nothing() {
    for (g, depth) in [
        (0.0, 3.0),
        (0.9, 8.0),
        (-0.9, 4.0),
        (0.999, 20.0),
        (-0.999, 3.0),
    ] {
        for environment in furnaces() {
            let mut scene = scene(
                volume([14, 13, 17], blobs),
                vec![point(0.0, 1.0, 1.0), point(1.0, depth, 1.0)],
            );
            scene.phase_g = g;
            scene.integrator.max_scatters = None;
            scene.environment = environment;
            let image = picture(&scene, &options(), effort(256));
            let [red, _, _, opacity] = mean_and_deviation(&image);
            let noise = red.1.hypot(opacity.1);
            eprintln!("furnace, g {g}: {red:?} of {opacity:?}");
            // The brighter texel adds 1e-5.
            assert!(
                (red.0 - opacity.0).abs() < SIGMAS * noise + 1e-4,
                "g {g}: {red:?} of {opacity:?}"
            );
            assert!(SIGMAS * noise < 0.04 * opacity.0, "g {g}: too noisy");
        }
    }
    let mut scene = homogeneous(20.0, 1.0);
    scene.integrator.max_scatters = None;
    for environment in furnaces() {
        scene.environment = environment;
        let image = picture(&scene, &options(), effort(256));
        assert_mean("opaque furnace", &image, 0, 1.0, 1e-4);
    }
}

fn white_furnace_with_surfaces_gains_nothing() {
    for environment in furnaces() {
        let mut scene = scene(
            volume([14, 13, 17], blobs),
            vec![point(0.0, 1.0, 1.0), point(1.0, 12.0, 1.0)],
        );
        scene.integrator.max_scatters = None;
        scene.gradient_factor = 2.0;
        scene.environment = environment;
        let [matt, _, _, opacity] = mean_and_deviation(&picture(&scene, &options(), effort(256)));
        let noise = SIGMAS * matt.1.hypot(opacity.1);
        eprintln!("matt: {matt:?} of {opacity:?}");
        assert!(
            (matt.0 - opacity.0).abs() < noise + 1e-4,
            "{matt:?} of {opacity:?}"
        );

        let shiny =
            scene
                .transfer_function
                .points()
                .iter()
                .map(|&p| holovol_volume::TransferPoint {
                    specular: 0.9,
                    roughness: 0.7,
                    ..p
                });
        scene.transfer_function = transfer_function(shiny.collect());
        let [red, _, _, opacity] = mean_and_deviation(&picture(&scene, &options(), effort(256)));
        eprintln!("shiny: {red:?} of {opacity:?}");
        let noise = SIGMAS * red.1.hypot(opacity.1);
        assert!(red.0 <= opacity.0 + noise, "{red:?} of {opacity:?}");
        assert!(red.0 >= 0.6 * opacity.0, "{red:?} of {opacity:?}");
    }
}

fn bright_texel_shines_from_where_it_is() {
    // A thin medium that scatters forward is brightest looking toward the light.
    let (width, height) = (64, 32);
    let (column, row) = (40, 9);
    let mut texels = vec![[0.0; 3]; width * height];
    texels[row * width + column] = [1e9; 3];
    let mut scene = homogeneous(0.5, 1.0);
    scene.phase_g = 0.9;
    scene.environment.map = EnvironmentMap::new(width, height, texels);
    scene.environment.rotation_y = 30f64.to_radians();
    scene.world_from_unit_cube =
        DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0)) * scene.world_from_unit_cube;
    // 50.6° right of −z in the map, then 30° counter-clockwise seen from above: to the left.
    let azimuth = ((column as f64 + 0.5) / width as f64 - 0.5) * 360.0 - 30.0;
    let polar = (row as f64 + 0.5) / height as f64 * 180.0;
    let mut seen = |azimuth: f64, polar: f64| {
        let (sin_a, cos_a) = azimuth.to_radians().sin_cos();
        let (sin_p, cos_p) = polar.to_radians().sin_cos();
        let toward = DVec3::new(sin_p * sin_a, cos_p, -sin_p * cos_a);
        scene.camera = beam(-2.0 * toward, DVec3::ZERO);
        let [red, _, _, opacity] = mean_and_deviation(&picture(&scene, &options(), effort(16)));
        red.0 / opacity.0
    };
    let straight = seen(azimuth, polar);
    for (da, dp) in [(12.0, 0.0), (-12.0, 0.0), (0.0, 10.0), (0.0, -10.0)] {
        let aside = seen(azimuth + da, polar + dp);
        assert!(
            aside < 0.7 * straight,
            "{aside} at {da}°, {dp}° from the light, {straight} straight on"
        );
    }
    // A texel of 1e9 seen through a phase function is 1e9 · f(0) · solid angle, less what is lost.
    let texel = (2.0 * PI / width as f64) * (PI / height as f64) * polar.to_radians().sin();
    let bound = 1e9 * henyey_greenstein(0.9, 1.0) * texel;
    assert!(
        straight > 0.3 * bound && straight < bound,
        "{straight:e} of {bound:e}"
    );
}

fn mirrored_volume_lies_where_its_matrix_says() {
    // One opaque corner of an asymmetric phantom, in a mirrored, turned frame.
    let corner = |at: DVec3| f64::from(u8::from(at.x > 0.85 && at.y > 0.7 && at.z < 0.2));
    let opaque = vec![point(0.45, 0.0, 0.0), point(0.55, 500.0, 0.0)];
    let mut scene = scene(volume([8, 8, 8], corner), opaque);
    let turn = DMat4::from_rotation_y(0.3);
    scene.world_from_unit_cube =
        turn * DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0)) * scene.world_from_unit_cube;
    scene.camera.fov_y = 0.6;
    (scene.camera.width, scene.camera.height) = (64, 64);
    let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
    for (i, pixel) in picture(&scene, &options(), 4).pixels().iter().enumerate() {
        let weight = f64::from(pixel[3]);
        sum += weight;
        x += weight * ((i % 64) as f64 + 0.5);
        y += weight * ((i / 64) as f64 + 0.5);
    }
    // The corner's middle: x mirrored to −0.4375, turned by hand, projected by hand.
    let (px, py, pz) = (-0.4375, 0.375, -0.375);
    let (sin, cos) = 0.3f64.sin_cos();
    let (wx, wz) = (cos * px + sin * pz, -sin * px + cos * pz);
    let scale = 32.0 / (0.3f64.tan() * (3.0 - wz));
    let (expected_x, expected_y) = (32.0 + scale * wx, 32.0 - scale * py);
    assert!(sum > 5.0, "the marked corner is not seen");
    let (x, y) = (x / sum, y / sum);
    assert!(
        (x - expected_x).abs() < 1.5 && (y - expected_y).abs() < 1.5,
        "seen at ({x}, {y}), expected at ({expected_x}, {expected_y})"
    );
}
