//! How a lens maps directions to pixels.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

/// A lens projection. The lens looks along +z of its own frame, x to the right of its picture and
/// y down, as OpenCV has it.
pub trait Projection {
    /// Pixel of a unit direction (pixel centres at half-integers: the picture's left edge is 0);
    /// `None` where the lens doesn't see.
    fn project(&self, direction: DVec3) -> Option<DVec2>;

    /// Largest angle from the axis that the model holds for, radians.
    fn max_angle(&self) -> f64;
}

/// Lens models with their parameters, in pixels of the calibrated picture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "model", rename_all = "snake_case", deny_unknown_fields)]
pub enum LensModel {
    /// r = f·θ.
    Equidistant {
        /// Pixels per radian.
        focal: f64,
        /// Pixel of the axis.
        centre: [f64; 2],
        /// Full field of view, degrees.
        fov_deg: f64,
    },
    /// r = f·(θ + k₁θ³ + k₂θ⁵ + k₃θ⁷ + k₄θ⁹): OpenCV's `fisheye` (Kannala and Brandt 2006).
    KannalaBrandt {
        /// Pixels per radian on the axis, across and down.
        focal: [f64; 2],
        /// Pixel of the axis.
        centre: [f64; 2],
        /// k₁ … k₄.
        k: [f64; 4],
        /// Full field of view, degrees.
        fov_deg: f64,
    },
    /// Unified projection from a sphere, with Brown's distortion (Mei and Rives 2007).
    Mei {
        /// Distance of the projection centre from the sphere's.
        xi: f64,
        /// Focal lengths across and down, pixels.
        focal: [f64; 2],
        /// Principal point.
        centre: [f64; 2],
        /// Radial k₁ … k₃.
        k: [f64; 3],
        /// Tangential p₁, p₂.
        p: [f64; 2],
        /// Full field of view, degrees; cut where the model folds, at acos(−1/ξ).
        fov_deg: f64,
    },
    /// r = Σ aᵢ·θⁱ, a polynomial of the angle measured from the *image plane* backwards, as
    /// Scaramuzza's toolbox writes as `invpol`; here of θ from the axis.
    OCam {
        /// a₀, a₁, …: pixels from radians.
        polynomial: Vec<f64>,
        /// Pixel of the axis.
        centre: [f64; 2],
        /// c, d, e of the affine matrix [[c, d], [e, 1]]; the identity is [1, 0, 0].
        #[serde(default = "identity")]
        affine: [f64; 3],
        /// Full field of view, degrees.
        fov_deg: f64,
    },
}

fn identity() -> [f64; 3] {
    [1.0, 0.0, 0.0]
}

impl LensModel {
    /// Full field of view in degrees, as calibrated.
    pub fn fov_deg(&self) -> f64 {
        match self {
            Self::Equidistant { fov_deg, .. }
            | Self::KannalaBrandt { fov_deg, .. }
            | Self::Mei { fov_deg, .. }
            | Self::OCam { fov_deg, .. } => *fov_deg,
        }
    }

    /// Pixel of the axis.
    pub fn centre(&self) -> DVec2 {
        match self {
            Self::Equidistant { centre, .. }
            | Self::KannalaBrandt { centre, .. }
            | Self::Mei { centre, .. }
            | Self::OCam { centre, .. } => DVec2::from_array(*centre),
        }
    }

