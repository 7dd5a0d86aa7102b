// What all passes of the denoiser share: bindings, packed guides, and the distance between guides.
#define_import_path holovol_render::denoise::common

// One eye. A ray through pixel position (x, y) is direction + x * dx + y * dy, of length 1 along
// the eye's axis, in world space; a position is that times its depth, seen from the eye.
struct Eye {
    direction: vec4<f32>,
    direction_dx: vec4<f32>,
    direction_dy: vec4<f32>,
    // Rows of what turns such a position into (depth * x, depth * y, depth) of the previous frame
    // (volume moved back), and of the other eye in this frame.
    previous_x: vec4<f32>,
    previous_y: vec4<f32>,
    previous_depth: vec4<f32>,
    other_x: vec4<f32>,
    other_y: vec4<f32>,
    other_depth: vec4<f32>,
    // Rows of what turns a normal back with the volume; w of the first: size of a pixel at depth 1.
    turn_x: vec4<f32>,
    turn_y: vec4<f32>,
    turn_z: vec4<f32>,
    // x, y: pixels across and down; z: first pixel in the accumulators; w: first pixel here.
    image: vec4<u32>,
    // x: samples of this frame; y: HISTORY flags; z: first tile; w: tiles across.
    frame: vec4<u32>,
    // x: frames of history that may be kept; y: factor on it; z: change of light T; w: factor on
    // what tiles remember.
    history: vec4<f32>,
    // x: which of the tracer's views it is; yzw: pixels across and down of the last frame, and its
    // first pixel there.
    place: vec4<u32>,
    // Where the last frame's eye stood, seen from this one, the volume held still; w: unused.
    before: vec4<f32>,
}

struct Denoise {
    eyes: array<Eye, 2>,
    // x: eyes; y: pixels of a half, those of all eyes at least; z: tiles, likewise; w: unused.
    counts: vec4<u32>,
    // Which half, 0 or 1, is x: this frame's, y: the last one's, z: this frame's of the tiles; w: 1 if
    // guides are this frame's, 0 if they are those of a view at rest.
    halves: vec4<u32>,
    // Change of the estimate that a unit of each is expected to make, squared and relative:
    // x: pixel^2; y: 1 - cosine of normals; z: depth by spread, squared; w: relative opacity^2.
    bias: vec4<f32>,
    // Squared and relative, likewise: x: between frames and y: between eyes, times the distance of
    // guides; z: of the other eye in any case; w: variance of one frame before it is known.
    across: vec4<f32>,
    // x: gain of the tiles' correction, y: how much a correction shortens the history,
    // z: what radiance counts as dark, squared; w: memory of the filter's weight, per frame.
    tiles: vec4<f32>,
    // Bias of light that differs x: in the last frame's filtered image, y: in this frame's own;
    // z: factor on what guides of the last frame must agree, per radian that a place has turned;
    // w: of light as the guides expect it.
    edges: vec4<f32>,
    // xyz: toward the dominant light, world space; w: 0 if there is no guide of light.
    sun: vec4<f32>,
    // What that guide has x: of the dominant light, y: of the light grid; 0 of what it doesn't know;
    // z: 1 if the last frame's was of the same, else 0; w: texels along a cell of the grid.
    light: vec4<f32>,
}

const HISTORY_NONE: u32 = 0u;
const HISTORY_MOVED: u32 = 1u;
const HISTORY_SAME: u32 = 2u;

// Light is what radiance is per albedo, kept away from division by none.
const ALBEDO_FLOOR: f32 = 0.5;
// Beyond this, squares of light would leave f32.
const LARGEST: f32 = 1e15;
const TILE: u32 = 8u;
// What "frames" are counted in: a frame of four samples is worth two.
const SAMPLES_PER_FRAME: f32 = 2.0;

