//! Output files: checked before the work, written beside and then renamed.

use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use holovol_reference::Image;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};

use crate::{Exit, Failure};

/// An 8-bit sRGB picture with straight alpha.
pub(crate) struct Picture {
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) pixels: Vec<[u8; 4]>,
}

/// Finds out whether a file can be written, without leaving anything behind.
///
/// # Errors
/// If the name does not end in `extension`, its folder is missing or can't be written, or it is a
/// folder itself.
pub(crate) fn check(path: &Path, extension: &str, option: &str) -> Result<(), Failure> {
    let failure = |problem: String| {
        Failure::new(
            Exit::Output,
            format!("{option} {}: {problem}", path.display()),
        )
    };
    let found = path.extension().and_then(|e| e.to_str());
    if !found.is_some_and(|found| found.eq_ignore_ascii_case(extension)) {
        return Err(failure(format!(
            "expected a file name that ends in .{extension}"
        )));
    }
    if path.is_dir() {
        return Err(failure("is a folder; name a file in it".into()));
    }
    let folder = folder_of(path);
    if !folder.is_dir() {
        return Err(failure(format!(
            "its folder {} does not exist; make it first",
            folder.display()
        )));
    }
    let part = part_of(path);
    File::create(&part)
        .and_then(|file| {
            drop(file);
            fs::remove_file(&part)
        })
        .map_err(|error| failure(format!("can't be written ({error}); choose another place")))
}

/// `OUT.exr` to `OUT.left.0001.exr`.
pub(crate) fn numbered(path: &Path, eye: Option<&str>, frame: Option<u32>) -> PathBuf {
    let mut suffix = String::new();
    if let Some(eye) = eye {
        suffix += &format!(".{eye}");
    }
    if let Some(frame) = frame {
        suffix += &format!(".{frame:04}");
    }
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(suffix);
    if let Some(extension) = path.extension() {
        name.push(".");
        name.push(extension);
    }
    path.with_file_name(name)
}

/// Writes an image as OpenEXR.
pub(crate) fn write_exr(image: &Image, path: &Path) -> Result<(), Failure> {
    image
        .write_exr(path)
        .map_err(|error| Failure::new(Exit::Output, error.to_string()))
}

/// Writes a picture as PNG.
pub(crate) fn write_png(picture: &Picture, path: &Path) -> Result<(), Failure> {
    write_whole(path, |part| encode(picture, part))
}

/// Writes a text file.
pub(crate) fn write_text(text: &str, path: &Path) -> Result<(), Failure> {
    write_whole(path, |part| {
        fs::write(part, text).map_err(|error| error.to_string())
    })
}

/// Writes a file of bytes.
pub(crate) fn write_bytes(bytes: &[u8], path: &Path) -> Result<(), Failure> {
    write_whole(path, |part| {
        fs::write(part, bytes).map_err(|error| error.to_string())
    })
}

/// Writes beside, then renames: the path never holds half a file.
fn write_whole(
    path: &Path,
    write: impl FnOnce(&Path) -> Result<(), String>,
) -> Result<(), Failure> {
    let part = part_of(path);
    let written =
        write(&part).and_then(|()| fs::rename(&part, path).map_err(|error| error.to_string()));
    written.map_err(|problem| {
        // Nothing more can be done about a leftover that can't be removed either.
        let _ = fs::remove_file(&part);
        Failure::new(
            Exit::Output,
            format!("{}: can't be written ({problem})", path.display()),
        )
    })
}

fn encode(picture: &Picture, path: &Path) -> Result<(), String> {
    let file = File::create(path).map_err(|error| error.to_string())?;
    let encoder = PngEncoder::new_with_quality(
        BufWriter::new(file),
        CompressionType::Default,
        FilterType::Adaptive,
    );
    let opaque = picture.pixels.iter().all(|pixel| pixel[3] == 255);
    let (bytes, color) = if opaque {
        let rgb = picture.pixels.iter().flat_map(|&[r, g, b, _]| [r, g, b]);
        (rgb.collect(), ExtendedColorType::Rgb8)
    } else {
        (picture.pixels.concat(), ExtendedColorType::Rgba8)
    };
    encoder
        .write_image(&bytes, picture.width, picture.height, color)
        .map_err(|error| error.to_string())
}

fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

/// Where a file grows until it is whole.
fn part_of(path: &Path) -> PathBuf {
    let mut part = path.as_os_str().to_owned();
    part.push(".part");
    part.into()
}
