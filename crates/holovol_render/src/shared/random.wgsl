// Random numbers as a pure function of pixel, sample and dimension.
#define_import_path holovol_render::random

// 2^-24: 24 random bits make a float in [0, 1) without rounding up to 1.
const UNIT_FROM_24_BITS: f32 = 5.9604644775390625e-8;

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
    return f32(bits >> 8u) * UNIT_FROM_24_BITS;
}

fn unit_float_pair(bits: vec2<u32>) -> vec2<f32> {
    return vec2<f32>(bits >> vec2<u32>(8u)) * UNIT_FROM_24_BITS;
}

fn unit_float_triple(bits: vec3<u32>) -> vec3<f32> {
    return vec3<f32>(bits >> vec3<u32>(8u)) * UNIT_FROM_24_BITS;
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

// Point `index` of a shuffled, Owen-scrambled Sobol sequence in two dimensions: Burley 2020,
// "Practical Hash-based Owen Scrambling". Different seeds give independent sequences.
fn sobol_pair(index: u32, seed: u32) -> vec2<f32> {
    let seeds = pcg3d(vec3<u32>(seed, 0x2545f491u, 0x9e3779b9u));
    let shuffled = reverseBits(owen_scramble_reversed(reverseBits(index), seeds.x));
    let x = reverseBits(owen_scramble_reversed(shuffled, seeds.y));
    let y = reverseBits(owen_scramble_reversed(sobol_second_reversed(shuffled), seeds.z));
    return unit_float_pair(vec2<u32>(x, y));
}
