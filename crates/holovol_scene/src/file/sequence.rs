use std::path::Path;

use glam::{DMat4, DVec3, DVec4};
use holovol_light::EnvironmentMap;
use holovol_volume::{Progress, ReadOptions, TransferFunction, Volume};

use super::validate::check_frames;
use super::{EnvironmentEntry, SceneError, SceneFile};
use crate::{Environment, Integrator, Scene};

/// A scene file with everything it names in memory: gives the scene at each frame.
///
/// Frames share voxels and texels, so that making one is cheap.
#[derive(Clone, Debug)]
pub struct Sequence {
    file: SceneFile,
    volume: Volume,
    window: [f64; 2],
    world_from_unit_cube: DMat4,
    transfer_function: TransferFunction,
    environment: EnvironmentMap,
    switched_environment: Option<EnvironmentMap>,
    switched_transfer_function: Option<TransferFunction>,
    frames: u32,
    notices: Vec<String>,
}

impl Sequence {
    /// Reads a scene file with everything it names.
    ///
    /// # Errors
    /// If the scene or a file that it names can't be read or is not valid.
    pub fn load(path: &Path, progress: &mut dyn FnMut(Progress)) -> Result<Self, SceneError> {
        let file = SceneFile::read(path)?;
        let base = path.parent().unwrap_or(Path::new(""));
        Self::new(&file, base, progress).map_err(|source| source.in_file(path))
    }

