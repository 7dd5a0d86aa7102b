//! T: how much the illumination changed since the last frame (DESIGN §6).

use glam::DVec3;

use crate::estimate::Light;
use crate::{Grid, luminance};

/// Patches across and down.
const PATCHES: usize = 16;
/// Cells across and down in a patch: what SSIM compares.
const CELLS: usize = 8;
const SIDE: usize = PATCHES * CELLS;
/// Radiance, relative to the mean, below which a camera's noise hides changes.
const FLOOR: f64 = 0.02;
/// A change of a patch's mean by this much, EV, halves its similarity.
const C1: f64 = 0.3 * 0.3;
/// Structure below this spread, EV, is noise.
const C2: f64 = 2.0 * 0.15 * 0.15;
/// A patch that gives a surface which faces it less than this share of the mean irradiance can't
/// change it by more, and is left out.
const SMALLEST: f64 = 0.01;
/// A patch that changes irradiance by this share counts in full, one that changes it by less in
/// proportion.
const FULL: f64 = 0.06;

/// Compares each frame's light with the last one's; allocates nothing after the first.
///
/// The similarity τ of a patch is an SSIM of log radiance: C1/(Δμ² + C1) in place of SSIM's term
/// of means, which depends on the unit of radiance, times (2σ₁₂ + C2)/(σ₁² + σ₂² + C2).
/// T = 1 − min τ, where a patch's 1 − τ counts by the share of the light that moved in it: a
/// person who walks past a wall changes the wall wholly and the light hardly.
#[derive(Clone, Debug)]
pub struct ChangeDetector {
    flux: [Vec<f64>; 2],
    log: [Vec<f64>; 2],
    solid_angles: Vec<f64>,
    floor: f64,
    newest: usize,
    frames: usize,
}

impl Default for ChangeDetector {
    fn default() -> Self {
        Self::new()
    }
}

impl ChangeDetector {
    /// A detector that has seen nothing.
    pub fn new() -> Self {
        let zeros = || vec![0.0; SIDE * SIDE];
        let grid = Grid::new(SIDE, SIDE);
        Self {
            flux: [zeros(), zeros()],
            log: [zeros(), zeros()],
            solid_angles: (0..SIDE).map(|y| f64::from(grid.solid_angle(y))).collect(),
            floor: 0.0,
            newest: 0,
            frames: 0,
        }
    }

    /// Takes a frame's map and the disc lights that are not in it; gives T in 0 … 1, which is 1
    /// for the first frame.
    pub fn update(&mut self, grid: &Grid, texels: &[[f32; 3]], discs: &[Light]) -> f64 {
        self.newest = 1 - self.newest;
        let now = self.newest;
        self.gather(now, grid, texels, discs);
        self.frames += 1;
        if self.frames == 1 {
            return 1.0;
        }
        let total = |flux: &[f64]| flux.iter().sum::<f64>();
        let all = total(&self.flux[0]).max(total(&self.flux[1]));
        if all <= 0.0 {
            return 0.0;
        }
        let mut change = 0.0_f64;
        for patch in 0..PATCHES * PATCHES {
            let corner = (patch % PATCHES + patch / PATCHES * SIDE) * CELLS;
            change = change.max(self.patch_change(corner, all));
        }
        change.clamp(0.0, 1.0)
    }

    fn patch_change(&self, corner: usize, all: f64) -> f64 {
        let (mut moved, mut sums, mut fluxes) = (0.0, [0.0; 5], [0.0; 2]);
        for y in 0..CELLS {
            for i in corner + y * SIDE..corner + y * SIDE + CELLS {
                let (flux, other) = (self.flux[0][i], self.flux[1][i]);
                moved += (flux - other).abs();
                fluxes[0] += flux;
                fluxes[1] += other;
                let (a, b) = (self.log[0][i], self.log[1][i]);
                for (sum, term) in sums.iter_mut().zip([a, b, a * a, b * b, a * b]) {
                    *sum += term;
                }
            }
        }
        // Mean irradiance is a quarter of all flux.
        if 4.0 * fluxes[0].max(fluxes[1]) / all < SMALLEST {
            return 0.0;
        }
        let share = 4.0 * moved / all;
        let [a, b, aa, bb, ab] = sums.map(|sum| sum / (CELLS * CELLS) as f64);
        let (va, vb, covariance) = (aa - a * a, bb - b * b, ab - a * b);
        let means = C1 / ((a - b).powi(2) + C1);
        let structure = (2.0 * covariance + C2) / (va + vb + C2);
        (1.0 - means * structure.max(0.0)) * (share / FULL).min(1.0)
    }

    fn gather(&mut self, now: usize, grid: &Grid, texels: &[[f32; 3]], discs: &[Light]) {
        let (width, height) = (grid.width(), grid.height());
        let flux = &mut self.flux[now];
        flux.fill(0.0);
        for (y, row) in texels.chunks_exact(width).take(height).enumerate() {
            let solid_angle = grid.solid_angle(y);
            let cells = &mut flux[y * SIDE / height * SIDE..][..SIDE];
            if width % SIDE == 0 {
                let per_cell = width / SIDE;
                for (cell, texels) in cells.iter_mut().zip(row.chunks_exact(per_cell)) {
                    let mut sum = [0.0_f32; 3];
                    for texel in texels {
                        for c in 0..3 {
                            sum[c] += texel[c];
                        }
                    }
                    let sum = 0.2126 * sum[0] + 0.7152 * sum[1] + 0.0722 * sum[2];
                    *cell += f64::from(sum * solid_angle);
                }
            } else {
                for (x, texel) in row.iter().enumerate() {
                    let l = luminance(texel.map(f64::from));
                    cells[x * SIDE / width] += l * f64::from(solid_angle);
                }
            }
        }
        // Maps smaller than the cells leave gaps, which are alike in every frame.
        for light in discs.iter().filter(|light| light.disc) {
            flux[cell_of(light.direction)] += luminance(light.irradiance);
        }
        let total: f64 = flux.iter().sum();
        let mean = total / (4.0 * std::f64::consts::PI);
        // Both frames' logs share a floor. It follows the light only when that has become another,
        // so that as a rule the old frame's logs stay.
        let usual = self.floor * 0.5..=self.floor * 2.0;
        if usual.contains(&(FLOOR * mean)) && self.floor > 0.0 {
            self.take_logs(now);
        } else {
            self.floor = (FLOOR * mean).max(1e-12);
            self.take_logs(0);
            self.take_logs(1);
        }
    }

