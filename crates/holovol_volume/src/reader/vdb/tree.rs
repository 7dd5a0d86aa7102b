//! A grid's tree: 32³ nodes of 16³ nodes of leaves of 8³ voxels, made dense.

use std::collections::HashSet;

use half::f16;

use super::grid::ValueType;
use super::stream::{COMPRESS_ACTIVE_MASK, Stream};
use crate::VolumeError;

/// Log₂ of the children along an axis, of the two inner levels, and of a leaf's voxels.
const UPPER: u32 = 5;
const LOWER: u32 = 4;
const LEAF: u32 = 3;

const LEAF_VOXELS: usize = 1 << (3 * LEAF);
const LEAF_MASK_BYTES: usize = LEAF_VOXELS / 8;

/// Indices beyond this could overflow when a node's size is added.
const INDEX_MAX: i32 = 1 << 30;

/// More root tiles or children than this are damage.
const ROOT_MAX: u32 = 1 << 26;

/// How a node's inactive values are stored: openvdb/io/Compression.h.
const NO_MASK_OR_INACTIVE_VALUES: u8 = 0;
const ONE_INACTIVE_VALUE: u8 = 2;
const MASK_NO_INACTIVE_VALUES: u8 = 3;
const MASK_ONE_INACTIVE_VALUE: u8 = 4;
const MASK_TWO_INACTIVE_VALUES: u8 = 5;
const ALL_VALUES: u8 = 6;

/// Indices from `low` to `high`, both inside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Bounds {
    pub low: [i32; 3],
    pub high: [i32; 3],
}

impl Bounds {
    const EMPTY: Self = Self {
        low: [i32::MAX; 3],
        high: [i32::MIN; 3],
    };

    fn add(&mut self, low: [i32; 3], high: [i32; 3]) {
        for axis in 0..3 {
            if let (Some(l), Some(h)) = (self.low.get_mut(axis), self.high.get_mut(axis)) {
                *l = (*l).min(low[axis]);
                *h = (*h).max(high[axis]);
            }
        }
    }

    /// Voxels along x, y, z; `None` if there is nothing inside.
    pub fn dims(&self) -> Option<[u32; 3]> {
        let mut dims = [0; 3];
        for (axis, dim) in dims.iter_mut().enumerate() {
            let size = i64::from(self.high[axis]) - i64::from(self.low[axis]) + 1;
            *dim = u32::try_from(size).ok().filter(|&size| size > 0)?;
        }
        Some(dims)
    }
}

/// How a grid's values are stored.
#[derive(Clone, Copy, Debug)]
pub(super) struct Packing {
    pub values: ValueType,
    pub is_half: bool,
    pub compression: u32,
}

/// What the tree's topology tells.
pub(super) struct Topology {
    /// Of what is active.
    pub bounds: Bounds,
    pub background: f32,
    /// Origins, in the order in which their values are stored.
    pub leaves: Vec<[i32; 3]>,
    pub rounded: bool,
}

/// A box of voxels to be filled, x fastest.
pub(super) struct Dense<'a> {
    pub bounds: Bounds,
    pub dims: [u32; 3],
    pub voxels: &'a mut [f32],
}

impl Dense<'_> {
    /// Fills a cube; what lies outside is left out.
    fn fill(&mut self, origin: [i32; 3], size: i32, value: f32) {
        let Bounds { low, high } = self.bounds;
        let from = |axis: usize| origin[axis].max(low[axis]);
        let to = |axis: usize| (origin[axis] + (size - 1)).min(high[axis]);
        if (0..3).any(|axis| from(axis) > to(axis)) {
            return;
        }
        for z in from(2)..=to(2) {
            for y in from(1)..=to(1) {
                let start = self.offset([from(0), y, z]);
                let length = (to(0) - from(0)) as usize + 1;
                if let Some(row) = self.voxels.get_mut(start..start + length) {
                    row.fill(value);
                }
            }
        }
    }

    fn offset(&self, index: [i32; 3]) -> usize {
        let [x, y, z]: [usize; 3] =
            std::array::from_fn(|axis| (index[axis] - self.bounds.low[axis]) as usize);
        let [nx, ny, _] = self.dims.map(|n| n as usize);
        x + nx * (y + ny * z)
    }

    /// Puts a leaf's values (z fastest) into their places.
    pub fn put_leaf(&mut self, origin: [i32; 3], values: &[f32]) {
        let Bounds { low, high } = self.bounds;
        for (number, &value) in values.iter().enumerate() {
            let index = child(origin, number, LEAF, 1);
            if (0..3).all(|axis| low[axis] <= index[axis] && index[axis] <= high[axis]) {
                let offset = self.offset(index);
                if let Some(voxel) = self.voxels.get_mut(offset) {
                    *voxel = value;
                }
            }
        }
    }
}

