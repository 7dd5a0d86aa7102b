//! Writing volumes, exactly: what a format can't hold is refused.

mod nifti;
mod nrrd;
mod raw;

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::GzEncoder;

use crate::{Volume, Voxels};

/// The file formats that volumes can be written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutputFormat {
    /// `.nrrd`, one file.
    Nrrd,
    /// `.nii`; NIfTI-1, or NIfTI-2 where only that holds the numbers exactly.
    Nifti,
    /// `.nii.gz`.
    NiftiGz,
    /// `.raw`, with a sidecar (see [`RawLayout`](crate::RawLayout)).
    Raw,
}

impl OutputFormat {
    /// The format that a file name's ending means.
    pub fn of(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_string_lossy().to_lowercase();
        [
            (".nrrd", Self::Nrrd),
            (".nii", Self::Nifti),
            (".nii.gz", Self::NiftiGz),
            (".raw", Self::Raw),
        ]
        .into_iter()
        .find(|(end, _)| name.ends_with(end))
        .map(|(_, format)| format)
    }
}

/// Why a volume could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteError {
    /// The file can't be written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The ending of the name is none of ours.
    #[error("{}: expected a name that ends in .nrrd, .nii, .nii.gz or .raw", path.display())]
    UnknownFormat {
        /// The file.
        path: PathBuf,
    },
    /// The file would not hold what the volume's file holds.
    #[error("{}: {what}; {way_out}", path.display())]
    Inexact {
        /// The file.
        path: PathBuf,
        /// What would be lost.
        what: String,
        /// What to do about it.
        way_out: &'static str,
    },
}

/// Writes a volume in the format that the file's name means.
///
/// Voxels, scaling, spacing and orientation are exact: f64 where f32 would round. Display windows
/// and remarks are not written, and nothing of a patient, whom [`Volume`] does not know.
///
/// # Errors
/// If the format can't hold what the volume holds, or the volume is not exactly its own file's
/// (see [`Volume::is_rounded`], [`Volume::replaced`]) and `lossy` is false; if writing fails. The
/// file may then be there in part.
pub fn write(volume: &Volume, path: &Path, lossy: bool) -> Result<(), WriteError> {
    let format =
        OutputFormat::of(path).ok_or_else(|| WriteError::UnknownFormat { path: path.into() })?;
    let inexact = |what: String, way_out: &'static str| WriteError::Inexact {
        path: path.into(),
        what,
        way_out,
    };
    if !lossy {
        if volume.is_rounded() {
            return Err(inexact(
                "the volume's values were rounded or interpolated when it was read".into(),
                "allow that with --lossy",
            ));
        }
        let replaced = volume.replaced();
        if replaced.nan + replaced.infinite > 0 {
            return Err(inexact(
                format!(
                    "{} voxels were not finite and have been replaced",
                    replaced.nan + replaced.infinite
                ),
                "allow that with --lossy",
            ));
        }
        let named = volume.labels().is_some_and(|labels| !labels.is_empty());
        if named && format != OutputFormat::Nrrd {
            return Err(inexact(
                "the format can't hold the names of labels".into(),
                "write .nrrd, or leave them out with --lossy",
            ));
        }
        if volume.labels().is_some() && format == OutputFormat::Raw {
            return Err(inexact(
                "the format can't say that values are labels".into(),
                "write .nrrd or .nii, or allow that with --lossy",
            ));
        }
    }
    let io = |source| WriteError::Io {
        path: path.into(),
        source,
    };
    let file = || File::create(path).map(BufWriter::new).map_err(io);
    match format {
        OutputFormat::Nrrd => nrrd::write(volume, &mut file()?).map_err(io),
        OutputFormat::Raw => raw::write(volume, path, &mut file()?).map_err(io),
        OutputFormat::Nifti | OutputFormat::NiftiGz => {
            let header = nifti::header(volume)
                .map_err(|what| inexact(what.into(), "write .nrrd, which can"))?;
            if format == OutputFormat::Nifti {
                nifti::write(&header, volume, &mut file()?).map_err(io)
            } else {
                let mut packed = GzEncoder::new(file()?, Compression::default());
                nifti::write(&header, volume, &mut packed)
                    .and_then(|()| packed.finish()?.flush())
                    .map_err(io)
            }
        }
    }
}

/// Writes the stored numbers, little-endian, x fastest.
fn write_stored(voxels: &Voxels, out: &mut dyn Write) -> io::Result<()> {
    fn each<T: Copy, const N: usize>(
        numbers: &[T],
        bytes: impl Fn(T) -> [u8; N],
        out: &mut dyn Write,
    ) -> io::Result<()> {
        const CHUNK: usize = 1 << 16;
        let mut buffer = Vec::with_capacity(CHUNK * N);
        for chunk in numbers.chunks(CHUNK) {
            buffer.clear();
            buffer.extend(chunk.iter().flat_map(|&number| bytes(number)));
            out.write_all(&buffer)?;
        }
        out.flush()
    }
    match voxels {
        Voxels::U8(v) => each(v, u8::to_le_bytes, out),
        Voxels::I8(v) => each(v, i8::to_le_bytes, out),
        Voxels::U16(v) => each(v, u16::to_le_bytes, out),
        Voxels::I16(v) => each(v, i16::to_le_bytes, out),
        Voxels::F32(v) => each(v, f32::to_le_bytes, out),
    }
}
