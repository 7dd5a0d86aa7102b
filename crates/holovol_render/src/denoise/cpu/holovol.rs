//! Twins of holovol.wgsl.

use glam::{IVec2, UVec2, Vec2, Vec3, Vec4};

use super::{
    ALBEDO_FLOOR, BETWEEN, Key, LARGEST, Memory, SAMPLES_PER_FRAME, is_marched, mean_rgb, project,
    with_frames,
};
use crate::denoise::uniforms::History;
use crate::denoise::{FADE_FRAMES, TILE};

const NO_WEIGHT: f32 = 0.02;
const LIGHT_NOISE: f32 = 0.04;
const NEAR_SEEN: f32 = 6.0;
const NEAR_EXPECTED: f32 = 2.0;
const BRIGHTEST: f32 = 1e12;
const PAYS: f32 = 0.9;
const NARROWER: [f32; 2] = [0.5, 16.0];
const MOST_STRICT: f32 = 8.0;
const TURN_LOSS: f32 = 20.0;
const EDIT: [f32; 2] = [0.05, 0.5];
const PAIR: u32 = 2;
const SLOPE_PRIOR: f32 = 0.1;
const SHARE_PRIOR: f32 = 0.03;
const COVERAGE_BIAS: f32 = 0.7;

#[derive(Clone, Copy, Default)]
struct Fetched {
    light: Vec4,
    frames: f32,
    filtered: f32,
    fit: f32,
}

/// Light that is not negative, with any opacity.
fn not_negative(light: Vec4) -> Vec4 {
    light.truncate().max(Vec3::ZERO).extend(light.w)
}

/// Both parts together, `share` being the second's.
fn expected_light(light: Vec2, share: f32) -> f32 {
    2.0 * (light.x + (light.y - light.x) * share)
}

impl Memory {
    fn history(&self, eye: usize) -> u32 {
        self.eye(eye).frame[1]
    }

    fn tile_count(&self) -> usize {
        self.uniform.counts[2] as usize
    }

    fn tile_sums(&self, part: usize) -> usize {
        part * self.tile_count()
    }

    fn tile_memory(&self, now: bool, part: usize) -> usize {
        let half = self.uniform.halves[2] as usize;
        (6 + 2 * part + if now { half } else { 1 - half }) * self.tile_count()
    }

    fn tile_result(&self, part: usize) -> usize {
        (14 + part) * self.tile_count()
    }

    fn tile_rows(&self, part: usize) -> usize {
        (17 + TILE as usize * part) * self.tile_count()
    }

    /// Tiles across and down.
    fn grid(&self, eye: usize) -> UVec2 {
        UVec2::new(self.eye(eye).frame[3], self.size(eye).y.div_ceil(TILE))
    }

    fn tile(&self, eye: usize, at: UVec2) -> usize {
        (self.eye(eye).frame[2] + at.x + self.grid(eye).x * at.y) as usize
    }

    fn tile_at(&self, eye: usize, position: UVec2, part: usize) -> Vec4 {
        let last = self.grid(eye).as_ivec2() - 1;
        let middle = (position.as_vec2() + 0.5) / TILE as f32 - 0.5;
        let base = middle.floor();
        let weight = middle - base;
        let value = |x: i32, y: i32| {
            let at = (base.as_ivec2() + IVec2::new(x, y)).clamp(IVec2::ZERO, last);
            self.tiles[self.tile_result(part) + self.tile(eye, at.as_uvec2())]
        };
        let top = value(0, 0).lerp(value(1, 0), weight.x);
        top.lerp(value(0, 1).lerp(value(1, 1), weight.x), weight.y)
    }

    /// Light per unit of what guides expect, and the grid's share of that.
    fn light_gain(&self, eye: usize, position: UVec2) -> Vec4 {
        if self.uniform.sun[3] > 0.0 {
            self.tile_at(eye, position, 2)
        } else {
            Vec4::ZERO
        }
    }

