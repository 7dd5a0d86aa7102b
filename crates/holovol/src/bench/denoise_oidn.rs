//! Open Image Denoise, run as a program.

use std::path::{Path, PathBuf};
use std::process::Command;

use holovol_reference::Image;

use super::denoise_measures::{Reference, both, relmse};
use crate::{Exit, Failure};

/// Open Image Denoise on each eye's noisy frame: its best variant over colour alone, and with the
/// albedo guide, taken as noisy or as clean.
pub(super) fn best_oidn(
    program: &Path,
    noisy: &[Image],
    albedo: &[[f32; 4]],
    reference: &Reference,
) -> Result<(String, Vec<Image>), Failure> {
    let mut best: Option<(String, f64, Vec<Image>)> = None;
    for (variant, aux) in [
        ("colour", None),
        ("albedo", Some(false)),
        ("clean albedo", Some(true)),
    ] {
        let mut images = Vec::new();
        for (eye, image) in noisy.iter().enumerate() {
            let pixels = image.pixels().len();
            let guide = &albedo[eye * pixels..(eye + 1) * pixels];
            images.push(oidn(program, image, aux.map(|clean| (guide, clean)))?);
        }
        let error = both(&images, reference, relmse);
        if best.as_ref().is_none_or(|(_, least, _)| error < *least) {
            best = Some((variant.into(), error, images));
        }
    }
    best.map(|(name, _, images)| (name, images))
        .ok_or_else(|| Failure::new(Exit::Internal, "no variant of Open Image Denoise was run"))
}

fn oidn(
    program: &Path,
    noisy: &Image,
    guide: Option<(&[[f32; 4]], bool)>,
) -> Result<Image, Failure> {
    let folder = std::env::temp_dir().join(format!("holovol-oidn-{}", std::process::id()));
    let failed = |reason: String| {
        Failure::new(
            Exit::Input,
            format!("--oidn: {}: {reason}", program.display()),
        )
    };
    let io = |error: std::io::Error| failed(error.to_string());
    std::fs::create_dir_all(&folder).map_err(io)?;
    let file = |name: &str| -> PathBuf { folder.join(name) };
    let (width, height) = (noisy.width(), noisy.height());
    std::fs::write(file("c.pfm"), pfm(width, height, noisy.pixels())).map_err(io)?;
    let mut command = Command::new(program);
    command
        .arg("--hdr")
        .arg(file("c.pfm"))
        .arg("-o")
        .arg(file("o.pfm"));
    if let Some((pixels, clean)) = guide {
        std::fs::write(file("a.pfm"), pfm(width, height, pixels)).map_err(io)?;
        command.arg("--alb").arg(file("a.pfm"));
        if clean {
            command.arg("--clean_aux");
        }
    }
    let result = command.output().map_err(io)?;
    if !result.status.success() {
        return Err(failed(String::from_utf8_lossy(&result.stdout).into_owned()));
    }
    let bytes = std::fs::read(file("o.pfm")).map_err(io)?;
    std::fs::remove_dir_all(&folder).map_err(io)?;
    let count = 12 * width as usize * height as usize;
    let data = bytes
        .len()
        .checked_sub(count)
        .map(|start| &bytes[start..])
        .ok_or_else(|| failed("its image is cut short".into()))?;
    let mut pixels: Vec<[f32; 4]> = Vec::new();
    for row in data.chunks_exact(12 * width as usize).rev() {
        for pixel in row.chunks_exact(12) {
            let channel = |c: usize| {
                let bytes: [u8; 4] = std::array::from_fn(|i| pixel[4 * c + i]);
                f32::from_le_bytes(bytes)
            };
            pixels.push([channel(0), channel(1), channel(2), 1.0]);
        }
    }
    Ok(Image::new(width, height, pixels))
}

/// Portable float map: rows from the bottom, little-endian.
fn pfm(width: u32, height: u32, pixels: &[[f32; 4]]) -> Vec<u8> {
    let mut bytes = format!("PF\n{width} {height}\n-1.0\n").into_bytes();
    for row in pixels.chunks_exact(width as usize).rev() {
        for pixel in row {
            for channel in &pixel[..3] {
                bytes.extend(channel.to_le_bytes());
            }
        }
    }
    bytes
}
