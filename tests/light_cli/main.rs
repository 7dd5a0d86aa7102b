//! `holovol light`, `stitch` and `calibrate` as their users meet them.

mod cameras;
mod doubts;
#[path = "../support/mod.rs"]
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
    bench.write("ink.jpg", include_bytes!("../support/cmyk.jpg"));
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
