//! `holovol info`: what is in a volume or a scene file.

use std::fmt::Write;
use std::io::Read;
use std::path::{Path, PathBuf};

use glam::DMat4;
use holovol_scene::{SceneFile, Sequence};
use holovol_volume::{Content, Volume, VolumeError};
use serde::Serialize;

use crate::cli::InfoArgs;
use crate::progress::Bar;
use crate::{Exit, Failure, output, print_bytes, print_json, thumbnail};

/// The percentiles that are told.
const PERCENTS: [f64; 7] = [0.1, 1.0, 25.0, 50.0, 75.0, 99.0, 99.9];

#[derive(Serialize)]
struct VolumeInfo {
    path: PathBuf,
    dims: [u32; 3],
    voxels: u64,
    kind: &'static str,
    bytes: u64,
    slope: f64,
    intercept: f64,
    /// Metres.
    spacing: [f64; 3],
    /// Metres.
    size: [f64; 3],
    /// Where i, j, k point to in the patient; null if the header doesn't say.
    orientation: Option<String>,
    world_from_unit_cube: [[f64; 4]; 4],
    /// Of the values, where the file says it.
    unit: Option<String>,
    range: [f64; 2],
    mean: f64,
    /// [percent, value] pairs.
    percentiles: Vec<[f64; 2]>,
    header_window: Option<[f64; 2]>,
    header_windows: Vec<WindowInfo>,
    /// Whether the values are names of something; null if the file doesn't say.
    labels: Option<Vec<LabelInfo>>,
    auto_window: [f64; 2],
    nan_voxels: u64,
    infinite_voxels: u64,
    notices: Vec<String>,
}

#[derive(Serialize)]
struct WindowInfo {
    name: String,
    window: [f64; 2],
}

#[derive(Serialize)]
struct LabelInfo {
    value: f64,
    name: String,
}

#[derive(Serialize)]
struct SceneInfo {
    path: PathBuf,
    width: u32,
    height: u32,
    frames: u32,
    stereo: bool,
    max_scatters: Option<u32>,
    phase_g: f64,
    gradient_factor: f64,
    transfer_function_points: usize,
    window: [f64; 2],
    environment: EnvironmentInfo,
    notices: Vec<String>,
    volume: VolumeInfo,
}

#[derive(Serialize)]
struct EnvironmentInfo {
    path: Option<PathBuf>,
    width: usize,
    height: usize,
    max: f32,
    rotation_y_deg: f64,
    scale: f64,
}

pub(crate) fn run(args: &InfoArgs) -> Result<(), Failure> {
    if let Some(path) = &args.thumbnail {
        output::check(path, "png", "--thumbnail")?;
    }
    let bar = Bar::new("loading");
    let mut progress = |progress: holovol_volume::Progress| {
        bar.set(progress.fraction(), "");
    };
    if is_scene(&args.file)? {
        let sequence = Sequence::load(&args.file, &mut progress)?;
        drop(bar);
        let scene = sequence.frame(0)?;
        let info = SceneInfo::new(&args.file, &sequence, &scene);
        if args.json {
            print_json(&info)?;
        } else {
            print_bytes(info.text().as_bytes())?;
        }
        return draw(
            args,
            &scene.volume,
            scene.world_from_unit_cube,
            scene.window,
        );
    }
    let options = args.input.options();
    let volume = match holovol_volume::open_with(&args.file, &options, &mut progress) {
        Ok(volume) => volume,
        // What is there to choose from is what was asked for.
        Err(VolumeError::Choose {
            path,
            what,
            contents,
        }) => {
            drop(bar);
            return list(args, &path, what, &contents);
        }
        Err(error) => return Err(error.into()),
    };
    drop(bar);
    let info = VolumeInfo::new(&args.file, &volume, volume.world_from_unit_cube());
    if args.json {
        print_json(&info)?;
    } else {
        print_bytes(info.text().as_bytes())?;
    }
    let window = volume.header_window().unwrap_or(info.auto_window);
    draw(args, &volume, volume.world_from_unit_cube(), window)
}

#[derive(Serialize)]
struct ContentInfo<'a> {
    number: usize,
    name: &'a str,
    description: &'a str,
    dims: Option<[u64; 3]>,
    /// Metres.
    spacing: Option<[f64; 3]>,
}

/// Tells what can be chosen from.
fn list(args: &InfoArgs, path: &Path, what: &str, contents: &[Content]) -> Result<(), Failure> {
    let infos: Vec<ContentInfo<'_>> = contents
        .iter()
        .enumerate()
        .map(|(index, content)| ContentInfo {
            number: index + 1,
            name: &content.name,
            description: &content.description,
            dims: content.dims,
            spacing: content.spacing,
        })
        .collect();
    if args.json {
        return print_json(&serde_json::json!({ "path": path, "contents": infos }));
    }
    let mut text = format!("{:<14}{}\n", "file", path.display());
    for info in &infos {
        let mut parts = vec![info.description.to_owned()];
        if !info.name.is_empty() {
            parts.insert(0, info.name.to_owned());
        }
        if let Some([x, y, z]) = info.dims {
            parts.push(format!("{x} × {y} × {z}"));
        }
        parts.extend(info.spacing.map(lengths));
        // Writing to a string can't fail.
        let _ = writeln!(text, "{:<14}{}", info.number, parts.join(", "));
    }
    let _ = writeln!(
        text,
        "{:<14}{} {what}: name one with --choice N",
        "note",
        infos.len()
    );
    print_bytes(text.as_bytes())
}

