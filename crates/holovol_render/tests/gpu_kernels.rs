//! Runs the shipped kernels on the GPU and compares them with their CPU twins.

fn main() {}
