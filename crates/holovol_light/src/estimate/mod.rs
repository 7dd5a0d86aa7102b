//! HDR light from LDR exposures and whatever else is known: a ladder of evidence.

mod constrain;
mod extend;
mod found;
mod merge;
mod observe;
mod prior;
mod regions;
mod resolve;
mod sky;
#[cfg(test)]
mod tests;

use std::f64::consts::{LN_2, PI};

use glam::DVec3;

use crate::measure::luminous_flux;
use crate::{Grid, luminance};
use constrain::{Beliefs, GROUPS, Measured};
use regions::Regions;

pub(crate) use extend::draw_discs;
pub use found::{FoundLight, find_lights};
pub use merge::{CLIPPED, Exposure};
pub use observe::Observation;
pub use prior::Prior;
pub use regions::Region;
pub use sky::Sky;

/// What is known of a scene's light.
#[derive(Clone, Copy, Debug, Default)]
pub struct Evidence<'a> {
    /// Exposures of the same view, the brightest first; at least one.
    pub frames: &'a [Exposure<'a>],
    /// A light meter's reading.
    pub meter: Option<Meter>,
    /// Irradiance measured on a diffuse ball, or by many meters.
    pub probe: Option<&'a [ProbeSample]>,
}

/// A reading of luminous irradiance, in the units of the first frame: π is what a world that just
/// clips would give. (A lux value divided by the luminance that clips, cd/m².)
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Meter {
    /// Which way the meter looks, in the panorama's frame.
    pub normal: DVec3,
    /// Luminous irradiance.
    pub irradiance: f64,
    /// One standard deviation relative to the reading.
    pub relative_sigma: f64,
}

impl Meter {
    /// A meter that looks up and reads to ± 5 %.
    pub fn upward(irradiance: f64) -> Self {
        Self {
            normal: DVec3::Y,
            irradiance,
            relative_sigma: 0.05,
        }
    }
}

/// Irradiance of one surface direction of a probe, in the units of the first frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProbeSample {
    /// The surface's normal, in the panorama's frame.
    pub normal: DVec3,
    /// RGB.
    pub irradiance: [f64; 3],
}

/// One standard deviation of a probe's samples relative to its mean irradiance.
const PROBE_SIGMA: f64 = 0.03;

/// What an estimate rests on, from the least to the most.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rung {
    /// One exposure: clipped lights are guessed.
    Single,
    /// One exposure and a light meter.
    SingleAndMeter,
    /// Several exposures: only what the darkest clips is guessed.
    Bracket,
    /// Several exposures and a light meter.
    BracketAndMeter,
    /// A diffuse probe, with one exposure or several.
    Probe,
}

impl Rung {
    /// Its name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Single => "single",
            Self::SingleAndMeter => "single+lux",
            Self::Bracket => "bracket",
            Self::BracketAndMeter => "bracket+lux",
            Self::Probe => "probe",
        }
    }
}

/// What a light seems to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LightClass {
    /// The sun, or a moon exposed like one.
    Sun,
    /// Small with sharp edges.
    Lamp,
    /// Large: a window, a softbox, bright sky.
    Window,
    /// Something lit, below the horizon.
    Reflection,
}

/// A clipped light, extended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// What it seems to be.
    pub class: LightClass,
    /// Unit direction of its centre, in the panorama's frame.
    pub direction: DVec3,
    /// sr.
    pub solid_angle: f64,
    /// Irradiance facing it, RGB: mean radiance × solid angle.
    pub irradiance: [f64; 3],
    /// One standard deviation of its strength, EV.
    pub sigma_ev: f64,
    /// Whether it is small enough to be a disc light: then it can be taken out of the map.
    pub disc: bool,
    /// Its region: a sun's among the halos, another's among the cores.
    region: u32,
}

/// Lights smaller than this are discs, sr.
pub const DISC_SOLID_ANGLE: f64 = 0.02;
/// The sun's disc, sr.
pub const SUN_SOLID_ANGLE: f64 = 6.8e-5;

