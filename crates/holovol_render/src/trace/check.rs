//! What no kernel could trace, found before anything is uploaded.

use glam::{DMat3, DMat4, DVec3, DVec4};
use holovol_scene::Scene;

use super::{Medium, TraceOptions};
use crate::RenderError;

/// Registers for candidates and chosen collisions are laid out for this many.
const PICKS_MAX: u32 = 4;
const CANDIDATES_MAX: u32 = 8;

/// Between the view and `up`: below, rounding decides which way is up.
const SMALLEST_SINE: f64 = 1e-9;

/// Fails on media that would put NaN or infinity into every path.
pub(crate) fn medium(medium: &Medium, dims: [u32; 3]) -> Result<(), RenderError> {
    let determinant = DMat3::from_mat4(medium.world_from_unit_cube).determinant();
    let inverse = medium.world_from_unit_cube.inverse();
    // The kernels keep texels per metre in f32, and divide by them.
    let is_representable = (0..3).all(|axis| {
        let texels_per_metre = inverse.row(axis).truncate().length() * f64::from(dims[axis]);
        (texels_per_metre as f32).is_normal()
    });
    if determinant == 0.0 || !determinant.is_finite() || !inverse.is_finite() || !is_representable {
        return refuse(
            "volume.world_from_unit_cube",
            format!(
                "its determinant is {determinant:e} m³: expected a finite matrix that can be \
                 inverted, and voxels between 1e-37 and 1e37 m"
            ),
        );
    }
    let [low, high] = medium.window;
    if !(low.is_finite() && high.is_finite() && low != high) {
        return refuse(
            "volume.window",
            format!("[{low}, {high}]: expected two different finite numbers"),
        );
    }
    let g = medium.phase_g;
    if !(g > -1.0 && g < 1.0) {
        return refuse(
            "phase_g",
            format!("{g}: expected more than -1 and less than 1"),
        );
    }
    let planes = &medium.clip_planes;
    let is_plane = |plane: &DVec4| plane.is_finite() && plane.truncate() != DVec3::ZERO;
    if planes.len() > Medium::MAX_CLIP_PLANES || !planes.iter().all(is_plane) {
        return refuse(
            "clip",
            format!(
                "{planes:?}: expected at most {} finite planes, each with a normal",
                Medium::MAX_CLIP_PLANES
            ),
        );
    }
    Ok(())
}

/// Fails on cameras that see nothing definite.
pub(crate) fn camera(scene: &Scene) -> Result<(), RenderError> {
    let camera = &scene.camera;
    let rays = camera.pixel_rays(DMat4::IDENTITY);
    let directions = [rays.direction, rays.direction_dx, rays.direction_dy];
    let is_finite = rays.origin.is_finite() && directions.iter().all(|d| d.is_finite());
    let forward = (camera.target - camera.eye).normalize_or_zero();
    let has_up = forward.cross(camera.up.normalize_or_zero()).length() > SMALLEST_SINE;
    if !is_finite || !has_up || camera.width == 0 || camera.height == 0 {
        return refuse(
            "camera",
            format!(
                "{} × {} pixels from {} to {}: expected at least one pixel, `eye` and `target` \
                 apart, and `up` along neither",
                camera.width, camera.height, camera.eye, camera.target
            ),
        );
    }
    Ok(())
}

/// Fails on options for which there is no kernel.
pub(crate) fn options(options: &TraceOptions) -> Result<(), RenderError> {
    if !(1..=PICKS_MAX).contains(&options.picks) {
        return refuse(
            "picks",
            format!("{}: expected 1 to {PICKS_MAX}", options.picks),
        );
    }
    if let Some(candidates) = options.light_candidates
        && (candidates == [0, 0] || candidates.iter().any(|&n| n > CANDIDATES_MAX))
    {
        return refuse(
            "light_candidates",
            format!("{candidates:?}: expected at least one, and at most {CANDIDATES_MAX} of each"),
        );
    }
    if options.cell_size == 0 {
        return refuse("cell_size", "0 voxels: expected at least 1".into());
    }
    if options.budget == 0 {
        return refuse("budget", "0 rounds: expected at least 1".into());
    }
    Ok(())
}

fn refuse(field: &'static str, reason: String) -> Result<(), RenderError> {
    Err(RenderError::Scene { field, reason })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_without_a_kernel_are_refused() {
        let fine = TraceOptions::default();
        assert!(options(&fine).is_ok());
        type Spoil = fn(&mut TraceOptions);
        let wrong: [(&str, Spoil); 6] = [
            ("picks", |o| o.picks = 0),
            ("picks", |o| o.picks = 5),
            ("light_candidates", |o| o.light_candidates = Some([0, 0])),
            ("light_candidates", |o| o.light_candidates = Some([9, 1])),
            ("cell_size", |o| o.cell_size = 0),
            ("budget", |o| o.budget = 0),
        ];
        for (field, spoil) in wrong {
            let mut spoilt = fine.clone();
            spoil(&mut spoilt);
            let message = options(&spoilt).expect_err(field).to_string();
            assert!(message.starts_with(field), "{message}");
        }
    }
}
