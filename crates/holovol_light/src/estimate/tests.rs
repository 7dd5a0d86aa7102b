use glam::DVec3;

use super::*;
use crate::EnvironmentMap;
use crate::measure::{FluxCells, normals};
use crate::response::srgb_to_linear;

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

/// The doubts of an estimate, its flux, σ and rung.
fn doubted(
    frames: &[(f64, Vec<[f32; 3]>)],
    meter: Option<Meter>,
    probe: Option<&[ProbeSample]>,
) -> (Vec<Doubt>, f64, f64, Rung) {
    let exposures: Vec<Exposure> = frames
        .iter()
        .map(|(ev, radiance)| Exposure { ev: *ev, radiance })
        .collect();
    let mut estimator = Estimator::new(WIDTH, HEIGHT, Prior::default());
    estimator.estimate(&Evidence {
        frames: &exposures,
        meter,
        probe,
    });
    let (flux, sigma) = (estimator.flux(), estimator.sigma_ev());
    (estimator.doubts().to_vec(), flux, sigma, estimator.rung())
}

#[test]
fn exposures_that_contradict_the_first_are_not_believed() {
    let base = || expose(day, 0.0);
    let single = doubted(&[(0.0, base())], None, None);
    let honest = doubted(&[(0.0, base()), (-6.0, expose(day, -6.0))], None, None);
    assert_eq!((honest.0, honest.3), (vec![], Rung::Bracket));
    let far = doubted(&[(0.0, base()), (-10.0, expose(day, -10.0))], None, None);
    assert_eq!((far.0, far.3), (vec![], Rung::Bracket));
    let elsewhere = |d: DVec3| lit_wall(40.0)(DVec3::new(d.z, d.y, -d.x));
    let wrong = [
        ("the same picture", [(0.0, base()), (-6.0, base())]),
        (
            "another place",
            [(0.0, base()), (-6.0, expose(elsewhere, -6.0))],
        ),
        ("a cap", [(0.0, base()), (-6.0, expose(|_| [0.0; 3], 0.0))]),
        ("the sign turned", [(6.0, expose(day, -6.0)), (0.0, base())]),
        ("3 EV off", [(0.0, base()), (-6.0, expose(day, -3.0))]),
        ("the same far away", [(0.0, base()), (-10.0, base())]),
    ];
    for (name, frames) in wrong {
        let (doubts, flux, sigma, rung) = doubted(&frames, None, None);
        let [
            Doubt::Frame {
                frame,
                with,
                off_ev,
                believed: false,
                ..
            },
        ] = doubts[..]
        else {
            panic!("{name}: {doubts:?}");
        };
        assert_eq!(
            (frames[frame].0 == 0.0, frames[with].0),
            (false, 0.0),
            "{name}"
        );
        // What is black, or another place, says nothing of the exposure.
        let far = off_ev.abs() > 0.8 || ["another place", "a cap"].contains(&name);
        assert!(far, "{name}: {off_ev}");
        assert_eq!(
            (flux, sigma, rung),
            (single.1, single.2, Rung::Single),
            "{name}"
        );
    }
    // Little off, or a response taken for another: used, but with less trust.
    let taken_for_srgb = |value: f32| srgb_to_linear(f64::from(value).powf(1.0 / 2.2)) as f32;
    let power = |ev: f64| -> Vec<[f32; 3]> {
        let picture = expose(day, ev).into_iter();
        picture.map(|texel| texel.map(taken_for_srgb)).collect()
    };
    let doubtful = [
        [(0.0, base()), (-6.0, expose(day, -5.5))],
        [(0.0, base()), (-6.0, expose(day, -5.0))],
        [(0.0, power(0.0)), (-6.0, power(-6.0))],
    ];
    for frames in doubtful {
        let (doubts, _, sigma, _) = doubted(&frames, None, None);
        assert!(
            matches!(doubts[..], [Doubt::Frame { believed: true, .. }]),
            "{doubts:?}"
        );
        assert!(sigma > honest.2.hypot(0.2), "{sigma} {}", honest.2);
    }
}

