//! Whatever the bytes, reading ends soon, without a panic, and without the memory a header claims.

use std::time::Instant;

use proptest::prelude::*;

use crate::bytes::{Nifti, Number, gzip, message, nrrd, read};

fn nifti() -> Vec<u8> {
    let voxels: Vec<i32> = (0..24).map(|i| i * 1000).collect();
    let mut file = Nifti::new(false, false, 8, &[2, 3, 4], &voxels);
    file.sform(
        1,
        [
            [1.0, 0.0, 0.0, 5.0],
            [0.0, 2.0, 0.0, 6.0],
            [0.0, 0.0, 3.0, 7.0],
        ],
    );
    file.bytes()
}

fn nifti2() -> Vec<u8> {
    let voxels: Vec<f64> = (0..24).map(|i| f64::from(i) * 0.1).collect();
    let mut file = Nifti::new(true, true, 64, &[2, 3, 4], &voxels);
    file.qform(1, [0.1, 0.2, 0.3], true);
    file.bytes()
}

fn attached(encoding: &str, data: &[u8]) -> Vec<u8> {
    let encoding = format!("encoding: {encoding}");
    let lines = [
        "type: uint16",
        "dimension: 4",
        "space: left-posterior-superior",
        "sizes: 2 3 2 2",
        "space directions: none (1,0.5,0) (0,2,0) (0,0,3)",
        "kinds: vector domain domain domain",
        "space origin: (1,2,3)",
        "space units: \"mm\" \"mm\" \"um\"",
        "endian: big",
        "line skip: 0",
        "byte skip: 0",
        &encoding,
    ];
    nrrd(&lines, data)
}

/// One sound file of each kind.
fn seeds() -> Vec<Vec<u8>> {
    let data: Vec<u8> = (0..48).collect();
    let text: String = (0..24).map(|i| format!("{i} ")).collect();
    vec![
        nifti(),
        nifti2(),
        gzip(&nifti()),
        attached("raw", &data),
        attached("gzip", &gzip(&data)),
        attached("ascii", text.as_bytes()),
        attached("hex", "0123456789abcdef".repeat(6).as_bytes()),
    ]
}

#[test]
fn seeds_are_sound() {
    for seed in seeds() {
        read(&seed).unwrap_or_else(|error| panic!("{error}"));
    }
}

#[test]
fn every_truncation_is_an_error() {
    for (which, seed) in seeds().iter().enumerate() {
        // The NRRD seeds end with a vector component that isn't wanted, and perhaps gzip's trailer.
        let unwanted = if which < 3 { 0 } else { 16 };
        for length in 0..seed.len() - unwanted {
            assert!(
                read(&seed[..length]).is_err(),
                "{length} of {} bytes of seed {which}",
                seed.len()
            );
        }
    }
}

#[test]
fn claims_beyond_the_file_fail_at_once() {
    let start = Instant::now();
    let mut file = Nifti::new(true, false, 64, &[1 << 20, 1 << 20, 1], &[0.5f64; 8]);
    assert!(message(&file.bytes()).contains("at most 64"));
    for dims in [
        [1i64 << 10, 1 << 10, 1 << 10],
        [(1 << 32) - 1, (1 << 32) - 1, 1 << 20],
        [1 << 40, 1, 1],
    ] {
        for (i, dim) in dims.into_iter().enumerate() {
            file.dim(i + 1, dim);
        }
        message(&file.bytes());
        message(&gzip(&file.bytes()));
    }
    let claims = nrrd(
        &[
            "type: double",
            "dimension: 3",
            "sizes: 1024 1024 1024",
            "endian: big",
            "encoding: gzip",
        ],
        &gzip(&[0; 4096]),
    );
    assert!(message(&claims).contains("truncated"));
    assert!(start.elapsed().as_secs_f64() < 1.0);
}

