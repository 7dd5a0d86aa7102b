use std::sync::Arc;

use glam::{DMat4, DVec3};
use rayon::prelude::*;

use crate::{Geometry, VolumeError};

/// The stored numbers of a volume, in the type that holds the file's values exactly.
///
/// x varies fastest: voxel (i, j, k) is at `i + dims[0] * (j + dims[1] * k)`.
#[derive(Clone, Debug, PartialEq)]
pub enum Voxels {
    /// Unsigned 8-bit.
    U8(Vec<u8>),
    /// Signed 8-bit.
    I8(Vec<i8>),
    /// Unsigned 16-bit.
    U16(Vec<u16>),
    /// Signed 16-bit.
    I16(Vec<i16>),
    /// 32-bit float; also what wider types are read into, with a notice if that loses digits.
    F32(Vec<f32>),
}

/// The type of the stored numbers, see [`Voxels`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum VoxelKind {
    /// Unsigned 8-bit.
    U8,
    /// Signed 8-bit.
    I8,
    /// Unsigned 16-bit.
    U16,
    /// Signed 16-bit.
    I16,
    /// 32-bit float.
    F32,
}

impl VoxelKind {
    /// Size of one voxel in bytes.
    pub fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::F32 => 4,
        }
    }

    /// The name that Rust, NumPy and NRRD users know: `u8`, `i8`, `u16`, `i16` or `f32`.
    pub fn name(self) -> &'static str {
        match self {
            Self::U8 => "u8",
            Self::I8 => "i8",
            Self::U16 => "u16",
            Self::I16 => "i16",
            Self::F32 => "f32",
        }
    }
}

impl Voxels {
    /// The type of the numbers.
    pub fn kind(&self) -> VoxelKind {
        match self {
            Self::U8(_) => VoxelKind::U8,
            Self::I8(_) => VoxelKind::I8,
            Self::U16(_) => VoxelKind::U16,
            Self::I16(_) => VoxelKind::I16,
            Self::F32(_) => VoxelKind::F32,
        }
    }

    /// How many voxels there are.
    pub fn len(&self) -> usize {
        match self {
            Self::U8(v) => v.len(),
            Self::I8(v) => v.len(),
            Self::U16(v) => v.len(),
            Self::I16(v) => v.len(),
            Self::F32(v) => v.len(),
        }
    }

    /// Whether there are no voxels at all.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The stored number at a linear index; panics past the end.
    #[inline]
    pub fn stored(&self, index: usize) -> f64 {
        match self {
            Self::U8(v) => f64::from(v[index]),
            Self::I8(v) => f64::from(v[index]),
            Self::U16(v) => f64::from(v[index]),
            Self::I16(v) => f64::from(v[index]),
            Self::F32(v) => f64::from(v[index]),
        }
    }
}

/// A scalar field on the unit cube, with the place that its file gives it in the world.
///
/// Voxel (i, j, k) has its centre at ((i+½)/N₀, (j+½)/N₁, (k+½)/N₂) of the unit cube; between
/// centres the field is trilinear, outside of them it is clamped. Values are
/// `slope · stored + intercept`, finite by construction: NaN becomes the minimum and infinities
/// the finite minimum or maximum when the volume is made. Cloning is cheap: voxels are shared.
///
/// Not to be confused with Bevy's `audio::Volume`, a loudness.
#[derive(Clone, Debug)]
pub struct Volume {
    voxels: Arc<Voxels>,
    dims: [u32; 3],
    slope: f64,
    intercept: f64,
    geometry: Geometry,
    stored_range: [f64; 2],
    replaced: ReplacedVoxels,
    header_windows: Vec<HeaderWindow>,
    source_format: Option<SourceFormat>,
    rounded: bool,
    labels: Option<Arc<Vec<Label>>>,
    unit: Option<String>,
    notices: Vec<String>,
}

/// What one value of a label volume stands for.
#[derive(Clone, Debug, PartialEq)]
pub struct Label {
    /// The value.
    pub value: f64,
    /// What it is called; may be empty.
    pub name: String,
    /// The colour that the file gives it, sRGB, 0 to 1.
    pub color: Option<[f32; 3]>,
}

/// A display window that a file's header asks for.
#[derive(Clone, Debug, PartialEq)]
pub struct HeaderWindow {
    /// The values that become black and white, in data units; the higher one first where the
    /// header wants low values bright.
    pub window: [f64; 2],
    /// What the header calls it (`LUNG`); may be empty.
    pub name: String,
}

/// What a volume's file was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SourceFormat {
    /// The format: `NIfTI-1`, `NRRD`, ….
    pub name: &'static str,
    /// The type of the numbers in the file, such as `f64`; [`Voxels`] may hold them in a smaller
    /// one.
    pub numbers: &'static str,
}

/// How many voxels were not finite and have been replaced.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReplacedVoxels {
    /// NaN, now the minimum.
    pub nan: u64,
    /// ±infinity, now the finite maximum or minimum.
    pub infinite: u64,
    /// What the file says was not measured, now the minimum.
    pub padding: u64,
}

