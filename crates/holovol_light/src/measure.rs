//! What light does: irradiance, spherical harmonics, the dominant light.

use std::f64::consts::PI;

use glam::DVec3;

use crate::{EnvironmentMap, Grid, luminance};

/// Light gathered into about 8000 cells, to ask for irradiance cheaply.
///
/// Each cell keeps its flux as a vector (direction × radiance × solid angle), so that a small
/// light keeps its exact direction: only the horizon of the receiving surface is blurred, by at
/// most half a cell, 1.4°.
#[derive(Clone, Debug)]
pub struct FluxCells {
    /// Per cell and channel: ∫ L ω dω.
    cells: Vec<[DVec3; 3]>,
}

/// Cells across and down.
const CELLS: [usize; 2] = [128, 64];

impl FluxCells {
    /// Gathers a map's light.
    pub fn new(map: &EnvironmentMap) -> Self {
        Self::from_texels(&Grid::new(map.width(), map.height()), map.texels())
    }

    /// Gathers the light of row-major texels.
    ///
    /// # Panics
    /// If there are fewer texels than the grid has.
    pub fn from_texels(grid: &Grid, texels: &[[f32; 3]]) -> Self {
        if let Some((grid, texels)) = refined(grid, texels, CELLS) {
            return Self::from_texels(&grid, &texels);
        }
        let mut cells = vec![[DVec3::ZERO; 3]; CELLS[0] * CELLS[1]];
        let (width, height) = (grid.width(), grid.height());
        for y in 0..height {
            let solid_angle = f64::from(grid.solid_angle(y));
            let row = y * CELLS[1] / height * CELLS[0];
            for x in 0..width {
                let direction = DVec3::from_array(grid.direction(x, y).map(f64::from));
                let cell = &mut cells[row + x * CELLS[0] / width];
                for c in 0..3 {
                    cell[c] += direction * (solid_angle * f64::from(texels[x + width * y][c]));
                }
            }
        }
        Self { cells }
    }

    /// Adds a light too small to have a shape: irradiance facing it, RGB.
    pub fn add(&mut self, direction: DVec3, irradiance: [f64; 3]) {
        self.cells.push(irradiance.map(|e| direction * e));
    }

    /// Irradiance of a surface with this unit normal, RGB.
    pub fn irradiance(&self, normal: DVec3) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for cell in &self.cells {
            for c in 0..3 {
                sum[c] += cell[c].dot(normal).max(0.0);
            }
        }
        sum
    }

    /// Direction of the dominant light: the 10° cap with most luminous flux, then its centroid.
    /// `None` in the dark.
    pub fn dominant_direction(&self) -> Option<DVec3> {
        /// Half the cap's opening, radians.
        const CAP: f64 = 10.0 / 180.0 * PI;
        let lit: Vec<(DVec3, f64)> = self
            .cells
            .iter()
            .map(|cell| {
                let vector = 0.2126 * cell[0] + 0.7152 * cell[1] + 0.0722 * cell[2];
                (vector.normalize_or_zero(), vector.length())
            })
            .filter(|&(_, flux)| flux > 0.0)
            .collect();
        let cap = |at: DVec3| {
            lit.iter()
                .filter(move |(direction, _)| direction.dot(at) > CAP.cos())
                .fold((DVec3::ZERO, 0.0), |(sum, total), &(direction, flux)| {
                    (sum + direction * flux, total + flux)
                })
        };
        let best = normals(2048)
            .map(|at| (at, cap(at).1))
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .filter(|&(_, flux)| flux > 0.0)?;
        let mut at = best.0;
        // A few steps bring the cap over the light's own centre.
        for _ in 0..4 {
            at = cap(at).0.try_normalize()?;
        }
        Some(at)
    }
}

/// The map with texels cut into equal ones, if it has fewer than `least` across or down: a texel
/// that is a large part of the sphere doesn't shine from its centre alone.
fn refined(grid: &Grid, texels: &[[f32; 3]], least: [usize; 2]) -> Option<(Grid, Vec<[f32; 3]>)> {
    let (width, height) = (grid.width(), grid.height());
    let parts = [least[0].div_ceil(width), least[1].div_ceil(height)];
    if parts == [1, 1] {
        return None;
    }
    let fine = Grid::new(width * parts[0], height * parts[1]);
    let texel = |i: usize| {
        let (x, y) = (i % fine.width() / parts[0], i / fine.width() / parts[1]);
        texels[x + width * y]
    };
    let cut = (0..fine.len()).map(texel).collect();
    Some((fine, cut))
}

