//! Twin of `phase_function.wgsl`.

use std::f32::consts::{PI, TAU};

use glam::{Mat3, Vec3};

/// Two unit vectors at right angles to a third, and that one.
pub fn basis_around(n: Vec3) -> Mat3 {
    let s = if n.z >= 0.0 { 1.0 } else { -1.0 };
    let a = -1.0 / (s + n.z);
    let b = n.x * n.y * a;
    Mat3::from_cols(
        Vec3::new(1.0 + s * n.x * n.x * a, s * b, -s * n.x),
        Vec3::new(b, s + n.y * n.y * a, -n.y),
        n,
    )
}

/// Where the phase function peaks.
pub fn phase_peak(g: f32, wo: Vec3) -> Vec3 {
    if g >= 0.0 { -wo } else { wo }
}

/// Henyey–Greenstein, 1/sr.
pub fn phase_eval(g: f32, wo: Vec3, wi: Vec3) -> f32 {
    let difference = wi - phase_peak(g, wo);
    let a = g.abs();
    let d = (1.0 - a) * (1.0 - a) + a * difference.dot(difference);
    (1.0 - a) * (1.0 + a) / (4.0 * PI) / (d * d.sqrt())
}

/// Draws wi.
pub fn phase_sample(g: f32, wo: Vec3, [x, y]: [f32; 2]) -> Vec3 {
    let a = g.abs();
    let d = (1.0 - a) + 2.0 * a * (1.0 - x);
    let s = (1.0 - a) * (1.0 + a) / d;
    let one_minus_cos = ((1.0 - a) * x * (s + (1.0 - a)) / d).clamp(0.0, 2.0);
    let sin_theta = (one_minus_cos * (2.0 - one_minus_cos)).sqrt();
    let (sin_phi, cos_phi) = (TAU * y).sin_cos();
    basis_around(phase_peak(g, wo))
        * Vec3::new(
            sin_theta * cos_phi,
            sin_theta * sin_phi,
            1.0 - one_minus_cos,
        )
}