@group(0) @binding(16) var<uniform> denoise: Denoise;
// Per pixel: a half for this frame and one for the last of what is kept: light, and opacity less the
// guide's (in the paper's mode radiance and opacity).
@group(0) @binding(17) var<storage, read_write> state: array<vec4<f32>>;
// Per pixel: two halves of guides, see Key; then guides with the frames of both eyes.
@group(0) @binding(18) var<storage, read_write> keys: array<vec4<u32>>;
// Per pixel: two halves of (frames, filtered light); then (frames, filtered light) of the history.
// A frame is one of two samples: SAMPLES_PER_FRAME.
@group(0) @binding(19) var<storage, read_write> counts: array<vec2<f32>>;
@group(0) @binding(20) var<storage, read_write> tiles: array<vec4<f32>>;
// Two sums per pixel, as the tracer leaves them.
@group(0) @binding(21) var<storage, read> noisy: array<vec4<f32>>;
@group(0) @binding(22) var<storage, read_write> output: array<vec4<f32>>;
// Per pixel, of this frame alone: albedo * opacity with opacity; then two that the passes hand on. Not
// with what is kept, so that no binding holds more than 48 bytes of a pixel: two eyes of a headset
// fit the 128 MiB that every device binds.
@group(0) @binding(23) var<storage, read_write> lights: array<vec4<f32>>;

fn half_now() -> u32 { return denoise.halves.x * denoise.counts.y; }
fn half_before() -> u32 { return denoise.halves.y * denoise.counts.y; }
fn albedo_at(pixel: u32) -> u32 { return pixel; }
fn scratch_at(pixel: u32) -> u32 { return denoise.counts.y + pixel; }
fn near_at(pixel: u32) -> u32 { return 2u * denoise.counts.y + pixel; }
fn both_at(pixel: u32) -> u32 { return 2u * denoise.counts.y + pixel; }

struct Key {
    // Mean of albedo * opacity over R, G, B; 0: nothing was met.
    albedo: f32,
    normal: vec3<f32>,
    // Metres along the eye's axis, and its standard deviation.
    depth: f32,
    spread: f32,
    // Frames that the estimate is worth.
    frames: f32,
    // What light is expected to be, but for factors: of the dominant source and of the light grid.
    light: vec2<f32>,
}

// Of what was met; halves smaller than this lose digits.
const LEAST_ALBEDO: f32 = 1e-4;

// In the first word, as the sign of light: no ray of the march made this guide, those around did.
const BETWEEN: u32 = 0x80000000u;

fn is_marched(first_word: u32) -> bool {
    return (first_word & 0xffffu) != 0u && (first_word & BETWEEN) == 0u;
}

fn is_met(words: vec4<u32>) -> bool {
    return (words.x & 0xffffu) != 0u;
}

// Octahedral (Cigolle et al. 2014), 12 bits each above 8 that are left free.
fn pack_normal(n: vec3<f32>) -> u32 {
    let p = n.xy / max(abs(n.x) + abs(n.y) + abs(n.z), 1e-20);
    let folded = (1.0 - abs(p.yx)) * select(vec2<f32>(-1.0), vec2<f32>(1.0), p >= vec2<f32>(0.0));
    let unit = clamp(select(p, folded, n.z < 0.0), vec2<f32>(-1.0), vec2<f32>(1.0));
    let steps = vec2<u32>(round((unit + 1.0) * 2047.0));
    return steps.x << 20u | steps.y << 8u;
}

fn unpack_normal(word: u32) -> vec3<f32> {
    let p = vec2<f32>(f32(word >> 20u), f32((word >> 8u) & 0xfffu)) / 2047.0 - 1.0;
    let z = 1.0 - abs(p.x) - abs(p.y);
    let t = max(-z, 0.0);
    let xy = p + select(vec2<f32>(t), vec2<f32>(-t), p >= vec2<f32>(0.0));
    let n = vec3<f32>(xy, z);
    return n * inverseSqrt(dot(n, n));
}

fn pack_key(key: Key) -> vec4<u32> {
    let relative_spread = min(key.spread / max(key.depth, 1e-30), 60000.0);
    let light = key.light.x + key.light.y;
    return vec4<u32>(
        pack2x16float(vec2<f32>(key.albedo, light)),
        pack_normal(key.normal) | u32(round(255.0 * key.light.x / max(light, 1e-20))),
        bitcast<u32>(key.depth),
        pack2x16float(vec2<f32>(relative_spread, min(key.frames, 60000.0))),
    );
}

