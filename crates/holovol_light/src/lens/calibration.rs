//! Calibration files of dual-fisheye cameras.

use std::path::{Path, PathBuf};

use glam::{DMat3, DQuat, DVec2, DVec3};
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
    /// A lens or the response is impossible.
    #[error("{field} {reason}")]
    Field {
        /// Path of the field, as in `lenses[1].projection.centre`.
        field: String,
        /// What it is, and what was expected.
        reason: String,
    },
    /// The calibration of a file can't be used.
    #[error("{path}: {problem}")]
    InFile {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        problem: Box<CalibrationError>,
    },
    /// The pictures are not those that were calibrated.
    #[error(
        "lenses[{lens}].size is {expected:?} pixels, its picture has {found:?}; only the same shape at another scale can be used"
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

impl CalibrationError {
    /// The same problem, naming the file that has it.
    pub fn in_file(self, path: &Path) -> Self {
        match self {
            Self::Io { .. } | Self::Parse { .. } | Self::InFile { .. } => self,
            problem => Self::InFile {
                path: path.into(),
                problem: Box::new(problem),
            },
        }
    }
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

    /// Least and greatest falloff.
    fn falloff_range(&self) -> [f64; 2] {
        let [a, b, c] = self.vignetting;
        // The edges, and where the derivative by ρ², a + 2bρ² + 3cρ⁴, is 0.
        let q = -(b + (b * b - 3.0 * a * c).max(0.0).sqrt().copysign(b));
        let turns = [q / (3.0 * c), a / q].into_iter();
        let places = turns
            .filter(|r2| (0.0..=1.0).contains(r2))
            .chain([0.0, 1.0]);
        places.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], r2| {
            let falloff = self.falloff(r2.sqrt());
            [low.min(falloff), high.max(falloff)]
        })
    }

    /// Share of a picture's lit pixels that lie outside the field of view, 0 … 1: about a half
    /// where a picture holds both lenses' circles, much more where it is not the one that was
    /// calibrated. `picture` has the lens's size.
    pub fn lit_outside(&self, picture: &[[u8; 3]]) -> f64 {
        /// Above what glare and coding leave of the black around a lens's circle.
        const LIT: u8 = 32;
        let edge = super::stitch::edge_radius(self);
        let (mut lit, mut outside) = (0.0, 0.0);
        for (i, pixel) in picture.iter().enumerate() {
            if pixel.iter().any(|&code| code > LIT) {
                let at = DVec2::new((i % self.size[0]) as f64, (i / self.size[0]) as f64) + 0.5;
                lit += 1.0;
                outside += f64::from(u8::from(at.distance(self.projection.centre()) > edge + 1.0));
            }
        }
        if lit > 0.0 { outside / lit } else { 0.0 }
    }

    /// What is impossible, if anything: the field, and what is wrong with it.
    fn problem(&self) -> Option<(String, String)> {
        let own = |field: &str, reason: String| Some((field.into(), reason));
        if !self.size.iter().all(|n| (1..=MAX_SIDE).contains(n)) {
            return own(
                "size",
                format!("is {:?}, expected 1 … {MAX_SIDE} pixels", self.size),
            );
        }
        let rotation = DQuat::from_array(self.lens_from_camera);
        if !(rotation.is_finite() && (0.5..2.0).contains(&rotation.length())) {
            return own(
                "lens_from_camera",
                format!(
                    "is {:?}, expected a unit quaternion x, y, z, w",
                    self.lens_from_camera
                ),
            );
        }
        if !(0.01..=100.0).contains(&self.gain) {
            return own("gain", format!("is {:?}, expected 0.01 … 100", self.gain));
        }
        if !self.vignetting.iter().all(|a| a.abs() <= 100.0) {
            return own(
                "vignetting",
                format!("is {:?}, expected −100 … 100 each", self.vignetting),
            );
        }
        let [low, high] = self.falloff_range();
        if low < 0.05 || high > 20.0 {
            return own(
                "vignetting",
                format!(
                    "is {:?}, a falloff of {low:.3} … {high:.3}; expected one within 0.05 … 20",
                    self.vignetting
                ),
            );
        }
        let inner = |(field, reason)| Some((format!("projection.{field}"), reason));
        if let Some(problem) = self.projection.problem() {
            return inner(problem);
        }
        let ([width, height], centre) = (self.size, self.projection.centre());
        let place = format!("its picture of {width} × {height} pixels");
        if !(centre.cmpgt(DVec2::ZERO).all() && centre.x < width as f64 && centre.y < height as f64)
        {
            return inner((
                "centre",
                format!(
                    "is [{}, {}], outside {place}; size, centre and focal belong to one picture of one lens",
                    centre.x, centre.y
                ),
            ));
        }
        let scale = match self.projection {
            LensModel::OCam { .. } => "polynomial",
            _ => "focal",
        };
        let (share, edge) = self.projection.on_picture(self.size);
        if share < 0.5 {
            return inner((
                scale,
                format!(
                    "leaves {:.0} % of the field of view ({}°) outside {place}; if it is of a larger picture, size has to be that one's; if the picture is cut, lower fov_deg",
                    100.0 * (1.0 - share),
                    self.projection.fov_deg()
                ),
            ));
        }
        if edge < LEAST_EDGE * width.min(height) as f64 {
            return inner((
                scale,
                format!(
                    "puts the whole field of view within {edge:.1} pixels of the centre of {place}; if it is of a smaller picture, size has to be that one's"
                ),
            ));
        }
        None
    }
}

