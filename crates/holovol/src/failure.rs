use std::fmt;
use std::process::ExitCode;

use holovol_light::LightError;
use holovol_reference::ImageError;
use holovol_render::RenderError;
use holovol_scene::SceneError;
use holovol_volume::VolumeError;

/// Exit codes of the command, besides 0 for success.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Exit {
    /// 1: a mistake of ours.
    Internal = 1,
    /// 2: the command line makes no sense.
    Usage = 2,
    /// 3: a file that was given can't be used.
    Input = 3,
    /// 4: the output can't be written.
    Output = 4,
    /// 5: no graphics adapter fits.
    NoAdapter = 5,
    /// 6: the graphics device failed or is too small: lost, or out of memory.
    Device = 6,
    /// 7: the image was written, but a check of the renderer failed, so that it may be wrong.
    Inexact = 7,
    /// 8: there is no headset, or no way to it.
    NoHeadset = 8,
    /// 130: stopped by Ctrl-C; what was traced by then is written.
    Interrupted = 130,
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit as u8)
    }
}

/// Why the command failed, in words for its user.
#[derive(Clone, Debug)]
pub struct Failure {
    /// What kind of failure it is.
    pub exit: Exit,
    message: String,
}

impl Failure {
    /// A failure with its message: what is wrong, and the way out.
    pub fn new(exit: Exit, message: impl Into<String>) -> Self {
        Self {
            exit,
            message: message.into(),
        }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for Failure {}

impl From<SceneError> for Failure {
    fn from(error: SceneError) -> Self {
        Self::new(Exit::Input, error.to_string())
    }
}

impl From<VolumeError> for Failure {
    fn from(error: VolumeError) -> Self {
        Self::new(Exit::Input, error.to_string())
    }
}

impl From<LightError> for Failure {
    fn from(error: LightError) -> Self {
        Self::new(Exit::Input, error.to_string())
    }
}

impl From<ImageError> for Failure {
    /// Of reading; writing is [`Exit::Output`].
    fn from(error: ImageError) -> Self {
        Self::new(Exit::Input, error.to_string())
    }
}

impl From<holovol_reference::TraceError> for Failure {
    fn from(error: holovol_reference::TraceError) -> Self {
        Self::new(Exit::Input, error.to_string())
    }
}

impl From<RenderError> for Failure {
    fn from(error: RenderError) -> Self {
        let exit = match error {
            RenderError::NoAdapter { .. } | RenderError::Device { .. } => Exit::NoAdapter,
            RenderError::DeviceLost { .. }
            | RenderError::OutOfMemory { .. }
            | RenderError::VolumeTooLarge { .. } => Exit::Device,
            RenderError::Scene { .. } => Exit::Input,
            _ => Exit::Internal,
        };
        Self::new(exit, error.to_string())
    }
}