impl Volume {
    /// Makes a volume of voxels as a file stores them, x fastest.
    ///
    /// # Errors
    /// If a dimension is 0, the number of voxels is not the product of `dims`, or `slope`,
    /// `intercept` or the range of the values is not finite.
    pub fn new(
        mut voxels: Voxels,
        dims: [u32; 3],
        slope: f64,
        intercept: f64,
        geometry: Geometry,
    ) -> Result<Self, VolumeError> {
        let expected = dims
            .iter()
            .try_fold(1usize, |product, &n| product.checked_mul(n as usize));
        if expected != Some(voxels.len()) || voxels.is_empty() {
            return Err(VolumeError::Dimensions {
                dims: dims.map(u64::from),
                voxels: voxels.len(),
            });
        }
        if !slope.is_finite() || slope == 0.0 || !intercept.is_finite() {
            return Err(VolumeError::Scaling { slope, intercept });
        }
        let (stored_range, replaced) = make_finite(&mut voxels, slope < 0.0);
        // Factors near the largest number there is take values beyond it.
        let [a, b] = stored_range.map(|stored| slope * stored + intercept);
        if !(b - a).is_finite() {
            return Err(VolumeError::Scaling { slope, intercept });
        }
        Ok(Self {
            voxels: Arc::new(voxels),
            dims,
            slope,
            intercept,
            geometry,
            stored_range,
            replaced,
            header_windows: Vec::new(),
            source_format: None,
            rounded: false,
            labels: None,
            unit: None,
            notices: Vec::new(),
        })
    }

    /// The same volume with the display window (lo, hi) that its header asks for, in data units.
    pub fn with_header_window(mut self, window: [f64; 2]) -> Self {
        self.header_windows.insert(
            0,
            HeaderWindow {
                window,
                name: String::new(),
            },
        );
        self
    }

    /// The same volume with all display windows of its header, the preferred one first.
    pub fn with_header_windows(mut self, windows: Vec<HeaderWindow>) -> Self {
        self.header_windows = windows;
        self
    }

    /// The same volume with word of so many voxels that its file calls padding; those that came as
    /// NaN are counted as nothing else.
    pub fn with_padding(mut self, padding: u64) -> Self {
        self.replaced.padding = padding;
        self.replaced.nan = self.replaced.nan.saturating_sub(padding);
        self
    }

    /// The same volume with the unit of its values, see [`Volume::unit`]. An empty one is none, and
    /// no more than 16 characters are kept.
    pub fn with_unit(mut self, unit: &str) -> Self {
        let unit: String = unit.chars().filter(|c| !c.is_control()).take(16).collect();
        self.unit = (!unit.trim().is_empty()).then(|| unit.trim().to_owned());
        self
    }

    /// The same volume with word of whether its voxels are rounded, see [`Volume::is_rounded`].
    pub fn with_rounded(mut self, rounded: bool) -> Self {
        self.rounded = rounded;
        self
    }

    /// The same volume as one of labels: its values are names, not amounts.
    pub fn with_labels(mut self, labels: Vec<Label>) -> Self {
        self.labels = Some(Arc::new(labels));
        self
    }

    /// The same volume with word of the file it comes from.
    pub fn with_source_format(mut self, source_format: SourceFormat) -> Self {
        self.source_format = Some(source_format);
        self
    }

    /// The same volume with a remark for its user, such as "4-D file: showing the first of 20".
    pub fn with_notice(mut self, notice: impl Into<String>) -> Self {
        self.notices.push(notice.into());
        self
    }

    /// The same volume at another place in the world.
    pub fn with_geometry(mut self, geometry: Geometry) -> Self {
        self.geometry = geometry;
        self
    }

    /// The stored numbers, before `slope` and `intercept`.
    pub fn voxels(&self) -> &Voxels {
        &self.voxels
    }

    /// Voxels along x, y, z (fastest first).
    pub fn dims(&self) -> [u32; 3] {
        self.dims
    }

    /// `value = slope · stored + intercept`.
    pub fn slope(&self) -> f64 {
        self.slope
    }

    /// `value = slope · stored + intercept`.
    pub fn intercept(&self) -> f64 {
        self.intercept
    }

    /// Spacing and orientation.
    pub fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// World metres from unit-cube coordinates, as the header says (see [`Geometry`]).
    pub fn world_from_unit_cube(&self) -> DMat4 {
        self.geometry.world_from_unit_cube(self.dims)
    }

    /// Smallest and largest stored number.
    pub fn stored_range(&self) -> [f64; 2] {
        self.stored_range
    }

    /// Smallest and largest value, in data units.
    pub fn range(&self) -> [f64; 2] {
        let [a, b] = self
            .stored_range
            .map(|stored| self.slope * stored + self.intercept);
        [a.min(b), a.max(b)]
    }

    /// Voxels that were NaN or infinite in the file.
    pub fn replaced(&self) -> ReplacedVoxels {
        self.replaced
    }

    /// The unit of the values as the file gives it, such as `HU`; `None` where it gives none.
    pub fn unit(&self) -> Option<&str> {
        self.unit.as_deref()
    }

