//! The wgpu kernels of holovol: majorants and the volume path tracer.
//!
//! Runs on any wgpu device, with or without a window: [`Gpu::new`] opens one, Bevy brings its own.
//!
//! ```no_run
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use holovol_render::{Gpu, TraceOptions, Tracer};
//! let scene = holovol_scene::load("scene.json".as_ref(), &mut |_progress| {})?;
//! let gpu = Gpu::new(None)?;
//! let mut tracer = Tracer::new(&gpu, &scene, &TraceOptions::default())?;
//! tracer.accumulate(64)?;
//! let pixels: Vec<[f32; 4]> = tracer.read_image()?;
//! # Ok(()) }
//! ```

mod composite;
mod denoise;
mod depth;
mod error;
mod fetch;
mod frame;
mod gpu;
mod layout;
mod light_grid;
mod majorant;
mod shader;
#[cfg(any(test, feature = "testing"))]
#[doc(hidden)]
pub mod shared;
#[cfg(any(test, feature = "testing"))]
#[doc(hidden)]
pub mod testing;
mod trace;
mod variants;
mod view_depth;
mod volume;

pub use composite::{CompositeBinding, CompositePlace, CompositeTarget, Compositor};
pub use denoise::{
    DenoiseFrame, DenoiseKernels, DenoiseMode, DenoiseSettings, Denoiser, LightChange,
    PaperSettings, environment_change,
};
pub use depth::{DepthLayers, DepthSource, MeshDepth};
pub use error::RenderError;
pub use frame::{
    FrameImage, FrameTracer, FrameWork, Kernels, SHARE_BLOCK, SampleShares, ViewFrame,
};
pub use gpu::{Gpu, wanted_features, wanted_limits};
pub use majorant::MajorantGrid;
pub use trace::{
    Counters, GpuEnvironment, Guide, Interpolation, MAX_VIEWS, Medium, TraceOptions, Tracer, View,
};
pub use view_depth::{LEAST_OPACITY, ViewDepth, ViewDepthTarget};
pub use volume::GpuVolume;
pub use wgpu;
