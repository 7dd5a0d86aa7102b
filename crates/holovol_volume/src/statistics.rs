//! What the values of a volume are like: histogram, percentiles, and a window made of them.

use rayon::prelude::*;

use crate::{Volume, Voxels};

/// Bins of the histogram of a float volume.
const FLOAT_BINS: usize = 4096;

/// Voxels that one task counts.
const CHUNK: usize = 1 << 20;

/// How often each value occurs.
#[derive(Clone, Debug, PartialEq)]
pub struct Histogram {
    /// Value at the lower edge of bin 0, data units.
    pub low: f64,
    /// Value at the upper edge of the last bin, data units.
    pub high: f64,
    /// Voxels per bin; bins are equally wide.
    pub counts: Vec<u64>,
}

impl Histogram {
    /// Width of a bin, data units.
    pub fn bin_width(&self) -> f64 {
        (self.high - self.low) / self.counts.len() as f64
    }

    /// The value at the middle of a bin, data units.
    pub fn bin_centre(&self, bin: usize) -> f64 {
        self.low + (bin as f64 + 0.5) * self.bin_width()
    }
}

impl Volume {
    /// How often each value occurs: one bin per stored integer from the smallest to the largest,
    /// 4096 bins from the smallest to the largest value for floats.
    pub fn histogram(&self) -> Histogram {
        let [low, high] = self.stored_range();
        let (mut counts, edges) = if let Voxels::F32(values) = self.voxels() {
            let per_unit = FLOAT_BINS as f64 / (high - low).max(f64::MIN_POSITIVE);
            let bin =
                |value: f32| (((f64::from(value) - low) * per_unit) as usize).min(FLOAT_BINS - 1);
            // A constant volume's only bin needs a width.
            let high = if high > low { high } else { low + 1.0 };
            (count(values, FLOAT_BINS, bin), [low, high])
        } else {
            let counts = Counts::new(self.voxels()).of_integers(low, high);
            (counts, [low - 0.5, high + 0.5])
        };
        let [low, high] = edges.map(|stored| self.slope() * stored + self.intercept());
        if self.slope() < 0.0 {
            counts.reverse();
        }
        Histogram {
            low: low.min(high),
            high: low.max(high),
            counts,
        }
    }

    /// The value that `percent` (0 … 100) of the voxels don't exceed, in data units.
    ///
    /// Exact for every type; linear between neighbouring voxels in order of value, like NumPy's.
    pub fn percentile(&self, percent: f64) -> f64 {
        self.percentiles(&[percent])[0]
    }

    /// Several percentiles in one go, see [`Volume::percentile`].
    pub fn percentiles(&self, percents: &[f64]) -> Vec<f64> {
        let counts = Counts::new(self.voxels());
        percents
            .iter()
            .map(|&percent| self.value_at_percent(&counts, &[], percent))
            .collect()
    }

    /// The mean of all values, in data units.
    pub fn mean(&self) -> f64 {
        let sum = match self.voxels() {
            Voxels::U8(v) => sum(v),
            Voxels::I8(v) => sum(v),
            Voxels::U16(v) => sum(v),
            Voxels::I16(v) => sum(v),
            Voxels::F32(v) => sum(v),
        };
        self.slope() * (sum / self.voxels().len() as f64) + self.intercept()
    }

    /// A display window (lo < hi) in data units that shows most volumes well.
    ///
    /// From the 1st to the 99.8th percentile of the voxels that are left when background is
    /// taken away: single values that at least 5 % of the voxels share, far more often than
    /// neighbouring values occur (padding, removed air). Volumes of few values (labels) get their
    /// whole range; constant ones [c, c + 1].
    pub fn auto_window(&self) -> [f64; 2] {
        const LOW_PERCENT: f64 = 1.0;
        const HIGH_PERCENT: f64 = 99.8;
        let counts = Counts::new(self.voxels());
        let spikes = counts.spikes();
        let background: u64 = spikes.iter().map(|spike| spike.1).sum();
        let mut window = self.range();
        if background < counts.total && counts.distinct_values() > LABELS_MAX {
            let trimmed = [LOW_PERCENT, HIGH_PERCENT]
                .map(|percent| self.value_at_percent(&counts, &spikes, percent));
            if trimmed[0] < trimmed[1] {
                window = trimmed;
            }
        }
        let [low, high] = window;
        if low < high {
            [low, high]
        } else {
            // One f32 step at least, for numbers that swallow a 1.
            [low, low + (low.abs() * 1e-6).max(1.0)]
        }
    }

