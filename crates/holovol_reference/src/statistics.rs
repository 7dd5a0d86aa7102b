//! Whether two pictures differ by more than chance.
//!
//! Both sides are [`BlockStatistics`]: means of 16×16 blocks, how far those may be off, and how
//! well that is known. [`agreement`] makes one p-value of all blocks; for a suite of n scenes,
//! demand p ≥ 1e-6/n. Nothing is tuned by hand: Student's t takes account of variances that were
//! estimated from few seeds, and blocks that too few samples reached are tested together.

use crate::measures::{BLOCK, RELMSE_OFFSET, SizeMismatch};
use crate::special::{MAX_Z, chi_square_p, normal_z, student_t_p};
use crate::{Film, Image};

/// Pictures are stored and summed in f32: differences below this share of a value are rounding.
const ROUNDING: f64 = 1e-5;

/// Means of blocks with fewer events than this (paths that met the volume) are not normal.
const MIN_EVENTS: f64 = 200.0;

/// Block means of a picture and their uncertainty.
#[derive(Clone, Debug)]
pub struct BlockStatistics {
    size: [u32; 2],
    /// Per block, row-major; R, G, B, opacity.
    blocks: Vec<Block>,
    /// Variance of every pixel's mean, the shape of the noise.
    pixel_variances: Vec<[f64; 4]>,
    /// Samples per pixel; infinite where unknown.
    samples: f64,
}

/// One block of 16×16 pixels (fewer at the right and lower border).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Block {
    /// Mean: R, G, B, opacity.
    pub mean: [f64; 4],
    /// Variance of `mean`.
    pub variance: [f64; 4],
    /// Degrees of freedom that `variance` was estimated with.
    pub dof: [f64; 4],
    /// Pixels in the block.
    pub pixels: usize,
}

/// The verdict of [`agreement`].
#[derive(Clone, Debug)]
pub struct Agreement {
    /// Chance of differences at least as large if both pictures have the same expectation; all
    /// tests and channels are allowed for.
    pub p_value: f64,
    /// Largest |z| of any block and channel.
    pub max_z: f64,
    /// Block (column, row) and channel (R, G, B, opacity) it is found at; a column past the last
    /// stands for all blocks that were tested together.
    pub worst: ([u32; 2], usize),
    /// Mean of z² over the blocks, per channel: 1 by chance, more where blocks differ.
    pub mean_square_z: [f64; 4],
    /// z of the whole picture's mean, per channel; 0 if too few paths meet the volume.
    pub mean_z: [f64; 4],
    /// Tests made of blocks: one by one, those that few paths meet together. 0 if nothing could be
    /// tested.
    pub blocks: usize,
}

impl Agreement {
    /// Whether the pictures agree: p-value not below `p`.
    pub fn holds(&self, p: f64) -> bool {
        self.p_value >= p
    }
}

impl std::fmt::Display for Agreement {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let ([x, y], channel) = self.worst;
        write!(
            f,
            "p = {:.3e}; largest |z| {:.2} in block ({x}, {y}) channel {}; mean z² {:.2?} over {} blocks; z of the mean {:.2?}",
            self.p_value,
            self.max_z,
            "RGBA".as_bytes()[channel] as char,
            self.mean_square_z,
            self.blocks,
            self.mean_z
        )
    }
}

fn blocks_across(width: u32) -> u32 {
    width.div_ceil(BLOCK)
}

/// Sums a per-pixel quantity over each block: sums and numbers of pixels, row-major.
fn block_sums(
    [width, height]: [u32; 2],
    pixels: impl Iterator<Item = [f64; 4]>,
) -> Vec<([f64; 4], usize)> {
    let across = blocks_across(width) as usize;
    let mut sums = vec![([0.0; 4], 0); across * blocks_across(height) as usize];
    for (index, pixel) in pixels.enumerate() {
        let [x, y] = [index % width as usize, index / width as usize];
        let (sum, count) = &mut sums[x / BLOCK as usize + across * (y / BLOCK as usize)];
        for channel in 0..4 {
            sum[channel] += pixel[channel];
        }
        *count += 1;
    }
    sums
}

