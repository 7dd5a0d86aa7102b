//! The `holovol` command as its users meet it, without a GPU.

mod support;

use std::io::Write;
use std::time::Instant;

use holovol_reference::Image;
use serde_json::json;
use support::{Bench, exists, nrrd, scene};

const RENDER: [&str; 6] = [
    "render",
    "scene.json",
    "--out",
    "out.exr",
    "--backend",
    "reference",
];

fn render(more: &[&'static str]) -> Vec<&'static str> {
    RENDER.iter().chain(more).copied().collect()
}

fn names(bench: &Bench) -> Vec<String> {
    let entries = std::fs::read_dir(bench.folder.path()).unwrap();
    let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = names.collect();
    names.sort();
    names
}

#[test]
fn render_prints_one_line_and_writes_image_and_picture() {
    let bench = Bench::new();
    let line = bench.json(&render(&["--spp", "8", "--png", "out.png", "--seed", "5"]));
    assert_eq!((&line["spp"], &line["seed"]), (&json!(8), &json!(5)));
    assert_eq!((&line["width"], &line["height"]), (&json!(24), &json!(16)));
    assert_eq!(line["backend"], "reference");
    assert!(line["adapter"].as_str().unwrap().contains("CPU"));
    let number = |key: &str| line[key].as_f64().unwrap();
    let rate = 24.0 * 16.0 * 8.0 / number("seconds");
    assert!((number("samples_per_second") / rate - 1.0).abs() < 1e-6);
    assert!(number("load_seconds") > 0.0);

    let image = Image::read_exr(&bench.path("out.exr")).unwrap();
    let mean = |channel: usize| {
        let sum: f64 = image.pixels().iter().map(|p| f64::from(p[channel])).sum();
        sum / image.pixels().len() as f64
    };
    for channel in 0..3 {
        let told = line["mean_rgb"][channel].as_f64().unwrap();
        assert!((told - mean(channel)).abs() < 1e-9);
    }
    assert!((number("mean_opacity") - mean(3)).abs() < 1e-9);
    assert!((0.05..0.9).contains(&mean(3)), "{}", mean(3));
    let picture = image::open(bench.path("out.png")).unwrap().into_rgb8();
    assert_eq!(picture.dimensions(), (24, 16));
    assert_eq!(picture.get_pixel(0, 0).0, [0, 0, 0]);
    assert!(picture.get_pixel(12, 8).0[0] > 60);
    let names = names(&bench);
    assert!(
        !names.iter().any(|name| name.ends_with(".part")),
        "{names:?}"
    );
}

#[test]
fn seeds_repeat_and_differ() {
    let bench = Bench::new();
    let image = |seed: &'static str| {
        bench.json(&render(&["--spp", "2", "--seed", seed]));
        Image::read_exr(&bench.path("out.exr")).unwrap()
    };
    let first = image("1");
    assert_eq!(first, image("1"));
    assert_ne!(first, image("2"));
    assert_ne!(first, image("18446744073709551615"));
}

#[test]
fn seconds_end_the_work() {
    let bench = Bench::new();
    let line = bench.json(&render(&["--seconds", "0.5"]));
    let seconds = line["seconds"].as_f64().unwrap();
    assert!((0.1..2.5).contains(&seconds), "{seconds}");
    assert!(line["spp"].as_u64().unwrap() > 1);
}

#[test]
fn one_side_of_the_image_follows_the_other() {
    let bench = Bench::new();
    let size = |args: &[&'static str]| {
        let line = bench.json(&render(args));
        (
            line["width"].as_u64().unwrap(),
            line["height"].as_u64().unwrap(),
        )
    };
    assert_eq!(size(&["--spp", "1", "--width", "12"]), (12, 8));
    assert_eq!(size(&["--spp", "1", "--height", "8"]), (12, 8));
    assert_eq!(
        size(&["--spp", "1", "--width", "5", "--height", "9"]),
        (5, 9)
    );
}

#[test]
fn stereo_and_animation_give_numbered_images() {
    let bench = Bench::new();
    let mut animated = scene();
    animated["stereo"] = json!({ "ipd": 0.01 });
    animated["animation"] = json!({ "frames": 3, "eye_to": [0.02, 0, 0.04],
        "switch": { "frame": 1, "environment": { "constant": [0, 0, 0] } } });
    bench.write_scene("scene.json", &animated);
    let line = bench.json(&render(&[
        "--spp", "1", "--frames", "2", "--png", "out.png",
    ]));
    assert_eq!(line["images"], 4);
    for eye in ["left", "right"] {
        let image = |frame: u32| {
            assert!(exists(&bench.path(&format!("out.{eye}.{frame:04}.png"))));
            Image::read_exr(&bench.path(&format!("out.{eye}.{frame:04}.exr"))).unwrap()
        };
        assert!(image(0).pixels().iter().any(|p| p[0] > 0.0));
        assert!(
            image(1).pixels().iter().all(|p| p[0] == 0.0),
            "the light is out"
        );
        assert!(image(1).pixels().iter().any(|p| p[3] > 0.0));
    }
    assert!(!exists(&bench.path("out.exr")));
    bench.write_scene("scene.json", &scene());
    let still = bench.run(&render(&["--spp", "1", "--frames", "2"]));
    assert_eq!(still.status.code(), Some(2));
}

#[test]
fn compare_tells_all_measures() {
    let bench = Bench::new();
    bench.json(&render(&["--spp", "4"]));
    let same = bench.json(&["compare", "out.exr", "out.exr"]);
    assert_eq!((&same["relmse"], &same["mse"]), (&json!(0.0), &json!(0.0)));
    assert_eq!((&same["flip"], &same["ssim"]), (&json!(0.0), &json!(1.0)));
    assert_eq!(same["mean"], same["mean_reference"]);
    bench.json(&[
        "render",
        "scene.json",
        "--out",
        "b.exr",
        "--backend",
        "reference",
        "--spp",
        "4",
        "--seed",
        "3",
    ]);
    let other = bench.json(&["compare", "b.exr", "out.exr"]);
    assert!(other["relmse"].as_f64().unwrap() > 1e-4);
    assert!(other["ssim"].as_f64().unwrap() < 1.0);
    assert!(other["psnr"].as_f64().unwrap() > 5.0);
}

#[test]
fn info_tells_what_is_in_a_volume_and_a_scene() {
    let bench = Bench::new();
    let text = bench.output(&["info", "sphere.nrrd", "--thumbnail", "t.png"]);
    for word in [
        "12 × 12 × 12",
        "u8",
        "1 × 1 × 1 mm",
        "not recorded",
        "percentiles",
    ] {
        assert!(text.contains(word), "{text}");
    }
    let thumbnail = image::open(bench.path("t.png")).unwrap().into_rgb8();
    let brightest = thumbnail.pixels().map(|pixel| pixel.0[0]).max().unwrap();
    assert!(thumbnail.width() > 500 && brightest > 200);
    let volume = bench.json(&["info", "sphere.nrrd", "--json"]);
    assert_eq!(volume["dims"], json!([12, 12, 12]));
    assert_eq!(volume["spacing"], json!([0.001, 0.001, 0.001]));
    let scene = bench.json(&["info", "scene.json", "--json"]);
    assert_eq!(
        (&scene["width"], &scene["max_scatters"]),
        (&json!(24), &json!(1))
    );
    assert_eq!(scene["volume"]["dims"], json!([12, 12, 12]));
    assert!(
        bench
            .output(&["info", "scene.json"])
            .contains("at most 1 scattering")
    );
}

#[test]
fn voxels_that_are_no_numbers_are_counted() {
    let bench = Bench::new();
    let voxels = [f32::NAN, 1.0, f32::INFINITY, 3.0]
        .map(f32::to_le_bytes)
        .concat();
    bench.write("nan.nrrd", &nrrd("float", "2 2 1", &voxels));
    let info = bench.json(&["info", "nan.nrrd", "--json"]);
    assert_eq!(
        (&info["nan_voxels"], &info["infinite_voxels"]),
        (&json!(1), &json!(1))
    );
    assert_eq!(info["range"], json!([1.0, 3.0]));
    assert!(bench.output(&["info", "nan.nrrd"]).contains("1 NaN"));
}

#[test]
fn demo_needs_nothing_and_says_where() {
    let bench = Bench::new();
    let args = [
        "demo",
        "--out",
        "d.png",
        "--size",
        "16",
        "--spp",
        "1",
        "--backend",
        "reference",
    ];
    let text = bench.output(&args);
    assert!(text.lines().next().unwrap().ends_with("d.png"), "{text}");
    let picture = image::open(bench.path("d.png")).unwrap();
    assert_eq!((picture.width(), picture.height()), (16, 16));
}

#[test]
fn help_and_completions_teach() {
    let bench = Bench::new();
    let help = bench.output(&["--help"]);
    for word in [
        "Examples:",
        "Exit codes:",
        "render",
        "compare",
        "info",
        "demo",
    ] {
        assert!(help.contains(word), "{help}");
    }
    assert!(bench.output(&["render", "--help"]).contains("Examples:"));
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        assert!(
            bench
                .output(&["completions", shell])
                .contains("interpolation")
        );
    }
}

