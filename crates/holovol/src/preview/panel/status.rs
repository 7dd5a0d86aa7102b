//! The line at the bottom: what is going on, or what is under the cursor.

use bevy_egui::egui;

use super::super::Status;
use super::super::measure::length_text;
use super::super::quality::RESTING_SAMPLES;
use super::super::slices::direction_name;
use super::Shown;

pub(super) fn draw(context: &egui::Context, free: egui::Rect, shown: &mut Shown) {
    egui::Area::new("status".into())
        .anchor(egui::Align2::LEFT_BOTTOM, [free.left() + 8.0, -8.0])
        .show(context, |ui| {
            egui::Frame::popup(ui.style()).show(ui, |ui| {
                ui.set_max_width((free.width() - 36.0).max(80.0));
                work(ui, shown);
                message(ui, shown);
                state(ui, shown);
            });
        });
}

fn bar(ui: &mut egui::Ui, part: Option<f32>) {
    match part {
        Some(part) => {
            ui.add(
                egui::ProgressBar::new(part)
                    .desired_width(160.0)
                    .show_percentage(),
            );
        }
        None => spinner(ui),
    }
}

/// Turns as often as it is drawn: egui's own would have a frame drawn for each of its steps.
fn spinner(ui: &mut egui::Ui) {
    const POINTS: usize = 8;
    const TURNS_PER_SECOND: f64 = 0.8;
    let (rect, _) = ui.allocate_exact_size(egui::Vec2::splat(16.0), egui::Sense::hover());
    let turn = ui.input(|input| input.time) * TURNS_PER_SECOND;
    let colour = ui.visuals().strong_text_color();
    for i in 0..POINTS {
        let part = i as f32 / POINTS as f32;
        let angle = std::f32::consts::TAU * part;
        // The brightest runs around.
        let behind = (turn.fract() as f32 - part).rem_euclid(1.0);
        let at = rect.center() + 6.0 * egui::Vec2::angled(angle);
        ui.painter()
            .circle_filled(at, 1.8, colour.gamma_multiply(1.0 - 0.85 * behind));
    }
}

/// What takes a while.
fn work(ui: &mut egui::Ui, shown: &mut Shown) {
    let mut is_stopped = false;
    if let Some((name, part)) = shown.opening.progress() {
        ui.horizontal(|ui| {
            ui.label(format!("opening {name}"));
            bar(ui, part);
            is_stopped = shown.opening.can_cancel() && ui.button("Stop").clicked();
        });
    }
    if is_stopped {
        shown.opening.cancel();
    }
    if let Some(part) = shown.pictures.progress() {
        ui.horizontal(|ui| {
            ui.label("taking pictures");
            bar(ui, Some(part));
            if ui.button("Stop").clicked() {
                shown.pictures.cancel();
            }
        });
    }
}

/// What became of the last wish; failures stay until they are read.
fn message(ui: &mut egui::Ui, shown: &mut Shown) {
    let numbers = shown.statistics.get();
    for error in &numbers.errors {
        ui.colored_label(ui.visuals().error_fg_color, error);
    }
    let mut is_read = false;
    match &shown.session.status {
        Some(Status::Failed(text)) => {
            ui.horizontal_wrapped(|ui| {
                ui.colored_label(ui.visuals().error_fg_color, text);
                is_read = ui.button("OK").clicked();
            });
        }
        Some(Status::Done(text)) => {
            ui.horizontal_wrapped(|ui| {
                ui.label(text);
                is_read = ui.small_button("×").clicked();
            });
        }
        None => {}
    }
    if is_read {
        shown.session.status = None;
    }
}

/// What is shown, how fine it is, and what the cursor points at.
fn state(ui: &mut egui::Ui, shown: &Shown) {
    let numbers = shown.statistics.get();
    let Some(scan) = &shown.studio.scan else {
        if !shown.opening.is_busy() {
            ui.label("nothing is open: drop a scan here, or type its path into the panel");
        }
        return;
    };
    if numbers.is_waiting {
        ui.horizontal(|ui| {
            spinner(ui);
            ui.label("sending scan or light to the graphics device, compiling what they need");
        });
        return;
    }
    let done = numbers.samples_per_pixel;
    ui.horizontal(|ui| {
        ui.label(format!(
            "{}   {done} / {RESTING_SAMPLES} samples",
            shown.session.name
        ));
        if let Some(hit) = shown.pointer.hit {
            let from_middle = (hit.at - scan.middle()).to_array();
            let is_patient = scan.is_patient();
            let places = [0, 1, 2].map(|axis| {
                let metres: f64 = from_middle[axis];
                let name = direction_name(axis, metres >= 0.0, is_patient);
                let name = name.trim_start_matches(['+', '−']);
                let sign = if is_patient || metres >= 0.0 {
                    ""
                } else {
                    "−"
                };
                format!("{name} {sign}{}", length_text(metres.abs()))
            });
            ui.separator();
            let unit = scan.volume().unit().unwrap_or_default();
            ui.strong(format!("{} {unit}", Short(hit.value)));
            ui.label(places.join("  "));
        }
    });
}

/// A value with as many digits as are worth reading.
struct Short(f64);

impl std::fmt::Display for Short {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let size = self.0.abs();
        if size >= 1e6 || (size < 1e-3 && size > 0.0) {
            write!(f, "{:.3e}", self.0)
        } else if size >= 100.0 {
            write!(f, "{:.1}", self.0)
        } else {
            let text = format!("{:.3}", self.0);
            f.write_str(text.trim_end_matches('0').trim_end_matches('.'))
        }
    }
}
