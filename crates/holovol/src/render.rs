//! `holovol render`: a scene file to images.

use std::path::{Path, PathBuf};
use std::time::Instant;

use holovol_reference::Image;
use holovol_scene::{Camera, Scene, SceneFile, Sequence};

use crate::backend::{Device, Goal, Traced};
use crate::cli::{Backend, Denoise, Interpolation, RenderArgs};
use crate::progress::Bar;
use crate::{Exit, Failure, interrupt, output, picture, print_json, render_live};

/// What `render` prints.
#[derive(serde::Serialize)]
struct Line<'a> {
    out: &'a Path,
    adapter: String,
    driver: Option<String>,
    backend: &'static str,
    interpolation: &'static str,
    seed: u64,
    width: u32,
    height: u32,
    images: usize,
    /// The smallest over the images.
    spp: u64,
    seconds: f64,
    load_seconds: f64,
    samples_per_second: f64,
    mean_rgb: [f64; 3],
    mean_opacity: f64,
    /// The images, in the order in which they were rendered.
    files: &'a [PathBuf],
}

/// Sums over the images of a run.
#[derive(Default)]
struct Totals {
    images: usize,
    spp: Option<u64>,
    samples: f64,
    seconds: f64,
    mean: [f64; 4],
    faults: Vec<String>,
    files: Vec<PathBuf>,
}

pub(crate) fn run(args: &RenderArgs) -> Result<(), Failure> {
    output::check(&args.out, "exr", "--out")?;
    if let Some(png) = &args.png {
        output::check(png, "png", "--png")?;
    }
    let started = Instant::now();
    let device = match args.denoise {
        None => Some(Device::open(&args.device)?),
        Some(_) => None,
    };
    let sequence = load(args)?;
    for notice in sequence.notices() {
        eprintln!("note: {notice}");
    }
    // What fails at a later frame is found before the first is rendered.
    for index in 0..sequence.frames() {
        let scene = sequence.frame(index)?;
        for (eye, _) in eyes(&sequence, &scene.camera) {
            let frame = (sequence.frames() > 1).then_some(index);
            output::check_numbered(&output::numbered(&args.out, eye, frame), "--out")?;
            if let Some(png) = &args.png {
                output::check_numbered(&output::numbered(png, eye, frame), "--png")?;
            }
        }
    }
    let device = match (device, args.denoise) {
        (Some(device), None) => device,
        (_, denoise) => {
            let denoise = denoise.unwrap_or(Denoise::Off);
            return render_live::run(args, denoise, &sequence, |camera| eyes(&sequence, camera));
        }
    };
    let mut load_seconds = started.elapsed().as_secs_f64();

    let mut totals = Totals::default();
    let mut notices = Vec::new();
    let mut empty = None;
    'images: for index in 0..sequence.frames() {
        let scene = sequence.frame(index)?;
        let frame = (sequence.frames() > 1).then_some(index);
        for (eye, camera) in eyes(&sequence, &scene.camera) {
            let scene = Scene {
                camera,
                ..scene.clone()
            };
            let name = label(eye, frame);
            let bar = Bar::new(&name);
            let goal = Goal::from(args.effort);
            let traced = device.trace(&scene, args.seed, goal, &mut |part, spp| {
                bar.set(part, &format!("{spp} spp"));
            })?;
            drop(bar);
            load_seconds += traced.prepare_seconds;
            for notice in &traced.notices {
                if !notices.contains(notice) {
                    eprintln!("note: {notice}");
                    notices.push(notice.clone());
                }
            }
            write(args, &sequence, &scene, &traced.image, eye, frame)?;
            totals.add(traced);
            totals.files.push(output::numbered(&args.out, eye, frame));
            empty.get_or_insert(scene);
            if interrupt::is_asked() {
                break 'images;
            }
        }
    }
    if let Some(scene) = empty.filter(|_| totals.mean[3] == 0.0) {
        eprintln!("note: {}", why_empty(&scene));
    }

    let camera = sequence.file().camera;
    let images = totals.images.max(1) as f64;
    let [r, g, b, mean_opacity] = totals.mean.map(|sum| sum / images);
    print_json(&Line {
        out: &args.out,
        adapter: device.adapter(),
        driver: device.driver(),
        backend: match args.device.backend {
            Backend::Gpu => "gpu",
            Backend::Reference => "reference",
        },
        interpolation: match args.device.interpolation {
            Interpolation::Exact => "exact",
            Interpolation::Hardware => "hardware",
        },
        seed: args.seed,
        width: camera.width,
        height: camera.height,
        images: totals.images,
        spp: totals.spp.unwrap_or(0),
        seconds: totals.seconds,
        load_seconds,
        samples_per_second: totals.samples / totals.seconds.max(1e-9),
        mean_rgb: [r, g, b],
        mean_opacity,
        files: &totals.files,
    })?;
    if interrupt::is_asked() {
        return Err(Failure::new(
            Exit::Interrupted,
            format!(
                "stopped; {} of {} images written, the last with {} samples per pixel",
                totals.images,
                u64::from(sequence.frames()) * if sequence.ipd().is_some() { 2 } else { 1 },
                totals.spp.unwrap_or(0),
            ),
        ));
    }
    check(&totals.faults, args.device.interpolation)
}

