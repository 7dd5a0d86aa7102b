//! Clipped regions become lights: classed, extended by the prior, the small ones made discs.

use std::f64::consts::PI;

use glam::DVec3;

use super::constrain::GROUPS;
use super::prior::{NEAR, gain_limit};
use super::sky::smoothstep;
use super::{DISC_SOLID_ANGLE, Estimator, Light, LightClass, Region, SUN_SOLID_ANGLE};
use crate::{Grid, luminance};

/// The last light may stand for all weaker ones together.
pub(super) const REST: u32 = u32::MAX;

/// log₂(halo/clipped) of a glow around a sun: below the first it has none, above the second one.
const GLOW: [f64; 2] = [0.4, 1.0];
/// A core smaller than this may be a sun without its glow being seen, sr.
pub(super) const SUN_CORE: [f64; 2] = [0.004, 0.02];
/// From this ceiling on, a clipped core is the light itself rather than its glow.
const BRACKETED: f32 = 8.0;
/// Sine of the elevation below which nothing is a sun: haze and hills shift centres a little.
pub(super) const LOWEST_SUN: f64 = -0.05;
/// Clearness × glow from which on a light is taken for a sun.
pub(super) const SUN_FROM: f64 = 0.25;
/// The glow does not grow further toward the sun than to here, radians.
const GLOW_CORE: f64 = 1.0 / 180.0 * PI;
/// Largest radius of a glow that is believed, radians.
const GLOW_RADIUS: f64 = 0.6;
/// Of a clear day's other clipped regions, which are lit things and clouds, gains count this much.
const SUNLIT_GAIN: f64 = 0.35;
/// Most by which a clipped channel of a coloured texel is raised by the colour around it.
const LARGEST_TINT: f32 = 4.0;
/// Sine of the elevation at which sunlight is red, and from which on it is white.
const REDDENING: [f64; 2] = [0.09, 0.45];
/// Sunlight, RGB of luminance 1, at these elevations.
const SUNLIGHT: [[f64; 3]; 2] = [[1.45, 0.95, 0.31], [1.07, 0.99, 0.9]];

impl Estimator {
    /// Finds the lights among the regions and fills their cores.
    pub(super) fn extend(&mut self) {
        self.lights.clear();
        self.tint();
        let sun = self.find_sun(self.sky.clearness);
        let darkened = sun.map_or(1.0, |(_, s)| 1.0 - s * (1.0 - SUNLIT_GAIN));
        let limit = gain_limit(self.reach_of_exposures());
        self.mark_sunlit(sun.map(|(i, _)| i));
        self.order.clear();
        self.strengths.clear();
        for (i, core) in self.cores.regions.iter().enumerate() {
            let gain = if core.core > 0.0 {
                self.prior.gain_of(core.edge_gain(&self.grid), limit) * darkened
            } else {
                0.0
            };
            self.strengths.push(gain.exp2() as f32);
            if core.core > 0.0 && !self.sunlit[i] {
                self.order.push(i as u32);
            }
        }
        let (cores, strengths) = (&self.cores.regions, &self.strengths);
        let flux = |i: &u32| cores[*i as usize].core * strengths[*i as usize];
        self.order
            .sort_unstable_by(|a, b| flux(b).total_cmp(&flux(a)));
        self.assign(usize::from(sun.is_some()));
        if let Some((i, s)) = sun {
            let direction = self.halos.regions[i as usize].centre();
            self.glow(i, direction);
            self.add_sun(i, s, direction);
        }
        self.add_regions(sun.is_some());
    }

    /// In a clear sky whose darkest exposure clips nowhere, what nearly does is taken for clipped:
    /// a peak of few pixels is blunted by compression, and a sun that just fails to clip there
    /// would be a rare one.
    pub(super) fn mark_blunted_sun(&mut self) {
        let sunny = self.reach_of_exposures() >= BRACKETED && self.sky.clearness > SUN_FROM;
        if !sunny || self.clipped.contains(&7) {
            return;
        }
        let level = NEAR * self.ceiling;
        let upper = self.grid.len() / 2;
        let texels = self.radiance.iter().zip(&mut self.clipped).take(upper);
        for (texel, bits) in texels {
            if texel[0].min(texel[1]).min(texel[2]) >= level {
                *bits = 7;
            }
        }
    }

