//! A kernel that does nothing but look the field up at random places, for benchmarks.

use crate::shader::{ShaderFile, shader_file};

pub(crate) const FETCH: ShaderFile = shader_file!("fetch.wgsl");
