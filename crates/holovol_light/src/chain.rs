//! The whole chain from exposures to what a renderer needs, frame by frame.

use std::sync::Arc;

use crate::change::ChangeDetector;
use crate::estimate::{Estimator, Evidence, Exposure, Light, Meter, Prior, Rung, draw_discs};
use crate::measure::{add_to_spherical_harmonics, spherical_harmonics};
use crate::temporal::{TemporalFilter, exposure_change};
use crate::{EnvironmentMap, EnvironmentSampler, Grid};

/// Exposures of alternating frames are merged up to this age, in frames.
const OLDEST: usize = 2;
/// T since the last published light from which on it is published again: noise stays below.
const PUBLISH: f64 = 0.07;
/// A disc light that changed by this share, or moved by this angle (radians), is published again:
/// highlights show that before T does. Guesses flicker by less.
const DISC_CHANGE: f64 = 0.1;
const DISC_MOVE: f64 = 0.25 / 180.0 * std::f64::consts::PI;
/// But only if it gives this share of all light: lesser ones come and go with the noise.
const DISC_SHARE: f64 = 0.05;

/// What a renderer draws with: a map and the table made from this very map, so that densities are
/// right, and the disc lights that are not in it.
#[derive(Clone, Debug)]
pub struct PublishedLight {
    /// Radiance without the disc lights.
    pub map: EnvironmentMap,
    /// Its sampling table; `None` if it is black.
    pub sampler: Option<Arc<EnvironmentSampler>>,
    /// Small lights.
    pub discs: Vec<Light>,
}

impl PublishedLight {
    /// Map and lights as one map, for renderers that know no disc lights: each disc's energy is
    /// spread over the texels whose centres it covers, or the nearest one.
    pub fn whole_map(&self) -> EnvironmentMap {
        let (width, height) = (self.map.width(), self.map.height());
        let mut texels = self.map.texels().to_vec();
        draw_discs(&Grid::new(width, height), &mut texels, &self.discs);
        EnvironmentMap::new(width, height, texels)
    }
}

/// What one frame gave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Update {
    /// Change of illumination since the last frame, 0 … 1 (DESIGN §6).
    pub change: f64,
    /// Change of illumination since the last published light: what a renderer sees when it takes
    /// a new one.
    pub change_since_published: f64,
    /// Whether [`LightChain::published`] is new.
    pub published: bool,
    /// The frame's exposure, EV: as given, or found.
    pub ev: f64,
    /// What the estimate rests on.
    pub rung: Rung,
    /// One standard deviation of all light, EV.
    pub sigma_ev: f64,
    /// Spherical harmonics of all light, to order 2.
    pub sh9: [[f32; 3]; 9],
}

/// One exposure of an alternating bracket, kept until the next of its kind.
#[derive(Clone, Debug)]
struct Kept {
    ev: f64,
    radiance: Vec<[f32; 3]>,
    age: usize,
}

/// Turns a camera's frames into light: merges alternating exposures, estimates, filters over
/// time, and publishes map and sampling table only when something changed.
///
/// In the steady state it allocates nothing; publishing makes a new map and table, since a
/// renderer may still read the last.
#[derive(Clone, Debug)]
pub struct LightChain {
    estimator: Estimator,
    filter: TemporalFilter,
    change: ChangeDetector,
    kept: Vec<Kept>,
    published: Option<PublishedLight>,
    /// An untagged frame and its exposure, EV, that others are compared with.
    reference: Option<(Vec<[f32; 3]>, f64)>,
}

impl LightChain {
    /// A chain for panoramas of this size, both at least 1.
    pub fn new(width: usize, height: usize, prior: Prior) -> Self {
        Self {
            estimator: Estimator::new(width, height, prior),
            filter: TemporalFilter::new(width, height),
            change: ChangeDetector::new(),
            kept: Vec::new(),
            published: None,
            reference: None,
        }
    }

    /// Takes a frame of a camera that does not tell its exposure: what most of the picture does,
    /// compared with an earlier frame, is taken for the exposure. So a change of the light in more
    /// than half of the view is taken for one of exposure: lock or tag it where you can.
    ///
    /// # Panics
    /// If the frame has not the chain's size.
    pub fn update_untagged(
        &mut self,
        frame: &[[f32; 3]],
        seconds: f64,
        meter: Option<Meter>,
    ) -> Update {
        /// Less than this is noise, EV.
        const STEADY: f64 = 0.03;
        /// From here on the two frames have too little in common, EV.
        const FAR: f64 = 1.5;
        let found = self.reference.as_ref().and_then(|(reference, ev)| {
            let change = exposure_change(reference, frame)?;
            Some((change, *ev))
        });
        let ev = match found {
            Some((change, ev)) if change.abs() < STEADY => ev,
            Some((change, ev)) => ev + change,
            None => self.reference.as_ref().map_or(0.0, |(_, ev)| *ev),
        };
        match &mut self.reference {
            None => self.reference = Some((frame.to_vec(), ev)),
            Some((reference, at)) => {
                if found.is_none_or(|(change, _)| change.abs() > FAR) {
                    reference.copy_from_slice(frame);
                    *at = ev;
                }
            }
        }
        self.update(frame, ev, seconds, meter)
    }

