//! Light from frame to frame: no flicker, and a switch goes through at once.

use glam::DVec3;

use crate::estimate::Light;
use crate::measure::sum_of;
use crate::{Grid, luminance};

/// Time constant of the map, s.
const MAP_SECONDS: f64 = 0.15;
/// Spread by which a light's strength may drift, EV per √s.
const DRIFT: f64 = 0.1;
/// An innovation beyond this is a switch, EV.
const SWITCH: f64 = 1.0;
/// Frame-to-frame spread of a light's measured strength, EV: much less than its bias, which
/// [`Light::sigma_ev`] tells and no averaging removes.
const FLICKER: f64 = 0.25;
/// Lights nearer than this are the same from frame to frame, radians.
const SAME: f64 = 0.09;
/// Within this angle a light's place is noise, radians; from twice it on it is followed at once.
const STEADY: f64 = 0.026;
/// Frames that it is a mean of, at most.
const MEAN_OF: u32 = 20;
/// Time without being seen after which a light is forgotten, s.
const FORGET: f64 = 0.1;
/// Blocks across and down that are looked at for switches in the map.
const BLOCKS: [usize; 2] = [32, 16];
/// A block's mean that changes by more than this, EV, is taken over at once.
const BLOCK_SWITCH: f64 = 0.5;

/// A light over time.
#[derive(Clone, Copy, Debug)]
struct Track {
    light: Light,
    /// log₂ of its luminous irradiance.
    level: f64,
    variance: f64,
    /// Frames that its place is a mean of.
    seen: u32,
    /// For how long, s.
    unseen: f64,
}

/// A part of the map.
#[derive(Clone, Copy, Debug, Default)]
struct Block {
    /// Sums over the new map and over the filtered one.
    new: f64,
    kept: f64,
    /// By which the new one is taken over.
    rate: f64,
    /// A light has come out of it, or gone into it.
    is_exchanged: bool,
}

/// Filters maps and lights over time; allocates only while lights appear.
#[derive(Clone, Debug)]
pub struct TemporalFilter {
    grid: Grid,
    map: Vec<[f32; 3]>,
    blocks: Vec<Block>,
    tracks: Vec<Track>,
    matched: Vec<bool>,
    lights: Vec<Light>,
    started: bool,
}

impl TemporalFilter {
    /// A filter for maps of this size.
    pub fn new(width: usize, height: usize) -> Self {
        let grid = Grid::new(width, height);
        Self {
            map: vec![[0.0; 3]; grid.len()],
            blocks: vec![Block::default(); BLOCKS[0] * BLOCKS[1]],
            tracks: Vec::with_capacity(16),
            matched: Vec::with_capacity(16),
            lights: Vec::with_capacity(16),
            started: false,
            grid,
        }
    }

    /// Takes an estimate, `seconds` after the last, whose exposure was `exposure_ev` (EV above a
    /// reference that stays; its radiance is divided by it, so that a camera which changes its
    /// exposure does not change the light).
    ///
    /// # Panics
    /// If the map has not the filter's size.
    pub fn update(
        &mut self,
        radiance: &[[f32; 3]],
        lights: &[Light],
        seconds: f64,
        exposure_ev: f64,
    ) {
        assert_eq!(radiance.len(), self.grid.len(), "the filter's size");
        let scale = (-exposure_ev).exp2();
        self.add_blocks(radiance, scale as f32);
        self.track(lights, scale, seconds);
        self.blend_map(radiance, scale as f32, seconds);
        self.drop_dark(scale);
        self.lights.clear();
        self.lights
            .extend(self.tracks.iter().map(|track| track.light));
        self.started = true;
    }

    /// The filtered map, without disc lights.
    pub fn radiance(&self) -> &[[f32; 3]] {
        &self.map
    }

    /// The filtered disc lights.
    pub fn lights(&self) -> &[Light] {
        &self.lights
    }

    /// Sums of the new map over blocks.
    fn add_blocks(&mut self, radiance: &[[f32; 3]], scale: f32) {
        let (width, height) = (self.grid.width(), self.grid.height());
        for block in &mut self.blocks {
            (block.new, block.is_exchanged) = (0.0, false);
        }
        for (y, row) in radiance.chunks_exact(width).take(height).enumerate() {
            for b in 0..BLOCKS[0] {
                let sum = sum_of(&row[edge(b, width)..edge(b + 1, width)]);
                let sum = f64::from(scale * (sum[0] + sum[1] + sum[2]));
                self.blocks[block_row(y, height) + b].new += sum;
            }
        }
    }

