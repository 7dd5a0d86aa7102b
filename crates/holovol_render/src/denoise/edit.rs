//! Which changes of a medium make its former light worth little.

use glam::DVec4;

use crate::Medium;

/// Whether light scattered in the old medium says little of the new one. Rotation and scale of the
/// environment are the caller's to judge, the volume's motion is followed.
pub(super) fn is_edit(before: &Medium, now: &Medium) -> bool {
    let unmoved = Medium {
        world_from_unit_cube: before.world_from_unit_cube,
        environment_rotation_y: before.environment_rotation_y,
        environment_scale: before.environment_scale,
        clip_planes: before.clip_planes.clone(),
        ..now.clone()
    };
    unmoved != *before || !cut_alike(before, now)
}

/// Whether the same of a volume is cut away, wherever it has moved with its planes.
fn cut_alike(before: &Medium, now: &Medium) -> bool {
    const ROUNDING: f64 = 1e-5;
    let planes = |medium: &Medium| -> Vec<DVec4> {
        let to_unit_cube = medium.world_from_unit_cube.transpose();
        let planes = medium.clip_planes.iter().map(|&plane| {
            let plane = to_unit_cube * plane;
            plane / plane.truncate().length().max(f64::MIN_POSITIVE)
        });
        planes.collect()
    };
    let (before, now) = (planes(before), planes(now));
    before.len() == now.len()
        && before
            .iter()
            .zip(&now)
            .all(|(a, b)| (*a - *b).abs().max_element() < ROUNDING)
}

#[cfg(test)]
mod tests {
    use glam::DMat4;
    use holovol_volume::{TransferFunction, TransferPoint};

    use super::*;

    #[test]
    fn planes_that_move_with_their_volume_are_no_edit() {
        let point = TransferPoint {
            s: 0.0,
            sigma_t: 1.0,
            albedo: [0.5; 3],
            emission: [0.0; 3],
            roughness: 0.5,
            specular: 0.0,
        };
        let medium = |place: DMat4, plane: DVec4| Medium {
            window: [0.0, 1.0],
            world_from_unit_cube: place,
            transfer_function: TransferFunction::new(vec![point]).expect("a point"),
            phase_g: 0.0,
            gradient_factor: 0.0,
            max_scatters: Some(1),
            clip_planes: vec![plane],
            environment_rotation_y: 0.0,
            environment_scale: 1.0,
        };
        let plane = DVec4::new(0.6, 0.0, 0.8, -0.3);
        let before = medium(DMat4::IDENTITY, plane);
        let turn = DMat4::from_rotation_y(0.3) * DMat4::from_translation(glam::DVec3::X);
        let along = turn.inverse().transpose() * plane;
        assert!(!is_edit(&before, &medium(turn, along)));
        assert!(
            is_edit(&before, &medium(turn, plane)),
            "through a plane that stays"
        );
        assert!(is_edit(
            &before,
            &medium(DMat4::IDENTITY, plane - DVec4::W * 0.01)
        ));
    }
}