    /// Loads everything that a scene names, relative to `base`.
    ///
    /// # Errors
    /// If the scene is not valid, or a file that it names can't be read.
    pub fn new(
        file: &SceneFile,
        base: &Path,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Self, SceneError> {
        file.validate()?;
        // Light first: it is small, so a mistake in its path shows before a long wait.
        let environment = load_environment(&file.environment, base, "environment")?;
        let switch = file.animation.as_ref().and_then(|a| a.switch.as_ref());
        let switched_environment = switch
            .and_then(|switch| switch.environment.as_ref())
            .map(|entry| load_environment(entry, base, "animation.switch.environment"))
            .transpose()?;
        let switched_transfer_function = switch
            .and_then(|switch| switch.transfer_function.as_ref())
            .map(|entry| entry.resolve("animation.switch.transfer_function"))
            .transpose()?;
        let mut options = ReadOptions::default();
        if let Some(choice) = &file.volume.choice {
            options = options.with_choice(choice);
        }
        let path = base.join(&file.volume.path);
        let volume = holovol_volume::open_with(&path, &options, progress).map_err(|source| {
            SceneError::Volume {
                field: "volume.path".into(),
                source: Box::new(source),
            }
        })?;
        Self::from_parts(
            file,
            volume,
            environment,
            switched_environment,
            switched_transfer_function,
        )
    }

    /// Puts a volume and a light that are already in memory in the place of those that the file
    /// names.
    ///
    /// # Errors
    /// If the scene is not valid, or its animation exchanges the environment.
    pub fn with_data(
        file: &SceneFile,
        volume: Volume,
        environment: EnvironmentMap,
    ) -> Result<Self, SceneError> {
        file.validate()?;
        let switch = file.animation.as_ref().and_then(|a| a.switch.as_ref());
        if switch.is_some_and(|switch| switch.environment.is_some()) {
            return Err(SceneError::Unsupported {
                field: "animation.switch.environment".into(),
            });
        }
        let switched_transfer_function = switch
            .and_then(|switch| switch.transfer_function.as_ref())
            .map(|entry| entry.resolve("animation.switch.transfer_function"))
            .transpose()?;
        Self::from_parts(file, volume, environment, None, switched_transfer_function)
    }

    fn from_parts(
        file: &SceneFile,
        volume: Volume,
        environment: EnvironmentMap,
        switched_environment: Option<EnvironmentMap>,
        switched_transfer_function: Option<TransferFunction>,
    ) -> Result<Self, SceneError> {
        let mut notices = file.notices();
        notices.extend(volume.notices().iter().map(|n| format!("volume: {n}")));
        notices.extend(replaced_voxels(&volume));
        if environment.replaced() > 0 {
            notices.push(format!(
                "environment: {} of {} texels were NaN, infinite or negative and have been replaced",
                environment.replaced(),
                environment.texels().len()
            ));
        }
        file.environment
            .check_peak(peak(&environment), "environment")?;
        let switch = file.animation.as_ref().and_then(|a| a.switch.as_ref());
        if let (Some(entry), Some(map)) = (
            switch.and_then(|switch| switch.environment.as_ref()),
            &switched_environment,
        ) {
            entry.check_peak(peak(map), "animation.switch.environment")?;
        }
        let window = file.volume.window.unwrap_or_else(|| {
            let [lo, hi] = volume.range();
            if lo < hi {
                return [lo, hi];
            }
            notices.push(format!(
                "volume: all values are {lo}; the window is [{lo}, {}]",
                lo + one_more(lo)
            ));
            [lo, lo + one_more(lo)]
        });
        let world_from_unit_cube = file
            .volume
            .matrix()
            .unwrap_or_else(|| volume.world_from_unit_cube());
        let transfer_function = file.transfer_function.resolve("transfer_function")?;
        let spacing = largest_spacing(world_from_unit_cube, volume.dims());
        for (function, field) in [
            (Some(&transfer_function), "transfer_function"),
            (
                switched_transfer_function.as_ref(),
                "animation.switch.transfer_function",
            ),
        ] {
            notices.extend(voxel_depth(function, spacing, field)?);
        }
        Ok(Self {
            world_from_unit_cube,
            transfer_function,
            frames: file.animation.as_ref().map_or(1, |a| a.frames),
            file: file.clone(),
            volume,
            window,
            environment,
            switched_environment,
            switched_transfer_function,
            notices,
        })
    }

    /// The scene file.
    pub fn file(&self) -> &SceneFile {
        &self.file
    }

    /// Remarks for the user about the scene and the files that it names.
    pub fn notices(&self) -> &[String] {
        &self.notices
    }

    /// How many frames there are; 1 without an animation.
    pub fn frames(&self) -> u32 {
        self.frames
    }

    /// Another number of frames over the same motion; a switch stays at its frame.
    ///
    /// # Errors
    /// If it is 0 or more than [`SceneFile::MAX_FRAMES`].
    pub fn with_frames(mut self, frames: u32) -> Result<Self, SceneError> {
        check_frames("animation.frames", frames)?;
        self.frames = frames;
        Ok(self)
    }

    /// Distance of the eyes in metres, for a stereo scene; see [`crate::Camera::stereo`].
    pub fn ipd(&self) -> Option<f64> {
        self.file.stereo.map(|stereo| stereo.ipd)
    }

    /// The scene at frame `index`, counted from 0; past the end it stays as at the last.
    ///
    /// # Errors
    /// If the camera's way leads through its target or makes it look along `up`.
    pub fn frame(&self, index: u32) -> Result<Scene, SceneError> {
        let last = self.frames.saturating_sub(1);
        let index = index.min(last);
        let t = f64::from(index) / f64::from(last.max(1));
        let animation = self.file.animation.as_ref();
        let switched = animation
            .and_then(|a| a.switch.as_ref())
            .filter(|switch| index >= switch.frame);

        let mut camera = self.file.camera;
        if let Some(to) = animation.and_then(|a| a.eye_to) {
            camera.eye = lerp3(camera.eye, to, t);
        }
        if let Some(to) = animation.and_then(|a| a.target_to) {
            camera.target = lerp3(camera.target, to, t);
        }
        let camera = camera.resolve().map_err(|error| match error {
            SceneError::Field { field, problem } if self.frames > 1 => SceneError::Field {
                field: format!("animation: at frame {index}, {field}"),
                problem,
            },
            error => error,
        })?;

        let light = switched
            .and_then(|switch| switch.environment.as_ref())
            .unwrap_or(&self.file.environment);
        let map = switched
            .and(self.switched_environment.as_ref())
            .unwrap_or(&self.environment);
        let rotation_y_deg = animation
            .and_then(|a| a.environment_rotation_to_deg)
            .map_or(light.rotation_y_deg, |to| lerp(light.rotation_y_deg, to, t));

        let turn = animation
            .and_then(|a| a.volume_rotation_y_to_deg)
            .map_or(0.0, |to| lerp(0.0, to, t).to_radians());
        let world_from_unit_cube = if turn == 0.0 {
            self.world_from_unit_cube
        } else {
            let centre = self
                .world_from_unit_cube
                .transform_point3(DVec3::splat(0.5));
            DMat4::from_translation(centre)
                * DMat4::from_rotation_y(turn)
                * DMat4::from_translation(-centre)
                * self.world_from_unit_cube
        };

        Ok(Scene {
            volume: self.volume.clone(),
            window: self.window,
            world_from_unit_cube,
            transfer_function: switched
                .and(self.switched_transfer_function.as_ref())
                .unwrap_or(&self.transfer_function)
                .clone(),
            phase_g: self.file.phase_g,
            gradient_factor: self.file.gradient_factor,
            clip_planes: self.file.clip.iter().copied().map(DVec4::from).collect(),
            environment: Environment {
                map: map.clone(),
                rotation_y: rotation_y_deg.to_radians(),
                scale: light.scale,
            },
            camera,
            integrator: Integrator {
                max_scatters: self.file.integrator.max_scatters,
            },
        })
    }
}

fn load_environment(
    entry: &EnvironmentEntry,
    base: &Path,
    field: &str,
) -> Result<EnvironmentMap, SceneError> {
    if let Some(radiance) = entry.constant {
        return Ok(EnvironmentMap::constant(radiance.map(|c| c as f32)));
    }
    let path = entry.path.as_deref().unwrap_or(Path::new(""));
    EnvironmentMap::load(&base.join(path)).map_err(|source| SceneError::Light {
        field: format!("{field}.path"),
        source,
    })
}

/// The brightest channel of a map.
fn peak(map: &EnvironmentMap) -> f64 {
    let channels = map.texels().iter().flatten();
    channels.fold(0.0, |peak, &c| f64::max(peak, c.into()))
}

/// Longest edge of a voxel, metres.
fn largest_spacing(world_from_unit_cube: DMat4, dims: [u32; 3]) -> f64 {
    let edge = |axis: usize| {
        world_from_unit_cube.col(axis).truncate().length() / f64::from(dims[axis].max(1))
    };
    edge(0).max(edge(1)).max(edge(2))
}

/// A remark if a transfer function makes voxels so dense that tracing takes long; an error if it
/// would hardly end.
fn voxel_depth(
    function: Option<&TransferFunction>,
    spacing: f64,
    field: &str,
) -> Result<Option<String>, SceneError> {
    /// From here on the walls of voxels decide, and time grows with the depth.
    const DENSE: f64 = 1e3;
    let points = function.map_or(&[][..], |function| function.points());
    let sigma_t = points.iter().fold(0.0, |most, p| f64::max(most, p.sigma_t));
    let depth = sigma_t * spacing;
    let what = format!(
        "sigma_t of {sigma_t:e} /m is an optical depth of {depth:.1e} across a voxel of {spacing:.1e} m"
    );
    if depth > SceneFile::MAX_VOXEL_DEPTH {
        return Err(SceneError::field(
            format!("{field}.points"),
            format!(
                "{what}, which would hardly ever end; expected at most {:e}, reduce sigma_t (its unit is 1/m)",
                SceneFile::MAX_VOXEL_DEPTH
            ),
        ));
    }
    Ok((depth > DENSE).then(|| {
        format!(
            "{field}: {what}: rendering takes long and looks the same from 1e3 on (the unit is 1/m)"
        )
    }))
}

/// A remark about voxels that are not numbers.
fn replaced_voxels(volume: &Volume) -> Option<String> {
    let replaced = volume.replaced();
    let total = replaced.nan + replaced.infinite;
    (total > 0).then(|| {
        format!(
            "volume: {total} of {} voxels were NaN or infinite and have been replaced (NaN by the minimum, infinities by the finite minimum or maximum)",
            volume.dims().map(u64::from).iter().product::<u64>()
        )
    })
}

/// A step that a value of this size can take.
fn one_more(value: f64) -> f64 {
    value.abs().max(1.0)
}

fn lerp(a: f64, b: f64, t: f64) -> f64 {
    // Exact at both ends.
    if t == 1.0 { b } else { a + (b - a) * t }
}

fn lerp3(a: [f64; 3], b: [f64; 3], t: f64) -> [f64; 3] {
    std::array::from_fn(|axis| lerp(a[axis], b[axis], t))
}
