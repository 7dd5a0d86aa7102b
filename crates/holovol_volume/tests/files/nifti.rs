//! NIfTI header features, each in a file made for it.

use holovol_volume::VoxelKind;

use crate::bytes::{Nifti, Number, good, gzip, message, values};

const VERSIONS: [bool; 2] = [false, true];

fn small() -> Nifti {
    Nifti::new(false, false, 2, &[2, 2, 2], &[1u8, 2, 3, 4, 5, 6, 7, 8])
}

/// Both versions in both byte orders, plain and packed.
fn check_type<T: Number>(datatype: i16, voxels: [T; 6], expected: [f64; 6], kind: VoxelKind) {
    for two in VERSIONS {
        for big in [false, true] {
            let file = Nifti::new(two, big, datatype, &[3, 2, 1], &voxels).bytes();
            for bytes in [gzip(&file), file] {
                let volume = good(&bytes);
                assert_eq!(volume.dims(), [3, 2, 1]);
                assert_eq!(values(&volume), expected, "two {two}, big {big}");
                assert_eq!(volume.voxels().kind(), kind);
                let name = if two { "NIfTI-2" } else { "NIfTI-1" };
                assert_eq!(volume.source_format().map(|f| f.name), Some(name));
            }
        }
    }
}

#[test]
fn every_number_type_keeps_its_values() {
    let f = |v: [i64; 6]| v.map(|n| n as f64);
    check_type(
        2,
        [0u8, 1, 2, 128, 254, 255],
        f([0, 1, 2, 128, 254, 255]),
        VoxelKind::U8,
    );
    check_type(
        256,
        [0i8, 1, -1, 127, -128, 5],
        f([0, 1, -1, 127, -128, 5]),
        VoxelKind::I8,
    );
    check_type(
        4,
        [0i16, 258, -1, 32767, -32768, 5],
        f([0, 258, -1, 32767, -32768, 5]),
        VoxelKind::I16,
    );
    check_type(
        512,
        [0u16, 258, 1, 65535, 2, 5],
        f([0, 258, 1, 65535, 2, 5]),
        VoxelKind::U16,
    );
    check_type(
        8,
        [0i32, 1 << 24, -7, 3, 4, 5],
        f([0, 1 << 24, -7, 3, 4, 5]),
        VoxelKind::F32,
    );
    check_type(
        768,
        [0u32, 1 << 31, 7, 3, 4, 5],
        f([0, 1 << 31, 7, 3, 4, 5]),
        VoxelKind::F32,
    );
    check_type(
        1024,
        [0i64, 1 << 40, -7, 3, 4, 5],
        f([0, 1 << 40, -7, 3, 4, 5]),
        VoxelKind::F32,
    );
    check_type(
        1280,
        [0u64, 1 << 62, 7, 3, 4, 5],
        f([0, 1 << 62, 7, 3, 4, 5]),
        VoxelKind::F32,
    );
    let floats = [0.5, -2.25, 3.0, 1e10, -0.125, 7.0];
    check_type(
        16,
        floats.map(|n| n as f32),
        floats.map(|n| f64::from(n as f32)),
        VoxelKind::F32,
    );
    check_type(64, floats, floats, VoxelKind::F32);
}

#[test]
fn wide_types_go_to_the_smallest_that_is_exact() {
    let kind = |voxels: [i32; 6]| {
        good(&Nifti::new(false, false, 8, &[6], &voxels).bytes())
            .voxels()
            .kind()
    };
    assert_eq!(kind([0, 255, 1, 2, 3, 4]), VoxelKind::U8);
    assert_eq!(kind([-128, 127, 1, 2, 3, 4]), VoxelKind::I8);
    assert_eq!(kind([0, 256, 1, 2, 3, 4]), VoxelKind::U16);
    assert_eq!(kind([0, 65535, 1, 2, 3, 4]), VoxelKind::U16);
    assert_eq!(kind([-1, 128, 1, 2, 3, 4]), VoxelKind::I16);
    assert_eq!(kind([-32768, 32767, 1, 2, 3, 4]), VoxelKind::I16);
    assert_eq!(kind([-1, 32768, 1, 2, 3, 4]), VoxelKind::F32);
    assert_eq!(kind([0, 65536, 1, 2, 3, 4]), VoxelKind::F32);
    let floats = [0.0f32, -0.0, 2.0, 300.0, 4.0, 5.0];
    let volume = good(&Nifti::new(false, false, 16, &[6], &floats).bytes());
    assert_eq!(volume.voxels().kind(), VoxelKind::U16);
    assert_eq!(values(&volume), floats.map(f64::from));
}