    /// Says for each core whether it lies in the sun's halo: such cores are the sun and its glow.
    fn mark_sunlit(&mut self, sun: Option<u32>) {
        self.sunlit.clear();
        self.sunlit.resize(self.cores.regions.len(), false);
        if sun.is_some() {
            let halos = self.halos.containing(&self.cores.runs);
            for (run, halo) in self.cores.runs.iter().zip(halos) {
                self.sunlit[run.region as usize] |= halo == sun;
            }
        }
    }

    /// Says for each core which light it is part of; the sun comes first and has none.
    fn assign(&mut self, first: usize) {
        self.assignment.clear();
        self.assignment.resize(self.cores.regions.len(), u8::MAX);
        for (rank, &i) in self.order.iter().enumerate() {
            self.assignment[i as usize] = (first + rank).min(GROUPS - 1) as u8;
        }
    }

    /// Clipped channels of texels that still have an unclipped one: the colour of the rim says
    /// how bright they are.
    fn tint(&mut self) {
        let width = self.grid.width();
        for run in &self.halos.runs {
            let region = &self.halos.regions[run.region as usize];
            if region.clipped == 0.0 || region.rim.iter().any(|&c| c <= 0.0) {
                continue;
            }
            let rim = region.rim;
            let row = run.y as usize * width;
            for i in row + run.start as usize..row + run.end as usize {
                let bits = self.clipped[i];
                if bits == 0 || bits == 7 {
                    continue;
                }
                let texel = &mut self.radiance[i];
                let (mut scale, mut open) = (0.0, 0.0);
                for c in 0..3 {
                    if bits & (1 << c) == 0 {
                        scale += texel[c] / rim[c];
                        open += 1.0;
                    }
                }
                for c in 0..3 {
                    if bits & (1 << c) != 0 {
                        let expected = scale / open * rim[c];
                        let most = LARGEST_TINT * self.ceiling;
                        texel[c] = expected.clamp(self.ceiling, most);
                    }
                }
            }
        }
    }

    /// Luminous irradiance facing it of the sun that there would be under a clear sky; 0 if there
    /// is no place for one. To be asked before lights are extended.
    pub(super) fn possible_sun(&self) -> f64 {
        let sun = self.find_sun(1.0).map(|(_, sureness)| {
            sureness * self.prior.sun_over_sky.exp2() * luminance(self.map_irradiance(DVec3::Y))
        });
        sun.unwrap_or(0.0)
    }

    /// The region that holds the sun, and how surely it is one, 0 … 1, under a sky of this
    /// clearness.
    fn find_sun(&self, clearness: f64) -> Option<(u32, f64)> {
        let candidates = self.halos.regions.iter().enumerate();
        let (i, region) = candidates
            .filter(|(_, region)| region.core > 0.0 && region.centre().y > LOWEST_SUN)
            .max_by(|a, b| a.1.core.total_cmp(&b.1.core))?;
        let growth = f64::from(region.halo / region.clipped).log2();
        let glow = smoothstep(GLOW, growth);
        let bracketed = self.reach_of_exposures() >= BRACKETED;
        let small = if bracketed {
            1.0 - smoothstep(SUN_CORE, f64::from(region.core))
        } else {
            0.0
        };
        let sureness = clearness * glow.max(small);
        (sureness > SUN_FROM).then_some((i as u32, sureness))
    }

    /// Fills a sun's region with its glow, which falls as 1/angle from one degree on: so it does
    /// on each of the fitted panoramas, out to 20° and more.
    fn glow(&mut self, i: u32, sun: DVec3) {
        let region = self.halos.regions[i as usize];
        let sun = sun.as_vec3();
        let radius = (f64::from(region.core) / PI).sqrt().min(GLOW_RADIUS) as f32;
        let width = self.grid.width();
        for run in self.halos.runs.iter().filter(|run| run.region == i) {
            let y = run.y as usize;
            for x in run.start as usize..run.end as usize {
                let at = x + width * y;
                if self.clipped[at] == 7 {
                    let off = (glam::Vec3::from_array(self.grid.direction(x, y)) - sun).length();
                    let rise = (radius / off.max(GLOW_CORE as f32)).max(1.0);
                    self.radiance[at] = [self.ceiling * rise; 3];
                }
            }
        }
    }

