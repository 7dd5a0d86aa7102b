//! From hands to transforms.

use bevy::camera::primitives::Aabb;
use bevy::math::Isometry3d;
use bevy::prelude::*;

use super::{
    Grabbable, Hand, HandMenu, HandPlane, Handle, Hands, Interaction, Placement, Surface,
    SurfaceTouch, Touching, cutting, pose_of,
};

/// Lets hands take what is [`Graspable`], press [`TouchPanel`]s and the menu, and hold
/// [`HandPlane`]s; whoever knows of hands sets [`Hands`], and [`Viewer`], before
/// [`InteractionSystems`].
pub struct InteractionPlugin;

/// `PreUpdate`: things follow the hands, panels are pressed.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct InteractionSystems;

/// With [`InteractionPlugin`], which [`HolovolPlugins`](crate::HolovolPlugins) leave out: makes an
/// entity with a box around it, such as a [`Volume3d`](crate::Volume3d), something that
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

/// Where the user looks from: between the eyes, −z ahead; in the world's coordinates.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq)]
pub struct Viewer(pub Option<Isometry3d>);

/// The menu at the hand; not there before somebody inserts it.
#[derive(Resource, Default, Debug, Deref)]
pub struct CurrentMenu(HandMenu);

/// A button of the [`CurrentMenu`] is pressed: its number from the top.
#[derive(Message, Clone, Copy, Debug, PartialEq, Eq)]
pub struct MenuPressed(pub usize);

/// A rectangle that hands press with a fingertip, or with a ray and a pinch: around the entity's
/// origin, +x to the right and +y up as seen by who faces it, from its +z. Its scale counts for
/// nothing.
#[derive(Component, Clone, Copy, Debug, Default)]
#[require(Transform)]
pub struct TouchPanel {
    /// m to the right and the upper edge.
    pub half_size: Vec2,
    touching: Touching,
    touch: SurfaceTouch,
}

impl TouchPanel {
    /// Reaches so far, m, to each side.
    pub fn new(half_size: Vec2) -> Self {
        Self {
            half_size,
            ..default()
        }
    }

    /// What hands do to it in this frame.
    pub fn touch(&self) -> SurfaceTouch {
        self.touch
    }
}

/// What a hand touches, points at or has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandTarget {
    /// Something [`Graspable`], or a [`TouchPanel`]; `None` is the menu.
    pub entity: Option<Entity>,
    /// Which handle of a thing.
    pub handle: Option<Handle>,
    /// Taken or pressed.
    pub is_held: bool,
    /// Touched; else it is at the end of the ray.
    pub is_near: bool,
    /// Where, in the world.
    pub place: Vec3,
}

/// What the hands are at, left and right; read only.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq)]
pub struct HandTargets(pub [Option<HandTarget>; 2]);

/// Hands as far as nothing else has them.
#[derive(Resource, Default)]
pub(super) struct FreeHands(pub(super) Hands);

impl Plugin for InteractionPlugin {
    fn build(&self, app: &mut App) {
        app.register_type::<Graspable>()
            .init_resource::<Hands>()
            .init_resource::<Viewer>()
            .init_resource::<FreeHands>()
            .init_resource::<HandTargets>()
            .init_resource::<CurrentInteraction>()
            .add_message::<MenuPressed>()
            .add_systems(
                PreUpdate,
                (press, cutting::follow_hands, follow_hands)
                    .chain()
                    .in_set(InteractionSystems),
            );
    }
}

