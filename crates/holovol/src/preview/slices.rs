//! Cuts through a scan along the patient's axes, resampled.

use glam::{DMat4, DVec3};
use holovol_volume::Volume;
use rayon::prelude::*;

/// A cut, seen as radiologists look at it: from the patient's feet, from the front, from the left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Cut {
    Axial,
    Coronal,
    Sagittal,
}

/// World directions that a patient's sides lie in, and what they are called; without a patient
/// the axes themselves.
const LETTERS: [[&str; 2]; 3] = [["R", "L"], ["I", "S"], ["P", "A"]];
const AXES: [[&str; 2]; 3] = [["−x", "+x"], ["−y", "+y"], ["−z", "+z"]];

/// The name of a direction along a world axis.
pub(crate) fn direction_name(axis: usize, is_positive: bool, is_patient: bool) -> &'static str {
    let names = if is_patient { LETTERS } else { AXES };
    names[axis.min(2)][usize::from(is_positive)]
}

impl Cut {
    pub(crate) const ALL: [Self; 3] = [Self::Axial, Self::Coronal, Self::Sagittal];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Axial => "axial",
            Self::Coronal => "coronal",
            Self::Sagittal => "sagittal",
        }
    }

    /// World axis and sign of right and up in the image.
    fn sides(self) -> [(usize, f64); 2] {
        match self {
            // The patient's left is on the viewer's right.
            Self::Axial => [(0, 1.0), (2, 1.0)],
            Self::Coronal => [(0, 1.0), (1, 1.0)],
            // The patient looks to the left.
            Self::Sagittal => [(2, -1.0), (1, 1.0)],
        }
    }

    /// World axis across the cut.
    pub(crate) fn across(self) -> usize {
        match self {
            Self::Axial => 1,
            Self::Coronal => 2,
            Self::Sagittal => 0,
        }
    }

    /// What is at the image's left, right, bottom and top.
    pub(crate) fn letters(self, is_patient: bool) -> [&'static str; 4] {
        let [(a, sa), (b, sb)] = self.sides();
        [
            direction_name(a, sa < 0.0, is_patient),
            direction_name(a, sa > 0.0, is_patient),
            direction_name(b, sb < 0.0, is_patient),
            direction_name(b, sb > 0.0, is_patient),
        ]
    }
}

/// The box that all three cuts show, so that they have one scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Field {
    pub(crate) middle: DVec3,
    /// Half of the longest side, metres.
    pub(crate) half: f64,
}

impl Field {
    pub(crate) fn of(world_from_unit_cube: DMat4) -> Self {
        let corner = |i: usize| {
            let bit = |axis: usize| (i >> axis & 1) as f64;
            world_from_unit_cube.transform_point3(DVec3::new(bit(0), bit(1), bit(2)))
        };
        let low = (0..8).map(corner).reduce(DVec3::min).unwrap_or_default();
        let high = (0..8).map(corner).reduce(DVec3::max).unwrap_or_default();
        Self {
            middle: 0.5 * (low + high),
            half: 0.5 * (high - low).max_element().max(1e-12),
        }
    }

    /// Image position of a world point: 0 … 1 to the right and down.
    pub(crate) fn place(&self, cut: Cut, at: DVec3) -> [f64; 2] {
        let [right, up] = cut
            .sides()
            .map(|(axis, sign)| 0.5 + 0.5 * sign * (at[axis] - self.middle[axis]) / self.half);
        [right, 1.0 - up]
    }

    /// The world point at an image position; `through` is any point of the cut.
    pub(crate) fn point(&self, cut: Cut, through: DVec3, [x, y]: [f64; 2]) -> DVec3 {
        let mut at = through;
        for ((axis, sign), place) in cut.sides().into_iter().zip([x, 1.0 - y]) {
            at[axis] = self.middle[axis] + sign * self.half * (2.0 * place - 1.0);
        }
        at
    }
}

