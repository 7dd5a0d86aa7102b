//! T: how much the illumination changed since the last frame (DESIGN §6).

use glam::{DVec3, Vec3};

use crate::estimate::Light;
use crate::measure::normals;
use crate::{EnvironmentMap, Grid, luminance};

#[cfg(test)]
mod tests;

/// Patches across and down.
const PATCHES: usize = 16;
/// Cells across and down in a patch: what SSIM compares.
const CELLS: usize = 8;
const SIDE: usize = PATCHES * CELLS;
/// Surfaces that are asked for their irradiance.
const SURFACES: usize = 128;
/// Radiance, relative to the mean, below which a camera's noise hides changes.
const FLOOR: f32 = 0.02;
/// A change of a patch's mean by 0.3 EV halves its similarity.
const C1: f32 = 0.3 * 0.3;
/// A change of irradiance by so much, EV, halves what is left of 1: a person who walks by takes up
/// to 0.3 from some surface.
const LIT: f32 = 0.55;
/// So does light that comes from elsewhere, if it is this share of all: a sun that moves changes no
/// surface more than a person does, but the way that all light comes from.
const MOVED: f32 = 0.05;
/// Keeps what a person does apart from what a lamp does.
const POWER: i32 = 6;
/// Structure below this spread, EV, is noise.
const C2: f32 = 2.0 * 0.15 * 0.15;
/// A patch that gives no surface this share of its irradiance can't change any by more, and is
/// left out.
const SMALLEST: f32 = 0.01;
/// Share from which on what a patch exchanges counts wholly, since the kept frame.
const WHOLE: f32 = 0.008;
/// A surface in the dark counts as if it had this share of the mean irradiance.
const DARK: f32 = 0.05;
/// What a patch that changes wholly is worth where irradiance stays: a person before a wall is
/// seen, and may be mirrored, but lights nothing.
const SEEN: f32 = 0.45;

/// Times that cells are blurred over their neighbours: what is found a fraction of a degree off, or
/// once as a disc light and once in the map, would jump from one cell to the next.
const BLURS: usize = 2;

/// Compares each frame's light with the last one's; allocates nothing after the first.
///
/// The picture: per patch the similarity τ is an SSIM of log radiance, C1/(Δμ² + C1) in place of
/// SSIM's term of means, which depends on the unit of radiance, times (2σ₁₂ + C2)/(σ₁² + σ₂² + C2).
/// Cells are blurred first, and patches left out which give every surface less than 1 % of its
/// irradiance.
///
/// The light: the largest change ΔE, EV, of the irradiance of 128 surfaces has a similarity of
/// ε = 1/(1 + (ΔE/0.55)⁶). M is half of what the fluxes of overlapping patches differ by, over all
/// light, with a similarity of μ = 1/(1 + (M/0.05)⁶).
///
/// T = 1 − ε μ (1 − 0.45 (1 − min τ)): a change of the picture alone gives at most 0.45, one of the
/// light up to 1.
#[derive(Clone, Debug)]
pub struct ChangeDetector {
    frames: [Gathered; 3],
    /// Which of them is the newest, the one before, and the one that was kept.
    newest: usize,
    previous: Option<usize>,
    kept: Option<usize>,
    cells: Grid,
    surfaces: Vec<Vec3>,
    /// Cosines of patches over surfaces, patch by patch.
    cosines: Vec<f32>,
    /// Added to radiance before its logarithm is taken.
    floor: f32,
    row: [[f32; SIDE]; 2],
}

/// A frame's light.
#[derive(Clone, Debug)]
struct Gathered {
    /// Per cell: luminous flux, and log₂ of its radiance.
    flux: Vec<f32>,
    log: Vec<f32>,
    /// Per patch: flux, and flux × direction.
    patches: Vec<f32>,
    vectors: Vec<Vec3>,
    /// Flux of patches that overlap, each cell's shared among the four nearest: light that moves
    /// goes over from one to the next little by little.
    overlapping: Vec<f32>,
    /// Per surface.
    irradiance: Vec<f32>,
    all: f32,
}

/// What changed between two frames.
#[derive(Clone, Copy, Default)]
struct Change {
    /// Of the patch that changed most, 0 … 1.
    seen: f32,
    /// Of the surface whose irradiance changed most, EV.
    lit: f32,
    /// Light that comes from other patches, over all.
    moved: f32,
}

impl Default for ChangeDetector {
    fn default() -> Self {
        Self::new()
    }
}

