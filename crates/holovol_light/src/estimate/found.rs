//! The lights of a map whose radiance is known.

use glam::DVec3;

use super::extend::{LOWEST_SUN, SUN_CORE, SUN_FROM};
use super::regions::Regions;
use super::{DISC_SOLID_ANGLE, LightClass, Sky};
use crate::measure::luminous_flux;
use crate::{EnvironmentMap, Grid, luminance};

/// Times the mean radiance from which on a texel belongs to a light, and from which on it makes
/// one.
const BRIGHT: [f64; 2] = [3.0, 6.0];
/// Share of all light that a light gives at least.
const SMALLEST_SHARE: f64 = 0.01;
/// At most this many are told.
const MOST: usize = 16;

/// A light of a map, for lists and marks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FoundLight {
    /// What it seems to be.
    pub class: LightClass,
    /// Unit direction of its centre, in the map's frame.
    pub direction: DVec3,
    /// sr.
    pub solid_angle: f64,
    /// Irradiance facing it, RGB, in the map's unit × sr.
    pub irradiance: [f64; 3],
    /// Of all light of the map, 0 … 1, by luminous flux.
    pub share: f64,
}

/// Finds the lights of a map of full dynamic range, such as a file's or an estimate's with its
/// disc lights drawn in: places six times as bright as the mean that give 1 % of all light or
/// more, the strongest first, at most 16.
pub fn find_lights(map: &EnvironmentMap) -> Vec<FoundLight> {
    let grid = Grid::new(map.width(), map.height());
    let texels = map.texels();
    let all = luminous_flux(&grid, texels);
    let mean = all / (4.0 * std::f64::consts::PI);
    if mean.is_nan() || mean <= 0.0 || map.as_constant().is_some() {
        return Vec::new();
    }
    let [level, core] = BRIGHT.map(|times| times * mean);
    let brightest = |t: &[f32; 3]| f64::from(t[0].max(t[1]).max(t[2]));
    let mark = |t: &[f32; 3]| if brightest(t) >= core { 7 } else { 0 };
    let marks: Vec<u8> = texels.iter().map(mark).collect();
    let mut found = Regions::default();
    found.find(&grid, texels, &marks, 2.0 * level as f32);
    let mut sums = vec![([0.0; 3], DVec3::ZERO); found.regions.len()];
    for run in &found.runs {
        let y = run.y as usize;
        let solid_angle = f64::from(grid.solid_angle(y));
        let (irradiance, moment) = &mut sums[run.region as usize];
        for x in run.start as usize..run.end as usize {
            let texel = texels[x + grid.width() * y].map(f64::from);
            for c in 0..3 {
                irradiance[c] += texel[c] * solid_angle;
            }
            let direction = DVec3::from_array(grid.direction(x, y).map(f64::from));
            *moment += direction * (luminance(texel) * solid_angle);
        }
    }
    let sky = Sky::look(&grid, texels, level as f32);
    let light = |(region, (irradiance, moment)): (&super::Region, ([f64; 3], DVec3))| {
        let (halo, core) = (f64::from(region.halo), f64::from(region.core));
        let share = luminance(irradiance) / all;
        let direction = moment.normalize_or(DVec3::Y);
        let is_sun = sky.clearness > SUN_FROM && core < SUN_CORE[1] && direction.y > LOWEST_SUN;
        let class = if is_sun {
            LightClass::Sun
        } else if direction.y < -0.1 {
            LightClass::Reflection
        } else if halo < DISC_SOLID_ANGLE {
            LightClass::Lamp
        } else {
            LightClass::Window
        };
        (core > 0.0 && share >= SMALLEST_SHARE).then_some(FoundLight {
            class,
            direction,
            solid_angle: halo,
            irradiance,
            share,
        })
    };
    let mut lights: Vec<FoundLight> = found.regions.iter().zip(sums).filter_map(light).collect();
    lights.sort_by(|a, b| b.share.total_cmp(&a.share));
    lights.truncate(MOST);
    // There is one sun: the strongest.
    let mut suns = lights.iter_mut().filter(|l| l.class == LightClass::Sun);
    suns.next();
    for other in suns {
        other.class = LightClass::Lamp;
    }
    lights
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(radiance: impl Fn(DVec3) -> [f32; 3]) -> EnvironmentMap {
        let grid = Grid::new(256, 128);
        let at = |i: usize| DVec3::from_array(grid.direction(i % 256, i / 256).map(f64::from));
        EnvironmentMap::new(256, 128, (0..grid.len()).map(|i| radiance(at(i))).collect())
    }

    #[test]
    fn lamps_and_suns_are_found_with_their_share_also_across_the_seam() {
        for towards in [DVec3::new(0.3, 0.5, -0.7), DVec3::new(0.01, 0.2, 1.0)] {
            let towards = towards.normalize();
            let room = map(|d| [if d.dot(towards) > 0.999 { 500.0 } else { 0.1 }; 3]);
            let lights = find_lights(&room);
            assert_eq!(lights.len(), 1, "{lights:?}");
            assert!(lights[0].direction.dot(towards) > 0.9999);
            assert_eq!(lights[0].class, LightClass::Lamp);
            // 500 · 2π · 0.001 beside 0.1 · 4π.
            assert!((lights[0].share - 0.714).abs() < 0.03, "{lights:?}");
            let day = map(|d| match (d.dot(towards) > 0.9995, d.y > 0.0) {
                (true, _) => [4000.0; 3],
                (_, true) => [0.1, 0.2, 0.4],
                _ => [0.1; 3],
            });
            assert_eq!(find_lights(&day)[0].class, LightClass::Sun);
        }
    }

    #[test]
    fn even_and_black_maps_have_none() {
        assert!(find_lights(&EnvironmentMap::constant([1.0; 3])).is_empty());
        assert!(find_lights(&map(|_| [0.0; 3])).is_empty());
        assert!(find_lights(&map(|d| [1.0 + d.y as f32; 3])).is_empty());
    }
}
