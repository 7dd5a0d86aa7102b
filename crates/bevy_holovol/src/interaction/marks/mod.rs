//! What hands do, drawn: boxes with their handles, rays, the menu, planes.
//!
//! Marks are ordinary meshes without light of their own, so that volumes hide them, and they
//! volumes, as with any mesh. Boxes are drawn just outside what they surround: a mesh inside a
//! volume costs a pass for its depth.

mod pieces;

use bevy::camera::primitives::Aabb;
use bevy::camera::visibility::RenderLayers;
use bevy::light::NotShadowCaster;
use bevy::prelude::*;

use self::pieces::{
    CURSOR, HAND, Paint, Piece, RAY, Shape, add_box, add_line, add_menu, add_plane, ball,
};
use super::plugin::FreeHands;
use super::{
    CurrentMenu, Graspable, Hand, HandPlane, HandTarget, HandTargets, Hands, MENU_BUTTONS,
    Placement, TouchPanel,
};
use crate::VolumeClipPlane;

/// Draws what hands do: boxes with their handles around what they are at, their rays, the menu, and
/// planes that they hold or have put down. As [`InteractionPlugin`](super::InteractionPlugin), which
/// it needs beside it, it needs no headset. Where there is neither hand nor plane nothing is drawn,
/// and nothing is made before the first one comes.
///
/// Needs Bevy's meshes (`PbrPlugin`). [`InteractionMarks`] are its settings.
pub struct InteractionMarksPlugin;

impl Plugin for InteractionMarksPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<InteractionMarks>()
            .init_resource::<MenuFace>()
            .add_systems(PostUpdate, draw.before(TransformSystems::Propagate));
    }
}

/// How marks look.
#[derive(Resource, Clone, Debug)]
pub struct InteractionMarks {
    /// Of what no hand is at.
    pub idle: Color,
    /// Of what a hand is at.
    pub hover: Color,
    /// Of what a hand has or presses.
    pub held: Color,
    /// Of the menu behind its buttons, and of these.
    pub plate: Color,
    /// See `plate`.
    pub button: Color,
    /// Whether hands have a ball where they grasp: where their own can't be seen.
    pub has_hands: bool,
    /// Which cameras see them; by default layer 0.
    pub layers: RenderLayers,
}

impl Default for InteractionMarks {
    fn default() -> Self {
        Self {
            idle: Color::srgb(0.75, 0.78, 0.82),
            hover: Color::srgb(0.35, 0.75, 1.0),
            held: Color::srgb(1.0, 0.77, 0.25),
            plate: Color::srgb(0.10, 0.11, 0.13),
            button: Color::srgb(0.30, 0.33, 0.38),
            has_hands: true,
            layers: RenderLayers::default(),
        }
    }
}

/// What is on the buttons of [`CurrentMenu`], from the top.
#[derive(Resource, Clone, Debug, Default)]
pub struct MenuFace {
    /// Pictures: meshes around the origin within ±0.5 along x and y, seen from +z.
    pub icons: [Option<Handle<Mesh>>; MENU_BUTTONS],
    /// Buttons that show something is on.
    pub is_on: [bool; MENU_BUTTONS],
}

/// On all that is drawn here.
#[derive(Component)]
struct Mark;

/// What is spawned, each kind's in the order in which a frame uses it.
#[derive(Default)]
struct Pool {
    cubes: Vec<Entity>,
    balls: Vec<Entity>,
    icons: [Vec<Entity>; MENU_BUTTONS],
    kit: Option<Kit>,
    used: usize,
}

/// Made with the first piece.
struct Kit {
    cube: Handle<Mesh>,
    ball: Handle<Mesh>,
    paints: [Handle<StandardMaterial>; Paint::COUNT],
}

impl Kit {
    fn new(
        marks: &InteractionMarks,
        meshes: &mut Assets<Mesh>,
        materials: &mut Assets<StandardMaterial>,
    ) -> Self {
        let colors = [
            marks.idle,
            marks.hover,
            marks.held,
            marks.plate,
            marks.button,
        ];
        Self {
            cube: meshes.add(Cuboid::from_length(1.0)),
            ball: meshes.add(Sphere::new(0.5).mesh().ico(2).unwrap_or_else(|_| {
                // Only for millions of triangles.
                Cuboid::from_length(1.0).into()
            })),
            paints: colors.map(|base_color| {
                materials.add(StandardMaterial {
                    base_color,
                    unlit: true,
                    ..default()
                })
            }),
        }
    }
}

type MarkParts<'a> = (
    &'a mut Transform,
    &'a mut Visibility,
    &'a mut Mesh3d,
    &'a mut MeshMaterial3d<StandardMaterial>,
);
type Thing<'a> = (&'a Graspable, &'a Aabb, &'a Transform);
type Plane<'a> = (
    Entity,
    &'a Transform,
    Has<HandPlane>,
    &'a InheritedVisibility,
);
type FreePlane = (
    With<VolumeClipPlane>,
    Or<(With<HandPlane>, With<Graspable>)>,
    Without<ChildOf>,
    Without<Mark>,
);

/// What there may be to draw.
#[derive(bevy::ecs::system::SystemParam)]
struct Scene<'w, 's> {
    hands: Res<'w, Hands>,
    free: Res<'w, FreeHands>,
    targets: Res<'w, HandTargets>,
    menu: Option<Res<'w, CurrentMenu>>,
    face: Res<'w, MenuFace>,
    things: Query<'w, 's, Thing<'static>, (Without<ChildOf>, Without<Mark>)>,
    panels: Query<'w, 's, (), With<TouchPanel>>,
    planes: Query<'w, 's, Plane<'static>, FreePlane>,
}

