//! T: how much the light has changed, for renderers whose light is an environment map.

use std::f64::consts::{PI, TAU};

use glam::{DMat3, DMat4};
use holovol_light::change::ChangeDetector;
use holovol_light::{EnvironmentMap, Grid};

/// What an exchange counts for where it can't be measured: as a lamp switched on.
const EXCHANGED: f32 = 0.9;
/// A turn by 10° counts as the sun moved by as much: 0.5 (DESIGN §6).
const PER_RADIAN: f64 = 0.5 * 18.0 / PI;
/// Texels that the detector's cells need along each side.
const MEASURABLE: usize = 128;

/// T of one map after another, 0 … 1: that of patches of log radiance, or of the change of a colour
/// channel's total if that is more. Takes a few ms for each million of texels.
pub fn environment_change(before: &EnvironmentMap, now: &EnvironmentMap) -> f32 {
    if before.texels().as_ptr() == now.texels().as_ptr() {
        return 0.0;
    }
    let size = |map: &EnvironmentMap| [map.width(), map.height()];
    let is_fine = |map: &EnvironmentMap| size(map).iter().all(|&n| n >= MEASURABLE);
    let totals = channels(before, now);
    if before.as_constant().is_some() && now.as_constant().is_some() {
        return totals;
    }
    if size(before) != size(now) && !(is_fine(before) && is_fine(now)) {
        return EXCHANGED;
    }
    let mut detector = ChangeDetector::new();
    let mut update = |map: &EnvironmentMap| {
        let grid = Grid::new(map.width(), map.height());
        detector.update(&grid, map.texels(), &[])
    };
    update(before);
    (update(now) as f32).max(totals).min(1.0)
}

/// The largest relative change of a channel's total.
fn channels(before: &EnvironmentMap, now: &EnvironmentMap) -> f32 {
    let [a, b] = [before, now].map(|map| {
        let (width, mut total) = (map.width(), [0.0; 3]);
        for (y, row) in map.texels().chunks_exact(width).enumerate() {
            let v = (y as f64 + 0.5) / map.height() as f64;
            let solid_angle = (v * PI).sin() / (width * map.height()) as f64;
            for texel in row {
                for (total, &c) in total.iter_mut().zip(texel) {
                    *total += solid_angle * f64::from(c);
                }
            }
        }
        total
    });
    // A channel that is dark beside the others changes nothing to be seen.
    let floor = 0.01 * a.into_iter().chain(b).fold(0.0, f64::max);
    let change = |a: f64, b: f64| dimming(a + floor, b + floor);
    (0..3).map(|c| change(a[c], b[c])).fold(0.0, f32::max)
}

/// 0 for the same brightness, 1 for light and darkness.
fn dimming(a: f64, b: f64) -> f32 {
    let (low, high) = (a.min(b), a.max(b));
    if high > 0.0 {
        (1.0 - low / high).clamp(0.0, 1.0) as f32
    } else {
        0.0
    }
}

/// Follows the T of an environment that is exchanged, turned and dimmed.
#[derive(Clone, Debug, Default)]
pub struct LightChange(Option<Light>);

#[derive(Clone, Debug)]
struct Light {
    map: EnvironmentMap,
    rotation_y: f64,
    scale: f64,
}

impl LightChange {
    /// The map of the last frame.
    pub fn map(&self) -> Option<&EnvironmentMap> {
        self.0.as_ref().map(|light| &light.map)
    }

    /// T between the last frame's light and this, 0 … 1; 0 for the first. `exchanged` tells the T
    /// of another map, if it is one: [`environment_change`], or what a worker has found of it.
    pub fn update(
        &mut self,
        map: &EnvironmentMap,
        rotation_y: f64,
        scale: f64,
        exchanged: impl FnOnce(&EnvironmentMap) -> f32,
    ) -> f32 {
        let now = Light {
            map: map.clone(),
            rotation_y,
            scale,
        };
        let Some(before) = self.0.replace(now) else {
            return 0.0;
        };
        let mut change = dimming(scale, before.scale);
        if map.texels().as_ptr() != before.map.texels().as_ptr() {
            change = change.max(exchanged(&before.map));
        }
        if map.as_constant().is_none() {
            let turned = (rotation_y - before.rotation_y).rem_euclid(TAU);
            let turn = PER_RADIAN * turned.min(TAU - turned);
            change = change.max(turn.min(f64::from(EXCHANGED)) as f32);
        }
        change.clamp(0.0, 1.0)
    }
}

