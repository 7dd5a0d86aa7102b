//! `holovol bench denoise`: both denoisers on the same noisy frames, against converged images.
//!
//! Every sequence ends at the scene's own state, so that one reference per eye serves all; runs of
//! 1, 2, 8 and 32 frames begin as much earlier. A reference is two independent halves: the mean of
//! (image − half 1)·(image − half 2) is the squared error without the reference's own noise.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use glam::{DMat4, DVec3};
use holovol_light::EnvironmentMap;
use holovol_reference::{Image, measures};
use holovol_render::{
    DenoiseMode, DenoiseSettings, Denoiser, Gpu, PaperSettings, TraceOptions, Tracer,
};
use holovol_scene::{Camera, Scene, Sequence};
use holovol_volume::{TransferFunction, TransferPoint};
use serde::Serialize;

use crate::cli::BenchDenoiseArgs;
use crate::live::{Live, Seconds};
use crate::progress::Bar;
use crate::{Exit, Failure, output, print_json};

/// Frames after which runs are judged.
const FRAMES: [u32; 4] = [1, 2, 8, 32];
/// Frames under the old light or transfer function before a switch.
const BEFORE_SWITCH: u32 = 12;
/// Frames after a switch at which ghosts are measured.
const AFTER_SWITCH: [u32; 4] = [1, 2, 4, 8];
/// Distance of the eyes, metres.
const IPD: f64 = 0.063;

#[derive(Debug, Serialize)]
struct Report {
    adapter: String,
    driver: String,
    spp: u32,
    reference_spp: u32,
    scenes: Vec<SceneReport>,
}

#[derive(Debug, Serialize)]
struct SceneReport {
    scene: String,
    cases: Vec<CaseReport>,
    switches: Vec<SwitchReport>,
}

#[derive(Debug, Serialize)]
struct CaseReport {
    case: &'static str,
    noisy_relmse: f64,
    noisy_flip: f64,
    /// The best of its variants; its name.
    oidn: Option<(String, f64, f64)>,
    results: Vec<Outcome>,
    /// Means over the frames of the longest run.
    seconds: Seconds,
    paper_seconds: Seconds,
    /// (guides + filter) / trace.
    cost_share: f64,
    /// At rest, by mode: RMS change of the left eye's image over the last frame.
    flicker: BTreeMap<&'static str, f64>,
}

#[derive(Debug, Serialize)]
struct Outcome {
    mode: &'static str,
    frames: u32,
    relmse: f64,
    flip: f64,
}

#[derive(Debug, Serialize)]
struct SwitchReport {
    switch: &'static str,
    mode: &'static str,
    frames: u32,
    ghost: f64,
    relmse: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Case {
    Rest,
    SlowHead,
    FastHead,
    Volume,
    Light,
}

impl Case {
    const ALL: [Self; 5] = [
        Self::Rest,
        Self::SlowHead,
        Self::FastHead,
        Self::Volume,
        Self::Light,
    ];

    fn name(self) -> &'static str {
        match self {
            Self::Rest => "rest",
            Self::SlowHead => "slow head",
            Self::FastHead => "fast head",
            Self::Volume => "volume turning",
            Self::Light => "light turning",
        }
    }

    /// The scene `back` frames before its end.
    fn scene(self, end: &Scene, back: u32) -> Scene {
        let back = f64::from(back);
        let mut scene = end.clone();
        let around = |angle: f64, step: f64| {
            let arm = end.camera.eye - end.camera.target;
            let turned = DMat4::from_rotation_y(angle).transform_vector3(arm);
            end.camera.target + turned + DVec3::Y * (0.1 * step)
        };
        let head = |metres: f64| {
            let arm = end.camera.eye - end.camera.target;
            let radius = DVec3::new(arm.x, 0.0, arm.z).length().max(1e-3);
            around(-back * metres / radius, back * metres)
        };
        match self {
            Self::Rest => {}
            Self::SlowHead => scene.camera.eye = head(0.005),
            Self::FastHead => scene.camera.eye = head(0.02),
            Self::Volume => {
                let centre = end.world_from_unit_cube.transform_point3(DVec3::splat(0.5));
                scene.world_from_unit_cube = DMat4::from_translation(centre)
                    * DMat4::from_rotation_y(-back.to_radians())
                    * DMat4::from_translation(-centre)
                    * end.world_from_unit_cube;
            }
            Self::Light => scene.environment.rotation_y -= back.to_radians(),
        }
        scene
    }
}

