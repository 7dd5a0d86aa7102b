//! The view as a scene file that `holovol render` reads.

use std::path::{Path, PathBuf};

use bevy::math::UVec2;
use bevy::prelude::Transform;
use holovol_light::EnvironmentMap;
use holovol_reference::Image;
use holovol_scene::{
    Background, CameraEntry, EnvironmentEntry, IntegratorEntry, OutputEntry, SceneFile,
    ToneMapping, TransferFunctionEntry, VolumeEntry,
};

use super::look::{LightSource, Look};
use super::studio::Scan;
use crate::{Failure, output};

/// Where a picture is taken from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Viewpoint {
    pub(crate) transform: Transform,
    /// Metres to what is looked at.
    pub(crate) distance: f32,
    /// Vertical, radians.
    pub(crate) fov: f32,
    /// Pixels.
    pub(crate) size: UVec2,
    /// Factor from radiance 1 to what is shown.
    pub(crate) exposure: f32,
}

impl Viewpoint {
    pub(crate) fn camera(&self) -> CameraEntry {
        let eye = self.transform.translation.as_dvec3();
        let forward = self.transform.forward().as_vec3().as_dvec3();
        let target = eye + forward.normalize() * f64::from(self.distance);
        CameraEntry {
            eye: eye.to_array(),
            target: target.to_array(),
            up: self.transform.up().as_vec3().as_dvec3().to_array(),
            fov_y_deg: f64::from(self.fov).to_degrees(),
            width: self.size.x.max(1),
            height: self.size.y.max(1),
        }
    }
}

/// The scene of a view; paths are as the scan and the light have them.
pub(crate) fn scene_file(look: &Look, scan: &Scan, view: &Viewpoint) -> SceneFile {
    let matrix = scan.world_from_unit_cube();
    let environment = EnvironmentEntry {
        rotation_y_deg: look.light.rotation_deg,
        scale: look.light.stops.exp2(),
        ..match &look.light.source {
            LightSource::Constant(radiance) => {
                EnvironmentEntry::from_constant(radiance.map(f64::from))
            }
            LightSource::Map { path, .. } => {
                EnvironmentEntry::from_path(path.clone().unwrap_or_else(|| "room".into()))
            }
        }
    };
    SceneFile {
        version: SceneFile::VERSION,
        volume: VolumeEntry {
            path: scan.path.clone().unwrap_or_else(|| "phantom".into()),
            choice: scan.choice.clone(),
            window: Some(look.window),
            world_from_unit_cube: Some(std::array::from_fn(|row| matrix.row(row).to_array())),
        },
        transfer_function: TransferFunctionEntry {
            points: look.points_in_metres(scan.longest_edge()),
        },
        phase_g: look.phase_g,
        gradient_factor: look.gradient_factor,
        clip: look
            .clip_planes(matrix)
            .iter()
            .map(|plane| plane.to_array())
            .collect(),
        environment,
        camera: view.camera(),
        integrator: IntegratorEntry {
            max_scatters: look.max_scatters,
        },
        stereo: None,
        animation: None,
        output: Some(OutputEntry {
            exposure_ev: Some(f64::from(view.exposure).log2()),
            tone_mapping: ToneMapping::Neutral,
            background: if look.light.is_sky {
                Background::Environment
            } else {
                Background::Black
            },
        }),
    }
}

/// Writes a scene, and beside it what came from no file; gives the files.
///
/// # Errors
/// If one of them can't be written, or the scene can't be rendered.
pub(crate) fn save(
    mut file: SceneFile,
    scan: &Scan,
    light: &LightSource,
    map: Option<&EnvironmentMap>,
    path: &Path,
) -> Result<Vec<PathBuf>, Failure> {
    output::check(path, "json", "the scene")?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let beside = |suffix: &str| {
        let mut name = path.file_stem().unwrap_or_default().to_owned();
        name.push(suffix);
        PathBuf::from(name)
    };
    let mut written = vec![path.to_owned()];
    file.volume.path = match &scan.path {
        Some(path) => from_folder(path, folder),
        None => {
            let name = beside(".nrrd");
            let place = folder.join(&name);
            output::check(&place, "nrrd", "the scan")?;
            holovol_volume::write(scan.volume(), &place, true)
                .map_err(|error| Failure::new(crate::Exit::Output, error.to_string()))?;
            written.push(place);
            name
        }
    };
    if let LightSource::Map { path: light, .. } = light {
        file.environment.path = Some(match (light, map) {
            (Some(light), _) => from_folder(light, folder),
            (None, Some(map)) => {
                let name = beside(".light.exr");
                let place = folder.join(&name);
                output::check(&place, "exr", "the light")?;
                let texels = map.texels().iter().map(|&[r, g, b]| [r, g, b, 1.0]);
                let [width, height] = [map.width(), map.height()].map(|n| n as u32);
                output::write_exr(&Image::new(width, height, texels.collect()), &place)?;
                written.push(place);
                name
            }
            (None, None) => beside(".light.exr"),
        });
    }
    output::write_text(&file.to_json()?, path)?;
    Ok(written)
}

