//! `holovol light`: LDR panoramas to HDR light.

pub(crate) mod input;
mod jpeg;
mod notes;
#[cfg(feature = "preview")]
mod panorama;
pub(crate) mod preview;
pub(crate) mod stitch;

use std::f64::consts::PI;
use std::path::{Path, PathBuf};
use std::time::Instant;

use glam::DVec3;
use holovol_light::estimate::{
    Doubt, Estimator, Evidence, Exposure, LightClass, Meter, PROBE_DIRECTIONS, Prior, ProbeSample,
    Rung, distinct_directions,
};
use holovol_light::measure::{add_to_spherical_harmonics, spherical_harmonics};
use holovol_reference::Image;
use serde::Serialize;

use crate::cli::LightArgs;
use crate::{Exit, Failure, output, print_json};
use input::Linear;
#[cfg(feature = "preview")]
pub(crate) use panorama::{Panorama, panorama};

/// What `light` reports.
#[derive(Serialize)]
struct Report {
    out: PathBuf,
    width: usize,
    height: usize,
    rung: &'static str,
    sigma_ev: f64,
    /// Radiance at which the darkest frame clips.
    ceiling: f64,
    /// Share of the sphere that clips in the first frame.
    clipped: f64,
    sky: SkyReport,
    lights: Vec<LightReport>,
    sh9: [[f32; 3]; 9],
    seconds: f64,
    notes: Vec<String>,
}

#[derive(Serialize)]
struct SkyReport {
    blue_over_red: f64,
    clearness: f64,
}

/// A light in the report.
#[derive(Serialize)]
pub(crate) struct LightReport {
    class: &'static str,
    pub(crate) direction: [f64; 3],
    pub(crate) solid_angle: f64,
    /// Irradiance facing it.
    intensity: [f64; 3],
    radiance: [f64; 3],
    sigma_ev: f64,
    pub(crate) disc: bool,
}

/// An exposure as an option of the command line names it: `PANO` or `PANO@EV`.
fn exposure(option: &str, text: &str) -> Result<(PathBuf, f64), Failure> {
    // A file may have an @ in its name; only a number behind the last one is an exposure.
    if let Some((path, ev)) = text.rsplit_once('@')
        && let Ok(ev) = ev.parse::<f64>()
    {
        if ev.is_nan() || ev.abs() > 40.0 {
            return Err(Failure::new(
                Exit::Usage,
                format!("{option} {text}: an exposure of {ev} EV, expected −40 … 40"),
            ));
        }
        return Ok((path.into(), ev));
    }
    Ok((text.into(), 0.0))
}

/// Refuses what would be given beside a picture that holds all radiance.
fn check_alone(text: &str, args: &LightArgs) -> Result<(), Failure> {
    let beside = [
        (args.ldr.len() > 1, "other exposures have"),
        (args.lux.is_some(), "--lux has"),
        (args.probe.is_some(), "--probe has"),
    ];
    match beside.into_iter().find(|(given, _)| *given) {
        None => Ok(()),
        Some((_, what)) => Err(Failure::new(
            Exit::Usage,
            format!(
                "--ldr {text}: it has radiance above 1, so that it is HDR already and {what} nothing to add; give it alone, or save exposures clipped at 1 (a scene's environment.scale brings an HDR panorama to a measured brightness)"
            ),
        )),
    }
}

/// Refuses to write over what is read.
fn check_inputs_stay(args: &LightArgs, inputs: &[PathBuf]) -> Result<(), Failure> {
    let same = |a: &Path, b: &Path| match (a.canonicalize(), b.canonicalize()) {
        (Ok(a), Ok(b)) => a == b,
        _ => false,
    };
    let outputs = [
        ("--out", Some(&args.out)),
        ("--report", args.report.as_ref()),
        ("--preview", args.preview.as_ref()),
    ];
    for (option, out) in outputs {
        if let Some(out) = out.filter(|out| inputs.iter().any(|input| same(input, out))) {
            return Err(Failure::new(
                Exit::Output,
                format!(
                    "{option} {}: it is read, too, and would be lost; choose another name",
                    out.display()
                ),
            ));
        }
    }
    Ok(())
}

