//! Calibration from what both lenses see: rotation, centres and field of view are refined until
//! the overlap agrees.

use glam::{DQuat, DVec3};

use super::calibration::to_lens;
use super::stitch::edge_radius;
use super::{Calibration, CalibrationError, FisheyePair, LensModel, Projection};

/// A refined calibration and what it gained.
#[derive(Clone, Debug)]
pub struct Refined {
    /// The better calibration.
    pub calibration: Calibration,
    /// Mean difference in the overlap before and after, in units of its standard deviation.
    pub disagreement: [f64; 2],
    /// Directions that were compared.
    pub compared: usize,
}

/// Directions over the sphere of which those in the overlap are compared.
const SAMPLES: usize = 60_000;
/// Smoothing of the pictures, finest last, in pixels at 1000 pixels of width: the search first
/// sees the coarse shapes only, so that it does not end in the wrong texture.
const SCALES: [usize; 3] = [12, 5, 2];
/// Fewer comparisons than this say nothing.
const FEWEST: usize = 200;
/// Parameters: a rotation vector and a centre per lens, and one factor on the focal lengths.
const PARAMETERS: usize = 8;
/// How far each is expected to be off: radians; pixels at 1000 pixels of width; log. In a ring of
/// overlap a turn looks much like a shift, and cameras turn more than they shift.
const EXPECTED: [f64; PARAMETERS] = [0.03, 0.03, 0.03, 1.0, 1.0, 1.0, 1.0, 0.01];
/// Weight of these expectations against the mean squared difference.
const EXPECTED_WEIGHT: f64 = 1e-3;

/// Refines rotation of the second lens against the first, both centres, and the common focal
/// length on one stitched pair, by the intensities of the overlap (Gauss–Newton with numeric
/// derivatives, coarse to fine).
///
/// Only what the overlap determines moves: a common shift along the seam's axis is left alone.
///
/// # Errors
/// If sizes differ from the calibration's, the lenses don't overlap, or the overlap has no
/// contrast.
pub fn refine(calibration: &Calibration, pair: &FisheyePair) -> Result<Refined, CalibrationError> {
    calibration.check()?;
    for lens in 0..2 {
        let [width, height] = calibration.lenses[lens].size;
        let found = pair.pictures[lens].len();
        if found != width * height {
            return Err(CalibrationError::Size {
                lens,
                expected: [width, height],
                found: [found, 1],
            });
        }
    }
    let table = calibration.response.table();
    let per_thousand = calibration.lenses[0].size[0] as f64 / 1000.0;
    let expected: [f64; PARAMETERS] = std::array::from_fn(|k| match k {
        3..7 => EXPECTED[k] * per_thousand,
        _ => EXPECTED[k],
    });
    let cost = |residuals: &[f64], p: &[f64; PARAMETERS]| {
        let off = p.iter().zip(expected).map(|(p, e)| (p / e).powi(2));
        mean_square(residuals) + EXPECTED_WEIGHT * off.sum::<f64>()
    };
    let mut parameters = [0.0; PARAMETERS];
    let mut first = None;
    let mut last = (0.0, 0);
    for scale in SCALES {
        let pictures: Vec<Blurred> = (0..2)
            .map(|lens| {
                let size = calibration.lenses[lens].size;
                let radius = (scale * size[0]).div_ceil(2000).max(1);
                let model = &calibration.lenses[lens].projection;
                let circle = (model.centre(), edge_radius(&calibration.lenses[lens]) - 1.0);
                Blurred::new(pair.pictures[lens], size, &table[1], radius, circle)
            })
            .collect();
        let residuals = |p: &[f64; PARAMETERS]| residuals(&moved(calibration, p), &pictures);
        let mut damping = 1e-3;
        let mut best = residuals(&parameters);
        if best.1 < FEWEST {
            return Err(CalibrationError::Overlap(format!(
                "the lenses share only {} of {SAMPLES} directions; expected a field of view above 182° in both",
                best.1
            )));
        }
        first.get_or_insert(mean_square(&best.0));
        for _ in 0..12 {
            let steps: [f64; PARAMETERS] = [1e-3, 1e-3, 1e-3, 0.5, 0.5, 0.5, 0.5, 1e-3];
            let columns: Vec<Vec<f64>> = (0..PARAMETERS)
                .map(|k| {
                    let (mut up, mut down) = (parameters, parameters);
                    up[k] += steps[k];
                    down[k] -= steps[k];
                    let (up, down) = (residuals(&up).0, residuals(&down).0);
                    let pairs = up.iter().zip(&down);
                    pairs.map(|(u, d)| (u - d) / (2.0 * steps[k])).collect()
                })
                .collect();
            let weights = expected.map(|e| EXPECTED_WEIGHT * best.0.len() as f64 / (e * e));
            let Some(step) = solve(&columns, &best.0, &parameters, &weights, damping) else {
                break;
            };
            let mut next = parameters;
            for k in 0..PARAMETERS {
                next[k] += step[k];
            }
            let found = residuals(&next);
            let gained = cost(&best.0, &parameters) - cost(&found.0, &next);
            if found.1 >= FEWEST && gained > 0.0 {
                parameters = next;
                best = found;
                damping *= 0.3;
                if gained < 1e-6 {
                    break;
                }
            } else {
                damping *= 8.0;
                if damping > 1e6 {
                    break;
                }
            }
        }
        last = (mean_square(&best.0), best.1);
    }
    let calibration = moved(calibration, &parameters);
    calibration.check()?;
    Ok(Refined {
        calibration,
        disagreement: [first.unwrap_or(0.0).sqrt(), last.0.sqrt()],
        compared: last.1,
    })
}

