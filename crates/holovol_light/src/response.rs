//! Camera response: from code values to linear light, and fitted from an exposure series.

use serde::{Deserialize, Serialize};

/// How a camera turns linear light (0 … 1, clipped) into code values.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Response {
    /// The curve of sRGB, which most cameras come near to.
    #[default]
    Srgb,
    /// code = light^(1/γ).
    Gamma(f64),
    /// Linear light of each of 256 codes, for R, G and B; rising from about 0 to 1.
    Table([Vec<f64>; 3]),
}

impl Response {
    /// What is wrong with it, if anything.
    ///
    /// # Errors
    /// If a table is not 256 numbers that never fall, or a gamma not in 0.2 … 5.
    pub fn check(&self) -> Result<(), String> {
        match self {
            Self::Srgb => Ok(()),
            Self::Gamma(gamma) if (0.2..=5.0).contains(gamma) => Ok(()),
            Self::Gamma(gamma) => Err(format!("gamma is {gamma}, expected 0.2 … 5")),
            Self::Table(tables) => {
                for (channel, table) in ["red", "green", "blue"].iter().zip(tables) {
                    if table.len() != 256 {
                        return Err(format!(
                            "{channel} has {} values, expected 256",
                            table.len()
                        ));
                    }
                    let valid = table.iter().all(|v| v.is_finite() && *v >= 0.0);
                    if !valid || table.windows(2).any(|pair| pair[0] > pair[1]) {
                        return Err(format!("{channel} is not rising from 0 to 1"));
                    }
                    if table[255] <= table[0] {
                        return Err(format!("{channel} is flat"));
                    }
                }
                Ok(())
            }
        }
    }

    /// Linear light of a code in 0 … 1, where 1 is clipping.
    pub fn linear(&self, channel: usize, code: f64) -> f64 {
        let code = code.clamp(0.0, 1.0);
        match self {
            Self::Srgb => srgb_to_linear(code),
            Self::Gamma(gamma) => code.powf(*gamma),
            Self::Table(tables) => {
                let table = &tables[channel.min(2)];
                let (first, last) = (table[0], table[255]);
                let at = code * 255.0;
                let low = at.floor() as usize;
                let high = (low + 1).min(255);
                let value = table[low] + (at - low as f64) * (table[high] - table[low]);
                ((value - first) / (last - first)).clamp(0.0, 1.0)
            }
        }
    }

    /// Linear light of the 256 codes of 8 bits, for R, G and B.
    pub fn table(&self) -> [[f32; 256]; 3] {
        std::array::from_fn(|c| std::array::from_fn(|z| self.linear(c, z as f64 / 255.0) as f32))
    }
}

/// Linear light of an sRGB value, both 0 … 1 (IEC 61966-2-1).
pub fn srgb_to_linear(code: f64) -> f64 {
    if code <= 0.04045 {
        code / 12.92
    } else {
        ((code + 0.055) / 1.055).powf(2.4)
    }
}

/// sRGB value of linear light, both 0 … 1.
pub fn linear_to_srgb(light: f64) -> f64 {
    if light <= 0.003_130_8 {
        light * 12.92
    } else {
        1.055 * light.powf(1.0 / 2.4) - 0.055
    }
}

/// One picture of an exposure series: 8-bit RGB and its exposure in EV.
#[derive(Clone, Copy, Debug)]
pub struct SeriesFrame<'a> {
    /// Exposure relative to any of the others, EV.
    pub ev: f64,
    /// Row-major codes, all frames alike in size and view.
    pub pixels: &'a [[u8; 3]],
}

/// Smoothness λ of the fitted curve (Debevec and Malik 1997, eq. 3).
const SMOOTHNESS: f64 = 30.0;
/// Pixels that are looked at.
const SAMPLES: usize = 120;
/// A curve through fewer different codes is a guess.
const FEWEST_CODES: usize = 32;
/// Share of the changes of exposure that a series has to show.
const LEAST_FOLLOWED: f64 = 0.75;

