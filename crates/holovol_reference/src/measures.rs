//! How much two pictures differ (DESIGN §8): the first argument is judged, the second is the
//! reference. All sums are f64.

use holovol_light::luminance;

use crate::{Film, Image};

/// Side of a block, in pixels.
pub const BLOCK: u32 = 16;

/// Viewing distance at which FLIP and people look: a 0.7 m wide 4K screen from 0.7 m.
pub const PIXELS_PER_DEGREE: f32 = nv_flip::DEFAULT_PIXELS_PER_DEGREE;

/// Why two pictures can't be compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "pictures of {}×{} and {}×{} pixels: render both at the same size to compare them",
    a[0], a[1], b[0], b[1]
)]
pub struct SizeMismatch {
    /// Width and height of the first.
    pub a: [u32; 2],
    /// Width and height of the second.
    pub b: [u32; 2],
}

/// All measures of one picture against a reference.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Comparison {
    /// Mean over pixels and RGB of (a − b)²/(b² + 0.01), premultiplied linear radiance.
    pub relmse: f64,
    /// Mean over pixels and RGB of (a − b)².
    pub mse: f64,
    /// √mse.
    pub rmse: f64,
    /// Of the tone-mapped pictures over black, dB; infinite if they are equal (null in JSON).
    pub psnr: f64,
    /// Mean FLIP error of the tone-mapped pictures over black, 0 … 1.
    pub flip: f64,
    /// Structural similarity of the tone-mapped pictures over black, 1 if equal.
    pub ssim: f64,
    /// Mean of the judged picture: R, G, B, opacity.
    pub mean: [f64; 4],
    /// Mean of the reference.
    pub mean_reference: [f64; 4],
}

/// Judges a picture by all measures.
///
/// NaN and infinite pixels make the linear measures NaN or infinite; the tone-mapped ones take
/// NaN for black and infinities for white.
///
/// # Errors
/// If the sizes differ.
pub fn compare(image: &Image, reference: &Image) -> Result<Comparison, SizeMismatch> {
    same_size(image, reference)?;
    let mse = mse(image, reference)?;
    let white = white_point(reference);
    let [a, b] = [image, reference].map(|picture| tone_map(picture, white));
    let size = [image.width(), image.height()];
    Ok(Comparison {
        relmse: relmse(image, reference)?,
        mse,
        rmse: mse.sqrt(),
        psnr: psnr(&a, &b),
        flip: flip_of(&a, &b, size),
        ssim: ssim_of(&a, &b, size),
        mean: mean(image),
        mean_reference: mean(reference),
    })
}

fn same_size(a: &Image, b: &Image) -> Result<(), SizeMismatch> {
    let [a, b] = [a, b].map(|image| [image.width(), image.height()]);
    if a == b {
        Ok(())
    } else {
        Err(SizeMismatch { a, b })
    }
}

/// Mean over pixels and RGB of a function of both values.
fn mean_over_rgb(
    image: &Image,
    reference: &Image,
    term: impl Fn(f64, f64) -> f64,
) -> Result<f64, SizeMismatch> {
    same_size(image, reference)?;
    let pairs = image.pixels().iter().zip(reference.pixels());
    let sum: f64 = pairs
        .map(|(a, b)| (0..3).map(|c| term(a[c].into(), b[c].into())).sum::<f64>())
        .sum();
    Ok(sum / (3 * image.pixels().len()) as f64)
}

/// Mean over pixels and RGB of (a − b)²/(b² + 0.01).
///
/// # Errors
/// If the sizes differ.
pub fn relmse(image: &Image, reference: &Image) -> Result<f64, SizeMismatch> {
    mean_over_rgb(image, reference, |a, b| {
        (a - b) * (a - b) / (b * b + RELMSE_OFFSET)
    })
}

/// The relMSE against the truth that a film is expected to have, from its own variances.
pub fn expected_relmse(film: &Film) -> f64 {
    let pixels = film.means().zip(film.variances());
    let terms = pixels.map(|(mean, variance)| {
        (0..3)
            .map(|c| variance[c] / (mean[c] * mean[c] + RELMSE_OFFSET))
            .sum::<f64>()
    });
    terms.sum::<f64>() / (3 * film.means().len()) as f64
}

/// Keeps dark pixels from ruling relMSE.
pub(crate) const RELMSE_OFFSET: f64 = 0.01;

/// Mean over pixels and RGB of (a − b)².
///
/// # Errors
/// If the sizes differ.
pub fn mse(image: &Image, reference: &Image) -> Result<f64, SizeMismatch> {
    mean_over_rgb(image, reference, |a, b| (a - b) * (a - b))
}

/// Mean over all pixels: R, G, B, opacity.
pub fn mean(image: &Image) -> [f64; 4] {
    let count = image.pixels().len() as f64;
    std::array::from_fn(|c| {
        let sum: f64 = image.pixels().iter().map(|pixel| f64::from(pixel[c])).sum();
        sum / count
    })
}

/// The luminance that pictures are compared at as white: the reference's 99th percentile (the
/// smallest that at least 99 % of its pixels don't exceed), its maximum if that is 0, 1 if it is
/// black.
pub fn white_point(reference: &Image) -> f64 {
    let mut values: Vec<f64> = reference
        .pixels()
        .iter()
        .map(|&[r, g, b, _]| luminance([r, g, b].map(f64::from)))
        .filter(|value| value.is_finite())
        .collect();
    values.sort_unstable_by(f64::total_cmp);
    let rank = (values.len() * 99).div_ceil(100).max(1) - 1;
    let candidates = [values.get(rank), values.last()];
    let white = candidates.into_iter().flatten().find(|&&value| value > 0.0);
    white.copied().unwrap_or(1.0)
}

