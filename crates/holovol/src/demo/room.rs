//! The light of a living room: a window on the left, a curtained one behind the viewer, lamps,
//! warm walls.

use glam::{DVec3, dvec3};
use holovol_light::EnvironmentMap;
use rayon::prelude::*;

const WIDTH: usize = 1024;
const HEIGHT: usize = 512;
/// Rays per texel and axis.
const OVERSAMPLING: usize = 2;

/// Corners of the room in metres, seen from its middle; the floor is at eye height below.
const LOW: DVec3 = dvec3(-2.6, -1.3, -3.4);
const HIGH: DVec3 = dvec3(2.4, 1.3, 2.8);

/// Radiance of the lamps' shades and of the sky through the window.
const LAMP: DVec3 = dvec3(56.0, 40.0, 25.0);
const SKY_HIGH: DVec3 = dvec3(9.0, 13.0, 19.0);
const SKY_LOW: DVec3 = dvec3(17.0, 16.0, 14.0);

/// A latitude–longitude map of the room.
pub(super) fn environment() -> EnvironmentMap {
    let texels = (0..WIDTH * HEIGHT)
        .into_par_iter()
        .map(|index| {
            let mut sum = DVec3::ZERO;
            for sample in 0..OVERSAMPLING * OVERSAMPLING {
                let offset = |i: usize| (i as f64 + 0.5) / OVERSAMPLING as f64;
                let u = (index % WIDTH) as f64 + offset(sample % OVERSAMPLING);
                let v = (index / WIDTH) as f64 + offset(sample / OVERSAMPLING);
                let uv = [u / WIDTH as f64, v / HEIGHT as f64];
                sum += radiance(EnvironmentMap::direction_from_uv(uv));
            }
            let mean = sum / (OVERSAMPLING * OVERSAMPLING) as f64;
            mean.to_array().map(|c| c as f32)
        })
        .collect();
    EnvironmentMap::new(WIDTH, HEIGHT, texels)
}

/// What is seen from the middle of the room.
fn radiance(direction: DVec3) -> DVec3 {
    if let Some(lamp) = lamps(direction) {
        return lamp;
    }
    // The wall that the ray meets first.
    let corner = DVec3::select(direction.cmpgt(DVec3::ZERO), HIGH, LOW);
    let distances = (corner / direction).to_array();
    let axis = (0..3)
        .min_by(|&a, &b| distances[a].total_cmp(&distances[b]))
        .unwrap_or(0);
    let p = direction * distances[axis];
    match (axis, direction[axis] > 0.0) {
        (1, true) => dvec3(0.93, 0.9, 0.85) * shade(p, DVec3::NEG_Y),
        (1, false) => floor(p) * shade(p, DVec3::Y),
        (0, false) => window_wall(p),
        (0, true) => bookshelf(p) * shade(p, DVec3::NEG_X),
        (_, false) => far_wall(p) * shade(p, DVec3::Z),
        _ => curtained_wall(p),
    }
}

/// Shades of lamps that stand before the walls: spheres, the radiance a little less at the rim.
fn lamps(direction: DVec3) -> Option<DVec3> {
    const LAMPS: [(DVec3, f64); 3] = [
        (dvec3(1.75, 0.55, -1.6), 0.17),
        (dvec3(-1.9, 0.2, 2.0), 0.15),
        (dvec3(0.5, 1.02, 0.9), 0.13),
    ];
    let mut hits = LAMPS.iter().filter_map(|&(centre, radius)| {
        let along = direction.dot(centre);
        let aside = (centre - direction * along).length() / radius;
        (along > 0.0 && aside < 1.0).then(|| LAMP * (0.55 + 0.45 * (1.0 - aside * aside)))
    });
    hits.next()
}

/// Light on a surface from window, lamps and the rest of the room, with darker corners.
fn shade(p: DVec3, normal: DVec3) -> DVec3 {
    let window = dvec3(LOW.x, 0.2, -0.3);
    let mut light = dvec3(0.17, 0.15, 0.13);
    let mut add = |source: DVec3, power: DVec3| {
        let to = source - p;
        let square = to.length_squared().max(0.05);
        let cosine = (normal.dot(to) / square.sqrt()).max(0.0);
        // Half of the light has met a wall before.
        light += power * (0.25 + 0.75 * cosine) / (square + 0.3);
    };
    add(window, dvec3(1.5, 1.7, 2.0));
    add(dvec3(0.3, 0.1, HIGH.z), dvec3(1.1, 1.1, 1.15));
    add(dvec3(1.75, 0.55, -1.6), dvec3(0.75, 0.48, 0.25));
    add(dvec3(-1.9, 0.2, 2.0), dvec3(0.6, 0.38, 0.2));
    add(dvec3(0.5, 1.02, 0.9), dvec3(0.45, 0.29, 0.15));
    let depth = (p - LOW).min(HIGH - p).max(DVec3::ZERO).to_array();
    let corner: f64 = depth
        .into_iter()
        .enumerate()
        .filter(|&(axis, _)| normal[axis] == 0.0)
        .map(|(_, d)| 1.0 - 0.35 * (-d / 0.22).exp())
        .product();
    light * corner
}

/// Boards with a rug.
fn floor(p: DVec3) -> DVec3 {
    let rug = (p.x * p.x / 1.7 + (p.z + 0.4) * (p.z + 0.4) / 1.1).sqrt();
    if rug < 1.0 {
        let ring = if (0.82..0.9).contains(&rug) {
            0.55
        } else {
            1.0
        };
        return dvec3(0.42, 0.12, 0.1) * ring;
    }
    let board = (p.x / 0.16).floor();
    let tone = 0.85 + 0.15 * ((board * 12.9898).sin() * 43758.5453).fract().abs();
    let gap = if (p.x / 0.16).fract().abs() < 0.04 {
        0.5
    } else {
        1.0
    };
    dvec3(0.42, 0.26, 0.15) * tone * gap
}