/// Origin of a node's child number `number` (z fastest), whose side is `size`.
fn child(origin: [i32; 3], number: usize, log: u32, size: i32) -> [i32; 3] {
    let part = |shift: u32| ((number >> shift) & ((1 << log) - 1)) as i32 * size;
    [
        origin[0] + part(2 * log),
        origin[1] + part(log),
        origin[2] + part(0),
    ]
}

fn is_on(mask: &[u8], number: usize) -> bool {
    mask.get(number / 8)
        .is_some_and(|byte| byte >> (number % 8) & 1 == 1)
}

fn count_on(mask: &[u8]) -> usize {
    mask.iter().map(|byte| byte.count_ones() as usize).sum()
}

/// Reads the topology; fills tiles into `dense` where that is given.
pub(super) fn read_topology(
    stream: &mut Stream<'_>,
    packing: Packing,
    dense: Option<&mut Dense<'_>>,
) -> Result<Topology, VolumeError> {
    let buffers = stream.u32()?;
    if buffers != 1 {
        return Err(stream.error("number of buffers", buffers.to_string(), "1"));
    }
    let mut walk = Walk {
        packing,
        dense,
        topology: Topology {
            bounds: Bounds::EMPTY,
            background: 0.0,
            leaves: Vec::new(),
            rounded: false,
        },
    };
    let background = walk.value(stream)?;
    walk.topology.background = background;
    let tiles = stream.u32()?;
    let children = stream.u32()?;
    if tiles > ROOT_MAX || children > ROOT_MAX {
        return Err(stream.error(
            "root node",
            format!("{tiles} tiles and {children} children"),
            format!("at most {ROOT_MAX}"),
        ));
    }
    // Each of them once: what overlaps could be filled for ever.
    let mut seen = HashSet::new();
    for _ in 0..tiles {
        let origin = root_origin(stream, &mut seen)?;
        let value = walk.value(stream)?;
        let active = stream.u8()? != 0;
        walk.tile(origin, 1 << (UPPER + LOWER + LEAF), value, active);
    }
    for _ in 0..children {
        let origin = root_origin(stream, &mut seen)?;
        walk.inner(stream, origin, UPPER)?;
    }
    Ok(walk.topology)
}

fn root_origin(
    stream: &mut Stream<'_>,
    seen: &mut HashSet<[i32; 3]>,
) -> Result<[i32; 3], VolumeError> {
    let origin = [stream.i32()?, stream.i32()?, stream.i32()?];
    let is_sound = |index: &i32| {
        (-INDEX_MAX..INDEX_MAX).contains(index) && index & ((1 << (UPPER + LOWER + LEAF)) - 1) == 0
    };
    if !origin.iter().all(is_sound) || !seen.insert(origin) {
        return Err(stream.error(
            "node origin",
            format!("{origin:?}"),
            format!("multiples of 4096 from −{INDEX_MAX} to {INDEX_MAX}, each once"),
        ));
    }
    Ok(origin)
}

struct Walk<'a, 'b> {
    packing: Packing,
    dense: Option<&'a mut Dense<'b>>,
    topology: Topology,
}

impl Walk<'_, '_> {
    /// A single value, which is never stored as half.
    fn value(&mut self, stream: &mut Stream<'_>) -> Result<f32, VolumeError> {
        let value = match self.packing.values {
            ValueType::F32 => return Ok(f32::from_le_bytes(stream.array()?)),
            ValueType::F64 => stream.f64()?,
            ValueType::I32 => stream.i32()?.into(),
            ValueType::I64 => stream.i64()? as f64,
        };
        Ok(rounded(value, &mut self.topology.rounded))
    }

    fn tile(&mut self, origin: [i32; 3], size: i32, value: f32, active: bool) {
        if active {
            let high = origin.map(|low| low + (size - 1));
            self.topology.bounds.add(origin, high);
        }
        if let Some(dense) = &mut self.dense {
            dense.fill(origin, size, value);
        }
    }

    fn inner(
        &mut self,
        stream: &mut Stream<'_>,
        origin: [i32; 3],
        log: u32,
    ) -> Result<(), VolumeError> {
        let count = 1usize << (3 * log);
        let side = 1 << if log == UPPER { LOWER + LEAF } else { LEAF };
        let mut children = vec![0; count / 8];
        stream.fill(&mut children)?;
        let mut active = vec![0; count / 8];
        stream.fill(&mut active)?;
        let values = read_values(
            stream,
            self.packing,
            self.topology.background,
            &active,
            count,
            &mut self.topology.rounded,
        )?;
        let background = self.topology.background;
        for (number, &value) in values.iter().enumerate() {
            let is_active = is_on(&active, number);
            if !is_on(&children, number) && (is_active || value != background) {
                self.tile(child(origin, number, log, side), side, value, is_active);
            }
        }
        drop(values);
        for number in (0..count).filter(|&number| is_on(&children, number)) {
            let origin = child(origin, number, log, side);
            if log == UPPER {
                self.inner(stream, origin, LOWER)?;
            } else {
                let mask = stream.array::<LEAF_MASK_BYTES>()?;
                self.leaf(origin, &mask);
            }
        }
        Ok(())
    }