/// What one run must answer to: exit code and words of the message.
#[track_caller]
fn refuses(bench: &Bench, args: &[&str], code: i32, words: &[&str]) {
    let started = Instant::now();
    let output = bench.run(args);
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{args:?}: {message}");
    for word in words {
        assert!(
            message.contains(word),
            "{args:?}: {message:?} lacks {word:?}"
        );
    }
    assert!(!message.contains("panicked"), "{message}");
    assert!(
        output.stdout.is_empty(),
        "{args:?} prints to standard output"
    );
    assert!(started.elapsed().as_secs() < 20, "{args:?} takes too long");
}

#[test]
fn command_lines_without_sense_are_refused() {
    let bench = Bench::new();
    refuses(&bench, &[], 2, &["Usage"]);
    refuses(&bench, &["render", "scene.json"], 2, &["--out"]);
    refuses(&bench, &render(&["--spp", "0"]), 2, &["--spp"]);
    refuses(
        &bench,
        &render(&["--spp", "1", "--seconds", "1"]),
        2,
        &["--seconds"],
    );
    refuses(
        &bench,
        &render(&["--seconds", "-1"]),
        2,
        &["--seconds", "above 0"],
    );
    refuses(&bench, &render(&["--seconds", "nan"]), 2, &["--seconds"]);
    refuses(&bench, &render(&["--width", "0"]), 2, &["camera.width"]);
    refuses(
        &bench,
        &render(&["--width", "4000000000"]),
        2,
        &["camera.width", "16384"],
    );
    refuses(&bench, &render(&["--adapter", "x"]), 2, &["--adapter"]);
    refuses(
        &bench,
        &render(&["--interpolation", "hardware"]),
        2,
        &["--interpolation"],
    );
}

