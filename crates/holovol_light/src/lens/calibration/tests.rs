//! Calibrations as files and imports give them.

use super::*;
use crate::lens::Projection;

#[test]
fn front_and_back_look_ahead_and_behind_with_up_up() {
    let camera = Calibration::nominal([1000, 1000], 190.0);
    let pixel = |lens: usize, direction: DVec3| {
        let lens = &camera.lenses[lens];
        lens.projection.project(to_lens(lens.rotation(), direction))
    };
    let middle = glam::DVec2::splat(500.0);
    assert!((pixel(0, DVec3::NEG_Z).unwrap() - middle).length() < 1e-6);
    assert!((pixel(1, DVec3::Z).unwrap() - middle).length() < 1e-6);
    assert!(pixel(0, DVec3::Z).is_none());
    // Up is up in both pictures; the right of the scene is right ahead and left behind.
    let (up, right) = (
        DVec3::new(0.0, 0.5, -1.0).normalize(),
        DVec3::new(0.5, 0.0, -1.0),
    );
    assert!(pixel(0, up).unwrap().y < 400.0);
    assert!(pixel(0, right.normalize()).unwrap().x > 600.0);
    let behind = DVec3::new(0.5, 0.5, 1.0).normalize();
    assert!(pixel(1, behind).unwrap().x < 400.0 && pixel(1, behind).unwrap().y < 400.0);
}

#[test]
fn files_round_trip_and_say_what_is_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("camera.json");
    let camera = Calibration::nominal([1440, 1440], 195.0);
    std::fs::write(&path, camera.to_json()).unwrap();
    assert_eq!(Calibration::load(&path).unwrap(), camera);
    let broken = camera.to_json().replacen("\"focal\"", "\"fokal\"", 1);
    std::fs::write(&path, broken).unwrap();
    let message = Calibration::load(&path).unwrap_err().to_string();
    assert!(
        message.contains("camera.json") && message.contains("fokal"),
        "{message}"
    );
    let half = camera.for_sizes([[720, 720]; 2]).unwrap();
    assert_eq!(
        half.lenses[0].projection.centre(),
        glam::DVec2::splat(360.0)
    );
    let message = camera.for_sizes([[720, 700]; 2]).unwrap_err().to_string();
    assert!(
        message.contains("[1440, 1440]") && message.contains("[720, 700]"),
        "{message}"
    );
}

#[test]
fn opencv_parameters_are_imported_at_its_pixel_centres() {
    let matrix = [[410.0, 0.0, 719.5], [0.0, 411.0, 720.5], [0.0, 0.0, 1.0]];
    let lens = (matrix, [0.01, -0.002, 0.0, 0.0]);
    let camera = Calibration::from_opencv_fisheye([lens, lens], [1440; 2], 190.0).unwrap();
    let found = &camera.lenses[0].projection;
    assert_eq!(found.centre(), glam::DVec2::new(720.0, 721.0));
    // OpenCV: θ_d = θ(1 + k₁θ² + k₂θ⁴), u = fx·θ_d + cx.
    let theta = 1.0_f64;
    let pixel = found
        .project(DVec3::new(theta.sin(), 0.0, theta.cos()))
        .unwrap();
    assert!((pixel.x - (410.0 * 1.008 + 720.0)).abs() < 1e-9, "{pixel}");
    let skewed = ([[410.0, 5.0, 0.0], matrix[1], matrix[2]], lens.1);
    assert!(Calibration::from_opencv_fisheye([skewed, lens], [1440; 2], 190.0).is_err());
}

#[test]
fn offset_strings_are_imported_or_refused() {
    let lens = "2_1100.0_1101.0_720_721_0_0_0_0_0_0_0.1_0.01_0_0.001_0.002_1440_1440_113";
    let camera = Calibration::from_insta360_offset(&format!("2_{lens}_{lens}")).unwrap();
    let LensModel::Mei { xi, focal, p, .. } = camera.lenses[1].projection else {
        panic!("the long form is Mei's model");
    };
    assert_eq!((xi, focal, p), (2.0, [1100.0, 1101.0], [0.001, 0.002]));
    let short = "2_700_720_720_0_0_0_700_2160_720_0_0_0_2880_1440_2";
    let camera = Calibration::from_insta360_offset(short).unwrap();
    assert_eq!(
        camera.lenses[1].projection.centre(),
        glam::DVec2::splat(720.0)
    );
    for wrong in ["", "2_1_2", "3_1", "2_a", &format!("2_{lens}")] {
        assert!(Calibration::from_insta360_offset(wrong).is_err(), "{wrong}");
    }
}

