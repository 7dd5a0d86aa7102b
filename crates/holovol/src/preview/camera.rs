//! The camera: around the scan, or flying through it; by mouse, touchpad, touch and keys.

use bevy::input::gestures::PinchGesture;
use bevy::input::mouse::{MouseScrollUnit, MouseWheel};
use bevy::prelude::*;
use bevy_egui::input::{egui_wants_any_keyboard_input, egui_wants_any_pointer_input};
use serde::{Deserialize, Serialize};

pub(crate) struct CameraPlugin;

impl Plugin for CameraPlugin {
    fn build(&self, app: &mut App) {
        app.add_systems(
            Update,
            (
                (pointer, touch).run_if(not(egui_wants_any_pointer_input)),
                keys.run_if(not(egui_wants_any_keyboard_input)),
                apply,
            )
                .chain(),
        );
    }
}

/// Radians per logical pixel of a drag.
const TURN: f32 = 0.006;
/// Of the distance, per line of a wheel; a touchpad's pixel is that many lines.
const ZOOM: f32 = 0.12;
const LINES_PER_PIXEL: f32 = 0.02;
/// Of the distance, per second.
const FLY_SPEED: f32 = 0.6;
/// Just short of the poles, where "up" turns over.
const MAX_PITCH: f32 = 1.55;

/// A camera that looks at a point from a distance.
#[derive(Component, Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Orbit {
    pub(crate) target: Vec3,
    pub(crate) distance: f32,
    /// About +y, radians; 0 looks along −z.
    pub(crate) yaw: f32,
    /// Radians above the horizon.
    pub(crate) pitch: f32,
    /// About the direction of view, radians; 0 has +y upwards.
    #[serde(default)]
    pub(crate) roll: f32,
    /// Dragging turns the head instead of the scan.
    #[serde(skip)]
    pub(crate) flies: bool,
    /// Where the home key goes.
    #[serde(skip)]
    pub(crate) home: Home,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Home {
    pub(crate) target: Vec3,
    pub(crate) eye: Vec3,
    pub(crate) up: Vec3,
}

impl Default for Home {
    fn default() -> Self {
        Self {
            target: Vec3::ZERO,
            eye: Vec3::new(0.3, 0.1, 0.6),
            up: Vec3::Y,
        }
    }
}

impl Default for Orbit {
    fn default() -> Self {
        let Home { target, eye, up } = Home::default();
        Self::looking(target, eye, up)
    }
}

impl Orbit {
    /// Looks at `target` from `eye`, with `up` in the upper half of the picture's middle line.
    pub(crate) fn looking(target: Vec3, eye: Vec3, up: Vec3) -> Self {
        let from = eye - target;
        let distance = from.length().max(1e-6);
        let mut orbit = Self {
            target,
            distance,
            yaw: from.x.atan2(from.z),
            pitch: (from.y / distance)
                .clamp(-1.0, 1.0)
                .asin()
                .clamp(-MAX_PITCH, MAX_PITCH),
            roll: 0.0,
            flies: false,
            home: Home { target, eye, up },
        };
        let level = orbit.rotation();
        let [right, above] = [level * Vec3::X, level * Vec3::Y].map(|axis| up.dot(axis));
        if right.abs() > 1e-5 * up.length() {
            orbit.roll = (-right).atan2(above);
        }
        orbit
    }

    pub(crate) fn go_home(&mut self) {
        *self = Self::looking(self.home.target, self.home.eye, self.home.up);
    }

    fn rotation(&self) -> Quat {
        Quat::from_rotation_y(self.yaw)
            * Quat::from_rotation_x(-self.pitch)
            * Quat::from_rotation_z(self.roll)
    }

    pub(crate) fn transform(&self) -> Transform {
        let rotation = self.rotation();
        Transform {
            translation: self.target + rotation * Vec3::Z * self.distance,
            rotation,
            scale: Vec3::ONE,
        }
    }

