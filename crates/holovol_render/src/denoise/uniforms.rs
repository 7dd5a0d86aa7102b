//! What the passes are told of a frame; layouts as in common.wgsl.

use bytemuck::{Pod, Zeroable};
use glam::{DMat3, DMat4, DVec3};

use crate::View;

#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(super) struct EyeUniform {
    pub(super) direction: [f32; 4],
    pub(super) direction_dx: [f32; 4],
    pub(super) direction_dy: [f32; 4],
    pub(super) previous: [[f32; 4]; 3],
    pub(super) other: [[f32; 4]; 3],
    pub(super) turn: [[f32; 4]; 3],
    pub(super) image: [u32; 4],
    pub(super) frame: [u32; 4],
    pub(super) history: [f32; 4],
    pub(super) place: [u32; 4],
    pub(super) before: [f32; 4],
}

#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(super) struct DenoiseUniform {
    pub(super) eyes: [EyeUniform; 2],
    pub(super) counts: [u32; 4],
    pub(super) halves: [u32; 4],
    pub(super) bias: [f32; 4],
    pub(super) across: [f32; 4],
    pub(super) tiles: [f32; 4],
    pub(super) edges: [f32; 4],
    pub(super) sun: [f32; 4],
    pub(super) light: [f32; 4],
}

/// What the passes may take from the frame before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub(super) enum History {
    None = 0,
    Moved = 1,
    /// Nothing has changed: pixel by pixel.
    Same = 2,
}

fn row(v: DVec3, w: f64) -> [f32; 4] {
    [v.x as f32, v.y as f32, v.z as f32, w as f32]
}

/// Rows of what turns a place seen from `from` (relative to its origin) into (depth·x, depth·y,
/// depth) of `to`; `moved` is applied to world places in between. Composed in f64: eyes may be far
/// from the world's origin. `None` if `to` has no pixels or sees along its own plane.
pub(super) fn projection(from: &View, to: &View, moved: DMat4) -> Option<[[f32; 4]; 3]> {
    let rays = DMat3::from_cols(to.direction_dx, to.direction_dy, to.direction);
    if rays.determinant() == 0.0 || !rays.is_finite() {
        return None;
    }
    let inverse = rays.inverse();
    let linear = inverse * DMat3::from_mat4(moved);
    let offset = inverse * (moved.transform_point3(from.origin) - to.origin);
    let rows = [0, 1, 2].map(|i| row(linear.row(i), offset[i]));
    rows.iter().flatten().all(|v| v.is_finite()).then_some(rows)
}

impl EyeUniform {
    pub(super) fn new(view: &View) -> Self {
        let pixel = view.direction_dx.length();
        Self {
            direction: row(view.direction, 0.0),
            direction_dx: row(view.direction_dx, 0.0),
            direction_dy: row(view.direction_dy, 0.0),
            turn: [row(DVec3::X, pixel), row(DVec3::Y, 0.0), row(DVec3::Z, 0.0)],
            ..Self::zeroed()
        }
    }

    /// Where the last frame's eye stood, seen from this one's as if the volume had not moved.
    pub(super) fn set_before(&mut self, view: &View, before: &View, moved: DMat4) {
        let place = moved.inverse().transform_point3(before.origin) - view.origin;
        // What can't be moved back has no history either.
        let place = if place.is_finite() {
            place
        } else {
            DVec3::ZERO
        };
        self.before = row(place, 0.0);
    }

    /// Normals go back with the volume; scale is left out.
    pub(super) fn set_turn(&mut self, moved: DMat4) {
        let matrix = DMat3::from_mat4(moved);
        let scale = matrix.determinant().abs().cbrt();
        for (i, turn) in self.turn.iter_mut().enumerate() {
            let pixel = f64::from(turn[3]);
            *turn = row(matrix.row(i) / scale.max(f64::MIN_POSITIVE), pixel);
        }
    }
}
