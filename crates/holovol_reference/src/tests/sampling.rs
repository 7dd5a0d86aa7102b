use std::f64::consts::{PI, TAU};

use glam::DVec3;
use holovol_light::EnvironmentMap;

use super::Fault;
use crate::environment::EnvironmentTable;
use crate::phase::{Phase, Surface, henyey_greenstein};
use crate::rng::Rng;
use crate::special::chi_square_p;

const COSINES: usize = 24;
const AZIMUTHS: usize = 32;

/// p-value of directions drawn against a density: chi-square over equal solid angles.
fn p_of_draws(
    count: usize,
    mut draw: impl FnMut() -> DVec3,
    pdf: impl Fn(DVec3) -> f64,
    fineness: usize,
) -> f64 {
    let mut observed = vec![0.0; COSINES * AZIMUTHS];
    for _ in 0..count {
        let d = draw();
        assert!((d.length() - 1.0).abs() < 1e-9, "{d} is no unit vector");
        let row = ((0.5 - 0.5 * d.y) * COSINES as f64) as usize;
        let column = ((0.5 + d.x.atan2(-d.z) / TAU) * AZIMUTHS as f64) as usize;
        observed[row.min(COSINES - 1) * AZIMUTHS + column.min(AZIMUTHS - 1)] += 1.0;
    }
    // The density's integral over each bin, by midpoints.
    let per_bin = 4.0 * PI / (COSINES * AZIMUTHS) as f64;
    let expected: Vec<f64> = (0..COSINES * AZIMUTHS)
        .map(|bin| {
            let mut sum = 0.0;
            for i in 0..fineness * fineness {
                let (fx, fy) = (
                    ((i % fineness) as f64 + 0.5) / fineness as f64,
                    ((i / fineness) as f64 + 0.5) / fineness as f64,
                );
                let cosine = 1.0 - 2.0 * ((bin / AZIMUTHS) as f64 + fy) / COSINES as f64;
                let phi = (((bin % AZIMUTHS) as f64 + fx) / AZIMUTHS as f64 - 0.5) * TAU;
                let sine = (1.0 - cosine * cosine).sqrt();
                sum += pdf(DVec3::new(sine * phi.sin(), cosine, -sine * phi.cos()));
            }
            sum / (fineness * fineness) as f64 * per_bin * count as f64
        })
        .collect();
    // Bins that expect little are taken together.
    let (mut chi_square, mut bins) = (0.0, 0);
    let (mut rest_observed, mut rest_expected) = (0.0, 0.0);
    for (o, e) in observed.iter().zip(&expected) {
        if *e >= 20.0 {
            chi_square += (o - e) * (o - e) / e;
            bins += 1;
        } else {
            rest_observed += o;
            rest_expected += e;
        }
    }
    if rest_expected > 5.0 {
        chi_square += (rest_observed - rest_expected).powi(2) / rest_expected;
        bins += 1;
    } else if rest_observed > 50.0 {
        return 0.0;
    }
    chi_square_p(chi_square, f64::from(bins))
}

fn phase(g: f64, surface: Option<Surface>) -> Phase {
    Phase {
        g,
        surface,
        fault: Fault::None,
    }
}

#[test]
fn hg_integrates_to_one_with_mean_cosine_g() {
    for g in [0.0f64, 1e-9, 0.3, -0.7, 0.95, -0.95, 0.999] {
        // Midpoints in the cosine, crowded to where the peak is.
        let n = 400_000;
        let (mut total, mut mean) = (0.0, 0.0);
        for i in 0..n {
            let x = (f64::from(i) + 0.5) / f64::from(n);
            let from_peak = 2.0 * x.powi(3);
            let cosine = g.signum() * (1.0 - from_peak);
            let weight = 2.0 * 3.0 * x * x / f64::from(n);
            let density = TAU * henyey_greenstein(g, cosine) * weight;
            total += density;
            mean += density * cosine;
        }
        assert!((total - 1.0).abs() < 1e-6, "g {g}: integral {total}");
        assert!((mean - g).abs() < 1e-6, "g {g}: mean cosine {mean}");
    }
}

#[test]
fn drawn_cosines_have_mean_g_along_the_light_path() {
    let wo = DVec3::new(0.3, -0.5, 0.8).normalize();
    for g in [0.0, 1e-7, 0.5, -0.8, 0.99, -0.999] {
        let mut rng = Rng::new(3, 1, 4);
        let n = 200_000;
        let cosines = (0..n).map(|_| (-wo).dot(phase(g, None).draw(wo, &mut rng)));
        let mean = cosines.sum::<f64>() / f64::from(n);
        let deviation = ((1.0 - g * g) / f64::from(n)).sqrt();
        assert!((mean - g).abs() < 5.0 * deviation, "{mean} for g {g}");
    }
}

