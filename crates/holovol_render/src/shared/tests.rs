use std::f64::consts::PI;

use glam::{DVec3, IVec3, Vec3, vec3};
use holovol_light::EnvironmentMap;
use holovol_scene::Environment;

use super::environment::Light;
use super::phase_function::{phase_eval, phase_sample};
use super::random::{pcg3d, sobol_pair, sobol_second_reversed, unit_float, z_order};
use super::scattering::choose_light;
use super::surface::{Surface, scatter_eval, scatter_pdf, scatter_sample};
use super::walk::{Event, Walk};
use crate::majorant::cpu::Majorants;
use crate::testing::sphere::SphereCells;

fn numbers(i: u32, stream: u32) -> [f32; 3] {
    pcg3d([i, stream, 0xbb67_ae85]).map(unit_float)
}

/// A direction from two numbers, uniform over the sphere.
fn direction([x, y, _]: [f32; 3]) -> Vec3 {
    let z = 1.0 - 2.0 * x;
    let (sin, cos) = (std::f32::consts::TAU * y).sin_cos();
    let radius = (1.0 - z * z).max(0.0).sqrt();
    vec3(radius * cos, radius * sin, z).normalize()
}

/// The second generator matrix from its recurrence: v_k = v_{k-1} xor v_{k-1} / 2.
#[test]
fn second_dimension_has_sobols_direction_numbers() {
    let mut numbers = vec![1u32 << 31];
    for k in 1..32 {
        let previous: u32 = numbers[k - 1];
        numbers.push(previous ^ previous >> 1);
    }
    for i in (0..2000).chain([u32::MAX, 0x8000_0000, 0x1234_5678]) {
        let chosen = (0..32).filter(|k| i >> k & 1 == 1);
        let expected = chosen.fold(0, |x, k| x ^ numbers[k]);
        assert_eq!(
            sobol_second_reversed(i).reverse_bits(),
            expected,
            "index {i}"
        );
    }
}

/// A (0, 2)-sequence: the first 2^m points, and every further 2^m, put one point into each
/// elementary interval of area 2^-m.
#[test]
fn every_elementary_interval_holds_one_point() {
    for seed in [0, 1, 2, 0xdead_beef, u32::MAX] {
        for (m, block) in [(1, 0), (4, 0), (4, 3), (6, 1), (8, 0), (9, 5)] {
            let points: Vec<_> = (0..1u32 << m)
                .map(|i| sobol_pair((block << m) + i, seed))
                .collect();
            for columns in 0..=m {
                let rows = m - columns;
                let mut taken = vec![false; 1 << m];
                for [x, y] in &points {
                    let cell = |x: f32, bits: u32| (x * (1u32 << bits) as f32) as usize;
                    let at = cell(*x, columns) + (cell(*y, rows) << columns);
                    assert!(
                        !taken[at],
                        "seed {seed}, 2^{columns} x 2^{rows}: two points in one"
                    );
                    taken[at] = true;
                }
            }
        }
    }
}

/// Each place of a block once, and squares of 2, 4 and 8 pixels one after the other: their points are
/// whole nets.
#[test]
fn squares_of_a_block_follow_each_other() {
    let mut taken = [false; 256];
    for (x, y) in (0..256u32).map(|i| (i % 16, i / 16)) {
        let place = z_order([x + 32, y + 48]);
        assert!(!taken[place as usize], "{x}, {y}");
        taken[place as usize] = true;
        for side in [2, 4, 8] {
            let first = z_order([x / side * side, y / side * side]);
            assert_eq!(first % (side * side), 0, "{x}, {y}");
            assert_eq!(place / (side * side), first / (side * side), "{x}, {y}");
        }
    }
}

#[test]
fn seeds_give_different_sequences_of_uniform_mean() {
    let mut firsts: Vec<_> = (0..2000)
        .map(|seed| sobol_pair(0, seed).map(f32::to_bits))
        .collect();
    firsts.sort_unstable();
    firsts.dedup();
    assert!(firsts.len() > 1990, "{} first points", firsts.len());
    // First points of 2000 seeds: their mean's standard deviation is 0.0065.
    for axis in 0..2 {
        let sum: f32 = (0..2000).map(|seed| sobol_pair(0, seed)[axis]).sum();
        assert!((sum / 2000.0 - 0.5).abs() < 0.035, "{sum}");
    }
}

#[test]
fn unit_floats_lie_between_zero_and_one() {
    assert_eq!(unit_float(0), (-32f32).exp2());
    assert_eq!(unit_float(3 << 1), 3.5 * (-31f32).exp2());
    assert_eq!(unit_float(1 << 31), 0.5);
    assert_eq!(unit_float(u32::MAX), 1.0 - f32::EPSILON / 2.0);
}

