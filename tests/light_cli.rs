//! `holovol light`, `stitch` and `calibrate` as their users meet them.

mod support;

use std::path::Path;

use holovol_light::EnvironmentMap;
use image::codecs::jpeg::JpegEncoder;
use image::{GrayImage, ImageBuffer, Rgb, RgbImage};
use serde_json::{Value, json};
use support::{Bench, exists};

const WIDTH: u32 = 128;
const HEIGHT: u32 = 64;

/// A grey room with a lamp, 3 × 3 pixels, at an exposure.
fn room(ev: f64) -> RgbImage {
    RgbImage::from_fn(WIDTH, HEIGHT, |x, y| {
        let on = (60..63).contains(&x) && (20..23).contains(&y);
        let light = (if on { 40.0 } else { 0.2 } * ev.exp2()).min(1.0);
        let code = (holovol_light::response::linear_to_srgb(light) * 255.0).round() as u8;
        Rgb([code; 3])
    })
}

/// The map that was written: finite and nowhere negative by the loader's own count.
#[track_caller]
fn map(path: &Path) -> EnvironmentMap {
    let map = EnvironmentMap::load(path).unwrap();
    assert_eq!(map.replaced(), 0);
    map
}

#[track_caller]
fn light(bench: &Bench, ldr: &str) -> (Value, EnvironmentMap) {
    let line = bench.json(&["light", "--ldr", ldr, "--out", "env.exr"]);
    (line, map(&bench.path("env.exr")))
}

#[track_caller]
fn refused(bench: &Bench, args: &[&str], code: i32, words: &[&str]) {
    let output = bench.run(args);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "{args:?}: {stderr}");
    for word in words {
        assert!(stderr.contains(word), "{args:?}: no {word:?} in {stderr:?}");
    }
}

#[test]
fn a_lamp_is_found_and_a_dark_frame_measures_it() {
    let bench = Bench::new();
    room(0.0).save(bench.path("room.png")).unwrap();
    room(-6.0).save(bench.path("dark.png")).unwrap();
    let args = [
        "light",
        "--ldr",
        "room.png",
        "--ldr",
        "dark.png@-6",
        "--out",
        "env.exr",
        "--report",
        "report.json",
        "--preview",
        "lights.png",
    ];
    let line = bench.json(&args);
    assert_eq!(line["rung"], "bracket");
    assert!(line["sigma_ev"].as_f64().unwrap() < 0.1);
    let lamp = &line["lights"][0];
    let direction: Vec<f64> = lamp["direction"]
        .as_array()
        .unwrap()
        .iter()
        .map(|v| v.as_f64().unwrap())
        .collect();
    let expected = EnvironmentMap::direction_from_uv([61.5 / 128.0, 21.5 / 64.0]);
    let cosine: f64 = direction
        .iter()
        .zip(expected.to_array())
        .map(|(a, b)| a * b)
        .sum();
    assert!(cosine > 0.9998, "{direction:?}");
    let found = map(&bench.path("env.exr"));
    let peak = found.texel(61, 21)[1];
    assert!((36.0..44.0).contains(&peak), "{peak}");
    let wall = found.texel(10, 40)[0];
    assert!((wall - 0.2).abs() < 0.005, "{wall}");
    let report: Value =
        serde_json::from_slice(&std::fs::read(bench.path("report.json")).unwrap()).unwrap();
    assert_eq!(report["lights"], line["lights"]);
    assert_eq!(report["sh9"].as_array().unwrap().len(), 9);
    assert_eq!(
        image::open(bench.path("lights.png")).unwrap().width(),
        WIDTH
    );
    let alone = bench.json(&["light", "--ldr", "room.png", "--out", "env.hdr"]);
    assert_eq!(alone["rung"], "single");
    assert!(alone["sigma_ev"].as_f64() > line["sigma_ev"].as_f64());
    assert!(EnvironmentMap::load(&bench.path("env.hdr")).is_ok());
}