impl ChangeDetector {
    /// A detector that has seen nothing.
    pub fn new() -> Self {
        let empty = || Gathered {
            flux: vec![0.0; SIDE * SIDE],
            log: vec![0.0; SIDE * SIDE],
            patches: vec![0.0; PATCHES * PATCHES],
            vectors: vec![Vec3::ZERO; PATCHES * PATCHES],
            overlapping: vec![0.0; PATCHES * PATCHES],
            irradiance: vec![0.0; SURFACES],
            all: 0.0,
        };
        let grid = Grid::new(SIDE, SIDE);
        let middles = Grid::new(PATCHES, PATCHES);
        let surfaces: Vec<Vec3> = normals(SURFACES).map(|n| n.as_vec3()).collect();
        let cosines = (0..PATCHES * PATCHES).flat_map(|patch| {
            let at = Vec3::from(middles.direction(patch % PATCHES, patch / PATCHES));
            let cosine = move |n: &Vec3| n.dot(at).max(0.0);
            surfaces.iter().map(cosine).collect::<Vec<_>>()
        });
        Self {
            frames: [empty(), empty(), empty()],
            newest: 0,
            previous: None,
            kept: None,
            cells: grid,
            cosines: cosines.collect(),
            surfaces,
            floor: 0.0,
            row: [[0.0; SIDE]; 2],
        }
    }

    /// Takes a frame's map and the disc lights that are not in it; gives T in 0 … 1, which is 1
    /// for the first frame.
    pub fn update(&mut self, grid: &Grid, texels: &[[f32; 3]], discs: &[Light]) -> f64 {
        let started = self.floor > 0.0;
        let before = self.newest;
        // There are three: the last, the kept, and one to write.
        let free = |i: &usize| !started || (*i != before && Some(*i) != self.kept);
        self.newest = (0..3).find(free).unwrap_or(0);
        self.previous = started.then_some(before);
        self.gather(grid, texels, discs);
        self.previous.map_or(1.0, |before| {
            let Change { seen, lit, moved } = self.compare(before, |_| 1.0);
            let similar = 1.0 / (1.0 + (lit / LIT).powi(POWER));
            let similar = similar / (1.0 + (moved / MOVED).powi(POWER));
            f64::from((1.0 - similar * (1.0 - SEEN * seen)).clamp(0.0, 1.0))
        })
    }

    /// Keeps the newest frame as what [`Self::since_kept`] compares with.
    ///
    /// Before the first frame there is nothing to keep.
    pub fn keep(&mut self) {
        if self.floor > 0.0 {
            self.kept = Some(self.newest);
        }
    }

    /// How far the newest frame's light is from the kept one's, 0 … 1, 1 if none was kept: as T,
    /// but small changes of irradiance count (0.3 EV halve what is left of 1), and a patch counts
    /// only by what it exchanges, fully from 0.8 % of a surface's irradiance on. A lamp that gives
    /// a thousandth of the light may flicker.
    pub fn since_kept(&self) -> f64 {
        self.kept.map_or(1.0, |kept| {
            let Change { seen, lit, .. } = self.compare(kept, |share| (share / WHOLE).min(1.0));
            let similar = C1 / (lit * lit + C1);
            f64::from((1.0 - similar * (1.0 - SEEN * seen)).clamp(0.0, 1.0))
        })
    }

    /// What changed, where a patch counts by the share of a surface's irradiance that it exchanges.
    fn compare(&self, other: usize, counts: impl Fn(f32) -> f32) -> Change {
        let (a, b) = (&self.frames[other], &self.frames[self.newest]);
        let all = a.all.max(b.all);
        if other == self.newest || all <= 0.0 {
            return Change::default();
        }
        if !(a.all + b.all).is_finite() {
            // Radiance that is infinite or no number is another light.
            return Change {
                seen: 1.0,
                lit: f32::INFINITY,
                moved: 1.0,
            };
        }
        let dark = DARK * 0.25 * all;
        let mut brightest = [0.0; SURFACES];
        let mut ratio = 1.0_f32;
        for ((a, b), inverse) in a.irradiance.iter().zip(&b.irradiance).zip(&mut brightest) {
            let (a, b) = (a + dark, b + dark);
            let (most, least) = (a.max(b), a.min(b));
            ratio = ratio.max(most / least);
            *inverse = 1.0 / most;
        }
        let (mut changed, mut moved) = (0.0_f32, 0.0);
        for patch in 0..PATCHES * PATCHES {
            let flux = a.patches[patch].max(b.patches[patch]);
            moved += (a.overlapping[patch] - b.overlapping[patch]).abs();
            let cosines = &self.cosines[patch * SURFACES..][..SURFACES];
            let shares = cosines.iter().zip(&brightest);
            let share = shares.fold(0.0_f32, |most, (c, inverse)| most.max(c * inverse));
            if flux * share >= SMALLEST {
                let counts = counts(exchanged(a, b, patch) * share);
                if counts > changed {
                    changed = changed.max(counts * patch_change(a, b, patch));
                }
            }
        }
        Change {
            seen: changed,
            lit: ratio.log2(),
            moved: 0.5 * moved / all,
        }
    }

