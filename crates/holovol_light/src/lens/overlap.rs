//! Calibration from what both lenses see: rotation, centres and field of view are refined until
//! the overlap agrees.

use std::f64::consts::TAU;

use glam::{DMat3, DQuat, DVec3};

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
    /// Correlation of both lenses' detail in the overlap after it: 1 is the same, 0 unrelated.
    pub agreement: f64,
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
/// Smoothing of the detail by which a result is judged, coarse enough that what stands near one
/// lens is not lost by parallax.
const DETAIL: usize = 12;
/// Sectors of the ring of overlap in each of which a plane is no detail.
const SECTORS: usize = 24;
/// Correlation of the detail below which nothing was found. Twelve panoramas through a tilted
/// camera reach 0.73 and more (in rooms down to 1 m from wall to camera), pictures of different
/// places 0.29 at most.
const LEAST_AGREEMENT: f64 = 0.5;
/// Standard deviation of the detail, of ln radiance, that is no more than noise.
const LEAST_CONTRAST: f64 = 0.01;
/// Weight of these expectations against the mean squared difference.
const EXPECTED_WEIGHT: f64 = 1e-3;

/// Refines rotation of the second lens against the first, both centres, and the common focal
/// length on one stitched pair, by the intensities of the overlap (Gauss–Newton with numeric
/// derivatives, coarse to fine).
///
/// Only what the overlap determines moves: a common shift along the seam's axis is left alone.
///
/// # Errors
/// If sizes differ from the calibration's, the lenses don't overlap, or nothing in the overlap
/// tells the pose: both pictures are the same, without detail, or their detail doesn't agree
/// (correlation below 0.5).
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
    if is_one_picture(&blurred(calibration, pair, &table[1], SCALES[2])) {
        return Err(CalibrationError::Overlap(
            "both lenses have the same picture, which tells nothing of the pose; expected one of each lens, taken at once".into(),
        ));
    }
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
        let pictures = blurred(calibration, pair, &table[1], scale);
        let residuals = |p: &[f64; PARAMETERS]| residuals(&moved(calibration, p), &pictures);
        let mut damping = 1e-3;
        let mut best = residuals(&parameters);
        if best.1 < FEWEST {
            return Err(CalibrationError::Overlap(format!(
                "the lenses see only {} of {SAMPLES} directions in common, too few to compare; expected lenses that each see more than half of the sphere: a field of view of 182° and more (fov_deg, or --fov without a file), all of it on the picture",
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
    let agreement = agreement(&calibration, pair, &table[1]);
    if agreement < LEAST_AGREEMENT {
        return Err(CalibrationError::Overlap(format!(
            "nothing in the overlap tells the pose: both pictures' detail agrees there to {agreement:.2} (1 is the same, 0 unrelated), expected {LEAST_AGREEMENT} and more; take both at once, of a place with something to see all around the seam, and start from about the right field of view and poses"
        )));
    }
    Ok(Refined {
        agreement,
        calibration,
        disagreement: [first.unwrap_or(0.0).sqrt(), last.0.sqrt()],
        compared: last.1,
    })
}

/// Both pictures, smoothed.
fn blurred(
    calibration: &Calibration,
    pair: &FisheyePair,
    table: &[f32; 256],
    scale: usize,
) -> [Blurred; 2] {
    std::array::from_fn(|l| {
        let lens = &calibration.lenses[l];
        let radius = (scale * lens.size[0]).div_ceil(2000).max(1);
        let circle = (lens.projection.centre(), edge_radius(lens) - 1.0);
        Blurred::new(pair.pictures[l], lens.size, table, radius, circle)
    })
}

/// Correlation of what both lenses see in the overlap, less what any two pictures of a bright sky
/// over a dark ground, and any two lenses that darken toward their edge, have in common: the plane
/// that fits each sector of the ring of overlap. 0 where there is no contrast.
fn agreement(calibration: &Calibration, pair: &FisheyePair, table: &[f32; 256]) -> f64 {
    let pictures = blurred(calibration, pair, table, DETAIL);
    let rotations = calibration.lenses.each_ref().map(|lens| lens.rotation());
    let mut sectors = vec![Vec::new(); SECTORS];
    for direction in crate::measure::normals(SAMPLES) {
        let values = [0, 1].map(|l| {
            let local = to_lens(rotations[l], direction);
            let pixel = calibration.lenses[l].projection.project(local)?;
            pictures[l].at(pixel.x, pixel.y)
        });
        if let [Some(a), Some(b)] = values {
            let local = to_lens(rotations[0], direction);
            let turn = (local.y.atan2(local.x) / TAU + 0.5) * SECTORS as f64;
            let sector = (turn as usize).min(SECTORS - 1);
            // Place in the sector: along the ring, across it.
            let place = DVec3::new(1.0, turn - sector as f64 - 0.5, local.z);
            sectors[sector].push((place, [a, b]));
        }
    }
    let (mut squares, mut product, mut count) = ([0.0; 2], 0.0, 0.0);
    for sector in &sectors {
        let mut matrix = DMat3::ZERO;
        let mut right = [DVec3::ZERO; 2];
        for &(place, values) in sector {
            matrix += DMat3::from_cols(place * place.x, place * place.y, place * place.z);
            right = [0, 1].map(|l| right[l] + place * values[l]);
        }
        // A sector of a few places has no detail.
        if matrix.determinant() < 1e-6 {
            continue;
        }
        let planes = right.map(|right| matrix.inverse() * right);
        for &(place, values) in sector {
            let [a, b] = [0, 1].map(|l| values[l] - planes[l].dot(place));
            squares = [squares[0] + a * a, squares[1] + b * b];
            product += a * b;
            count += 1.0;
        }
    }
    if squares[0].min(squares[1]) <= count * LEAST_CONTRAST * LEAST_CONTRAST {
        return 0.0;
    }
    product / (squares[0] * squares[1]).sqrt()
}

/// Whether both lenses have one image circle of one picture, if perhaps coded twice: it can agree
/// with itself, mirrored in the overlap, in a symmetric room.
fn is_one_picture([a, b]: &[Blurred; 2]) -> bool {
    if (a.width, a.height) != (b.width, b.height) {
        return false;
    }
    let inside = a.values.iter().filter(|value| value.is_finite()).count() as f64;
    // Variances of the picture and of its difference from the other, where the circles overlap.
    let (mut count, mut sums, mut squares) = (0.0, [0.0; 2], [0.0; 2]);
    for (&a, &b) in a.values.iter().zip(&b.values) {
        if a.is_finite() && b.is_finite() {
            count += 1.0;
            for (k, value) in [a, a - b].map(f64::from).into_iter().enumerate() {
                sums[k] += value;
                squares[k] += value * value;
            }
        }
    }
    let [spread, difference] = [0, 1].map(|k| squares[k] - sums[k] * sums[k] / count);
    let contrast = spread > count * LEAST_CONTRAST * LEAST_CONTRAST;
    count > 0.5 * inside && contrast && difference < 0.01 * spread
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
fn residuals(calibration: &Calibration, pictures: &[Blurred; 2]) -> (Vec<f64>, usize) {
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