pub(crate) fn run(args: &LightArgs) -> Result<(), Failure> {
    let hdr_out = args
        .out
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("hdr"));
    if !hdr_out
        && args
            .out
            .extension()
            .is_none_or(|e| !e.eq_ignore_ascii_case("exr"))
    {
        return Err(Failure::new(
            Exit::Output,
            format!(
                "--out {}: expected a file name that ends in .exr or .hdr",
                args.out.display()
            ),
        ));
    }
    output::check(&args.out, if hdr_out { "hdr" } else { "exr" }, "--out")?;
    if let Some(report) = &args.report {
        output::check(report, "json", "--report")?;
    }
    if let Some(preview) = &args.preview {
        output::check(preview, "png", "--preview")?;
    }
    let given = [&args.probe, &args.prior].into_iter().flatten().cloned();
    let named = args.ldr.iter().map(|text| exposure("--ldr", text));
    let inputs: Vec<PathBuf> = named
        .map(|named| named.map(|(path, _)| path))
        .chain(given.map(Ok))
        .collect::<Result<_, _>>()?;
    check_inputs_stay(args, &inputs)?;
    let response = input::response(&args.crf)?;
    let mut notes = Vec::new();
    let mut frames: Vec<(f64, Linear, &str)> = Vec::new();
    for text in &args.ldr {
        let (path, ev) = exposure("--ldr", text)?;
        let mut picture = input::linear(&path, &response)?;
        notes.append(&mut picture.notes);
        if picture.hdr {
            check_alone(text, args)?;
        }
        frames.push((ev, picture, text));
    }
    let base = frames[0].0;
    let unseen_sigma_ev = frames[0].1.unseen_sigma_ev;
    let (width, height) = (frames[0].1.width, frames[0].1.height);
    for (ev, frame, text) in &mut frames {
        *ev -= base;
        if (frame.width, frame.height) != (width, height) {
            return Err(Failure::new(
                Exit::Input,
                format!(
                    "--ldr {text}: {} × {} pixels, but the first frame has {width} × {height}; all must show the same view",
                    frame.width, frame.height
                ),
            ));
        }
    }
    if width != 2 * height {
        notes.push(format!(
            "{width} × {height} pixels is not 2 : 1; taken for the whole sphere, stretched"
        ));
    }
    frames.sort_by(|a, b| b.0.total_cmp(&a.0));
    if frames.windows(2).any(|pair| pair[0].0 == pair[1].0) {
        return Err(Failure::new(
            Exit::Usage,
            "two frames have the same exposure; say which with PANO@EV, as in dark.png@-6",
        ));
    }
    let probe = args.probe.as_deref().map(read_probe).transpose()?;
    if let Some(lux) = args.lux
        && !(lux.is_finite() && lux > 0.0)
    {
        return Err(Failure::new(
            Exit::Usage,
            format!("--lux {lux}: expected an irradiance above 0"),
        ));
    }

    let prior = args.prior.as_deref().map(read_prior).transpose()?;

    let started = Instant::now();
    let mut map = Vec::new();
    let mut estimator = Estimator::new(width, height, prior.unwrap_or_default());
    let passes_through = frames.len() == 1 && frames[0].1.hdr;
    if passes_through {
        notes.push("the picture is HDR already: its radiance is passed through".into());
        map.clone_from(&frames[0].1.texels);
    } else {
        let exposures: Vec<Exposure> = frames
            .iter()
            .map(|(ev, frame, _)| Exposure {
                ev: *ev,
                radiance: &frame.texels,
            })
            .collect();
        estimator.estimate(&Evidence {
            frames: &exposures,
            meter: args.lux.map(Meter::upward),
            probe: probe.as_deref(),
        });
        estimator.write_map(&mut map);
        let names = notes::Names {
            frames: frames.iter().map(|(_, _, text)| *text).collect(),
            lux: args.lux,
            probe: args.probe.iter().map(|p| p.display().to_string()).collect(),
        };
        notes.extend(
            estimator
                .doubts()
                .iter()
                .map(|doubt| notes::doubt(doubt, &names)),
        );
        let compared = |doubt: &Doubt| matches!(doubt, Doubt::Meter { .. });
        if args.lux.is_some()
            && estimator.rung() == Rung::Probe
            && !estimator.doubts().iter().any(compared)
        {
            notes.push(
                "--lux agrees with the probe, which says more: only the probe is used".into(),
            );
        }
    }
    let mut sh9 = spherical_harmonics(
        estimator.grid(),
        if passes_through {
            &map
        } else {
            estimator.radiance()
        },
    );
    for light in estimator.lights().iter().filter(|light| light.disc) {
        add_to_spherical_harmonics(&mut sh9, light.direction, light.irradiance);
    }
    let seconds = started.elapsed().as_secs_f64();

    let clipped = clipped_share(&frames[0].1, estimator.grid());
    if clipped > 0.5 && !passes_through {
        notes.push(format!(
            "{:.0} % of the sphere is clipped: little can be known of the light; expose less",
            100.0 * clipped
        ));
    }
    let report = Report {
        out: args.out.clone(),
        width,
        height,
        rung: if passes_through {
            "hdr"
        } else {
            estimator.rung().name()
        },
        sigma_ev: estimator.sigma_ev().hypot(unseen_sigma_ev),
        ceiling: f64::from(estimator.ceiling()),
        clipped,
        sky: SkyReport {
            blue_over_red: estimator.sky().blue_over_red,
            clearness: estimator.sky().clearness,
        },
        lights: estimator.lights().iter().map(LightReport::new).collect(),
        sh9,
        seconds,
        notes,
    };
    for note in &report.notes {
        eprintln!("note: {note}");
    }
    write_map(&args.out, hdr_out, width, height, &map)?;
    if let Some(path) = &args.preview {
        let picture = preview::draw(&frames[0].1, &report.lights);
        output::write_png(&picture, path)?;
    }
    if let Some(path) = &args.report {
        let text = serde_json::to_string_pretty(&report)
            .map_err(|error| Failure::new(Exit::Internal, error.to_string()))?;
        output::write_text(&(text + "\n"), path)?;
    }
    print_json(&report)
}