    /// Of an image: pixels across and down, and where its first is in keys, state and counts.
    fn fetch(
        &self,
        key: Key,
        place: Vec3,
        image: [usize; 3],
        [pixel_size, strictness]: [f32; 2],
        gain: Vec4,
    ) -> Fetched {
        let [width, height, first] = image;
        let size = Vec2::new(width as f32, height as f32);
        let here = key.at(place.z, key.normal);
        let position = place.truncate() / place.z - 0.5;
        let is_inside = position.cmpgt(Vec2::NEG_ONE).all() && position.cmplt(size).all();
        if !(place.z > 0.0 && is_inside) {
            return Fetched::default();
        }
        let base = position.floor();
        let weight = position - base;
        let mut found = Fetched::default();
        let mut total = 0.0;
        for offset in [(0, 0), (1, 0), (0, 1), (1, 1)].map(IVec2::from) {
            let at = base.as_ivec2() + offset;
            if at.cmplt(IVec2::ZERO).any() || at.as_vec2().cmpge(size).any() {
                continue;
            }
            let pixel = first + at.x as usize + width * at.y as usize;
            let there = self.key(pixel);
            if there.albedo <= 0.0 || there.frames <= 0.0 {
                continue;
            }
            let side = |offset: i32, w: f32| if offset == 1 { w } else { 1.0 - w };
            let distance = self.guide_distance(here, there, pixel_size);
            let w =
                side(offset.x, weight.x) * side(offset.y, weight.y) / (1.0 + strictness * distance);
            total += w;
            let change = gain.truncate() * expected_light(key.light - there.light, gain.w);
            found.light += w * (self.state[pixel] + change.extend(0.0));
            found.frames += w * self.counts[pixel].x;
            found.filtered += w * (self.counts[pixel].y + mean_rgb(change));
        }
        if total < NO_WEIGHT {
            return Fetched::default();
        }
        found.light = not_negative(found.light / total);
        found.filtered = (found.filtered / total).max(0.0);
        found.fit = total;
        found
    }

    fn new_light(&self, eye: usize, pixel: usize) -> Option<Vec4> {
        let mean = self.sample(eye, pixel)?;
        let scale = self.albedo(pixel) + ALBEDO_FLOOR;
        let light = (mean.truncate() / scale).clamp(Vec3::ZERO, Vec3::splat(LARGEST));
        Some(light.extend(mean.w - self.opacity(pixel)))
    }

    /// Frames that an eye's samples count for.
    fn worth(&self, eye: usize) -> f32 {
        self.eye(eye).frame[0].max(1) as f32 / SAMPLES_PER_FRAME
    }

    fn history_of(&self, eye: usize, position: UVec2, pixel: usize) -> Fetched {
        let key = self.key(self.now() + pixel);
        let mut before = Fetched::default();
        if self.history(eye) == History::Same as u32 {
            let at = self.before() + pixel;
            before = Fetched {
                light: self.state[at],
                frames: self.counts[at].x,
                filtered: self.counts[at].y,
                fit: 1.0,
            };
        } else if self.history(eye) == History::Moved as u32 && key.albedo > 0.0 {
            let here = self.position(eye, position, key.depth);
            let there = project(&self.eye(eye).previous, here);
            let turned = key.at(key.depth, self.turned(eye, key.normal));
            let here = here.truncate();
            let was = here - Vec4::from(self.eye(eye).before).truncate();
            let direction = |v: Vec3| v / v.length_squared().max(1e-30).sqrt();
            let turn = direction(here).cross(direction(was)).length();
            let factor = (self.uniform.edges[2] * turn).clamp(1.0, MOST_STRICT);
            let strictness = self.uniform.across[0] * factor;
            let last = self.image_before(eye, self.before());
            let known = self.eye(eye).history[3] * self.uniform.light[2];
            let gain = self.light_gain(eye, position) * Vec3::splat(known).extend(1.0);
            let bounds = [self.pixel_size(eye), strictness];
            before = self.fetch(turned, there, last, bounds, gain);
            before.frames /= 1.0 + TURN_LOSS * turn * turn * before.frames;
        }
        let [most, factor, change, _] = self.eye(eye).history;
        before.frames = (before.frames * factor).min(most);
        let t = ((change - EDIT[0]) / (EDIT[1] - EDIT[0])).clamp(0.0, 1.0);
        let edited = t * t * (3.0 - 2.0 * t);
        before.frames *= 1.0 + (before.fit * before.fit - 1.0) * edited;
        before
    }

