//! From linear radiance to a picture for display.

use holovol_light::luminance;
use holovol_reference::Image;
use holovol_scene::{Background, Camera, Environment, OutputEntry, ToneMapping};

use crate::output::Picture;

/// Opacity from which on a pixel counts as showing the volume.
const COVERED: f32 = 0.02;

/// Exposes an image, puts it over its background, maps its tones and encodes it as sRGB.
///
/// Without `exposure_ev` the 99th percentile of luminance where the volume is becomes 1.
pub(crate) fn develop(
    image: &Image,
    settings: &OutputEntry,
    camera: &Camera,
    environment: &Environment,
) -> Picture {
    let exposure = match settings.exposure_ev {
        Some(ev) => ev.exp2(),
        None => auto_exposure(image),
    };
    let curve = |rgb: [f64; 3]| map_tones(rgb.map(|c| c * exposure), settings.tone_mapping);
    let width = image.width() as usize;
    let develop = |(index, &[r, g, b, a]): (usize, &[f32; 4])| {
        let rgb = [r, g, b].map(|c| f64::from(if c.is_finite() { c.max(0.0) } else { 0.0 }));
        let opacity = f64::from(if a.is_finite() {
            a.clamp(0.0, 1.0)
        } else {
            0.0
        });
        let through = 1.0 - opacity;
        match settings.background {
            Background::Black => opaque(curve(rgb)),
            Background::Color(color) => {
                let mapped = curve(rgb);
                opaque([0, 1, 2].map(|c| mapped[c] + through * color[c]))
            }
            Background::Environment => {
                let (x, y) = (index % width, index / width);
                let wi = camera.direction(x as f64 + 0.5, y as f64 + 0.5);
                let behind = environment.radiance(wi);
                opaque(curve([0, 1, 2].map(|c| rgb[c] + through * behind[c])))
            }
            Background::Transparent => {
                let straight = curve(rgb.map(|c| if opacity > 0.0 { c / opacity } else { 0.0 }));
                let [r, g, b] = straight.map(encode_srgb);
                [r, g, b, (opacity * 255.0).round() as u8]
            }
        }
    };
    Picture {
        width: image.width(),
        height: image.height(),
        pixels: image.pixels().iter().enumerate().map(develop).collect(),
    }
}

/// The factor that takes the 99th percentile of luminance where the volume is to 1.
fn auto_exposure(image: &Image) -> f64 {
    let covered = image.pixels().iter().filter(|pixel| pixel[3] > COVERED);
    let mut luminances: Vec<f64> = covered
        .map(|&[r, g, b, _]| luminance([r, g, b].map(f64::from)))
        .filter(|l| l.is_finite())
        .collect();
    luminances.sort_by(f64::total_cmp);
    let white = luminances
        .get(luminances.len() * 99 / 100)
        .copied()
        .unwrap_or(1.0);
    if white > 0.0 { 1.0 / white } else { 1.0 }
}

/// Exposed linear radiance to linear display light, 0 … 1.
fn map_tones(rgb: [f64; 3], curve: ToneMapping) -> [f64; 3] {
    match curve {
        ToneMapping::None => rgb.map(|c| c.min(1.0)),
        ToneMapping::Neutral => neutral(rgb),
        ToneMapping::Aces => rgb.map(|c| {
            // K. Narkowicz, "ACES Filmic Tone Mapping Curve" (2015); grey stays where it was at
            // an input scale of 0.6.
            let x = 0.6 * c.min(1e6);
            (x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)).min(1.0)
        }),
        ToneMapping::Reinhard => {
            let scale = 1.0 / (1.0 + luminance(rgb));
            rgb.map(|c| (c * scale).min(1.0))
        }
    }
}

/// Khronos PBR Neutral (Khronos Group, 2024): exact below 0.8 but for a toe, then rolls off and
/// desaturates.
fn neutral(rgb: [f64; 3]) -> [f64; 3] {
    const START: f64 = 0.8 - 0.04;
    const DESATURATION: f64 = 0.15;
    let low = rgb[0].min(rgb[1]).min(rgb[2]);
    let toe = if low < 0.08 {
        low - 6.25 * low * low
    } else {
        0.04
    };
    let rgb = rgb.map(|c| c - toe);
    let peak = rgb[0].max(rgb[1]).max(rgb[2]);
    if peak < START {
        return rgb;
    }
    let range = 1.0 - START;
    let mapped = 1.0 - range * range / (peak + range - START);
    let white = 1.0 - 1.0 / (DESATURATION * (peak - mapped) + 1.0);
    rgb.map(|c| {
        let c = c * mapped / peak;
        c + (mapped - c) * white
    })
}

fn opaque(linear: [f64; 3]) -> [u8; 4] {
    let [r, g, b] = linear.map(encode_srgb);
    [r, g, b, 255]
}

/// Linear light (clamped to 0 … 1) to 8-bit sRGB.
pub(crate) fn encode_srgb(linear: f64) -> u8 {
    let c = linear.clamp(0.0, 1.0);
    let encoded = if c <= 0.003_130_8 {
        12.92 * c
    } else {
        1.055 * c.powf(1.0 / 2.4) - 0.055
    };
    (encoded * 255.0).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_keep_black_rise_and_end_at_white() {
        for curve in [
            ToneMapping::None,
            ToneMapping::Neutral,
            ToneMapping::Aces,
            ToneMapping::Reinhard,
        ] {
            let mut before = -1.0;
            for step in 0..4000 {
                let mapped = map_tones([f64::from(step) * 0.01; 3], curve)[1];
                assert!((0.0..=1.0).contains(&mapped), "{curve:?} {step}: {mapped}");
                assert!(mapped >= before, "{curve:?} falls at {step}");
                before = mapped;
            }
            assert_eq!(map_tones([0.0; 3], curve), [0.0; 3]);
            assert!(before > 0.95, "{curve:?} ends at {before}");
        }
    }

    #[test]
    fn neutral_keeps_saturated_colours_below_its_shoulder() {
        assert_eq!(neutral([0.5, 0.0, 0.1]), [0.5, 0.0, 0.1]);
        let [r, g, b] = neutral([0.5, 0.3, 0.2]);
        assert!((r - 0.46).abs() < 1e-12 && (g - 0.26).abs() < 1e-12 && (b - 0.16).abs() < 1e-12);
    }

    #[test]
    fn exposure_takes_the_99th_percentile_of_the_volume_to_one() {
        // 100 covered pixels of luminance 1 … 100 among empty ones.
        let covered = (1..=100).map(|i| [i as f32, i as f32, i as f32, 1.0]);
        let pixels: Vec<[f32; 4]> = covered.chain([[0.0; 4]; 100]).collect();
        let exposure = auto_exposure(&Image::new(200, 1, pixels));
        assert!((exposure * 100.0 - 1.0).abs() < 1e-9, "{exposure}");
        assert_eq!(auto_exposure(&Image::new(1, 1, vec![[0.0; 4]])), 1.0);
    }

    #[test]
    fn srgb_has_its_known_values() {
        let known = [
            (0.0, 0),
            (0.001, 3),
            (0.215_861, 128),
            (0.5, 188),
            (1.0, 255),
            (7.0, 255),
        ];
        for (linear, expected) in known {
            assert_eq!(encode_srgb(linear), expected, "{linear}");
        }
    }
}
