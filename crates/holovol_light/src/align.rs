//! From the camera's frame to the world's, and from the camera's place to the volume's.

use glam::{DMat3, DQuat, DVec3, DVec4};

use crate::EnvironmentMap;
use crate::estimate::Light;

/// Why no rotation could be found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum AlignError {
    /// Too few directions.
    #[error("{0} pairs of directions; point at 2 lights or more")]
    TooFew(usize),
    /// All directions lie on one line.
    #[error(
        "the lights lie in one direction (or opposite ones); point at lights apart from each other"
    )]
    Collinear,
}

/// The rotation that takes the camera's directions to the world's best in the least-squares sense
/// (Wahba's problem, by Davenport's q method: the largest eigenvector of a 4 × 4 matrix).
///
/// Pairs are (direction in the camera's frame, direction in the world's, weight).
///
/// # Errors
/// With fewer than two pairs, or if they don't fix the rotation.
pub fn rotation_from_directions(pairs: &[(DVec3, DVec3, f64)]) -> Result<DQuat, AlignError> {
    if pairs.len() < 2 {
        return Err(AlignError::TooFew(pairs.len()));
    }
    let spread = pairs.iter().any(|(a, ..)| {
        let first = pairs[0].0;
        a.normalize_or_zero()
            .cross(first.normalize_or_zero())
            .length()
            > 0.02
    });
    if !spread {
        return Err(AlignError::Collinear);
    }
    let mut b = DMat3::ZERO;
    for (camera, world, weight) in pairs {
        let (camera, world) = (camera.normalize_or_zero(), world.normalize_or_zero());
        // Σ w · world · cameraᵀ
        b += DMat3::from_cols(world * camera.x, world * camera.y, world * camera.z) * *weight;
    }
    let trace = b.x_axis.x + b.y_axis.y + b.z_axis.z;
    let s = b + b.transpose();
    let z = DVec3::new(
        b.y_axis.z - b.z_axis.y,
        b.z_axis.x - b.x_axis.z,
        b.x_axis.y - b.y_axis.x,
    );
    let rows = [
        [s.x_axis.x - trace, s.y_axis.x, s.z_axis.x, z.x],
        [s.x_axis.y, s.y_axis.y - trace, s.z_axis.y, z.y],
        [s.x_axis.z, s.y_axis.z, s.z_axis.z - trace, z.z],
        [z.x, z.y, z.z, trace],
    ];
    // Power iteration on K + cI, which is positive: the largest eigenvalue is the sum of weights.
    let shift: f64 = pairs.iter().map(|p| p.2).sum::<f64>() + 1e-9;
    let mut best = (f64::MIN, DVec4::W);
    for start in [DVec4::W, DVec4::X, DVec4::Y, DVec4::Z] {
        let mut q = (start + DVec4::splat(1e-3)).normalize();
        for _ in 0..2000 {
            let a = q.to_array();
            let row = |r: [f64; 4]| r.iter().zip(a).map(|(m, v)| m * v).sum::<f64>();
            let next = DVec4::from_array(rows.map(row)) + q * shift;
            let next = next.normalize_or_zero();
            let step = (next - q).length();
            q = next;
            if step < 1e-14 {
                break;
            }
        }
        let a = q.to_array();
        let gain: f64 = (0..4)
            .map(|i| (0..4).map(|j| a[i] * rows[i][j] * a[j]).sum::<f64>())
            .sum();
        if gain > best.0 {
            best = (gain, q);
        }
    }
    Ok(DQuat::from_vec4(best.1).normalize())
}

/// What the surroundings are taken for when light seen at the camera is asked for elsewhere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Proxy {
    /// A sphere around the camera, radius in metres.
    Sphere(f64),
    /// An axis-aligned box, corners relative to the camera, metres.
    Box {
        /// Lowest corner; all below 0.
        low: DVec3,
        /// Highest corner; all above 0.
        high: DVec3,
    },
}

impl Proxy {
    /// Where a ray from `origin` (inside) meets the proxy.
    fn hit(&self, origin: DVec3, direction: DVec3) -> DVec3 {
        match *self {
            Self::Sphere(radius) => {
                let along = origin.dot(direction);
                let inside = (along * along + radius * radius - origin.length_squared()).max(0.0);
                origin + direction * (inside.sqrt() - along)
            }
            Self::Box { low, high } => {
                let mut nearest = f64::INFINITY;
                for axis in 0..3 {
                    let d = direction[axis];
                    if d != 0.0 {
                        let wall = if d > 0.0 { high[axis] } else { low[axis] };
                        nearest = nearest.min((wall - origin[axis]) / d);
                    }
                }
                origin + direction * nearest.max(0.0)
            }
        }
    }

    /// The place itself, pulled into the proxy where it lies outside or at its very wall.
    fn inside(&self, place: DVec3) -> DVec3 {
        /// Nearer to the wall than this share, the warp is singular.
        const MARGIN: f64 = 0.95;
        match *self {
            Self::Sphere(radius) => place.clamp_length_max(MARGIN * radius),
            Self::Box { low, high } => place.clamp(low * MARGIN, high * MARGIN),
        }
    }
}