fn draw(
    args: &InfoArgs,
    volume: &Volume,
    world_from_unit_cube: DMat4,
    window: [f64; 2],
) -> Result<(), Failure> {
    let Some(path) = &args.thumbnail else {
        return Ok(());
    };
    output::write_png(&thumbnail::draw(volume, world_from_unit_cube, window), path)
}

/// Whether a file is a scene: by its name, or because it begins like a JSON object.
fn is_scene(path: &Path) -> Result<bool, Failure> {
    if path
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("json"))
    {
        return Ok(true);
    }
    if path.is_dir() {
        return Ok(false);
    }
    let mut start = Vec::new();
    std::fs::File::open(path)
        .and_then(|file| file.take(64).read_to_end(&mut start))
        .map_err(|error| Failure::new(Exit::Input, format!("{}: {error}", path.display())))?;
    Ok(start.trim_ascii_start().first() == Some(&b'{'))
}

impl VolumeInfo {
    fn new(path: &Path, volume: &Volume, world_from_unit_cube: DMat4) -> Self {
        let dims = volume.dims();
        let spacing = volume.geometry().spacing();
        let values = volume.percentiles(&PERCENTS);
        Self {
            path: path.into(),
            dims,
            voxels: dims.iter().map(|&n| u64::from(n)).product(),
            kind: volume.voxels().kind().name(),
            bytes: (volume.voxels().len() * volume.voxels().kind().bytes()) as u64,
            slope: volume.slope(),
            intercept: volume.intercept(),
            spacing,
            size: std::array::from_fn(|axis| spacing[axis] * f64::from(dims[axis])),
            orientation: volume.geometry().axis_codes(),
            world_from_unit_cube: world_from_unit_cube.transpose().to_cols_array_2d(),
            unit: volume.unit().map(str::to_owned),
            range: volume.range(),
            mean: volume.mean(),
            percentiles: PERCENTS
                .into_iter()
                .zip(values)
                .map(|(p, v)| [p, v])
                .collect(),
            header_window: volume.header_window(),
            header_windows: (volume.header_windows().iter())
                .map(|window| WindowInfo {
                    name: window.name.clone(),
                    window: window.window,
                })
                .collect(),
            labels: volume.labels().map(|labels| {
                (labels.iter())
                    .map(|label| LabelInfo {
                        value: label.value,
                        name: label.name.clone(),
                    })
                    .collect()
            }),
            auto_window: volume.auto_window(),
            nan_voxels: volume.replaced().nan,
            infinite_voxels: volume.replaced().infinite,
            notices: volume.notices().to_vec(),
        }
    }

    fn text(&self) -> String {
        let mut text = String::new();
        let mut line = |name: &str, value: String| {
            // Writing to a string can't fail.
            let _ = writeln!(text, "{name:<14}{value}");
        };
        let [x, y, z] = self.dims;
        line("file", self.path.display().to_string());
        line(
            "voxels",
            format!(
                "{x} × {y} × {z} = {}, {} ({})",
                self.voxels,
                self.kind,
                bytes(self.bytes)
            ),
        );
        if (self.slope, self.intercept) != (1.0, 0.0) {
            line(
                "value",
                format!(
                    "{} · stored + {}",
                    number(self.slope),
                    number(self.intercept)
                ),
            );
        }
        line("spacing", lengths(self.spacing));
        line("size", lengths(self.size));
        line(
            "orientation",
            self.orientation.as_deref().map_or_else(
                || "not recorded: i, j, k are taken for x, y, z".to_owned(),
                |codes| format!("{codes} (i, j, k point there in the patient)"),
            ),
        );
        line(
            "range",
            format!(
                "{} … {}, mean {} {}",
                number(self.range[0]),
                number(self.range[1]),
                number(self.mean),
                self.unit.as_deref().unwrap_or_default()
            ),
        );
        let percentiles = self
            .percentiles
            .iter()
            .map(|[p, v]| format!("{p} %: {}", number(*v)));
        line("percentiles", percentiles.collect::<Vec<_>>().join("   "));
        let window = |[lo, hi]: [f64; 2]| format!("{} … {}", number(lo), number(hi));
        for header in &self.header_windows {
            line(
                "header window",
                format!("{} {}", window(header.window), header.name),
            );
        }
        if let Some(labels) = &self.labels {
            let names = labels
                .iter()
                .map(|l| format!("{} {}", number(l.value), l.name));
            line("labels", names.collect::<Vec<_>>().join(", "));
        }
        line("auto window", window(self.auto_window));
        if self.nan_voxels + self.infinite_voxels > 0 {
            line(
                "replaced",
                format!(
                    "{} NaN (now the minimum), {} infinite (now the finite minimum or maximum)",
                    self.nan_voxels, self.infinite_voxels
                ),
            );
        }
        for notice in &self.notices {
            line("note", notice.clone());
        }
        text
    }
}

