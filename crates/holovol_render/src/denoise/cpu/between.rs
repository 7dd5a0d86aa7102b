//! Twin of between.wgsl.

use glam::{IVec2, UVec2, Vec2, Vec3, Vec4};

use super::{ALBEDO_FLOOR, BETWEEN, Key, Memory, is_marched};

const LEAST_ALBEDO: f32 = 1e-4;

impl Memory {
    /// What pixels around would cover of one whose middle the medium misses.
    pub(super) fn guide_between(&mut self, eye: usize, position: UVec2, pixel: usize) {
        let middle = position.as_ivec2();
        let low = (middle - 1).max(IVec2::ZERO);
        let high = (middle + 1).min(self.size(eye).as_ivec2() - 1);
        let (mut albedo, mut normal, mut sums) = (Vec4::ZERO, Vec3::ZERO, Vec3::ZERO);
        let mut sum_of_light = Vec2::ZERO;
        let mut nearest = 0.0;
        for y in low.y..=high.y {
            for x in low.x..=high.x {
                let at = self.pixel(eye, x as u32, y as u32);
                if !is_marched(self.keys[self.now() + at]) {
                    continue;
                }
                let there = self.key(self.now() + at);
                if sums.x == 0.0 {
                    nearest = there.depth;
                }
                let side = (2 - (IVec2::new(x, y) - middle).abs()).as_vec2();
                let share = side.x * side.y / 16.0;
                let w = share * there.albedo;
                let behind = there.depth - nearest;
                let light = there.light * (there.albedo + ALBEDO_FLOOR);
                albedo += share * self.albedo(at).extend(self.opacity(at));
                normal += w * there.normal;
                let square = behind * behind + there.spread * there.spread;
                sums += Vec3::new(w, w * behind, w * square);
                sum_of_light += share * light;
            }
        }
        if sums.x == 0.0 {
            return;
        }
        let mean = sums.y / sums.x;
        let key = Key {
            albedo: sums.x.max(LEAST_ALBEDO),
            normal: normal / normal.length_squared().max(1e-30).sqrt(),
            depth: nearest + mean,
            spread: (sums.z / sums.x - mean * mean).max(0.0).sqrt(),
            frames: 0.0,
            light: sum_of_light / (sums.x.max(LEAST_ALBEDO) + ALBEDO_FLOOR),
        };
        let [first, rest @ ..] = key.pack();
        let [normal, depth, frames] = rest;
        let now = self.now();
        self.keys[now + pixel] = [first | BETWEEN, normal, depth, frames];
        let at = 2 * self.pixels() + pixel;
        self.state[at] = albedo;
    }
}
