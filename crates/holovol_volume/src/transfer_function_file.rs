use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::{TransferFunction, TransferFunctionError, TransferPoint};

/// The JSON form of a [`TransferFunction`] in a scene: `{ "points": [ … ] }`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PointsForm {
    points: Vec<TransferPoint>,
}

impl TryFrom<PointsForm> for TransferFunction {
    type Error = TransferFunctionError;

    fn try_from(form: PointsForm) -> Result<Self, Self::Error> {
        Self::new(form.points)
    }
}

impl<'de> Deserialize<'de> for TransferFunction {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        PointsForm::deserialize(deserializer)?
            .try_into()
            .map_err(serde::de::Error::custom)
    }
}

/// A `*.tf.json` file: a transfer function that stands alone and can suit any scan.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TransferFunctionFile {
    /// The transfer function, `sigma_t` as written in the file.
    #[serde(flatten)]
    pub transfer_function: TransferFunction,
    /// Values at which s is 0 and 1, in data units; may be reversed, not equal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub window: Option<[f64; 2]>,
    /// If given, `sigma_t` is per volume size: it is multiplied by this and divided by the longest
    /// edge of the volume in metres. Finite, ≥ 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub optical_depth_scale: Option<f64>,
}

/// What [`TransferFunctionFile`] looks like in JSON. (`flatten` and `deny_unknown_fields` don't
/// go together, so that reading needs its own form.)
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FileForm {
    points: Vec<TransferPoint>,
    window: Option<[f64; 2]>,
    optical_depth_scale: Option<f64>,
}

/// Why a `*.tf.json` file could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TransferFunctionFileError {
    /// The file could not be opened or read.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// It is no JSON, or a field is unknown, missing or of the wrong type.
    #[error("{path}: {source}")]
    Json {
        /// The file.
        path: PathBuf,
        /// What is wrong, with line and column.
        source: serde_json::Error,
    },
    /// The points are no transfer function.
    #[error("{path}: {source}")]
    Points {
        /// The file.
        path: PathBuf,
        /// What is wrong with them.
        source: TransferFunctionError,
    },
    /// The window has no width or is not finite.
    #[error("{path}: `window` is [{}, {}], but must be two different finite numbers", window[0], window[1])]
    Window {
        /// The file.
        path: PathBuf,
        /// The window in the file.
        window: [f64; 2],
    },
    /// The scale is negative or not finite.
    #[error("{path}: `optical_depth_scale` is {scale}, but must be 0 or more")]
    OpticalDepthScale {
        /// The file.
        path: PathBuf,
        /// The scale in the file.
        scale: f64,
    },
}

impl TransferFunctionFile {
    /// Reads a `*.tf.json` file.
    ///
    /// # Errors
    /// If it can't be read, isn't such a file, or has a number out of its range.
    pub fn load(path: &Path) -> Result<Self, TransferFunctionFileError> {
        let text =
            std::fs::read_to_string(path).map_err(|source| TransferFunctionFileError::Io {
                path: path.into(),
                source,
            })?;
        Self::parse(&text, path)
    }

    /// Reads the text of such a file; `path` is what messages call it.
    ///
    /// # Errors
    /// If it isn't such a file, or has a number out of its range.
    pub fn parse(text: &str, path: &Path) -> Result<Self, TransferFunctionFileError> {
        let form: FileForm =
            serde_json::from_str(text).map_err(|source| TransferFunctionFileError::Json {
                path: path.into(),
                source,
            })?;
        let transfer_function = TransferFunction::new(form.points).map_err(|source| {
            TransferFunctionFileError::Points {
                path: path.into(),
                source,
            }
        })?;
        if let Some(window) = form.window
            && (window[0] == window[1] || !window.iter().all(|edge| edge.is_finite()))
        {
            return Err(TransferFunctionFileError::Window {
                path: path.into(),
                window,
            });
        }
        if let Some(scale) = form.optical_depth_scale
            && !(scale.is_finite() && scale >= 0.0)
        {
            return Err(TransferFunctionFileError::OpticalDepthScale {
                path: path.into(),
                scale,
            });
        }
        Ok(Self {
            transfer_function,
            window: form.window,
            optical_depth_scale: form.optical_depth_scale,
        })
    }

    /// The transfer function for a volume whose longest edge is this long, in metres.
    pub fn for_volume_size(&self, longest_edge: f64) -> TransferFunction {
        match self.optical_depth_scale {
            Some(scale) => self.transfer_function.scaled(scale / longest_edge),
            None => self.transfer_function.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const POINT: &str = r#"{ "s": 0.5, "sigma_t": 8.0, "albedo": [0.1, 0.2, 0.3] }"#;

    fn parse(text: &str) -> Result<TransferFunctionFile, String> {
        TransferFunctionFile::parse(text, Path::new("a.tf.json")).map_err(|e| e.to_string())
    }

    #[test]
    fn file_with_everything_survives_a_round_trip() {
        let text =
            format!(r#"{{ "points": [{POINT}], "window": [9, -1], "optical_depth_scale": 3 }}"#);
        let file = parse(&text).unwrap();
        assert_eq!(file.window, Some([9.0, -1.0]));
        let again = parse(&serde_json::to_string(&file).unwrap()).unwrap();
        assert_eq!(again, file);
    }

    #[test]
    fn optical_depth_scale_is_per_volume_size() {
        let scaled = parse(&format!(
            r#"{{ "points": [{POINT}], "optical_depth_scale": 3 }}"#
        ));
        let sigma_t = |file: TransferFunctionFile| file.for_volume_size(0.5).eval(0.0).sigma_t;
        assert_eq!(sigma_t(scaled.unwrap()), 48.0);
        let plain = parse(&format!(r#"{{ "points": [{POINT}] }}"#));
        assert_eq!(sigma_t(plain.unwrap()), 8.0);
    }

    #[test]
    fn bad_files_get_messages_that_name_file_and_field() {
        for (text, expected) in [
            ("{", "EOF"),
            ("{}", "points"),
            (r#"{ "points": [] }"#, "at least one point"),
            (
                r#"{ "points": [{"s":0,"sigma_t":1,"albedo":[1,1,1],"x":1}] }"#,
                "`x`",
            ),
            (
                r#"{ "points": [{"s":0,"sigma_t":-1,"albedo":[1,1,1]}] }"#,
                "points[0].sigma_t",
            ),
            (
                r#"{ "points": [{"s":0,"sigma_t":1,"albedo":[1,1,1]}], "window": [2, 2] }"#,
                "`window`",
            ),
            (
                r#"{ "points": [{"s":0,"sigma_t":1,"albedo":[1,1,1]}], "windows": [2, 2] }"#,
                "`windows`",
            ),
            (
                r#"{ "points": [{"s":0,"sigma_t":1,"albedo":[1,1,1]}], "optical_depth_scale": -1 }"#,
                "optical_depth_scale",
            ),
        ] {
            let message = parse(text).unwrap_err();
            assert!(message.starts_with("a.tf.json: "), "{message}");
            assert!(message.contains(expected), "{message} lacks {expected}");
        }
    }

    #[test]
    fn scene_form_takes_points_alone() {
        let points: TransferFunction =
            serde_json::from_str(&format!(r#"{{ "points": [{POINT}] }}"#)).unwrap();
        assert_eq!(points.eval(0.0).albedo, [0.1, 0.2, 0.3]);
        let unknown = format!(r#"{{ "points": [{POINT}], "window": [0, 1] }}"#);
        assert!(serde_json::from_str::<TransferFunction>(&unknown).is_err());
    }
}
