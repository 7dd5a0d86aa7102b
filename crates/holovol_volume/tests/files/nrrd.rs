//! NRRD header features, each in a file made for it.

use glam::DVec3;
use holovol_volume::VoxelKind;

use crate::bytes::{all_bytes, good, gzip, message, nrrd, values};

const HEADER: [&str; 4] = [
    "type: uint16",
    "dimension: 3",
    "sizes: 3 2 1",
    "endian: little",
];
const FIELD: [u16; 6] = [1, 2, 300, 4, 5, 65535];

fn with(lines: &[&str], data: &[u8]) -> Vec<u8> {
    nrrd(&[&HEADER, lines].concat(), data)
}

fn field() -> [f64; 6] {
    FIELD.map(f64::from)
}

/// A header whose `name` line is replaced.
fn replaced(name: &str, line: &str) -> Vec<u8> {
    let lines = ["encoding: raw"]
        .iter()
        .chain(&HEADER)
        .map(|old| if old.starts_with(name) { line } else { old });
    nrrd(&lines.collect::<Vec<_>>(), &all_bytes(&FIELD, false))
}

#[test]
fn every_encoding_gives_the_same_values() {
    let raw = all_bytes(&FIELD, false);
    let hex: String = raw.iter().map(|byte| format!("{byte:02X}\n")).collect();
    for (encoding, data) in [
        ("raw", raw.clone()),
        ("gzip", gzip(&raw)),
        ("gz", [gzip(&raw[..5]), gzip(&raw[5..])].concat()),
        ("ascii", b"1 2\n300,4 \t5 65535.0\n".to_vec()),
        ("TXT", b"1 2 3e2 4 5 65535".to_vec()),
        ("hex", hex.into_bytes()),
    ] {
        let volume = good(&with(&[&format!("encoding: {encoding}")], &data));
        assert_eq!(values(&volume), field(), "{encoding}");
        assert_eq!(volume.dims(), [3, 2, 1]);
        assert_eq!(volume.voxels().kind(), VoxelKind::U16);
    }
    // The whole file packed once more.
    assert_eq!(
        values(&good(&gzip(&with(&["encoding: raw"], &raw)))),
        field()
    );
}

#[test]
fn every_type_name_is_known() {
    let check = |names: &str, big: &[u8], expected: f64| {
        for name in names.split(", ") {
            let little: Vec<u8> = big.iter().rev().copied().collect();
            for (endian, data) in [("big", big), ("little", &little)] {
                let (kind, endian) = (format!("type: {name}"), format!("endian: {endian}"));
                let lines = [&kind, "dimension: 1", "sizes: 1", "encoding: raw", &endian];
                assert_eq!(values(&good(&nrrd(&lines, data))), [expected], "{name}");
            }
        }
    };
    check("signed char, int8, int8_t", &[0xfe], -2.0);
    check("uchar, unsigned char, uint8, uint8_t", &[0xfe], 254.0);
    check(
        "short, short int, signed short, signed short int, int16, int16_t",
        &[0xff, 1],
        -255.0,
    );
    check(
        "ushort, unsigned short, unsigned short int, uint16, uint16_t",
        &[2, 1],
        513.0,
    );
    check(
        "int, signed int, int32, int32_t",
        &[0xff, 0xff, 0, 0],
        -65536.0,
    );
    check(
        "uint, unsigned int, uint32, uint32_t",
        &[0, 1, 0, 0],
        65536.0,
    );
    check(
        "longlong, long long, long long int, signed long long, signed long long int, int64, int64_t",
        &[0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xfd],
        -3.0,
    );
    check(
        "ulonglong, unsigned long long, unsigned long long int, uint64, uint64_t",
        &[0, 0, 0, 1, 0, 0, 0, 0],
        4294967296.0,
    );
    check("float", &1.5f32.to_be_bytes(), 1.5);
    check("double", &(-0.375f64).to_be_bytes(), -0.375);
}

#[test]
fn text_holds_every_type() {
    for (kind, text, expected) in [
        ("int8", "-128 127", [-128.0, 127.0]),
        ("uint32", "4294967295 7", [4294967296.0, 7.0]),
        ("int64", "-9 9", [-9.0, 9.0]),
        ("float", "-1.5e3 0.25", [-1500.0, 0.25]),
        ("double", "nan 0.5", [0.5, 0.5]),
    ] {
        let kind = format!("type: {kind}");
        let lines = [&kind, "dimension: 1", "sizes: 2", "encoding: text"];
        assert_eq!(
            values(&good(&nrrd(&lines, text.as_bytes()))),
            expected,
            "{kind}"
        );
    }
    for (kind, text, part) in [
        ("uint8", "1 256", "`256` is no u8"),
        ("uint8", "1 x", "`x` is no u8"),
        ("int16", "1 2.5", "`2.5` is no i16"),
        ("uint8", "1", "truncated"),
    ] {
        let kind = format!("type: {kind}");
        let lines = [&kind, "dimension: 1", "sizes: 2", "encoding: text"];
        let text = message(&nrrd(&lines, text.as_bytes()));
        assert!(text.contains(part), "{text}");
    }
    let hex = with(&["encoding: hex"], b"0102030405060708090a0b0g");
    assert!(message(&hex).contains("`g` is no hexadecimal digit"));
}

