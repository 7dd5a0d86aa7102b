//! DICOM series: which there are, in which order, and what is said of them.

use std::fs;
use std::path::Path;

use holovol_volume::{ReadOptions, Volume, VolumeError, contents, open, open_with};

use crate::bytes::values;

const SECRET: &str = "SECRET^NAME";

/// A slice of 2 × 2 pixels in implicit VR, little-endian.
#[derive(Clone)]
struct Slice {
    elements: Vec<(u32, Vec<u8>)>,
}

impl Slice {
    fn at(z: f64, pixels: [u16; 4]) -> Self {
        let mut slice = Self {
            elements: Vec::new(),
        };
        slice.text(0x0010_0010, SECRET);
        slice.text(0x0010_0020, SECRET);
        slice.text(0x0008_0060, "CT");
        slice.text(0x0020_000e, "1.2.3");
        slice.text(0x0020_0011, "1");
        slice.text(0x0008_0018, &format!("1.2.3.{z}"));
        slice.text(0x0020_0032, &format!("0\\0\\{z}"));
        slice.text(0x0020_0037, "1\\0\\0\\0\\1\\0");
        slice.text(0x0028_0030, "0.5\\0.5");
        slice.text(0x0028_0004, "MONOCHROME2");
        for (tag, number) in [
            (0x0028_0002, 1),
            (0x0028_0010, 2),
            (0x0028_0011, 2),
            (0x0028_0100, 16),
            (0x0028_0101, 16),
            (0x0028_0102, 15),
            (0x0028_0103, 0),
        ] {
            slice.number(tag, number);
        }
        let bytes = pixels.iter().flat_map(|p| p.to_le_bytes()).collect();
        slice.put(0x7fe0_0010, bytes);
        slice
    }

    fn put(&mut self, tag: u32, mut value: Vec<u8>) {
        if value.len() % 2 == 1 {
            value.push(b' ');
        }
        self.elements.retain(|(other, _)| *other != tag);
        self.elements.push((tag, value));
        self.elements.sort();
    }

    fn text(&mut self, tag: u32, text: &str) {
        self.put(tag, text.as_bytes().to_vec());
    }

    fn number(&mut self, tag: u32, number: u16) {
        self.put(tag, number.to_le_bytes().to_vec());
    }

    fn with_text(mut self, tag: u32, text: &str) -> Self {
        self.text(tag, text);
        self
    }

    fn with_number(mut self, tag: u32, number: u16) -> Self {
        self.number(tag, number);
        self
    }

    fn bytes(&self) -> Vec<u8> {
        let mut bytes = vec![0; 128];
        bytes.extend(b"DICM");
        let uid = b"1.2.840.10008.1.2\0";
        bytes.extend([2, 0, 0x10, 0, b'U', b'I', uid.len() as u8, 0]);
        bytes.extend(uid);
        for (tag, value) in &self.elements {
            bytes.extend(((tag >> 16) as u16).to_le_bytes());
            bytes.extend((*tag as u16).to_le_bytes());
            bytes.extend((value.len() as u32).to_le_bytes());
            bytes.extend(value);
        }
        bytes
    }
}

struct Study(tempfile::TempDir);

impl Study {
    fn new(slices: &[Slice]) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        for (number, slice) in slices.iter().enumerate() {
            let name = format!("{number}.dcm");
            fs::write(folder.path().join(name), slice.bytes()).expect("it can be written");
        }
        Self(folder)
    }

    fn path(&self) -> &Path {
        self.0.path()
    }

    fn volume(&self) -> Volume {
        let volume = open(self.path(), &mut |_| {}).unwrap_or_else(|error| panic!("{error}"));
        assert!(!format!("{volume:?}").contains("SECRET"));
        volume
    }

    fn error(&self) -> VolumeError {
        let error = match open(self.path(), &mut |_| {}) {
            Ok(volume) => panic!("read {:?}", volume.dims()),
            Err(error) => error,
        };
        assert!(!format!("{error} {error:?}").contains("SECRET"));
        error
    }
}

fn notices(volume: &Volume) -> String {
    volume.notices().join("\n")
}

#[test]
fn slices_are_sorted_by_position_whatever_their_names() {
    let at = |z: f64| Slice::at(z, [z as u16; 4]);
    let study = Study::new(&[at(30.0), at(10.0), at(20.0)]);
    fs::write(study.path().join("DICOMDIR"), b"no image").expect("written");
    fs::create_dir(study.path().join("sub")).expect("made");
    fs::write(study.path().join("sub/40"), at(40.0).bytes()).expect("written");
    let volume = study.volume();
    assert_eq!(volume.dims(), [2, 2, 4]);
    assert_eq!(values(&volume)[..5], [10.0, 10.0, 10.0, 10.0, 20.0]);
    assert_eq!(volume.geometry().spacing(), [5e-4, 5e-4, 1e-2]);
    assert_eq!(volume.geometry().axis_codes().as_deref(), Some("LPS"));
    assert_eq!(volume.notices(), &[] as &[String]);
}

