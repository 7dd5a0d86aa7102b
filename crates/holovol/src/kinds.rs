//! What a file that a person names or drops is, by its name; readers themselves go by content.

use std::path::Path;

/// What is done with a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FileKind {
    /// `*.tf.json`
    TransferFunction,
    /// Any other `*.json`.
    Scene,
    /// Light from all around.
    Panorama {
        /// `.hdr` and `.exr`, which hold radiance; else a picture whose light is estimated.
        is_hdr: bool,
    },
    /// All else, folders too.
    Volume,
}

impl FileKind {
    pub(crate) fn of(path: &Path) -> Self {
        let name = path.to_string_lossy().to_lowercase();
        let ends = |endings: &[&str]| endings.iter().any(|ending| name.ends_with(ending));
        if path.is_dir() {
            Self::Volume
        } else if ends(&[".tf.json"]) {
            Self::TransferFunction
        } else if ends(&[".json"]) {
            Self::Scene
        } else if ends(&[".hdr", ".exr"]) {
            Self::Panorama { is_hdr: true }
        } else if ends(&[".png", ".jpg", ".jpeg"]) {
            Self::Panorama { is_hdr: false }
        } else {
            Self::Volume
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_tell_what_a_file_is() {
        let kind = |name: &str| FileKind::of(Path::new(name));
        assert_eq!(kind("a/Bone.TF.json"), FileKind::TransferFunction);
        assert_eq!(kind("view.json"), FileKind::Scene);
        assert_eq!(kind("room.EXR"), FileKind::Panorama { is_hdr: true });
        assert_eq!(kind("R0010.JPG"), FileKind::Panorama { is_hdr: false });
        assert_eq!(kind("head.nii.gz"), FileKind::Volume);
        assert_eq!(kind("IM0001"), FileKind::Volume);
        let folder = tempfile::tempdir().unwrap();
        let named = folder.path().join("series.json");
        std::fs::create_dir(&named).unwrap();
        assert_eq!(FileKind::of(&named), FileKind::Volume);
    }
}