const ASYMMETRIES: [f32; 9] = [0.0, 0.2, -0.2, 0.5, -0.5, 0.9, -0.9, 0.999, -0.999];

#[test]
fn hg_is_normalised_with_mean_cosine_g_and_drawn_as_evaluated() {
    for (case, g) in ASYMMETRIES.into_iter().enumerate() {
        for (k, wo) in [vec3(0.3, -0.5, 0.8), Vec3::Z, Vec3::NEG_Z]
            .into_iter()
            .enumerate()
        {
            let wo = wo.normalize();
            let pdf = |wi| f64::from(phase_eval(g, wo, wi));
            let draws: Vec<_> = (0..20_000)
                .map(|i| {
                    let [x, y, _] = numbers(i, (10 * case + k) as u32);
                    phase_sample(g, wo, [x, y])
                })
                .collect();
            let cells = SphereCells::around(if g < 0.0 { wo } else { -wo });
            cells
                .check(&draws, pdf, 2e-3)
                .unwrap_or_else(|error| panic!("g = {g}: {error}"));
            let cosine = |wi: Vec3| f64::from((-wo).dot(wi));
            let mean: f64 = cells.integrals(|wi| pdf(wi) * cosine(wi)).iter().sum();
            assert!(
                (mean - f64::from(g)).abs() < 2e-3,
                "g = {g}: mean cosine {mean}"
            );
            let drawn = draws.iter().map(|&wi| cosine(wi)).sum::<f64>() / draws.len() as f64;
            // No distribution on [-1, 1] of mean g spreads more than this.
            let spread = ((1.0 - f64::from(g * g)) / draws.len() as f64).sqrt();
            assert!(
                (drawn - f64::from(g)).abs() < 6.0 * spread,
                "g = {g}: drawn {drawn}"
            );
        }
    }
}

fn surfaces() -> Vec<(Surface, Vec3)> {
    let mut cases = Vec::new();
    for alpha in [1e-3, 0.03, 0.3, 1.0] {
        for probability in [0.0, 0.4, 1.0] {
            for specular in [0.0, 0.04, 0.6, 1.0] {
                for n_o in [1.0f32, 0.7, 0.05, 1e-3] {
                    if n_o < 0.01 && alpha < 0.01 {
                        // A ribbon 1e-6 rad wide: neither f32 nor these cells resolve it.
                        continue;
                    }
                    let normal = vec3(0.2, 0.9, -0.4).normalize();
                    let side = normal.any_orthonormal_vector();
                    let wo = (n_o * normal + (1.0 - n_o * n_o).sqrt() * side).normalize();
                    cases.push((
                        Surface {
                            normal,
                            probability,
                            specular,
                            alpha,
                        },
                        wo,
                    ));
                }
            }
        }
    }
    cases
}

/// Where the surface's density peaks, if it does; else where the phase function's may.
fn peak(surface: &Surface, wo: Vec3) -> Vec3 {
    if surface.probability > 0.0 {
        2.0 * surface.normal.dot(wo) * surface.normal - wo
    } else {
        -wo
    }
}

#[test]
fn surface_lobes_are_drawn_as_evaluated() {
    for (case, (surface, wo)) in surfaces().into_iter().enumerate() {
        let draws: Vec<_> = (0..4000)
            .map(|i| scatter_sample(0.3, &surface, wo, numbers(i, 500 + case as u32)))
            .collect();
        let pdf = |wi| f64::from(scatter_pdf(0.3, &surface, wo, wi));
        let checked = SphereCells::around(peak(&surface, wo)).check(&draws, pdf, 0.01);
        checked.unwrap_or_else(|error| panic!("{surface:?}, {wo}: {error}"));
    }
}

/// The white furnace at one point: nothing is gained, and without a surface nothing is lost.
#[test]
fn surface_reflects_at_most_what_it_receives() {
    for (surface, wo) in surfaces() {
        let f = |wi| f64::from(scatter_eval(0.3, &surface, wo, wi));
        let total: f64 = SphereCells::around(peak(&surface, wo))
            .integrals(f)
            .iter()
            .sum();
        assert!(total <= 1.005, "{surface:?}, {wo}: {total}");
        if surface.probability == 0.0 || surface.specular == 0.0 {
            assert!((total - 1.0).abs() < 5e-3, "{surface:?}, {wo}: {total}");
        }
        // Facets in each other's shadow lose some of what even a mirror gets.
        if surface.specular == 1.0 {
            assert!(total > 0.3, "{surface:?}, {wo}: {total}");
        }
    }
}