#[test]
fn phase_draws_follow_their_density() {
    let wo = DVec3::new(0.2, 0.6, 0.5).normalize();
    let surface = |weight, normal: DVec3, alpha, f0| {
        Some(Surface {
            weight,
            normal: normal.normalize(),
            alpha,
            f0,
        })
    };
    let cases = [
        phase(0.0, None),
        phase(0.6, None),
        phase(-0.6, None),
        phase(0.3, surface(0.5, DVec3::new(0.1, 1.0, 0.3), 0.5, 0.0)),
        phase(0.3, surface(0.9, DVec3::new(0.1, 1.0, 0.3), 0.5, 0.5)),
        // Grazing, where many mirror directions lie below the horizon.
        phase(-0.2, surface(1.0, DVec3::new(-1.0, 0.4, 0.3), 0.8, 1.0)),
    ];
    for (i, case) in cases.iter().enumerate() {
        let mut rng = Rng::new(11, i as u64, 0);
        let p = p_of_draws(
            400_000,
            || case.draw(wo, &mut rng),
            |wi| case.pdf(wo, wi),
            12,
        );
        assert!(p >= 1e-6, "case {i}: p = {p:e}");
    }
}

#[test]
fn chi_square_notices_five_percent() {
    // The test above can fail: a density that is 5 % off in shape.
    let wo = DVec3::Y;
    let case = phase(0.6, None);
    let wrong = phase(0.63, None);
    let mut rng = Rng::new(11, 0, 0);
    let p = p_of_draws(
        400_000,
        || case.draw(wo, &mut rng),
        |wi| wrong.pdf(wo, wi),
        12,
    );
    assert!(p < 1e-6, "p = {p:e}");
}

fn lumpy_map(width: usize, height: usize) -> EnvironmentMap {
    let texels = (0..width * height).map(|i| {
        let level = ((i * 7919) % 13) as f32 * 0.1;
        [level, 0.5 * level, 0.1]
    });
    EnvironmentMap::new(width, height, texels.collect())
}

#[test]
fn environment_draws_follow_their_density() {
    for (width, height) in [(1, 1), (1, 3), (5, 1), (8, 4), (16, 9)] {
        let map = lumpy_map(width, height);
        let table = EnvironmentTable::new(&map).expect("there is light");
        let mut rng = Rng::new(5, width as u64, height as u64);
        let draw = || {
            let drawn = table.draw(&mut rng);
            let pdf = table.pdf(drawn.direction);
            assert!(
                (pdf / drawn.pdf - 1.0).abs() < 1e-6,
                "{pdf} evaluated, {} drawn",
                drawn.pdf
            );
            drawn.direction
        };
        let p = p_of_draws(300_000, draw, |wi| table.pdf(wi), 24);
        assert!(p >= 1e-6, "{width} × {height}: p = {p:e}");
    }
}

#[test]
fn radiance_over_density_is_bounded_under_a_sun() {
    let (width, height) = (32, 16);
    let mut texels = vec![[0.1, 0.1, 0.2]; width * height];
    texels[5 * width + 31] = [1e9; 3];
    let map = EnvironmentMap::new(width, height, texels);
    let table = EnvironmentTable::new(&map).expect("there is light");
    let mut rng = Rng::new(1, 2, 3);
    let n = 200_000;
    let (mut sum, mut largest) = (0.0, 0.0f64);
    for _ in 0..n {
        let drawn = table.draw(&mut rng);
        let weight = map.radiance(drawn.direction)[0] / drawn.pdf;
        sum += weight;
        largest = largest.max(weight);
    }
    // A bilinear tent of 2 × 2 texels at 61.9° from the pole holds 1e9 · texel's solid angle.
    let theta = PI * 5.5 / 16.0;
    let texel = (TAU / 32.0) * (PI / 16.0) * theta.sin();
    let mean = sum / f64::from(n);
    assert!((mean / (1e9 * texel) - 1.0).abs() < 0.01, "{mean}");
    assert!(largest < 4.1 * mean, "{largest} against a mean of {mean}");
}

#[test]
fn scattering_is_its_formula_at_any_angle() {
    let mut rng = Rng::new(8, 0, 0);
    let mut random = || {
        let mut draw = || 2.0 * rng.uniform() - 1.0;
        DVec3::new(draw(), draw(), draw()).normalize()
    };
    for i in 0..4000 {
        let roughness = [0.05, 0.3, 0.7, 1.0][i % 4];
        let f0 = [0.0, 0.04, 0.5, 1.0][i / 4 % 4];
        let weight = [0.2, 1.0][i / 16 % 2];
        let g: f64 = [0.4, -0.8][i / 32 % 2];
        let (wo, wi, normal) = (random(), random(), random());
        let normal = normal * normal.dot(wo).signum();
        let surface = Surface {
            weight,
            normal,
            alpha: f64::max(roughness * roughness, 1e-3),
            f0,
        };
        let cosine = -wo.dot(wi);
        let volume = (1.0 - g * g) / (4.0 * PI * (1.0 + g * g - 2.0 * g * cosine).powf(1.5));
        let bracket = super::quadrature::surface_term(normal, wo, wi, roughness, f0);
        let expected = (1.0 - weight) * volume + weight * bracket;
        let value = phase(g, Some(surface)).eval(wo, wi);
        assert!(
            (value - expected).abs() <= 1e-7 * expected,
            "{value} is not {expected}: wo {wo}, wi {wi}, n {normal}, roughness {roughness}, F0 {f0}"
        );
    }
}
