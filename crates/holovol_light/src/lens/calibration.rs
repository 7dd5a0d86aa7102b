//! Calibration files of dual-fisheye cameras.

use std::path::{Path, PathBuf};

use glam::{DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

use super::LensModel;

/// Why a calibration can't be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CalibrationError {
    /// The file could not be read.
    #[error("{path}: cannot read the calibration: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is not a calibration.
    #[error("{path}: not a calibration file: {reason}; docs/lighting.md lists its fields")]
    Parse {
        /// The file.
        path: PathBuf,
        /// Where and what.
        reason: String,
    },
    /// A lens is impossible.
    #[error("lens {lens} of the calibration: {reason}")]
    Lens {
        /// 0 or 1.
        lens: usize,
        /// What is wrong.
        reason: String,
    },
    /// The pictures are not those that were calibrated.
    #[error(
        "the calibration is for pictures of {expected:?} pixels, lens {lens}'s picture has {found:?}; only the same shape at another scale can be used"
    )]
    Size {
        /// 0 or 1.
        lens: usize,
        /// Width and height in the file.
        expected: [usize; 2],
        /// Width and height of the picture.
        found: [usize; 2],
    },
    /// An import failed.
    #[error("{0}")]
    Import(String),
    /// The pictures don't tell enough.
    #[error("{0}")]
    Overlap(String),
}

/// One lens of a camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lens {
    /// Width and height of the calibrated picture, pixels.
    pub size: [usize; 2],
    /// The projection.
    pub projection: LensModel,
    /// Rotation to the lens's frame (z along its axis, x right, y down) from the camera's (−z
    /// ahead, x right, y up): a unit quaternion x, y, z, w.
    pub lens_from_camera: [f64; 4],
    /// Vignetting: falloff 1 + a₁ρ² + a₂ρ⁴ + a₃ρ⁶, ρ the radius over that of the edge of the
    /// field of view.
    #[serde(default)]
    pub vignetting: [f64; 3],
    /// Brightness relative to the camera's nominal.
    #[serde(default = "one")]
    pub gain: f64,
}

fn one() -> f64 {
    1.0
}

impl Lens {
    /// The rotation as a matrix.
    pub fn rotation(&self) -> DMat3 {
        DMat3::from_quat(DQuat::from_array(self.lens_from_camera).normalize())
    }

    /// Falloff at a radius, as a share of the edge's: 1 on the axis.
    pub fn falloff(&self, rho: f64) -> f64 {
        let r2 = rho * rho;
        let [a, b, c] = self.vignetting;
        1.0 + r2 * (a + r2 * (b + r2 * c))
    }
}

/// A calibrated dual-fisheye camera, as its JSON file has it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// Of the format: 1.
    pub version: u32,
    /// The two lenses; pictures are given in this order.
    pub lenses: [Lens; 2],
    /// Camera response: `"srgb"`, `{"gamma": 2.2}` or `{"table": [[256], [256], [256]]}`.
    #[serde(default)]
    pub response: crate::response::Response,
}

/// Front lens: x stays, y (down) is −y, z (ahead) is −z of the camera. Back: turned about y.
const FRONT: DQuat = DQuat::from_xyzw(1.0, 0.0, 0.0, 0.0);

impl Calibration {
    /// An uncalibrated camera: two equidistant lenses back to back that fill their pictures.
    pub fn nominal(size: [usize; 2], fov_deg: f64) -> Self {
        let [width, height] = size.map(|n| n as f64);
        let radius = 0.5 * width.min(height);
        let lens = |rotation: DQuat| Lens {
            size,
            projection: LensModel::Equidistant {
                focal: radius / (0.5 * fov_deg.to_radians()),
                centre: [0.5 * width, 0.5 * height],
                fov_deg,
            },
            lens_from_camera: rotation.to_array(),
            vignetting: [0.0; 3],
            gain: 1.0,
        };
        Self {
            version: 1,
            lenses: [
                lens(FRONT),
                lens(FRONT * DQuat::from_rotation_y(std::f64::consts::PI)),
            ],
            response: crate::response::Response::default(),
        }
    }

