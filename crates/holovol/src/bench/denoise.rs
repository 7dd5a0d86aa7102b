//! `holovol bench denoise`: both denoisers on the same noisy frames, against converged images.
//!
//! Every sequence ends at the scene's own state, so that one reference per eye serves all; runs of
//! 1, 2, 8 and 32 frames begin as much earlier. A reference is two independent halves: the mean of
//! (image − half 1)·(image − half 2) is the squared error without the reference's own noise.

use std::collections::BTreeMap;

use glam::{DMat4, DVec3};
use holovol_light::EnvironmentMap;
use holovol_reference::Image;
use holovol_render::{
    DenoiseMode, DenoiseSettings, Denoiser, Gpu, PaperSettings, TraceOptions, Tracer, View,
};
use holovol_scene::{Camera, Scene, Sequence};
use holovol_volume::{TransferFunction, TransferPoint};
use serde::Serialize;

use super::denoise_measures::{
    self as measures, Reference, both, correspondences, disagreement as apart, disoccluded, flip,
    ghost, middle, relmse, relmse_where,
};
use super::denoise_oidn::best_oidn;
use super::denoise_report;
use crate::cli::BenchDenoiseArgs;
use crate::live::{Live, Seconds};
use crate::progress::Bar;
use crate::{Exit, Failure, output, print_json};

/// Frames after which runs are judged.
pub(super) const FRAMES: [u32; 4] = [1, 2, 8, 32];
/// Frames after which contrast and the eyes are compared.
const SETTLED: u32 = 8;
/// Frames since places came into view, for their error against that of a fresh start.
const SINCE_HIDDEN: u32 = 4;
/// Frames under the old light or transfer function before a switch.
const BEFORE_SWITCH: u32 = 12;
/// Frames after a switch at which ghosts are measured.
const AFTER_SWITCH: [u32; 4] = [1, 2, 4, 8];
/// Distance of the eyes, metres.
pub(super) const IPD: f64 = 0.063;

#[derive(Debug, Serialize)]
pub(super) struct Report {
    pub(super) adapter: String,
    pub(super) driver: String,
    pub(super) spp: u32,
    pub(super) reference_spp: u32,
    pub(super) scenes: Vec<SceneReport>,
}

#[derive(Debug, Serialize)]
pub(super) struct SceneReport {
    pub(super) scene: String,
    pub(super) cases: Vec<CaseReport>,
    pub(super) switches: Vec<SwitchReport>,
}

#[derive(Debug, Serialize)]
pub(super) struct CaseReport {
    pub(super) case: &'static str,
    pub(super) noisy_relmse: f64,
    pub(super) noisy_flip: f64,
    /// The best of its variants; its name.
    pub(super) oidn: Option<(String, f64, f64)>,
    pub(super) results: Vec<Outcome>,
    /// Means over the frames of the longest run but the first.
    pub(super) seconds: Seconds,
    pub(super) paper_seconds: Seconds,
    /// (guides + filter) / trace.
    pub(super) cost_share: f64,
    /// By mode: RMS change of the left eye's error over the last frame.
    pub(super) flicker: BTreeMap<&'static str, f64>,
    /// By mode: RMS difference of the eyes' relative errors after 8 frames.
    pub(super) disagreement: BTreeMap<&'static str, f64>,
    /// By mode: the left eye's contrast at the scale of a pixel, 1 for all of the reference's.
    pub(super) contrast: BTreeMap<&'static str, f64>,
    pub(super) disoccluded: Option<Disoccluded>,
}

#[derive(Debug, Serialize)]
pub(super) struct Outcome {
    pub(super) mode: &'static str,
    pub(super) frames: u32,
    pub(super) relmse: f64,
    pub(super) flip: f64,
}

#[derive(Debug, Serialize)]
pub(super) struct SwitchReport {
    pub(super) switch: &'static str,
    pub(super) mode: &'static str,
    pub(super) frames: u32,
    pub(super) ghost: f64,
    pub(super) relmse: f64,
}