    /// What is impossible about its parameters, if anything.
    pub fn problem(&self) -> Option<String> {
        let numbers: Vec<f64> = match self {
            Self::Equidistant { focal, .. } => vec![*focal],
            Self::KannalaBrandt { focal, k, .. } => [&focal[..], &k[..]].concat(),
            Self::Mei {
                xi, focal, k, p, ..
            } => [&[*xi], &focal[..], &k[..], &p[..]].concat(),
            Self::OCam {
                polynomial, affine, ..
            } => [&polynomial[..], &affine[..]].concat(),
        };
        let fov = self.fov_deg();
        if !numbers.iter().all(|n| n.is_finite()) || !self.centre().is_finite() {
            return Some("a parameter is not a finite number".into());
        }
        if !(fov > 0.0 && fov <= 360.0) {
            return Some(format!(
                "fov_deg is {fov}, expected above 0 and at most 360"
            ));
        }
        let positive = match self {
            Self::Equidistant { focal, .. } => *focal > 0.0,
            Self::KannalaBrandt { focal, .. } => focal.iter().all(|&f| f > 0.0),
            Self::Mei { xi, focal, .. } => *xi >= 0.0 && focal.iter().all(|&f| f > 0.0),
            Self::OCam { polynomial, .. } => polynomial.len() >= 2,
        };
        if !positive {
            return Some(
                "focal lengths must be above 0, xi at least 0, and a polynomial needs two terms"
                    .into(),
            );
        }
        // A picture in which a larger angle lies further in can't be looked up.
        let mut last = -1.0;
        for i in 0..=64 {
            let angle = self.max_angle() * f64::from(i) / 64.0;
            let radius = self.radius_of(angle);
            if radius.is_nan() || radius <= last {
                return Some(format!(
                    "the lens folds at {:.1}° from its axis; its fov_deg must end before",
                    angle.to_degrees()
                ));
            }
            last = radius;
        }
        None
    }

    /// Distance from the axis's pixel for an angle from the axis, across.
    fn radius_of(&self, angle: f64) -> f64 {
        let direction = DVec3::new(angle.sin(), 0.0, angle.cos());
        let unbounded = self.project_unbounded(direction);
        unbounded.map_or(f64::NAN, |pixel| (pixel - self.centre()).length())
    }

    /// The same lens on a picture of another size.
    pub fn scaled(&self, factor: f64) -> Self {
        let mut out = self.clone();
        match &mut out {
            Self::Equidistant { focal, centre, .. } => {
                *focal *= factor;
                *centre = centre.map(|c| c * factor);
            }
            Self::KannalaBrandt { focal, centre, .. } | Self::Mei { focal, centre, .. } => {
                *focal = focal.map(|f| f * factor);
                *centre = centre.map(|c| c * factor);
            }
            Self::OCam {
                polynomial, centre, ..
            } => {
                polynomial.iter_mut().for_each(|a| *a *= factor);
                *centre = centre.map(|c| c * factor);
            }
        }
        out
    }

    fn project_unbounded(&self, direction: DVec3) -> Option<DVec2> {
        let across = direction.truncate();
        let sine = across.length();
        let angle = sine.atan2(direction.z);
        // On the axis every heading is the same pixel.
        let heading = if sine > 0.0 { across / sine } else { DVec2::X };
        match self {
            Self::Equidistant { focal, centre, .. } => {
                Some(DVec2::from_array(*centre) + heading * (focal * angle))
            }
            Self::KannalaBrandt {
                focal, centre, k, ..
            } => {
                let t2 = angle * angle;
                let series = 1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])));
                let offset = DVec2::from_array(*focal) * heading * (angle * series);
                Some(DVec2::from_array(*centre) + offset)
            }
            Self::Mei {
                xi,
                focal,
                centre,
                k,
                p,
                ..
            } => {
                let depth = direction.z + xi;
                if depth <= 1e-9 {
                    return None;
                }
                let m = across / depth;
                let r2 = m.length_squared();
                let radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[2]));
                let tangential = DVec2::new(
                    2.0 * p[0] * m.x * m.y + p[1] * (r2 + 2.0 * m.x * m.x),
                    p[0] * (r2 + 2.0 * m.y * m.y) + 2.0 * p[1] * m.x * m.y,
                );
                let distorted = m * radial + tangential;
                Some(DVec2::from_array(*centre) + DVec2::from_array(*focal) * distorted)
            }
            Self::OCam {
                polynomial,
                centre,
                affine: [c, d, e],
                ..
            } => {
                let radius = polynomial.iter().rev().fold(0.0, |sum, a| sum * angle + a);
                let DVec2 { x, y } = heading * radius;
                Some(DVec2::from_array(*centre) + DVec2::new(c * x + d * y, e * x + y))
            }
        }
    }
}

