//! `holovol bench light`: T (DESIGN §6) for what may happen between two frames.

use std::f64::consts::TAU;

use glam::DVec3;
use holovol_light::change::ChangeDetector;
use holovol_light::evaluate::happenings::{
    scaled, with_lamp, with_moved_sun, with_noise, with_person,
};
use holovol_light::evaluate::{imagined, median};
use holovol_light::{EnvironmentMap, Grid};
use rayon::prelude::*;
use serde::Serialize;

/// Panoramas as a camera gives them.
const SIZE: [usize; 2] = [512, 256];
/// Rooms and days at random.
const IMAGINED: u64 = 64;
/// Walks in each panorama.
const WALKS: usize = 4;
/// Frames of a walk, and their number in a second.
const FRAMES: usize = 16;
const RATE: f64 = 30.0;
/// Distance, m, and speed, m/s, of who walks by.
const DISTANCE: f64 = 1.5;
const SPEED: f64 = 1.4;
/// Shares of all light that who walks by hides: up to each is an event of its own, and who hides
/// more than the last stands before the lamp.
const HIDES: [f64; 3] = [0.01, 0.03, 0.1];

/// T of one event over many panoramas.
#[derive(Serialize)]
pub(super) struct Change {
    pub(super) event: String,
    pub(super) expected: &'static str,
    pub(super) count: usize,
    pub(super) least: f64,
    pub(super) median: f64,
    pub(super) most: f64,
    /// How many are not what was expected.
    pub(super) outside: usize,
}

/// Measures T for what may happen between two frames of each panorama, and of imagined ones made
/// from this seed on.
pub(super) fn changes(maps: &[EnvironmentMap], imagined_seed: u64) -> Vec<Change> {
    let small: Vec<EnvironmentMap> = maps.par_iter().map(shrunk).collect();
    let imagined: Vec<EnvironmentMap> = (imagined_seed..imagined_seed + IMAGINED)
        .into_par_iter()
        .map(|seed| imagined(seed, SIZE[0], SIZE[1]))
        .collect();
    let mut rows = table(&small, "");
    rows.extend(table(&imagined, "imagined: "));
    rows
}

type Event = (&'static str, &'static str, [f64; 2]);

/// What happened, in the order of the table: its name, DESIGN's words for it, and its bounds.
///
/// A surface's light is what T is for, and DESIGN leaves out patches that can't change it by 1 %: so
/// who hides less than that may give 0.
const EVENTS: [Event; 9] = [
    ("nothing", "0", [0.0, 0.0]),
    ("sensor noise", "< 0.05", [0.0, 0.05]),
    ("exposure change, compensated to 2 %", "< 0.05", [0.0, 0.05]),
    (
        "a person walks by, hiding < 1 % of all light",
        "≤ 0.5",
        [0.0, 0.5],
    ),
    ("… 1 to 3 %", "0.05 … 0.5", [0.05, 0.5]),
    ("… 3 to 10 %", "0.05 … 0.5", [0.05, 0.5]),
    ("… more, so steps before the light", "–", [0.0, 1.0]),
    ("the sun moves by 10°", "> 0.5", [0.5, 1.0]),
    ("a lamp goes on", "> 0.8", [0.8, 1.0]),
];
/// The first of a person's events, the sun's and the lamp's.
const PERSON: usize = 3;
const SUN: usize = 7;
const LAMP: usize = 8;

fn table(maps: &[EnvironmentMap], which: &str) -> Vec<Change> {
    let found: Vec<Vec<(usize, f64)>> = maps
        .par_iter()
        .enumerate()
        .map(|(i, map)| of_one(i as u64, map))
        .collect();
    let of_event = |event: usize| -> Vec<f64> {
        let all = found.iter().flatten();
        all.filter(|(e, _)| *e == event).map(|(_, t)| *t).collect()
    };
    let row = |(event, (name, expected, [low, high])): (usize, &Event)| {
        let all = of_event(event);
        (!all.is_empty()).then(|| Change {
            event: format!("{which}{name}"),
            expected,
            count: all.len(),
            least: all.iter().copied().fold(f64::MAX, f64::min),
            median: median(all.clone()),
            most: all.iter().copied().fold(0.0, f64::max),
            outside: all.iter().filter(|t| !(*low..=*high).contains(*t)).count(),
        })
    };
    EVENTS.iter().enumerate().filter_map(row).collect()
}

/// Pairs of event and T.
fn of_one(seed: u64, map: &EnvironmentMap) -> Vec<(usize, f64)> {
    let grid = Grid::new(SIZE[0], SIZE[1]);
    let between = |a: &EnvironmentMap, b: &EnvironmentMap| {
        let mut detector = ChangeDetector::new();
        detector.update(&grid, a.texels(), &[]);
        detector.update(&grid, b.texels(), &[])
    };
    let mut out = vec![
        (0, between(map, map)),
        (
            1,
            between(&with_noise(map, seed), &with_noise(map, seed + 1000)),
        ),
        (2, between(map, &scaled(map, 1.02))),
    ];
    for walk in 0..WALKS {
        let (t, hides) = walk_by(&grid, map, (walk as f64 + 0.3) / WALKS as f64 * TAU);
        let class = HIDES.iter().filter(|&&share| hides >= share).count();
        out.push((PERSON + class, t));
    }
    if let Some(moved) = with_moved_sun(map) {
        out.push((SUN, between(map, &moved)));
    }
    let lamp = with_lamp(
        map,
        DVec3::new(0.5, 0.6, 0.62).normalize(),
        0.5,
        2.5_f64.to_radians(),
    );
    out.push((LAMP, between(map, &lamp)));
    out
}

/// The largest T of a walk, and the largest share of light that it hides.
fn walk_by(grid: &Grid, map: &EnvironmentMap, from: f64) -> (f64, f64) {
    let mut detector = ChangeDetector::new();
    let (mut most, mut hides) = (0.0_f64, 0.0_f64);
    for frame in 0..FRAMES {
        let azimuth = from + frame as f64 / RATE * SPEED / DISTANCE;
        let (now, hidden) = with_person(map, azimuth, DISTANCE);
        let t = detector.update(grid, now.texels(), &[]);
        if frame > 0 {
            most = most.max(t);
        }
        hides = hides.max(hidden);
    }
    (most, hides)
}

/// A panorama at [`SIZE`], each texel the mean of those it covers, or the nearest one.
fn shrunk(map: &EnvironmentMap) -> EnvironmentMap {
    let span = |i: usize, to: usize, from: usize| {
        let start = i * from / to;
        start..((i + 1) * from / to).max(start + 1)
    };
    let texel = |i: usize| {
        let columns = span(i % SIZE[0], SIZE[0], map.width());
        let rows = span(i / SIZE[0], SIZE[1], map.height());
        let count = (columns.len() * rows.len()) as f32;
        let mut sum = [0.0; 3];
        for y in rows {
            for x in columns.clone() {
                let texel = map.texel(x as i64, y as i64);
                for c in 0..3 {
                    sum[c] += texel[c];
                }
            }
        }
        sum.map(|c| c / count)
    };
    EnvironmentMap::new(
        SIZE[0],
        SIZE[1],
        (0..SIZE[0] * SIZE[1]).map(texel).collect(),
    )
}