#[test]
fn late_large_values_widen_what_was_read_before() {
    // More than two chunks of each range, so that every step of widening is taken.
    let mut voxels: Vec<i32> = (0..600_000).map(|i| i % 200).collect();
    voxels.extend((0..600_000).map(|i| -(i % 300)));
    voxels.extend((0..600_000).map(|i| i * 16));
    let volume = good(&Nifti::new(true, false, 8, &[1_800_000], &voxels).bytes());
    assert_eq!(volume.voxels().kind(), VoxelKind::F32);
    assert!(
        voxels
            .iter()
            .enumerate()
            .all(|(i, &n)| volume.voxels().stored(i) == f64::from(n))
    );
}

#[test]
fn each_chunk_widens_for_all_before_it() {
    // A chunk of 200s fits u8, one of -1s i8; together they need i16.
    let mut voxels = vec![200i32; 300_000];
    voxels.resize(900_000, -1);
    let volume = good(&Nifti::new(true, false, 8, &[900_000], &voxels).bytes());
    assert_eq!(volume.voxels().kind(), VoxelKind::I16);
    assert_eq!(volume.range(), [-1.0, 200.0]);
}

#[test]
fn rounded_values_are_named() {
    let notices = |file: Nifti| good(&file.bytes()).notices().join("; ");
    let notice = notices(Nifti::new(
        false,
        false,
        8,
        &[3],
        &[0, 16_777_217, -16_777_219],
    ));
    assert!(
        notice.contains("2 of 3 are rounded, by at most 1.000e0"),
        "{notice}"
    );
    let notice = notices(Nifti::new(false, false, 64, &[2], &[0.1, 0.5]));
    assert!(
        notice.contains("f64") && notice.contains("1 of 2 are rounded"),
        "{notice}"
    );
    assert_eq!(
        notices(Nifti::new(false, false, 64, &[2], &[0.25, f64::NAN])),
        ""
    );
    let huge = good(&Nifti::new(false, false, 64, &[2], &[1e300, 0.5]).bytes());
    assert_eq!(huge.range()[1], f64::from(f32::MAX));
    assert_eq!(huge.replaced().infinite, 0);
    let notice = notices(Nifti::new(false, false, 1280, &[1], &[u64::MAX]));
    assert!(
        notice.contains("1 of 1 are rounded, by at most 1.000e0"),
        "{notice}"
    );
}

#[test]
fn slope_and_intercept_scale_values() {
    for two in VERSIONS {
        let mut file = Nifti::new(two, true, 4, &[3], &[-2i16, 0, 7]);
        let mut check = |slope, intercept, expected: [f64; 3]| {
            file.scaling(slope, intercept);
            assert_eq!(
                values(&good(&file.bytes())),
                expected,
                "{slope} {intercept}"
            );
        };
        check(0.5, 10.0, [9.0, 10.0, 13.5]);
        check(-2.0, 1.0, [5.0, 1.0, -13.0]);
        check(0.0, 10.0, [-2.0, 0.0, 7.0]);
        check(f64::NAN, 10.0, [-2.0, 0.0, 7.0]);
        check(2.0, f64::NAN, [-4.0, 0.0, 14.0]);
        check(f64::INFINITY, 0.0, [-2.0, 0.0, 7.0]);
        check(1.0, f64::NEG_INFINITY, [-2.0, 0.0, 7.0]);
    }
}

