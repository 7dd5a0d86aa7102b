//! `holovol bench trace`: the tracer against variants of itself, taking turns in one run.
//!
//! A machine's speed varies from minute to minute, so every round runs every variant and only
//! ratios within a round are compared. Errors are those of the unbiased estimator: the variance
//! over the rounds' seeds, so that no reference image is needed.

use std::time::Instant;

use holovol_render::{Gpu, Interpolation, TraceOptions, Tracer};
use holovol_scene::{Scene, Sequence};
use holovol_volume::{Volume, Voxels};
use rayon::prelude::*;
use serde::Serialize;

use super::{median, report};
use crate::cli::BenchTraceArgs;
use crate::progress::Bar;
use crate::{Exit, Failure, output, print_json};

/// Sides of the volumes that cost is measured over.
const SIDES: [u32; 4] = [64, 128, 256, 512];
/// Invocations and lookups of each in the bare random-fetch kernel.
const FETCH_LANES: u32 = 65536;
const FETCH_LOOKUPS: u32 = 64;

/// All that was measured.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    pub(super) adapter: String,
    pub(super) driver: String,
    pub(super) rounds: u32,
    pub(super) spp: u32,
    pub(super) scenes: Vec<SceneReport>,
    pub(super) sizes: Vec<SizeReport>,
}

/// One scene.
#[derive(Debug, Serialize)]
pub(super) struct SceneReport {
    pub(super) scene: String,
    pub(super) texture_format: String,
    /// Per sample that meets the volume.
    pub(super) lookups_per_covered_sample: f64,
    pub(super) cells_per_covered_sample: f64,
    /// Of the tracer, and of a kernel that does nothing else.
    pub(super) lookups_per_second: f64,
    pub(super) bare_lookups_per_second: f64,
    pub(super) lookup_rate_ratio: f64,
    pub(super) variants: Vec<VariantReport>,
}

/// One way to trace a scene; ratios are to the default.
#[derive(Debug, Serialize)]
pub(super) struct VariantReport {
    pub(super) name: &'static str,
    pub(super) samples_per_second: f64,
    /// relMSE of one sample per pixel.
    pub(super) relmse_times_spp: f64,
    pub(super) seconds_ratio: f64,
    /// How many times as efficient the default is.
    pub(super) default_gain: f64,
    /// Difference of the mean images, as relMSE: bias, or what chance leaves.
    pub(super) relmse_to_default: f64,
}

/// One size of the same field.
#[derive(Debug, Serialize)]
pub(super) struct SizeReport {
    pub(super) side: u32,
    pub(super) samples_per_second: f64,
    /// Seconds per sample, by those of half the side.
    pub(super) cost_growth: f64,
}

struct Variant {
    name: &'static str,
    options: TraceOptions,
    seconds: Vec<f64>,
    images: Vec<Vec<[f32; 4]>>,
}

pub(crate) fn run(args: &BenchTraceArgs) -> Result<(), Failure> {
    if let Some(path) = &args.report {
        output::check(path, "md", "--report")?;
    }
    let gpu = Gpu::new(args.adapter.as_deref())?;
    let bar = Bar::new("measuring");
    let mut scenes = Vec::new();
    let mut first = None;
    for (index, path) in args.scenes.iter().enumerate() {
        let done = |scenes: usize| scenes as f64 / (args.scenes.len() + 1) as f64;
        bar.set(done(index), &path.display().to_string());
        let scene = Sequence::load(path, &mut |_| {})?.frame(0)?;
        let name = path
            .file_stem()
            .map_or_else(String::new, |s| s.to_string_lossy().into_owned());
        scenes.push(measure_scene(&gpu, &scene, name, args)?);
        first.get_or_insert(scene);
        bar.set(done(index + 1), "sizes");
    }
    let sizes = match first {
        Some(scene) if !args.no_sizes => measure_sizes(&gpu, &scene, args)?,
        _ => Vec::new(),
    };
    drop(bar);
    let report = Report {
        adapter: gpu.adapter_name().to_owned(),
        driver: gpu.driver(),
        rounds: args.rounds,
        spp: args.spp,
        scenes,
        sizes,
    };
    if let Some(path) = &args.report {
        output::write_text(&report::markdown(&report), path)?;
    }
    print_json(&report)
}

