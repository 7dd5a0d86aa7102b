//! Scattering: Henyey–Greenstein, blended with a surface where the field has a gradient.
//!
//! `wo` and `wi` are unit directions, both away from the scattering point.

use std::f64::consts::{FRAC_1_PI, PI, TAU};

use glam::DVec3;

use crate::rng::Rng;

/// Two unit directions that make a right-handed orthonormal frame with a third one.
fn frame(axis: DVec3) -> (DVec3, DVec3) {
    let other = if axis.x.abs() < 0.7 {
        DVec3::X
    } else {
        DVec3::Y
    };
    let tangent = axis.cross(other).normalize();
    (tangent, axis.cross(tangent))
}

/// The direction at an angle (cosine) to an axis, at a uniform azimuth.
fn around(axis: DVec3, cosine: f64, rng: &mut Rng) -> DVec3 {
    let (tangent, bitangent) = frame(axis);
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    let (sin_phi, cos_phi) = (TAU * rng.uniform()).sin_cos();
    (axis * cosine + (tangent * cos_phi + bitangent * sin_phi) * sine).normalize()
}

/// Henyey–Greenstein density, 1/sr; `cosine` is dot(−wo, wi).
pub fn henyey_greenstein(g: f64, cosine: f64) -> f64 {
    // (1 − g)² + 2g(1 − cos) keeps its digits for forward scattering near |g| = 1.
    let squared = (1.0 - g) * (1.0 - g) + 2.0 * g * (1.0 - cosine);
    (1.0 - g * g) / (4.0 * PI * squared * squared.sqrt())
}

/// The cosine whose distribution function is ξ. The usual inverse,
/// (1 + g² − ((1 − g²)/(1 + gk))²)/2g with k = 2ξ − 1, expanded so that g may be 0.
fn henyey_greenstein_cosine(g: f64, xi: f64) -> f64 {
    let k = 2.0 * xi - 1.0;
    let numerator = k * (1.0 + g * g) + 0.5 * g * (k * k + 3.0) + 0.5 * g * g * g * (k * k - 1.0);
    let denominator = 1.0 + g * k;
    (numerator / (denominator * denominator)).clamp(-1.0, 1.0)
}

/// The gradient surface at a point (Kroes et al. 2012; DESIGN §2).
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// P: its share of the scattering.
    pub weight: f64,
    /// Unit normal on the side of `wo`.
    pub normal: DVec3,
    /// GGX α.
    pub alpha: f64,
    /// F0; 0 means no lobe.
    pub f0: f64,
}

/// How one point scatters, f without albedo.
#[derive(Clone, Copy, Debug)]
pub struct Phase {
    /// Mean cosine of the volume's part.
    pub g: f64,
    /// The surface's part, if there is any.
    pub surface: Option<Surface>,
    #[cfg(test)]
    pub fault: crate::tests::Fault,
}

impl Surface {
    /// Smallest α: a mirror has no density.
    pub const MIN_ALPHA: f64 = 1e-3;

    fn schlick(&self, cosine: f64) -> f64 {
        if self.f0 == 0.0 {
            return 0.0;
        }
        self.f0 + (1.0 - self.f0) * (1.0 - cosine.clamp(0.0, 1.0)).powi(5)
    }

    /// GGX density of microfacet normals.
    fn distribution(&self, cosine: f64) -> f64 {
        let a2 = self.alpha * self.alpha;
        let d = cosine * cosine * (a2 - 1.0) + 1.0;
        a2 / (PI * d * d)
    }

    /// The bracket of DESIGN §2, the cosine of `wi` included.
    fn eval(&self, wo: DVec3, wi: DVec3) -> f64 {
        let (no, ni) = (self.normal.dot(wo).max(0.0), self.normal.dot(wi));
        if ni <= 0.0 {
            return 0.0;
        }
        let diffuse = (1.0 - self.schlick(no)) * ni * FRAC_1_PI;
        if self.f0 == 0.0 {
            return diffuse;
        }
        let half = (wo + wi).normalize_or(self.normal);
        let a2 = self.alpha * self.alpha;
        // G / (4 no ni) of the height-correlated Smith term, in its form without a division by 0.
        let smith = |a: f64, b: f64| a * (b * b * (1.0 - a2) + a2).sqrt();
        let visibility = 0.5 / (smith(no, ni) + smith(ni, no));
        diffuse
            + self.distribution(self.normal.dot(half))
                * self.schlick(half.dot(wo))
                * visibility
                * ni
    }

    /// Chance of drawing from the lobe rather than from the diffuse part.
    fn lobe_share(&self, wo: DVec3) -> f64 {
        if self.f0 == 0.0 {
            0.0
        } else {
            0.2 + 0.6 * self.schlick(self.normal.dot(wo))
        }
    }
}

impl Phase {
    /// f(wo, wi), 1/sr.
    pub fn eval(&self, wo: DVec3, wi: DVec3) -> f64 {
        #[cfg(test)]
        let g = self.g
            * if self.fault.is(crate::tests::Fault::SignOfG) {
                -1.0
            } else {
                1.0
            };
        #[cfg(not(test))]
        let g = self.g;
        let volume = henyey_greenstein(g, -wo.dot(wi));
        match &self.surface {
            None => volume,
            Some(surface) => {
                (1.0 - surface.weight) * volume + surface.weight * surface.eval(wo, wi)
            }
        }
    }

    /// Density with which [`Self::draw`] draws `wi`, 1/sr.
    pub fn pdf(&self, wo: DVec3, wi: DVec3) -> f64 {
        let volume = henyey_greenstein(self.g, -wo.dot(wi));
        let Some(surface) = &self.surface else {
            return volume;
        };
        let share = surface.lobe_share(wo);
        let diffuse = surface.normal.dot(wi).max(0.0) * FRAC_1_PI;
        let lobe = if share > 0.0 {
            let half = (wo + wi).normalize_or(surface.normal);
            let cosine = surface.normal.dot(half).abs();
            let jacobian = 1.0 / (4.0 * wo.dot(half).abs().max(f64::MIN_POSITIVE));
            #[cfg(test)]
            let jacobian = jacobian * self.fault.factor(crate::tests::Fault::HalfVectorJacobian);
            surface.distribution(cosine) * cosine * jacobian
        } else {
            0.0
        };
        let surface_pdf = (1.0 - share) * diffuse + share * lobe;
        (1.0 - surface.weight) * volume + surface.weight * surface_pdf
    }

    /// Draws `wi` with density [`Self::pdf`].
    pub fn draw(&self, wo: DVec3, rng: &mut Rng) -> DVec3 {
        match &self.surface {
            Some(surface) if rng.uniform() < surface.weight => {
                let xi = rng.uniform();
                if rng.uniform() < surface.lobe_share(wo) {
                    // Microfacet normals by D cos θ, then the mirror direction.
                    let a2 = surface.alpha * surface.alpha;
                    let cosine = ((1.0 - xi) / (1.0 + xi * (a2 - 1.0))).sqrt();
                    let half = around(surface.normal, cosine, rng);
                    (2.0 * wo.dot(half) * half - wo).normalize()
                } else {
                    around(surface.normal, xi.sqrt(), rng)
                }
            }
            _ => around(-wo, henyey_greenstein_cosine(self.g, rng.uniform()), rng),
        }
    }
}