#[test]
fn sform_goes_before_qform_goes_before_spacing() {
    for two in VERSIONS {
        let mut file = Nifti::new(two, false, 2, &[2, 2, 2], &[0u8; 8]);
        let spacing = |file: &Nifti| {
            good(&file.bytes())
                .geometry()
                .spacing()
                .map(|s| (s * 1e6).round())
        };
        let codes = |file: &Nifti| good(&file.bytes()).geometry().axis_codes();
        assert_eq!((spacing(&file), codes(&file)), ([1e3, 2e3, 3e3], None));

        // Half a turn about z.
        file.qform(1, [0.0, 0.0, 1.0], false);
        assert_eq!(
            (spacing(&file), codes(&file)),
            ([1e3, 2e3, 3e3], Some("LPS".into()))
        );
        file.qform(1, [0.0, 0.0, 1.0], true);
        assert_eq!(codes(&file), Some("LPI".into()));

        let rows = [
            [0.0, 0.0, 7.0, 1.0],
            [-5.0, 0.0, 0.0, 2.0],
            [0.0, 6.0, 0.0, 3.0],
        ];
        file.sform(2, rows);
        assert_eq!(
            (spacing(&file), codes(&file)),
            ([5e3, 6e3, 7e3], Some("PSR".into()))
        );
        file.sform(0, rows);
        assert_eq!(codes(&file), Some("LPI".into()));
    }
}

#[test]
fn unsound_sform_falls_back_with_a_notice() {
    let rows_of = |v: f64| {
        [
            [v, 0.0, 0.0, 0.0],
            [0.0, 2.0, 0.0, 0.0],
            [0.0, 0.0, 2.0, 0.0],
        ]
    };
    for (rows, problem) in [
        ([[0.0; 4]; 3], "zero"),
        (rows_of(0.0), "zero"),
        (rows_of(f64::NAN), "not finite"),
        (rows_of(f64::INFINITY), "not finite"),
        (rows_of(1e30), "impossible"),
        (
            [
                [1.0, 1.0, 0.0, 0.0],
                [1.0, 1.0, 0.0, 0.0],
                [0.0, 0.0, 1.0, 0.0],
            ],
            "not independent",
        ),
    ] {
        let mut file = small();
        file.sform(1, rows);
        file.qform(1, [0.0, 1.0, 0.0], false);
        let volume = good(&file.bytes());
        assert_eq!(volume.geometry().axis_codes().as_deref(), Some("LAI"));
        let notices = volume.notices().join("; ");
        assert!(
            notices.contains("s-form") && notices.contains(problem),
            "{notices}"
        );
        file.code(252, 344, 0);
        let volume = good(&file.bytes());
        assert_eq!(volume.geometry().axis_codes(), None);
        assert_eq!(volume.geometry().spacing(), [0.001, 0.002, 0.003]);
    }
    let mut file = small();
    file.qform(1, [f64::NAN, 0.0, 0.0], false);
    let volume = good(&file.bytes());
    assert_eq!(volume.geometry().axis_codes(), None);
    assert!(volume.notices().join("; ").contains("q-form"));
}

#[test]
fn disagreement_about_left_and_right_is_noticed() {
    let mut file = small();
    file.sform(
        1,
        [
            [1.0, 0.0, 0.0, 0.0],
            [0.0, 2.0, 0.0, 0.0],
            [0.0, 0.0, 3.0, 0.0],
        ],
    );
    file.qform(1, [0.0; 3], false);
    assert_eq!(good(&file.bytes()).notices().len(), 0);
    file.qform(1, [0.0; 3], true);
    let volume = good(&file.bytes());
    assert!(volume.notices().join("").contains("left and right"));
    assert_eq!(volume.geometry().axis_codes().as_deref(), Some("RAS"));
}

