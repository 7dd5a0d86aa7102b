//! What is believed of clipped lights before they are measured.

use std::f64::consts::LN_2;

/// The few numbers that clipped lights are extended by, in EV (log₂).
///
/// [`Prior::default`] is fitted on twelve CC0 panoramas of Poly Haven by `holovol bench light`,
/// which also fits it again without each of them, and measures on that one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prior {
    /// log₂ of the sun's irradiance facing it over the horizontal irradiance of its clear sky.
    pub sun_over_sky: f64,
    /// One standard deviation of [`Self::sun_over_sky`] for a sun at the zenith; not fitted.
    pub sun_sigma: f64,
    /// A clipped region's gain over that of [`exponential_gain`].
    pub gain: f64,
    /// One standard deviation of the gain of a region whose [`exponential_gain`] is 1 EV.
    pub gain_sigma: f64,
    /// Per rung: factor from the spread of the model to the spread that was met.
    pub sigma_scale: [f64; 5],
}

impl Default for Prior {
    fn default() -> Self {
        Self {
            sun_over_sky: 2.288,
            sun_sigma: 0.6,
            gain: 2.161,
            gain_sigma: 2.265,
            sigma_scale: [1.25, 1.52, 0.8, 0.8, 0.53],
        }
    }
}

/// log₂(halo / clipped) of an edge that the picture can't show sharper.
const SHARPEST: f64 = 0.1;
/// No lamp has more than this, EV above white paper that it lights: a bulb's glass has 2⁷, the
/// surface of a bright LED 2¹¹.
const BRIGHTEST: f64 = 11.0;

/// Gain of a clipped region, EV, if the area above a radiance L falls as exp(−L/s) all the way
/// from half the clipping level up, from solid angles.
///
/// Then halo / clipped = exp(1/2s), and the core has 1 + s on average. A region whose halo is many
/// times its core is about to end: next to nothing is missing. One that looks cut out is far above
/// clipping.
pub(super) fn exponential_gain(halo: f64, clipped: f64) -> f64 {
    let growth = (halo / clipped).log2().max(0.0) + SHARPEST;
    (1.0 + 0.5 / (growth * LN_2)).log2()
}

/// Gain that no light above this ceiling has, EV: what even a dark exposure clips can't have much
/// more.
pub(super) fn gain_limit(ceiling: f32) -> f64 {
    (BRIGHTEST - f64::from(ceiling).log2()).max(1.0)
}

/// Spread of the optical depth of clear air, in EV per air mass.
const HAZE_SIGMA: f64 = 0.14;
/// Air masses are counted up to here.
const LARGEST_AIR_MASS: f64 = 8.0;

impl Prior {
    /// One standard deviation of a sun's strength, EV: haze tells the more the longer the way
    /// through it (Beer–Lambert), and a doubtful sun is as unsure as it is doubtful.
    pub(super) fn sun_sigma(&self, sine_of_elevation: f64, sureness: f64) -> f64 {
        let air_mass = 1.0 / sine_of_elevation.max(1.0 / LARGEST_AIR_MASS);
        self.sun_sigma.hypot(HAZE_SIGMA * air_mass) + (1.0 - sureness)
    }

    /// Gain of a region's clipped core over the clipping level, EV: levels off toward the limit.
    pub(crate) fn gain_of(&self, exponential: f64, limit: f64) -> f64 {
        let gain = self.gain * exponential;
        gain * limit / (gain + limit)
    }

    /// One standard deviation of that gain, EV: none where nothing is missing.
    pub(crate) fn gain_sigma_of(&self, exponential: f64) -> f64 {
        self.gain_sigma * exponential.sqrt()
    }
}