    /// Takes a frame: linear, 1 where it clips, `ev` its exposure above a reference that stays,
    /// `seconds` since the last. A meter reads in units of the reference.
    ///
    /// # Panics
    /// If the frame has not the chain's size.
    pub fn update(
        &mut self,
        frame: &[[f32; 3]],
        ev: f64,
        seconds: f64,
        meter: Option<Meter>,
    ) -> Update {
        assert_eq!(frame.len(), self.estimator.grid().len(), "the chain's size");
        for kept in &mut self.kept {
            kept.age += 1;
        }
        /// Exposures nearer than this are the same setting, EV.
        const SAME: f64 = 0.5;
        match self
            .kept
            .iter_mut()
            .find(|kept| (kept.ev - ev).abs() < SAME || kept.age > 2 * OLDEST)
        {
            Some(kept) => {
                kept.radiance.copy_from_slice(frame);
                (kept.ev, kept.age) = (ev, 0);
            }
            None => self.kept.push(Kept {
                ev,
                radiance: frame.to_vec(),
                age: 0,
            }),
        }
        self.kept.sort_by(|a, b| b.ev.total_cmp(&a.ev));
        // Up to four exposures without allocating: more than any camera alternates.
        const EMPTY: Exposure = Exposure {
            ev: 0.0,
            radiance: &[],
        };
        let mut exposures = [EMPTY; 4];
        let mut count = 0;
        for kept in self.kept.iter().filter(|kept| kept.age <= OLDEST).take(4) {
            exposures[count] = Exposure {
                ev: kept.ev,
                radiance: &kept.radiance,
            };
            count += 1;
        }
        self.estimator.estimate(&Evidence {
            frames: &exposures[..count],
            meter,
            probe: None,
        });
        // The estimator's unit is EV 0 already: exposures are absolute.
        self.filter.update(
            self.estimator.radiance(),
            self.estimator.lights(),
            seconds,
            0.0,
        );
        let grid = self.estimator.grid();
        let change = self
            .change
            .update(grid, self.filter.radiance(), self.filter.lights());
        let mut sh9 = spherical_harmonics(grid, self.filter.radiance());
        for light in self.filter.lights() {
            add_to_spherical_harmonics(&mut sh9, light.direction, light.irradiance);
        }
        let change_since_published = self.change.since_kept();
        // Y₀₀ is 1/√(4π).
        let all_light = f64::from(sh9[0][1]) * (4.0 * std::f64::consts::PI).sqrt();
        let publish = change_since_published >= PUBLISH || self.discs_changed(all_light);
        if publish {
            self.publish();
        }
        Update {
            change,
            change_since_published,
            published: publish,
            ev,
            rung: self.estimator.rung(),
            sigma_ev: self.estimator.sigma_ev(),
            sh9,
        }
    }

    /// The light as last published; `None` before the first frame.
    pub fn published(&self) -> Option<&PublishedLight> {
        self.published.as_ref()
    }

    fn discs_changed(&self, all_light: f64) -> bool {
        let Some(published) = &self.published else {
            return true;
        };
        let now = self.filter.lights();
        let least = DISC_SHARE * all_light;
        // Whether a light that counts is none of the others, however little these give.
        let is_new = |light: &Light, others: &[Light]| {
            let is_same = |other: &Light| {
                let change = (light.irradiance[1] - other.irradiance[1]).abs();
                change < least.max(DISC_CHANGE * other.irradiance[1])
                    && light.direction.angle_between(other.direction) < DISC_MOVE
            };
            light.irradiance[1] > least && !others.iter().any(is_same)
        };
        now.iter().any(|light| is_new(light, &published.discs))
            || published.discs.iter().any(|light| is_new(light, now))
    }

