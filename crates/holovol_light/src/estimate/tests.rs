use glam::DVec3;

use super::*;
use crate::EnvironmentMap;
use crate::measure::{FluxCells, normals};

const WIDTH: usize = 128;
const HEIGHT: usize = 64;

/// A scene of direction → radiance, clipped at 2^−ev and brought to 0 … 1.
fn expose(scene: impl Fn(DVec3) -> [f64; 3], ev: f64) -> Vec<[f32; 3]> {
    let grid = Grid::new(WIDTH, HEIGHT);
    (0..grid.len())
        .map(|i| {
            let at = grid.direction(i % WIDTH, i / WIDTH).map(f64::from);
            scene(DVec3::from_array(at)).map(|c| (c * ev.exp2()).min(1.0) as f32)
        })
        .collect()
}

/// A clear day: blue sky, green ground, a glow and a sun too bright for any exposure.
fn day(direction: DVec3) -> [f64; 3] {
    let sun = DVec3::new(0.6, 0.6, -0.53).normalize();
    let angle = direction.angle_between(sun);
    let glow = 0.1 / angle.max(0.02);
    let disc = if angle < 0.03 { 3000.0 } else { 0.0 };
    if direction.y > 0.0 {
        [0.1 + glow + disc, 0.2 + glow + disc, 0.45 + glow + disc]
    } else {
        [0.08, 0.12, 0.05]
    }
}

/// A room with a cut-out lamp.
fn room(direction: DVec3) -> [f64; 3] {
    let lamp = DVec3::new(-0.5, 0.7, 0.4).normalize();
    let level = if direction.angle_between(lamp) < 0.06 {
        30.0
    } else {
        0.15
    };
    [level; 3]
}

fn estimate(frames: &[(f64, Vec<[f32; 3]>)], meter: Option<Meter>) -> Estimator {
    let exposures: Vec<Exposure> = frames
        .iter()
        .map(|(ev, radiance)| Exposure { ev: *ev, radiance })
        .collect();
    let mut estimator = Estimator::new(WIDTH, HEIGHT, Prior::default());
    estimator.estimate(&Evidence {
        frames: &exposures,
        meter,
        probe: None,
    });
    estimator
}

fn whole(estimator: &Estimator) -> EnvironmentMap {
    let mut texels = Vec::new();
    estimator.write_map(&mut texels);
    EnvironmentMap::new(WIDTH, HEIGHT, texels)
}

#[test]
fn a_sun_is_told_from_a_lamp() {
    let outdoors = estimate(&[(0.0, expose(day, 0.0))], None);
    assert_eq!(outdoors.lights()[0].class, LightClass::Sun);
    assert_eq!(outdoors.lights()[0].solid_angle, SUN_SOLID_ANGLE);
    let sun = DVec3::new(0.6, 0.6, -0.53).normalize();
    assert!(outdoors.lights()[0].direction.angle_between(sun) < 0.05);
    let indoors = estimate(&[(0.0, expose(room, 0.0))], None);
    assert_ne!(indoors.lights()[0].class, LightClass::Sun);
}

#[test]
fn each_rung_is_surer_than_the_one_below() {
    let truth = FluxCells::new(&EnvironmentMap::new(WIDTH, HEIGHT, {
        let grid = Grid::new(WIDTH, HEIGHT);
        let radiance = |i| {
            let at = grid.direction(i % WIDTH, i / WIDTH).map(f64::from);
            room(DVec3::from_array(at)).map(|c| c as f32)
        };
        (0..grid.len()).map(radiance).collect()
    }));
    let base = expose(room, 0.0);
    let meter = Meter::upward(luminance(truth.irradiance(DVec3::Y)));
    let single = estimate(&[(0.0, base.clone())], None);
    let metered = estimate(&[(0.0, base.clone())], Some(meter));
    let bracket = estimate(&[(0.0, base), (-6.0, expose(room, -6.0))], None);
    let error = |estimator: &Estimator| {
        let found = FluxCells::new(&whole(estimator));
        let mean = |cells: &FluxCells| -> f64 {
            normals(64).map(|n| luminance(cells.irradiance(n))).sum()
        };
        (mean(&found) / mean(&truth)).log2().abs()
    };
    assert_eq!(single.rung(), Rung::Single);
    assert!(single.sigma_ev() > metered.sigma_ev() && metered.sigma_ev() > bracket.sigma_ev());
    assert!(error(&metered) < 0.1, "{}", error(&metered));
    assert!(error(&bracket) < 0.02, "{}", error(&bracket));
}