/// The wall at −x: two casements with a cross, the sky behind, curtains beside.
fn window_wall(p: DVec3) -> DVec3 {
    let (z, y) = (p.z + 0.3, p.y);
    let inside = z.abs() < 1.0 && (-0.5..0.95).contains(&y);
    let bar = z.abs() < 0.035 || (z.abs() - 0.97).abs() < 0.035 || (y - 0.45).abs() < 0.03;
    if inside && !bar {
        let height = (y + 0.5) / 1.45;
        // Roofs and trees at the bottom.
        let skyline = 0.16 + 0.05 * (z * 9.0).sin() + 0.04 * (z * 23.0 + 1.0).sin();
        if height < skyline {
            return dvec3(0.5, 0.55, 0.5);
        }
        return SKY_LOW.lerp(SKY_HIGH, height);
    }
    let light = shade(p, DVec3::X);
    if inside {
        return dvec3(0.8, 0.78, 0.74) * light;
    }
    let curtain = (1.0..1.38).contains(&z.abs()) && (-1.1..1.12).contains(&y);
    if curtain {
        let fold = 0.75 + 0.25 * (z * 62.0).sin();
        return dvec3(0.45, 0.13, 0.1) * fold * light;
    }
    dvec3(0.66, 0.54, 0.42) * light
}

/// The wall at +z, behind the viewer: daylight through a white curtain.
fn curtained_wall(p: DVec3) -> DVec3 {
    let is_curtain = (-0.9..1.5).contains(&p.x) && (-0.9..1.1).contains(&p.y);
    if is_curtain {
        let fold = 0.8 + 0.2 * (p.x * 31.0 + 1.5 * (p.x * 5.0).sin()).sin();
        return dvec3(4.6, 4.7, 4.9) * fold * (0.8 + 0.2 * p.y);
    }
    dvec3(0.62, 0.54, 0.46) * shade(p, DVec3::NEG_Z)
}

/// The wall at +x: shelves of books.
fn bookshelf(p: DVec3) -> DVec3 {
    let wall = dvec3(0.62, 0.5, 0.4);
    if !(-2.2..0.9).contains(&p.z) || p.y > 0.9 {
        return wall;
    }
    let row = ((p.y + 1.3) / 0.36).floor();
    let height = ((p.y + 1.3) / 0.36).fract();
    if height < 0.08 {
        return dvec3(0.3, 0.19, 0.11);
    }
    let place = p.z / 0.055 + row * 3.7;
    let random = |k: f64| {
        ((place.floor() * 78.233 + row * 37.719 + k).sin() * 43758.5453)
            .fract()
            .abs()
    };
    if height > 0.66 + 0.28 * random(1.0) {
        return dvec3(0.07, 0.05, 0.04);
    }
    let hue = random(2.0);
    let back = match hue {
        h if h < 0.3 => dvec3(0.4, 0.1, 0.08),
        h if h < 0.5 => dvec3(0.1, 0.2, 0.32),
        h if h < 0.7 => dvec3(0.13, 0.26, 0.16),
        h if h < 0.85 => dvec3(0.62, 0.53, 0.36),
        _ => dvec3(0.2, 0.16, 0.14),
    };
    let edge = if place.fract().abs() < 0.1 { 0.5 } else { 1.0 };
    back * edge * (0.7 + 0.3 * random(3.0))
}

/// The wall at −z, behind the volume: panelling below, two framed pictures.
fn far_wall(p: DVec3) -> DVec3 {
    for (x, y, w, h, tint) in [
        (-1.15, 0.32, 0.42, 0.3, dvec3(0.2, 0.3, 0.38)),
        (0.75, 0.36, 0.26, 0.36, dvec3(0.5, 0.38, 0.2)),
    ] {
        let (dx, dy): (f64, f64) = ((p.x - x).abs() / w, (p.y - y).abs() / h);
        if dx < 1.0 && dy < 1.0 {
            let horizon = 0.5 + 0.5 * ((p.y - y) / h + 0.25 * (p.x * 7.0).sin()).tanh();
            return tint * (0.5 + horizon);
        }
        if dx < 1.0 + 0.05 / w && dy < 1.0 + 0.05 / h {
            return dvec3(0.34, 0.24, 0.12);
        }
    }
    if p.y < -0.45 {
        let panel = ((p.x / 0.6).fract().abs() - 0.5).abs();
        let groove = if panel > 0.46 { 0.7 } else { 1.0 };
        return dvec3(0.5, 0.42, 0.33) * groove;
    }
    dvec3(0.34, 0.4, 0.36)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_window_lights_from_the_left_and_lamps_are_brightest() {
        let map = environment();
        let mean = |x: f64| {
            let directions = (0..400).map(|i| {
                let (sin, cos) = (f64::from(i) * 2.4).sin_cos();
                dvec3(x, 0.3 * sin, 0.3 * cos)
            });
            directions.map(|d| map.radiance(d)[1]).sum::<f64>() / 400.0
        };
        assert!(mean(-1.0) > 3.0 * mean(1.0), "{} {}", mean(-1.0), mean(1.0));
        let peak = map.texels().iter().flatten().fold(0.0f32, |a, &b| a.max(b));
        assert!((50.0..60.0).contains(&peak), "{peak}");
        assert_eq!(map.replaced(), 0);
        assert!(map.texels().iter().flatten().all(|&c| c > 0.0));
    }
}