#[test]
fn specular_term_is_reciprocal() {
    for i in 0..500 {
        let alpha = [1e-3, 0.05, 0.5, 1.0][i as usize % 4];
        // F0 = 1 leaves the specular term alone.
        let surface = Surface {
            normal: Vec3::Y,
            probability: 1.0,
            specular: 1.0,
            alpha,
        };
        let up = |d: Vec3| vec3(d.x, d.y.abs(), d.z);
        let (wo, wi) = (up(direction(numbers(i, 1))), up(direction(numbers(i, 2))));
        let there = scatter_eval(0.0, &surface, wo, wi) / wi.y;
        let back = scatter_eval(0.0, &surface, wi, wo) / wo.y;
        assert!(
            (there - back).abs() <= 1e-4 * there.max(back),
            "{there} {back}"
        );
    }
}

#[test]
fn no_direction_makes_nan() {
    let tiny = 1e-7;
    for alpha in [1e-3, 1.0] {
        for specular in [0.0, 0.04, 1.0] {
            let normal = Vec3::Y;
            let surface = Surface {
                normal,
                probability: 0.5,
                specular,
                alpha,
            };
            let grazing = [
                Vec3::X,
                vec3(1.0, tiny, 0.0),
                Vec3::Z,
                Vec3::Y,
                vec3(0.6, 0.8, 0.0),
            ];
            for wo in grazing {
                for wi in [
                    wo,
                    -wo,
                    Vec3::X,
                    Vec3::NEG_X,
                    Vec3::NEG_Y,
                    vec3(-1.0, tiny, 0.0),
                ] {
                    for value in [
                        scatter_eval(0.999, &surface, wo, wi),
                        scatter_pdf(0.999, &surface, wo, wi),
                    ] {
                        assert!(
                            value.is_finite() && value >= 0.0,
                            "{surface:?} {wo} {wi} {value}"
                        );
                    }
                }
                for z in [0.0, 0.01, 0.3, 0.49, 0.51, 0.999] {
                    for xy in [
                        [0.0, 0.0],
                        [1.0 - 6e-8, 1.0 - 6e-8],
                        [0.0, 0.5],
                        [0.5, 0.25],
                    ] {
                        let wi = scatter_sample(0.999, &surface, wo, [xy[0], xy[1], z]);
                        assert!((wi.length() - 1.0).abs() < 1e-5, "{surface:?} {wo} {wi}");
                    }
                }
            }
        }
    }
}

fn environment(width: usize, height: usize, texel: impl Fn(usize, usize) -> f32) -> Environment {
    let texels = (0..width * height)
        .map(|i| texel(i % width, i / width))
        .map(|value| [value, 0.5 * value, 0.25 * value]);
    Environment {
        map: EnvironmentMap::new(width, height, texels.collect()),
        rotation_y: 0.0,
        scale: 1.5,
    }
}

fn environments() -> Vec<Environment> {
    let noise = |i: usize, j: usize| numbers((i + 100 * j) as u32, 77)[0];
    vec![
        environment(2, 1, |i, _| i as f32),
        environment(1, 2, |_, j| 1.0 + j as f32),
        environment(5, 3, |_, j| if j == 1 { 0.0 } else { 1.0 }),
        environment(17, 9, noise),
        environment(
            64,
            32,
            |i, j| if (i, j) == (11, 9) { 1e9 } else { noise(i, j) },
        ),
        environment(16, 8, |i, j| if j == 0 { 40.0 } else { noise(i, j) }),
        environment(16, 8, |i, j| if j == 7 { 40.0 } else { noise(i, j) }),
    ]
}

#[test]
fn environment_is_drawn_as_evaluated() {
    for (case, environment) in environments().into_iter().enumerate() {
        let light = Light::new(&environment).expect("light");
        let samples: Vec<_> = (0..20_000)
            .map(|i| {
                let bits = pcg3d([i, case as u32, 3])[0];
                let [v, ..] = numbers(i, 950 + case as u32);
                light.sample(bits, v, numbers(i, 900 + case as u32))
            })
            .collect();
        for sample in &samples {
            let again = light.eval(sample.wi);
            let error = (sample.pdf - again.pdf).abs() / sample.pdf;
            // A sun's slope is steep: rounding the direction moves along it.
            assert!(
                error < 0.02,
                "case {case}: {} but {}",
                sample.pdf,
                again.pdf
            );
        }
        let (width, height) = (environment.map.width(), environment.map.height());
        let draws: Vec<_> = samples.iter().map(|sample| sample.wi).collect();
        SphereCells::of_map(width, height)
            .check(&draws, |wi| f64::from(light.eval(wi).pdf), 0.01)
            .unwrap_or_else(|error| panic!("{width} x {height}: {error}"));
    }
}

