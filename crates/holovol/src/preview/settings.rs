//! What the program remembers from one start to the next.

use std::path::{Path, PathBuf};

use bevy::prelude::*;
use bevy_holovol::prelude::*;
use serde::{Deserialize, Serialize};

use super::camera::Orbit;
use super::studio::Scan;
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
    pub(crate) noise: Noise,
    /// Of the scans looked at last, the last first.
    bookmarks: Vec<Bookmarks>,
    #[serde(skip)]
    place: Option<PathBuf>,
}

/// What becomes of the noise of a view of few samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Noise {
    /// It is left as it is; a resting view gathers samples.
    Left,
    /// Taken out as Cheng et al. 2023 do.
    Paper,
    #[default]
    Holovol,
}

impl Noise {
    pub(crate) const ALL: [(Self, &str, &str); 3] = [
        (
            Self::Left,
            "keep",
            "Every sample as it was traced; a resting view gathers them",
        ),
        (
            Self::Paper,
            "as in the paper",
            "As Cheng et al. 2023: to compare with; blurred also at rest",
        ),
        (
            Self::Holovol,
            "remove",
            "By neighbours and earlier frames; at rest it becomes exact",
        ),
    ];

    pub(crate) fn mode(self) -> VolumeRenderMode {
        match self {
            Self::Left => VolumeRenderMode::Progressive,
            Self::Paper | Self::Holovol => VolumeRenderMode::Denoised,
        }
    }

    pub(crate) fn denoiser(self) -> VolumeDenoiser {
        match self {
            Self::Paper => VolumeDenoiser::Paper,
            Self::Left | Self::Holovol => VolumeDenoiser::Holovol,
        }
    }
}

/// Places to look at one scan from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Bookmarks {
    /// Its file or folder; empty for what the program makes itself.
    scan: PathBuf,
    choice: Option<String>,
    places: Vec<Bookmark>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Bookmark {
    pub(crate) name: String,
    pub(crate) place: Orbit,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            recent: Vec::new(),
            is_light: false,
            zoom: 1.0,
            noise: Noise::default(),
            bookmarks: Vec::new(),
            place: None,
        }
    }
}

const RECENT_MAX: usize = 10;
/// Scans whose bookmarks are kept.
const BOOKMARKED_MAX: usize = 50;

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
        let path = absolute(Some(path));
        self.recent.retain(|other| *other != path);
        self.recent.insert(0, path);
        self.recent.truncate(RECENT_MAX);
        self.save();
    }

    pub(crate) fn bookmarks(&self, scan: &Scan) -> &[Bookmark] {
        let of_scan = self.bookmarks.iter().find(|found| found.is_of(scan));
        of_scan.map_or(&[], |found| &found.places)
    }

    /// Keeps a place under the first number that is free.
    pub(crate) fn add_bookmark(&mut self, scan: &Scan, place: Orbit) {
        let found = self.bookmarks.iter().position(|found| found.is_of(scan));
        let mut bookmarks = match found {
            Some(index) => self.bookmarks.remove(index),
            None => Bookmarks::of(scan),
        };
        let is_free = |name: &String| bookmarks.places.iter().all(|other| other.name != *name);
        let name = (1..).map(|n| n.to_string()).find(is_free);
        bookmarks.places.push(Bookmark {
            name: name.unwrap_or_default(),
            place,
        });
        self.bookmarks.insert(0, bookmarks);
        self.bookmarks.truncate(BOOKMARKED_MAX);
        self.save();
    }

    pub(crate) fn remove_bookmark(&mut self, scan: &Scan, index: usize) {
        let found = self.bookmarks.iter_mut().find(|found| found.is_of(scan));
        if let Some(found) = found
            && index < found.places.len()
        {
            found.places.remove(index);
        }
        self.bookmarks.retain(|found| !found.places.is_empty());
        self.save();
    }
}

impl Bookmarks {
    fn of(scan: &Scan) -> Self {
        Self {
            scan: absolute(scan.path.as_deref()),
            choice: scan.choice.clone(),
            places: Vec::new(),
        }
    }

    fn is_of(&self, scan: &Scan) -> bool {
        self.scan == absolute(scan.path.as_deref()) && self.choice == scan.choice
    }
}

/// Also from another folder the same; empty where there is no file.
fn absolute(path: Option<&Path>) -> PathBuf {
    path.map_or_else(PathBuf::new, |path| {
        std::path::absolute(path).unwrap_or_else(|_| path.into())
    })
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
    fn bookmarks_belong_to_their_scan_and_survive() {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("preview.json");
        let head = super::super::tests::blob();
        let lung = Scan {
            path: Some("/scans/lung".into()),
            choice: Some("2".into()),
            ..head.clone()
        };
        let orbit = Orbit::looking(Vec3::ZERO, Vec3::new(1.0, 2.0, 3.0), Vec3::X);
        let mut settings = Settings::load_from(&place);
        for _ in 0..3 {
            settings.add_bookmark(&lung, orbit);
        }
        settings.remove_bookmark(&lung, 1);
        settings.add_bookmark(&lung, Orbit::default());
        let again = Settings::load_from(&place);
        let names: Vec<&str> = again.bookmarks(&lung).iter().map(|b| &*b.name).collect();
        assert_eq!(names, ["1", "3", "2"]);
        let found = again.bookmarks(&lung)[0].place.transform();
        assert_eq!(found, orbit.transform());
        assert!(again.bookmarks(&head).is_empty());
        let other = Scan {
            choice: None,
            ..lung.clone()
        };
        assert!(again.bookmarks(&other).is_empty());
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
