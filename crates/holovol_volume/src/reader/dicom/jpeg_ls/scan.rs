//! The entropy-coded part of a JPEG-LS image: contexts, predictions, runs.

use super::{Parameters, Problem};

/// One more than the highest context: 364 of gradients and two of runs.
const CONTEXTS: usize = 365;
const RUN_CONTEXTS: usize = 2;

/// Where a prediction is corrected at most to.
const CORRECTION_RANGE: std::ops::RangeInclusive<i32> = -128..=127;

/// Run lengths double along this table (code table A.7.1.1).
const J: [u32; 32] = [
    0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7, 8, 9, 10, 11, 12, 13,
    14, 15,
];

/// Bits of a scan; a 0 is stuffed after each byte of ones.
struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
    buffer: u64,
    count: u32,
    previous_is_ff: bool,
    /// Bits that were made up after the end.
    beyond: u32,
}

impl Bits<'_> {
    fn fill(&mut self) {
        while self.count <= 48 {
            let byte = match self.bytes.get(self.at) {
                // A marker ends the scan.
                Some(&byte) if !(self.previous_is_ff && byte >= 0x80) => byte,
                _ => {
                    self.beyond += 8;
                    self.buffer <<= 8;
                    self.count += 8;
                    continue;
                }
            };
            self.at += 1;
            let width = if self.previous_is_ff { 7 } else { 8 };
            self.buffer = self.buffer << width | u64::from(byte);
            self.count += width;
            self.previous_is_ff = byte == 0xff;
        }
    }

    fn take(&mut self, count: u32) -> Result<u32, Problem> {
        if count == 0 {
            return Ok(0);
        }
        if self.count < count {
            self.fill();
        }
        self.count -= count;
        if self.count < self.beyond {
            return Err("the scan is cut off");
        }
        Ok((self.buffer >> self.count) as u32 & ((1u32 << count) - 1))
    }

    /// The number of zeros before the next one, at most `limit`.
    fn zeros(&mut self, limit: u32) -> Result<u32, Problem> {
        let mut zeros = 0;
        loop {
            if self.count == 0 {
                self.fill();
            }
            let window = self.buffer << (64 - self.count);
            let here = window.leading_zeros().min(self.count);
            zeros += here;
            if zeros > limit {
                return Err("a code is longer than any");
            }
            self.count -= here;
            if self.count > 0 {
                self.count -= 1;
                if self.count < self.beyond {
                    return Err("the scan is cut off");
                }
                return Ok(zeros);
            }
            if self.beyond > 0 {
                return Err("the scan is cut off");
            }
        }
    }
}

#[derive(Clone, Copy)]
struct Context {
    a: i32,
    b: i32,
    c: i32,
    n: i32,
}

pub(super) struct Scan<'a> {
    parameters: Parameters,
    bits: Bits<'a>,
    contexts: Vec<Context>,
    run_contexts: [Context; RUN_CONTEXTS],
    /// Negative run interruptions per context.
    run_negatives: [i32; RUN_CONTEXTS],
    run_index: usize,
}

impl<'a> Scan<'a> {
    pub fn new(parameters: Parameters, bytes: &'a [u8]) -> Self {
        let context = Context {
            a: ((parameters.range + 32) / 64).max(2),
            b: 0,
            c: 0,
            n: 1,
        };
        Self {
            parameters,
            bits: Bits {
                bytes,
                at: 0,
                buffer: 0,
                count: 0,
                previous_is_ff: false,
                beyond: 0,
            },
            contexts: vec![context; CONTEXTS],
            run_contexts: [context; RUN_CONTEXTS],
            run_negatives: [0; RUN_CONTEXTS],
            run_index: 0,
        }
    }

