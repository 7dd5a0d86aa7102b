use std::ops::ControlFlow;

use glam::{DMat4, DVec3};
use holovol_scene::{Camera, Scene};
use holovol_volume::{Geometry, TransferPoint, Volume, Voxels};

use super::quadrature::two_tissues;
use super::scenes::*;
use crate::{Film, Settings};

fn picture() -> Scene {
    let mut points = two_tissues();
    points[1].specular = 0.4;
    let mut scene = scene(volume([9, 7, 8], bump), points);
    scene.environment = uneven_light();
    scene.gradient_factor = 1.0;
    scene.phase_g = 0.4;
    scene.integrator.max_scatters = Some(4);
    scene.camera = Camera {
        fov_y: 0.5,
        width: 24,
        height: 20,
        ..beam(DVec3::new(1.0, 0.7, 2.6), DVec3::ZERO)
    };
    scene
}

/// Fails unless the same random numbers led to the same picture; rounding may turn the odd path.
fn assert_same(what: &str, a: &Film, b: &Film) {
    let differing = a
        .means()
        .zip(b.means())
        .filter(|(x, y)| (0..4).any(|c| (x[c] - y[c]).abs() > 1e-5 * (1.0 + x[c].abs())))
        .count();
    assert!(differing <= 2, "{what}: {differing} pixels differ");
    assert!(a.means().any(|pixel| pixel[0] > 0.01), "{what}: all black");
}

#[test]
fn a_thousand_times_larger_world_with_thinner_matter_is_the_same_picture() {
    let small = picture();
    for factor in [1000.0, 1e-6, 1e4] {
        let mut large = small.clone();
        large.world_from_unit_cube =
            DMat4::from_scale(DVec3::splat(factor)) * large.world_from_unit_cube;
        large.camera.eye *= factor;
        large.camera.target *= factor;
        large.transfer_function = large.transfer_function.scaled(1.0 / factor);
        assert_same("scaled", &film(&small, 4), &film(&large, 4));
    }
}

#[test]
fn moving_everything_far_away_changes_nothing() {
    let near = picture();
    let mut far = near.clone();
    let offset = DVec3::new(1e5, -2e4, 3e4);
    far.world_from_unit_cube = DMat4::from_translation(offset) * far.world_from_unit_cube;
    far.camera.eye += offset;
    far.camera.target += offset;
    assert_same("moved", &film(&near, 4), &film(&far, 4));
}

#[test]
fn turning_everything_about_the_vertical_changes_nothing() {
    let before = picture();
    let mut after = before.clone();
    let angle = 30f64.to_radians();
    let turn = DMat4::from_rotation_y(angle);
    after.world_from_unit_cube = turn * after.world_from_unit_cube;
    after.camera.eye = turn.transform_point3(after.camera.eye);
    after.camera.target = turn.transform_point3(after.camera.target);
    after.environment.rotation_y += angle;
    // Frames about directions turn differently, so random numbers mean other directions.
    let (a, b) = (film(&before, 64), film(&after, 64));
    let [x, y] = [&a, &b].map(mean_and_variance);
    for c in 0..4 {
        let z = (x[c].0 - y[c].0) / (x[c].1 + y[c].1).sqrt();
        assert!(z.abs() < 5.0, "channel {c}: {x:?} {y:?}");
    }
}

#[test]
fn a_mirrored_volume_lies_where_its_matrix_says() {
    // One opaque corner of an asymmetric phantom, in a mirrored, turned frame.
    let marked = volume([8, 8, 8], |at| {
        f64::from(u8::from(at.x > 0.85 && at.y > 0.7 && at.z < 0.2))
    });
    let opaque = vec![point(0.45, 0.0, 0.0), point(0.55, 500.0, 0.0)];
    let mut scene = scene(marked, opaque);
    let turn = DMat4::from_rotation_y(0.3);
    scene.world_from_unit_cube =
        turn * DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0)) * scene.world_from_unit_cube;
    scene.camera = Camera {
        fov_y: 0.6,
        width: 64,
        height: 64,
        ..beam(DVec3::new(0.0, 0.0, 3.0), DVec3::ZERO)
    };
    let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
    for (i, pixel) in film(&scene, 4).means().enumerate() {
        sum += pixel[3];
        x += pixel[3] * ((i % 64) as f64 + 0.5);
        y += pixel[3] * ((i / 64) as f64 + 0.5);
    }
    // The marked voxels' middle: x mirrored to −0.4375, then turned toward the camera by hand.
    let (px, py, pz) = (-0.4375, 0.375, -0.375);
    let (sin, cos) = 0.3f64.sin_cos();
    let (wx, wz) = (cos * px + sin * pz, -sin * px + cos * pz);
    let scale = 32.0 / (0.3f64.tan() * (3.0 - wz));
    let expected = (32.0 + scale * wx, 32.0 - scale * py);
    assert!(sum > 5.0, "the marked corner is not seen");
    let seen = (x / sum, y / sum);
    assert!(
        (seen.0 - expected.0).abs() < 1.5 && (seen.1 - expected.1).abs() < 1.5,
        "seen at {seen:?}, expected at {expected:?}"
    );
}

