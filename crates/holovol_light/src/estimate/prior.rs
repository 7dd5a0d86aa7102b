//! What is believed of clipped lights before they are measured.

/// The few numbers that clipped lights are extended by, in EV (log₂).
///
/// [`Prior::default`] is fitted on twelve CC0 panoramas of Poly Haven by `holovol bench light`,
/// which also fits it again without each of them, and measures on that one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prior {
    /// log₂ of the sun's irradiance facing it over the horizontal irradiance of its clear sky.
    pub sun_over_sky: f64,
    /// One standard deviation of [`Self::sun_over_sky`].
    pub sun_sigma: f64,
    /// Gain of a clipped region whose halo is as large as itself.
    pub gain: f64,
    /// Gain per halving of the halo: sharp edges say that the light is far above clipping.
    pub gain_per_sharpness: f64,
    /// One standard deviation of a region's gain.
    pub gain_sigma: f64,
    /// Factor from the spread of the model to the spread that was met.
    pub sigma_scale: f64,
}

impl Default for Prior {
    fn default() -> Self {
        Self {
            sun_over_sky: 2.4,
            sun_sigma: 0.8,
            gain: 0.3,
            gain_per_sharpness: 0.7,
            gain_sigma: 1.2,
            sigma_scale: 1.0,
        }
    }
}

/// log₂(halo / clipped) is taken at least as this: no edge is sharper than the picture.
const SHARPEST: f64 = 0.1;
/// Gains are believed up to here, EV.
const LARGEST_GAIN: f64 = 8.0;

impl Prior {
    /// What a region's edge says: 0 for log₂(halo/clipped) = 1, larger for sharper edges.
    pub fn sharpness(halo: f64, clipped: f64) -> f64 {
        -((halo / clipped).log2().max(0.0) + SHARPEST).log2()
    }

    /// Gain of a region's clipped core over the clipping level, EV.
    pub fn gain_of(&self, sharpness: f64) -> f64 {
        (self.gain + self.gain_per_sharpness * sharpness).clamp(0.0, LARGEST_GAIN)
    }
}
