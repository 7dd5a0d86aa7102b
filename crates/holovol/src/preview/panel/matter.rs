//! What values are made of.

use bevy_egui::egui;

use super::{Panel, Shown, curve, files};

pub(super) fn draw(ui: &mut egui::Ui, panel: &mut Panel, shown: &mut Shown) {
    ui.horizontal(|ui| {
        files::presets(ui, shown);
        if ui
            .button("Save")
            .on_hover_text("As a *.tf.json file")
            .clicked()
        {
            save(panel, shown);
        }
        ui.checkbox(&mut panel.curve.shows_all, "all values");
    });
    let studio = &mut *shown.studio;
    let Some(scan) = &studio.scan else { return };
    let look = &mut studio.look;
    curve::draw(ui, &mut panel.curve, look, scan);

    let [low, high] = scan.volume().range();
    let span = (high - low).abs().max(1e-9);
    let speed = span / 400.0;
    // Four digits of the range, and the unit that the file names.
    let decimals = (3.0 - span.log10().floor()).clamp(0.0, 9.0) as usize;
    let unit = scan.volume().unit().map(|unit| format!(" {unit}"));
    let unit = unit.as_deref().unwrap_or_default();
    let drag = |ui: &mut egui::Ui, value: &mut f64| {
        let drag = egui::DragValue::new(value).speed(speed);
        ui.add(drag.max_decimals(decimals).suffix(unit))
    };
    let [mut from, mut to] = look.window;
    let (mut level, mut width) = (0.5 * (from + to), to - from);
    egui::Grid::new("window").num_columns(4).show(ui, |ui| {
        ui.label("from");
        drag(ui, &mut from);
        ui.label("to");
        drag(ui, &mut to);
        ui.end_row();
        ui.label("level");
        let moved = drag(ui, &mut level);
        ui.label("window");
        let widened = drag(ui, &mut width);
        ui.end_row();
        if moved.changed() || widened.changed() {
            (from, to) = (level - 0.5 * width, level + 0.5 * width);
        }
    });
    if from != to && from.is_finite() && to.is_finite() {
        look.window = [from, to];
    }
    egui::Grid::new("matter").num_columns(2).show(ui, |ui| {
        ui.label("density");
        ui.add(
            egui::Slider::new(&mut look.density, 0.01..=100.0)
                .logarithmic(true)
                .clamping(egui::SliderClamping::Edits),
        );
        ui.end_row();
        ui.label("surface")
            .on_hover_text("Shading like a surface where values change fast");
        ui.add(
            egui::Slider::new(&mut look.gradient_factor, 0.0..=10.0)
                .clamping(egui::SliderClamping::Edits),
        );
        ui.end_row();
        ui.label("forward")
            .on_hover_text("Scattering: −1 backwards, 0 evenly, 1 forwards");
        ui.add(
            egui::Slider::new(&mut look.phase_g, -0.95..=0.95)
                .clamping(egui::SliderClamping::Edits),
        );
        ui.end_row();
    });
}

fn save(panel: &Panel, shown: &mut Shown) {
    let look = &shown.studio.look;
    let Some(mut file) = look.transfer_function() else {
        return;
    };
    file.window = Some(look.window);
    file.transfer_function = file.transfer_function.scaled(look.density);
    let name = format!("{}.tf", super::stem(&shown.session.name));
    let path = super::free_name(&panel.folder(), &name, "json", &[]);
    let outcome = serde_json::to_string_pretty(&file)
        .map_err(|error| crate::Failure::new(crate::Exit::Internal, error.to_string()))
        .and_then(|text| crate::output::write_text(&(text + "\n"), &path))
        .map(|()| format!("{} is written", path.display()));
    shown.tell(outcome);
}