    pub(super) fn reproject(&mut self) {
        let rows = self.tile_rows(0)..self.tile_rows(6);
        self.tiles[rows].fill(Vec4::ZERO);
        self.each_pixel(|m, eye, position, pixel| {
            let is_missed = m.keys[m.now() + pixel][0] & 0xffff == 0;
            if is_missed && m.uniform.halves[3] != 0 {
                m.guide_between(eye, position, pixel);
            }
        });
        self.each_pixel(|m, eye, position, pixel| {
            let before = m.history_of(eye, position, pixel);
            let (scratch, both) = (m.scratch(pixel), m.both(pixel));
            m.state[scratch] = before.light;
            m.counts[both] = Vec2::new(before.frames, before.filtered);
            let scale = m.albedo(pixel) + ALBEDO_FLOOR;
            let is_met = m.key(m.now() + pixel).albedo > 0.0;
            let row = TILE as usize * m.tile(eye, position / TILE) + (position.y % TILE) as usize;
            for (part, sum) in m.light_slope(eye, position).into_iter().enumerate() {
                let at = m.tile_rows(3 + part) + row;
                m.tiles[at] += sum;
            }
            let Some(light) = m.new_light(eye, pixel) else {
                return;
            };
            if !(is_met && before.frames > 0.0) {
                return;
            }
            let old = before.light.truncate() * scale;
            let difference = light.truncate() * scale - old;
            let d = mean_rgb(difference);
            let mean = mean_rgb(old);
            let filtered = before.filtered * mean_rgb(scale);
            let by_filter = filtered - mean;
            let w = m.worth(eye) / (filtered * filtered + m.uniform.tiles[2]);
            let sums = [
                difference.extend(d * d),
                old.extend(mean * mean),
                (w * Vec3::new(d * by_filter, by_filter * by_filter, d * d)).extend(1.0),
            ];
            for (part, sum) in sums.into_iter().enumerate() {
                let at = m.tile_rows(part) + row;
                m.tiles[at] += sum;
            }
        });
    }

    /// Sums of least squares between two pixels: of the dominant source, of the grid, of both.
    fn light_slope(&self, eye: usize, position: UVec2) -> [Vec4; 3] {
        let is_across = (position.x ^ position.y) & 1 == 0;
        let offset = if is_across { [PAIR, 0] } else { [0, PAIR] };
        let there = position + UVec2::from(offset);
        if there.cmpge(self.size(eye)).any() || self.uniform.sun[3] <= 0.0 {
            return [Vec4::ZERO; 3];
        }
        let [a, b] = [position, there].map(|at| self.pixel(eye, at.x, at.y));
        let [key_a, key_b] = [a, b].map(|pixel| self.key(self.now() + pixel));
        let expected = key_a.light - key_b.light;
        let are_marched = [a, b].map(|pixel| is_marched(self.keys[self.now() + pixel]));
        if are_marched != [true; 2] {
            return [Vec4::ZERO; 3];
        }
        match [a, b].map(|pixel| self.new_light(eye, pixel)) {
            [Some(a), Some(b)] => {
                let seen = (a - b).truncate();
                let of = |expected: f32| expected * seen.extend(expected);
                let both = Vec4::X * expected.x * expected.y;
                [of(expected.x), of(expected.y), both]
            }
            _ => [Vec4::ZERO; 3],
        }
    }