/// The calibration with its parameters changed.
fn moved(calibration: &Calibration, p: &[f64; PARAMETERS]) -> Calibration {
    let mut out = calibration.clone();
    let turn = DQuat::from_scaled_axis(DVec3::new(p[0], p[1], p[2]));
    let second = DQuat::from_array(out.lenses[1].lens_from_camera);
    out.lenses[1].lens_from_camera = (turn * second).normalize().to_array();
    for (lens, shift) in out.lenses.iter_mut().zip([[p[3], p[4]], [p[5], p[6]]]) {
        let factor = p[7].exp();
        match &mut lens.projection {
            LensModel::Equidistant { focal, centre, .. } => {
                *focal *= factor;
                centre[0] += shift[0];
                centre[1] += shift[1];
            }
            LensModel::KannalaBrandt { focal, centre, .. }
            | LensModel::Mei { focal, centre, .. } => {
                *focal = focal.map(|f| f * factor);
                centre[0] += shift[0];
                centre[1] += shift[1];
            }
            LensModel::OCam {
                polynomial, centre, ..
            } => {
                polynomial.iter_mut().for_each(|a| *a *= factor);
                centre[0] += shift[0];
                centre[1] += shift[1];
            }
        }
    }
    out
}

/// Differences of both lenses' log values over the overlap (0 where one does not see), each with
/// its mean taken off, so that gains don't matter; and how many there are.
fn residuals(calibration: &Calibration, pictures: &[Blurred]) -> (Vec<f64>, usize) {
    let rotations = calibration.lenses.each_ref().map(|lens| lens.rotation());
    let mut pairs = Vec::new();
    let mut mean = [0.0; 2];
    for direction in crate::measure::normals(SAMPLES) {
        // Only the band that both could see at all is looked at, whatever the parameters.
        let values: [Option<f64>; 2] = std::array::from_fn(|l| {
            let local = to_lens(rotations[l], direction);
            let pixel = calibration.lenses[l].projection.project(local)?;
            pictures[l].at(pixel.x, pixel.y)
        });
        let seen = match values {
            [Some(a), Some(b)] => {
                mean[0] += a;
                mean[1] += b;
                Some([a, b])
            }
            _ => None,
        };
        if to_lens(rotations[0], direction).z.abs() < 0.3 {
            pairs.push(seen);
        }
    }
    let count = pairs.iter().flatten().count();
    let mean = mean.map(|m| m / count.max(1) as f64);
    let variance = pairs.iter().flatten().map(|[a, _]| (a - mean[0]).powi(2));
    let spread = (variance.sum::<f64>() / count.max(1) as f64)
        .sqrt()
        .max(1e-3);
    let scale = 1.0 / spread;
    let differences = pairs.iter().map(|pair| match pair {
        Some([a, b]) => ((a - mean[0]) - (b - mean[1])) * scale,
        None => 0.0,
    });
    let normalise = (pairs.len() as f64 / count.max(1) as f64).sqrt();
    (differences.map(|d| d * normalise).collect(), count)
}

fn mean_square(values: &[f64]) -> f64 {
    values.iter().map(|v| v * v).sum::<f64>() / values.len().max(1) as f64
}