#[test]
fn meter_and_probe_are_used_and_told() {
    let bench = Bench::new();
    room(0.0).save(bench.path("room.png")).unwrap();
    let args = [
        "light", "--ldr", "room.png", "--lux", "0.9", "--out", "env.exr",
    ];
    let line = bench.json(&args);
    assert_eq!(line["rung"], "single+lux");
    let samples: Vec<Value> = [
        [0, 1, 0],
        [0, -1, 0],
        [1, 0, 0],
        [0, 0, -1],
        [-1, 0, 0],
        [0, 0, 1],
    ]
    .iter()
    .map(|n| json!({"normal": n, "irradiance": [0.7, 0.7, 0.7]}))
    .collect();
    bench.write("probe.json", json!(samples).to_string().as_bytes());
    let args = [
        "light",
        "--ldr",
        "room.png",
        "--probe",
        "probe.json",
        "--out",
        "env.exr",
    ];
    assert_eq!(bench.json(&args)["rung"], "probe");
    refused(
        &bench,
        &[
            "light", "--ldr", "room.png", "--lux", "-1", "--out", "e.exr",
        ],
        2,
        &["--lux"],
    );
    bench.write(
        "probe.json",
        b"[{\"normal\": [0, 0, 0], \"irradiance\": [1, 1, 1]}]",
    );
    refused(&bench, &args, 3, &["probe.json", "at least 4"]);
}

#[test]
fn a_prior_of_ones_own_is_believed_and_a_wrong_one_refused() {
    let bench = Bench::new();
    room(0.0).save(bench.path("room.png")).unwrap();
    let mut prior = json!({
        "sun_over_sky": 2.3, "sun_sigma": 0.6, "gain": 0.0, "gain_sigma": 1.0,
        "sigma_scale": [1.0, 1.0, 1.0, 1.0, 1.0],
    });
    let args = [
        "light",
        "--ldr",
        "room.png",
        "--prior",
        "prior.json",
        "--out",
        "env.exr",
    ];
    let brightest = |prior: &Value| {
        bench.write("prior.json", prior.to_string().as_bytes());
        bench.json(&args);
        let map = map(&bench.path("env.exr"));
        map.texels()
            .iter()
            .map(|texel| texel[1])
            .fold(0.0, f32::max)
    };
    // Nothing above clipping, and much.
    assert!((brightest(&prior) - 1.0).abs() < 0.05);
    prior["gain"] = json!(2.0);
    assert!(brightest(&prior) > 5.0);

    prior["gain"] = json!(-1.0);
    bench.write("prior.json", prior.to_string().as_bytes());
    refused(&bench, &args, 3, &["prior.json", "gain is out of range"]);
    prior["gane"] = json!(1.0);
    bench.write("prior.json", prior.to_string().as_bytes());
    refused(
        &bench,
        &args,
        3,
        &["prior.json", "not a prior", "gane", "bench light"],
    );
}

#[test]
fn extreme_pictures_give_finite_light() {
    let bench = Bench::new();
    for (name, code) in [("black.png", 0), ("white.png", 255)] {
        RgbImage::from_pixel(WIDTH, HEIGHT, Rgb([code; 3]))
            .save(bench.path(name))
            .unwrap();
    }
    let (line, found) = light(&bench, "black.png");
    assert_eq!(found.as_constant(), Some([0.0; 3]));
    assert_eq!(line["lights"], json!([]));
    let (line, found) = light(&bench, "white.png");
    assert!(found.texel(0, 0)[0] >= 0.99);
    assert!(line["notes"].to_string().contains("clipped"));
    assert!(
        line["sigma_ev"].as_f64().unwrap() > 0.5,
        "nothing is known: {line}"
    );
    RgbImage::from_pixel(1, 1, Rgb([128; 3]))
        .save(bench.path("one.png"))
        .unwrap();
    let (line, found) = light(&bench, "one.png");
    assert!((found.texel(0, 0)[0] - 0.2158).abs() < 1e-3);
    assert!(line["notes"].to_string().contains("2 : 1"));
    RgbImage::from_pixel(100, 37, Rgb([255, 200, 128]))
        .save(bench.path("odd.png"))
        .unwrap();
    let (line, _) = light(&bench, "odd.png");
    assert!(line["notes"].to_string().contains("2 : 1"));
}

