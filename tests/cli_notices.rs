//! What the `holovol` command says when a scene is allowed but can't be meant, or ends early.

mod support;

use holovol_reference::Image;
use serde_json::{Value, json};
use support::{Bench, exists, nrrd, scene};

const RENDER: [&str; 8] = [
    "render",
    "scene.json",
    "--out",
    "out.exr",
    "--backend",
    "reference",
    "--spp",
    "2",
];

/// Standard error of a render that succeeds.
#[track_caller]
fn notes(bench: &Bench, scene: &Value) -> String {
    bench.write_scene("scene.json", scene);
    let output = bench.run(&RENDER);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{stderr}");
    stderr
}

/// Standard error of a render that is refused.
#[track_caller]
fn refusal(bench: &Bench, text: &str, code: i32) -> String {
    bench.write("scene.json", text.as_bytes());
    let output = bench.run(&RENDER);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(code), "{stderr}");
    stderr
}

#[test]
fn empty_pictures_are_explained() {
    let bench = Bench::new();
    let mut away = scene();
    away["camera"]["eye"] = json!([100.0, 0.0, 300.0]);
    let stderr = notes(&bench, &away);
    assert!(
        stderr.contains("less than two pixels") && stderr.contains("metres"),
        "{stderr}"
    );

    let mut elsewhere = scene();
    elsewhere["camera"]["target"] = json!([0.0, 50.0, 0.0]);
    assert!(notes(&bench, &elsewhere).contains("looks elsewhere"));

    let mut outside = scene();
    outside["volume"]["window"] = json!([10000.0, 20000.0]);
    outside["transfer_function"] = json!({ "points": [
        { "s": 0.0, "sigma_t": 0.0, "albedo": [1, 1, 1] },
        { "s": 1.0, "sigma_t": 9.0, "albedo": [1, 1, 1] }] });
    let stderr = notes(&bench, &outside);
    assert!(stderr.contains("window [10000, 20000]"), "{stderr}");

    let mut transparent = scene();
    transparent["transfer_function"]["points"] =
        json!([{ "s": 0.0, "sigma_t": 0.0, "albedo": [1, 1, 1] }]);
    assert!(notes(&bench, &transparent).contains("sigma_t is 0 at every point"));
    assert!(!notes(&bench, &scene()).contains("nothing is seen"));
}

#[test]
fn voxels_that_are_no_numbers_are_told() {
    let bench = Bench::new();
    let voxels: Vec<u8> = [0.0, f32::NAN, 1.0, 1.0, f32::INFINITY, 0.5, 0.5, 0.2]
        .iter()
        .flat_map(|v: &f32| v.to_le_bytes())
        .collect();
    bench.write("damaged.nrrd", &nrrd("float", "2 2 2", &voxels));
    let mut damaged = scene();
    damaged["volume"]["path"] = json!("damaged.nrrd");
    let stderr = notes(&bench, &damaged);
    assert!(
        stderr.contains("2 of 8 voxels were NaN or infinite"),
        "{stderr}"
    );
}

#[test]
fn extreme_density_and_light_are_told_or_refused() {
    let bench = Bench::new();
    let mut dense = scene();
    let spacing = 0.012 / 12.0;
    let at_depth =
        |depth: f64| json!([{ "s": 0.0, "sigma_t": depth / spacing, "albedo": [1, 1, 1] }]);
    dense["volume"]["world_from_unit_cube"] = json!([
        [0.012, 0, 0, 0],
        [0, 0.012, 0, 0],
        [0, 0, 0.012, 0],
        [0, 0, 0, 1]
    ]);
    dense["transfer_function"]["points"] = at_depth(5e3);
    let stderr = notes(&bench, &dense);
    assert!(
        stderr.contains("optical depth of 5.0e3 across a voxel"),
        "{stderr}"
    );
    dense["transfer_function"]["points"] = at_depth(1e8);
    let stderr = refusal(&bench, &dense.to_string(), 3);
    assert!(
        stderr.contains("transfer_function.points") && stderr.contains("1/m"),
        "{stderr}"
    );

    let mut bright = scene();
    bright["environment"] = json!({ "constant": [1e29, 0, 0], "scale": 100.0 });
    let stderr = refusal(&bench, &bright.to_string(), 3);
    assert!(stderr.contains("environment.scale"), "{stderr}");
}

