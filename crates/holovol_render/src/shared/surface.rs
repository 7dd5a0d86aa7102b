//! Twin of `surface.wgsl`, with the surface term compiled in.

use std::f32::consts::{PI, TAU};

use glam::Vec3;

use super::phase_function::{basis_around, phase_eval, phase_sample};

/// A gradient surface at a scattering point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Unit normal on the side of wo.
    pub normal: Vec3,
    /// P: probability of the surface over the phase function.
    pub probability: f32,
    /// F0; 0: no lobe.
    pub specular: f32,
    /// Of GGX.
    pub alpha: f32,
}

/// Schlick's reflectance.
pub fn fresnel(specular: f32, cosine: f32) -> f32 {
    if specular == 0.0 {
        return 0.0;
    }
    let m = (1.0 - cosine).clamp(0.0, 1.0);
    let m2 = m * m;
    specular + (1.0 - specular) * m2 * m2 * m
}

fn ggx_density(alpha: f32, normal: Vec3, h: Vec3) -> f32 {
    let a2 = alpha * alpha;
    let across = normal.cross(h);
    let n_h = normal.dot(h);
    let d = across.dot(across) + n_h * n_h * a2;
    a2 / (PI * d * d)
}

fn ggx_visibility(alpha: f32, n_o: f32, n_i: f32) -> f32 {
    let a2 = alpha * alpha;
    let root = |cosine: f32| (a2 + (1.0 - a2) * cosine * cosine).sqrt();
    0.5 / (n_i * root(n_o) + n_o * root(n_i)).max(1e-12)
}

fn specular_probability(surface: &Surface, n_o: f32) -> f32 {
    if surface.specular > 0.0 {
        fresnel(surface.specular, n_o).clamp(0.1, 0.9)
    } else {
        0.0
    }
}

/// f, 1/sr: phase function and surface, blended.
pub fn scatter_eval(g: f32, surface: &Surface, wo: Vec3, wi: Vec3) -> f32 {
    let mut f = (1.0 - surface.probability) * phase_eval(g, wo, wi);
    let n_i = surface.normal.dot(wi);
    if n_i > 0.0 && surface.probability > 0.0 {
        let n_o = surface.normal.dot(wo).max(0.0);
        let mut lobe = (1.0 - fresnel(surface.specular, n_o)) * n_i / PI;
        if surface.specular > 0.0 {
            let h = (wo + wi).normalize();
            lobe += ggx_density(surface.alpha, surface.normal, h)
                * ggx_visibility(surface.alpha, n_o, n_i)
                * n_i
                * fresnel(surface.specular, h.dot(wo));
        }
        f += surface.probability * lobe;
    }
    f
}

/// Density of [`scatter_sample`], 1/sr.
pub fn scatter_pdf(g: f32, surface: &Surface, wo: Vec3, wi: Vec3) -> f32 {
    let mut pdf = (1.0 - surface.probability) * phase_eval(g, wo, wi);
    if surface.probability > 0.0 {
        let n_i = surface.normal.dot(wi);
        let n_o = surface.normal.dot(wo).max(0.0);
        let specular = specular_probability(surface, n_o);
        let mut lobe = (1.0 - specular) * n_i.max(0.0) / PI;
        let half = wo + wi;
        if specular > 0.0 && surface.normal.dot(half) > 0.0 {
            let a2 = surface.alpha * surface.alpha;
            let root = (a2 + (1.0 - a2) * n_o * n_o).sqrt();
            lobe += specular * ggx_density(surface.alpha, surface.normal, half.normalize()) * 0.5
                / (n_o + root).max(1e-12);
        }
        pdf += surface.probability * lobe;
    }
    pdf
}

/// Draws wi; the third number chooses the lobe.
pub fn scatter_sample(g: f32, surface: &Surface, wo: Vec3, [x, y, z]: [f32; 3]) -> Vec3 {
    if z >= surface.probability {
        return phase_sample(g, wo, [x, y]);
    }
    let frame = basis_around(surface.normal);
    let n_o = surface.normal.dot(wo).max(0.0);
    let (sin_phi, cos_phi) = (TAU * y).sin_cos();
    if z >= surface.probability * specular_probability(surface, n_o) {
        let radius = x.sqrt();
        let up = (1.0 - x).max(0.0).sqrt();
        return (frame * Vec3::new(radius * cos_phi, radius * sin_phi, up)).normalize();
    }
    let wo_local = frame.transpose() * wo;
    let stretch = Vec3::new(surface.alpha, surface.alpha, 1.0);
    let wo_stretched = (stretch * wo_local.max(Vec3::new(-1.0, -1.0, 0.0))).normalize();
    let up = (1.0 - x) * (1.0 + wo_stretched.z) - wo_stretched.z;
    let sin_theta = (1.0 - up * up).clamp(0.0, 1.0).sqrt();
    let cap = Vec3::new(sin_theta * cos_phi, sin_theta * sin_phi, up) + wo_stretched;
    let local = Vec3::new(
        surface.alpha * cap.x,
        surface.alpha * cap.y,
        cap.z.max(1e-7),
    );
    let h = (frame * local.normalize()).normalize();
    (2.0 * wo.dot(h) * h - wo).normalize()
}
