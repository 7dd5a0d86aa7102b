//! Scene files: what is read, what is refused, and in which words.

use std::path::{Path, PathBuf};

use holovol_scene::{Background, SceneError, SceneFile, ToneMapping};
use serde_json::{Value, json};

fn minimal() -> Value {
    json!({
        "version": 1,
        "volume": { "path": "head.nii.gz" },
        "transfer_function": { "points": [
            { "s": 0.0, "sigma_t": 0.0, "albedo": [0.8, 0.8, 0.8] },
            { "s": 1.0, "sigma_t": 500.0, "albedo": [0.9, 0.5, 0.4] }
        ] },
        "environment": { "constant": [1.0, 1.0, 1.0] },
        "camera": { "eye": [0, 0, 1], "target": [0, 0, 0], "up": [0, 1, 0],
                    "fov_y_deg": 30, "width": 64, "height": 48 }
    })
}

/// The minimal scene with one value put at a JSON pointer, whose last part may be new.
fn with(pointer: &str, value: Value) -> String {
    let mut scene = minimal();
    let (parent, key) = pointer.rsplit_once('/').unwrap();
    let parent = scene.pointer_mut(parent).unwrap();
    match parent {
        Value::Object(map) => {
            map.insert(key.to_owned(), value);
        }
        Value::Array(items) => items[key.parse::<usize>().unwrap()] = value,
        _ => panic!("{pointer} is in no object or array"),
    }
    scene.to_string()
}

fn without(pointer: &str) -> String {
    let mut scene = minimal();
    let (parent, key) = pointer.rsplit_once('/').unwrap();
    let parent = scene.pointer_mut(parent).unwrap();
    parent.as_object_mut().unwrap().remove(key).unwrap();
    scene.to_string()
}

fn message(text: &str) -> String {
    SceneFile::parse(text).unwrap_err().to_string()
}

#[track_caller]
fn refused(pointer: &str, value: Value, words: &[&str]) {
    let message = message(&with(pointer, value));
    for word in words {
        assert!(message.contains(word), "{message:?} lacks {word:?}");
    }
}

#[test]
fn defaults_are_those_of_the_design() {
    let scene = SceneFile::parse(&minimal().to_string()).unwrap();
    assert_eq!(scene.phase_g, 0.0);
    assert_eq!(scene.gradient_factor, 0.0);
    assert_eq!(scene.integrator.max_scatters, Some(1));
    assert_eq!(scene.environment.scale, 1.0);
    assert_eq!(scene.environment.rotation_y_deg, 0.0);
    assert!(scene.volume.window.is_none() && scene.volume.world_from_unit_cube.is_none());
    assert!(scene.stereo.is_none() && scene.animation.is_none() && scene.output.is_none());
    let unlimited = with("/integrator", json!({ "max_scatters": null }));
    let unlimited = SceneFile::parse(&unlimited).unwrap();
    assert_eq!(unlimited.integrator.max_scatters, None);
    let emission_only = with("/integrator", json!({ "max_scatters": 0 }));
    let emission_only = SceneFile::parse(&emission_only).unwrap();
    assert_eq!(emission_only.integrator.max_scatters, Some(0));
}

