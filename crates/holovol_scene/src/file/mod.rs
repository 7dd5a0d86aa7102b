//! Scene files: what they hold, how they are checked, and what they become in memory.

mod background;
mod error;
mod sequence;
mod validate;

pub use background::Background;
pub use error::SceneError;
pub use sequence::Sequence;

use std::path::{Path, PathBuf};

use holovol_volume::{Progress, TransferPoint};
use serde::{Deserialize, Serialize};

use crate::Scene;

/// A scene as its JSON file writes it; paths are relative to the file's folder.
///
/// [`Self::parse`] and [`Self::read`] give only valid ones. One that was put together in code is
/// checked by [`Self::resolve`], or earlier by [`Self::validate`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneFile {
    /// Version of the format: [`Self::VERSION`].
    pub version: u32,
    /// Which volume, and where it stands.
    pub volume: VolumeEntry,
    /// What its values look like.
    pub transfer_function: TransferFunctionEntry,
    /// Mean cosine of the phase function, within ±[`Self::MAX_G`].
    #[serde(default)]
    pub phase_g: f64,
    /// k of the gradient surface, ≥ 0; 0 turns it off.
    #[serde(default)]
    pub gradient_factor: f64,
    /// Planes `[nx, ny, nz, w]` in world space, at most [`Self::MAX_CLIP_PLANES`]: what lies at
    /// n·x + w < 0 is left out.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub clip: Vec<[f64; 4]>,
    /// Where light comes from.
    pub environment: EnvironmentEntry,
    /// The view.
    pub camera: CameraEntry,
    /// How paths are made.
    #[serde(default)]
    pub integrator: IntegratorEntry,
    /// Render a left and a right image.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stereo: Option<StereoEntry>,
    /// Render a sequence of images.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub animation: Option<AnimationEntry>,
    /// How pictures for display are made of the radiance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub output: Option<OutputEntry>,
}

/// The volume of a [`SceneFile`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VolumeEntry {
    /// The volume's file, or the folder of a series.
    pub path: PathBuf,
    /// Which of several series, grids, channels or volumes: a number from 1, or a name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub choice: Option<String>,
    /// Values at which s is 0 and 1, data units, not equal; the whole range if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub window: Option<[f64; 2]>,
    /// World metres from unit-cube coordinates, rows first; from the header if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub world_from_unit_cube: Option<[[f64; 4]; 4]>,
}

/// The transfer function of a [`SceneFile`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TransferFunctionEntry {
    /// At least one point, sorted by `s`.
    pub points: Vec<TransferPoint>,
}

/// The light of a [`SceneFile`]: either a picture or the same radiance from everywhere.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EnvironmentEntry {
    /// A latitude–longitude map, `.hdr` or `.exr`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub path: Option<PathBuf>,
    /// Radiance (linear RGB, ≥ 0) from everywhere.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub constant: Option<[f64; 3]>,
    /// Turn about +y in degrees, counter-clockwise seen from above.
    #[serde(default)]
    pub rotation_y_deg: f64,
    /// Factor on the radiance, ≥ 0.
    #[serde(default = "one")]
    pub scale: f64,
}

impl EnvironmentEntry {
    /// A map from a file, not turned, as bright as it is.
    pub fn from_path(path: impl Into<PathBuf>) -> Self {
        Self {
            path: Some(path.into()),
            constant: None,
            rotation_y_deg: 0.0,
            scale: 1.0,
        }
    }

    /// The same radiance from everywhere.
    pub fn from_constant(radiance: [f64; 3]) -> Self {
        Self {
            path: None,
            constant: Some(radiance),
            rotation_y_deg: 0.0,
            scale: 1.0,
        }
    }
}

/// The camera of a [`SceneFile`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraEntry {
    /// Position, world metres.
    pub eye: [f64; 3],
    /// The point looked at, world metres.
    pub target: [f64; 3],
    /// Up in the image; not along the view.
    #[serde(default = "y_axis")]
    pub up: [f64; 3],
    /// Vertical field of view over the whole image height, degrees, between 0 and 180.
    pub fov_y_deg: f64,
    /// Pixels across, 1 … [`SceneFile::MAX_SIDE`].
    pub width: u32,
    /// Pixels down, 1 … [`SceneFile::MAX_SIDE`].
    pub height: u32,
}

/// The integrator of a [`SceneFile`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct IntegratorEntry {
    /// Paths have at most this many scatterings; 0 leaves emission only, `None` (null) is unlimited.
    #[serde(default = "one_scatter")]
    pub max_scatters: Option<u32>,
}

impl Default for IntegratorEntry {
    fn default() -> Self {
        Self {
            max_scatters: one_scatter(),
        }
    }
}

/// Two eyes instead of one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StereoEntry {
    /// Distance between the eyes in metres, ≥ 0; the axes are parallel.
    pub ipd: f64,
}

/// Motion over a sequence, linear from what the scene says: frame i stands at i/(frames − 1).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AnimationEntry {
    /// How many images, 1 … [`SceneFile::MAX_FRAMES`].
    pub frames: u32,
    /// Where the eye ends.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub eye_to: Option<[f64; 3]>,
    /// Where the target ends.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target_to: Option<[f64; 3]>,
    /// Where the turn of the environment ends, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub environment_rotation_to_deg: Option<f64>,
    /// How far the volume has turned about +y through its centre at the end, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub volume_rotation_y_to_deg: Option<f64>,
    /// A sudden change.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub switch: Option<SwitchEntry>,
}

