//! Exposures of one scene to one radiance map, and where even the darkest is clipped.

use crate::measure::any_reaches;

/// A linearised picture of one exposure.
#[derive(Clone, Copy, Debug)]
pub struct Exposure<'a> {
    /// Exposure relative to the first frame, EV: −6 lets through 1/64 of its light.
    pub ev: f64,
    /// Row-major linear RGB; 1 is where this exposure clips.
    pub radiance: &'a [[f32; 3]],
}

/// Values from here on count as clipped: 253 of 255 in sRGB, since compression rings.
pub const CLIPPED: f32 = 0.98;
/// Values below say little: 5 of 255 in sRGB.
pub(super) const FLOOR: f32 = 0.0015;
/// From here to [`CLIPPED`] a value loses its weight, so that no edge shows.
const SHOULDER: f32 = 0.8;
/// Two exposures that differ by more than this factor at a pixel saw different things.
const MOVED: f32 = 1.5;

/// Texels that are looked at together, since most are far from clipping.
const BLOCK: usize = 16;

/// Merges exposures, sorted from the brightest to the darkest.
///
/// `radiance` gets the map in units of the frame with EV 0; `clipped` per pixel a bit per channel
/// that the darkest exposure clips. Returns the ceiling: the radiance at which the darkest clips.
pub(super) fn merge<'a>(
    mut frames: impl Iterator<Item = &'a Exposure<'a>>,
    radiance: &mut [[f32; 3]],
    clipped: &mut [u8],
) -> f32 {
    let gain = |frame: &Exposure| (-frame.ev).exp2() as f32;
    let Some(first) = frames.next() else {
        return 1.0;
    };
    let level = gain(first);
    let blocks = radiance.chunks_mut(BLOCK).zip(clipped.chunks_mut(BLOCK));
    for ((out, bits), texels) in blocks.zip(first.radiance.chunks(BLOCK)) {
        // NaN and negative values become 0.
        let values = texels.as_flattened().iter();
        for (out, value) in out.as_flattened_mut().iter_mut().zip(values) {
            *out = value.max(0.0).clamp(0.0, 1.0) * level;
        }
        bits.fill(0);
        if any_reaches(texels, CLIPPED) {
            for (bits, texel) in bits.iter_mut().zip(texels) {
                for c in 0..3 {
                    *bits |= u8::from(texel[c] >= CLIPPED) << c;
                }
            }
        }
    }
    let mut ceiling = level;
    for frame in frames {
        let (before, level) = (ceiling, gain(frame));
        let blocks = radiance.chunks_mut(BLOCK).zip(clipped.chunks_mut(BLOCK));
        let blocks = blocks.zip(frame.radiance.chunks(BLOCK));
        // Only what was near clipping can gain; most texels end here.
        let near = blocks.filter(|((out, _), _)| any_reaches(out, SHOULDER * before));
        let texels = near.flat_map(|((out, bits), texels)| out.iter_mut().zip(bits).zip(texels));
        for ((out, bits), texel) in texels {
            let brightest = out[0].max(out[1]).max(out[2]);
            if brightest < SHOULDER * before {
                continue;
            }
            for c in 0..3 {
                let value = texel[c].clamp(0.0, 1.0);
                let dark = value * level;
                let bit = 1 << c;
                if *bits & bit != 0 {
                    // What the brighter frame clipped can't be darker, unless it moved; then the
                    // newer, brighter frame's bound holds.
                    let moved = dark * MOVED < before;
                    out[c] = if moved {
                        before
                    } else {
                        dark.max(before * CLIPPED)
                    };
                    if value < CLIPPED {
                        *bits &= !bit;
                    }
                } else if out[c] > SHOULDER * before && value > FLOOR {
                    let agree = dark < out[c] * MOVED && out[c] < dark * MOVED;
                    if dark >= out[c] * MOVED {
                        // Compression has blunted what clipped.
                        out[c] = dark;
                        *bits |= u8::from(value >= CLIPPED) << c;
                    } else if agree {
                        let weight = (out[c] / before - SHOULDER) / (CLIPPED - SHOULDER);
                        out[c] += weight.clamp(0.0, 1.0) * (dark - out[c]);
                    }
                }
            }
        }
        ceiling = level;
    }
    ceiling
}

#[cfg(test)]
mod tests {
    use super::*;

    fn expose(scene: &[f32], ev: f64) -> Vec<[f32; 3]> {
        let scale = ev.exp2() as f32;
        scene.iter().map(|&l| [(l * scale).min(1.0); 3]).collect()
    }

    #[test]
    fn brackets_restore_what_they_see_and_mark_what_they_do_not() {
        let scene = [0.0, 0.02, 0.5, 0.9, 1.5, 30.0, 62.0, 100.0, 1e9];
        let pictures = [0.0, -3.0, -6.0].map(|ev| (ev, expose(&scene, ev)));
        let frames: Vec<Exposure> = pictures
            .iter()
            .map(|(ev, radiance)| Exposure { ev: *ev, radiance })
            .collect();
        let (mut out, mut bits) = (vec![[0.0; 3]; 9], vec![0; 9]);
        assert_eq!(merge(frames.iter(), &mut out, &mut bits), 64.0);
        for (i, &expected) in scene.iter().enumerate() {
            let above = expected > 64.0;
            assert_eq!(bits[i], if above { 7 } else { 0 }, "{expected}");
            assert!((out[i][0] - expected.min(64.0)).abs() <= 1e-5 * expected.min(64.0));
        }
    }

    #[test]
    fn what_compression_blunted_is_told_by_the_darker_exposure() {
        let (base, dark) = (vec![[0.9; 3], [0.85; 3]], vec![[0.5; 3], [1.0; 3]]);
        let frames = [(0.0, &base), (-6.0, &dark)].map(|(ev, radiance)| Exposure { ev, radiance });
        let (mut out, mut bits) = (vec![[0.0; 3]; 2], vec![0; 2]);
        merge(frames.iter(), &mut out, &mut bits);
        assert_eq!((out[0], bits[0]), ([32.0; 3], 0));
        assert_eq!((out[1], bits[1]), ([64.0; 3], 7));
    }

    #[test]
    fn what_moved_between_exposures_does_not_leave_a_hole() {
        let (base, dark) = (vec![[1.0; 3], [0.9; 3]], vec![[0.001; 3], [0.9; 3]]);
        let frames = [
            Exposure {
                ev: 0.0,
                radiance: &base,
            },
            Exposure {
                ev: -6.0,
                radiance: &dark,
            },
        ];
        let (mut out, mut bits) = (vec![[0.0; 3]; 2], vec![0; 2]);
        merge(frames.iter(), &mut out, &mut bits);
        assert_eq!((out[0], bits[0]), ([1.0; 3], 0));
        // What was near clipping may have been clipped.
        assert_eq!((out[1], bits[1]), ([0.9 * 64.0; 3], 0));
    }

    #[test]
    fn broken_values_become_finite_and_non_negative() {
        let base = vec![[f32::NAN, -1.0, f32::INFINITY]];
        let (mut out, mut bits) = (vec![[0.0; 3]; 1], vec![0; 1]);
        let frame = Exposure {
            ev: 0.0,
            radiance: &base,
        };
        merge([frame].iter(), &mut out, &mut bits);
        assert_eq!((out[0], bits[0]), ([0.0, 0.0, 1.0], 4));
    }
}