#[test]
fn unwritable_output_is_found_before_anything_is_read() {
    let bench = Bench::new();
    let out = |out: &'static str| ["render", "no-such-scene.json", "--out", out];
    refuses(
        &bench,
        &out("missing/out.exr"),
        4,
        &["--out", "missing", "does not exist"],
    );
    refuses(&bench, &out("out.png"), 4, &["out.png", ".exr"]);
    std::fs::create_dir(bench.path("folder.exr")).unwrap();
    refuses(
        &bench,
        &out("folder.exr"),
        4,
        &["folder.exr", "is a folder"],
    );
    let png = [
        "render",
        "no-such-scene.json",
        "--out",
        "o.exr",
        "--png",
        "missing/o.png",
    ];
    refuses(&bench, &png, 4, &["--png", "missing"]);
    if cfg!(target_os = "linux") {
        refuses(
            &bench,
            &out("/proc/out.exr"),
            4,
            &["/proc/out.exr", "can't be written"],
        );
    }
    assert_eq!(names(&bench), ["folder.exr", "scene.json", "sphere.nrrd"]);
}

#[test]
fn missing_adapters_are_named() {
    let bench = Bench::new();
    let args = [
        "render",
        "scene.json",
        "--out",
        "o.exr",
        "--adapter",
        "no-such-adapter",
    ];
    refuses(&bench, &args, 5, &["no-such-adapter", "found"]);
}

#[test]
fn bad_scenes_are_refused_by_file_and_field() {
    let bench = Bench::new();
    let with = |pointer: &str, value: serde_json::Value| {
        let mut scene = scene();
        let (parent, key) = pointer.rsplit_once('/').unwrap();
        scene.pointer_mut(parent).unwrap()[key] = value;
        bench.write_scene("scene.json", &scene);
    };
    for (pointer, value, words) in [
        ("/colour", json!(1), ["unknown key", "`colour`"]),
        (
            "/camera/fov_deg",
            json!(30),
            ["camera", "did you mean `fov_y_deg`"],
        ),
        (
            "/camera/fov_y_deg",
            json!("30 deg"),
            ["camera.fov_y_deg", "without quotes or a unit"],
        ),
        (
            "/volume/window",
            json!([1, 1]),
            ["volume.window", "two different numbers"],
        ),
        (
            "/volume/path",
            json!("gone.nrrd"),
            ["volume.path", "gone.nrrd"],
        ),
        (
            "/environment",
            json!({ "path": "gone.hdr" }),
            ["environment.path", "gone.hdr"],
        ),
        (
            "/environment",
            json!({ "path": "sphere.nrrd" }),
            ["environment.path", ".hdr"],
        ),
        ("/clip", json!([[0, 0, 0, 1]]), ["clip[0]", "no normal"]),
        ("/labels", json!({}), ["labels", "not supported yet"]),
        ("/phase_g", json!(1.5), ["phase_g", "1.5"]),
        (
            "/camera/width",
            json!(1u64 << 40),
            ["camera.width", "whole number"],
        ),
    ] {
        with(pointer, value);
        refuses(&bench, &RENDER, 3, &["scene.json", words[0], words[1]]);
    }
    bench.write("scene.json", b"{ \"version\": 1,");
    refuses(
        &bench,
        &RENDER,
        3,
        &["scene.json", "not valid JSON", "line 1"],
    );
    bench.write("scene.json", b"\x1f\x8b\x08\x00\xff\xfe");
    refuses(&bench, &RENDER, 3, &["scene.json", "UTF-8"]);
    std::fs::remove_file(bench.path("scene.json")).unwrap();
    refuses(&bench, &RENDER, 3, &["scene.json", "cannot read"]);
}

