//! Twin of `scattering.wgsl`.

use glam::Vec3;

use super::environment::{Light, importance};
use super::random::{pcg3d, unit_float};
use super::surface::{Surface, scatter_eval, scatter_pdf, scatter_sample};

/// Chooses a light direction and its weight (f · radiance / density), from so many candidates of
/// the environment and of the phase function.
pub fn choose_light(
    light: &Light,
    [environment, scatter]: [u32; 2],
    (g, surface, wo): (f32, &Surface, Vec3),
    first: [f32; 2],
    key: [u32; 3],
) -> (Vec3, Vec3) {
    let all = (environment + scatter) as f32;
    let (mut chosen_wi, mut chosen_value, mut chosen_target) = (Vec3::ZERO, Vec3::ZERO, 1.0);
    let mut weight_sum = 0.0;
    for i in 0..environment + scatter {
        let bits = pcg3d([key[0], key[1], key[2].wrapping_add(2 * i)]);
        let xi = pcg3d([key[0], key[1], key[2].wrapping_add(2 * i + 1)]).map(unit_float);
        let candidate = if i < environment {
            let (index, v) = if i == 0 {
                let bits = ((first[0] * 16_777_216.0) as u32) << 8 | bits[1] >> 24;
                (bits, first[1])
            } else {
                (bits[0], unit_float(bits[1]))
            };
            light.sample(index, v, xi)
        } else {
            let [u, v] = match i {
                0 => first,
                _ => [unit_float(bits[0]), unit_float(bits[1])],
            };
            light.eval(scatter_sample(g, surface, wo, [u, v, xi[2]]))
        };
        let value = scatter_eval(g, surface, wo, candidate.wi) * candidate.radiance;
        let mut pdf = environment as f32 / all * candidate.pdf;
        if scatter > 0 {
            pdf += scatter as f32 / all * scatter_pdf(g, surface, wo, candidate.wi);
        }
        let aim = importance(value);
        let weight = if aim > 0.0 && pdf > 0.0 {
            aim / pdf
        } else {
            0.0
        };
        weight_sum += weight;
        if unit_float(bits[2]) * weight_sum < weight {
            (chosen_wi, chosen_value, chosen_target) = (candidate.wi, value, aim);
        }
    }
    (
        chosen_wi,
        chosen_value * (weight_sum / (chosen_target * all)),
    )
}
