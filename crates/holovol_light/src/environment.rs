mod openexr;
mod radiance;

use std::f64::consts::{PI, TAU};
use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Read, Seek};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::DVec3;

/// Why light could not be loaded or made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LightError {
    /// The file could not be opened or read.
    #[error("{path}: cannot read the environment map: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is not a picture that can be read.
    #[error(
        "{path}: not a readable environment map: {reason}; expected Radiance .hdr or OpenEXR .exr with R, G, B"
    )]
    Decode {
        /// The file.
        path: PathBuf,
        /// What the decoder said.
        reason: String,
    },
    /// The picture's size is not usable.
    #[error(
        "{path}: environment map of {width} × {height} pixels: expected at least 1 × 1 and at most 16384 × 8192"
    )]
    Size {
        /// The file.
        path: PathBuf,
        /// Pixels across.
        width: usize,
        /// Pixels down.
        height: usize,
    },
}

/// Why a decoder gave up; [`EnvironmentMap::load`] adds the file.
#[derive(Debug)]
enum DecodeError {
    Size(usize, usize),
    Reason(String),
}

impl std::fmt::Display for DecodeError {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Self::Size(width, height) => write!(f, "{width} × {height} pixels"),
            Self::Reason(reason) => f.write_str(reason),
        }
    }
}

impl From<String> for DecodeError {
    fn from(reason: String) -> Self {
        Self::Reason(reason)
    }
}

impl From<&str> for DecodeError {
    fn from(reason: &str) -> Self {
        Self::Reason(reason.into())
    }
}

impl From<std::io::Error> for DecodeError {
    fn from(error: std::io::Error) -> Self {
        Self::Reason(match error.kind() {
            std::io::ErrorKind::UnexpectedEof => "the file breaks off".into(),
            _ => error.to_string(),
        })
    }
}

impl From<exr::error::Error> for DecodeError {
    fn from(error: exr::error::Error) -> Self {
        Self::Reason(error.to_string())
    }
}

fn check_size(width: usize, height: usize) -> Result<(), DecodeError> {
    let allowed = 1..=EnvironmentMap::MAX_WIDTH;
    if allowed.contains(&width) && (1..=EnvironmentMap::MAX_WIDTH / 2).contains(&height) {
        Ok(())
    } else {
        Err(DecodeError::Size(width, height))
    }
}

/// Rec. 709 luminance of a linear RGB triple.
#[inline]
pub fn luminance(rgb: [f64; 3]) -> f64 {
    0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]
}

/// Linear radiance from every direction, as a latitude–longitude map.
///
/// The image centre looks along −z, u grows toward +x, v = 0 is +y:
/// u = ½ + atan2(x, −z)/2π, v = acos(y)/π. Bilinear between texel centres, wrapping in u,
/// clamped in v. Texels are finite and ≥ 0 by construction. Cloning is cheap: texels are shared.
///
/// Not to be confused with Bevy's `EnvironmentMapLight`, a prefiltered cube map.
#[derive(Clone, Debug, PartialEq)]
pub struct EnvironmentMap {
    width: usize,
    height: usize,
    texels: Arc<Vec<[f32; 3]>>,
    replaced: usize,
}

impl EnvironmentMap {
    /// Largest width; the height may be half of it.
    pub const MAX_WIDTH: usize = 16384;
    /// Largest radiance: what all texels of the largest map give together is a finite f32.
    const LARGEST: f32 = f32::MAX / 1e6;

    /// A map of the same radiance from everywhere.
    pub fn constant(radiance: [f32; 3]) -> Self {
        Self::new(1, 1, vec![radiance])
    }

    /// A map of row-major texels, top row first. Values that are NaN or negative become 0, those
    /// that are infinite, or above 3.4 · 10³² so that sums would be, the largest of the others;
    /// [`Self::replaced`] counts such texels.
    ///
    /// # Panics
    /// If `texels.len()` is not `width · height`, or that is 0.
    pub fn new(width: usize, height: usize, mut texels: Vec<[f32; 3]>) -> Self {
        assert!(
            width * height == texels.len() && !texels.is_empty(),
            "one texel per pixel"
        );
        let valid = |c: f32| (0.0..=Self::LARGEST).contains(&c);
        let is_broken = |texel: &[f32; 3]| !texel.iter().all(|&c| valid(c));
        let replaced = texels.iter().filter(|texel| is_broken(texel)).count();
        if replaced > 0 {
            let values = texels.as_flattened_mut();
            let others = values.iter().copied().filter(|&c| valid(c));
            let largest = others.fold(0.0, f32::max);
            for c in values.iter_mut().filter(|c| !valid(**c)) {
                *c = if *c > 0.0 { largest } else { 0.0 };
            }
        }
        Self {
            width,
            height,
            texels: Arc::new(texels),
            replaced,
        }
    }