    pub(super) fn add_rows(&mut self) {
        for part in 0..6 {
            for tile in 0..self.tile_count() {
                let rows = self.tile_rows(part) + TILE as usize * tile;
                let sum = self.tiles[rows..rows + TILE as usize].iter().sum();
                let at = self.tile_sums(part) + tile;
                self.tiles[at] = sum;
            }
        }
    }

    pub(super) fn judge(&mut self) {
        for eye in 0..self.uniform.counts[0] as usize {
            let grid = self.grid(eye);
            for y in 0..grid.y {
                for x in 0..grid.x {
                    self.judge_tile(eye, UVec2::new(x, y));
                }
            }
        }
    }

    fn judge_tile(&mut self, eye: usize, place: UVec2) {
        let [correction_noise, shortening_factor, _, memory_factor] = self.uniform.tiles;
        let memory_factor = memory_factor * self.eye(eye).history[3];
        let last = self.grid(eye).as_ivec2() - 1;
        let (mut difference, mut old, mut memory) = (Vec4::ZERO, Vec4::ZERO, Vec4::ZERO);
        let mut own = Vec4::ZERO;
        let (mut slope, mut own_slope) = ([Vec4::ZERO; 3], [Vec4::ZERO; 3]);
        let slope_factor = memory_factor * (1.0 - self.eye(eye).history[2]) * self.uniform.light[2];
        let mut variance = 0.0;
        for y in -1..2 {
            for x in -1..2 {
                let at = (place.as_ivec2() + IVec2::new(x, y)).clamp(IVec2::ZERO, last);
                let tile = self.tile(eye, at.as_uvec2());
                let w = ((2 - x.abs()) * (2 - y.abs())) as f32 / 16.0;
                let sums = self.tiles[self.tile_sums(0) + tile];
                difference += w * sums;
                variance += w * w * sums.w;
                old += w * self.tiles[self.tile_sums(1) + tile];
                let mut remembered = self.tiles[self.tile_sums(2) + tile];
                let mut expected = [3, 4, 5].map(|part| self.tiles[self.tile_sums(part) + tile]);
                if self.history(eye) != History::None as u32 {
                    remembered += memory_factor * self.tiles[self.tile_memory(false, 0) + tile];
                    for (part, sum) in expected.iter_mut().enumerate() {
                        let before = self.tiles[self.tile_memory(false, 1 + part) + tile];
                        *sum += slope_factor * before;
                    }
                }
                memory += w * remembered;
                for (sum, expected) in slope.iter_mut().zip(expected) {
                    *sum += w * expected;
                }
                if (x, y) == (0, 0) {
                    own = remembered;
                    own_slope = expected;
                }
            }
        }
        let lag = mean_rgb(difference.truncate());
        let significance = (lag * lag / variance.max(1e-30) - 1.0).max(0.0);
        let gain = significance / (significance + correction_noise);
        let old_light = old.truncate();
        let mut correction = gain * difference.truncate() / old_light.max(Vec3::splat(1e-20));
        correction = correction.clamp(Vec3::splat(-0.9), Vec3::splat(4.0));
        correction = Vec3::select(old_light.cmpgt(Vec3::splat(1e-20)), correction, Vec3::ZERO);
        let mut shortening = mean_rgb(correction.abs()).min(1.0) * shortening_factor;
        if self.history(eye) == History::Same as u32 {
            correction = Vec3::ZERO;
            shortening = 0.0;
        }
        let prior = 1e-3 * memory.z + 1e-20;
        let weight = ((memory.x + prior) / (memory.y + prior)).clamp(0.0, 1.0);
        let noise = if old.w > 1e-30 {
            self.worth(eye) * difference.w / old.w.max(1e-30)
        } else {
            self.uniform.across[3]
        };
        let share = self.grid_share(slope);
        let (a, b) = (2.0 * (1.0 - share), 2.0 * share);
        let [of_source, of_grid, both] = slope;
        let squares = a * a * of_source.w + 2.0 * a * b * both.x + b * b * of_grid.w;
        let light = (a * of_source + b * of_grid).truncate().max(Vec3::ZERO);
        let mut gain = (light / (squares + SLOPE_PRIOR)).extend(share);
        if self.uniform.sun[3] <= 0.0 {
            gain = Vec4::ZERO;
        }
        let tile = self.tile(eye, place);
        let results = [
            (self.tile_memory(true, 0), own),
            (self.tile_memory(true, 1), own_slope[0]),
            (self.tile_memory(true, 2), own_slope[1]),
            (self.tile_memory(true, 3), own_slope[2]),
            (self.tile_result(2), gain),
            (self.tile_result(0), correction.extend(shortening)),
            (
                self.tile_result(1),
                Vec4::new(weight, noise.clamp(0.003, 1.0), 0.0, 0.0),
            ),
        ];
        for (first, value) in results {
            self.tiles[first + tile] = value;
        }
    }