    /// The sun itself: so much brighter than its sky.
    fn add_sun(&mut self, i: u32, sureness: f64, direction: DVec3) {
        let region = self.halos.regions[i as usize];
        let sky = luminance(self.map_irradiance(DVec3::Y));
        let air = self.sky.transmittance(direction.y);
        let flux = self.prior.sun_over_sky.exp2() * air * sureness * sky;
        let white = smoothstep(REDDENING, direction.y);
        let mut tint: [f64; 3] =
            std::array::from_fn(|c| SUNLIGHT[0][c] + white * (SUNLIGHT[1][c] - SUNLIGHT[0][c]));
        // Seen through a dark exposure, the rim is the sun's own glow and has its colour.
        if self.reach_of_exposures() >= BRACKETED && region.rim.iter().all(|&c| c > 0.0) {
            tint = region.rim.map(f64::from);
        }
        let scale = flux / luminance(tint);
        self.lights.push(Light {
            class: LightClass::Sun,
            direction,
            solid_angle: SUN_SOLID_ANGLE,
            irradiance: tint.map(|c| c * scale),
            sigma_ev: self.prior.sun_sigma(direction.y, sureness),
            disc: true,
            region: i,
        });
    }

    /// The other cores, the strongest on their own, the rest as one.
    fn add_regions(&mut self, sunny: bool) {
        let own = (GROUPS - usize::from(sunny)).min(self.order.len());
        let rest = self.order.len() > own;
        for k in 0..own {
            let index = self.order[k];
            let region = self.cores.regions[index as usize];
            let strength = f64::from(self.strengths[index as usize]);
            let last = rest && k + 1 == own;
            let solid_angle = f64::from(region.core);
            let small = solid_angle < DISC_SOLID_ANGLE && !last;
            let level = f64::from(self.ceiling) * strength;
            let direction = region.centre();
            self.lights.push(Light {
                class: classify(&region, direction),
                direction,
                solid_angle,
                // A disc leaves the clipping level in the map.
                irradiance: [if small {
                    solid_angle * (level - f64::from(self.ceiling))
                } else {
                    solid_angle * level
                }; 3],
                sigma_ev: self.prior.gain_sigma_of(region.edge_gain(&self.grid)),
                disc: small,
                region: if last { REST } else { index },
            });
        }
        let first = usize::from(sunny);
        let width = self.grid.width();
        let mut rest_flux = 0.0;
        for run in &self.cores.runs {
            let light = self.assignment[run.region as usize] as usize;
            if light == usize::from(u8::MAX) || self.lights[light].disc {
                continue;
            }
            let value = self.ceiling * self.strengths[run.region as usize];
            let row = run.y as usize * width;
            let mut filled = 0.0;
            for i in row + run.start as usize..row + run.end as usize {
                if self.clipped[i] == 7 {
                    self.radiance[i] = [value; 3];
                    filled += value;
                }
            }
            if self.lights[light].region == REST {
                rest_flux += f64::from(filled * self.grid.solid_angle(run.y as usize));
            }
        }
        if rest {
            let last = &mut self.lights[first + own - 1];
            last.irradiance = [rest_flux; 3];
        }
        self.lights
            .retain(|light| light.irradiance.iter().any(|&e| e > 0.0) || !light.disc);
    }

    /// Scales each light, RGB; no texel falls below the level at which it clipped.
    pub(super) fn scale_lights(&mut self, factors: &[[f64; 3]; GROUPS]) {
        let floor = self.ceiling;
        for (light, factor) in self.lights.iter_mut().zip(factors) {
            for c in 0..3 {
                light.irradiance[c] *= factor[c];
            }
        }
        let width = self.grid.width();
        for run in &self.cores.runs {
            let light = self.assignment[run.region as usize] as usize;
            if light >= self.lights.len() || self.lights[light].disc {
                continue;
            }
            let row = run.y as usize * width;
            for i in row + run.start as usize..row + run.end as usize {
                if self.clipped[i] == 7 {
                    for c in 0..3 {
                        let scaled = self.radiance[i][c] * factors[light][c] as f32;
                        self.radiance[i][c] = scaled.max(floor);
                    }
                }
            }
        }
    }

