//! Coarser while something moves, so that it moves smoothly; finer and finer at rest.

use bevy::input::keyboard::KeyboardInput;
use bevy::input::mouse::{MouseButtonInput, MouseWheel};
use bevy::prelude::*;
use bevy::time::Real;
use bevy_holovol::prelude::*;

use super::camera::Orbit;
use super::pictures::Pictures;
use super::settings::Settings;

/// Samples per pixel at which a resting view is done.
pub(crate) const RESTING_SAMPLES: u32 = 2048;

/// A frame in motion should take no longer, seconds.
const MOTION_BUDGET: f32 = 1.0 / 30.0;
/// Nor one at rest, so that the next motion is noticed.
const REST_BUDGET: f32 = 1.0 / 12.0;
/// Pixels of the image per pixel of the window in motion. A ladder, each step twice the cost of the
/// one before: an image of another size has no history to be denoised with.
const SCALES: [f32; 8] = [0.0884, 0.125, 0.177, 0.25, 0.354, 0.5, 0.707, 1.0];
/// Frames that a step is kept at least.
const STEADY_FRAMES: u32 = 5;
const MAX_SAMPLES_PER_FRAME: u32 = 16;
/// Seconds without change after which a view rests.
const REST_AFTER: f32 = 0.25;
/// Where a full frame takes longer than this, half the resolution comes first, for so long.
const SLOW_FRAME: f32 = 0.5;
const HALF_UNTIL: f32 = 3.0;
/// On slow machines a resting view waits while somebody uses the panel.
const PAUSE_ABOVE: f32 = 0.15;
const PAUSE_SECONDS: f32 = 0.8;

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
    /// Index into [`SCALES`].
    motion_step: usize,
    /// Frames in motion since it changed.
    frames_at_step: u32,
    samples: u32,
    since_change: f32,
    /// Half the resolution, on the way to all of it.
    is_half: bool,
    /// Of the view, pixels.
    size: Option<UVec2>,
    /// What a frame of the whole resolution took when it was last traced, seconds.
    full_seconds: f32,
    /// Since a hand was at mouse or keys, seconds.
    since_input: f32,
    /// Smoothed seconds of a frame.
    pub(crate) frame_seconds: f32,
}

impl Default for Quality {
    fn default() -> Self {
        Self {
            // Coarse, so that there is something to see at once.
            motion_step: 3,
            frames_at_step: 0,
            samples: 1,
            since_change: 0.0,
            is_half: false,
            size: None,
            full_seconds: 0.0,
            since_input: f32::INFINITY,
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
            self.frames_at_step += 1;
            self.choose_step();
        }
        if self.is_moving() {
            self.samples = 1;
            let scale = SCALES[self.motion_step];
            let full = self.frame_seconds / (scale * scale);
            self.is_half = scale < 0.5 && full > SLOW_FRAME;
        } else if self.is_half {
            self.is_half = self.since_change < HALF_UNTIL;
        } else if self.frame_seconds < 0.5 * REST_BUDGET {
            self.samples = (2 * self.samples).min(MAX_SAMPLES_PER_FRAME);
        } else if self.frame_seconds > REST_BUDGET {
            self.samples = (self.samples / 2).max(1);
        }
    }

    /// One step up where that keeps the budget, as many down as it takes.
    fn choose_step(&mut self) {
        if self.frames_at_step < STEADY_FRAMES {
            return;
        }
        let now = self.motion_step;
        // Cost goes with pixels.
        let seconds = |step: usize| self.frame_seconds * (SCALES[step] / SCALES[now]).powi(2);
        let step = if self.frame_seconds > 1.2 * MOTION_BUDGET {
            let fits = |&step: &usize| seconds(step) <= MOTION_BUDGET;
            (0..now).rev().find(fits).unwrap_or(0)
        } else if now + 1 < SCALES.len() && seconds(now + 1) < 0.9 * MOTION_BUDGET {
            now + 1
        } else {
            now
        };
        if step != now {
            self.frame_seconds = seconds(step);
            self.motion_step = step;
            self.frames_at_step = 0;
        }
    }

    /// Notes whether somebody is at mouse or keys, after [`Self::note`].
    fn note_input(&mut self, seconds: f32, is_used: bool) {
        let was_paused = self.is_paused();
        if !self.is_moving() && !self.is_half && !was_paused {
            self.full_seconds = seconds;
        }
        self.since_input = if is_used {
            0.0
        } else {
            self.since_input + seconds
        };
    }

    /// Tracing waits: its frames would take so long that the panel would not follow the hand.
    pub(crate) fn is_paused(&self) -> bool {
        !self.is_moving() && self.full_seconds > PAUSE_ABOVE && self.since_input < PAUSE_SECONDS
    }

    fn is_moving(&self) -> bool {
        self.since_change < REST_AFTER
    }

