//! What is believed of clipped lights before they are measured.

use std::f64::consts::{LN_2, PI};

/// The few numbers that clipped lights are extended by, in EV (log₂).
///
/// [`Prior::default`] is fitted on twelve CC0 panoramas of Poly Haven by `holovol bench light`,
/// which also fits it again without each of them, and measures on that one.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Prior {
    /// log₂ of the sun's irradiance facing it over the horizontal irradiance of its clear sky.
    pub sun_over_sky: f64,
    /// One standard deviation of [`Self::sun_over_sky`] for a sun at the zenith; not fitted.
    pub sun_sigma: f64,
    /// A clipped core's gain over what its edge says.
    pub gain: f64,
    /// One standard deviation of the gain of a core whose edge says 1 EV.
    pub gain_sigma: f64,
    /// Per rung: factor from the spread of the model to the spread that was met.
    pub sigma_scale: [f64; 5],
}

impl Default for Prior {
    fn default() -> Self {
        Self {
            sun_over_sky: 2.288,
            sun_sigma: 0.6,
            gain: 1.273,
            gain_sigma: 1.005,
            sigma_scale: [1.71, 1.56, 0.94, 0.8, 0.58],
        }
    }
}

/// Share of the clipping level from which on, in all channels, a texel is a clipped core's edge:
/// near it, since a lamp before a bright wall has that wall around it, and 20 % below, since noise
/// and compression move the edge of less.
pub(super) const NEAR: f32 = 0.8;
/// log₂(near / core) of an edge that the picture can't show sharper: some even of a large core, and
/// this share of a texel all around a small one.
const SHARPEST: f64 = 0.005;
const BLUR: f64 = 0.02;
/// A point of light is a Gaussian in the picture, of this standard deviation: an angle, of optics
/// and of how panoramas are made, but not more than so many texels of a finer picture. A small core
/// is the tip of one, and its edge can't be sharper than that tip's.
const POINT: f64 = 0.0052;
const POINT_TEXELS: f64 = 0.85;
/// What looks cut out is further above clipping than an exponential has it: the logarithm of gains
/// over that of what edges say has a slope of 1.1 to 1.3 (of 1.55 in one of six fits) whichever
/// room is left out.
const TAIL: f64 = 1.2;
/// No lamp has more than this, EV above white paper that it lights: a bulb's glass has 2⁷, the
/// surface of a bright LED 2¹¹.
const BRIGHTEST: f64 = 11.0;

/// What the edge of a clipped core says of its gain, EV: that of an area which falls as exp(−L/s)
/// above any radiance L from [`NEAR`] of the clipping level up, to the power of [`TAIL`].
///
/// `near` is the solid angle of the core with its edge, `texel` that of a texel, sr.
/// near / core = exp((1 − NEAR)/s), and the core has 1 + s on average. A core whose edge is many
/// times its size is about to end: next to nothing is missing. One that looks cut out is far above
/// clipping.
pub(super) fn edge_gain(near: f64, core: f64, texel: f64) -> f64 {
    // A disc's circumference over its area, in texels.
    let around = 2.0 * (PI * texel / core).sqrt();
    let sharpest = SHARPEST + (1.0 + BLUR * around).log2();
    // The area of a Gaussian above a level grows by 2πσ² ln(1/NEAR) down to NEAR of that level.
    let point = 2.0 * PI * POINT.powi(2).min(POINT_TEXELS.powi(2) * texel);
    let tip = 1.0 - point * f64::from(NEAR).ln() / core;
    let growth = (near / core).max(tip).log2() + sharpest;
    let gain = (1.0 + (1.0 - f64::from(NEAR)) / (growth * LN_2)).log2();
    gain.powf(TAIL)
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
    /// The first field that no light can have: spreads are above 0 and at most 10, a gain is at
    /// least 0 and at most 10, and a sun no further than 10 EV from its sky.
    pub fn invalid_field(&self) -> Option<&'static str> {
        let spread = |sigma: f64| sigma > 0.0 && sigma <= 10.0;
        [
            ("sun_over_sky", self.sun_over_sky.abs() <= 10.0),
            ("sun_sigma", spread(self.sun_sigma)),
            ("gain", (0.0..=10.0).contains(&self.gain)),
            ("gain_sigma", spread(self.gain_sigma)),
            ("sigma_scale", self.sigma_scale.into_iter().all(spread)),
        ]
        .into_iter()
        .find_map(|(name, valid)| (!valid).then_some(name))
    }

    /// One standard deviation of a sun's strength, EV: haze tells the more the longer the way
    /// through it (Beer–Lambert), and a doubtful sun is as unsure as it is doubtful.
    pub(super) fn sun_sigma(&self, sine_of_elevation: f64, sureness: f64) -> f64 {
        let air_mass = 1.0 / sine_of_elevation.max(1.0 / LARGEST_AIR_MASS);
        self.sun_sigma.hypot(HAZE_SIGMA * air_mass) + (1.0 - sureness)
    }

    /// Gain of a region's clipped core over the clipping level, EV: levels off toward the limit.
    pub(crate) fn gain_of(&self, edge: f64, limit: f64) -> f64 {
        let gain = self.gain * edge;
        gain * limit / (gain + limit)
    }

    /// One standard deviation of that gain, EV: none where nothing is missing.
    pub(crate) fn gain_sigma_of(&self, edge: f64) -> f64 {
        self.gain_sigma * edge.sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_looks_cut_out_is_far_above_clipping_and_what_fades_is_not() {
        let texel = 4e-5;
        let gain = |near: f64, core: f64| edge_gain(near, core, texel);
        // s = 1 and s = 1/4: means of twice and 1.25 times the clipping level.
        let exponential = |s: f64| (0.2 / s).exp();
        assert!((gain(0.1 * exponential(1.0), 0.1) - 1.0).abs() < 0.1);
        assert!(gain(0.1 * exponential(0.25), 0.1) < 0.4);
        assert!(gain(0.1, 0.1) > 4.0 && gain(10.0, 0.1) < 0.1);
        // A lamp of four texels shows no edge that could be told from a cut.
        assert!(gain(4.0 * texel, 4.0 * texel) < 0.8 * gain(0.1, 0.1));
        // As small a light can be a point's tip, hardly above clipping, where texels show points as
        // Gaussians: not where they are finer.
        assert!(gain(texel, texel) < 0.5 && edge_gain(texel, texel, texel / 16.0) > 1.5);
        // In a coarse picture as many texels are a lamp, and no point.
        let coarse = 64.0 * texel;
        assert!(edge_gain(4.0 * coarse, 4.0 * coarse, coarse) > 3.0);
        let prior = Prior::default();
        for core in [1e-6, 1e-3, 1.0, 12.0] {
            let found = prior.gain_of(gain(core, core), gain_limit(1.0));
            assert!((0.0..BRIGHTEST).contains(&found), "{core}: {found}");
        }
    }
}