/// `size` × `size` grey values of the cut through a point, top row first; what is outside of the
/// scan is black. `grey` are the values that become black and white.
pub(crate) fn resample(
    volume: &Volume,
    world_from_unit_cube: DMat4,
    cut: Cut,
    through: DVec3,
    grey: [f64; 2],
    size: usize,
) -> Vec<u8> {
    let unit_from_world = world_from_unit_cube.inverse();
    let field = Field::of(world_from_unit_cube);
    let inside = 0.0..=1.0;
    (0..size * size)
        .into_par_iter()
        .map(|index| {
            let place = [index % size, index / size].map(|i| (i as f64 + 0.5) / size as f64);
            let unit = unit_from_world.transform_point3(field.point(cut, through, place));
            if !unit.to_array().iter().all(|u| inside.contains(u)) {
                return 0;
            }
            let level = (volume.sample(unit) - grey[0]) / (grey[1] - grey[0]);
            (255.0 * level.clamp(0.0, 1.0)).round() as u8
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use holovol_volume::{Geometry, Voxels};

    use super::*;

    /// A patient of 4 × 4 × 4 voxels with a bright one at the left, another at the front, and a
    /// third at the top.
    fn patient(axes: [usize; 3], signs: [f64; 3]) -> Volume {
        let mut columns = [DVec3::ZERO; 3];
        for i in 0..3 {
            columns[i][axes[i]] = 0.01 * signs[i];
        }
        let matrix = glam::DMat3::from_cols(columns[0], columns[1], columns[2]);
        let mut voxels = vec![0u8; 64];
        // RAS: left is −R, anterior +A, superior +S.
        for (value, direction) in [(100, DVec3::NEG_X), (150, DVec3::Y), (200, DVec3::Z)] {
            let mut index = [0usize; 3];
            for i in 0..3 {
                let towards = direction.dot(columns[i]);
                index[i] = match towards {
                    t if t > 0.0 => 3,
                    t if t < 0.0 => 0,
                    _ => 1,
                };
            }
            voxels[index[0] + 4 * (index[1] + 4 * index[2])] = value;
        }
        let geometry = Geometry::from_ras(matrix, DVec3::ZERO);
        Volume::new(Voxels::U8(voxels), [4; 3], 1.0, 0.0, geometry).unwrap()
    }

    /// The brightest pixel's position among 4 × 4 over all cuts, and its value.
    fn brightest(volume: &Volume, cut: Cut) -> Vec<(u8, [usize; 2])> {
        let matrix = volume.world_from_unit_cube();
        let mut found = Vec::new();
        for layer in 0..4 {
            let through = DVec3::splat(0.01 * (f64::from(layer) - 1.5));
            let image = resample(volume, matrix, cut, through, [0.0, 255.0], 4);
            let bright = image.iter().enumerate().filter(|(_, v)| **v > 0);
            found.extend(bright.map(|(i, v)| (*v, [i % 4, i / 4])));
        }
        found.sort_unstable();
        found
    }

    #[test]
    fn left_is_right_anterior_is_up_whatever_the_order_in_the_file() {
        for (axes, signs) in [
            ([0, 1, 2], [1.0, 1.0, 1.0]),
            ([0, 1, 2], [-1.0, -1.0, 1.0]),
            ([2, 0, 1], [-1.0, 1.0, -1.0]),
        ] {
            let volume = patient(axes, signs);
            let axial = brightest(&volume, Cut::Axial);
            let left = axial.iter().find(|(v, _)| *v == 100).unwrap();
            assert_eq!(left.1[0], 3, "left is at the right: {axial:?}");
            let front = axial.iter().find(|(v, _)| *v == 150).unwrap();
            assert_eq!(front.1[1], 0, "front is up: {axial:?}");
            let coronal = brightest(&volume, Cut::Coronal);
            let top = coronal.iter().find(|(v, _)| *v == 200).unwrap();
            assert_eq!(top.1[1], 0, "superior is up: {coronal:?}");
            let sagittal = brightest(&volume, Cut::Sagittal);
            let front = sagittal.iter().find(|(v, _)| *v == 150).unwrap();
            assert_eq!(front.1[0], 0, "the patient looks left: {sagittal:?}");
        }
        assert_eq!(Cut::Axial.letters(true), ["R", "L", "P", "A"]);
        assert_eq!(Cut::Coronal.letters(true), ["R", "L", "I", "S"]);
        assert_eq!(Cut::Sagittal.letters(true), ["A", "P", "I", "S"]);
    }

    #[test]
    fn places_and_points_are_inverse() {
        let field = Field {
            middle: DVec3::new(0.1, 0.2, 0.3),
            half: 0.5,
        };
        let at = DVec3::new(0.3, -0.1, 0.4);
        for cut in Cut::ALL {
            let place = field.place(cut, at);
            assert!(field.point(cut, at, place).distance(at) < 1e-12);
            let mut other = field.point(cut, at, [0.9, 0.1]) - at;
            other[cut.across()] += 1.0;
            assert_eq!(other[cut.across()], 1.0, "a click stays in the cut");
        }
    }
}