/// Radiance over density has the mean of the map, and so have all mixtures of candidates.
#[test]
fn light_choices_have_the_right_mean() {
    let environment = environment(17, 9, |i, j| {
        numbers((i + 100 * j) as u32, 77)[0].powi(4) * 9.0
    });
    let light = Light::new(&environment).expect("light");
    let normal = vec3(0.2, 0.9, -0.4).normalize();
    let surface = Surface {
        normal,
        probability: 0.7,
        specular: 0.3,
        alpha: 0.2,
    };
    let wo = vec3(-0.5, 0.8, 0.1).normalize();
    let f = |wi: Vec3| {
        let d = wi.as_dvec3();
        f64::from(scatter_eval(0.3, &surface, wo, wi)) * environment.radiance(d)[0]
    };
    let exact: f64 = SphereCells::of_map(68, 36).integrals(f).iter().sum();
    for candidates in [[1, 0], [0, 1], [1, 1], [2, 2], [4, 1]] {
        let weights: Vec<f64> = (0..20_000)
            .map(|i| {
                let [a, b, _] = numbers(i, 40);
                let inputs = (0.3, &surface, wo);
                f64::from(
                    choose_light(&light, candidates, inputs, [a, b], [i, 7, 9])
                        .1
                        .x,
                )
            })
            .collect();
        let n = weights.len() as f64;
        let mean = weights.iter().sum::<f64>() / n;
        let variance = weights.iter().map(|w| (w - mean) * (w - mean)).sum::<f64>() / n;
        let deviation = (mean - exact).abs() / (variance / n).sqrt();
        assert!(
            deviation < 5.0,
            "{candidates:?}: {mean} for {exact}, {deviation} sigma"
        );
    }
}

/// Optical depth of a ray through the grid up to t, by sorting all borders, in f64.
fn optical_depth(grid: &Majorants, origin: DVec3, direction: DVec3, t: f64) -> f64 {
    let mut borders = vec![0.0, t];
    for axis in 0..3 {
        for cell in 0..=grid.cells[axis] {
            let border = f64::from(cell * grid.cell_size).min(f64::from(grid.extent[axis]));
            let at = (border - origin[axis]) / direction[axis];
            if at > 0.0 && at < t {
                borders.push(at);
            }
        }
    }
    borders.sort_by(f64::total_cmp);
    let segment = |pair: &[f64]| {
        let middle = origin + 0.5 * (pair[0] + pair[1]) * direction;
        let inside = middle.cmpge(DVec3::ZERO).all() && middle.cmple(grid.extent.as_dvec3()).all();
        let cell = (middle / f64::from(grid.cell_size)).floor().as_ivec3();
        let sigma = if inside {
            grid.at(cell.min(grid.cells.as_ivec3() - 1))
        } else {
            0.0
        };
        f64::from(sigma) * (pair[1] - pair[0])
    };
    borders.windows(2).map(segment).sum()
}

#[test]
fn walks_stop_where_the_optical_depth_is_reached() {
    let cells = glam::uvec3(3, 4, 2);
    let sigma_maj = (0..24)
        .map(|i| (numbers(i, 5)[0] - 0.3).max(0.0) * 4.0)
        .collect();
    let grid = Majorants {
        cell_size: 8,
        extent: vec3(21.0, 32.0, 11.0),
        cells,
        sigma_maj,
        occupied: [IVec3::ZERO, cells.as_ivec3()],
    };
    let (mut collisions, mut left) = (0, 0);
    for i in 0..4000 {
        let centre = 0.5 * grid.extent;
        let direction = direction(numbers(i, 6)) * (0.2 + 5.0 * numbers(i, 7)[0]);
        let target = centre + 12.0 * (Vec3::from(numbers(i, 8)) - 0.5);
        let origin = target - 20.0 * numbers(i, 9)[1] * direction;
        let tau = -(1.0 - numbers(i, 10)[0]).ln() * 8.0;
        let mut walk = Walk::start(&grid, origin, direction, 0.0, tau);
        let exact = |t| optical_depth(&grid, origin.as_dvec3(), direction.as_dvec3(), t);
        let event = if walk.misses() {
            Event::Left
        } else {
            walk.advance(1000)
        };
        match event {
            Event::Collision => {
                let there = exact(f64::from(walk.distance()));
                assert!((there - f64::from(tau)).abs() < 1e-3, "{there} for {tau}");
                collisions += 1;
            }
            Event::Left => {
                let all = exact(1e6);
                assert!(all < f64::from(tau) + 1e-3, "left after {tau} of {all}");
                left += 1;
            }
            Event::Moving => panic!("the walk stalled"),
        }
    }
    assert!(
        collisions > 500 && left > 500,
        "{collisions} collisions, {left} left"
    );
}

/// Around a sphere, cells add up to its area.
#[test]
fn sphere_cells_cover_the_sphere() {
    for cells in [SphereCells::around(Vec3::X), SphereCells::of_map(17, 9)] {
        let area: f64 = cells.integrals(|_| 1.0).iter().sum();
        assert!((area / (4.0 * PI) - 1.0).abs() < 1e-2, "{area}");
    }
}
