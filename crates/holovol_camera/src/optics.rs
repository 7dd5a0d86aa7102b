//! Lenses as a camera has them: from a place in the picture to the ray that arrives there.

use glam::{DVec2, DVec3};

/// A fisheye lens; lengths are in units of half the picture's shorter side, positions relative to
/// its middle, x right and y down.
#[derive(Clone, Debug, PartialEq)]
pub enum VirtualLens {
    /// Radius proportional to the angle from the axis.
    Equidistant {
        /// Angle from the axis at radius 1, radians.
        edge: f64,
    },
    /// Radius an odd polynomial of the angle (Kannala and Brandt 2006).
    KannalaBrandt {
        /// Radius per radian on the axis.
        focal: f64,
        /// Factors of θ³, θ⁵, θ⁷, θ⁹.
        k: [f64; 4],
        /// Angle from the axis at which the picture ends, radians.
        edge: f64,
    },
    /// A sphere seen from a point on its axis, then radial and tangential distortion
    /// (Mei and Rives 2007).
    Mei {
        /// Distance of that point from the sphere's centre.
        xi: f64,
        /// Focal length.
        focal: f64,
        /// Radial distortion.
        k: [f64; 3],
        /// Tangential distortion.
        p: [f64; 2],
        /// Angle from the axis at which the picture ends, radians.
        edge: f64,
    },
    /// Radius any polynomial of the angle, as omnidirectional toolboxes fit it.
    Polynomial {
        /// Factors of θ⁰, θ¹, …
        factors: Vec<f64>,
        /// Angle from the axis at which the picture ends, radians.
        edge: f64,
    },
}

impl VirtualLens {
    /// Angle from the axis at which the picture ends, radians.
    pub fn edge(&self) -> f64 {
        match self {
            Self::Equidistant { edge }
            | Self::KannalaBrandt { edge, .. }
            | Self::Mei { edge, .. }
            | Self::Polynomial { edge, .. } => *edge,
        }
    }

    /// The direction seen at a place of the picture, in the lens's frame (z along its axis);
    /// `None` outside the image circle.
    pub fn ray(&self, place: DVec2) -> Option<DVec3> {
        let radius = place.length();
        let angle = match self {
            Self::Equidistant { edge } => radius * edge,
            Self::KannalaBrandt { focal, k, edge } => {
                let series = |t: f64| {
                    focal
                        * (t + k[0] * t.powi(3)
                            + k[1] * t.powi(5)
                            + k[2] * t.powi(7)
                            + k[3] * t.powi(9))
                };
                invert(series, radius, *edge)?
            }
            Self::Polynomial { factors, edge } => {
                let value = |t: f64| {
                    factors
                        .iter()
                        .enumerate()
                        .map(|(i, a)| a * t.powi(i as i32))
                        .sum()
                };
                invert(value, radius, *edge)?
            }
            Self::Mei {
                xi,
                focal,
                k,
                p,
                edge,
            } => return mei_ray(place / *focal, *xi, *k, *p, *edge),
        };
        if angle > self.edge() {
            return None;
        }
        let heading = if radius > 0.0 {
            place / radius
        } else {
            DVec2::ZERO
        };
        Some((heading * angle.sin()).extend(angle.cos()))
    }
}

/// The angle up to `edge` at which a rising function takes a value, by bisection.
fn invert(function: impl Fn(f64) -> f64, value: f64, edge: f64) -> Option<f64> {
    if value > function(edge) {
        return None;
    }
    let (mut low, mut high) = (0.0, edge);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if function(middle) < value {
            low = middle;
        } else {
            high = middle;
        }
    }
    Some(0.5 * (low + high))
}

fn mei_ray(distorted: DVec2, xi: f64, k: [f64; 3], p: [f64; 2], edge: f64) -> Option<DVec3> {
    // Undo the distortion by fixed-point iteration, then lift to the sphere in closed form.
    let parts = |m: DVec2| {
        let r = m.length_squared();
        let bend = DVec2::new(
            2.0 * p[0] * m.x * m.y + p[1] * (r + 2.0 * m.x * m.x),
            p[0] * (r + 2.0 * m.y * m.y) + 2.0 * p[1] * m.x * m.y,
        );
        (1.0 + k[0] * r + k[1] * r * r + k[2] * r * r * r, bend)
    };
    let mut m = distorted;
    for _ in 0..50 {
        let (radial, bend) = parts(m);
        m = (distorted - bend) / radial;
    }
    // Far outside the circle the iteration goes anywhere.
    let (radial, bend) = parts(m);
    let off = (m * radial + bend - distorted).length();
    if off.is_nan() || off > 1e-9 {
        return None;
    }
    let r = m.length_squared();
    let root = 1.0 + (1.0 - xi * xi) * r;
    if root.is_nan() || root < 0.0 {
        return None;
    }
    let factor = (xi + root.sqrt()) / (r + 1.0);
    let ray = DVec3::new(factor * m.x, factor * m.y, factor - xi);
    let angle = ray.truncate().length().atan2(ray.z);
    (angle <= edge).then(|| ray.normalize())
}

#[cfg(test)]
mod tests {
    use super::*;
    use holovol_light::lens::{LensModel, Projection};

    /// The two implementations share nothing: what one projects, the other must see there.
    #[test]
    fn rays_land_where_the_stitcher_looks_for_them() {
        let edge = 97.0_f64.to_radians();
        let fov_deg = 195.0;
        let (scale, centre) = (700.0, [720.0, 730.0]);
        let pairs = [
            (
                VirtualLens::Equidistant { edge },
                LensModel::Equidistant {
                    focal: scale / edge,
                    centre,
                    fov_deg,
                },
            ),
            (
                VirtualLens::KannalaBrandt {
                    focal: 0.6,
                    k: [-0.02, 0.003, 1e-4, -2e-5],
                    edge,
                },
                LensModel::KannalaBrandt {
                    focal: [0.6 * scale; 2],
                    centre,
                    k: [-0.02, 0.003, 1e-4, -2e-5],
                    fov_deg,
                },
            ),
            (
                VirtualLens::Mei {
                    xi: 2.0,
                    focal: 1.8,
                    k: [0.05, -0.01, 0.0],
                    p: [1e-3, -2e-3],
                    edge,
                },
                LensModel::Mei {
                    xi: 2.0,
                    focal: [1.8 * scale; 2],
                    centre,
                    k: [0.05, -0.01, 0.0],
                    p: [1e-3, -2e-3],
                    fov_deg,
                },
            ),
            (
                VirtualLens::Polynomial {
                    factors: vec![0.0, 0.62, 0.0, -0.02],
                    edge,
                },
                LensModel::OCam {
                    polynomial: [0.0, 0.62, 0.0, -0.02].map(|a| a * scale).to_vec(),
                    centre,
                    affine: [1.0, 0.0, 0.0],
                    fov_deg,
                },
            ),
        ];
        for (lens, model) in pairs {
            for place in [DVec2::ZERO, DVec2::new(0.3, -0.2), DVec2::new(-0.7, 0.55)] {
                let ray = lens.ray(place).expect("inside the circle");
                let pixel = model.project(ray).expect("seen");
                let expected = DVec2::from_array(centre) + place * scale;
                assert!(
                    (pixel - expected).length() < 1e-3,
                    "{lens:?} {place}: {pixel}"
                );
            }
            assert!(lens.ray(DVec2::splat(5.0)).is_none(), "{lens:?}");
        }
    }
}
