//! Sizes, places and views at their limits.

use glam::{DMat4, DVec3, DVec4};
use holovol_reference::Image;
use holovol_render::{RenderError, Tracer};
use holovol_scene::Scene;

use crate::fields::*;
use crate::gpu::{
    Test, assert_agree, assert_mean, effort, gpu, options, picture, reference, statistics,
};

const ROUNDING: f64 = 1e-4;

pub fn tests() -> Vec<Test> {
    vec![
        ("scaled_worlds_look_the_same", scaled_worlds_look_the_same),
        (
            "far_from_the_origin_looks_the_same",
            far_from_the_origin_looks_the_same,
        ),
        ("far_cameras_agree", far_cameras_agree),
        (
            "rays_on_cell_borders_lose_nothing",
            rays_on_cell_borders_lose_nothing,
        ),
        (
            "volumes_as_thin_as_a_wavelength_are_seen",
            volumes_as_thin_as_a_wavelength_are_seen,
        ),
        (
            "scenes_without_extent_are_refused",
            scenes_without_extent_are_refused,
        ),
        (
            "cameras_that_look_past_see_nothing",
            cameras_that_look_past_see_nothing,
        ),
    ]
}

fn full_scene() -> Scene {
    let mut scene = blob_scene();
    scene.gradient_factor = 1.0;
    scene.phase_g = 0.4;
    scene.integrator.max_scatters = Some(3);
    scene
}

/// Fails unless the same random numbers led to the same picture; rounding may turn the odd path,
/// which changes its pixel.
#[track_caller]
fn assert_same(what: &str, a: &Image, b: &Image) {
    let is_off = |(x, y): &(&[f32; 4], &[f32; 4])| {
        (0..4).any(|c| (x[c] - y[c]).abs() > 1e-3 * (1.0 + x[c].abs()))
    };
    let off = a.pixels().iter().zip(b.pixels()).filter(is_off).count();
    eprintln!("{what}: {off} of {} pixels differ", a.pixels().len());
    assert!(off * 20 <= a.pixels().len(), "{what}: {off} pixels differ");
    assert!(
        a.pixels().iter().any(|pixel| pixel[0] > 0.01),
        "{what}: all black"
    );
}

fn scaled_worlds_look_the_same() {
    let scene = full_scene();
    let expected = picture(&scene, &options(), 4);
    // A micrometre to ten kilometres.
    for factor in [1000.0, 1e-3, 1e-6, 1e4] {
        let mut scaled = scene.clone();
        scaled.world_from_unit_cube =
            DMat4::from_scale(DVec3::splat(factor)) * scaled.world_from_unit_cube;
        scaled.camera.eye *= factor;
        scaled.camera.target *= factor;
        scaled.transfer_function = scaled.transfer_function.scaled(1.0 / factor);
        assert_same(
            &format!("× {factor:e}"),
            &expected,
            &picture(&scaled, &options(), 4),
        );
    }
}

fn far_from_the_origin_looks_the_same() {
    let scene = full_scene();
    let expected = picture(&scene, &options(), 4);
    let mut far = scene.clone();
    let offset = DVec3::new(1e5, -2e4, 3e4);
    far.world_from_unit_cube = DMat4::from_translation(offset) * far.world_from_unit_cube;
    far.camera.eye += offset;
    far.camera.target += offset;
    assert_same("moved by 1e5 m", &expected, &picture(&far, &options(), 4));
}

fn far_cameras_agree() {
    // The same directions from a hundred to ten thousand times the volume's size.
    for distance in [1e2, 1e4] {
        let mut scene = full_scene();
        let toward = scene.camera.eye.normalize();
        scene.camera.eye = distance * toward;
        scene.camera.fov_y = 1.1 / distance;
        let spp = effort(512);
        let what = format!("camera {distance:e} m away");
        let ours = statistics(&what, &scene, &options(), spp / 16);
        assert_agree(&what, &ours, &reference(&scene, spp));
    }
}