/// 8-bit sRGB over black: `white` (linear radiance) maps to 1, what lies above is clamped.
pub fn tone_map(image: &Image, white: f64) -> Vec<[u8; 3]> {
    let encode = |value: f32| {
        let linear = (f64::from(value) / white).clamp(0.0, 1.0);
        let srgb = if linear <= 0.003_130_8 {
            12.92 * linear
        } else {
            1.055 * linear.powf(1.0 / 2.4) - 0.055
        };
        // NaN becomes 0 by `as`.
        (srgb * 255.0).round() as u8
    };
    let pixels = image.pixels().iter();
    pixels.map(|&[r, g, b, _]| [r, g, b].map(encode)).collect()
}

/// Mean FLIP error over black (Andersson et al. 2020), 67 pixels per degree, 0 … 1.
///
/// # Errors
/// If the sizes differ.
pub fn flip(image: &Image, reference: &Image) -> Result<f64, SizeMismatch> {
    same_size(image, reference)?;
    let white = white_point(reference);
    let [a, b] = [image, reference].map(|picture| tone_map(picture, white));
    Ok(flip_of(&a, &b, [image.width(), image.height()]))
}

fn flip_of(image: &[[u8; 3]], reference: &[[u8; 3]], [width, height]: [u32; 2]) -> f64 {
    let picture = |pixels: &[[u8; 3]]| {
        nv_flip::FlipImageRgb8::with_data(width, height, pixels.as_flattened())
    };
    let errors = nv_flip::flip(picture(reference), picture(image), PIXELS_PER_DEGREE).to_vec();
    errors.iter().map(|&e| f64::from(e)).sum::<f64>() / errors.len() as f64
}

/// Mean structural similarity over black (Wang et al. 2004).
///
/// Gaussian window of 11 × 11 pixels with σ = 1.5, K = (0.01, 0.03), population variances, mean
/// over RGB and over the pixels whose window lies inside. In smaller pictures windows are cut.
///
/// # Errors
/// If the sizes differ.
pub fn ssim(image: &Image, reference: &Image) -> Result<f64, SizeMismatch> {
    same_size(image, reference)?;
    let white = white_point(reference);
    let [a, b] = [image, reference].map(|picture| tone_map(picture, white));
    Ok(ssim_of(&a, &b, [image.width(), image.height()]))
}

fn ssim_of(image: &[[u8; 3]], reference: &[[u8; 3]], size: [u32; 2]) -> f64 {
    const RADIUS: usize = 5;
    const SIGMA: f64 = 1.5;
    const C1: f64 = (0.01 * 255.0) * (0.01 * 255.0);
    const C2: f64 = (0.03 * 255.0) * (0.03 * 255.0);
    let [width, height] = size.map(|n| n as usize);
    let weight = |offset: f64| (-0.5 * offset * offset / (SIGMA * SIGMA)).exp();
    // Weighted mean over the window's part inside, along one axis with the given stride.
    let blur_axis = |plane: &[f64], n: usize, stride: usize| -> Vec<f64> {
        let blurred = (0..plane.len()).map(|index| {
            let at = index / stride % n;
            let (mut sum, mut weights) = (0.0, 0.0);
            for other in at.saturating_sub(RADIUS)..=(at + RADIUS).min(n - 1) {
                let w = weight(other as f64 - at as f64);
                sum += w * plane[index + other * stride - at * stride];
                weights += w;
            }
            sum / weights
        });
        blurred.collect()
    };
    let blur = |plane: Vec<f64>| blur_axis(&blur_axis(&plane, width, 1), height, width);
    let margin = |n: usize| RADIUS.min((n - 1) / 2);
    let (mut sum, mut count) = (0.0, 0usize);
    for channel in 0..3 {
        let plane = |f: &dyn Fn(f64, f64) -> f64| {
            let pairs = image.iter().zip(reference);
            blur(
                pairs
                    .map(|(a, b)| f(a[channel].into(), b[channel].into()))
                    .collect(),
            )
        };
        let (mean_a, mean_b) = (plane(&|a, _| a), plane(&|_, b| b));
        let (aa, bb, ab) = (
            plane(&|a, _| a * a),
            plane(&|_, b| b * b),
            plane(&|a, b| a * b),
        );
        for y in margin(height)..height - margin(height) {
            for x in margin(width)..width - margin(width) {
                let i = x + width * y;
                let (ma, mb) = (mean_a[i], mean_b[i]);
                let (va, vb, cov) = (aa[i] - ma * ma, bb[i] - mb * mb, ab[i] - ma * mb);
                sum += (2.0 * ma * mb + C1) * (2.0 * cov + C2)
                    / ((ma * ma + mb * mb + C1) * (va + vb + C2));
                count += 1;
            }
        }
    }
    sum / count as f64
}

fn psnr(image: &[[u8; 3]], reference: &[[u8; 3]]) -> f64 {
    let pairs = image.as_flattened().iter().zip(reference.as_flattened());
    let sum: f64 = pairs
        .map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2))
        .sum();
    let mse = sum / (3 * image.len()) as f64;
    10.0 * (255.0 * 255.0 / mse).log10()
}
