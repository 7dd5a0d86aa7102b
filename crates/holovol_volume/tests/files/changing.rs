//! Files that are written to, cut short or replaced while they are read.

use std::io::Write;
use std::path::{Path, PathBuf};

use holovol_volume::{VolumeError, open};

use crate::formats;

/// What happens to a file at the first sign of progress.
type Change = fn(&Path);

fn append(path: &Path) {
    let file = std::fs::OpenOptions::new().append(true).open(path);
    file.and_then(|mut file| file.write_all(&[0]))
        .expect("written");
}

fn cut(path: &Path) {
    let file = std::fs::OpenOptions::new().write(true).open(path);
    file.and_then(|file| file.set_len(100)).expect("cut");
}

/// As programs save: another file takes the name. Of equal length, but later.
fn replace(path: &Path) {
    let bytes = std::fs::read(path).expect("read");
    let beside = path.with_extension("beside");
    std::fs::write(&beside, bytes).expect("written");
    let later = std::time::SystemTime::now() + std::time::Duration::from_secs(5);
    std::fs::File::options()
        .write(true)
        .open(&beside)
        .and_then(|file| file.set_modified(later))
        .expect("set");
    std::fs::rename(beside, path).expect("renamed");
}

fn remove(path: &Path) {
    std::fs::remove_file(path).expect("removed");
}

const CHANGES: [(&str, Change); 4] = [
    ("append", append),
    ("cut", cut),
    ("replace", replace),
    ("remove", remove),
];

fn copy(from: &Path, to: &Path) {
    if from.is_dir() {
        std::fs::create_dir_all(to).expect("a folder");
        for entry in std::fs::read_dir(from).expect("a folder").flatten() {
            copy(&entry.path(), &to.join(entry.file_name()));
        }
    } else {
        std::fs::copy(from, to).expect("copied");
    }
}

/// Opens `opened`, and changes `changed` as soon as there is progress.
fn assert_noticed(opened: &str, changed: &str) {
    for (what, change) in CHANGES {
        let folder = tempfile::tempdir().expect("a folder");
        // With its data file or sidecar.
        let stem = opened.split('.').next().unwrap_or(opened);
        for entry in std::fs::read_dir(formats::folder())
            .expect("there")
            .flatten()
        {
            if entry.file_name().to_string_lossy().starts_with(stem) {
                copy(&entry.path(), &folder.path().join(entry.file_name()));
            }
        }
        let target: PathBuf = folder.path().join(changed);
        let mut is_changed = false;
        let result = open(&folder.path().join(opened), &mut |_| {
            if !std::mem::replace(&mut is_changed, true) {
                change(&target);
            }
        });
        assert!(is_changed, "{opened} tells its progress");
        match result {
            Err(VolumeError::Changed { path }) => {
                assert_eq!(path, target, "{what} {changed}");
            }
            other => panic!("{what} {changed} while {opened} is read: {other:?}"),
        }
    }
}

#[test]
fn changes_of_every_format_are_noticed() {
    for name in [
        "itk.nii",
        "itk.nrrd",
        "itk.mha",
        "float.vdb",
        "half.vdb",
        "ome.ome.tif",
        "ome_tiled.ome.tif",
        "imagej.tif",
        "dicom_enhanced.dcm",
        "dicom_zip.zip",
        "sidecar.raw",
    ] {
        assert_noticed(name, name);
    }
}

#[test]
fn changes_of_data_files_and_slices_are_noticed() {
    assert_noticed("itk.mhd", "itk.raw");
    assert_noticed("itk.hdr", "itk.img");
    for slice in ["0.dcm", "1.dcm", "2.dcm"] {
        assert_noticed("dicom_implicit", &format!("dicom_implicit/{slice}"));
    }
}