    /// The display window that the file's header asks for, in data units.
    pub fn header_window(&self) -> Option<[f64; 2]> {
        self.header_windows.first().map(|first| first.window)
    }

    /// All display windows that the file's header asks for, the preferred one first.
    pub fn header_windows(&self) -> &[HeaderWindow] {
        &self.header_windows
    }

    /// Whether the voxels are not exactly the file's: 64-bit numbers kept as f32, slices with
    /// scalings of their own, or slices that were interpolated.
    pub fn is_rounded(&self) -> bool {
        self.rounded
    }

    /// What the values stand for, if the file says that they are labels; may be empty.
    pub fn labels(&self) -> Option<&[Label]> {
        self.labels.as_deref().map(Vec::as_slice)
    }

    /// The format and number type of the file, if the volume comes from one.
    pub fn source_format(&self) -> Option<SourceFormat> {
        self.source_format
    }

    /// Remarks for the user, from reading the file.
    pub fn notices(&self) -> &[String] {
        &self.notices
    }

    /// Value of voxel (i, j, k), in data units; indices past the border are clamped to it.
    #[inline]
    pub fn value(&self, index: [i64; 3]) -> f64 {
        let [x, y, z] = std::array::from_fn(|axis| {
            index[axis].clamp(0, i64::from(self.dims[axis]) - 1) as usize
        });
        let stored = self
            .voxels
            .stored(x + self.dims[0] as usize * (y + self.dims[1] as usize * z));
        self.slope * stored + self.intercept
    }

    /// The trilinear field at a point of the unit cube, in data units and f64; clamped outside.
    pub fn sample(&self, unit_cube: DVec3) -> f64 {
        let texel: [f64; 3] =
            std::array::from_fn(|axis| unit_cube[axis] * f64::from(self.dims[axis]) - 0.5);
        let base = texel.map(|t| t.floor() as i64);
        let weight: [f64; 3] = std::array::from_fn(|axis| texel[axis] - texel[axis].floor());
        let lerp = |a: f64, b: f64, t: f64| a + (b - a) * t;
        let along_x = |dy: i64, dz: i64| {
            lerp(
                self.value([base[0], base[1] + dy, base[2] + dz]),
                self.value([base[0] + 1, base[1] + dy, base[2] + dz]),
                weight[0],
            )
        };
        let along_y = |dz: i64| lerp(along_x(0, dz), along_x(1, dz), weight[1]);
        lerp(along_y(0), along_y(1), weight[2])
    }
}

/// Enough to keep a core busy for much longer than it takes to hand it out.
const RANGE_CHUNK: usize = 1 << 18;

/// Replaces NaN and infinities; returns the range of the finite numbers and what was replaced.
fn make_finite(voxels: &mut Voxels, minimum_is_largest: bool) -> ([f64; 2], ReplacedVoxels) {
    fn range_of<T: Copy + PartialOrd + Into<f64> + Sync + Send>(values: &[T]) -> [f64; 2] {
        let first = values[0];
        let (low, high) = values
            .par_chunks(RANGE_CHUNK)
            .map(|chunk| {
                let (mut low, mut high) = (first, first);
                for &value in chunk {
                    low = if value < low { value } else { low };
                    high = if value > high { value } else { high };
                }
                (low, high)
            })
            .reduce(
                || (first, first),
                |(a, b), (c, d)| (if c < a { c } else { a }, if d > b { d } else { b }),
            );
        [low.into(), high.into()]
    }
    let values = match voxels {
        Voxels::U8(v) => return (range_of(v), ReplacedVoxels::default()),
        Voxels::I8(v) => return (range_of(v), ReplacedVoxels::default()),
        Voxels::U16(v) => return (range_of(v), ReplacedVoxels::default()),
        Voxels::I16(v) => return (range_of(v), ReplacedVoxels::default()),
        Voxels::F32(v) => v,
    };
    let (mut low, mut high, replaced) = values
        .par_chunks(RANGE_CHUNK)
        .map(|chunk| {
            let mut replaced = ReplacedVoxels::default();
            let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
            for &value in chunk {
                if value.is_finite() {
                    low = low.min(value);
                    high = high.max(value);
                } else if value.is_nan() {
                    replaced.nan += 1;
                } else {
                    replaced.infinite += 1;
                }
            }
            (low, high, replaced)
        })
        .reduce(
            || (f32::INFINITY, f32::NEG_INFINITY, ReplacedVoxels::default()),
            |(a, b, r), (c, d, s)| {
                let replaced = ReplacedVoxels {
                    nan: r.nan + s.nan,
                    infinite: r.infinite + s.infinite,
                    padding: 0,
                };
                (a.min(c), b.max(d), replaced)
            },
        );
    if low > high {
        (low, high) = (0.0, 0.0);
    }
    if replaced != ReplacedVoxels::default() {
        let minimum = if minimum_is_largest { high } else { low };
        for value in values.iter_mut().filter(|value| !value.is_finite()) {
            *value = if value.is_nan() {
                minimum
            } else {
                value.clamp(low, high)
            };
        }
    }
    ([f64::from(low), f64::from(high)], replaced)
}
