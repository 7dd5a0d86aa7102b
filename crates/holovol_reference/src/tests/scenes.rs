//! Small scenes to take apart, and what tests read off films.

use std::ops::ControlFlow;

use glam::{DMat4, DVec3};
use holovol_light::EnvironmentMap;
use holovol_scene::{Camera, Environment, Integrator, Scene};
use holovol_volume::{Geometry, TransferFunction, TransferPoint, Volume, Voxels};

use super::Fault;
use crate::special::student_t_p;
use crate::{Film, LightStrategy, Settings, Tracer};

pub fn point(s: f64, sigma_t: f64, albedo: f64) -> TransferPoint {
    TransferPoint {
        s,
        sigma_t,
        albedo: [albedo; 3],
        emission: [0.0; 3],
        roughness: 0.5,
        specular: 0.0,
    }
}

pub fn transfer_function(points: Vec<TransferPoint>) -> TransferFunction {
    TransferFunction::new(points).expect("sorted points in range")
}

/// A field given over the unit cube, sampled at voxel centres.
pub fn volume(dims: [u32; 3], field: impl Fn(DVec3) -> f64) -> Volume {
    let mut voxels = Vec::new();
    for k in 0..dims[2] {
        for j in 0..dims[1] {
            for i in 0..dims[0] {
                let index = DVec3::new(i.into(), j.into(), k.into());
                let centre = (index + 0.5) / DVec3::from_array(dims.map(f64::from));
                voxels.push(field(centre) as f32);
            }
        }
    }
    let geometry = Geometry::from_spacing([1.0; 3]);
    Volume::new(Voxels::F32(voxels), dims, 1.0, 0.0, geometry).expect("one value per voxel")
}

/// The same value everywhere.
pub fn homogeneous(sigma_t: f64, albedo: f64) -> Scene {
    scene(
        volume([1, 1, 1], |_| 0.5),
        vec![point(0.0, sigma_t, albedo)],
    )
}

/// A bump off the centre that never quite reaches the border, with a ripple.
pub fn bump(at: DVec3) -> f64 {
    let d = (at - DVec3::new(0.45, 0.55, 0.5)).length();
    (1.0 - 2.2 * d).max(0.0) * (1.0 + 0.3 * (9.0 * at.x + 5.0 * at.y).sin())
}

/// A unit cube around the origin in uniform light, seen through a beam along −z.
pub fn scene(volume: Volume, points: Vec<TransferPoint>) -> Scene {
    Scene {
        volume,
        window: [0.0, 1.0],
        world_from_unit_cube: DMat4::from_translation(DVec3::splat(-0.5)),
        transfer_function: transfer_function(points),
        phase_g: 0.0,
        gradient_factor: 0.0,
        clip_planes: Vec::new(),
        environment: uniform_light(1.0),
        camera: beam(DVec3::new(0.0, 0.0, 3.0), DVec3::ZERO),
        integrator: Integrator {
            max_scatters: Some(1),
        },
    }
}

pub fn uniform_light(radiance: f32) -> Environment {
    Environment {
        map: EnvironmentMap::constant([radiance; 3]),
        rotation_y: 0.0,
        scale: 1.0,
    }
}

/// Uneven light of a few texels, turned a little: no symmetry is left.
pub fn uneven_light() -> Environment {
    let (width, height) = (8, 4);
    let texel = |i: usize| {
        let (x, y) = ((i % width) as f32, (i / width) as f32);
        let level = 0.2 + 0.5 * (1.0 + (1.3 * x + 0.4 * y).sin()) + 0.2 * (3.0 - y);
        [level, 0.8 * level + 0.05 * x, 0.5 * level + 0.1 * y]
    };
    Environment {
        map: EnvironmentMap::new(width, height, (0..width * height).map(texel).collect()),
        rotation_y: 0.5,
        scale: 0.7,
    }
}

/// 16 × 16 pixels that all look along one line, so that a film is 256 estimates of one number.
pub fn beam(eye: DVec3, target: DVec3) -> Camera {
    Camera {
        eye,
        target,
        up: if (target - eye).cross(DVec3::Y).length() > 1e-3 {
            DVec3::Y
        } else {
            DVec3::X
        },
        fov_y: 3e-4,
        width: 16,
        height: 16,
    }
}

pub fn settings(spp: u32) -> Settings {
    Settings {
        spp,
        seed: 7,
        light_strategy: LightStrategy::Both,
    }
}

pub fn film(scene: &Scene, spp: u32) -> Film {
    crate::render(scene, &settings(spp), &mut |_| ControlFlow::Continue(()))
        .expect("a scene that can be traced")
}

pub fn faulty_film(scene: &Scene, settings: &Settings, fault: Fault) -> Film {
    let mut tracer = Tracer::new(scene, settings).expect("a scene that can be traced");
    tracer.fault = fault;
    let mut film = tracer.film();
    tracer.accumulate(&mut film, settings.spp);
    film
}

/// Mean over a film and the variance of that mean, per channel.
pub fn mean_and_variance(film: &Film) -> [(f64, f64); 4] {
    let n = film.means().len() as f64;
    std::array::from_fn(|c| {
        let mean: f64 = film.means().map(|pixel| pixel[c]).sum();
        let variance: f64 = film.variances().map(|pixel| pixel[c]).sum();
        (mean / n, variance / (n * n))
    })
}

/// Smallest p-value over R, G, B of a film's mean against what it should be (to within
/// `relative`, the expected value's own error).
pub fn p_of_mean(film: &Film, expected: [f64; 3], relative: f64) -> f64 {
    let observed = mean_and_variance(film);
    (0..3)
        .map(|c| {
            let (mean, variance) = observed[c];
            let off = (mean - expected[c]).abs() - relative * expected[c].abs();
            let scale = variance.sqrt();
            match off {
                off if off <= 0.0 => 1.0,
                _ if scale == 0.0 => 0.0,
                // A film of 256 pixels knows its variance well, but not perfectly.
                off => student_t_p(off / scale, 100.0),
            }
        })
        .fold(1.0, f64::min)
}

/// Fails if a film's mean differs from what it should be by more than chance.
pub fn assert_mean(what: &str, film: &Film, expected: [f64; 3], relative: f64) {
    let p = p_of_mean(film, expected, relative);
    let observed = mean_and_variance(film);
    let noise = observed.map(|(_, variance)| variance.sqrt());
    assert!(
        p >= 1e-6,
        "{what}: {:?} ± {noise:?} should be {expected:?} (p = {p:e})",
        observed.map(|(mean, _)| mean)
    );
}

/// As [`assert_mean`], of opacity, whose samples are 0 or 1.
pub fn assert_opacity(what: &str, film: &Film, expected: f64) {
    let (mean, _) = mean_and_variance(film)[3];
    let paths = film.samples() as f64 * film.means().len() as f64;
    let deviation = (expected * (1.0 - expected) / paths).sqrt();
    // Below one expected hit, a single one is no surprise.
    let off = ((mean - expected).abs() - 1.0 / paths).max(0.0);
    assert!(
        off <= 5.0 * deviation,
        "{what}: opacity {mean} should be {expected} ± {deviation}"
    );
}