    /// A percentile in data units, some stored values left out.
    fn value_at_percent(&self, counts: &Counts<'_>, without: &[(Key, u64)], percent: f64) -> f64 {
        let left_out: u64 = without.iter().map(|spike| spike.1).sum();
        let last = counts.total.saturating_sub(left_out + 1);
        let part = (percent / 100.0).clamp(0.0, 1.0);
        let part = if self.slope() < 0.0 { 1.0 - part } else { part };
        let rank = part * last as f64;
        let below = (rank.floor() as u64).min(last);
        let [a, b] = counts.stored_at_ranks(below, (below + 1).min(last), without);
        let stored = a + (b - a) * (rank - below as f64);
        self.slope() * stored + self.intercept()
    }
}

/// Volumes of no more different values than this are taken for labels.
const LABELS_MAX: usize = 16;

/// A number that sorts like the stored number it stands for.
type Key = u32;

/// For integers of 16 bits or less every key has its count; for floats the upper 16 bits of the
/// keys have, and the lower ones are counted when needed.
struct Counts<'a> {
    voxels: &'a Voxels,
    total: u64,
    by_upper_key: Vec<u64>,
}

const KEYS: usize = 1 << 16;

impl<'a> Counts<'a> {
    fn new(voxels: &'a Voxels) -> Self {
        let by_upper_key = match voxels {
            Voxels::U8(v) => count(v, KEYS, |n| n.into()),
            Voxels::I8(v) => count(v, KEYS, |n| (i32::from(n) + 32_768) as usize),
            Voxels::U16(v) => count(v, KEYS, |n| n.into()),
            Voxels::I16(v) => count(v, KEYS, |n| (i32::from(n) + 32_768) as usize),
            Voxels::F32(v) => count(v, KEYS, |n| (key_of_float(n) >> 16) as usize),
        };
        Self {
            voxels,
            total: voxels.len() as u64,
            by_upper_key,
        }
    }

    /// Counts of the integers from `low` to `high`.
    fn of_integers(&self, low: f64, high: f64) -> Vec<u64> {
        let offset = self.integer_offset();
        let range = (low as i32 + offset) as usize..=(high as i32 + offset) as usize;
        self.by_upper_key.get(range).unwrap_or_default().to_vec()
    }

    /// Key of the integer 0.
    fn integer_offset(&self) -> i32 {
        match self.voxels {
            Voxels::I8(_) | Voxels::I16(_) => 32_768,
            _ => 0,
        }
    }

    fn stored(&self, key: Key) -> f64 {
        match self.voxels {
            Voxels::F32(_) => float_of_key(key).into(),
            _ => f64::from(key as i32 - self.integer_offset()),
        }
    }

    /// Counts of the keys whose upper half is this.
    fn by_lower_key(&self, upper: usize) -> Vec<u64> {
        match self.voxels {
            Voxels::F32(v) => count_some(v, KEYS, |n| {
                let key = key_of_float(n);
                ((key >> 16) as usize == upper).then_some((key & 0xffff) as usize)
            }),
            _ => vec![self.by_upper_key.get(upper).copied().unwrap_or(0)],
        }
    }

    fn key(&self, upper: usize, lower: usize) -> Key {
        match self.voxels {
            Voxels::F32(_) => (upper << 16 | lower) as Key,
            _ => upper as Key,
        }
    }

    fn upper(&self, key: Key) -> usize {
        match self.voxels {
            Voxels::F32(_) => (key >> 16) as usize,
            _ => key as usize,
        }
    }

