use glam::{DMat4, DVec3, DVec4};
use holovol_light::EnvironmentMap;

use super::scenes::*;
use crate::Tracer;
use crate::field::Field;
use crate::tracking::Vertex;

#[test]
fn slab_opacity_is_one_minus_transmittance() {
    for depth in [1e-3, 0.1, 1.0, 4.0] {
        let mut scene = homogeneous(depth, 0.0);
        assert_opacity("slab", &film(&scene, 400), -f64::exp_m1(-depth));
        // Three times as long and seen along another axis.
        scene.world_from_unit_cube = DMat4::from_translation(DVec3::new(-1.5, 0.0, 0.0))
            * DMat4::from_scale(DVec3::new(3.0, 0.1, 0.2));
        scene.camera = beam(DVec3::new(5.0, 0.05, 0.1), DVec3::new(0.0, 0.05, 0.1));
        assert_opacity("long slab", &film(&scene, 400), -f64::exp_m1(-3.0 * depth));
    }
}

#[test]
fn planes_leave_out_what_is_before_them() {
    let mut scene = homogeneous(2.0, 0.5);
    // A stretched cube that still is one metre along the view.
    scene.world_from_unit_cube = DMat4::from_translation(DVec3::new(-2.0, -0.5, -0.5))
        * DMat4::from_scale(DVec3::new(4.0, 1.0, 1.0));
    for (clip_planes, left) in [
        (vec![DVec4::new(0.0, 0.0, -3.0, 0.6)], 0.7),
        (vec![DVec4::new(0.0, 0.0, 1.0, 0.1)], 0.6),
        (
            vec![
                DVec4::new(0.0, 0.0, -1.0, 0.2),
                DVec4::new(0.0, 0.0, 1.0, 0.1),
            ],
            0.3,
        ),
        (vec![DVec4::new(1.0, 0.0, 0.0, -0.4)], 0.0),
    ] {
        scene.clip_planes = clip_planes;
        assert_opacity(
            "what is left",
            &film(&scene, 400),
            -f64::exp_m1(-2.0 * left),
        );
    }
}

#[test]
fn camera_rays_end_where_they_are_told_to() {
    let scene = homogeneous(2.0, 0.5);
    // The cube's front is half a metre before its centre.
    let front = scene.camera.eye.length() - 0.5;
    for inside in [-1.0, 0.25, 0.8, 2.0] {
        let tracer = Tracer::new(&scene, &settings(400))
            .expect("a scene")
            .with_camera_ray_end(|_| front + inside);
        let mut film = tracer.film();
        tracer.accumulate(&mut film, 400);
        let expected = -f64::exp_m1(-2.0 * inside.clamp(0.0, 1.0));
        assert_opacity("what is before the end", &film, expected);
    }
}

#[test]
fn transmittance_is_that_of_the_integral_over_a_ramp() {
    // Two voxels: s rises linearly from ¼ to ¾ of the way, σ = 8 s(1 − s)-like by a tent in s.
    let tent = vec![
        point(0.0, 0.0, 0.0),
        point(0.5, 4.0, 0.0),
        point(1.0, 0.0, 0.0),
    ];
    let mut scene = scene(
        volume([2, 1, 1], |at| if at.x > 0.5 { 1.0 } else { 0.0 }),
        tent,
    );
    scene.camera = beam(DVec3::new(3.0, 0.0, 0.0), DVec3::ZERO);
    // Half a metre of a tent of height 4: its mean is 2.
    assert_opacity("ramp", &film(&scene, 400), -f64::exp_m1(-1.0));
}

