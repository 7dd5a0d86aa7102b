//! The way to a runtime: loader, instance, system.

use bevy::math::UVec2;
use openxr::{
    ApplicationInfo, Entry, EnvironmentBlendMode, ExtensionSet, FormFactor, Instance, SystemId,
    ViewConfigurationType, sys,
};

use super::HeadsetError;

pub(crate) const STEREO: ViewConfigurationType = ViewConfigurationType::PRIMARY_STEREO;

/// A runtime with a headset.
#[derive(Clone)]
pub(crate) struct Runtime {
    pub(crate) instance: Instance,
    pub(crate) system: SystemId,
    /// Name and version.
    pub(crate) name: String,
    /// What the runtime calls the headset.
    pub(crate) system_name: String,
    pub(crate) has_hand_tracking: bool,
    /// Pictures may come with their depth.
    pub(crate) takes_depth: bool,
    /// It says what of the images nobody sees.
    pub(crate) has_visibility_mask: bool,
    /// Its refresh rate can be chosen.
    pub(crate) has_refresh_rates: bool,
    /// It can be asked where the eyes look; whether it knows shows later.
    pub(crate) has_gaze: bool,
}

impl Runtime {
    /// Finds a runtime with a headset.
    pub(crate) fn find(app_name: &str) -> Result<Self, HeadsetError> {
        let entry = load()?;
        let offered = entry
            .enumerate_extensions()
            .map_err(|result| HeadsetError::NoRuntime(result.to_string()))?;
        let mut wanted = ExtensionSet::default();
        wanted.khr_vulkan_enable2 = offered.khr_vulkan_enable2;
        wanted.khr_visibility_mask = offered.khr_visibility_mask;
        wanted.khr_composition_layer_depth = offered.khr_composition_layer_depth;
        wanted.fb_display_refresh_rate = offered.fb_display_refresh_rate;
        wanted.ext_eye_gaze_interaction = offered.ext_eye_gaze_interaction;
        wanted.ext_hand_tracking = offered.ext_hand_tracking;
        wanted.ext_hand_interaction = offered.ext_hand_interaction;
        wanted.msft_spatial_anchor = offered.msft_spatial_anchor;
        wanted.msft_hand_interaction = offered.msft_hand_interaction;
        let info = ApplicationInfo {
            application_name: app_name,
            application_version: 0,
            engine_name: "holovol",
            engine_version: 0,
            api_version: openxr::Version::new(1, 0, 0),
        };
        let instance =
            entry
                .create_instance(&info, &wanted, &[])
                .map_err(|result| match result {
                    // What runtimes say whose service isn't running.
                    sys::Result::ERROR_RUNTIME_UNAVAILABLE
                    | sys::Result::ERROR_RUNTIME_FAILURE
                    | sys::Result::ERROR_INSTANCE_LOST
                    | sys::Result::ERROR_INITIALIZATION_FAILED => {
                        HeadsetError::NoRuntime(result.to_string())
                    }
                    _ => HeadsetError::of("xrCreateInstance")(result),
                })?;
        let properties = instance
            .properties()
            .map_err(HeadsetError::of("xrGetInstanceProperties"))?;
        let name = format!("{} {}", properties.runtime_name, properties.runtime_version);
        if !wanted.khr_vulkan_enable2 {
            return Err(HeadsetError::NoVulkan { runtime: name });
        }
        let system = instance
            .system(FormFactor::HEAD_MOUNTED_DISPLAY)
            .map_err(|result| match result {
                sys::Result::ERROR_FORM_FACTOR_UNAVAILABLE
                | sys::Result::ERROR_FORM_FACTOR_UNSUPPORTED => HeadsetError::NoHeadset {
                    runtime: name.clone(),
                },
                _ => HeadsetError::of("xrGetSystem")(result),
            })?;
        let system_name = instance
            .system_properties(system)
            .map_err(HeadsetError::of("xrGetSystemProperties"))?
            .system_name;
        let has_hand_tracking =
            wanted.ext_hand_tracking && instance.supports_hand_tracking(system).unwrap_or_default();
        Ok(Self {
            takes_depth: wanted.khr_composition_layer_depth,
            has_visibility_mask: wanted.khr_visibility_mask,
            has_refresh_rates: wanted.fb_display_refresh_rate,
            has_gaze: wanted.ext_eye_gaze_interaction,
            instance,
            system,
            name,
            system_name,
            has_hand_tracking,
        })
    }

    /// Pixels of an eye's image: those `wanted`, else as the runtime recommends, times a factor along
    /// each axis; as far as it allows.
    pub(crate) fn eye_size(
        &self,
        wanted: Option<UVec2>,
        factor: f32,
    ) -> Result<[u32; 2], HeadsetError> {
        let views = self
            .instance
            .enumerate_view_configuration_views(self.system, STEREO)
            .map_err(|_| HeadsetError::NotStereo)?;
        let [left, right] = views[..] else {
            return Err(HeadsetError::NotStereo);
        };
        let size = |axis: usize, recommended: [u32; 2], most: [u32; 2]| {
            let asked = wanted.map(|size| size[axis]);
            let asked = asked.unwrap_or(recommended[0].max(recommended[1]));
            let pixels = (asked as f32 * factor).round() as u32;
            pixels.clamp(1, most[0].min(most[1]).max(1))
        };
        Ok([
            size(
                0,
                [left, right].map(|view| view.recommended_image_rect_width),
                [left, right].map(|view| view.max_image_rect_width),
            ),
            size(
                1,
                [left, right].map(|view| view.recommended_image_rect_height),
                [left, right].map(|view| view.max_image_rect_height),
            ),
        ])
    }

    /// How pictures can meet the room.
    pub(crate) fn blend_modes(&self) -> Result<Vec<EnvironmentBlendMode>, HeadsetError> {
        self.instance
            .enumerate_environment_blend_modes(self.system, STEREO)
            .map_err(HeadsetError::of("xrEnumerateEnvironmentBlendModes"))
    }
}

/// The loader; distributions have its unversioned name in development packages only.
#[expect(unsafe_code, reason = "running code of a library found by name")]
fn load() -> Result<Entry, HeadsetError> {
    // SAFETY: what has the loader's name is the loader.
    unsafe { Entry::load().or_else(|first| load_versioned().map_err(|_| first)) }
        .map_err(|error| HeadsetError::NoLoader(error.to_string()))
}

#[expect(unsafe_code, reason = "running code of a library found by name")]
unsafe fn load_versioned() -> Result<Entry, openxr::LoadError> {
    let name = if cfg!(target_os = "macos") {
        "libopenxr_loader.1.dylib"
    } else {
        "libopenxr_loader.so.1"
    };
    // SAFETY: as the caller's.
    unsafe { Entry::load_from(std::path::Path::new(name)) }
}