/// Menu and panels first: a hand at one of them takes nothing behind it.
#[expect(
    clippy::too_many_arguments,
    reason = "all that a hand may have to do with"
)]
fn press(
    time: Res<Time>,
    hands: Res<Hands>,
    viewer: Res<Viewer>,
    interaction: Res<CurrentInteraction>,
    menu: Option<ResMut<CurrentMenu>>,
    mut panels: Query<(Entity, &mut TouchPanel, &GlobalTransform)>,
    planes: Query<&HandPlane>,
    mut free: ResMut<FreeHands>,
    mut targets: ResMut<HandTargets>,
    mut pressed: MessageWriter<MenuPressed>,
) {
    let mut busy = [0, 1].map(|hand| interaction.held(hand).is_some());
    let mut taken = [false; 2];
    for plane in &planes {
        busy[plane.hand()] = true;
        taken[plane.hand()] = true;
    }
    let targets = &mut targets.bypass_change_detection().0;
    *targets = [None; 2];
    if let Some(mut menu) = menu {
        let dt = time.delta_secs();
        let button = menu
            .bypass_change_detection()
            .0
            .update(&hands, busy, viewer.0, dt);
        pressed.write_batch(button.map(MenuPressed));
        if let Some(surface) = menu.surface() {
            point_at(targets, None, &surface, menu.touch());
        }
        for hand in 0..2 {
            let has = menu.has(hand);
            busy[hand] |= has;
            taken[hand] |= has;
        }
    }
    for (entity, mut panel, transform) in &mut panels {
        let surface = Surface {
            pose: transform.to_isometry(),
            half_size: panel.half_size,
        };
        let panel = panel.bypass_change_detection();
        panel.touch = panel.touching.update(&hands, busy, &surface);
        point_at(targets, Some(entity), &surface, panel.touch);
        if let Some(hand) = panel.touch.hand {
            busy[hand] = true;
            taken[hand] = true;
        }
    }
    free.0 = *hands;
    for (hand, taken) in free.0.0.iter_mut().zip(taken) {
        if taken {
            // Still squeezed or not, so that letting it go takes nothing.
            *hand = Hand {
                aim: None,
                grip: hand
                    .grip
                    .or(hand.aim)
                    .map(|_| Isometry3d::from_translation(AWAY)),
                ..*hand
            };
        }
    }
}

fn point_at(
    targets: &mut [Option<HandTarget>; 2],
    entity: Option<Entity>,
    surface: &Surface,
    touch: SurfaceTouch,
) {
    if let Some(hand) = touch.hand {
        targets[hand] = Some(HandTarget {
            entity,
            handle: None,
            is_held: touch.is_pressed,
            is_near: touch.is_near,
            place: surface.point(touch.place),
        });
    }
}

/// Where hands are that take nothing.
const AWAY: Vec3 = Vec3::new(0.0, -1e6, 0.0);

fn follow_hands(
    time: Res<Time>,
    hands: Res<FreeHands>,
    mut interaction: ResMut<CurrentInteraction>,
    mut targets: ResMut<HandTargets>,
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
        .update(&hands.0, &mut things, time.delta_secs());
    for (index, target) in targets.bypass_change_detection().0.iter_mut().enumerate() {
        let hand = &hands.0.0[index];
        let grip = interaction.grip(index);
        if let Some(reached) = grip.or_else(|| Interaction::hovered(hand, &things))
            && let Some(pose) = pose_of(hand, reached.far)
        {
            *target = Some(HandTarget {
                entity: former.get(reached.thing).copied(),
                handle: reached.handle,
                is_held: grip.is_some(),
                is_near: reached.far.is_none(),
                place: pose.translation.into(),
            });
        }
    }
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
    fn a_hand_at_a_panel_takes_nothing_behind_it() {
        let mut app = App::new();
        app.add_plugins((MinimalPlugins, InteractionPlugin));
        let aabb = Aabb {
            half_extents: Vec3::splat(0.1).into(),
            ..default()
        };
        let behind = Transform::from_xyz(0.0, 0.0, -2.0);
        let thing = app
            .world_mut()
            .spawn((Graspable::default(), aabb, behind))
            .id();
        let panel = app
            .world_mut()
            .spawn((
                TouchPanel::new(Vec2::splat(0.2)),
                GlobalTransform::from_xyz(0.0, 0.0, -1.0),
            ))
            .id();
        let point = |app: &mut App, yaw: f32, squeeze: f32| {
            let aim = Isometry3d::from_rotation(Quat::from_rotation_y(yaw));
            let hand = Hand {
                grip: Some(Isometry3d::IDENTITY),
                aim: Some(aim),
                squeeze,
                ..default()
            };
            app.insert_resource(Hands([Hand::default(), hand]));
            app.update();
        };
        for (yaw, squeeze) in [(0.0, 0.0), (0.0, 1.0), (0.05, 1.0)] {
            point(&mut app, yaw, squeeze);
        }
        let touch = app.world().get::<TouchPanel>(panel).expect("it").touch();
        assert!(touch.is_pressed && touch.place.x < 0.5, "{touch:?}");
        assert_eq!(app.world().resource::<CurrentInteraction>().held(1), None);
        point(&mut app, 0.0, 0.0);
        app.world_mut().despawn(panel);
        for squeeze in [0.0, 1.0] {
            point(&mut app, 0.0, squeeze);
        }
        let held = app.world().resource::<CurrentInteraction>().held(1);
        assert_eq!(held, Some(0), "without the panel it is taken");
        assert_eq!(*app.world().get::<Transform>(thing).expect("it"), behind);
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
