//! TODO
/// Histogram placeholder.
pub struct Histogram;
