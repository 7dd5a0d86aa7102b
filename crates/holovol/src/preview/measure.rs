//! What is under the cursor, how long things are.

use glam::{DMat4, DVec3, DVec4};
use holovol_volume::TransferFunction;

use super::look::Look;
use super::studio::Scan;

/// A half line in the world; the direction has length 1.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ray {
    pub(crate) origin: DVec3,
    pub(crate) direction: DVec3,
}

/// A place in a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Hit {
    /// World metres.
    pub(crate) at: DVec3,
    /// Data units.
    pub(crate) value: f64,
}

/// Steps along a ray at most.
const STEPS_MAX: f64 = 4096.0;

/// Where a ray's light is more likely scattered than not: the surface that is seen.
pub(crate) fn first_hit(scan: &Scan, look: &Look, ray: Ray) -> Option<Hit> {
    let matrix = scan.world_from_unit_cube();
    let unit_from_world = matrix.inverse();
    let function = TransferFunction::new(look.points_in_metres(scan.longest_edge())).ok()?;
    let planes = look.clip_planes(matrix);
    let [from, to] = part_inside(unit_from_world, &planes, ray)?;
    let volume = scan.volume();
    let finest = (0..3)
        .map(|axis| matrix.col(axis).truncate().length() / f64::from(volume.dims()[axis].max(1)))
        .fold(f64::INFINITY, f64::min);
    let step = (0.5 * finest).max((to - from) / STEPS_MAX);
    let [low, high] = look.window;
    let mut depth = 0.0;
    let mut t = from + 0.5 * step;
    while t < to {
        let at = ray.origin + ray.direction * t;
        let value = volume.sample(unit_from_world.transform_point3(at));
        depth += function.eval((value - low) / (high - low)).sigma_t * step;
        if depth > std::f64::consts::LN_2 {
            return Some(Hit { at, value });
        }
        t += step;
    }
    None
}

/// Distances between which a ray is in the unit cube and on the right side of all planes.
fn part_inside(unit_from_world: DMat4, planes: &[DVec4], ray: Ray) -> Option<[f64; 2]> {
    let origin = unit_from_world.transform_point3(ray.origin);
    let direction = unit_from_world.transform_vector3(ray.direction);
    let faces = (0..3).flat_map(|axis| {
        let (o, d) = (origin[axis], direction[axis]);
        [(o, d), (1.0 - o, -d)]
    });
    let cuts = planes.iter().map(|plane| {
        let normal = plane.truncate();
        (normal.dot(ray.origin) + plane.w, normal.dot(ray.direction))
    });
    // Inside of each is height + slope · t ≥ 0.
    let (mut from, mut to) = (0.0_f64, f64::INFINITY);
    for (height, slope) in faces.chain(cuts) {
        if slope > 0.0 {
            from = from.max(-height / slope);
        } else if slope < 0.0 {
            to = to.min(-height / slope);
        } else if height < 0.0 {
            return None;
        }
    }
    (from < to && to.is_finite()).then_some([from, to])
}

const UNITS: [(f64, &str); 5] = [
    (1e3, "km"),
    (1.0, "m"),
    (1e-3, "mm"),
    (1e-6, "µm"),
    (1e-9, "nm"),
];

/// A length in metres, in the unit that suits it: millimetres for anything in a body.
pub(crate) fn length_text(metres: f64) -> String {
    let fits = |&&(unit, name): &&(f64, &str)| match name {
        // 250 mm is what people measure with, not 0.25 m.
        "m" => metres >= 1.0,
        _ => metres >= 0.999 * unit,
    };
    let &(unit, name) = UNITS.iter().find(fits).unwrap_or(&UNITS[UNITS.len() - 1]);
    let number = metres / unit;
    let digits = match number {
        n if n >= 99.95 => 0,
        n if n >= 9.995 => 1,
        _ => 2,
    };
    format!("{number:.digits$} {name}")
}

