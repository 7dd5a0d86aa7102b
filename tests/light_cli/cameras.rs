//! `holovol stitch` and `calibrate`: lenses, pairs and series of exposures.

use super::*;

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