    /// Reads a calibration file.
    ///
    /// # Errors
    /// If the file is missing, or not a calibration, or one of an impossible lens.
    pub fn load(path: &Path) -> Result<Self, CalibrationError> {
        let text = std::fs::read_to_string(path).map_err(|source| CalibrationError::Io {
            path: path.into(),
            source,
        })?;
        let parse = |reason: String| CalibrationError::Parse {
            path: path.into(),
            reason,
        };
        let mut json = serde_json::Deserializer::from_str(&text);
        let found: Self = serde_path_to_error::deserialize(&mut json)
            .map_err(|error| parse(error.to_string()))?;
        if found.version != 1 {
            return Err(parse(format!("version is {}, expected 1", found.version)));
        }
        found.check()?;
        Ok(found)
    }

    /// Finds out whether the lenses are possible.
    ///
    /// # Errors
    /// If one is not.
    pub fn check(&self) -> Result<(), CalibrationError> {
        for (lens, entry) in self.lenses.iter().enumerate() {
            let rotation = DQuat::from_array(entry.lens_from_camera);
            let reason = if entry.size.contains(&0) {
                Some("its size is 0".into())
            } else if !(rotation.is_finite() && (0.5..2.0).contains(&rotation.length())) {
                Some("lens_from_camera is not a unit quaternion".into())
            } else if !(entry.gain.is_finite() && entry.gain > 0.0) {
                Some(format!("gain is {}, expected above 0", entry.gain))
            } else if (0..=16).any(|i| {
                let falloff = entry.falloff(f64::from(i) / 16.0);
                !falloff.is_finite() || falloff < 0.05
            }) {
                Some("vignetting falls below 5 %".into())
            } else {
                entry.projection.problem()
            };
            if let Some(reason) = reason {
                return Err(CalibrationError::Lens { lens, reason });
            }
        }
        self.response
            .check()
            .map_err(|reason| CalibrationError::Lens {
                lens: 0,
                reason: format!("response: {reason}"),
            })
    }

    /// The calibration for pictures of these sizes: the same shape, at any scale.
    ///
    /// # Errors
    /// If a picture has another shape.
    pub fn for_sizes(&self, sizes: [[usize; 2]; 2]) -> Result<Self, CalibrationError> {
        let mut out = self.clone();
        for (lens, (entry, found)) in out.lenses.iter_mut().zip(sizes).enumerate() {
            let factor = found[0] as f64 / entry.size[0] as f64;
            let height = entry.size[1] as f64 * factor;
            if found.contains(&0) || (height - found[1] as f64).abs() > 1.0 {
                return Err(CalibrationError::Size {
                    lens,
                    expected: entry.size,
                    found,
                });
            }
            entry.projection = entry.projection.scaled(factor);
            entry.size = found;
        }
        Ok(out)
    }

    /// As JSON, to be written to a file.
    pub fn to_json(&self) -> String {
        serde_json::to_string_pretty(self).unwrap_or_default()
    }

    /// From the parameters of OpenCV's `fisheye::calibrate`, one lens ahead, one behind.
    ///
    /// `camera_matrix` is K, row major; `distortion` is D, k₁ … k₄.
    ///
    /// # Errors
    /// If K has skew beyond a pixel, or makes an impossible lens.
    pub fn from_opencv_fisheye(
        lenses: [([[f64; 3]; 3], [f64; 4]); 2],
        size: [usize; 2],
        fov_deg: f64,
    ) -> Result<Self, CalibrationError> {
        let mut out = Self::nominal(size, fov_deg);
        for (entry, (camera_matrix, k)) in out.lenses.iter_mut().zip(lenses) {
            let [[fx, skew, cx], [_, fy, cy], _] = camera_matrix;
            if skew.abs() > 1.0 {
                return Err(CalibrationError::Import(format!(
                    "the camera matrix has a skew of {skew} pixels; calibrate with CALIB_FIX_SKEW"
                )));
            }
            entry.projection = LensModel::KannalaBrandt {
                focal: [fx, fy],
                // OpenCV's pixel centres lie at whole numbers, ours at halves.
                centre: [cx + 0.5, cy + 0.5],
                k,
                fov_deg,
            };
        }
        out.check()?;
        Ok(out)
    }

