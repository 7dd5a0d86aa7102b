//! What is refused, contradicted or less sure, and how that is told.

use super::*;

#[test]
fn what_can_not_be_read_or_does_not_fit_is_told() {
    let bench = Bench::new();
    room(0.0).save(bench.path("room.png")).unwrap();
    RgbImage::new(64, 32).save(bench.path("small.png")).unwrap();
    let bytes = std::fs::read(bench.path("room.png")).unwrap();
    bench.write("cut.png", &bytes[..bytes.len() / 2]);
    bench.write("text.png", b"not a picture");
    let mut jpeg = Vec::new();
    JpegEncoder::new(&mut jpeg)
        .encode_image(&room(0.0))
        .unwrap();
    let out = ["--out", "env.exr"];
    let args = |more: &[&'static str]| -> Vec<&'static str> {
        ["light"].iter().chain(more).chain(&out).copied().collect()
    };
    refused(&bench, &args(&["--ldr", "cut.png"]), 3, &["cut.png"]);
    // It ends in its header, before its last rows, within the last one, or without an end marker.
    let whole = jpeg.len();
    for left in [whole / 3, whole * 9 / 10, whole - 8, whole - 2] {
        bench.write("cut.jpg", &jpeg[..left]);
        refused(&bench, &args(&["--ldr", "cut.jpg"]), 3, &["cut.jpg"]);
    }
    // Another frame's header in the middle of what is coded.
    let middle = whole * 3 / 4;
    jpeg[middle..middle + 4].copy_from_slice(&[0xff, 0xc0, 0xff, 0xc0]);
    bench.write("cut.jpg", &jpeg);
    refused(
        &bench,
        &args(&["--ldr", "cut.jpg"]),
        3,
        &["cut.jpg", "damaged"],
    );
    refused(
        &bench,
        &args(&["--ldr", "text.png"]),
        3,
        &["text.png", "PNG, JPEG"],
    );
    refused(&bench, &args(&["--ldr", "none.png"]), 3, &["none.png"]);
    let two = args(&["--ldr", "room.png", "--ldr", "small.png@-6"]);
    refused(&bench, &two, 3, &["64 × 32", "128 × 64"]);
    let same = args(&["--ldr", "room.png", "--ldr", "room.png"]);
    refused(&bench, &same, 2, &["@EV"]);
    refused(
        &bench,
        &args(&["--ldr", "room.png", "--crf", "gamma:0"]),
        2,
        &["gamma"],
    );
    refused(
        &bench,
        &args(&["--ldr", "room.png", "--crf", "text.png"]),
        3,
        &["text.png"],
    );
    refused(
        &bench,
        &["light", "--ldr", "room.png", "--out", "env.png"],
        4,
        &["env.png", ".exr or .hdr"],
    );
}

/// Notes, σ and rung of a run.
#[track_caller]
fn told(bench: &Bench, args: &[&str]) -> (String, f64, String) {
    let line = bench.json(&[&["light", "--out", "env.exr"], args].concat());
    map(&bench.path("env.exr"));
    let sigma = line["sigma_ev"].as_f64().unwrap();
    let rung = line["rung"].as_str().unwrap().to_string();
    (line["notes"].to_string(), sigma, rung)
}

#[test]
fn what_is_read_is_not_written_over() {
    let bench = Bench::new();
    room(0.0).save(bench.path("room.png")).unwrap();
    let before = std::fs::read(bench.path("room.png")).unwrap();
    let args = ["light", "--ldr", "room.png@0", "--out", "o.exr"];
    let output = bench.run(&[&args[..], &["--preview", "room.png"]].concat());
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(4), "{stderr}");
    assert!(stderr.contains("--preview room.png"), "{stderr}");
    assert_eq!(std::fs::read(bench.path("room.png")).unwrap(), before);
}

