//! Environment light for volume rendering: radiance maps and their sampling tables.
//!
//! An [`EnvironmentMap`] is a latitude–longitude picture of linear radiance around the scene;
//! an [`EnvironmentSampler`] draws directions in exact proportion to its interpolated importance.

pub mod align;
pub mod chain;
pub mod change;
mod environment;
pub mod estimate;
pub mod evaluate;
mod grid;
pub mod lens;
pub mod measure;
pub mod response;
mod sampler;
pub mod temporal;
pub mod xmp;

pub use environment::{EnvironmentMap, LightError, luminance};
pub use grid::Grid;
pub use sampler::{AliasEntry, EnvironmentSampler, importance};
