//! Which variant of the kernel a scene gets: what it doesn't use isn't compiled in.

use super::uniforms::{MAX_VIEWS, UNROLLED_POINTS};
use super::{Interpolation, Medium, TraceOptions};
use crate::Gpu;
use crate::shader::{ShaderDefs, ShaderFile, shader_file};

pub(crate) const TRACE: ShaderFile = shader_file!("trace.wgsl");
pub(crate) const PATH: ShaderFile = shader_file!("path.wgsl");

pub(crate) const WORKGROUP_SIZE: u32 = 64;
/// Samples in the first of a pixel's two sums; f32 keeps 1024 addends to better than 1e-4.
pub(super) const FOLD_SAMPLES: u32 = 1024;
/// vec4s of a saved path, besides one for each collision that a flight chooses.
pub(super) const SAVED_PATH_VECTORS: u32 = 12;
/// Paths that one dispatch can save: at most 16 MiB each of two queues.
pub(crate) const QUEUE_CAPACITY: u32 = 65536;
/// |g| up to which the phase function varies so little that it needs no candidate of its own.
pub(super) const NEARLY_ISOTROPIC: f64 = 0.25;
/// Collisions of the camera's flight that are lit. Measured over the reference scenes: 4 is 1.5 to
/// 1.9 times as efficient as 1.
pub(super) const PICKS: u32 = 4;
/// Cells that a walk crosses in one round.
pub(super) const STEPS_PER_ROUND: u32 = 4;
/// Lanes scatter once those that wait, times this, are as many as those that walk.
pub(super) const SERVE_RATIO: u32 = 1;

/// Candidates for one light choice, from the environment and from the phase function.
///
/// A (nearly) isotropic medium needs one: the environment's density is already that of the
/// product. At |g| = 0.2 a second candidate was measured 15 % more efficient under a red sun and
/// 20 % less in a living room.
fn light_candidates(medium: &Medium, has_density: bool) -> [u32; 2] {
    if !has_density {
        [0, 1]
    } else if medium.phase_g.abs() <= NEARLY_ISOTROPIC && medium.gradient_factor == 0.0 {
        [1, 0]
    } else {
        [1, 1]
    }
}

/// What decides the variant besides the medium and the options.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Surroundings {
    pub(crate) constant_environment: bool,
    pub(crate) has_density: bool,
    /// The volume is an array of slices.
    pub(crate) slices: bool,
    /// Paths end at meshes.
    pub(crate) mesh_depth: bool,
    /// Parts of an image get fewer samples.
    pub(crate) sample_shares: bool,
    /// What samples find goes to the light grid, too.
    pub(crate) light_grid: bool,
}

pub(crate) fn shader_defs(
    gpu: &Gpu,
    medium: &Medium,
    options: &TraceOptions,
    surroundings: Surroundings,
) -> ShaderDefs {
    let points = medium.transfer_function.points();
    let emission = points.iter().any(|point| point.emission != [0.0; 3]);
    let multiple = medium.max_scatters != Some(0) && (emission || medium.max_scatters != Some(1));
    let [environment, scatter] = match options.light_candidates {
        Some(candidates) if surroundings.has_density => candidates,
        _ => light_candidates(medium, surroundings.has_density),
    };
    let unrolled = if points.len() <= UNROLLED_POINTS {
        points.len() as u32
    } else {
        0
    };
    let subgroups = options.subgroups && gpu.device.features().contains(wgpu::Features::SUBGROUP);
    vec![
        ("CELL_SIZE", options.cell_size),
        ("TRANSFER_POINTS", unrolled),
        ("UNROLLED_POINTS", UNROLLED_POINTS as u32),
        (
            "HARDWARE_INTERPOLATION",
            u32::from(options.interpolation == Interpolation::Hardware),
        ),
        ("SURFACE", u32::from(medium.gradient_factor > 0.0)),
        ("EMISSION", u32::from(emission)),
        ("MULTIPLE_SCATTERING", u32::from(multiple)),
        (
            "CONSTANT_ENVIRONMENT",
            u32::from(surroundings.constant_environment),
        ),
        ("ENVIRONMENT_CANDIDATES", environment),
        ("SCATTER_CANDIDATES", scatter),
        ("LIGHT_BANDS", holovol_light::LIGHT_BANDS as u32),
        ("SLICES", u32::from(surroundings.slices)),
        ("MESH_DEPTH", u32::from(surroundings.mesh_depth)),
        ("SAMPLE_SHARES", u32::from(surroundings.sample_shares)),
        ("LIGHT_GRID", u32::from(surroundings.light_grid)),
        ("SHARE_BLOCK", crate::frame::SHARE_BLOCK),
        ("CLIP_PLANES", medium.clip_planes.len() as u32),
        ("CLIP_PLANES_MAX", Medium::MAX_CLIP_PLANES as u32),
        ("VIEWS_MAX", MAX_VIEWS as u32),
        ("GUIDES", u32::from(options.guides)),
        ("STATISTICS", u32::from(options.statistics)),
        ("WHITE_NOISE", u32::from(options.white_noise)),
        ("SUBGROUPS", u32::from(subgroups)),
        ("STEPS_PER_ROUND", STEPS_PER_ROUND),
        ("SERVE_RATIO", SERVE_RATIO),
        ("FOLD_SAMPLES", FOLD_SAMPLES),
        ("SAVED_PATH_VECTORS", SAVED_PATH_VECTORS + options.picks),
        ("PICKS", options.picks),
        ("WORKGROUP_SIZE", WORKGROUP_SIZE),
    ]
}
