//! From light on the sensor to 8-bit codes, and what compression leaves of them.

/// A camera's tone curve, from linear light in 0 … 1 to a code in 0 … 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Curve {
    /// sRGB.
    Srgb,
    /// A power and an S-shaped contrast on top, as cameras have it.
    Contrast {
        /// code = light^(1/γ) before the contrast.
        gamma: f64,
        /// Share of the S, 0 … 1.
        strength: f64,
    },
}

impl Curve {
    /// Code of linear light.
    pub fn encode(self, light: f64) -> f64 {
        match self {
            Self::Srgb if light <= 0.003_130_8 => 12.92 * light,
            Self::Srgb => 1.055 * light.powf(1.0 / 2.4) - 0.055,
            Self::Contrast { gamma, strength } => {
                let v = light.powf(1.0 / gamma);
                strength * v * v * (3.0 - 2.0 * v) + (1.0 - strength) * v
            }
        }
    }
}

/// Noise and coding.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// Tone curve.
    pub curve: Curve,
    /// Electrons at clipping: shot noise has the square root of what arrives. 0: none.
    pub full_well: f64,
    /// Read noise, electrons.
    pub read_noise: f64,
    /// Whether colour is stored at half the resolution, as in 4:2:0 video.
    pub half_colour: bool,
    /// Step of the coefficients of 8 × 8 blocks, in codes of 255, as a video coder's quantiser
    /// has it; 0: none.
    pub quantiser: f64,
}

impl Default for Sensor {
    /// A small sensor, sRGB, 4:2:0, lightly compressed.
    fn default() -> Self {
        Self {
            curve: Curve::Srgb,
            full_well: 8000.0,
            read_noise: 4.0,
            half_colour: true,
            quantiser: 4.0,
        }
    }
}

/// Random numbers of one picture (PCG, O'Neill 2014).
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        let old = self.0;
        self.0 = old
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        let word = (((old >> 18) ^ old) >> 27) as u32;
        f64::from(word.rotate_right((old >> 59) as u32)) / 4_294_967_296.0
    }

    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