impl LightReport {
    fn new(light: &holovol_light::estimate::Light) -> Self {
        let solid_angle = light.solid_angle.max(1e-9);
        Self {
            class: match light.class {
                LightClass::Sun => "sun",
                LightClass::Lamp => "lamp",
                LightClass::Window => "window",
                LightClass::Reflection => "reflection",
            },
            direction: light.direction.to_array(),
            solid_angle: light.solid_angle,
            intensity: light.irradiance,
            radiance: light.irradiance.map(|e| e / solid_angle),
            sigma_ev: light.sigma_ev,
            disc: light.disc,
        }
    }
}

fn clipped_share(frame: &Linear, grid: &holovol_light::Grid) -> f64 {
    let rows = frame.texels.chunks_exact(grid.width()).enumerate();
    let clipped = rows.map(|(y, row)| {
        let count = row
            .iter()
            .filter(|texel| texel.iter().any(|&c| c >= holovol_light::estimate::CLIPPED))
            .count();
        count as f64 * f64::from(grid.solid_angle(y))
    });
    clipped.sum::<f64>() / (4.0 * PI)
}

/// Writes a map as EXR (32-bit float) or Radiance HDR.
fn write_map(
    path: &Path,
    hdr: bool,
    width: usize,
    height: usize,
    map: &[[f32; 3]],
) -> Result<(), Failure> {
    if hdr {
        let pixels: Vec<image::Rgb<f32>> = map.iter().map(|&texel| image::Rgb(texel)).collect();
        let mut bytes = Vec::new();
        image::codecs::hdr::HdrEncoder::new(&mut bytes)
            .encode(&pixels, width, height)
            .map_err(|error| Failure::new(Exit::Output, format!("{}: {error}", path.display())))?;
        return output::write_whole(path, &bytes);
    }
    let pixels = map.iter().map(|&[r, g, b]| [r, g, b, 1.0]).collect();
    output::write_exr(&Image::new(width as u32, height as u32, pixels), path)
}

/// Reads a prior: the object `prior` of what `holovol bench light` prints.
fn read_prior(path: &Path) -> Result<Prior, Failure> {
    let input =
        |problem: String| Failure::new(Exit::Input, format!("{}: {problem}", path.display()));
    let text = std::fs::read_to_string(path).map_err(|error| input(error.to_string()))?;
    let prior: Prior = serde_json::from_str(&text).map_err(|error| {
        input(format!(
            "not a prior ({error}); expected the object \"prior\" of what holovol bench light prints"
        ))
    })?;
    match prior.invalid_field() {
        None => Ok(prior),
        Some(field) => Err(input(format!(
            "{field} is out of range; holovol bench light fits priors to panoramas of your own"
        ))),
    }
}

/// Reads a probe: a JSON list of `{"normal": [x, y, z], "irradiance": [r, g, b]}`.
fn read_probe(path: &Path) -> Result<Vec<ProbeSample>, Failure> {
    #[derive(serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Entry {
        normal: [f64; 3],
        irradiance: [f64; 3],
    }
    let input =
        |problem: String| Failure::new(Exit::Input, format!("{}: {problem}", path.display()));
    let text = std::fs::read_to_string(path).map_err(|error| input(error.to_string()))?;
    let entries: Vec<Entry> = serde_json::from_str(&text).map_err(|error| {
        input(format!(
            "not a probe ({error}); expected [{{\"normal\": [x, y, z], \"irradiance\": [r, g, b]}}, …]"
        ))
    })?;
    let samples: Vec<ProbeSample> = entries
        .iter()
        .filter_map(|entry| {
            let normal = DVec3::from_array(entry.normal).try_normalize()?;
            let valid = entry.irradiance.iter().all(|e| e.is_finite() && *e >= 0.0);
            valid.then_some(ProbeSample {
                normal,
                irradiance: entry.irradiance,
            })
        })
        .collect();
    if samples.len() != entries.len() || samples.len() < 4 {
        return Err(input(format!(
            "{} of {} samples can be used; expected at least 4, all with a direction and irradiance of 0 and more",
            samples.len(),
            entries.len()
        )));
    }
    let directions = distinct_directions(&samples);
    if directions < PROBE_DIRECTIONS {
        return Err(input(format!(
            "its {} samples look in {directions} direction{} only; expected at least {PROBE_DIRECTIONS}, 15° or more from each other (for one direction there is --lux)",
            samples.len(),
            if directions == 1 { "" } else { "s" }
        )));
    }
    Ok(samples)
}