/// How far the irradiance of a correct strength may be from the meter's, EV: lights have shapes
/// and directions that are only nearly known.
const METER_MODEL_SIGMA: f64 = 0.05;
/// A light's centre may be off by this share of its clipped core's radius.
const MISPLACEMENT: f64 = 0.2;
/// Correlation of two regions' gains: lamps and windows of a room resemble each other.
const SHARED: f64 = 0.6;
/// How sure the unclipped part is, EV: response, vignetting, quantisation.
const BASE_SIGMA: f64 = 0.02;
/// Share of all light below which a meter sees nothing.
const UNSEEN: f64 = 1e-3;
/// Share of a light's misplacement, as it shows over a probe, by which its strength is misread.
const MISFIT_SHARE: f64 = 0.05;

/// Estimates HDR light for one size of panorama; owns its memory, so that the steady state
/// allocates nothing.
#[derive(Clone, Debug)]
pub struct Estimator {
    grid: Grid,
    prior: Prior,
    radiance: Vec<[f32; 3]>,
    clipped: Vec<u8>,
    /// What is within 1 EV of clipping in a channel, and what is near it in all.
    halos: Regions,
    cores: Regions,
    /// Clipped cores but the sun's, the strongest first.
    order: Vec<u32>,
    /// Per core: how many times the ceiling it is taken for.
    strengths: Vec<f32>,
    /// Per core: its light, or none (`u8::MAX`).
    assignment: Vec<u8>,
    /// Per core: whether it lies in the sun's halo.
    sunlit: Vec<bool>,
    lights: Vec<Light>,
    /// For small lights that were seen: marks, regions, and what each has above its level.
    marks: Vec<u8>,
    bright: Regions,
    above: Vec<([f64; 3], DVec3)>,
    /// Where the last estimate's lights of that kind were.
    resolved: Vec<DVec3>,
    ceiling: f32,
    /// Where the first frame clips.
    base: f32,
    sky: Sky,
    rung: Rung,
    sigma_ev: f64,
}

impl Estimator {
    /// An estimator for panoramas of this size, both at least 1.
    pub fn new(width: usize, height: usize, prior: Prior) -> Self {
        let grid = Grid::new(width, height);
        Self {
            prior,
            radiance: vec![[0.0; 3]; grid.len()],
            clipped: vec![0; grid.len()],
            halos: Regions::default(),
            cores: Regions::default(),
            order: Vec::new(),
            strengths: Vec::new(),
            assignment: Vec::new(),
            sunlit: Vec::new(),
            lights: Vec::new(),
            marks: Vec::new(),
            bright: Regions::default(),
            above: Vec::new(),
            resolved: Vec::new(),
            ceiling: 1.0,
            base: 1.0,
            sky: Sky::default(),
            rung: Rung::Single,
            sigma_ev: 0.0,
            grid,
        }
    }

    /// Estimates the light; afterwards the getters tell it.
    ///
    /// # Panics
    /// If there is no frame, or one whose length is not the panorama's.
    pub fn estimate(&mut self, evidence: &Evidence) {
        let frames = evidence.frames;
        assert!(
            !frames.is_empty() && frames.iter().all(|f| f.radiance.len() == self.grid.len()),
            "every frame has the estimator's size"
        );
        self.ceiling = merge::merge(frames, &mut self.radiance, &mut self.clipped);
        let ceiling = self.ceiling;
        self.base = (-frames[0].ev).exp2() as f32;
        let clipped = merge::CLIPPED * self.base;
        self.sky = Sky::look(&self.grid, &self.radiance, clipped);
        self.mark_blunted_sun();
        self.halos
            .find(&self.grid, &self.radiance, &self.clipped, ceiling);
        self.cores
            .find_cores(&self.grid, &self.radiance, &self.clipped, ceiling);
        self.rung = match (evidence.probe, evidence.meter, frames.len() > 1) {
            (Some(_), ..) => Rung::Probe,
            (None, None, false) => Rung::Single,
            (None, Some(_), false) => Rung::SingleAndMeter,
            (None, None, true) => Rung::Bracket,
            (None, Some(_), true) => Rung::BracketAndMeter,
        };
        self.extend();
        self.constrain(evidence);
        self.resolve();
    }

