//! The oracle of holovol: a plain f64 volume path tracer and the measures that judge pictures.
//!
//! [`render`] makes a [`Film`] of a [`holovol_scene::Scene`] with rayon: unbiased, deterministic
//! for a seed, and free of any sampling code that the kernels use. [`measures`] compares images
//! as people and as errors see them, [`statistics`] says whether two of them differ by more than
//! chance. Some 10⁵ to 10⁶ samples per second and core; memory is that of the scene, one f64 per
//! 4³ voxels and per environment texel, and 64 bytes per pixel.
//!
//! ```no_run
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use std::ops::ControlFlow;
//! let scene = holovol_scene::load("scene.json".as_ref(), &mut |_| {})?;
//! let settings = holovol_reference::Settings { spp: 256, ..Default::default() };
//! let film = holovol_reference::render(&scene, &settings, &mut |_| ControlFlow::Continue(()))?;
//! film.image().write_exr("scene.exr".as_ref())?;
//! # Ok(()) }
//! ```

mod environment;
mod field;
mod film;
mod image;
mod majorants;
pub mod measures;
mod phase;
mod rng;
mod special;
pub mod statistics;
mod stored;
mod tracer;
mod tracking;

#[cfg(test)]
mod tests;

pub use film::Film;
pub use image::{Image, ImageError};
pub use stored::{ReferenceInfo, StoredError, StoredReference};
pub use tracer::{LightStrategy, Settings, TraceError, Tracer, render};