/// The map as it would be seen from `place` (metres from the camera, in the map's frame).
pub fn recentre(map: &EnvironmentMap, proxy: Proxy, place: DVec3) -> EnvironmentMap {
    let place = proxy.inside(place);
    let (width, height) = (map.width(), map.height());
    let texels = (0..width * height).map(|i| {
        let uv = [
            ((i % width) as f64 + 0.5) / width as f64,
            ((i / width) as f64 + 0.5) / height as f64,
        ];
        let direction = EnvironmentMap::direction_from_uv(uv);
        // Radiance does not change along a ray: only the direction does.
        map.radiance(proxy.hit(place, direction)).map(|c| c as f32)
    });
    EnvironmentMap::new(width, height, texels.collect())
}

/// A light as it would be seen from `place`: its direction turns, and a near one's irradiance and
/// solid angle grow as the square of the distance falls. The sun is at infinity and stays.
pub fn recentre_light(light: &Light, proxy: Proxy, place: DVec3) -> Light {
    if light.class == crate::estimate::LightClass::Sun {
        return *light;
    }
    let place = proxy.inside(place);
    let at = proxy.hit(DVec3::ZERO, light.direction);
    let towards = at - place;
    let scale = at.length_squared() / towards.length_squared().max(1e-12);
    let mut out = *light;
    out.direction = towards.normalize_or(light.direction);
    out.irradiance = light.irradiance.map(|e| e * scale);
    out.solid_angle = (light.solid_angle * scale).min(2.0 * std::f64::consts::PI);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wahba_finds_the_rotation_back() {
        let truth = DQuat::from_euler(glam::EulerRot::YXZ, 2.9, -0.4, 0.2);
        let lights = [
            DVec3::new(0.3, 0.8, -0.5),
            DVec3::new(-0.9, 0.1, 0.2),
            DVec3::new(0.0, 0.5, 1.0),
        ];
        for count in [2, 3] {
            let pairs: Vec<_> = lights[..count]
                .iter()
                .map(|&d| (d, truth * d, 1.0))
                .collect();
            let found = rotation_from_directions(&pairs).unwrap();
            assert!(found.angle_between(truth) < 1e-6, "{count}: {found}");
        }
        let one = (DVec3::X, DVec3::Y, 1.0);
        assert_eq!(rotation_from_directions(&[one]), Err(AlignError::TooFew(1)));
        assert_eq!(
            rotation_from_directions(&[one, one]),
            Err(AlignError::Collinear)
        );
    }

    #[test]
    fn recentring_turns_near_lights_and_keeps_the_far() {
        let proxy = Proxy::Sphere(3.0);
        let hit = proxy.hit(DVec3::new(1.0, 0.0, 0.0), DVec3::NEG_Z);
        assert!((hit.length() - 3.0).abs() < 1e-12 && (hit.x - 1.0).abs() < 1e-12);
        let room = Proxy::Box {
            low: DVec3::new(-2.0, -1.0, -3.0),
            high: DVec3::new(2.0, 1.5, 3.0),
        };
        assert!((room.hit(DVec3::ZERO, DVec3::Y) - DVec3::new(0.0, 1.5, 0.0)).length() < 1e-12);
        // A bright texel above the camera is seen behind once we are in front of it.
        let (width, height) = (64, 32);
        let mut texels = vec![[0.1; 3]; width * height];
        for texel in &mut texels[..width * 2] {
            *texel = [100.0; 3];
        }
        let map = EnvironmentMap::new(width, height, texels);
        let moved = recentre(&map, room, DVec3::new(0.0, 0.0, -1.5));
        let towards = DVec3::new(0.0, 1.5, 1.5).normalize();
        assert!(moved.radiance(towards)[0] > 50.0);
        assert!(moved.radiance(DVec3::Y)[0] < 1.0);
        assert_eq!(
            recentre(&map, proxy, DVec3::ZERO).radiance(DVec3::NEG_Z),
            map.radiance(DVec3::NEG_Z)
        );
    }

    #[test]
    fn a_near_light_brightens_as_one_comes_nearer() {
        use crate::Grid;
        use crate::estimate::{Estimator, Evidence, Exposure, LightClass, Prior};
        let grid = Grid::new(64, 32);
        let lamp = |i: &usize| (31..33).contains(&(i % 64)) && (15..17).contains(&(i / 64));
        let level = |i: usize| [if lamp(&i) { 1.0 } else { 0.1 }; 3];
        let picture: Vec<[f32; 3]> = (0..grid.len()).map(level).collect();
        let frames = [Exposure {
            ev: 0.0,
            radiance: &picture,
        }];
        let mut estimator = Estimator::new(64, 32, Prior::default());
        estimator.estimate(&Evidence {
            frames: &frames,
            ..Evidence::default()
        });
        // Four texels ahead, 3 m away: and from 1.5 m to its left.
        let light = estimator.lights()[0];
        assert!(light.direction.distance(DVec3::NEG_Z) < 1e-3);
        let proxy = Proxy::Sphere(3.0);
        let nearer = recentre_light(&light, proxy, DVec3::new(0.0, 0.0, -1.5));
        let further = recentre_light(&light, proxy, DVec3::new(-1.5, 0.0, 0.0));
        for c in 0..3 {
            assert!((nearer.irradiance[c] / light.irradiance[c] - 4.0).abs() < 1e-2);
            assert!((further.irradiance[c] / light.irradiance[c] - 0.8).abs() < 1e-2);
        }
        assert!((nearer.solid_angle / light.solid_angle - 4.0).abs() < 1e-2);
        let towards = DVec3::new(1.5, 0.0, -3.0).normalize();
        assert!(further.direction.distance(towards) < 2e-3);
        let mut sun = light;
        sun.class = LightClass::Sun;
        assert_eq!(recentre_light(&sun, proxy, DVec3::X), sun);
    }
}
