//! What the cursor points at in the scan, and clicks there.

use bevy::prelude::*;
use bevy::window::PrimaryWindow;
use bevy_egui::input::EguiWantsInput;

use super::camera::Orbit;
use super::look::Look;
use super::measure::{Hit, Ray, first_hit};
use super::panel::Panel;
use super::studio::Studio;

pub(crate) struct PointerPlugin;

impl Plugin for PointerPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<Pointer>()
            .add_systems(Update, (hover, click).chain());
    }
}

/// Logical pixels that a click may move.
const STILL: f32 = 4.0;

#[derive(Resource, Default)]
pub(crate) struct Pointer {
    pub(crate) hit: Option<Hit>,
    /// What `hit` was found for.
    of: Option<(Vec2, GlobalTransform, Look, u32)>,
    pressed_at: Option<Vec2>,
}

type SeenFrom<'a> = (&'a Camera, &'a GlobalTransform);

fn hover(
    mut pointer: ResMut<Pointer>,
    windows: Query<&Window, With<PrimaryWindow>>,
    cameras: Query<SeenFrom, With<Orbit>>,
    studio: Res<Studio>,
    wants: Res<EguiWantsInput>,
    buttons: Res<ButtonInput<MouseButton>>,
) {
    let cursor = windows.iter().next().and_then(Window::cursor_position);
    let (Some(cursor), Ok((camera, transform))) = (cursor, cameras.single()) else {
        pointer.hit = None;
        return;
    };
    // While the scan is turned or moved nobody reads values.
    let drags = [MouseButton::Left, MouseButton::Right, MouseButton::Middle];
    if wants.wants_any_pointer_input() || buttons.any_pressed(drags) {
        pointer.hit = None;
        pointer.of = None;
        return;
    }
    let of = (cursor, *transform, studio.look.clone(), studio.opened);
    if pointer.of.as_ref() == Some(&of) {
        return;
    }
    pointer.of = Some(of);
    pointer.hit = camera
        .viewport_to_world(transform, cursor)
        .ok()
        .and_then(|ray| {
            let ray = Ray {
                origin: ray.origin.as_dvec3(),
                direction: ray.direction.as_vec3().as_dvec3().normalize(),
            };
            first_hit(studio.scan.as_ref()?, &studio.look, ray)
        });
}

fn click(
    mut pointer: ResMut<Pointer>,
    mut panel: ResMut<Panel>,
    windows: Query<&Window, With<PrimaryWindow>>,
    wants: Res<EguiWantsInput>,
    buttons: Res<ButtonInput<MouseButton>>,
) {
    let cursor = windows.iter().next().and_then(Window::cursor_position);
    if buttons.just_pressed(MouseButton::Left) {
        pointer.pressed_at = cursor.filter(|_| !wants.wants_any_pointer_input());
    }
    if !buttons.just_released(MouseButton::Left) {
        return;
    }
    let (Some(from), Some(to)) = (pointer.pressed_at.take(), cursor) else {
        return;
    };
    if from.distance(to) > STILL {
        return;
    }
    if let Some(hit) = pointer.hit
        && !panel.overlay.click(hit.at)
    {
        panel.slices.cross = Some(hit.at);
    }
}
