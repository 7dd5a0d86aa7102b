//! Two fisheye pictures to a linear panorama, through a table that is built once.

use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;

use super::calibration::to_lens;
use super::{Calibration, CalibrationError, Projection};
use crate::Grid;

/// Widest feather on either side of the seam, radians.
const FEATHER: f64 = 6.0 / 180.0 * std::f64::consts::PI;
/// The outermost part of a lens that is not used: its edge is dark and blurred, radians.
const EDGE: f64 = 1.0 / 180.0 * std::f64::consts::PI;
/// Weight of a lens's own nominal gain against the overlap's ratio (Brown and Lowe 2007, eq. 29).
const GAIN_SIGMA: f64 = 0.1;
/// Spread of the overlap's radiance that is not the gain's.
const OVERLAP_SIGMA: f64 = 0.04;
/// Directions over the whole sphere of which those in the overlap are compared.
const OVERLAP_SAMPLES: usize = 20_000;
/// A texel of which this share of pixels clips is clipped.
const CLIPPED_SHARE: f32 = 0.33;
/// Eight places in a texel, no two in one of its eight columns or rows: nearly as good against
/// aliasing as 4 × 4, for half of the time.
const ROOKS: [[f64; 2]; 8] = [
    [0.0, 3.0],
    [1.0, 6.0],
    [2.0, 1.0],
    [3.0, 4.0],
    [4.0, 7.0],
    [5.0, 2.0],
    [6.0, 5.0],
    [7.0, 0.0],
];
/// Counts clipped pixels in the same sum as their light, which stays far below it.
const FLAG: f32 = 64.0;
/// Codes from here on are clipped: a video coder's ringing takes some of what is.
const CLIPPED_CODE: u8 = 249;
/// Share of a new frame's gain that is taken over at once.
const GAIN_RATE: f32 = 0.1;

/// The pictures of both lenses: row-major 8-bit RGB of the calibrated sizes.
#[derive(Clone, Copy, Debug)]
pub struct FisheyePair<'a> {
    /// In the order of the calibration.
    pub pictures: [&'a [[u8; 3]]; 2],
}

/// Where a direction is found in one lens's picture.
#[derive(Clone, Copy, Debug, Default)]
struct Tap {
    /// Index of the upper left of four pixels.
    index: u32,
    /// Bilinear weights in 1/256: across, down.
    fraction: [u8; 2],
    /// What corrects vignetting and the lens's nominal gain.
    weight: f32,
}

/// What one lens gives to a texel of the panorama.
#[derive(Clone, Copy, Debug)]
struct Part {
    /// Column of the texel.
    column: u16,
    lens: u8,
    /// Bilinear fractions, where the picture is not finer than the panorama.
    fraction: [u8; 2],
    /// Blend weight × correction of vignetting and nominal gain, over the number of pixels.
    weight: f32,
    /// Blend weight alone: what a clipped part gives at least, whatever its gain.
    blend: f32,
}

/// A row of the panorama: its parts, and for each of them `per_part` indices of pixels.
#[derive(Clone, Debug, Default)]
struct Row {
    parts: Vec<Part>,
    pixels: Vec<u32>,
}

/// The middles of the cells that a texel is cut into.
fn places(columns: usize, rows: usize) -> Vec<[f64; 2]> {
    let middle = |i: usize, n: usize| (i as f64 + 0.5) / n as f64;
    (0..columns * rows)
        .map(|i| [middle(i % columns, columns), middle(i / columns, rows)])
        .collect()
}

/// Turns pairs of fisheye pictures into linear panoramas.
///
/// When a panorama's texel covers more than a pixel of the picture, it averages 4, 8 or 9 pixels
/// spread over it, so that shrinking up to 1 : 5 or so does not alias; otherwise it interpolates.
/// Its table has 4 bytes per pixel that is looked at: 5 MB for 512 × 256 from 1440² pictures.
#[derive(Clone, Debug)]
pub struct Stitcher {
    width: usize,
    height: usize,
    /// Strides of the two pictures.
    strides: [usize; 2],
    lengths: [usize; 2],
    rows: Vec<Row>,
    unseen: f64,
    per_part: usize,
    /// Directions that both lenses see well, for the gains: a tap in each, with weights that
    /// correct vignetting only.
    overlap: Vec<[Tap; 2]>,
    table: [[f32; 256]; 3],
    /// The table with [`FLAG`] on the codes that are clipped.
    flagged: [[f32; 256]; 3],
    gains: [f32; 2],
    started: bool,
}

