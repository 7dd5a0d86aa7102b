//! What this crate's tests need of its inside: CPU twins of the kernels, a way to call single
//! functions of them on the GPU, and a way to damage them, which shows that a test can fail.

pub mod sphere;

use std::borrow::Cow;
use std::cell::Cell;

pub use crate::denoise::cpu as denoise;
pub use crate::light_grid::cpu as light_grid;
pub use crate::majorant::cpu as majorants;
pub use crate::shared as twins;
pub use crate::trace::contract::{Contract, Lane};

use crate::shader::ShaderFile;
use crate::{Gpu, MajorantGrid, RenderError};

/// One change to one WGSL file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mutation {
    /// The file, as kernels name it: `shared/…` or its bare name.
    pub path: &'static str,
    /// Text that is there.
    pub from: &'static str,
    /// What takes its place.
    pub to: &'static str,
}

thread_local! {
    static MUTATION: Cell<Option<Mutation>> = const { Cell::new(None) };
}

impl Mutation {
    /// Runs something with the kernels it compiles changed. Fails if the text isn't there: the
    /// list of mutations must follow the kernels.
    pub fn during<T>(self, act: impl FnOnce() -> T) -> T {
        MUTATION.set(Some(self));
        let value = act();
        MUTATION.set(None);
        value
    }
}

/// For threads that compile what another asks for.
pub(crate) fn present_mutation() -> Option<Mutation> {
    MUTATION.get()
}

pub(crate) fn set_mutation(mutation: Option<Mutation>) {
    MUTATION.set(mutation);
}

/// A file's text, mutated if it is its turn.
pub(crate) fn source(file: &ShaderFile) -> Cow<'static, str> {
    match MUTATION.get() {
        Some(Mutation { path, from, to }) if path == file.path => {
            assert!(file.source.contains(from), "{path} has no `{from}`");
            Cow::Owned(file.source.replace(from, to))
        }
        _ => Cow::Borrowed(file.source),
    }
}

/// The seed of the n-th image (1, 2, …) that a [`FrameTracer`](crate::FrameTracer) begins.
pub fn beginning_seed(seed: u64, beginning: u64) -> u64 {
    crate::frame::beginning_seed(seed, beginning)
}

/// Smallest and largest texel of each cell as the GPU found them, x fastest.
///
/// # Errors
/// If the device is lost.
pub fn read_cell_ranges(gpu: &Gpu, grid: &MajorantGrid) -> Result<Vec<[f32; 2]>, RenderError> {
    let bytes = gpu.read_buffer("cell ranges", &grid.cell_ranges, grid.cell_ranges.size())?;
    Ok(bytemuck::pod_collect_to_vec(&bytes))
}
