//! `holovol render --denoise`: a scene's frames through the real-time pipeline.

use std::time::Instant;

use holovol_reference::Image;
use holovol_render::{DenoiseMode, DenoiseSettings, Denoiser, Gpu, PaperSettings};
use holovol_scene::{Camera, Sequence};

use crate::cli::{Backend, Denoise, Interpolation, RenderArgs};
use crate::live::{Live, Seconds};
use crate::progress::Bar;
use crate::{Exit, Failure, output, picture, print_json};

/// What it prints.
#[derive(serde::Serialize)]
struct Line<'a> {
    out: &'a std::path::Path,
    adapter: String,
    driver: String,
    denoise: &'static str,
    seed: u64,
    width: u32,
    height: u32,
    eyes: usize,
    frames: u32,
    spp_per_frame: u32,
    load_seconds: f64,
    /// Means per frame.
    seconds_per_frame: Seconds,
    mean_rgb: [f64; 3],
    mean_opacity: f64,
}

pub(crate) fn run(
    args: &RenderArgs,
    denoise: Denoise,
    sequence: &Sequence,
    cameras: impl Fn(&Camera) -> Vec<(Option<&'static str>, Camera)>,
) -> Result<(), Failure> {
    if args.device.backend == Backend::Reference {
        return Err(Failure::new(
            Exit::Usage,
            "--denoise is for --backend gpu; the reference has no real-time pipeline",
        ));
    }
    let started = Instant::now();
    let gpu = Gpu::new(args.device.adapter.as_deref())?;
    let interpolation = match args.device.interpolation {
        Interpolation::Exact => holovol_render::Interpolation::Exact,
        Interpolation::Hardware => holovol_render::Interpolation::Hardware,
    };
    let mut live = Live::new(&gpu, &sequence.frame(0)?, interpolation, args.seed)?;
    let mode = match denoise {
        Denoise::Off => None,
        Denoise::Paper => Some(DenoiseMode::Paper(PaperSettings::default())),
        Denoise::Holovol => Some(DenoiseMode::Holovol),
    };
    let settings = |mode| DenoiseSettings {
        mode,
        ..Default::default()
    };
    let mut denoiser: Option<Denoiser> = mode.map(|mode| live.denoiser(settings(mode)));
    let load_seconds = started.elapsed().as_secs_f64();
    let bar = Bar::new("rendering");
    let frames = sequence.frames();
    let mut sum = Seconds::default();
    let mut mean = [0.0; 4];
    let mut eyes = 0;
    for index in 0..frames {
        let scene = sequence.frame(index)?;
        let named = cameras(&scene.camera);
        let views: Vec<Camera> = named.iter().map(|&(_, camera)| camera).collect();
        eyes = views.len();
        let (seconds, change) = live.trace(&scene, &views, args.spp_per_frame)?;
        sum.trace += seconds;
        if let Some(denoiser) = &mut denoiser {
            let seconds = live.denoise(denoiser, eyes, change)?;
            sum.guides += seconds.guides;
            sum.filter += seconds.filter;
        }
        bar.set(f64::from(index + 1) / f64::from(frames), "");
        if index + 1 < frames && !args.all_frames {
            continue;
        }
        let images = match &denoiser {
            Some(denoiser) => denoiser.read_images()?,
            None => (0..eyes)
                .map(|slot| live.noisy(slot))
                .collect::<Result<_, _>>()?,
        };
        mean = [0.0; 4];
        for ((eye, camera), pixels) in named.iter().zip(images) {
            let image = Image::new(camera.width, camera.height, pixels);
            let of_image = holovol_reference::measures::mean(&image);
            for (mean, channel) in mean.iter_mut().zip(of_image) {
                *mean += channel / eyes as f64;
            }
            let frame = args.all_frames.then_some(index);
            output::write_exr(&image, &output::numbered(&args.out, *eye, frame))?;
            if let Some(png) = &args.png {
                let settings = sequence.file().output.unwrap_or_default();
                let picture = picture::develop(&image, &settings, camera, &scene.environment);
                output::write_png(&picture, &output::numbered(png, *eye, frame))?;
            }
        }
    }
    drop(bar);
    let per_frame = |seconds: f64| seconds / f64::from(frames.max(1));
    let camera = sequence.file().camera;
    let [r, g, b, mean_opacity] = mean;
    print_json(&Line {
        out: &args.out,
        adapter: gpu.adapter_name().to_owned(),
        driver: gpu.driver(),
        denoise: match denoise {
            Denoise::Off => "off",
            Denoise::Paper => "paper",
            Denoise::Holovol => "holovol",
        },
        seed: args.seed,
        width: camera.width,
        height: camera.height,
        eyes,
        frames,
        spp_per_frame: args.spp_per_frame,
        load_seconds,
        seconds_per_frame: Seconds {
            trace: per_frame(sum.trace),
            guides: per_frame(sum.guides),
            filter: per_frame(sum.filter),
        },
        mean_rgb: [r, g, b],
        mean_opacity,
    })?;
    let counters = live.counters();
    if counters.majorant_violations > 0 {
        return Err(Failure::new(
            Exit::Inexact,
            format!(
                "{} volume lookups exceeded their majorant: the image may be biased; please report this scene",
                counters.majorant_violations
            ),
        ));
    }
    Ok(())
}