#[test]
fn odd_spacings_are_replaced() {
    let mut file = small();
    let mut check = |pixdim: [f64; 3], expected: [f64; 3], noticed: usize| {
        for (i, value) in pixdim.into_iter().enumerate() {
            file.float(76, 104, i + 1, value);
        }
        let volume = good(&file.bytes());
        // A negative spacing may not mirror.
        assert!(volume.world_from_unit_cube().determinant() > 0.0);
        let spacing = volume.geometry().spacing();
        assert!(
            (0..3).all(|i| (spacing[i] - expected[i]).abs() < 1e-9),
            "{spacing:?}"
        );
        assert_eq!(volume.notices().len(), noticed, "{:?}", volume.notices());
    };
    check([2.0, 3.0, 4.0], [0.002, 0.003, 0.004], 0);
    check([-2.0, 3.0, 4.0], [0.002, 0.003, 0.004], 1);
    check([0.0, 3.0, 4.0], [0.003, 0.003, 0.004], 1);
    check([f64::NAN, f64::INFINITY, 4.0], [0.004, 0.004, 0.004], 2);
    check([0.0, 0.0, 0.0], [0.001; 3], 3);
}

#[test]
fn length_units_count() {
    for (code, metres) in [(0, 1e-3), (1, 1.0), (2, 1e-3), (3, 1e-6), (2 + 8, 1e-3)] {
        let mut file = small();
        file.header[123] = code;
        let spacing = good(&file.bytes()).geometry().spacing();
        assert!(
            (spacing[1] - 2.0 * metres).abs() < 1e-9 * metres,
            "unit {code}"
        );
    }
    let mut file = small();
    file.header[123] = 5;
    assert!(
        good(&file.bytes())
            .notices()
            .join("")
            .contains("xyzt_units")
    );
}

