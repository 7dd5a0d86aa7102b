//! Animated and stereo scenes: what each frame is.

use glam::DVec3;
use holovol_light::EnvironmentMap;
use holovol_scene::{SceneError, SceneFile, Sequence};
use holovol_volume::{Geometry, Volume, Voxels};
use serde_json::{Value, json};

fn sequence(extra: Value) -> Sequence {
    let mut scene = json!({
        "version": 1,
        "volume": { "path": "v" },
        "transfer_function": { "points": [{ "s": 0, "sigma_t": 1, "albedo": [1, 1, 1] }] },
        "environment": { "constant": [1, 1, 1], "rotation_y_deg": 30 },
        "camera": { "eye": [0, 0, 2], "target": [0, 0, 0], "fov_y_deg": 30,
                    "width": 8, "height": 8 }
    });
    for (key, value) in extra.as_object().unwrap() {
        scene[key] = value.clone();
    }
    let file = SceneFile::parse(&scene.to_string()).unwrap();
    let geometry = Geometry::from_spacing([0.01, 0.02, 0.03]);
    let volume = Volume::new(Voxels::U8((0..8).collect()), [2; 3], 1.0, 0.0, geometry).unwrap();
    Sequence::with_data(&file, volume, EnvironmentMap::constant([1.0; 3])).unwrap()
}

#[track_caller]
fn near(a: DVec3, b: DVec3) {
    assert!((a - b).length() < 1e-12, "{a} is not {b}");
}

#[test]
fn motion_is_linear_and_exact_at_both_ends() {
    let sequence = sequence(json!({ "animation": { "frames": 5, "eye_to": [0.4, 0.1, 1],
        "target_to": [0, 0.2, 0], "environment_rotation_to_deg": 110 } }));
    assert_eq!(sequence.frames(), 5);
    for (frame, t) in [(0, 0.0), (1, 0.25), (4, 1.0), (9, 1.0)] {
        let scene = sequence.frame(frame).unwrap();
        near(scene.camera.eye, DVec3::new(0.4 * t, 0.1 * t, 2.0 - t));
        near(scene.camera.target, DVec3::new(0.0, 0.2 * t, 0.0));
        let degrees = scene.environment.rotation_y.to_degrees();
        assert!((degrees - (30.0 + 80.0 * t)).abs() < 1e-9, "{degrees}");
    }
    assert_eq!(
        sequence.frame(4).unwrap().camera.eye,
        DVec3::new(0.4, 0.1, 1.0)
    );
}

#[test]
fn the_volume_turns_about_its_own_centre() {
    let matrix = json!([[0.2, 0, 0, 1], [0, 0.2, 0, 2], [0, 0, 0.2, 3], [0, 0, 0, 1]]);
    let sequence = sequence(json!({
        "volume": { "path": "v", "world_from_unit_cube": matrix },
        "animation": { "frames": 3, "volume_rotation_y_to_deg": 180 } }));
    let centre = DVec3::new(1.1, 2.1, 3.1);
    for frame in 0..3 {
        let placed = sequence.frame(frame).unwrap().world_from_unit_cube;
        near(placed.transform_point3(DVec3::splat(0.5)), centre);
    }
    // Counter-clockwise seen from above: +x goes to −z after a quarter turn.
    let quarter = sequence.frame(1).unwrap().world_from_unit_cube;
    near(
        quarter.transform_vector3(DVec3::X),
        DVec3::new(0.0, 0.0, -0.2),
    );
    let half = sequence.frame(2).unwrap().world_from_unit_cube;
    near(half.transform_vector3(DVec3::X), DVec3::new(-0.2, 0.0, 0.0));
}

#[test]
fn a_switch_holds_from_its_frame_on() {
    let sequence = sequence(json!({ "animation": { "frames": 4, "switch": { "frame": 2,
        "transfer_function": { "points": [{ "s": 0, "sigma_t": 9, "albedo": [0, 0, 0] }] } } } }));
    let sigma_t = |frame| {
        let scene = sequence.frame(frame).unwrap();
        scene.transfer_function.eval(0.5).sigma_t
    };
    assert_eq!([0, 1, 2, 3].map(sigma_t), [1.0, 1.0, 9.0, 9.0]);
}

#[test]
fn another_number_of_frames_covers_the_same_motion() {
    let sequence = sequence(json!({ "animation": { "frames": 5, "eye_to": [1, 0, 2] } }));
    let three = sequence.clone().with_frames(3).unwrap();
    let eye = |sequence: &Sequence, frame| sequence.frame(frame).unwrap().camera.eye;
    near(eye(&three, 1), eye(&sequence, 2));
    near(eye(&three, 2), eye(&sequence, 4));
    assert_eq!(
        eye(&sequence.clone().with_frames(1).unwrap(), 0),
        eye(&sequence, 0)
    );
    assert!(sequence.with_frames(0).is_err());
}

#[test]
fn a_camera_that_passes_its_target_is_told_with_its_frame() {
    let sequence = sequence(json!({ "animation": { "frames": 3, "eye_to": [0, 0, -2] } }));
    assert!(sequence.frame(0).is_ok());
    let error = sequence.frame(1).unwrap_err();
    assert!(matches!(error, SceneError::Field { .. }));
    assert!(error.to_string().contains("frame 1"), "{error}");
    assert!(sequence.frame(2).is_ok());
}

#[test]
fn eyes_stand_apart_along_the_cameras_right() {
    let sequence = sequence(json!({ "stereo": { "ipd": 0.06 } }));
    let [left, right] = sequence
        .frame(0)
        .unwrap()
        .camera
        .stereo(sequence.ipd().unwrap());
    near(left.eye, DVec3::new(-0.03, 0.0, 2.0));
    near(right.eye, DVec3::new(0.03, 0.0, 2.0));
    assert_eq!(left.axes(), right.axes());
}

#[test]
fn what_a_scene_leaves_out_comes_from_the_volume() {
    let scene = sequence(json!({})).frame(0).unwrap();
    assert_eq!(scene.window, [0.0, 7.0]);
    near(
        scene.world_from_unit_cube.transform_vector3(DVec3::ONE),
        DVec3::new(0.02, 0.04, 0.06),
    );
    near(
        scene
            .world_from_unit_cube
            .transform_point3(DVec3::splat(0.5)),
        DVec3::ZERO,
    );
}

#[test]
fn a_constant_volume_gets_a_window_that_is_not_empty() {
    let scene = json!({
        "version": 1, "volume": { "path": "v" },
        "transfer_function": { "points": [{ "s": 0, "sigma_t": 1, "albedo": [1, 1, 1] }] },
        "environment": { "constant": [1, 1, 1] },
        "camera": { "eye": [0, 0, 2], "target": [0, 0, 0], "fov_y_deg": 30, "width": 8, "height": 8 }
    });
    let file = SceneFile::parse(&scene.to_string()).unwrap();
    for value in [0.0f32, -3e38, 1e-30, 5.0] {
        let geometry = Geometry::from_spacing([0.01; 3]);
        let volume = Volume::new(Voxels::F32(vec![value; 8]), [2; 3], 1.0, 0.0, geometry).unwrap();
        let light = EnvironmentMap::constant([1.0; 3]);
        let sequence = Sequence::with_data(&file, volume, light).unwrap();
        let scene = sequence.frame(0).unwrap();
        assert!(scene.window[0] < scene.window[1]);
        assert_eq!(scene.s_from_value(f64::from(value)), 0.0);
        assert!(sequence.notices()[0].contains("all values are"));
    }
}