/// Levenberg–Marquardt step; `None` if singular.
fn solve(
    columns: &[Vec<f64>],
    residuals: &[f64],
    parameters: &[f64; PARAMETERS],
    weights: &[f64; PARAMETERS],
    damping: f64,
) -> Option<[f64; PARAMETERS]> {
    const N: usize = PARAMETERS;
    let mut a = [[0.0; N + 1]; N];
    for i in 0..N {
        for j in 0..N {
            a[i][j] = columns[i].iter().zip(&columns[j]).map(|(x, y)| x * y).sum();
        }
        a[i][N] = -columns[i]
            .iter()
            .zip(residuals)
            .map(|(x, r)| x * r)
            .sum::<f64>();
        a[i][i] += weights[i];
        a[i][N] -= weights[i] * parameters[i];
    }
    for (i, row) in a.iter_mut().enumerate() {
        row[i] = row[i] * (1.0 + damping) + 1e-9;
    }
    for i in 0..N {
        let pivot = (i..N).max_by(|&x, &y| a[x][i].abs().total_cmp(&a[y][i].abs()))?;
        a.swap(i, pivot);
        if a[i][i].abs() < 1e-12 || !a[i][i].is_finite() {
            return None;
        }
        for k in 0..N {
            if k != i {
                let factor = a[k][i] / a[i][i];
                for j in i..=N {
                    a[k][j] -= factor * a[i][j];
                }
            }
        }
    }
    Some(std::array::from_fn(|i| a[i][N] / a[i][i]))
}

/// A picture's log radiance, box-blurred twice; what lies outside the image circle is left out.
struct Blurred {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl Blurred {
    fn new(
        picture: &[[u8; 3]],
        [width, height]: [usize; 2],
        table: &[f32; 256],
        radius: usize,
        (centre, edge): (glam::DVec2, f64),
    ) -> Self {
        let inside = |i: usize| {
            let at = glam::DVec2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
            f32::from(u8::from((at - centre).length() <= edge))
        };
        let mut weights: Vec<f32> = (0..picture.len()).map(inside).collect();
        let log =
            |(pixel, weight): (&[u8; 3], &f32)| weight * (table[usize::from(pixel[1])] + 0.01).ln();
        let mut values: Vec<f32> = picture.iter().zip(&weights).map(log).collect();
        let mut line = Vec::new();
        for plane in [&mut values, &mut weights] {
            for _ in 0..2 {
                for y in 0..height {
                    box_blur(plane, y * width, 1, width, radius, &mut line);
                }
                for x in 0..width {
                    box_blur(plane, x, width, height, radius, &mut line);
                }
            }
        }
        for (value, weight) in values.iter_mut().zip(&weights) {
            *value = if *weight > 0.05 {
                *value / weight
            } else {
                f32::NAN
            };
        }
        Self {
            width,
            height,
            values,
        }
    }

    /// Bilinear value; `None` outside.
    fn at(&self, x: f64, y: f64) -> Option<f64> {
        let (x, y) = (x - 0.5, y - 0.5);
        if !(x >= 0.0 && y >= 0.0 && x < self.width as f64 - 1.0 && y < self.height as f64 - 1.0) {
            return None;
        }
        let i = x as usize + self.width * y as usize;
        let (fx, fy) = (x.fract(), y.fract());
        let v = |i: usize| f64::from(self.values[i]);
        let top = v(i) + fx * (v(i + 1) - v(i));
        let bottom = v(i + self.width) + fx * (v(i + self.width + 1) - v(i + self.width));
        Some(top + fy * (bottom - top)).filter(|value| value.is_finite())
    }
}

/// Means over 2·radius + 1 values along a line of a picture, cut at its ends.
fn box_blur(
    values: &mut [f32],
    start: usize,
    stride: usize,
    len: usize,
    radius: usize,
    line: &mut Vec<f32>,
) {
    line.clear();
    line.extend((0..len).map(|i| values[start + i * stride]));
    let mut sum: f64 = line[..radius.min(len)].iter().map(|&v| f64::from(v)).sum();
    let mut count = radius.min(len);
    for i in 0..len {
        if i + radius < len {
            sum += f64::from(line[i + radius]);
            count += 1;
        }
        if i > radius {
            sum -= f64::from(line[i - radius - 1]);
            count -= 1;
        }
        values[start + i * stride] = (sum / count as f64) as f32;
    }
}
