//! No text makes the scene parser panic, and what it accepts can be used.

use holovol_light::EnvironmentMap;
use holovol_scene::{SceneFile, Sequence};
use holovol_volume::{Geometry, Volume, Voxels};
use proptest::prelude::*;
use serde_json::{Value, json};

fn full_scene() -> Value {
    json!({
        "version": 1,
        "volume": { "path": "v.nrrd", "window": [-200.5, 1500],
            "world_from_unit_cube": [[0.18, 0, 0, -0.09], [0, 0, 0.246, -0.123],
                                     [0, -0.189, 0, 0.0945], [0, 0, 0, 1]] },
        "transfer_function": { "points": [
            { "s": 0.0, "sigma_t": 0.0, "albedo": [0.8, 0.8, 0.8] },
            { "s": 0.5, "sigma_t": 50.0, "albedo": [0.9, 0.5, 0.4], "emission": [1, 2, 3],
              "roughness": 0.3, "specular": 0.04 }
        ] },
        "phase_g": 0.3, "gradient_factor": 2.5,
        "environment": { "constant": [1, 0.5, 0.25], "rotation_y_deg": 45, "scale": 2 },
        "camera": { "eye": [0.18, 0.08, 0.55], "target": [0, 0, 0], "up": [0, 1, 0],
                    "fov_y_deg": 28, "width": 256, "height": 200 },
        "integrator": { "max_scatters": null },
        "stereo": { "ipd": 0.063 },
        "animation": { "frames": 4, "eye_to": [0, 0, 1], "target_to": [0, 0.1, 0],
            "environment_rotation_to_deg": 90, "volume_rotation_y_to_deg": -45,
            "switch": { "frame": 2, "transfer_function": { "points": [
                { "s": 0, "sigma_t": 1, "albedo": [0, 0, 0] } ] } } },
        "output": { "exposure_ev": -1, "tone_mapping": "aces", "background": [0.1, 0.2, 0.3] }
    })
}

/// All values of a document, by their pointers.
fn pointers(value: &Value, here: &str, found: &mut Vec<String>) {
    found.push(here.to_owned());
    match value {
        Value::Object(map) => {
            for (key, value) in map {
                pointers(value, &format!("{here}/{key}"), found);
            }
        }
        Value::Array(items) => {
            for (index, value) in items.iter().enumerate() {
                pointers(value, &format!("{here}/{index}"), found);
            }
        }
        _ => {}
    }
}

fn any_value() -> impl Strategy<Value = Value> {
    prop_oneof![
        Just(Value::Null),
        any::<bool>().prop_map(Value::from),
        any::<f64>().prop_map(Value::from),
        any::<i64>().prop_map(Value::from),
        (-2.0..2.0f64).prop_map(Value::from),
        prop_oneof![
            Just(0.0),
            Just(1e-320),
            Just(1e308),
            Just(-1e308),
            Just(1.0)
        ]
        .prop_map(Value::from),
        any::<u64>().prop_map(Value::from),
        ".{0,6}".prop_map(Value::from),
        prop::collection::vec(any::<f64>(), 0..5).prop_map(Value::from),
        Just(json!({})),
        Just(json!({ "path": "" })),
    ]
}

/// Puts values at places, takes places away, adds keys.
fn mutated() -> impl Strategy<Value = Value> {
    let mut places = Vec::new();
    pointers(&full_scene(), "", &mut places);
    let edit = (prop::sample::select(places), any_value(), 0..3u8);
    prop::collection::vec(edit, 1..4).prop_map(|edits| {
        let mut scene = full_scene();
        for (place, value, kind) in edits {
            match (kind, place.rsplit_once('/')) {
                (0, Some((parent, key))) => {
                    if let Some(Value::Object(map)) = scene.pointer_mut(parent) {
                        map.remove(key);
                    }
                }
                (1, _) => {
                    if let Some(Value::Object(map)) = scene.pointer_mut(&place) {
                        map.insert("surprise".into(), value);
                    }
                }
                _ => {
                    if let Some(target) = scene.pointer_mut(&place) {
                        *target = value;
                    }
                }
            }
        }
        scene
    })
}

/// Whatever is accepted has finite numbers that renderers can start from.
fn check_usable(file: &SceneFile) {
    let geometry = Geometry::from_spacing([0.01; 3]);
    let volume = Volume::new(Voxels::U8((0..8).collect()), [2; 3], 1.0, 0.0, geometry).unwrap();
    let light = EnvironmentMap::constant([1.0; 3]);
    let Ok(sequence) = Sequence::with_data(file, volume, light) else {
        return;
    };
    for index in [0, 1, sequence.frames() / 2, sequence.frames() - 1] {
        let Ok(scene) = sequence.frame(index) else {
            continue;
        };
        let rays = scene
            .camera
            .pixel_rays(scene.world_from_unit_cube.inverse());
        assert!(
            rays.origin.is_finite() && rays.direction.is_finite(),
            "{rays:?}"
        );
        assert!(rays.direction_dx.length() > 0.0 && rays.direction_dy.length() > 0.0);
        assert!(scene.min_spacing() > 0.0 && scene.min_spacing().is_finite());
        assert!(scene.s_from_value(0.0).is_finite());
        assert!(scene.phase_g.abs() < 1.0);
    }
}

#[test]
fn the_scene_that_is_mutated_is_valid() {
    let file = SceneFile::parse(&full_scene().to_string()).unwrap();
    assert_eq!(SceneFile::parse(&file.to_json().unwrap()).unwrap(), file);
    check_usable(&file);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn mutated_scenes_are_refused_in_words_or_usable(scene in mutated()) {
        match SceneFile::parse(&scene.to_string()) {
            Ok(file) => {
                check_usable(&file);
                let again = SceneFile::parse(&file.to_json().unwrap()).unwrap();
                prop_assert_eq!(again, file);
            }
            Err(error) => prop_assert!(error.to_string().len() > 15),
        }
    }

    #[test]
    fn damaged_text_never_panics(
        edits in prop::collection::vec((0..1200usize, any::<u8>()), 0..8),
        end in 0..4000usize,
    ) {
        let mut text = full_scene().to_string().into_bytes();
        for (at, byte) in edits {
            let at = at % text.len();
            text[at] = byte;
        }
        text.truncate(end.max(1));
        let _ = SceneFile::parse(&String::from_utf8_lossy(&text));
    }

    #[test]
    fn any_text_never_panics(text in ".{0,64}") {
        let _ = SceneFile::parse(&text);
    }
}