    fn turn(&mut self, delta: Vec2) {
        let eye = self.transform().translation;
        // What is dragged follows the hand, also in a picture that stands askew.
        let delta = Vec2::from_angle(-self.roll).rotate(delta);
        self.yaw -= TURN * delta.x;
        self.pitch = (self.pitch + TURN * delta.y).clamp(-MAX_PITCH, MAX_PITCH);
        if self.flies {
            self.target = eye - self.rotation() * Vec3::Z * self.distance;
        }
    }

    /// `metres`: of a logical pixel at distance 1.
    fn pan(&mut self, delta: Vec2, metres: f32) {
        let metres = metres * self.distance;
        let moved = Vec3::new(-delta.x, delta.y, 0.0) * metres;
        self.target += self.rotation() * moved;
    }

    fn zoom(&mut self, lines: f32) {
        self.distance = (self.distance * (-ZOOM * lines).exp()).clamp(1e-6, 1e6);
    }
}

/// Metres of a logical pixel at distance 1.
fn pixel(camera: &Camera, projection: &Projection) -> f32 {
    let height = camera.logical_viewport_size().map_or(1.0, |size| size.y);
    let fov = match projection {
        Projection::Perspective(perspective) => perspective.fov,
        _ => std::f32::consts::FRAC_PI_4,
    };
    2.0 * (0.5 * fov).tan() / height.max(1.0)
}

fn pointer(
    mut cameras: Query<(&mut Orbit, &Camera, &Projection)>,
    buttons: Res<ButtonInput<MouseButton>>,
    keys: Res<ButtonInput<KeyCode>>,
    mut moved: MessageReader<CursorMoved>,
    mut wheel: MessageReader<MouseWheel>,
    mut pinch: MessageReader<PinchGesture>,
) {
    let Ok((mut orbit, camera, projection)) = cameras.single_mut() else {
        return;
    };
    let metres = pixel(camera, projection);
    let pans = buttons.any_pressed([MouseButton::Right, MouseButton::Middle])
        || (buttons.pressed(MouseButton::Left)
            && keys.any_pressed([KeyCode::ShiftLeft, KeyCode::ShiftRight]));
    // Not the device's own motion: tablets, remote desktops and virtual machines tell places only.
    let delta: Vec2 = moved.read().filter_map(|event| event.delta).sum();
    if delta != Vec2::ZERO {
        if pans {
            orbit.pan(delta, metres);
        } else if buttons.pressed(MouseButton::Left) {
            orbit.turn(delta);
        }
    }
    for event in wheel.read() {
        let lines = match event.unit {
            MouseScrollUnit::Line => event.y,
            MouseScrollUnit::Pixel => event.y * LINES_PER_PIXEL,
        };
        orbit.zoom(lines);
    }
    for PinchGesture(amount) in pinch.read() {
        orbit.zoom(amount / ZOOM);
    }
}

/// One finger turns; two pan and zoom.
fn touch(mut cameras: Query<(&mut Orbit, &Camera, &Projection)>, touches: Res<Touches>) {
    let Ok((mut orbit, camera, projection)) = cameras.single_mut() else {
        return;
    };
    let metres = pixel(camera, projection);
    let fingers: Vec<_> = touches.iter().collect();
    match fingers.as_slice() {
        [one] if one.delta() != Vec2::ZERO => orbit.turn(one.delta()),
        [a, b] => {
            orbit.pan(0.5 * (a.delta() + b.delta()), metres);
            let now = a.position().distance(b.position());
            let before = a.previous_position().distance(b.previous_position());
            if before > 1.0 && now > 1.0 && now != before {
                orbit.zoom((now / before).ln() / ZOOM);
            }
        }
        _ => {}
    }
}

