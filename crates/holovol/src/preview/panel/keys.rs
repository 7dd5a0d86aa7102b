//! What keys do.

use bevy::input::keyboard::{Key, KeyboardFocusLost, KeyboardInput};
use bevy::prelude::*;
use bevy_egui::egui;
use bevy_egui::input::EguiWantsInput;
use bevy_egui::{EguiInput, PrimaryEguiContext};
use glam::DVec3;

use super::{Panel, Shown, view};

/// What the panel says of them.
pub(super) const LIST: [(&str, &str); 22] = [
    ("drag, one finger", "turn"),
    ("right or Shift drag, two fingers", "move"),
    ("wheel, pinch", "nearer, farther"),
    ("click", "moves the cross of the slices"),
    ("1 2 3, 4 5 6", "from front, left, top; the opposite"),
    ("Home", "first view"),
    ("F", "fly or orbit"),
    ("W A S D Q E", "fly"),
    ("B", "bookmark"),
    ("L", "slices"),
    ("M", "marks: orientation, scale"),
    ("R", "ruler: two clicks"),
    ("P", "picture"),
    ("Ctrl S", "save scene"),
    ("Ctrl Z", "undo"),
    ("Ctrl Y, Ctrl Shift Z", "redo"),
    ("Esc", "stop ruler, opening, pictures"),
    ("Tab", "panel"),
    ("F1", "about"),
    ("double click on the curve", "another point"),
    ("right click on a point", "delete it"),
    ("double click on a slice", "larger, smaller"),
];

/// Held, letters are other shortcuts than alone.
pub(crate) const CONTROL: [KeyCode; 4] = [
    KeyCode::ControlLeft,
    KeyCode::ControlRight,
    KeyCode::SuperLeft,
    KeyCode::SuperRight,
];

/// Tab opens and closes the panel, unless it goes on from a field or button of it.
pub(super) fn keep_tab(
    wants: Res<EguiWantsInput>,
    mut inputs: Query<&mut EguiInput, With<PrimaryEguiContext>>,
) {
    if wants.wants_keyboard_input() {
        return;
    }
    for mut input in &mut inputs {
        let is_tab = |event: &egui::Event| matches!(event, egui::Event::Key { key, .. } if *key == egui::Key::Tab);
        input.events.retain(|event| !is_tab(event));
    }
}

/// The letter that a key writes; on layouts without Latin letters, what stands there on most others.
fn letter(event: &KeyboardInput) -> Option<char> {
    let Key::Character(text) = &event.logical_key else {
        return None;
    };
    let written = text.chars().next()?.to_ascii_lowercase();
    if written.is_ascii() {
        return Some(written);
    }
    let code = format!("{:?}", event.key_code);
    let placed = code.strip_prefix("Key")?.chars().next()?;
    Some(placed.to_ascii_lowercase())
}

/// Keys that are held; by the order of events, since a slow frame may hold a whole shortcut.
#[derive(Default)]
pub(super) struct Held {
    control: bool,
    shift: bool,
}

impl Held {
    /// What is typed: a letter, and whether Control and Shift were held.
    fn typed(&mut self, event: &KeyboardInput) -> Option<(char, bool, bool)> {
        let is_pressed = event.state.is_pressed();
        if CONTROL.contains(&event.key_code) {
            self.control = is_pressed;
        } else if [KeyCode::ShiftLeft, KeyCode::ShiftRight].contains(&event.key_code) {
            self.shift = is_pressed;
        } else if is_pressed && !event.repeat {
            return Some((letter(event)?, self.control, self.shift));
        }
        None
    }
}

