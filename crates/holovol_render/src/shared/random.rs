//! Twin of `random.wgsl`.

/// Three random words from three.
pub fn pcg3d([x, y, z]: [u32; 3]) -> [u32; 3] {
    let step = |v: u32| v.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
    let mingle = |[x, y, z]: [u32; 3]| {
        let x = x.wrapping_add(y.wrapping_mul(z));
        let y = y.wrapping_add(z.wrapping_mul(x));
        [x, y, z.wrapping_add(x.wrapping_mul(y))]
    };
    let half = mingle([step(x), step(y), step(z)]);
    mingle(half.map(|v| v ^ (v >> 16)))
}

/// 31 bits as a number in (0, 1), at the middle of their interval.
pub fn unit_float(bits: u32) -> f32 {
    let whole = (bits >> 1) as f32 * (-31f32).exp2() + (-32f32).exp2();
    whole.min(1.0 - (-24f32).exp2())
}

/// Owen scrambling of reversed bits.
pub fn owen_scramble_reversed(bits: u32, seed: u32) -> u32 {
    let mut x = bits ^ bits.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^ x.wrapping_mul(0x53a2_2864)
}

/// Second dimension of Sobol's sequence, bits reversed.
pub fn sobol_second_reversed(index: u32) -> u32 {
    let mut x = index;
    for (mask, shift) in [
        (0xffff_0000, 16),
        (0xff00_ff00, 8),
        (0xf0f0_f0f0, 4),
        (0xcccc_cccc, 2),
        (0xaaaa_aaaa, 1),
    ] {
        x ^= (x & mask) >> shift;
    }
    x
}

/// Where a pixel stands along a Z-shaped curve through its block of 16 × 16.
pub fn z_order(pixel: [u32; 2]) -> u32 {
    let [x, y] = pixel.map(|v| {
        let v = v & 15;
        let v = (v | v << 2) & 0x33;
        (v | v << 1) & 0x55
    });
    x | y << 1
}

/// Point `index` of the sequence of a seed.
pub fn sobol_pair(index: u32, seed: u32) -> [f32; 2] {
    let seeds = pcg3d([seed, 0x2545_f491, 0x9e37_79b9]);
    let shuffled = owen_scramble_reversed(index.reverse_bits(), seeds[0]).reverse_bits();
    let x = owen_scramble_reversed(shuffled, seeds[1]).reverse_bits();
    let y = owen_scramble_reversed(sobol_second_reversed(shuffled), seeds[2]).reverse_bits();
    [unit_float(x), unit_float(y)]
}
