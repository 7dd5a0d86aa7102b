//! Signed distances (negative inside) and noise, from which the phantom is built.

use glam::{Vec3, vec3};

/// To an ellipsoid, nearly (I. Quilez): exact on the surface, right in order elsewhere.
pub(super) fn ellipsoid(p: Vec3, centre: Vec3, radii: Vec3) -> f32 {
    let q = p - centre;
    let scaled = (q / radii).length();
    let gradient = (q / (radii * radii)).length();
    if gradient > 0.0 {
        scaled * (scaled - 1.0) / gradient
    } else {
        -radii.min_element()
    }
}

/// To a capsule whose radius goes from `ra` at `a` to `rb` at `b`.
pub(super) fn capsule(p: Vec3, a: Vec3, b: Vec3, ra: f32, rb: f32) -> f32 {
    let (pa, ba) = (p - a, b - a);
    let t = (pa.dot(ba) / ba.length_squared()).clamp(0.0, 1.0);
    (pa - ba * t).length() - (ra + (rb - ra) * t)
}

/// Union with a rounded seam of width `k`.
pub(super) fn join(a: f32, b: f32, k: f32) -> f32 {
    let h = (k - (a - b).abs()).max(0.0);
    a.min(b) - h * h / (4.0 * k)
}

/// `a` without `b`, with a rounded rim of width `k`.
pub(super) fn carve(a: f32, b: f32, k: f32) -> f32 {
    -join(-a, b, k)
}

/// 0 below `low`, 1 above `high`, smooth between.
pub(super) fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Gradient noise (Perlin 2002), about −1 … 1, one feature per unit.
pub(super) fn noise(p: Vec3) -> f32 {
    let cell = p.floor();
    let f = p - cell;
    let fade = f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
    let corner = |dx: f32, dy: f32, dz: f32| {
        let offset = vec3(dx, dy, dz);
        gradient(cell + offset).dot(f - offset)
    };
    let lerp = |a: f32, b: f32, t: f32| a + (b - a) * t;
    let along_x = |dy, dz| lerp(corner(0.0, dy, dz), corner(1.0, dy, dz), fade.x);
    let along_y = |dz| lerp(along_x(0.0, dz), along_x(1.0, dz), fade.y);
    1.5 * lerp(along_y(0.0), along_y(1.0), fade.z)
}

fn gradient(cell: Vec3) -> Vec3 {
    let mut hash = Hash::new([cell.x as i32, cell.y as i32, cell.z as i32]);
    let z = 2.0 * hash.next() - 1.0;
    let (sin, cos) = (std::f32::consts::TAU * hash.next()).sin_cos();
    let r = (1.0 - z * z).max(0.0).sqrt();
    vec3(r * cos, r * sin, z)
}

/// Random numbers of a place: PCG (O'Neill 2014) on a mix of its coordinates.
pub(super) struct Hash(u32);

impl Hash {
    pub(super) fn new(place: [i32; 3]) -> Self {
        let [x, y, z] = place.map(|c| c as u32);
        Self(
            x.wrapping_mul(0x8da6_b343) ^ y.wrapping_mul(0xd816_3841) ^ z.wrapping_mul(0xcb1a_b31f),
        )
    }

    /// Uniform in [0, 1).
    pub(super) fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        let word = ((self.0 >> ((self.0 >> 28) + 4)) ^ self.0).wrapping_mul(277_803_737);
        let bits = (word >> 22) ^ word;
        (bits >> 8) as f32 / (1u32 << 24) as f32
    }
}
