//! What people ask for at the hand's menu, or in the panel.

use bevy::prelude::*;
use bevy_holovol::interaction::{
    CurrentMenu, HandPlane, InteractionMarks, InteractionMarksPlugin, MenuFace, MenuPressed,
};
use bevy_holovol::prelude::*;
use bevy_holovol::xr::{HeadsetBlend, HeadsetStatus};

use super::panel::PanelIsOpen;

pub(super) struct ActionPlugin;

impl Plugin for ActionPlugin {
    fn build(&self, app: &mut App) {
        app.add_plugins(InteractionMarksPlugin)
            .init_resource::<CurrentMenu>()
            .add_message::<Action>()
            .add_systems(Startup, draw_icons)
            .add_systems(Update, (menu, cut, show_hands).chain());
    }
}

/// The menu's buttons, from the top; the panel has them, too.
#[derive(Message, Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Action {
    /// Takes a cutting plane in this hand, or the one that is there away.
    Cut(usize),
    /// Opens the panel before the user, or closes it.
    Panel,
    /// Brings the volume before the user, as large as at first.
    Reset,
}

/// The plane that the menu gives.
#[derive(Component)]
pub(super) struct OwnPlane;

fn menu(
    mut pressed: MessageReader<MenuPressed>,
    menu: Res<CurrentMenu>,
    planes: Query<(), With<OwnPlane>>,
    panel: Res<PanelIsOpen>,
    mut face: ResMut<MenuFace>,
    mut actions: MessageWriter<Action>,
) {
    for MenuPressed(button) in pressed.read() {
        actions.write(match button {
            // The hand that presses is the free one.
            0 => Action::Cut(menu.touch().hand.unwrap_or(1)),
            1 => Action::Panel,
            _ => Action::Reset,
        });
    }
    let is_on = [!planes.is_empty(), panel.0, false];
    if face.is_on != is_on {
        face.is_on = is_on;
    }
}

fn cut(
    mut commands: Commands,
    mut actions: MessageReader<Action>,
    planes: Query<Entity, With<OwnPlane>>,
) {
    for action in actions.read() {
        let Action::Cut(hand) = action else { continue };
        if planes.is_empty() {
            commands.spawn((VolumeClipPlane, HandPlane::new(*hand), OwnPlane));
        }
        for plane in &planes {
            commands.entity(plane).despawn();
        }
    }
}

/// Where the room is seen, hands are seen by themselves.
fn show_hands(status: Res<HeadsetStatus>, mut marks: ResMut<InteractionMarks>) {
    let has_hands = status.blend == HeadsetBlend::Opaque;
    if marks.has_hands != has_hands {
        marks.has_hands = has_hands;
    }
}

fn draw_icons(mut face: ResMut<MenuFace>, mut meshes: ResMut<Assets<Mesh>>) {
    face.icons = [cut_icon(), panel_icon(), reset_icon()].map(|icon| Some(meshes.add(icon)));
}

fn merged(parts: impl IntoIterator<Item = Mesh>) -> Mesh {
    let mut parts = parts.into_iter();
    let mut whole = parts.next().unwrap_or_else(|| Rectangle::default().into());
    for part in parts {
        // All have the attributes of Bevy's plane shapes.
        if let Err(error) = whole.merge(&part) {
            warn!("an icon lacks a part: {error}");
        }
    }
    whole
}

fn rectangle(x: f32, y: f32, width: f32, height: f32) -> Mesh {
    let mesh = Mesh::from(Rectangle::new(width, height));
    mesh.translated_by(Vec3::new(x, y, 0.0))
}

fn triangle(corners: [[f32; 2]; 3]) -> Mesh {
    let [a, b, c] = corners.map(Vec2::from);
    Triangle2d::new(a, b, c).into()
}

/// A square whose upper half is taken off along a slant.
fn cut_icon() -> Mesh {
    let slant = rectangle(0.0, 0.0, 1.25, 0.07).rotated_by(Quat::from_rotation_z(-0.6));
    merged([
        triangle([[-0.42, 0.12], [-0.42, -0.45], [0.42, -0.45]]),
        slant,
    ])
}

/// Lines of a list.
fn panel_icon() -> Mesh {
    merged([0.3, 0.0, -0.3].into_iter().flat_map(|y| {
        let knob = rectangle(-0.4, y, 0.16, 0.16);
        [knob, rectangle(0.12, y, 0.7, 0.1)]
    }))
}

/// A house.
fn reset_icon() -> Mesh {
    merged([
        triangle([[-0.5, 0.02], [0.5, 0.02], [0.0, 0.48]]),
        rectangle(-0.2, -0.22, 0.26, 0.46),
        rectangle(0.2, -0.22, 0.26, 0.46),
        rectangle(0.0, -0.1, 0.2, 0.22),
    ])
}
