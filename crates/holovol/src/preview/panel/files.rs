//! Opening: a path with completion, and what was opened before.

use std::path::{Path, PathBuf};

use bevy_egui::egui;

use super::super::presets::Preset;
use super::{Panel, Shown};

/// Names offered at once.
const OFFERS: usize = 8;

pub(super) fn draw(ui: &mut egui::Ui, panel: &mut Panel, shown: &mut Shown) {
    ui.horizontal(|ui| {
        let field = egui::TextEdit::singleline(&mut panel.path)
            .hint_text("drop a file or folder, or type its path")
            .desired_width(super::WIDTH - 118.0);
        let field = ui.add(field);
        let entered = field.lost_focus() && ui.input(|input| input.key_pressed(egui::Key::Enter));
        if (ui.button("Open").clicked() || entered) && !panel.path.trim().is_empty() {
            shown.opening.open(expand(&panel.path));
            panel.path.clear();
        }
        let mut chosen = None;
        ui.menu_button("Recent", |ui| {
            if shown.settings.recent.is_empty() {
                ui.weak("nothing yet");
            }
            for path in &shown.settings.recent {
                let name = path.file_name().unwrap_or(path.as_os_str());
                let button = ui.button(name.to_string_lossy());
                if button.on_hover_text(path.to_string_lossy()).clicked() {
                    chosen = Some(path.clone());
                    ui.close();
                }
            }
        });
        if let Some(path) = chosen {
            shown.opening.open(path);
        }
    });
    others(ui, shown);
    if panel.path.is_empty() {
        return;
    }
    let offers = completions(&panel.path);
    let is_there = offers.len() == 1 && offers[0].to_string_lossy() == panel.path;
    if !is_there {
        for offer in offers.into_iter().take(OFFERS) {
            let name = offer.file_name().unwrap_or_default().to_string_lossy();
            let text = if offer.is_dir() {
                format!("{name}{}", std::path::MAIN_SEPARATOR)
            } else {
                name.into_owned()
            };
            if ui.selectable_label(false, text).clicked() {
                panel.path = offer.to_string_lossy().into_owned();
                if offer.is_dir() {
                    panel.path.push(std::path::MAIN_SEPARATOR);
                } else {
                    shown.opening.open(offer);
                    panel.path.clear();
                }
            }
        }
    }
}

/// The file that is shown, and a way to what else is in it.
fn others(ui: &mut egui::Ui, shown: &mut Shown) {
    let Some(path) = shown
        .studio
        .scan
        .as_ref()
        .and_then(|scan| scan.path.clone())
    else {
        return;
    };
    ui.horizontal(|ui| {
        let others = egui::Button::new("Other volumes …");
        let is_free = !shown.opening.is_busy() && shown.opening.choosing.is_none();
        let others = ui.add_enabled(is_free, others);
        let name = path
            .file_name()
            .unwrap_or(path.as_os_str())
            .to_string_lossy();
        ui.add(egui::Label::new(name).truncate())
            .on_hover_text(path.to_string_lossy());
        if others
            .on_hover_text("Series, grids, channels, times: what the file holds besides")
            .clicked()
        {
            shown.opening.ask(path);
        }
    });
}

/// A path as it is typed: `~` is the user's own folder.
pub(super) fn expand(typed: &str) -> PathBuf {
    let typed = typed.trim();
    let rest = match typed.strip_prefix('~') {
        Some("") => Some(""),
        Some(rest) => rest.strip_prefix(['/', std::path::MAIN_SEPARATOR]),
        None => None,
    };
    let home = std::env::var_os("HOME").or_else(|| std::env::var_os("USERPROFILE"));
    match (rest, home) {
        (Some(rest), Some(home)) => PathBuf::from(home).join(rest),
        _ => typed.into(),
    }
}

/// Files and folders whose paths begin so, sorted; hidden ones only if asked for.
fn completions(typed: &str) -> Vec<PathBuf> {
    let path = &expand(typed);
    let (folder, begin) = if typed.ends_with(std::path::MAIN_SEPARATOR) {
        (path.as_path(), String::new())
    } else {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        (path.parent().unwrap_or(Path::new("")), name.into_owned())
    };
    let place = if folder.as_os_str().is_empty() {
        Path::new(".")
    } else {
        folder
    };
    let Ok(entries) = std::fs::read_dir(place) else {
        return Vec::new();
    };
    let mut found: Vec<PathBuf> = entries
        .flatten()
        .filter(|entry| {
            let name = entry.file_name();
            let name = name.to_string_lossy();
            let fits = name.to_lowercase().starts_with(&begin.to_lowercase());
            fits && (begin.starts_with('.') || !name.starts_with('.'))
        })
        .map(|entry| folder.join(entry.file_name()))
        .collect();
    found.sort();
    found
}

/// A choice of looks.
pub(super) fn presets(ui: &mut egui::Ui, shown: &mut Shown) {
    let studio = &mut *shown.studio;
    let scan = studio.scan.as_ref();
    let chosen = scan.and_then(|scan| Preset::of(&studio.look, scan));
    egui::ComboBox::from_id_salt("presets")
        .selected_text(chosen.map_or("preset …", Preset::name))
        .show_ui(ui, |ui| {
            for preset in Preset::ALL {
                let is_chosen = chosen == Some(preset);
                if ui.selectable_label(is_chosen, preset.name()).clicked()
                    && let Some(scan) = &studio.scan
                {
                    preset.apply(&mut studio.look, scan);
                }
            }
        });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_completed() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["Head.nii", "heart.nrrd", "lung.nii", ".hidden"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let names = |typed: &str| -> Vec<String> {
            let typed = folder.path().join(typed);
            completions(&typed.to_string_lossy())
                .iter()
                .map(|path| path.file_name().unwrap().to_string_lossy().into_owned())
                .collect()
        };
        assert_eq!(names("he"), ["Head.nii", "heart.nrrd"]);
        assert_eq!(names(""), ["Head.nii", "heart.nrrd", "lung.nii"]);
        assert_eq!(names(".h"), [".hidden"]);
        assert_eq!(
            expand(" ~/scans "),
            PathBuf::from(std::env::var_os("HOME").unwrap_or_else(|| "~".into())).join("scans")
        );
        assert_eq!(expand("~ann/x"), Path::new("~ann/x"));
        assert_eq!(names("x"), Vec::<String>::new());
        assert!(completions("/nowhere/at/all/").is_empty());
    }
}
