//! `holovol bench stereo`: what two eyes cost against one, at equal error per eye.

use holovol_render::{DenoiseSettings, Gpu, Interpolation};
use holovol_scene::{Scene, Sequence};
use serde::Serialize;

use super::denoise::{Case, IPD, halves};
use super::denoise_measures::relmse;
use super::median;
use crate::cli::BenchStereoArgs;
use crate::live::{Live, Seconds};
use crate::progress::Bar;
use crate::{Failure, output, print_json};
use holovol_reference::Image;

/// Samples per pixel that one eye is given, and two eyes each.
const ONE_EYE: [u32; 4] = [1, 2, 3, 4];
const TWO_EYES: [u32; 3] = [1, 2, 3];
/// Samples at which curves are compared.
const HELD: u32 = 2;

#[derive(Debug, Serialize)]
struct Report {
    adapter: String,
    driver: String,
    frames: u32,
    rounds: u32,
    reference_spp: u32,
    scenes: Vec<SceneReport>,
}

#[derive(Debug, Serialize)]
struct SceneReport {
    scene: String,
    one_eye: Vec<Run>,
    two_eyes: Vec<Run>,
    /// Cost of two eyes of 2 samples over that of one eye that errs as little.
    as_good_as_two: Option<f64>,
    /// Cost of two eyes that err as little as one of 2 samples over that of the one.
    as_good_as_one: Option<f64>,
}

/// A point of a curve.
#[derive(Clone, Copy, Debug, Serialize)]
struct Run {
    samples: u32,
    /// relMSE of the left eye, mean of the rounds.
    error: f64,
    /// Medians over frames and rounds.
    seconds: Seconds,
}

impl Run {
    fn cost(&self) -> f64 {
        self.seconds.trace + self.seconds.guides + self.seconds.filter
    }
}

pub(crate) fn run(args: &BenchStereoArgs) -> Result<(), Failure> {
    if let Some(path) = &args.report {
        output::check(path, "md", "--report")?;
    }
    let gpu = Gpu::new(args.adapter.as_deref())?;
    let bar = Bar::new("measuring");
    let mut scenes = Vec::new();
    for (index, path) in args.scenes.iter().enumerate() {
        let name = path
            .file_stem()
            .map_or_else(String::new, |s| s.to_string_lossy().into_owned());
        let mut end = Sequence::load(path, &mut |_| {})?.frame(0)?;
        if let Some(side) = args.size {
            (end.camera.width, end.camera.height) = (side, side);
        }
        let progress = |done: f64| {
            bar.set((index as f64 + done) / args.scenes.len() as f64, &name);
        };
        scenes.push(measure(&gpu, &end, name.clone(), args, &progress)?);
    }
    drop(bar);
    let report = Report {
        adapter: gpu.adapter_name().to_owned(),
        driver: gpu.driver(),
        frames: args.frames,
        rounds: args.rounds,
        reference_spp: 2 * args.reference_spp,
        scenes,
    };
    if let Some(path) = &args.report {
        output::write_text(&markdown(&report), path)?;
    }
    print_json(&report)
}

/// Runs take turns, so that what else the machine does meets all of them alike.
fn measure(
    gpu: &Gpu,
    end: &Scene,
    scene: String,
    args: &BenchStereoArgs,
    progress: &dyn Fn(f64),
) -> Result<SceneReport, Failure> {
    progress(0.0);
    let left = end.camera.stereo(IPD)[0];
    let reference = halves(gpu, end, left, args.reference_spp)?;
    let mut curves = [(1, &ONE_EYE[..]), (2, &TWO_EYES[..])].map(|(eyes, samples)| {
        let points = samples
            .iter()
            .map(|&samples| (samples, Vec::new(), Vec::new()));
        (eyes, points.collect::<Vec<_>>())
    });
    for round in 0..args.rounds {
        progress((1.0 + f64::from(round)) / (1.0 + f64::from(args.rounds)));
        for (eyes, points) in &mut curves {
            for (samples, errors, times) in points {
                let seed = u64::from(round);
                errors.push(play(
                    gpu, end, *eyes, *samples, seed, &reference, args, times,
                )?);
            }
        }
    }
    let [one_eye, two_eyes] = curves.map(|(_, points)| {
        let runs = points.into_iter().map(|(samples, errors, times)| {
            let of = |f: fn(&Seconds) -> f64| median(times.iter().map(f).collect());
            Run {
                samples,
                error: errors.iter().sum::<f64>() / errors.len() as f64,
                seconds: Seconds {
                    trace: of(|s| s.trace),
                    guides: of(|s| s.guides),
                    filter: of(|s| s.filter),
                },
            }
        });
        runs.collect::<Vec<_>>()
    });
    let held = |runs: &[Run]| runs.iter().find(|run| run.samples == HELD).copied();
    let ratio = |over: &[Run], fixed: Option<Run>| {
        let fixed = fixed?;
        Some((fixed.cost(), cost_at(over, fixed.error)?))
    };
    Ok(SceneReport {
        scene,
        as_good_as_two: ratio(&one_eye, held(&two_eyes)).map(|(two, one)| two / one),
        as_good_as_one: ratio(&two_eyes, held(&one_eye)).map(|(one, two)| two / one),
        one_eye,
        two_eyes,
    })
}

