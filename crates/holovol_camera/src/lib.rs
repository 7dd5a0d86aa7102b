//! 360° cameras.
//!
//! [`VirtualCamera`] takes fisheye pictures of a known radiance map, with the faults of a real
//! camera: the tests and the demonstration of everything that turns pictures into light. It is
//! written apart from the code that undoes its faults, in double precision.

mod optics;
mod pipeline;
mod sensor;

pub use optics::VirtualLens;
pub use pipeline::{CameraError, Exposure, Shot, VirtualCamera};
pub use sensor::{Curve, Sensor};