    /// Of the expected light, by least squares.
    fn grid_share(&self, [of_source, of_grid, both]: [Vec4; 3]) -> f32 {
        let [source, grid, ..] = self.uniform.light;
        if source == 0.0 || grid == 0.0 {
            return 0.5;
        }
        let together = of_source.w + 2.0 * both.x + of_grid.w + SLOPE_PRIOR;
        let mixed = both.x + of_grid.w;
        let grid = of_grid.w + SHARE_PRIOR;
        let u = mean_rgb((of_source + of_grid).truncate());
        let v = mean_rgb(of_grid.truncate());
        let gain = grid * u - mixed * v;
        let more = together * v - mixed * u;
        let [source, grid] = [gain, gain + more].map(|factor| factor.max(0.0));
        if source + grid > 1e-20 {
            grid / (source + grid)
        } else {
            0.5
        }
    }

    pub(super) fn blend(&mut self) {
        self.each_pixel(|m, eye, position, pixel| {
            let mut old = m.state[m.scratch(pixel)];
            let mut frames = m.counts[m.both(pixel)].x;
            if m.history(eye) == History::Moved as u32 && frames > 0.0 {
                let tile = m.tile_at(eye, position, 0);
                old = (old.truncate() * (1.0 + tile.truncate())).extend(old.w);
                frames /= 1.0 + frames * tile.w;
            }
            if let Some(light) = m.new_light(eye, pixel) {
                let worth = m.worth(eye);
                old += worth * (light - old) / (frames + worth);
                frames += worth;
            } else if frames == 0.0 {
                old = Vec4::ZERO;
            }
            let at = m.now() + pixel;
            m.state[at] = old;
            m.counts[at] = Vec2::new(frames, 0.0);
            m.keys[at] = with_frames(m.keys[at], frames);
        });
    }

    pub(super) fn stereo(&mut self) {
        self.each_pixel(|m, eye, position, pixel| {
            let words = m.keys[m.now() + pixel];
            let key = Key::unpack(words);
            let mut light = m.state[m.now() + pixel];
            let mut frames = m.counts[m.now() + pixel].x;
            if key.albedo > 0.0 {
                let here = m.position(eye, position, key.depth);
                let there = project(&m.eye(eye).other, here);
                let [_, strictness, eye_bias, _] = m.uniform.across;
                let image = m.image(1 - eye, m.now());
                let gain = m.light_gain(eye, position);
                let bounds = [m.pixel_size(1 - eye), strictness];
                let other = m.fetch(key, there, image, bounds, gain);
                if other.frames > 0.0 {
                    let noise = m.tile_at(eye, position, 1).y;
                    let worth = other.frames / (1.0 + other.frames * eye_bias / noise);
                    light = light.lerp(other.light, worth / (frames + worth));
                    frames += worth;
                }
            }
            let (scratch, both) = (m.scratch(pixel), m.both(pixel));
            m.state[scratch] = light;
            m.keys[both] = with_frames(words, frames);
        });
    }

