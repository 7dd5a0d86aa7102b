use std::f64::consts::TAU;

use super::*;
use crate::evaluate::happenings::{scaled, with_lamp, with_moved_sun, with_noise, with_person};
use crate::evaluate::imagined;

const WIDTH: usize = 256;
const HEIGHT: usize = 128;

struct Noise(u64);

impl Noise {
    /// Normal enough: the sum of four uniforms.
    fn next(&mut self) -> f32 {
        let mut sum = 0.0;
        for _ in 0..4 {
            self.0 = self
                .0
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            sum += (self.0 >> 40) as f32 / (1u64 << 24) as f32 - 0.5;
        }
        sum * 1.7
    }
}

/// A room with structure, a lamp and a person.
fn room(lamp: f32, person: Option<usize>, noise: Option<u64>) -> Vec<[f32; 3]> {
    let mut noise = noise.map(Noise);
    (0..WIDTH * HEIGHT)
        .map(|i| {
            let (x, y) = (i % WIDTH, i / WIDTH);
            let mut l = 0.2 + 0.1 * ((x / 9 + y / 7) % 3) as f32 + 0.4 * (1.0 - y as f32 / 128.0);
            if person.is_some_and(|at| (at..at + 14).contains(&x) && (48..90).contains(&y)) {
                l = 0.12;
            }
            if (100..106).contains(&x) && (30..36).contains(&y) {
                l += lamp;
            }
            if let Some(noise) = &mut noise {
                l *= 1.0 + 0.03 * noise.next();
            }
            [l; 3]
        })
        .collect()
}

fn sky(sun_column: usize) -> Vec<[f32; 3]> {
    let grid = Grid::new(WIDTH, HEIGHT);
    let sun = DVec3::from_array(grid.direction(sun_column, 40).map(f64::from));
    (0..WIDTH * HEIGHT)
        .map(|i| {
            let at = DVec3::from_array(grid.direction(i % WIDTH, i / WIDTH).map(f64::from));
            let angle = at.angle_between(sun);
            let disc = if angle < 0.02 { 2000.0 } else { 0.0 };
            [(0.3 + 0.05 / angle.max(0.02) + disc) as f32; 3]
        })
        .collect()
}

fn change(a: &[[f32; 3]], b: &[[f32; 3]]) -> f64 {
    let grid = Grid::new(WIDTH, HEIGHT);
    let mut detector = ChangeDetector::new();
    assert_eq!(detector.update(&grid, a, &[]), 1.0);
    detector.update(&grid, b, &[])
}

#[test]
fn nothing_noise_and_compensated_exposure_are_no_change() {
    assert_eq!(
        change(&room(20.0, None, None), &room(20.0, None, None)),
        0.0
    );
    assert!(change(&room(20.0, None, Some(1)), &room(20.0, None, Some(2))) < 0.05);
    // 3 % is what an exposure tag may be off.
    let brighter: Vec<[f32; 3]> = room(20.0, None, None)
        .iter()
        .map(|t| t.map(|c| c * 1.03))
        .collect();
    assert!(change(&room(20.0, None, None), &brighter) < 0.05);
}

#[test]
fn a_moving_sun_and_a_lamp_are_large_changes() {
    let t = change(&sky(100), &sky(107));
    assert!(t > 0.5, "sun: {t}");
    let t = change(&room(0.0, None, None), &room(200.0, None, None));
    assert!(t > 0.8, "lamp: {t}");
    let t = change(&room(200.0, None, None), &room(0.0, None, None));
    assert!(t > 0.8, "lamp off: {t}");
    let half: Vec<[f32; 3]> = sky(100).iter().map(|t| t.map(|c| 0.5 * c)).collect();
    assert!(change(&sky(100), &half) > 0.8);
}

fn between(a: &EnvironmentMap, b: &EnvironmentMap) -> f64 {
    change(a.texels(), b.texels())
}

/// Rooms and days at random, by seed.
fn many() -> impl Iterator<Item = (u64, EnvironmentMap)> {
    (0..24).map(|seed| (seed, imagined(seed, WIDTH, HEIGHT)))
}

#[test]
fn noise_and_exposure_are_no_change_anywhere() {
    for (seed, map) in many() {
        let t = between(&with_noise(&map, seed), &with_noise(&map, seed + 1000));
        assert!(t < 0.05, "noise, seed {seed}: {t}");
        let t = between(&map, &scaled(&map, 1.03));
        assert!(t < 0.05, "exposure, seed {seed}: {t}");
    }
}

