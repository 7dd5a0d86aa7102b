//! The camera, and pictures of what it sees.

use bevy::prelude::Vec3;
use bevy_egui::egui;
use glam::DVec3;

use super::super::camera::Orbit;
use super::super::slices::direction_name;
use super::{Panel, Shown};

pub(super) fn draw(ui: &mut egui::Ui, panel: &mut Panel, shown: &mut Shown) {
    ui.horizontal(|ui| {
        ui.label("scatterings");
        let scatters = &mut shown.studio.look.max_scatters;
        for (text, value) in [
            ("1", Some(1)),
            ("4", Some(4)),
            ("16", Some(16)),
            ("all", None),
        ] {
            ui.selectable_value(scatters, value, text);
        }
    });
    let is_patient = shown
        .studio
        .scan
        .as_ref()
        .is_some_and(|scan| scan.volume().geometry().oriented);
    ui.horizontal(|ui| {
        ui.label("from");
        for axis in [2, 0, 1] {
            for is_positive in [true, false] {
                let name = direction_name(axis, is_positive, is_patient);
                if ui.button(name).clicked() {
                    let sign = if is_positive { 1.0 } else { -1.0 };
                    look_from(shown, DVec3::AXES[axis] * sign);
                }
            }
        }
    });
    let camera = shown.session.camera;
    ui.horizontal(|ui| {
        if let Ok((mut orbit, ..)) = shown.cameras.get_mut(camera) {
            if ui.button("First view").clicked() {
                orbit.go_home();
            }
            let mut flies = orbit.flies;
            if ui.checkbox(&mut flies, "fly").changed() {
                orbit.flies = flies;
            }
        }
        ui.checkbox(&mut panel.overlay.shows_marks, "marks");
        let mut rules = panel.overlay.is_ruling();
        if ui.checkbox(&mut rules, "ruler").changed() {
            panel.overlay.toggle_ruler();
        }
    });
    let mut removed = None;
    ui.horizontal_wrapped(|ui| {
        if ui.button("+ bookmark").clicked() {
            add_bookmark(panel, shown);
        }
        for (index, (name, place)) in panel.bookmarks.iter().enumerate() {
            let button = ui.button(name).on_hover_text("right click: delete");
            if button.clicked()
                && let Ok((mut orbit, ..)) = shown.cameras.get_mut(camera)
            {
                *orbit = *place;
            }
            if button.secondary_clicked() {
                removed = Some(index);
            }
        }
    });
    if let Some(index) = removed {
        panel.bookmarks.remove(index);
    }
}

/// Keeps where the camera is.
pub(super) fn add_bookmark(panel: &mut Panel, shown: &Shown) {
    if let Ok((orbit, ..)) = shown.cameras.get(shown.session.camera) {
        let free = (1..).find(|n| {
            panel
                .bookmarks
                .iter()
                .all(|(name, _)| *name != n.to_string())
        });
        let name = free.unwrap_or(1).to_string();
        panel.bookmarks.push((name, *orbit));
    }
}

/// Goes around the target to a side of the scan.
pub(super) fn look_from(shown: &mut Shown, side: DVec3) {
    let camera = shown.session.camera;
    if let Ok((mut orbit, ..)) = shown.cameras.get_mut(camera) {
        // Straight from above "up" would turn over.
        let side = side.as_vec3() + Vec3::new(0.0, 0.0, 1e-4);
        let eye = orbit.target + side.normalize() * orbit.distance;
        *orbit = Orbit {
            home: orbit.home,
            flies: orbit.flies,
            ..Orbit::looking(orbit.target, eye)
        };
    }
}

pub(super) fn pictures(ui: &mut egui::Ui, panel: &mut Panel, shown: &mut Shown) {
    ui.horizontal(|ui| {
        ui.label("folder");
        let field = egui::TextEdit::singleline(&mut panel.folder);
        ui.add(field.desired_width(super::WIDTH - 70.0));
    });
    ui.horizontal(|ui| {
        ui.label("samples");
        ui.add(
            egui::DragValue::new(&mut panel.samples)
                .speed(4)
                .range(1..=65_536),
        );
        if ui.button("PNG").clicked() {
            shown.take_pictures(panel, "png", 1);
        }
        let exr = ui
            .button("EXR")
            .on_hover_text("Linear radiance with opacity");
        if exr.clicked() {
            shown.take_pictures(panel, "exr", 1);
        }
    });
    ui.horizontal(|ui| {
        ui.label("turntable of");
        let frames = &mut panel.turntable_frames;
        ui.add(egui::DragValue::new(frames).range(2..=3600));
        ui.label("pictures");
        if ui.button("Turn").clicked() {
            let frames = panel.turntable_frames;
            shown.take_pictures(panel, "png", frames);
        }
    });
    if shown.pictures.progress().is_some() && ui.button("Stop").clicked() {
        shown.pictures.cancel();
    }
}
