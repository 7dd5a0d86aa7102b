//! CPU twins of the functions that kernels share: each file mirrors the WGSL file of its name, in
//! f32 and in the same order, so that tests can compare the two number by number.

pub mod environment;
pub mod field;
pub mod phase_function;
pub mod random;
pub mod scattering;
pub mod surface;
pub mod transfer_function;
pub mod walk;

#[cfg(test)]
mod tests;

/// What WGSL's `mix` is for numbers.
fn mix(a: f32, b: f32, t: f32) -> f32 {
    a * (1.0 - t) + b * t
}
