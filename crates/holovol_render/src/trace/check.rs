//! What no kernel could trace, found before anything is uploaded.

use glam::{DMat3, DMat4, DVec3, DVec4};
use holovol_scene::Scene;

use super::Medium;
use crate::RenderError;

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

fn refuse(field: &'static str, reason: String) -> Result<(), RenderError> {
    Err(RenderError::Scene { field, reason })
}
