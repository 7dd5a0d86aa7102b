//! What the upper half of a panorama says about a sky.

use crate::Grid;

/// What was seen above the horizon.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sky {
    /// Blue over red of what the first exposure sees from 5° up; 1 if there is nothing.
    pub blue_over_red: f64,
    /// How much it looks like a clear sky, 0 … 1.
    pub clearness: f64,
    /// Optical depth of haze, from how blue the blue part of the sky is.
    pub haze: f64,
}

/// Sine of the elevation from which on texels count as sky.
const LOWEST: f32 = 0.087;
/// log₂ of blue over red at which a sky begins to look blue, and from which on it is clear.
///
/// Overcast sky and daylit rooms stay below the first (white balance makes them about neutral);
/// clear skies far from the sun reach 2 … 3.5 in blue over red.
const CLEAR: [f64; 2] = [0.26, 0.85];

/// Only every such texel of every such row is asked for its colour.
const STRIDE: usize = 4;
/// Bins of log₂ of blue over red, and what they cover.
const BINS: usize = 64;
const BLUES: [f32; 2] = [0.2, 4.2];
/// log₂ of blue over red by which white balance makes a sky bluer than sunlight outside the air
/// would: the light on the ground is what is made white.
const WHITE_BALANCE: f64 = 0.4;
/// Optical depth of air in blue and red (465 and 610 nm), and of haze of depth 1 at 550 nm with
/// an Ångström exponent of 1.3.
const AIR: [f64; 2] = [0.195, 0.064];
const HAZE: [f64; 2] = [1.24, 0.875];
/// Haze scatters forward: as seen from aside, half as much as air of the same depth does
/// (Henyey–Greenstein with g = 0.65 over Rayleigh is 0.64 at 75° and 0.45 at 90°).
const ASIDE: f64 = 0.5;
/// Largest optical depth that haze with a sun to be seen has.
const THICKEST: f64 = 0.6;
/// Air masses are counted up to here.
const LARGEST_AIR_MASS: f64 = 8.0;

impl Sky {
    /// Share of the sun's light that haze lets through, over what it would let through at the
    /// zenith (Beer–Lambert).
    pub(super) fn transmittance(&self, sine_of_elevation: f64) -> f64 {
        let air_mass = 1.0 / sine_of_elevation.max(1.0 / LARGEST_AIR_MASS);
        (-self.haze * (air_mass - 1.0)).exp()
    }

    /// Looks at the texels below `clipping` in all channels: the first exposure's level, so that
    /// darker exposures don't change what is seen.
    pub(super) fn look(grid: &Grid, radiance: &[[f32; 3]], clipping: f32) -> Self {
        let width = grid.width();
        let (mut red, mut blue) = (0.0, 0.0);
        let mut blues = [0.0_f64; BINS];
        for (y, row) in radiance.chunks_exact(width).enumerate() {
            if grid.row(y)[1] < LOWEST {
                break;
            }
            let mut sum = [0.0_f32; 3];
            for texel in row {
                let seen = texel[0].max(texel[1]).max(texel[2]) < clipping;
                for c in 0..3 {
                    sum[c] += if seen { texel[c] } else { 0.0 };
                }
            }
            if y % STRIDE == 0 {
                for texel in row.iter().step_by(STRIDE) {
                    let open = texel[0].max(texel[1]).max(texel[2]) < clipping;
                    let blue = (texel[2] / texel[0].max(1e-9)).log2();
                    // Not trees, walls, clouds or the glow around the sun.
                    if open && blue > BLUES[0] {
                        let place = (blue - BLUES[0]) / (BLUES[1] - BLUES[0]) * BINS as f32;
                        blues[(place as usize).min(BINS - 1)] += f64::from(grid.solid_angle(y));
                    }
                }
            }
            red += f64::from(sum[0] * grid.solid_angle(y));
            blue += f64::from(sum[2] * grid.solid_angle(y));
        }
        let blue_over_red = if red > 0.0 && blue > 0.0 {
            blue / red
        } else {
            1.0
        };
        Self {
            blue_over_red,
            clearness: smoothstep(CLEAR, blue_over_red.log2()),
            haze: haze(&blues),
        }
    }
}

/// Optical depth of the haze that makes a sky of air as little blue as this one, if both
/// scatter once.
fn haze(blues: &[f64; BINS]) -> f64 {
    let half = 0.5 * blues.iter().sum::<f64>();
    let mut sum = 0.0;
    let middle = blues.iter().position(|light| {
        sum += light;
        sum >= half
    });
    let bin = middle.unwrap_or(0) as f64 + 0.5;
    let [least, most] = BLUES.map(f64::from);
    let blue = least + bin / BINS as f64 * (most - least);
    // blue/red = (AIR + ASIDE · HAZE · depth) of blue over that of red.
    let ratio = (blue - WHITE_BALANCE).exp2();
    let per_depth = ASIDE * (ratio * HAZE[1] - HAZE[0]);
    if per_depth <= 0.0 {
        return THICKEST;
    }
    ((AIR[0] - ratio * AIR[1]) / per_depth).clamp(0.0, THICKEST)
}

/// 0 up to `edges[0]`, 1 from `edges[1]` on, smooth between.
pub(super) fn smoothstep(edges: [f64; 2], x: f64) -> f64 {
    let t = ((x - edges[0]) / (edges[1] - edges[0])).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sky of air and haze that scatter once, seen at right angles to the sun.
    fn sky(depth: f64) -> Sky {
        let grid = Grid::new(64, 32);
        // Henyey–Greenstein with g = 0.65 at 82°, over Rayleigh.
        let aside = 0.51;
        let level = |c: usize| (AIR[c] + aside * HAZE[c] * depth) as f32;
        let [blue, red] = [level(0) * (WHITE_BALANCE.exp2() as f32), level(1)];
        Sky::look(&grid, &vec![[red, 0.5 * (red + blue), blue]; 64 * 32], 10.0)
    }

    #[test]
    fn haze_is_told_by_how_blue_the_sky_is_and_dims_a_low_sun() {
        for depth in [0.05, 0.2, 0.4] {
            let found = sky(depth).haze;
            assert!((found / depth - 1.0).abs() < 0.25, "{found} for {depth}");
        }
        assert_eq!(sky(0.3).transmittance(1.0), 1.0);
        assert!(sky(0.3).transmittance(0.2) < 0.45);
        assert!(sky(0.02).transmittance(0.2) > 0.8);
    }
}