/// A path as a scene in `folder` names it: relative below it, else from the root.
fn from_folder(path: &Path, folder: &Path) -> PathBuf {
    let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.into());
    let path = absolute(path);
    match path.strip_prefix(absolute(folder)) {
        Ok(inside) if !inside.as_os_str().is_empty() => inside.into(),
        _ => path,
    }
}

/// A name for what is made of a file: without its endings.
pub(crate) fn stem(name: &str) -> &str {
    let name = name.strip_suffix(".gz").unwrap_or(name);
    match name.rsplit_once('.') {
        Some((stem, ending)) if !stem.is_empty() && ending.len() <= 5 => stem,
        _ => name,
    }
}

/// The first of `folder/STEM.EXTENSION`, `STEM-2`, … that is free, also with these other endings.
pub(crate) fn free_name(folder: &Path, stem: &str, extension: &str, others: &[&str]) -> PathBuf {
    // What a file system or another program could trip over.
    let is_plain = |c: char| c.is_alphanumeric() || "-_.".contains(c);
    let stem: String = stem
        .chars()
        .map(|c| if is_plain(c) { c } else { '-' })
        .collect();
    let stem = stem.trim_matches(['-', '.']);
    let stem = if stem.is_empty() { "view" } else { stem };
    let name = |n: u32| match n {
        1 => stem.to_owned(),
        n => format!("{stem}-{n}"),
    };
    let is_free = |name: &String| {
        let endings = [extension].into_iter().chain(others.iter().copied());
        endings
            .map(|ending| folder.join(format!("{name}.{ending}")))
            .all(|path| !path.exists())
    };
    let name = (1..).map(name).find(is_free);
    folder.join(format!("{}.{extension}", name.as_deref().unwrap_or(stem)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_below_the_scene_are_relative() {
        let name = |path: &str| from_folder(Path::new(path), Path::new("/a/b"));
        assert_eq!(name("/a/b/c/scan.nii"), Path::new("c/scan.nii"));
        assert_eq!(name("/a/x/scan.nii"), Path::new("/a/x/scan.nii"));
        assert_eq!(name("/a/b"), Path::new("/a/b"), "a folder of slices");
    }

    #[test]
    fn endings_are_left_out() {
        for (name, expected) in [
            ("head.nii.gz", "head"),
            ("CT 1.2.840 chest.dcm", "CT 1.2.840 chest"),
            ("a head phantom in a room", "a head phantom in a room"),
            (".hidden", ".hidden"),
            ("scan No. eleven", "scan No. eleven"),
        ] {
            assert_eq!(stem(name), expected);
        }
    }

    #[test]
    fn names_are_free_and_plain() {
        let folder = tempfile::tempdir().unwrap();
        let first = free_name(folder.path(), "a head, lit", "png", &[]);
        assert_eq!(first, folder.path().join("a-head--lit.png"));
        std::fs::write(&first, "").unwrap();
        std::fs::write(folder.path().join("turn.0000.png"), "").unwrap();
        let turn = free_name(folder.path(), "turn", "png", &["0000.png"]);
        assert_eq!(turn, folder.path().join("turn-2.png"));
        let second = free_name(folder.path(), "a head, lit", "png", &[]);
        assert_eq!(second, folder.path().join("a-head--lit-2.png"));
        assert_eq!(
            free_name(folder.path(), "../..", "png", &[]),
            folder.path().join("view.png")
        );
    }
}