#[test]
fn depth_and_colour_kinds_are_read() {
    let bench = Bench::new();
    let deep = ImageBuffer::from_fn(WIDTH, HEIGHT, |_, _| Rgb([30000_u16, 10, 65000]));
    deep.save(bench.path("deep.png")).unwrap();
    let (_, found) = light(&bench, "deep.png");
    let expected = holovol_light::response::srgb_to_linear(30000.0 / 65535.0) as f32;
    assert!((found.texel(5, 5)[0] - expected).abs() < 1e-4);
    let mut grey = Vec::new();
    let picture = GrayImage::from_pixel(WIDTH, HEIGHT, image::Luma([100]));
    JpegEncoder::new(&mut grey).encode_image(&picture).unwrap();
    bench.write("grey.jpg", &grey);
    let (_, found) = light(&bench, "grey.jpg");
    let [r, g, b] = found.texel(5, 5);
    assert!(r == g && g == b && (r - 0.127).abs() < 0.005, "{r}");
    // C, M, Y, K of 0, 64, 128 and 100 in 255, as printers' programs save them.
    bench.write("ink.jpg", include_bytes!("support/cmyk.jpg"));
    let (_, found) = light(&bench, "ink.jpg");
    let paper = [0.0, 64.0, 128.0].map(|ink| (1.0 - ink / 255.0) * (1.0 - 100.0 / 255.0));
    for (found, expected) in found.texel(5, 5).into_iter().zip(paper) {
        let expected = holovol_light::response::srgb_to_linear(expected) as f32;
        assert!((found - expected).abs() < 0.02, "{found} for {expected}");
    }
}

#[test]
fn linear_files_are_exposures_or_pass_through() {
    let bench = Bench::new();
    let write = |name: &str, texels: Vec<[f32; 3]>| {
        let pixels = texels.iter().map(|&[r, g, b]| [r, g, b, 1.0]).collect();
        let picture = holovol_reference::Image::new(16, 8, pixels);
        picture.write_exr(&bench.path(name)).unwrap();
    };
    let mut texels = vec![[0.3; 3]; 128];
    texels[40] = [1.0; 3];
    write("clipped.exr", texels.clone());
    let (line, _) = light(&bench, "clipped.exr");
    assert_eq!(line["rung"], "single");
    texels[40] = [500.0; 3];
    write("hdr.exr", texels.clone());
    let (line, found) = light(&bench, "hdr.exr");
    assert_eq!(
        (&line["rung"], found.texels()),
        (&json!("hdr"), texels.as_slice())
    );
    texels[3] = [f32::NAN, -1.0, 0.5];
    write("nan.exr", texels);
    let (line, found) = light(&bench, "nan.exr");
    assert!(
        line["notes"]
            .to_string()
            .contains("1 texels were not finite"),
        "{line}"
    );
    assert_eq!(found.texel(3, 0), [0.0, 0.0, 0.5]);
}

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

