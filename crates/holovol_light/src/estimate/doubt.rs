//! What speaks against the evidence, or against what was made of it.

use std::f64::consts::PI;

use super::merge::{Exposure, FLOOR};
use super::{Estimator, ProbeSample, Rung};
use crate::Grid;

/// What speaks against a piece of evidence, or against the estimate as a whole. Each widens σ;
/// evidence that is not believed is left out, as if it had not been given.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Doubt {
    /// An exposure shows something else than the one next to it: another place, or its EV is
    /// wrong.
    Frame {
        /// Which of the evidence's frames.
        frame: usize,
        /// Which one it was compared with.
        with: usize,
        /// Median of how much brighter than the other it shows what both can tell, EV.
        off_ev: f64,
        /// Share of what both can tell in which they differ by more than half, beside what an
        /// unknown response does to the dark.
        differs: f64,
        /// Whether it is used all the same.
        believed: bool,
    },
    /// A meter reads what the picture and the lights in it can hardly give.
    Meter {
        /// Its reading over what was expected, EV.
        off_ev: f64,
        /// How many standard deviations of all that is believed it is off.
        spreads: f64,
        /// Whether it is used all the same.
        believed: bool,
    },
    /// A meter looks where the picture has next to no light, so that it says nothing.
    UnseeingMeter,
    /// A probe reads what the picture and the lights in it can hardly give, or sees too little.
    Probe {
        /// Its mean over what was expected, EV.
        off_ev: f64,
        /// How many standard deviations of all that is believed it is off.
        spreads: f64,
        /// Directions that it has samples of, 15° or more from each other.
        directions: usize,
        /// Whether it is used all the same.
        believed: bool,
    },
    /// The picture has no colours, so that no sky looks blue and no sun is told from a lamp.
    Colourless {
        /// What a sun in the brightest place would add to all light, EV.
        sun_ev: f64,
    },
    /// The picture is darker than what it could tell from black.
    Black {
        /// How much darker in the mean, EV.
        below_ev: f64,
    },
}

/// Standard deviations from which on evidence contradicts: meters and probes that are right were
/// at most 3.1 off on the panoramas that the prior is fitted on.
pub(super) const DOUBTED: f64 = 3.5;
/// Standard deviations from which on evidence is not believed at all.
pub(super) const REFUSED: f64 = 6.0;
/// No contradiction says more of the picture than that it may be this far off, EV: a reading in
/// another unit, thousands of times too large, is no reason to know nothing.
const MOST_DOUBT: f64 = 2.0;

/// Rows of the picture that frames are compared in.
const ROWS: usize = 64;
/// Values from here on say little of how bright something is: they may be about to clip.
const BRIGHTEST: f32 = 0.9;
/// EV by which exposures that saw the same don't differ, and the share of what both can tell above
/// which they contradict each other.
const DIFFERENT: f32 = 0.585;
const CONTRADICTS: f32 = 0.45;
/// How far dark values may be off alike, EV: this at [`TOE`] linear, at others as its ratio to them
/// to the power of ¾. sRGB taken for a power of 2.2, or the reverse, is so far off; and where
/// exposures of a bracket overlap, the darker one is dark.
const TOE_EV: f32 = 1.3;
const TOE: f32 = 0.004;
const MOST_TOE_EV: f32 = 1.5;
/// Share of the picture that both have to tell something of.
const TOLD: f32 = 0.01;
/// What a darker exposure surely shows: twice what it can tell from black.
const SHOWN: f32 = 2.0 * FLOOR;
/// Share that may differ by noise, compression and what moves; and how far an exposure may be off
/// for all that differs beyond, EV.
const MOVES: f64 = 0.1;
const SCATTER_EV: f64 = 3.0;
/// Exposures are believed to be this exact in the middle, EV.
const EXACT: f64 = 0.2;
/// Share of what is told that has to be within the range of both for its median to count alone.
const WITHIN: f32 = 0.1;
/// Differences of 0.1 EV, from −10 EV on, at values of the darker exposure of an octave each; the
/// first of what it shows as black.
const BINS: usize = 200;
const LEVELS: usize = 11;

/// What share of a picture differs by how much.
type Histogram = [f32; BINS];

fn bin_of(ev: f32) -> usize {
    ((10.0 * ev + 0.5 * BINS as f32) as usize).min(BINS - 1)
}

