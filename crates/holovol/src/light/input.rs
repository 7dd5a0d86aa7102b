//! Pictures as the light commands take them.

use std::fs;
use std::io::Cursor;
use std::path::Path;

use holovol_light::response::Response;
use holovol_light::{EnvironmentMap, xmp};
use image::{ColorType, ImageDecoder, ImageReader};

use super::jpeg;
use crate::{Exit, Failure};

/// A picture, linear, 1 where it clips.
pub(crate) struct Linear {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) texels: Vec<[f32; 3]>,
    /// Its file holds radiance, not codes.
    #[cfg_attr(
        not(feature = "preview"),
        expect(dead_code, reason = "panoramas of the preview")
    )]
    pub(crate) is_linear: bool,
    /// Whether values above 1 are light rather than overflow.
    pub(crate) hdr: bool,
    /// One standard deviation of all light for what it does not show of the sphere, EV.
    pub(crate) unseen_sigma_ev: f64,
    /// What its user should know.
    pub(crate) notes: Vec<String>,
}

/// A picture's codes, 0 … 1.
struct Codes {
    width: usize,
    height: usize,
    texels: Vec<[f32; 3]>,
}

/// Values of linear files above this are light beyond an LDR exposure's clipping.
const BEYOND: f32 = 1.01;

fn input(path: &Path, problem: impl std::fmt::Display) -> Failure {
    Failure::new(Exit::Input, format!("{}: {problem}", path.display()))
}

/// Reads PNG or JPEG through a response, HDR or EXR as they are.
pub(crate) fn linear(path: &Path, response: &Response) -> Result<Linear, Failure> {
    let bytes = fs::read(path).map_err(|error| input(path, error))?;
    let is_linear = bytes.starts_with(b"#?") || bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]);
    if is_linear {
        let map = EnvironmentMap::load(path)?;
        let mut notes = Vec::new();
        if map.replaced() > 0 {
            notes.push(format!(
                "{}: {} texels were not finite and at least 0 and have been replaced",
                path.display(),
                map.replaced()
            ));
        }
        let hdr = map.texels().iter().flatten().any(|&c| c > BEYOND);
        return Ok(Linear {
            width: map.width(),
            height: map.height(),
            texels: map.texels().to_vec(),
            is_linear,
            hdr,
            unseen_sigma_ev: 0.0,
            notes,
        });
    }
    let Codes {
        width,
        height,
        mut texels,
    } = codes(path, &bytes)?;
    if jpeg::is_jpeg(&bytes) {
        texels.iter_mut().for_each(jpeg::restore_clipped);
    }
    let mut notes = Vec::new();
    let curve = curve(response);
    let mut texels: Vec<[f32; 3]> = texels
        .into_iter()
        .map(|texel| [0, 1, 2].map(|c| lookup(&curve[c], texel[c])))
        .collect();
    let (mut width, mut height) = (width, height);
    let mut unseen_sigma_ev = 0.0;
    let sphere = xmp::photo_sphere(&bytes).unwrap_or_default();
    match sphere.uncrop(width, height, &texels) {
        Ok(None) => {}
        Ok(Some(whole)) => {
            unseen_sigma_ev = whole.unseen_sigma_ev();
            notes.push(format!(
                "{}: its metadata says that it does not show {:.0} % of the sphere, {:.0} % of the upper half; that repeats its edge, and a light there would be missed",
                path.display(),
                100.0 * (whole.unseen[0] + whole.unseen[1]),
                200.0 * whole.unseen[0],
            ));
            (width, height, texels) = (whole.width, whole.height, whole.texels);
        }
        Err(problem) => notes.push(format!(
            "{}: its photo sphere metadata (GPano) can't be right: {problem}; taken for the whole sphere",
            path.display()
        )),
    }
    Ok(Linear {
        width,
        height,
        texels,
        is_linear,
        hdr: false,
        unseen_sigma_ev,
        notes,
    })
}

/// Steps of the tabulated response: 16-bit codes are between.
const STEPS: usize = 4096;

fn curve(response: &Response) -> [Vec<f32>; 3] {
    [0, 1, 2].map(|c| {
        let value = |i| response.linear(c, i as f64 / STEPS as f64) as f32;
        (0..=STEPS).map(value).collect()
    })
}

