use std::path::Path;

use crate::measures::{compare, flip, mean, mse, relmse, ssim, tone_map, white_point};
use crate::{Image, ImageError};

fn gradient(width: u32, height: u32) -> Image {
    let pixels = (0..width * height).map(|i| {
        let (x, y) = ((i % width) as f32, (i / width) as f32);
        [x / 10.0, y / 10.0, (x * y) / 100.0, 1.0]
    });
    Image::new(width, height, pixels.collect())
}

#[test]
fn exr_files_come_back_as_written() {
    let folder = tempfile::tempdir().expect("a folder for the test");
    let path = folder.path().join("picture.exr");
    let mut pixels = gradient(37, 21).pixels().to_vec();
    pixels[3] = [1e9, f32::INFINITY, -0.0, 0.25];
    let image = Image::new(37, 21, pixels);
    image.write_exr(&path).expect("written");
    assert_eq!(Image::read_exr(&path).expect("read"), image);
    let names: Vec<_> = folder.path().read_dir().expect("a folder").collect();
    assert_eq!(names.len(), 1, "no .part is left: {names:?}");
}

#[test]
fn unusable_files_are_named_and_explained() {
    let folder = tempfile::tempdir().expect("a folder for the test");
    let missing = Image::read_exr(&folder.path().join("missing.exr"));
    assert!(matches!(missing, Err(ImageError::Io { .. })), "{missing:?}");
    let path = folder.path().join("text.exr");
    std::fs::write(&path, "no picture at all").expect("written");
    let text = Image::read_exr(&path).expect_err("no picture").to_string();
    assert!(
        text.contains("text.exr") && text.contains("R, G, B"),
        "{text}"
    );

    let whole = folder.path().join("whole.exr");
    gradient(64, 64).write_exr(&whole).expect("written");
    let bytes = std::fs::read(&whole).expect("read");
    for length in [0, 8, 100, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(&path, &bytes[..length]).expect("written");
        let error = Image::read_exr(&path).expect_err("cut off").to_string();
        assert!(error.contains("text.exr"), "{error}");
    }
    // A header that claims 30 000 × 30 000 pixels.
    let mut claims = bytes;
    let window = claims
        .windows(11)
        .position(|w| w == b"dataWindow\0")
        .expect("every EXR has one");
    // Name, type "box2i\0", length, then xMin, yMin, xMax, yMax.
    let corner = window + 11 + 6 + 4 + 8;
    for at in [corner, corner + 4] {
        claims[at..at + 4].copy_from_slice(&29_999i32.to_le_bytes());
    }
    std::fs::write(&path, &claims).expect("written");
    let error = Image::read_exr(&path).expect_err("claims too much");
    assert!(error.to_string().contains("30000 × 30000"), "{error}");
}

#[test]
fn unwritable_places_are_named() {
    let folder = tempfile::tempdir().expect("a folder for the test");
    let path = folder.path().join("no/such/folder/a.exr");
    let error = gradient(2, 2).write_exr(&path).expect_err("no folder");
    assert!(error.to_string().contains("no/such/folder"), "{error}");
    // A folder is in the way: the part file is removed again.
    let taken = folder.path().join("taken.exr");
    std::fs::create_dir_all(taken.join("full")).expect("made");
    gradient(2, 2)
        .write_exr(&taken)
        .expect_err("a folder is there");
    assert!(!Path::new(&folder.path().join("taken.exr.part")).exists());
}

#[test]
fn error_measures_have_their_formulas_values() {
    let a = Image::new(1, 2, vec![[0.5, 0.0, 1.0, 1.0], [0.0; 4]]);
    let b = Image::new(1, 2, vec![[0.3, 0.1, 1.0, 0.0], [0.0; 4]]);
    let close = |x: f64, y: f64| assert!((x - y).abs() < 1e-7, "{x} is not {y}");
    close(
        relmse(&a, &b).expect("same size"),
        (0.04 / 0.1 + 0.01 / 0.02) / 6.0,
    );
    close(mse(&a, &b).expect("same size"), 0.05 / 6.0);
    close(mean(&a)[0], 0.25);
    close(mean(&a)[3], 0.5);
    assert!(relmse(&a, &gradient(3, 3)).is_err());
}

#[test]
fn white_is_the_99th_percentile_of_the_reference() {
    let pixels = (0..200).map(|i| [i as f32, i as f32, i as f32, 1.0]);
    let image = Image::new(20, 10, pixels.collect());
    assert!((white_point(&image) - 197.0).abs() < 1e-6);
    let black = Image::new(2, 1, vec![[0.0; 4]; 2]);
    assert_eq!(white_point(&black), 1.0);
    // Half of the range is 188 in sRGB; beyond white and NaN are clamped.
    let values = Image::new(
        2,
        1,
        vec![[98.5, 0.0, 1e9, 1.0], [f32::NAN, -1.0, 0.2, 1.0]],
    );
    assert_eq!(tone_map(&values, 197.0), [[188, 0, 255], [0, 0, 3]]);
}

#[test]
fn equal_pictures_are_perfect_and_worse_ones_order_themselves() {
    let reference = gradient(48, 40);
    let same = compare(&reference, &reference).expect("same size");
    assert_eq!((same.relmse, same.flip), (0.0, 0.0));
    assert!((same.ssim - 1.0).abs() < 1e-12 && same.psnr.is_infinite());
    let noisy = |strength: f32| {
        let mut rng = crate::rng::Rng::new(2, 0, 0);
        let pixels = reference
            .pixels()
            .iter()
            .map(|pixel| pixel.map(|c| (c + strength * (rng.uniform() as f32 - 0.5)).max(0.0)));
        Image::new(48, 40, pixels.collect())
    };
    let [mild, strong] = [0.2, 1.5].map(|s| compare(&noisy(s), &reference).expect("same size"));
    assert!(mild.relmse < strong.relmse && mild.flip < strong.flip);
    assert!(mild.ssim > strong.ssim && mild.psnr > strong.psnr);
    assert!(mild.flip > 0.0 && strong.flip < 1.0);
}

#[test]
fn structural_similarity_has_known_values() {
    // Two flat pictures: only the luminance term is left, (2ab + C1)/(a² + b² + C1).
    let flat = |value: f32| Image::new(16, 16, vec![[value, value, value, 1.0]; 256]);
    let (a, b) = (flat(0.5), flat(1.0));
    let expected = (2.0 * 188.0 * 255.0 + 6.5025) / (188.0f64.powi(2) + 255.0f64.powi(2) + 6.5025);
    let got = ssim(&a, &b).expect("same size");
    assert!((got - expected).abs() < 1e-9, "{got} is not {expected}");
    assert!(flip(&a, &b).expect("same size") > 0.05);
}