    fn leaf(&mut self, origin: [i32; 3], mask: &[u8]) {
        self.topology.leaves.push(origin);
        if mask.iter().all(|&byte| byte == 0xff) {
            let high = origin.map(|low| low + 7);
            self.topology.bounds.add(origin, high);
            return;
        }
        for number in (0..LEAF_VOXELS).filter(|&number| is_on(mask, number)) {
            let index = child(origin, number, LEAF, 1);
            self.topology.bounds.add(index, index);
        }
    }
}

/// A leaf's values, z fastest.
pub(super) fn read_leaf(
    stream: &mut Stream<'_>,
    packing: Packing,
    background: f32,
    rounding: &mut bool,
) -> Result<Vec<f32>, VolumeError> {
    let mask = stream.array::<LEAF_MASK_BYTES>()?;
    read_values(stream, packing, background, &mask, LEAF_VOXELS, rounding)
}

/// A node's values: the active ones packed, the inactive ones told by masks.
fn read_values(
    stream: &mut Stream<'_>,
    packing: Packing,
    background: f32,
    active: &[u8],
    count: usize,
    rounding: &mut bool,
) -> Result<Vec<f32>, VolumeError> {
    let how = stream.u8()?;
    if how > ALL_VALUES {
        return Err(stream.error("node compression", how.to_string(), "0 to 6"));
    }
    let mut one = |stream: &mut Stream<'_>| -> Result<f32, VolumeError> {
        let bytes = stream.vec_exact(packing.values.bytes())?;
        Ok(numbers(&bytes, packing.values, false, rounding)
            .first()
            .copied()
            .unwrap_or(0.0))
    };
    let mut off = if how == NO_MASK_OR_INACTIVE_VALUES {
        background
    } else {
        -background
    };
    let mut selected = background;
    if matches!(
        how,
        ONE_INACTIVE_VALUE | MASK_ONE_INACTIVE_VALUE | MASK_TWO_INACTIVE_VALUES
    ) {
        off = one(stream)?;
        if how == MASK_TWO_INACTIVE_VALUES {
            selected = one(stream)?;
        }
    }
    let mut selection = Vec::new();
    if (MASK_NO_INACTIVE_VALUES..=MASK_TWO_INACTIVE_VALUES).contains(&how) {
        selection = stream.vec_exact(count / 8)?;
    }
    let is_masked = packing.compression & COMPRESS_ACTIVE_MASK != 0 && how != ALL_VALUES;
    let stored = if is_masked { count_on(active) } else { count };
    let width = if packing.is_half {
        2
    } else {
        packing.values.bytes()
    };
    // Halves of nothing are not even announced.
    let bytes = if packing.is_half && stored == 0 {
        Vec::new()
    } else {
        stream.block(stored * width, packing.compression)?
    };
    let values = numbers(&bytes, packing.values, packing.is_half, rounding);
    if stored == count {
        return Ok(values);
    }
    let mut values = values.into_iter();
    Ok((0..count)
        .map(|number| {
            if is_on(active, number) {
                values.next().unwrap_or(background)
            } else if is_on(&selection, number) {
                selected
            } else {
                off
            }
        })
        .collect())
}

fn rounded(value: f64, rounding: &mut bool) -> f32 {
    let kept = value as f32;
    *rounding |= f64::from(kept) != value && value.is_finite();
    kept
}

fn numbers(bytes: &[u8], values: ValueType, is_half: bool, rounding: &mut bool) -> Vec<f32> {
    fn each<const N: usize>(bytes: &[u8], number: impl FnMut(&[u8; N]) -> f32) -> Vec<f32> {
        bytes.as_chunks().0.iter().map(number).collect()
    }
    if is_half {
        return each(bytes, |&b| f16::from_le_bytes(b).to_f32());
    }
    match values {
        ValueType::F32 => each(bytes, |&b| f32::from_le_bytes(b)),
        ValueType::F64 => each(bytes, |&b| rounded(f64::from_le_bytes(b), rounding)),
        ValueType::I32 => each(bytes, |&b| rounded(i32::from_le_bytes(b).into(), rounding)),
        ValueType::I64 => each(bytes, |&b| {
            let number = i64::from_le_bytes(b);
            let kept = number as f32;
            *rounding |= kept as i128 != i128::from(number);
            kept
        }),
    }
}