#[test]
fn every_part_of_the_format_is_read() {
    let mut scene = minimal();
    scene["stereo"] = json!({ "ipd": 0.063 });
    scene["animation"] = json!({ "frames": 32, "eye_to": [1, 0, 1], "target_to": [0, 0.1, 0],
        "environment_rotation_to_deg": 90, "volume_rotation_y_to_deg": 360,
        "switch": { "frame": 16, "environment": { "path": "b.hdr", "scale": 2 },
                    "transfer_function": { "points": [{ "s": 0, "sigma_t": 1, "albedo": [1, 1, 1],
                        "emission": [1, 2, 3], "roughness": 0.2, "specular": 0.04 }] } } });
    scene["output"] =
        json!({ "exposure_ev": -1.5, "tone_mapping": "aces", "background": "environment" });
    let scene = SceneFile::parse(&scene.to_string()).unwrap();
    assert_eq!(scene.stereo.unwrap().ipd, 0.063);
    let animation = scene.animation.as_ref().unwrap();
    let switch = animation.switch.as_ref().unwrap();
    assert_eq!((animation.frames, switch.frame), (32, 16));
    assert_eq!(switch.environment.as_ref().unwrap().scale, 2.0);
    let points = &switch.transfer_function.as_ref().unwrap().points;
    assert_eq!(points[0].emission, [1.0, 2.0, 3.0]);
    let output = scene.output.unwrap();
    assert_eq!(output.tone_mapping, ToneMapping::Aces);
    assert_eq!(output.background, Background::Environment);
    let again = SceneFile::parse(&scene.to_json().unwrap()).unwrap();
    assert_eq!(again, scene);
}

#[test]
fn unknown_keys_are_named_with_the_nearest_valid_one() {
    refused(
        "/transfer_function/points/1/sigmat",
        json!(3),
        &[
            "transfer_function.points[1]:",
            "`sigmat`",
            "did you mean `sigma_t`?",
        ],
    );
    refused(
        "/camera/fov_y",
        json!(0.5),
        &["camera:", "`fov_y`", "`fov_y_deg`?"],
    );
    refused(
        "/Environment",
        json!({}),
        &["the scene:", "`Environment`", "`environment`?"],
    );
    let far = message(&with("/camera/zzz", json!(1)));
    assert!(
        !far.contains("did you mean") && far.contains("`fov_y_deg`"),
        "{far}"
    );
}

#[test]
fn planes_that_cut_nothing_definite_are_refused() {
    refused("/clip", json!([[0, 0, 0, 1]]), &["clip[0]", "no normal"]);
    refused("/clip", json!([[0, 1e300, 0, 1]]), &["clip[0][1]"]);
    refused(
        "/clip",
        json!([[0, 1, 0]]),
        &["clip[0]", "exactly that many"],
    );
    refused(
        "/clip",
        json!(vec![[1, 0, 0, 0]; 9]),
        &["clip", "at most 8"],
    );
    with("/clip", json!([[0, 1, 0, -0.5], [1, 1, 1, 1e-3]]));
}

#[test]
fn parts_to_come_are_recognised_and_refused() {
    for (pointer, name) in [("/volumes", "volumes:"), ("/labels", "labels:")] {
        refused(pointer, json!([]), &[name, "not supported yet"]);
    }
    let model = json!({ "model": "slabs" });
    refused(
        "/integrator",
        model,
        &["integrator.model:", "not supported yet"],
    );
    let mut instead = minimal();
    let volume = instead.as_object_mut().unwrap().remove("volume").unwrap();
    instead["volumes"] = json!([volume]);
    assert!(message(&instead.to_string()).contains("volumes: not supported yet"));
}

