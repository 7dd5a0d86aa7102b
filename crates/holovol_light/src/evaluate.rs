//! Fits the prior and measures the ladder on panoramas whose light is known.

use glam::DVec3;
use rayon::prelude::*;

use crate::estimate::{Estimator, Evidence, Exposure, Meter, Observation, Prior, ProbeSample};
use crate::measure::{FluxCells, LightError512, Truth, normals};
use crate::{EnvironmentMap, luminance};

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
}

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
        Self {
            panorama,
            share,
            map,
            truth,
        }
    }

    /// The 8-bit sRGB picture of an exposure, linearised again.
    pub fn exposure(&self, ev: f64) -> Vec<[f32; 3]> {
        let scale = ev.exp2() as f32;
        let decode: Vec<f32> = (0..256).map(|z| srgb_to_linear(z as f32 / 255.0)).collect();
        let code = |l: f32| decode[(linear_to_srgb((l * scale).min(1.0)) * 255.0).round() as usize];
        self.map.texels().iter().map(|texel| texel.map(code)).collect()
    }

    /// How far a map is from the truth.
    pub fn error(&self, cells: &FluxCells) -> LightError512 {
        self.truth.error(cells)
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
        let bits = texels.iter().step_by(997).map(|t| u64::from(t[1].to_bits()));
        bits.fold(0x9e37_79b9_7f4a_7c15, |hash, bits| {
            (hash ^ bits).wrapping_mul(0x0000_0100_0000_01b3)
        })
    }
}

/// The irradiance cells of an estimate, discs included.
pub fn cells_of(estimator: &Estimator) -> FluxCells {
    let mut cells = FluxCells::from_texels(estimator.grid(), estimator.radiance());
    for light in estimator.lights().iter().filter(|light| light.disc) {
        cells.add(light.direction, light.irradiance);
    }
    cells
}

/// Fits the prior to cases.
pub fn fit(cases: &[&Case]) -> Prior {
    let mut prior = Prior::default();
    let observed: Vec<(usize, Vec<Observation>)> = cases
        .par_iter()
        .flat_map_iter(|case| {
            let (width, height) = (case.map.width(), case.map.height());
            let mut estimator = Estimator::new(width, height, prior);
            [Given::Single, Given::Minus6, Given::Minus4Minus8]
                .into_iter()
                .map(|given| {
                    case.estimate(&mut estimator, given);
                    (case.panorama, estimator.observe(case.map.texels()))
                })
                .collect::<Vec<_>>()
        })
        .collect();
    let panoramas = 1 + cases.iter().map(|case| case.panorama).max().unwrap_or(0);

    // Suns: a panorama is one observation however often it was exposed.
    let mut suns = Vec::new();
    for panorama in 0..panoramas {
        let of_it = observed.iter().filter(|(p, _)| *p == panorama);
        let ratios = of_it.flat_map(|(_, all)| all).filter_map(|o| match o {
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
        let spread = suns.iter().map(|s| (s - prior.sun_over_sky).powi(2)).sum::<f64>();
        prior.sun_sigma = (spread / suns.len() as f64).sqrt().max(0.3);
    }

    // Regions: weighted least squares, each panorama with the same weight in all.
    let mut points = Vec::new();
    for panorama in 0..panoramas {
        let of_it = observed.iter().filter(|(p, _)| *p == panorama);
        let all: Vec<(f64, f64, f64)> = of_it
            .filter(|(_, all)| !all.iter().any(|o| matches!(o, Observation::Sun(_))))
            .flat_map(|(_, all)| all)
            .filter_map(|o| match *o {
                Observation::Region { sharpness, gain, share } => Some((sharpness, gain, share)),
                Observation::Sun(_) => None,
            })
            .collect();
        let total: f64 = all.iter().map(|p| p.2).sum();
        points.extend(all.iter().map(|&(x, y, w)| (x, y, w / total.max(1e-9))));
    }
    let weight: f64 = points.iter().map(|p| p.2).sum();
    if weight > 0.0 {
        let mean = |f: &dyn Fn(&(f64, f64, f64)) -> f64| {
            points.iter().map(|p| p.2 * f(p)).sum::<f64>() / weight
        };
        let (x, y) = (mean(&|p| p.0), mean(&|p| p.1));
        let covariance = mean(&|p| (p.0 - x) * (p.1 - y));
        // The ridge is worth one panorama whose sharpness varies by one.
        let slope = covariance / (mean(&|p| (p.0 - x).powi(2)) + 1.0 / weight);
        prior.gain_per_sharpness = slope.max(0.0);
        prior.gain = y - prior.gain_per_sharpness * x;
        let residual = mean(&|p| (p.1 - prior.gain_of(p.0)).powi(2));
        prior.gain_sigma = residual.sqrt();
    }
    prior.sigma_scale = 1.0;
    prior
}

/// The middle of some values; 0 of none.
pub fn median(values: Vec<f64>) -> f64 {
    quantile(values, 0.5)
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

fn srgb_to_linear(v: f32) -> f32 {
    if v <= 0.04045 {
        v / 12.92
    } else {
        ((v + 0.055) / 1.055).powf(2.4)
    }
}

fn linear_to_srgb(l: f32) -> f32 {
    if l <= 0.003_130_8 {
        l * 12.92
    } else {
        1.055 * l.powf(1.0 / 2.4) - 0.055
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
