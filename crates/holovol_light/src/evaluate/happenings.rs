//! What may happen to a room between two frames, done to a panorama: what T is tried on.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use super::Noise;
use crate::measure::{FluxCells, luminous_flux};
use crate::{EnvironmentMap, Grid, luminance};

/// Height of the camera, m.
const CAMERA: f64 = 1.15;
/// Trousers, shirt and head: from and to which height (m), half the width (m), reflectance.
const BODY: [[f64; 4]; 3] = [
    [0.0, 0.9, 0.18, 0.08],
    [0.9, 1.5, 0.25, 0.35],
    [1.5, 1.75, 0.1, 0.3],
];

/// The panorama with a person at this azimuth (radians from −z toward +x) and distance (m), lit by
/// the panorama as the side that the camera sees would be; and the share of all light that the
/// person hides.
pub fn with_person(map: &EnvironmentMap, azimuth: f64, distance: f64) -> (EnvironmentMap, f64) {
    let (width, height) = (map.width(), map.height());
    let grid = Grid::new(width, height);
    let towards = DVec3::new(azimuth.sin(), 0.0, -azimuth.cos());
    let light = FluxCells::new(map).irradiance(-towards);
    let mut texels = map.texels().to_vec();
    let mut hidden = 0.0;
    for [low, high, half, reflectance] in BODY {
        let row_of = |level: f64| 0.5 + ((CAMERA - level) / distance).atan() / PI;
        let (top, bottom) = (row_of(high) * height as f64, row_of(low) * height as f64);
        let reach = (half / distance).atan() / TAU * width as f64;
        let middle = (azimuth / TAU + 0.5) * width as f64;
        for y in top.floor().max(0.0) as usize..(bottom.ceil() as usize).min(height) {
            let inside = |from: f64, to: f64, at: f64| (to.min(at + 1.0) - from.max(at)).max(0.0);
            let rows = inside(top, bottom, y as f64);
            for x in (middle - reach).floor() as i64..(middle + reach).ceil() as i64 {
                let cover = rows * inside(middle - reach, middle + reach, x as f64);
                let at = x.rem_euclid(width as i64) as usize + width * y;
                let flux = luminance(texels[at].map(f64::from)) * f64::from(grid.solid_angle(y));
                hidden += cover * flux;
                for c in 0..3 {
                    let body = reflectance * light[c] / PI;
                    texels[at][c] += (cover * (body - f64::from(texels[at][c]))) as f32;
                }
            }
        }
    }
    let all = luminous_flux(&grid, map.texels());
    let map = EnvironmentMap::new(width, height, texels);
    (map, if all > 0.0 { hidden / all } else { 0.0 })
}

/// The panorama with another lamp: `share` of all that was there before, `radius` in radians.
pub fn with_lamp(
    map: &EnvironmentMap,
    direction: DVec3,
    share: f64,
    radius: f64,
) -> EnvironmentMap {
    let grid = Grid::new(map.width(), map.height());
    let mut texels = map.texels().to_vec();
    let mut covered = 0.0;
    grid.visit_cap(direction, radius, |y, _, count| {
        covered += f64::from(grid.solid_angle(y)) * count as f64;
    });
    let add = (share * luminous_flux(&grid, &texels) / covered.max(1e-9)) as f32;
    grid.visit_cap(direction, radius, |y, start, count| {
        for k in start..start + count as i64 {
            let x = k.rem_euclid(map.width() as i64) as usize;
            let texel = &mut texels[x + map.width() * y];
            *texel = texel.map(|c| c + add);
        }
    });
    EnvironmentMap::new(map.width(), map.height(), texels)
}

/// The panorama with its brightest 3° moved by 10° along their row; `None` if these are no sun:
/// less than a fifth of all light, or the next 3° have a third of theirs.
pub fn with_moved_sun(map: &EnvironmentMap) -> Option<EnvironmentMap> {
    const SUN: f64 = 3.0 / 180.0 * PI;
    let (width, height) = (map.width(), map.height());
    let grid = Grid::new(width, height);
    let texels = map.texels();
    let l = |i: usize| luminance(texels[i].map(f64::from));
    let brightest = (0..texels.len()).max_by(|&a, &b| l(a).total_cmp(&l(b)))?;
    let (sun_x, sun_y) = (brightest % width, brightest / width);
    let at = |i: usize| DVec3::from(grid.direction(i % width, i / width).map(f64::from));
    let shift = (width as f64 / 36.0 / f64::from(grid.row(sun_y)[0])).round() as usize;
    let level = texels[(sun_x + width / 2) % width + width * sun_y];
    let mut out = texels.to_vec();
    let (mut sun, mut ring, mut all) = (0.0, 0.0, 0.0);
    for (i, texel) in out.iter_mut().enumerate() {
        let flux = l(i) * f64::from(grid.solid_angle(i / width));
        let angle = at(i).angle_between(at(brightest));
        all += flux;
        if angle < SUN {
            sun += flux;
            *texel = level;
        } else if angle < 2.0 * SUN {
            ring += flux;
        }
    }
    for (i, texel) in texels.iter().enumerate() {
        if at(i).angle_between(at(brightest)) < SUN {
            out[(i % width + shift) % width + i / width * width] = *texel;
        }
    }
    let is_sun = sun > 0.2 * all && ring < sun / 3.0;
    is_sun.then(|| EnvironmentMap::new(width, height, out))
}

/// The panorama with 2 % of noise, and what a sensor has in the dark.
pub fn with_noise(map: &EnvironmentMap, seed: u64) -> EnvironmentMap {
    let mut noise = Noise(seed);
    let texels = map.texels();
    let mean = texels.iter().map(|t| t[1].min(1.0)).sum::<f32>() / texels.len() as f32;
    let mut shaken = |c: f32| {
        let bright = (0.02 * noise.normal()) as f32;
        let dark = (0.006 * noise.normal()) as f32;
        (c * (1.0 + bright) + mean * dark).max(0.0)
    };
    let texels = texels.iter().map(|t| t.map(&mut shaken)).collect();
    EnvironmentMap::new(map.width(), map.height(), texels)
}

/// The panorama with all of its light times a factor.
pub fn scaled(map: &EnvironmentMap, factor: f32) -> EnvironmentMap {
    let texels = map.texels().iter().map(|t| t.map(|c| c * factor));
    EnvironmentMap::new(map.width(), map.height(), texels.collect())
}
