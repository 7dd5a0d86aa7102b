//! Fits the prior and measures the ladder on panoramas whose light is known.

pub mod happenings;
mod imagined;

use glam::DVec3;
use rayon::prelude::*;

use crate::estimate::{Estimator, Evidence, Exposure, Meter, Observation, Prior, ProbeSample};
use crate::measure::{FluxCells, LightError512, Truth, normals};
use crate::response::{linear_to_srgb, srgb_to_linear};
use crate::{EnvironmentMap, Grid, luminance};

pub use imagined::imagined;

/// Shares of the picture that the base exposure clips.
pub const CLIPPED_SHARES: [f64; 3] = [0.005, 0.02, 0.08];
/// Turns of each panorama.
pub const ROTATIONS: usize = 4;

/// What an estimator is given.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Given {
    /// One exposure.
    Single,
    /// And an upward light meter.
    SingleLux,
    /// And a −6 EV frame.
    Minus6,
    /// And both.
    Minus6Lux,
    /// And −4 and −8 EV frames.
    Minus4Minus8,
    /// One exposure and a diffuse probe.
    Probe,
}

impl Given {
    /// All, as in the table.
    pub const ALL: [Self; 6] = [
        Self::Single,
        Self::SingleLux,
        Self::Minus6,
        Self::Minus6Lux,
        Self::Minus4Minus8,
        Self::Probe,
    ];

    /// Its name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Single => "one LDR frame",
            Self::SingleLux => "+ one upward lux value, ±5 %",
            Self::Minus6 => "+ a −6 EV frame",
            Self::Minus6Lux => "+ −6 EV and lux",
            Self::Minus4Minus8 => "+ −4 and −8 EV frames",
            Self::Probe => "+ a measured diffuse probe",
        }
    }

    fn exposures(self) -> &'static [f64] {
        match self {
            Self::Single | Self::SingleLux | Self::Probe => &[0.0],
            Self::Minus6 | Self::Minus6Lux => &[0.0, -6.0],
            Self::Minus4Minus8 => &[0.0, -4.0, -8.0],
        }
    }
}

/// A panorama, turned and exposed.
pub struct Case {
    /// Which panorama.
    pub panorama: usize,
    /// Share of the picture that clips.
    pub share: f64,
    /// True radiance; the base exposure clips at 1.
    pub map: EnvironmentMap,
    truth: Truth,
    /// Luminous flux of the truth.
    flux: f64,
    /// 8-bit sRGB pictures of [`EXPOSURES`].
    pictures: Vec<Vec<[u8; 3]>>,
}

/// All exposures that any rung uses, EV.
const EXPOSURES: [f64; 4] = [0.0, -4.0, -6.0, -8.0];

impl Case {
    /// Turns a panorama by whole texels, `rotation` of [`ROTATIONS`], and scales it so that `share`
    /// of its texels have a channel above 1.
    pub fn new(panorama: usize, map: &EnvironmentMap, rotation: usize, share: f64) -> Self {
        let (width, height) = (map.width(), map.height());
        let shift = (rotation * width) / ROTATIONS + width / 23;
        let mut brightest: Vec<f32> = map
            .texels()
            .iter()
            .map(|texel| texel[0].max(texel[1]).max(texel[2]))
            .collect();
        let rank = ((1.0 - share) * (brightest.len() - 1) as f64) as usize;
        let (_, level, _) = brightest.select_nth_unstable_by(rank, f32::total_cmp);
        let scale = 1.0 / level.max(f32::MIN_POSITIVE);
        let texels = (0..width * height)
            .map(|i| {
                let (x, y) = (i % width, i / width);
                map.texels()[(x + shift) % width + y * width].map(|c| c * scale)
            })
            .collect();
        let map = EnvironmentMap::new(width, height, texels);
        let truth = Truth::new(&FluxCells::new(&map));
        let pictures = EXPOSURES.map(|ev| picture(&map, ev)).to_vec();
        Self {
            panorama,
            share,
            flux: crate::measure::luminous_flux(&Grid::new(width, height), map.texels()),
            map,
            truth,
            pictures,
        }
    }

    /// The 8-bit sRGB picture of an exposure, linearised again.
    fn exposure(&self, ev: f64) -> Vec<[f32; 3]> {
        let decode: Vec<f32> = (0..256)
            .map(|z| srgb_to_linear(f64::from(z) / 255.0) as f32)
            .collect();
        let index = EXPOSURES.iter().position(|&e| e == ev);
        let picture = &self.pictures[index.expect("an exposure that is prepared")];
        let linear = |texel: &[u8; 3]| texel.map(|code| decode[usize::from(code)]);
        picture.iter().map(linear).collect()
    }

    /// How far a map is from the truth.
    pub fn error(&self, cells: &FluxCells) -> LightError512 {
        self.truth.error(cells)
    }