#[test]
fn damaged_volumes_are_refused_by_file_and_field() {
    let bench = Bench::new();
    let refused = |bytes: &[u8], words: &[&str]| {
        bench.write("bad.nrrd", bytes);
        refuses(
            &bench,
            &["info", "bad.nrrd"],
            3,
            &[&["bad.nrrd"], words].concat(),
        );
    };
    refused(&nrrd("uint8", "12 12 12", &[0; 100]), &["truncated"]);
    refused(&nrrd("uint8", "12 0 12", &[0; 144]), &["sizes"]);
    refused(
        &nrrd("uint8", "1099511627776 1 1", &[0; 144]),
        &["1099511627776"],
    );
    refused(&nrrd("uint8", "65536 65536 65536", &[0; 144]), &[]);
    refused(&nrrd("colour", "2 2 2", &[0; 8]), &["type", "colour"]);
    refused(b"", &["bad.nrrd"]);
    refused(b"not a volume at all", &["expected"]);

    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    let noise: Vec<u8> = (0..100_000u32)
        .map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8)
        .collect();
    packed.write_all(&nifti([50, 50, 40], &noise)).unwrap();
    let packed = packed.finish().unwrap();
    let refused = |bytes: &[u8], words: &[&str]| {
        bench.write("bad.nii.gz", bytes);
        refuses(
            &bench,
            &["info", "bad.nii.gz"],
            3,
            &[&["bad.nii.gz"], words].concat(),
        );
    };
    refused(&packed[..packed.len() / 2], &[]);
    let mut corrupt = packed.clone();
    for byte in &mut corrupt[packed.len() / 2..packed.len() / 2 + 64] {
        *byte ^= 0x5a;
    }
    refused(&corrupt, &[]);
    bench.write("good.nii.gz", &packed);
    assert!(
        bench
            .output(&["info", "good.nii.gz"])
            .contains("50 × 50 × 40")
    );
    bench.write("bad.nii", &nifti([50, -3, 40], &noise));
    refuses(&bench, &["info", "bad.nii"], 3, &["bad.nii", "dim"]);
}

/// A NIfTI-1 file of u8 voxels of 1 mm.
fn nifti(dims: [i16; 3], voxels: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0; 352];
    let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
    put(0, &348i32.to_le_bytes());
    let dim = [3, dims[0], dims[1], dims[2], 1, 1, 1, 1];
    for (i, n) in dim.into_iter().enumerate() {
        put(40 + 2 * i, &i16::to_le_bytes(n));
        put(76 + 4 * i, &1f32.to_le_bytes());
    }
    put(70, &2i16.to_le_bytes());
    put(72, &8i16.to_le_bytes());
    put(108, &352f32.to_le_bytes());
    put(112, &1f32.to_le_bytes());
    put(123, &[2]);
    put(344, b"n+1\0");
    bytes.extend(voxels);
    bytes
}

#[cfg(target_os = "linux")]
#[test]
fn headers_allocate_nothing_that_they_only_claim() {
    let bench = Bench::new();
    bench.write("huge.nrrd", &nrrd("float", "30000 30000 3000", &[0; 64]));
    bench.write("huge.hdr", b"#?RADIANCE\n\n-Y 8192 +X 16384\n");
    let mut claims = scene();
    claims["environment"] = json!({ "path": "huge.hdr" });
    bench.write_scene("claims.json", &claims);
    for args in ["info huge.nrrd", "info claims.json"] {
        // 600 MB of address space: less than either header claims.
        let script = format!(
            "ulimit -v 600000; exec {} {args}",
            env!("CARGO_BIN_EXE_holovol")
        );
        let output = std::process::Command::new("sh")
            .args(["-c", &script])
            .env("RAYON_NUM_THREADS", "1")
            .current_dir(bench.folder.path())
            .output()
            .unwrap();
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(3), "{args}: {message}");
        assert!(message.contains("huge."), "{message}");
    }
}

