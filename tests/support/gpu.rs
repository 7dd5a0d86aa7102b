//! One device for a whole test binary, pictures of many seeds, and what they must agree with.

use std::ops::ControlFlow;
use std::sync::OnceLock;

use holovol_reference::statistics::{BlockStatistics, agreement};
use holovol_reference::{Image, LightStrategy, Settings};
use holovol_render::{Counters, Gpu, TraceOptions, Tracer};
use holovol_scene::Scene;
use libtest_mimic::{Arguments, Failed, Trial};

/// More than all binaries make together: a run fails by chance once in a million.
const COMPARISONS: f64 = 400.0;
const P_MIN: f64 = 1e-6 / COMPARISONS;
/// As many standard deviations of a mean over 256 independent pixels have a chance below `P_MIN`.
pub const SIGMAS: f64 = 6.5;
/// Pictures of different seeds from which block variances are estimated.
pub const SEEDS: u64 = 16;

static GPU: OnceLock<Gpu> = OnceLock::new();
static FIRST_SEED: OnceLock<u64> = OnceLock::new();

pub type Test = (&'static str, fn());

/// Runs tests one after the other (the device, or the reference, takes all cores): ignored
/// without an adapter, or failed if `HOLOVOL_REQUIRE_GPU=1`.
pub fn run(tests: Vec<Test>) {
    let mut args = Arguments::from_args();
    args.test_threads = Some(1);
    let is_listing = args.list;
    let problem = if is_listing {
        None
    } else {
        match Gpu::new(None) {
            Ok(gpu) => {
                eprintln!("adapter: {}, {}", gpu.adapter_name(), gpu.driver());
                GPU.set(gpu).expect("set once");
                None
            }
            Err(error) => Some(error.to_string()),
        }
    };
    let is_required = std::env::var_os("HOLOVOL_REQUIRE_GPU").is_some_and(|value| value == "1");
    if is_nightly() && !is_listing {
        eprintln!("HOLOVOL_SEED={}", first_seed());
    }
    let trials = tests.into_iter().map(|(name, body)| {
        let problem = problem.clone();
        let is_ignored = problem.is_some() && !is_required;
        Trial::test(name, move || match problem {
            Some(problem) => Err(Failed::from(problem)),
            None => {
                body();
                Ok(())
            }
        })
        .with_ignored_flag(is_ignored)
    });
    libtest_mimic::run(&args, trials.collect()).exit();
}

pub fn gpu() -> &'static Gpu {
    GPU.get().expect("tests without a device are ignored")
}

fn is_nightly() -> bool {
    std::env::var_os("HOLOVOL_NIGHTLY").is_some_and(|value| value == "1")
}

/// Samples per pixel: more at night.
pub fn effort(spp: u32) -> u32 {
    if is_nightly() { 8 * spp } else { spp }
}

/// Fixed, or `HOLOVOL_SEED`, or at night a random one.
pub fn first_seed() -> u64 {
    *FIRST_SEED.get_or_init(|| {
        let given = std::env::var("HOLOVOL_SEED")
            .ok()
            .and_then(|s| s.parse().ok());
        let random = || {
            let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
            now.map_or(1, |now| now.as_nanos() as u64 >> 10)
        };
        given.unwrap_or_else(|| if is_nightly() { random() } else { 2024 })
    })
}

pub fn options() -> TraceOptions {
    TraceOptions {
        seed: first_seed(),
        ..Default::default()
    }
}

#[track_caller]
pub fn tracer(scene: &Scene, options: &TraceOptions) -> Tracer {
    Tracer::new(gpu(), scene, options).expect("a scene that can be traced")
}

/// Fails if the kernel met more extinction than it expected, or left a sample out.
#[track_caller]
pub fn assert_clean(what: &str, counters: &Counters) {
    let bad = [counters.majorant_violations, counters.nonfinite_samples];
    assert_eq!(bad, [0, 0], "{what}: {counters:?}");
}

#[track_caller]
pub fn image(tracer: &Tracer) -> Image {
    let [width, height] = tracer.image_size();
    Image::new(width, height, tracer.read_image().expect("an image"))
}

/// One picture of a scene.
#[track_caller]
pub fn picture(scene: &Scene, options: &TraceOptions, spp: u32) -> Image {
    let mut tracer = tracer(scene, options);
    tracer.accumulate(spp).expect("samples");
    assert_clean("picture", &tracer.counters());
    image(&tracer)
}

/// Pictures of [`SEEDS`] seeds.
#[track_caller]
pub fn pictures(what: &str, scene: &Scene, options: &TraceOptions, spp: u32) -> Vec<Image> {
    let mut tracer = tracer(scene, options);
    let seed = options.seed;
    (0..SEEDS)
        .map(|i| {
            tracer.restart(seed.wrapping_add(i));
            tracer.accumulate(spp).expect("samples");
            assert_clean(what, &tracer.counters());
            image(&tracer)
        })
        .collect()
}

#[track_caller]
pub fn statistics(what: &str, scene: &Scene, options: &TraceOptions, spp: u32) -> BlockStatistics {
    let images = pictures(what, scene, options, spp);
    BlockStatistics::from_seeds(&images, spp.into()).expect("equal sizes")
}

/// Fails if two pictures differ by more than chance.
#[track_caller]
pub fn assert_agree(what: &str, a: &BlockStatistics, b: &BlockStatistics) {
    let agreement = agreement(a, b).expect("equal sizes");
    eprintln!("{what}: {agreement}");
    assert!(agreement.blocks > 0, "{what}: nothing could be compared");
    assert!(agreement.holds(P_MIN), "{what}: {agreement}");
}

/// The same scene by the f64 reference.
pub fn reference(scene: &Scene, spp: u32) -> BlockStatistics {
    let settings = Settings {
        spp,
        seed: first_seed() ^ 0x5eed,
        light_strategy: LightStrategy::Both,
    };
    let film = holovol_reference::render(scene, &settings, &mut |_| ControlFlow::Continue(()));
    BlockStatistics::from_film(&film.expect("a scene that can be traced"))
}

/// Mean over pixels that all estimate the same, and its standard deviation; R, G, B, opacity.
pub fn mean_and_deviation(image: &Image) -> [(f64, f64); 4] {
    let n = image.pixels().len() as f64;
    std::array::from_fn(|c| {
        let values = || image.pixels().iter().map(|pixel| f64::from(pixel[c]));
        let mean = values().sum::<f64>() / n;
        let squares: f64 = values().map(|v| (v - mean).powi(2)).sum();
        (mean, (squares / (n * (n - 1.0))).sqrt())
    })
}

/// Fails if a channel's mean differs from `expected` by more than chance and f32's rounding
/// (`relative`), or is too noisy for a fault of 4 % to be seen.
#[track_caller]
pub fn assert_mean(what: &str, image: &Image, channel: usize, expected: f64, relative: f64) {
    let (mean, deviation) = mean_and_deviation(image)[channel];
    let allowed = SIGMAS * deviation + relative * expected.abs();
    eprintln!("{what}: {mean:.6e} ± {deviation:.1e}, expected {expected:.6e}");
    assert!(
        (mean - expected).abs() <= allowed,
        "{what}: channel {channel} is {mean} ± {deviation}, expected {expected}"
    );
    assert!(
        allowed <= 0.04 * expected.abs() + 1e-30,
        "{what}: too noisy to tell, {mean} ± {deviation}"
    );
}
