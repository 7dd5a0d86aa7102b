//! Planes and the box that cut a scan open.

use bevy_egui::egui;
use glam::DVec3;

use super::super::look::{Crop, MAX_PLANES, Plane};
use super::super::slices::direction_name;
use super::{Panel, Shown};

pub(super) fn draw(ui: &mut egui::Ui, panel: &mut Panel, shown: &mut Shown) {
    ui.checkbox(&mut panel.overlay.shows_handles, "handles in the scene");
    let towards_viewer = shown
        .cameras
        .get(shown.session.camera)
        .ok()
        .map(|(orbit, ..)| orbit.transform().back().as_vec3().as_dvec3().normalize());
    let studio = &mut *shown.studio;
    let Some(scan) = &studio.scan else { return };
    let is_patient = scan.is_patient();
    let radius = scan.radius();
    let matrix = scan.world_from_unit_cube();
    let look = &mut studio.look;

    ui.checkbox(&mut look.crop.is_on, "crop to a box");
    if look.crop.is_on {
        for axis in 0..3 {
            // The unit cube's axes are the file's; they are called after where they point.
            let along = matrix.col(axis).truncate();
            let (world, sign) = (0..3)
                .map(|i| (i, along[i]))
                .max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))
                .unwrap_or((axis, 1.0));
            let [from, to] = [sign < 0.0, sign >= 0.0]
                .map(|is_positive| direction_name(world, is_positive, is_patient));
            ui.horizontal(|ui| {
                ui.spacing_mut().slider_width = 92.0;
                let (mut low, mut high) = (look.crop.low[axis], look.crop.high[axis]);
                ui.label(from);
                let low_slider = egui::Slider::new(&mut low, 0.0..=1.0).show_value(false);
                if ui.add(low_slider).changed() {
                    look.crop.set_side(axis, false, low);
                }
                let high_slider = egui::Slider::new(&mut high, 0.0..=1.0).show_value(false);
                if ui.add(high_slider).changed() {
                    look.crop.set_side(axis, true, high);
                }
                ui.label(to);
            });
        }
        if ui.button("Whole scan").clicked() {
            look.crop = Crop {
                is_on: true,
                ..Crop::default()
            };
        }
    }
    let mut removed = None;
    for (index, plane) in look.planes.iter_mut().enumerate() {
        ui.separator();
        ui.horizontal(|ui| {
            ui.checkbox(&mut plane.is_on, format!("plane {}", index + 1));
            if ui.button("Turn around").clicked() {
                plane.normal = -plane.normal;
                plane.offset = -plane.offset;
            }
            if ui.button("Delete").clicked() {
                removed = Some(index);
            }
        });
        ui.horizontal(|ui| {
            ui.label("towards");
            for axis in 0..3 {
                for is_positive in [false, true] {
                    let direction = DVec3::AXES[axis] * if is_positive { 1.0 } else { -1.0 };
                    let is_chosen = plane.normal.dot(direction) > 0.999;
                    let name = direction_name(axis, is_positive, is_patient);
                    if ui.selectable_label(is_chosen, name).clicked() {
                        plane.normal = direction;
                    }
                }
            }
            if let Some(direction) = towards_viewer
                && ui
                    .button("me")
                    .on_hover_text("As the camera looks now")
                    .clicked()
            {
                plane.normal = direction;
            }
        });
        let mut part = plane.offset / radius;
        if ui
            .add(egui::Slider::new(&mut part, -1.0..=1.0).text("place"))
            .changed()
        {
            plane.offset = part * radius;
        }
    }
    if let Some(index) = removed {
        look.planes.remove(index);
    }
    let count = look.wanted_planes(matrix).len();
    if count > MAX_PLANES {
        let text = format!(
            "Only {MAX_PLANES} planes cut at once: the last {} don't.",
            count - MAX_PLANES
        );
        ui.colored_label(ui.visuals().warn_fg_color, text);
    }
    let button = ui.add_enabled(count < MAX_PLANES, egui::Button::new("New plane"));
    if button.clicked() {
        look.planes.push(Plane {
            normal: DVec3::Z,
            offset: 0.0,
            is_on: true,
        });
    }
}
