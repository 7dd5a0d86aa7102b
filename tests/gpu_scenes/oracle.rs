//! The kernel against the f64 reference, which shares no sampling code with it.

use glam::{DMat4, DVec3, DVec4};
use holovol_light::EnvironmentMap;
use holovol_render::TraceOptions;
use holovol_scene::Scene;
use holovol_volume::TransferPoint;

use crate::fields::*;
use crate::gpu::{Test, assert_agree, effort, options, reference, statistics};

pub fn tests() -> Vec<Test> {
    vec![
        ("surfaces_agree", surfaces_agree),
        ("emission_agrees", emission_agrees),
        ("placements_agree", placements_agree),
        ("cuts_agree", cuts_agree),
        ("cameras_agree", cameras_agree),
        ("phase_functions_agree", phase_functions_agree),
        ("scattering_orders_agree", scattering_orders_agree),
        ("light_strategies_agree", light_strategies_agree),
        ("numbers_of_picks_agree", numbers_of_picks_agree),
        ("cell_sizes_agree", cell_sizes_agree),
        ("sun_of_one_texel_agrees", sun_of_one_texel_agrees),
    ]
}

/// Samples per pixel of the reference; each of the kernel's pictures has a sixteenth.
const SPP: u32 = 512;

#[track_caller]
fn assert_same(what: &str, scene: &Scene, options: &TraceOptions) {
    let spp = effort(SPP);
    let ours = statistics(what, scene, options, spp / 16);
    assert_agree(what, &ours, &reference(scene, spp));
}

fn with_points(scene: &mut Scene, change: impl Fn(TransferPoint) -> TransferPoint) {
    let points = scene.transfer_function.points().iter().copied();
    scene.transfer_function = transfer_function(points.map(change).collect());
}

fn surfaces_agree() {
    for (k, specular, roughness, scatters) in [
        (0.5, 0.0, 0.5, 1),
        (2.0, 0.04, 0.3, 1),
        (5.0, 0.6, 0.15, 1),
        (50.0, 1.0, 1.0, 1),
        (2.0, 0.5, 0.4, 4),
    ] {
        let mut scene = blob_scene();
        scene.gradient_factor = k;
        scene.phase_g = 0.3;
        scene.integrator.max_scatters = Some(scatters);
        // Material varies with s.
        with_points(&mut scene, |p| TransferPoint {
            specular: specular * p.s.min(1.0),
            roughness,
            ..p
        });
        let what = format!("surface, k {k}, specular {specular}, {scatters} scatterings");
        assert_same(&what, &scene, &options());
        // Uniform light needs no candidate from the environment: with so little noise, an error of
        // the scattering direction's density or of the gradient is seen.
        scene.environment = uniform_light(1.0);
        let what = format!("{what}, uniform light");
        let spp = effort(4 * SPP);
        let ours = statistics(&what, &scene, &options(), spp / 16);
        assert_agree(&what, &ours, &reference(&scene, spp));
    }
    // A shiny furnace: errors add up with every scattering.
    let mut scene = blob_scene();
    scene.environment = uniform_light(1.0);
    scene.gradient_factor = 2.0;
    scene.integrator.max_scatters = None;
    let glossy = |s, sigma_t| TransferPoint {
        specular: 0.9,
        roughness: 0.7,
        ..point(s, sigma_t, 1.0)
    };
    scene.transfer_function = transfer_function(vec![glossy(0.0, 1.0), glossy(1.0, 12.0)]);
    assert_same("shiny furnace", &scene, &options());
}

fn emission_agrees() {
    for (max_scatters, k) in [(Some(0), 0.0), (Some(1), 0.0), (Some(2), 1.0), (None, 0.0)] {
        let mut scene = blob_scene();
        scene.integrator.max_scatters = max_scatters;
        scene.gradient_factor = k;
        with_points(&mut scene, |p| TransferPoint {
            emission: [1.5 * p.s, 0.4, 2.0 * (1.0 - p.s)],
            ..p
        });
        assert_same(
            &format!("emission, {max_scatters:?}, k {k}"),
            &scene,
            &options(),
        );
    }
}

fn placements_agree() {
    let base = blob_scene().world_from_unit_cube;
    let scale = |x, y, z| DMat4::from_scale(DVec3::new(x, y, z));
    let shear = DMat4::from_cols(
        DVec4::X,
        DVec4::new(0.5, 1.0, 0.2, 0.0),
        DVec4::new(-0.3, 0.4, 1.0, 0.0),
        DVec4::W,
    );
    let turn = DMat4::from_axis_angle(DVec3::new(0.36, 0.48, 0.8), 1.1);
    for (name, placement) in [
        ("sheared", shear),
        ("turned", turn),
        ("mirrored", scale(-1.0, 1.0, 1.0)),
        (
            "mirrored, sheared and turned",
            turn * shear * scale(1.0, 1.0, -1.0),
        ),
    ] {
        let mut scene = blob_scene();
        scene.world_from_unit_cube = placement * base;
        scene.gradient_factor = 1.0;
        scene.phase_g = 0.5;
        scene.integrator.max_scatters = Some(2);
        assert_same(name, &scene, &options());
    }
    // Spacing of 1 : 1000, seen from the side.
    let mut scene = blob_scene();
    scene.world_from_unit_cube = scale(1.0, 0.03, 30.0) * base;
    scene.gradient_factor = 1.0;
    let camera = beam(DVec3::new(3.0, 0.05, 4.0), DVec3::ZERO);
    (scene.camera.eye, scene.camera.target) = (camera.eye, camera.target);
    scene.camera.fov_y = 0.008;
    assert_same("spacing of 1 : 1000", &scene, &options());
}

