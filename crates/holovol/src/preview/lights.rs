//! What the panel shows of the light: the panorama and a sphere.

use std::f64::consts::{PI, TAU};

use glam::DVec3;
use holovol_light::{EnvironmentMap, luminance};

use crate::picture::encode_srgb;

/// A small copy of a map.
#[derive(Clone, Debug)]
pub(crate) struct Overview {
    /// Mean radiance, row by row from the top.
    texels: Vec<[f64; 3]>,
    /// Mean over the sphere.
    mean: f64,
}

pub(crate) const WIDTH: usize = 128;
pub(crate) const HEIGHT: usize = 64;
/// What chalk in the brightest light is exposed to.
const WHITE: f64 = 0.9;

/// Solid angle of a texel of the overview.
fn solid_angle(row: usize) -> f64 {
    let [top, bottom] = [row, row + 1].map(|y| (PI * y as f64 / HEIGHT as f64).cos());
    (top - bottom) * TAU / WIDTH as f64
}

fn direction(index: usize) -> DVec3 {
    let [x, y] = [index % WIDTH, index / WIDTH].map(|i| i as f64 + 0.5);
    EnvironmentMap::direction_from_uv([x / WIDTH as f64, y / HEIGHT as f64])
}

impl Overview {
    pub(crate) fn new(map: &EnvironmentMap) -> Self {
        let mut sums = vec![([0.0; 3], 0.0); WIDTH * HEIGHT];
        let (width, height) = (map.width().max(1), map.height().max(1));
        // A map smaller than this copy is looked up, a larger one summed.
        let (columns, rows) = (width.max(WIDTH), height.max(HEIGHT));
        for y in 0..rows {
            for x in 0..columns {
                let texel = map.texel((x * width / columns) as i64, (y * height / rows) as i64);
                let (sum, count) = &mut sums[y * HEIGHT / rows * WIDTH + x * WIDTH / columns];
                for (sum, c) in sum.iter_mut().zip(texel) {
                    *sum += f64::from(c);
                }
                *count += 1.0;
            }
        }
        let texels: Vec<[f64; 3]> = sums
            .into_iter()
            .map(|(sum, count): ([f64; 3], f64)| sum.map(|c| c / count.max(1.0)))
            .collect();
        let weighted = texels.iter().enumerate();
        let mean = weighted
            .map(|(i, texel)| luminance(*texel) * solid_angle(i / WIDTH))
            .sum::<f64>()
            / (4.0 * PI);
        Self { texels, mean }
    }

    /// The panorama for display, 8-bit sRGB.
    pub(crate) fn picture(&self) -> Vec<[u8; 3]> {
        let exposure = 0.35 / self.mean.max(1e-9);
        let develop = |texel: &[f64; 3]| texel.map(|c| encode_srgb(soft(c * exposure)));
        self.texels.iter().map(develop).collect()
    }

    /// Stops by which a camera makes chalk that faces the light show just below white.
    pub(crate) fn exposure_ev(&self) -> f64 {
        let sources = self.sources();
        let steps = || [-1.0, 0.0, 1.0].into_iter();
        let normals = steps()
            .flat_map(|x| steps().flat_map(move |y| steps().map(move |z| DVec3::new(x, y, z))))
            .filter_map(DVec3::try_normalize);
        let brightest = normals
            .map(|normal| luminance(lit(&sources, normal)))
            .fold(0.0, f64::max);
        if brightest > 0.0 {
            (WHITE / brightest).log2().clamp(-24.0, 24.0)
        } else {
            0.0
        }
    }

    /// Directions with power, without those that hardly give any.
    fn sources(&self) -> Vec<(DVec3, [f64; 3])> {
        self.texels
            .iter()
            .enumerate()
            .map(|(i, texel)| (direction(i), texel.map(|c| c * solid_angle(i / WIDTH))))
            .filter(|(_, power)| luminance(*power) > 1e-4 * self.mean * solid_angle(HEIGHT / 2))
            .collect()
    }