/// Means of 16×16 blocks, row-major: R, G, B, opacity.
pub fn block_means(image: &Image) -> Vec<[f64; 4]> {
    let pixels = image.pixels().iter().map(|pixel| pixel.map(f64::from));
    block_sums([image.width(), image.height()], pixels)
        .into_iter()
        .map(|(sum, count)| sum.map(|s| s / count as f64))
        .collect()
}

impl BlockStatistics {
    /// Of a film, whose samples and pixels are independent.
    pub fn from_film(film: &Film) -> Self {
        let size = [film.width(), film.height()];
        let pixel_variances: Vec<[f64; 4]> = film.variances().collect();
        let means = block_sums(size, film.means());
        let variances = block_sums(size, pixel_variances.iter().copied());
        let squares = block_sums(size, pixel_variances.iter().map(|v| v.map(|v| v * v)));
        let blocks = means.iter().zip(&variances).zip(&squares);
        let blocks = blocks.map(|(((mean, pixels), (variance, _)), (square, _))| {
            let n = *pixels as f64;
            Block {
                mean: mean.map(|sum| sum / n),
                variance: variance.map(|sum| sum / (n * n)),
                // As if each pixel's variance were as uncertain as it is large: heavy tails.
                dof: std::array::from_fn(|c| {
                    if square[c] > 0.0 {
                        2.0 * variance[c] * variance[c] / square[c]
                    } else {
                        f64::INFINITY
                    }
                }),
                pixels: *pixels,
            }
        });
        Self {
            size,
            blocks: blocks.collect(),
            samples: film.samples() as f64,
            pixel_variances,
        }
    }

    /// Of pictures of one scene with different seeds, `spp` samples per pixel each. Samples and
    /// pixels of one picture may depend on each other (low-discrepancy or blue-noise sampling).
    ///
    /// # Errors
    /// If the sizes differ.
    ///
    /// # Panics
    /// If there are fewer than two pictures.
    pub fn from_seeds(images: &[Image], spp: u64) -> Result<Self, SizeMismatch> {
        assert!(images.len() >= 2, "a variance needs two pictures");
        let size = [images[0].width(), images[0].height()];
        for image in images {
            let other = [image.width(), image.height()];
            if other != size {
                return Err(SizeMismatch { a: size, b: other });
            }
        }
        let n = images.len() as f64;
        // Mean of one channel over the pictures, and the variance of that mean.
        let moments = |values: &dyn Fn(usize) -> f64| {
            let all = || (0..images.len()).map(values);
            let mean = all().sum::<f64>() / n;
            let squares: f64 = all().map(|v| (v - mean) * (v - mean)).sum();
            (mean, squares / (n * (n - 1.0)))
        };
        let pixel_variances = (0..images[0].pixels().len())
            .map(|i| std::array::from_fn(|c| moments(&|seed| images[seed].pixels()[i][c].into()).1))
            .collect();
        let means: Vec<Vec<[f64; 4]>> = images.iter().map(block_means).collect();
        let counts = block_sums(size, images[0].pixels().iter().map(|_| [0.0; 4]));
        let blocks = counts.iter().enumerate().map(|(i, (_, pixels))| {
            let channels: [(f64, f64); 4] =
                std::array::from_fn(|c| moments(&|seed| means[seed][i][c]));
            Block {
                mean: channels.map(|(mean, _)| mean),
                variance: channels.map(|(_, variance)| variance),
                dof: [n - 1.0; 4],
                pixels: *pixels,
            }
        });
        Ok(Self {
            size,
            blocks: blocks.collect(),
            samples: n * spp as f64,
            pixel_variances,
        })
    }