impl Stitcher {
    /// Builds the table for panoramas of `width` × `height` (at most 65,535 across), turned by
    /// `world_from_camera`.
    ///
    /// # Errors
    /// If the calibration is impossible, its lenses see nothing, or the panorama is too wide.
    pub fn new(
        calibration: &Calibration,
        width: usize,
        height: usize,
        world_from_camera: DMat3,
    ) -> Result<Self, CalibrationError> {
        calibration.check()?;
        if width > usize::from(u16::MAX) {
            return Err(CalibrationError::Overlap(format!(
                "a panorama of {width} pixels across, expected at most {}",
                u16::MAX
            )));
        }
        let grid = Grid::new(width.max(1), height.max(1));
        let camera_from_world = world_from_camera.transpose();
        let rotations = calibration.lenses.each_ref().map(|lens| lens.rotation());
        let axes = calibration.axes();
        let reach = calibration
            .lenses
            .each_ref()
            .map(|lens| lens.projection.max_angle() - EDGE);
        let edges = calibration.lenses.each_ref().map(edge_radius);
        // How many pixels a texel covers decides how many of them it looks at.
        let texel = std::f64::consts::PI / grid.height() as f64;
        let density = (0..2)
            .map(|l| edges[l] / calibration.lenses[l].projection.max_angle() * texel)
            .fold(0.0, f64::max);
        let places = match density {
            d if d < 1.5 => places(1, 1),
            d if d < 2.6 => places(2, 2),
            d if d < 3.6 => places(3, 3),
            _ => ROOKS.map(|place| place.map(|i| (i + 0.5) / 8.0)).to_vec(),
        };
        let per_part = places.len();
        let build = |y: usize| {
            let mut row = Row::default();
            for x in 0..grid.width() {
                let at = |dx: f64, dy: f64| {
                    let uv = [
                        (x as f64 + dx) / grid.width() as f64,
                        (y as f64 + dy) / grid.height() as f64,
                    ];
                    camera_from_world * crate::EnvironmentMap::direction_from_uv(uv)
                };
                let middle = at(0.5, 0.5);
                let found = [0, 1].map(|l| {
                    let lens = &calibration.lenses[l];
                    let pixel = lens.projection.project(to_lens(rotations[l], middle))?;
                    Some((pixel, place(pixel, lens.size)?))
                });
                let blend = blend(middle, axes, reach, found.map(|place| place.is_some()));
                for l in 0..2 {
                    let lens = &calibration.lenses[l];
                    let Some((pixel, (index, fraction))) = found[l].filter(|_| blend[l] > 0.0)
                    else {
                        continue;
                    };
                    let rho = (pixel - lens.projection.centre()).length() / edges[l];
                    let level = lens.falloff(rho.min(1.0)) * lens.gain;
                    row.parts.push(Part {
                        column: x as u16,
                        lens: l as u8,
                        fraction,
                        weight: (blend[l] / level) as f32 / per_part as f32,
                        blend: blend[l] as f32,
                    });
                    if per_part == 1 {
                        row.pixels.push(index);
                        continue;
                    }
                    for &[across, down] in &places {
                        let around = at(across, down);
                        let nearest = lens.projection.project(to_lens(rotations[l], around));
                        let nearest = nearest.and_then(|p| place_nearest(p, lens.size));
                        row.pixels.push(nearest.unwrap_or(index));
                    }
                }
            }
            row
        };
        let rows: Vec<Row> = (0..grid.height()).into_par_iter().map(build).collect();
        let unseen = unseen(&grid, &rows);
        if unseen >= 1.0 {
            return Err(CalibrationError::Overlap(
                "no direction of the panorama falls on a picture; expected pictures of 2 × 2 pixels and more, and lenses of a wide field of view".into(),
            ));
        }
        let table = calibration.response.table();
        let mut flagged = table;
        for table in &mut flagged {
            for value in &mut table[usize::from(CLIPPED_CODE)..] {
                *value += FLAG;
            }
        }
        Ok(Self {
            width: grid.width(),
            height: grid.height(),
            strides: calibration.lenses.each_ref().map(|lens| lens.size[0]),
            lengths: calibration
                .lenses
                .each_ref()
                .map(|lens| lens.size[0] * lens.size[1]),
            rows,
            unseen,
            per_part,
            overlap: overlap_taps(calibration, axes, reach),
            table,
            flagged,
            gains: [1.0; 2],
            started: false,
        })
    }

    /// Width and height of the panorama.
    pub fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// Share of the sphere that neither lens sees, 0 … 1: it is black in the panorama.
    pub fn unseen(&self) -> f64 {
        self.unseen
    }

    /// The lenses' gains, found from the overlaps so far.
    pub fn gains(&self) -> [f32; 2] {
        self.gains
    }