    /// From an Insta360 offset string, long form (ξ, fx, fy, cx, cy, yaw, pitch, roll, x, y, z,
    /// k₁, k₂, k₃, p₁, p₂, width, height, type per lens) or short form (radius, cx, cy, yaw,
    /// pitch, roll per lens, then width, height, type), after a leading count of lenses, parted by
    /// underscores. Angles are degrees.
    ///
    /// The field order is that of public notes on the format; the vendor does not document it.
    ///
    /// # Errors
    /// If it has another number of fields, or makes an impossible lens.
    pub fn from_insta360_offset(text: &str) -> Result<Self, CalibrationError> {
        let import = |reason: String| CalibrationError::Import(format!("offset string: {reason}"));
        let fields: Vec<f64> = text
            .trim()
            .split('_')
            .map(|field| field.parse::<f64>())
            .collect::<Result<_, _>>()
            .map_err(|error| import(format!("a field is not a number ({error})")))?;
        if fields.first() != Some(&2.0) {
            return Err(import("it does not begin with 2, for two lenses".into()));
        }
        let size = |w: f64, h: f64| -> Result<[usize; 2], CalibrationError> {
            if (1.0..=65536.0).contains(&w) && (1.0..=65536.0).contains(&h) {
                Ok([w as usize, h as usize])
            } else {
                Err(import(format!("a picture of {w} × {h} pixels")))
            }
        };
        let turn = |yaw: f64, pitch: f64, roll: f64| {
            DQuat::from_euler(
                glam::EulerRot::ZXY,
                roll.to_radians(),
                pitch.to_radians(),
                yaw.to_radians(),
            )
        };
        let body = &fields[1..];
        let mut out;
        if body.len() >= 38 {
            out = Self::nominal(size(body[16], body[17])?, 200.0);
            for (entry, f) in out.lenses.iter_mut().zip(body.chunks_exact(19)) {
                entry.size = size(f[16], f[17])?;
                entry.projection = LensModel::Mei {
                    xi: f[0],
                    focal: [f[1], f[2]],
                    centre: [f[3], f[4]],
                    k: [f[11], f[12], f[13]],
                    p: [f[14], f[15]],
                    fov_deg: 200.0,
                };
                let nominal = DQuat::from_array(entry.lens_from_camera);
                entry.lens_from_camera = (turn(f[5], f[6], f[7]) * nominal).to_array();
            }
        } else if (14..=15).contains(&body.len()) {
            let [width, height] = size(body[12], body[13])?;
            // The short form counts both circles in one picture, side by side.
            out = Self::nominal([width / 2, height], 200.0);
            for (i, f) in body.chunks_exact(6).take(2).enumerate() {
                let entry = &mut out.lenses[i];
                let shift = if f[1] > 0.5 * width as f64 {
                    0.5 * width as f64
                } else {
                    0.0
                };
                entry.projection = LensModel::Equidistant {
                    focal: f[0] / 100.0_f64.to_radians(),
                    centre: [f[1] - shift, f[2]],
                    fov_deg: 200.0,
                };
                let nominal = DQuat::from_array(entry.lens_from_camera);
                entry.lens_from_camera = (turn(f[3], f[4], f[5]) * nominal).to_array();
            }
        } else {
            return Err(import(format!(
                "{} fields after the count, expected 38 and more (long form) or 14 (short form)",
                body.len()
            )));
        }
        out.check()?;
        Ok(out)
    }
}

