//! Small bright lights that the exposures did see: they leave the map as discs, too.

use glam::DVec3;

use super::extend::REST;
use super::regions::Regions;
use super::{DISC_SOLID_ANGLE, Estimator, Light, LightClass};
use crate::luminance;
use crate::measure::{any_reaches, luminous_flux};

/// A texel this many times the mean radiance may be part of a small light.
const BRIGHT: f64 = 16.0;
/// Lights with less of all flux than this stay in the map.
const SMALLEST_SHARE: f64 = 0.005;
/// At most this many are taken out.
const MOST: usize = 16;
/// One that was taken out of the last estimate counts as so much stronger, so that noise doesn't
/// decide anew in every frame; it is the same within the angle of this cosine.
const STAYS: f64 = 1.5;
const SAME_COS: f64 = 0.9998;
/// How sure what was seen is, EV.
const SEEN_SIGMA: f64 = 0.05;

impl Estimator {
    /// Takes small bright lights out of the map. Energy is kept: a disc has what the map loses.
    pub(super) fn resolve(&mut self) {
        let flux = luminous_flux(&self.grid, &self.radiance);
        let level = (BRIGHT * flux / (4.0 * std::f64::consts::PI)) as f32;
        if level.is_nan() || level <= 0.0 || !any_reaches(&self.radiance, 2.0 * level) {
            return;
        }
        // Texels at twice the level mark a light, those above the level are all of it.
        self.marks.clear();
        let mark = |texel: &[f32; 3]| {
            if texel.iter().any(|&c| c >= 2.0 * level) {
                7
            } else {
                0
            }
        };
        self.marks.extend(self.radiance.iter().map(mark));
        let mut found = std::mem::take(&mut self.bright);
        found.find(&self.grid, &self.radiance, &self.marks, 2.0 * level);
        self.order.clear();
        let small = |(i, region): (usize, &super::Region)| {
            let lit = region.core > 0.0 && f64::from(region.halo) < DISC_SOLID_ANGLE;
            lit.then_some(i as u32)
        };
        self.order
            .extend(found.regions.iter().enumerate().filter_map(small));
        self.take_out(&found, level, SMALLEST_SHARE * flux);
        self.bright = found;
        self.lights
            .sort_unstable_by(|a, b| luminance(b.irradiance).total_cmp(&luminance(a.irradiance)));
    }

    fn take_out(&mut self, found: &Regions, level: f32, least: f64) {
        let width = self.grid.width();
        // What each region has above the level, and where it is.
        self.above.clear();
        self.above
            .resize(found.regions.len(), ([0.0; 3], DVec3::ZERO));
        for run in &found.runs {
            let y = run.y as usize;
            let solid_angle = f64::from(self.grid.solid_angle(y));
            let (irradiance, moment) = &mut self.above[run.region as usize];
            for x in run.start as usize..run.end as usize {
                let extra = self.radiance[x + width * y].map(|c| f64::from((c - level).max(0.0)));
                for c in 0..3 {
                    irradiance[c] += extra[c] * solid_angle;
                }
                let direction = DVec3::from_array(self.grid.direction(x, y).map(f64::from));
                *moment += direction * (luminance(extra) * solid_angle);
            }
        }
        let (above, resolved) = (&self.above, &self.resolved);
        let strength = |i: &u32| {
            let (irradiance, moment) = above[*i as usize];
            let direction = moment.normalize_or_zero();
            let was = resolved.iter().any(|other| other.dot(direction) > SAME_COS);
            luminance(irradiance) * if was { STAYS } else { 1.0 }
        };
        self.order.retain(|i| strength(i) >= least);
        self.order
            .sort_unstable_by(|a, b| strength(b).total_cmp(&strength(a)));
        self.order.truncate(MOST);
        self.resolved.clear();
        for &i in &self.order {
            let (irradiance, moment) = self.above[i as usize];
            let direction = moment.normalize_or(DVec3::Y);
            self.resolved.push(direction);
            self.lights.push(Light {
                class: if direction.y < -0.1 {
                    LightClass::Reflection
                } else {
                    LightClass::Lamp
                },
                direction,
                solid_angle: f64::from(found.regions[i as usize].halo),
                irradiance,
                sigma_ev: SEEN_SIGMA,
                disc: true,
                region: REST,
            });
        }
        for run in &found.runs {
            if self.order.contains(&run.region) {
                let row = run.y as usize * width;
                for texel in &mut self.radiance[row + run.start as usize..row + run.end as usize] {
                    *texel = texel.map(|c| c.min(level));
                }
            }
        }
    }
}
