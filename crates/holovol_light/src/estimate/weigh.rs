//! Meters and probes against what is believed of the lights.

use std::f64::consts::{LN_2, PI};

use super::constrain::{self, Beliefs, GROUPS, Measured, Posterior};
use super::doubt::{DOUBTED, Doubt, REFUSED, distinct_directions};
use super::extend::REST;
use super::prior::gain_limit;
use super::{Estimator, Evidence, Light, LightClass, Meter, ProbeSample, Rung};
use crate::luminance;

/// One standard deviation of a probe's samples relative to its mean irradiance.
const PROBE_SIGMA: f64 = 0.03;
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

impl Estimator {
    /// Unknown strengths under what was measured; lights and map are scaled by the result. Gives
    /// the flux of all light.
    pub(super) fn constrain(&mut self, evidence: &Evidence, exposures: usize) -> f64 {
        let count = self.lights.len().min(GROUPS);
        let beliefs = self.beliefs();
        let probe = evidence.probe.unwrap_or_default();
        let by_probe = self.weigh_probe(&beliefs, probe);
        let by_meter = match (&by_probe, evidence.meter) {
            (None, Some(meter)) => self.weigh_meter(&beliefs, &meter),
            (Some(_), Some(meter)) => {
                self.compare_meter(&meter);
                None
            }
            _ => None,
        };
        self.rung = match (&by_probe, &by_meter, exposures > 1) {
            (Some(_), ..) => Rung::Probe,
            (None, None, false) => Rung::Single,
            (None, Some(_), false) => Rung::SingleAndMeter,
            (None, None, true) => Rung::Bracket,
            (None, Some(_), true) => Rung::BracketAndMeter,
        };
        let mut variance = match &by_probe {
            Some(_) => self.misfit(probe).powi(2),
            None => BASE_SIGMA * BASE_SIGMA,
        };
        let found = by_probe.or(by_meter);
        let found = found.unwrap_or_else(|| constrain::posterior(&beliefs, &[]));
        let flux = self.flux();
        let after = flux.max(1e-12);
        let mut shares = [0.0; GROUPS];
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
        flux
    }

    /// The strengths that a meter asks for; none if it sees nothing, or asks for what can't be.
    fn weigh_meter(&mut self, beliefs: &Beliefs, meter: &Meter) -> Option<Posterior> {
        let Some(measured) = self.measured(meter) else {
            self.doubts.push(Doubt::UnseeingMeter);
            return None;
        };
        let mut found = constrain::posterior(beliefs, &[measured]);
        let spreads = found.spreads();
        let believed =
            spreads <= REFUSED && found.misfit <= DOUBTED && self.can_be(&found.strengths);
        if !believed || spreads > DOUBTED {
            let doubt = Doubt::Meter {
                off_ev: measured.residual(&[0.0; GROUPS]),
                spreads,
                believed,
            };
            self.doubts.push(doubt);
            if !believed {
                return None;
            }
            found.widen(spreads / DOUBTED);
        }
        self.scale_lights(&found.strengths.map(|x| [x.exp2(); 3]));
        Some(found)
    }

    /// Whether no lamp is brighter than lamps are, if lights have these log₂ strengths.
    fn can_be(&self, strengths: &[f64; GROUPS]) -> bool {
        let most = gain_limit(self.reach_of_exposures());
        self.lights.iter().zip(strengths).all(|(light, strength)| {
            let of_one = light.class != LightClass::Sun && light.region != REST;
            let level = luminance(light.irradiance) / light.solid_angle;
            !of_one || (level / f64::from(self.ceiling)).log2() + strength <= most
        })
    }

    /// What a meter says of lights that a probe has measured.
    fn compare_meter(&mut self, meter: &Meter) {
        let Some(measured) = self.measured(meter) else {
            return;
        };
        let off_ev = measured.residual(&[0.0; GROUPS]);
        let spreads = off_ev.abs() / measured.sigma;
        if spreads > DOUBTED {
            self.doubts.push(Doubt::Meter {
                off_ev,
                spreads,
                believed: false,
            });
        }
    }

    /// How far the estimate is from what the probe saw: of all light, EV.
    ///
    /// A probe sees the whole sphere, so that whatever is wrong (a light's place or shape, the
    /// camera's response) shows in it.
    fn misfit(&self, probe: &[ProbeSample]) -> f64 {
        let count = probe.len() as f64;
        let mean = luminance(mean_of(probe));
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

    /// The strengths that a probe asks for, per channel, and the spread of the green ones; none
    /// if there is none, or it asks for what can't be.
    fn weigh_probe(&mut self, beliefs: &Beliefs, probe: &[ProbeSample]) -> Option<Posterior> {
        if probe.is_empty() {
            return None;
        }
        let mean = mean_of(probe);
        let reaches: Vec<_> = probe
            .iter()
            .map(|sample| self.reach(sample.normal))
            .collect();
        // Base and lights over all samples: what the probe would read of a guess, and of a fit.
        let all = reaches.iter().fold(
            ([0.0; 3], [[0.0; 3]; GROUPS]),
            |(base, reach), (other, others)| {
                let add = |a: [f64; 3], b: [f64; 3]| std::array::from_fn(|c| a[c] + b[c]);
                (
                    add(base, *other),
                    std::array::from_fn(|i| add(reach[i], others[i])),
                )
            },
        );
        // All samples as one meter.
        let count = probe.len() as f64;
        let gauge = Measured {
            base: luminance(all.0) / count,
            reach: all.1.map(|e| luminance(e) / count),
            value: luminance(mean),
            sigma: (PROBE_SIGMA / LN_2).hypot(METER_MODEL_SIGMA),
        };
        let gauged = constrain::posterior(beliefs, &[gauge]);
        let directions = distinct_directions(probe);
        let believed = gauged.spreads() <= REFUSED
            && gauged.misfit <= DOUBTED
            && self.can_be(&gauged.strengths)
            && directions >= super::PROBE_DIRECTIONS;
        if !believed || gauged.spreads() > DOUBTED {
            self.doubts.push(Doubt::Probe {
                off_ev: gauge.residual(&[0.0; GROUPS]),
                spreads: gauged.spreads(),
                directions,
                believed,
            });
        }
        if !believed {
            return None;
        }
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
        let mut found = posterior?;
        found.widen((gauged.spreads() / DOUBTED).max(1.0));
        self.scale_lights(&factors);
        Some(found)
    }
}

fn mean_of(probe: &[ProbeSample]) -> [f64; 3] {
    probe.iter().fold([0.0; 3], |sum, sample| {
        std::array::from_fn(|c| sum[c] + sample.irradiance[c] / probe.len() as f64)
    })
}
