//! The scalar field and its extinction, in texel coordinates: voxel i's centre is at i + ½.

use glam::{DMat3, DVec3};
use holovol_scene::Scene;
use holovol_volume::TransferFunction;

/// A stored number.
pub trait Stored: Copy + Into<f64> + Send + Sync {}
impl<T: Copy + Into<f64> + Send + Sync> Stored for T {}

/// Voxels as s, the transfer function's argument.
#[derive(Clone, Copy)]
pub struct Field<'a, T> {
    voxels: &'a [T],
    dims: [usize; 3],
    /// s = `slope` · stored + `intercept`.
    slope: f64,
    intercept: f64,
}

impl<'a, T: Stored> Field<'a, T> {
    /// `voxels` are those of the scene's volume, which has checked their number.
    pub fn new(scene: &Scene, voxels: &'a [T]) -> Self {
        let volume = &scene.volume;
        let width = scene.window[1] - scene.window[0];
        Self {
            voxels,
            dims: volume.dims().map(|n| n as usize),
            slope: volume.slope() / width,
            intercept: (volume.intercept() - scene.window[0]) / width,
        }
    }

    pub fn dims(&self) -> [usize; 3] {
        self.dims
    }

    /// s of one voxel.
    #[inline]
    pub fn voxel(&self, [x, y, z]: [usize; 3]) -> f64 {
        self.slope * self.stored(x + self.dims[0] * (y + self.dims[1] * z)) + self.intercept
    }

    #[inline]
    fn stored(&self, index: usize) -> f64 {
        self.voxels[index].into()
    }

    /// s at a point, trilinear, clamped at the border.
    #[inline]
    pub fn sample(&self, texel: DVec3) -> f64 {
        let [nx, ny, nz] = self.dims;
        let axis = |position: f64, n: usize| {
            let clamped = (position - 0.5).clamp(0.0, (n - 1) as f64);
            let low = clamped as usize;
            (low, (low + 1).min(n - 1), clamped - low as f64)
        };
        let (x0, x1, wx) = axis(texel.x, nx);
        let (y0, y1, wy) = axis(texel.y, ny);
        let (z0, z1, wz) = axis(texel.z, nz);
        let lerp = |a: f64, b: f64, t: f64| a + (b - a) * t;
        let [r00, r10] = [y0, y1].map(|y| nx * (y + ny * z0));
        let [r01, r11] = [y0, y1].map(|y| nx * (y + ny * z1));
        let x00 = lerp(self.stored(r00 + x0), self.stored(r00 + x1), wx);
        let x10 = lerp(self.stored(r10 + x0), self.stored(r10 + x1), wx);
        let x01 = lerp(self.stored(r01 + x0), self.stored(r01 + x1), wx);
        let x11 = lerp(self.stored(r11 + x0), self.stored(r11 + x1), wx);
        let stored = lerp(lerp(x00, x10, wy), lerp(x01, x11, wy), wz);
        self.slope * stored + self.intercept
    }

    /// ∇s per metre in the world: central differences over ±1 voxel along each volume axis,
    /// turned by the inverse transpose of `world_from_texel`, that is by `texel_from_world`ᵀ.
    pub fn gradient(&self, texel: DVec3, texel_from_world: &DMat3) -> DVec3 {
        let difference =
            |step: DVec3| 0.5 * (self.sample(texel + step) - self.sample(texel - step));
        let per_texel = DVec3::new(
            difference(DVec3::X),
            difference(DVec3::Y),
            difference(DVec3::Z),
        );
        texel_from_world.transpose() * per_texel
    }
}

/// `sigma_t` over s alone, laid out for fast lookup.
pub struct Extinction {
    s: Vec<f64>,
    sigma_t: Vec<f64>,
}

impl Extinction {
    pub fn new(transfer_function: &TransferFunction) -> Self {
        let points = transfer_function.points();
        Self {
            s: points.iter().map(|p| p.s).collect(),
            sigma_t: points.iter().map(|p| p.sigma_t).collect(),
        }
    }

    /// `sigma_t` at s, 1/m.
    #[inline]
    pub fn at(&self, s: f64) -> f64 {
        let last = self.s.len() - 1;
        if s >= self.s[last] {
            return self.sigma_t[last];
        }
        if s < self.s[0] {
            return self.sigma_t[0];
        }
        // The last point at or before s; points are few, so a plain scan wins.
        let mut low = 0;
        while self.s[low + 1] <= s {
            low += 1;
        }
        let t = (s - self.s[low]) / (self.s[low + 1] - self.s[low]);
        self.sigma_t[low] + (self.sigma_t[low + 1] - self.sigma_t[low]) * t
    }

    /// An upper bound of `sigma_t` over [low, high], both sides of any step at its ends included.
    pub fn bound(&self, low: f64, high: f64) -> f64 {
        // Interpolation may leave the range of the voxels by rounding, and so cross a step.
        let slack = 1e-12 * (1.0 + low.abs() + high.abs());
        let (low, high) = (low - slack, high + slack);
        let mut bound = self.at(low).max(self.at(high));
        for (s, sigma_t) in self.s.iter().zip(&self.sigma_t) {
            if *s >= low && *s <= high {
                bound = bound.max(*sigma_t);
            }
        }
        bound
    }
}
