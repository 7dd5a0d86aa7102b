//! The `holovol` command on a graphics adapter.

mod support;

use holovol_reference::Image;
use libtest_mimic::{Arguments, Failed, Trial};
use support::{Bench, exists};

fn main() {
    let args = Arguments::from_args();
    let is_required = std::env::var_os("HOLOVOL_REQUIRE_GPU").is_some_and(|value| value == "1");
    let missing = holovol_render::Gpu::new(None).err();
    let test = |name: &str, body: fn()| {
        let problem = missing.as_ref().map(ToString::to_string);
        let is_ignored = problem.is_some() && !is_required;
        Trial::test(name, move || match problem {
            Some(problem) => Err(Failed::from(problem)),
            None => {
                body();
                Ok(())
            }
        })
        .with_ignored_flag(is_ignored)
    };
    let trials = vec![
        test(
            "render_names_the_adapter_and_repeats",
            render_names_the_adapter_and_repeats,
        ),
        test("backends_agree", backends_agree),
        test(
            "hardware_interpolation_differs_from_exact_and_says_so",
            hardware_interpolation_differs_from_exact_and_says_so,
        ),
        test("denoise_lowers_the_error", denoise_lowers_the_error),
        test("benchmarks_measure", benchmarks_measure),
        test("demo_makes_a_picture", demo_makes_a_picture),
        test(
            "every_kind_of_file_is_told_and_rendered",
            every_kind_of_file_is_told_and_rendered,
        ),
    ];
    libtest_mimic::run(&args, trials).exit();
}

fn render_names_the_adapter_and_repeats() {
    let bench = Bench::new();
    let args = [
        "render",
        "scene.json",
        "--out",
        "a.exr",
        "--spp",
        "4",
        "--seed",
        "9",
    ];
    let line = bench.json(&args);
    assert_eq!((&line["backend"], &line["spp"]), (&"gpu".into(), &4.into()));
    let adapter = line["adapter"].as_str().unwrap();
    let a = Image::read_exr(&bench.path("a.exr")).unwrap();
    // The same adapter by a part of its name, any case.
    let part = adapter.split_whitespace().next().unwrap().to_uppercase();
    bench.json(&[
        "render",
        "scene.json",
        "--out",
        "b.exr",
        "--spp",
        "4",
        "--seed",
        "9",
        "--adapter",
        &part,
    ]);
    assert_eq!(a, Image::read_exr(&bench.path("b.exr")).unwrap());
    bench.json(&[
        "render",
        "scene.json",
        "--out",
        "b.exr",
        "--spp",
        "4",
        "--seed",
        "10",
    ]);
    assert_ne!(a, Image::read_exr(&bench.path("b.exr")).unwrap());
}

fn backends_agree() {
    let bench = Bench::new();
    let mean = |backend: &str| {
        let args = [
            "render",
            "scene.json",
            "--out",
            "o.exr",
            "--spp",
            "512",
            "--backend",
            backend,
        ];
        let line = bench.json(&args);
        let rgb = line["mean_rgb"].as_array().unwrap().clone();
        let rgb = rgb.iter().map(|c| c.as_f64().unwrap());
        rgb.chain(line["mean_opacity"].as_f64()).collect::<Vec<_>>()
    };
    // 196,608 samples each of a standard deviation below 0.5: 6 deviations are below 0.01.
    for (gpu, reference) in mean("gpu").into_iter().zip(mean("reference")) {
        assert!((gpu - reference).abs() < 0.01, "{gpu} and {reference}");
        assert!(reference > 0.03, "{reference}");
    }
}

fn hardware_interpolation_differs_from_exact_and_says_so() {
    let bench = Bench::new();
    let render = |interpolation: &str| {
        let line = bench.json(&[
            "render",
            "scene.json",
            "--out",
            "o.exr",
            "--spp",
            "32",
            "--interpolation",
            interpolation,
        ]);
        assert_eq!(line["interpolation"], interpolation);
        Image::read_exr(&bench.path("o.exr")).unwrap()
    };
    // Texture units weigh with 8 bits: some of 12,288 paths collide elsewhere.
    assert_ne!(render("exact"), render("hardware"));
}

fn denoise_lowers_the_error() {
    let bench = Bench::new();
    bench.json(&["render", "scene.json", "--out", "r.exr", "--spp", "1024"]);
    let reference = Image::read_exr(&bench.path("r.exr")).unwrap();
    let error = |mode: &str| {
        let line = bench.json(&[
            "render",
            "scene.json",
            "--out",
            "d.exr",
            "--denoise",
            mode,
            "--frames",
            "8",
            "--spp-per-frame",
            "2",
            "--all-frames",
        ]);
        assert_eq!(
            (&line["denoise"], &line["frames"]),
            (&mode.into(), &8.into())
        );
        assert!(line["seconds_per_frame"]["trace"].as_f64().unwrap() >= 0.0);
        let last = Image::read_exr(&bench.path("d.0007.exr")).unwrap();
        holovol_reference::measures::relmse(&last, &reference).unwrap()
    };
    let [off, paper, holovol] = ["off", "paper", "holovol"].map(error);
    assert!(
        holovol < 0.5 * off && holovol < paper && holovol > 0.0,
        "holovol {holovol}, paper {paper}, off {off}"
    );
}

