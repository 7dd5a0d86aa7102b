//! Output files: checked before the work, written beside and then renamed.

use std::fs::{self, File};
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

/// Finds out whether a numbered name is taken by a folder.
///
/// # Errors
/// If it is.
pub(crate) fn check_numbered(path: &Path, option: &str) -> Result<(), Failure> {
    if !path.is_dir() {
        return Ok(());
    }
    Err(Failure::new(
        Exit::Output,
        format!(
            "{option}: {} is a folder; move it, or choose another name",
            path.display()
        ),
    ))
}

/// Writes an image as OpenEXR. If its place is full by now, the image is kept in the folder for
/// temporary files.
pub(crate) fn write_exr(image: &Image, path: &Path) -> Result<(), Failure> {
    let Err(error) = image.write_exr(path) else {
        return Ok(());
    };
    let name = path.file_name().unwrap_or_default();
    let refuge = std::env::temp_dir().join(name);
    let kept = !refuge.exists() && image.write_exr(&refuge).is_ok();
    let way_out = if kept {
        format!("the image is kept as {}", refuge.display())
    } else {
        "make room or choose another place, and render again".into()
    };
    Err(Failure::new(Exit::Output, format!("{error}; {way_out}")))
}

/// Writes a picture as PNG.
pub(crate) fn write_png(picture: &Picture, path: &Path) -> Result<(), Failure> {
    let bytes = encode(picture).map_err(|problem| {
        Failure::new(Exit::Internal, format!("{}: {problem}", path.display()))
    })?;
    write_whole(path, &bytes)
}

/// Writes a text file.
pub(crate) fn write_text(text: &str, path: &Path) -> Result<(), Failure> {
    write_whole(path, text.as_bytes())
}

/// Writes bytes beside, then renames: the path never holds half a file.
pub(crate) fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    // A link stays a link: what it points to is replaced.
    let place = fs::canonicalize(path).unwrap_or_else(|_| path.into());
    let part = part_of(&place);
    let written = fs::write(&part, bytes).and_then(|()| fs::rename(&part, &place));
    written.map_err(|error| {
        // Nothing more can be done about a leftover that can't be removed either.
        let _ = fs::remove_file(&part);
        Failure::new(
            Exit::Output,
            format!(
                "{}: can't be written ({error}); make room or choose another place",
                path.display()
            ),
        )
    })
}

/// As PNG, in memory: an encoder that writes to a file would swallow the error of its last bytes.
fn encode(picture: &Picture) -> Result<Vec<u8>, String> {
    let mut file = Vec::new();
    let encoder =
        PngEncoder::new_with_quality(&mut file, CompressionType::Default, FilterType::Adaptive);
    let opaque = picture.pixels.iter().all(|pixel| pixel[3] == 255);
    let (bytes, color) = if opaque {
        let rgb = picture.pixels.iter().flat_map(|&[r, g, b, _]| [r, g, b]);
        (rgb.collect(), ExtendedColorType::Rgb8)
    } else {
        (picture.pixels.concat(), ExtendedColorType::Rgba8)
    };
    encoder
        .write_image(&bytes, picture.width, picture.height, color)
        .map_err(|error| error.to_string())?;
    Ok(file)
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