#[test]
fn pairs_are_stitched_and_wrong_calibrations_refused() {
    let bench = Bench::new();
    // A lens that fills its picture, brighter toward the right.
    let picture = RgbImage::from_fn(200, 200, |x, _| Rgb([60 + (x / 4) as u8; 3]));
    picture.save(bench.path("a.png")).unwrap();
    picture.save(bench.path("b.png")).unwrap();
    let line = bench.json(&[
        "stitch", "a.png", "b.png", "--out", "pano.png", "--width", "256",
    ]);
    assert_eq!(
        (&line["width"], &line["height"]),
        (&json!(256), &json!(128))
    );
    let pano = image::open(bench.path("pano.png")).unwrap().into_rgb8();
    // Ahead is the middle of the front picture; to its right the panorama gets brighter.
    assert!((i32::from(pano.get_pixel(128, 64).0[0]) - 85).abs() <= 2);
    assert!(pano.get_pixel(150, 64).0[0] > pano.get_pixel(106, 64).0[0]);
    RgbImage::new(200, 100)
        .save(bench.path("flat.png"))
        .unwrap();
    let calibrate = [
        "calibrate",
        "--pair",
        "a.png",
        "b.png",
        "--out",
        "camera.json",
    ];
    refused(
        &bench,
        &calibrate,
        3,
        &["--pair a.png b.png", "same picture"],
    );
    assert!(!exists(&bench.path("camera.json")));
    let offset = "2_90_100_100_0_0_0_90_300_100_0_0_0_400_200_2";
    bench.json(&["calibrate", "--insta360", offset, "--out", "camera.json"]);
    bench.json(&[
        "stitch",
        "a.png",
        "b.png",
        "--calibration",
        "camera.json",
        "--out",
        "pano.png",
    ]);
    let wrong = [
        "stitch",
        "flat.png",
        "flat.png",
        "--calibration",
        "camera.json",
        "--out",
        "p.png",
    ];
    refused(&bench, &wrong, 3, &["[200, 200]", "[200, 100]"]);
    bench.write("camera.json", b"{\"version\": 1}");
    refused(&bench, &wrong, 3, &["camera.json", "lenses"]);
    refused(&bench, &["calibrate", "--out", "c.json"], 2, &["--pair"]);
}

/// The side of a lens's picture, pixels.
const SIDE: u32 = 200;

/// A lens's picture, 195° wide, of one of many places; `back` looks the other way.
fn fisheye(back: bool, seed: f64) -> RgbImage {
    RgbImage::from_fn(SIDE, SIDE, |x, y| {
        let middle = |i: u32| (f64::from(i) + 0.5) / f64::from(SIDE) * 2.0 - 1.0;
        let (x, y) = (middle(x), middle(y));
        let radius = x.hypot(y);
        if radius > 1.0 {
            return Rgb([0; 3]);
        }
        let angle = radius * 97.5_f64.to_radians();
        let (side, up) = (angle.sin() * x / radius, -angle.sin() * y / radius);
        let (side, ahead) = if back {
            (-side, -angle.cos())
        } else {
            (side, angle.cos())
        };
        let direction = glam::DVec3::new(side, up, ahead);
        let waves = holovol_light::measure::normals(8).zip(1..);
        let light: f64 = waves
            .map(|(n, i)| {
                let phase = (8.0 + 2.0 * f64::from(i)) * n.dot(direction);
                (phase + seed * f64::from(i)).sin()
            })
            .sum();
        Rgb([(120.0 + 15.0 * light) as u8; 3])
    })
}