#[test]
fn a_turned_panorama_gives_a_turned_estimate() {
    let base = expose(day, 0.0);
    let turned: Vec<[f32; 3]> = (0..base.len())
        .map(|i| base[(i % WIDTH + WIDTH / 4) % WIDTH + i / WIDTH * WIDTH])
        .collect();
    let (a, b) = (
        estimate(&[(0.0, base)], None),
        estimate(&[(0.0, turned)], None),
    );
    for i in 0..WIDTH * HEIGHT {
        let from = (i % WIDTH + WIDTH / 4) % WIDTH + i / WIDTH * WIDTH;
        let (found, expected) = (b.radiance()[i][1], a.radiance()[from][1]);
        assert!(
            (found - expected).abs() < 1e-3 * expected.max(0.1),
            "{found} {expected}"
        );
    }
    let quarter = glam::DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2);
    let expected = quarter * a.lights()[0].direction;
    assert!(b.lights()[0].direction.angle_between(expected) < 1e-3);
}

#[test]
fn discs_keep_the_energy_that_the_map_loses() {
    let frames = [(0.0, expose(room, 0.0)), (-6.0, expose(room, -6.0))];
    let estimator = estimate(&frames, None);
    assert_eq!(estimator.lights().len(), 1);
    assert!(estimator.lights()[0].disc);
    let grid = Grid::new(WIDTH, HEIGHT);
    let drawn = crate::measure::luminous_flux(&grid, whole(&estimator).texels());
    assert!((drawn / estimator.flux() - 1.0).abs() < 1e-4);
    // 1/64 of 30 does not clip: what is seen is the truth.
    let seen: Vec<[f32; 3]> = expose(|d| room(d).map(|c| c / 64.0), 0.0);
    let expected = 64.0 * crate::measure::luminous_flux(&grid, &seen);
    assert!((drawn / expected - 1.0).abs() < 0.01, "{drawn} {expected}");
}

#[test]
fn whatever_comes_light_is_finite_and_not_negative() {
    let broken = [
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        -1.0,
        0.0,
        1.0,
        1e30,
    ];
    let mut state = 1_u32;
    let mut any = || {
        state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        broken[(state >> 16) as usize % broken.len()]
    };
    for (width, height) in [(1, 1), (2, 1), (7, 3), (64, 32)] {
        let base: Vec<[f32; 3]> = (0..width * height).map(|_| [any(), any(), any()]).collect();
        let dark: Vec<[f32; 3]> = (0..width * height).map(|_| [any(), any(), any()]).collect();
        let mut estimator = Estimator::new(width, height, Prior::default());
        for meter in [None, Some(Meter::upward(0.0)), Some(Meter::upward(1e20))] {
            let frames = [
                Exposure {
                    ev: 0.0,
                    radiance: &base,
                },
                Exposure {
                    ev: -6.0,
                    radiance: &dark,
                },
            ];
            estimator.estimate(&Evidence {
                frames: &frames,
                meter,
                probe: None,
            });
            let map = estimator.radiance().iter().flatten();
            assert!(map.clone().all(|c| c.is_finite() && *c >= 0.0));
            for light in estimator.lights() {
                assert!(light.irradiance.iter().all(|e| e.is_finite() && *e >= 0.0));
                assert!(light.direction.is_normalized());
            }
            assert!(estimator.sigma_ev().is_finite());
        }
    }
}