#[test]
fn values_out_of_range_name_field_value_and_what_is_allowed() {
    let g = ["phase_g", "1 ", "-0.9999 to 0.9999"];
    refused("/phase_g", json!(1), &g);
    refused(
        "/gradient_factor",
        json!(-1),
        &["gradient_factor", "-1", "0 to"],
    );
    refused("/version", json!(2), &["version", "2", "expected 1"]);
    refused(
        "/volume/window",
        json!([5, 5]),
        &["volume.window", "[5, 5]", "two different"],
    );
    refused("/volume/path", json!(""), &["volume.path", "empty"]);
    refused(
        "/camera/width",
        json!(0),
        &["camera.width", "0", "1 to 16384"],
    );
    refused(
        "/camera/height",
        json!(16385),
        &["camera.height", "16385", "1 to 16384"],
    );
    refused(
        "/camera/fov_y_deg",
        json!(180),
        &["camera.fov_y_deg", "180", "degrees"],
    );
    refused(
        "/camera/eye",
        json!([0, 0, 0]),
        &["camera.target", "where `eye` is"],
    );
    refused(
        "/camera/eye",
        json!([0, 1, 0]),
        &["camera.up", "parallel to the view"],
    );
    refused("/camera/up", json!([0, 0, 0]), &["camera.up", "no length"]);
    refused("/camera/eye/1", json!(1e300), &["camera.eye[1]", "metres"]);
    refused(
        "/environment",
        json!({}),
        &["environment", "neither `path` nor `constant`"],
    );
    refused(
        "/environment/path",
        json!("a.hdr"),
        &["environment", "both"],
    );
    refused(
        "/environment/scale",
        json!(-1),
        &["environment.scale", "-1"],
    );
    refused(
        "/environment/constant/2",
        json!(-0.5),
        &["environment.constant[2]", "-0.5"],
    );
    refused(
        "/integrator",
        json!({ "max_scatters": -1 }),
        &["integrator.max_scatters", "-1"],
    );
    refused(
        "/stereo",
        json!({ "ipd": -0.06 }),
        &["stereo.ipd", "metres"],
    );
    refused(
        "/transfer_function/points",
        json!([]),
        &["transfer_function.points", "at least one"],
    );
    refused(
        "/transfer_function/points/1/sigma_t",
        json!(-1),
        &["points[1].sigma_t", "-1"],
    );
    refused(
        "/transfer_function/points/0/s",
        json!(2),
        &["points[1].s", "sort"],
    );
    refused(
        "/output",
        json!({ "background": [2, 0, 0] }),
        &["output.background[0]"],
    );
    refused(
        "/output",
        json!({ "background": "blue" }),
        &["output.background", "environment"],
    );
    refused(
        "/output",
        json!({ "tone_mapping": "x" }),
        &["output.tone_mapping", "neutral"],
    );
    let late = json!({ "frames": 4, "switch": { "frame": 4 } });
    refused("/animation", late, &["animation.switch.frame", "0 to 3"]);
    refused(
        "/animation",
        json!({ "frames": 0 }),
        &["animation.frames", "1 to"],
    );
}

#[test]
fn numbers_with_units_are_refused_with_the_way_out() {
    let words = ["camera.fov_y_deg", "30 deg", "angles degrees"];
    refused("/camera/fov_y_deg", json!("30 deg"), &words);
}

#[test]
fn an_image_too_large_to_hold_is_refused() {
    let mut scene = minimal();
    scene["camera"]["width"] = json!(16384);
    scene["camera"]["height"] = json!(16384);
    assert!(message(&scene.to_string()).contains("pixels are too many"));
}

