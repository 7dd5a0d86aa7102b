//! CPU twins of the denoiser's passes: f32, same order, on the same buffers.

mod between;
mod holovol;
mod paper;

use bytemuck::{Pod, Zeroable};
use glam::{DMat4, DVec3, Quat, UVec2, Vec2, Vec3, Vec4};
use half::f16;
use holovol_scene::Camera;

use super::passes::Passes;
use super::uniforms::{DenoiseUniform, EyeUniform, History, projection};
use super::{COUNTS, DenoiseMode, DenoiseSettings, KEYS, LIGHTS, STATE, TILE, TILES};
use crate::{Gpu, RenderError, View};

/// Light is what radiance is per albedo, kept away from division by none.
const ALBEDO_FLOOR: f32 = 0.5;
const LARGEST: f32 = 1e15;
const SAMPLES_PER_FRAME: f32 = 2.0;

/// In the first word of a key, as the sign of light: see common.wgsl.
const BETWEEN: u32 = 1 << 31;

/// What happened to the eyes since the last frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Before {
    /// There was none.
    Nothing,
    /// Eyes and volume have moved a little.
    Moved,
    /// Nothing has changed.
    Same,
}

/// All that the passes read and write, for two eyes of different sizes.
#[derive(Clone)]
pub struct Memory {
    mode: DenoiseMode,
    radius: u32,
    uniform: DenoiseUniform,
    /// The kernels' `state`, then their `lights`.
    state: Vec<Vec4>,
    keys: Vec<[u32; 4]>,
    counts: Vec<Vec2>,
    tiles: Vec<Vec4>,
    noisy: Vec<Vec4>,
    output: Vec<Vec4>,
}

/// Guides of a pixel, see `Key` in common.wgsl.
#[derive(Clone, Copy, Debug)]
struct Key {
    albedo: f32,
    normal: Vec3,
    depth: f32,
    spread: f32,
    frames: f32,
    light: Vec2,
}

fn half_pair(word: u32) -> [f32; 2] {
    [word as u16, (word >> 16) as u16].map(|bits| f16::from_bits(bits).to_f32())
}

fn half_word(low: f32, high: f32) -> u32 {
    let [low, high] = [low, high].map(|v| u32::from(f16::from_f32(v.min(60000.0)).to_bits()));
    low | high << 16
}

fn pack_normal(n: Vec3) -> u32 {
    let p = n.truncate() / (n.x.abs() + n.y.abs() + n.z.abs()).max(1e-20);
    let side = |x: f32| if x >= 0.0 { 1.0 } else { -1.0 };
    let folded = Vec2::new((1.0 - p.y.abs()) * side(p.x), (1.0 - p.x.abs()) * side(p.y));
    let p = if n.z < 0.0 { folded } else { p };
    let steps = |x: f32| ((x.clamp(-1.0, 1.0) + 1.0) * 2047.0).round() as u32;
    steps(p.x) << 20 | steps(p.y) << 8
}

fn unpack_normal(word: u32) -> Vec3 {
    let of = |steps: u32| steps as f32 / 2047.0 - 1.0;
    let p = Vec2::new(of(word >> 20), of(word >> 8 & 0xfff));
    let z = 1.0 - p.x.abs() - p.y.abs();
    let t = (-z).max(0.0);
    let unfold = |x: f32| x + if x >= 0.0 { -t } else { t };
    let n = Vec3::new(unfold(p.x), unfold(p.y), z);
    n / n.dot(n).sqrt()
}

impl Key {
    fn pack(self) -> [u32; 4] {
        let spread = self.spread / self.depth.max(1e-30);
        let light = self.light.element_sum();
        let part = self.light.x.abs() / light.abs().max(1e-20);
        [
            half_word(self.albedo, light),
            pack_normal(self.normal) | (255.0 * part).round() as u32,
            self.depth.to_bits(),
            half_word(spread, self.frames),
        ]
    }

    fn unpack(words: [u32; 4]) -> Self {
        let [albedo, light] = half_pair(words[0]);
        let [spread, frames] = half_pair(words[3]);
        let depth = f32::from_bits(words[2]);
        let part = (words[1] & 0xff) as f32 / 255.0;
        Self {
            albedo,
            light: light.abs() * Vec2::new(part, 1.0 - part),
            normal: unpack_normal(words[1]),
            depth,
            spread: depth * spread,
            frames,
        }
    }