#[test]
fn emission_of_an_absorbing_slab_has_its_closed_form() {
    for depth in [0.05, 1.0, 5.0] {
        let mut glowing = point(0.0, depth, 0.0);
        glowing.emission = [2.0, 0.5, 0.0];
        let mut scene = scene(volume([1, 1, 1], |_| 0.0), vec![glowing]);
        scene.environment = uniform_light(3.0);
        for max_scatters in [Some(0), Some(1), None] {
            scene.integrator.max_scatters = max_scatters;
            let opacity = -f64::exp_m1(-depth);
            let expected = [2.0 * opacity, 0.5 * opacity, 0.0];
            assert_mean("glowing slab", &film(&scene, 400), expected, 0.0);
        }
    }
}

#[test]
fn emission_is_collected_at_every_collision_of_the_allowed_paths() {
    // Deep inside an opaque medium nothing escapes: E (1 + a + … + aⁿ).
    let albedo = 0.6f64;
    let mut glowing = point(0.0, 1e4, albedo);
    glowing.emission = [1.0; 3];
    let mut scene = scene(volume([1, 1, 1], |_| 0.0), vec![glowing]);
    scene.camera = beam(DVec3::ZERO, DVec3::new(0.0, 0.0, -1.0));
    scene.environment = uniform_light(0.0);
    for n in [0, 1, 2, 5] {
        scene.integrator.max_scatters = Some(n);
        let expected = (1.0 - albedo.powi(n as i32 + 1)) / (1.0 - albedo);
        assert_mean("glowing fog", &film(&scene, 50), [expected; 3], 1e-9);
    }
    scene.integrator.max_scatters = None;
    let expected = [1.0 / (1.0 - albedo); 3];
    assert_mean(
        "glowing fog without limit",
        &film(&scene, 50),
        expected,
        1e-9,
    );
}

#[test]
fn thin_medium_scatters_once_by_its_closed_form() {
    // Uniform light L on a slab so thin that nothing is lost: L · albedo · depth.
    let mut scene = homogeneous(1e-4, 0.7);
    scene.world_from_unit_cube = DMat4::from_translation(DVec3::new(-0.5, -0.5, -0.5));
    scene.environment = uniform_light(2.0);
    scene.phase_g = 0.6;
    let film = film(&scene, 4000);
    // Losses on the way out are below 2e-4.
    assert_mean("thin slab", &film, [2.0 * 0.7 * 1e-4; 3], 2e-4);
}

#[test]
fn white_furnace_gives_back_every_photon() {
    for (g, depth) in [
        (0.0, 3.0),
        (0.9, 8.0),
        (-0.9, 8.0),
        (0.999, 20.0),
        (-0.999, 3.0),
    ] {
        let mut scene = scene(
            volume([6, 5, 7], bump),
            vec![point(0.0, 0.0, 1.0), point(1.0, depth, 1.0)],
        );
        scene.phase_g = g;
        scene.integrator.max_scatters = None;
        for [r, green, b, opacity] in film(&scene, 8).means() {
            for channel in [r, green, b] {
                assert!(
                    (channel - opacity).abs() < 1e-9,
                    "g {g}: {channel} of {opacity}"
                );
            }
        }
    }
}

#[test]
fn opaque_white_furnace_is_exactly_one() {
    let mut scene = homogeneous(60.0, 1.0);
    scene.integrator.max_scatters = None;
    for pixel in film(&scene, 4).means() {
        assert!(pixel.iter().all(|c| (c - 1.0).abs() < 1e-12), "{pixel:?}");
    }
}

#[test]
fn white_furnace_with_a_matt_surface_is_one_and_with_a_glossy_one_less() {
    let mut scene = scene(
        volume([6, 5, 7], bump),
        vec![point(0.0, 0.0, 1.0), point(1.0, 12.0, 1.0)],
    );
    scene.integrator.max_scatters = None;
    scene.gradient_factor = 3.0;
    scene.camera.fov_y = 0.4;
    let matt = film(&scene, 16);
    for [r, _, _, opacity] in matt.means() {
        assert!((r - opacity).abs() < 1e-9, "{r} of {opacity}");
    }
    let [points] = [scene.transfer_function.points().to_vec()];
    let glossy = points.into_iter().map(|p| holovol_volume::TransferPoint {
        specular: 0.9,
        roughness: 0.7,
        ..p
    });
    scene.transfer_function = transfer_function(glossy.collect());
    let observed = mean_and_variance(&film(&scene, 64));
    let (radiance, opacity) = (observed[0], observed[3]);
    let noise = (radiance.1 + opacity.1).sqrt();
    assert!(radiance.0 <= opacity.0 + 5.0 * noise, "{observed:?}");
    assert!(radiance.0 >= 0.5 * opacity.0, "{observed:?}");
}