/// Fits the response to an exposure series of a scene that stood still (Debevec and Malik 1997),
/// then makes it monotone.
///
/// Minimises Σ w(z)²·(g(z) − ln E − ln t)² + λ·Σ w(z)²·g″(z)² with a hat for w; each pixel's ln E is
/// eliminated, which leaves 256 unknowns per channel.
///
/// # Errors
/// With fewer than 3 frames, frames of different sizes, all of one exposure, without pixels
/// between black and clipping, with few different codes, or with codes that don't change as the exposures say.
pub fn fit_response(frames: &[SeriesFrame]) -> Result<Response, String> {
    if frames.len() < 3 {
        return Err(format!(
            "an exposure series of {} pictures; expected at least 3, better 5 or more",
            frames.len()
        ));
    }
    let len = frames[0].pixels.len();
    if len == 0 || frames.iter().any(|frame| frame.pixels.len() != len) {
        return Err("the pictures of the series have different sizes".into());
    }
    let (low, high) = frames.iter().fold((f64::MAX, f64::MIN), |(low, high), f| {
        (low.min(f.ev), high.max(f.ev))
    });
    if !(high - low >= 1.0 && (high - low).is_finite()) {
        return Err(
            "the exposures of the series span less than 1 EV; say each as PICTURE@EV, as in dark.png@-2".into(),
        );
    }
    let mut tables: [Vec<f64>; 3] = Default::default();
    for (c, table) in tables.iter_mut().enumerate() {
        let samples = choose(frames, c);
        let usable = samples.iter().filter(|&&i| {
            let open = frames.iter().filter(|f| (6..250).contains(&f.pixels[i][c]));
            open.count() >= 2
        });
        let name = ["red", "green", "blue"][c];
        if usable.count() < 20 {
            return Err(format!(
                "{name} has too few pixels between black and clipping in two pictures of the series"
            ));
        }
        let mut used = [false; 256];
        for (frame, &i) in frames
            .iter()
            .flat_map(|f| samples.iter().map(move |i| (f, i)))
        {
            used[usize::from(frame.pixels[i][c])] = true;
        }
        let codes = used[6..250].iter().filter(|&&used| used).count();
        if codes < FEWEST_CODES {
            return Err(format!(
                "{name} has {codes} different codes in the whole series, expected {FEWEST_CODES} and more; take a scene with dark and bright parts"
            ));
        }
        let curve = solve(frames, &samples, c)?;
        let followed = followed(frames, &samples, c, &curve);
        if followed < LEAST_FOLLOWED {
            return Err(format!(
                "{name} follows only {:.0} % of what the exposures say, expected {:.0} % and more; is each picture's @EV right (darker is less), and did scene, camera and white balance stand still?",
                100.0 * followed.max(0.0),
                100.0 * LEAST_FOLLOWED
            ));
        }
        let last = curve[255];
        *table = curve.iter().map(|g| (g - last).exp()).collect();
    }
    let response = Response::Table(tables);
    response.check()?;
    Ok(response)
}

/// Pixels spread over the codes of the middle frame.
fn choose(frames: &[SeriesFrame], c: usize) -> Vec<usize> {
    let mut by_ev: Vec<&SeriesFrame> = frames.iter().collect();
    by_ev.sort_by(|a, b| a.ev.total_cmp(&b.ev));
    let middle = by_ev[by_ev.len() / 2].pixels;
    let mut order: Vec<usize> = (0..middle.len())
        .step_by((middle.len() / 20_000).max(1))
        .collect();
    order.sort_by_key(|&i| middle[i][c]);
    let step = (order.len() as f64 / SAMPLES as f64).max(1.0);
    // Half by rank, half by code, so that rare codes have a say too.
    let mut chosen: Vec<usize> = (0..SAMPLES.min(order.len()))
        .map(|k| order[((k as f64 + 0.5) * step) as usize % order.len()])
        .collect();
    for code in (4..252).step_by(4) {
        let at = order.partition_point(|&i| middle[i][c] < code);
        chosen.extend(order.get(at));
    }
    chosen
}

fn solve(frames: &[SeriesFrame], samples: &[usize], c: usize) -> Result<Vec<f64>, String> {
    const N: usize = 256;
    let hat = |z: usize| (z.min(255 - z) as f64 + 0.01) / 128.0;
    let mut matrix = vec![0.0; N * N];
    let mut right = vec![0.0; N];
    for &i in samples {
        let seen: Vec<(usize, f64, f64)> = frames
            .iter()
            .map(|f| {
                let z = usize::from(f.pixels[i][c]);
                // Clipped pixels say nothing of their light.
                let weight = if (3..253).contains(&z) {
                    hat(z).powi(2)
                } else {
                    0.0
                };
                (z, weight, f.ev * std::f64::consts::LN_2)
            })
            .collect();
        let total: f64 = seen.iter().map(|s| s.1).sum();
        if total <= 0.0 {
            continue;
        }
        // Eliminating ln E leaves the weighted deviations from the pixel's mean.
        let mean_t = seen.iter().map(|s| s.1 * s.2).sum::<f64>() / total;
        for &(z, w, t) in &seen {
            matrix[z * N + z] += w;
            right[z] += w * (t - mean_t);
            for &(y, v, _) in &seen {
                matrix[z * N + y] -= w * v / total;
            }
        }
    }
    for z in 1..N - 1 {
        let weight = SMOOTHNESS * hat(z).powi(2);
        for (i, a) in [(z - 1, 1.0), (z, -2.0), (z + 1, 1.0)] {
            for (j, b) in [(z - 1, 1.0), (z, -2.0), (z + 1, 1.0)] {
                matrix[i * N + j] += weight * a * b;
            }
        }
    }
    // The level is free: g(128) = 0.
    matrix[128 * N + 128] += 1.0;
    let mut curve = cholesky(matrix, right, N)
        .ok_or("the series does not determine the response: its codes hardly change from picture to picture; take more exposures, 1 or 2 EV apart")?;
    make_monotone(&mut curve);
    Ok(curve)
}