impl Sensor {
    /// Codes of linear light (1 clips), row-major.
    pub fn develop(
        &self,
        width: usize,
        height: usize,
        light: &[[f64; 3]],
        seed: u64,
    ) -> Vec<[u8; 3]> {
        let mut random = Random(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
        let mut codes: Vec<[f64; 3]> = light
            .iter()
            .map(|rgb| {
                rgb.map(|l| {
                    let mut l = l.max(0.0);
                    if self.full_well > 0.0 {
                        // Light far beyond clipping has no noise that shows.
                        let electrons = l.min(4.0) * self.full_well;
                        let sigma = (electrons + self.read_noise * self.read_noise).sqrt();
                        l += sigma * random.normal() / self.full_well;
                    }
                    255.0 * self.curve.encode(l.clamp(0.0, 1.0))
                })
            })
            .collect();
        if self.half_colour || self.quantiser > 0.0 {
            self.code(width, height, &mut codes);
        }
        let byte = |c: f64| c.round().clamp(0.0, 255.0) as u8;
        codes.iter().map(|rgb| rgb.map(byte)).collect()
    }

    /// To luma and colour difference (BT.601, full range), each coded, and back.
    fn code(&self, width: usize, height: usize, codes: &mut [[f64; 3]]) {
        let mut planes: [Vec<f64>; 3] = [0, 1, 2].map(|_| Vec::with_capacity(codes.len()));
        for [r, g, b] in codes.iter() {
            let y = 0.299 * r + 0.587 * g + 0.114 * b;
            planes[0].push(y);
            planes[1].push((b - y) / 1.772);
            planes[2].push((r - y) / 1.402);
        }
        for (i, plane) in planes.iter_mut().enumerate() {
            if i > 0 && self.half_colour {
                halve(width, height, plane);
            }
            if self.quantiser > 0.0 {
                quantise(width, height, plane, self.quantiser);
            }
        }
        for (i, code) in codes.iter_mut().enumerate() {
            // Planes hold whole numbers in 8 bits.
            let [y, cb, cr] = [0, 1, 2].map(|c| planes[c][i].round());
            *code = [
                y + 1.402 * cr,
                y - 0.344_136 * cb - 0.714_136 * cr,
                y + 1.772 * cb,
            ];
        }
    }
}

/// Means of 2 × 2 in place of each of them.
fn halve(width: usize, height: usize, plane: &mut [f64]) {
    for y in (0..height).step_by(2) {
        for x in (0..width).step_by(2) {
            let corners = [(0, 0), (1, 0), (0, 1), (1, 1)]
                .map(|(dx, dy)| (x + dx).min(width - 1) + width * (y + dy).min(height - 1));
            let mean = corners.iter().map(|&i| plane[i]).sum::<f64>() / 4.0;
            corners.iter().for_each(|&i| plane[i] = mean);
        }
    }
}

/// Rounds the cosine coefficients of 8 × 8 blocks to multiples of a step, coarser for finer detail.
fn quantise(width: usize, height: usize, plane: &mut [f64], step: f64) {
    const N: usize = 8;
    let basis: [[f64; N]; N] = std::array::from_fn(|k| {
        std::array::from_fn(|i| {
            let scale = if k == 0 { 1.0_f64 } else { 2.0 };
            let angle = std::f64::consts::PI * (i as f64 + 0.5) * k as f64 / N as f64;
            (scale / N as f64).sqrt() * angle.cos()
        })
    });
    for by in (0..height).step_by(N) {
        for bx in (0..width).step_by(N) {
            let at =
                |x: usize, y: usize| (bx + x).min(width - 1) + width * (by + y).min(height - 1);
            let mut block = [[0.0; N]; N];
            for (v, row) in block.iter_mut().enumerate() {
                for (u, coefficient) in row.iter_mut().enumerate() {
                    let mut sum = 0.0;
                    for y in 0..N {
                        for x in 0..N {
                            sum += plane[at(x, y)] * basis[u][x] * basis[v][y];
                        }
                    }
                    let step = step * (1.0 + 0.25 * (u + v) as f64);
                    *coefficient = (sum / step).round() * step;
                }
            }
            for y in 0..N.min(height - by) {
                for x in 0..N.min(width - bx) {
                    let mut sum = 0.0;
                    for (v, row) in block.iter().enumerate() {
                        for (u, coefficient) in row.iter().enumerate() {
                            sum += coefficient * basis[u][x] * basis[v][y];
                        }
                    }
                    plane[at(x, y)] = sum;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quiet_sensor_codes_srgb() {
        let sensor = Sensor {
            full_well: 0.0,
            half_colour: false,
            quantiser: 0.0,
            ..Sensor::default()
        };
        let codes = sensor.develop(4, 1, &[[0.0; 3], [0.214; 3], [1.0; 3], [1e9; 3]], 1);
        assert_eq!(codes, [[0; 3], [127; 3], [255; 3], [255; 3]]);
    }

    #[test]
    fn noise_has_the_size_that_physics_says() {
        let sensor = Sensor {
            half_colour: false,
            quantiser: 0.0,
            ..Sensor::default()
        };
        let codes = sensor.develop(100, 100, &vec![[0.5; 3]; 10_000], 7);
        let mean = codes.iter().map(|c| f64::from(c[1])).sum::<f64>() / 1e4;
        let variance = codes
            .iter()
            .map(|c| (f64::from(c[1]) - mean).powi(2))
            .sum::<f64>()
            / 1e4;
        // σ of light is √(0.5/8000); the curve's slope there is 0.68, and rounding adds 1/12.
        let expected = (255.0 * 0.68 * (0.5_f64 / 8000.0).sqrt()).powi(2) + 1.0 / 12.0;
        assert!(
            (variance / expected - 1.0).abs() < 0.1,
            "{variance} {expected}"
        );
    }

    #[test]
    fn coding_keeps_the_mean_and_loses_the_detail() {
        let sensor = Sensor {
            full_well: 0.0,
            quantiser: 12.0,
            ..Sensor::default()
        };
        let light: Vec<[f64; 3]> = (0..64 * 64)
            .map(|i| {
                [
                    0.3 + 0.02 * f64::from(i % 2),
                    0.3,
                    0.2 + 0.001 * f64::from(i % 64),
                ]
            })
            .collect();
        let plain = Sensor {
            half_colour: false,
            quantiser: 0.0,
            ..sensor
        };
        let (a, b) = (
            sensor.develop(64, 64, &light, 1),
            plain.develop(64, 64, &light, 1),
        );
        assert_ne!(a, b);
        let mean = |codes: &[[u8; 3]], c: usize| {
            codes.iter().map(|z| f64::from(z[c])).sum::<f64>() / codes.len() as f64
        };
        for c in 0..3 {
            assert!((mean(&a, c) - mean(&b, c)).abs() < 1.5);
        }
    }
}
