//! Finding the format, and what goes wrong around a file rather than in it.

use std::fs;
use std::io::Write;
use std::path::Path;

use holovol_volume::{ReadOptions, open, open_with};

use crate::bytes::{Nifti, gzip, nrrd, values};

fn message(path: &Path) -> String {
    match open(path, &mut |_| {}) {
        Ok(volume) => panic!("read {:?}", volume.dims()),
        Err(error) => error.to_string(),
    }
}

#[test]
fn content_goes_before_name() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let nifti = Nifti::new(false, false, 2, &[2], &[3u8, 4]).bytes();
    let raw = nrrd(
        &["type: uint8", "dimension: 1", "sizes: 2", "encoding: raw"],
        &[3, 4],
    );
    for (name, bytes) in [
        ("a.nrrd", &nifti),
        ("b.nii", &raw),
        ("c", &gzip(&nifti)),
        ("d.nii", &gzip(&raw)),
    ] {
        let path = folder.path().join(name);
        fs::write(&path, bytes).expect("it can be written");
        let volume = open(&path, &mut |_| {}).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(values(&volume), [3.0, 4.0], "{name}");
    }
}

#[test]
fn a_scene_that_lies_where_a_sidecar_would_is_none() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("a.nrrd");
    let header = ["type: uint8", "dimension: 1", "sizes: 2", "encoding: raw"];
    fs::write(&path, nrrd(&header, &[3, 4])).expect("it can be written");
    let beside = folder.path().join("a.nrrd.json");
    let scene = r#"{"version": 1, "volume": {"path": "a.nrrd"}, "camera": {"eye": [0, 0, 1]}}"#;
    fs::write(&beside, scene).expect("it can be written");
    let volume = open(&path, &mut |_| {}).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(values(&volume), [3.0, 4.0]);
    // What is meant for a sidecar is not passed over.
    fs::write(&beside, r#"{"dim": [2, 1, 1], "type": "u8"}"#).expect("it can be written");
    assert!(message(&path).contains("a.nrrd.json"));
}

#[test]
fn what_is_no_volume_is_told_so() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name);
    fs::write(path("empty.nii"), b"").expect("it can be written");
    fs::write(path("text.txt"), b"hello").expect("it can be written");
    fs::write(path("text.nii"), b"hello").expect("it can be written");
    fs::write(
        path("half.nii"),
        &Nifti::new(false, false, 2, &[2], &[3u8, 4]).bytes()[..100],
    )
    .expect("it can be written");
    for (name, parts) in [
        ("", ["folder", ".nhdr"]),
        ("missing.nii", ["missing.nii", "No such file"]),
        ("empty.nii", ["is empty", ".nii.gz"]),
        ("text.txt", ["not known", "NRRD (.nrrd"]),
        ("text.nii", ["`sizeof_hdr`", "348"]),
        ("half.nii", ["within its NIfTI header", "complete copy"]),
    ] {
        let text = message(&path(name));
        for part in parts {
            if cfg!(windows) && part == "No such file" {
                continue;
            }
            assert!(text.contains(part), "{text} lacks {part}");
        }
    }
}

#[test]
fn detached_data_is_found_beside_its_header() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name);
    let header = |data: &str| {
        let data = format!("data file: {data}");
        let lines = [
            "type: uint8",
            "dimension: 1",
            "sizes: 2",
            "encoding: raw",
            &data,
        ];
        format!("NRRD0004\n{}\n", lines.join("\n"))
    };
    fs::create_dir(path("sub")).expect("it can be made");
    fs::write(path("sub/data.raw"), [8, 9]).expect("it can be written");
    fs::write(path("a.nhdr"), header("sub/data.raw")).expect("it can be written");
    let volume = open(&path("a.nhdr"), &mut |_| {}).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(values(&volume), [8.0, 9.0]);

    for (data, part) in [("gone.raw", "gone.raw"), ("sub", "not a regular file")] {
        fs::write(path("a.nhdr"), header(data)).expect("it can be written");
        let text = message(&path("a.nhdr"));
        assert!(text.contains("a.nhdr") && text.contains(part), "{text}");
    }
    fs::write(path("short.raw"), [8]).expect("it can be written");
    fs::write(path("a.nhdr"), header("short.raw")).expect("it can be written");
    let text = message(&path("a.nhdr"));
    assert!(
        text.contains("short.raw") && text.contains("2 bytes"),
        "{text}"
    );
}

#[test]
fn the_limit_on_voxel_bytes_holds() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("a.nii");
    fs::write(
        &path,
        Nifti::new(false, false, 4, &[3], &[1i16, 2, 3]).bytes(),
    )
    .expect("written");
    let read = |limit| {
        open_with(
            &path,
            &ReadOptions::default().with_max_voxel_bytes(limit),
            &mut |_| {},
        )
    };
    assert!(read(6).is_ok());
    let text = read(5)
        .err()
        .map(|error| error.to_string())
        .unwrap_or_default();
    assert!(
        text.contains("6 bytes") && text.contains("limit of 5"),
        "{text}"
    );
}

