//! Asymmetric phantoms written by nibabel and pynrrd (`../expected/phantoms.py`) must land where
//! NumPy says.

use std::path::Path;

use glam::DVec3;
use serde_json::Value;

use crate::real::numbers;

fn check(name: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/phantoms")
        .join(name);
    let volume = holovol_volume::open(&path, &mut |_| {}).unwrap_or_else(|error| panic!("{error}"));
    let facts: Value = serde_json::from_str(include_str!("../expected/phantoms.json"))
        .expect("the expected places are JSON");
    let facts = &facts[name];
    assert_eq!(volume.dims(), [5, 4, 3]);
    assert_eq!(
        volume.geometry().axis_codes().as_deref(),
        facts["axis_codes"].as_str()
    );
    assert_eq!(volume.voxels().kind().name(), narrow_kind(name));
    let marks = facts["marks"].as_array().expect("a list of marks");
    assert_eq!(marks.len(), 3);
    for mark in marks {
        let mark = numbers(mark);
        let index = (0..60)
            .map(|i| [i % 5, i / 5 % 4, i / 20])
            .find(|&index| volume.value(index) == mark[0])
            .unwrap_or_else(|| panic!("{name} has no mark {}", mark[0]));
        let centre = DVec3::from_array(index.map(|i| i as f64 + 0.5)) / DVec3::new(5.0, 4.0, 3.0);
        let found = volume.world_from_unit_cube().transform_point3(centre);
        let expected = DVec3::new(mark[1], mark[2], mark[3]);
        // NIfTI-1 keeps f32.
        assert!(
            (found - expected).length() < 1e-6 * expected.length(),
            "{name}, mark {}: {found} instead of {expected}",
            mark[0]
        );
    }
}

/// Types of 4 and 8 bytes hold small integers here, which fit 8 bits.
fn narrow_kind(name: &str) -> &'static str {
    match name {
        "qform.nii" | "las_detached.nhdr" => "i16",
        "qform_mirrored_big.nii"
        | "lps_gzip.nrrd"
        | "lps_mirrored_raw.nrrd"
        | "ras_microns.nrrd" => "u16",
        _ => "u8",
    }
}

macro_rules! phantoms {
    ($($test:ident: $file:literal),* $(,)?) => {
        $(#[test] fn $test() { check($file); })*
    };
}

phantoms! {
    nifti_sform: "sform.nii",
    nifti_sform_mirrored: "sform_mirrored.nii.gz",
    nifti_sform_sheared: "sform_sheared.nii",
    nifti_qform: "qform.nii",
    nifti_qform_mirrored_big_endian: "qform_mirrored_big.nii",
    nifti2_sform: "nifti2_sform.nii.gz",
    nifti2_qform_big_endian: "nifti2_qform_big.nii",
    nifti_in_metres: "metres.nii",
    nifti_in_microns: "microns.nii",
    nifti_without_orientation: "no_orientation.nii",
    nrrd_lps: "lps_gzip.nrrd",
    nrrd_lps_mirrored_big_endian: "lps_mirrored_raw.nrrd",
    nrrd_ras_ascii: "ras_ascii.nrrd",
    nrrd_las_detached: "las_detached.nhdr",
    nrrd_ras_microns: "ras_microns.nrrd",
}