/// A wall that nearly clips, with a spot that does and fades, and a lamp before it.
fn lit_wall(lamp: f64) -> impl Fn(DVec3) -> [f64; 3] {
    move |direction| {
        let spot = direction.angle_between(DVec3::new(0.2, 0.3, -0.9).normalize());
        let at = direction.angle_between(DVec3::new(-0.5, 0.1, -0.85).normalize());
        let wall = if direction.z < -0.7 { 0.7 } else { 0.1 };
        let level = if at < 0.06 {
            lamp
        } else {
            wall + 0.6 * (1.0 - spot / 0.5).max(0.0)
        };
        [level; 3]
    }
}

#[test]
fn a_lamp_is_not_taken_for_the_wall_behind_it() {
    let lit = estimate(&[(0.0, expose(lit_wall(40.0), 0.0))], None);
    let towards = DVec3::new(-0.5, 0.1, -0.85).normalize();
    let near = |light: &&Light| light.direction.angle_between(towards) < 0.05;
    let lamp = lit.lights().iter().find(near).expect("the lamp is a light");
    let level = |light: &Light| luminance(light.irradiance) / light.solid_angle;
    assert!(lamp.disc && level(lamp) > 1.5, "{lamp:?}");
    // The spot is at most 1.3.
    let spot = lit.lights().iter().find(|light| !near(light));
    let spot = spot.expect("the spot is a light");
    assert!(level(spot) < 1.6, "{spot:?}");
}

#[test]
fn a_sun_that_compression_keeps_from_clipping_is_still_one() {
    let base = expose(day, 0.0);
    let dark = expose(day, -6.0);
    // What clips comes out of a video coder a little below it.
    let blunted: Vec<[f32; 3]> = dark.iter().map(|t| t.map(|c| c.min(0.93))).collect();
    let clean = estimate(&[(0.0, base.clone()), (-6.0, dark)], None);
    let coded = estimate(&[(0.0, base.clone()), (-6.0, blunted)], None);
    assert_eq!(coded.lights()[0].class, LightClass::Sun);
    assert!((coded.flux() / clean.flux() - 1.0).abs() < 0.1);
    // A glow without a sun stays what it is.
    let veiled = |d: DVec3| day(d).map(|c| c.min(30.0));
    let dim = estimate(
        &[(0.0, expose(veiled, 0.0)), (-6.0, expose(veiled, -6.0))],
        None,
    );
    assert!(
        dim.lights()
            .iter()
            .all(|light| light.class != LightClass::Sun)
    );
}

/// Exposures may be counted from the brightest or from the darkest.
#[test]
fn the_unit_of_radiance_changes_nothing_but_the_unit() {
    let frames = |first: f64| {
        let shot = |ev: f64| (ev - first, expose(day, ev));
        vec![shot(0.0), shot(-6.0)]
    };
    let [bright, dark] = [0.0, -6.0].map(|first| estimate(&frames(first), None));
    let class = |estimator: &Estimator| estimator.lights()[0].class;
    assert_eq!(class(&bright), LightClass::Sun);
    assert_eq!(class(&dark), LightClass::Sun);
    let ratio = dark.flux() / bright.flux() * 64.0;
    assert!((ratio - 1.0).abs() < 1e-3, "{ratio}");
    assert!((dark.sigma_ev() / bright.sigma_ev() - 1.0).abs() < 1e-3);
}

/// A picture of one row: all of it lies on the horizon, which a meter that looks up doesn't see.
#[test]
fn a_meter_that_sees_nothing_of_the_picture_says_nothing() {
    let row = vec![[1.0; 3]; 2];
    let frames = [Exposure {
        ev: 0.0,
        radiance: &row,
    }];
    let flux = |meter: Option<Meter>| {
        let mut estimator = Estimator::new(2, 1, Prior::default());
        estimator.estimate(&Evidence {
            frames: &frames,
            meter,
            probe: None,
        });
        estimator.flux()
    };
    assert_eq!(flux(Some(Meter::upward(3.0))), flux(None));
}
