//! Twin of `environment.wgsl`, with a map that is not constant.

use std::f32::consts::{PI, TAU};

use glam::{IVec2, Vec2, Vec3, ivec2, vec2};
use holovol_light::{EnvironmentSampler, LIGHT_BANDS};

use super::mix;

/// A scene's light as kernels see it.
#[derive(Clone, Debug)]
pub struct Light {
    size: IVec2,
    texels: Vec<Vec3>,
    /// Thresholds and aliases (column, row) of the patches.
    alias: Vec<(f32, [u16; 2])>,
    band_rows: u32,
    normalisation: f32,
    cos_sin: Vec2,
    scale: f32,
}

/// Radiance from a direction, and the density with which it is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightSample {
    /// World direction, unit.
    pub wi: Vec3,
    /// Scaled radiance.
    pub radiance: Vec3,
    /// 1/sr.
    pub pdf: f32,
}

/// What densities are proportional to.
pub fn importance(rgb: Vec3) -> f32 {
    (rgb.x + rgb.y + rgb.z) * (1.0 / 3.0)
}

/// Mean of sin(theta) over the strip below a row.
pub fn strip_sine(row: i32, height: i32) -> f32 {
    let v0 = ((row as f32 + 0.5) / height as f32).max(0.0);
    let v1 = ((row as f32 + 1.5) / height as f32).min(1.0);
    let half_width = 0.5 * PI * (v1 - v0);
    (0.5 * PI * (v0 + v1)).sin() * half_width.sin() / half_width
}

fn sample_linear(a: f32, b: f32, xi: f32) -> f32 {
    let scale = 1.0 / a.max(b).max(1e-37);
    let (low, high) = (a * scale, b * scale);
    let root = mix(low * low, high * high, xi).sqrt();
    (xi * (low + high) / (low + root).max(1e-12)).clamp(0.0, 1.0)
}

impl Light {
    /// None if the light is constant or black, and needs no density.
    pub fn new(environment: &holovol_scene::Environment) -> Option<Self> {
        let map = &environment.map;
        if map.as_constant().is_some() {
            return None;
        }
        let sampler = EnvironmentSampler::new(map)?;
        let (sin, cos) = environment.rotation_y.sin_cos();
        let entries = sampler.entries().iter();
        Some(Self {
            size: ivec2(map.width() as i32, map.height() as i32),
            texels: map.texels().iter().copied().map(Vec3::from_array).collect(),
            alias: entries
                .map(|entry| (entry.threshold, entry.alias))
                .collect(),
            band_rows: (sampler.rows() / LIGHT_BANDS) as u32,
            normalisation: sampler.normalisation() as f32,
            cos_sin: vec2(cos as f32, sin as f32),
            scale: environment.scale as f32,
        })
    }

    fn texel(&self, x: i32, y: i32) -> Vec3 {
        let column = x.rem_euclid(self.size.x);
        self.texels[(column + self.size.x * y.clamp(0, self.size.y - 1)) as usize]
    }

    fn light_sample(&self, wi: Vec3, radiance: Vec3, row: i32, sin_theta: f32) -> LightSample {
        let density = importance(radiance) * self.normalisation * strip_sine(row, self.size.y);
        LightSample {
            wi,
            radiance: radiance * self.scale,
            pdf: density / (2.0 * PI * PI * sin_theta.max(1e-9)),
        }
    }

    /// Light from a world direction.
    pub fn eval(&self, wi: Vec3) -> LightSample {
        let Vec2 { x: c, y: s } = self.cos_sin;
        let d = Vec3::new(c * wi.x - s * wi.z, wi.y, s * wi.x + c * wi.z);
        let u = 0.5 + d.x.atan2(-d.z) / TAU;
        let sin_theta = (d.x * d.x + d.z * d.z).sqrt();
        let v = sin_theta.atan2(d.y) / PI;
        let texel = vec2(u, v) * self.size.as_vec2() - 0.5;
        let weight = texel - texel.floor();
        let i = texel.floor().as_ivec2();
        let radiance = self.bilinear(i, weight);
        self.light_sample(wi, radiance, i.y, sin_theta)
    }

    fn bilinear(&self, i: IVec2, weight: Vec2) -> Vec3 {
        let lerp = |a: Vec3, b: Vec3, t: f32| a * (1.0 - t) + b * t;
        let row = |y| lerp(self.texel(i.x, y), self.texel(i.x + 1, y), weight.x);
        lerp(row(i.y), row(i.y + 1), weight.y)
    }

    /// Draws a direction: `bits` and `v` choose the patch, xi the rest.
    pub fn sample(&self, bits: u32, v: f32, xi: [f32; 3]) -> LightSample {
        let wide = |a: u32, b: u32| u64::from(a) * u64::from(b);
        let band = wide(bits, LIGHT_BANDS as u32);
        let column = wide(band as u32, self.size.x as u32) >> 32;
        let rows = self.band_rows as f32;
        let row = (band >> 32) as u32 * self.band_rows + (v * rows).floor().min(rows - 1.0) as u32;
        let (mut column, mut row) = (column as i32, row as i32);
        let (threshold, alias) = self.alias[(column + self.size.x * row) as usize];
        if xi[0] >= threshold {
            [column, row] = alias.map(i32::from);
        }
        row -= 1;
        let corner = |x, y| importance(self.texel(column + x, row + y));
        let top = [corner(0, 0), corner(1, 0)];
        let bottom = [corner(0, 1), corner(1, 1)];
        let y = sample_linear(top[0] + top[1], bottom[0] + bottom[1], xi[2]);
        let left = mix(top[0], bottom[0], y);
        let right = mix(top[1], bottom[1], y);
        let x = sample_linear(left, right, xi[1]);
        let corner = vec2(column as f32, row as f32);
        let uv = (corner + 0.5 + vec2(x, y)) / self.size.as_vec2();
        let mirrored = if uv.y > 1.0 { 2.0 - uv.y } else { uv.y.abs() };
        let radiance = self.bilinear(ivec2(column, row), vec2(x, y));
        let (sin_theta, cos_theta) = (mirrored * PI).sin_cos();
        let (sin_phi, cos_phi) = ((uv.x - 0.5) * TAU).sin_cos();
        let d = Vec3::new(sin_theta * sin_phi, cos_theta, -sin_theta * cos_phi);
        let Vec2 { x: c, y: s } = self.cos_sin;
        let wi = Vec3::new(c * d.x + s * d.z, d.y, c * d.z - s * d.x);
        self.light_sample(wi, radiance, row, sin_theta)
    }
}