fn unpack_key(words: vec4<u32>) -> Key {
    let first = unpack2x16float(words.x);
    let pair = unpack2x16float(words.w);
    let depth = bitcast<f32>(words.z);
    return Key(first.x, unpack_normal(words.y), depth, depth * pair.x, pair.y, light_parts(words));
}

// Of the dominant source and of the light grid.
fn light_parts(words: vec4<u32>) -> vec2<f32> {
    let light = abs(unpack2x16float(words.x).y);
    let part = f32(words.y & 0xffu) / 255.0;
    return light * vec2<f32>(part, 1.0 - part);
}

// Of both parts together, share of it being the second's factor: 0.5 counts them alike.
fn expected_light(light: vec2<f32>, share: f32) -> f32 {
    return 2.0 * mix(light.x, light.y, share);
}

fn with_frames(words: vec4<u32>, frames: f32) -> vec4<u32> {
    let spread = unpack2x16float(words.w).x;
    return vec4<u32>(words.xyz, pack2x16float(vec2<f32>(spread, min(frames, 60000.0))));
}

// How much the estimates at two guides are expected to differ, squared and relative.
fn guide_distance(a: Key, b: Key, pixel_size: f32) -> f32 {
    let slack = a.spread + b.spread + 2.0 * pixel_size * a.depth + 1e-30;
    let depth = (b.depth - a.depth) / slack;
    let opacity = b.albedo - a.albedo;
    let sum = b.albedo + a.albedo;
    return denoise.bias.y * (1.0 - dot(a.normal, b.normal))
        + denoise.bias.z * min(depth * depth, 50.0)
        + denoise.bias.w * 4.0 * opacity * opacity / (sum * sum + 1e-4);
}

fn direction_of(v: vec3<f32>) -> vec3<f32> {
    return v * inverseSqrt(max(dot(v, v), 1e-30));
}

fn is_finite(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u;
}

fn all_finite(v: vec4<f32>) -> bool {
    return is_finite(v.x) && is_finite(v.y) && is_finite(v.z) && is_finite(v.w);
}

fn mean_rgb(v: vec3<f32>) -> f32 {
    return (v.x + v.y + v.z) * (1.0 / 3.0);
}

// What the tiles say at a pixel: bilinear between their middles. part: 0 or 1.
fn tile_at(eye: u32, position: vec2<u32>, part: u32) -> vec4<f32> {
    let across = denoise.eyes[eye].frame.w;
    let down = (denoise.eyes[eye].image.y + TILE - 1u) / TILE;
    let last = vec2<i32>(i32(across), i32(down)) - 1;
    let middle = (vec2<f32>(position) + 0.5) / f32(TILE) - 0.5;
    let base = floor(middle);
    let weight = middle - base;
    let low = clamp(vec2<i32>(base), vec2<i32>(0), last);
    let high = clamp(vec2<i32>(base) + 1, vec2<i32>(0), last);
    let first = tile_result(part) + denoise.eyes[eye].frame.z;
    let v00 = tiles[first + u32(low.x) + across * u32(low.y)];
    let v10 = tiles[first + u32(high.x) + across * u32(low.y)];
    let v01 = tiles[first + u32(low.x) + across * u32(high.y)];
    let v11 = tiles[first + u32(high.x) + across * u32(high.y)];
    return mix(mix(v00, v10, weight.x), mix(v01, v11, weight.x), weight.y);
}

// Tiles: six vectors of sums, four of memory by halves, three of results; then of their rows.
fn tile_sums(part: u32) -> u32 { return part * denoise.counts.z; }
fn tile_memory(now: bool, part: u32) -> u32 {
    let half = select(1u - denoise.halves.z, denoise.halves.z, now);
    return (6u + 2u * part + half) * denoise.counts.z;
}
fn tile_result(part: u32) -> u32 { return (14u + part) * denoise.counts.z; }
fn tile_rows(part: u32) -> u32 { return (17u + TILE * part) * denoise.counts.z; }
