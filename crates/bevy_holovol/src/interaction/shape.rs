//! Boxes as hands meet them: their inside, their corners and edges, and rays that hit them.

use bevy::math::{Quat, Vec3};

/// Where a thing is: a rotation, a scale alike along all axes, a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// m, world.
    pub translation: Vec3,
    /// World from thing.
    pub rotation: Quat,
    /// World metres per metre of the thing.
    pub scale: f32,
}

impl Placement {
    /// At the origin, as it is.
    pub const IDENTITY: Self = Self {
        translation: Vec3::ZERO,
        rotation: Quat::IDENTITY,
        scale: 1.0,
    };

    /// A point of the thing, in the world.
    pub fn to_world(&self, point: Vec3) -> Vec3 {
        self.translation + self.rotation * (self.scale * point)
    }

    /// A point of the world, in the thing.
    pub fn to_local(&self, point: Vec3) -> Vec3 {
        self.rotation.inverse() * (point - self.translation) / self.scale
    }

    /// Finite, and with a scale that isn't 0.
    pub fn is_valid(&self) -> bool {
        self.translation.is_finite()
            && self.rotation.is_finite()
            && self.scale.is_finite()
            && self.scale > 0.0
    }
}

/// A part of a box that does more than move it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Handle {
    /// Scales about the opposite corner: bit i of the number is set on the positive side of axis i.
    Corner(u8),
    /// Turns about this axis, which the edge is parallel to; the signs are those of the two other
    /// axes, in order.
    Edge {
        /// 0, 1 or 2.
        axis: u8,
        /// Which of the four edges.
        positive: [bool; 2],
    },
}

impl Handle {
    /// All of a box: its corners, then its edges.
    pub fn all() -> impl Iterator<Item = Self> {
        let corners = (0..8).map(Self::Corner);
        let edges = (0..3).flat_map(|axis| {
            [[false, false], [false, true], [true, false], [true, true]]
                .map(|positive| Self::Edge { axis, positive })
        });
        corners.chain(edges)
    }

    /// Its middle, for a box around the origin that reaches `half` to each side.
    pub fn place(self, half: Vec3) -> Vec3 {
        let sign = |is_positive: bool| if is_positive { 1.0 } else { -1.0 };
        match self {
            Self::Corner(bits) => {
                half * Vec3::from([0, 1, 2].map(|axis| sign(bits >> axis & 1 == 1)))
            }
            Self::Edge { axis, positive } => {
                let mut place = half;
                place[usize::from(axis)] = 0.0;
                for (other, is_positive) in others(axis).into_iter().zip(positive) {
                    place[other] *= sign(is_positive);
                }
                place
            }
        }
    }
}

fn others(axis: u8) -> [usize; 2] {
    match axis {
        0 => [1, 2],
        1 => [0, 2],
        _ => [0, 1],
    }
}

/// Distance of a point to a box around the origin; 0 inside.
pub(super) fn distance_to_box(point: Vec3, half: Vec3) -> f32 {
    (point.abs() - half).max(Vec3::ZERO).length()
}

/// Where a ray enters a box around the origin, in lengths of `direction`; 0 from within.
pub(super) fn ray_to_box(origin: Vec3, direction: Vec3, half: Vec3) -> Option<f32> {
    let a = (-half - origin) / direction;
    let b = (half - origin) / direction;
    let (near, far) = (a.min(b), a.max(b));
    // min and max pass over NaN: a ray in a face's plane.
    let entry = near.x.max(near.y).max(near.z).max(0.0);
    let exit = far.x.min(far.y).min(far.z);
    (entry <= exit && entry.is_finite()).then_some(entry)
}

/// Where along a ray a point is nearest, and how near.
pub(super) fn ray_to_point(origin: Vec3, direction: Vec3, point: Vec3) -> (f32, f32) {
    let along = ((point - origin).dot(direction) / direction.length_squared()).max(0.0);
    let along = if along.is_finite() { along } else { 0.0 };
    (along, (origin + along * direction).distance(point))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_are_eight_corners_and_twelve_edges_on_the_surface() {
        let half = Vec3::new(1.0, 2.0, 3.0);
        let places: Vec<_> = Handle::all().map(|handle| handle.place(half)).collect();
        assert_eq!(places.len(), 20);
        for (i, a) in places.iter().enumerate() {
            assert_eq!(distance_to_box(*a, half), 0.0);
            for b in &places[..i] {
                assert!(a.distance(*b) > 0.9, "{a} and {b} are two");
            }
        }
    }

    #[test]
    fn rays_hit_what_is_ahead_of_them() {
        let half = Vec3::splat(0.5);
        let from = |x: f32, z: f32| ray_to_box(Vec3::new(x, 0.0, z), Vec3::NEG_Z, half);
        assert_eq!(from(0.0, 2.0), Some(1.5));
        assert_eq!(from(0.0, 0.0), Some(0.0), "from within");
        assert_eq!(from(0.0, -2.0), None, "behind");
        assert_eq!(from(0.6, 2.0), None, "beside");
        let none = ray_to_box(Vec3::new(0.0, 0.0, 2.0), Vec3::ZERO, half);
        assert_eq!(none, None, "a ray without a direction");
    }
}