    /// What the exposures of a rung say without any extension: clipped light stays clipped.
    pub fn plain_merge(&self, given: Given) -> Vec<[f32; 3]> {
        let mut out = self.exposure(0.0);
        for &ev in &given.exposures()[1..] {
            let (dark, level) = (self.exposure(ev), (-ev).exp2() as f32);
            for (texel, dark) in out.iter_mut().zip(dark) {
                for c in 0..3 {
                    texel[c] = if texel[c] >= 0.95 {
                        texel[c].max(dark[c] * level)
                    } else {
                        texel[c]
                    };
                }
            }
        }
        out
    }

    /// Estimates with what is given; random noise of meter and probe is the case's own.
    pub fn estimate(&self, estimator: &mut Estimator, given: Given) {
        let pictures: Vec<(f64, Vec<[f32; 3]>)> = given
            .exposures()
            .iter()
            .map(|&ev| (ev, self.exposure(ev)))
            .collect();
        let frames: Vec<Exposure> = pictures
            .iter()
            .map(|(ev, radiance)| Exposure { ev: *ev, radiance })
            .collect();
        let mut noise = Noise(self.seed());
        let meter = matches!(given, Given::SingleLux | Given::Minus6Lux).then(|| {
            let truth = luminance(self.truth.cells().irradiance(DVec3::Y));
            Meter::upward(truth * (1.0 + 0.05 * noise.normal()))
        });
        let samples: Vec<ProbeSample> = if given == Given::Probe {
            let mut samples: Vec<ProbeSample> = normals(64)
                .map(|normal| ProbeSample {
                    normal,
                    irradiance: self.truth.cells().irradiance(normal),
                })
                .collect();
            let mean = samples.iter().fold([0.0; 3], |sum, sample| {
                std::array::from_fn(|c| sum[c] + sample.irradiance[c] / 64.0)
            });
            for sample in &mut samples {
                for c in 0..3 {
                    let noisy = sample.irradiance[c] + 0.03 * mean[c] * noise.normal();
                    sample.irradiance[c] = noisy.max(0.0);
                }
            }
            samples
        } else {
            Vec::new()
        };
        estimator.estimate(&Evidence {
            frames: &frames,
            meter,
            probe: (given == Given::Probe).then_some(samples.as_slice()),
        });
    }

    fn seed(&self) -> u64 {
        let texels = self.map.texels();
        let bits = texels
            .iter()
            .step_by(997)
            .map(|t| u64::from(t[1].to_bits()));
        bits.fold(0x9e37_79b9_7f4a_7c15, |hash, bits| {
            (hash ^ bits).wrapping_mul(0x0000_0100_0000_01b3)
        })
    }
}

/// The 8-bit sRGB picture of a map at an exposure.
fn picture(map: &EnvironmentMap, ev: f64) -> Vec<[u8; 3]> {
    // By table: the curve is smooth enough for 16 bits to hit the right code of 8.
    let encode: Vec<u8> = (0..=u16::MAX)
        .map(|i| (linear_to_srgb(f64::from(i) / 65535.0) * 255.0).round() as u8)
        .collect();
    let scale = ev.exp2() as f32;
    let code = |l: f32| encode[((l * scale).min(1.0) * 65535.0).round() as usize];
    map.texels().iter().map(|texel| texel.map(code)).collect()
}

/// The irradiance cells of an estimate, discs included.
pub fn cells_of(estimator: &Estimator) -> FluxCells {
    let mut cells = FluxCells::from_texels(estimator.grid(), estimator.radiance());
    for light in estimator.lights().iter().filter(|light| light.disc) {
        cells.add(light.direction, light.irradiance);
    }
    cells
}

/// What the truth says about the lights of a case, at each set of exposures.
pub fn observe(case: &Case) -> Vec<Observation> {
    let (width, height) = (case.map.width(), case.map.height());
    let mut estimator = Estimator::new(width, height, Prior::default());
    [Given::Single, Given::Minus6, Given::Minus4Minus8]
        .into_iter()
        .flat_map(|given| {
            case.estimate(&mut estimator, given);
            estimator.observe(case.map.texels())
        })
        .collect()
}

