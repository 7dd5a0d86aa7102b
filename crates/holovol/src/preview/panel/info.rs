//! Numbers, keys, and what this program is not for.

use bevy_egui::egui;

use super::{Panel, Shown};

pub(super) fn keys(ui: &mut egui::Ui) {
    pairs(ui, "keys", super::keys::LIST, |ui, what| ui.label(what));
}

/// Two columns that together are no wider than the panel.
fn pairs<N: Into<egui::WidgetText>, V>(
    ui: &mut egui::Ui,
    id: &str,
    rows: impl IntoIterator<Item = (N, V)>,
    value: impl Fn(&mut egui::Ui, V) -> egui::Response,
) {
    let gap = ui.spacing().item_spacing.x;
    let half = 0.5 * (ui.available_width() - gap) - 1.0;
    egui::Grid::new(id)
        .num_columns(2)
        .max_col_width(half)
        .show(ui, |ui| {
            ui.style_mut().wrap_mode = Some(egui::TextWrapMode::Wrap);
            for (name, of) in rows {
                ui.label(name);
                value(ui, of);
                ui.end_row();
            }
        });
}

pub(super) fn numbers(ui: &mut egui::Ui, shown: &Shown) {
    let numbers = shown.statistics.get();
    let seconds = shown.quality.frame_seconds;
    const GENERAL: usize = 3;
    let mut rows = vec![
        ("adapter".to_owned(), shown.adapter.name.clone()),
        ("driver".to_owned(), shown.adapter.driver_info.clone()),
        ("frame".to_owned(), format!("{:.1} ms", 1e3 * seconds)),
    ];
    // Where the device can tell, what each stage of ours took.
    for diagnostic in shown.diagnostics.iter() {
        let path = diagnostic.path().as_str();
        if let Some(stage) = path.split('/').find(|part| part.starts_with("holovol"))
            && let (Some(value), true) = (diagnostic.smoothed(), path.contains("elapsed"))
        {
            let clock = if path.ends_with("gpu") { "GPU" } else { "CPU" };
            let stage = stage.trim_start_matches("holovol_").replace('_', " ");
            rows.push((format!("{stage}, {clock}"), format!("{value:.2} ms")));
        }
    }
    if rows.len() == GENERAL {
        rows.push(("stages".into(), "this device doesn't time them".into()));
    }
    rows.push((
        "samples per pixel".into(),
        numbers.samples_per_pixel.to_string(),
    ));
    let millions = numbers.samples as f64 / 1e6;
    rows.push(("samples so far".into(), format!("{millions:.1} M")));
    rows.push(("uploads".into(), numbers.uploads.to_string()));
    if let Some(scan) = &shown.studio.scan {
        let [x, y, z] = scan.volume().dims();
        rows.push(("voxels".into(), format!("{x} × {y} × {z}")));
        let voxels = scan.volume().voxels();
        let bytes = voxels.len() * voxels.kind().bytes();
        let megabytes = bytes as f64 / f64::from(1 << 20);
        rows.push(("memory of voxels".into(), format!("{megabytes:.1} MiB")));
    }
    if let Some(bytes) = device_memory(ui, shown) {
        let megabytes = bytes as f64 / f64::from(1 << 20);
        rows.push(("memory of the device".into(), format!("{megabytes:.0} MiB")));
    }
    pairs(ui, "numbers", rows, |ui, value| ui.monospace(value));
}

/// Bytes that the program has on the graphics device, where the driver's allocator can tell. To
/// count them takes a list of all, so that it is done once a second.
fn device_memory(ui: &egui::Ui, shown: &Shown) -> Option<u64> {
    let (now, id) = (ui.input(|input| input.time), ui.id().with("memory"));
    let (of, bytes) = ui
        .data(|data| data.get_temp::<(f64, Option<u64>)>(id))
        .filter(|(of, _)| (0.0..1.0).contains(&(now - of)))
        .unwrap_or_else(|| {
            let report = shown.device.wgpu_device().generate_allocator_report();
            (now, report.map(|report| report.total_allocated_bytes))
        });
    ui.data_mut(|data| data.insert_temp(id, (of, bytes)));
    bytes
}

pub(super) fn about(context: &egui::Context, panel: &mut Panel) {
    if !panel.shows_about {
        return;
    }
    let modal = egui::Modal::new("about".into()).show(context, |ui| {
        ui.set_width(360.0);
        ui.heading(format!("holovol {}", env!("CARGO_PKG_VERSION")));
        ui.label("Shows scans as if they stood in the light of a room.");
        ui.add_space(8.0);
        ui.strong("Not for diagnosis.");
        ui.label(
            "This is no medical device. Colours, opacities and light are chosen to be seen well, \
             and hide what they hide; measure and decide nothing about a patient by it.",
        );
        ui.add_space(8.0);
        ui.label("What files hold of patients' names is neither shown nor kept; names of files and folders are.");
        ui.label("MIT or Apache-2.0, as you like.");
        ui.add_space(8.0);
        ui.button("Close").clicked()
    });
    if modal.inner || modal.should_close() {
        panel.shows_about = false;
    }
}