    pub fn image(mut self, width: usize, height: usize) -> Result<Vec<u16>, Problem> {
        let mut samples: Vec<u16> = Vec::new();
        // A column more on either side, so that every sample has its neighbours.
        let mut above = vec![0i32; width + 2];
        let mut line = vec![0i32; width + 2];
        for _ in 0..height {
            // Beyond the right edge the sample above is repeated.
            if let [.., last, edge] = above.as_mut_slice() {
                *edge = *last;
            }
            // Before the left edge is what was above it; `above[0]` is the one of the line before.
            if let (Some(before), Some(first)) = (line.first_mut(), above.get(1)) {
                *before = *first;
            }
            self.line(&above, &mut line)?;
            let row = line.iter().skip(1).take(width);
            samples.extend(row.map(|&sample| sample as u16));
            std::mem::swap(&mut above, &mut line);
        }
        Ok(samples)
    }

    fn line(&mut self, above: &[i32], line: &mut [i32]) -> Result<(), Problem> {
        let width = line.len() - 2;
        let mut x = 1;
        while x <= width {
            let (Some(&[c, b, d]), Some(&a)) = (
                above.get(x - 1..).and_then(<[i32]>::first_chunk::<3>),
                line.get(x - 1),
            ) else {
                return Err("a line is too short");
            };
            let gradients = [d - b, b - c, c - a];
            if gradients.iter().all(|g| g.abs() <= self.parameters.near) {
                x += self.run(above, line, x, a)?;
            } else {
                let sample = self.regular(a, b, c, gradients)?;
                if let Some(place) = line.get_mut(x) {
                    *place = sample;
                }
                x += 1;
            }
        }
        Ok(())
    }

    fn quantized(&self, gradient: i32) -> i32 {
        let [t1, t2, t3] = self.parameters.thresholds;
        let size = gradient.abs();
        let level = if size <= self.parameters.near {
            0
        } else if size < t1 {
            1
        } else if size < t2 {
            2
        } else if size < t3 {
            3
        } else {
            4
        };
        level * gradient.signum()
    }

    fn regular(&mut self, a: i32, b: i32, c: i32, gradients: [i32; 3]) -> Result<i32, Problem> {
        let p = self.parameters;
        let [q1, q2, q3] = gradients.map(|gradient| self.quantized(gradient));
        let index = 81 * q1 + 9 * q2 + q3;
        let sign = if index < 0 { -1 } else { 1 };
        let context = self
            .contexts
            .get_mut(index.unsigned_abs() as usize)
            .ok_or("a context is out of range")?;
        let median = if c >= a.max(b) {
            a.min(b)
        } else if c <= a.min(b) {
            a.max(b)
        } else {
            a + b - c
        };
        let predicted = (median + sign * context.c).clamp(0, p.maxval);
        let k = golomb_parameter(context.n, context.a);
        let mapped = golomb(&mut self.bits, k, p.limit, p.qbpp)?;
        // Error mapping: A.5.2, turned over.
        let mut error = if mapped & 1 == 0 {
            mapped >> 1
        } else {
            -((mapped + 1) >> 1)
        };
        if p.near == 0 && k == 0 && 2 * context.b <= -context.n {
            error = -(error + 1);
        }
        // Update: A.6.
        context.b += error * (2 * p.near + 1);
        context.a += error.abs();
        if context.a > 1 << 24 || context.b.abs() > 1 << 24 {
            return Err("a prediction error is out of range");
        }
        if context.n == p.reset {
            context.a >>= 1;
            context.b >>= 1;
            context.n >>= 1;
        }
        context.n += 1;
        if context.b <= -context.n {
            context.c = (context.c - 1).max(*CORRECTION_RANGE.start());
            context.b = (context.b + context.n).max(1 - context.n);
        } else if context.b > 0 {
            context.c = (context.c + 1).min(*CORRECTION_RANGE.end());
            context.b = (context.b - context.n).min(0);
        }
        Ok(reconstructed(&p, predicted, sign * error))
    }