/// Slanted planes through a glossy volume: what is cut off neither shows nor casts shadows.
fn cuts_agree() {
    let mut scene = blob_scene();
    scene.gradient_factor = 1.0;
    scene.integrator.max_scatters = Some(3);
    let middle = scene
        .world_from_unit_cube
        .transform_point3(DVec3::splat(0.5));
    let plane = |normal: DVec3| normal.extend(-normal.dot(middle));
    let [slanted, other] = [DVec3::new(-1.0, -0.4, -0.7), DVec3::new(0.2, -3.0, 0.5)].map(plane);
    for planes in [vec![slanted], vec![slanted, other]] {
        scene.clip_planes = planes;
        assert_same("cuts", &scene, &options());
    }
}

fn cameras_agree() {
    for (name, eye, target) in [
        (
            "inside",
            DVec3::new(0.1, -0.1, 0.05),
            DVec3::new(0.4, 0.2, -1.0),
        ),
        (
            "on a face",
            DVec3::new(0.1, 0.05, 0.5),
            DVec3::new(0.0, 0.0, -0.5),
        ),
        (
            "on an edge",
            DVec3::new(0.5, 0.1, 0.5),
            DVec3::new(0.0, 0.0, 0.0),
        ),
        ("on a corner", DVec3::splat(0.5), DVec3::ZERO),
        ("along x", DVec3::new(2.0, 0.0, 0.0), DVec3::ZERO),
        ("along −y", DVec3::new(0.0, 2.0, 0.0), DVec3::ZERO),
    ] {
        let mut scene = blob_scene();
        let camera = beam(eye, target);
        scene.camera.eye = eye;
        scene.camera.target = target;
        scene.camera.up = camera.up;
        scene.camera.fov_y = 0.7;
        scene.phase_g = 0.3;
        assert_same(&format!("camera {name}"), &scene, &options());
    }
}

fn phase_functions_agree() {
    for g in [-0.999, -0.9, 0.3, 0.9, 0.999] {
        for scatters in [1, 3] {
            let mut scene = blob_scene();
            scene.phase_g = g;
            scene.integrator.max_scatters = Some(scatters);
            assert_same(
                &format!("g {g}, {scatters} scatterings"),
                &scene,
                &options(),
            );
        }
    }
}

fn scattering_orders_agree() {
    for max_scatters in [Some(0), Some(2), Some(5), None] {
        let mut scene = blob_scene();
        scene.integrator.max_scatters = max_scatters;
        scene.phase_g = 0.4;
        assert_same(&format!("{max_scatters:?} scatterings"), &scene, &options());
    }
}

fn light_strategies_agree() {
    let mut scene = blob_scene();
    scene.gradient_factor = 1.5;
    scene.phase_g = 0.6;
    with_points(&mut scene, |p| TransferPoint {
        specular: 0.3,
        roughness: 0.6,
        ..p
    });
    let spp = effort(4 * SPP);
    let expected = reference(&scene, spp);
    for candidates in [[1, 0], [0, 1], [1, 1], [2, 2], [4, 1]] {
        let options = TraceOptions {
            light_candidates: Some(candidates),
            ..options()
        };
        let what = format!("light candidates {candidates:?}");
        assert_agree(
            &what,
            &statistics(&what, &scene, &options, spp / 32),
            &expected,
        );
    }
}

fn numbers_of_picks_agree() {
    let mut scene = blob_scene();
    scene.integrator.max_scatters = Some(3);
    scene.phase_g = -0.4;
    with_points(&mut scene, |p| TransferPoint {
        emission: [0.3, 0.0, 0.6 * p.s],
        ..p
    });
    let spp = effort(2 * SPP);
    let expected = reference(&scene, spp);
    for picks in 1..=4 {
        for white_noise in [false, true] {
            let options = TraceOptions {
                picks,
                white_noise,
                ..options()
            };
            let what = format!("{picks} picks, white noise {white_noise}");
            assert_agree(
                &what,
                &statistics(&what, &scene, &options, spp / 32),
                &expected,
            );
        }
    }
}

fn cell_sizes_agree() {
    let scene = blob_scene();
    let expected = reference(&scene, effort(2 * SPP));
    for cell_size in [1, 4, 8, 16, 64] {
        let options = TraceOptions {
            cell_size,
            ..options()
        };
        let what = format!("cells of {cell_size}³");
        let ours = statistics(&what, &scene, &options, effort(SPP) / 16);
        assert_agree(&what, &ours, &expected);
    }
}

fn sun_of_one_texel_agrees() {
    let (width, height) = (64, 32);
    let mut texels = vec![[0.2, 0.3, 0.4]; width * height];
    texels[9 * width + 40] = [1e9, 0.9e9, 0.7e9];
    for (g, k) in [(0.0, 0.0), (0.5, 1.0)] {
        let mut scene = blob_scene();
        scene.environment.map = EnvironmentMap::new(width, height, texels.clone());
        scene.environment.rotation_y = 30f64.to_radians();
        scene.environment.scale = 1e-6;
        scene.phase_g = g;
        scene.gradient_factor = k;
        scene.world_from_unit_cube =
            DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0)) * scene.world_from_unit_cube;
        assert_same(&format!("sun, g {g}, k {k}"), &scene, &options());
    }
}