    fn gather(&mut self, grid: &Grid, texels: &[[f32; 3]], discs: &[Light]) {
        let (width, height) = (grid.width(), grid.height());
        let frame = &mut self.frames[self.newest];
        let flux = &mut frame.flux;
        flux.fill(0.0);
        let luminous = |[r, g, b]: [f32; 3]| 0.2126 * r + 0.7152 * g + 0.0722 * b;
        for (y, row) in texels.chunks_exact(width).take(height).enumerate() {
            let solid_angle = grid.solid_angle(y);
            let rows = covered(y, height);
            if width % SIDE == 0 && rows.len() == 1 {
                let cells = &mut flux[rows.start * SIDE..][..SIDE];
                let per_cell = width / SIDE;
                for (cell, texels) in cells.iter_mut().zip(row.chunks_exact(per_cell)) {
                    let mut sum = [0.0_f32; 3];
                    for texel in texels {
                        for c in 0..3 {
                            sum[c] += texel[c];
                        }
                    }
                    *cell += luminous(sum) * solid_angle;
                }
                continue;
            }
            // Texels larger than cells shine from all that they cover.
            let all: f32 = rows.clone().map(|y| self.cells.solid_angle(y)).sum();
            for y in rows {
                let cells = &mut flux[y * SIDE..][..SIDE];
                let share = solid_angle * self.cells.solid_angle(y) / all;
                for (x, texel) in row.iter().enumerate() {
                    let columns = covered(x, width);
                    let part = luminous(*texel) * share / columns.len() as f32;
                    cells[columns].iter_mut().for_each(|cell| *cell += part);
                }
            }
        }
        for light in discs.iter().filter(|light| light.disc) {
            add_light(flux, light.direction, luminance(light.irradiance) as f32);
        }
        for _ in 0..BLURS {
            blur(flux, &mut self.row);
        }
        frame.sum(&self.cells, &self.surfaces);
        // All frames' logs share a floor. It follows the light only when that has become another,
        // so that as a rule the old frames' logs stay.
        let wanted = FLOOR * frame.all / (4.0 * std::f32::consts::PI);
        if self.floor > 0.0 && (self.floor * 0.5..=self.floor * 2.0).contains(&wanted) {
            frame.take_logs(&self.cells, self.floor);
        } else {
            self.floor = wanted.clamp(1e-12, 1e30);
            for frame in &mut self.frames {
                frame.take_logs(&self.cells, self.floor);
            }
        }
    }
}

impl Gathered {
    /// From cells to patches and surfaces.
    fn sum(&mut self, cells: &Grid, surfaces: &[Vec3]) {
        self.patches.fill(0.0);
        self.vectors.fill(Vec3::ZERO);
        self.overlapping.fill(0.0);
        for (y, row) in self.flux.chunks_exact(SIDE).enumerate() {
            let [sin, cos] = cells.row(y);
            let patches = y / CELLS * PATCHES;
            let mut across = [0.0; PATCHES];
            for (i, block) in row.chunks_exact(CELLS).enumerate() {
                let (mut sum, mut dx, mut dz) = (0.0, 0.0, 0.0);
                let (mut left, mut right) = (0.0, 0.0);
                for (k, &flux) in block.iter().enumerate() {
                    let [x, z] = cells.column(i * CELLS + k);
                    sum += flux;
                    dx += flux * x;
                    dz += flux * z;
                    left += flux * (-from_middle(k)).max(0.0);
                    right += flux * from_middle(k).max(0.0);
                }
                self.patches[patches + i] += sum;
                self.vectors[patches + i] += Vec3::new(sin * dx, cos * sum, sin * dz);
                across[i] += sum - left - right;
                across[(i + PATCHES - 1) % PATCHES] += left;
                across[(i + 1) % PATCHES] += right;
            }
            let down = from_middle(y % CELLS);
            let own = y / CELLS;
            let next = if down < 0.0 {
                own.saturating_sub(1)
            } else {
                (own + 1).min(PATCHES - 1)
            };
            for (i, flux) in across.into_iter().enumerate() {
                self.overlapping[own * PATCHES + i] += flux * (1.0 - down.abs());
                self.overlapping[next * PATCHES + i] += flux * down.abs();
            }
        }
        self.all = self.patches.iter().sum();
        for (irradiance, n) in self.irradiance.iter_mut().zip(surfaces) {
            let seen = self.vectors.iter().map(|vector| vector.dot(*n).max(0.0));
            *irradiance = seen.sum();
        }
    }

