use std::ops::ControlFlow;

use glam::{DMat4, DVec3};
use holovol_light::EnvironmentMap;

use super::scenes::*;
use crate::field::{Extinction, Field};
use crate::majorants::Majorants;
use crate::rng::Rng;
use crate::{TraceError, Tracer};

#[test]
fn extinction_of_any_size_gives_its_opacity() {
    for (sigma_t, size) in [
        (1e-6, 1.0),
        (1e7, 1e-7),
        (1e7, 0.1),
        (1e-4, 1e4),
        (1e6, 1.0),
    ] {
        let mut scene = homogeneous(sigma_t, 0.5);
        scene.world_from_unit_cube =
            DMat4::from_scale(DVec3::splat(size)) * scene.world_from_unit_cube;
        scene.camera = beam(DVec3::new(0.0, 0.0, 3.0 * size), DVec3::ZERO);
        assert_opacity("slab", &film(&scene, 100), -f64::exp_m1(-sigma_t * size));
    }
}

#[test]
fn volumes_of_one_voxel_line_or_sheet_are_seen() {
    for dims in [[1, 1, 1], [1, 1, 9], [17, 1, 1], [1, 12, 13]] {
        for eye in [DVec3::X, DVec3::Y, DVec3::Z] {
            let mut scene = scene(volume(dims, |_| 1.0), vec![point(0.0, 1.0, 0.5)]);
            scene.camera = beam(3.0 * eye, DVec3::ZERO);
            assert_opacity("thin volume", &film(&scene, 50), -f64::exp_m1(-1.0));
        }
    }
}

#[test]
fn spacing_of_one_to_a_thousand_keeps_the_optical_depth() {
    let mut scene = scene(
        volume([8, 8, 8], |at| at.x),
        vec![point(0.0, 0.0, 0.5), point(1.0, 2.0, 0.5)],
    );
    scene.world_from_unit_cube =
        DMat4::from_scale(DVec3::new(1.0, 0.03, 30.0)) * scene.world_from_unit_cube;
    scene.camera = beam(DVec3::new(4.0, 0.001, 0.0), DVec3::new(0.0, 0.001, 0.0));
    assert_opacity("spacing", &film(&scene, 100), -f64::exp_m1(-1.0));
}

#[test]
fn a_vertical_step_is_as_wide_as_its_points_say() {
    // s rises from 1/16 to 15/16 over a metre's 7/8: σ is 3 where s ≥ ½, from coincident points.
    let step = vec![
        point(0.5, 0.0, 0.0),
        point(0.5, 1.0, 0.0),
        point(0.5, 3.0, 0.0),
    ];
    let mut scene = scene(volume([8, 1, 1], |at| at.x), step);
    scene.camera = beam(DVec3::new(3.0, 0.0, 0.0), DVec3::ZERO);
    assert_opacity("step", &film(&scene, 200), -f64::exp_m1(-1.5));
}

#[test]
fn extreme_light_and_phase_stay_finite() {
    let mut texels = vec![[0.2, 0.3, 0.4]; 32 * 16];
    texels[100] = [1e9; 3];
    for g in [0.0, 0.999, -0.999] {
        let mut scene = homogeneous(3.0, 1.0);
        scene.environment.map = EnvironmentMap::new(32, 16, texels.clone());
        scene.phase_g = g;
        scene.gradient_factor = 5.0;
        scene.integrator.max_scatters = None;
        let film = film(&scene, 20);
        assert!(film.means().flatten().all(f64::is_finite));
        assert!(film.means().any(|pixel| pixel[0] > 0.0));
    }
}