/// ∫ luminance dω over a map: four times the mean luminous irradiance over all normals.
pub fn luminous_flux(grid: &Grid, texels: &[[f32; 3]]) -> f64 {
    let rows = texels.chunks_exact(grid.width()).take(grid.height());
    rows.enumerate()
        .map(|(y, row)| luminance(sum_of(row).map(f64::from)) * f64::from(grid.solid_angle(y)))
        .sum()
}

/// The sum of texels: eight at a time, so that additions don't wait for each other.
pub(crate) fn sum_of(texels: &[[f32; 3]]) -> [f32; 3] {
    const LANES: usize = 24;
    let mut lanes = [0.0_f32; LANES];
    let chunks = texels.as_flattened().chunks_exact(LANES);
    let rest = chunks.remainder();
    for chunk in chunks {
        for (lane, value) in lanes.iter_mut().zip(chunk) {
            *lane += value;
        }
    }
    for (lane, value) in lanes.iter_mut().zip(rest) {
        *lane += value;
    }
    let mut sum = [0.0; 3];
    for lane in lanes.chunks_exact(3) {
        for c in 0..3 {
            sum[c] += lane[c];
        }
    }
    sum
}

/// Whether any channel reaches a level; NaN does not.
pub(crate) fn any_reaches(texels: &[[f32; 3]], level: f32) -> bool {
    let values = texels.as_flattened().iter();
    values.fold(false, |any, &value| any | (value >= level))
}

/// `count` directions spread evenly over the sphere (a Fibonacci lattice).
pub fn normals(count: usize) -> impl Iterator<Item = DVec3> {
    /// 2π(1 − 1/golden ratio).
    const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;
    (0..count).map(move |i| {
        let y = 1.0 - (2.0 * i as f64 + 1.0) / count as f64;
        let radius = (1.0 - y * y).max(0.0).sqrt();
        let (sin, cos) = (GOLDEN_ANGLE * (i as f64 + 0.5)).sin_cos();
        DVec3::new(radius * cos, y, radius * sin)
    })
}

/// How far an estimate's light is from the true light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightError512 {
    /// Root of the mean squared error of irradiance over 512 normals and RGB, over that of the
    /// truth; not scaled in any way.
    pub irradiance_rmse: f64,
    /// log₂ of mean luminous irradiance over true mean: > 0 is too bright. NaN in the dark.
    pub ev_bias: f64,
    /// Angle between the dominant lights, radians; π where only one of both has light.
    pub direction: f64,
}

/// A scene's true light, with what is asked of it again and again.
#[derive(Clone, Debug)]
pub struct Truth {
    cells: FluxCells,
    irradiance: Vec<[f64; 3]>,
    direction: Option<DVec3>,
}

impl Truth {
    /// Prepares the truth for comparisons.
    pub fn new(cells: &FluxCells) -> Self {
        Self {
            cells: cells.clone(),
            irradiance: normals(512).map(|n| cells.irradiance(n)).collect(),
            direction: cells.dominant_direction(),
        }
    }

    /// The light itself.
    pub fn cells(&self) -> &FluxCells {
        &self.cells
    }

    /// Measures an estimate (DESIGN §8).
    pub fn error(&self, estimate: &FluxCells) -> LightError512 {
        let (mut error, mut square) = (0.0, 0.0);
        let mut sums = [0.0; 2];
        for (normal, expected) in normals(512).zip(&self.irradiance) {
            let found = estimate.irradiance(normal);
            for c in 0..3 {
                error += (found[c] - expected[c]).powi(2);
                square += expected[c].powi(2);
            }
            sums[0] += luminance(found);
            sums[1] += luminance(*expected);
        }
        let direction = match (estimate.dominant_direction(), self.direction) {
            (Some(a), Some(b)) => a.angle_between(b),
            (None, None) => 0.0,
            _ => PI,
        };
        LightError512 {
            irradiance_rmse: (error / square).sqrt(),
            ev_bias: (sums[0] / sums[1]).log2(),
            direction,
        }
    }
}