    fn blend_map(&mut self, radiance: &[[f32; 3]], scale: f32, seconds: f64) {
        let (width, height) = (self.grid.width(), self.grid.height());
        let rate = 1.0 - (-seconds.max(0.0) / MAP_SECONDS).exp();
        for block in &mut self.blocks {
            let ratio = (block.new.max(1e-9) / block.kept.max(1e-9)).log2().abs();
            let is_switched = !self.started || block.is_exchanged || ratio > BLOCK_SWITCH;
            block.rate = if is_switched { 1.0 } else { rate };
            // The map's sums follow as the map does.
            block.kept += block.rate * (block.new - block.kept);
        }
        for y in 0..height {
            let row = y * width..(y + 1) * width;
            let (new, old) = (&radiance[row.clone()], &mut self.map[row]);
            for b in 0..BLOCKS[0] {
                let columns = edge(b, width)..edge(b + 1, width);
                let rate = self.blocks[block_row(y, height) + b].rate as f32;
                let old = old[columns.clone()].as_flattened_mut();
                for (old, new) in old.iter_mut().zip(new[columns].as_flattened()) {
                    *old += rate * (scale * new - *old);
                }
            }
        }
    }

    /// The block at a place, and those that a small light there may reach into.
    fn blocks_around(&self, direction: DVec3) -> impl Iterator<Item = usize> + use<> {
        let [u, v] = crate::EnvironmentMap::uv_from_direction(direction);
        let at = |t: f64, n: usize| ((t * n as f64) as usize).min(n - 1);
        let [x, y] = [at(u, BLOCKS[0]), at(v, BLOCKS[1])];
        (0..9).map(move |k| {
            let x = (x + k % 3 + BLOCKS[0] - 1) % BLOCKS[0];
            let y = (y + k / 3).saturating_sub(1).min(BLOCKS[1] - 1);
            x + BLOCKS[0] * y
        })
    }

    /// Luminous flux, about, that the new map has and the filtered one lacks around a place.
    fn gain_around(&self, direction: DVec3) -> f64 {
        let [_, v] = crate::EnvironmentMap::uv_from_direction(direction);
        let row = ((v * self.grid.height() as f64) as usize).min(self.grid.height() - 1);
        let more: f64 = self
            .blocks_around(direction)
            .map(|block| self.blocks[block].new - self.blocks[block].kept)
            .sum();
        more / 3.0 * f64::from(self.grid.solid_angle(row))
    }

    fn exchange(&mut self, direction: DVec3) {
        for block in self.blocks_around(direction) {
            self.blocks[block].is_exchanged = true;
        }
    }

    fn track(&mut self, lights: &[Light], scale: f64, seconds: f64) {
        self.matched.clear();
        self.matched.resize(self.tracks.len(), false);
        for light in lights.iter().filter(|light| light.disc) {
            let mut light = *light;
            light.irradiance = light.irradiance.map(|e| e * scale);
            let level = luminance(light.irradiance).max(1e-12).log2();
            // Of parts of one light that lie close together each goes on by its strength.
            let off = |track: &Track| {
                let angle = track.light.direction.angle_between(light.direction);
                (angle < SAME).then_some(angle / SAME + (track.level - level).abs() / SWITCH)
            };
            let nearest = self
                .tracks
                .iter()
                .enumerate()
                .filter(|(i, _)| !self.matched.get(*i).copied().unwrap_or(true))
                .filter_map(|(i, track)| Some((i, off(track)?)))
                .min_by(|a, b| a.1.total_cmp(&b.1));
            let Some((i, _)) = nearest else {
                // If it was in the map until now, it leaves that at once.
                if self.started && self.gain_around(light.direction) < -0.5 * level.exp2() {
                    self.exchange(light.direction);
                }
                self.tracks.push(Track {
                    light,
                    level,
                    variance: FLICKER * FLICKER,
                    seen: 1,
                    unseen: 0.0,
                });
                continue;
            };
            self.matched[i] = true;
            let track = &mut self.tracks[i];
            track.unseen = 0.0;
            let noise = FLICKER * FLICKER;
            if (level - track.level).abs() > SWITCH {
                (track.level, track.variance) = (level, noise);
            } else {
                track.variance += DRIFT * DRIFT * seconds.max(0.0);
                let gain = track.variance / (track.variance + noise);
                track.level += gain * (level - track.level);
                track.variance *= 1.0 - gain;
            }
            // Where a light is found jitters, but one that is carried is followed.
            let moved = track.light.direction.angle_between(light.direction) / STEADY;
            let jitter = (moved - 1.0).clamp(0.0, 1.0);
            track.seen = (track.seen + 1).min(MEAN_OF);
            let gain = (1.0 / f64::from(track.seen)).max(jitter);
            let towards = track.light.direction.lerp(light.direction, gain);
            light.direction = towards.try_normalize().unwrap_or(light.direction);
            let to = track.level.exp2() / luminance(light.irradiance).max(1e-12);
            light.irradiance = light.irradiance.map(|e| e * to);
            track.light = light;
        }
        for i in 0..self.matched.len() {
            let Track { light, level, .. } = self.tracks[i];
            if self.matched[i] {
                continue;
            }
            self.tracks[i].unseen += seconds.max(1e-3);
            // Found in the map, not gone: it joins that at once, and is no disc any more.
            if self.gain_around(light.direction) > 0.5 * level.exp2() {
                self.exchange(light.direction);
                self.tracks[i].unseen = f64::INFINITY;
            }
        }
    }