    fn take_logs(&mut self, cells: &Grid, floor: f32) {
        let rows = self.log.chunks_exact_mut(SIDE);
        let rows = rows.zip(self.flux.chunks_exact(SIDE));
        for (y, (logs, fluxes)) in rows.enumerate() {
            let inverse = 1.0 / cells.solid_angle(y);
            for (log, flux) in logs.iter_mut().zip(fluxes) {
                *log = (flux * inverse + floor).log2();
            }
        }
    }
}

/// How far the middle of a patch's cell `k` is from the patch's own, in patches.
fn from_middle(k: usize) -> f32 {
    (k as f32 + 0.5) / CELLS as f32 - 0.5
}

/// Flux by which the cells of a patch differ.
fn exchanged(a: &Gathered, b: &Gathered, patch: usize) -> f32 {
    let corner = (patch % PATCHES + patch / PATCHES * SIDE) * CELLS;
    let rows = (0..CELLS).map(|y| corner + y * SIDE..corner + y * SIDE + CELLS);
    rows.flat_map(|row| a.flux[row.clone()].iter().zip(&b.flux[row]))
        .map(|(a, b)| (a - b).abs())
        .sum()
}

/// 1 − τ of a patch.
fn patch_change(a: &Gathered, b: &Gathered, patch: usize) -> f32 {
    let corner = (patch % PATCHES + patch / PATCHES * SIDE) * CELLS;
    let mut sums = [0.0_f32; 5];
    // Logs from the patch's first cell on, so that squares of f32 keep their digits.
    let middle = a.log[corner];
    for y in 0..CELLS {
        let row = corner + y * SIDE..corner + y * SIDE + CELLS;
        for (a, b) in a.log[row.clone()].iter().zip(&b.log[row]) {
            let (a, b) = (a - middle, b - middle);
            for (sum, term) in sums.iter_mut().zip([a, b, a * a, b * b, a * b]) {
                *sum += term;
            }
        }
    }
    let [a, b, aa, bb, ab] = sums.map(|sum| sum / (CELLS * CELLS) as f32);
    let (va, vb, covariance) = (aa - a * a, bb - b * b, ab - a * b);
    let means = C1 / ((a - b).powi(2) + C1);
    let structure = (2.0 * covariance + C2) / (va + vb + C2);
    (1.0 - means * structure.max(0.0)).max(0.0)
}

/// The cells across, or down, that the `i`th of `count` texels covers, or the one that it lies in.
fn covered(i: usize, count: usize) -> std::ops::Range<usize> {
    let start = i * SIDE / count;
    start..((i + 1) * SIDE / count).max(start + 1)
}

/// Adds a disc light's flux to the four cells around it.
fn add_light(flux: &mut [f32], direction: DVec3, light: f32) {
    let [u, v] = EnvironmentMap::uv_from_direction(direction).map(|t| t * SIDE as f64 - 0.5);
    let ([column, row], [right, down]) = ([u.floor(), v.floor()], [u - u.floor(), v - v.floor()]);
    for (y, wy) in [(row, 1.0 - down), (row + 1.0, down)] {
        let y = y.clamp(0.0, SIDE as f64 - 1.0) as usize;
        for (x, wx) in [(column, 1.0 - right), (column + 1.0, right)] {
            let x = (x as i64).rem_euclid(SIDE as i64) as usize;
            flux[x + SIDE * y] += light * (wx * wy) as f32;
        }
    }
}

/// Means over 3 × 3 cells, weights 1 2 1.
fn blur(flux: &mut [f32], rows: &mut [[f32; SIDE]; 2]) {
    for row in flux.chunks_exact_mut(SIDE) {
        let (first, last) = (row[0], row[SIDE - 1]);
        let mut left = last;
        for x in 0..SIDE {
            let right = if x + 1 < SIDE { row[x + 1] } else { first };
            let own = row[x];
            row[x] = 0.25 * (left + right) + 0.5 * own;
            left = own;
        }
    }
    // The row above as it was, and this one.
    let [above, own] = rows;
    above.copy_from_slice(&flux[..SIDE]);
    for y in 0..SIDE {
        let below = SIDE * (y + 1).min(SIDE - 1);
        own.copy_from_slice(&flux[SIDE * y..][..SIDE]);
        for x in 0..SIDE {
            flux[SIDE * y + x] = 0.25 * (above[x] + flux[below + x]) + 0.5 * own[x];
        }
        above.copy_from_slice(own);
    }
}