    /// Reads a Radiance `.hdr` or an OpenEXR `.exr` file, whichever its first bytes say.
    ///
    /// Of an OpenEXR file it takes the first flat layer with R, G and B (half, float or integer);
    /// a Radiance file's `EXPOSURE` is undone, as its format says.
    ///
    /// # Errors
    /// If the file is missing, damaged, or not such a picture.
    pub fn load(path: &Path) -> Result<Self, LightError> {
        let io = |source| LightError::Io {
            path: path.into(),
            source,
        };
        let file = File::open(path).map_err(io)?;
        let file_len = file.metadata().map_err(io)?.len();
        Self::decode(path, BufReader::new(file), file_len)
    }

    /// Reads the contents of such a file; `name` is what messages call it.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn from_bytes(name: &Path, bytes: &[u8]) -> Result<Self, LightError> {
        Self::decode(name, Cursor::new(bytes), bytes.len() as u64)
    }

    fn decode(
        path: &Path,
        mut reader: impl BufRead + Seek,
        file_len: u64,
    ) -> Result<Self, LightError> {
        let io = |source| LightError::Io {
            path: path.into(),
            source,
        };
        let mut magic = Vec::new();
        (&mut reader).take(4).read_to_end(&mut magic).map_err(io)?;
        reader.rewind().map_err(io)?;
        let decoded = match magic.as_slice() {
            [0x76, 0x2f, 0x31, 0x01] => openexr::read(reader, file_len),
            [b'#', b'?', ..] => radiance::read(reader),
            _ => Err(format!(
                "it begins with neither `#?` nor the OpenEXR signature but with {magic:02x?}"
            )
            .into()),
        };
        let (width, height, texels) = decoded.map_err(|error| match error {
            DecodeError::Size(width, height) => LightError::Size {
                path: path.into(),
                width,
                height,
            },
            DecodeError::Reason(reason) => LightError::Decode {
                path: path.into(),
                reason,
            },
        })?;
        Ok(Self::new(width, height, texels))
    }

    /// Texels across.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Texels down.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Row-major linear RGB, top row first.
    pub fn texels(&self) -> &[[f32; 3]] {
        &self.texels
    }

    /// How many texels were not finite and ≥ 0 and have been replaced.
    pub fn replaced(&self) -> usize {
        self.replaced
    }

    /// The radiance of a constant map.
    pub fn as_constant(&self) -> Option<[f32; 3]> {
        let first = self.texels[0];
        self.texels
            .iter()
            .all(|&texel| texel == first)
            .then_some(first)
    }

    /// Direction to texture coordinates, in the map's own frame.
    pub fn uv_from_direction(direction: DVec3) -> [f64; 2] {
        let y = (direction.y / direction.length()).clamp(-1.0, 1.0);
        [0.5 + direction.x.atan2(-direction.z) / TAU, y.acos() / PI]
    }

    /// Texture coordinates to unit direction, in the map's own frame.
    pub fn direction_from_uv([u, v]: [f64; 2]) -> DVec3 {
        let (sin_phi, cos_phi) = ((u - 0.5) * TAU).sin_cos();
        let (sin_theta, cos_theta) = (v * PI).sin_cos();
        DVec3::new(sin_theta * sin_phi, cos_theta, -sin_theta * cos_phi)
    }

    /// Texel with u wrapped and v clamped.
    #[inline]
    pub fn texel(&self, x: i64, y: i64) -> [f32; 3] {
        let x = x.rem_euclid(self.width as i64) as usize;
        let y = y.clamp(0, self.height as i64 - 1) as usize;
        self.texels[x + self.width * y]
    }

    /// Bilinear radiance at texture coordinates, in f64.
    pub fn radiance_at_uv(&self, [u, v]: [f64; 2]) -> [f64; 3] {
        let (x, y) = (u * self.width as f64 - 0.5, v * self.height as f64 - 0.5);
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        let (i, j) = (x0 as i64, y0 as i64);
        let corners = [
            self.texel(i, j),
            self.texel(i + 1, j),
            self.texel(i, j + 1),
            self.texel(i + 1, j + 1),
        ];
        let weights = [
            (1.0 - fx) * (1.0 - fy),
            fx * (1.0 - fy),
            (1.0 - fx) * fy,
            fx * fy,
        ];
        std::array::from_fn(|c| (0..4).map(|k| weights[k] * f64::from(corners[k][c])).sum())
    }

    /// Bilinear radiance from a direction of the map's own frame, in f64.
    pub fn radiance(&self, direction: DVec3) -> [f64; 3] {
        self.radiance_at_uv(Self::uv_from_direction(direction))
    }
}
