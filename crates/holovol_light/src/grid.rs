//! Geometry of a latitude–longitude grid, computed once per size.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

/// Directions and solid angles of the texels of a latitude–longitude map.
///
/// The convention is that of [`EnvironmentMap`](crate::EnvironmentMap).
#[derive(Clone, Debug)]
pub struct Grid {
    width: usize,
    height: usize,
    /// Per row: sin θ, cos θ at the texel's centre.
    rows: Vec<[f32; 2]>,
    /// Per row: solid angle of a texel, sr.
    solid_angles: Vec<f32>,
    /// Per column: x/sin θ, z/sin θ of the direction.
    columns: Vec<[f32; 2]>,
}

impl Grid {
    /// The grid of a map of this size, both at least 1.
    pub fn new(width: usize, height: usize) -> Self {
        let row = |j: usize| (j as f64 + 0.5) / height as f64 * PI;
        let column = |i: usize| ((i as f64 + 0.5) / width as f64 - 0.5) * TAU;
        let edge = |j: usize| (j as f64 / height as f64 * PI).cos();
        Self {
            width,
            height,
            rows: (0..height)
                .map(|j| [row(j).sin() as f32, row(j).cos() as f32])
                .collect(),
            solid_angles: (0..height)
                .map(|j| (TAU / width as f64 * (edge(j) - edge(j + 1))) as f32)
                .collect(),
            columns: (0..width)
                .map(|i| [column(i).sin() as f32, -column(i).cos() as f32])
                .collect(),
        }
    }

    /// Texels across.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Texels down.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Number of texels.
    pub fn len(&self) -> usize {
        self.width * self.height
    }

    /// Never: a grid has a texel.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Solid angle of a texel of row `y`, sr; all texels together have 4π.
    #[inline]
    pub fn solid_angle(&self, y: usize) -> f32 {
        self.solid_angles[y]
    }

    /// sin θ and cos θ (the direction's y) at the centre of row `y`.
    #[inline]
    pub fn row(&self, y: usize) -> [f32; 2] {
        self.rows[y]
    }

    /// x and z of the direction of column `x` on the horizon.
    #[inline]
    pub fn column(&self, x: usize) -> [f32; 2] {
        self.columns[x]
    }

    /// Unit direction of a texel's centre.
    #[inline]
    pub fn direction(&self, x: usize, y: usize) -> [f32; 3] {
        let [sin, cos] = self.rows[y];
        let [dx, dz] = self.columns[x];
        [sin * dx, cos, sin * dz]
    }

    /// The texels whose centre may lie within `angle` (radians) of a direction, row by row:
    /// `visit(y, first column, columns)`, columns counted with wrap-around.
    pub fn visit_cap(
        &self,
        direction: DVec3,
        angle: f64,
        mut visit: impl FnMut(usize, i64, usize),
    ) {
        let theta = direction.y.clamp(-1.0, 1.0).acos();
        let phi = direction.x.atan2(-direction.z);
        let per_row = self.height as f64 / PI;
        let first = ((theta - angle) * per_row - 0.5).ceil().max(0.0) as usize;
        let last = ((theta + angle) * per_row - 0.5).floor();
        if last < 0.0 {
            return;
        }
        for y in first..=(last as usize).min(self.height - 1) {
            let row = (y as f64 + 0.5) / per_row;
            // Haversine: sin²(angle/2) = sin²(Δθ/2) + sin θ sin θ' sin²(Δφ/2).
            let rest = (0.5 * angle).sin().powi(2) - (0.5 * (row - theta)).sin().powi(2);
            let product = theta.sin() * row.sin();
            if rest < 0.0 {
                continue;
            }
            let half = if rest >= product {
                PI
            } else {
                2.0 * (rest / product).sqrt().asin()
            };
            let scale = self.width as f64 / TAU;
            if half >= PI {
                visit(y, 0, self.width);
                continue;
            }
            let start = ((phi + PI - half) * scale - 0.5).ceil() as i64;
            let end = ((phi + PI + half) * scale - 0.5).floor() as i64;
            let count = (end - start + 1).clamp(0, self.width as i64) as usize;
            if count > 0 {
                visit(y, start, count);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solid_angles_cover_the_sphere() {
        for (width, height) in [(1, 1), (2, 1), (64, 32), (7, 5)] {
            let grid = Grid::new(width, height);
            let sum: f32 = (0..height).map(|y| grid.solid_angle(y)).sum();
            let error = f64::from(sum) * width as f64 / (4.0 * PI) - 1.0;
            assert!(error.abs() < 1e-5, "{width} × {height}: {error}");
        }
    }

    #[test]
    fn directions_are_those_of_environment_maps() {
        let grid = Grid::new(16, 8);
        for (x, y) in [(0, 0), (3, 2), (8, 4), (15, 7)] {
            let uv = [(x as f64 + 0.5) / 16.0, (y as f64 + 0.5) / 8.0];
            let expected = crate::EnvironmentMap::direction_from_uv(uv);
            let found = DVec3::from_array(grid.direction(x, y).map(f64::from));
            assert!((found - expected).length() < 1e-6, "{x}, {y}");
        }
    }

    #[test]
    fn a_cap_visits_exactly_its_texels() {
        let grid = Grid::new(64, 32);
        for direction in [
            DVec3::Y,
            DVec3::NEG_Z,
            DVec3::Z,
            DVec3::new(0.3, -0.95, 0.1).normalize(),
            DVec3::new(0.6, 0.1, 0.8).normalize(),
        ] {
            for angle in [0.02_f64, 0.3, 1.8] {
                let mut visited = vec![0; grid.len()];
                grid.visit_cap(direction, angle, |y, start, count| {
                    for k in 0..count as i64 {
                        visited[(start + k).rem_euclid(64) as usize + 64 * y] += 1;
                    }
                });
                for y in 0..32 {
                    for x in 0..64 {
                        let at = DVec3::from_array(grid.direction(x, y).map(f64::from));
                        let off = at.angle_between(direction) - angle;
                        let found = visited[x + 64 * y];
                        assert!(found <= 1, "twice");
                        if off.abs() > 1e-4 {
                            assert_eq!(found == 1, off < 0.0, "{direction} {angle} {x} {y}");
                        }
                    }
                }
            }
        }
    }
}