/// A lamp of few pixels loses its colour and its brightest codes in a JPEG, but not its light.
#[test]
fn jpegs_keep_small_lights() {
    let bench = Bench::new();
    let lamp = |ev: f64| {
        let mut picture = room(ev);
        // 40 times the clipping level on brown, 2 by 3 pixels, off the coder's grid.
        let code = (255.0 * (40.0 * ev.exp2()).min(1.0).powf(1.0 / 2.2)) as u8;
        let around = (255.0 * (0.2 * ev.exp2()).powf(1.0 / 2.2)) as u8;
        for y in 20..30 {
            for x in 50..62 {
                picture.put_pixel(x, y, Rgb([around, around / 2, around / 5]));
            }
        }
        for (x, y) in [(55, 25), (56, 25), (55, 26), (56, 26), (55, 27), (56, 27)] {
            picture.put_pixel(x, y, Rgb([code; 3]));
        }
        picture
    };
    let flux = |extension: &str| {
        let names = ["base", "dark"].map(|name| format!("{name}.{extension}"));
        for (name, ev) in names.iter().zip([0.0, -6.0]) {
            lamp(ev).save(bench.path(name)).unwrap();
        }
        let dark = format!("{}@-6", names[1]);
        let args = [
            "light", "--ldr", &names[0], "--ldr", &dark, "--out", "o.exr",
        ];
        let line = bench.json(&args);
        line["sh9"][0][1].as_f64().unwrap()
    };
    let [png, jpeg] = ["png", "jpg"].map(flux);
    assert!((jpeg / png - 1.0).abs() < 0.1, "png {png}, jpeg {jpeg}");
}

#[test]
fn evidence_that_contradicts_is_named_and_not_believed() {
    let bench = Bench::new();
    room(0.0).save(bench.path("room.png")).unwrap();
    room(-6.0).save(bench.path("dark.png")).unwrap();
    RgbImage::new(WIDTH, HEIGHT)
        .save(bench.path("black.png"))
        .unwrap();
    let (notes, alone, _) = told(&bench, &["--ldr", "room.png"]);
    assert_eq!(notes, "[]");
    for dark in ["room.png@-6", "dark.png@6", "dark.png@-4", "black.png@-6"] {
        let (notes, sigma, rung) = told(&bench, &["--ldr", "room.png", "--ldr", dark]);
        assert!(
            notes.contains(&format!("{dark} contradicts room.png")),
            "{notes}"
        );
        assert_eq!((sigma, rung.as_str()), (alone, "single"), "{dark}");
    }
    for lux in ["500", "1e30", "1e-9"] {
        for picture in ["room.png", "black.png"] {
            let (notes, sigma, rung) = told(&bench, &["--ldr", picture, "--lux", lux]);
            assert!(
                notes.contains("--lux") && notes.contains("left out"),
                "{lux}: {notes}"
            );
            assert!(rung == "single" && sigma > 1.5, "{lux}: {rung} {sigma}");
        }
    }
    let (notes, sigma, _) = told(&bench, &["--ldr", "black.png"]);
    assert!(
        notes.contains("black.png is black") && sigma > 1.0,
        "{notes} {sigma}"
    );
    let probe = |samples: &[(i32, i32, i32, f64)]| {
        let samples = samples
            .iter()
            .map(|&(x, y, z, e)| json!({"normal": [x, y, z], "irradiance": [e, e, e]}));
        let all: Vec<Value> = samples.collect();
        bench.write("probe.json", json!(all).to_string().as_bytes());
    };
    probe(&[(0, 1, 0, 0.7); 6]);
    let args = ["--ldr", "room.png", "--probe", "probe.json"];
    let all = [&["light"], &args[..], &["--out", "env.exr"]].concat();
    refused(&bench, &all, 3, &["probe.json", "1 direction", "15°"]);
    let six = |e| {
        [
            (0, 1, 0, e),
            (0, -1, 0, e),
            (1, 0, 0, e),
            (-1, 0, 0, e),
            (0, 0, 1, e),
            (0, 0, -1, e),
        ]
    };
    probe(&six(0.0));
    let (notes, sigma, rung) = told(&bench, &args);
    assert!(
        notes.contains("probe.json is") && notes.contains("left out"),
        "{notes}"
    );
    assert!(rung == "single" && sigma > alone, "{rung} {sigma}");
    probe(&six(0.7));
    let beside = |lux| told(&bench, &[&args[..], &["--lux", lux]].concat());
    let (notes, sure, rung) = beside("0.7");
    assert!(notes.contains("--lux agrees") && rung == "probe", "{notes}");
    let (notes, sigma, rung) = beside("7");
    assert!(notes.contains("--lux 7 is") && rung == "probe", "{notes}");
    assert!(sigma > sure + 1.0, "{sure} {sigma}");
}

