//! Voxels without a header: their layout comes from the user, or from a sidecar `FILE.json`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};

use super::decode::{self, Decoded, Layout};
use super::numbers::NumberType;
use super::placement::{METRES_PER_MM, check_directions};
use super::{Input, Progress, ReadOptions};
use crate::{Geometry, SourceFormat, Volume, VolumeError};

/// A sidecar longer than this is none.
const SIDECAR_BYTES_MAX: u64 = 1 << 20;

/// How the voxels of a file without a header lie in it; also what a sidecar (`scan.raw.json`
/// beside `scan.raw`) holds.
///
/// ```json
/// { "dims": [256, 256, 120], "type": "u16", "endian": "little", "spacing_mm": [0.7, 0.7, 1.5] }
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RawLayout {
    /// Voxels along x, y, z, fastest first.
    pub dims: [u32; 3],
    /// The numbers' type: `u8`, `i8`, `u16`, `i16`, `u32`, `i32`, `u64`, `i64`, `f32` or `f64`.
    #[serde(rename = "type")]
    pub number: NumberType,
    /// Which byte of a number comes first: `little` (the default) or `big`.
    #[serde(default)]
    pub endian: Endian,
    /// Millimetres per voxel step along x, y, z; 1 mm if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spacing_mm: Option<[f64; 3]>,
    /// Bytes before the first voxel.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub offset: u64,
    /// `value = slope · stored + intercept`; 1 if left out.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub slope: f64,
    /// `value = slope · stored + intercept`; 0 if left out.
    #[serde(default, skip_serializing_if = "is_zero_f64")]
    pub intercept: f64,
    /// Millimetres per voxel step along each of x, y, z, as vectors to the patient's right,
    /// anterior, superior; takes the place of `spacing_mm`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub directions_ras_mm: Option<[[f64; 3]; 3]>,
    /// The same without a patient, in the world's x, y, z.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub directions_world_mm: Option<[[f64; 3]; 3]>,
    /// The first voxel's centre in the same frame, millimetres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub origin_ras_mm: Option<[f64; 3]>,
}

/// Which byte of a number comes first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Endian {
    /// The lowest.
    #[default]
    Little,
    /// The highest.
    Big,
}

fn one() -> f64 {
    1.0
}

fn is_one(number: &f64) -> bool {
    *number == 1.0
}

fn is_zero(number: &u64) -> bool {
    *number == 0
}

fn is_zero_f64(number: &f64) -> bool {
    *number == 0.0
}

/// What lies where a sidecar would, and is none: a scene that was saved under its scan's name, what
/// other programs know of a scan.
fn is_of_something_else(text: &str) -> bool {
    const KEYS: [&str; 3] = ["dims", "type", "endian"];
    serde_json::from_str::<BTreeMap<String, IgnoredAny>>(text)
        .is_ok_and(|object| !KEYS.iter().any(|key| object.contains_key(*key)))
}

impl RawLayout {
    /// Little-endian numbers from the file's beginning on, 1 mm apart.
    pub fn new(dims: [u32; 3], number: NumberType) -> Self {
        Self {
            dims,
            number,
            endian: Endian::Little,
            spacing_mm: None,
            offset: 0,
            slope: 1.0,
            intercept: 0.0,
            directions_ras_mm: None,
            directions_world_mm: None,
            origin_ras_mm: None,
        }
    }

    /// The sidecar's path of a data file: `scan.raw.json` of `scan.raw`.
    pub fn sidecar_path(data: &Path) -> PathBuf {
        let mut name = data.as_os_str().to_owned();
        name.push(".json");
        name.into()
    }

