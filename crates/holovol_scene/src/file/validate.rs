use glam::{DMat4, DVec3};
use holovol_volume::{TransferFunction, TransferFunctionError};

use super::{
    AnimationEntry, Background, CameraEntry, EnvironmentEntry, OutputEntry, SceneError, SceneFile,
    TransferFunctionEntry, VolumeEntry,
};
use crate::Camera;

/// Sine of the smallest angle between the view and `up`, and the smallest volume of a transform's
/// parallelepiped against its edges: below, f64 has no digits left to work with.
const DEGENERATE: f64 = 1e-9;

impl SceneFile {
    /// Checks every value that can be checked without opening a file.
    ///
    /// # Errors
    /// Names the first field that is out of its range, what came and what is allowed.
    pub fn validate(&self) -> Result<(), SceneError> {
        if self.version != Self::VERSION {
            return Err(SceneError::field(
                "version",
                format!(
                    "{} is not a version that can be read; expected {}",
                    self.version,
                    Self::VERSION
                ),
            ));
        }
        self.volume.validate()?;
        self.transfer_function.resolve("transfer_function")?;
        let g = Self::MAX_G;
        in_range(
            "phase_g",
            self.phase_g,
            -g..=g,
            "the mean cosine of the phase function",
        )?;
        in_range(
            "gradient_factor",
            self.gradient_factor,
            0.0..=1e9,
            "0 turns the surface off",
        )?;
        validate_planes(&self.clip)?;
        self.environment.validate("environment")?;
        self.camera.resolve()?;
        if let Some(stereo) = self.stereo {
            in_range(
                "stereo.ipd",
                stereo.ipd,
                0.0..=1e6,
                "metres between the eyes, such as 0.063",
            )?;
        }
        if let Some(animation) = &self.animation {
            animation.validate()?;
        }
        self.output.map_or(Ok(()), |output| output.validate())
    }

    /// Remarks about values that are allowed but look like a slip of units.
    pub fn notices(&self) -> Vec<String> {
        /// Larger volumes are usually millimetres taken for metres.
        const LARGE_METRES: f64 = 50.0;
        /// Narrower views are usually radians taken for degrees.
        const NARROW_DEG: f64 = 1.6;
        let mut notices = Vec::new();
        if let Some(matrix) = self.volume.matrix() {
            let size = (0..3)
                .map(|i| matrix.col(i).truncate().length())
                .fold(0.0, f64::max);
            if size > LARGE_METRES {
                notices.push(format!(
                    "volume.world_from_unit_cube: the volume is {size} m long; lengths are in metres, not millimetres"
                ));
            }
        }
        if self.camera.fov_y_deg < NARROW_DEG {
            notices.push(format!(
                "camera.fov_y_deg: {} is very narrow; the field of view is in degrees, not radians",
                self.camera.fov_y_deg
            ));
        }
        notices
    }
}

fn validate_planes(planes: &[[f64; 4]]) -> Result<(), SceneError> {
    if planes.len() > SceneFile::MAX_CLIP_PLANES {
        return Err(SceneError::field(
            "clip",
            format!(
                "{} planes are too many; at most {} cut a volume",
                planes.len(),
                SceneFile::MAX_CLIP_PLANES
            ),
        ));
    }
    for (index, plane) in planes.iter().enumerate() {
        let range = -SceneFile::MAX_COORDINATE..=SceneFile::MAX_COORDINATE;
        for (part, value) in plane.iter().enumerate() {
            let field = format!("clip[{index}][{part}]");
            in_range(&field, *value, range.clone(), "a plane is [nx, ny, nz, w]")?;
        }
        let [x, y, z, _] = *plane;
        // Its square is a normal number still.
        if DVec3::new(x, y, z).length() < 1e-100 {
            return Err(SceneError::field(
                format!("clip[{index}]"),
                format!(
                    "{plane:?} has no normal; expected [nx, ny, nz, w], what lies at n·x + w < 0 is left out"
                ),
            ));
        }
    }
    Ok(())
}