#[test]
fn skips_are_taken_in_the_right_place() {
    let raw = all_bytes(&FIELD, false);
    let lines_first = [b"a header\nof others\nxyz", &raw[..]].concat();
    let skip = ["encoding: raw", "line skip: 2", "byte skip: 3"];
    assert_eq!(values(&good(&with(&skip, &lines_first))), field());
    // Lines in what is packed, bytes in what was packed.
    let packed = [b"one line\n", &gzip(&[b"xyz", &raw[..]].concat())[..]].concat();
    let skip = ["encoding: gzip", "lineskip: 1", "byteskip: 3"];
    assert_eq!(values(&good(&with(&skip, &packed))), field());
    // -1: the data is at the end.
    let skip = ["encoding: raw", "byte skip: -1"];
    assert_eq!(values(&good(&with(&skip, &lines_first))), field());
    assert!(message(&with(&["encoding: gzip", "byte skip: -1"], &packed)).contains("`byte skip`"));
    assert!(message(&with(&["encoding: raw", "byte skip: -2"], &raw)).contains("`byte skip`"));
    assert!(message(&with(&["encoding: raw", "line skip: -1"], &raw)).contains("`line skip`"));
    let skip = ["encoding: raw", "line skip: 999999999999"];
    assert!(message(&with(&skip, &raw)).contains("truncated"));
}

#[test]
fn headers_may_be_written_freely() {
    let raw = all_bytes(&FIELD, false);
    let mut bytes =
        b"NRRD0005\r\n# note\r\nTYPE: Unsigned Short\r\ndimension: 3\r\nsizes: 3 2 1\r\n".to_vec();
    bytes.extend(
        b"sizes:=9 9 9\r\nEndian: LITTLE\r\nencoding:RAW\r\nmeasurement frame: (1,0,0)\r\n\r\n",
    );
    bytes.extend(raw);
    assert_eq!(values(&good(&bytes)), field());
}

#[test]
fn spacings_and_units() {
    let spacing = |lines: &[&str]| {
        let lines = [&["encoding: raw"], lines].concat();
        let volume = good(&with(&lines, &all_bytes(&FIELD, false)));
        assert!(volume.world_from_unit_cube().determinant() > 0.0);
        assert_eq!(volume.geometry().axis_codes(), None);
        let spacing = volume.geometry().spacing().map(|s| (s * 1e9).round() / 1e3);
        (spacing, volume.notices().len())
    };
    assert_eq!(spacing(&["spacings: 1 2 3.5"]), ([1e3, 2e3, 3.5e3], 0));
    assert_eq!(spacing(&["spacings: 1 -2 3"]), ([1e3, 2e3, 3e3], 1));
    assert_eq!(spacing(&["spacings: 4 nan 3"]), ([4e3, 3e3, 3e3], 1));
    assert_eq!(spacing(&["spacings: nan nan 0"]), ([1e3; 3], 1));
    assert_eq!(spacing(&[]), ([1e3; 3], 1));
    assert_eq!(
        spacing(&["spacings: 1 2 3", "units: \"um\" \"cm\" \"mm\""]),
        ([1.0, 2e4, 3e3], 0)
    );
    assert_eq!(
        spacing(&["spacings: 1 2 3", "units: \"mm\" \"mm\" \"parsec\""]),
        ([1e3, 2e3, 3e3], 1)
    );
    // Sizes are 3 2 1; an axis of one voxel between its nodes has no length.
    let ends = ["axis mins: 0 -1 2", "axis maxs: 6 3 5"];
    assert_eq!(spacing(&ends), ([2e3, 2e3, 3e3], 0));
    let on_nodes = [ends[0], ends[1], "centers: node node cell"];
    assert_eq!(spacing(&on_nodes), ([3e3, 4e3, 3e3], 0));
    let on_nodes = [ends[0], ends[1], "centerings: node cell node"];
    assert_eq!(spacing(&on_nodes), ([3e3, 2e3, 2e3], 1));
    assert_eq!(spacing(&ends[..1]), ([1e3; 3], 1));
    let text = message(&with(
        &["encoding: raw", ends[0], "axis maxs: 1 2"],
        &[0; 12],
    ));
    assert!(text.contains("`axis maxs`"), "{text}");
    let text = message(&with(&["encoding: raw", "spacings: 1 2"], &[0; 12]));
    assert!(
        text.contains("`spacings`") && text.contains("3 numbers"),
        "{text}"
    );
}

