//! `holovol stitch` and `holovol calibrate`.

use std::path::Path;

use glam::DMat3;
use holovol_light::lens::{Calibration, CalibrationError, FisheyePair, Stitcher, refine};
use holovol_light::response::{SeriesFrame, blind_check, fit_response, linear_to_srgb};
use serde::Serialize;

use super::input::{response, rgb8};
use crate::cli::{CalibrateArgs, StitchArgs};
use crate::output::Picture;
use crate::{Exit, Failure, output, print_json};

impl From<CalibrationError> for Failure {
    fn from(error: CalibrationError) -> Self {
        Self::new(Exit::Input, error.to_string())
    }
}

#[derive(Serialize)]
struct Stitched<'a> {
    out: &'a Path,
    width: usize,
    height: usize,
    gains: [f32; 2],
    seconds: f64,
}

pub(crate) fn run(args: &StitchArgs) -> Result<(), Failure> {
    output::check(&args.out, "png", "--out")?;
    let (wa, ha, a) = rgb8(&args.a)?;
    let (wb, hb, b) = rgb8(&args.b)?;
    let calibration = match &args.calibration {
        Some(path) => Calibration::load(path)?.for_sizes([[wa, ha], [wb, hb]])?,
        None => nominal([[wa, ha], [wb, hb]], args.fov)?,
    };
    let width = args.width as usize;
    let mut stitcher = Stitcher::new(&calibration, width, width / 2, DMat3::IDENTITY)?;
    let mut panorama = vec![[0.0; 3]; width * (width / 2)];
    let started = std::time::Instant::now();
    stitcher.stitch(&FisheyePair { pictures: [&a, &b] }, &mut panorama)?;
    let seconds = started.elapsed().as_secs_f64();
    let code = |l: f32| (linear_to_srgb(f64::from(l.clamp(0.0, 1.0))) * 255.0).round() as u8;
    let picture = Picture {
        width: width as u32,
        height: (width / 2) as u32,
        pixels: panorama
            .iter()
            .map(|&[r, g, b]| [code(r), code(g), code(b), 255])
            .collect(),
    };
    output::write_png(&picture, &args.out)?;
    print_json(&Stitched {
        out: &args.out,
        width,
        height: width / 2,
        gains: stitcher.gains(),
        seconds,
    })
}

fn nominal(sizes: [[usize; 2]; 2], fov: f64) -> Result<Calibration, Failure> {
    if sizes[0] != sizes[1] {
        return Err(Failure::new(
            Exit::Input,
            format!(
                "the pictures have {:?} and {:?} pixels; without --calibration both must be alike",
                sizes[0], sizes[1]
            ),
        ));
    }
    Ok(Calibration::nominal(sizes[0], fov))
}

#[derive(Serialize)]
struct Calibrated<'a> {
    out: &'a Path,
    #[serde(skip_serializing_if = "Option::is_none")]
    disagreement: Option<[f64; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    compared: Option<usize>,
    response: &'static str,
}

pub(crate) fn calibrate(args: &CalibrateArgs) -> Result<(), Failure> {
    output::check(&args.out, "json", "--out")?;
    let mut line = Calibrated {
        out: &args.out,
        disagreement: None,
        compared: None,
        response: "as given",
    };
    let pair = match args.pair.as_slice() {
        [] => None,
        [a, b] => Some((rgb8(a)?, rgb8(b)?)),
        _ => return Err(Failure::new(Exit::Usage, "--pair takes two pictures")),
    };
    let mut calibration = match (&args.start, &args.insta360, &pair) {
        (Some(path), None, _) => Calibration::load(path)?,
        (None, Some(text), _) => Calibration::from_insta360_offset(text)?,
        (None, None, Some(((w, h, _), (v, g, _)))) => nominal([[*w, *h], [*v, *g]], args.fov)?,
        (Some(_), Some(_), _) => {
            return Err(Failure::new(
                Exit::Usage,
                "--start and --insta360 exclude each other",
            ));
        }
        (None, None, None) if args.series.is_empty() => {
            return Err(Failure::new(
                Exit::Usage,
                "nothing to calibrate from; give --pair A B, --start, --insta360 or --series",
            ));
        }
        (None, None, None) => Calibration::nominal([1, 1], args.fov),
    };
    if let Some(crf) = &args.crf {
        calibration.response = response(crf)?;
    }
    if !args.series.is_empty() {
        calibration.response = series(&args.series)?;
        line.response = "fitted";
    }
    if let Some(((wa, ha, a), (wb, hb, b))) = &pair {
        for picture in [a, b] {
            let check = blind_check(picture);
            if check.gaps > 0.2 {
                eprintln!(
                    "note: {:.0} % of the codes are never used; the picture seems to be edited",
                    100.0 * check.gaps
                );
            }
        }
        let start = calibration.for_sizes([[*wa, *ha], [*wb, *hb]])?;
        let refined = refine(&start, &FisheyePair { pictures: [a, b] })?;
        line.disagreement = Some(refined.disagreement);
        line.compared = Some(refined.compared);
        calibration = refined.calibration;
    }
    output::write_text(&(calibration.to_json() + "\n"), &args.out)?;
    print_json(&line)
}

/// Fits the response to `PICTURE@EV …`.
fn series(entries: &[String]) -> Result<holovol_light::response::Response, Failure> {
    let mut pictures = Vec::new();
    for text in entries {
        let (path, ev) = super::exposure(text)?;
        pictures.push((ev, rgb8(&path)?.2));
    }
    let frames: Vec<SeriesFrame> = pictures
        .iter()
        .map(|(ev, pixels)| SeriesFrame { ev: *ev, pixels })
        .collect();
    fit_response(&frames)
        .map_err(|problem| Failure::new(Exit::Input, format!("--series: {problem}")))
}
