use std::path::Path;

use glam::{DMat3, DQuat, DVec3};

use crate::reader::placement::{METRES_PER_MM, check_directions, checked_origin, checked_spacing};
use crate::{Geometry, VolumeError};

/// The two layouts of the header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Version {
    One,
    Two,
}

impl Version {
    /// Layout and whether it is big-endian, from `sizeof_hdr`.
    pub fn detect(first_bytes: &[u8]) -> Option<(Self, bool)> {
        match *first_bytes.first_chunk::<4>()? {
            [0x5c, 1, 0, 0] => Some((Self::One, false)),
            [0, 0, 1, 0x5c] => Some((Self::One, true)),
            [0x1c, 2, 0, 0] => Some((Self::Two, false)),
            [0, 0, 2, 0x1c] => Some((Self::Two, true)),
            _ => None,
        }
    }

    pub fn header_bytes(self) -> u64 {
        match self {
            Self::One => 348,
            Self::Two => 540,
        }
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::One => "NIfTI-1",
            Self::Two => "NIfTI-2",
        }
    }

    /// Header and the four bytes that announce extensions: voxels can't begin before.
    fn first_offset(self) -> u64 {
        self.header_bytes() + 4
    }
}

/// The fields that matter here, at their places in either layout.
pub(super) struct Header<'a> {
    bytes: &'a [u8],
    version: Version,
    big_endian: bool,
    path: &'a Path,
    storage: Storage,
}

/// Where the voxels are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Storage {
    /// In this file.
    Single,
    /// In the `.img` file beside this one.
    Pair,
    /// Likewise; the header is of Analyze 7.5, which NIfTI grew from.
    Analyze,
}

impl<'a> Header<'a> {
    /// Checks the magic string.
    pub fn new(
        bytes: &'a [u8],
        version: Version,
        big_endian: bool,
        path: &'a Path,
    ) -> Result<Self, VolumeError> {
        let mut header = Self {
            bytes,
            version,
            big_endian,
            path,
            storage: Storage::Single,
        };
        let magic: [u8; 4] = header.array(match version {
            Version::One => 344,
            Version::Two => 4,
        });
        let is_header_file = path
            .extension()
            .is_some_and(|end| end.eq_ignore_ascii_case("hdr"));
        header.storage = match &magic {
            b"n+1\0" | b"n+2\0" => Storage::Single,
            b"ni1\0" | b"ni2\0" => Storage::Pair,
            _ if is_header_file && version == Version::One => Storage::Analyze,
            _ => {
                return Err(header.error(
                    "magic",
                    format!("{:?}", String::from_utf8_lossy(&magic)),
                    "n+1, ni1, n+2 or ni2; an Analyze 7.5 header, which has none, is named .hdr",
                ));
            }
        };
        Ok(header)
    }

    pub fn storage(&self) -> Storage {
        self.storage
    }

