use std::f64::consts::PI;

use rayon::prelude::*;

use crate::EnvironmentMap;

/// One slot of Walker's alias method: keep the slot's own outcome below `threshold`, else `alias`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AliasEntry {
    /// Probability of the slot's own outcome.
    pub threshold: f32,
    /// The other outcome.
    pub alias: u32,
}

/// What the density of light samples is proportional to: the mean of R, G and B.
///
/// All channels' errors count alike, and a red sun must not starve the blue of the sky, as
/// luminance would have it: on a strongly coloured sunrise this saves a tenth of the variance.
#[inline]
pub fn importance(rgb: [f64; 3]) -> f64 {
    (rgb[0] + rgb[1] + rgb[2]) / 3.0
}

/// Draws directions with a density proportional to the [`importance`] of the bilinear map.
///
/// The map is cut into patches between texel centres: W across, H + 1 down, the first and last
/// row being half patches at the poles. The alias table chooses a patch by its integral of
/// importance · sin θ, with sin θ averaged over the patch; within a patch, bilinear importance is
/// inverted. So the density at (u, v) is `importance · strip_sine · normalisation`, bounded by the
/// light itself however small its sources are. Build: O(patches), about 10 ms for 1024 × 512.
#[derive(Clone, Debug)]
pub struct EnvironmentSampler {
    entries: Vec<AliasEntry>,
    normalisation: f64,
}

impl EnvironmentSampler {
    /// Builds the table of a map; `None` if the map is black.
    pub fn new(map: &EnvironmentMap) -> Option<Self> {
        let (width, height) = (map.width(), map.height());
        let importances: Vec<f64> = map
            .texels()
            .par_iter()
            .map(|texel| importance(texel.map(f64::from)))
            .collect();
        let row = |j: i64| {
            let j = j.clamp(0, height as i64 - 1) as usize;
            &importances[j * width..(j + 1) * width]
        };
        let weights: Vec<f64> = (0..=height)
            .into_par_iter()
            .flat_map_iter(|strip| {
                let (top, bottom) = (row(strip as i64 - 1), row(strip as i64));
                let (v0, v1) = strip_bounds(strip, height);
                let area = (v1 - v0) / width as f64;
                let factor = 0.25 * area * strip_sine(strip, height);
                (0..width).map(move |i| {
                    let next = (i + 1) % width;
                    factor * (top[i] + top[next] + bottom[i] + bottom[next])
                })
            })
            .collect();
        let total: f64 = weights.iter().sum();
        (total > 0.0 && total.is_finite()).then(|| Self {
            entries: alias_table(&weights, total),
            normalisation: 1.0 / total,
        })
    }

    /// The alias table, one entry per patch, row by row from the +y pole.
    pub fn entries(&self) -> &[AliasEntry] {
        &self.entries
    }

    /// 1 / ∫ importance · strip_sine du dv.
    pub fn normalisation(&self) -> f64 {
        self.normalisation
    }
}

/// v at which strip `strip` of `height + 1` begins and ends.
fn strip_bounds(strip: usize, height: usize) -> (f64, f64) {
    let v = |edge: f64| (edge / height as f64).clamp(0.0, 1.0);
    (v(strip as f64 - 0.5), v(strip as f64 + 0.5))
}

/// Mean of sin θ over a strip.
fn strip_sine(strip: usize, height: usize) -> f64 {
    let (v0, v1) = strip_bounds(strip, height);
    let half_width = 0.5 * PI * (v1 - v0);
    (0.5 * PI * (v0 + v1)).sin() * half_width.sin() / half_width
}

/// Walker's method in Vose's order: O(n), exact up to the rounding of the thresholds.
fn alias_table(weights: &[f64], total: f64) -> Vec<AliasEntry> {
    let scale = weights.len() as f64 / total;
    let mut probability: Vec<f64> = weights.iter().map(|weight| weight * scale).collect();
    let mut entries: Vec<AliasEntry> = (0..weights.len() as u32)
        .map(|alias| AliasEntry {
            threshold: 1.0,
            alias,
        })
        .collect();
    let (mut small, mut large): (Vec<usize>, Vec<usize>) =
        (0..weights.len()).partition(|&i| probability[i] < 1.0);
    while let (Some(&low), Some(&high)) = (small.last(), large.last()) {
        small.pop();
        entries[low] = AliasEntry {
            threshold: probability[low] as f32,
            alias: high as u32,
        };
        probability[high] -= 1.0 - probability[low];
        if probability[high] < 1.0 {
            large.pop();
            small.push(high);
        }
    }
    // What is left in `small` is 1 but for rounding, unless it can't be drawn at all.
    for i in small {
        if weights[i] == 0.0 {
            entries[i] = AliasEntry {
                threshold: 0.0,
                alias: large.first().map_or(i, |&h| h) as u32,
            };
        }
    }
    entries
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn alias_table_keeps_every_weight() {
        // One light far above the rest, and many alike.
        for brightest in [1e9, 4.0] {
            let weights = [0.0, 3.0, brightest, 2.0, 0.5, 0.0, 7.0];
            let total: f64 = weights.iter().sum();
            let entries = alias_table(&weights, total);
            let mut drawn = [0.0; 7];
            for (i, entry) in entries.iter().enumerate() {
                drawn[i] += f64::from(entry.threshold) / 7.0;
                drawn[entry.alias as usize] += (1.0 - f64::from(entry.threshold)) / 7.0;
            }
            for (weight, drawn) in weights.iter().zip(drawn) {
                assert!((weight / total - drawn).abs() < 1e-7, "{weight}: {drawn}");
            }
        }
    }

    #[test]
    fn strips_cover_the_sphere() {
        for height in [1, 2, 7, 512] {
            let integral: f64 = (0..=height)
                .map(|strip| {
                    let (v0, v1) = strip_bounds(strip, height);
                    (v1 - v0) * strip_sine(strip, height)
                })
                .sum();
            assert!((integral - 2.0 / PI).abs() < 1e-12, "{height}: {integral}");
        }
    }

    #[test]
    fn black_maps_have_no_sampler() {
        assert!(EnvironmentSampler::new(&EnvironmentMap::constant([0.0; 3])).is_none());
    }
}