    /// These guides as the last frame or the other eye should have them.
    fn at(self, depth: f32, normal: Vec3) -> Self {
        Self {
            depth,
            normal,
            ..self
        }
    }
}

/// Whether a ray of the march made this guide.
fn is_marched(words: [u32; 4]) -> bool {
    words[0] & 0xffff != 0 && words[0] & BETWEEN == 0
}

fn with_frames(words: [u32; 4], frames: f32) -> [u32; 4] {
    let [spread, _] = half_pair(words[3]);
    [words[0], words[1], words[2], half_word(spread, frames)]
}

fn mean_rgb(v: Vec3) -> f32 {
    (v.x + v.y + v.z) * (1.0 / 3.0)
}

fn project(rows: &[[f32; 4]; 3], here: Vec4) -> Vec3 {
    Vec3::from_array(rows.map(|row| Vec4::from(row).dot(here)))
}

impl Memory {
    fn eye(&self, eye: usize) -> &EyeUniform {
        &self.uniform.eyes[eye]
    }

    fn size(&self, eye: usize) -> UVec2 {
        let [width, height, ..] = self.eye(eye).image;
        UVec2::new(width, height)
    }

    fn pixel_size(&self, eye: usize) -> f32 {
        self.eye(eye).turn[0][3]
    }

    fn pixels(&self) -> usize {
        self.uniform.counts[1] as usize
    }

    fn now(&self) -> usize {
        self.uniform.halves[0] as usize * self.pixels()
    }

    fn before(&self) -> usize {
        self.uniform.halves[1] as usize * self.pixels()
    }

    fn albedo(&self, pixel: usize) -> Vec3 {
        self.state[2 * self.pixels() + pixel].truncate()
    }

    fn opacity(&self, pixel: usize) -> f32 {
        self.state[2 * self.pixels() + pixel].w
    }

    fn scratch(&self, pixel: usize) -> usize {
        3 * self.pixels() + pixel
    }

    fn near_place(&self, pixel: usize) -> usize {
        4 * self.pixels() + pixel
    }

    fn both(&self, pixel: usize) -> usize {
        2 * self.pixels() + pixel
    }

    fn key(&self, pixel: usize) -> Key {
        Key::unpack(self.keys[pixel])
    }

    fn pixel(&self, eye: usize, x: u32, y: u32) -> usize {
        (self.eye(eye).image[3] + x + self.size(eye).x * y) as usize
    }

    /// Pixels across and down, and the first one behind `half`.
    fn image(&self, eye: usize, half: usize) -> [usize; 3] {
        let [width, height, _, first] = self.eye(eye).image.map(|n| n as usize);
        [width, height, half + first]
    }

    /// Likewise of the last frame.
    fn image_before(&self, eye: usize, half: usize) -> [usize; 3] {
        let [_, width, height, first] = self.eye(eye).place.map(|n| n as usize);
        [width, height, half + first]
    }

    fn position(&self, eye: usize, pixel: UVec2, depth: f32) -> Vec4 {
        let p = pixel.as_vec2() + 0.5;
        let eye = self.eye(eye);
        let ray = Vec4::from(eye.direction)
            + p.x * Vec4::from(eye.direction_dx)
            + p.y * Vec4::from(eye.direction_dy);
        (depth * ray.truncate()).extend(1.0)
    }

    fn turned(&self, eye: usize, normal: Vec3) -> Vec3 {
        let rows = self.eye(eye).turn;
        Vec3::from_array(rows.map(|row| Vec4::from(row).truncate().dot(normal)))
    }

    /// A pixel's mean of this frame's samples.
    fn sample(&self, eye: usize, pixel: usize) -> Option<Vec4> {
        let eye = self.eye(eye);
        let at = pixel - eye.image[3] as usize + eye.image[2] as usize;
        let mean = (self.noisy[2 * at] + self.noisy[2 * at + 1]) / eye.frame[0].max(1) as f32;
        mean.is_finite().then_some(mean)
    }

