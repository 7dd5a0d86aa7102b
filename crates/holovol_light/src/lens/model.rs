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

/// No camera's parameter is as large.
const LARGEST: f64 = 1e9;
/// Ways from the axis outward along which a lens is looked over.
const HEADINGS: u32 = 16;

/// Σ aᵢ·xⁱ.
fn polynomial_at(coefficients: &[f64], x: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, a| sum * x + a)
}

/// The direction at an angle from the axis, toward one of [`HEADINGS`].
fn towards(angle: f64, heading: u32) -> DVec3 {
    let heading = f64::from(heading) / f64::from(HEADINGS) * 2.0 * PI;
    DVec3::new(
        angle.sin() * heading.cos(),
        angle.sin() * heading.sin(),
        angle.cos(),
    )
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

    /// Its fields that hold numbers, by name.
    fn fields(&self) -> Vec<(&'static str, &[f64])> {
        use std::slice::from_ref;
        let mut fields = match self {
            Self::Equidistant { focal, .. } => vec![("focal", from_ref(focal))],
            Self::KannalaBrandt { focal, k, .. } => vec![("focal", &focal[..]), ("k", k)],
            Self::Mei {
                xi, focal, k, p, ..
            } => vec![("xi", from_ref(xi)), ("focal", focal), ("k", k), ("p", p)],
            Self::OCam {
                polynomial, affine, ..
            } => vec![("polynomial", &polynomial[..]), ("affine", affine)],
        };
        let (Self::Equidistant {
            centre, fov_deg, ..
        }
        | Self::KannalaBrandt {
            centre, fov_deg, ..
        }
        | Self::Mei {
            centre, fov_deg, ..
        }
        | Self::OCam {
            centre, fov_deg, ..
        }) = self;
        fields.extend([("centre", &centre[..]), ("fov_deg", from_ref(fov_deg))]);
        fields
    }

    /// What is impossible about its parameters, if anything: the field, and what is wrong with it.
    pub fn problem(&self) -> Option<(&'static str, String)> {
        for (name, numbers) in self.fields() {
            let (valid, expected) = match name {
                "focal" => (
                    numbers.iter().all(|&f| f > 0.0 && f <= LARGEST),
                    "above 0, in pixels",
                ),
                "fov_deg" => (
                    numbers.iter().all(|&f| f > 0.0 && f <= 360.0),
                    "above 0 and at most 360",
                ),
                "xi" => (numbers.iter().all(|&xi| xi >= 0.0), "0 and more"),
                "polynomial" => (numbers.len() >= 2, "two terms and more"),
                // A determinant of 0 flattens the picture.
                "affine" => (
                    matches!(numbers, [c, d, e] if c - d * e > 0.01),
                    "about [1, 0, 0]",
                ),
                _ => (true, ""),
            };
            if !valid {
                return Some((name, format!("is {numbers:?}, expected {expected}")));
            }
            if !numbers.iter().all(|n| n.abs() <= LARGEST) {
                return Some((
                    name,
                    format!("is {numbers:?}, expected numbers within ±{LARGEST:e}"),
                ));
            }
        }
        if let Self::OCam { polynomial, .. } = self
            && polynomial[0].abs() > 0.02 * polynomial_at(polynomial, self.max_angle()).abs()
        {
            return Some((
                "polynomial",
                format!(
                    "is {polynomial:?}: the axis lies {} pixels off its own pixel, expected about 0; it is of the angle from the axis, not from the image plane",
                    polynomial[0]
                ),
            ));
        }
        self.fold()
    }

    /// Where a larger angle does not lie further out, which can't be looked up.
    fn fold(&self) -> Option<(&'static str, String)> {
        for heading in 0..HEADINGS {
            let mut last = -1.0;
            for i in 0..=64 {
                let angle = self.max_angle() * f64::from(i) / 64.0;
                let pixel = self.project_unbounded(towards(angle, heading));
                let radius = pixel.map_or(f64::NAN, |pixel| (pixel - self.centre()).length());
                if radius.is_nan() || radius <= last {
                    let end = angle.to_degrees();
                    return Some((
                        "fov_deg",
                        format!(
                            "is {}, but by its other numbers the lens folds {end:.1}° from its axis (larger angles come nearer to the centre again); expected less than {:.0}, or other numbers",
                            self.fov_deg(),
                            2.0 * end
                        ),
                    ));
                }
                last = radius;
            }
        }
        None
    }

    /// How it maps its field of view to a picture: the share (by solid angle) that is on the
    /// picture, and the radius of its edge in pixels, the least of all headings.
    pub(super) fn on_picture(&self, [width, height]: [usize; 2]) -> (f64, f64) {
        const RINGS: u32 = 32;
        let (mut inside, mut all, mut edge) = (0.0, 0.0, f64::INFINITY);
        for heading in 0..HEADINGS {
            for ring in 0..=RINGS {
                let angle = self.max_angle() * f64::from(ring) / f64::from(RINGS);
                let Some(pixel) = self.project_unbounded(towards(angle, heading)) else {
                    continue;
                };
                let on = (0.0..=width as f64).contains(&pixel.x)
                    && (0.0..=height as f64).contains(&pixel.y);
                all += angle.sin();
                inside += angle.sin() * f64::from(u8::from(on));
                if ring == RINGS {
                    edge = edge.min((pixel - self.centre()).length());
                }
            }
        }
        (inside / all, edge)
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
                let radius = polynomial_at(polynomial, angle);
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
        let (field, reason) = lens.problem().unwrap();
        assert!(field == "fov_deg" && reason.contains("folds"), "{reason}");
        for focal in [f64::NAN, f64::INFINITY, -300.0, 0.0, 1e300] {
            let lens = LensModel::Equidistant {
                focal,
                centre: [0.0; 2],
                fov_deg: 190.0,
            };
            let (field, reason) = lens.problem().unwrap();
            assert_eq!(field, "focal", "{reason}");
        }
        // Each folds or flattens along headings other than across.
        let tall = LensModel::Mei {
            xi: 1.0,
            focal: [300.0; 2],
            centre: [500.0; 2],
            k: [0.0; 3],
            p: [0.4, 0.0],
            fov_deg: 190.0,
        };
        assert_eq!(tall.problem().unwrap().0, "fov_deg");
        let flat = LensModel::OCam {
            polynomial: vec![0.0, 300.0],
            centre: [500.0; 2],
            affine: [1.0, 1.0, 1.0],
            fov_deg: 190.0,
        };
        assert_eq!(flat.problem().unwrap().0, "affine");
        // The polynomial as Scaramuzza's toolbox has it, of the angle from the image plane.
        let turned = LensModel::OCam {
            polynomial: vec![500.0, 300.0],
            centre: [500.0; 2],
            affine: identity(),
            fov_deg: 190.0,
        };
        let (field, reason) = turned.problem().unwrap();
        assert!(field == "polynomial" && reason.contains("axis"), "{reason}");
    }
}