    /// Irradiance of a surface: from all but the lights, and from each light.
    pub(super) fn reach(&self, normal: DVec3) -> ([f64; 3], [[f64; 3]; GROUPS]) {
        let mut reach = [[0.0; 3]; GROUPS];
        let mut base = self.map_irradiance(normal);
        let width = self.grid.width();
        let n = normal.as_vec3();
        for run in &self.cores.runs {
            let light = self.assignment[run.region as usize] as usize;
            if light >= self.lights.len() || self.lights[light].disc {
                continue;
            }
            let y = run.y as usize;
            let mut sum = [0.0_f32; 3];
            for x in run.start as usize..run.end as usize {
                let at = x + width * y;
                if self.clipped[at] == 7 {
                    let cosine = glam::Vec3::from_array(self.grid.direction(x, y)).dot(n);
                    for c in 0..3 {
                        sum[c] += cosine.max(0.0) * self.radiance[at][c];
                    }
                }
            }
            for c in 0..3 {
                let part = f64::from(sum[c] * self.grid.solid_angle(y));
                reach[light][c] += part;
                base[c] -= part;
            }
        }
        for (reach, light) in reach.iter_mut().zip(&self.lights) {
            if light.disc {
                *reach = light
                    .irradiance
                    .map(|e| e * light.direction.dot(normal).max(0.0));
            }
        }
        (base.map(|e| e.max(0.0)), reach)
    }

    /// Irradiance of a surface from the map, discs left out.
    fn map_irradiance(&self, normal: DVec3) -> [f64; 3] {
        let n = normal.as_vec3();
        let width = self.grid.width();
        let mut total = [0.0; 3];
        for (y, row) in self.radiance.chunks_exact(width).enumerate() {
            let [sin, cos] = self.grid.row(y);
            // A row that can't be seen at all ends here.
            if cos * n.y + sin * (1.0 - n.y * n.y).max(0.0).sqrt() <= 0.0 {
                continue;
            }
            let mut sum = [0.0_f32; 3];
            for (x, texel) in row.iter().enumerate() {
                let [dx, dz] = self.grid.column(x);
                let cosine = (sin * (dx * n.x + dz * n.z) + cos * n.y).max(0.0);
                for c in 0..3 {
                    sum[c] += cosine * texel[c];
                }
            }
            for c in 0..3 {
                total[c] += f64::from(sum[c] * self.grid.solid_angle(y));
            }
        }
        total
    }

    /// Writes the whole estimate, discs included, as one map: each disc's energy is spread over
    /// the texels whose centres it covers, or the nearest one.
    pub fn write_map(&self, out: &mut Vec<[f32; 3]>) {
        out.clear();
        out.extend_from_slice(&self.radiance);
        draw_discs(&self.grid, out, &self.lights);
    }
}

/// Adds the disc lights to a map.
pub(crate) fn draw_discs(grid: &Grid, texels: &mut [[f32; 3]], lights: &[Light]) {
    for light in lights.iter().filter(|light| light.disc) {
        let angle = (1.0 - light.solid_angle / (2.0 * PI))
            .clamp(-1.0, 1.0)
            .acos();
        splat(grid, texels, light.direction, angle, light.irradiance);
    }
}

fn splat(grid: &Grid, texels: &mut [[f32; 3]], direction: DVec3, angle: f64, irradiance: [f64; 3]) {
    let width = grid.width() as i64;
    // At least a texel's half diagonal, so that there is always one.
    let angle = angle.max(0.75 * PI / grid.height() as f64);
    let mut covered = 0.0;
    grid.visit_cap(direction, angle, |y, _, count| {
        covered += f64::from(grid.solid_angle(y)) * count as f64;
    });
    if covered <= 0.0 {
        return;
    }
    let add = irradiance.map(|e| (e / covered) as f32);
    grid.visit_cap(direction, angle, |y, start, count| {
        for k in start..start + count as i64 {
            let texel = &mut texels[(k.rem_euclid(width) + width * y as i64) as usize];
            for c in 0..3 {
                texel[c] += add[c];
            }
        }
    });
}

fn classify(region: &Region, direction: DVec3) -> LightClass {
    if direction.y < -0.1 {
        LightClass::Reflection
    } else if f64::from(region.core) < DISC_SOLID_ANGLE {
        LightClass::Lamp
    } else {
        LightClass::Window
    }
}
