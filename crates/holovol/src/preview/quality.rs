//! Coarser while something moves, so that it moves smoothly; finer and finer at rest.

use bevy::prelude::*;
use bevy::time::Real;
use bevy_holovol::prelude::*;

use super::camera::Orbit;

/// Samples per pixel at which a resting view is done.
pub(crate) const RESTING_SAMPLES: u32 = 2048;

/// A frame in motion should take no longer, seconds.
const MOTION_BUDGET: f32 = 1.0 / 30.0;
/// Nor one at rest, so that the next motion is noticed.
const REST_BUDGET: f32 = 1.0 / 12.0;
const SCALES: std::ops::RangeInclusive<f32> = 0.1..=1.0;
const MAX_SAMPLES_PER_FRAME: u32 = 16;
/// Seconds without change after which a view rests.
const REST_AFTER: f32 = 0.25;

pub(crate) struct QualityPlugin;

impl Plugin for QualityPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<Quality>()
            .add_systems(PostUpdate, adapt);
    }
}

/// How finely a moving view is drawn on this machine.
#[derive(Resource, Debug)]
pub(crate) struct Quality {
    /// Pixels of the image per pixel of the window, in motion.
    motion_scale: f32,
    samples: u32,
    since_change: f32,
    /// Smoothed seconds of a frame.
    pub(crate) frame_seconds: f32,
}

impl Default for Quality {
    fn default() -> Self {
        Self {
            motion_scale: 0.5,
            samples: 1,
            since_change: 0.0,
            frame_seconds: MOTION_BUDGET,
        }
    }
}

impl Quality {
    /// Takes in what a frame took, and whether the view changed in it.
    fn note(&mut self, seconds: f32, changed: bool) {
        // A window that slept, or a disk that hung, says nothing of the next frame.
        let seconds = seconds.clamp(1e-3, 1.0);
        self.frame_seconds += 0.3 * (seconds - self.frame_seconds);
        let was_moving = self.is_moving();
        self.since_change = if changed {
            0.0
        } else {
            self.since_change + seconds
        };
        if self.is_moving() && was_moving {
            // Cost goes with pixels: the square of the scale. Slowly, against swinging.
            let step = (MOTION_BUDGET / self.frame_seconds).sqrt().clamp(0.8, 1.1);
            self.motion_scale = (self.motion_scale * step).clamp(*SCALES.start(), *SCALES.end());
        }
        if self.is_moving() {
            self.samples = 1;
        } else if self.frame_seconds < 0.5 * REST_BUDGET {
            self.samples = (2 * self.samples).min(MAX_SAMPLES_PER_FRAME);
        } else if self.frame_seconds > REST_BUDGET {
            self.samples = (self.samples / 2).max(1);
        }
    }

    fn is_moving(&self) -> bool {
        self.since_change < REST_AFTER
    }

    fn scale(&self) -> f32 {
        if self.is_moving() {
            self.motion_scale
        } else {
            1.0
        }
    }
}

type Shown<'a> = (
    Ref<'a, Volume3d>,
    Ref<'a, VolumeMaterial3d>,
    Ref<'a, VolumeMedium>,
    Ref<'a, GlobalTransform>,
);

fn adapt(
    mut quality: ResMut<Quality>,
    time: Res<Time<Real>>,
    environment: Res<VolumeEnvironment>,
    volumes: Query<Shown>,
    // Not the eyes of a headset.
    mut cameras: Query<(Ref<Transform>, &mut VolumeRenderSettings), With<Orbit>>,
    mut transfer_functions: MessageReader<AssetEvent<TransferFunctionAsset>>,
    planes: Query<(), (With<VolumeClipPlane>, Changed<GlobalTransform>)>,
) {
    let edited = transfer_functions
        .read()
        .any(|e| matches!(e, AssetEvent::Modified { .. }));
    let moved = volumes.iter().any(|(volume, material, medium, transform)| {
        volume.is_changed()
            || material.is_changed()
            || medium.is_changed()
            || transform.is_changed()
    });
    for (transform, mut settings) in &mut cameras {
        let changed = transform.is_changed() || moved || edited;
        let changed = changed || environment.is_changed() || !planes.is_empty();
        quality.note(time.delta_secs(), changed);
        let (scale, samples) = (quality.scale(), quality.samples);
        if settings.resolution_scale != scale || settings.samples != samples {
            settings.resolution_scale = scale;
            settings.samples = samples;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A machine on which a full frame takes `full` seconds.
    fn after(frames: usize, full: f32, quality: &mut Quality, changed: bool) -> f32 {
        let mut seconds = 0.0;
        for _ in 0..frames {
            let scale = quality.scale();
            seconds = full * scale * scale * quality.samples as f32 + 0.002;
            quality.note(seconds, changed);
        }
        seconds
    }

    #[test]
    fn motion_keeps_the_budget_on_any_machine() {
        for full in [0.01, 0.05, 0.3, 1.0] {
            let mut quality = Quality::default();
            let seconds = after(200, full, &mut quality, true);
            assert!(seconds < 1.3 * MOTION_BUDGET, "{full}: {seconds}");
            let is_fine = quality.motion_scale == 1.0 || seconds > 0.7 * MOTION_BUDGET;
            assert!(is_fine, "{full}: no coarser than needed, {quality:?}");
        }
    }

    #[test]
    fn rest_is_full_resolution_and_more_samples_where_they_are_cheap() {
        let mut quality = Quality::default();
        after(100, 0.3, &mut quality, true);
        after(20, 0.3, &mut quality, false);
        assert_eq!((quality.scale(), quality.samples), (1.0, 1));
        let mut quality = Quality::default();
        after(100, 0.002, &mut quality, false);
        assert_eq!(quality.samples, MAX_SAMPLES_PER_FRAME);
    }
}