/// T for places of a volume that has moved so: what turns changes as under a turned environment, what
/// grows by a tenth has optical depths that are a tenth more, which counts 0.2.
pub(super) fn change_by_motion(moved: DMat4) -> f32 {
    let linear = DMat3::from_mat4(moved);
    let scale = linear.determinant().abs().cbrt();
    let off = (linear * scale.recip() - DMat3::IDENTITY).to_cols_array();
    // Of a turn: the length is the square root of 8 times the sine of half the angle.
    let length = off.iter().map(|x| x * x).sum::<f64>().sqrt();
    let turned = 2.0 * (length / 8f64.sqrt()).min(1.0).asin();
    let change = (PER_RADIAN * turned).max(2.0 * scale.ln().abs()).min(1.0) as f32;
    if change.is_nan() { 1.0 } else { change }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    fn room(lamp: f32, tint: [f32; 3]) -> EnvironmentMap {
        let texel = |i: usize| {
            let (x, y) = (i % 256, i / 256);
            let is_lamp = (100..106).contains(&x) && (30..36).contains(&y);
            let l = 0.2 + 0.1 * ((x / 9 + y / 7) % 3) as f32 + if is_lamp { lamp } else { 0.0 };
            tint.map(|c| c * l)
        };
        EnvironmentMap::new(256, 128, (0..256 * 128).map(texel).collect())
    }

    #[test]
    fn maps_change_as_much_as_they_differ() {
        let white = [1.0; 3];
        let (off, on) = (room(0.0, white), room(200.0, white));
        assert_eq!(environment_change(&off, &off.clone()), 0.0);
        assert_eq!(environment_change(&off, &room(0.0, white)), 0.0, "as new");
        assert!(environment_change(&off, &on) > 0.8);
        assert!(environment_change(&on, &off) > 0.8);
        let warm = environment_change(&off, &room(0.0, [1.0, 1.0, 0.5]));
        assert!((0.4..0.6).contains(&warm), "another colour: {warm}");
        let constant = EnvironmentMap::constant;
        let red = environment_change(&constant([1.0; 3]), &constant([1.0, 0.0, 0.0]));
        assert!(red > 0.9, "{red}");
        assert!(environment_change(&constant([0.3; 3]), &on) > 0.8);
    }

    #[test]
    fn turns_and_dimming_count() {
        let (map, mut change) = (room(200.0, [1.0; 3]), LightChange::default());
        let same = |_: &EnvironmentMap| panic!("it is the same map");
        assert_eq!(change.update(&map, 0.0, 1.0, same), 0.0, "the first");
        assert_eq!(change.update(&map, 0.0, 1.0, same), 0.0);
        let turned = change.update(&map, 10f64.to_radians(), 1.0, same);
        assert!((turned - 0.5).abs() < 1e-6, "{turned}");
        let dimmed = change.update(&map, 10f64.to_radians(), 0.25, same);
        assert!((dimmed - 0.75).abs() < 1e-6, "{dimmed}");
        let other = EnvironmentMap::constant([1.0; 3]);
        assert_eq!(change.update(&other, 3.0, 0.25, |_| 0.6), 0.6);
        assert_eq!(change.update(&other, 0.0, 0.25, same), 0.0, "turned alike");
    }

    #[test]
    fn turned_volumes_count_as_turned_light() {
        let turn =
            |degrees: f64| DMat4::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), degrees.to_radians());
        for degrees in [0.0, 0.5, 10.0] {
            let expected = 0.05 * degrees as f32;
            let found = change_by_motion(turn(degrees) * DMat4::from_translation(DVec3::X));
            assert!(
                (found - expected).abs() < 1e-6,
                "{found}, {degrees} degrees"
            );
        }
        assert_eq!(change_by_motion(turn(179.0)), 1.0);
        assert_eq!(
            change_by_motion(DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0))),
            1.0
        );
        let grown = change_by_motion(DMat4::from_scale(DVec3::splat(1.1)));
        assert!((grown - 0.19).abs() < 0.01, "{grown}");
        for nowhere in [DMat4::ZERO, DMat4::NAN] {
            assert_eq!(change_by_motion(nowhere), 1.0);
        }
    }
}