/// Two halves of each eye's reference.
type Reference = [[Image; 2]; 2];

pub(crate) fn run(args: &BenchDenoiseArgs) -> Result<(), Failure> {
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
        bar.set(index as f64 / args.scenes.len() as f64, &name);
        let mut scene = Sequence::load(path, &mut |_| {})?.frame(0)?;
        if let Some(side) = args.size {
            (scene.camera.width, scene.camera.height) = (side, side);
        }
        scenes.push(measure(&gpu, &scene, name, args)?);
    }
    drop(bar);
    let report = Report {
        adapter: gpu.adapter_name().to_owned(),
        driver: gpu.driver(),
        spp: args.spp,
        reference_spp: 2 * args.reference_spp,
        scenes,
    };
    if let Some(path) = &args.report {
        output::write_text(&markdown(&report), path)?;
    }
    print_json(&report)
}

fn settings(mode: DenoiseMode) -> DenoiseSettings {
    DenoiseSettings {
        mode,
        ..Default::default()
    }
}

fn modes() -> [(&'static str, DenoiseSettings); 2] {
    [
        ("holovol", settings(DenoiseMode::Holovol)),
        (
            "paper",
            settings(DenoiseMode::Paper(PaperSettings::default())),
        ),
    ]
}

fn measure(
    gpu: &Gpu,
    end: &Scene,
    name: String,
    args: &BenchDenoiseArgs,
) -> Result<SceneReport, Failure> {
    let cameras = end.camera.stereo(IPD);
    let reference = reference(gpu, end, &cameras, args.reference_spp)?;
    let mut cases = Vec::new();
    for case in Case::ALL {
        let wanted =
            args.cases.is_empty() || args.cases.iter().any(|c| case.name().contains(c.as_str()));
        if wanted {
            cases.push(measure_case(gpu, end, case, &reference, &name, args)?);
        }
    }
    let mut switches = Vec::new();
    if args.cases.is_empty() || args.cases.iter().any(|c| c == "switch") {
        for switch in ["lamp", "transfer function"] {
            switches.extend(measure_switch(gpu, end, switch, &reference, args)?);
        }
    }
    Ok(SceneReport {
        scene: name,
        cases,
        switches,
    })
}

fn reference(
    gpu: &Gpu,
    scene: &Scene,
    cameras: &[Camera; 2],
    spp: u32,
) -> Result<Reference, Failure> {
    let eye = |camera: Camera| -> Result<[Image; 2], Failure> {
        let scene = Scene {
            camera,
            ..scene.clone()
        };
        let half = |seed: u64| -> Result<Image, Failure> {
            let options = TraceOptions {
                seed,
                ..Default::default()
            };
            let mut tracer = Tracer::new(gpu, &scene, &options)?;
            tracer.accumulate(spp)?;
            Ok(Image::new(
                camera.width,
                camera.height,
                tracer.read_image()?,
            ))
        };
        Ok([half(900_001)?, half(900_002)?])
    };
    Ok([eye(cameras[0])?, eye(cameras[1])?])
}

fn measure_case(
    gpu: &Gpu,
    end: &Scene,
    case: Case,
    reference: &Reference,
    name: &str,
    args: &BenchDenoiseArgs,
) -> Result<CaseReport, Failure> {
    let longest = FRAMES[FRAMES.len() - 1];
    let mut live = Live::new(gpu, end, holovol_render::Interpolation::Exact, args.seed)?;
    let mut runs: Vec<(&'static str, u32, Denoiser)> = Vec::new();
    for (mode, settings) in modes() {
        for frames in FRAMES {
            runs.push((mode, frames, live.denoiser(settings)?));
        }
    }
    let mut times: BTreeMap<&'static str, Vec<Seconds>> = BTreeMap::new();
    let mut last: BTreeMap<&'static str, Vec<Vec<[f32; 4]>>> = BTreeMap::new();
    for back in (0..longest).rev() {
        let scene = case.scene(end, back);
        let cameras = scene.camera.stereo(IPD);
        let (trace, change) = live.trace(&scene, &cameras, args.spp)?;
        for (mode, frames, denoiser) in &mut runs {
            if back >= *frames {
                continue;
            }
            let mut seconds = live.denoise(denoiser, 2, change)?;
            seconds.trace = trace;
            if *frames == longest {
                times.entry(*mode).or_default().push(seconds);
                if back < 2 {
                    last.entry(*mode)
                        .or_default()
                        .extend(denoiser.read_images()?);
                }
            }
        }
    }
    let noisy: Vec<Image> = (0..2)
        .map(|slot| Ok(image(end, live.noisy(slot)?)))
        .collect::<Result<_, Failure>>()?;
    let mut results = Vec::new();
    for (mode, frames, denoiser) in &runs {
        let images: Vec<Image> = denoiser
            .read_images()?
            .into_iter()
            .map(|pixels| image(end, pixels))
            .collect();
        if let Some(folder) = &args.pictures {
            let stem = format!("{name}.{}.{mode}.{frames}", case.name().replace(' ', "_"));
            output::write_exr(&images[0], &folder.join(format!("{stem}.exr")))?;
        }
        results.push(Outcome {
            mode,
            frames: *frames,
            relmse: both(&images, reference, relmse),
            flip: both(&images, reference, flip),
        });
    }
    if let Some(folder) = &args.pictures {
        let stem = format!("{name}.{}", case.name().replace(' ', "_"));
        output::write_exr(&noisy[0], &folder.join(format!("{stem}.noisy.exr")))?;
        output::write_exr(
            &middle(&reference[0]),
            &folder.join(format!("{stem}.reference.exr")),
        )?;
    }
    let albedo = runs[0].2.read_albedo()?;
    let oidn = match &args.oidn {
        Some(program) => Some(best_oidn(program, &noisy, &albedo, reference)?),
        None => None,
    };
    let mut flicker = BTreeMap::new();
    for (mode, images) in &last {
        // Frames back 1 and 0, two eyes each; at rest both have the same truth.
        if case == Case::Rest
            && let [a, _, b, _] = images.as_slice()
        {
            flicker.insert(*mode, rms_change(a, b));
        }
    }
    let mean = |mode: &str| {
        let times = times.get(mode).map_or(&[][..], Vec::as_slice);
        let n = times.len().max(1) as f64;
        let of = |f: fn(&Seconds) -> f64| times.iter().map(f).sum::<f64>() / n;
        Seconds {
            trace: of(|s| s.trace),
            guides: of(|s| s.guides),
            filter: of(|s| s.filter),
        }
    };
    let seconds = mean("holovol");
    Ok(CaseReport {
        case: case.name(),
        noisy_relmse: both(&noisy, reference, relmse),
        noisy_flip: both(&noisy, reference, flip),
        oidn,
        results,
        seconds,
        paper_seconds: mean("paper"),
        cost_share: (seconds.guides + seconds.filter) / seconds.trace.max(1e-12),
        flicker,
    })
}

fn measure_switch(
    gpu: &Gpu,
    end: &Scene,
    switch: &'static str,
    reference: &Reference,
    args: &BenchDenoiseArgs,
) -> Result<Vec<SwitchReport>, Failure> {
    let mut old = end.clone();
    if switch == "lamp" {
        let texels = end.environment.map.texels();
        let mean = texels
            .iter()
            .map(|t| f64::from(t[0] + t[1] + t[2]))
            .sum::<f64>()
            / (3.0 * texels.len().max(1) as f64);
        old.environment.map = EnvironmentMap::constant([(0.5 * mean) as f32; 3]);
    } else {
        old.transfer_function = edited(&end.transfer_function)
            .map_err(|reason| Failure::new(Exit::Internal, reason))?;
    }
    let cameras = end.camera.stereo(IPD);
    let before = reference_of_one(gpu, &old, &cameras[0], args.reference_spp)?;
    let mut live = Live::new(gpu, &old, holovol_render::Interpolation::Exact, args.seed)?;
    let mut denoisers = Vec::new();
    for (mode, settings) in modes() {
        denoisers.push((mode, live.denoiser(settings)?));
    }
    let mut reports = Vec::new();
    let last = AFTER_SWITCH[AFTER_SWITCH.len() - 1];
    for index in 0..BEFORE_SWITCH + last {
        let scene = if index < BEFORE_SWITCH { &old } else { end };
        let (_, change) = live.trace(scene, &cameras, args.spp)?;
        for (mode, denoiser) in &mut denoisers {
            live.denoise(denoiser, 2, change)?;
            let after = (index + 1).saturating_sub(BEFORE_SWITCH);
            if AFTER_SWITCH.contains(&after) {
                let images: Vec<Image> = denoiser
                    .read_images()?
                    .into_iter()
                    .map(|pixels| image(end, pixels))
                    .collect();
                reports.push(SwitchReport {
                    switch,
                    mode,
                    frames: after,
                    ghost: ghost(&images[0], &reference[0], &before),
                    relmse: both(&images, reference, relmse),
                });
            }
        }
    }
    Ok(reports)
}

fn reference_of_one(gpu: &Gpu, scene: &Scene, camera: &Camera, spp: u32) -> Result<Image, Failure> {
    let scene = Scene {
        camera: *camera,
        ..scene.clone()
    };
    let mut tracer = Tracer::new(gpu, &scene, &TraceOptions::default())?;
    tracer.accumulate(spp)?;
    Ok(Image::new(
        camera.width,
        camera.height,
        tracer.read_image()?,
    ))
}

/// The points moved by 8 % of s, their colours in reverse order.
fn edited(function: &TransferFunction) -> Result<TransferFunction, String> {
    let points = function.points();
    let points: Vec<TransferPoint> = points
        .iter()
        .zip(points.iter().rev())
        .map(|(point, other)| TransferPoint {
            s: if point.s > 0.0 && point.s < 1.0 {
                (1.08 * point.s).min(1.0)
            } else {
                point.s
            },
            albedo: other.albedo,
            ..*point
        })
        .collect();
    TransferFunction::new(points).map_err(|error| error.to_string())
}

fn image(scene: &Scene, pixels: Vec<[f32; 4]>) -> Image {
    Image::new(scene.camera.width, scene.camera.height, pixels)
}

fn middle(halves: &[Image; 2]) -> Image {
    let pixels = halves[0].pixels().iter().zip(halves[1].pixels());
    let pixels = pixels
        .map(|(a, b)| std::array::from_fn(|c| 0.5 * (a[c] + b[c])))
        .collect();
    Image::new(halves[0].width(), halves[0].height(), pixels)
}

fn both(images: &[Image], reference: &Reference, of: fn(&Image, &[Image; 2]) -> f64) -> f64 {
    let sum: f64 = images
        .iter()
        .zip(reference)
        .map(|(image, halves)| of(image, halves))
        .sum();
    sum / images.len().max(1) as f64
}

/// Without the reference's noise: see the module.
fn relmse(image: &Image, halves: &[Image; 2]) -> f64 {
    let [one, two] = halves;
    let mut sum = 0.0;
    for ((a, r), s) in image.pixels().iter().zip(one.pixels()).zip(two.pixels()) {
        for c in 0..3 {
            let (a, r, s) = (f64::from(a[c]), f64::from(r[c]), f64::from(s[c]));
            let b = 0.5 * (r + s);
            sum += (a - r) * (a - s) / (b * b + 0.01);
        }
    }
    sum / (3 * image.pixels().len()) as f64
}

fn flip(image: &Image, halves: &[Image; 2]) -> f64 {
    measures::flip(image, &middle(halves)).unwrap_or(f64::NAN)
}

/// Coefficient of (output − new) on (old − new); the halves keep the reference's noise out.
fn ghost(image: &Image, halves: &[Image; 2], old: &Image) -> f64 {
    let (mut top, mut bottom) = (0.0, 0.0);
    let [one, two] = halves;
    for (i, a) in image.pixels().iter().enumerate() {
        for c in 0..3 {
            let [a, r, s, o] = [a, &one.pixels()[i], &two.pixels()[i], &old.pixels()[i]]
                .map(|pixel| f64::from(pixel[c]));
            top += (a - r) * (o - s);
            bottom += (o - r) * (o - s);
        }
    }
    top / bottom.max(1e-30)
}

fn rms_change(a: &[[f32; 4]], b: &[[f32; 4]]) -> f64 {
    let mut sum = 0.0;
    for (a, b) in a.iter().zip(b) {
        for c in 0..3 {
            sum += f64::from(a[c] - b[c]).powi(2);
        }
    }
    (sum / (3 * a.len().max(1)) as f64).sqrt()
}

/// Open Image Denoise on each eye's noisy frame: its best variant over colour alone, and with the
/// albedo guide, taken as noisy or as clean.
fn best_oidn(
    program: &Path,
    noisy: &[Image],
    albedo: &[[f32; 4]],
    reference: &Reference,
) -> Result<(String, f64, f64), Failure> {
    let mut best: Option<(String, f64, f64)> = None;
    for (variant, aux) in [
        ("colour", None),
        ("albedo", Some(false)),
        ("clean albedo", Some(true)),
    ] {
        let mut images = Vec::new();
        for (eye, image) in noisy.iter().enumerate() {
            let pixels = image.pixels().len();
            let guide = &albedo[eye * pixels..(eye + 1) * pixels];
            images.push(oidn(program, image, aux.map(|clean| (guide, clean)))?);
        }
        let error = both(&images, reference, relmse);
        if best.as_ref().is_none_or(|(_, least, _)| error < *least) {
            best = Some((variant.into(), error, both(&images, reference, flip)));
        }
    }
    best.ok_or_else(|| Failure::new(Exit::Internal, "no variant of Open Image Denoise was run"))
}

fn oidn(
    program: &Path,
    noisy: &Image,
    guide: Option<(&[[f32; 4]], bool)>,
) -> Result<Image, Failure> {
    let folder = std::env::temp_dir().join(format!("holovol-oidn-{}", std::process::id()));
    let failed = |reason: String| {
        Failure::new(
            Exit::Input,
            format!("--oidn: {}: {reason}", program.display()),
        )
    };
    let io = |error: std::io::Error| failed(error.to_string());
    std::fs::create_dir_all(&folder).map_err(io)?;
    let file = |name: &str| -> PathBuf { folder.join(name) };
    let (width, height) = (noisy.width(), noisy.height());
    std::fs::write(file("c.pfm"), pfm(width, height, noisy.pixels())).map_err(io)?;
    let mut command = Command::new(program);
    command
        .arg("--hdr")
        .arg(file("c.pfm"))
        .arg("-o")
        .arg(file("o.pfm"));
    if let Some((pixels, clean)) = guide {
        std::fs::write(file("a.pfm"), pfm(width, height, pixels)).map_err(io)?;
        command.arg("--alb").arg(file("a.pfm"));
        if clean {
            command.arg("--clean_aux");
        }
    }
    let result = command.output().map_err(io)?;
    if !result.status.success() {
        return Err(failed(String::from_utf8_lossy(&result.stdout).into_owned()));
    }
    let bytes = std::fs::read(file("o.pfm")).map_err(io)?;
    std::fs::remove_dir_all(&folder).map_err(io)?;
    let count = 12 * width as usize * height as usize;
    let data = bytes
        .len()
        .checked_sub(count)
        .map(|start| &bytes[start..])
        .ok_or_else(|| failed("its image is cut short".into()))?;
    let mut pixels: Vec<[f32; 4]> = Vec::new();
    for row in data.chunks_exact(12 * width as usize).rev() {
        for pixel in row.chunks_exact(12) {
            let channel = |c: usize| {
                let bytes: [u8; 4] = std::array::from_fn(|i| pixel[4 * c + i]);
                f32::from_le_bytes(bytes)
            };
            pixels.push([channel(0), channel(1), channel(2), 1.0]);
        }
    }
    Ok(Image::new(width, height, pixels))
}

/// Portable float map: rows from the bottom, little-endian.
fn pfm(width: u32, height: u32, pixels: &[[f32; 4]]) -> Vec<u8> {
    let mut bytes = format!("PF\n{width} {height}\n-1.0\n").into_bytes();
    for row in pixels.chunks_exact(width as usize).rev() {
        for pixel in row {
            for channel in &pixel[..3] {
                bytes.extend(channel.to_le_bytes());
            }
        }
    }
    bytes
}

fn markdown(report: &Report) -> String {
    use std::fmt::Write;
    let mut page = format!(
        "{}, {}; {} samples per pixel, eye and frame; references of {} samples per pixel.\n",
        report.adapter, report.driver, report.spp, report.reference_spp
    );
    page.push_str("\n| scene | case | noisy | OIDN | mode | relMSE after 1, 2, 8, 32 frames | FLIP after 1, 2, 8, 32 frames |\n|---|---|---|---|---|---|---|\n");
    for scene in &report.scenes {
        for case in &scene.cases {
            for mode in ["holovol", "paper"] {
                let row = |of: fn(&Outcome) -> f64| {
                    let of_mode = case.results.iter().filter(|r| r.mode == mode);
                    let cells: Vec<_> = of_mode.map(|r| format!("{:.5}", of(r))).collect();
                    cells.join(", ")
                };
                let oidn = case.oidn.as_ref().map_or("—".into(), |(name, relmse, _)| {
                    format!("{relmse:.5} ({name})")
                });
                // Writing to a string can't fail.
                let _ = writeln!(
                    page,
                    "| {} | {} | {:.4} | {oidn} | {mode} | {} | {} |",
                    scene.scene,
                    case.case,
                    case.noisy_relmse,
                    row(|r| r.relmse),
                    row(|r| r.flip)
                );
            }
        }
    }
    page.push_str("\n| scene | case | trace, ms | guides, ms | filter, ms | share | paper's filter, ms |\n|---|---|---|---|---|---|---|\n");
    for scene in &report.scenes {
        for case in &scene.cases {
            let _ = writeln!(
                page,
                "| {} | {} | {:.1} | {:.1} | {:.1} | {:.2} | {:.1} |",
                scene.scene,
                case.case,
                1e3 * case.seconds.trace,
                1e3 * case.seconds.guides,
                1e3 * case.seconds.filter,
                case.cost_share,
                1e3 * case.paper_seconds.filter
            );
        }
    }
    page.push_str(
        "\n| scene | switch | mode | frames | ghost | relMSE |\n|---|---|---|---|---|---|\n",
    );
    for scene in &report.scenes {
        for s in &scene.switches {
            let _ = writeln!(
                page,
                "| {} | {} | {} | {} | {:.3} | {:.5} |",
                scene.scene, s.switch, s.mode, s.frames, s.ghost, s.relmse
            );
        }
    }
    page
}