#[test]
fn what_macos_adds_to_archives_is_no_second_volume() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("a.zip");
    let volume = Nifti::new(false, false, 4, &[3], &[1i16, 2, 3]).bytes();
    let mut archive = zip::ZipWriter::new(fs::File::create(&path).expect("new"));
    for (name, bytes) in [
        ("x/a.nii", volume.as_slice()),
        ("__MACOSX/x/._a.nii", b"\0\x05\x16\x07"),
    ] {
        let options = zip::write::SimpleFileOptions::default()
            .compression_method(zip::CompressionMethod::Deflated);
        archive.start_file(name, options).expect("written");
        archive.write_all(bytes).expect("written");
    }
    archive.finish().expect("written");
    let volume = open(&path, &mut |_| {}).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(values(&volume), [1.0, 2.0, 3.0]);
}

#[test]
fn other_programs_sidecars_are_passed_over() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let bytes = Nifti::new(false, false, 4, &[3], &[1i16, 2, 3]).bytes();
    for name in ["a.nii", "a.raw"] {
        let path = folder.path().join(name);
        fs::write(&path, &bytes[if name == "a.raw" { 352 } else { 0 }..]).expect("written");
        let sidecar = folder.path().join(format!("{name}.json"));
        fs::write(&sidecar, r#"{ "Modality": "MR" }"#).expect("written");
    }
    let volume = open(&folder.path().join("a.nii"), &mut |_| {});
    assert_eq!(
        values(&volume.unwrap_or_else(|error| panic!("{error}"))),
        [1.0, 2.0, 3.0]
    );
    let error = open(&folder.path().join("a.raw"), &mut |_| {}).err();
    assert!(error.is_some_and(|error| error.to_string().contains("--raw-dims")));
}

#[test]
fn damage_in_archives_is_found_by_their_check_sums() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("a.zip");
    let nifti = Nifti::new(false, false, 4, &[3], &[1i16, 2, 0x1234]).bytes();
    let dicom = crate::formats::folder().join("dicom_explicit/1.dcm");
    let dicom = fs::read(dicom).expect("the phantom");
    for (name, bytes) in [("a.nii", nifti), ("a.dcm", dicom)] {
        let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
        let options = zip::write::SimpleFileOptions::default()
            .compression_method(zip::CompressionMethod::Stored);
        archive.start_file(name, options).expect("written");
        archive.write_all(&bytes).expect("written");
        let mut whole = archive.finish().expect("written").into_inner();
        fs::write(&path, &whole).expect("written");
        open(&path, &mut |_| {}).unwrap_or_else(|error| panic!("{name}: {error}"));
        let end = whole.windows(bytes.len()).position(|part| part == bytes);
        let end = end.expect("it is stored") + bytes.len();
        whole[end - 1] ^= 1;
        fs::write(&path, &whole).expect("written");
        let error = open(&path, &mut |_| {})
            .err()
            .map(|error| error.to_string());
        let text = error.unwrap_or_default().to_lowercase();
        assert!(
            text.contains("checksum") || text.contains("check sum"),
            "{name}: {text}"
        );
    }
}

#[test]
fn compressions_of_tiff_that_are_not_read_are_named() {
    let bytes = fs::read(crate::formats::folder().join("white.tif")).expect("the phantom");
    let entry = [3, 1, 3, 0, 1, 0, 0, 0];
    for (number, name) in [
        (34_925u16, "LZMA"),
        (50_000, "Zstandard"),
        (7, "JPEG"),
        (999, "number 999"),
    ] {
        let mut bytes = bytes.clone();
        let places: Vec<usize> = (0..bytes.len() - 8)
            .filter(|&at| bytes[at..at + 8] == entry)
            .collect();
        assert_eq!(places.len(), 3, "one for each page");
        for at in places {
            bytes[at + 8..at + 10].copy_from_slice(&number.to_le_bytes());
        }
        let text = crate::bytes::message(&bytes);
        assert!(text.contains(name) && text.contains("save it"), "{text}");
    }
}

#[test]
fn archives_of_more_members_than_bytes_are_refused_before_they_are_listed() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("many.zip");
    // An empty archive of ZIP64 that claims 2^40 members; the old record at the end does not.
    let mut bytes = b"PK\x03\x04".to_vec();
    bytes.extend([0; 26]);
    let record = bytes.len() as u64;
    bytes.extend(b"PK\x06\x06");
    bytes.extend(44u64.to_le_bytes());
    bytes.extend([45, 0, 45, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    bytes.extend((1u64 << 40).to_le_bytes());
    bytes.extend((1u64 << 40).to_le_bytes());
    bytes.extend([0; 16]);
    bytes.extend(b"PK\x06\x07\0\0\0\0");
    bytes.extend(record.to_le_bytes());
    bytes.extend(1u32.to_le_bytes());
    bytes.extend(b"PK\x05\x06");
    bytes.extend([0; 18]);
    fs::write(&path, &bytes).expect("it can be written");
    let told = message(&path);
    assert!(told.contains("claims 1099511627776 members"), "{told}");
}

#[test]
fn big_tiffs_with_unknown_types_are_refused_rather_than_read_askew() {
    let seeds = concat!(env!("CARGO_MANIFEST_DIR"), "/../../fuzz/seeds/tiff/");
    let told = message(Path::new(&format!("{seeds}unknown_types.tif")));
    assert!(told.contains("an entry of type"), "{told}");
}
