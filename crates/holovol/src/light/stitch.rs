//! `holovol stitch` and `holovol calibrate`.

use std::io::Read as _;
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

/// A picture with more of its lit pixels outside the field of view is another camera's; with both
/// lenses' circles in one picture it's a half.
const MOST_OUTSIDE: f64 = 0.6;
/// Less of the sphere is not worth a note.
const LEAST_UNSEEN: f64 = 5e-4;

#[derive(Serialize)]
struct Stitched<'a> {
    out: &'a Path,
    width: usize,
    height: usize,
    gains: [f32; 2],
    /// Share of the sphere that neither lens sees.
    unseen: f64,
    seconds: f64,
}

pub(crate) fn run(args: &StitchArgs) -> Result<(), Failure> {
    output::check(&args.out, "png", "--out")?;
    let (wa, ha, a) = rgb8(&args.a)?;
    let (wb, hb, b) = rgb8(&args.b)?;
    let calibration = match &args.calibration {
        Some(path) => Calibration::load(path)?
            .for_sizes([[wa, ha], [wb, hb]])
            .map_err(|error| error.in_file(path))?,
        None => nominal([[wa, ha], [wb, hb]], args.fov, "--calibration")?,
    };
    let width = args.width as usize;
    let mut stitcher = Stitcher::new(&calibration, width, width / 2, DMat3::IDENTITY)?;
    let mut panorama = vec![[0.0; 3]; width * (width / 2)];
    let started = std::time::Instant::now();
    stitcher.stitch(&FisheyePair { pictures: [&a, &b] }, &mut panorama)?;
    let seconds = started.elapsed().as_secs_f64();
    for (lens, (path, picture)) in [(&args.a, &a), (&args.b, &b)].into_iter().enumerate() {
        let outside = calibration.lenses[lens].lit_outside(picture);
        if outside > MOST_OUTSIDE {
            eprintln!(
                "note: {}: {:.0} % of what is lit in it lies outside lenses[{lens}]'s field of view; the calibration seems to be for other pictures",
                path.display(),
                100.0 * outside
            );
        }
    }
    let unseen = stitcher.unseen();
    if unseen > LEAST_UNSEEN {
        eprintln!(
            "note: neither lens sees {:.1} % of the sphere, which is black in {}; is the field of view right (fov_deg, or --fov without a calibration)?",
            100.0 * unseen,
            args.out.display()
        );
    }
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
        unseen,
        seconds,
    })
}

/// Two equidistant lenses for pictures of one size; `option` names a file that could say better.
fn nominal(sizes: [[usize; 2]; 2], fov: f64, option: &str) -> Result<Calibration, Failure> {
    if sizes[0] != sizes[1] {
        return Err(Failure::new(
            Exit::Input,
            format!(
                "the pictures have {:?} and {:?} pixels; without {option} both must be alike",
                sizes[0], sizes[1]
            ),
        ));
    }
    Ok(Calibration::nominal(sizes[0], fov))
}

#[derive(Serialize)]
struct Calibrated<'a> {
    out: &'a Path,
    /// What the file holds: a calibration or a response.
    kind: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    agreement: Option<f64>,
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
        kind: "calibration",
        agreement: None,
        disagreement: None,
        compared: None,
        response: "as given",
    };
    let pair = match args.pair.as_slice() {
        [] => None,
        [a, b] => Some((rgb8(a)?, rgb8(b)?)),
        _ => return Err(Failure::new(Exit::Usage, "--pair takes two pictures")),
    };
    if args.crf.is_some() && !args.series.is_empty() {
        return Err(Failure::new(
            Exit::Usage,
            "--crf and --series exclude each other: one gives the response, one fits it",
        ));
    }
    let mut calibration = match (&args.start, &args.insta360, &pair) {
        (Some(path), None, _) => Calibration::load(path)?,
        (None, Some(text), _) => Calibration::from_insta360_offset(text)?,
        (None, None, Some(((w, h, _), (v, g, _)))) => {
            nominal([[*w, *h], [*v, *g]], args.fov, "--start")?
        }
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
        (None, None, None) => {
            // Of the lenses nothing is known: the response alone, as --crf reads it.
            (line.kind, line.response) = ("response", "fitted");
            write_json(&series(&args.series)?, &args.out)?;
            return print_json(&line);
        }
    };
    if let Some(crf) = &args.crf {
        calibration.response = response(crf)?;
    }
    if !args.series.is_empty() {
        calibration.response = series(&args.series)?;
        line.response = "fitted";
    }
    if let Some(((wa, ha, a), (wb, hb, b))) = &pair {
        for (path, picture) in args.pair.iter().zip([a, b]) {
            let check = blind_check(picture);
            if check.gaps > 0.2 {
                eprintln!(
                    "note: {}: {:.0} % of the codes are never used; the picture seems to be edited",
                    path.display(),
                    100.0 * check.gaps
                );
            }
        }
        let sizes = [[*wa, *ha], [*wb, *hb]];
        let start = calibration.for_sizes(sizes).map_err(|error| {
            let source = args.start.as_deref().unwrap_or(Path::new("--insta360"));
            error.in_file(source)
        })?;
        let refined = refine(&start, &FisheyePair { pictures: [a, b] }).map_err(|error| {
            let [a, b] = [0, 1].map(|i| args.pair[i].display());
            Failure::new(Exit::Input, format!("--pair {a} {b}: {error}"))
        })?;
        line.agreement = Some(refined.agreement);
        line.disagreement = Some(refined.disagreement);
        line.compared = Some(refined.compared);
        calibration = refined.calibration;
    }
    write_json(&calibration, &args.out)?;
    print_json(&line)
}

fn write_json(value: &impl Serialize, path: &Path) -> Result<(), Failure> {
    let text = serde_json::to_string_pretty(value)
        .map_err(|error| Failure::new(Exit::Internal, error.to_string()))?;
    output::write_text(&(text + "\n"), path)
}

fn is_jpeg_file(path: &Path) -> bool {
    let mut start = [0; 2];
    let read = std::fs::File::open(path).and_then(|mut file| file.read_exact(&mut start));
    read.is_ok() && super::jpeg::is_jpeg(&start)
}

/// Fits the response to `PICTURE@EV …`.
fn series(entries: &[String]) -> Result<holovol_light::response::Response, Failure> {
    let mut pictures = Vec::new();
    let mut first = None;
    for text in entries {
        let (path, ev) = super::exposure("--series", text)?;
        if is_jpeg_file(&path) {
            return Err(Failure::new(
                Exit::Input,
                format!(
                    "--series {text}: a JPEG, whose coding bends the fit (by a factor of up to 4 in trials); give PNG made from raw or uncompressed pictures, or use --crf srgb"
                ),
            ));
        }
        let (width, height, pixels) = rgb8(&path)?;
        let (across, down) = *first.get_or_insert((width, height));
        if (width, height) != (across, down) {
            return Err(Failure::new(
                Exit::Input,
                format!(
                    "--series {text}: {width} × {height} pixels, but the first picture has {across} × {down}; all must show the same view"
                ),
            ));
        }
        pictures.push((ev, pixels));
    }
    let frames: Vec<SeriesFrame> = pictures
        .iter()
        .map(|(ev, pixels)| SeriesFrame { ev: *ev, pixels })
        .collect();
    fit_response(&frames)
        .map_err(|problem| Failure::new(Exit::Input, format!("--series: {problem}")))
}