/// Widest and tallest picture, pixels.
const MAX_SIDE: usize = 32_768;
/// A lens whose field of view has a smaller radius, in shorter sides of its picture, is none.
const LEAST_EDGE: f64 = 0.05;
/// Lenses that look less far apart look the same way, degrees.
const LEAST_APART: f64 = 90.0;

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
        found.check().map_err(|problem| problem.in_file(path))?;
        Ok(found)
    }

    /// Finds out whether the lenses are possible.
    ///
    /// # Errors
    /// If one is not.
    pub fn check(&self) -> Result<(), CalibrationError> {
        for (lens, entry) in self.lenses.iter().enumerate() {
            if let Some((field, reason)) = entry.problem() {
                return Err(CalibrationError::Field {
                    field: format!("lenses[{lens}].{field}"),
                    reason,
                });
            }
        }
        let [first, second] = self.axes();
        let apart = first.angle_between(second).to_degrees();
        if apart < LEAST_APART {
            return Err(CalibrationError::Field {
                field: "lenses[1].lens_from_camera".into(),
                reason: format!(
                    "has the lens look {apart:.0}° from where lenses[0] does, expected about 180°"
                ),
            });
        }
        self.response
            .check()
            .map_err(|reason| CalibrationError::Field {
                field: "response".into(),
                reason,
            })
    }

    /// Where the lenses look, in the camera's frame.
    pub(super) fn axes(&self) -> [DVec3; 2] {
        let axis = |lens: &Lens| lens.rotation().transpose() * DVec3::Z;
        self.lenses.each_ref().map(axis)
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
            let alike = (height - found[1] as f64).abs() <= 1.0;
            if found.contains(&0) || !alike {
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
    /// If K is no camera matrix, has skew beyond a pixel, or makes an impossible lens.
    pub fn from_opencv_fisheye(
        lenses: [([[f64; 3]; 3], [f64; 4]); 2],
        size: [usize; 2],
        fov_deg: f64,
    ) -> Result<Self, CalibrationError> {
        let mut out = Self::nominal(size, fov_deg);
        for (entry, (camera_matrix, k)) in out.lenses.iter_mut().zip(lenses) {
            let [[fx, skew, cx], [shear, fy, cy], last] = camera_matrix;
            if shear != 0.0 || last != [0.0, 0.0, 1.0] {
                return Err(CalibrationError::Import(format!(
                    "the camera matrix is {camera_matrix:?}; expected [[fx, skew, cx], [0, fy, cy], [0, 0, 1]], row by row"
                )));
            }
            if skew.is_nan() || skew.abs() > 1.0 {
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
        let number = |(i, field): (usize, &str)| match field.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(import(format!(
                "field {} is {field:?}, expected a number",
                i + 1
            ))),
        };
        let fields: Vec<f64> = text
            .trim()
            .split('_')
            .enumerate()
            .map(number)
            .collect::<Result<_, _>>()?;
        if fields.first() != Some(&2.0) {
            return Err(import("it does not begin with 2, for two lenses".into()));
        }
        let size = |w: f64, h: f64| -> Result<[usize; 2], CalibrationError> {
            let sides = 1.0..=MAX_SIDE as f64;
            if sides.contains(&w) && sides.contains(&h) {
                Ok([w as usize, h as usize])
            } else {
                Err(import(format!(
                    "a picture of {w} × {h} pixels, expected 1 … {MAX_SIDE}"
                )))
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
        out.check().map_err(|problem| import(problem.to_string()))?;
        Ok(out)
    }
}

/// Direction in a lens's frame of one in the camera's.
pub(crate) fn to_lens(rotation: DMat3, direction: DVec3) -> DVec3 {
    rotation * direction
}

#[cfg(test)]
mod tests;