/// The longest of 1, 2, 5, 10, … that is no longer than `most` metres, and its name.
pub(crate) fn scale_bar(most: f64) -> Option<(f64, String)> {
    if !(1e-9..1e12).contains(&most) {
        return None;
    }
    let decade = 10f64.powf(most.log10().floor());
    let length = [5.0, 2.0, 1.0]
        .map(|step| step * decade)
        .into_iter()
        .find(|&length| length <= most * 1.000_001)?;
    let (unit, name) = UNITS
        .into_iter()
        .find(|&(unit, _)| length >= 0.999 * unit)
        .unwrap_or((1e-9, "nm"));
    Some((length, format!("{:.0} {name}", length / unit)))
}

#[cfg(test)]
mod tests {
    use bevy_holovol::VolumeAsset;
    use holovol_volume::{Geometry, TransferPoint, Volume, Voxels};

    use super::super::look::Plane;
    use super::*;

    /// 10 cm wide; values rise from 0 to 9 along x.
    fn scan() -> Scan {
        let voxels = (0..1000).map(|i| (i % 10) as u8).collect();
        let geometry = Geometry::from_spacing([0.01; 3]);
        let volume = Volume::new(Voxels::U8(voxels), [10; 3], 1.0, 0.0, geometry).unwrap();
        Scan::new(VolumeAsset::new(volume))
    }

    /// Dense from the value 5 on.
    fn look() -> Look {
        let point = |s, sigma_t| TransferPoint {
            s,
            sigma_t,
            albedo: [0.5; 3],
            emission: [0.0; 3],
            roughness: 0.5,
            specular: 0.0,
        };
        Look {
            window: [0.0, 10.0],
            points: vec![point(0.5, 0.0), point(0.5, 1e6)],
            optical_depth_scale: None,
            ..Look::default()
        }
    }

    fn along_x(x: f64) -> Ray {
        Ray {
            origin: DVec3::new(x, 0.0, 0.0),
            direction: DVec3::X,
        }
    }

    #[test]
    fn the_surface_is_hit_where_it_is() {
        let hit = first_hit(&scan(), &look(), along_x(-1.0)).unwrap();
        // Voxel 5's centre is 5 mm to the right of the middle.
        assert!((hit.at.x - 0.005).abs() < 0.003, "{hit:?}");
        assert!((hit.value - 5.0).abs() < 0.4, "{hit:?}");
        let beside = Ray {
            origin: DVec3::new(-1.0, 0.06, 0.0),
            direction: DVec3::X,
        };
        assert_eq!(first_hit(&scan(), &look(), beside), None);
        let away = Ray {
            origin: DVec3::new(-1.0, 0.0, 0.0),
            direction: DVec3::NEG_X,
        };
        assert_eq!(first_hit(&scan(), &look(), away), None);
        let inside = first_hit(&scan(), &look(), along_x(0.02)).unwrap();
        assert!((inside.at.x - 0.02).abs() < 0.005);
    }

    #[test]
    fn what_is_cut_away_is_not_hit() {
        let mut look = look();
        look.planes.push(Plane {
            normal: DVec3::NEG_X,
            offset: -0.03,
            is_on: true,
        });
        let hit = first_hit(&scan(), &look, along_x(-1.0)).unwrap();
        assert!((hit.at.x - 0.03).abs() < 0.004, "{hit:?}");
        look.planes[0].is_on = false;
        look.crop.is_on = true;
        look.crop.set_side(0, true, 0.4);
        assert_eq!(first_hit(&scan(), &look, along_x(-1.0)), None);
    }

    #[test]
    fn lengths_have_fitting_units() {
        for (metres, text) in [
            (0.0234, "23.4 mm"),
            (0.25, "250 mm"),
            (1.5, "1.50 m"),
            (3e-6, "3.00 µm"),
            (0.0, "0.00 nm"),
            (12_000.0, "12.0 km"),
        ] {
            assert_eq!(length_text(metres), text);
        }
        assert_eq!(scale_bar(0.07), Some((0.05, "50 mm".into())));
        assert_eq!(scale_bar(0.1), Some((0.1, "100 mm".into())));
        assert_eq!(scale_bar(2.5e-6), Some((2e-6, "2 µm".into())));
        assert_eq!(scale_bar(f64::NAN), None);
    }
}