    /// Of a stored reference that says of its noise only its relMSE (`floor`) and its samples per
    /// pixel. Where the noise sits is taken from `shape`, statistics of the same scene.
    ///
    /// # Errors
    /// If the sizes differ.
    pub fn from_reference(
        reference: &Image,
        floor: f64,
        spp: u64,
        shape: &Self,
    ) -> Result<Self, SizeMismatch> {
        let size = [reference.width(), reference.height()];
        if size != shape.size {
            return Err(SizeMismatch {
                a: shape.size,
                b: size,
            });
        }
        // The relMSE that noise of this shape has, and from it the factor to the reference's own.
        let pairs = shape.pixel_variances.iter().zip(reference.pixels());
        let sum: f64 = pairs
            .map(|(variance, pixel)| {
                (0..3)
                    .map(|c| variance[c] / (f64::from(pixel[c]).powi(2) + RELMSE_OFFSET))
                    .sum::<f64>()
            })
            .sum();
        let own = sum / (3 * reference.pixels().len()) as f64;
        let scale = if own > 0.0 { floor / own } else { 0.0 };
        let pixel_variances: Vec<[f64; 4]> = shape
            .pixel_variances
            .iter()
            .map(|variance| variance.map(|v| v * scale))
            .collect();
        let means = block_means(reference);
        let variances = block_sums(size, pixel_variances.iter().copied());
        let blocks = means
            .iter()
            .zip(variances)
            .map(|(mean, (sum, pixels))| Block {
                mean: *mean,
                variance: sum.map(|v| v / (pixels * pixels) as f64),
                dof: [f64::INFINITY; 4],
                pixels,
            });
        Ok(Self {
            size,
            blocks: blocks.collect(),
            pixel_variances,
            samples: spp as f64,
        })
    }

    /// All blocks, row-major.
    pub fn blocks(&self) -> &[Block] {
        &self.blocks
    }
}

/// How many events of the rarer kind the less sampled of two pictures can be expected to have in
/// a block: paths that met the volume, for opacity also paths that missed it.
fn rare_events(a: &Block, b: &Block, samples: f64, channel: usize) -> f64 {
    let [a, b, paths] = [a.mean[3], b.mean[3], samples * a.pixels as f64];
    let hits = a.max(b) * paths;
    if channel == 3 {
        hits.min((1.0 - a.min(b)) * paths)
    } else {
        hits
    }
}

/// Averages blocks, weighted by their pixels.
fn merge(blocks: impl Iterator<Item = Block>) -> Block {
    let mut sum = Block::default();
    // Of squared variances over their degrees of freedom (Welch and Satterthwaite).
    let mut spread = [0.0; 4];
    for block in blocks {
        let n = block.pixels as f64;
        sum.pixels += block.pixels;
        for (c, spread) in spread.iter_mut().enumerate() {
            let variance = n * n * block.variance[c];
            sum.mean[c] += n * block.mean[c];
            sum.variance[c] += variance;
            *spread += variance * variance / block.dof[c];
        }
    }
    let n = (sum.pixels as f64).max(1.0);
    sum.dof = std::array::from_fn(|c| degrees_of_freedom(sum.variance[c], spread[c]));
    sum.mean = sum.mean.map(|mean| mean / n);
    sum.variance = sum.variance.map(|variance| variance / (n * n));
    sum
}

fn degrees_of_freedom(variance: f64, spread: f64) -> f64 {
    if spread > 0.0 {
        variance * variance / spread
    } else {
        f64::INFINITY
    }
}

/// How unlikely a difference is.
#[derive(Clone, Copy)]
struct Score {
    /// Two-sided.
    p: f64,
    /// The standard normal's value of the same p, with the difference's sign.
    z: f64,
}