fn ev_of(bin: usize) -> f32 {
    0.1 * (bin as f32 + 0.5 - 0.5 * BINS as f32)
}

fn median(histogram: &Histogram) -> f32 {
    let half = 0.5 * histogram.iter().sum::<f32>();
    let mut sum = 0.0;
    let middle = histogram.iter().position(|share| {
        sum += share;
        sum >= half
    });
    ev_of(middle.unwrap_or(BINS / 2))
}

/// How two exposures differ in what both can tell.
struct Difference {
    off_ev: f64,
    differs: f32,
    is_told: bool,
}

impl Difference {
    /// Compares a brighter and a darker exposure.
    fn new(grid: &Grid, bright: &Exposure, dark: &Exposure) -> Self {
        let times = (bright.ev - dark.ev).exp2() as f32;
        let least = FLOOR * times;
        if least > 0.5 * BRIGHTEST {
            return Self::far(grid, bright, dark);
        }
        let (width, step) = (grid.width(), (grid.height() / ROWS).max(1));
        let mut levels = [[0.0_f32; BINS]; LEVELS];
        // Of what is within the range of both.
        let mut inner = [0.0_f32; BINS];
        for y in (0..grid.height()).step_by(step) {
            let row = y * width..(y + 1) * width;
            let pairs = bright.radiance[row.clone()].iter().zip(&dark.radiance[row]);
            for (a, b) in pairs.step_by(step) {
                // Green says enough. What is out of range of one is compared with the range's end.
                let [a, b] = [a[1], times * b[1]].map(|v| v.max(least).min(BRIGHTEST));
                let is_end = |v: f32| v == least || v == BRIGHTEST;
                if a == b && is_end(a) {
                    continue;
                }
                let weight = grid.solid_angle(y);
                let bin = bin_of((b / a).log2());
                let level = (b / least).log2() as usize + usize::from(b > least);
                levels[level.min(LEVELS - 1)][bin] += weight;
                inner[bin] += if is_end(a) || is_end(b) { 0.0 } else { weight };
            }
        }
        let all: Histogram = std::array::from_fn(|i| levels.iter().map(|level| level[i]).sum());
        let told: f32 = all.iter().sum();
        let is_within = inner.iter().sum::<f32>() > WITHIN * told;
        let different: f32 = (0..LEVELS)
            .map(|i| {
                let value = FLOOR * (i as f32 - 0.5).exp2();
                different(&levels[i], if i > 0 { toe(value) } else { 0.0 })
            })
            .sum();
        let whole: f32 = (0..grid.height())
            .step_by(step)
            .map(|y| grid.solid_angle(y) * width.div_ceil(step) as f32)
            .sum();
        Self {
            off_ev: f64::from(median(if is_within { &inner } else { &all })),
            differs: different / told.max(f32::MIN_POSITIVE),
            is_told: told >= TOLD * whole,
        }
    }

    /// Of exposures so far apart that nothing is in the range of both: what the darker one shows
    /// clips in the brighter one.
    fn far(grid: &Grid, bright: &Exposure, dark: &Exposure) -> Self {
        let mut histogram = [0.0_f32; BINS];
        for y in 0..grid.height() {
            let row = y * grid.width()..(y + 1) * grid.width();
            let pairs = bright.radiance[row.clone()].iter().zip(&dark.radiance[row]);
            for (a, _) in pairs.filter(|(_, b)| b[1] > SHOWN) {
                let ev = (BRIGHTEST / a[1].clamp(FLOOR, BRIGHTEST)).log2();
                histogram[bin_of(ev)] += grid.solid_angle(y);
            }
        }
        let told: f32 = histogram.iter().sum();
        Self {
            off_ev: f64::from(median(&histogram)),
            differs: different(&histogram, 0.0) / told.max(f32::MIN_POSITIVE),
            is_told: told >= 0.1 * TOLD * 4.0 * std::f32::consts::PI,
        }
    }
}

/// How far a value may be off since the response isn't known, EV.
fn toe(value: f32) -> f32 {
    let root = (TOE / value).sqrt();
    (TOE_EV * root * root.sqrt()).min(MOST_TOE_EV)
}

/// What differs by more than what it may be off alike, EV.
fn different(histogram: &Histogram, toe: f32) -> f32 {
    let alike = median(histogram).clamp(-toe, toe);
    let bins = histogram.iter().enumerate();
    bins.filter(|(bin, _)| (ev_of(*bin) - alike).abs() > DIFFERENT)
        .map(|(_, share)| share)
        .sum()
}