impl Projection for LensModel {
    fn project(&self, direction: DVec3) -> Option<DVec2> {
        let angle = direction.truncate().length().atan2(direction.z);
        if angle > self.max_angle() {
            return None;
        }
        self.project_unbounded(direction)
    }

    fn max_angle(&self) -> f64 {
        let half = 0.5 * self.fov_deg().to_radians();
        match self {
            // Beyond acos(−1/ξ) larger angles come nearer again (120° for ξ = 2).
            Self::Mei { xi, .. } => {
                let fold = if *xi > 1.0 {
                    (-1.0 / xi).acos() - 1e-3
                } else {
                    FRAC_PI_2 + xi.asin()
                };
                half.min(fold)
            }
            _ => half.min(PI),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(angle_deg: f64) -> DVec3 {
        let angle = angle_deg.to_radians();
        DVec3::new(angle.sin(), 0.0, angle.cos())
    }

    #[test]
    fn the_models_agree_where_they_are_the_same_lens() {
        let equidistant = LensModel::Equidistant {
            focal: 300.0,
            centre: [500.0, 480.0],
            fov_deg: 200.0,
        };
        let series = LensModel::KannalaBrandt {
            focal: [300.0; 2],
            centre: [500.0, 480.0],
            k: [0.0; 4],
            fov_deg: 200.0,
        };
        let polynomial = LensModel::OCam {
            polynomial: vec![0.0, 300.0],
            centre: [500.0, 480.0],
            affine: identity(),
            fov_deg: 200.0,
        };
        for angle in [0.0, 30.0, 95.0] {
            let direction = glam::DQuat::from_rotation_z(0.7) * at(angle);
            let expected = equidistant.project(direction).unwrap();
            assert!(
                (expected - DVec2::new(500.0, 480.0)).length() - 300.0 * angle.to_radians() < 1e-9
            );
            for model in [&series, &polynomial] {
                assert!((model.project(direction).unwrap() - expected).length() < 1e-9);
            }
        }
        assert!(equidistant.project(at(101.0)).is_none());
        assert_eq!(equidistant.problem(), None);
    }

    #[test]
    fn mei_is_a_pinhole_for_xi_zero_and_folds_where_it_should() {
        let mei = |xi: f64, fov_deg: f64| LensModel::Mei {
            xi,
            focal: [400.0; 2],
            centre: [0.0; 2],
            k: [0.0; 3],
            p: [0.0; 2],
            fov_deg,
        };
        let pixel = mei(0.0, 90.0).project(at(30.0)).unwrap();
        assert!((pixel.x - 400.0 * 30.0_f64.to_radians().tan()).abs() < 1e-9);
        let folding = mei(2.0, 300.0);
        assert!((folding.max_angle().to_degrees() - 120.0).abs() < 0.1);
        assert!(folding.project(at(119.0)).is_some() && folding.project(at(121.0)).is_none());
        assert_eq!(mei(2.0, 200.0).problem(), None);
    }

    #[test]
    fn impossible_lenses_are_told() {
        let lens = LensModel::KannalaBrandt {
            focal: [300.0; 2],
            centre: [500.0; 2],
            k: [-0.4, 0.0, 0.0, 0.0],
            fov_deg: 190.0,
        };
        assert!(lens.problem().unwrap().contains("folds"));
        let lens = LensModel::Equidistant {
            focal: f64::NAN,
            centre: [0.0; 2],
            fov_deg: 190.0,
        };
        assert!(lens.problem().is_some());
    }
}