/// The likeliest reason why nothing of the volume is seen.
fn why_empty(scene: &Scene) -> String {
    let points = scene.transfer_function.points();
    if points.iter().all(|point| point.sigma_t == 0.0) {
        return "nothing is seen: sigma_t is 0 at every point of `transfer_function`".into();
    }
    let [lo, hi] = scene.window;
    let [low, high] = scene.volume.range();
    let s = |value: f64| (value - lo) / (hi - lo);
    let (from, to) = (s(low).min(s(high)), s(low).max(s(high)));
    let is_visible = |s: f64| scene.transfer_function.eval(s).sigma_t > 0.0;
    let inside = points
        .iter()
        .map(|p| p.s)
        .filter(|s| (from..=to).contains(s));
    if ![from, to].into_iter().chain(inside).any(is_visible) {
        return format!(
            "nothing is seen: the values {low} to {high} are s = {from:.3} to {to:.3} in the window [{lo}, {hi}], where sigma_t is 0"
        );
    }
    let centre = scene
        .world_from_unit_cube
        .transform_point3(glam::DVec3::splat(0.5));
    let size = (0..3)
        .map(|axis| scene.world_from_unit_cube.col(axis).truncate().length())
        .fold(0.0, f64::max);
    let distance = centre.distance(scene.camera.eye);
    let seen = size / distance.max(1e-30) / scene.camera.fov_y * f64::from(scene.camera.height);
    if seen < 2.0 {
        return format!(
            "nothing is seen: the volume is {size:.3} m large and {distance:.3} m away, less than two pixels; lengths are in metres"
        );
    }
    format!(
        "nothing is seen: the volume's centre is at {:.3?} m, the camera at {:.3?} looks elsewhere or through empty parts",
        centre.to_array(),
        scene.camera.eye.to_array()
    )
}

/// Reads the scene, with the size and number of frames that the user wants.
fn load(args: &RenderArgs) -> Result<Sequence, Failure> {
    let mut file = SceneFile::read(&args.scene)?;
    resize(&mut file, args.width, args.height)?;
    let base = args.scene.parent().unwrap_or(Path::new(""));
    let bar = Bar::new("loading");
    let sequence = Sequence::new(&file, base, &mut |progress| {
        bar.set(progress.fraction(), "");
    })
    .map_err(|error| error.in_file(&args.scene))?;
    let Some(frames) = args.frames else {
        return Ok(sequence);
    };
    if file.animation.is_none() && args.denoise.is_none() {
        return Err(Failure::new(
            Exit::Usage,
            format!(
                "--frames: {} has no `animation`; add one, or leave --frames out",
                args.scene.display()
            ),
        ));
    }
    Ok(sequence.with_frames(frames)?)
}

/// Overrides the image size; one side alone keeps the shape.
fn resize(file: &mut SceneFile, width: Option<u32>, height: Option<u32>) -> Result<(), Failure> {
    let camera = &mut file.camera;
    let follow = |given: u32, from: u32, side: u32| {
        let scaled = u64::from(given) * u64::from(side) + u64::from(from) / 2;
        u32::try_from(scaled / u64::from(from))
            .unwrap_or(u32::MAX)
            .max(1)
    };
    (camera.width, camera.height) = match (width, height) {
        (None, None) => return Ok(()),
        (Some(width), Some(height)) => (width, height),
        (Some(width), None) => (width, follow(width, camera.width, camera.height)),
        (None, Some(height)) => (follow(height, camera.height, camera.width), height),
    };
    file.validate()
        .map_err(|error| Failure::new(Exit::Usage, format!("--width, --height: {error}")))
}

/// The cameras of one frame, with the names of the eyes.
fn eyes(sequence: &Sequence, camera: &Camera) -> Vec<(Option<&'static str>, Camera)> {
    match sequence.ipd() {
        None => vec![(None, *camera)],
        Some(ipd) => {
            let [left, right] = camera.stereo(ipd);
            vec![(Some("left"), left), (Some("right"), right)]
        }
    }
}

fn label(eye: Option<&str>, frame: Option<u32>) -> String {
    match (eye, frame) {
        (None, None) => "rendering".into(),
        (Some(eye), None) => eye.into(),
        (None, Some(frame)) => format!("frame {frame}"),
        (Some(eye), Some(frame)) => format!("{frame} {eye}"),
    }
}

fn write(
    args: &RenderArgs,
    sequence: &Sequence,
    scene: &Scene,
    image: &Image,
    eye: Option<&str>,
    frame: Option<u32>,
) -> Result<(), Failure> {
    output::write_exr(image, &output::numbered(&args.out, eye, frame))?;
    let Some(png) = &args.png else { return Ok(()) };
    let settings = sequence.file().output.unwrap_or_default();
    let picture = picture::develop(image, &settings, &scene.camera, &scene.environment);
    output::write_png(&picture, &output::numbered(png, eye, frame))
}

/// Fails where the accuracy path must not be silent; the fast path only tells.
fn check(faults: &[String], interpolation: Interpolation) -> Result<(), Failure> {
    if faults.is_empty() {
        return Ok(());
    }
    let message = faults.join("; ");
    if interpolation == Interpolation::Hardware {
        eprintln!("warning: {message}");
        return Ok(());
    }
    Err(Failure::new(Exit::Inexact, message))
}

impl Totals {
    fn add(&mut self, traced: Traced) {
        let pixels = traced.image.pixels();
        let mut sum = [0.0; 4];
        for pixel in pixels {
            for (sum, &channel) in sum.iter_mut().zip(pixel) {
                *sum += f64::from(channel);
            }
        }
        for (mean, sum) in self.mean.iter_mut().zip(sum) {
            *mean += sum / pixels.len() as f64;
        }
        self.images += 1;
        self.spp = Some(self.spp.map_or(traced.spp, |spp| spp.min(traced.spp)));
        self.samples += traced.spp as f64 * pixels.len() as f64;
        self.seconds += traced.seconds;
        for fault in traced.faults {
            if !self.faults.contains(&fault) {
                self.faults.push(fault);
            }
        }
    }
}