#[test]
fn damaged_gzip_is_told_so() {
    // A wrong check sum, and nothing else.
    let mut packed = gzip(&nifti());
    let at = packed.len() - 6;
    packed[at] ^= 1;
    assert!(message(&packed).contains("damaged"));
    let mut packed = attached("gzip", &gzip(&[7; 48]));
    let at = packed.len() - 12;
    packed[at] ^= 0x55;
    message(&packed);
}

#[test]
fn slope_zero_of_both_signs_scales_nothing() {
    let mut file = Nifti::new(false, false, 2, &[2], &[1u8, 2]);
    file.scaling(-0.0, 3.0);
    file.put(116, 184, 3f32.bytes(false));
    assert_eq!(
        read(&file.bytes()).map(|v| v.range()).unwrap_or_default(),
        [1.0, 2.0]
    );
}

#[test]
fn scaling_beyond_all_numbers_is_refused() {
    let mut file = Nifti::new(true, false, 4, &[2], &[1i16, 20_000]);
    file.scaling(1e306, 0.0);
    let text = message(&file.bytes());
    assert!(text.contains("slope") && text.contains("1e306"), "{text}");
}

/// Whole files of the formats that other libraries wrote.
fn phantoms() -> Vec<(String, Vec<u8>)> {
    let folder = crate::formats::folder();
    let codecs = folder.join("codecs");
    let mut paths: Vec<_> = [
        "itk.mha",
        "float.vdb",
        "half.vdb",
        "zip.vdb",
        "ome.ome.tif",
        "ome_tiled.ome.tif",
        "imagej.tif",
        "dicom_enhanced.dcm",
        "dicom_zip.zip",
        "dicom_big/0.dcm",
        "dicom_deflated/0.dcm",
        "dicom_jpeg/0.dcm",
    ]
    .map(|name| folder.join(name))
    .into();
    for entry in std::fs::read_dir(codecs).expect("it is there").flatten() {
        paths.push(entry.path());
    }
    paths.sort();
    let read = |path: std::path::PathBuf| {
        let bytes = std::fs::read(&path).expect("it is there");
        (path.display().to_string(), bytes)
    };
    paths.into_iter().map(read).collect()
}

/// Reads what may be damaged: soon, and with a message that names the file and a way out.
fn survives(name: &str, bytes: &[u8]) {
    let start = Instant::now();
    match read(bytes) {
        Ok(volume) => {
            let world = volume.world_from_unit_cube();
            assert!(
                world.is_finite() && world.determinant() != 0.0,
                "{name}: {world}"
            );
            assert!(volume.range().iter().all(|edge| edge.is_finite()), "{name}");
        }
        Err(error) => {
            let text = error.to_string();
            assert!(
                text.starts_with("memory") && text.len() > 30,
                "{name}: {text}"
            );
        }
    }
    assert!(start.elapsed().as_secs_f64() < 5.0, "{name} takes long");
}

#[test]
fn phantoms_are_survived_when_cut_off() {
    for (name, bytes) in phantoms() {
        // Every byte of the headers, then some of the rest.
        let steps = (0..bytes.len().min(700)).chain((700..bytes.len()).step_by(61));
        for length in steps {
            survives(&format!("{length} bytes of {name}"), &bytes[..length]);
        }
    }
}

#[test]
fn phantoms_are_survived_with_any_bit_flipped() {
    for (name, bytes) in phantoms() {
        let bits =
            (0..bytes.len().min(900) * 8).step_by(if cfg!(debug_assertions) { 7 } else { 1 });
        for bit in bits {
            let mut bytes = bytes.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            survives(&format!("{name} with bit {bit} flipped"), &bytes);
        }
        // The pixels, too.
        for byte in (900..bytes.len()).step_by(37) {
            let mut bytes = bytes.clone();
            bytes[byte] ^= 0x55;
            survives(&format!("{name} with byte {byte} changed"), &bytes);
        }
    }
}