#[test]
fn a_person_walking_by_is_some_change_anywhere() {
    let mut seen = 0;
    for (seed, map) in many() {
        // 1.4 m/s, 1.5 m away, 30 frames a second.
        let (distance, step) = (1.5, 1.4 / 1.5 / 30.0);
        let from = seed as f64 / 24.0 * TAU;
        let grid = Grid::new(WIDTH, HEIGHT);
        let mut detector = ChangeDetector::new();
        let (mut most, mut hides) = (0.0_f64, 0.0_f64);
        for i in 0..16 {
            let (now, hidden) = with_person(&map, from + f64::from(i) * step, distance);
            let t = detector.update(&grid, now.texels(), &[]);
            if i > 0 {
                most = most.max(t);
            }
            hides = hides.max(hidden);
        }
        // Who steps before the lamp takes its light away, and who stands where there
        // is next to none may be left out.
        if hides < 0.1 {
            let least = if hides > 0.01 { 0.05 } else { 0.0 };
            assert!(
                (least..0.5).contains(&most),
                "seed {seed}: {most}, hides {hides}"
            );
            seen += usize::from(hides > 0.01);
        }
    }
    assert!(seen > 5, "{seen}");
}

#[test]
fn lamps_and_suns_are_large_changes_anywhere() {
    let mut suns = 0;
    for (seed, map) in many() {
        let azimuth = seed as f64;
        let direction = DVec3::new(azimuth.cos(), 0.7, azimuth.sin()).normalize();
        let lit = with_lamp(&map, direction, 0.5, 0.05);
        let t = between(&map, &lit);
        assert!(t > 0.8, "lamp, seed {seed}: {t}");
        if let Some(moved) = with_moved_sun(&map) {
            let t = between(&map, &moved);
            assert!(t > 0.5, "sun, seed {seed}: {t}");
            suns += 1;
        }
    }
    assert!(suns > 5, "{suns}");
}

#[test]
fn nothing_is_kept_before_the_first_frame_and_infinite_light_is_a_change() {
    let grid = Grid::new(WIDTH, HEIGHT);
    let mut detector = ChangeDetector::new();
    detector.keep();
    assert_eq!(detector.since_kept(), 1.0);
    let mut map = room(1.0, None, None);
    detector.update(&grid, &map, &[]);
    detector.keep();
    map[5000] = [f32::INFINITY; 3];
    assert_eq!(detector.update(&grid, &map, &[]), 1.0);
    assert_eq!(detector.since_kept(), 1.0);
}

#[test]
fn slow_change_adds_up_against_what_was_kept() {
    let grid = Grid::new(WIDTH, HEIGHT);
    let map = imagined(2, WIDTH, HEIGHT);
    let mut detector = ChangeDetector::new();
    assert_eq!(detector.since_kept(), 1.0);
    detector.update(&grid, map.texels(), &[]);
    detector.keep();
    assert_eq!(detector.since_kept(), 0.0);
    // Dusk, a hundredth a frame.
    let mut last = 0.0;
    for i in 1..40 {
        let darker = scaled(&map, 0.99_f32.powi(i));
        let t = detector.update(&grid, darker.texels(), &[]);
        assert!(t < 0.01, "{t}");
        assert!(detector.since_kept() >= last, "{i}");
        last = detector.since_kept();
    }
    assert!(last > 0.5, "{last}");
    detector.keep();
    assert_eq!(detector.since_kept(), 0.0);
}

#[test]
fn texels_larger_than_cells_shine_from_all_that_they_cover() {
    for (width, height) in [(1, 1), (2, 1), (64, 32), (200, 100)] {
        let mut detector = ChangeDetector::new();
        let texels = vec![[1.0; 3]; width * height];
        detector.update(&Grid::new(width, height), &texels, &[]);
        let flux = &detector.frames[detector.newest].flux;
        let cells = Grid::new(SIDE, SIDE);
        // Blurring evens out the rows next to the poles.
        for (i, flux) in flux
            .iter()
            .enumerate()
            .take(SIDE * (SIDE - 8))
            .skip(SIDE * 8)
        {
            let ratio = flux / cells.solid_angle(i / SIDE);
            let rough = if width > 128 { 1.1 } else { 0.02 };
            assert!((ratio - 1.0).abs() < rough, "{width} × {height}: {ratio}");
        }
    }
}