#[test]
fn several_series_are_listed_and_one_is_chosen() {
    let first = |z: f64| Slice::at(z, [1; 4]);
    let second = |z: f64| {
        Slice::at(z, [2; 4])
            .with_text(0x0020_000e, "1.2.4")
            .with_text(0x0008_0018, &format!("9.{z}"))
            .with_text(0x0020_0011, "2")
            .with_text(0x0008_103e, "thin")
            .with_text(0x0008_0060, "MR")
    };
    let study = Study::new(&[
        second(0.0),
        first(0.0),
        second(1.0),
        first(2.0),
        second(2.0),
    ]);
    let text = study.error().to_string();
    for part in [
        "2 series",
        "1: CT",
        "2: MR \"thin\"",
        "2 × 2 × 3",
        "spacing 0.5 × 0.5 × 1 mm",
    ] {
        assert!(text.contains(part), "{text} lacks {part}");
    }
    let listed = contents(study.path(), &ReadOptions::default()).expect("a list");
    assert_eq!(listed.len(), 2);
    assert_eq!(listed[0].dims, Some([2, 2, 2]));
    let options = ReadOptions::default().with_choice("2");
    let volume = open_with(study.path(), &options, &mut |_| {}).expect("it is there");
    assert_eq!((volume.dims(), volume.range()), ([2, 2, 3], [2.0, 2.0]));
    let options = ReadOptions::default().with_choice("3");
    let error = open_with(study.path(), &options, &mut |_| {}).expect_err("it is not there");
    assert!(matches!(error, VolumeError::NoSuchChoice { .. }), "{error}");
}

#[test]
fn missing_slices_are_told_and_interpolated_on_demand() {
    let at = |z: f64| Slice::at(z, [z as u16 * 10; 4]);
    let study = Study::new(&[at(0.0), at(1.0), at(2.0), at(5.0), at(6.0)]);
    let volume = study.volume();
    assert_eq!(volume.dims()[2], 5);
    assert!(notices(&volume).contains("2 slices are missing, the first after slice 3"));
    assert!(
        (volume.geometry().spacing()[2] - 1.5e-3).abs() < 1e-12,
        "its extent is true"
    );
    let options = ReadOptions::default().with_fill_missing_slices(true);
    let filled = open_with(study.path(), &options, &mut |_| {}).expect("it can be read");
    assert_eq!(filled.dims()[2], 7);
    assert!((filled.geometry().spacing()[2] - 1e-3).abs() < 1e-12);
    let column: Vec<f64> = (0..7).map(|z| filled.value([0, 0, z])).collect();
    assert_eq!(column, [0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0]);
    assert!(filled.is_rounded() && !volume.is_rounded());
}

#[test]
fn uneven_spacing_and_tilt_are_told() {
    let study = Study::new(&[0.0, 1.0, 2.3, 3.0].map(|z| Slice::at(z, [1; 4])));
    let text = notices(&study.volume());
    assert!(
        text.contains("unevenly spaced: 0.700 to 1.300 mm"),
        "{text}"
    );
    assert!(text.contains("0.300 mm off"), "{text}");

    let tilted = [0.0, 1.0, 2.0]
        .map(|z| Slice::at(z, [1; 4]).with_text(0x0020_0032, &format!("0\\{}\\{z}", 0.5 * z)));
    let volume = Study::new(&tilted).volume();
    assert!(notices(&volume).contains("26.6°"), "{}", notices(&volume));
    let step = volume.geometry().metres_from_index.z_axis;
    assert!(
        (step - glam::DVec3::new(0.0, -5e-4, 1e-3)).length() < 1e-12,
        "{step}"
    );
}

