//! Twin of `transfer_function.wgsl`, on the points as they are uploaded.

use holovol_volume::TransferFunction;

use super::mix;
use crate::trace::uniforms::{GpuTransferPoint, transfer_points};

/// A transfer function on the device.
#[derive(Clone, Debug)]
pub struct Transfer {
    points: Vec<GpuTransferPoint>,
}

/// All that a transfer function says of one s but the extinction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Single-scattering albedo.
    pub albedo: [f32; 3],
    /// Source radiance.
    pub emission: [f32; 3],
    /// Roughness of the surface.
    pub roughness: f32,
    /// F0 of the surface.
    pub specular: f32,
}

impl Transfer {
    /// The points as they are uploaded.
    pub fn new(function: &TransferFunction) -> Self {
        Self {
            points: transfer_points(function),
        }
    }

    fn segment(&self, s: f32) -> usize {
        self.points
            .partition_point(|point| s >= point.density[0])
            .saturating_sub(1)
    }

    fn weight(&self, segment: usize, s: f32) -> f32 {
        let [start, _, _, inverse] = self.points[segment].density;
        ((s - start) * inverse).clamp(0.0, 1.0)
    }

    /// Extinction, 1/m.
    pub fn sigma_t(&self, s: f32) -> f32 {
        let segment = self.segment(s);
        let [_, sigma_t, change, _] = self.points[segment].density;
        sigma_t + change * self.weight(segment, s)
    }

    /// Everything else.
    pub fn material(&self, s: f32) -> Material {
        let segment = self.segment(s);
        let t = self.weight(segment, s);
        let low = &self.points[segment];
        let high = &self.points[(segment + 1).min(self.points.len() - 1)];
        let albedo: [f32; 4] = std::array::from_fn(|c| mix(low.albedo[c], high.albedo[c], t));
        let emission: [f32; 4] = std::array::from_fn(|c| mix(low.emission[c], high.emission[c], t));
        Material {
            albedo: [albedo[0], albedo[1], albedo[2]],
            emission: [emission[0], emission[1], emission[2]],
            roughness: albedo[3],
            specular: emission[3],
        }
    }
}