/// Little of everything; what errors must do on any machine.
fn benchmarks_measure() {
    let bench = Bench::new();
    // Half a metre away and as far across: both eyes see it.
    let mut scene = support::scene();
    let (side, half) = (0.3, -0.15);
    scene["volume"]["world_from_unit_cube"] = serde_json::json!([
        [side, 0, 0, half],
        [0, side, 0, half],
        [0, 0, side, half],
        [0, 0, 0, 1]
    ]);
    scene["camera"]["eye"] = serde_json::json!([0, 0, 0.5]);
    scene["camera"]["fov_y_deg"] = 40.into();
    scene["transfer_function"]["points"][1]["sigma_t"] = 40.into();
    bench.write_scene("scene.json", &scene);
    let measured = |args: &[&str]| {
        let args = [&["bench"], args, &["--report", "report.md"]].concat();
        let line = bench.json(&args);
        let report = std::fs::read_to_string(bench.path("report.md")).unwrap();
        assert!(report.contains("| scene |"), "{args:?}: {report}");
        line["scenes"][0].clone()
    };
    let is_positive = |value: &serde_json::Value| value.as_f64().is_some_and(|value| value > 0.0);

    let scene = measured(&["trace", "scene.json", "--rounds", "2", "--no-sizes"]);
    assert!(is_positive(&scene["lookups_per_covered_sample"]), "{scene}");
    let variants = scene["variants"].as_array().unwrap();
    assert!(
        variants.len() > 3 && variants.iter().all(|v| is_positive(&v["default_gain"])),
        "{scene}"
    );

    let few = ["scene.json", "--size", "24", "--reference-spp", "64"];
    let scene = measured(&[&["denoise", "--case", "rest"], &few[..]].concat());
    let case = &scene["cases"][0];
    let error = |frames: u32| {
        let of = |outcome: &&serde_json::Value| {
            outcome["mode"] == "holovol" && outcome["frames"] == frames
        };
        let outcome = case["results"].as_array().unwrap().iter().find(of).unwrap();
        outcome["relmse"].as_f64().unwrap()
    };
    assert!(
        error(8) < error(1) && error(1) < case["noisy_relmse"].as_f64().unwrap(),
        "{case}"
    );

    let rounds = ["--rounds", "4", "--frames", "3", "--rest"];
    let scene = measured(&[&["stereo"], &few[..], &rounds[..]].concat());
    let errors = |eyes: &str| -> Vec<f64> {
        let runs = scene[eyes].as_array().unwrap();
        runs.iter()
            .map(|run| run["error"].as_f64().unwrap())
            .collect()
    };
    let [one, two] = ["one_eye", "two_eyes"].map(errors);
    assert!(
        (one.len(), two.len()) == (4, 3) && one[3] < one[0] && two[2] < two[0] && two[0] < one[0],
        "{scene}"
    );
    assert!(
        is_positive(&scene["as_good_as_two"]) && is_positive(&scene["as_good_as_one"]),
        "{scene}"
    );
}

fn demo_makes_a_picture() {
    let bench = Bench::new();
    let text = bench.output(&["demo", "--out", "d.png", "--size", "64", "--spp", "2"]);
    assert!(text.contains("d.png"), "{text}");
    assert!(exists(&bench.path("d.png")));
}

/// The phantoms of the volume crate, written by other libraries: 5 × 4 × 3 voxels of
/// 0.7 × 1.9 × 3.1 mm, or µm, or m.
const KINDS: [(&str, Option<&str>, f64); 21] = [
    ("itk.nii", None, 1e-3),
    ("itk.hdr", None, 1e-3),
    ("itk.nrrd", None, 1e-3),
    ("numbered.nhdr", None, 1e-3),
    ("itk.mhd", None, 1e-3),
    ("itk.mha", None, 1e-3),
    ("list.mhd", None, 1e-3),
    ("dicom_explicit", None, 1e-3),
    ("dicom_deflated", None, 1e-3),
    ("dicom_tilted", None, 1e-3),
    ("dicom_jpeg", None, 1e-3),
    ("dicom_jpegls", None, 1e-3),
    ("dicom_jpeg2000", None, 1e-3),
    ("dicom_enhanced.dcm", None, 1e-3),
    ("dicom_zip.zip", None, 1e-3),
    ("half.vdb", None, 1.0),
    ("several.vdb", Some("marked"), 1.0),
    ("ome.ome.tif", None, 1e-6),
    ("channels.ome.tif", Some("marked"), 1e-6),
    ("imagej.tif", None, 1e-6),
    ("sidecar.raw", None, 1e-3),
];

fn every_kind_of_file_is_told_and_rendered() {
    let bench = Bench::new();
    let phantoms = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../holovol_volume/tests/phantoms/formats")
        .canonicalize()
        .unwrap();
    for (name, choice, metres) in KINDS {
        let path = phantoms.join(name);
        let path = path.to_str().unwrap();
        let mut info = vec!["info", path];
        info.extend(choice.iter().flat_map(|choice| ["--choice", choice]));
        let told = bench.output(&info);
        assert!(told.contains("5 × 4 × 3"), "{name}: {told}");

        let mut scene = support::scene();
        scene["volume"] = serde_json::json!({ "path": path, "window": [0, 200] });
        if let Some(choice) = choice {
            scene["volume"]["choice"] = choice.into();
        }
        // About 12 units across, an optical depth of a few.
        scene["transfer_function"]["points"][0]["sigma_t"] = (0.2 / metres).into();
        scene["transfer_function"]["points"][1]["sigma_t"] = (2.0 / metres).into();
        scene["camera"]["eye"] = serde_json::json!([0.0, 0.0, 40.0 * metres]);
        scene["camera"]["width"] = 32.into();
        scene["camera"]["height"] = 32.into();
        bench.write_scene("kind.json", &scene);
        let line = bench.json(&["render", "kind.json", "--out", "kind.exr", "--spp", "4"]);
        let opacity = line["mean_opacity"].as_f64().unwrap();
        assert!((0.02..0.9).contains(&opacity), "{name}: {opacity}");
        assert!(line["mean_rgb"][0].as_f64().unwrap() > 0.01, "{name}");
    }
}