/// What is impossible is refused by file and field; what leaves a part black is said.
#[test]
fn lenses_that_do_not_fit_their_pictures_are_told() {
    let bench = Bench::new();
    fisheye(false, 0.0).save(bench.path("a.png")).unwrap();
    fisheye(true, 0.0).save(bench.path("b.png")).unwrap();
    let stitch = |options: &[&str]| {
        let all = [
            "stitch", "a.png", "b.png", "--out", "p.png", "--width", "128",
        ];
        let output = bench.run(&[&all[..], options].concat());
        (
            output.status.code(),
            String::from_utf8_lossy(&output.stderr).into_owned(),
            String::from_utf8_lossy(&output.stdout).into_owned(),
        )
    };
    let (code, notes, line) = stitch(&[]);
    assert_eq!((code, notes.as_str()), (Some(0), ""));
    assert!(line.contains("\"unseen\":0.0"), "{line}");
    let (code, notes, _) = stitch(&["--fov", "100"]);
    assert_eq!(code, Some(0));
    assert!(
        notes.contains("neither lens sees 65.") && notes.contains("--fov"),
        "{notes}"
    );
    // The numbers of pictures half as large, and twice.
    let camera = |numbers: f64, size: u32| {
        let lens = |rotation: [f64; 4]| {
            json!({ "size": [size, size], "lens_from_camera": rotation, "projection": {
                "model": "equidistant", "focal": numbers * 100.0 / 97.5_f64.to_radians(),
                "centre": [numbers * 100.0, numbers * 100.0], "fov_deg": 195.0 } })
        };
        let lenses = [lens([1.0, 0.0, 0.0, 0.0]), lens([0.0, 0.0, 1.0, 0.0])];
        json!({ "version": 1, "lenses": lenses }).to_string()
    };
    bench.write("camera.json", camera(0.5, SIDE).as_bytes());
    let (code, notes, _) = stitch(&["--calibration", "camera.json"]);
    assert_eq!(code, Some(0));
    assert!(
        notes.contains("note: a.png: 79 %") && notes.contains("lenses[1]"),
        "{notes}"
    );
    bench.write("camera.json", camera(2.0, SIDE).as_bytes());
    let (code, error, _) = stitch(&["--calibration", "camera.json"]);
    assert_eq!(code, Some(3), "{error}");
    assert!(
        error.contains("camera.json: lenses[0].projection.centre is [200, 200]"),
        "{error}"
    );
    bench.write("camera.json", camera(2.0, 2 * SIDE).as_bytes());
    assert_eq!(stitch(&["--calibration", "camera.json"]).1, "");
}

#[test]
fn cameras_are_calibrated_or_it_is_said_why_not() {
    let bench = Bench::new();
    fisheye(false, 0.0).save(bench.path("a.png")).unwrap();
    fisheye(true, 0.0).save(bench.path("b.png")).unwrap();
    fisheye(true, 1.0).save(bench.path("other.png")).unwrap();
    RgbImage::new(SIDE, SIDE / 2)
        .save(bench.path("flat.png"))
        .unwrap();
    let calibrate = |b: &'static str| ["calibrate", "--pair", "a.png", b, "--out", "c.json"];
    refused(
        &bench,
        &calibrate("other.png"),
        3,
        &["a.png other.png", "agrees there to"],
    );
    refused(
        &bench,
        &calibrate("flat.png"),
        3,
        &["[200, 100]", "without --start"],
    );
    assert!(!exists(&bench.path("c.json")));
    let line = bench.json(&calibrate("b.png"));
    assert!(line["agreement"].as_f64().unwrap() > 0.9, "{line}");
    let offset = ["calibrate", "--out", "d.json", "--insta360"];
    for (text, words) in [
        ("", ["offset string", "field 1"]),
        (
            "2_90_100_100_0_0_NaN_90_300_100_0_0_0_400_200_2",
            ["field 7", "NaN"],
        ),
        (
            "2_-90_100_100_0_0_0_90_300_100_0_0_0_400_200_2",
            ["lenses[0].projection.focal", "-"],
        ),
        (
            "2_90_1e300_100_0_0_0_90_300_100_0_0_0_400_200_2",
            ["lenses[0].projection.centre", "1e300"],
        ),
    ] {
        refused(&bench, &[&offset[..], &[text]].concat(), 3, &words);
    }
}