fn keys(mut cameras: Query<&mut Orbit>, keys: Res<ButtonInput<KeyCode>>, time: Res<Time>) {
    let Ok(mut orbit) = cameras.single_mut() else {
        return;
    };
    // Those are shortcuts of the panel.
    if keys.any_pressed(super::panel::CONTROL) {
        return;
    }
    if keys.just_pressed(KeyCode::Home) {
        orbit.go_home();
    }
    if keys.just_pressed(KeyCode::KeyF) {
        orbit.flies = !orbit.flies;
    }
    let axis = |minus, plus| {
        f32::from(u8::from(keys.pressed(plus))) - f32::from(u8::from(keys.pressed(minus)))
    };
    let moved = Vec3::new(
        axis(KeyCode::KeyA, KeyCode::KeyD),
        axis(KeyCode::KeyQ, KeyCode::KeyE),
        axis(KeyCode::KeyW, KeyCode::KeyS),
    );
    if moved != Vec3::ZERO {
        let step = FLY_SPEED * orbit.distance * time.delta_secs();
        let rotation = orbit.rotation();
        orbit.target += rotation * moved * step;
    }
}

fn apply(mut cameras: Query<(&Orbit, &mut Transform, &mut Projection), Changed<Orbit>>) {
    for (orbit, mut transform, mut projection) in &mut cameras {
        transform.set_if_neq(orbit.transform());
        if let Projection::Perspective(perspective) = &mut *projection {
            perspective.near = 0.01 * orbit.distance;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_is_the_eye_that_was_asked_for() {
        for eye in [
            Vec3::new(0.3, 0.1, 0.6),
            Vec3::new(-2.0, -1.0, 0.5),
            Vec3::Z,
        ] {
            let target = Vec3::new(0.1, 0.2, -0.3);
            for up in [Vec3::Y, Vec3::new(0.7, 0.4, 0.2), Vec3::new(0.1, -1.0, 0.0)] {
                let pose = Orbit::looking(target, eye, up).transform();
                assert!(pose.translation.distance(eye) < 1e-5, "{pose:?}");
                let expected = Transform::from_translation(eye).looking_at(target, up);
                assert!(
                    pose.rotation.angle_between(expected.rotation) < 1e-3,
                    "{up}"
                );
            }
        }
    }

    #[test]
    fn a_drag_to_the_right_takes_the_scan_to_the_right_however_the_head_is_held() {
        for up in [Vec3::Y, Vec3::X, -Vec3::Y] {
            let mut orbit = Orbit::looking(Vec3::ZERO, Vec3::new(0.1, 0.05, 1.0), up);
            // A point of the scan in front of the camera.
            let point = orbit.rotation() * Vec3::Z * 0.1;
            orbit.turn(Vec2::new(30.0, 0.0));
            let seen = orbit
                .transform()
                .compute_affine()
                .inverse()
                .transform_point3(point);
            assert!(
                seen.x > 0.005 && seen.y.abs() < 0.2 * seen.x,
                "{up}: {seen}"
            );
        }
    }

    #[test]
    fn what_is_panned_stays_under_the_cursor() {
        for (fov, height) in [(0.4f32, 600.0f32), (0.9, 300.0)] {
            let mut orbit = Orbit::looking(Vec3::ZERO, Vec3::new(0.4, 0.2, 1.5), Vec3::Y);
            let from = orbit.target;
            let metres = 2.0 * (0.5 * fov).tan() / height;
            orbit.pan(Vec2::new(50.0, 20.0), metres);
            let seen = orbit
                .transform()
                .compute_affine()
                .inverse()
                .transform_point3(from);
            // Pixels from the middle of the picture.
            let pixels = Vec2::new(seen.x, -seen.y) / -seen.z / (0.5 * fov).tan() * 0.5 * height;
            assert!(pixels.distance(Vec2::new(50.0, 20.0)) < 0.1, "{pixels}");
        }
    }

    #[test]
    fn flying_turns_the_head_and_orbiting_the_scan() {
        let mut orbit = Orbit::default();
        let eye = orbit.transform().translation;
        orbit.turn(Vec2::new(50.0, 20.0));
        assert!(orbit.transform().translation.distance(eye) > 0.1);
        assert_eq!(orbit.target, Vec3::ZERO);
        let eye = orbit.transform().translation;
        orbit.flies = true;
        orbit.turn(Vec2::new(50.0, 20.0));
        assert!(orbit.transform().translation.distance(eye) < 1e-5);
        orbit.go_home();
        assert_eq!(orbit, Orbit::default());
    }
}
