use std::path::{Path, PathBuf};

use holovol_light::LightError;
use holovol_volume::VolumeError;

use super::SceneFile;

/// Why a scene could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// The scene file could not be opened or read.
    #[error("{path}: cannot read the scene file: {source}{}", way_out(source))]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is too large to be a scene.
    #[error(
        "{path}: {size} bytes are too many for a scene file (at most {}); is this the volume instead of the scene?",
        SceneFile::MAX_BYTES
    )]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Its length in bytes.
        size: u64,
    },
    /// The file is not text.
    #[error(
        "not a scene file: byte {offset} is not UTF-8 text; a scene file is JSON (is this the volume instead of the scene?)"
    )]
    Utf8 {
        /// Where the text ends.
        offset: usize,
    },
    /// The text is not JSON.
    #[error("not valid JSON: {source}{hint}")]
    Syntax {
        /// What is wrong, with line and column.
        source: serde_json::Error,
        /// The way out, or nothing.
        hint: &'static str,
    },
    /// A key that scene files don't have.
    #[error(
        "{place}: unknown key `{key}`{}; the keys here are {expected}",
        suggestion.as_ref().map(|s| format!(", did you mean `{s}`?")).unwrap_or_default()
    )]
    UnknownKey {
        /// JSON path of the object with the key.
        place: String,
        /// The key.
        key: String,
        /// The nearest valid key, if one is near.
        suggestion: Option<String>,
        /// The valid keys.
        expected: String,
    },
    /// A value is missing, of another type or out of its range.
    #[error("{field}: {problem}")]
    Field {
        /// JSON path of the value.
        field: String,
        /// What was expected and what came.
        problem: String,
    },
    /// A part of the format that this version can't render yet.
    #[error("{field}: not supported yet; remove it to render the rest of the scene")]
    Unsupported {
        /// JSON path of the value.
        field: String,
    },
    /// The volume could not be loaded.
    #[error("{field}: {source}")]
    Volume {
        /// JSON path of the volume's path.
        field: String,
        /// Why, with the file's name.
        source: Box<VolumeError>,
    },
    /// The light could not be loaded.
    #[error("{field}: {source}")]
    Light {
        /// JSON path of the light's path.
        field: String,
        /// Why, with the file's name.
        source: LightError,
    },
    /// Something is wrong with this scene file.
    #[error("{path}: {source}")]
    InFile {
        /// The scene file.
        path: PathBuf,
        /// What is wrong.
        source: Box<SceneError>,
    },
}

impl SceneError {
    /// The same error, naming the scene file, if it does not already.
    pub fn in_file(self, path: &Path) -> Self {
        match self {
            Self::Io { .. } | Self::TooLarge { .. } | Self::InFile { .. } => self,
            source => Self::InFile {
                path: path.into(),
                source: Box::new(source),
            },
        }
    }

    pub(super) fn field(field: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Field {
            field: field.into(),
            problem: problem.into(),
        }
    }

    /// Names the field that serde stumbled over, the nearest key to an unknown one, and the
    /// parts of the format that can't be rendered yet.
    pub(super) fn from_json(
        text: &str,
        error: serde_path_to_error::Error<serde_json::Error>,
    ) -> Self {
        if !error.inner().is_data() {
            return Self::Syntax {
                source: error.into_inner(),
                hint: syntax_hint(text),
            };
        }
        if let Some(field) = unsupported_part(text) {
            return Self::Unsupported {
                field: field.into(),
            };
        }
        let path = error.path().to_string();
        let message = error.inner().to_string();
        let mut place = if path == "." {
            "the scene".to_owned()
        } else {
            path
        };
        let Some((key, expected)) = unknown_key(&message) else {
            return Self::field(place, with_hint(&message));
        };
        // The path of an unknown key ends in the key itself.
        match place.strip_suffix(key).map(|p| p.trim_end_matches('.')) {
            Some("") => place = "the scene".to_owned(),
            Some(parent) => place.truncate(parent.len()),
            None => {}
        }
        Self::UnknownKey {
            place,
            key: key.to_owned(),
            suggestion: nearest_key(key, expected),
            expected: expected.to_owned(),
        }
    }
}

/// JSON path of something that DESIGN knows and the renderer does not yet.
fn unsupported_part(text: &str) -> Option<&'static str> {
    let value: serde_json::Value = serde_json::from_str(text).ok()?;
    let parts = [
        ("/volumes", "volumes"),
        ("/labels", "labels"),
        ("/integrator/model", "integrator.model"),
    ];
    let found = parts
        .iter()
        .find(|(pointer, _)| value.pointer(pointer).is_some());
    found.map(|&(_, field)| field)
}

/// Key and list of valid keys from serde's message "unknown field `a`, expected one of `b`, `c`".
fn unknown_key(message: &str) -> Option<(&str, &str)> {
    let (key, rest) = message.strip_prefix("unknown field `")?.split_once("`, ")?;
    let expected = rest
        .strip_prefix("expected one of ")
        .or_else(|| rest.strip_prefix("expected "))?;
    let end = expected.find(" at line").unwrap_or(expected.len());
    Some((key, &expected[..end]))
}

fn nearest_key(key: &str, expected: &str) -> Option<String> {
    /// Below this Jaro–Winkler similarity two keys have little to do with each other.
    const SIMILAR: f64 = 0.75;
    let lower = key.to_lowercase();
    let similarity = |candidate: &str| strsim::jaro_winkler(&lower, candidate);
    let keys = expected.split('`').skip(1).step_by(2);
    let nearest = keys.max_by(|a, b| similarity(a).total_cmp(&similarity(b)))?;
    (similarity(nearest) > SIMILAR).then(|| nearest.to_owned())
}

/// What a user can do about a file that can't be opened.
fn way_out(error: &std::io::Error) -> &'static str {
    use std::io::ErrorKind;
    match error.kind() {
        ErrorKind::NotFound => "; check the path, which is relative to the current folder",
        ErrorKind::PermissionDenied => "; check the file's permissions",
        ErrorKind::IsADirectory => "; name the scene file in it",
        _ => "",
    }
}

/// What a user may have meant by text that is not JSON.
pub(super) fn syntax_hint(text: &str) -> &'static str {
    let text = text.trim_start();
    if text.is_empty() {
        "; the file is empty, README shows what a scene file holds"
    } else if !text.starts_with('{') {
        "; a scene file is an object { … } (is this the volume instead of the scene?)"
    } else if text.contains("//") || text.contains("/*") || text.contains("\n#") {
        "; JSON has no comments"
    } else if text.contains("NaN") || text.contains("Infinity") {
        "; JSON has finite numbers only"
    } else {
        ""
    }
}

/// Serde's messages about types in words for people, with the way out.
fn with_hint(message: &str) -> String {
    let hint = if message.contains("expected f64") && message.contains("string") {
        "; write a bare number without quotes or a unit (lengths are metres, angles degrees)"
    } else if message.contains("expected an array of length") {
        "; give exactly that many numbers"
    } else if message.starts_with("missing field") {
        "; add it, README shows a whole scene"
    } else {
        ""
    };
    let place = message.find(" at line").unwrap_or(message.len());
    let (what, place) = message.split_at(place);
    let what = what
        .replace("missing field", "is missing the key")
        .replace("invalid type: ", "found ")
        .replace("invalid value: ", "found ")
        .replace("invalid length ", "found a list of ")
        .replace("integer ", "")
        .replace("floating point ", "")
        .replace("expected f64", "expected a number")
        .replace("expected u32", "expected a whole number, 0 or above");
    format!("{what}{place}{hint}")
}
