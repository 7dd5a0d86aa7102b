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
        test("demo_makes_a_picture", demo_makes_a_picture),
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

fn demo_makes_a_picture() {
    let bench = Bench::new();
    let text = bench.output(&["demo", "--out", "d.png", "--size", "64", "--spp", "2"]);
    assert!(text.contains("d.png"), "{text}");
    assert!(exists(&bench.path("d.png")));
}