    /// How far the exposures reach beyond the brightest one's clipping level, or beyond that of an
    /// exposure of 0 EV if that is further: a dark frame may be the first, or the only one.
    fn reach_of_exposures(&self) -> f32 {
        self.ceiling / self.base.min(1.0)
    }

    /// Unknown strengths under what was measured; lights and map are scaled by the result.
    fn constrain(&mut self, evidence: &Evidence) {
        let count = self.lights.len().min(GROUPS);
        let beliefs = self.beliefs();
        let mut shares = [0.0; GROUPS];
        let measured = evidence.meter.and_then(|meter| self.measured(&meter));
        let found = match evidence.probe {
            Some(probe) if !probe.is_empty() => self.constrain_by_probe(&beliefs, probe),
            _ => {
                let found = constrain::posterior(&beliefs, measured.as_slice());
                self.scale_lights(&found.strengths.map(|x| [x.exp2(); 3]));
                found
            }
        };
        let mut variance = match evidence.probe {
            Some(probe) if !probe.is_empty() => self.misfit(probe).powi(2),
            _ => BASE_SIGMA * BASE_SIGMA,
        };
        let after = self.flux().max(1e-12);
        for (share, light) in shares.iter_mut().zip(&self.lights) {
            *share = luminance(light.irradiance) / after;
        }
        for i in 0..count {
            self.lights[i].sigma_ev = found.covariance[i][i].max(0.0).sqrt();
            for j in 0..count {
                variance += shares[i] * shares[j] * found.covariance[i][j];
            }
        }
        self.sigma_ev = self.prior.sigma_scale[self.rung as usize] * variance.max(0.0).sqrt();
    }

    /// How far the estimate is from what the probe saw: of all light, EV.
    ///
    /// A probe sees the whole sphere, so that whatever is wrong (a light's place or shape, the
    /// camera's response) shows in it.
    fn misfit(&self, probe: &[ProbeSample]) -> f64 {
        let count = probe.len() as f64;
        let mean = probe
            .iter()
            .map(|sample| luminance(sample.irradiance))
            .sum::<f64>()
            / count;
        if mean <= 0.0 {
            return BASE_SIGMA;
        }
        let (mut sum, mut square) = (0.0, 0.0);
        for sample in probe {
            let (base, reach) = self.reach(sample.normal);
            let found = luminance(base) + reach.iter().map(|rgb| luminance(*rgb)).sum::<f64>();
            let off = (found - luminance(sample.irradiance)) / mean;
            sum += off / count;
            square += off * off / count;
        }
        // Luminance has less noise than its channels.
        let noise = PROBE_SIGMA * 0.2126_f64.hypot(0.7152).hypot(0.0722);
        let unexplained = (square - sum * sum - noise * noise).max(0.0).sqrt();
        let seen = sum.hypot(MISFIT_SHARE * unexplained);
        seen.max(noise / count.sqrt()) / LN_2
    }

    /// A meter's reading, and how well the lights' places let it be understood; none if it sees
    /// next to nothing of the picture, so that any reading would ask for any light.
    fn measured(&self, meter: &Meter) -> Option<Measured> {
        let (base, reach) = self.reach(meter.normal);
        let base = luminance(base);
        let reach = reach.map(luminance);
        let total = (base + reach.iter().sum::<f64>()).max(1e-12);
        if total < UNSEEN * self.flux() {
            return None;
        }
        // A light that is off by δ changes its cosine by δ·tan: much where it grazes the meter.
        let misplaced = self.lights.iter().zip(reach).map(|(light, reach)| {
            let cosine = light.direction.dot(meter.normal).clamp(0.05, 1.0);
            let tangent = (1.0 - cosine * cosine).sqrt() / cosine;
            reach / total * tangent * self.misplacement(light)
        });
        let model = misplaced.sum::<f64>().min(1.0) / LN_2;
        let read = meter.relative_sigma / LN_2;
        Some(Measured {
            base,
            reach,
            value: meter.irradiance,
            sigma: (read * read + model * model + METER_MODEL_SIGMA.powi(2)).sqrt(),
        })
    }

