//! A picture of a volume at a glance: middle slices above, projections like radiographs below.

use glam::{DMat4, DVec3};
use holovol_volume::Volume;
use rayon::prelude::*;

use crate::output::Picture;
use crate::picture::encode_srgb;

/// Side of a panel and width of the gaps, pixels.
const PANEL: usize = 288;
const GAP: usize = 8;
/// Steps through the volume for a projection: finer than most volumes' voxels on the panel.
const STEPS: u32 = 320;
/// Display light behind the panels and behind the volume.
const FRAME: [u8; 4] = [17, 19, 23, 255];
const EMPTY: [u8; 4] = [4, 5, 7, 255];

/// World directions of a panel: to the right, up, and away from the viewer.
const VIEWS: [[DVec3; 3]; 3] = [
    // From the front, from the side at +x, from above with the front at the bottom.
    [DVec3::X, DVec3::Y, DVec3::NEG_Z],
    [DVec3::NEG_Z, DVec3::Y, DVec3::NEG_X],
    [DVec3::X, DVec3::NEG_Z, DVec3::NEG_Y],
];

/// Draws a volume, grey from `window[0]` (black) to `window[1]` (white), at its true proportions.
pub(crate) fn draw(volume: &Volume, world_from_unit_cube: DMat4, window: [f64; 2]) -> Picture {
    let width = 3 * PANEL + 4 * GAP;
    let height = 2 * PANEL + 3 * GAP;
    let mut picture = Picture {
        width: width as u32,
        height: height as u32,
        pixels: vec![FRAME; width * height],
    };
    let centre = world_from_unit_cube.transform_point3(DVec3::splat(0.5));
    let corners = (0..8).map(|corner| {
        let unit = [1, 2, 4].map(|bit| f64::from(u8::from(corner & bit != 0)));
        world_from_unit_cube.transform_point3(DVec3::from_array(unit)) - centre
    });
    let half = corners.fold(DVec3::ZERO, |half, corner| half.max(corner.abs()));
    let half = half.max_element();
    let unit_cube_from_world = world_from_unit_cube.inverse();

    for (column, axes) in VIEWS.into_iter().enumerate() {
        for (row, is_projection) in [false, true].into_iter().enumerate() {
            let levels: Vec<Option<f64>> = (0..PANEL * PANEL)
                .into_par_iter()
                .map(|index| {
                    let at = |i: usize| (i as f64 + 0.5) / PANEL as f64 * 2.0 - 1.0;
                    let [right, up, away] = axes.map(|axis| axis * half);
                    let on_plane = centre + right * at(index % PANEL) - up * at(index / PANEL);
                    let s = |value: f64| {
                        ((value - window[0]) / (window[1] - window[0])).clamp(0.0, 1.0)
                    };
                    if is_projection {
                        project(volume, unit_cube_from_world, on_plane, away, s)
                    } else {
                        slice(volume, unit_cube_from_world, on_plane).map(s)
                    }
                })
                .collect();
            let white = if is_projection {
                white_level(&levels)
            } else {
                1.0
            };
            let panel: Vec<[u8; 4]> = levels
                .iter()
                .map(|level| level.map_or(EMPTY, |level| grey(level / white)))
                .collect();
            let (x, y) = (GAP + column * (PANEL + GAP), GAP + row * (PANEL + GAP));
            for (line, pixels) in panel.chunks(PANEL).enumerate() {
                let start = x + width * (y + line);
                picture.pixels[start..start + PANEL].copy_from_slice(pixels);
            }
        }
    }
    picture
}

fn slice(volume: &Volume, unit_cube_from_world: DMat4, point: DVec3) -> Option<f64> {
    let unit = unit_cube_from_world.transform_point3(point);
    is_inside(unit).then(|| volume.sample(unit))
}

/// What adds up along the line of sight through a point, as a part of what could.
fn project(
    volume: &Volume,
    unit_cube_from_world: DMat4,
    point: DVec3,
    away: DVec3,
    s: impl Fn(f64) -> f64,
) -> Option<f64> {
    let middle = unit_cube_from_world.transform_point3(point);
    let reach = unit_cube_from_world.transform_vector3(away);
    let dims = DVec3::from_array(volume.dims().map(f64::from));
    let (mut sum, mut is_met) = (0.0, false);
    for step in 0..STEPS {
        let t = (f64::from(step) + 0.5) / f64::from(STEPS) * 2.0 - 1.0;
        let unit = middle + reach * t;
        if is_inside(unit) {
            is_met = true;
            sum += s(volume.value((unit * dims).to_array().map(|i| i as i64)));
        }
    }
    is_met.then(|| sum / f64::from(STEPS))
}

/// The level of a projection that is shown white: nearly the largest.
fn white_level(levels: &[Option<f64>]) -> f64 {
    let mut levels: Vec<f64> = levels.iter().flatten().copied().collect();
    levels.sort_by(f64::total_cmp);
    let white = levels.get(levels.len() * 998 / 1000).copied();
    white.filter(|&white| white > 0.0).unwrap_or(1.0)
}

fn is_inside(unit: DVec3) -> bool {
    unit.cmpge(DVec3::ZERO).all() && unit.cmple(DVec3::ONE).all()
}

/// 0 … 1 in display light, slightly brightened in the middle: films of scans are.
fn grey(s: f64) -> [u8; 4] {
    let level = encode_srgb(s.clamp(0.0, 1.0).powf(1.6));
    [level, level, level, 255]
}

#[cfg(test)]
mod tests {
    use super::*;
    use holovol_volume::{Geometry, Voxels};

    /// A volume that is bright in the corner at small x, large y, large z.
    #[test]
    fn panels_look_from_the_front_the_side_and_above() {
        let mut voxels = vec![0u8; 64];
        voxels[4 * (3 + 4 * 3)] = 200;
        let geometry = Geometry::from_spacing([0.001; 3]);
        let volume = Volume::new(Voxels::U8(voxels), [4; 3], 1.0, 0.0, geometry).unwrap();
        let picture = draw(&volume, volume.world_from_unit_cube(), [0.0, 200.0]);
        let pixel = |column: usize, right: bool, bottom: bool| {
            let near = |far: bool| if far { PANEL - 20 } else { 20 };
            let x = GAP + column * (PANEL + GAP) + near(right);
            let y = GAP + PANEL + GAP + near(bottom);
            picture.pixels[x + picture.width as usize * y][0]
        };
        // Front: left, top. From +x: z towards the viewer's left, so left, top. Above: left, bottom.
        for (column, right, bottom) in [(0, false, false), (1, false, false), (2, false, true)] {
            for (r, b) in [(false, false), (false, true), (true, false), (true, true)] {
                let expected = (r, b) == (right, bottom);
                assert_eq!(
                    pixel(column, r, b) == 255,
                    expected,
                    "panel {column} {r} {b}"
                );
            }
        }
    }
}
