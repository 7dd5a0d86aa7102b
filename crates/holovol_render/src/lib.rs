//! The wgpu kernels of holovol: majorants and the volume path tracer. Runs on any wgpu device.

pub use wgpu;
