use std::sync::{Arc, Mutex, PoisonError};

use bevy::camera::Hdr;
use bevy::core_pipeline::prepass::DepthPrepass;
use bevy::prelude::*;
use holovol_render::Counters;

/// Makes a `Camera3d` see volumes, and says how.
///
/// Requires [`Hdr`], since radiance is laid over the opaque pass before Bevy tone-maps, and
/// [`DepthPrepass`], whose meshes end paths.
#[derive(Component, Reflect, Clone, Debug, PartialEq)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
#[require(Hdr, DepthPrepass)]
pub struct VolumeRenderSettings {
    /// What becomes of the samples of earlier frames.
    pub mode: VolumeRenderMode,
    /// How [`VolumeRenderMode::Denoised`] takes noise out; other modes don't use it.
    pub denoiser: VolumeDenoiser,
    /// Samples per pixel and frame; 1 by default, 0 to stand still for a while: the last image stays,
    /// also if the camera moves. Twice as many halve the variance that is left to a denoiser; 2 is
    /// what its settings were found with.
    pub samples: u32,
    /// Samples per pixel at which a resting view is done and costs nothing more; 1024 by default.
    pub max_samples: u32,
    /// Paths have at most this many scatterings; `None` is unlimited. 1 by default. Views of a volume
    /// that differ in it are traced apart.
    pub max_scatters: Option<u32>,
    /// Pixels of the traced image per pixel of the view along each axis, 0.05 to 2; 1 by default.
    pub resolution_scale: f32,
    /// Begins anew once and clears itself: for changes that can't be seen from outside, such as
    /// meshes that a shader moves, or masks otherwise than before.
    pub reset: bool,
}

impl Default for VolumeRenderSettings {
    fn default() -> Self {
        Self {
            mode: VolumeRenderMode::default(),
            denoiser: VolumeDenoiser::default(),
            samples: 1,
            max_samples: 1024,
            max_scatters: Some(1),
            resolution_scale: 1.0,
            reset: false,
        }
    }
}

impl VolumeRenderSettings {
    /// Pixels of the traced image for a view of this size.
    pub(crate) fn image_size(&self, viewport: [u32; 2]) -> [u32; 2] {
        let scale = if self.resolution_scale.is_finite() {
            self.resolution_scale.clamp(0.05, 2.0)
        } else {
            1.0
        };
        viewport.map(|n| ((n as f32 * scale).round() as u32).max(1))
    }
}

/// Resets that are about to be extracted, and are to be cleared after that.
#[derive(Resource, Default)]
pub(super) struct PendingResets(Vec<Entity>);

pub(super) fn note_resets(
    mut pending: ResMut<PendingResets>,
    settings: Query<(Entity, &VolumeRenderSettings)>,
) {
    let resets = settings.iter().filter(|(_, settings)| settings.reset);
    pending.0.extend(resets.map(|(entity, _)| entity));
}

pub(super) fn clear_resets(
    mut pending: ResMut<PendingResets>,
    mut settings: Query<&mut VolumeRenderSettings>,
) {
    for entity in pending.0.drain(..) {
        if let Ok(mut settings) = settings.get_mut(entity) {
            settings.reset = false;
        }
    }
}

/// What becomes of the samples of earlier frames.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq)]
#[reflect(Default, Clone, Debug, PartialEq)]
pub enum VolumeRenderMode {
    /// A resting view gathers them: unbiased, its error falls as 1/√samples without a floor. Any
    /// change of camera, volume, light or meshes begins anew.
    #[default]
    Progressive,
    /// Each frame's samples join what earlier frames, neighbouring pixels and the other eye know of
    /// the same place: for views that move. Biased in motion, by how much docs/denoising.md says; at
    /// rest it goes on to the image of [`Self::Progressive`], and stops there.
    ///
    /// Camera, volume, meshes, light and transfer function may all change: what the history still
    /// says of the new image is kept, the rest is dropped, pixel by pixel. After a cut to another
    /// place nothing has to be done; [`VolumeRenderSettings::reset`] forgets all.
    Denoised,
    /// Each frame stands for itself: unbiased, and as noisy as its few samples.
    Fresh,
}

/// How noise is taken out of a [`VolumeRenderMode::Denoised`] view.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Clone, Debug, PartialEq, Hash)]
pub enum VolumeDenoiser {
    /// This project's: a resting view converges to the exact image.
    #[default]
    Holovol,
    /// That of Cheng et al. 2023, as printed: to compare with. It stays biased at rest.
    Paper,
}

/// On a camera: it is the right eye to another one, the left. Both are denoised together, so that
/// each profits from the other's samples and they agree.
///
/// It has an effect if both are active with [`VolumeRenderMode::Denoised`], the same denoiser and
/// the same `max_scatters`. Poses, projections and sizes are free.
#[derive(Component, Reflect, Clone, Copy, Debug, PartialEq, Eq)]
#[reflect(Component, Clone, Debug, PartialEq)]
pub struct RightEyeOf(#[entities] pub Entity);

/// What tracing took, summed over volumes; in both worlds.
#[derive(Resource, Clone, Debug, Default)]
pub struct VolumeStatistics(Arc<Mutex<Statistics>>);

/// One moment of [`VolumeStatistics`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Statistics {
    /// Frames in which volumes were looked at.
    pub frames: u64,
    /// Dispatches recorded since the start.
    pub dispatches: u64,
    /// Samples made since the start: pixels times samples of each.
    pub samples: u64,
    /// Images denoised since the start.
    pub denoised: u64,
    /// Depth passes drawn since the start for meshes that overlap volumes.
    pub depth_passes: u64,
    /// Volumes, transfer functions and environments uploaded since the start.
    pub uploads: u64,
    /// Times since the start that other room was made for images, which begin anew by it: when
    /// cameras come and go, or a view outgrows its room.
    pub resizes: u64,
    /// Least samples per pixel among the images of the last frame.
    pub samples_per_pixel: u32,
    /// All images of the last frame have all their samples.
    pub is_done: bool,
    /// Something was still being uploaded or compiled in the last frame.
    pub is_waiting: bool,
    /// What the kernels counted.
    pub counters: Counters,
    /// What went wrong in the last frame, in plain words.
    pub errors: Vec<String>,
}

impl VolumeStatistics {
    /// The present numbers.
    pub fn get(&self) -> Statistics {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    pub(crate) fn update(&self, change: impl FnOnce(&mut Statistics)) {
        change(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner));
    }
}