#[test]
fn walks_cover_the_box_and_bounds_hold() {
    let volume = volume([19, 7, 4], bump);
    let mut scene = scene(
        volume,
        vec![
            point(0.0, 0.5, 0.5),
            point(0.3, 4.0, 0.5),
            point(0.3, 9.0, 0.5),
            point(0.6, 1.0, 0.5),
        ],
    );
    scene.window = [0.0, 0.9];
    let holovol_volume::Voxels::F32(voxels) = scene.volume.voxels() else {
        unreachable!("made of f32");
    };
    let field = Field::new(&scene, voxels);
    let extinction = Extinction::new(&scene.transfer_function);
    let majorants = Majorants::new(&field, &extinction);
    let size = DVec3::new(19.0, 7.0, 4.0);
    let mut rng = Rng::new(0, 0, 0);
    for round in 0..4000 {
        let mut random = || DVec3::new(rng.uniform(), rng.uniform(), rng.uniform());
        let mut origin = (random() * 3.0 - 1.0) * size;
        let mut direction = random() - 0.5;
        // Every other ray lies on cell borders or runs along an axis.
        if round % 2 == 0 {
            origin = (origin / 4.0).round() * 4.0;
            direction[round % 3] = 0.0;
        }
        if round % 4 == 0 {
            direction[(round + 1) % 3] = 0.0;
        }
        let mut covered = 0.0;
        majorants.walk(origin, direction, |start, length, majorant| {
            covered += length;
            for i in 0..8 {
                let at = start + direction * (length * f64::from(i) / 7.0);
                let s = field.sample(at);
                assert!((s - scene.s_from_value(scene.volume.sample(at / size))).abs() < 1e-12);
                let sigma_t = extinction.at(s);
                assert!((sigma_t - scene.transfer_function.eval(s).sigma_t).abs() < 1e-9);
                assert!(
                    sigma_t <= majorant * (1.0 + 1e-12),
                    "{sigma_t} > {majorant}"
                );
            }
            ControlFlow::<()>::Continue(())
        });
        // The chord by clipping against one pair of faces after the other.
        let (mut enter, mut leave) = (0.0f64, 1e9f64);
        for axis in 0..3 {
            let (o, d, n) = (origin[axis], direction[axis], size[axis]);
            if d == 0.0 {
                if o < 0.0 || o > n {
                    leave = -1.0;
                }
            } else {
                enter = enter.max((-o / d).min((n - o) / d));
                leave = leave.min((-o / d).max((n - o) / d));
            }
        }
        let chord = (leave - enter).max(0.0);
        assert!(
            (covered - chord).abs() < 1e-9 * (1.0 + chord),
            "{origin} {direction}: {covered} of {chord}"
        );
    }
}

#[test]
fn what_cannot_be_traced_is_refused() {
    let refused = |change: &dyn Fn(&mut holovol_scene::Scene)| {
        let mut scene = homogeneous(1.0, 1.0);
        change(&mut scene);
        Tracer::new(&scene, &settings(1)).err()
    };
    let flat = refused(&|scene| {
        scene.world_from_unit_cube = DMat4::from_scale(DVec3::new(1.0, 0.0, 1.0));
    });
    assert!(
        matches!(flat, Some(TraceError::SingularTransform { .. })),
        "{flat:?}"
    );
    let window = refused(&|scene| scene.window = [1.0, 1.0]);
    assert!(
        matches!(window, Some(TraceError::Window { .. })),
        "{window:?}"
    );
    let camera = refused(&|scene| scene.camera.target = scene.camera.eye);
    assert!(matches!(camera, Some(TraceError::Camera)), "{camera:?}");
    let g = refused(&|scene| scene.phase_g = 1.0);
    assert!(matches!(g, Some(TraceError::PhaseG { .. })), "{g:?}");
}

#[test]
fn a_thin_but_not_flat_volume_is_traced() {
    let mut scene = homogeneous(1e7, 0.5);
    scene.world_from_unit_cube =
        DMat4::from_scale(DVec3::new(1.0, 1.0, 1e-7)) * scene.world_from_unit_cube;
    assert_opacity("sheet", &film(&scene, 50), -f64::exp_m1(-1.0));
}
