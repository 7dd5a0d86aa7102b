//! Panoramas that nobody has taken: rooms and days at random, so that what was tuned on a few real
//! ones is tried on many others.

use std::f64::consts::PI;

use glam::DVec3;

use super::Noise;
use crate::measure::FluxCells;
use crate::{EnvironmentMap, Grid, luminance};

/// A room (odd seeds) or a day (even ones).
///
/// Walls and ground are lit by the lamps, windows or sun of the panorama (one bounce, and a mean
/// for the rest) and reflect 5 to 80 %. Suns are weakened and skies whitened by the same haze.
pub fn imagined(seed: u64, width: usize, height: usize) -> EnvironmentMap {
    let mut noise = Noise(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x51ed);
    let grid = Grid::new(width, height);
    let mut texels = vec![[0.0; 3]; grid.len()];
    let is_day = seed.is_multiple_of(2);
    if is_day {
        day(&grid, &mut texels, &mut noise);
    } else {
        lamps(&grid, &mut texels, &mut noise);
    }
    let lights = FluxCells::from_texels(&grid, &texels);
    let around = lights.irradiance(DVec3::Y).map(|e| 0.3 * e / PI);
    let walls = reflectances(&grid, &mut noise);
    for (i, texel) in texels.iter_mut().enumerate() {
        let at = DVec3::from(grid.direction(i % width, i / width).map(f64::from));
        if luminance(texel.map(f64::from)) > 0.0 {
            continue;
        }
        // Ground looks up, walls look at the camera.
        let normal = if is_day { DVec3::Y } else { -at };
        let light = lights.irradiance(normal);
        for c in 0..3 {
            texel[c] = (walls[i][c] * (light[c] / PI + around[c])) as f32;
        }
    }
    EnvironmentMap::new(width, height, texels)
}

/// Lamps and windows of a room.
fn lamps(grid: &Grid, texels: &mut [[f32; 3]], noise: &mut Noise) {
    let count = 1 + (noise.uniform() * 6.0) as usize;
    for _ in 0..count {
        let up = noise.uniform();
        let azimuth = noise.uniform() * 2.0 * PI;
        let flat = (1.0 - up * up).sqrt();
        let direction = DVec3::new(flat * azimuth.cos(), up, flat * azimuth.sin());
        let radius = 0.02 * 12.0_f64.powf(noise.uniform());
        let level = (noise.normal() * 2.0 - 12.0 * radius).exp2();
        let warm = 1.0 + 0.4 * noise.uniform();
        grid.visit_cap(direction, radius.max(0.04), |y, start, count| {
            for k in start..start + count as i64 {
                let x = k.rem_euclid(grid.width() as i64) as usize;
                texels[x + grid.width() * y] =
                    [level * warm, level, level / warm].map(|c| c as f32);
            }
        });
    }
}

/// Sky and sun; the lower half stays black.
fn day(grid: &Grid, texels: &mut [[f32; 3]], noise: &mut Noise) {
    let haze = 0.02 + 0.4 * noise.uniform().powi(2);
    let elevation = 0.1 + 1.2 * noise.uniform();
    let azimuth = noise.uniform() * 2.0 * PI;
    let sun = DVec3::new(
        elevation.cos() * azimuth.cos(),
        elevation.sin(),
        elevation.cos() * azimuth.sin(),
    );
    let air_mass = 1.0 / elevation.sin();
    let direct = (-(0.1 + haze) * air_mass).exp();
    let blue = [0.06 + 0.9 * haze, 0.1 + haze, 0.2 + 1.2 * haze];
    // At least a texel's half diagonal, so that there is a sun.
    let radius = 0.75 * PI / grid.height() as f64;
    let disc = 10.0 * direct / (PI * radius * radius);
    for (i, texel) in texels.iter_mut().enumerate() {
        let (x, y) = (i % grid.width(), i / grid.width());
        let at = DVec3::from(grid.direction(x, y).map(f64::from));
        if at.y <= 0.0 {
            continue;
        }
        let angle = at.angle_between(sun).max(0.017);
        let glow = (0.02 + 0.3 * haze) / angle;
        let bright = if angle <= radius.max(0.017) {
            disc
        } else {
            0.0
        };
        for c in 0..3 {
            texel[c] = (blue[c] * (1.0 + at.dot(sun).powi(2)) + glow + bright) as f32;
        }
    }
}

/// Overlapping patches of 5 to 80 %.
fn reflectances(grid: &Grid, noise: &mut Noise) -> Vec<[f64; 3]> {
    let (width, height) = (grid.width(), grid.height());
    let mut out = vec![[0.3; 3]; grid.len()];
    for _ in 0..40 {
        let [x0, y0] = [width, height].map(|n| (noise.uniform() * n as f64) as usize);
        let [w, h] = [width, height].map(|n| (n as f64 * (0.02 + 0.3 * noise.uniform())) as usize);
        let grey = 0.05 * 16.0_f64.powf(noise.uniform());
        let tint = [0; 3].map(|_| grey * (1.0 + 0.2 * (noise.uniform() - 0.5)));
        for y in y0..(y0 + h).min(height) {
            for x in x0..x0 + w {
                out[x % width + width * y] = tint;
            }
        }
    }
    out
}