    /// Forgets lights that are out. One that went out is gone from the map too: keeping it would be
    /// a ghost. One that was missed for a frame or two is kept at what it was.
    fn drop_dark(&mut self, scale: f64) {
        let (map, grid) = (&self.map, &self.grid);
        let is_dark = |direction: DVec3| {
            let [u, v] = crate::EnvironmentMap::uv_from_direction(direction);
            let x = ((u * grid.width() as f64) as usize).min(grid.width() - 1);
            let y = ((v * grid.height() as f64) as usize).min(grid.height() - 1);
            map[x + grid.width() * y]
                .iter()
                .all(|&c| c < 0.5 * scale as f32)
        };
        self.tracks.retain(|track| {
            track.unseen < FORGET && !(track.unseen > 0.0 && is_dark(track.light.direction))
        });
    }
}

/// Texels of a row from which a block's columns begin.
fn edge(block: usize, width: usize) -> usize {
    block * width / BLOCKS[0]
}

/// The first block of a row of texels.
fn block_row(y: usize, height: usize) -> usize {
    (y * BLOCKS[1] / height) * BLOCKS[0]
}

/// Change of exposure between two pictures of an untagged camera, EV: the median log ratio of
/// texels that clip in neither. `None` if too few do not.
///
/// Looks at about 4000 texels. A change of the light of more than half the view is taken for one
/// of exposure: lock the exposure, or tag it, where you can.
pub fn exposure_change(before: &[[f32; 3]], after: &[[f32; 3]]) -> Option<f64> {
    const LOOKED_AT: usize = 4096;
    const FEWEST: u32 = 64;
    /// A histogram, so that nothing is allocated: its bins, and their number in an EV.
    const BINS: usize = 1024;
    const PER_EV: f32 = 64.0;
    let step = (before.len() / LOOKED_AT).max(1);
    let open = |texel: &[f32; 3]| texel.iter().all(|&c| c > 0.004 && c < 0.9);
    let mut counts = [0_u32; BINS];
    let mut all = 0;
    for (a, b) in before.iter().zip(after).step_by(step) {
        if open(a) && open(b) {
            let place = (b[1] / a[1]).log2() * PER_EV + 0.5 * BINS as f32;
            counts[(place.max(0.0) as usize).min(BINS - 1)] += 1;
            all += 1;
        }
    }
    if all < FEWEST {
        return None;
    }
    let half = 0.5 * f64::from(all);
    let mut below = 0.0;
    for (bin, &count) in counts.iter().enumerate() {
        let count = f64::from(count);
        if below + count >= half {
            let place = bin as f64 + (half - below) / count.max(1.0);
            return Some((place - 0.5 * BINS as f64) / f64::from(PER_EV));
        }
        below += count;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::{Estimator, Evidence, Exposure, Prior};

    const WIDTH: usize = 128;
    const HEIGHT: usize = 64;

    /// A grey room with a lamp of 3 × 3 texels.
    fn picture(lamp: f32, exposure_ev: f64, wobble: f32) -> Vec<[f32; 3]> {
        let scale = exposure_ev.exp2() as f32;
        (0..WIDTH * HEIGHT)
            .map(|i| {
                let (x, y) = (i % WIDTH, i / WIDTH);
                let on = (60..63).contains(&x) && (20..23).contains(&y);
                let l = if on { lamp } else { 0.2 * (1.0 + wobble) };
                [(l * scale).min(1.0); 3]
            })
            .collect()
    }

    fn run(frames: &[(f32, f64, f32)]) -> (Vec<f64>, Vec<usize>) {
        let mut estimator = Estimator::new(WIDTH, HEIGHT, Prior::default());
        let mut filter = TemporalFilter::new(WIDTH, HEIGHT);
        let (mut flux, mut count) = (Vec::new(), Vec::new());
        for &(lamp, ev, wobble) in frames {
            let picture = picture(lamp, ev, wobble);
            let frames = [Exposure {
                ev: 0.0,
                radiance: &picture,
            }];
            estimator.estimate(&Evidence {
                frames: &frames,
                ..Default::default()
            });
            filter.update(estimator.radiance(), estimator.lights(), 1.0 / 30.0, ev);
            let map = crate::measure::luminous_flux(estimator.grid(), filter.radiance());
            let discs = filter
                .lights()
                .iter()
                .map(|light| luminance(light.irradiance));
            flux.push(map + discs.sum::<f64>());
            count.push(filter.lights().len());
        }
        (flux, count)
    }

    #[test]
    fn a_switch_goes_through_in_one_frame_both_ways() {
        let (flux, count) = run(&[
            (0.2, 0.0, 0.0),
            (0.2, 0.0, 0.0),
            (50.0, 0.0, 0.0),
            (50.0, 0.0, 0.0),
            (0.2, 0.0, 0.0),
        ]);
        assert_eq!(count, [0, 0, 1, 1, 0]);
        assert!(flux[2] > 1.01 * flux[1]);
        assert!((flux[2] / flux[3] - 1.0).abs() < 0.05, "{flux:?}");
    }

    #[test]
    fn a_lamp_that_brightens_much_does_so_at_once_and_little_slowly() {
        let mut estimator = Estimator::new(WIDTH, HEIGHT, Prior::default());
        let picture = picture(50.0, 0.0, 0.0);
        let frames = [Exposure {
            ev: 0.0,
            radiance: &picture,
        }];
        estimator.estimate(&Evidence {
            frames: &frames,
            ..Default::default()
        });
        let after = |factor: f64| {
            let mut filter = TemporalFilter::new(WIDTH, HEIGHT);
            let lights = estimator.lights().to_vec();
            for _ in 0..30 {
                filter.update(estimator.radiance(), &lights, 1.0 / 30.0, 0.0);
            }
            let mut brighter = lights.clone();
            for light in &mut brighter {
                light.irradiance = light.irradiance.map(|e| e * factor);
            }
            filter.update(estimator.radiance(), &brighter, 1.0 / 30.0, 0.0);
            filter.lights()[0].irradiance[1] / lights[0].irradiance[1]
        };
        assert!((after(8.0) - 8.0).abs() < 1e-6, "{}", after(8.0));
        assert!(after(1.2) < 1.1, "{}", after(1.2));
    }

    #[test]
    fn flicker_is_damped() {
        let wobble = |i: i32| if i % 2 == 0 { 0.05 } else { -0.05 };
        let frames: Vec<_> = (0..40).map(|i| (50.0, 0.0, wobble(i))).collect();
        let (flux, _) = run(&frames);
        let late = &flux[20..];
        let spread = late
            .iter()
            .fold((f64::MAX, f64::MIN), |(a, b), &f| (a.min(f), b.max(f)));
        assert!(spread.1 / spread.0 < 1.03, "{spread:?}");
    }

    #[test]
    fn the_camera_s_exposure_is_not_the_light_s() {
        // The lamp clips throughout; only its tagged exposure changes.
        let (flux, _) = run(&[
            (0.2, 0.0, 0.0),
            (0.2, 0.0, 0.0),
            (0.2, -1.0, 0.0),
            (0.2, 1.0, 0.0),
        ]);
        for pair in flux.windows(2) {
            assert!((pair[1] / pair[0] - 1.0).abs() < 0.02, "{flux:?}");
        }
        let (before, after) = (picture(50.0, 0.0, 0.0), picture(50.0, -0.7, 0.0));
        let found = exposure_change(&before, &after).unwrap();
        assert!((found + 0.7).abs() < 0.01, "{found}");
        let black = vec![[0.0; 3]; WIDTH * HEIGHT];
        assert!(exposure_change(&black, &black).is_none());
    }
}
