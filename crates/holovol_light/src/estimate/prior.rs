//! What is believed of clipped lights before they are measured.

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
    /// Gain of a clipped region whose halo is as large as itself, EV.
    pub gain: f64,
    /// Gain per unit of [`sharpness`].
    pub gain_per_sharpness: f64,
    /// One standard deviation of a region's gain.
    pub gain_sigma: f64,
    /// Per rung: factor from the spread of the model to the spread that was met.
    pub sigma_scale: [f64; 5],
}

impl Default for Prior {
    fn default() -> Self {
        Self {
            sun_over_sky: 2.287,
            sun_sigma: 0.6,
            gain: 1.942,
            gain_per_sharpness: 0.605,
            gain_sigma: 1.996,
            sigma_scale: [1.08, 1.48, 0.87, 0.8, 0.8],
        }
    }
}

/// log₂(halo / clipped) is taken at least as this: no edge is sharper than the picture.
const SHARPEST: f64 = 0.1;
/// Gains are believed up to here, EV.
const LARGEST_GAIN: f64 = 8.0;

/// How sharp a clipped region's edge is, from solid angles: 0 where its halo, which reaches down
/// to −1 EV, is as large as itself, 1 and more where the edge looks cut out. Only what is far
/// above clipping looks so.
pub(super) fn sharpness(halo: f64, clipped: f64) -> f64 {
    -((halo / clipped).log2().max(0.0) + SHARPEST).log2()
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

    /// Gain of a region's clipped core over the clipping level, EV.
    pub(crate) fn gain_of(&self, sharpness: f64) -> f64 {
        (self.gain + self.gain_per_sharpness * sharpness).clamp(0.0, LARGEST_GAIN)
    }
}