/// Share of the series's changes of exposure (squared EV, within each pixel) that the curve finds
/// again in the codes: 1 where they are as the exposures say, 0 where the codes don't follow them.
fn followed(frames: &[SeriesFrame], samples: &[usize], c: usize, curve: &[f64]) -> f64 {
    let (mut left, mut all) = (0.0, 0.0);
    for &i in samples {
        let open = || {
            frames.iter().filter_map(|f| {
                let z = f.pixels[i][c];
                let t = f.ev * std::f64::consts::LN_2;
                (6..250)
                    .contains(&z)
                    .then(|| (t, t - curve[usize::from(z)]))
            })
        };
        let count = open().count().max(1) as f64;
        let sum = open().fold([0.0; 2], |sum, (t, e)| [sum[0] + t, sum[1] + e]);
        for (t, e) in open() {
            all += (t - sum[0] / count).powi(2);
            left += (e - sum[1] / count).powi(2);
        }
    }
    if all > 0.0 { 1.0 - left / all } else { 0.0 }
}

/// The nearest curve (least squares) that never falls: pool adjacent violators.
fn make_monotone(curve: &mut [f64]) {
    let mut blocks: Vec<(f64, usize)> = Vec::new();
    for &value in curve.iter() {
        let mut block = (value, 1);
        while let Some(&(mean, count)) = blocks.last() {
            if mean <= block.0 {
                break;
            }
            let all = count + block.1;
            block.0 = (mean * count as f64 + block.0 * block.1 as f64) / all as f64;
            block.1 = all;
            blocks.pop();
        }
        blocks.push(block);
    }
    let values = blocks
        .iter()
        .flat_map(|&(mean, count)| std::iter::repeat_n(mean, count));
    for (out, value) in curve.iter_mut().zip(values) {
        *out = value;
    }
}

/// Solves a symmetric positive definite system; `None` if it is not.
fn cholesky(mut a: Vec<f64>, mut b: Vec<f64>, n: usize) -> Option<Vec<f64>> {
    for i in 0..n {
        for j in 0..=i {
            let dot: f64 = (0..j).map(|k| a[i * n + k] * a[j * n + k]).sum();
            let value = a[i * n + j] - dot;
            if i == j {
                if value.is_nan() || value <= 0.0 {
                    return None;
                }
                a[i * n + i] = value.sqrt();
            } else {
                a[i * n + j] = value / a[j * n + j];
            }
        }
    }
    for i in 0..n {
        let dot: f64 = (0..i).map(|k| a[i * n + k] * b[k]).sum();
        b[i] = (b[i] - dot) / a[i * n + i];
    }
    for i in (0..n).rev() {
        let dot: f64 = (i + 1..n).map(|k| a[k * n + i] * b[k]).sum();
        b[i] = (b[i] - dot) / a[i * n + i];
    }
    Some(b)
}

/// What a single picture says against its being sRGB.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlindCheck {
    /// Share of pixels at 0 in some channel.
    pub crushed: f64,
    /// Share of pixels at 255 in some channel.
    pub clipped: f64,
    /// Share of the codes 16 … 239 that no pixel uses: a stretched or re-encoded picture has gaps.
    pub gaps: f64,
}

