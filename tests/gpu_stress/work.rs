//! Seeds, budgets, dispatches and sums at their limits.

use holovol_reference::Image;
use holovol_render::TraceOptions;

use crate::fields::*;
use crate::gpu::{
    Test, assert_clean, assert_mean, image, mean_and_deviation, options, picture, tracer,
};

pub fn tests() -> Vec<Test> {
    vec![
        (
            "same_seed_gives_the_same_bits",
            same_seed_gives_the_same_bits,
        ),
        ("seeds_at_their_limits_differ", seeds_at_their_limits_differ),
        (
            "small_budgets_give_the_same_bits",
            small_budgets_give_the_same_bits,
        ),
        ("full_queues_lose_no_path", full_queues_lose_no_path),
        (
            "a_million_samples_do_not_stall",
            a_million_samples_do_not_stall,
        ),
        (
            "no_samples_are_an_empty_image",
            no_samples_are_an_empty_image,
        ),
        (
            "guides_and_statistics_change_no_bit",
            guides_and_statistics_change_no_bit,
        ),
        (
            "images_of_any_shape_are_whole",
            images_of_any_shape_are_whole,
        ),
    ]
}

fn busy_scene() -> holovol_scene::Scene {
    let mut scene = blob_scene();
    scene.gradient_factor = 1.0;
    scene.phase_g = 0.5;
    scene.integrator.max_scatters = None;
    scene
}

fn same_seed_gives_the_same_bits() {
    let scene = busy_scene();
    let whole = picture(&scene, &options(), 12);
    assert_eq!(whole, picture(&scene, &options(), 12));
    // In parts, and after a restart.
    let mut tracer = tracer(&scene, &options());
    for more in [1, 4, 7] {
        tracer.accumulate(more).expect("samples");
    }
    assert_eq!(tracer.samples_per_pixel(), 12);
    assert_eq!(whole, image(&tracer));
    tracer.restart(options().seed + 1);
    tracer.accumulate(12).expect("samples");
    assert_ne!(whole, image(&tracer));
    tracer.restart(options().seed);
    tracer.accumulate(12).expect("samples");
    assert_eq!(whole, image(&tracer));
    let without = TraceOptions {
        subgroups: false,
        ..options()
    };
    assert_eq!(whole, picture(&scene, &without, 12));
}

fn seeds_at_their_limits_differ() {
    let scene = busy_scene();
    let seeds = [
        0,
        1,
        u64::MAX,
        u64::MAX - 1,
        1 << 32,
        1 << 63,
        u64::from(u32::MAX),
    ];
    let mut tracer = tracer(&scene, &options());
    let mut seen = Vec::new();
    for seed in seeds {
        tracer.restart(seed);
        tracer.accumulate(2).expect("samples");
        assert_clean("seed", &tracer.counters());
        let image = image(&tracer);
        assert!(!seen.contains(&image), "seed {seed:#x} repeats another");
        seen.push(image);
    }
}

fn small_budgets_give_the_same_bits() {
    let scene = busy_scene();
    let expected = picture(&scene, &options(), 6);
    for budget in [1, 7, 64] {
        let options = TraceOptions {
            budget,
            ..options()
        };
        let mut tracer = tracer(&scene, &options);
        tracer.accumulate(6).expect("samples");
        assert_clean("budget", &tracer.counters());
        assert!(tracer.counters().continued_paths > 0, "budget {budget}");
        assert_eq!(expected, image(&tracer), "budget {budget}");
    }
}

/// More paths at once than can be saved: the rest go on where they are.
fn full_queues_lose_no_path() {
    let mut scene = busy_scene();
    (scene.camera.width, scene.camera.height) = (320, 320);
    let expected = picture(&scene, &options(), 1);
    let small = TraceOptions {
        budget: 4,
        ..options()
    };
    let mut tracer = tracer(&scene, &small);
    tracer.accumulate(1).expect("samples");
    assert_eq!(expected, image(&tracer));
}

