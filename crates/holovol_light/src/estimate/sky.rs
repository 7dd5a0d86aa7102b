//! What the upper half of a panorama says about a sky.

use crate::Grid;

/// What was seen above the horizon.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sky {
    /// Blue over red of the unclipped light from 5° up; 1 if there is none.
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
    /// Looks at the texels with no clipped channel.
    pub(super) fn look(grid: &Grid, radiance: &[[f32; 3]], clipped: &[u8]) -> Self {
        let width = grid.width();
        let (mut red, mut blue) = (0.0, 0.0);
        for y in 0..grid.height() {
            if grid.row(y)[1] < LOWEST {
                break;
            }
            let row = y * width..(y + 1) * width;
            let (mut row_red, mut row_blue) = (0.0_f32, 0.0_f32);
            for (texel, &bits) in radiance[row.clone()].iter().zip(&clipped[row]) {
                let seen = if bits == 0 { 1.0 } else { 0.0 };
                row_red += seen * texel[0];
                row_blue += seen * texel[2];
            }
            let solid_angle = f64::from(grid.solid_angle(y));
            red += f64::from(row_red) * solid_angle;
            blue += f64::from(row_blue) * solid_angle;
        }
        let blue_over_red = if red > 0.0 && blue > 0.0 { blue / red } else { 1.0 };
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
