//! What the upper half of a panorama says about a sky.

use crate::Grid;

/// What was seen above the horizon.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sky {
    /// Blue over red of what the first exposure sees from 5° up; 1 if there is nothing.
    pub blue_over_red: f64,
    /// How much it looks like a clear sky, 0 … 1.
    pub clearness: f64,
}

/// Sine of the elevation from which on texels count as sky.
const LOWEST: f32 = 0.087;
/// log₂ of blue over red at which a sky begins to look blue, and from which on it is clear.
///
/// Overcast sky and daylit rooms stay below the first (white balance makes them about neutral);
/// clear skies far from the sun reach 2 … 3.5 in blue over red.
const CLEAR: [f64; 2] = [0.26, 0.85];

impl Sky {
    /// Looks at the texels below `clipping` in all channels: the first exposure's level, so that
    /// darker exposures don't change what is seen.
    pub(super) fn look(grid: &Grid, radiance: &[[f32; 3]], clipping: f32) -> Self {
        let width = grid.width();
        let (mut red, mut blue) = (0.0, 0.0);
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
        }
    }
}

/// 0 up to `edges[0]`, 1 from `edges[1]` on, smooth between.
pub(super) fn smoothstep(edges: [f64; 2], x: f64) -> f64 {
    let t = ((x - edges[0]) / (edges[1] - edges[0])).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