#[test]
fn directions_follow_the_space() {
    let read = |lines: &[&str]| {
        let lines = [
            &[
                "encoding: raw",
                "space directions: (1,0,0) (0,2,0) (0,0,3)",
                "space origin: (10,20,30)",
            ],
            lines,
        ]
        .concat();
        let volume = good(&with(&lines, &all_bytes(&FIELD, false)));
        (
            volume.geometry().axis_codes(),
            volume.geometry().origin,
            volume.notices().len(),
            volume,
        )
    };
    let origin = |x: f64, y: f64, z: f64| DVec3::new(x, y, z) * 1e-3;
    for (space, codes, signs) in [
        ("RAS", "RAS", origin(10.0, 20.0, 30.0)),
        ("Right-Anterior-Superior", "RAS", origin(10.0, 20.0, 30.0)),
        ("left-posterior-superior", "LPS", origin(-10.0, -20.0, 30.0)),
        ("LPST", "LPS", origin(-10.0, -20.0, 30.0)),
        ("left-anterior-superior", "LAS", origin(-10.0, 20.0, 30.0)),
    ] {
        let (found, at, notices, _) = read(&[&format!("space: {space}")]);
        assert_eq!((found.as_deref(), notices), (Some(codes), 0), "{space}");
        assert!((at - signs).length() < 1e-12, "{space}: {at}");
    }
    let (codes, _, notices, _) = read(&["space: scanner-xyz"]);
    assert_eq!((codes.as_deref(), notices), (Some("RAS"), 1));
    let (codes, _, _, volume) = read(&["space: 3D-left-handed"]);
    assert_eq!(codes, None);
    assert!(volume.world_from_unit_cube().determinant() < 0.0);
    let (codes, _, notices, volume) = read(&["space dimension: 3"]);
    assert_eq!((codes, notices), (None, 1));
    assert!(volume.world_from_unit_cube().determinant() > 0.0);
    let (_, at, _, volume) = read(&["space: RAS", "space units: \"um\" \"um\" \"um\""]);
    assert!((volume.geometry().spacing()[2] - 3e-6).abs() < 1e-15);
    assert!((at - origin(0.01, 0.02, 0.03)).length() < 1e-12);
}

#[test]
fn unsound_directions_fall_back_to_their_lengths() {
    for (directions, spacing) in [
        ("(0,0,0) (0,2,0) (0,0,3)", [2e-3, 2e-3, 3e-3]),
        ("(1,0,0) (2,0,0) (0,0,3)", [1e-3, 2e-3, 3e-3]),
        ("(nan,0,0) (0,2,0) (0,0,3)", [2e-3, 2e-3, 3e-3]),
        ("(1e40,0,0) (0,2,0) (0,0,3)", [2e-3, 2e-3, 3e-3]),
        ("none (0,2,0) (0,0,3)", [2e-3, 3e-3, 2e-3]),
    ] {
        let line = format!("space directions: {directions}");
        let volume = good(&with(
            &["encoding: raw", "space: RAS", &line],
            &all_bytes(&FIELD, false),
        ));
        let (codes, found) = (volume.geometry().axis_codes(), volume.geometry().spacing());
        if directions.starts_with("none") {
            assert_eq!(volume.dims(), [3, 2, 1]);
        } else {
            assert_eq!(codes, None, "{directions}");
            assert!(
                (0..3).all(|i| (found[i] - spacing[i]).abs() < 1e-12),
                "{directions}: {found:?}"
            );
        }
        assert!(!volume.notices().is_empty(), "{directions}");
    }
    for line in [
        "space directions: (1,0,0) (0,2,0)",
        "space directions: 1 2 3",
        "space directions: (1,0,0) (0,2,0) (0,a,3)",
        "space: middle-earth",
        "space origin: x",
    ] {
        let lines = [
            "encoding: raw",
            "space directions: (1,0,0) (0,2,0) (0,0,3)",
            line,
        ];
        let text = message(&with(&lines, &all_bytes(&FIELD, false)));
        assert!(
            text.contains(&format!("`{}`", &line[..line.find(':').unwrap_or(0)])),
            "{text}"
        );
    }
}