impl Estimator {
    /// Says of each exposure whether it is believed: not if it contradicts the one of 0 EV or
    /// those between, brighter ones and darker ones each in their order.
    pub(super) fn believe(&mut self, frames: &[Exposure]) {
        self.doubts.clear();
        self.believed.clear();
        self.believed.resize(frames.len(), true);
        let ev = |i: &usize| frames[*i].ev.abs();
        let first = (0..frames.len()).min_by(|a, b| ev(a).total_cmp(&ev(b)));
        let first = first.unwrap_or(0);
        let mut last = first;
        for i in first + 1..frames.len() {
            self.compare(frames, [last, i], i);
            last = if self.believed[i] { i } else { last };
        }
        last = first;
        for i in (0..first).rev() {
            self.compare(frames, [i, last], i);
            last = if self.believed[i] { i } else { last };
        }
    }

    fn compare(&mut self, frames: &[Exposure], [bright, dark]: [usize; 2], asked: usize) {
        let found = Difference::new(&self.grid, &frames[bright], &frames[dark]);
        if !found.is_told {
            return;
        }
        let off = found.off_ev.abs();
        self.believed[asked] = found.differs <= CONTRADICTS;
        if !self.believed[asked] || off > EXACT || f64::from(found.differs) > MOVES {
            self.doubts.push(Doubt::Frame {
                frame: asked,
                with: bright + dark - asked,
                off_ev: if asked == dark {
                    found.off_ev
                } else {
                    -found.off_ev
                },
                differs: f64::from(found.differs),
                believed: self.believed[asked],
            });
        }
    }

    /// Doubts about the picture itself, once its lights are measured: `flux` is all light's,
    /// `missed_sun` what a sun would give that the picture could not show to be one.
    pub(super) fn doubt_picture(&mut self, flux: f64, missed_sun: f64) {
        let least = 4.0 * PI * f64::from(FLOOR * self.base);
        if flux < least {
            self.doubts.push(Doubt::Black {
                below_ev: (least / flux.max(1e-9 * least)).log2(),
            });
        }
        // What is measured counts the sun, whatever it is taken for.
        if missed_sun > 0.0 && matches!(self.rung, Rung::Single | Rung::Bracket) {
            let sun_ev = (1.0 + missed_sun / flux.max(1e-12)).log2();
            self.doubts.push(Doubt::Colourless { sun_ev });
        }
    }

    /// One standard deviation of all light for what speaks against the estimate, EV.
    pub(super) fn doubt_ev(&self) -> f64 {
        let ev = |doubt: &Doubt| match *doubt {
            Doubt::Frame {
                off_ev,
                differs,
                believed: true,
                ..
            } => {
                let off = off_ev.abs().min(2.0 * (off_ev.abs() - EXACT).max(0.0));
                off.hypot(SCATTER_EV * (differs - MOVES).max(0.0))
            }
            Doubt::Meter { off_ev, .. } | Doubt::Probe { off_ev, .. } => off_ev.abs(),
            Doubt::Colourless { sun_ev } => sun_ev,
            Doubt::Black { below_ev } => below_ev,
            _ => 0.0,
        };
        let square = |doubt| ev(doubt).clamp(0.0, MOST_DOUBT).powi(2);
        self.doubts.iter().map(square).sum::<f64>().sqrt()
    }
}

/// Whether a picture has no colours at all: a greyscale camera's, or one that was made so.
pub(super) fn is_colourless(texels: &[[f32; 3]]) -> bool {
    /// Difference of channels that coding may leave, relative and absolute.
    const LEFT: [f32; 2] = [0.01, 1e-4];
    texels.iter().all(|&[r, g, b]| {
        let (least, most) = (r.min(g).min(b), r.max(g).max(b));
        most - least <= LEFT[0] * most + LEFT[1]
    })
}

/// Directions of a probe's samples that are 15° or more from each other.
pub fn distinct_directions(probe: &[ProbeSample]) -> usize {
    const APART: f64 = 15.0;
    let cosine = APART.to_radians().cos();
    let mut found: Vec<glam::DVec3> = Vec::new();
    for sample in probe {
        if found.iter().all(|other| other.dot(sample.normal) < cosine) {
            found.push(sample.normal);
        }
    }
    found.len()
}