/// Looks at a picture's codes for signs that its response was tampered with. It can't tell which
/// curve a camera has: a wrong one costs about 0.2 EV (see `docs/lighting.md`).
pub fn blind_check(pixels: &[[u8; 3]]) -> BlindCheck {
    let mut used = [0_usize; 256];
    let (mut crushed, mut clipped) = (0, 0);
    for pixel in pixels {
        crushed += usize::from(pixel.contains(&0));
        clipped += usize::from(pixel.contains(&255));
        for &z in pixel {
            used[usize::from(z)] += 1;
        }
    }
    let count = pixels.len().max(1) as f64;
    let gaps = used[16..240].iter().filter(|&&n| n == 0).count();
    BlindCheck {
        crushed: crushed as f64 / count,
        clipped: clipped as f64 / count,
        gaps: gaps as f64 / 224.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A series through a curve that is no gamma: contrast in the middle, as cameras have.
    fn series(curve: impl Fn(f64) -> f64, evs: &[f64]) -> Vec<Vec<[u8; 3]>> {
        let scene: Vec<f64> = (0..4000)
            .map(|i| (f64::from(i) / 400.0 - 7.0).exp2())
            .collect();
        let picture = |ev: &f64| {
            let code = |l: f64| (curve((l * ev.exp2()).min(1.0)) * 255.0).round() as u8;
            scene.iter().map(|&l| [code(l); 3]).collect()
        };
        evs.iter().map(picture).collect()
    }

    #[test]
    fn a_series_gives_back_its_response() {
        let curve = |l: f64| {
            let v = l.powf(1.0 / 2.0);
            v * v * (3.0 - 2.0 * v) * 0.4 + 0.6 * v
        };
        let evs = [0.0, -1.0, -2.0, -3.0, -4.5, -6.0];
        let pictures = series(curve, &evs);
        let frames: Vec<SeriesFrame> = evs
            .iter()
            .zip(&pictures)
            .map(|(&ev, pixels)| SeriesFrame { ev, pixels })
            .collect();
        let response = fit_response(&frames).unwrap();
        for light in [0.02, 0.05, 0.2, 0.5, 0.8] {
            let found = response.linear(1, curve(light));
            let error = (found / light).log2();
            assert!(error.abs() < 0.1, "{light}: {found}");
            let wrong = Response::Srgb.linear(1, curve(light));
            assert!((wrong / light).log2().abs() > error.abs() || error.abs() < 0.02);
        }
    }

    #[test]
    fn series_that_tell_nothing_are_refused() {
        let pictures = series(|l| l, &[0.0, 0.1, 0.2]);
        let frames: Vec<SeriesFrame> = pictures
            .iter()
            .zip([0.0, 0.1, 0.2])
            .map(|(pixels, ev)| SeriesFrame { ev, pixels })
            .collect();
        assert!(
            fit_response(&frames[..2])
                .unwrap_err()
                .contains("at least 3")
        );
        assert!(fit_response(&frames).unwrap_err().contains("1 EV"));
        let black = vec![[0; 3]; 100];
        let frames = [0.0, -2.0, -4.0].map(|ev| SeriesFrame { ev, pixels: &black });
        assert!(
            fit_response(&frames)
                .unwrap_err()
                .contains("too few pixels")
        );
        // Exposures that are not those of the pictures: all alike, or the other way round.
        let evs = [0.0, -1.0, -2.0];
        let refused = |pictures: [&Vec<[u8; 3]>; 3]| {
            let frames = [0, 1, 2].map(|i| SeriesFrame {
                ev: evs[i],
                pixels: pictures[i],
            });
            fit_response(&frames).unwrap_err()
        };
        let pictures = series(|l| l.sqrt(), &evs);
        let alike = refused([&pictures[0]; 3]);
        assert!(
            alike.contains("hardly change") || alike.contains("follows only"),
            "{alike}"
        );
        let turned = refused([&pictures[2], &pictures[1], &pictures[0]]);
        assert!(turned.contains("follows only"), "{turned}");
        let grey = [90, 60, 40].map(|code| vec![[code; 3]; 4000]);
        let codes = refused(grey.each_ref());
        assert!(codes.contains("3 different codes"), "{codes}");
    }

    #[test]
    fn curves_run_from_black_to_clipping() {
        for response in [Response::Srgb, Response::Gamma(2.2)] {
            let table = response.table();
            assert_eq!((table[0][0], table[2][255]), (0.0, 1.0));
            assert!(table[1].windows(2).all(|pair| pair[0] < pair[1]));
        }
        assert!(Response::Gamma(-1.0).check().is_err());
        assert!(
            Response::Table([vec![0.0], vec![], vec![]])
                .check()
                .is_err()
        );
        assert!((linear_to_srgb(srgb_to_linear(0.3)) - 0.3).abs() < 1e-12);
    }

    #[test]
    fn monotone_means_pooling() {
        let mut curve = [0.0, 2.0, 1.0, 3.0];
        make_monotone(&mut curve);
        assert_eq!(curve, [0.0, 1.5, 1.5, 3.0]);
    }
}