    /// The format's name, as in messages.
    pub fn format(&self) -> &'static str {
        match self.storage {
            Storage::Analyze => "Analyze 7.5",
            _ => self.version.name(),
        }
    }

    fn error(
        &self,
        field: impl Into<String>,
        found: impl Into<String>,
        expected: &str,
    ) -> VolumeError {
        VolumeError::Field {
            path: self.path.into(),
            format: self.format(),
            field: field.into(),
            found: found.into(),
            expected: expected.into(),
        }
    }

    /// Bytes at an offset, in little-endian order of the machine's reading.
    fn array<const N: usize>(&self, at: usize) -> [u8; N] {
        let mut array = [0; N];
        for (to, from) in array.iter_mut().zip(self.bytes.iter().skip(at)) {
            *to = *from;
        }
        array
    }

    fn number<const N: usize>(&self, at: usize) -> [u8; N] {
        let mut array = self.array(at);
        if self.big_endian {
            array.reverse();
        }
        array
    }

    /// An integer field: 16 bits at `one` in NIfTI-1, 32 bits at `two` in NIfTI-2.
    fn code(&self, one: usize, two: usize) -> i32 {
        match self.version {
            Version::One => i16::from_le_bytes(self.number(one)).into(),
            Version::Two => i32::from_le_bytes(self.number(two)),
        }
    }

    /// The `index`-th of the floats at `one` (f32, NIfTI-1) or `two` (f64, NIfTI-2).
    fn float(&self, one: usize, two: usize, index: usize) -> f64 {
        match self.version {
            Version::One => f32::from_le_bytes(self.number(one + 4 * index)).into(),
            Version::Two => f64::from_le_bytes(self.number(two + 8 * index)),
        }
    }

    fn float3(&self, one: usize, two: usize, first: usize) -> DVec3 {
        DVec3::from_array(std::array::from_fn(|i| self.float(one, two, first + i)))
    }

    fn dim(&self, index: usize) -> i64 {
        match self.version {
            Version::One => i16::from_le_bytes(self.number(40 + 2 * index)).into(),
            Version::Two => i64::from_le_bytes(self.number(16 + 8 * index)),
        }
    }

    /// Voxels along x, y, z; axes that the file doesn't have count 1.
    pub fn dims(&self) -> Result<[u32; 3], VolumeError> {
        let axes = self.dim(0);
        if !(1..=7).contains(&axes) {
            return Err(self.error("dim[0]", axes.to_string(), "1 to 7 axes"));
        }
        let mut dims = [1; 3];
        for (index, dim) in (1..=axes as usize).zip(&mut dims) {
            let size = self.dim(index);
            *dim = u32::try_from(size)
                .ok()
                .filter(|&size| size > 0)
                .ok_or_else(|| {
                    self.error(
                        format!("dim[{index}]"),
                        size.to_string(),
                        "1 to 4294967295 voxels",
                    )
                })?;
        }
        Ok(dims)
    }

    /// How many volumes the file holds.
    pub fn volume_count(&self) -> u64 {
        let axes = self.dim(0).clamp(0, 7) as usize;
        (4..=axes)
            .map(|index| self.dim(index).max(1) as u64)
            .fold(1, u64::saturating_mul)
    }

    pub fn datatype(&self) -> i16 {
        i16::from_le_bytes(self.number(match self.version {
            Version::One => 70,
            Version::Two => 12,
        }))
    }

    /// Where the voxels begin. Extensions lie between the header and there.
    pub fn voxel_offset(&self) -> Result<u64, VolumeError> {
        let offset = match self.version {
            Version::One => f64::from(f32::from_le_bytes(self.number(108))),
            Version::Two => i64::from_le_bytes(self.number(168)) as f64,
        };
        // Writers leave 0 for "right after the header".
        let first = match self.storage {
            Storage::Single => self.version.first_offset(),
            _ => 0,
        };
        if offset.is_nan() || offset < 0.0 || offset > i64::MAX as f64 {
            return Err(self.error(
                "vox_offset",
                offset.to_string(),
                &format!("{first} or more, within the file"),
            ));
        }
        Ok((offset as u64).max(first))
    }

    /// `scl_slope` and `scl_inter`; a slope of 0 or NaN means that values aren't scaled.
    pub fn scaling(&self, notices: &mut Vec<String>) -> (f64, f64) {
        if self.storage == Storage::Analyze {
            return (1.0, 0.0);
        }
        let slope = self.float(112, 176, 0);
        let intercept = self.float(116, 184, 0);
        if slope == 0.0 || slope.is_nan() {
            return (1.0, 0.0);
        }
        if slope.is_infinite() || intercept.is_infinite() {
            notices.push(format!(
                "scl_slope {slope} and scl_inter {intercept} are not finite: values are not scaled"
            ));
            return (1.0, 0.0);
        }
        (slope, if intercept.is_nan() { 0.0 } else { intercept })
    }

    /// `cal_min` and `cal_max`, if they are set.
    pub fn window(&self) -> Option<[f64; 2]> {
        let [high, low] = [self.float(124, 192, 0), self.float(128, 200, 0)];
        (low < high && low.is_finite() && high.is_finite()).then_some([low, high])
    }

    fn metres_per_unit(&self, notices: &mut Vec<String>) -> f64 {
        let units = match self.version {
            Version::One => i32::from(self.array::<1>(123)[0]),
            Version::Two => i32::from_le_bytes(self.number(500)),
        };
        match units & 7 {
            1 => 1.0,
            0 | 2 => METRES_PER_MM,
            3 => 1e-6,
            code => {
                notices.push(format!(
                    "xyzt_units has the unknown length unit {code}: taken as mm"
                ));
                METRES_PER_MM
            }
        }
    }

    /// Whether the values are labels (`NIFTI_INTENT_LABEL`).
    pub fn is_labels(&self) -> bool {
        const LABEL: i32 = 1002;
        self.storage != Storage::Analyze && self.code(68, 504) == LABEL
    }

    /// Spacing and orientation, by the best of the header's three ways of saying it.
    pub fn geometry(&self, notices: &mut Vec<String>) -> Geometry {
        let metres = self.metres_per_unit(notices);
        let mut pixdim_notices = Vec::new();
        let spacing = checked_spacing(
            self.float3(76, 104, 1).to_array(),
            metres,
            "pixdim",
            &mut pixdim_notices,
        );
        if self.storage == Storage::Analyze {
            // What follows the sizes there are other things.
            notices.append(&mut pixdim_notices);
            notices.push(
                "an Analyze 7.5 header does not tell left from right: orientation is not known"
                    .into(),
            );
            return Geometry::from_spacing(spacing);
        }
        let mut sound = |name: &str, geometry: Option<Geometry>| sound(name, geometry, notices);
        let sform = sound("s-form", self.sform(metres));
        let qform = sound("q-form", self.qform(spacing));
        if let (Some(sform), Some(qform)) = (&sform, &qform)
            && sform.metres_from_index.determinant() * qform.metres_from_index.determinant() < 0.0
        {
            notices
                .push("s-form and q-form disagree about left and right: the s-form holds".into());
        }
        match (sform, qform) {
            (Some(sform), _) => sform,
            (None, Some(qform)) => {
                notices.append(&mut pixdim_notices);
                qform
            }
            (None, None) => {
                notices.append(&mut pixdim_notices);
                Geometry::from_spacing(spacing)
            }
        }
    }

    fn sform(&self, metres: f64) -> Option<Geometry> {
        (self.code(254, 348) > 0).then(|| {
            let row = |axis: usize| (280 + 16 * axis, 400 + 32 * axis);
            let rows = [0, 1, 2].map(|axis| {
                let (one, two) = row(axis);
                self.float3(one, two, 0)
            });
            let origin = [0, 1, 2].map(|axis| {
                let (one, two) = row(axis);
                self.float(one, two, 3)
            });
            let directions = DMat3::from_cols(rows[0], rows[1], rows[2]).transpose();
            Geometry::from_ras(
                directions * metres,
                checked_origin(DVec3::from_array(origin) * metres),
            )
        })
    }

    fn qform(&self, spacing: [f64; 3]) -> Option<Geometry> {
        (self.code(252, 344) > 0).then(|| {
            let bcd = self.float3(256, 352, 0);
            // Rounding may have made them a little longer than a unit quaternion allows.
            let a = (1.0 - bcd.length_squared()).max(0.0).sqrt();
            let quaternion = DQuat::from_xyzw(bcd.x, bcd.y, bcd.z, a).normalize();
            let handedness = if self.float(76, 104, 0) < 0.0 {
                -1.0
            } else {
                1.0
            };
            let steps = DVec3::from_array(spacing) * DVec3::new(1.0, 1.0, handedness);
            let metres = self.metres_per_unit(&mut Vec::new());
            Geometry::from_ras(
                DMat3::from_quat(quaternion) * DMat3::from_diagonal(steps),
                checked_origin(self.float3(268, 376, 0) * metres),
            )
        })
    }
}

/// A geometry whose directions are fit for use; says why one isn't.
fn sound(name: &str, geometry: Option<Geometry>, notices: &mut Vec<String>) -> Option<Geometry> {
    let geometry = geometry?;
    match check_directions(&geometry.metres_from_index) {
        Ok(()) => Some(geometry),
        Err(problem) => {
            notices.push(format!(
                "the {name}'s directions are {problem}: it is ignored"
            ));
            None
        }
    }
}