fn rays_on_cell_borders_lose_nothing() {
    // Cells of 8 voxels end at multiples of 1/4; rays run in their faces and along their edges.
    for dims in [[32, 32, 32], [32, 16, 8]] {
        for (eye, target) in [
            (DVec3::new(0.0, 0.0, 3.0), DVec3::ZERO),
            (DVec3::new(0.25, 0.25, 3.0), DVec3::new(0.25, 0.25, 0.0)),
            (DVec3::new(-3.0, 0.25, -0.25), DVec3::new(0.0, 0.25, -0.25)),
            (DVec3::new(0.0, 3.0, 0.25), DVec3::new(0.0, 0.0, 0.25)),
        ] {
            let mut scene = scene(volume(dims, |_| 1.0), vec![point(0.0, 1.5, 0.5)]);
            scene.camera = beam(eye, target);
            // As parallel as f32 can tell.
            scene.camera.fov_y = 1e-12;
            let image = picture(&scene, &options(), effort(64));
            let what = format!("on borders from {eye}");
            assert_mean(&what, &image, 3, -f64::exp_m1(-1.5), ROUNDING);
        }
        // Along the diagonal, through edges and corners of cells.
        let mut scene = scene(volume(dims, |_| 1.0), vec![point(0.0, 1.0, 0.5)]);
        scene.camera = beam(DVec3::splat(2.0), DVec3::ZERO);
        scene.camera.fov_y = 1e-7;
        let image = picture(&scene, &options(), effort(64));
        assert_mean(
            "diagonal",
            &image,
            3,
            -f64::exp_m1(-(3f64.sqrt())),
            ROUNDING,
        );
    }
    // Cameras in faces of cells, light that passes along them.
    let mut scene = blob_scene();
    scene.camera.eye = DVec3::new(0.5, 0.0, 0.0);
    scene.camera.target = DVec3::ZERO;
    scene.camera.fov_y = 0.5;
    let spp = effort(512);
    let ours = statistics("in a face", &scene, &options(), spp / 16);
    assert_agree("in a face", &ours, &reference(&scene, spp));
}

fn volumes_as_thin_as_a_wavelength_are_seen() {
    let mut scene = homogeneous(1e7, 0.5);
    scene.world_from_unit_cube =
        DMat4::from_scale(DVec3::new(1.0, 1.0, 1e-7)) * scene.world_from_unit_cube;
    let image = picture(&scene, &options(), effort(128));
    assert_mean("sheet", &image, 3, -f64::exp_m1(-1.0), ROUNDING);
}

#[track_caller]
fn assert_refused(field: &str, change: impl Fn(&mut Scene)) {
    let mut scene = blob_scene();
    change(&mut scene);
    match Tracer::new(gpu(), &scene, &options()).err() {
        Some(RenderError::Scene {
            field: told,
            reason,
        }) => {
            assert_eq!(told, field, "{reason}");
        }
        other => panic!("{field}: {other:?}"),
    }
}

fn scenes_without_extent_are_refused() {
    let placed = |matrix: DMat4| move |scene: &mut Scene| scene.world_from_unit_cube = matrix;
    let field = "volume.world_from_unit_cube";
    assert_refused(field, placed(DMat4::from_scale(DVec3::new(1.0, 0.0, 1.0))));
    assert_refused(field, placed(DMat4::from_scale(DVec3::splat(1e-100))));
    assert_refused(field, placed(DMat4::from_scale(DVec3::splat(1e60))));
    assert_refused(field, placed(DMat4::from_scale(DVec3::splat(f64::NAN))));
    // Two axes along each other.
    let flat = DMat4::from_cols(DVec4::X, DVec4::X, DVec4::Z, DVec4::W);
    assert_refused(field, placed(flat));
    assert_refused("volume.window", |scene| scene.window = [0.5, 0.5]);
    assert_refused("volume.window", |scene| scene.window = [0.0, f64::INFINITY]);
    assert_refused("phase_g", |scene| scene.phase_g = 1.0);
    assert_refused("phase_g", |scene| scene.phase_g = f64::NAN);
    assert_refused("camera", |scene| scene.camera.target = scene.camera.eye);
    assert_refused("camera", |scene| {
        scene.camera.up = scene.camera.target - scene.camera.eye
    });
    assert_refused("camera", |scene| scene.camera.width = 0);
}

fn cameras_that_look_past_see_nothing() {
    let mut scene = blob_scene();
    scene.camera.target = 2.0 * scene.camera.eye;
    let image = picture(&scene, &options(), 4);
    assert!(image.pixels().iter().all(|pixel| *pixel == [0.0; 4]));
}
