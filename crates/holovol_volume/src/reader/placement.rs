use glam::{DMat3, DVec3};

/// Lengths without a unit are millimetres.
pub(super) const METRES_PER_MM: f64 = 1e-3;

/// Spacings beyond these (metres) are taken for damage: an atom, and half the way to the moon.
const SPACING_RANGE: std::ops::RangeInclusive<f64> = 1e-13..=2e8;

/// Columns count as linearly dependent if they span less than this part of a box of their lengths.
const SINGULAR_BELOW: f64 = 1e-4;

/// Directions that are fit to place voxels, or why not.
pub(super) fn check_directions(metres_from_index: &DMat3) -> Result<(), &'static str> {
    if !metres_from_index.is_finite() {
        return Err("not finite");
    }
    let lengths: [f64; 3] = std::array::from_fn(|axis| metres_from_index.col(axis).length());
    if lengths.contains(&0.0) {
        return Err("zero along an axis");
    }
    if !lengths.iter().all(|length| SPACING_RANGE.contains(length)) {
        return Err("of impossible size");
    }
    let unit = DMat3::from_cols(
        metres_from_index.x_axis / lengths[0],
        metres_from_index.y_axis / lengths[1],
        metres_from_index.z_axis / lengths[2],
    );
    if unit.determinant().abs() < SINGULAR_BELOW {
        return Err("not independent of each other");
    }
    Ok(())
}

/// Spacings in metres that are fit for use; says in `notices` which had to be replaced.
pub(super) fn checked_spacing(
    spacing: [f64; 3],
    metres_per_unit: f64,
    field: &str,
    notices: &mut Vec<String>,
) -> [f64; 3] {
    // A missing spacing is best taken from its neighbours.
    let usable = |length: f64| SPACING_RANGE.contains(&(length.abs() * metres_per_unit));
    let fallback = spacing
        .into_iter()
        .filter(|&length| usable(length))
        .map(f64::abs)
        .fold(f64::INFINITY, f64::min);
    let fallback = if fallback.is_finite() { fallback } else { 1.0 };
    std::array::from_fn(|axis| {
        let length = spacing[axis];
        if usable(length) {
            if length < 0.0 {
                notices.push(format!(
                    "{field} along axis {axis} is {length}: taken as {}",
                    -length
                ));
            }
            length.abs() * metres_per_unit
        } else {
            let found = if length.is_nan() {
                "not known".into()
            } else {
                length.to_string()
            };
            // As many digits as anybody measures.
            let taken: f64 = format!("{fallback:.6e}").parse().unwrap_or(fallback);
            notices.push(format!(
                "{field} along axis {axis} is {found}: taken as {taken}"
            ));
            fallback * metres_per_unit
        }
    })
}

/// An origin in metres; zero where the file's is not finite.
pub(super) fn checked_origin(metres: DVec3) -> DVec3 {
    if metres.is_finite() {
        metres
    } else {
        DVec3::ZERO
    }
}