#[test]
fn scaling_window_padding_and_inversion_are_understood() {
    let slice = |z: f64, pixels| {
        Slice::at(z, pixels)
            .with_text(0x0028_1053, "2")
            .with_text(0x0028_1052, "-1000")
            .with_text(0x0028_1050, "40\\600")
            .with_text(0x0028_1051, "400\\1500")
            .with_text(0x0028_1055, "SOFT\\BONE")
    };
    let volume = Study::new(&[slice(0.0, [1, 2, 3, 4]), slice(1.0, [5; 4])]).volume();
    assert_eq!(volume.range(), [-998.0, -990.0]);
    assert_eq!(volume.header_window(), Some([-160.0, 239.0]));
    assert_eq!(volume.header_windows()[1].name, "BONE");

    // 12 bits of 16, signed; what is above is no part of the number.
    let signed = Slice::at(0.0, [0xf801, 0x0fff, 0x07ff, 0x0000])
        .with_number(0x0028_0101, 12)
        .with_number(0x0028_0102, 11)
        .with_number(0x0028_0103, 1);
    let volume = Study::new(&[signed]).volume();
    assert_eq!(values(&volume), [-2047.0, -1.0, 2047.0, 0.0]);

    // The lowest value, whichever number that is; told, and no NaN.
    let padded = || Slice::at(0.0, [5, 9, 63_536, 7]).with_number(0x0028_0120, 63_536);
    let falling = padded().with_text(0x0028_1053, "-1");
    let other = Slice::at(1.0, [5; 4]).with_text(0x0028_1053, "3");
    for (slices, expected) in [
        (vec![padded()], vec![5.0, 9.0, 5.0, 7.0]),
        (vec![falling], vec![-5.0, -9.0, -9.0, -7.0]),
        (
            vec![padded(), other],
            vec![5.0, 9.0, 5.0, 7.0, 15.0, 15.0, 15.0, 15.0],
        ),
    ] {
        let volume = Study::new(&slices).volume();
        assert_eq!(values(&volume), expected);
        assert_eq!((volume.replaced().padding, volume.replaced().nan), (1, 0));
        assert!(
            volume
                .notices()
                .iter()
                .any(|notice| notice.contains("1 voxels are padding"))
        );
    }

    let inverted = Slice::at(0.0, [5, 9, 6, 7]).with_text(0x0028_0004, "MONOCHROME1");
    let volume = Study::new(&[inverted]).volume();
    assert_eq!(values(&volume), [5.0, 9.0, 6.0, 7.0]);
    assert_eq!(volume.header_window(), Some([9.0, 5.0]));
}

#[test]
fn slices_with_scalings_of_their_own_agree() {
    let slice = |z: f64, slope: &str| Slice::at(z, [10; 4]).with_text(0x0028_1053, slope);
    let volume = Study::new(&[slice(0.0, "0.5"), slice(1.0, "2")]).volume();
    assert_eq!(volume.range(), [5.0, 20.0]);
    assert!(!volume.is_rounded());
}

#[test]
fn doses_are_scaled() {
    let slice = |z: f64| {
        let slice = Slice::at(z, [8; 4]).with_text(0x3004_000e, "0.25");
        slice.with_text(0x3004_0002, "GY")
    };
    let volume = Study::new(&[slice(0.0), slice(1.0)]).volume();
    assert_eq!(volume.range(), [2.0, 2.0]);
    assert_eq!(volume.unit(), Some("Gy"));
    // Some write a scaling of 1 besides.
    let slice = |z: f64| {
        let slice = Slice::at(z, [8; 4]).with_text(0x3004_000e, "0.25");
        slice.with_text(0x0028_1053, "1")
    };
    assert_eq!(
        Study::new(&[slice(0.0), slice(1.0)]).volume().range(),
        [2.0, 2.0]
    );
}

#[test]
fn diffusion_weightings_are_kept_apart() {
    // In another order at each place.
    let slice = |z: f64, b: f64, number: u16| {
        let mut slice = Slice::at(z, [b as u16 + z as u16; 4]);
        slice.put(0x0018_9087, b.to_le_bytes().to_vec());
        let slice = slice.with_text(0x0008_0018, &format!("1.{z}.{b}"));
        slice.with_text(0x0020_0013, &number.to_string())
    };
    let study = Study::new(&[
        slice(0.0, 0.0, 1),
        slice(0.0, 1000.0, 2),
        slice(1.0, 1000.0, 3),
        slice(1.0, 0.0, 4),
    ]);
    let listed = contents(study.path(), &ReadOptions::default()).expect("a list");
    assert_eq!(listed.len(), 2, "{listed:?}");
    assert!(
        listed
            .iter()
            .any(|c| c.description.contains("b = 1000 s/mm²")),
        "{listed:?}"
    );
    let mut ranges: Vec<_> = ["1", "2"]
        .map(|choice| {
            let options = ReadOptions::default().with_choice(choice);
            open_with(study.path(), &options, &mut |_| {})
                .expect("it is there")
                .range()
        })
        .into();
    ranges.sort_by(|a, b| a[0].total_cmp(&b[0]));
    assert_eq!(ranges, [[0.0, 1.0], [1000.0, 1001.0]]);
}

#[test]
fn images_of_one_name_at_several_places_are_all_read() {
    let slice = |z: f64, value| Slice::at(z, [value; 4]).with_text(0x0008_0018, "1.2.3.4");
    let twice = [slice(0.0, 1), slice(1.0, 2), slice(2.0, 3), slice(2.0, 3)];
    let volume = Study::new(&twice).volume();
    assert_eq!(volume.dims(), [2, 2, 3]);
    assert_eq!(volume.range(), [1.0, 3.0]);
}

