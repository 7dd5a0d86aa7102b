//! A mouse, or whatever points, as the right hand: in windows, taking things needs no headset.

use bevy::math::{Isometry3d, Mat3, Quat, Ray3d};
use bevy::prelude::*;

use super::{Hand, Hands, InteractionSystems};

/// Where a pointer points; set in every frame before [`InteractionSystems`], for example from
/// `Camera::viewport_to_world` at the cursor and a mouse button.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq)]
pub struct PointerHand {
    /// From the camera on; `None` while the pointer is elsewhere.
    pub ray: Option<Ray3d>,
    /// Whether it takes.
    pub is_pressed: bool,
}

/// Makes the [`PointerHand`] the right hand while that isn't tracked.
pub struct PointerHandPlugin;

impl Plugin for PointerHandPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<PointerHand>()
            .add_systems(PreUpdate, point.before(InteractionSystems));
    }
}

fn point(pointer: Res<PointerHand>, mut hands: ResMut<Hands>, mut was_it: Local<bool>) {
    let right = &mut hands.bypass_change_detection().0[1];
    let is_tracked = !*was_it && (right.grip.is_some() || right.aim.is_some());
    // Headsets set hands anew in every frame; nobody else does.
    *was_it = !is_tracked;
    if !is_tracked {
        *right = pointer.hand();
    }
}

impl PointerHand {
    fn hand(&self) -> Hand {
        let Some(ray) = self.ray else {
            return Hand::default();
        };
        Hand {
            aim: Some(Isometry3d::new(ray.origin, along(*ray.direction))),
            squeeze: if self.is_pressed { 1.0 } else { 0.0 },
            ..Hand::default()
        }
    }
}

/// −z along a direction, without turning about it as it moves.
fn along(direction: Vec3) -> Quat {
    let z = -direction;
    let x = Vec3::Y.cross(z).try_normalize().unwrap_or(Vec3::X);
    Quat::from_mat3(&Mat3::from_cols(x, z.cross(x), z)).normalize()
}

#[cfg(test)]
mod tests {
    use super::super::{CurrentInteraction, Graspable, InteractionPlugin};
    use super::*;
    use bevy::camera::primitives::Aabb;

    #[test]
    fn a_mouse_drags_things() {
        let mut app = App::new();
        app.add_plugins((MinimalPlugins, InteractionPlugin, PointerHandPlugin));
        let aabb = Aabb {
            half_extents: Vec3::splat(0.1).into(),
            ..default()
        };
        let graspable = Graspable {
            has_handles: false,
            ..default()
        };
        let place = Transform::from_xyz(0.0, 0.0, -1.0);
        let thing = app.world_mut().spawn((graspable, aabb, place)).id();
        app.world_mut()
            .resource_mut::<CurrentInteraction>()
            .settings
            .smoothing = 0.0;
        let drag = |app: &mut App, toward: Option<Vec3>, is_pressed: bool| {
            let ray = toward
                .map(|toward| Ray3d::new(Vec3::ZERO, Dir3::new(toward).expect("a direction")));
            app.insert_resource(PointerHand { ray, is_pressed });
            app.update();
            app.world().get::<Transform>(thing).expect("it").translation
        };
        drag(&mut app, Some(Vec3::NEG_Z), false);
        drag(&mut app, Some(Vec3::NEG_Z), true);
        let aside = Vec3::new(0.5, 0.0, -1.0);
        let moved = drag(&mut app, Some(aside), true);
        // As far as it was held, in the new direction.
        assert!(moved.x > 0.35 && moved.x < 0.5, "{moved}");
        let left = drag(&mut app, Some(Vec3::NEG_X), false);
        assert_eq!(left, moved, "let go");
        assert_eq!(drag(&mut app, None, true), moved);
        // Pressed elsewhere, it takes nothing that it comes over.
        for toward in [Vec3::NEG_X, Vec3::NEG_X, moved] {
            assert_eq!(drag(&mut app, Some(toward), true), moved);
        }
        assert_eq!(app.world().resource::<CurrentInteraction>().held(1), None);
    }
}
