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

/// s at the least resolution with frames late, until fewer frames are asked for.
const STARVED: f32 = 2.0;
/// s at the full resolution in time, until more are.
const PLENTY: f32 = 30.0;

/// The headset's refresh rate, which goes down when even the least resolution is too much.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct RatePace {
    late_for: f32,
    in_time_for: f32,
    /// What was asked for last, 1/s.
    wanted: Option<f32>,
}

impl RatePace {
    /// Takes in a frame as [`Pace`] has, and the scale that it led to; returns the rate to ask for,
    /// if another: one of the ascending `rates`, at least `least`, and never above the `first`.
    #[expect(clippy::too_many_arguments, reason = "all that a frame says")]
    pub(crate) fn note(
        &mut self,
        interval: f32,
        period: f32,
        scale: f32,
        [least_scale, most_scale]: [f32; 2],
        rates: &[f32],
        least: f32,
        first: f32,
    ) -> Option<f32> {
        let is_told = interval > 0.0 && period > 0.0 && interval.is_finite() && period.is_finite();
        if !is_told {
            return None;
        }
        let is_late = interval > LATE * period;
        if is_late && scale <= least_scale {
            self.late_for += interval;
            self.in_time_for = 0.0;
        } else if !is_late {
            self.late_for = (self.late_for - interval).max(0.0);
            self.in_time_for = if scale >= most_scale {
                self.in_time_for + interval
            } else {
                0.0
            };
        }
        let now = self.wanted.unwrap_or(first);
        /// Rates come as 89.99 and 90.
        const SAME: f32 = 0.5;
        let next = if self.late_for >= STARVED {
            let lower = rates.iter().rev();
            lower
                .copied()
                .find(|rate| *rate < now - SAME && *rate >= least - SAME)
        } else if self.in_time_for >= PLENTY {
            let higher = rates.iter();
            higher
                .copied()
                .find(|rate| *rate > now + SAME && *rate <= first + SAME)
        } else {
            None
        }?;
        *self = Self {
            wanted: Some(next),
            ..Self::default()
        };
        Some(next)
    }
}

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
#[expect(clippy::too_many_arguments, reason = "all that a pace is kept with")]
pub(crate) fn keep(
    frame: Res<CurrentFrame>,
    status: Res<HeadsetStatus>,
    settings: Res<MixedRealitySettings>,
    mut eyes: Query<&mut VolumeRenderSettings, With<EyeCamera>>,
    mut pace: Local<(Pace, RatePace)>,
    mut last: Local<Option<i64>>,
    mut first_rate: Local<Option<f32>>,
    mut session: Local<u32>,
    cost: Res<FrameCost>,
) {
    let _counting = cost.count();
    if *session != status.sessions {
        // It begins at the headset's own rate.
        *session = status.sessions;
        (pace.1, *first_rate) = (RatePace::default(), None);
    }
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
    let period = status.period.as_secs_f32();
    let (pace, rate_pace) = &mut *pace;
    let scale = pace.note(interval, period, range);
    if let (Some(shared), Some(least)) = (&frame.shared, settings.least_refresh_rate)
        && !shared.refresh_rates.is_empty()
        && period > 0.0
    {
        let (rates, first) = (
            &shared.refresh_rates,
            *first_rate.get_or_insert(1.0 / period),
        );
        let wanted = rate_pace.note(interval, period, scale, range, rates, least, first);
        if let Some(rate) = wanted {
            match shared.session.request_display_refresh_rate(rate) {
                Ok(()) => info!("the headset is asked for {rate} frames a second"),
                Err(result) => warn!("the headset refuses {rate} frames a second: {result}"),
            }
        }
    }
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

    /// The rate that is asked for last, of a device that takes `cost` s for a frame at scale 1.
    fn rate(cost: f32, seconds: f32, rates: &[f32], least: f32) -> Option<f32> {
        let (mut pace, mut rate_pace) = (Pace::default(), RatePace::default());
        let (mut time, mut rate, mut asked) = (0.0, 90.0, None);
        let mut scale = 1.0_f32;
        while time < seconds {
            let period = 1.0 / rate;
            let interval = (cost * scale * scale / period).ceil().max(1.0) * period;
            time += interval;
            scale = pace.note(interval, period, RANGE);
            let wanted = rate_pace.note(interval, period, scale, RANGE, rates, least, 90.0);
            asked = wanted.or(asked);
            rate = wanted.unwrap_or(rate);
        }
        asked
    }

    #[test]
    fn the_rate_goes_down_when_the_least_resolution_is_too_much() {
        let rates = [60.0, 72.0, 89.99, 120.0];
        // At 0.4² of it, 90 frames a second take 0.069 s, 72 take 0.087 s.
        assert_eq!(
            rate(0.06, 30.0, &rates, 60.0),
            None,
            "the resolution is enough"
        );
        assert_eq!(rate(0.08, 30.0, &rates, 60.0), Some(72.0));
        assert_eq!(rate(0.1, 60.0, &rates, 60.0), Some(60.0));
        assert_eq!(
            rate(0.1, 60.0, &rates, 70.0),
            Some(72.0),
            "not below the least"
        );
        assert_eq!(rate(1.0, 30.0, &[], 60.0), None);
        assert_eq!(
            rate(0.001, 90.0, &rates, 60.0),
            None,
            "never above the first"
        );
    }

    #[test]
    fn the_rate_comes_back_when_there_is_time() {
        let mut pace = RatePace {
            wanted: Some(60.0),
            ..RatePace::default()
        };
        let mut asked = None;
        for _ in 0..(2.2 * PLENTY * 60.0) as u32 {
            let rates = [60.0, 72.0, 90.0, 120.0];
            asked = pace
                .note(1.0 / 60.0, 1.0 / 60.0, 1.0, RANGE, &rates, 60.0, 90.0)
                .or(asked);
        }
        assert_eq!(asked, Some(90.0), "by way of 72");
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
