//! Depth, albedo and gradient of the first collision.

use glam::{DMat4, DVec3, Vec3};
use holovol_render::{Gpu, Guide, TraceOptions, Tracer};
use holovol_scene::{Camera, Scene};
use holovol_volume::{TransferFunction, Voxels};

use super::scenes;

fn guides(gpu: &Gpu, scene: &Scene, samples: u32) -> Result<Vec<Guide>, String> {
    let options = TraceOptions {
        guides: true,
        ..Default::default()
    };
    let mut tracer = Tracer::new(gpu, scene, &options).map_err(|error| error.to_string())?;
    tracer
        .accumulate(samples)
        .map_err(|error| error.to_string())?;
    tracer.read_guides().map_err(|error| error.to_string())
}

/// Seen from the front, a medium of 1 mm mean free path: collisions lie 1 mm ± 1 mm behind it.
pub fn slab(gpu: &Gpu) -> Result<(), String> {
    let points = vec![scenes::point(0.5, 1000.0)];
    let scene = Scene {
        volume: scenes::volume(Voxels::U8(vec![7; 64]), [4, 4, 4]),
        window: [0.0, 255.0],
        world_from_unit_cube: DMat4::from_translation(DVec3::splat(-0.5)),
        transfer_function: TransferFunction::new(points).expect("a point"),
        gradient_factor: 0.0,
        camera: Camera {
            eye: DVec3::new(0.0, 0.0, 2.5),
            target: DVec3::ZERO,
            up: DVec3::Y,
            fov_y: 0.02,
            width: 8,
            height: 8,
        },
        ..scenes::scene()
    };
    for guide in guides(gpu, &scene, 256)? {
        let albedo = Vec3::from(guide.albedo).distance(Vec3::new(0.9, 0.5, 0.2));
        let is_right = (guide.depth - 2.001).abs() < 5e-4
            && (guide.spread - 1e-3).abs() < 5e-4
            && albedo < 1e-4
            && (guide.opacity - 1.0).abs() < 1e-3
            && guide.gradient_magnitude == 0.0;
        if !is_right {
            return Err(format!("{guide:?} of a slab 2 m away, 1 mm deep"));
        }
    }
    Ok(())
}

/// A linear field under a skewed transform: its gradient is known in closed form.
pub fn ramp(gpu: &Gpu) -> Result<(), String> {
    let dims = [24u32, 20, 16];
    let slope = DVec3::new(0.3, -0.2, 0.5);
    let at = |i: u32| {
        let index = [i % dims[0], i / dims[0] % dims[1], i / (dims[0] * dims[1])];
        let unit: [f64; 3] =
            std::array::from_fn(|k| (f64::from(index[k]) + 0.5) / f64::from(dims[k]));
        DVec3::from(unit).dot(slope) as f32
    };
    let voxels = (0..dims.iter().product()).map(at).collect();
    let window = [-0.2, 1.4];
    let scene = Scene {
        volume: scenes::volume(Voxels::F32(voxels), dims),
        window,
        transfer_function: TransferFunction::new(vec![scenes::point(0.0, 12.0)]).expect("a point"),
        camera: Camera {
            width: 16,
            height: 16,
            fov_y: 0.05,
            ..scenes::scene().camera
        },
        ..scenes::scene()
    };
    // Inverse transpose: world gradient of a function on the unit cube.
    let matrix = glam::DMat3::from_mat4(scene.world_from_unit_cube);
    let exact = matrix.inverse().transpose() * slope / (window[1] - window[0]);
    let mut seen = 0;
    for guide in guides(gpu, &scene, 64)? {
        if guide.opacity < 0.3 {
            continue;
        }
        seen += 1;
        let direction = Vec3::from(guide.gradient).as_dvec3().normalize();
        // Differences near the border are cut by clamping: a few samples of many.
        let is_right = direction.dot(exact.normalize()) > 0.97
            && (f64::from(guide.gradient_magnitude) / exact.length() - 1.0).abs() < 0.15;
        if !is_right {
            return Err(format!("{guide:?} where the gradient is {exact}"));
        }
    }
    if seen < 20 {
        Err(format!("the ramp covers {seen} pixels"))
    } else {
        Ok(())
    }
}