    pub(super) fn prefilter(&mut self) {
        self.each_pixel(|m, eye, position, pixel| {
            let near = m.near_mean(eye, position, pixel);
            let at = m.near_place(pixel);
            m.state[at] = near;
        });
    }

    /// Light over 3 × 3 neighbours: its mean, the variance of that, and frames.
    fn near_mean(&self, eye: usize, position: UVec2, pixel: usize) -> Vec4 {
        let key = self.key(self.both(pixel));
        if key.albedo <= 0.0 {
            return Vec4::ZERO;
        }
        let noise = self.tile_at(eye, position, 1).y;
        let gains = self.light_gain(eye, position);
        let gain = mean_rgb(gains.truncate());
        let middle = position.as_ivec2();
        let low = (middle - 1).max(IVec2::ZERO);
        let high = (middle + 1).min(self.size(eye).as_ivec2() - 1);
        let (mut sums, mut squares) = (Vec2::ZERO, Vec3::ZERO);
        for y in low.y..=high.y {
            for x in low.x..=high.x {
                let at = self.pixel(eye, x as u32, y as u32);
                let there = self.key(self.both(at));
                let bias = self.guide_distance(key, there, self.pixel_size(eye));
                let fits = 1.0 / (1.0 + bias * there.frames / noise);
                let w = fits * fits * there.frames;
                let all = mean_rgb(self.state[self.scratch(at)].truncate())
                    + gain * expected_light(key.light - there.light, gains.w);
                let light = all.clamp(-BRIGHTEST, BRIGHTEST);
                sums += w * Vec2::new(1.0, light);
                squares += w * w * Vec3::new(1.0, light, light * light);
            }
        }
        let total = sums.x.max(1e-10);
        let mean = sums.y / total;
        let spread = squares.z - 2.0 * mean * squares.y + mean * mean * squares.x;
        Vec4::new(mean, spread.max(0.0) / (total * total), total, 0.0)
    }

    fn near_distance(&self, a: Vec4, b: Vec4, explained: f32, noise: f32) -> f32 {
        let difference = a.x - b.x - explained;
        let mean = 0.5 * (a.x * a.x + b.x * b.x) + self.uniform.tiles[2];
        let seen = NEAR_SEEN * (a.y + b.y);
        let expected = NEAR_EXPECTED * noise * (1.0 / a.z.max(0.1) + 1.0 / b.z.max(0.1));
        let excess = (difference * difference - seen) / mean - expected;
        self.uniform.edges[1] * excess.max(0.0)
            + self.uniform.edges[3] * explained * explained / mean
    }

    pub(super) fn gather(&mut self) {
        self.each_pixel(|m, eye, position, pixel| {
            let own = m.state[m.now() + pixel];
            let scale = m.albedo(pixel) + ALBEDO_FLOOR;
            let key = m.key(m.both(pixel));
            let (mut result, mut filtered) = (own, own);
            if key.albedo > 0.0 {
                let tile = m.tile_at(eye, position, 1);
                filtered = m.filtered(eye, position, pixel, tile);
                let fade = FADE_FRAMES as f32;
                let weight = tile.x.min(fade / (fade + m.counts[m.now() + pixel].x));
                result = own.lerp(filtered, weight);
            }
            let at = m.now() + pixel;
            m.counts[at].y = mean_rgb(filtered.truncate() * scale) / mean_rgb(scale);
            let opacity = (result.w + m.opacity(pixel)).clamp(0.0, 1.0);
            m.output[pixel] = (result.truncate() * scale).extend(opacity);
        });
    }