    /// Reads the sidecar of a data file, if there is one.
    ///
    /// # Errors
    /// If it can't be read, or is not such a layout.
    pub fn from_sidecar(data: &Path) -> Result<Option<Self>, VolumeError> {
        let path = Self::sidecar_path(data);
        let length = match std::fs::metadata(&path) {
            Ok(metadata) if metadata.is_file() => metadata.len(),
            _ => return Ok(None),
        };
        if length > SIDECAR_BYTES_MAX {
            return Ok(None);
        }
        let text = std::fs::read_to_string(&path).map_err(|e| VolumeError::io(&path, e))?;
        if is_of_something_else(&text) {
            return Ok(None);
        }
        serde_json::from_str(&text)
            .map(Some)
            .map_err(|error| VolumeError::Field {
                path,
                format: "raw sidecar",
                field: "layout".into(),
                found: error.to_string(),
                expected: "{\"dims\": [x, y, z], \"type\": \"u16\"} and if need be \"endian\", \
                           \"spacing_mm\", \"offset\", \"slope\", \"intercept\", \
                           \"directions_ras_mm\", \"directions_world_mm\", \"origin_ras_mm\""
                    .into(),
            })
    }

    fn geometry(&self, path: &Path) -> Result<Geometry, VolumeError> {
        let field = |field: &str, found: String, expected: &str| VolumeError::Field {
            path: path.into(),
            format: "raw",
            field: field.into(),
            found,
            expected: expected.into(),
        };
        if let Some(directions) = self.directions_ras_mm.or(self.directions_world_mm) {
            let [x, y, z] = directions.map(|d| DVec3::from_array(d) * METRES_PER_MM);
            let directions = DMat3::from_cols(x, y, z);
            check_directions(&directions).map_err(|problem| {
                field(
                    "directions_ras_mm",
                    problem.into(),
                    "three independent vectors in millimetres",
                )
            })?;
            let origin = DVec3::from_array(self.origin_ras_mm.unwrap_or_default());
            if !origin.is_finite() {
                return Err(field(
                    "origin_ras_mm",
                    format!("{origin}"),
                    "finite numbers",
                ));
            }
            return Ok(Geometry {
                metres_from_index: directions,
                origin: origin * METRES_PER_MM,
                oriented: self.directions_ras_mm.is_some(),
            });
        }
        let spacing = self
            .spacing_mm
            .unwrap_or([1.0; 3])
            .map(|l| l * METRES_PER_MM);
        check_directions(&DMat3::from_diagonal(DVec3::from_array(spacing)))
            .ok()
            .filter(|()| spacing.iter().all(|&length| length > 0.0))
            .ok_or_else(|| {
                field(
                    "spacing_mm",
                    format!("{:?}", self.spacing_mm.unwrap_or_default()),
                    "three positive lengths in millimetres",
                )
            })?;
        Ok(Geometry::from_spacing(spacing))
    }
}

/// Reads voxels as the layout says.
pub(super) fn read(
    mut input: Input<'_>,
    layout: &RawLayout,
    options: &ReadOptions,
    progress: &mut dyn FnMut(Progress),
) -> Result<Volume, VolumeError> {
    let path = input.path().to_path_buf();
    let field = |field: &str, found: String, expected: &str| VolumeError::Field {
        path: path.clone(),
        format: "raw",
        field: field.into(),
        found,
        expected: expected.into(),
    };
    if layout.dims.contains(&0) {
        return Err(field(
            "dims",
            format!("{:?}", layout.dims),
            "1 or more each",
        ));
    }
    if !layout.slope.is_finite() || layout.slope == 0.0 || !layout.intercept.is_finite() {
        let found = format!("{} and {}", layout.slope, layout.intercept);
        return Err(field(
            "slope and intercept",
            found,
            "finite, and slope not 0",
        ));
    }
    let geometry = layout.geometry(&path)?;
    input.skip(layout.offset)?;
    let Decoded {
        voxels,
        mut notices,
        rounded,
    } = decode::read_voxels(
        &mut input,
        &Layout {
            number: layout.number,
            big_endian: layout.endian == Endian::Big,
            dims: layout.dims,
        },
        options,
        progress,
    )?;
    notices.extend(decode::check_end(&mut input)?);
    let volume = Volume::new(
        voxels,
        layout.dims,
        layout.slope,
        layout.intercept,
        geometry,
    )?
    .with_rounded(rounded)
    .with_source_format(SourceFormat {
        name: "raw",
        numbers: layout.number.name(),
    });
    Ok(notices.into_iter().fold(volume, Volume::with_notice))
}
