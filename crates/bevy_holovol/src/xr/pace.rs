//! Keeps the headset's pace: volumes get fewer pixels as soon as frames come late, and more again
//! when they have long been in time. The compositor must not starve: it needs the device as well.

use bevy::prelude::*;

use super::cost::FrameCost;
use super::eyes::EyeCamera;
use super::session::CurrentFrame;
use super::{HeadsetStatus, MixedRealitySettings};
use crate::VolumeRenderSettings;

/// Of the scale, at a late frame.
const LESS: f32 = 0.85;
/// At the end of a time without one.
const MORE: f32 = 1.08;
/// s in time before there is more; longer before what has been too much is tried again.
const PATIENCE: f32 = 1.0;
const LONG_PATIENCE: f32 = 10.0;
/// Periods from one display time to the next that are late.
const LATE: f32 = 1.5;
/// Frames after a change that were begun before it.
const ECHO: u32 = 2;

/// Pixels traced per pixel of the eyes' images along each axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pace {
    scale: f32,
    in_time_for: f32,
    /// The least scale that was too much, until it is in time again.
    too_much: Option<f32>,
    echo: u32,
}

impl Default for Pace {
    fn default() -> Self {
        Self {
            scale: 1.0,
            in_time_for: 0.0,
            too_much: None,
            echo: 0,
        }
    }
}

impl Pace {
    /// Takes in that the next frame is shown `interval` s after the last, where the headset shows one
    /// every `period` s; returns the scale, which is within `[least, most]`.
    pub(crate) fn note(&mut self, interval: f32, period: f32, [least, most]: [f32; 2]) -> f32 {
        let is_told = interval > 0.0 && period > 0.0 && interval.is_finite() && period.is_finite();
        if is_told && self.echo > 0 {
            self.echo -= 1;
        } else if is_told && interval > LATE * period {
            self.too_much = Some(self.too_much.map_or(self.scale, |s| s.min(self.scale)));
            self.change(LESS);
        } else if is_told {
            self.in_time_for += interval;
            let next = self.scale * MORE;
            let is_doubtful = self.too_much.is_some_and(|scale| next >= scale);
            let patience = if is_doubtful { LONG_PATIENCE } else { PATIENCE };
            if self.in_time_for >= patience {
                // It has proved not to be too much.
                self.too_much = self.too_much.filter(|scale| self.scale < *scale);
                self.change(MORE);
            }
        }
        self.scale = self.scale.min(most).max(least);
        self.scale
    }

    fn change(&mut self, factor: f32) {
        self.scale *= factor;
        self.in_time_for = 0.0;
        self.echo = ECHO;
    }
}

/// `First`, after the wait for a frame.
pub(crate) fn keep(
    frame: Res<CurrentFrame>,
    status: Res<HeadsetStatus>,
    settings: Res<MixedRealitySettings>,
    mut eyes: Query<&mut VolumeRenderSettings, With<EyeCamera>>,
    mut pace: Local<Pace>,
    mut last: Local<Option<i64>>,
    cost: Res<FrameCost>,
) {
    let _counting = cost.count();
    let (Some(timing), Some(range)) = (frame.timing, settings.volume_resolution) else {
        *last = None;
        return;
    };
    let now = timing.display_time.as_nanos();
    // Frames that aren't rendered say nothing.
    let former = std::mem::replace(&mut *last, timing.should_render.then_some(now));
    let Some(former) = former.filter(|_| timing.should_render) else {
        return;
    };
    let interval = now.saturating_sub(former) as f32 * 1e-9;
    let scale = pace.note(interval, status.period.as_secs_f32(), range);
    for mut eye in &mut eyes {
        if eye.resolution_scale != scale {
            eye.resolution_scale = scale;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: f32 = 1.0 / 90.0;
    const RANGE: [f32; 2] = [0.4, 1.0];

    /// A device that takes `cost` periods for a frame at scale 1: shown a whole number of periods
    /// apart. Returns the scale, and the frames of the last 10 s that were late.
    fn run(pace: &mut Pace, cost: f32, seconds: f32) -> (f32, u32) {
        let (mut time, mut late, mut scale) = (0.0, 0, pace.scale);
        while time < seconds {
            let periods = (cost * scale * scale).ceil().max(1.0);
            late += u32::from(periods > 1.0 && time > seconds - 10.0);
            time += periods * PERIOD;
            scale = pace.note(periods * PERIOD, PERIOD, RANGE);
        }
        (scale, late)
    }

    #[test]
    fn the_scale_settles_below_what_the_device_can_do() {
        for cost in [0.5, 1.2, 2.0, 4.0] {
            let mut pace = Pace::default();
            let (scale, late) = run(&mut pace, cost, 60.0);
            let best = (1.0 / cost).sqrt().min(1.0);
            assert!(scale <= 1.1 * best && scale > 0.8 * best, "{cost}: {scale}");
            assert!(late <= 6, "{cost}: {late} of about 900 frames are late");
        }
    }

    #[test]
    fn the_scale_comes_back_when_there_is_time_again() {
        let mut pace = Pace::default();
        assert!(run(&mut pace, 4.0, 10.0).0 < 0.6);
        assert_eq!(run(&mut pace, 0.5, 60.0).0, 1.0);
    }

    #[test]
    fn limits_hold_whatever_is_said() {
        let mut pace = Pace::default();
        assert_eq!(run(&mut pace, 100.0, 10.0).0, RANGE[0]);
        for interval in [f32::NAN, -1.0, 0.0, f32::INFINITY] {
            let scale = pace.note(interval, PERIOD, RANGE);
            assert_eq!(scale, RANGE[0]);
            assert_eq!(pace.note(PERIOD, interval, RANGE), RANGE[0]);
        }
    }
}