/// One run: the left eye's last error; adds what its frames took.
#[expect(clippy::too_many_arguments, reason = "one run's whole description")]
fn play(
    gpu: &Gpu,
    end: &Scene,
    eyes: usize,
    samples: u32,
    seed: u64,
    reference: &[Image; 2],
    args: &BenchStereoArgs,
    times: &mut Vec<Seconds>,
) -> Result<f64, Failure> {
    let case = if args.rest {
        Case::Rest
    } else {
        Case::SlowHead
    };
    let mut live = Live::new(gpu, end, Interpolation::Exact, seed)?;
    let mut denoiser = live.denoiser(DenoiseSettings::default());
    for back in (0..args.frames).rev() {
        let scene = case.scene(end, back);
        let cameras = scene.camera.stereo(IPD);
        let (trace, change) = live.trace(&scene, &cameras[..eyes], samples)?;
        let seconds = live.denoise(&mut denoiser, eyes, change)?;
        // In the first frame drivers may compile.
        if back + 1 < args.frames {
            times.push(Seconds { trace, ..seconds });
        }
    }
    let pixels = denoiser.read_images()?.swap_remove(0);
    let image = Image::new(end.camera.width, end.camera.height, pixels);
    Ok(relmse(&image, reference))
}

/// What a run that errs by `error` costs, between the two measured ones: logarithms of both, linear;
/// beyond the curve's ends, where its last two lead.
fn cost_at(runs: &[Run], error: f64) -> Option<f64> {
    let place = |run: &Run| (run.error.ln(), run.cost().ln());
    let is_between = |pair: &&[Run]| pair[1].error <= error;
    let pair = runs
        .windows(2)
        .find(is_between)
        .or_else(|| runs.windows(2).last())?;
    let [(e, c), (f, d)] = [place(&pair[0]), place(&pair[1])];
    let cost = (c + (d - c) * (error.ln() - e) / (f - e)).exp();
    cost.is_normal().then_some(cost)
}

fn markdown(report: &Report) -> String {
    use std::fmt::Write;
    let mut page = format!(
        "{}, {}; left eye's relMSE · 10³ after {} frames (ms of a frame), means of {} runs; references of {} samples per pixel.\n\n",
        report.adapter, report.driver, report.frames, report.rounds, report.reference_spp
    );
    let list = |samples: &[u32]| {
        samples
            .iter()
            .map(u32::to_string)
            .collect::<Vec<_>>()
            .join(", ")
    };
    // Writing to a string can't fail.
    let _ = writeln!(
        page,
        "| scene | one eye, {} samples | two eyes, {} samples | as good as two eyes of {HELD} samples | as good as one eye of {HELD} samples |\n|---|---|---|---|---|",
        list(&ONE_EYE),
        list(&TWO_EYES)
    );
    for scene in &report.scenes {
        let curve = |runs: &[Run]| {
            let points = runs
                .iter()
                .map(|run| format!("{:.3} ({:.1})", 1e3 * run.error, 1e3 * run.cost()));
            points.collect::<Vec<_>>().join(", ")
        };
        let ratio =
            |value: Option<f64>| value.map_or("—".into(), |value| format!("{value:.2} ×"));
        let _ = writeln!(
            page,
            "| {} | {} | {} | {} | {} |",
            scene.scene,
            curve(&scene.one_eye),
            curve(&scene.two_eyes),
            ratio(scene.as_good_as_two),
            ratio(scene.as_good_as_one)
        );
    }
    page
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(samples: u32, error: f64, seconds: f64) -> Run {
        let seconds = Seconds {
            trace: 0.5 * seconds,
            guides: 0.25 * seconds,
            filter: 0.25 * seconds,
        };
        Run {
            samples,
            error,
            seconds,
        }
    }

    #[test]
    fn costs_between_and_beyond_runs_follow_their_curve() {
        // Error falls as 1/cost.
        let runs = [run(1, 4.0, 1.0), run(2, 2.0, 2.0), run(4, 1.0, 4.0)];
        for (error, cost) in [
            (4.0, 1.0),
            (3.0, 4.0 / 3.0),
            (1.6, 2.5),
            (0.5, 8.0),
            (8.0, 0.5),
        ] {
            let found = cost_at(&runs, error).unwrap();
            assert!((found - cost).abs() < 1e-9, "{error}: {found}");
        }
        assert!(cost_at(&runs[..1], 1.0).is_none());
        assert!(cost_at(&[run(1, 2.0, 1.0), run(2, 2.0, 2.0)], 1.0).is_none());
    }
}
