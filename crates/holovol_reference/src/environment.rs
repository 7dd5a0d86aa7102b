//! Drawing directions in proportion to the environment's light.
//!
//! The bilinear map falls into patches between texel centres. A patch is drawn by the mean of its
//! four corners times its solid angle (row, then column, by inverting running sums), a direction
//! in it uniformly by solid angle. As the map is nowhere more than four times its patch's mean,
//! radiance / pdf is bounded whatever the contrast of the map.

use std::f64::consts::{PI, TAU};

use glam::DVec3;
use holovol_light::EnvironmentMap;

use crate::rng::Rng;

/// Running sums over the patches of a map.
pub struct EnvironmentTable {
    width: usize,
    /// Texel rows; there is one more row of patches.
    height: usize,
    /// Sum up to and with each row, last is 1.
    rows: Vec<f64>,
    /// Per row: sum up to and with each patch, last is 1 (0 in a black row).
    columns: Vec<f64>,
    /// cos θ at the rows' borders, from 1 down to −1.
    cosines: Vec<f64>,
}

/// A drawn direction.
pub struct EnvironmentDraw {
    /// Unit direction in the map's frame.
    pub direction: DVec3,
    /// Density over solid angle, 1/sr.
    pub pdf: f64,
}

/// The first index whose running sum exceeds ξ.
fn invert(running: &[f64], xi: f64) -> usize {
    running
        .partition_point(|&sum| sum <= xi)
        .min(running.len() - 1)
}

fn share(running: &[f64], index: usize) -> f64 {
    running[index] - if index == 0 { 0.0 } else { running[index - 1] }
}

impl EnvironmentTable {
    /// `None` if the map is black.
    pub fn new(map: &EnvironmentMap) -> Option<Self> {
        let (width, height) = (map.width(), map.height());
        let cosines: Vec<f64> = (0..=height + 1)
            .map(|border| match border {
                0 => 1.0,
                _ if border == height + 1 => -1.0,
                _ => (PI * (border as f64 - 0.5) / height as f64).cos(),
            })
            .collect();
        let light = |x: usize, y: i64| {
            let [r, g, b] = map.texel(x as i64, y).map(f64::from);
            r + g + b
        };
        let mut rows = Vec::with_capacity(height + 1);
        let mut columns = Vec::with_capacity(width * (height + 1));
        let mut total = 0.0;
        for row in 0..=height {
            let y = row as i64 - 1;
            let mut sum = 0.0;
            for x in 0..width {
                sum += light(x, y) + light(x + 1, y) + light(x, y + 1) + light(x + 1, y + 1);
                columns.push(sum);
            }
            if sum > 0.0 {
                let line = &mut columns[row * width..];
                line.iter_mut().for_each(|running| *running /= sum);
            }
            total += sum * (cosines[row] - cosines[row + 1]);
            rows.push(total);
        }
        rows.iter_mut().for_each(|running| *running /= total);
        (total > 0.0).then_some(Self {
            width,
            height,
            rows,
            columns,
            cosines,
        })
    }

    fn row(&self, row: usize) -> &[f64] {
        &self.columns[row * self.width..(row + 1) * self.width]
    }

    fn patch_pdf(&self, row: usize, column: usize) -> f64 {
        let solid_angle = TAU / self.width as f64 * (self.cosines[row] - self.cosines[row + 1]);
        share(&self.rows, row) * share(self.row(row), column) / solid_angle
    }

    /// Draws a direction.
    pub fn draw(&self, rng: &mut Rng) -> EnvironmentDraw {
        let row = invert(&self.rows, rng.uniform());
        let column = invert(self.row(row), rng.uniform());
        let u = (column as f64 + 0.5 + rng.uniform()) / self.width as f64;
        let (top, bottom) = (self.cosines[row], self.cosines[row + 1]);
        let cosine = top + (bottom - top) * rng.uniform();
        let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
        let (sin_phi, cos_phi) = ((u - 0.5) * TAU).sin_cos();
        EnvironmentDraw {
            direction: DVec3::new(sine * sin_phi, cosine, -sine * cos_phi),
            pdf: self.patch_pdf(row, column),
        }
    }

    /// Density with which [`Self::draw`] draws a unit direction of the map's frame, 1/sr.
    pub fn pdf(&self, direction: DVec3) -> f64 {
        let u = 0.5 + direction.x.atan2(-direction.z) / TAU;
        let v = direction.y.clamp(-1.0, 1.0).acos() / PI;
        let column = (u * self.width as f64 - 0.5).floor() as i64;
        let row = ((v * self.height as f64 + 0.5) as usize).min(self.height);
        self.patch_pdf(row, column.rem_euclid(self.width as i64) as usize)
    }
}