    fn guide_distance(&self, a: Key, b: Key, pixel_size: f32) -> f32 {
        let slack = a.spread + b.spread + 2.0 * pixel_size * a.depth + 1e-30;
        let depth = (b.depth - a.depth) / slack;
        let opacity = b.albedo - a.albedo;
        let sum = b.albedo + a.albedo;
        let [_, normal_bias, depth_bias, opacity_bias] = self.uniform.bias;
        normal_bias * (1.0 - a.normal.dot(b.normal))
            + depth_bias * (depth * depth).min(50.0)
            + opacity_bias * 4.0 * opacity * opacity / (sum * sum + 1e-4)
    }

    /// Calls something for every pixel of every eye.
    fn each_pixel(&mut self, mut act: impl FnMut(&mut Self, usize, UVec2, usize)) {
        for eye in 0..self.uniform.counts[0] as usize {
            let size = self.size(eye);
            for y in 0..size.y {
                for x in 0..size.x {
                    let pixel = self.pixel(eye, x, y);
                    act(self, eye, UVec2::new(x, y), pixel);
                }
            }
        }
    }

    /// Two eyes whose buffers hold anything that they may hold in use: guides, history, samples,
    /// some of them not finite. `number` gives numbers in 0 … 1.
    pub fn random(
        settings: &DenoiseSettings,
        before: Before,
        light_change: f32,
        number: &mut dyn FnMut() -> f32,
    ) -> Self {
        let sizes = [UVec2::new(37, 22), UVec2::new(24, 33)];
        let sizes_before = [UVec2::new(30, 20), UVec2::new(24, 30)];
        let mut vector = |scale: f64| {
            let mut side = || scale * (2.0 * f64::from(number()) - 1.0);
            DVec3::new(side(), side(), side())
        };
        let views = sizes.map(|size| {
            View::from_camera(&Camera {
                eye: DVec3::new(0.0, 0.0, 2.0) + vector(0.03),
                target: vector(0.01),
                up: DVec3::Y,
                fov_y: 0.5,
                width: size.x,
                height: size.y,
            })
        });
        let moved = DMat4::from_rotation_y(0.01) * DMat4::from_translation(vector(0.01));
        let mut uniform = DenoiseUniform::zeroed();
        let (mut pixels, mut tiles) = (0, 0);
        for (i, size) in sizes.into_iter().enumerate() {
            let mut eye = EyeUniform::new(&views[i]);
            let mut last = views[i].resized(sizes_before[i].to_array());
            last.origin += vector(0.01);
            let history = match before {
                Before::Nothing => History::None,
                Before::Moved => History::Moved,
                Before::Same => History::Same,
            };
            eye.previous = projection(&views[i], &last, moved).unwrap_or_default();
            eye.other = projection(&views[i], &views[1 - i], DMat4::IDENTITY).unwrap_or_default();
            eye.set_turn(moved);
            eye.set_before(&views[i], &last, moved);
            let across = size.x.div_ceil(TILE);
            // Not in the order in which the denoiser has them.
            let first = if i == 0 {
                sizes[1].element_product()
            } else {
                0
            };
            eye.image = [size.x, size.y, first, pixels];
            eye.frame = [[2, 5][i], history as u32, tiles, across];
            eye.history = [24.0, 1.0, light_change, [1.0, 0.0][i]];
            let first_before = [0, sizes_before[0].element_product()][i];
            eye.place = [0, sizes_before[i].x, sizes_before[i].y, first_before];
            uniform.eyes[i] = eye;
            pixels += size.element_product();
            tiles += across * size.y.div_ceil(TILE);
        }
        uniform.counts = [2, pixels, tiles, 0];
        let is_other = u32::from(before != Before::Same);
        uniform.halves = [0, is_other, 1, is_other];
        settings.fill(&mut uniform, 1.0);
        // One case without a guide of light.
        uniform.light = [1.0, 1.0, 0.7, 0.0];
        uniform.sun = [0.0, 1.0, 0.0, if light_change > 0.0 { 0.0 } else { 1.0 }];
        let (count, tile_count) = (pixels as usize, tiles as usize);
        let mut four = |low: f32, high: f32| {
            let mut side = || low + (high - low) * number();
            Vec4::new(side(), side(), side(), side())
        };
        let key = |four: Vec4, normal: Vec4| {
            Key {
                albedo: if four.x < 0.2 { 0.0 } else { four.x },
                normal: Quat::from_rotation_x(1.2 * normal.x)
                    * Quat::from_rotation_y(6.0 * normal.y)
                    * Vec3::Z,
                depth: 2.0 + 0.05 * four.y,
                spread: 0.05 * four.z,
                frames: if four.w < 0.1 { 0.0 } else { 30.0 * four.w },
                // Some are between others' in the last frame.
                light: if normal.w < -0.8 {
                    -0.3
                } else {
                    0.5 + 0.5 * normal.z
                } * Vec2::new(0.5 + 0.5 * normal.y, 0.5 - 0.5 * normal.y),
            }
            .pack()
        };
        let keys = (0..KEYS as usize * count)
            .map(|_| key(four(0.0, 1.0), four(-1.0, 1.0)))
            .collect();
        let state = (0..(STATE + LIGHTS) as usize * count)
            .map(|_| four(0.0, 1.0))
            .collect();
        let counts = (0..COUNTS as usize * count)
            .map(|_| four(0.0, 1.0))
            .map(|v| Vec2::new(if v.x < 0.1 { 0.0 } else { 30.0 * v.x }, v.y))
            .collect();
        let tiles = (0..TILES as usize * tile_count)
            .map(|_| four(0.0, 1.0))
            .collect();
        let noisy = (0..2 * count)
            .map(|i| match i % 97 {
                5 => Vec4::new(f32::NAN, 0.0, 0.0, 0.0),
                50 => Vec4::splat(f32::INFINITY),
                _ => four(0.0, 1.0),
            })
            .collect();
        Self {
            mode: settings.mode,
            radius: settings.pass_radius(),
            uniform,
            state,
            keys,
            counts,
            tiles,
            noisy,
            output: vec![Vec4::ZERO; count],
        }
    }

