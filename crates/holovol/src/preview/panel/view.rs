//! The camera, and pictures of what it sees.

use bevy::prelude::Vec3;
use bevy_egui::egui;
use glam::DVec3;

use super::super::camera::Orbit;
use super::super::settings::Noise;
use super::super::slices::direction_name;
use super::super::studio::Scan;
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
    noise(ui, shown);
    exposure(ui, panel, shown);
    let is_patient = shown.studio.scan.as_ref().is_some_and(Scan::is_patient);
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
            add_bookmark(shown);
        }
        let scan = shown.studio.scan.as_ref();
        let bookmarks = scan.map_or(&[] as &[_], |scan| shown.settings.bookmarks(scan));
        for (index, bookmark) in bookmarks.iter().enumerate() {
            let button = ui
                .button(&bookmark.name)
                .on_hover_text("right click: delete");
            if button.clicked()
                && let Ok((mut orbit, ..)) = shown.cameras.get_mut(camera)
            {
                *orbit = Orbit {
                    home: orbit.home,
                    ..bookmark.place
                };
            }
            if button.secondary_clicked() {
                removed = Some(index);
            }
        }
    });
    if let (Some(index), Some(scan)) = (removed, &shown.studio.scan) {
        shown.settings.remove_bookmark(scan, index);
    }
}

fn noise(ui: &mut egui::Ui, shown: &mut Shown) {
    let mut chosen = shown.settings.noise;
    ui.horizontal(|ui| {
        ui.label("noise");
        for (noise, name, what) in Noise::ALL {
            ui.selectable_value(&mut chosen, noise, name)
                .on_hover_text(what);
        }
    });
    if chosen != shown.settings.noise {
        shown.settings.noise = chosen;
        shown.settings.save();
    }
}

/// How bright it shows; the light itself stays as it is.
fn exposure(ui: &mut egui::Ui, panel: &Panel, shown: &mut Shown) {
    ui.horizontal(|ui| {
        let look = &mut shown.studio.look;
        ui.label("exposure");
        let slider = egui::Slider::new(&mut look.exposure_ev, -8.0..=8.0)
            .suffix(" EV")
            .clamping(egui::SliderClamping::Never);
        ui.add(slider);
        let auto = ui
            .button("Auto")
            .on_hover_text("Chalk in this light shows just below white");
        if auto.clicked()
            && let Some(ev) = panel.light.exposure_ev()
        {
            look.exposure_ev = ev - look.light.stops;
        }
    });
}

/// Keeps where the camera is.
pub(super) fn add_bookmark(shown: &mut Shown) {
    if let Ok((orbit, ..)) = shown.cameras.get(shown.session.camera)
        && let Some(scan) = &shown.studio.scan
    {
        shown.settings.add_bookmark(scan, *orbit);
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
            ..Orbit::looking(orbit.target, eye, Vec3::Y)
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