#[expect(clippy::too_many_arguments, reason = "what marks are made of")]
fn draw(
    mut commands: Commands,
    scene: Scene,
    marks: Res<InteractionMarks>,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
    mut parts: Query<MarkParts, With<Mark>>,
    mut pieces: Local<Vec<Piece>>,
    mut pool: Local<Pool>,
) {
    pieces.clear();
    scene.add(&marks, &mut pieces);
    if pieces.is_empty() && pool.used == 0 {
        return;
    }
    if marks.is_changed() {
        pool.kit = None;
    }
    let Pool {
        cubes,
        balls,
        icons,
        kit,
        used,
    } = &mut *pool;
    *used = pieces.len();
    let kit = kit.get_or_insert_with(|| Kit::new(&marks, &mut meshes, &mut materials));
    let mut next = [0; 2 + MENU_BUTTONS];
    for piece in pieces.iter() {
        let (kind, entities, mesh) = match piece.shape {
            Shape::Cube => (0, &mut *cubes, Some(&kit.cube)),
            Shape::Ball => (1, &mut *balls, Some(&kit.ball)),
            Shape::Icon(i) => (2 + i, &mut icons[i], scene.face.icons[i].as_ref()),
        };
        let Some(mesh) = mesh else {
            continue;
        };
        let paint = &kit.paints[piece.paint as usize];
        let index = next[kind];
        next[kind] += 1;
        let Some(&entity) = entities.get(index) else {
            let mark = commands.spawn((
                Mark,
                Mesh3d(mesh.clone()),
                MeshMaterial3d(paint.clone()),
                piece.place,
                Visibility::Inherited,
                NotShadowCaster,
                marks.layers.clone(),
            ));
            entities.push(mark.id());
            continue;
        };
        let Ok((mut transform, mut visibility, mut mesh3d, mut material)) = parts.get_mut(entity)
        else {
            continue;
        };
        transform.set_if_neq(piece.place);
        visibility.set_if_neq(Visibility::Inherited);
        if mesh3d.0 != *mesh {
            mesh3d.0 = mesh.clone();
        }
        if material.0 != *paint {
            material.0 = paint.clone();
        }
    }
    let kinds = [&*cubes, &*balls].into_iter().chain(&*icons);
    for (entities, used) in kinds.zip(next) {
        for &entity in entities.iter().skip(used) {
            if let Ok((_, mut visibility, ..)) = parts.get_mut(entity) {
                visibility.set_if_neq(Visibility::Hidden);
            }
        }
    }
}

impl Scene<'_, '_> {
    fn add(&self, marks: &InteractionMarks, pieces: &mut Vec<Piece>) {
        let targets = &self.targets.0;
        for (index, target) in targets.iter().enumerate() {
            let hand = &self.hands.0[index];
            if marks.has_hands
                && let Some(grip) = hand.grip
            {
                pieces.push(ball(
                    grip.translation.into(),
                    HAND,
                    Paint::at(target.as_ref()),
                ));
            }
            self.add_ray(index, target.as_ref(), pieces);
            // A box in both hands is one.
            let entity = target.as_ref().and_then(|target| target.entity);
            let is_second = index == 1 && targets[0].is_some_and(|other| other.entity == entity);
            if let Some(entity) = entity.filter(|_| !is_second)
                && let Ok((graspable, aabb, transform)) = self.things.get(entity)
            {
                let at = |target: &&HandTarget| target.entity == Some(entity);
                let hands = targets.each_ref().map(|t| t.as_ref().filter(at));
                let placement = Placement {
                    translation: transform.transform_point(aabb.center.into()),
                    rotation: transform.rotation.normalize(),
                    scale: transform.scale.x,
                };
                let half = Vec3::from(aabb.half_extents);
                add_box(placement, half, graspable.has_handles, hands, pieces);
            }
        }
        if let Some(menu) = &self.menu
            && let Some(surface) = menu.surface()
        {
            let pressed = menu.touch().is_pressed;
            add_menu(surface.pose, menu.hovered(), pressed, &self.face, pieces);
        }
        for (entity, transform, is_in_hand, visibility) in &self.planes {
            if visibility.get() {
                let is_at = |target: &&HandTarget| target.entity == Some(entity);
                let paint = match targets.iter().flatten().find(is_at) {
                    _ if is_in_hand => Paint::Held,
                    target => Paint::at(target),
                };
                add_plane(transform.to_isometry(), paint, pieces);
            }
        }
    }

    /// From the hand to what it points at.
    fn add_ray(&self, index: usize, target: Option<&HandTarget>, pieces: &mut Vec<Piece>) {
        // A hand whose ray nothing heeds has none.
        let aim = |hand: &Hand| hand.aim.filter(|aim| aim.translation.is_finite());
        let hand = if target.is_some() {
            &self.hands.0[index]
        } else {
            &self.free.0.0[index]
        };
        let is_panel = target.is_some_and(|t| t.entity.is_none_or(|e| self.panels.contains(e)));
        match target {
            Some(target) if target.is_near => {
                if is_panel {
                    pieces.push(ball(target.place, CURSOR, Paint::at(Some(target))));
                }
            }
            Some(target) => {
                let Some(aim) = aim(hand) else {
                    return;
                };
                let from = Vec3::from(aim.translation);
                pieces.push(ball(target.place, CURSOR, Paint::at(Some(target))));
                add_line(from, target.place, Paint::at(Some(target)), pieces);
            }
            None => {
                if let Some(aim) = aim(hand) {
                    let from = Vec3::from(aim.translation);
                    let to = from + RAY * (aim.rotation * Vec3::NEG_Z);
                    add_line(from, to, Paint::Idle, pieces);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
