// Random numbers as a pure function of pixel, sample and dimension.
#define_import_path holovol_render::random

// 2^-31 and half of it: 31 bits make a float in (0, 1), at the middle of their interval. Small ones
// keep all their digits: a grid of 2^-24 with 0 would bias events rarer than 1e-5.
const UNIT_FROM_31_BITS: f32 = 4.656612873077393e-10;
const HALF_A_STEP: f32 = 2.3283064365386963e-10;
const BELOW_ONE: f32 = 0.99999994;

// Jarzynski and Olano 2020, "Hash Functions for GPU Rendering", pcg3d.
fn pcg3d(key: vec3<u32>) -> vec3<u32> {
    var v = key * 1664525u + 1013904223u;
    v.x += v.y * v.z;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v ^= v >> vec3<u32>(16u);
    v.x += v.y * v.z;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    return v;
}

fn unit_float(bits: u32) -> f32 {
    return min(f32(i32(bits >> 1u)) * UNIT_FROM_31_BITS + HALF_A_STEP, BELOW_ONE);
}

fn unit_float_pair(bits: vec2<u32>) -> vec2<f32> {
    let signed = vec2<i32>(bits >> vec2<u32>(1u));
    return min(vec2<f32>(signed) * UNIT_FROM_31_BITS + HALF_A_STEP, vec2<f32>(BELOW_ONE));
}

fn unit_float_triple(bits: vec3<u32>) -> vec3<f32> {
    let signed = vec3<i32>(bits >> vec3<u32>(1u));
    return min(vec3<f32>(signed) * UNIT_FROM_31_BITS + HALF_A_STEP, vec3<f32>(BELOW_ONE));
}

// Owen scrambling of reversed bits by a hash that only carries upwards: Laine and Karras 2011,
// "Stratified Sampling for Stochastic Transparency", constants by Vegdahl 2021.
fn owen_scramble_reversed(bits: u32, seed: u32) -> u32 {
    var x = bits ^ (bits * 0x3d20adeau);
    x += seed;
    x *= (seed >> 16u) | 1u;
    x ^= x * 0x05526c56u;
    x ^= x * 0x53a22864u;
    return x;
}

// Second dimension of Sobol's sequence, bits reversed: the Pascal matrix modulo 2 as five
// butterflies.
fn sobol_second_reversed(index: u32) -> u32 {
    var x = index;
    x ^= (x & 0xffff0000u) >> 16u;
    x ^= (x & 0xff00ff00u) >> 8u;
    x ^= (x & 0xf0f0f0f0u) >> 4u;
    x ^= (x & 0xccccccccu) >> 2u;
    x ^= (x & 0xaaaaaaaau) >> 1u;
    return x;
}

// Where a pixel stands along a Z-shaped curve through its block of 16 x 16.
fn z_order(pixel: vec2<u32>) -> u32 {
    var v = pixel & vec2<u32>(15u);
    v = (v | v << vec2<u32>(2u)) & vec2<u32>(0x33u);
    v = (v | v << vec2<u32>(1u)) & vec2<u32>(0x55u);
    return v.x | v.y << 1u;
}

// Point `index` of a shuffled, Owen-scrambled Sobol sequence in two dimensions: Burley 2020,
// "Practical Hash-based Owen Scrambling". Different seeds give independent sequences.
fn sobol_pair(index: u32, seed: u32) -> vec2<f32> {
    let seeds = pcg3d(vec3<u32>(seed, 0x2545f491u, 0x9e3779b9u));
    let shuffled = reverseBits(owen_scramble_reversed(reverseBits(index), seeds.x));
    let x = reverseBits(owen_scramble_reversed(shuffled, seeds.y));
    let y = reverseBits(owen_scramble_reversed(sobol_second_reversed(shuffled), seeds.z));
    return unit_float_pair(vec2<u32>(x, y));
}
