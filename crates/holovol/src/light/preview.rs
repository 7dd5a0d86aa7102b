//! The first frame with its lights marked.

use std::f64::consts::TAU;

use glam::DVec3;
use holovol_light::EnvironmentMap;
use holovol_light::response::linear_to_srgb;

use super::LightReport;
use super::input::Linear;
use crate::output::Picture;

/// Rings of disc lights, and outlines of larger ones.
const COLORS: [[u8; 4]; 2] = [[255, 40, 40, 255], [40, 220, 255, 255]];
/// Points of a ring.
const POINTS: usize = 1440;
/// Smallest ring, radians, that can be seen.
const SMALLEST: f64 = 0.03;

/// Draws each light as a ring of its solid angle; the sun's is larger than it is.
pub(crate) fn draw(frame: &Linear, lights: &[LightReport]) -> Picture {
    let code = |l: f32| (linear_to_srgb(f64::from(l.clamp(0.0, 1.0))) * 255.0).round() as u8;
    let mut picture = Picture {
        width: frame.width as u32,
        height: frame.height as u32,
        pixels: frame
            .texels
            .iter()
            .map(|&[r, g, b]| [code(r), code(g), code(b), 255])
            .collect(),
    };
    for light in lights {
        let direction = DVec3::from_array(light.direction);
        let angle = (1.0 - light.solid_angle / TAU)
            .clamp(-1.0, 1.0)
            .acos()
            .max(SMALLEST);
        let (across, along) = direction.any_orthonormal_pair();
        for i in 0..POINTS {
            let (sin, cos) = (i as f64 / POINTS as f64 * TAU).sin_cos();
            let at = direction * angle.cos() + (across * cos + along * sin) * angle.sin();
            let [u, v] = EnvironmentMap::uv_from_direction(at);
            let x = ((u * frame.width as f64) as usize).min(frame.width - 1);
            let y = ((v * frame.height as f64) as usize).min(frame.height - 1);
            picture.pixels[x + frame.width * y] = COLORS[usize::from(!light.disc)];
        }
    }
    picture
}