#[test]
fn readings_that_no_light_explains_are_not_believed() {
    let black = |_: DVec3| [0.0; 3];
    let scenes: [(&str, Vec<[f32; 3]>); 3] = [
        ("day", expose(day, 0.0)),
        ("room", expose(room, 0.0)),
        ("black", expose(black, 0.0)),
    ];
    for (name, picture) in scenes {
        let frames = [(0.0, picture)];
        let alone = doubted(&frames, None, None);
        for lux in [5e5, 1e30, 1e-9] {
            let (doubts, flux, sigma, rung) = doubted(&frames, Some(Meter::upward(lux)), None);
            let found = doubts.iter().any(|d| {
                matches!(
                    d,
                    Doubt::Meter {
                        believed: false,
                        ..
                    }
                )
            });
            assert!(found && rung == Rung::Single, "{name} {lux}: {doubts:?}");
            assert_eq!(flux, alone.1, "{name} {lux}");
            assert!(
                sigma > alone.2.hypot(1.9) && sigma < alone.2 + 3.0,
                "{name} {lux}: {sigma}"
            );
        }
    }
}

#[test]
fn probes_of_nothing_and_of_one_direction_are_not_believed() {
    let frames = [(0.0, expose(room, 0.0))];
    let alone = doubted(&frames, None, None);
    let sample = |normal: DVec3, irradiance: f64| ProbeSample {
        normal,
        irradiance: [irradiance; 3],
    };
    let dark: Vec<ProbeSample> = normals(32).map(|n| sample(n, 0.0)).collect();
    let one: Vec<ProbeSample> = (0..6).map(|_| sample(DVec3::Y, 0.6)).collect();
    for (name, probe) in [("dark", dark), ("one direction", one)] {
        let (doubts, flux, sigma, rung) = doubted(&frames, None, Some(&probe));
        assert!(
            matches!(
                doubts[..],
                [Doubt::Probe {
                    believed: false,
                    ..
                }]
            ),
            "{name}: {doubts:?}"
        );
        assert_eq!((flux, rung), (alone.1, Rung::Single), "{name}");
        assert!(sigma >= alone.2, "{name}: {sigma}");
    }
    // A good one, with a meter that reads another unit beside it.
    let mut scene = Estimator::new(WIDTH, HEIGHT, Prior::default());
    scene.estimate(&Evidence {
        frames: &[Exposure {
            ev: 0.0,
            radiance: &frames[0].1,
        }],
        ..Evidence::default()
    });
    let truth = FluxCells::new(&whole(&scene));
    let good: Vec<ProbeSample> = normals(32)
        .map(|n| ProbeSample {
            normal: n,
            irradiance: truth.irradiance(n),
        })
        .collect();
    let (doubts, _, sure, rung) = doubted(&frames, None, Some(&good));
    assert_eq!((doubts, rung), (vec![], Rung::Probe));
    let (doubts, _, sigma, rung) = doubted(&frames, Some(Meter::upward(500.0)), Some(&good));
    assert!(
        matches!(
            doubts[..],
            [Doubt::Meter {
                believed: false,
                ..
            }]
        ),
        "{doubts:?}"
    );
    assert_eq!(rung, Rung::Probe);
    assert!(sigma > sure + 1.0, "{sigma}");
}

#[test]
fn a_picture_without_colours_may_hide_a_sun() {
    let grey = |d: DVec3| [luminance(day(d)); 3];
    let (doubts, flux, sigma, _) = doubted(&[(0.0, expose(grey, 0.0))], None, None);
    let [Doubt::Colourless { sun_ev }] = doubts[..] else {
        panic!("{doubts:?}");
    };
    let coloured = doubted(&[(0.0, expose(day, 0.0))], None, None);
    assert_eq!(coloured.0, []);
    let off = (coloured.1 / flux).log2();
    assert!(
        off < 2.0 * sigma && sun_ev > 0.5 * off,
        "{sun_ev} {sigma} {off}"
    );
    // Where no lamp could be a sun, colours don't matter.
    let (doubts, ..) = doubted(&[(0.0, expose(|_| [0.2; 3], 0.0))], None, None);
    assert_eq!(doubts, []);
    let (doubts, _, sigma, _) = doubted(&[(0.0, expose(|_| [1e-4; 3], 0.0))], None, None);
    assert!(
        matches!(doubts[..], [Doubt::Black { .. }]) && sigma > 1.0,
        "{doubts:?} {sigma}"
    );
}