    fn take_logs(&mut self, frame: usize) {
        let rows = self.log[frame].chunks_exact_mut(SIDE);
        let rows = rows.zip(self.flux[frame].chunks_exact(SIDE));
        for ((logs, fluxes), solid_angle) in rows.zip(&self.solid_angles) {
            for (log, flux) in logs.iter_mut().zip(fluxes) {
                *log = f64::from(((flux / solid_angle + self.floor) as f32).log2());
            }
        }
    }
}

fn cell_of(direction: DVec3) -> usize {
    let [u, v] = crate::EnvironmentMap::uv_from_direction(direction);
    let at = |t: f64| ((t * SIDE as f64) as usize).min(SIDE - 1);
    at(u) + SIDE * at(v)
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 256;
    const HEIGHT: usize = 128;

    struct Noise(u64);

    impl Noise {
        /// Normal enough: the sum of four uniforms.
        fn next(&mut self) -> f32 {
            let mut sum = 0.0;
            for _ in 0..4 {
                self.0 = self
                    .0
                    .wrapping_mul(6364136223846793005)
                    .wrapping_add(1442695040888963407);
                sum += (self.0 >> 40) as f32 / (1u64 << 24) as f32 - 0.5;
            }
            sum * 1.7
        }
    }

    /// A room with structure, a lamp and a person.
    fn room(lamp: f32, person: Option<usize>, noise: Option<u64>) -> Vec<[f32; 3]> {
        let mut noise = noise.map(Noise);
        (0..WIDTH * HEIGHT)
            .map(|i| {
                let (x, y) = (i % WIDTH, i / WIDTH);
                let mut l =
                    0.2 + 0.1 * ((x / 9 + y / 7) % 3) as f32 + 0.4 * (1.0 - y as f32 / 128.0);
                if person.is_some_and(|at| (at..at + 14).contains(&x) && (48..90).contains(&y)) {
                    l = 0.12;
                }
                if (100..106).contains(&x) && (30..36).contains(&y) {
                    l += lamp;
                }
                if let Some(noise) = &mut noise {
                    l *= 1.0 + 0.03 * noise.next();
                }
                [l; 3]
            })
            .collect()
    }

    fn sky(sun_column: usize) -> Vec<[f32; 3]> {
        let grid = Grid::new(WIDTH, HEIGHT);
        let sun = DVec3::from_array(grid.direction(sun_column, 40).map(f64::from));
        (0..WIDTH * HEIGHT)
            .map(|i| {
                let at = DVec3::from_array(grid.direction(i % WIDTH, i / WIDTH).map(f64::from));
                let angle = at.angle_between(sun);
                let disc = if angle < 0.02 { 2000.0 } else { 0.0 };
                [(0.3 + 0.05 / angle.max(0.02) + disc) as f32; 3]
            })
            .collect()
    }

    fn change(a: &[[f32; 3]], b: &[[f32; 3]]) -> f64 {
        let grid = Grid::new(WIDTH, HEIGHT);
        let mut detector = ChangeDetector::new();
        assert_eq!(detector.update(&grid, a, &[]), 1.0);
        detector.update(&grid, b, &[])
    }

    #[test]
    fn nothing_noise_and_compensated_exposure_are_no_change() {
        assert_eq!(
            change(&room(20.0, None, None), &room(20.0, None, None)),
            0.0
        );
        assert!(change(&room(20.0, None, Some(1)), &room(20.0, None, Some(2))) < 0.05);
        // 3 % is what an exposure tag may be off.
        let brighter: Vec<[f32; 3]> = room(20.0, None, None)
            .iter()
            .map(|t| t.map(|c| c * 1.03))
            .collect();
        assert!(change(&room(20.0, None, None), &brighter) < 0.05);
    }

    #[test]
    fn a_person_is_a_small_change() {
        for at in [10, 60, 150] {
            let t = change(&room(20.0, Some(at), None), &room(20.0, Some(at + 8), None));
            assert!((0.0..0.5).contains(&t), "{at}: {t}");
        }
        let t = change(&room(0.0, None, None), &room(0.0, Some(60), None));
        assert!((0.05..0.5).contains(&t), "{t}");
    }

    #[test]
    fn a_moving_sun_and_a_lamp_are_large_changes() {
        let t = change(&sky(100), &sky(107));
        assert!(t > 0.5, "sun: {t}");
        let t = change(&room(0.0, None, None), &room(200.0, None, None));
        assert!(t > 0.8, "lamp: {t}");
        let t = change(&room(200.0, None, None), &room(0.0, None, None));
        assert!(t > 0.8, "lamp off: {t}");
        let half: Vec<[f32; 3]> = sky(100).iter().map(|t| t.map(|c| 0.5 * c)).collect();
        assert!(change(&sky(100), &half) > 0.8);
    }
}
