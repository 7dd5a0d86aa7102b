//! The dominant light of an environment, if it has one: a sun, a lamp, a window.

use glam::DVec3;
use holovol_light::EnvironmentMap;

/// Half the opening of the cone that its light comes from.
const CONE: f64 = 5.0 / 180.0 * std::f64::consts::PI;
/// Cells across and down that a map is summed up in, at most.
const CELLS: [usize; 2] = [256, 128];

/// Where most light of an environment comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Sun {
    /// Unit vector toward it, in the map's frame.
    pub(crate) direction: DVec3,
    /// Its share of the irradiance of a surface that faces it, 0 to 1.
    pub(crate) share: f64,
    /// Its part of all light, from everywhere, 0 to 1.
    pub(crate) part: f64,
}

impl Sun {
    /// The brightest place of a map, and what comes from around it. `None` for constant and black
    /// maps.
    pub(crate) fn find(map: &EnvironmentMap) -> Option<Self> {
        if map.as_constant().is_some() {
            return None;
        }
        let cells = cells(map);
        let brightest = cells
            .iter()
            .max_by(|a, b| a.radiance().total_cmp(&b.radiance()))?;
        let mut direction = brightest.flux.try_normalize()?;
        let near = |direction: DVec3| {
            let is_near =
                move |cell: &&Cell| cell.flux.dot(direction) > CONE.cos() * cell.flux.length();
            cells.iter().filter(is_near)
        };
        // A few steps bring the cone over the light's own centre.
        for _ in 0..4 {
            direction = near(direction)
                .map(|cell| cell.flux)
                .sum::<DVec3>()
                .try_normalize()?;
        }
        let facing = |cell: &Cell| cell.flux.dot(direction).max(0.0);
        let all: f64 = cells.iter().map(facing).sum();
        let share = near(direction).map(facing).sum::<f64>() / all;
        let flux =
            |cells: &mut dyn Iterator<Item = &Cell>| cells.map(|c| c.flux.length()).sum::<f64>();
        let part = flux(&mut near(direction)) / flux(&mut cells.iter());
        let found = Self {
            direction,
            share,
            part,
        };
        (share.is_finite() && part.is_finite()).then_some(found)
    }
}

/// A patch of the sphere.
#[derive(Clone, Copy, Default)]
struct Cell {
    /// Direction times flux.
    flux: DVec3,
    solid_angle: f64,
}

impl Cell {
    fn radiance(&self) -> f64 {
        self.flux.length() / self.solid_angle.max(f64::MIN_POSITIVE)
    }
}

fn cells(map: &EnvironmentMap) -> Vec<Cell> {
    let (width, height) = (map.width(), map.height());
    let [across, down] = [width.min(CELLS[0]), height.min(CELLS[1])];
    let mut cells = vec![Cell::default(); across * down];
    for (y, row) in map.texels().chunks_exact(width).enumerate() {
        let v = (y as f64 + 0.5) / height as f64;
        let (sin, cos) = (v * std::f64::consts::PI).sin_cos();
        let row_cells = &mut cells[y * down / height * across..][..across];
        for (x, texel) in row.iter().enumerate() {
            let (east, north) = longitude(x, width);
            let flux = sin * texel.iter().map(|&c| f64::from(c)).sum::<f64>();
            let cell = &mut row_cells[x * across / width];
            cell.flux += flux * DVec3::new(sin * east, cos, -sin * north);
            cell.solid_angle += sin;
        }
    }
    cells
}

/// Sine and cosine of a column's angle from −z to +x.
fn longitude(x: usize, width: usize) -> (f64, f64) {
    ((x as f64 + 0.5) / width as f64 * std::f64::consts::TAU - std::f64::consts::PI).sin_cos()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(sun: f32, [u, v]: [f64; 2]) -> EnvironmentMap {
        let towards = EnvironmentMap::direction_from_uv([u, v]);
        let texel = |i: usize| {
            let uv = [(i % 512) as f64 + 0.5, (i / 512) as f64 + 0.5];
            let direction = EnvironmentMap::direction_from_uv([uv[0] / 512.0, uv[1] / 256.0]);
            let is_sun = direction.dot(towards) > 1.5_f64.to_radians().cos();
            [if is_sun { sun } else { 1.0 }; 3]
        };
        EnvironmentMap::new(512, 256, (0..512 * 256).map(texel).collect())
    }

    #[test]
    fn a_sun_is_found_with_its_share_wherever_it_stands() {
        for uv in [[0.3, 0.4], [0.999, 0.2], [0.62, 0.02]] {
            let sun = Sun::find(&map(1000.0, uv)).expect("a sun");
            let expected = EnvironmentMap::direction_from_uv(uv);
            let angle = sun.direction.angle_between(expected).to_degrees();
            assert!(angle < 0.7, "{angle} degrees at {uv:?}");
            // 1000 · 0.0022 sr of it, and π from around.
            assert!((0.36..0.45).contains(&sun.share), "{}", sun.share);
            // And 4π from everywhere.
            assert!((0.13..0.17).contains(&sun.part), "{}", sun.part);
        }
    }

    #[test]
    fn an_even_sky_has_no_dominant_light() {
        let sky = Sun::find(&map(1.2, [0.3, 0.4])).expect("a direction");
        assert!(sky.share < 0.02, "{}", sky.share);
        assert_eq!(Sun::find(&EnvironmentMap::constant([1.0; 3])), None);
    }
}