#[test]
fn axes_that_are_not_space_give_their_first_entry() {
    let read = |lines: &[&str], numbers: &[u8]| {
        let lines = [
            &["type: uint8", "encoding: raw", "spacings: 1 1 1 1"],
            lines,
        ]
        .concat();
        good(&nrrd(&lines, numbers))
    };
    let data: Vec<u8> = (0..24).collect();
    // Colour first: every third number.
    let volume = read(
        &[
            "dimension: 4",
            "sizes: 3 2 2 2",
            "kinds: RGB-color domain domain domain",
        ],
        &data,
    );
    assert_eq!(volume.dims(), [2, 2, 2]);
    assert_eq!(
        values(&volume),
        [0.0, 3.0, 6.0, 9.0, 12.0, 15.0, 18.0, 21.0]
    );
    assert!(
        volume
            .notices()
            .join("")
            .contains("axis 0 (rgb-color) has 3"),
        "{:?}",
        volume.notices()
    );
    // Time last: the beginning.
    let volume = read(
        &[
            "dimension: 4",
            "sizes: 2 2 2 3",
            "kinds: domain domain domain time",
        ],
        &data,
    );
    assert_eq!(values(&volume), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
    // In the middle, found by its missing direction.
    let directions = "space directions: (1,0,0) (0,1,0) none (0,0,1)";
    let volume = read(
        &["dimension: 4", "sizes: 2 2 3 2", "space: RAS", directions],
        &data,
    );
    assert_eq!(
        values(&volume),
        [0.0, 1.0, 2.0, 3.0, 12.0, 13.0, 14.0, 15.0]
    );
    assert_eq!(volume.geometry().axis_codes().as_deref(), Some("RAS"));
    // Two of them.
    let kinds = "kinds: vector domain list domain domain";
    let lines = [
        "type: uint8",
        "encoding: raw",
        "dimension: 5",
        "sizes: 2 2 3 2 1",
        kinds,
    ];
    let volume = good(&nrrd(&lines, &data));
    assert_eq!(
        (volume.dims(), values(&volume)),
        ([2, 2, 1], vec![0.0, 2.0, 12.0, 14.0])
    );
    // One entry only: no loss, no notice.
    let volume = read(
        &[
            "dimension: 4",
            "sizes: 1 2 3 4",
            "kinds: scalar domain domain domain",
        ],
        &data,
    );
    assert_eq!((volume.dims(), volume.notices().len()), ([2, 3, 4], 0));
    let volume = read(&["dimension: 4", "sizes: 2 3 4 1"], &data);
    assert_eq!((volume.dims(), volume.notices().len()), ([2, 3, 4], 0));
    // A stack of slices whose third axis is called a list.
    let lines = [
        "type: uint8",
        "encoding: raw",
        "dimension: 3",
        "sizes: 2 3 4",
        "spacings: 1 1 1",
        "kinds: domain domain list",
    ];
    assert_eq!(good(&nrrd(&lines, &data)).dims(), [2, 3, 4]);
}

#[test]
fn bad_headers_name_field_and_way_out() {
    for (bytes, part) in [
        (replaced("type", "type: block"), "integers or floats"),
        (replaced("type", "type: quux"), "`type`"),
        (replaced("type", "# none"), "`type` is missing"),
        (replaced("dimension", "dimension: 0"), "`dimension`"),
        (replaced("dimension", "dimension: 17"), "1 to 16"),
        (replaced("sizes", "sizes: 3 2 0"), "`sizes`"),
        (replaced("sizes", "sizes: 3 2"), "3 whole numbers"),
        (replaced("sizes", "sizes: 3 2 -1"), "`sizes`"),
        (replaced("sizes", "sizes: 3 2 99999999999"), "`sizes`"),
        (
            replaced("sizes", "sizes: 4294967295 4294967295 4294967295"),
            "address space",
        ),
        (replaced("sizes", "sizes: 65536 65536 65536"), "at most 12"),
        (replaced("endian", "# none"), "`endian` is missing"),
        (replaced("endian", "endian: middle"), "little or big"),
        (replaced("encoding", "encoding: bzip2"), "bz2 header"),
        (replaced("encoding", "encoding: zip"), "`encoding`"),
        (replaced("encoding", "# none"), "`encoding` is missing"),
        (replaced("encoding", "gibberish"), "gibberish"),
        (nrrd(&["type: uint8"], b""), "`encoding` is missing"),
        (
            b"NRRD0004\ntype: uint8\n".to_vec(),
            "ends within its NRRD header",
        ),
        (b"NRRD0009\n\n".to_vec(), "`magic`"),
        (b"NRRD".to_vec(), "`magic`"),
        (
            replaced("encoding", "data file: LIST"),
            "`encoding` is missing",
        ),
        (
            with(&["encoding: raw", "data file: LIST 2"], b""),
            "0 files",
        ),
        (
            with(&["encoding: raw", "data file: a%02d.raw 1 9 1"], b""),
            "9 files",
        ),
        (with(&["encoding: raw", "data file: a.raw"], b""), "a.raw"),
    ] {
        let text = message(&bytes);
        assert!(text.contains(part), "{text} lacks {part}");
    }
}

#[test]
fn endless_header_is_refused() {
    let mut bytes = b"NRRD0004\n# ".to_vec();
    bytes.resize(5 << 20, b'x');
    assert!(message(&bytes).contains("longer than"));
}
