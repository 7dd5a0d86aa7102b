//! From frames to a stack: their order, the gaps between them, and their place in the world.

use glam::{DMat3, DVec3};

use super::header::Frame;
use crate::Geometry;
use crate::reader::placement::{METRES_PER_MM, check_directions, checked_origin, checked_spacing};

/// Steps that differ by less than this part of a step, or this many mm, are even.
const EVEN: f64 = 0.01;
const EVEN_MM: f64 = 2e-3;

/// Steps that are off a multiple of the others by less than this part are gaps in an even stack.
const MULTIPLE: f64 = 0.05;

/// More slices than this are not missing, they never were.
const GAP_MAX: f64 = 1000.0;

/// Shear is told from this angle on, degrees.
const TILT_TOLD: f64 = 0.1;

/// A frame, by the number of its image in the list and its number there.
#[derive(Clone, Debug)]
pub(super) struct Slice {
    pub image: usize,
    pub frame: Frame,
}

/// Slices in order, and where they are.
#[derive(Clone, Debug)]
pub(super) struct Stack {
    pub slices: Vec<Slice>,
    pub geometry: Geometry,
    pub notices: Vec<String>,
    /// Before slice .0 lack .1 slices.
    pub gaps: Vec<(usize, usize)>,
}

impl Stack {
    /// Splits frames of one kind into stacks: several where frames share their places.
    pub fn split(slices: Vec<Slice>) -> Vec<Self> {
        let positions: Option<Vec<f64>> = slices.iter().map(|s| along_normal(&s.frame)).collect();
        let Some(positions) = positions else {
            return vec![Self::unplaced(slices)];
        };
        let mut order: Vec<(f64, Slice)> = positions.into_iter().zip(slices).collect();
        order.sort_by(|(a, x), (b, y)| a.total_cmp(b).then_with(|| by_number(x, y)));

        // Frames at the same place follow each other now.
        let mut places: Vec<Vec<(f64, Slice)>> = Vec::new();
        for (position, slice) in order {
            match places.last_mut() {
                Some(place)
                    if place
                        .first()
                        .is_some_and(|(first, _)| (position - first).abs() < EVEN_MM / 2.0) =>
                {
                    place.push((position, slice));
                }
                _ => places.push(vec![(position, slice)]),
            }
        }
        let most = places.iter().map(Vec::len).max().unwrap_or(0);
        let is_even = places.iter().all(|place| place.len() == most);
        if most > 1 && is_even && places.len() > 1 {
            for place in &mut places {
                place.sort_by(|(_, x), (_, y)| by_number(x, y));
                place.reverse();
            }
            return (0..most)
                .map(|_| Self::placed(places.iter_mut().filter_map(Vec::pop).collect()))
                .collect();
        }
        if most > 1 && places.len() == 1 {
            // Many frames at one place: a film.
            return places
                .into_iter()
                .flatten()
                .map(|slice| Self::placed(vec![slice]))
                .collect();
        }
        let left_out: usize = places.iter().map(|place| place.len() - 1).sum();
        let firsts = places
            .into_iter()
            .filter_map(|place| place.into_iter().next());
        let mut stack = Self::placed(firsts.collect());
        if left_out > 0 {
            stack.notices.push(format!(
                "{left_out} slices lie where another one is and are left out"
            ));
        }
        vec![stack]
    }

    /// Without positions, the files' own numbers give the order.
    fn unplaced(mut slices: Vec<Slice>) -> Self {
        let by_location = slices.iter().all(|slice| slice.frame.location.is_some());
        slices.sort_by(|x, y| {
            let location = |slice: &Slice| slice.frame.location.unwrap_or(0.0);
            let order = if by_location {
                location(x).total_cmp(&location(y))
            } else {
                std::cmp::Ordering::Equal
            };
            order.then_with(|| by_number(x, y))
        });
        let mut notices = vec![format!(
            "no positions in space: slices are in the order of their {}, orientation is not known",
            if by_location { "locations" } else { "numbers" }
        )];
        let step = match slices.as_slice() {
            [first, .., last] if by_location => first
                .frame
                .location
                .zip(last.frame.location)
                .map(|(a, b)| (b - a).abs() / (slices.len() - 1) as f64),
            _ => None,
        };
        let lengths = match slices.first() {
            Some(slice) => lengths(&slice.frame, step.filter(|&step| step > 0.0)),
            None => [f64::NAN; 3],
        };
        let spacing = checked_spacing(lengths, METRES_PER_MM, "spacing", &mut notices);
        Self {
            slices,
            geometry: Geometry::from_spacing(spacing),
            notices,
            gaps: Vec::new(),
        }
    }

    /// Slices with their positions along the normal, mm, ascending.
    fn placed(order: Vec<(f64, Slice)>) -> Self {
        let mut notices = Vec::new();
        let (positions, slices): (Vec<f64>, Vec<Slice>) = order.into_iter().unzip();
        let gaps = gaps(&positions, &mut notices);
        let count = slices.len() + gaps.iter().map(|(_, missing)| missing).sum::<usize>();
        let geometry = geometry(&slices, slices.len(), &mut notices);
        debug_assert!(count >= slices.len());
        Self {
            slices,
            geometry,
            notices,
            gaps,
        }
    }

    /// Slices with those that are missing.
    pub fn filled_count(&self) -> usize {
        self.slices.len() + self.gaps.iter().map(|(_, missing)| missing).sum::<usize>()
    }

    /// Where the stack is when its gaps are filled.
    pub fn filled_geometry(&self) -> Geometry {
        geometry(&self.slices, self.filled_count(), &mut Vec::new())
    }
}