    fn is_paper(&self) -> bool {
        matches!(self.mode, DenoiseMode::Paper(_))
    }

    /// Names of the passes, in their order.
    pub fn passes(&self) -> Vec<&'static str> {
        Passes::entries(self.is_paper()).to_vec()
    }

    /// Runs a pass's twin.
    ///
    /// # Panics
    /// If there is no such pass.
    pub fn run_twin(&mut self, pass: &str) {
        match pass {
            "near" => self.near(),
            "first_step" => self.first_step(),
            "second_step" => self.second_step(),
            "reproject" => self.reproject(),
            "add_rows" => self.add_rows(),
            "judge" => self.judge(),
            "blend" => self.blend(),
            "stereo" => self.stereo(),
            "prefilter" => self.prefilter(),
            "gather" => self.gather(),
            _ => panic!("there is no pass {pass}"),
        }
    }

    /// Runs a pass's kernel.
    ///
    /// # Errors
    /// If it doesn't compile or the device fails.
    pub fn run_kernel(&mut self, gpu: &Gpu, pass: &'static str) -> Result<(), RenderError> {
        let passes = Passes::new(gpu, self.is_paper(), self.radius, Some(pass))?;
        let sizes = [0, 1].map(|eye| self.size(eye).to_array());
        let (state, lights) = self.state.split_at(STATE as usize * self.pixels());
        let contents: [&[u8]; 8] = [
            bytemuck::bytes_of(&self.uniform),
            &bytes(state, |v| v.to_array()),
            bytemuck::cast_slice(&self.keys),
            &bytes(&self.counts, |v| v.to_array()),
            &bytes(&self.tiles, |v| v.to_array()),
            &bytes(&self.noisy, |v| v.to_array()),
            &bytes(&self.output, |v| v.to_array()),
            &bytes(lights, |v| v.to_array()),
        ];
        let buffers = gpu.scoped("a pass", 0, || {
            let mut usage = wgpu::BufferUsages::UNIFORM;
            contents.map(|contents| {
                let buffer = gpu.filled("a pass", contents, usage);
                usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC;
                buffer
            })
        })?;
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        passes.record(gpu, &mut encoder, &sizes, buffers.each_ref())?;
        gpu.queue.submit([encoder.finish()]);
        let read = |i: usize| gpu.read_buffer("a pass", &buffers[i], buffers[i].size());
        self.state = vectors(&read(1)?, Vec4::from_array);
        self.state.extend(vectors(&read(7)?, Vec4::from_array));
        self.keys = vectors(&read(2)?, |v| v);
        self.counts = vectors(&read(3)?, Vec2::from_array);
        self.tiles = vectors(&read(4)?, Vec4::from_array);
        self.output = vectors(&read(6)?, Vec4::from_array);
        Ok(())
    }

    /// How many values differ from those before a pass; the first that differs from the twin's.
    ///
    /// # Errors
    /// The place and the values of both, if they differ by more than roundings explain.
    pub fn compare(&self, twin: &Self, before: &Self) -> Result<usize, String> {
        /// Roundings of f32 through a few dozen operations, some of them differences.
        const TOLERANCE: f32 = 3e-4;
        /// As halves: one unit in the last place of them.
        const HALF_TOLERANCE: f32 = 1e-3;
        let mut changed = 0;
        let named = [
            ("state", self.state(), twin.state(), before.state()),
            ("keys", self.words(), twin.words(), before.words()),
            ("counts", self.counts(), twin.counts(), before.counts()),
            ("tiles", self.tiles(), twin.tiles(), before.tiles()),
            ("output", self.output(), twin.output(), before.output()),
        ];
        for (name, kernel, twin, before) in named {
            let tolerance = if name == "keys" {
                HALF_TOLERANCE
            } else {
                TOLERANCE
            };
            // Tiles sum up eight pixels and more.
            let least = if name == "tiles" { 0.8 } else { 0.1 };
            for (i, ((a, b), c)) in kernel.iter().zip(&twin).zip(&before).enumerate() {
                let scale = a.abs().max(b.abs()).max(least);
                // NaN is close to nothing but the same NaN.
                let is_close = (a - b).abs() <= tolerance * scale;
                if a.to_bits() != b.to_bits() && !is_close {
                    return Err(format!("{name}[{i}]: {a} of the kernel, {b} of its twin"));
                }
                changed += usize::from(a.to_bits() != c.to_bits());
            }
        }
        Ok(changed)
    }

    fn state(&self) -> Vec<f32> {
        self.state.iter().flat_map(|v| v.to_array()).collect()
    }

    /// Keys as what they stand for.
    fn words(&self) -> Vec<f32> {
        let of = |words: &[u32; 4]| {
            let key = Key::unpack(*words);
            let is_between = f32::from(words[0] & BETWEEN != 0);
            let Vec3 { x, y, z } = key.normal;
            let light = key.light.element_sum();
            let part = key.light.x / light.max(1e-20);
            let rest = [key.frames, light, is_between];
            // Of 12 and of 8 bits, one of which may differ.
            let coarse = [0.05 * x, 0.05 * y, 0.05 * z, 0.02 * part];
            [[key.albedo, key.depth, key.spread], rest]
                .concat()
                .into_iter()
                .chain(coarse)
        };
        self.keys.iter().flat_map(of).collect()
    }

    fn counts(&self) -> Vec<f32> {
        self.counts.iter().flat_map(|v| v.to_array()).collect()
    }

    fn tiles(&self) -> Vec<f32> {
        self.tiles.iter().flat_map(|v| v.to_array()).collect()
    }

    fn output(&self) -> Vec<f32> {
        self.output.iter().flat_map(|v| v.to_array()).collect()
    }
}

fn bytes<T: Copy, const N: usize>(values: &[T], array: fn(&T) -> [f32; N]) -> Vec<u8> {
    let floats = values.iter().flat_map(array);
    floats.flat_map(f32::to_le_bytes).collect()
}

fn vectors<T, A: Pod>(bytes: &[u8], of: fn(A) -> T) -> Vec<T> {
    let values: Vec<A> = bytemuck::pod_collect_to_vec(bytes);
    values.into_iter().map(of).collect()
}