    /// The weighted mean over an octagon of neighbours.
    fn filtered(&self, eye: usize, position: UVec2, pixel: usize, tile: Vec4) -> Vec4 {
        let radius = self.radius as i32;
        let key = self.key(self.both(pixel));
        let guide = self.counts[self.both(pixel)];
        let near = self.state[self.near_place(pixel)];
        let noise = tile.y;
        let pays = PAYS / tile.x.max(0.05);
        let narrower = match self.history(eye) {
            same if same == History::Same as u32 => 1.0,
            _ => (pays * pays).clamp(NARROWER[0], NARROWER[1]),
        } / noise;
        let centre = key.frames.max(0.5);
        let gain = self.light_gain(eye, position);
        let mut light = centre * self.state[self.scratch(pixel)];
        let mut total = centre;
        let middle = position.as_ivec2();
        let low = (middle - radius).max(IVec2::ZERO);
        let high = (middle + radius).min(self.size(eye).as_ivec2() - 1);
        for y in low.y..=high.y {
            let reach = radius - ((y - middle.y).abs() - radius / 2).max(0);
            for x in low.x.max(middle.x - reach)..=high.x.min(middle.x + reach) {
                let at = self.pixel(eye, x as u32, y as u32);
                let there = self.key(self.both(at));
                let offset = (IVec2::new(x, y) - middle).as_vec2();
                let change = gain.truncate() * expected_light(key.light - there.light, gain.w);
                let explained = mean_rgb(change);
                let is_between = |at: usize| self.keys[self.both(at)][0] & BETWEEN != 0;
                let coverage = if is_between(pixel) || is_between(at) {
                    COVERAGE_BIAS
                } else {
                    0.0
                };
                let bias = coverage
                    + self.uniform.bias[0] * offset.length_squared()
                    + self.guide_distance(key, there, self.pixel_size(eye))
                    + self.light_distance(guide, self.counts[self.both(at)], explained, noise)
                    + self.near_distance(near, self.state[self.near_place(at)], explained, noise);
                let fits = 1.0 / (1.0 + bias * there.frames * narrower);
                if (x, y) != (middle.x, middle.y) {
                    let w = fits * fits * there.frames;
                    total += w;
                    light += w * (self.state[self.scratch(at)] + change.extend(0.0));
                }
            }
        }
        not_negative(light / total)
    }

    fn light_distance(&self, a: Vec2, b: Vec2, explained: f32, noise: f32) -> f32 {
        let difference = a.y - b.y - explained;
        let trust = (0.5 * a.x.min(b.x)).min(1.0);
        let mean = 0.5 * (a.y * a.y + b.y * b.y) + self.uniform.tiles[2];
        let excess = difference * difference / mean - LIGHT_NOISE * noise;
        self.uniform.edges[0] * trust * excess.max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DenoiseSettings;
    use crate::denoise::cpu::Before;

    #[test]
    fn frames_count_for_their_samples() {
        let mut drawn = 0u32;
        let mut number = || {
            drawn = drawn.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (drawn >> 8) as f32 / 16_777_216.0
        };
        let settings = DenoiseSettings::default();
        let mut memory = Memory::random(&settings, Before::Same, 0.0, &mut number);
        for eye in &mut memory.uniform.eyes {
            eye.frame[0] = 16;
        }
        memory.reproject();
        memory.blend();
        let mut finite = 0;
        for eye in 0..2 {
            let pixel = memory.pixel(eye, 3, 4);
            let Some(light) = memory.new_light(eye, pixel) else {
                continue;
            };
            finite += 1;
            let (before, old) = (memory.counts[memory.both(pixel)].x, memory.scratch(pixel));
            let now = memory.now() + pixel;
            assert_eq!(
                memory.counts[now].x,
                before + 8.0,
                "16 samples are 8 frames"
            );
            let mean = (memory.state[old] * before + light * 8.0) / (before + 8.0);
            assert!(memory.state[now].abs_diff_eq(mean, 1e-5));
        }
        assert!(finite > 0);
    }
}