pub(super) fn shortcuts(
    keys: Res<ButtonInput<KeyCode>>,
    mut typed: MessageReader<KeyboardInput>,
    mut held: Local<Held>,
    mut lost: MessageReader<KeyboardFocusLost>,
    wants: Res<EguiWantsInput>,
    mut panel: ResMut<Panel>,
    mut shown: Shown,
) {
    if lost.read().count() > 0 {
        *held = Held::default();
    }
    let letters: Vec<_> = typed.read().filter_map(|event| held.typed(event)).collect();
    let is_asking = panel.shows_about || shown.opening.choosing.is_some();
    if is_asking || wants.wants_keyboard_input() || keys.get_just_pressed().len() == 0 {
        return;
    }
    let panel = &mut *panel;
    let studio = &mut *shown.studio;
    for &(letter, control, shift) in &letters {
        match (letter, control, shift) {
            ('y', true, _) | ('z', true, true) => studio.history.redo(&mut studio.look),
            ('z', true, false) => studio.history.undo(&mut studio.look),
            _ => {}
        }
    }
    if letters.iter().any(|typed| typed.0 == 's' && typed.1) {
        shown.save_scene(panel);
    }
    let has = |letter| letters.iter().any(|typed| typed.0 == letter && !typed.1);
    let pressed = |key| keys.just_pressed(key);
    if pressed(KeyCode::Tab) {
        panel.is_open = !panel.is_open;
    }
    if has('p') {
        shown.take_pictures(panel, "png", 1);
    }
    if has('l') {
        panel.slices.is_open = !panel.slices.is_open;
    }
    if has('m') {
        panel.overlay.shows_marks = !panel.overlay.shows_marks;
    }
    if has('r') {
        panel.overlay.toggle_ruler();
    }
    if has('b') {
        view::add_bookmark(&mut shown);
    }
    // One thing at a time.
    if pressed(KeyCode::Escape) && !panel.overlay.leave_ruler() && !shown.opening.cancel() {
        shown.pictures.cancel();
    }
    if pressed(KeyCode::F1) {
        panel.shows_about = true;
    }
    let sides = [
        (KeyCode::Digit1, DVec3::Z),
        (KeyCode::Digit2, DVec3::X),
        (KeyCode::Digit3, DVec3::Y),
        (KeyCode::Digit4, DVec3::NEG_Z),
        (KeyCode::Digit5, DVec3::NEG_X),
        (KeyCode::Digit6, DVec3::NEG_Y),
    ];
    for (key, from) in sides {
        if pressed(key) {
            view::look_from(&mut shown, from);
        }
    }
}

#[cfg(test)]
mod tests {
    use bevy::input::ButtonState;

    use super::*;

    #[test]
    fn shortcuts_go_by_the_letter_that_is_written() {
        let event = |key_code, text: &str| KeyboardInput {
            key_code,
            logical_key: Key::Character(text.into()),
            state: ButtonState::Pressed,
            text: None,
            repeat: false,
            window: Entity::PLACEHOLDER,
        };
        // Of German, French and Russian keyboards.
        assert_eq!(letter(&event(KeyCode::KeyY, "z")), Some('z'));
        assert_eq!(letter(&event(KeyCode::Semicolon, "M")), Some('m'));
        assert_eq!(letter(&event(KeyCode::KeyZ, "я")), Some('z'));
        assert_eq!(letter(&event(KeyCode::Semicolon, "ж")), None);
    }

    #[test]
    fn a_shortcut_within_a_frame_is_one() {
        let event = |key_code, logical_key, state| KeyboardInput {
            key_code,
            logical_key,
            state,
            text: None,
            repeat: false,
            window: Entity::PLACEHOLDER,
        };
        let control = |state| event(KeyCode::ControlLeft, Key::Control, state);
        let s = event(
            KeyCode::KeyS,
            Key::Character("s".into()),
            ButtonState::Pressed,
        );
        let mut held = Held::default();
        assert_eq!(held.typed(&control(ButtonState::Pressed)), None);
        assert_eq!(held.typed(&s), Some(('s', true, false)));
        assert_eq!(held.typed(&control(ButtonState::Released)), None);
        assert_eq!(held.typed(&s), Some(('s', false, false)));
    }
}