/// Cameras that can't be are refused by name of file and field.
#[test]
fn senseless_cameras_are_refused_by_file_and_field() {
    type Damage = fn(&mut Calibration);
    let cases: [(&str, &str, Damage); 9] = [
        ("lenses[1].projection.centre", "outside", |camera| {
            move_centre(camera, [720.0, -3.0]);
        }),
        // The numbers of a picture twice as large, and of one a thirtieth as large.
        ("lenses[1].projection.centre", "outside", |camera| {
            camera.lenses[1].projection = camera.lenses[1].projection.scaled(2.0);
        }),
        ("lenses[1].projection.focal", "larger picture", |camera| {
            camera.lenses[1].projection = camera.lenses[1].projection.scaled(2.0);
            move_centre(camera, [720.0, 720.0]);
        }),
        ("lenses[1].projection.focal", "smaller picture", |camera| {
            camera.lenses[1].projection = camera.lenses[1].projection.scaled(1.0 / 30.0);
        }),
        ("lenses[1].lens_from_camera", "look 0°", |camera| {
            camera.lenses[1].lens_from_camera = camera.lenses[0].lens_from_camera;
        }),
        ("lenses[1].gain", "1e-9", |camera| {
            camera.lenses[1].gain = 1e-9
        }),
        ("lenses[1].size", "40000", |camera| {
            camera.lenses[1].size = [40_000, 40_000];
        }),
        // Below 0 between the axis and the edge only.
        ("lenses[1].vignetting", "falloff", |camera| {
            camera.lenses[1].vignetting = [-50.0, 50.0, 0.0];
        }),
        ("response", "gamma", |camera| {
            camera.response = crate::response::Response::Gamma(0.0);
        }),
    ];
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("camera.json");
    for (field, word, damage) in cases {
        let mut camera = Calibration::nominal([1440, 1440], 195.0);
        damage(&mut camera);
        std::fs::write(&path, camera.to_json()).unwrap();
        let message = Calibration::load(&path).unwrap_err().to_string();
        for word in ["camera.json: ", field, word] {
            assert!(message.contains(word), "no {word:?} in {message:?}");
        }
    }
}

fn move_centre(camera: &mut Calibration, to: [f64; 2]) {
    if let LensModel::Equidistant { centre, .. } = &mut camera.lenses[1].projection {
        *centre = to;
    }
}

/// Both circles in one picture, or the picture cut at top and bottom, are ways cameras are.
#[test]
fn pictures_of_both_circles_and_cut_ones_are_accepted() {
    let mut both = Calibration::nominal([2880, 1440], 195.0);
    for (lens, x) in both.lenses.iter_mut().zip([720.0, 2160.0]) {
        if let LensModel::Equidistant { centre, .. } = &mut lens.projection {
            centre[0] = x;
        }
    }
    both.check().unwrap();
    // A circle as wide as the 16 : 9 picture's diagonal.
    let mut cut = Calibration::nominal([1920, 1080], 195.0);
    for lens in &mut cut.lenses {
        if let LensModel::Equidistant { focal, .. } = &mut lens.projection {
            *focal *= 1920.0_f64.hypot(1080.0) / 1080.0;
        }
    }
    cut.check().unwrap();
}

#[test]
fn light_outside_the_circle_is_counted() {
    let camera = Calibration::nominal([200, 200], 195.0);
    let disc = |centre: [f64; 2], radius: f64| -> Vec<[u8; 3]> {
        let lit = |i: usize| {
            let at = glam::DVec2::new((i % 200) as f64, (i / 200) as f64) + 0.5;
            at.distance(glam::DVec2::from_array(centre)) < radius
        };
        (0..200 * 200)
            .map(|i| if lit(i) { [90; 3] } else { [9; 3] })
            .collect()
    };
    assert_eq!(camera.lenses[0].lit_outside(&disc([100.0; 2], 100.0)), 0.0);
    let half = camera.for_sizes([[100, 100]; 2]).unwrap();
    let mut wrong = half.lenses[0].clone();
    wrong.size = [200, 200];
    let outside = wrong.lit_outside(&disc([100.0; 2], 100.0));
    assert!((0.7..0.95).contains(&outside), "{outside}");
    assert_eq!(wrong.lit_outside(&vec![[0; 3]; 200 * 200]), 0.0);
}

#[test]
fn hostile_imports_are_refused() {
    let matrix = [[410.0, 0.0, 719.5], [0.0, 411.0, 720.5], [0.0, 0.0, 1.0]];
    let opencv = |place: [usize; 2], value: f64| {
        let mut damaged = matrix;
        damaged[place[0]][place[1]] = value;
        let lenses = [(matrix, [0.0; 4]), (damaged, [0.0; 4])];
        let result = Calibration::from_opencv_fisheye(lenses, [1440; 2], 190.0);
        result.unwrap_err().to_string()
    };
    for value in [f64::NAN, f64::INFINITY, 1e300, -410.0] {
        assert!(opencv([0, 0], value).contains("lenses[1].projection.focal"));
        assert!(opencv([0, 2], value).contains("lenses[1].projection.centre"));
        assert!(opencv([0, 1], value).contains("skew"));
        assert!(opencv([2, 0], value).contains("row by row"));
    }
    let fov = Calibration::from_opencv_fisheye([(matrix, [0.0; 4]); 2], [1440; 2], f64::NAN);
    assert!(fov.unwrap_err().to_string().contains("fov_deg"));

    let fields = "2.0_1100.0_1101.0_720_721_0_0_0_0_0_0_0.1_0.01_0_0.001_0.002_1440_1440_113";
    let fields: Vec<&str> = fields.split('_').collect();
    for place in 0..fields.len() {
        for value in ["NaN", "inf", "1e300", "-1e300", "1e-300", "-1", "", "x"] {
            let mut damaged = fields.clone();
            damaged[place] = value;
            let text = format!("2_{}_{}", fields.join("_"), damaged.join("_"));
            match Calibration::from_insta360_offset(&text) {
                Ok(camera) => camera.check().unwrap(),
                Err(error) => {
                    let message = error.to_string();
                    assert!(message.starts_with("offset string: "), "{message}");
                }
            }
        }
    }
    let message = |text: &str| {
        Calibration::from_insta360_offset(text)
            .unwrap_err()
            .to_string()
    };
    assert!(message("").contains("field 1"));
    let negative = fields.join("_").replace("1100.0", "-1100.0");
    let text = format!("2_{}_{negative}", fields.join("_"));
    assert!(message(&text).contains("lenses[1].projection.focal"));
    assert!(message(&text.replace("_721_", "_NaN_")).contains("field 6"));
}
