//! The phantom of `../expected/formats.py`, written in every format by other libraries, must land
//! where NumPy says; compressed DICOM must decode to what the libraries decode it to.

use std::path::{Path, PathBuf};

use glam::DVec3;
use holovol_volume::{ReadOptions, Volume, open_with};
use serde_json::Value;

use crate::bytes::values;
use crate::real::numbers;

pub fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/phantoms/formats")
}

pub fn open(name: &str) -> Volume {
    holovol_volume::open(&folder().join(name), &mut |_| {}).unwrap_or_else(|e| panic!("{e}"))
}

/// The places of the marks, to 1e-5 of the phantom's size.
fn check(volume: &Volume, facts: &Value, name: &str) {
    assert_eq!(volume.dims(), [5, 4, 3], "{name}");
    let marks = facts["marks"].as_array().expect("a list of marks");
    assert_eq!(marks.len(), 3);
    // Of lossy compression.
    let tolerance = facts["tolerance"].as_f64().unwrap_or(0.0);
    let size = DVec3::from_array(volume.geometry().spacing()) * DVec3::new(5.0, 4.0, 3.0);
    for mark in marks {
        let mark = numbers(mark);
        let found: Vec<[i64; 3]> = (0..60)
            .map(|i| [i % 5, i / 5 % 4, i / 20])
            .filter(|&index| (volume.value(index) - mark[0]).abs() <= tolerance)
            .collect();
        let [index] = found[..] else {
            panic!("{name}: mark {} is at {found:?}", mark[0]);
        };
        let centre = DVec3::from_array(index.map(|i| i as f64 + 0.5)) / DVec3::new(5.0, 4.0, 3.0);
        let place = volume.world_from_unit_cube().transform_point3(centre);
        let expected = DVec3::new(mark[1], mark[2], mark[3]);
        assert!(
            (place - expected).length() < 1e-5 * size.length(),
            "{name}, mark {}: {place} instead of {expected}",
            mark[0]
        );
    }
    let sevens = values(volume)
        .iter()
        .filter(|&&value| (value - 7.0).abs() <= tolerance)
        .count();
    assert_eq!(sevens, 57, "{name}");
}

#[test]
fn phantoms_of_all_formats_land_where_numpy_says() {
    let facts: Value = serde_json::from_str(include_str!("../expected/formats.json"))
        .expect("the expected places are JSON");
    let facts = facts.as_object().expect("an object");
    assert!(facts.len() > 20, "{}", facts.len());
    let mut failures = Vec::new();
    for (name, facts) in facts {
        let mut options = ReadOptions::default();
        if let Some(choice) = facts["choice"].as_str() {
            options = options.with_choice(choice);
        }
        match open_with(&folder().join(name), &options, &mut |_| {}) {
            Ok(volume) => check(&volume, facts, name),
            Err(error) => failures.push(error.to_string()),
        }
    }
    assert_eq!(failures, [] as [String; 0]);
}

/// Compressed and plain files of one image.
fn same(packed: &str, plain: &str, tolerance: f64) {
    let [packed_values, plain_values] = [packed, plain].map(|name| {
        let volume = open(&format!("codecs/{name}.dcm"));
        assert_eq!(volume.dims(), [53, 37, 1]);
        values(&volume)
    });
    let worst = packed_values
        .iter()
        .zip(&plain_values)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max);
    assert!(worst <= tolerance, "{packed}: off by {worst}");
    let spread = plain_values.iter().fold(0.0f64, |a, b| a.max(b.abs()));
    assert!(spread > 100.0, "{plain} holds an image");
}

#[test]
fn lossless_dicom_decodes_exactly() {
    for kind in ["u8", "u12", "s16"] {
        for codec in ["rle", "jpegls", "jpeg2000", "jpeg_lossless"] {
            same(&format!("{kind}_{codec}"), &format!("{kind}_plain"), 0.0);
        }
    }
}

#[test]
fn lossy_dicom_decodes_as_others_decode_it() {
    // The inverse cosine transform may round to either side.
    same("lossy_jpeg", "lossy_jpeg_plain", 1.0);
    same("lossy_jpegls", "lossy_jpegls_plain", 0.0);
    same("lossy_jpeg2000", "lossy_jpeg2000_plain", 1.0);
}