fn variants(scene: &Scene) -> Vec<Variant> {
    let one_cell = scene
        .volume
        .dims()
        .into_iter()
        .max()
        .unwrap_or(1)
        .next_power_of_two();
    let default = TraceOptions::default;
    let options = [
        ("default", default()),
        (
            "one majorant cell",
            TraceOptions {
                cell_size: one_cell,
                ..default()
            },
        ),
        (
            "hardware interpolation",
            TraceOptions {
                interpolation: Interpolation::Hardware,
                ..default()
            },
        ),
        (
            "white noise",
            TraceOptions {
                white_noise: true,
                ..default()
            },
        ),
        (
            "one lit collision",
            TraceOptions {
                picks: 1,
                ..default()
            },
        ),
    ];
    let variant = |(name, options)| Variant {
        name,
        options,
        seconds: Vec::new(),
        images: Vec::new(),
    };
    options.into_iter().map(variant).collect()
}

fn measure_scene(
    gpu: &Gpu,
    scene: &Scene,
    name: String,
    args: &BenchTraceArgs,
) -> Result<SceneReport, Failure> {
    let mut variants = variants(scene);
    let (mut bare, mut tracer_rate, mut rate_ratio) = (Vec::new(), Vec::new(), Vec::new());
    let counted = count(gpu, scene, args.spp)?;
    let pixels = f64::from(scene.camera.width) * f64::from(scene.camera.height);
    let lookups = counted.lookups / f64::from(args.spp);
    let mut texture_format = String::new();
    for round in 0..args.rounds {
        for variant in &mut variants {
            let options = TraceOptions {
                seed: u64::from(round) + 1,
                ..variant.options.clone()
            };
            let mut tracer = Tracer::new(gpu, scene, &options)?;
            // The first dispatches also find their size.
            tracer.accumulate(1)?;
            let started = Instant::now();
            tracer.accumulate(args.spp)?;
            variant.seconds.push(started.elapsed().as_secs_f64());
            variant.images.push(tracer.read_image()?);
            if variant.name == "default" {
                tracer.fetch_rate(FETCH_LANES, 1)?;
                let fetched = tracer.fetch_rate(FETCH_LANES, FETCH_LOOKUPS)?;
                let seconds = variant.seconds.last().copied().unwrap_or(f64::INFINITY);
                let rate = lookups * f64::from(args.spp) / seconds;
                bare.push(fetched);
                tracer_rate.push(rate);
                rate_ratio.push(rate / fetched);
                texture_format = format!("{:?}", tracer.volume().format());
            }
        }
    }
    let denominators = denominators(&variants);
    let errors: Vec<f64> = variants
        .iter()
        .map(|v| relmse_of_seeds(v, &denominators))
        .collect();
    let spp = f64::from(args.spp + 1);
    let default_seconds = variants[0].seconds.clone();
    let default_mean = mean_image(&variants[0]);
    let reports = variants
        .iter()
        .zip(&errors)
        .map(|(variant, &error)| {
            let ratios = variant
                .seconds
                .iter()
                .zip(&default_seconds)
                .map(|(a, b)| a / b);
            let seconds_ratio = median(ratios.collect());
            VariantReport {
                name: variant.name,
                samples_per_second: pixels * f64::from(args.spp) / median(variant.seconds.clone()),
                relmse_times_spp: error * spp,
                seconds_ratio,
                default_gain: seconds_ratio * error / errors[0],
                relmse_to_default: relmse(&mean_image(variant), &default_mean, &denominators),
            }
        })
        .collect();
    Ok(SceneReport {
        scene: name,
        texture_format,
        lookups_per_covered_sample: counted.lookups / counted.covered,
        cells_per_covered_sample: counted.cells / counted.covered,
        lookups_per_second: median(tracer_rate),
        bare_lookups_per_second: median(bare),
        lookup_rate_ratio: median(rate_ratio),
        variants: reports,
    })
}

struct Counted {
    lookups: f64,
    cells: f64,
    covered: f64,
}

fn count(gpu: &Gpu, scene: &Scene, spp: u32) -> Result<Counted, Failure> {
    let options = TraceOptions {
        statistics: true,
        ..Default::default()
    };
    let mut tracer = Tracer::new(gpu, scene, &options)?;
    tracer.accumulate(spp)?;
    let counters = tracer.counters();
    Ok(Counted {
        lookups: counters.lookups as f64,
        cells: counters.cells as f64,
        covered: (counters.covered_samples as f64).max(1.0),
    })
}