/// Direction in a lens's frame of one in the camera's.
pub(crate) fn to_lens(rotation: DMat3, direction: DVec3) -> DVec3 {
    rotation * direction
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::Projection;

    #[test]
    fn front_and_back_look_ahead_and_behind_with_up_up() {
        let camera = Calibration::nominal([1000, 1000], 190.0);
        let pixel = |lens: usize, direction: DVec3| {
            let lens = &camera.lenses[lens];
            lens.projection.project(to_lens(lens.rotation(), direction))
        };
        let middle = glam::DVec2::splat(500.0);
        assert!((pixel(0, DVec3::NEG_Z).unwrap() - middle).length() < 1e-6);
        assert!((pixel(1, DVec3::Z).unwrap() - middle).length() < 1e-6);
        assert!(pixel(0, DVec3::Z).is_none());
        // Up is up in both pictures; the right of the scene is right ahead and left behind.
        let (up, right) = (
            DVec3::new(0.0, 0.5, -1.0).normalize(),
            DVec3::new(0.5, 0.0, -1.0),
        );
        assert!(pixel(0, up).unwrap().y < 400.0);
        assert!(pixel(0, right.normalize()).unwrap().x > 600.0);
        let behind = DVec3::new(0.5, 0.5, 1.0).normalize();
        assert!(pixel(1, behind).unwrap().x < 400.0 && pixel(1, behind).unwrap().y < 400.0);
    }

    #[test]
    fn files_round_trip_and_say_what_is_wrong() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("camera.json");
        let camera = Calibration::nominal([1440, 1440], 195.0);
        std::fs::write(&path, camera.to_json()).unwrap();
        assert_eq!(Calibration::load(&path).unwrap(), camera);
        let broken = camera.to_json().replacen("\"focal\"", "\"fokal\"", 1);
        std::fs::write(&path, broken).unwrap();
        let message = Calibration::load(&path).unwrap_err().to_string();
        assert!(
            message.contains("camera.json") && message.contains("fokal"),
            "{message}"
        );
        let half = camera.for_sizes([[720, 720]; 2]).unwrap();
        assert_eq!(
            half.lenses[0].projection.centre(),
            glam::DVec2::splat(360.0)
        );
        let message = camera.for_sizes([[720, 700]; 2]).unwrap_err().to_string();
        assert!(
            message.contains("[1440, 1440]") && message.contains("[720, 700]"),
            "{message}"
        );
    }

    #[test]
    fn opencv_parameters_are_imported_at_its_pixel_centres() {
        let matrix = [[410.0, 0.0, 719.5], [0.0, 411.0, 720.5], [0.0, 0.0, 1.0]];
        let lens = (matrix, [0.01, -0.002, 0.0, 0.0]);
        let camera = Calibration::from_opencv_fisheye([lens, lens], [1440; 2], 190.0).unwrap();
        let found = &camera.lenses[0].projection;
        assert_eq!(found.centre(), glam::DVec2::new(720.0, 721.0));
        // OpenCV: θ_d = θ(1 + k₁θ² + k₂θ⁴), u = fx·θ_d + cx.
        let theta = 1.0_f64;
        let pixel = found
            .project(DVec3::new(theta.sin(), 0.0, theta.cos()))
            .unwrap();
        assert!((pixel.x - (410.0 * 1.008 + 720.0)).abs() < 1e-9, "{pixel}");
        let skewed = ([[410.0, 5.0, 0.0], matrix[1], matrix[2]], lens.1);
        assert!(Calibration::from_opencv_fisheye([skewed, lens], [1440; 2], 190.0).is_err());
    }

    #[test]
    fn offset_strings_are_imported_or_refused() {
        let lens = "2_1100.0_1101.0_720_721_0_0_0_0_0_0_0.1_0.01_0_0.001_0.002_1440_1440_113";
        let camera = Calibration::from_insta360_offset(&format!("2_{lens}_{lens}")).unwrap();
        let LensModel::Mei { xi, focal, p, .. } = camera.lenses[1].projection else {
            panic!("the long form is Mei's model");
        };
        assert_eq!((xi, focal, p), (2.0, [1100.0, 1101.0], [0.001, 0.002]));
        let short = "2_700_720_720_0_0_0_700_2160_720_0_0_0_2880_1440_2";
        let camera = Calibration::from_insta360_offset(short).unwrap();
        assert_eq!(
            camera.lenses[1].projection.centre(),
            glam::DVec2::splat(720.0)
        );
        for wrong in ["", "2_1_2", "3_1", "2_a", &format!("2_{lens}")] {
            assert!(Calibration::from_insta360_offset(wrong).is_err(), "{wrong}");
        }
    }
}
