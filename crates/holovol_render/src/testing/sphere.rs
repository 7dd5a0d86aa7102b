//! Tests of directional densities: integrals and histograms over cells of the sphere.

use std::f64::consts::{PI, TAU};

use glam::{DMat3, DVec3, Vec3};

/// Largest deviation, in standard deviations, that chance is believed: p < 1e-8.
pub const MAX_DEVIATION: f64 = 5.6;

/// A partition of the sphere into rectangles of two coordinates.
pub struct SphereCells {
    columns: usize,
    /// Borders of the rows, ascending, in a coordinate of `direction`.
    rows: Vec<f64>,
    /// Points a side for integrals over one cell.
    order: usize,
    kind: Kind,
}

enum Kind {
    /// Rows in ln(1 − cos θ) around the third axis: they resolve any peak there.
    Around(DMat3),
    /// Rows in v, columns in u of a latitude–longitude map, whose texel centres are on borders.
    Map,
}

/// 1 − cos θ below which everything is one row.
const FINEST: f64 = 1e-9;

impl SphereCells {
    /// Cells that get finer and finer toward an axis, where the density may peak.
    pub fn around(axis: Vec3) -> Self {
        let axis = axis.as_dvec3().normalize();
        let side = axis.any_orthonormal_vector();
        let count = 40;
        let borders = (0..=count)
            .map(|i| FINEST.ln() + (2.0f64.ln() - FINEST.ln()) * f64::from(i) / f64::from(count));
        Self {
            columns: 16,
            rows: std::iter::once(f64::NEG_INFINITY).chain(borders).collect(),
            order: 12,
            kind: Kind::Around(DMat3::from_cols(side, axis.cross(side), axis)),
        }
    }

    /// Cells between the texel centres of a map.
    pub fn of_map(width: usize, height: usize) -> Self {
        let borders = (0..=height + 1).map(|j| (j as f64 - 0.5) / height as f64);
        Self {
            columns: width.max(4),
            rows: borders.map(|v| v.clamp(0.0, 1.0)).collect(),
            order: 12,
            kind: Kind::Map,
        }
    }

    fn count(&self) -> usize {
        self.columns * (self.rows.len() - 1)
    }

    fn offset(&self) -> f64 {
        match self.kind {
            Kind::Around(_) => 0.0,
            Kind::Map => 0.5 / self.columns as f64,
        }
    }

    fn cell(&self, direction: Vec3) -> usize {
        let d = direction.as_dvec3();
        let (row, turn) = match &self.kind {
            Kind::Around(frame) => {
                let local = frame.transpose() * d;
                let difference = d.normalize() - frame.z_axis;
                let one_minus_cos = 0.5 * difference.length_squared();
                (one_minus_cos.ln(), local.y.atan2(local.x) / TAU + 0.5)
            }
            Kind::Map => (d.x.hypot(d.z).atan2(d.y) / PI, 0.5 + d.x.atan2(-d.z) / TAU),
        };
        let turn = (turn - self.offset()).rem_euclid(1.0);
        let column = ((turn * self.columns as f64) as usize).min(self.columns - 1);
        let row = self.rows.partition_point(|&border| border <= row);
        let row = row.clamp(1, self.rows.len() - 1) - 1;
        row * self.columns + column
    }

    /// Direction at a row coordinate and a turn, and solid angle per row coordinate and turn.
    fn direction(&self, row: f64, turn: f64) -> (DVec3, f64) {
        match &self.kind {
            Kind::Around(frame) => {
                let one_minus_cos = row.exp();
                let sin = (one_minus_cos * (2.0 - one_minus_cos)).max(0.0).sqrt();
                let (s, c) = ((turn - 0.5) * TAU).sin_cos();
                let local = DVec3::new(sin * c, sin * s, 1.0 - one_minus_cos);
                (*frame * local, one_minus_cos * TAU)
            }
            Kind::Map => {
                let (sin, cos) = (row * PI).sin_cos();
                let (s, c) = ((turn - 0.5) * TAU).sin_cos();
                (DVec3::new(sin * s, cos, -sin * c), 2.0 * PI * PI * sin)
            }
        }
    }

    /// Integrals of a function over each cell, sr.
    pub fn integrals(&self, f: impl Fn(Vec3) -> f64) -> Vec<f64> {
        (0..self.count())
            .map(|cell| {
                let (row, column) = (cell / self.columns, cell % self.columns);
                let (low, high) = (self.rows[row], self.rows[row + 1]);
                // Below the finest row: the density at its border, over what little is there.
                let low = if low.is_finite() { low } else { high - 12.0 };
                let step = 1.0 / self.order as f64;
                let mut sum = 0.0;
                for i in 0..self.order {
                    for j in 0..self.order {
                        let [x, y] = [i, j].map(|k| (k as f64 + 0.5) * step);
                        let turn = (column as f64 + x) / self.columns as f64 + self.offset();
                        let (direction, jacobian) = self.direction(low + y * (high - low), turn);
                        sum += jacobian * f(direction.as_vec3());
                    }
                }
                sum * (high - low) * step * step / self.columns as f64
            })
            .collect()
    }

    /// Whether draws follow a density (1/sr), and whether that integrates to one within `slack`.
    ///
    /// # Errors
    /// What is wrong, with the numbers.
    pub fn check(
        &self,
        draws: &[Vec3],
        pdf: impl Fn(Vec3) -> f64,
        slack: f64,
    ) -> Result<(), String> {
        let expected = self.integrals(pdf);
        let total: f64 = expected.iter().sum();
        if !is_within(total - 1.0, slack) {
            return Err(format!("the density integrates to {total}"));
        }
        let mut counts = vec![0.0; self.count()];
        for &draw in draws {
            if !is_within(f64::from(draw.length() - 1.0), 1e-5) {
                return Err(format!("{draw} is no direction"));
            }
            counts[self.cell(draw)] += 1.0;
        }
        let deviation = chi_square(&counts, &expected, draws.len() as f64 / total);
        if !is_within(deviation.max(0.0), MAX_DEVIATION) {
            return Err(format!(
                "draws don't follow the density: chi-square is {deviation:.1} standard deviations \
                 too large"
            ));
        }
        Ok(())
    }
}

/// False for NaN.
fn is_within(error: f64, slack: f64) -> bool {
    error.abs() <= slack
}

/// How many standard deviations chi-square lies above what chance gives; cells that expect less
/// than 10 are taken together. By Wilson and Hilferty's cube root.
fn chi_square(counts: &[f64], expected: &[f64], draws: f64) -> f64 {
    let (mut sum, mut cells) = (0.0, 0.0);
    let (mut pooled_count, mut pooled) = (0.0, 0.0);
    for (&count, &share) in counts.iter().zip(expected) {
        pooled_count += count;
        pooled += draws * share;
        if pooled >= 10.0 {
            sum += (pooled_count - pooled) * (pooled_count - pooled) / pooled;
            cells += 1.0;
            (pooled_count, pooled) = (0.0, 0.0);
        }
    }
    // What is left over expects little; a crowd there is an error all the same.
    sum += (pooled_count - pooled) * (pooled_count - pooled) / pooled.max(10.0);
    let freedom: f64 = f64::max(cells, 1.0);
    let variance = 2.0 / (9.0 * freedom);
    ((sum / freedom).cbrt() - (1.0 - variance)) / variance.sqrt()
}