fn a_million_samples_do_not_stall() {
    let mut scene = homogeneous(1.0, 0.0);
    // Addends that are no binary fraction: a single f32 sum would round each of them.
    let mut glowing = point(0.0, 1.0, 0.0);
    glowing.emission = [0.3; 3];
    scene.transfer_function = transfer_function(vec![glowing]);
    (scene.camera.width, scene.camera.height) = (4, 4);
    let mut tracer = tracer(&scene, &options());
    tracer.accumulate(1_000_000).expect("samples");
    assert_clean("a million samples", &tracer.counters());
    let image = image(&tracer);
    assert_mean("a million samples", &image, 3, -f64::exp_m1(-1.0), 2e-5);
    assert_mean(
        "a million glowing samples",
        &image,
        0,
        -0.3 * f64::exp_m1(-1.0),
        2e-4,
    );
    for [.., opacity] in image.pixels() {
        let off = f64::from(*opacity) + f64::exp_m1(-1.0);
        assert!(off.abs() < 1e-4, "one pixel's opacity is off by {off:e}");
    }
}

fn no_samples_are_an_empty_image() {
    let mut tracer = tracer(&blob_scene(), &options());
    tracer.accumulate(0).expect("no samples");
    assert_eq!(tracer.samples_per_pixel(), 0);
    let is_empty = |image: &Image| image.pixels().iter().all(|pixel| *pixel == [0.0; 4]);
    assert!(is_empty(&image(&tracer)));
    tracer.accumulate(3).expect("samples");
    assert!(!is_empty(&image(&tracer)));
    tracer.restart(options().seed);
    assert!(is_empty(&image(&tracer)));
    assert_eq!(tracer.samples_per_pixel(), 0);
}

fn guides_and_statistics_change_no_bit() {
    let scene = busy_scene();
    let with = TraceOptions {
        guides: true,
        statistics: true,
        ..options()
    };
    let mut tracer = tracer(&scene, &with);
    tracer.accumulate(8).expect("samples");
    assert_eq!(picture(&scene, &options(), 8), image(&tracer));
    let counters = tracer.counters();
    let samples = 8 * u64::from(scene.camera.width * scene.camera.height);
    assert!(counters.lookups > 0, "{counters:?}");
    assert!(
        (1..samples).contains(&counters.covered_samples),
        "{counters:?}"
    );
    // Guides weigh by opacity: theirs is that of the image.
    let guides = tracer.read_guides().expect("guides");
    for (guide, pixel) in guides.iter().zip(image(&tracer).pixels()) {
        assert!(
            (guide.opacity - pixel[3]).abs() < 1e-4,
            "{guide:?}, {pixel:?}"
        );
    }
}

/// Every pixel of wide, tall and odd images has its samples, none twice.
fn images_of_any_shape_are_whole() {
    let shapes = [(1, 1), (1, 300), (300, 1), (65, 7), (9, 17), (4099, 3)];
    for (width, height) in shapes {
        assert_whole(width, height, &options(), 3);
    }
    // More than 128 MiB of sums, and of guides: all that some devices bind at once.
    assert_whole(2500, 1700, &options(), 1);
    let with_guides = TraceOptions {
        guides: true,
        ..options()
    };
    assert_whole(1700, 1700, &with_guides, 1);
}

fn assert_whole(width: u32, height: u32, options: &TraceOptions, samples: u32) {
    let mut scene = homogeneous(1e4, 0.5);
    scene.environment = uniform_light(0.0);
    (scene.camera.width, scene.camera.height) = (width, height);
    scene.camera.fov_y = 1e-6;
    let mut tracer = tracer(&scene, options);
    tracer.accumulate(samples).expect("samples");
    let image = image(&tracer);
    // A sample more or less is a third at least; roulette gives seldom ones up to 0.2 more.
    let is_whole = |opacity: f32| (opacity - 1.0).abs() < 0.25;
    let missing = image
        .pixels()
        .iter()
        .filter(|pixel| !is_whole(pixel[3]))
        .count();
    assert_eq!(
        missing,
        0,
        "{width} × {height}: {:?}",
        mean_and_deviation(&image)[3]
    );
    let guides = tracer.read_guides().expect("guides");
    let seen = guides.iter().all(|guide| is_whole(guide.opacity));
    assert!(seen, "{width} × {height}: guides");
}