/// Scores the difference of two blocks, per channel, by Welch's t-test.
fn difference(a: &Block, b: &Block) -> [Score; 4] {
    std::array::from_fn(|c| {
        let difference = a.mean[c] - b.mean[c];
        if difference == 0.0 {
            return Score { p: 1.0, z: 0.0 };
        }
        let rounding = ROUNDING * a.mean[c].abs().max(b.mean[c].abs());
        let variance = a.variance[c] + b.variance[c] + rounding * rounding;
        if !(difference.is_finite() && variance.is_finite()) {
            return Score { p: 0.0, z: MAX_Z };
        }
        let spread = a.variance[c].powi(2) / a.dof[c] + b.variance[c].powi(2) / b.dof[c];
        let p = student_t_p(
            difference / variance.sqrt(),
            degrees_of_freedom(variance, spread),
        );
        Score {
            p,
            z: normal_z(p).copysign(difference),
        }
    })
}

/// Scores of all blocks in one channel, those that few paths meet taken together.
fn block_scores(
    a: &BlockStatistics,
    b: &BlockStatistics,
    channel: usize,
) -> (Vec<([u32; 2], Score)>, Option<Score>) {
    let across = blocks_across(a.size[0]);
    let samples = a.samples.min(b.samples);
    let mut scores = Vec::new();
    let mut rest = [Vec::new(), Vec::new()];
    let (mut rest_events, mut all_events) = (0.0, 0.0);
    for (index, (x, y)) in (0u32..).zip(a.blocks.iter().zip(&b.blocks)) {
        let events = rare_events(x, y, samples, channel);
        all_events += events;
        if events >= MIN_EVENTS {
            let place = [index % across, index / across];
            scores.push((place, difference(x, y)[channel]));
        } else {
            rest[0].push(*x);
            rest[1].push(*y);
            rest_events += events;
        }
    }
    if rest_events >= MIN_EVENTS {
        let [x, y] = rest.map(|blocks| merge(blocks.into_iter()));
        scores.push(([across, 0], difference(&x, &y)[channel]));
    }
    let whole = (all_events >= MIN_EVENTS).then(|| {
        let [x, y] = [a, b].map(|side| merge(side.blocks.iter().copied()));
        difference(&x, &y)[channel]
    });
    (scores, whole)
}

/// Tests whether two pictures have the same expectation: by the worst block, by all blocks
/// together (chi-square of z-scores), and by the whole pictures' means.
///
/// # Errors
/// If the sizes differ.
pub fn agreement(a: &BlockStatistics, b: &BlockStatistics) -> Result<Agreement, SizeMismatch> {
    if a.size != b.size {
        return Err(SizeMismatch {
            a: a.size,
            b: b.size,
        });
    }
    let mut result = Agreement {
        p_value: 1.0,
        max_z: 0.0,
        worst: ([0, 0], 0),
        mean_square_z: [0.0; 4],
        mean_z: [0.0; 4],
        blocks: 0,
    };
    let (mut p_worst, mut p_all, mut p_mean) = (1.0f64, 1.0f64, 1.0f64);
    let mut tests = 0;
    for channel in 0..4 {
        let (scores, whole) = block_scores(a, b, channel);
        if let Some(whole) = whole {
            p_mean = p_mean.min(whole.p);
            result.mean_z[channel] = whole.z;
        }
        if scores.is_empty() {
            continue;
        }
        let mut sum = 0.0;
        for (place, score) in &scores {
            p_worst = p_worst.min(score.p);
            sum += score.z * score.z;
            if score.z.abs() > result.max_z {
                result.max_z = score.z.abs();
                result.worst = (*place, channel);
            }
        }
        let count = scores.len() as f64;
        result.mean_square_z[channel] = sum / count;
        result.blocks = result.blocks.max(scores.len());
        p_all = p_all.min(chi_square_p(sum, count));
        tests += scores.len();
    }
    // Bonferroni over blocks and channels, then over the three kinds of test.
    let p_worst = p_worst * tests.max(1) as f64;
    result.p_value = (3.0 * p_worst.min(4.0 * p_all).min(4.0 * p_mean)).min(1.0);
    Ok(result)
}