    /// The stored numbers at two neighbouring ranks (0 is the smallest), some keys left out.
    fn stored_at_ranks(&self, first: u64, second: u64, without: &[(Key, u64)]) -> [f64; 2] {
        let mut found = [f64::NAN; 2];
        let mut before = 0;
        let last = self.by_upper_key.len() - 1;
        for (upper, &all) in self.by_upper_key.iter().enumerate() {
            let skipped = without.iter().filter(|spike| self.upper(spike.0) == upper);
            let here = all - skipped.map(|spike| spike.1).sum::<u64>();
            let holds = |rank: u64| (before..before + here).contains(&rank);
            if holds(first) || holds(second) {
                let mut rank = before;
                for (lower, &all) in self.by_lower_key(upper).iter().enumerate() {
                    let key = self.key(upper, lower);
                    let skipped = without.iter().any(|spike| spike.0 == key);
                    let here = if skipped { 0 } else { all };
                    for (found, wanted) in found.iter_mut().zip([first, second]) {
                        if (rank..rank + here).contains(&wanted) {
                            *found = self.stored(key);
                        }
                    }
                    rank += here;
                }
            }
            before += here;
            if before > second || upper == last {
                break;
            }
        }
        found
    }

    /// Single values that are far more frequent than their neighbours, with their counts.
    fn spikes(&self) -> Vec<(Key, u64)> {
        /// Of all voxels.
        const PART_MIN: f64 = 0.05;
        /// Times the mean count of the neighbours.
        const RATIO_MIN: f64 = 8.0;
        /// Neighbours on either side.
        const NEIGHBOURS: usize = 3;
        let frequent = |count: u64| count as f64 >= PART_MIN * self.total as f64;
        let mut spikes = Vec::new();
        for (upper, _) in (self.by_upper_key.iter().enumerate()).filter(|bin| frequent(*bin.1)) {
            if let Voxels::F32(_) = self.voxels {
                // Floats that aren't background hardly ever repeat.
                let lower = self.by_lower_key(upper);
                let keys = lower.iter().enumerate().filter(|bin| frequent(*bin.1));
                spikes.extend(keys.map(|(lower, &count)| (self.key(upper, lower), count)));
            } else {
                let count = self.by_upper_key[upper];
                let near = upper.saturating_sub(NEIGHBOURS)..=(upper + NEIGHBOURS).min(KEYS - 1);
                let around: u64 = self.by_upper_key[near].iter().sum::<u64>() - count;
                if count as f64 >= RATIO_MIN * around as f64 / (2 * NEIGHBOURS) as f64 {
                    spikes.push((self.key(upper, 0), count));
                }
            }
        }
        spikes
    }

    /// How many different values there are; for floats, at least.
    fn distinct_values(&self) -> usize {
        self.by_upper_key.iter().filter(|&&count| count > 0).count()
    }
}

/// Sorts like the float: negative ones have all bits turned, others the sign bit.
fn key_of_float(value: f32) -> Key {
    // -0 and 0 are one value.
    let bits = (value + 0.0).to_bits();
    if bits >> 31 == 1 {
        !bits
    } else {
        bits | 1 << 31
    }
}

fn float_of_key(key: Key) -> f32 {
    f32::from_bits(if key >> 31 == 1 {
        key & !(1 << 31)
    } else {
        !key
    })
}

fn count<T: Copy + Sync>(values: &[T], bins: usize, bin: impl Fn(T) -> usize + Sync) -> Vec<u64> {
    count_some(values, bins, |value| Some(bin(value)))
}

fn count_some<T: Copy + Sync>(
    values: &[T],
    bins: usize,
    bin: impl Fn(T) -> Option<usize> + Sync,
) -> Vec<u64> {
    let add = |mut counts: Vec<u64>, chunk: &[T]| {
        for bin in chunk.iter().filter_map(|&value| bin(value)) {
            counts[bin] += 1;
        }
        counts
    };
    let none = || vec![0u64; bins];
    // A table per thread costs more than a small volume.
    if values.len() <= CHUNK {
        return add(none(), values);
    }
    let pieces = values.par_chunks(CHUNK).fold(none, add);
    pieces.reduce(none, |mut a, b| {
        for (a, b) in a.iter_mut().zip(b) {
            *a += b;
        }
        a
    })
}

/// Sum in f64, chunk by chunk so that it doesn't hang on the number of threads.
fn sum<T: Copy + Sync + Into<f64>>(values: &[T]) -> f64 {
    let chunks: Vec<f64> = values
        .par_chunks(CHUNK)
        .map(|chunk| chunk.iter().map(|&value| value.into()).sum())
        .collect();
    chunks.iter().sum()
}
