//! Scientific and medical volumes: voxels, transfer functions, cell ranges, and the files they come in.
//!
//! A [`Volume`] is a scalar field on the unit cube. [`open`] reads one from a file; a
//! [`TransferFunction`] says what its values look like. Neither needs a GPU.
//!
//! ```no_run
//! # fn main() -> Result<(), holovol_volume::VolumeError> {
//! let volume = holovol_volume::open("scan.nii.gz".as_ref(), &mut |_progress| {})?;
//! println!("{:?} voxels, {:?}", volume.dims(), volume.range());
//! # Ok(()) }
//! ```

mod cells;
mod geometry;
mod reader;
mod statistics;
mod transfer_function;
mod transfer_function_file;
mod volume;
mod writer;

pub use cells::{CELL_SIZE, CellRanges};
pub use geometry::Geometry;
pub use reader::{
    CancelFlag, Content, DicomReader, Endian, Input, MetaImageReader, NiftiReader, NrrdReader,
    NumberType, Progress, RawLayout, ReadOptions, TiffReader, VdbReader, VolumeError, VolumeReader,
    ZipReader, contents, open, open_with, read, readers,
};
pub use statistics::Histogram;
pub use transfer_function::{Material, TransferFunction, TransferFunctionError, TransferPoint};
pub use transfer_function_file::{TransferFunctionFile, TransferFunctionFileError};
pub use volume::{HeaderWindow, Label, ReplacedVoxels, SourceFormat, Volume, VoxelKind, Voxels};
pub use writer::{OutputFormat, WriteError, write};