    /// How far a light may be from where it was seen, radians.
    fn misplacement(&self, light: &Light) -> f64 {
        let regions = match light.class {
            LightClass::Sun => &self.halos.regions,
            _ => &self.cores.regions,
        };
        let region = regions.get(light.region as usize);
        let core = region.map_or(light.solid_angle, |region| f64::from(region.core));
        MISPLACEMENT * (core / PI).sqrt()
    }

    /// What is believed of the lights' strengths relative to what was guessed.
    fn beliefs(&self) -> Beliefs {
        let count = self.lights.len().min(GROUPS);
        let mut covariance = [[0.0; GROUPS]; GROUPS];
        for i in 0..count {
            for j in 0..count {
                let (a, b) = (&self.lights[i], &self.lights[j]);
                let alike = if i == j {
                    1.0
                } else if (a.class == LightClass::Sun) == (b.class == LightClass::Sun) {
                    SHARED
                } else {
                    0.0
                };
                covariance[i][j] = alike * a.sigma_ev * b.sigma_ev;
            }
        }
        Beliefs::new(count, &covariance)
    }

    fn constrain_by_probe(
        &mut self,
        beliefs: &Beliefs,
        probe: &[ProbeSample],
    ) -> constrain::Posterior {
        let mean = probe.iter().fold([0.0; 3], |sum, sample| {
            std::array::from_fn(|c| sum[c] + sample.irradiance[c] / probe.len() as f64)
        });
        let reaches: Vec<_> = probe
            .iter()
            .map(|sample| self.reach(sample.normal))
            .collect();
        let mut factors = [[1.0; 3]; GROUPS];
        let mut posterior = None;
        for c in [0, 2, 1] {
            let measured: Vec<Measured> = probe
                .iter()
                .zip(&reaches)
                .map(|(sample, (base, reach))| {
                    let value = sample.irradiance[c].max(1e-3 * mean[c]).max(1e-12);
                    Measured {
                        base: base[c],
                        reach: reach.map(|rgb| rgb[c]),
                        value,
                        // The noise is that of the probe's picture: absolute, not relative.
                        sigma: PROBE_SIGMA * (mean[c] / value).max(1.0) / LN_2,
                    }
                })
                .collect();
            let found = constrain::posterior(beliefs, &measured);
            for (factor, x) in factors.iter_mut().zip(found.strengths) {
                factor[c] = x.exp2();
            }
            posterior = Some(found);
        }
        self.scale_lights(&factors);
        posterior.unwrap_or_else(|| constrain::posterior(beliefs, &[]))
    }

    /// The panorama's grid.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// The radiance map without the lights that are discs, in units in which the first frame
    /// clips at 1.
    pub fn radiance(&self) -> &[[f32; 3]] {
        &self.radiance
    }

    /// The clipped lights, the strongest first.
    pub fn lights(&self) -> &[Light] {
        &self.lights
    }

    /// What the estimate rests on.
    pub fn rung(&self) -> Rung {
        self.rung
    }

    /// One standard deviation of the log₂ of all light together, EV.
    pub fn sigma_ev(&self) -> f64 {
        self.sigma_ev
    }

    /// What was seen of a sky.
    pub fn sky(&self) -> &Sky {
        &self.sky
    }

    /// Radiance at which the darkest exposure clips.
    pub fn ceiling(&self) -> f32 {
        self.ceiling
    }

    /// Luminous flux of map and discs: four times the mean luminous irradiance.
    pub fn flux(&self) -> f64 {
        let discs = self.lights.iter().filter(|light| light.disc);
        luminous_flux(&self.grid, &self.radiance)
            + discs.map(|light| luminance(light.irradiance)).sum::<f64>()
    }
}