/// What an animation exchanges from one frame to the next.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SwitchEntry {
    /// The first frame (from 0) with the new things.
    pub frame: u32,
    /// The light from then on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub environment: Option<EnvironmentEntry>,
    /// The transfer function from then on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub transfer_function: Option<TransferFunctionEntry>,
}

/// How a picture for display is made of the radiance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OutputEntry {
    /// Radiance is multiplied by 2 to this; found from the image if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure_ev: Option<f64>,
    /// The curve from exposed radiance to display.
    #[serde(default)]
    pub tone_mapping: ToneMapping,
    /// What shows where the volume is transparent.
    #[serde(default)]
    pub background: Background,
}

/// The curve from exposed radiance to display light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ToneMapping {
    /// Clamped at 1: what the measures of image quality look at.
    None,
    /// Khronos PBR Neutral: colours stay as they are up to 0.8, then roll off to white.
    #[default]
    Neutral,
    /// A fit of the ACES film curve (Narkowicz 2015): more contrast, highlights lose colour.
    Aces,
    /// c/(1 + c) on luminance (Reinhard et al. 2002).
    Reinhard,
}

fn one() -> f64 {
    1.0
}

fn one_scatter() -> Option<u32> {
    Some(1)
}

fn y_axis() -> [f64; 3] {
    [0.0, 1.0, 0.0]
}

impl SceneFile {
    /// As many planes cut a volume.
    pub const MAX_CLIP_PLANES: usize = 8;
    /// The version of the format that this crate reads and writes.
    pub const VERSION: u32 = 1;
    /// Largest |g|: f32 kernels lose the lobe beyond.
    pub const MAX_G: f64 = 0.9999;
    /// Largest image width and height.
    pub const MAX_SIDE: u32 = 16384;
    /// Largest number of pixels of an image (1 GiB of RGBA in 32-bit float).
    pub const MAX_PIXELS: u64 = 1 << 26;
    /// Largest number of frames of an animation.
    pub const MAX_FRAMES: u32 = 100_000;
    /// Largest distance of anything from the origin, metres.
    pub const MAX_COORDINATE: f64 = 1e12;
    /// Largest radiance of the light after scaling: products and sums of it stay within f32.
    pub const MAX_RADIANCE: f64 = 1e30;
    /// Largest optical depth across one voxel: at 10⁷ a path already takes minutes.
    pub const MAX_VOXEL_DEPTH: f64 = 1e7;
    /// Largest scene file, bytes.
    pub const MAX_BYTES: u64 = 16 << 20;

    /// Reads a scene from the text of its file and checks it. Opens no file.
    ///
    /// # Errors
    /// If the text is not JSON, has unknown or missing keys, or a value out of its range.
    pub fn parse(text: &str) -> Result<Self, SceneError> {
        // Some editors begin a file with a byte-order mark.
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        // Serde would take an array's values for the fields in their order.
        if text.trim_ascii_start().starts_with('[') {
            return Err(SceneError::field(
                "the scene",
                "is an array; expected an object { … }",
            ));
        }
        let mut deserializer = serde_json::Deserializer::from_str(text);
        let file: Self = serde_path_to_error::deserialize(&mut deserializer)
            .map_err(|source| SceneError::from_json(text, source))?;
        deserializer
            .end()
            .map_err(|source| SceneError::Syntax { source, hint: "" })?;
        file.validate()?;
        Ok(file)
    }

    /// Reads and checks a scene file; what it names is not opened yet.
    ///
    /// # Errors
    /// As [`Self::parse`], with the file's name; or if the file can't be read.
    pub fn read(path: &Path) -> Result<Self, SceneError> {
        let io = |source| SceneError::Io {
            path: path.into(),
            source,
        };
        let size = std::fs::metadata(path).map_err(io)?.len();
        if size > Self::MAX_BYTES {
            return Err(SceneError::TooLarge {
                path: path.into(),
                size,
            });
        }
        let bytes = std::fs::read(path).map_err(io)?;
        std::str::from_utf8(&bytes)
            .map_err(|source| SceneError::Utf8 {
                offset: source.valid_up_to(),
            })
            .and_then(Self::parse)
            .map_err(|source| source.in_file(path))
    }

    /// The text of a scene file, ending in a line feed; [`Self::parse`] gives the same scene back.
    ///
    /// # Errors
    /// If the scene is not valid, or a path is not UTF-8 text.
    pub fn to_json(&self) -> Result<String, SceneError> {
        self.validate()?;
        let mut text = serde_json::to_string_pretty(self)
            .map_err(|error| SceneError::field("the scene", error.to_string()))?;
        text.push('\n');
        Ok(text)
    }

    /// Loads the volume and the light that the scene names, relative to `base`, and gives the
    /// first frame.
    ///
    /// # Errors
    /// If the scene is not valid, or a file that it names can't be read.
    pub fn resolve(
        &self,
        base: &Path,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Scene, SceneError> {
        Sequence::new(self, base, progress)?.frame(0)
    }
}

/// Reads a scene file with everything it names; of an animation the first frame.
///
/// # Errors
/// If the scene or a file that it names can't be read or is not valid.
pub fn load(path: &Path, progress: &mut dyn FnMut(Progress)) -> Result<Scene, SceneError> {
    Sequence::load(path, progress)?.frame(0)
}
