//! What marks consist of: cubes and balls, drawn out and painted.

use bevy::math::Isometry3d;
use bevy::prelude::*;

use super::MenuFace;
use crate::interaction::{HandTarget, Handle, MENU_BUTTONS, MENU_HALF_SIZE, Placement};

/// m, of edges and rays.
pub(super) const LINE: f32 = 0.002;
/// m, of corners and edges' handles.
pub(super) const CORNER: f32 = 0.012;
const EDGE: f32 = 0.009;
/// Those that a hand is at are larger.
pub(super) const AT_HAND: f32 = 1.6;
/// m, by which boxes are larger than what they surround.
const CLEARANCE: f32 = 0.0005;
/// m, of rays that meet nothing, and before the hand.
pub(super) const RAY: f32 = 0.4;
pub(super) const BEFORE_HAND: f32 = 0.03;
/// m, of the ball at a ray's end, and at the hand.
pub(super) const CURSOR: f32 = 0.008;
pub(super) const HAND: f32 = 0.016;
/// m, half of the square that stands for a plane.
const PLANE: f32 = 0.15;
/// m, between the menu's buttons.
const GAP: f32 = 0.003;
/// Of a button's height.
const ICON: f32 = 0.6;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shape {
    /// Of edge 1.
    Cube,
    /// Of diameter 1.
    Ball,
    Icon(usize),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Paint {
    Idle,
    Hover,
    Held,
    Plate,
    Button,
}

impl Paint {
    pub(super) const COUNT: usize = 5;

    pub(super) fn at(target: Option<&HandTarget>) -> Self {
        match target {
            None => Self::Idle,
            Some(target) if target.is_held => Self::Held,
            Some(_) => Self::Hover,
        }
    }
}

/// One mesh of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Piece {
    pub(super) shape: Shape,
    pub(super) paint: Paint,
    pub(super) place: Transform,
}

pub(super) fn ball(at: Vec3, size: f32, paint: Paint) -> Piece {
    Piece {
        shape: Shape::Ball,
        paint,
        place: Transform::from_translation(at).with_scale(Vec3::splat(size)),
    }
}

fn cube(pose: Isometry3d, size: Vec3, paint: Paint) -> Piece {
    Piece {
        shape: Shape::Cube,
        paint,
        place: Transform::from_isometry(pose).with_scale(size),
    }
}

/// Begins a little before the hand.
pub(super) fn add_line(from: Vec3, to: Vec3, paint: Paint, pieces: &mut Vec<Piece>) {
    let Some(direction) = (to - from).try_normalize() else {
        return;
    };
    let length = from.distance(to) - BEFORE_HAND;
    if length > 0.0 && length.is_finite() {
        let middle = to - 0.5 * length * direction;
        let pose = Isometry3d::new(middle, Quat::from_rotation_arc(Vec3::Z, direction));
        pieces.push(cube(pose, Vec3::new(LINE, LINE, length), paint));
    }
}

/// Edges, corners and the handles in the middle of edges. Lines stay as thin as they are whatever
/// the box's scale is.
pub(super) fn add_box(
    placement: Placement,
    half: Vec3,
    has_handles: bool,
    hands: [Option<&HandTarget>; 2],
    pieces: &mut Vec<Piece>,
) {
    let half = half * placement.scale;
    let pose = Isometry3d::new(placement.translation, placement.rotation);
    let is_held = hands.iter().flatten().any(|hand| hand.is_held);
    let whole = if is_held { Paint::Held } else { Paint::Hover };
    let outside = |size: f32| half + (CLEARANCE + 0.5 * size);
    for handle in Handle::all() {
        if let Handle::Edge { axis, .. } = handle {
            let axis = usize::from(axis);
            let mut size = Vec3::splat(LINE);
            size[axis] = 2.0 * outside(LINE)[axis];
            let place = Isometry3d::from_translation(handle.place(outside(LINE)));
            pieces.push(cube(pose * place, size, whole));
        }
        if !has_handles {
            continue;
        }
        let hand = hands.iter().flatten().find(|h| h.handle == Some(handle));
        let paint = Paint::at(hand.copied());
        let larger = if hand.is_some() { AT_HAND } else { 1.0 };
        let piece = match handle {
            Handle::Corner(_) => {
                let size = larger * CORNER;
                let place = Isometry3d::from_translation(handle.place(outside(size)));
                cube(pose * place, Vec3::splat(size), paint)
            }
            Handle::Edge { .. } => {
                let size = larger * EDGE;
                ball(pose * handle.place(outside(size)), size, paint)
            }
        };
        pieces.push(piece);
    }
}

/// A square around a plane, and a ball where it is taken.
pub(super) fn add_plane(pose: Isometry3d, paint: Paint, pieces: &mut Vec<Piece>) {
    for side in [-PLANE, PLANE] {
        let length = 2.0 * PLANE + LINE;
        let across = pose * Isometry3d::from_xyz(0.0, 0.0, side);
        pieces.push(cube(across, Vec3::new(length, LINE, LINE), paint));
        let along = pose * Isometry3d::from_xyz(side, 0.0, 0.0);
        pieces.push(cube(along, Vec3::new(LINE, LINE, length), paint));
    }
    pieces.push(ball(pose.translation.into(), CORNER, paint));
}

pub(super) fn add_menu(
    pose: Isometry3d,
    hovered: Option<usize>,
    is_pressed: bool,
    face: &MenuFace,
    pieces: &mut Vec<Piece>,
) {
    const THICKNESS: f32 = 0.002;
    let at = |x: f32, y: f32, z: f32| pose * Isometry3d::from_xyz(x, y, z);
    let size = 2.0 * (MENU_HALF_SIZE + GAP);
    let behind = at(0.0, 0.0, -1.6 * THICKNESS);
    pieces.push(cube(behind, size.extend(THICKNESS), Paint::Plate));
    let height = 2.0 * MENU_HALF_SIZE.y / MENU_BUTTONS as f32;
    for button in 0..MENU_BUTTONS {
        let paint = match hovered {
            Some(hovered) if hovered == button && is_pressed => Paint::Held,
            Some(hovered) if hovered == button => Paint::Hover,
            _ => Paint::Button,
        };
        let y = MENU_HALF_SIZE.y - (button as f32 + 0.5) * height;
        let size = Vec3::new(2.0 * MENU_HALF_SIZE.x - GAP, height - GAP, THICKNESS);
        pieces.push(cube(at(0.0, y, -0.5 * THICKNESS), size, paint));
        // On what is lit, dark.
        let icon = match (paint, face.is_on[button]) {
            (Paint::Button, true) => Paint::Held,
            (Paint::Button, false) => Paint::Idle,
            _ => Paint::Plate,
        };
        pieces.push(Piece {
            shape: Shape::Icon(button),
            paint: icon,
            place: Transform::from_isometry(at(0.0, y, 0.2 * THICKNESS))
                .with_scale(Vec3::splat(ICON * height)),
        });
    }
}