    /// A ball in this light, its left half a mirror and its right half chalk; `size` × `size`
    /// sRGB with opacity. `rotation_y` in radians, seen along −z.
    pub(crate) fn ball(&self, rotation_y: f64, size: usize) -> Vec<[u8; 4]> {
        let exposure = 0.5 / self.mean.max(1e-9);
        let (sin, cos) = rotation_y.sin_cos();
        let map_from_world =
            |d: DVec3| DVec3::new(cos * d.x - sin * d.z, d.y, sin * d.x + cos * d.z);
        // Coarser still: irradiance is smooth.
        let sources = self.sources();
        let pixel = |index: usize| {
            let [x, y] =
                [index % size, index / size].map(|i| 2.0 * (i as f64 + 0.5) / size as f64 - 1.0);
            let square = x * x + y * y;
            if square >= 1.0 {
                return [0; 4];
            }
            let normal = DVec3::new(x, -y, (1.0 - square).sqrt());
            let light = if x < 0.0 {
                let seen = 2.0 * normal.z * normal - DVec3::Z;
                self.look_up(map_from_world(seen))
            } else {
                lit(&sources, map_from_world(normal))
            };
            let [r, g, b] = light.map(|c| encode_srgb(soft(c * exposure)));
            [r, g, b, 255]
        };
        (0..size * size).map(pixel).collect()
    }

    fn look_up(&self, direction: DVec3) -> [f64; 3] {
        let [u, v] = EnvironmentMap::uv_from_direction(direction);
        let x = ((u * WIDTH as f64) as usize).min(WIDTH - 1);
        let y = ((v * HEIGHT as f64) as usize).min(HEIGHT - 1);
        self.texels[x + WIDTH * y]
    }
}

/// Radiance of chalk with this normal.
fn lit(sources: &[(DVec3, [f64; 3])], normal: DVec3) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for (direction, power) in sources {
        let cosine = normal.dot(*direction).max(0.0) / PI;
        for (sum, c) in sum.iter_mut().zip(power) {
            *sum += c * cosine;
        }
    }
    sum
}

/// Rolls off towards 1, so that lamps keep a colour.
fn soft(c: f64) -> f64 {
    let c = c.max(0.0);
    if c < 0.6 { c } else { 1.0 - 0.16 / (c - 0.2) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Dim all around with a lamp that gives most of the light.
    fn room(lamp: DVec3) -> EnvironmentMap {
        let (width, height) = (256, 128);
        let texels = (0..width * height).map(|i| {
            let uv = [(i % width) as f64 + 0.5, (i / width) as f64 + 0.5];
            let at =
                EnvironmentMap::direction_from_uv([uv[0] / width as f64, uv[1] / height as f64]);
            [if at.dot(lamp) > 0.99 { 500.0 } else { 0.1 }; 3]
        });
        EnvironmentMap::new(width, height, texels.collect())
    }

    #[test]
    fn a_room_is_exposed_by_what_it_gives_in_its_brightest_direction() {
        let uniform = Overview::new(&EnvironmentMap::constant([4.0; 3]));
        let expected = (0.9f64 / 4.0).log2();
        assert!((uniform.exposure_ev() - expected).abs() < 0.01);
        // 500 · 2π · 0.01 / π and 0.1.
        let lamp = Overview::new(&room(DVec3::X));
        let expected = (0.9f64 / 10.1).log2();
        assert!(
            // The lamp is a dozen texels across: so much hangs on its edge.
            (lamp.exposure_ev() - expected).abs() < 0.15,
            "{}",
            lamp.exposure_ev()
        );
        let black = Overview::new(&EnvironmentMap::constant([0.0; 3]));
        assert_eq!(black.exposure_ev(), 0.0);
    }

    #[test]
    fn the_ball_is_bright_where_the_light_is_and_turns_with_it() {
        let overview = Overview::new(&room(DVec3::new(1.0, 0.0, 0.3).normalize()));
        let size = 32;
        let at = |ball: &[[u8; 4]], x: usize, y: usize| ball[x + size * y];
        let lit = overview.ball(0.0, size);
        assert!(at(&lit, 29, 16)[0] > 150, "{:?}", at(&lit, 29, 16));
        assert_eq!(at(&lit, 0, 0)[3], 0);
        let turned = overview.ball(PI, size);
        assert!(at(&turned, 29, 16)[0] < at(&lit, 29, 16)[0] / 2);
    }
}