/// Spherical harmonics to order 2 of a radiance map: RGB of 9 real coefficients.
///
/// Orthonormal basis, in the order Y₀₀; Y₁₋₁ ∝ y, Y₁₀ ∝ z, Y₁₁ ∝ x; Y₂₋₂ ∝ xy, Y₂₋₁ ∝ yz,
/// Y₂₀ ∝ 3z² − 1, Y₂₁ ∝ xz, Y₂₂ ∝ x² − y² (Ramamoorthi and Hanrahan 2001, eq. 3), in the map's
/// frame. Costs about five multiply-adds per texel and channel: sines are taken out row by row.
pub fn spherical_harmonics(grid: &Grid, texels: &[[f32; 3]]) -> [[f32; 3]; 9] {
    /// Maps of fewer texels are cut into finer ones first.
    const FINE: [usize; 2] = [32, 16];
    if let Some((grid, texels)) = refined(grid, texels, FINE) {
        return spherical_harmonics(&grid, &texels);
    }
    let width = grid.width();
    let mut sums = [[0.0_f64; 3]; 9];
    for (y, row) in texels.chunks_exact(width).take(grid.height()).enumerate() {
        let moments = row_moments(grid, row);
        let [sin, cos] = grid.row(y).map(f64::from);
        let solid_angle = f64::from(grid.solid_angle(y));
        for c in 0..3 {
            let [l, lx, lz, lxx, lxz] = moments.map(|moment| f64::from(moment[c]) * solid_angle);
            let lzz = l - lxx;
            let terms = [
                l,
                cos * l,
                sin * lz,
                sin * lx,
                sin * cos * lx,
                sin * cos * lz,
                3.0 * sin * sin * lzz - l,
                sin * sin * lxz,
                sin * sin * lxx - cos * cos * l,
            ];
            for (sum, term) in sums.iter_mut().zip(terms) {
                sum[c] += term;
            }
        }
    }
    let mut out = [[0.0; 3]; 9];
    for (i, (sum, factor)) in sums.iter().zip(SH_FACTORS).enumerate() {
        out[i] = sum.map(|value| (value * factor) as f32);
    }
    out
}

/// Sums of L, L·dx, L·dz, L·dx², L·dx·dz over a row; dz² = 1 − dx².
fn row_moments(grid: &Grid, row: &[[f32; 3]]) -> [[f32; 3]; 5] {
    let mut moments = [[0.0_f32; 3]; 5];
    let mut add = |x: usize, even: [f32; 3], odd: [f32; 3]| {
        let [dx, dz] = grid.column(x);
        for c in 0..3 {
            moments[0][c] += even[c];
            moments[1][c] += dx * odd[c];
            moments[2][c] += dz * odd[c];
            moments[3][c] += dx * dx * even[c];
            moments[4][c] += dx * dz * even[c];
        }
    };
    if row.len().is_multiple_of(2) {
        // Opposite columns have opposite directions, and products alike.
        let (left, right) = row.split_at(row.len() / 2);
        for (x, (a, b)) in left.iter().zip(right).enumerate() {
            let even = std::array::from_fn(|c| a[c] + b[c]);
            let odd = std::array::from_fn(|c| a[c] - b[c]);
            add(x, even, odd);
        }
    } else {
        for (x, texel) in row.iter().enumerate() {
            add(x, *texel, *texel);
        }
    }
    moments
}

/// Adds a small light to spherical harmonics: irradiance facing it, RGB.
pub fn add_to_spherical_harmonics(sh: &mut [[f32; 3]; 9], direction: DVec3, irradiance: [f64; 3]) {
    let DVec3 { x, y, z } = direction;
    let terms = [
        1.0,
        y,
        z,
        x,
        x * y,
        y * z,
        3.0 * z * z - 1.0,
        x * z,
        x * x - y * y,
    ];
    for ((sum, term), factor) in sh.iter_mut().zip(terms).zip(SH_FACTORS) {
        for c in 0..3 {
            sum[c] += (irradiance[c] * term * factor) as f32;
        }
    }
}

/// Irradiance of a surface from spherical harmonics (Ramamoorthi and Hanrahan 2001, eq. 10).
pub fn irradiance_from_spherical_harmonics(sh: &[[f32; 3]; 9], normal: DVec3) -> [f64; 3] {
    let mut unit = [[0.0_f32; 3]; 9];
    add_to_spherical_harmonics(&mut unit, normal, [1.0; 3]);
    let band = |i: usize| match i {
        0 => PI,
        1..4 => 2.0 * PI / 3.0,
        _ => PI / 4.0,
    };
    std::array::from_fn(|c| {
        (0..9)
            .map(|i| band(i) * f64::from(unit[i][0]) * f64::from(sh[i][c]))
            .sum()
    })
}

