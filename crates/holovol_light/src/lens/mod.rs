//! From two fisheye pictures to one panorama: lens models, calibration files, stitching.

mod calibration;
mod model;
mod overlap;
mod stitch;

pub use calibration::{Calibration, CalibrationError, Lens};
pub use model::{LensModel, Projection};
pub use overlap::{Refined, refine};
pub use stitch::{FisheyePair, Stitcher};
