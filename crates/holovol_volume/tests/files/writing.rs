//! What is written reads back the same, or is refused.

use holovol_volume::{Geometry, Label, ReadOptions, Volume, Voxels, open, write};

use crate::bytes::values;
use crate::formats;

fn round_trip(volume: &Volume, name: &str) -> Volume {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join(name);
    write(volume, &path, false).unwrap_or_else(|error| panic!("{name}: {error}"));
    open(&path, &mut |_| {}).unwrap_or_else(|error| panic!("{error}"))
}

fn refusal(volume: &Volume, name: &str) -> String {
    let folder = tempfile::tempdir().expect("a temporary folder");
    match write(volume, &folder.path().join(name), false) {
        Ok(()) => panic!("{name} was written"),
        Err(error) => error.to_string(),
    }
}

fn same(a: &Volume, b: &Volume, name: &str) {
    assert_eq!(a.dims(), b.dims(), "{name}");
    assert_eq!(values(a), values(b), "{name}");
    assert_eq!(a.geometry().oriented, b.geometry().oriented, "{name}");
    let difference = a.world_from_unit_cube() - b.world_from_unit_cube();
    let worst = difference
        .to_cols_array()
        .map(f64::abs)
        .into_iter()
        .fold(0.0, f64::max);
    assert!(worst < 1e-14, "{name}: {worst}");
}

const NAMES: [&str; 4] = ["a.nrrd", "a.nii", "a.nii.gz", "a.raw"];

#[test]
fn phantoms_survive_every_format() {
    for source in ["itk.nrrd", "dicom_tilted", "ome.ome.tif", "sidecar.raw"] {
        let volume = formats::open(source);
        for name in NAMES {
            same(
                &volume,
                &round_trip(&volume, name),
                &format!("{source} to {name}"),
            );
        }
    }
    let free = formats::open("float.vdb");
    for name in ["a.nrrd", "a.raw"] {
        same(&free, &round_trip(&free, name), name);
    }
    assert!(refusal(&free, "a.nii").contains("without a patient"));
}

#[test]
fn every_type_and_scaling_survives() {
    let geometry = Geometry::from_spacing([1e-3, 2e-3, 3e-3]);
    for voxels in [
        Voxels::U8(vec![0, 1, 255]),
        Voxels::I8(vec![-128, 0, 127]),
        Voxels::U16(vec![0, 1, 65_535]),
        Voxels::I16(vec![-32_768, 0, 32_767]),
        Voxels::F32(vec![-1e30, 0.1, 3.5]),
    ] {
        for (slope, intercept) in [(1.0, 0.0), (2.0, -1000.0), (0.25, 3.0), (2.00784, 0.1)] {
            let volume = Volume::new(voxels.clone(), [3, 1, 1], slope, intercept, geometry)
                .expect("it fits");
            for name in NAMES {
                let folder = tempfile::tempdir().expect("a temporary folder");
                let path = folder.path().join(name);
                write(&volume, &path, false).unwrap_or_else(|error| panic!("{error}"));
                let again = open(&path, &mut |_| {}).unwrap_or_else(|error| panic!("{error}"));
                // What NRRD holds as f64 is kept as f32 when it is read.
                let tolerance = if again.is_rounded() { 1e-7 } else { 0.0 };
                for (a, b) in values(&volume).into_iter().zip(values(&again)) {
                    assert!((a - b).abs() <= tolerance * a.abs(), "{name}: {a} {b}");
                }
            }
        }
    }
}

#[test]
fn what_a_format_cannot_hold_is_refused() {
    let geometry = Geometry::from_spacing([1e-3; 3]);
    let new = |voxels| Volume::new(voxels, [2, 1, 1], 1.0, 0.0, geometry).expect("it fits");
    let holes = new(Voxels::F32(vec![f32::NAN, 1.0]));
    assert!(refusal(&holes, "a.nrrd").contains("1 voxels were not finite"));
    let rounded = new(Voxels::U8(vec![1, 2])).with_rounded(true);
    assert!(refusal(&rounded, "a.nii").contains("--lossy"));
    let label = Label {
        value: 2.0,
        name: "liver".into(),
        color: Some([1.0, 0.5, 0.0]),
    };
    let labels = new(Voxels::U8(vec![1, 2])).with_labels(vec![label]);
    assert!(refusal(&labels, "a.nii").contains("names of labels"));
    assert_eq!(round_trip(&labels, "a.seg.nrrd").labels(), labels.labels());
    let unnamed = new(Voxels::U8(vec![1, 2])).with_labels(Vec::new());
    assert_eq!(round_trip(&unnamed, "a.nii").labels(), Some([].as_slice()));
    assert!(refusal(&unnamed, "a.raw").contains("labels"));
    assert!(refusal(&unnamed, "a.jpg").contains(".nrrd, .nii"));
}

#[test]
fn choices_reach_further_volumes() {
    let file = crate::bytes::Nifti::new(false, false, 2, &[2, 1, 1, 3], &[1u8, 2, 3, 4, 5, 6]);
    let bytes = file.bytes();
    let input = holovol_volume::Input::from_bytes(std::path::Path::new("memory"), &bytes);
    let options = ReadOptions::default().with_choice("3");
    let volume = holovol_volume::read(input, &options, &mut |_| {}).expect("it is there");
    assert_eq!(values(&volume), [5.0, 6.0]);
}