#[test]
fn pictures_that_can_not_be_compared_are_refused() {
    let bench = Bench::new();
    bench.json(&render(&["--spp", "1"]));
    bench.json(&[
        "render",
        "scene.json",
        "--out",
        "s.exr",
        "--backend",
        "reference",
        "--spp",
        "1",
        "--width",
        "12",
    ]);
    refuses(
        &bench,
        &["compare", "out.exr", "s.exr"],
        3,
        &["out.exr", "s.exr", "24×16", "12×8"],
    );
    refuses(
        &bench,
        &["compare", "out.exr", "gone.exr"],
        3,
        &["gone.exr"],
    );
    refuses(
        &bench,
        &["compare", "out.exr", "scene.json"],
        3,
        &["scene.json", "OpenEXR"],
    );
    let whole = std::fs::read(bench.path("out.exr")).unwrap();
    bench.write("cut.exr", &whole[..whole.len() / 2]);
    refuses(&bench, &["compare", "out.exr", "cut.exr"], 3, &["cut.exr"]);
}

fn phantom(name: &str) -> String {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../holovol_volume/tests/phantoms/formats");
    folder.join(name).to_string_lossy().into_owned()
}

#[test]
fn info_lists_what_can_be_chosen() {
    let bench = Bench::new();
    let several = phantom("several.vdb");
    let line = bench.json(&["info", &several, "--json"]);
    assert_eq!(line["contents"][1]["name"], "marked");
    assert_eq!(line["contents"][1]["number"], 2);
    let line = bench.json(&["info", &several, "--json", "--choice", "2"]);
    assert_eq!(line["range"], json!([7.0, 103.0]));
    let line = bench.json(&["info", &phantom("dicom_explicit"), "--json"]);
    assert_eq!(line["dims"], json!([5, 4, 3]));
}

#[test]
fn convert_is_exact_or_refuses() {
    let bench = Bench::new();
    let source = phantom("dicom_tilted");
    let before = bench.json(&["info", &source, "--json"]);
    for out in ["out.nrrd", "out.nii", "out.nii.gz", "out.raw"] {
        let output = bench.run(&["convert", &source, out]);
        assert!(output.status.success(), "{output:?}");
        let after = bench.json(&["info", out, "--json"]);
        for field in ["dims", "range", "mean", "orientation", "percentiles"] {
            assert_eq!(before[field], after[field], "{out}: {field}");
        }
    }
    let there = names(&bench);
    assert!(there.contains(&"out.raw.json".to_owned()));
    assert!(
        !there.iter().any(|name| name.starts_with("part")),
        "{there:?}"
    );
    // Without the sidecar, by the command line.
    std::fs::remove_file(bench.path("out.raw.json")).unwrap();
    let after = bench.json(&[
        "info",
        "out.raw",
        "--json",
        "--raw-dims",
        "5,4,3",
        "--raw-type",
        "i16",
        "--raw-spacing",
        "0.7,1.9,3.1",
    ]);
    assert_eq!(before["dims"], after["dims"]);
    assert_eq!(before["range"], after["range"]);
    let spacing = after["spacing"][2].as_f64().unwrap();
    assert!((spacing - 0.0031).abs() < 1e-9, "{after}");
    // Nobody's file is in the way of an unfinished one.
    for name in ["part.out.nii", "part0.out.nii"] {
        std::fs::write(bench.path(name), "precious").unwrap();
    }
    assert!(bench.run(&["convert", &source, "out.nii"]).status.success());
    for name in ["part.out.nii", "part0.out.nii"] {
        assert_eq!(std::fs::read(bench.path(name)).unwrap(), b"precious");
    }
    for (out, part) in [("out.jpg", ".nrrd, .nii"), ("no/out.nii", "no")] {
        let output = bench.run(&["convert", &source, out]);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(4), "{text}");
        assert!(text.contains(part), "{text}");
    }
    let free = bench.run(&["convert", &phantom("float.vdb"), "free.nii"]);
    assert_eq!(free.status.code(), Some(4));
    let text = String::from_utf8_lossy(&free.stderr).into_owned();
    assert!(text.contains("free.nii: the format can't hold"), "{text}");
}
