//! Twins of paper.wgsl.

use glam::{UVec2, Vec3, Vec4};

use super::{Key, Memory, project};
use crate::denoise::uniforms::History;

const ALPHA: f32 = 0.5;
const BETA: f32 = 2.0;

impl Memory {
    fn bilateral(&self, [a, b]: [Key; 2], albedos: [Vec3; 2], pixel_size: f32) -> f32 {
        let albedo = albedos[0] - albedos[1];
        let depth =
            (a.depth - b.depth) / (a.spread + b.spread + 2.0 * pixel_size * a.depth + 1e-30);
        let [_, albedo_falloff, gradient, depth_falloff] = self.uniform.bias;
        let exponent = albedo_falloff * albedo.dot(albedo)
            + gradient * (1.0 - a.normal.dot(b.normal))
            + depth_falloff * (depth * depth).min(1e4);
        (-exponent).exp()
    }

    /// The pixel of an image that a place falls into.
    fn pixel_at(&self, [width, height, first]: [usize; 3], place: Vec3) -> Option<usize> {
        let size = UVec2::new(width as u32, height as u32);
        let at = place.truncate() / place.z;
        let is_inside =
            place.z > 0.0 && at.cmpge(glam::Vec2::ZERO).all() && at.cmplt(size.as_vec2()).all();
        let p = at.as_uvec2().min(size - UVec2::ONE);
        is_inside.then(|| first + p.x as usize + width * p.y as usize)
    }

    fn first_step_at(&self, pixel: usize) -> usize {
        4 * self.pixels() + pixel
    }

    pub(super) fn near(&mut self) {
        let radius = self.radius;
        self.each_pixel(|m, eye, position, pixel| {
            let (key, albedo) = (m.key(m.now() + pixel), m.albedo(pixel));
            let size = m.size(eye);
            let falloff = 0.5 / (m.uniform.bias[0] * m.uniform.bias[0]).max(1e-6);
            let (mut sum, mut total) = (Vec4::ZERO, 0.0);
            for y in position.y.saturating_sub(radius)..=(position.y + radius).min(size.y - 1) {
                for x in position.x.saturating_sub(radius)..=(position.x + radius).min(size.x - 1) {
                    let at = m.pixel(eye, x, y);
                    let Some(value) = m.sample(eye, at) else {
                        continue;
                    };
                    let offset = UVec2::new(x, y).as_vec2() - position.as_vec2();
                    let keys = [key, m.key(m.now() + at)];
                    let w = (-falloff * offset.dot(offset)).exp()
                        * m.bilateral(keys, [albedo, m.albedo(at)], m.pixel_size(eye));
                    sum += w * value;
                    total += w;
                }
            }
            let at = m.scratch(pixel);
            m.state[at] = if total > 0.0 { sum / total } else { Vec4::ZERO };
        });
    }

    pub(super) fn first_step(&mut self) {
        self.each_pixel(|m, eye, position, pixel| {
            let key = m.key(m.now() + pixel);
            let albedo = m.albedo(pixel);
            let pixel_size = m.pixel_size(eye);
            let mut value = m.state[m.scratch(pixel)];
            let here = m.position(eye, position, key.depth);
            let place = project(&m.eye(eye).other, here);
            if key.albedo > 0.0
                && let Some(at) = m.pixel_at(m.image(1 - eye, 0), place)
            {
                let keys = [key.at(place.z, key.normal), m.key(m.now() + at)];
                let zeta = m.bilateral(keys, [albedo, m.albedo(at)], pixel_size);
                value = (value + zeta * m.state[m.scratch(at)]) / (1.0 + zeta);
            }
            let change = m.eye(eye).history[2];
            let has_history = m.eye(eye).frame[1] != History::None as u32 && change < 1.0;
            let place = project(&m.eye(eye).previous, here);
            if has_history
                && key.albedo > 0.0
                && let Some(at) = m.pixel_at(m.image_before(eye, 0), place)
            {
                let before = m.key(m.before() + at);
                let keys = [key.at(place.z, m.turned(eye, key.normal)), before];
                let means = [albedo.element_sum() / 3.0, before.albedo].map(Vec3::splat);
                let zeta = m.bilateral(keys, means, pixel_size);
                let weight = zeta / (1.0 + (-1.0 / (change - 1.0)).exp());
                value = (value + weight * m.state[m.before() + at]) / (1.0 + weight);
            }
            let at = m.first_step_at(pixel);
            m.state[at] = value;
        });
    }

    pub(super) fn second_step(&mut self) {
        self.each_pixel(|m, eye, position, pixel| {
            let key = m.key(m.now() + pixel);
            let mut value = m.state[m.first_step_at(pixel)];
            let here = m.position(eye, position, key.depth);
            let place = project(&m.eye(eye).other, here);
            if key.albedo > 0.0
                && let Some(at) = m.pixel_at(m.image(1 - eye, 0), place)
            {
                let difference = (m.albedo(pixel) - m.albedo(at)).length();
                let lambda = ALPHA * (BETA - (-difference).exp());
                value = m.state[m.first_step_at(at)].lerp(value, lambda);
            }
            let at = m.now() + pixel;
            m.state[at] = value;
            m.output[pixel] = value
                .truncate()
                .max(Vec3::ZERO)
                .extend(value.w.clamp(0.0, 1.0));
        });
    }
}