    /// Stitches a pair into `out`, linear RGB with 1 at clipping; directions that no lens sees
    /// are 0.
    ///
    /// # Errors
    /// If a picture or `out` has another size than was calibrated.
    pub fn stitch(
        &mut self,
        pair: &FisheyePair,
        out: &mut [[f32; 3]],
    ) -> Result<(), CalibrationError> {
        for lens in 0..2 {
            if pair.pictures[lens].len() != self.lengths[lens] {
                return Err(CalibrationError::Size {
                    lens,
                    expected: [self.strides[lens], self.lengths[lens] / self.strides[lens]],
                    found: [pair.pictures[lens].len(), 1],
                });
            }
        }
        if out.len() != self.width * self.height {
            return Err(CalibrationError::Overlap(format!(
                "the panorama has {} texels, expected {} × {}",
                out.len(),
                self.width,
                self.height
            )));
        }
        self.update_gains(pair);
        let this = &*self;
        out.par_chunks_mut(this.width)
            .zip(&this.rows)
            .with_min_len(8)
            .for_each(|(texels, row)| this.stitch_row(pair, row, texels));
        Ok(())
    }

    fn stitch_row(&self, pair: &FisheyePair, row: &Row, texels: &mut [[f32; 3]]) {
        texels.fill([0.0; 3]);
        let pixels = row.pixels.chunks_exact(self.per_part);
        for (part, pixels) in row.parts.iter().zip(pixels) {
            let lens = usize::from(part.lens);
            let picture = pair.pictures[lens];
            let weight = part.weight * self.gains[lens];
            let texel = &mut texels[usize::from(part.column)];
            if let &[index] = pixels {
                let tap = Tap {
                    index,
                    fraction: part.fraction,
                    weight,
                };
                let (value, bits) = self.sample(picture, self.strides[lens], &tap);
                for c in 0..3 {
                    let clipped = bits & (1 << c) != 0;
                    let share = weight * value[c];
                    texel[c] += if clipped {
                        share.max(part.blend)
                    } else {
                        share
                    };
                }
                continue;
            }
            let mut sum = [0.0_f32; 3];
            for &index in pixels {
                let pixel = picture[index as usize];
                for c in 0..3 {
                    sum[c] += self.flagged[c][usize::from(pixel[c])];
                }
            }
            for c in 0..3 {
                let clipped = (sum[c] / FLAG).floor();
                let share = weight * (sum[c] - FLAG * clipped);
                // A sun that fills part of a texel must not be averaged away.
                let most = CLIPPED_SHARE * self.per_part as f32 <= clipped;
                texel[c] += if most { share.max(part.blend) } else { share };
            }
        }
    }

    #[inline]
    fn sample(&self, picture: &[[u8; 3]], stride: usize, tap: &Tap) -> ([f32; 3], u8) {
        let i = tap.index as usize;
        let [fx, fy] = tap.fraction.map(|f| f32::from(f) / 256.0);
        let corners = [
            (picture[i], (1.0 - fx) * (1.0 - fy)),
            (picture[i + 1], fx * (1.0 - fy)),
            (picture[i + stride], (1.0 - fx) * fy),
            (picture[i + stride + 1], fx * fy),
        ];
        let mut value = [0.0; 3];
        let mut bits = 0;
        for (pixel, weight) in corners {
            for c in 0..3 {
                value[c] += weight * self.table[c][usize::from(pixel[c])];
                bits |= u8::from(pixel[c] >= CLIPPED_CODE && weight > 0.25) << c;
            }
        }
        (value, bits)
    }

    /// Gains that make both lenses agree where both see, and stay near 1 (Brown and Lowe 2007).
    fn update_gains(&mut self, pair: &FisheyePair) {
        let (mut sums, mut count) = ([0.0_f64; 2], 0.0);
        for taps in &self.overlap {
            let mut level = [0.0; 2];
            let mut open = true;
            for l in 0..2 {
                let (value, bits) = self.sample(pair.pictures[l], self.strides[l], &taps[l]);
                open &= bits == 0 && value.iter().all(|&v| v > 0.005 && v < 0.9);
                level[l] = f64::from(value[1] * taps[l].weight);
            }
            if open {
                sums[0] += level[0];
                sums[1] += level[1];
                count += 1.0;
            }
        }
        if count < 16.0 {
            return;
        }
        let [a, b] = sums.map(|s| s / count);
        // Relative to their mean, so that the spread is one of ratios.
        let scale = 0.5 * (a + b);
        let (a, b) = (a / scale, b / scale);
        let (n, g) = (count / OVERLAP_SIGMA.powi(2), count / GAIN_SIGMA.powi(2));
        // Minimum of n·(g₀a − g₁b)² + g·((1 − g₀)² + (1 − g₁)²).
        let (m00, m11, m01) = (n * a * a + g, n * b * b + g, -n * a * b);
        let determinant = m00 * m11 - m01 * m01;
        let found = [
            ((g * m11 - m01 * g) / determinant) as f32,
            ((g * m00 - m01 * g) / determinant) as f32,
        ];
        let rate = if self.started { GAIN_RATE } else { 1.0 };
        for (gain, found) in self.gains.iter_mut().zip(found) {
            *gain += rate * (found - *gain);
        }
        self.started = true;
    }
}