#[test]
fn transforms_must_be_affine_and_have_a_volume() {
    let matrix = |rows: [[f64; 4]; 4]| json!(rows);
    let field = "/volume/world_from_unit_cube";
    let flat = [
        [1., 0., 0., 0.],
        [0., 1., 0., 0.],
        [0., 0., 0., 0.],
        [0., 0., 0., 1.],
    ];
    refused(
        field,
        matrix(flat),
        &["volume.world_from_unit_cube", "singular"],
    );
    let coplanar = [
        [1., 0., 1., 0.],
        [0., 1., 1., 0.],
        [0., 0., 0., 0.],
        [0., 0., 0., 1.],
    ];
    refused(field, matrix(coplanar), &["singular"]);
    let transposed = [
        [1., 0., 0., 0.],
        [0., 1., 0., 0.],
        [0., 0., 1., 0.],
        [5., 0., 0., 1.],
    ];
    refused(field, matrix(transposed), &["last row", "[0, 0, 0, 1]"]);
    refused(
        field,
        json!([[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        &["world_from_unit_cube"],
    );
    // A volume of 1 µm and one with edges of 1 : 1000 are not singular.
    for edges in [[1e-6, 1e-6, 1e-6], [1e-3, 1.0, 1.0], [1e4, 1e4, 1e4]] {
        let [x, y, z] = edges;
        let rows = [
            [x, 0., 0., 0.],
            [0., y, 0., 0.],
            [0., 0., -z, 0.],
            [0., 0., 0., 1.],
        ];
        SceneFile::parse(&with(field, matrix(rows))).unwrap();
    }
}

#[test]
fn likely_slips_of_units_are_remarked_on() {
    let rows = json!([[180, 0, 0, 0], [0, 180, 0, 0], [0, 0, 180, 0], [0, 0, 0, 1]]);
    let scene = SceneFile::parse(&with("/volume/world_from_unit_cube", rows)).unwrap();
    assert!(scene.notices()[0].contains("metres, not millimetres"));
    let scene = SceneFile::parse(&with("/camera/fov_y_deg", json!(0.52))).unwrap();
    assert!(scene.notices()[0].contains("degrees, not radians"));
    let plain = SceneFile::parse(&minimal().to_string()).unwrap();
    assert!(plain.notices().is_empty());
}

#[test]
fn missing_keys_and_broken_json_are_told() {
    let missing = message(&without("/camera/eye"));
    assert!(
        missing.contains("camera:") && missing.contains("`eye`"),
        "{missing}"
    );
    let broken = message("{ \"version\": 1,");
    assert!(
        broken.contains("not valid JSON") && broken.contains("line 1"),
        "{broken}"
    );
    assert!(message(&format!("{} {{}}", minimal())).contains("not valid JSON"));
    assert!(message("").contains("not valid JSON"));
    let array = message("[1, 2]");
    assert!(
        array.contains("the scene:") && array.contains("object"),
        "{array}"
    );
    for deep in ["[", "{\"clip\":", "{\"volume\":["] {
        assert!(!message(&deep.repeat(100_000)).is_empty());
    }
    let huge = minimal().to_string().replace("500.0", "1e999");
    assert!(
        message(&huge).contains("not valid JSON"),
        "{}",
        message(&huge)
    );
}

#[test]
fn errors_name_the_scene_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.json");
    let missing = SceneFile::read(&path).unwrap_err();
    assert!(matches!(missing, SceneError::Io { .. }));
    assert!(missing.to_string().contains("scene.json"));
    std::fs::write(&path, with("/phase_g", json!(3))).unwrap();
    let message = SceneFile::read(&path).unwrap_err().to_string();
    assert!(message.contains("scene.json: phase_g: 3"), "{message}");
    std::fs::write(&path, [0x1f, 0x8b, 0x08, 0x00, 0xff]).unwrap();
    let message = SceneFile::read(&path).unwrap_err().to_string();
    assert!(
        message.contains("scene.json: not a scene file"),
        "{message}"
    );
}

#[test]
fn missing_environment_and_volume_name_field_and_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.json");
    std::fs::write(
        &path,
        with("/environment", json!({ "path": "nowhere.hdr" })),
    )
    .unwrap();
    let error = holovol_scene::load(&path, &mut |_| {})
        .unwrap_err()
        .to_string();
    for word in ["scene.json", "environment.path", "nowhere.hdr"] {
        assert!(error.contains(word), "{error}");
    }
    std::fs::write(&path, minimal().to_string()).unwrap();
    let error = holovol_scene::load(&path, &mut |_| {})
        .unwrap_err()
        .to_string();
    for word in ["scene.json", "volume.path", "head.nii.gz"] {
        assert!(error.contains(word), "{error}");
    }
}

#[test]
fn reference_scenes_are_read() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/reference");
    let Ok(entries) = std::fs::read_dir(&folder) else {
        eprintln!("skipped: {} is absent", folder.display());
        return;
    };
    let scenes: Vec<PathBuf> = entries
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "json"))
        .filter(|path| !path.to_string_lossy().ends_with(".ref.json"))
        .collect();
    assert!(!scenes.is_empty());
    for path in scenes {
        let scene = SceneFile::read(&path).unwrap();
        assert!(scene.notices().is_empty(), "{}", path.display());
    }
}