#[test]
fn one_bright_texel_shines_from_where_it_is() {
    // A thin medium that scatters forward is brightest looking toward the light.
    let (width, height) = (64, 32);
    let (column, row) = (40, 9);
    let mut texels = vec![[0.0; 3]; width * height];
    texels[row * width + column] = [1e4; 3];
    let mut scene = homogeneous(1e-3, 1.0);
    scene.phase_g = 0.9;
    scene.environment.map = holovol_light::EnvironmentMap::new(width, height, texels);
    scene.environment.rotation_y = 30f64.to_radians();
    scene.world_from_unit_cube =
        DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0)) * scene.world_from_unit_cube;
    // By hand: 50.6° right of −z, then 30° counter-clockwise, which is to the left.
    let azimuth = ((column as f64 + 0.5) / width as f64 - 0.5) * 360.0 - 30.0;
    let polar = (row as f64 + 0.5) / height as f64 * 180.0;
    let toward = |azimuth: f64, polar: f64| {
        let (sin_a, cos_a) = azimuth.to_radians().sin_cos();
        let (sin_p, cos_p) = polar.to_radians().sin_cos();
        DVec3::new(sin_p * sin_a, cos_p, -sin_p * cos_a)
    };
    let mut seen = |azimuth: f64, polar: f64| {
        scene.camera = beam(DVec3::ZERO, toward(azimuth, polar));
        let film = film(&scene, 2000);
        let [red, .., opacity] = mean_and_variance(&film);
        red.0 / opacity.0
    };
    let straight = seen(azimuth, polar);
    for (da, dp) in [(12.0, 0.0), (-12.0, 0.0), (0.0, 10.0), (0.0, -10.0)] {
        let aside = seen(azimuth + da, polar + dp);
        assert!(
            aside < 0.6 * straight,
            "{aside} at {da}°, {dp}°, {straight} straight on"
        );
    }
}

#[test]
fn number_types_of_one_field_agree() {
    let dims = [5u32, 4, 6];
    let values: Vec<u8> = (0..120u32).map(|i| ((i * 37) % 101) as u8).collect();
    let with = |voxels: Voxels, slope: f64, intercept: f64| {
        let geometry = Geometry::from_spacing([1.0; 3]);
        let volume = Volume::new(voxels, dims, slope, intercept, geometry).expect("120 voxels");
        let mut scene = scene(volume, two_tissues());
        scene.window = [0.0, 100.0];
        scene.camera.fov_y = 0.3;
        film(&scene, 8)
    };
    let base = with(Voxels::U8(values.clone()), 1.0, 0.0);
    let shifted = values.iter().map(|&v| i16::from(v) - 50);
    let halved = values.iter().map(|&v| f32::from(v) / 2.0);
    let others = [
        with(
            Voxels::I8(values.iter().map(|&v| v as i8 - 50).collect()),
            1.0,
            50.0,
        ),
        with(
            Voxels::U16(values.iter().map(|&v| u16::from(v) * 3).collect()),
            1.0 / 3.0,
            0.0,
        ),
        with(Voxels::I16(shifted.collect()), 1.0, 50.0),
        with(Voxels::F32(halved.collect()), 2.0, 0.0),
    ];
    for other in &others {
        assert_same("number type", &base, other);
    }
}

#[test]
fn a_reversed_window_mirrors_the_transfer_function() {
    let forward = picture();
    let mut reversed = forward.clone();
    reversed.window = [1.0, 0.0];
    let points = forward.transfer_function.points().iter().rev();
    let mirrored = points.map(|p| TransferPoint { s: 1.0 - p.s, ..*p });
    reversed.transfer_function = transfer_function(mirrored.collect());
    // Gradients point the other way, and normals are turned to the viewer.
    assert_same("reversed", &film(&forward, 4), &film(&reversed, 4));
}

#[test]
fn same_seed_gives_the_same_bits_and_another_seed_does_not() {
    let scene = picture();
    let bits = |seed: u64, threads: usize, passes: &[u32]| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let settings = Settings {
            seed,
            ..settings(6)
        };
        pool.expect("a thread pool").install(|| {
            let tracer = crate::Tracer::new(&scene, &settings).expect("a scene");
            let mut film = tracer.film();
            passes.iter().for_each(|&n| tracer.accumulate(&mut film, n));
            film.image()
        })
    };
    let one = bits(u64::MAX, 1, &[6]);
    assert_eq!(one, bits(u64::MAX, 3, &[1, 2, 3]));
    assert_ne!(one, bits(0, 1, &[6]));
}

#[test]
fn rendering_stops_when_asked() {
    let scene = picture();
    let film = crate::render(&scene, &settings(64), &mut |done| {
        if done >= 3 {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    });
    assert_eq!(film.expect("a scene").samples(), 3);
}
