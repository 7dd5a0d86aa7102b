//! Environment light for volume rendering: from a camera's pictures to radiance maps and their
//! sampling tables.
//!
//! An [`EnvironmentMap`] is a latitude–longitude picture of linear radiance around the scene;
//! an [`EnvironmentSampler`] draws directions in exact proportion to its interpolated importance.
//!
//! Where the map comes from: [`lens`] joins fisheye pictures to a panorama, [`response`] makes it
//! linear, [`estimate`] restores the light that clipped, [`temporal`] and [`change`] follow it
//! over time, [`align`] brings it to the world's frame and the volume's place. [`chain`] does the
//! middle of this frame by frame: start there. [`evaluate`] measures what it is worth.

#![expect(
    clippy::needless_range_loop,
    reason = "loops over channels and small matrices read as the formulas do"
)]

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
pub use sampler::{AliasEntry, EnvironmentSampler, LIGHT_BANDS, importance};