impl VolumeEntry {
    fn validate(&self) -> Result<(), SceneError> {
        if self.path.as_os_str().is_empty() {
            return Err(SceneError::field(
                "volume.path",
                "is empty; expected the path of a volume, relative to the scene file",
            ));
        }
        if let Some([lo, hi]) = self.window {
            for (index, value) in [lo, hi].into_iter().enumerate() {
                let field = format!("volume.window[{index}]");
                in_range(&field, value, -1e30..=1e30, "in data units")?;
            }
            if lo == hi {
                return Err(SceneError::field(
                    "volume.window",
                    format!(
                        "[{lo}, {hi}] is empty; expected two different numbers, or leave `window` out for the whole range"
                    ),
                ));
            }
        }
        let Some(matrix) = self.matrix() else {
            return Ok(());
        };
        let field = "volume.world_from_unit_cube";
        if let Some(value) = matrix
            .to_cols_array()
            .into_iter()
            .find(|v| !v.is_finite() || v.abs() > SceneFile::MAX_COORDINATE)
        {
            return Err(SceneError::field(
                field,
                format!(
                    "{value} is out of range; expected metres within ±{:e}",
                    SceneFile::MAX_COORDINATE
                ),
            ));
        }
        let last = matrix.row(3);
        if last.to_array() != [0.0, 0.0, 0.0, 1.0] {
            return Err(SceneError::field(
                field,
                format!(
                    "the last row is {:?}; expected [0, 0, 0, 1] (write the matrix row by row, with the translation in the last column)",
                    last.to_array()
                ),
            ));
        }
        let edges = [0, 1, 2].map(|axis| matrix.col(axis).truncate());
        let normalized = edges.map(|edge| edge.normalize_or_zero());
        let volume = normalized[0].dot(normalized[1].cross(normalized[2])).abs();
        // 1e-30 m: their product and its inverse stay normal numbers.
        if volume < DEGENERATE || edges.iter().any(|edge| edge.length() < 1e-30) {
            return Err(SceneError::field(
                field,
                "is singular: the volume has no extent in some direction; the first three columns are the world directions (metres) of the volume's edges and must not lie in a plane",
            ));
        }
        Ok(())
    }

    /// The transform, if it is given.
    pub(super) fn matrix(&self) -> Option<DMat4> {
        self.world_from_unit_cube
            .map(|rows| DMat4::from_cols_array_2d(&rows).transpose())
    }
}

impl TransferFunctionEntry {
    pub(super) fn resolve(&self, field: &str) -> Result<TransferFunction, SceneError> {
        TransferFunction::new(self.points.clone()).map_err(|error| {
            match error {
                TransferFunctionError::Empty => SceneError::field(
                    format!("{field}.points"),
                    "is empty; expected at least one point",
                ),
                error => {
                    // These messages begin with the point they are about.
                    SceneError::field(field, error.to_string())
                }
            }
        })
    }
}

impl EnvironmentEntry {
    pub(super) fn validate(&self, field: &str) -> Result<(), SceneError> {
        match (&self.path, self.constant) {
            (Some(_), Some(_)) => {
                return Err(SceneError::field(
                    field,
                    "has both `path` and `constant`; keep one of them",
                ));
            }
            (None, None) => {
                return Err(SceneError::field(
                    field,
                    "has neither `path` nor `constant`; give the path of an .hdr or .exr picture, or a radiance [r, g, b]",
                ));
            }
            (Some(path), None) if path.as_os_str().is_empty() => {
                return Err(SceneError::field(
                    format!("{field}.path"),
                    "is empty; expected the path of an .hdr or .exr picture, relative to the scene file",
                ));
            }
            (Some(_), None) => {}
            (None, Some(radiance)) => {
                for (index, value) in radiance.into_iter().enumerate() {
                    in_range(
                        &format!("{field}.constant[{index}]"),
                        value,
                        0.0..=1e30,
                        "radiance",
                    )?;
                }
            }
        }
        in_range(
            &format!("{field}.rotation_y_deg"),
            self.rotation_y_deg,
            -1e6..=1e6,
            "degrees",
        )?;
        in_range(
            &format!("{field}.scale"),
            self.scale,
            0.0..=1e12,
            "a factor on the radiance",
        )?;
        self.constant.map_or(Ok(()), |radiance| {
            self.check_peak(radiance.into_iter().fold(0.0, f64::max), field)
        })
    }

    /// Fails if the brightest radiance of the map, scaled, is more than kernels in f32 can sum up.
    pub(super) fn check_peak(&self, peak: f64, field: &str) -> Result<(), SceneError> {
        let scaled = peak * self.scale;
        if scaled <= SceneFile::MAX_RADIANCE {
            return Ok(());
        }
        Err(SceneError::field(
            format!("{field}.scale"),
            format!(
                "{} makes the brightest radiance {scaled:e}; expected at most {:e}, reduce `scale` or the light itself",
                self.scale,
                SceneFile::MAX_RADIANCE
            ),
        ))
    }
}