/// The left eye's pixels whose places came into view in the last four frames.
#[derive(Debug, Serialize)]
pub(super) struct Disoccluded {
    pub(super) pixels: usize,
    pub(super) relmse: f64,
    /// At the same pixels, of a denoiser that began four frames ago.
    pub(super) fresh: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Case {
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

    fn is_head(self) -> bool {
        matches!(self, Self::SlowHead | Self::FastHead)
    }

    /// The scene `back` frames before its end.
    pub(super) fn scene(self, end: &Scene, back: u32) -> Scene {
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
        output::write_text(&denoise_report::markdown(&report), path)?;
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
    let [left, right] = cameras.map(|camera| halves(gpu, scene, camera, spp));
    Ok([left?, right?])
}

pub(super) fn halves(
    gpu: &Gpu,
    scene: &Scene,
    camera: Camera,
    spp: u32,
) -> Result<[Image; 2], Failure> {
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
        let pixels = tracer.read_image()?;
        Ok(Image::new(camera.width, camera.height, pixels))
    };
    Ok([half(900_001)?, half(900_002)?])
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
            runs.push((mode, frames, live.denoiser(settings)));
        }
    }
    let fresh = runs.len();
    runs.push((
        "holovol",
        SINCE_HIDDEN,
        live.denoiser(settings(DenoiseMode::Holovol)),
    ));
    let mut times: BTreeMap<&'static str, Vec<Seconds>> = BTreeMap::new();
    let mut last: BTreeMap<&'static str, Vec<Image>> = BTreeMap::new();
    let mut hidden = None;
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
            if *frames != longest {
                continue;
            }
            times.entry(*mode).or_default().push(seconds);
            if back < 2 {
                let left = denoiser.read_images()?.swap_remove(0);
                last.entry(*mode).or_default().push(image(end, left));
            }
            if back == SINCE_HIDDEN && case.is_head() {
                hidden = Some((View::from_camera(&cameras[0]), denoiser.read_depths()?));
            }
        }
    }
    let noisy: Vec<Image> = (0..2)
        .map(|slot| Ok(image(end, live.noisy(slot)?)))
        .collect::<Result<_, Failure>>()?;
    let views = end
        .camera
        .stereo(IPD)
        .map(|camera| View::from_camera(&camera));
    let depths = runs[0].2.read_depths()?;
    let left_depths = &depths[..noisy[0].pixels().len()];
    let places = correspondences(&views[0], left_depths, &views[1]);
    let mut disagreement = BTreeMap::from([("noisy", apart(&noisy, reference, &places))]);
    let mut contrast = BTreeMap::new();
    let mut results = Vec::new();
    let mut outputs = Vec::new();
    for (mode, frames, denoiser) in &runs {
        let images: Vec<Image> = denoiser
            .read_images()?
            .into_iter()
            .map(|pixels| image(end, pixels))
            .collect();
        if *frames == SETTLED {
            disagreement.insert(*mode, apart(&images, reference, &places));
            contrast.insert(*mode, measures::contrast(&images[0], &reference[0]));
        }
        if FRAMES.contains(frames) {
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
        outputs.push(images);
    }
    let disoccluded = hidden.map(|(view, before)| {
        let wanted = disoccluded(&views[0], left_depths, &view, &before);
        let of = |run: usize| relmse_where(&outputs[run][0], &reference[0], &wanted);
        Disoccluded {
            pixels: wanted.iter().filter(|&&wanted| wanted).count(),
            relmse: of(FRAMES.len() - 1),
            fresh: of(fresh),
        }
    });
    if let Some(folder) = &args.pictures {
        let stem = format!("{name}.{}", case.name().replace(' ', "_"));
        output::write_exr(&noisy[0], &folder.join(format!("{stem}.noisy.exr")))?;
        output::write_exr(
            &middle(&reference[0]),
            &folder.join(format!("{stem}.reference.exr")),
        )?;
    }
    let albedo = runs[0].2.read_albedo()?;
    let mut oidn = None;
    if let Some(program) = &args.oidn {
        let (variant, images) = best_oidn(program, &noisy, &albedo, reference)?;
        disagreement.insert("oidn", apart(&images, reference, &places));
        contrast.insert("oidn", measures::contrast(&images[0], &reference[0]));
        let [relmse, flip] = [relmse, flip].map(|of| both(&images, reference, of));
        oidn = Some((variant, relmse, flip));
    }
    let flicker = flicker(gpu, case, end, reference, &last, args)?;
    let mean = |mode: &str| {
        // In the first frame drivers may compile.
        let times = times.get(mode).map_or(&[][..], |times| &times[1..]);
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
        disagreement,
        contrast,
        disoccluded,
    })
}

/// By mode, from the left eye's last two images; in motion only if asked for, since the frame
/// before needs a reference of its own.
fn flicker(
    gpu: &Gpu,
    case: Case,
    end: &Scene,
    reference: &Reference,
    last: &BTreeMap<&'static str, Vec<Image>>,
    args: &BenchDenoiseArgs,
) -> Result<BTreeMap<&'static str, f64>, Failure> {
    let before = match case {
        Case::Rest => reference[0].clone(),
        _ if !args.flicker => return Ok(BTreeMap::new()),
        _ => {
            let scene = case.scene(end, 1);
            let [left, _] = scene.camera.stereo(IPD);
            halves(gpu, &scene, left, args.reference_spp)?
        }
    };
    let of = |(mode, images): (&&'static str, &Vec<Image>)| {
        let [a, b] = images.as_slice() else {
            return None;
        };
        let change = measures::error_change([a, b], [&before, &reference[0]]);
        Some((*mode, change))
    };
    Ok(last.iter().filter_map(of).collect())
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
        denoisers.push((mode, live.denoiser(settings)));
    }
    // What of the coefficient is blur, and no ghost: a denoiser that has never seen the old image.
    let fresh = settings(DenoiseMode::Holovol);
    denoisers.push(("fresh", live.denoiser(fresh)));
    let mut reports = Vec::new();
    let last = AFTER_SWITCH[AFTER_SWITCH.len() - 1];
    for index in 0..BEFORE_SWITCH + last {
        let scene = if index < BEFORE_SWITCH { &old } else { end };
        let (_, change) = live.trace(scene, &cameras, args.spp)?;
        for (mode, denoiser) in &mut denoisers {
            if *mode == "fresh" && index < BEFORE_SWITCH {
                continue;
            }
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
