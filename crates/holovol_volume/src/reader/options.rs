use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::raw::RawLayout;

/// How far a reader has come.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Progress {
    /// Bytes of voxels read so far.
    pub bytes: u64,
    /// Bytes of voxels in all; 0 while that is not known yet (a folder being looked through).
    pub total_bytes: u64,
}

impl Progress {
    /// The part that is done, 0 to 1; 0 while the whole is not known.
    pub fn fraction(&self) -> f64 {
        if self.total_bytes == 0 {
            0.0
        } else {
            self.bytes as f64 / self.total_bytes as f64
        }
    }
}

/// Lets one thread stop what another one reads; clones share the flag.
#[derive(Clone, Debug, Default)]
pub struct CancelFlag(Arc<AtomicBool>);

impl CancelFlag {
    /// Asks the reader to stop. It does so within some megabytes and returns
    /// [`VolumeError::Cancelled`](crate::VolumeError::Cancelled).
    pub fn cancel(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether somebody asked to stop.
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// What a user may ask of a reader.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct ReadOptions {
    /// Refuse a file whose voxels need more bytes than this.
    pub max_voxel_bytes: Option<u64>,
    /// Which of several volumes: a number from 1, or a name, as [`contents`](crate::contents)
    /// lists them.
    pub choice: Option<String>,
    /// Put interpolated slices in the place of missing ones, where a series lacks some.
    pub fill_missing_slices: bool,
    /// How a file without a header is to be read.
    pub raw: Option<RawLayout>,
    /// Stops reading when it is set.
    pub cancel: CancelFlag,
}

impl ReadOptions {
    /// The same options with a limit on the bytes of voxels.
    pub fn with_max_voxel_bytes(mut self, bytes: u64) -> Self {
        self.max_voxel_bytes = Some(bytes);
        self
    }

    /// The same options with a choice among several volumes.
    pub fn with_choice(mut self, choice: impl Into<String>) -> Self {
        self.choice = Some(choice.into());
        self
    }

    /// The same options, with missing slices interpolated or not.
    pub fn with_fill_missing_slices(mut self, fill: bool) -> Self {
        self.fill_missing_slices = fill;
        self
    }

    /// The same options with the layout of a file without a header.
    pub fn with_raw(mut self, layout: RawLayout) -> Self {
        self.raw = Some(layout);
        self
    }

    /// The same options with a flag that stops the reader.
    pub fn with_cancel(mut self, cancel: CancelFlag) -> Self {
        self.cancel = cancel;
        self
    }
}

/// One of the volumes that a file or folder holds.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Content {
    /// A name that chooses it, beside its number; empty if it has none.
    pub name: String,
    /// What it is, for its user: modality and description of a series, a grid's type.
    pub description: String,
    /// Voxels along x, y, z, if that is known without reading it.
    pub dims: Option<[u64; 3]>,
    /// Spacing along x, y, z in metres, if that is known without reading it.
    pub spacing: Option<[f64; 3]>,
}

impl Content {
    pub(super) fn line(&self, number: usize) -> String {
        let mut line = format!("{number}: ");
        if !self.name.is_empty() {
            line.push_str(&self.name);
            line.push_str(", ");
        }
        line.push_str(&self.description);
        if let Some([x, y, z]) = self.dims {
            line.push_str(&format!(", {x} × {y} × {z}"));
        }
        if let Some(spacing) = self.spacing {
            let [x, y, z] = spacing.map(|metres| (metres * 1e6).round() / 1e3);
            line.push_str(&format!(", spacing {x} × {y} × {z} mm"));
        }
        line
    }
}

/// The index that a choice (a number from 1, or a name) means.
pub(super) fn chosen(choice: &str, contents: &[Content]) -> Option<usize> {
    let by_name = contents.iter().position(|content| {
        !content.name.is_empty() && content.name.eq_ignore_ascii_case(choice.trim())
    });
    by_name.or_else(|| {
        let number = choice.trim().parse::<usize>().ok()?.checked_sub(1)?;
        (number < contents.len()).then_some(number)
    })
}