/// A JPEG with photo sphere metadata.
fn photo_sphere(picture: &RgbImage, fields: &[(&str, i64)]) -> Vec<u8> {
    let mut jpeg = Vec::new();
    JpegEncoder::new(&mut jpeg).encode_image(picture).unwrap();
    let fields = fields
        .iter()
        .map(|(name, n)| format!(" GPano:{name}=\"{n}\""));
    let xmp = format!(
        "http://ns.adobe.com/xap/1.0/\0<x{}/>",
        fields.collect::<String>()
    );
    let length = (xmp.len() as u16 + 2).to_be_bytes();
    let segment = [&[0xff, 0xe1], &length[..], xmp.as_bytes()].concat();
    jpeg.splice(2..2, segment);
    jpeg
}

#[test]
fn photo_spheres_that_show_a_part_are_less_sure_and_wrong_ones_told() {
    let bench = Bench::new();
    let sphere = |top: i64, height: i64| {
        let fields = [
            ("FullPanoWidthPixels", 128),
            ("FullPanoHeightPixels", 64),
            ("CroppedAreaLeftPixels", 0),
            ("CroppedAreaTopPixels", top),
            ("CroppedAreaImageWidthPixels", 128),
            ("CroppedAreaImageHeightPixels", height),
        ];
        let picture = RgbImage::from_fn(WIDTH, 32, |x, y| *room(0.0).get_pixel(x, y + 16));
        bench.write("part.jpg", &photo_sphere(&picture, &fields));
        let line = bench.json(&["light", "--ldr", "part.jpg", "--out", "env.exr"]);
        let sigma = line["sigma_ev"].as_f64().unwrap();
        (line["height"].clone(), line["notes"].to_string(), sigma)
    };
    room(0.0).save(bench.path("room.png")).unwrap();
    let (_, whole, _) = told(&bench, &["--ldr", "room.png"]);
    let (height, notes, sigma) = sphere(16, 32);
    assert_eq!(height, 64);
    assert!(
        notes.contains("part.jpg") && notes.contains("29 %"),
        "{notes}"
    );
    assert!(sigma > whole.hypot(0.8), "{sigma} {whole}");
    for (top, crop) in [(40, 32), (-8, 32), (16, 0), (16, 20)] {
        let (height, notes, _) = sphere(top, crop);
        assert_eq!(height, 32);
        assert!(
            notes.contains("part.jpg") && notes.contains("GPano"),
            "{top} {crop}: {notes}"
        );
    }
}

#[test]
fn hdr_panoramas_are_given_alone_and_what_is_infinite_does_not_swamp_them() {
    let bench = Bench::new();
    let write = |name: &str, bright: f32| {
        let mut pixels = vec![[0.3, 0.3, 0.3, 1.0]; 128];
        pixels[50] = [500.0, 500.0, 500.0, 1.0];
        pixels[40] = [bright, bright, bright, 1.0];
        let picture = holovol_reference::Image::new(16, 8, pixels);
        picture.write_exr(&bench.path(name)).unwrap();
    };
    write("hdr.exr", 20.0);
    RgbImage::new(16, 8).save(bench.path("dark.png")).unwrap();
    bench.write("probe.json", b"[]");
    let beside: [&[&str]; 3] = [
        &["--lux", "2"],
        &["--ldr", "dark.png@-6"],
        &["--probe", "probe.json"],
    ];
    for more in beside {
        let args = [&["light", "--ldr", "hdr.exr", "--out", "env.exr"], more].concat();
        refused(&bench, &args, 2, &["hdr.exr", "alone"]);
    }
    for bright in [f32::INFINITY, 3e38] {
        write("broken.exr", bright);
        let line = bench.json(&["light", "--ldr", "broken.exr", "--out", "env.exr"]);
        assert!(
            line["notes"].to_string().contains("1 texels were not"),
            "{line}"
        );
        assert_eq!(map(&bench.path("env.exr")).texel(8, 2), [500.0; 3]);
        let sh9 = line["sh9"].as_array().unwrap();
        let numbers = sh9.iter().flat_map(|rgb| rgb.as_array().unwrap());
        assert!(
            numbers
                .clone()
                .all(|n| n.as_f64().is_some_and(|n| n.abs() < 1e3)),
            "{line}"
        );
    }
}