impl SceneInfo {
    fn new(path: &Path, sequence: &Sequence, scene: &holovol_scene::Scene) -> Self {
        let file: &SceneFile = sequence.file();
        let map = &scene.environment.map;
        Self {
            path: path.into(),
            width: file.camera.width,
            height: file.camera.height,
            frames: sequence.frames(),
            stereo: file.stereo.is_some(),
            max_scatters: file.integrator.max_scatters,
            phase_g: file.phase_g,
            gradient_factor: file.gradient_factor,
            transfer_function_points: file.transfer_function.points.len(),
            window: scene.window,
            environment: EnvironmentInfo {
                path: file.environment.path.clone(),
                width: map.width(),
                height: map.height(),
                max: map
                    .texels()
                    .iter()
                    .flatten()
                    .fold(0.0, |a: f32, &b| a.max(b)),
                rotation_y_deg: file.environment.rotation_y_deg,
                scale: file.environment.scale,
            },
            notices: sequence.notices().to_vec(),
            volume: VolumeInfo::new(&file.volume.path, &scene.volume, scene.world_from_unit_cube),
        }
    }

    fn text(&self) -> String {
        let mut text = String::new();
        let mut line = |name: &str, value: String| {
            // Writing to a string can't fail.
            let _ = writeln!(text, "{name:<14}{value}");
        };
        let eyes = if self.stereo { ", two eyes" } else { "" };
        let frames = if self.frames > 1 {
            format!(", {} frames", self.frames)
        } else {
            String::new()
        };
        line("scene", self.path.display().to_string());
        line(
            "image",
            format!("{} × {} pixels{eyes}{frames}", self.width, self.height),
        );
        let scatters = self
            .max_scatters
            .map_or("unlimited scatterings".to_owned(), |n| {
                format!("at most {n} scatterings")
            });
        line(
            "paths",
            format!(
                "{scatters}, g = {}, gradient factor {}",
                self.phase_g, self.gradient_factor
            ),
        );
        line(
            "look",
            format!(
                "{} transfer function points over {} … {}",
                self.transfer_function_points,
                number(self.window[0]),
                number(self.window[1])
            ),
        );
        let light = &self.environment;
        line(
            "light",
            match &light.path {
                Some(path) => format!(
                    "{}, {} × {}, peak {}, turned by {}°, scaled by {}",
                    path.display(),
                    light.width,
                    light.height,
                    number(light.max.into()),
                    light.rotation_y_deg,
                    light.scale
                ),
                None => format!(
                    "constant, peak {}, scaled by {}",
                    number(light.max.into()),
                    light.scale
                ),
            },
        );
        // The volume's own notices are told with the volume.
        for notice in self
            .notices
            .iter()
            .filter(|notice| !notice.starts_with("volume: "))
        {
            line("note", notice.clone());
        }
        text.push('\n');
        text + &self.volume.text()
    }
}

/// Six digits are enough to read.
fn number(value: f64) -> String {
    if value == 0.0 || (1e-3..1e6).contains(&value.abs()) {
        let rounded = format!("{value:.4}");
        rounded
            .trim_end_matches('0')
            .trim_end_matches('.')
            .to_owned()
    } else {
        format!("{value:.5e}")
    }
}

/// Three lengths in the unit that suits the largest.
fn lengths(metres: [f64; 3]) -> String {
    let largest = metres.iter().fold(0.0f64, |a, &b| a.max(b.abs()));
    let (unit, scale) = match largest {
        l if l < 1e-5 => ("nm", 1e9),
        l if l < 1e-3 => ("µm", 1e6),
        l if l < 1.0 => ("mm", 1e3),
        l if l < 1e4 => ("m", 1.0),
        _ => ("km", 1e-3),
    };
    let [x, y, z] = metres.map(|l| number(l * scale));
    format!("{x} × {y} × {z} {unit}")
}

fn bytes(count: u64) -> String {
    let count = count as f64;
    match count {
        c if c < 1024.0 => format!("{c} B"),
        c if c < 1024.0 * 1024.0 => format!("{:.1} KiB", c / 1024.0),
        c if c < 1024.0 * 1024.0 * 1024.0 => format!("{:.1} MiB", c / 1048576.0),
        c => format!("{:.1} GiB", c / 1073741824.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_and_lengths_are_short() {
        assert_eq!(number(-1000.0), "-1000");
        assert_eq!(number(0.898_437_5), "0.8984");
        assert_eq!(number(1.25e9), "1.25000e9");
        assert_eq!(
            lengths([0.001, 0.000_898_44, 0.000_898_44]),
            "1 × 0.8984 × 0.8984 mm"
        );
        assert_eq!(lengths([1e-6, 1e-6, 2e-6]), "1000 × 1000 × 2000 nm");
        assert_eq!(bytes(1536), "1.5 KiB");
    }
}
