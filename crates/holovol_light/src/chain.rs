//! The whole chain from exposures to what a renderer needs, frame by frame.

use std::sync::Arc;

use crate::change::ChangeDetector;
use crate::estimate::{Estimator, Evidence, Exposure, Light, Meter, Prior, Rung};
use crate::measure::{add_to_spherical_harmonics, spherical_harmonics};
use crate::temporal::TemporalFilter;
use crate::{EnvironmentMap, EnvironmentSampler};

/// Exposures of alternating frames are merged up to this age, in frames.
const OLDEST: usize = 2;
/// Change since the last published light from which on it is published again.
const PUBLISH: f64 = 0.01;
/// A disc light that changed by this share is published again.
const DISC_CHANGE: f64 = 0.02;

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

/// What one frame gave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Update {
    /// Change of illumination since the last frame, 0 … 1 (DESIGN §6).
    pub change: f64,
    /// Whether [`LightChain::published`] is new.
    pub published: bool,
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
    unpublished: f64,
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
            unpublished: 0.0,
        }
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
        self.unpublished += change;
        let publish = self.unpublished >= PUBLISH || self.discs_changed();
        if publish {
            self.publish();
        }
        Update {
            change,
            published: publish,
            rung: self.estimator.rung(),
            sigma_ev: self.estimator.sigma_ev(),
            sh9,
        }
    }

    /// The light as last published; `None` before the first frame.
    pub fn published(&self) -> Option<&PublishedLight> {
        self.published.as_ref()
    }

    fn discs_changed(&self) -> bool {
        let Some(published) = &self.published else {
            return true;
        };
        let now = self.filter.lights();
        now.len() != published.discs.len()
            || now.iter().zip(&published.discs).any(|(a, b)| {
                let ratio = a.irradiance[1] / b.irradiance[1].max(1e-12);
                (ratio - 1.0).abs() > DISC_CHANGE
                    || a.direction.angle_between(b.direction) > 0.1 * DISC_CHANGE
            })
    }

    fn publish(&mut self) {
        let grid = self.estimator.grid();
        let map = EnvironmentMap::new(grid.width(), grid.height(), self.filter.radiance().to_vec());
        self.published = Some(PublishedLight {
            sampler: EnvironmentSampler::new(&map).map(Arc::new),
            map,
            discs: self.filter.lights().to_vec(),
        });
        self.unpublished = 0.0;
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
