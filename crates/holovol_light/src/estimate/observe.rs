//! What the truth says about the lights of an estimate: the ground that priors are fitted on.

use super::extend::REST;
use super::prior::gain_limit;
use super::regions::Regions;
use super::{Estimator, LightClass};
use crate::luminance;
use crate::measure::luminous_flux;

/// A light as it was guessed, beside the truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Observation {
    /// log₂ of the sun's true luminous irradiance over what a clear sky's sun would have had with
    /// a prior of 0.
    Sun(f64),
    /// A clipped region.
    Region {
        /// What its edge says of its gain, EV.
        edge: f64,
        /// log₂ of its core's true mean luminance over the clipping level.
        gain: f64,
        /// Gain that no light has, EV.
        limit: f64,
        /// Solid angle of its core, sr.
        core: f64,
        /// Its true share of all luminous flux.
        flux: f64,
    },
}

impl Estimator {
    /// Compares the lights of the last estimate, made without meter or probe, with the true
    /// radiance (same units, size and orientation).
    pub fn observe(&self, truth: &[[f32; 3]]) -> Vec<Observation> {
        let width = self.grid.width();
        let flux = |texels: &[[f32; 3]], y: usize| {
            let sum = texels
                .iter()
                .fold(0.0, |sum, texel| sum + luminance(texel.map(f64::from)));
            sum * f64::from(self.grid.solid_angle(y))
        };
        let all = luminous_flux(&self.grid, truth);
        let sums = |regions: &Regions| {
            let mut found = vec![(0.0, 0.0); regions.regions.len()];
            for run in &regions.runs {
                let row = run.y as usize * width;
                for i in row + run.start as usize..row + run.end as usize {
                    if self.clipped[i] == 7 {
                        let (here, guess) = &mut found[run.region as usize];
                        *here += flux(&truth[i..=i], run.y as usize);
                        *guess += flux(&self.radiance[i..=i], run.y as usize);
                    }
                }
            }
            found
        };
        let (in_halos, in_cores) = (sums(&self.halos), sums(&self.cores));
        let lights = self.lights.iter().filter(|light| light.region != REST);
        lights
            .filter_map(|light| {
                if light.class == LightClass::Sun {
                    let (real, glow) = in_halos[light.region as usize];
                    let guess = luminance(light.irradiance);
                    let missing = (real - glow).max(0.02 * guess);
                    return Some(Observation::Sun(
                        (missing / guess).log2() + self.prior.sun_over_sky,
                    ));
                }
                let region = self.cores.regions[light.region as usize];
                let (real, _) = in_cores[light.region as usize];
                let mean = real / f64::from(region.core * self.ceiling);
                (mean > 0.0).then(|| Observation::Region {
                    edge: region.edge_gain(&self.grid),
                    gain: mean.log2().max(0.0),
                    limit: gain_limit(self.reach_of_exposures()),
                    core: f64::from(region.core),
                    flux: real / all,
                })
            })
            .collect()
    }
}