impl CameraEntry {
    /// Checks the camera and turns it into what renderers use.
    pub(super) fn resolve(&self) -> Result<Camera, SceneError> {
        let expected = format!("1 to {}", SceneFile::MAX_SIDE);
        for (field, pixels) in [("camera.width", self.width), ("camera.height", self.height)] {
            if !(1..=SceneFile::MAX_SIDE).contains(&pixels) {
                return Err(SceneError::field(
                    field,
                    format!("{pixels} is out of range; expected {expected} pixels"),
                ));
            }
        }
        let pixels = u64::from(self.width) * u64::from(self.height);
        if pixels > SceneFile::MAX_PIXELS {
            return Err(SceneError::field(
                "camera",
                format!(
                    "{} × {} = {pixels} pixels are too many; expected at most {}",
                    self.width,
                    self.height,
                    SceneFile::MAX_PIXELS
                ),
            ));
        }
        if !(self.fov_y_deg >= 1e-4 && self.fov_y_deg <= 179.9) {
            return Err(SceneError::field(
                "camera.fov_y_deg",
                format!(
                    "{} is out of range; expected 0.0001 to 179.9 degrees",
                    self.fov_y_deg
                ),
            ));
        }
        for (name, point) in [("eye", self.eye), ("target", self.target), ("up", self.up)] {
            position(&format!("camera.{name}"), point)?;
        }
        let [eye, target, up] = [self.eye, self.target, self.up].map(DVec3::from_array);
        let view = target - eye;
        // Nearer than the last digits of the coordinates there is no direction to look in.
        if view.length() <= 1e-12 * eye.length().max(target.length()) || view.length() < 1e-30 {
            return Err(SceneError::field(
                "camera.target",
                format!(
                    "{:?} is where `eye` is; expected a point in front of the camera",
                    self.target
                ),
            ));
        }
        if up.length() < 1e-30 {
            return Err(SceneError::field(
                "camera.up",
                "has no length; expected a direction such as [0, 1, 0]",
            ));
        }
        if view.normalize().cross(up.normalize()).length() < DEGENERATE {
            return Err(SceneError::field(
                "camera.up",
                format!(
                    "{:?} is parallel to the view from `eye` to `target`; choose another direction, such as [0, 0, -1] when looking down",
                    self.up
                ),
            ));
        }
        Ok(Camera {
            eye,
            target,
            up: up.normalize(),
            fov_y: self.fov_y_deg.to_radians(),
            width: self.width,
            height: self.height,
        })
    }
}

impl AnimationEntry {
    fn validate(&self) -> Result<(), SceneError> {
        check_frames("animation.frames", self.frames)?;
        for (name, point) in [("eye_to", self.eye_to), ("target_to", self.target_to)] {
            if let Some(point) = point {
                position(&format!("animation.{name}"), point)?;
            }
        }
        for (name, degrees) in [
            (
                "environment_rotation_to_deg",
                self.environment_rotation_to_deg,
            ),
            ("volume_rotation_y_to_deg", self.volume_rotation_y_to_deg),
        ] {
            if let Some(degrees) = degrees {
                in_range(&format!("animation.{name}"), degrees, -1e6..=1e6, "degrees")?;
            }
        }
        let Some(switch) = &self.switch else {
            return Ok(());
        };
        if switch.frame >= self.frames {
            return Err(SceneError::field(
                "animation.switch.frame",
                format!(
                    "{} is never reached; expected 0 to {} (frames − 1)",
                    switch.frame,
                    self.frames - 1
                ),
            ));
        }
        if let Some(environment) = &switch.environment {
            environment.validate("animation.switch.environment")?;
        }
        if let Some(transfer_function) = &switch.transfer_function {
            transfer_function.resolve("animation.switch.transfer_function")?;
        }
        Ok(())
    }
}

impl OutputEntry {
    fn validate(self) -> Result<(), SceneError> {
        if let Some(exposure_ev) = self.exposure_ev {
            in_range("output.exposure_ev", exposure_ev, -100.0..=100.0, "stops")?;
        }
        if let Background::Color(color) = self.background {
            for (index, channel) in color.into_iter().enumerate() {
                in_range(
                    &format!("output.background[{index}]"),
                    channel,
                    0.0..=1.0,
                    "linear display light",
                )?;
            }
        }
        Ok(())
    }
}

/// Checks a number of frames, whether it comes from a scene or from its user.
pub(super) fn check_frames(field: &str, frames: u32) -> Result<(), SceneError> {
    if (1..=SceneFile::MAX_FRAMES).contains(&frames) {
        return Ok(());
    }
    Err(SceneError::field(
        field,
        format!(
            "{frames} is out of range; expected 1 to {}",
            SceneFile::MAX_FRAMES
        ),
    ))
}

fn position(field: &str, point: [f64; 3]) -> Result<(), SceneError> {
    let limit = SceneFile::MAX_COORDINATE;
    for (index, value) in point.into_iter().enumerate() {
        in_range(
            &format!("{field}[{index}]"),
            value,
            -limit..=limit,
            "metres",
        )?;
    }
    Ok(())
}

fn in_range(
    field: &str,
    value: f64,
    range: std::ops::RangeInclusive<f64>,
    meaning: &str,
) -> Result<(), SceneError> {
    if range.contains(&value) {
        return Ok(());
    }
    let number = |x: f64| {
        if x.abs() >= 1e5 {
            format!("{x:e}")
        } else {
            x.to_string()
        }
    };
    Err(SceneError::field(
        field,
        format!(
            "{value} is out of range; expected {} to {} ({meaning})",
            number(*range.start()),
            number(*range.end())
        ),
    ))
}