#[test]
fn of_several_volumes_the_first_is_read() {
    let voxels: Vec<u16> = (0..48).collect();
    let file = Nifti::new(false, false, 512, &[2, 2, 2, 3, 2], &voxels);
    let volume = good(&gzip(&file.bytes()));
    assert_eq!(values(&volume), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
    assert_eq!(
        volume.notices(),
        ["the file has 6 volumes: this is number 1; another can be chosen"]
    );
    let single = Nifti::new(false, false, 512, &[2, 2, 2, 1, 0], &voxels[..8]);
    assert_eq!(good(&single.bytes()).notices().len(), 0);
}

#[test]
fn extensions_are_skipped() {
    for two in VERSIONS {
        let mut file = Nifti::new(two, false, 2, &[2], &[7u8, 9]);
        if two {
            file.put(0, 168, (544i64 + 32).bytes(false));
        } else {
            file.float(108, 0, 0, 352.0 + 32.0);
        }
        file.voxels.splice(0..0, [255; 32]);
        assert_eq!(values(&good(&file.bytes())), [7.0, 9.0]);
    }
}

#[test]
fn offset_zero_means_right_after_the_header() {
    let mut file = small();
    file.float(108, 0, 0, 0.0);
    assert_eq!(good(&file.bytes()).range(), [1.0, 8.0]);
    for offset in [f64::NAN, -1.0, f64::INFINITY] {
        file.float(108, 0, 0, offset);
        assert!(message(&file.bytes()).contains("`vox_offset`"));
    }
    file.float(108, 0, 0, 1e18);
    assert!(message(&file.bytes()).contains("truncated"));
}

#[test]
fn display_window_comes_along() {
    let mut file = small();
    assert_eq!(good(&file.bytes()).header_window(), None);
    file.float(124, 192, 0, 90.0);
    file.float(128, 200, 0, -10.0);
    assert_eq!(good(&file.bytes()).header_window(), Some([-10.0, 90.0]));
}

#[test]
fn bad_headers_name_field_and_way_out() {
    let with = |change: &dyn Fn(&mut Nifti)| {
        let mut file = small();
        change(&mut file);
        message(&file.bytes())
    };
    for (text, parts) in [
        (with(&|f| f.dim(2, 0)), ["`dim[2]`", "is 0"]),
        (with(&|f| f.dim(3, -5)), ["`dim[3]`", "is -5"]),
        (with(&|f| f.dim(0, 9)), ["`dim[0]`", "1 to 7"]),
        (
            with(&|f| f.put(70, 12, 32i16.bytes(false))),
            ["complex64", "magnitude"],
        ),
        (
            with(&|f| f.put(70, 12, 128i16.bytes(false))),
            ["RGB24", "one channel"],
        ),
        (
            with(&|f| f.put(70, 12, 1536i16.bytes(false))),
            ["float128", "float64"],
        ),
        (
            with(&|f| f.put(70, 12, 77i16.bytes(false))),
            ["`datatype`", "is 77"],
        ),
        (
            with(&|f| f.put(344, 0, b"ni1\0".to_vec())),
            ["memory.img", "put it there"],
        ),
        (
            with(&|f| f.put(344, 0, b"abcd".to_vec())),
            ["`magic`", "Analyze"],
        ),
    ] {
        for part in parts {
            assert!(text.contains(part), "{text} lacks {part}");
        }
    }
}

#[test]
fn trailing_bytes_are_noticed() {
    let mut bytes = small().bytes();
    bytes.extend([1, 2, 3]);
    assert!(good(&bytes).notices().join("").contains("goes on after"));
    let mut packed = gzip(&small().bytes());
    packed.extend([0; 512]);
    // As gzip itself does, what follows and isn't gzip is passed over.
    assert_eq!(good(&packed).range(), [1.0, 8.0]);
}

#[test]
fn nan_and_infinities_become_finite() {
    let field = [f32::NAN, 1.5, f32::INFINITY, -2.5, f32::NEG_INFINITY, 0.0];
    let mut file = Nifti::new(false, false, 16, &[6], &field);
    let volume = good(&file.bytes());
    assert_eq!(values(&volume), [-2.5, 1.5, 1.5, -2.5, -2.5, 0.0]);
    assert_eq!((volume.replaced().nan, volume.replaced().infinite), (1, 2));
    // With a negative slope the smallest value is the largest stored number.
    file.scaling(-1.0, 0.0);
    assert_eq!(
        values(&good(&file.bytes())),
        [-1.5, -1.5, -1.5, 2.5, 2.5, -0.0]
    );
    let none = good(&Nifti::new(false, false, 16, &[2], &[f32::NAN, f32::INFINITY]).bytes());
    assert_eq!(none.range(), [0.0, 0.0]);
}

#[test]
fn one_field_in_several_types_gives_the_same_samples() {
    let field: Vec<u8> = (0..60u32).map(|i| (i * i * 7 % 256) as u8).collect();
    let dims = [5, 4, 3];
    let u8s = good(&Nifti::new(false, false, 2, &dims, &field).bytes());
    let wide: Vec<u16> = field.iter().map(|&n| u16::from(n) * 257).collect();
    let mut u16s = Nifti::new(false, true, 512, &dims, &wide);
    u16s.scaling(1.0 / 256.0, 0.0);
    let u16s = good(&u16s.bytes());
    let floats: Vec<f32> = field.iter().map(|&n| f32::from(n) + 0.5).collect();
    let mut f32s = Nifti::new(true, false, 16, &dims, &floats);
    f32s.scaling(1.0, -0.5);
    let f32s = good(&f32s.bytes());
    assert_eq!(f32s.voxels().kind(), VoxelKind::F32);
    for i in 0..200 {
        let at = glam::DVec3::new(0.37, 0.73, 0.19) * f64::from(i) % 1.4 - 0.2;
        let expected = u8s.sample(at);
        assert!((u16s.sample(at) - expected * 257.0 / 256.0).abs() < 1e-9);
        assert!((f32s.sample(at) - expected).abs() < 1e-9);
    }
}
