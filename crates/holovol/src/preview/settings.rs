//! What the program remembers from one start to the next.

use std::path::{Path, PathBuf};

use bevy::prelude::*;
use serde::{Deserialize, Serialize};

use crate::output;

/// Kept as JSON in the user's configuration folder. Of files only paths are kept: names of
/// patients stand inside files, and those are never read for this.
#[derive(Resource, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct Settings {
    /// The last opened first.
    pub(crate) recent: Vec<PathBuf>,
    pub(crate) is_light: bool,
    /// Size of the panel: 1 is the desktop's.
    pub(crate) zoom: f32,
    #[serde(skip)]
    place: Option<PathBuf>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            recent: Vec::new(),
            is_light: false,
            zoom: 1.0,
            place: None,
        }
    }
}

const RECENT_MAX: usize = 10;

impl Settings {
    /// Those of this user; defaults if there are none or they can't be read.
    pub(crate) fn load() -> Self {
        config_folder().map_or_else(Self::default, |folder| {
            Self::load_from(&folder.join("holovol").join("preview.json"))
        })
    }

    fn load_from(place: &Path) -> Self {
        let read = std::fs::read_to_string(place).ok();
        let found: Option<Self> = read.and_then(|text| serde_json::from_str(&text).ok());
        let found = found.unwrap_or_default();
        Self {
            zoom: if (0.5..=3.0).contains(&found.zoom) {
                found.zoom
            } else {
                1.0
            },
            place: Some(place.into()),
            ..found
        }
    }

    /// Writes them down. That it can't be done is no reason to disturb anybody.
    pub(crate) fn save(&self) {
        let Some(place) = &self.place else { return };
        let folder = place.parent().unwrap_or(Path::new(""));
        if let (Ok(()), Ok(text)) = (
            std::fs::create_dir_all(folder),
            serde_json::to_string_pretty(self),
        ) && let Err(error) = output::write_text(&(text + "\n"), place)
        {
            debug!("{error}");
        }
    }

    pub(crate) fn note_recent(&mut self, path: &Path) {
        let path = std::path::absolute(path).unwrap_or_else(|_| path.into());
        self.recent.retain(|other| *other != path);
        self.recent.insert(0, path);
        self.recent.truncate(RECENT_MAX);
        self.save();
    }
}

/// Where programs keep what they remember of this user.
fn config_folder() -> Option<PathBuf> {
    let variable = |name| {
        std::env::var_os(name)
            .filter(|value| !value.is_empty())
            .map(PathBuf::from)
    };
    if cfg!(windows) {
        return variable("APPDATA");
    }
    if cfg!(target_os = "macos") {
        return Some(variable("HOME")?.join("Library/Application Support"));
    }
    variable("XDG_CONFIG_HOME").or_else(|| Some(variable("HOME")?.join(".config")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recent_files_survive_and_the_last_is_first() {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("deep/preview.json");
        let mut settings = Settings::load_from(&place);
        assert!(settings.recent.is_empty());
        for name in ["/a", "/b", "/a"] {
            settings.note_recent(Path::new(name));
        }
        let again = Settings::load_from(&place);
        assert_eq!(again.recent, [Path::new("/a"), Path::new("/b")]);
        for n in 0..20 {
            settings.note_recent(Path::new(&format!("/{n}")));
        }
        assert_eq!(settings.recent.len(), RECENT_MAX);
    }

    #[test]
    fn damaged_settings_are_the_default() {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("preview.json");
        std::fs::write(&place, "{ \"zoom\": 1e9, \"recent\": 3").unwrap();
        assert_eq!(Settings::load_from(&place).zoom, 1.0);
        std::fs::write(&place, "{ \"zoom\": 1e9 }").unwrap();
        assert_eq!(Settings::load_from(&place).zoom, 1.0);
    }
}
