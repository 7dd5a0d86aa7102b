use openxr::sys;

/// Why there is no picture in a headset, and what to do about it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum HeadsetError {
    /// The library through which programs find a runtime isn't installed.
    #[error(
        "there is no OpenXR loader ({0}); install it: `apt install libopenxr-loader1` on Debian and \
         Ubuntu, `openxr` or `openxr-loader` elsewhere"
    )]
    NoLoader(String),
    /// No runtime is installed, chosen, or running.
    #[error(
        "there is no OpenXR runtime ({0}); start the one of your headset (SteamVR, WiVRn, Monado: \
         `monado-service`), and make it the active one in its settings or by XR_RUNTIME_JSON, the \
         path of its manifest"
    )]
    NoRuntime(String),
    /// The runtime doesn't take the pictures that we make.
    #[error(
        "{runtime} takes no Vulkan pictures (it lacks XR_KHR_vulkan_enable2), and nothing else is \
         built in yet: use a runtime that does, such as SteamVR, Monado or WiVRn"
    )]
    NoVulkan {
        /// Its name and version.
        runtime: String,
    },
    /// The runtime runs, but no headset is connected to it.
    #[error(
        "{runtime} has no headset: connect it, put it on, and try again; `--simulate` needs none"
    )]
    NoHeadset {
        /// Its name and version.
        runtime: String,
    },
    /// The runtime wants another graphics device, and the app may not be given one
    /// ([`MixedRealitySettings::may_replace_device`](super::MixedRealitySettings::may_replace_device)).
    #[error(
        "the runtime now wants another graphics device than the one in use: end this program and \
         start it again"
    )]
    OtherDevice,
    /// No format that we can draw into.
    #[error("the headset offers none of the picture formats {wanted}; it has {found}")]
    NoFormat {
        /// Those that we draw into.
        wanted: String,
        /// Those of the runtime, as its graphics interface numbers them.
        found: String,
    },
    /// The headset shows something else than two eyes.
    #[error("the headset doesn't show one picture for each of two eyes, which is all we can draw")]
    NotStereo,
    /// Pictures can't meet the room in any way that we know.
    #[error("the headset offers no blend mode that we know: opaque, additive or alpha")]
    NoBlendMode,
    /// The graphics device could not be made.
    #[error("the graphics device that the headset wants could not be opened: {0}")]
    Device(String),
    /// A call to the runtime failed.
    #[error("OpenXR, {call}: {result}")]
    Call {
        /// What was asked.
        call: &'static str,
        /// What the runtime said.
        result: sys::Result,
    },
}

impl HeadsetError {
    /// Turns the runtime's answers to one call into ours.
    pub(crate) fn of(call: &'static str) -> impl Fn(sys::Result) -> Self {
        move |result| match result {
            sys::Result::ERROR_RUNTIME_UNAVAILABLE => Self::NoRuntime(result.to_string()),
            _ => Self::Call { call, result },
        }
    }
}