/// Normalisation of the nine basis functions as polynomials.
const SH_FACTORS: [f64; 9] = [
    0.282_094_791_773_878_14,
    0.488_602_511_902_919_9,
    0.488_602_511_902_919_9,
    0.488_602_511_902_919_9,
    1.092_548_430_592_079_2,
    1.092_548_430_592_079_2,
    0.315_391_565_252_520_05,
    1.092_548_430_592_079_2,
    0.546_274_215_296_039_6,
];

#[cfg(test)]
mod tests {
    use super::*;

    fn lobe(width: usize, height: usize) -> EnvironmentMap {
        let grid = Grid::new(width, height);
        let texels = (0..width * height).map(|i| {
            let [x, y, z] = grid.direction(i % width, i / width);
            [
                1.0 + 0.5 * x + 0.4 * x * y,
                2.0 + y * z,
                1.0 - 0.6 * y + 0.3 * x * z + 0.2 * x * x,
            ]
        });
        EnvironmentMap::new(width, height, texels.collect())
    }

    #[test]
    fn irradiance_of_uniform_light_is_pi() {
        let cells = FluxCells::new(&EnvironmentMap::new(256, 128, vec![[1.0; 3]; 256 * 128]));
        for normal in normals(16) {
            let [e, ..] = cells.irradiance(normal);
            assert!((e / PI - 1.0).abs() < 2e-3, "{e}");
        }
    }

    #[test]
    fn a_map_of_one_texel_shines_from_all_over() {
        for (width, height) in [(1, 1), (2, 1), (3, 2)] {
            let (grid, texels) = (Grid::new(width, height), vec![[1.0; 3]; width * height]);
            let cells = FluxCells::from_texels(&grid, &texels);
            let sh = spherical_harmonics(&grid, &texels);
            for normal in normals(16) {
                let found = [
                    cells.irradiance(normal),
                    irradiance_from_spherical_harmonics(&sh, normal),
                ];
                for [e, ..] in found {
                    assert!(
                        (e / PI - 1.0).abs() < 0.01,
                        "{width} × {height} {normal}: {e}"
                    );
                }
            }
        }
    }

    #[test]
    fn spherical_harmonics_give_the_irradiance_of_smooth_light() {
        let map = lobe(256, 128);
        let sh = spherical_harmonics(&Grid::new(256, 128), map.texels());
        let cells = FluxCells::new(&map);
        for normal in normals(64) {
            let (a, b) = (
                irradiance_from_spherical_harmonics(&sh, normal),
                cells.irradiance(normal),
            );
            for c in 0..3 {
                assert!((a[c] / b[c] - 1.0).abs() < 4e-3, "{normal}: {a:?} {b:?}");
            }
        }
    }

    #[test]
    fn a_small_light_adds_alike_to_map_and_harmonics() {
        let mut texels = vec![[0.0; 3]; 256 * 128];
        let grid = Grid::new(256, 128);
        texels[40 + 256 * 30] = [3.0, 2.0, 1.0];
        let direct = spherical_harmonics(&grid, &texels);
        let mut added = [[0.0; 3]; 9];
        let solid_angle = f64::from(grid.solid_angle(30));
        let direction = DVec3::from_array(grid.direction(40, 30).map(f64::from));
        add_to_spherical_harmonics(
            &mut added,
            direction,
            [3.0, 2.0, 1.0].map(|l| l * solid_angle),
        );
        for (a, b) in direct.iter().flatten().zip(added.iter().flatten()) {
            assert!((a - b).abs() < 1e-7 + 1e-5 * b.abs(), "{a} {b}");
        }
    }

    #[test]
    fn the_dominant_light_is_found_and_errors_are_zero_for_equals() {
        let mut texels = vec![[0.1; 3]; 256 * 128];
        texels[200 + 256 * 40] = [3000.0; 3];
        let map = EnvironmentMap::new(256, 128, texels);
        let cells = FluxCells::new(&map);
        let found = cells.dominant_direction().expect("there is light");
        let grid = Grid::new(256, 128);
        let expected = DVec3::from_array(grid.direction(200, 40).map(f64::from));
        assert!(found.angle_between(expected) < 0.5_f64.to_radians());
        let truth = Truth::new(&cells);
        let error = truth.error(&cells);
        assert_eq!((error.irradiance_rmse, error.ev_bias), (0.0, 0.0));
        let dimmer = EnvironmentMap::new(256, 128, vec![[0.1; 3]; 256 * 128]);
        let error = truth.error(&FluxCells::new(&dimmer));
        assert!(
            error.ev_bias < -1.0 && error.irradiance_rmse > 0.5,
            "{error:?}"
        );
    }
}