fn mean_image(variant: &Variant) -> Vec<[f64; 3]> {
    let count = variant.images.len().max(1) as f64;
    let pixels = variant.images.first().map_or(0, Vec::len);
    (0..pixels)
        .map(|i| {
            std::array::from_fn(|c| {
                variant
                    .images
                    .iter()
                    .map(|image| f64::from(image[i][c]))
                    .sum::<f64>()
                    / count
            })
        })
        .collect()
}

/// b² + 0.01 of relMSE, b being the mean of all images that are unbiased.
fn denominators(variants: &[Variant]) -> Vec<[f64; 3]> {
    let unbiased: Vec<_> = variants
        .iter()
        .filter(|v| v.options.interpolation == Interpolation::Exact)
        .map(mean_image)
        .collect();
    let count = unbiased.len() as f64;
    (0..unbiased[0].len())
        .map(|i| {
            std::array::from_fn(|c| {
                let mean = unbiased.iter().map(|image| image[i][c]).sum::<f64>() / count;
                mean * mean + 0.01
            })
        })
        .collect()
}

/// relMSE of one image, from the variance over the seeds.
fn relmse_of_seeds(variant: &Variant, denominators: &[[f64; 3]]) -> f64 {
    let means = mean_image(variant);
    let images = variant.images.len() as f64;
    let mut sum = 0.0;
    for image in &variant.images {
        for (pixel, (mean, denominator)) in image.iter().zip(means.iter().zip(denominators)) {
            for c in 0..3 {
                sum += (f64::from(pixel[c]) - mean[c]).powi(2) / denominator[c];
            }
        }
    }
    sum / ((images - 1.0).max(1.0) * 3.0 * means.len() as f64)
}

fn relmse(a: &[[f64; 3]], b: &[[f64; 3]], denominators: &[[f64; 3]]) -> f64 {
    let squares = a
        .iter()
        .zip(b)
        .zip(denominators)
        .map(|((a, b), denominator)| {
            (0..3)
                .map(|c| (a[c] - b[c]).powi(2) / denominator[c])
                .sum::<f64>()
        });
    squares.sum::<f64>() / (3.0 * a.len() as f64)
}

fn measure_sizes(
    gpu: &Gpu,
    scene: &Scene,
    args: &BenchTraceArgs,
) -> Result<Vec<SizeReport>, Failure> {
    let pixels = f64::from(scene.camera.width) * f64::from(scene.camera.height);
    let scenes: Vec<Scene> = SIDES
        .iter()
        .map(|&side| resampled(scene, side))
        .collect::<Result<_, Failure>>()?;
    let mut seconds = vec![Vec::new(); SIDES.len()];
    for round in 0..args.rounds {
        for (scene, seconds) in scenes.iter().zip(&mut seconds) {
            let options = TraceOptions {
                seed: u64::from(round),
                ..Default::default()
            };
            let mut tracer = Tracer::new(gpu, scene, &options)?;
            tracer.accumulate(1)?;
            let started = Instant::now();
            tracer.accumulate(args.spp)?;
            seconds.push(started.elapsed().as_secs_f64());
        }
    }
    let growth = |i: usize| match i.checked_sub(1) {
        None => 1.0,
        Some(previous) => median(
            seconds[i]
                .iter()
                .zip(&seconds[previous])
                .map(|(a, b)| a / b)
                .collect(),
        ),
    };
    Ok(SIDES
        .iter()
        .enumerate()
        .map(|(i, &side)| SizeReport {
            side,
            samples_per_second: pixels * f64::from(args.spp) / median(seconds[i].clone()),
            cost_growth: growth(i),
        })
        .collect())
}

/// The same field on side³ voxels of 8 bits.
fn resampled(scene: &Scene, side: u32) -> Result<Scene, Failure> {
    let n = side as usize;
    let voxels: Vec<u8> = (0..n * n * n)
        .into_par_iter()
        .map(|index| {
            let place = [index % n, index / n % n, index / (n * n)];
            let unit = place.map(|i| (i as f64 + 0.5) / n as f64);
            let s = scene.s_from_value(scene.volume.sample(unit.into()));
            (s * 255.0).round().clamp(0.0, 255.0) as u8
        })
        .collect();
    let volume = Volume::new(
        Voxels::U8(voxels),
        [side; 3],
        1.0,
        0.0,
        *scene.volume.geometry(),
    )
    .map_err(|error| Failure::new(Exit::Internal, error.to_string()))?;
    Ok(Scene {
        volume,
        window: [0.0, 255.0],
        ..scene.clone()
    })
}