#[test]
fn nothing_of_the_environment_itself_is_seen() {
    let scene = homogeneous(0.0, 1.0);
    assert!(film(&scene, 2).means().all(|pixel| pixel == [0.0; 4]));
}

#[test]
fn black_environment_leaves_opacity_only() {
    let mut scene = homogeneous(2.0, 0.9);
    scene.environment = uniform_light(0.0);
    let black = film(&scene, 200);
    assert_opacity("black", &black, -f64::exp_m1(-2.0));
    assert!(black.means().all(|pixel| pixel[..3] == [0.0; 3]));
    scene.environment.map = EnvironmentMap::new(2, 2, vec![[0.0, 0.0, 1.0]; 4]);
    assert!(
        film(&scene, 4).means().any(|pixel| pixel[2] > 0.0),
        "blue alone is light"
    );
}

#[test]
fn surface_share_and_normal_are_those_of_a_ramp() {
    // s rises by ⅛ per voxel along x; the cube is 2 × 1 × 0.5 m, so the least spacing is 1/16 m.
    let mut points = vec![point(0.0, 1.0, 1.0)];
    points[0].roughness = 0.6;
    points[0].specular = 0.3;
    let mut scene = scene(volume([8, 4, 8], |at| at.x), points);
    scene.world_from_unit_cube = DMat4::from_scale(DVec3::new(2.0, 1.0, 0.5));
    scene.gradient_factor = 20.0;
    let tracer = Tracer::new(&scene, &settings(1)).expect("a scene");
    let holovol_volume::Voxels::F32(voxels) = scene.volume.voxels() else {
        unreachable!("made of f32");
    };
    let field = Field::new(&scene, voxels);
    let vertex = Vertex {
        texel: DVec3::new(4.2, 2.0, 4.0),
        s: 0.5,
    };
    let material = scene.transfer_function.eval(0.5);
    for side in [1.0, -1.0] {
        let wo = DVec3::new(0.6 * side, 0.8, 0.0);
        let phase = tracer.phase(&field, &vertex, &material, wo);
        let surface = phase.surface.expect("there is a gradient");
        // |∇s| = ½ per metre: P = 1 − exp(−20 · ½ / 16).
        let expected = 1.0 - (-20.0f64 * 0.5 / 16.0).exp();
        assert!(
            (surface.weight - expected).abs() < 1e-6,
            "{}",
            surface.weight
        );
        assert!(
            (surface.normal - DVec3::X * side).length() < 1e-6,
            "{}",
            surface.normal
        );
        assert!((surface.alpha - 0.36).abs() < 1e-12 && surface.f0 == 0.3);
    }
}

#[test]
fn film_knows_its_variance() {
    // Opacity is 0 or 1 with probability p: the mean of n has variance p(1 − p)/n.
    let scene = homogeneous(0.7, 0.5);
    let film = film(&scene, 100);
    let p = -f64::exp_m1(-0.7);
    let variances = film.variances().map(|variance| variance[3]);
    let mean = variances.sum::<f64>() / 256.0;
    let expected = p * (1.0 - p) / 100.0;
    // 256 estimates of 100 samples each: known to better than 1 %.
    assert!(
        (mean / expected - 1.0).abs() < 0.04,
        "{mean} is not {expected}"
    );
    assert_eq!(film.samples(), 100);
}