#[test]
fn units_are_those_that_dicom_defines() {
    let unit = |texts: &[(u32, &str)]| {
        let slice = |z| {
            let slice = Slice::at(z, [1; 4]);
            texts
                .iter()
                .fold(slice, |slice, (tag, text)| slice.with_text(*tag, text))
        };
        let volume = Study::new(&[slice(0.0), slice(1.0)]).volume();
        volume.unit().map(str::to_owned)
    };
    let (modality, kind, pet) = (0x0008_0060, 0x0028_1054, 0x0054_1001);
    let slope = (0x0028_1053, "1");
    assert_eq!(unit(&[(modality, "CT"), slope]).as_deref(), Some("HU"));
    assert_eq!(unit(&[(modality, "CT")]), None);
    assert_eq!(unit(&[(modality, "CT"), (kind, "US")]), None);
    assert_eq!(unit(&[(modality, "MR")]), None);
    assert_eq!(
        unit(&[(modality, "MR"), (kind, "HU")]).as_deref(),
        Some("HU")
    );
    assert_eq!(
        unit(&[(modality, "PT"), (pet, "BQML")]).as_deref(),
        Some("Bq/ml")
    );
    assert_eq!(unit(&[(modality, "MR"), (kind, SECRET)]), None);
}

#[test]
fn what_is_wrong_is_named_without_the_patient() {
    let good = |z: f64| Slice::at(z, [1; 4]);
    for (slice, parts) in [
        (good(0.0).with_number(0x0028_0010, 3), ["12 bytes", "0.dcm"]),
        (
            good(0.0).with_number(0x0028_0101, 17),
            ["Bits Stored", "17"],
        ),
        (
            good(0.0).with_text(0x0028_0030, SECRET),
            ["(0028,0030)", "text of 11"],
        ),
        (
            good(0.0).with_text(0x0020_0032, "1\\2"),
            ["(0020,0032)", "2 numbers"],
        ),
        (
            good(0.0).with_text(0x0028_0004, "RGB"),
            ["in colour (RGB)", "DICOM image"],
        ),
        (
            good(0.0).with_number(0x0028_0100, 12),
            ["12 bits", "DICOM image"],
        ),
    ] {
        let text = Study::new(&[slice]).error().to_string();
        for part in parts {
            assert!(text.contains(part), "{text} lacks {part}");
        }
    }
    // Whatever is cut off, and wherever.
    let whole = good(0.0).bytes();
    for length in (140..whole.len()).step_by(3) {
        let study = Study::new(&[]);
        fs::write(study.path().join("cut.dcm"), &whole[..length]).expect("written");
        let text = study.error().to_string();
        assert!(
            text.contains("cut.dcm") || text.contains("DICOM image"),
            "{text}"
        );
    }
}

#[test]
fn every_flipped_bit_of_a_header_is_survived_and_tells_no_name() {
    let whole = Slice::at(0.0, [1, 2, 3, 4]).bytes();
    for bit in 0..whole.len() * 8 {
        let mut bytes = whole.clone();
        bytes[bit / 8] ^= 1 << (bit % 8);
        let input = holovol_volume::Input::from_bytes(Path::new("memory"), &bytes);
        let text = match holovol_volume::read(input, &ReadOptions::default(), &mut |_| {}) {
            Ok(volume) => format!("{volume:?}"),
            Err(error) => format!("{error} {error:?}"),
        };
        assert!(
            !text.contains("SECRE") && !text.contains("^NAME"),
            "{bit}: {text}"
        );
    }
}

#[cfg(unix)]
#[test]
fn loops_of_links_end_and_unreadable_files_are_named() {
    use std::os::unix::fs::{PermissionsExt, symlink};
    let study = Study::new(&[Slice::at(0.0, [1; 4]), Slice::at(1.0, [2; 4])]);
    symlink(study.path(), study.path().join("loop")).expect("linked");
    symlink("nowhere", study.path().join("dangling")).expect("linked");
    assert_eq!(study.volume().dims()[2], 2);
    let closed = study.path().join("closed");
    fs::write(&closed, b"x").expect("written");
    fs::set_permissions(&closed, fs::Permissions::from_mode(0o0)).expect("set");
    // Root may read everything.
    if fs::read(&closed).is_err() {
        assert!(study.error().to_string().contains("closed"));
    }
}

#[test]
fn a_cancelled_reader_stops() {
    let study = Study::new(&[Slice::at(0.0, [1; 4])]);
    let flag = holovol_volume::CancelFlag::default();
    flag.cancel();
    let options = ReadOptions::default().with_cancel(flag);
    let error = open_with(study.path(), &options, &mut |_| {}).expect_err("it was cancelled");
    assert!(matches!(error, VolumeError::Cancelled { .. }), "{error}");
}
