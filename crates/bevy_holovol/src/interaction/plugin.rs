//! From hands to transforms.

use bevy::camera::primitives::Aabb;
use bevy::prelude::*;

use super::{Grabbable, Hands, Interaction, Placement};

/// Lets hands take what is [`Graspable`]; whoever knows of hands sets [`Hands`] before
/// [`InteractionSystems`].
pub struct InteractionPlugin;

/// `PreUpdate`: graspable things follow the hands.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct InteractionSystems;

/// Makes an entity with a box around it, such as a [`Volume3d`](crate::Volume3d), something that
/// hands can take. Its scale should be alike along all axes: hands make it so.
#[derive(Component, Reflect, Clone, Copy, Debug, PartialEq)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
pub struct Graspable {
    /// Whether corners scale and edges turn; true by default.
    pub has_handles: bool,
    /// Bounds of the transform's scale; 0.1 to 10 by default.
    pub scale_limits: [f32; 2],
}

impl Default for Graspable {
    fn default() -> Self {
        Self {
            has_handles: true,
            scale_limits: [0.1, 10.0],
        }
    }
}

/// What the hands are doing; its settings can be changed.
#[derive(Resource, Default, Debug, Deref, DerefMut)]
pub struct CurrentInteraction(pub Interaction);

impl Plugin for InteractionPlugin {
    fn build(&self, app: &mut App) {
        app.register_type::<Graspable>()
            .init_resource::<Hands>()
            .init_resource::<CurrentInteraction>()
            .add_systems(PreUpdate, follow_hands.in_set(InteractionSystems));
    }
}

fn follow_hands(
    time: Res<Time>,
    hands: Res<Hands>,
    mut interaction: ResMut<CurrentInteraction>,
    mut graspables: Query<(Entity, &Graspable, &Aabb, &mut Transform), Without<ChildOf>>,
    mut former: Local<Vec<Entity>>,
    mut things: Local<Vec<Grabbable>>,
) {
    former.clear();
    things.clear();
    former.extend(graspables.iter().map(|(entity, ..)| entity));
    // The order of a query may change; entities' own doesn't.
    former.sort_unstable();
    for entity in former.iter() {
        let Ok((_, graspable, aabb, transform)) = graspables.get(*entity) else {
            continue;
        };
        let center = Vec3::from(aabb.center);
        things.push(Grabbable {
            placement: Placement {
                translation: transform.transform_point(center),
                rotation: transform.rotation.normalize(),
                scale: transform.scale.x,
            },
            half_size: aabb.half_extents.into(),
            has_handles: graspable.has_handles,
            scale_limits: graspable.scale_limits,
        });
    }
    interaction
        .bypass_change_detection()
        .update(&hands, &mut things, time.delta_secs());
    for (entity, thing) in former.iter().zip(things.iter()) {
        let Ok((_, _, aabb, mut transform)) = graspables.get_mut(*entity) else {
            continue;
        };
        let Placement {
            translation,
            rotation,
            scale,
        } = thing.placement;
        let center = Vec3::from(aabb.center);
        let moved = Transform {
            translation: translation - rotation * (scale * center),
            rotation,
            scale: Vec3::splat(scale),
        };
        // Rounding is no movement: it would begin images anew.
        let is_near = moved.translation.distance(transform.translation) < 1e-6
            && moved.rotation.angle_between(transform.rotation) < 1e-6
            && (moved.scale - transform.scale).abs().max_element() < 1e-6;
        if !is_near {
            *transform = moved;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Hand;
    use super::*;
    use bevy::math::Isometry3d;

    fn hand(place: Vec3, squeeze: f32) -> Hands {
        let hand = Hand {
            grip: Some(Isometry3d::from_translation(place)),
            squeeze,
            ..default()
        };
        Hands([Hand::default(), hand])
    }

    #[test]
    fn an_entity_follows_the_hand_and_rests_without() {
        let mut app = App::new();
        app.add_plugins((MinimalPlugins, InteractionPlugin));
        let center = Vec3::new(0.2, 0.0, 0.0);
        let aabb = Aabb {
            center: center.into(),
            half_extents: Vec3::splat(0.1).into(),
        };
        let place = Transform::from_xyz(1.0, 0.0, 0.0).with_scale(Vec3::splat(2.0));
        let entity = app
            .world_mut()
            .spawn((Graspable::default(), aabb, place))
            .id();
        let transform = |app: &App| *app.world().get::<Transform>(entity).expect("it");
        app.world_mut()
            .resource_mut::<CurrentInteraction>()
            .settings
            .smoothing = 0.0;
        let grasp = place.transform_point(center);
        for squeeze in [0.0, 1.0] {
            app.insert_resource(hand(grasp, squeeze));
            app.update();
        }
        assert_eq!(transform(&app), place, "taken, not moved");
        app.insert_resource(hand(grasp + Vec3::Y, 1.0));
        app.update();
        assert!((transform(&app).translation - Vec3::new(1.0, 1.0, 0.0)).length() < 1e-5);
        app.insert_resource(Hands::default());
        app.update();
        app.world_mut().clear_trackers();
        app.update();
        let entity = app.world().entity(entity);
        let tick = entity.get_ref::<Transform>().expect("it");
        assert!(!tick.is_changed(), "nothing holds it");
    }
}
