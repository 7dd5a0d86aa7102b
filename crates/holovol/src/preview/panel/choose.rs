//! Asks which of several volumes in a file is meant.

use bevy_egui::egui;
use holovol_volume::Content;

use super::super::measure::length_text;
use super::Shown;

pub(super) fn draw(context: &egui::Context, shown: &mut Shown) {
    let Some(choosing) = &shown.opening.choosing else {
        return;
    };
    let modal = egui::Modal::new("choose".into()).show(context, |ui| {
        let name = choosing.path.file_name().unwrap_or_default();
        ui.set_width(460.0_f32.min(0.8 * context.viewport_rect().width()));
        ui.heading(format!(
            "{} {} in {}",
            choosing.contents.len(),
            choosing.what,
            name.to_string_lossy()
        ));
        let mut chosen = None;
        let height = 0.6 * context.viewport_rect().height();
        egui::ScrollArea::vertical()
            .max_height(height)
            .show(ui, |ui| {
                for (index, content) in choosing.contents.iter().enumerate() {
                    let text = line(index + 1, content);
                    if ui.selectable_label(false, text).clicked() {
                        chosen = Some(index + 1);
                    }
                }
            });
        ui.separator();
        (chosen, ui.button("None of them").clicked())
    });
    let (chosen, is_left) = modal.inner;
    if let Some(number) = chosen {
        shown.opening.choose(number);
    } else if is_left || modal.should_close() {
        shown.opening.choosing = None;
    }
}

/// What a person chooses by.
fn line(number: usize, content: &Content) -> String {
    let mut parts = vec![format!("{number}:")];
    let words = [&content.name, &content.description];
    parts.extend(words.into_iter().filter(|word| !word.is_empty()).cloned());
    if let Some([x, y, z]) = content.dims {
        parts.push(format!("{x} × {y} × {z}"));
    }
    if let (Some(dims), Some(spacing)) = (content.dims, content.spacing) {
        let lengths = [0, 1, 2].map(|axis| length_text(dims[axis] as f64 * spacing[axis]));
        parts.push(format!("({})", lengths.join(" × ")));
    }
    parts.join("  ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_says_what_is_known() {
        let mut content = Content::default();
        assert_eq!(line(2, &content), "2:");
        content.description = "CT thorax".into();
        content.dims = Some([512, 512, 88]);
        assert_eq!(line(1, &content), "1:  CT thorax  512 × 512 × 88");
        content.spacing = Some([0.001, 0.001, 0.002]);
        let text = line(1, &content);
        assert!(
            text.starts_with("1:  CT thorax  512 × 512 × 88  ("),
            "{text}"
        );
    }
}