/// Share of the sphere of the texels without a part.
fn unseen(grid: &Grid, rows: &[Row]) -> f64 {
    let (mut seen, mut all) = (0.0, 0.0);
    for (y, row) in rows.iter().enumerate() {
        // The parts of a texel follow each other.
        let texels = row.parts.chunk_by(|a, b| a.column == b.column).count();
        let solid_angle = f64::from(grid.solid_angle(y));
        seen += solid_angle * texels as f64;
        all += solid_angle * grid.width() as f64;
    }
    1.0 - seen / all
}

/// Directions spread over the overlap, where each lens finds them.
fn overlap_taps(calibration: &Calibration, axes: [DVec3; 2], reach: [f64; 2]) -> Vec<[Tap; 2]> {
    crate::measure::normals(OVERLAP_SAMPLES)
        .filter_map(|direction| {
            let mut taps = [Tap::default(); 2];
            for l in 0..2 {
                let lens = &calibration.lenses[l];
                if axes[l].angle_between(direction) > reach[l] {
                    return None;
                }
                let pixel = lens
                    .projection
                    .project(to_lens(lens.rotation(), direction))?;
                let (index, fraction) = place(pixel, lens.size)?;
                let rho = (pixel - lens.projection.centre()).length() / edge_radius(lens);
                taps[l] = Tap {
                    index,
                    fraction,
                    weight: (1.0 / (lens.falloff(rho.min(1.0)) * lens.gain)) as f32,
                };
            }
            Some(taps)
        })
        .collect()
}

/// Radius of the edge of a lens's field of view, pixels.
pub(super) fn edge_radius(lens: &super::Lens) -> f64 {
    let angle = lens.projection.max_angle() - 1e-6;
    let edge = lens
        .projection
        .project(DVec3::new(angle.sin(), 0.0, angle.cos()));
    edge.map_or(1.0, |pixel| {
        (pixel - lens.projection.centre()).length().max(1e-6)
    })
}

/// Weights of the lenses for a direction of the camera: smooth across the seam, 1 in all; a lens
/// on whose picture the direction is not has none.
fn blend(direction: DVec3, axes: [DVec3; 2], reach: [f64; 2], on_picture: [bool; 2]) -> [f64; 2] {
    let angles = axes.map(|axis| axis.angle_between(direction));
    // Half the overlap's width bounds the feather.
    let margin = [reach[0] - angles[0], reach[1] - angles[1]];
    match [0, 1].map(|l| margin[l] > 0.0 && on_picture[l]) {
        [true, false] => [1.0, 0.0],
        [false, true] => [0.0, 1.0],
        [false, false] => [0.0, 0.0],
        [true, true] => {
            let overlap = (reach[0] + reach[1] - std::f64::consts::PI).max(1e-6);
            let feather = (0.5 * overlap).min(FEATHER);
            let t = (0.5 + 0.25 * (angles[1] - angles[0]) / feather).clamp(0.0, 1.0);
            let smooth = t * t * (3.0 - 2.0 * t);
            [smooth, 1.0 - smooth]
        }
    }
}

/// Upper left texel and fractions of a pixel position; `None` outside the picture.
fn place(pixel: DVec2, [width, height]: [usize; 2]) -> Option<(u32, [u8; 2])> {
    if width < 2 || height < 2 {
        return None;
    }
    let (x, y) = (pixel.x - 0.5, pixel.y - 0.5);
    if !(x > -1.0 && y > -1.0 && x < width as f64 && y < height as f64) {
        return None;
    }
    let (x, y) = (
        x.clamp(0.0, width as f64 - 1.001),
        y.clamp(0.0, height as f64 - 1.001),
    );
    let index = x as usize + width * y as usize;
    Some((
        index as u32,
        [x.fract(), y.fract()].map(|f| (f * 256.0) as u8),
    ))
}

/// The pixel at a position; `None` outside the picture.
fn place_nearest(pixel: DVec2, [width, height]: [usize; 2]) -> Option<u32> {
    let inside =
        pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x < width as f64 && pixel.y < height as f64;
    inside.then(|| (pixel.x as usize + width * pixel.y as usize) as u32)
}

#[cfg(test)]
mod tests;