fn lookup(curve: &[f32], code: f32) -> f32 {
    let at = code.clamp(0.0, 1.0) * STEPS as f32;
    let low = (at as usize).min(STEPS - 1);
    curve[low] + (at - low as f32) * (curve[low + 1] - curve[low])
}

/// Reads the 8-bit RGB codes of a picture.
pub(crate) fn rgb8(path: &Path) -> Result<(usize, usize, Vec<[u8; 3]>), Failure> {
    let bytes = fs::read(path).map_err(|error| input(path, error))?;
    let Codes {
        width,
        height,
        texels,
    } = codes(path, &bytes)?;
    let code = |texel: [f32; 3]| texel.map(|c| (c * 255.0).round() as u8);
    Ok((width, height, texels.into_iter().map(code).collect()))
}

fn codes(path: &Path, bytes: &[u8]) -> Result<Codes, Failure> {
    let reader = ImageReader::new(Cursor::new(bytes))
        .with_guessed_format()
        .map_err(|error| input(path, error))?;
    if reader.format().is_none() {
        return Err(input(
            path,
            "not a picture that can be read; expected PNG, JPEG, Radiance HDR or OpenEXR",
        ));
    }
    let broken = |error: image::ImageError| {
        input(
            path,
            format!("the picture can't be read ({error}); export it again"),
        )
    };
    let decoder = reader.into_decoder().map_err(broken)?;
    let (width, height) = decoder.dimensions();
    let (width, height) = (width as usize, height as usize);
    let limit = EnvironmentMap::MAX_WIDTH;
    if width == 0 || height == 0 || width > limit || height > limit {
        return Err(input(
            path,
            format!("{width} × {height} pixels; expected 1 × 1 to {limit} × {limit}"),
        ));
    }
    if let Some(flaw) = jpeg::flaw(bytes) {
        return Err(input(
            path,
            format!("the JPEG is damaged or breaks off ({flaw}); copy or export it again"),
        ));
    }
    let deep = matches!(
        decoder.color_type(),
        ColorType::L16 | ColorType::La16 | ColorType::Rgb16 | ColorType::Rgba16
    );
    let picture = image::DynamicImage::from_decoder(decoder).map_err(broken)?;
    let texels = if deep {
        let rgb = picture.into_rgb16();
        rgb.pixels()
            .map(|p| p.0.map(|c| f32::from(c) / 65535.0))
            .collect()
    } else {
        let rgb = picture.into_rgb8();
        rgb.pixels()
            .map(|p| p.0.map(|c| f32::from(c) / 255.0))
            .collect()
    };
    Ok(Codes {
        width,
        height,
        texels,
    })
}

/// Reads a response: `srgb`, `gamma:2.2`, a response file, or the one of a calibration.
pub(crate) fn response(text: &str) -> Result<Response, Failure> {
    if text.eq_ignore_ascii_case("srgb") {
        return Ok(Response::Srgb);
    }
    let usage = |problem: String| Failure::new(Exit::Usage, format!("--crf {text}: {problem}"));
    if let Some(gamma) = text.strip_prefix("gamma:") {
        let gamma = gamma
            .parse()
            .map_err(|_| usage("expected gamma:NUMBER".into()))?;
        let response = Response::Gamma(gamma);
        response.check().map_err(usage)?;
        return Ok(response);
    }
    let path = Path::new(text);
    let json = fs::read_to_string(path).map_err(|error| {
        input(
            path,
            format!("{error}; expected srgb, gamma:NUMBER or a response file"),
        )
    })?;
    /// A response by itself, or the calibration that holds one.
    #[derive(serde::Deserialize)]
    struct Holder {
        response: Response,
    }
    let found = serde_json::from_str::<Response>(&json)
        .or_else(|first| {
            serde_json::from_str::<Holder>(&json)
                .map(|h| h.response)
                .map_err(|_| first)
        })
        .map_err(|error| input(path, format!("not a response file ({error})")))?;
    found.check().map_err(|problem| input(path, problem))?;
    Ok(found)
}