#[test]
fn slips_in_json_are_recognised() {
    let bench = Bench::new();
    let text = scene().to_string();
    for (text, words) in [
        (String::new(), "empty"),
        ("NRRD0004\ntype: uint8".into(), "is this the volume"),
        (text.replacen('{', "{ // my scene\n", 1), "no comments"),
        (text.replacen("24", "NaN", 1), "finite numbers only"),
        (text.replacen("24", "null", 1), "expected a whole number"),
    ] {
        let stderr = refusal(&bench, &text, 3);
        assert!(
            stderr.contains(words) && stderr.contains("scene.json"),
            "{stderr}"
        );
        assert!(
            !stderr.contains("u32") && !stderr.contains("f64"),
            "{stderr}"
        );
    }
    // A byte-order mark is none.
    bench.write("scene.json", format!("\u{feff}{text}").as_bytes());
    assert!(bench.run(&RENDER).status.success());
    let missing = bench.run(&["render", "nope.json", "--out", "out.exr"]);
    let stderr = String::from_utf8(missing.stderr).unwrap();
    assert!(
        stderr.contains("nope.json") && stderr.contains("check the path"),
        "{stderr}"
    );
}

#[test]
fn options_out_of_range_are_named() {
    let bench = Bench::new();
    for (option, value) in [("--spp", "-4"), ("--seed", "-1"), ("--adapter", "")] {
        let output = bench.run(&["render", "scene.json", "--out", "o.exr", option, value]);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{stderr}");
        assert!(
            stderr.contains(option) && !stderr.contains("'-- "),
            "{stderr}"
        );
    }
}

#[test]
fn taken_names_of_later_images_are_found_before_the_first() {
    let bench = Bench::new();
    let mut pair = scene();
    pair["stereo"] = json!({ "ipd": 0.06 });
    std::fs::create_dir(bench.path("out.right.exr")).unwrap();
    let stderr = refusal(&bench, &pair.to_string(), 4);
    assert!(stderr.contains("out.right.exr is a folder"), "{stderr}");
    assert!(!exists(&bench.path("out.left.exr")));
    std::fs::remove_dir(bench.path("out.right.exr")).unwrap();
    let line = bench.json(&RENDER);
    assert_eq!(line["files"], json!(["out.left.exr", "out.right.exr"]));
}

#[cfg(unix)]
#[test]
fn links_stay_links() {
    let bench = Bench::new();
    bench.write("target.exr", b"");
    std::os::unix::fs::symlink("target.exr", bench.path("out.exr")).unwrap();
    bench.json(&RENDER);
    assert!(bench.path("out.exr").is_symlink());
    Image::read_exr(&bench.path("target.exr")).unwrap();
}

#[cfg(unix)]
#[test]
fn readers_that_leave_are_no_failure() {
    use std::process::Stdio;
    let bench = Bench::new();
    let mut child = bench
        .command()
        .args(RENDER)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    assert!(child.wait().unwrap().success());
}

#[cfg(unix)]
#[test]
fn interrupted_work_is_kept() {
    use std::process::{Command, Stdio};
    use std::time::Duration;
    let bench = Bench::new();
    let child = bench
        .command()
        .args(&RENDER[..6])
        .args(["--seconds", "600"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // Long enough to be tracing, however slow the machine: nothing else takes so long.
    std::thread::sleep(Duration::from_secs(3));
    let id = child.id().to_string();
    assert!(
        Command::new("kill")
            .args(["-INT", &id])
            .status()
            .unwrap()
            .success()
    );
    let output = child.wait_with_output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(130), "{stderr}");
    assert!(stderr.contains("what is traced is kept"), "{stderr}");
    let line: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(line["spp"].as_u64().unwrap() > 0);
    Image::read_exr(&bench.path("out.exr")).unwrap();
}