fn by_number(x: &Slice, y: &Slice) -> std::cmp::Ordering {
    let key = |slice: &Slice| (slice.frame.acquisition, slice.frame.instance);
    let ((a, i), (b, j)) = (key(x), key(y));
    a.total_cmp(&b)
        .then(i.total_cmp(&j))
        .then(x.frame.index.cmp(&y.frame.index))
        .then(x.image.cmp(&y.image))
}

/// Position along the slice's normal, mm.
fn along_normal(frame: &Frame) -> Option<f64> {
    let [row, column] = frame.axes?;
    let normal = row.cross(column);
    (normal.length_squared() > 0.5).then_some(())?;
    frame
        .position
        .map(|position| normal.normalize().dot(position))
}

/// Lengths of a voxel step, mm; NaN where unknown.
fn lengths(frame: &Frame, step: Option<f64>) -> [f64; 3] {
    let [x, y] = frame.spacing.unwrap_or([f64::NAN; 2]);
    // The distance between slices counts, not their thickness, but one slice has only that.
    let z = step
        .or(frame.between.map(f64::abs).filter(|&between| between > 0.0))
        .or(frame.thickness.filter(|&thickness| thickness > 0.0));
    [x, y, z.unwrap_or_else(|| x.min(y))]
}

/// Where slices are missing; says so, or what else is uneven.
fn gaps(positions: &[f64], notices: &mut Vec<String>) -> Vec<(usize, usize)> {
    let steps: Vec<f64> = positions
        .iter()
        .zip(positions.iter().skip(1))
        .map(|(a, b)| b - a)
        .collect();
    let mut sorted = steps.clone();
    sorted.sort_by(f64::total_cmp);
    let (Some(&smallest), Some(&median), Some(&largest)) =
        (sorted.first(), sorted.get(sorted.len() / 2), sorted.last())
    else {
        return Vec::new();
    };
    if largest - smallest <= (EVEN * median).max(EVEN_MM) {
        return Vec::new();
    }
    for base in [median, smallest] {
        let is_multiple = |step: &f64| {
            let times = step / base;
            times < GAP_MAX && times > 0.5 && (times - times.round()).abs() <= MULTIPLE
        };
        if steps.iter().all(is_multiple) {
            let gaps: Vec<(usize, usize)> = steps
                .iter()
                .enumerate()
                .map(|(index, step)| (index + 1, (step / base).round() as usize - 1))
                .filter(|(_, missing)| *missing > 0)
                .collect();
            if gaps.is_empty() {
                break;
            }
            let missing: usize = gaps.iter().map(|(_, missing)| missing).sum();
            let at = gaps.first().map_or(0, |(index, _)| *index);
            notices.push(format!(
                "{missing} slices are missing, the first after slice {at}"
            ));
            return gaps;
        }
    }
    notices.push(format!(
        "slices are unevenly spaced: {smallest:.3} to {largest:.3} mm"
    ));
    Vec::new()
}

/// Where slices are that are spread evenly over `count` places.
fn geometry(slices: &[Slice], count: usize, notices: &mut Vec<String>) -> Geometry {
    let (Some(first), Some(last)) = (slices.first(), slices.last()) else {
        return Geometry::from_spacing([METRES_PER_MM; 3]);
    };
    let [row, column] = first.frame.axes.unwrap_or([DVec3::X, DVec3::Y]);
    let normal = row.cross(column).normalize_or_zero();
    let origin = first.frame.position.unwrap_or(DVec3::ZERO);
    let span = last.frame.position.unwrap_or(origin) - origin;
    let step = (count > 1).then(|| span / (count - 1) as f64);
    let lengths = lengths(&first.frame, step.map(|step| step.dot(normal)));
    let [x, y, z] = checked_spacing(lengths, METRES_PER_MM, "spacing", notices);
    let step = match step {
        Some(step) => step * METRES_PER_MM,
        None => normal * z,
    };
    let directions = DMat3::from_cols(row * x, column * y, step);
    if let Err(problem) = check_directions(&directions) {
        notices.push(format!(
            "the slices' directions are {problem}: orientation is not known"
        ));
        return Geometry::from_spacing([x, y, z]);
    }
    tell_shape(slices, count, row, column, step, notices);
    let ras_from_lps = DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0));
    Geometry::from_ras(
        ras_from_lps * directions,
        checked_origin(ras_from_lps * origin * METRES_PER_MM),
    )
}

/// Says whether the stack is sheared, and how far slices are off their even places.
fn tell_shape(
    slices: &[Slice],
    count: usize,
    row: DVec3,
    column: DVec3,
    step: DVec3,
    notices: &mut Vec<String>,
) {
    let normal = row.cross(column).normalize_or_zero();
    let angle = step.angle_between(normal).to_degrees();
    if angle > TILT_TOLD {
        notices.push(format!(
            "slices are shifted against each other by {angle:.1}° (gantry tilt): kept as a shear"
        ));
    }
    let skew = row.angle_between(column).to_degrees();
    if (skew - 90.0).abs() > TILT_TOLD {
        notices.push(format!("rows and columns are at {skew:.1}° to each other"));
    }
    // Filled gaps put slices back in their places.
    if count > slices.len() {
        return;
    }
    let origin = slices.first().and_then(|slice| slice.frame.position);
    let off = slices
        .iter()
        .enumerate()
        .filter_map(|(index, slice)| {
            let even = origin? + step / METRES_PER_MM * index as f64;
            Some((slice.frame.position? - even).length())
        })
        .fold(0.0, f64::max);
    if off > EVEN * step.length() / METRES_PER_MM + EVEN_MM {
        notices.push(format!(
            "slices are spread evenly over their whole extent; some are {off:.3} mm off their place"
        ));
    }
}