    fn scale(&self) -> f32 {
        if self.is_moving() {
            SCALES[self.motion_step]
        } else if self.is_half {
            0.5
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

#[derive(bevy::ecs::system::SystemParam)]
struct Input<'w, 's> {
    moved: MessageReader<'w, 's, CursorMoved>,
    pressed: MessageReader<'w, 's, MouseButtonInput>,
    turned: MessageReader<'w, 's, MouseWheel>,
    typed: MessageReader<'w, 's, KeyboardInput>,
}

impl Input<'_, '_> {
    fn is_used(&mut self) -> bool {
        let is_used = !self.moved.is_empty()
            || !self.pressed.is_empty()
            || !self.turned.is_empty()
            || !self.typed.is_empty();
        self.moved.clear();
        self.pressed.clear();
        self.turned.clear();
        self.typed.clear();
        is_used
    }
}

#[expect(clippy::too_many_arguments, reason = "all that a view depends on")]
fn adapt(
    mut quality: ResMut<Quality>,
    time: Res<Time<Real>>,
    environment: Res<VolumeEnvironment>,
    volumes: Query<Shown>,
    // Not the eyes of a headset.
    mut cameras: Query<(Ref<Transform>, &Camera, &mut VolumeRenderSettings), With<Orbit>>,
    mut transfer_functions: MessageReader<AssetEvent<TransferFunctionAsset>>,
    planes: Query<(), (With<VolumeClipPlane>, Changed<GlobalTransform>)>,
    mut input: Input,
    pictures: Res<Pictures>,
    program: Res<Settings>,
) {
    let is_used = input.is_used();
    let is_working = pictures.progress().is_some();
    let edited = transfer_functions
        .read()
        .any(|e| matches!(e, AssetEvent::Modified { .. }));
    let moved = volumes.iter().any(|(volume, material, medium, transform)| {
        volume.is_changed()
            || material.is_changed()
            || medium.is_changed()
            || transform.is_changed()
    });
    for (transform, camera, mut settings) in &mut cameras {
        let size = camera.physical_viewport_size();
        let is_resized = std::mem::replace(&mut quality.size, size) != size;
        let changed = is_resized || transform.is_changed() || moved || edited;
        let changed = changed || environment.is_changed() || !planes.is_empty();
        quality.note(time.delta_secs(), changed);
        quality.note_input(time.delta_secs(), is_used);
        let samples = if quality.is_paused() || (is_working && !quality.is_moving()) {
            0
        } else {
            quality.samples
        };
        let scale = quality.scale();
        let (mode, denoiser) = (program.noise.mode(), program.noise.denoiser());
        let is_as_wanted = settings.resolution_scale == scale
            && (settings.samples, settings.mode, settings.denoiser) == (samples, mode, denoiser);
        if !is_as_wanted {
            settings.resolution_scale = scale;
            settings.samples = samples;
            settings.mode = mode;
            settings.denoiser = denoiser;
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
            let is_fine = quality.scale() == 1.0 || 2.0 * seconds > 0.85 * MOTION_BUDGET;
            assert!(is_fine, "{full}: no coarser than needed, {quality:?}");
            // It stays where it is.
            let step = quality.motion_step;
            for _ in 0..100 {
                after(1, full, &mut quality, true);
                assert_eq!(quality.motion_step, step, "{full}");
            }
        }
    }

    #[test]
    fn a_slow_machine_waits_for_the_hand_and_a_fast_one_does_not() {
        for (full, pauses) in [(2.0, true), (0.02, false)] {
            let mut quality = Quality::default();
            after(60, full, &mut quality, true);
            after(60, full, &mut quality, false);
            quality.note_input(full, false);
            assert!(!quality.is_paused());
            quality.note_input(full, true);
            assert_eq!(quality.is_paused(), pauses, "{full}");
            // Its own quick frames while it waits don't make it forget.
            for _ in 0..10 {
                quality.note(0.02, false);
                quality.note_input(0.02, false);
            }
            assert_eq!(quality.is_paused(), pauses, "{full}");
            for _ in 0..60 {
                quality.note(0.02, false);
                quality.note_input(0.02, false);
            }
            assert!(!quality.is_paused());
        }
    }

    #[test]
    fn rest_is_full_resolution_and_more_samples_where_they_are_cheap() {
        let mut quality = Quality::default();
        after(100, 0.3, &mut quality, true);
        after(20, 0.3, &mut quality, false);
        assert_eq!((quality.scale(), quality.samples), (1.0, 1));
        // Where that is slow, half of it comes first.
        after(100, 2.0, &mut quality, true);
        after(16, 2.0, &mut quality, false);
        assert_eq!(quality.scale(), 0.5);
        after(20, 2.0, &mut quality, false);
        assert_eq!(quality.scale(), 1.0);
        let mut quality = Quality::default();
        after(100, 0.002, &mut quality, false);
        assert_eq!(quality.samples, MAX_SAMPLES_PER_FRAME);
    }
}