    fn publish(&mut self) {
        let grid = self.estimator.grid();
        let map = EnvironmentMap::new(grid.width(), grid.height(), self.filter.radiance().to_vec());
        self.published = Some(PublishedLight {
            sampler: EnvironmentSampler::new(&map).map(Arc::new),
            map,
            discs: self.filter.lights().to_vec(),
        });
        self.change.keep();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::luminance;

    const WIDTH: usize = 128;
    const HEIGHT: usize = 64;

    fn frame(lamp: f32, ev: f64) -> Vec<[f32; 3]> {
        let scale = ev.exp2() as f32;
        (0..WIDTH * HEIGHT)
            .map(|i| {
                let (x, y) = (i % WIDTH, i / WIDTH);
                let on = (60..62).contains(&x) && (20..22).contains(&y);
                [(scale * if on { lamp } else { 0.2 }).min(1.0); 3]
            })
            .collect()
    }

    #[test]
    fn alternating_exposures_see_the_lamp_and_nothing_is_published_twice() {
        let mut chain = LightChain::new(WIDTH, HEIGHT, Prior::default());
        let mut last = None;
        for i in 0..12 {
            let ev = if i % 2 == 0 { 0.0 } else { -6.0 };
            let update = chain.update(&frame(40.0, ev), ev, 1.0 / 30.0, None);
            if i >= 8 {
                assert!(!update.published && update.change < 0.01, "{i}: {update:?}");
                assert_eq!(update.rung, Rung::Bracket);
            }
            last = Some(update);
        }
        let published = chain.published().unwrap();
        assert_eq!(published.discs.len(), 1);
        // 40 over four texels, less what stays in the map.
        let solid_angle = 4.0 * f64::from(chain.estimator.grid().solid_angle(20));
        let found = luminance(published.discs[0].irradiance) / solid_angle;
        assert!((30.0..41.0).contains(&found), "{found}");
        assert!(published.sampler.is_some() && last.unwrap().sigma_ev < 0.1);
    }

    #[test]
    fn an_untagged_exposure_is_not_the_light() {
        // A room with walls of many shades and a lamp that clips; the camera hunts by ±0.7 EV.
        let room = |ev: f64, seed: u64| -> Vec<[f32; 3]> {
            let scale = ev.exp2() as f32;
            let lit = |i: usize| {
                let (x, y) = (i % WIDTH, i / WIDTH);
                let on = (60..62).contains(&x) && (20..22).contains(&y);
                let shade = 0.05 + 0.05 * ((x / 8 + y / 8) % 5) as f32;
                let noise =
                    1.0 + 0.02 * (((i as u64 * 7919 + seed * 104_729) % 97) as f32 / 48.0 - 1.0);
                (scale * noise * if on { 5.0 } else { shade }).min(1.0)
            };
            (0..WIDTH * HEIGHT).map(|i| [lit(i); 3]).collect()
        };
        let mut chain = LightChain::new(WIDTH, HEIGHT, Prior::default());
        let mut first = 0.0;
        for i in 0..40_u32 {
            let ev = 0.7 * (f64::from(i) * 0.2).sin();
            let update = chain.update_untagged(&room(ev, u64::from(i)), 1.0 / 30.0, None);
            assert!((update.ev - ev).abs() < 0.05, "{} for {ev}", update.ev);
            let flux = f64::from(update.sh9[0][1]);
            if i == 0 {
                first = flux;
                continue;
            }
            assert!((flux / first - 1.0).abs() < 0.05, "{i}: {flux} of {first}");
            assert!(update.change < 0.05, "{i}: {update:?}");
        }
        // But a light that lights less than half of what is seen is.
        let mut lit = room(0.0, 50);
        for (i, texel) in lit.iter_mut().enumerate() {
            if i % WIDTH < 40 {
                *texel = texel.map(|c| (c * 4.0).min(1.0));
            }
        }
        // The last exposure has its say for two frames more.
        let mut most = 0.0_f64;
        for _ in 0..4 {
            let update = chain.update_untagged(&lit, 1.0 / 30.0, None);
            assert!(update.ev.abs() < 0.1, "{update:?}");
            most = most.max(update.change);
        }
        assert!(most > 0.5, "{most}");
    }

    #[test]
    fn noise_is_not_published() {
        let mut chain = LightChain::new(WIDTH, HEIGHT, Prior::default());
        let map = crate::evaluate::imagined(5, WIDTH, HEIGHT);
        let mut published = 0;
        for i in 0..60 {
            let noisy = crate::evaluate::happenings::with_noise(&map, i);
            let picture: Vec<[f32; 3]> = noisy
                .texels()
                .iter()
                .map(|t| t.map(|c| c.min(1.0)))
                .collect();
            let update = chain.update(&picture, 0.0, 1.0 / 30.0, None);
            // The filter settles first.
            published += usize::from(update.published && i > 10);
        }
        assert_eq!(published, 0);
    }

    #[test]
    fn a_lamp_that_goes_on_is_published_at_once() {
        let mut chain = LightChain::new(WIDTH, HEIGHT, Prior::default());
        for _ in 0..5 {
            chain.update(&frame(0.2, 0.0), 0.0, 1.0 / 30.0, None);
        }
        let update = chain.update(&frame(400.0, 0.0), 0.0, 1.0 / 30.0, None);
        assert!(update.published && chain.published().unwrap().discs.len() == 1);
        let update = chain.update(&frame(0.2, 0.0), 0.0, 1.0 / 30.0, None);
        assert!(update.published && chain.published().unwrap().discs.is_empty());
    }
}