    /// A run of equal samples and what ends it; returns the number of samples.
    fn run(
        &mut self,
        above: &[i32],
        line: &mut [i32],
        start: usize,
        a: i32,
    ) -> Result<usize, Problem> {
        let left = line.len() - 1 - start;
        let mut length = 0;
        while self.bits.take(1)? == 1 {
            let block = 1usize << J.get(self.run_index).copied().unwrap_or(15);
            let count = block.min(left - length);
            length += count;
            if count == block {
                self.run_index = (self.run_index + 1).min(J.len() - 1);
            }
            if length == left {
                fill(line, start, length, a);
                return Ok(length);
            }
        }
        let rest = self
            .bits
            .take(J.get(self.run_index).copied().unwrap_or(0))? as usize;
        length += rest;
        if length >= left {
            return Err("a run is longer than its line");
        }
        fill(line, start, length, a);
        let end = start + length;
        let b = above.get(end).copied().unwrap_or(0);
        let sample = self.interruption(a, b)?;
        if let Some(place) = line.get_mut(end) {
            *place = sample;
        }
        self.run_index = self.run_index.saturating_sub(1);
        Ok(length + 1)
    }

    /// The sample that ends a run: A.7.2.
    fn interruption(&mut self, a: i32, b: i32) -> Result<i32, Problem> {
        let p = self.parameters;
        let same = (a - b).abs() <= p.near;
        let kind = usize::from(same);
        let (Some(context), Some(negatives)) = (
            self.run_contexts.get_mut(kind),
            self.run_negatives.get_mut(kind),
        ) else {
            return Err("a context is out of range");
        };
        let spread = if same {
            context.a + (context.n >> 1)
        } else {
            context.a
        };
        let k = golomb_parameter(context.n, spread);
        let shortening = J.get(self.run_index).copied().unwrap_or(0) + 1;
        let limit = p.limit.saturating_sub(shortening);
        let mapped = golomb(&mut self.bits, k, limit, p.qbpp)?;
        let value = mapped + kind as i32;
        // Whether the error is negative hangs on its code's parity and on what was seen before.
        let map = value & 1;
        let size = (value + map) / 2;
        let expects_negative = k != 0 || 2 * *negatives >= context.n;
        let error = if expects_negative == (map == 1) {
            -size
        } else {
            size
        };
        if error < 0 {
            *negatives += 1;
        }
        context.a += (mapped + 1 - kind as i32) >> 1;
        if context.a > 1 << 24 {
            return Err("a prediction error is out of range");
        }
        if context.n == p.reset {
            context.a >>= 1;
            *negatives >>= 1;
            context.n >>= 1;
        }
        context.n += 1;
        let (predicted, sign) = if same {
            (a, 1)
        } else {
            (b, if a > b { -1 } else { 1 })
        };
        Ok(reconstructed(&p, predicted, sign * error))
    }
}

fn fill(line: &mut [i32], start: usize, length: usize, value: i32) {
    if let Some(run) = line.get_mut(start..start + length) {
        run.fill(value);
    }
}

/// The smallest k with n·2ᵏ ≥ a.
fn golomb_parameter(n: i32, a: i32) -> u32 {
    let mut k = 0;
    while n << k < a && k < 24 {
        k += 1;
    }
    k
}

/// A limited-length Golomb code: A.5.3.
fn golomb(bits: &mut Bits<'_>, k: u32, limit: u32, qbpp: u32) -> Result<i32, Problem> {
    let escape = limit.saturating_sub(qbpp + 1);
    let zeros = bits.zeros(escape)?;
    let value = if zeros < escape {
        (zeros << k) + bits.take(k)?
    } else {
        bits.take(qbpp)? + 1
    };
    i32::try_from(value)
        .ok()
        .filter(|&value| value < 1 << 20)
        .ok_or("a code is out of range")
}

fn reconstructed(p: &Parameters, predicted: i32, error: i32) -> i32 {
    let step = 2 * p.near + 1;
    let mut sample = predicted + error * step;
    let turn = p.range * step;
    if sample < -p.near {
        sample += turn;
    } else if sample > p.maxval + p.near {
        sample -= turn;
    }
    sample.clamp(0, p.maxval)
}