/// Fits the prior to cases and what was [`observe`]d of each.
pub fn fit(cases: &[(&Case, &[Observation])]) -> Prior {
    let mut prior = Prior::default();
    let observed: Vec<(usize, &[Observation])> = cases
        .iter()
        .map(|(case, all)| (case.panorama, *all))
        .collect();
    let panoramas = 1 + observed.iter().map(|(p, _)| *p).max().unwrap_or(0);

    // Suns: a panorama is one observation however often it was exposed.
    let mut suns = Vec::new();
    for panorama in 0..panoramas {
        let of_it = observed.iter().filter(|(p, _)| *p == panorama);
        let ratios = of_it.flat_map(|(_, all)| *all).filter_map(|o| match o {
            Observation::Sun(ratio) => Some(*ratio),
            Observation::Region { .. } => None,
        });
        let ratios: Vec<f64> = ratios.collect();
        if !ratios.is_empty() {
            suns.push(median(ratios));
        }
    }
    if suns.len() >= 3 {
        prior.sun_over_sky = median(suns.clone());
    }

    // Regions: how many times what its edge says a region is, each panorama with the same weight
    // in all. The middle counts by how large regions are, the spread by how much light they have.
    let mut points: Vec<[f64; 5]> = Vec::new();
    for panorama in 0..panoramas {
        let of_it = observed.iter().filter(|(p, _)| *p == panorama);
        let all: Vec<[f64; 5]> = of_it
            .filter(|(_, all)| !all.iter().any(|o| matches!(o, Observation::Sun(_))))
            .flat_map(|(_, all)| *all)
            .filter_map(|o| match *o {
                Observation::Region {
                    edge,
                    gain,
                    limit,
                    core,
                    flux,
                } => Some([edge, gain, core, flux, limit]),
                Observation::Sun(_) => None,
            })
            .collect();
        let total = |i: usize| all.iter().map(|p| p[i]).sum::<f64>().max(1e-9);
        let (core, flux) = (total(2), total(3));
        points.extend(
            all.iter()
                .map(|p| [p[0], p[1], p[2] / core, p[3] / flux, p[4]]),
        );
    }
    if !points.is_empty() {
        // What the gain was before it levelled off.
        let straight = |p: &[f64; 5]| p[1] / (1.0 - p[1] / p[4]).max(0.1);
        let pairs = points.iter().map(|p| (straight(p) / p[0], p[2]));
        prior.gain = weighted_median(pairs.collect());
        let off = |p: &[f64; 5]| (p[1] - prior.gain_of(p[0], p[4])).powi(2) / p[0];
        let weights: f64 = points.iter().map(|p| p[3]).sum();
        let residual: f64 = points.iter().map(|p| p[3] * off(p)).sum();
        prior.gain_sigma = (residual / weights).sqrt();
    }
    prior.sigma_scale = calibrate(cases, prior);
    prior
}

/// Share of cases that ± 2σ should hold.
const INSIDE: f64 = 0.98;

/// Per rung, the model's spread is not narrowed by more than this: the few cases of a rung share
/// their panoramas, and one draw of a meter's noise. A probe's spread is measured case by case.
const LEAST_SCALE: [f64; 5] = [0.8, 0.8, 0.8, 0.8, 0.4];

/// What σ has to be scaled by, per rung, for ± 2σ to hold the truth as often as it should.
fn calibrate(cases: &[(&Case, &[Observation])], mut prior: Prior) -> [f64; 5] {
    prior.sigma_scale = [1.0; 5];
    let misses: Vec<[(f64, usize); 6]> = cases
        .par_iter()
        .map(|(case, _)| {
            let mut estimator = Estimator::new(case.map.width(), case.map.height(), prior);
            Given::ALL.map(|given| {
                case.estimate(&mut estimator, given);
                let bias = (estimator.flux() / case.flux).log2();
                (bias.abs() / estimator.sigma_ev(), estimator.rung() as usize)
            })
        })
        .collect();
    std::array::from_fn(|rung| {
        let of_it = misses.iter().flatten().filter(|(_, r)| *r == rung);
        let scale = 0.5 * quantile(of_it.map(|(miss, _)| *miss).collect(), INSIDE);
        if scale > 0.0 {
            scale.max(LEAST_SCALE[rung])
        } else {
            1.0
        }
    })
}

/// Spearman's rank correlation; 0 of fewer than two pairs.
pub fn rank_correlation(a: &[f64], b: &[f64]) -> f64 {
    let ranks = |values: &[f64]| -> Vec<f64> {
        let of = |v: &f64| {
            let below = values.iter().filter(|w| *w < v).count();
            let equal = values.iter().filter(|w| *w == v).count();
            below as f64 + 0.5 * (equal as f64 - 1.0)
        };
        values.iter().map(of).collect()
    };
    let (a, b) = (ranks(a), ranks(b));
    let mean = 0.5 * (a.len() as f64 - 1.0);
    let product = |x: &[f64], y: &[f64]| -> f64 {
        x.iter().zip(y).map(|(x, y)| (x - mean) * (y - mean)).sum()
    };
    let spread = (product(&a, &a) * product(&b, &b)).sqrt();
    if spread > 0.0 {
        product(&a, &b) / spread
    } else {
        0.0
    }
}

/// The middle of some values; 0 of none.
pub fn median(values: Vec<f64>) -> f64 {
    quantile(values, 0.5)
}

/// The value below which half of the weight is, of pairs of value and weight.
fn weighted_median(mut pairs: Vec<(f64, f64)>) -> f64 {
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * pairs.iter().map(|pair| pair.1).sum::<f64>();
    let mut sum = 0.0;
    let mut reached = pairs.iter().filter(|pair| {
        sum += pair.1;
        sum >= half
    });
    reached.next().map_or(0.0, |pair| pair.0)
}

/// The value that a share of all is below, interpolated; 0 of none.
pub fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let at = share.clamp(0.0, 1.0) * values.len().saturating_sub(1) as f64;
    let (low, high) = (at.floor() as usize, at.ceil() as usize);
    match (values.get(low), values.get(high)) {
        (Some(a), Some(b)) => a + (at - low as f64) * (b - a),
        _ => 0.0,
    }
}

/// SplitMix64 and Box–Muller.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        let (a, b) = (1.0 - self.uniform(), self.uniform());
        (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()
    }
}