/// A series alone gives a response that `--crf` reads; one that shows no exposures is refused.
#[test]
fn a_series_becomes_a_response_file() {
    let bench = Bench::new();
    for (name, ev) in [("0.png", 0.0_f64), ("1.png", -1.5), ("2.png", -3.0)] {
        let picture = RgbImage::from_fn(128, 64, |x, _| {
            let light = (f64::from(x) / 12.8 - 8.0 + ev).exp2().min(1.0);
            Rgb([(light.powf(1.0 / 1.8) * 255.0).round() as u8; 3])
        });
        picture.save(bench.path(name)).unwrap();
    }
    let fit = |series: [&'static str; 3]| {
        let [a, b, c] = series;
        ["calibrate", "--series", a, b, c, "--out", "response.json"]
    };
    refused(
        &bench,
        &fit(["0.png", "0.png@-1.5", "0.png@-3"]),
        3,
        &["--series", "exposure"],
    );
    refused(
        &bench,
        &fit(["2.png", "1.png@-1.5", "0.png@-3"]),
        3,
        &["red follows only"],
    );
    let jpeg = image::open(bench.path("1.png")).unwrap().into_rgb8();
    jpeg.save(bench.path("1.jpg")).unwrap();
    refused(
        &bench,
        &fit(["0.png", "1.jpg@-1.5", "2.png@-3"]),
        3,
        &["--series 1.jpg@-1.5: a JPEG"],
    );
    refused(
        &bench,
        &fit(["0.png", "1.png", "2.png"]),
        3,
        &["PICTURE@EV"],
    );
    refused(
        &bench,
        &fit(["0.png", "1.png@-99", "2.png"]),
        2,
        &["--series 1.png@-99"],
    );
    RgbImage::new(64, 128).save(bench.path("tall.png")).unwrap();
    let tall = fit(["0.png", "1.png@-1.5", "tall.png@-3"]);
    refused(&bench, &tall, 3, &["tall.png@-3", "64 × 128"]);
    assert!(!exists(&bench.path("response.json")));
    let line = bench.json(&fit(["0.png", "1.png@-1.5", "2.png@-3"]));
    assert_eq!(
        (&line["kind"], &line["response"]),
        (&json!("response"), &json!("fitted"))
    );
    let text = std::fs::read_to_string(bench.path("response.json")).unwrap();
    let file: Value = serde_json::from_str(&text).unwrap();
    assert!(file["table"].is_array() && file["lenses"].is_null());
    // Half of the codes is 2^-1.8 of the light.
    let grey = RgbImage::from_pixel(64, 32, Rgb([128; 3]));
    grey.save(bench.path("grey.png")).unwrap();
    let args = [
        "light",
        "--ldr",
        "grey.png",
        "--crf",
        "response.json",
        "--out",
        "env.exr",
    ];
    bench.json(&args);
    let level = f64::from(map(&bench.path("env.exr")).texels()[0][1]);
    assert!((level.log2() + 1.8).abs() < 0.15, "{level}");
}

/// A real sun, clipped by 16 EV, from one 8-bit picture: found, and its strength within 1 EV.
#[test]
fn a_real_sun_is_restored() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../../shared/data/hdri/kloppenheim_05_1k.hdr");
    if !exists(&path) {
        eprintln!("skipped: {} is not there", path.display());
        return;
    }
    let bench = Bench::new();
    let truth = EnvironmentMap::load(&path).unwrap();
    let code = |l: f32| {
        let light = f64::from(l).min(1.0);
        (holovol_light::response::linear_to_srgb(light) * 255.0).round() as u8
    };
    let picture = RgbImage::from_fn(1024, 512, |x, y| {
        Rgb(truth.texel(i64::from(x), i64::from(y)).map(code))
    });
    picture.save(bench.path("day.png")).unwrap();
    let (line, found) = light(&bench, "day.png");
    let sun = &line["lights"][0];
    assert_eq!(sun["class"], "sun");
    assert!((sun["direction"][1].as_f64().unwrap() - 75.0_f64.to_radians().sin()).abs() < 0.02);
    let grid = holovol_light::Grid::new(1024, 512);
    let flux = |map: &EnvironmentMap| holovol_light::measure::luminous_flux(&grid, map.texels());
    let bias = (flux(&found) / flux(&truth)).log2();
    assert!(bias.abs() < 1.0, "{bias}");
    let as_is = truth
        .texels()
        .iter()
        .map(|t| t.map(|c| c.min(1.0)))
        .collect();
    let as_is = (flux(&EnvironmentMap::new(1024, 512, as_is)) / flux(&truth)).log2();
    assert!(as_is < -1.2, "{as_is}");
}
