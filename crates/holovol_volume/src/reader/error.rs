use std::path::{Path, PathBuf};

use super::options::Content;
use super::supported_formats;

/// Why a volume could not be read or made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VolumeError {
    /// The file could not be opened or read.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A folder came where a file was expected.
    #[error("{}: this is a folder; name a file in it ({})", path.display(), supported_formats())]
    Folder {
        /// The folder.
        path: PathBuf,
    },
    /// No reader knows the file, by content or by name.
    #[error("{}: {found}; expected one of these formats: {}; voxels without a header need --raw-dims and --raw-type, or a sidecar beside them", path.display(), supported_formats())]
    UnknownFormat {
        /// The file.
        path: PathBuf,
        /// What the file looks like.
        found: String,
    },
    /// A header field can't be right.
    #[error("{}: {format} field `{field}` is {found}, expected {expected}", path.display())]
    Field {
        /// The file.
        path: PathBuf,
        /// The format.
        format: &'static str,
        /// The field, as the format's own documentation calls it.
        field: String,
        /// What is there.
        found: String,
        /// What should be there, and the way out if there is one.
        expected: String,
    },
    /// The file is fine, but this part of the format can't be read.
    #[error("{}: {what}; {way_out}", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// What can't be read.
        what: String,
        /// What to do about it.
        way_out: String,
    },
    /// A header names a data file that can't be opened.
    #[error(
        "{}: its data file {} can't be read ({source}); put it there, or correct its name in the header",
        header.display(), data.display()
    )]
    DataFile {
        /// The header.
        header: PathBuf,
        /// The data file it names.
        data: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file ends before its header does.
    #[error("{}: the file ends within its {format} header: it is truncated; get a complete copy", path.display())]
    TruncatedHeader {
        /// The file.
        path: PathBuf,
        /// The format.
        format: &'static str,
    },
    /// Fewer voxels than the header says.
    #[error(
        "{}: the header promises {expected} bytes of voxels, but there are at most {available}: \
         the file is truncated or its header is wrong; get a complete copy",
        path.display()
    )]
    Truncated {
        /// The file.
        path: PathBuf,
        /// Bytes of voxels that the header promises.
        expected: u64,
        /// Upper bound of the bytes that are there.
        available: u64,
    },
    /// The compressed or textual voxels can't be decoded.
    #[error("{}: the voxels can't be decoded ({source}): the file is damaged; get a good copy", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: std::io::Error,
    },
    /// More voxels than allowed or than memory can hold.
    #[error("{}: {bytes} bytes of voxels are more than {limit}; use a smaller or downsampled volume", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Bytes of voxels.
        bytes: u64,
        /// What they exceed.
        limit: String,
    },
    /// Several volumes, and none was chosen.
    #[error("{}: {} {what} are here; choose one by its number{}", path.display(), contents.len(), listed(contents))]
    Choose {
        /// The file or folder.
        path: PathBuf,
        /// What there are several of: `series`, `grids`.
        what: &'static str,
        /// What can be chosen.
        contents: Vec<Content>,
    },
    /// Nothing goes by the number or name that was chosen.
    #[error("{}: there is no `{choice}` here; choose one of these{}", path.display(), listed(contents))]
    NoSuchChoice {
        /// The file or folder.
        path: PathBuf,
        /// What was asked for.
        choice: String,
        /// What can be chosen.
        contents: Vec<Content>,
    },
    /// A folder or an archive in which no reader finds a volume.
    #[error("{}: none of the {files} files in this folder is a DICOM image that can be shown{reasons}; \
             name a file of one of these formats: {}", path.display(), supported_formats())]
    NothingFound {
        /// The folder or archive.
        path: PathBuf,
        /// How many files were looked at.
        files: usize,
        /// Why images that were found can't be shown; empty if there were none.
        reasons: String,
    },
    /// The file was written to while it was read.
    #[error("{}: the file changed while it was read; wait until it is complete, then open it again", path.display())]
    Changed {
        /// The file.
        path: PathBuf,
    },
    /// Somebody set the [`CancelFlag`](crate::CancelFlag).
    #[error("{}: reading was cancelled", path.display())]
    Cancelled {
        /// The file or folder.
        path: PathBuf,
    },
    /// The number of voxels does not fit the dimensions.
    #[error("dimensions {dims:?} do not go with {voxels} voxels")]
    Dimensions {
        /// Dimensions along x, y, z.
        dims: [u64; 3],
        /// Voxels that came.
        voxels: usize,
    },
    /// Slope or intercept is not finite.
    #[error(
        "values are scaled by slope {slope} and intercept {intercept}, which must be finite and keep them finite"
    )]
    Scaling {
        /// Slope.
        slope: f64,
        /// Intercept.
        intercept: f64,
    },
}

/// At most this many choices are listed in a message.
const LISTED_MAX: usize = 40;

fn listed(contents: &[Content]) -> String {
    let lines = contents.iter().take(LISTED_MAX).enumerate();
    let mut text: String = lines
        .map(|(index, content)| format!("\n  {}", content.line(index + 1)))
        .collect();
    if contents.len() > LISTED_MAX {
        text.push_str("\n  …");
    }
    text
}

impl VolumeError {
    pub(super) fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io {
            path: path.into(),
            source,
        }
    }

    /// The same with the file's name, where it has none.
    pub(super) fn within(self, path: &Path, format: &'static str) -> Self {
        match self {
            Self::Scaling { slope, intercept } => Self::Field {
                path: path.into(),
                format,
                field: "slope and intercept".into(),
                found: format!("{slope:e} and {intercept:e}"),
                expected: "finite numbers that keep the values finite; correct the header".into(),
            },
            other => other,
        }
    }

    /// Sorts an error from a decoder: damaged content, or the system's own.
    pub(super) fn decoding(path: &Path, source: std::io::Error) -> Self {
        use std::io::ErrorKind::{InvalidData, InvalidInput, UnexpectedEof};
        if matches!(source.kind(), InvalidData | InvalidInput | UnexpectedEof) {
            Self::Damaged {
                path: path.into(),
                source,
            }
        } else {
            Self::io(path, source)
        }
    }
}
