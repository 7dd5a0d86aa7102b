//! Grids of an OpenVDB file: which there are, and where they lie.

use glam::{DMat3, DVec3};

use super::stream::Stream;
use crate::reader::placement::check_directions;
use crate::{Geometry, VolumeError};

/// `OPENVDB_FILE_VERSION_NODE_MASK_COMPRESSION`, of 2013: the oldest that is read.
const VERSION_MIN: u32 = 222;

/// Newer files may hold what we don't know.
const VERSION_MAX: u32 = 224;

/// More grids than this are damage.
const GRIDS_MAX: u32 = 4096;

/// Beyond version 213 a byte says so.
const HAS_OFFSETS: u8 = 1;

/// The type of a grid's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ValueType {
    F32,
    F64,
    I32,
    I64,
}

impl ValueType {
    pub fn bytes(self) -> usize {
        match self {
            Self::F32 | Self::I32 => 4,
            Self::F64 | Self::I64 => 8,
        }
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F64 => "f64",
            Self::I32 => "i32",
            Self::I64 => "i64",
        }
    }
}

/// What a file's list says of a grid.
#[derive(Clone, Debug)]
pub(super) struct Descriptor {
    pub name: String,
    pub tree: String,
    /// `None` if it can't be read.
    pub values: Option<ValueType>,
    pub is_half: bool,
    pub instance_of: String,
    pub grid_at: i64,
    pub blocks_at: i64,
}

/// Reads the file's header and its list of grids.
pub(super) fn list(stream: &mut Stream<'_>) -> Result<Vec<Descriptor>, VolumeError> {
    if stream.array::<8>()? != *b" BDV\0\0\0\0" {
        return Err(stream.error("magic", "something else", "the bytes \" BDV\""));
    }
    let version = stream.u32()?;
    if !(VERSION_MIN..=VERSION_MAX).contains(&version) {
        return Err(stream.unsupported(
            format!("file version {version} can't be read, only {VERSION_MIN} to {VERSION_MAX}"),
            "save it again with OpenVDB 2 to 12",
        ));
    }
    // Major and minor version of the library.
    stream.array::<8>()?;
    if stream.u8()? != HAS_OFFSETS {
        return Err(stream.unsupported(
            "a file without grid offsets (a stream) can't be read",
            "save it to a file with OpenVDB",
        ));
    }
    // Its UUID.
    stream.array::<36>()?;
    stream.skip_metadata()?;
    let count = stream.u32()?;
    if count > GRIDS_MAX {
        return Err(stream.error(
            "number of grids",
            count.to_string(),
            format!("at most {GRIDS_MAX}"),
        ));
    }
    let mut grids = Vec::new();
    for _ in 0..count {
        let name = stream.string("grid name")?;
        // Equal names are told apart by a suffix that nobody is to see.
        let name = name.split('\u{1e}').next().unwrap_or_default().to_owned();
        let kind = stream.string("grid type")?;
        let (tree, is_half) = match kind.strip_suffix("_HalfFloat") {
            Some(tree) => (tree, true),
            None => (kind.as_str(), false),
        };
        let instance_of = stream.string("grid instance")?;
        let grid_at = stream.i64()?;
        let blocks_at = stream.i64()?;
        let end = stream.i64()?;
        grids.push(Descriptor {
            values: match tree {
                "Tree_float_5_4_3" => Some(ValueType::F32),
                "Tree_double_5_4_3" => Some(ValueType::F64),
                "Tree_int32_5_4_3" => Some(ValueType::I32),
                "Tree_int64_5_4_3" => Some(ValueType::I64),
                _ => None,
            },
            name,
            tree: tree.to_owned(),
            is_half,
            instance_of,
            grid_at,
            blocks_at,
        });
        // The next descriptor follows the grid. Going back would let a file be read for ever.
        if u64::try_from(end).is_ok_and(|end| end < stream.position()) {
            return Err(stream.error(
                "grid end",
                end.to_string(),
                "an offset after its descriptor",
            ));
        }
        stream.go_to(end, "grid end")?;
    }
    Ok(grids)
}

/// Where the voxel of an index lies: metres per step, and index (0, 0, 0)'s place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Transform {
    steps: DMat3,
    origin: DVec3,
}

impl Transform {
    pub fn read(stream: &mut Stream<'_>) -> Result<Self, VolumeError> {
        let kind = stream.string("transform")?;
        let vector = |stream: &mut Stream<'_>| -> Result<DVec3, VolumeError> {
            Ok(DVec3::new(stream.f64()?, stream.f64()?, stream.f64()?))
        };
        let transform = match kind.as_str() {
            "UniformScaleMap" | "ScaleMap" => {
                let scale = vector(stream)?;
                // Voxel size and inverses follow from it.
                for _ in 0..4 {
                    vector(stream)?;
                }
                Self {
                    steps: DMat3::from_diagonal(scale),
                    origin: DVec3::ZERO,
                }
            }
            "UniformScaleTranslateMap" | "ScaleTranslateMap" => {
                let origin = vector(stream)?;
                let scale = vector(stream)?;
                for _ in 0..4 {
                    vector(stream)?;
                }
                Self {
                    steps: DMat3::from_diagonal(scale),
                    origin,
                }
            }
            "TranslationMap" => Self {
                steps: DMat3::IDENTITY,
                origin: vector(stream)?,
            },
            "AffineMap" | "UnitaryMap" => {
                // Row vectors are multiplied from the left: rows are our columns.
                let mut rows = [DVec3::ZERO; 4];
                for row in &mut rows {
                    *row = vector(stream)?;
                    stream.f64()?;
                }
                let [x, y, z, origin] = rows;
                Self {
                    steps: DMat3::from_cols(x, y, z),
                    origin,
                }
            }
            _ => {
                let shown: String = kind.chars().take(40).collect();
                return Err(stream.unsupported(
                    format!("the transform {shown:?} is not affine"),
                    "resample the grid to a uniform scale",
                ));
            }
        };
        check_directions(&transform.steps)
            .map_err(|problem| stream.error("transform", problem, "independent steps in metres"))?;
        if !transform.origin.is_finite() {
            return Err(stream.error("transform", "not finite", "a place in metres"));
        }
        Ok(transform)
    }

    /// The geometry of a volume whose first voxel has this index.
    pub fn geometry(&self, first: [i32; 3]) -> Geometry {
        let index = DVec3::from_array(first.map(f64::from));
        Geometry {
            metres_from_index: self.steps,
            origin: self.origin + self.steps * index,
            oriented: false,
        }
    }
}