/// What must hold of any volume that is read at all.
fn check_sound(bytes: &[u8]) {
    let Ok(volume) = read(bytes) else { return };
    let voxels: u64 = volume.dims().iter().map(|&n| u64::from(n)).product();
    assert_eq!(voxels, volume.voxels().len() as u64);
    // Deflate's ratio, and 4 bytes per digit of text.
    assert!(voxels <= bytes.len() as u64 * 1032 + 4096);
    let [low, high] = volume.auto_window();
    assert!(
        low < high && low.is_finite() && high.is_finite(),
        "{low} {high}"
    );
    let world = volume.world_from_unit_cube();
    assert!(world.is_finite() && world.determinant() != 0.0, "{world}");
    assert!(volume.range().iter().all(|edge| edge.is_finite()));
    volume.sample(glam::DVec3::splat(0.4));
    volume.histogram();
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..2000)) {
        check_sound(&bytes);
        check_sound(&[b"NRRD0004\n", &bytes[..]].concat());
    }

    #[test]
    fn mutated_files_never_panic(
        which in 0usize..7,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in any::<prop::sample::Index>(),
        is_cut: bool,
    ) {
        let mut bytes = seeds().swap_remove(which);
        // Headers are where it matters.
        let header = bytes.len().min(600);
        for (index, value) in changes {
            bytes[index.index(header)] = value;
        }
        if is_cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        check_sound(&bytes);
    }

    #[test]
    fn nifti_fields_of_any_value_never_panic(
        two: bool,
        big: bool,
        dims in prop::collection::vec(prop_oneof![any::<i64>(), 0i64..4], 8),
        datatype in prop_oneof![any::<i16>(), prop::sample::select(vec![2i16, 4, 8, 16, 64, 256, 512, 768, 1024, 1280])],
        floats in prop::collection::vec(prop_oneof![any::<f64>(), prop::sample::select(vec![0.0, -1.0, f64::NAN, f64::INFINITY, 1e-40])], 21),
        codes in prop::array::uniform3(-1i16..6),
        voxels in prop::collection::vec(any::<u8>(), 0..200),
    ) {
        let mut file = Nifti::new(two, big, datatype, &[1, 1, 1], &voxels);
        for (i, dim) in dims.into_iter().enumerate() {
            file.dim(i, dim);
        }
        let (spacing, rest) = floats.split_at(4);
        for (i, &value) in spacing.iter().enumerate() {
            file.float(76, 104, i, value);
        }
        file.scaling(rest[0], rest[1]);
        file.code(252, 344, codes[0]);
        file.code(254, 348, codes[1]);
        for (i, &value) in rest[2..5].iter().enumerate() {
            file.float(256, 352, i, value);
        }
        for (i, &value) in rest[5..].iter().enumerate() {
            file.float(280, 400, i, value);
        }
        check_sound(&file.bytes());
    }

    #[test]
    fn nrrd_fields_of_any_value_never_panic(
        kind in prop::sample::select(vec!["uint8", "int16", "int32", "uint64", "float", "double"]),
        encoding in prop::sample::select(vec!["raw", "gzip", "ascii", "hex"]),
        sizes in "[0-9]{1,2}( [0-9]{1,19}){0,3}",
        dimension in 1usize..5,
        directions in "(none |\\([0-9,.e+-]{0,12}\\) ?){0,4}",
        field in prop::sample::select(vec!["spacings", "kinds", "space", "units", "space units", "space origin", "byte skip", "line skip", "data file"]),
        value in "\\PC{0,24}",
        data in prop::collection::vec(any::<u8>(), 0..200),
    ) {
        let lines = [
            format!("type: {kind}"),
            format!("encoding: {encoding}"),
            format!("dimension: {dimension}"),
            format!("sizes: {sizes}"),
            format!("space directions: {directions}"),
            format!("{field}: {value}"),
            "endian: big".into(),
        ];
        let lines: Vec<&str> = lines.iter().map(String::as_str).collect();
        check_sound(&nrrd(&lines, &data));
    }
}
