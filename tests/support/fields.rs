//! Small scenes, made in memory.

use glam::{DMat4, DVec3};
use holovol_light::EnvironmentMap;
use holovol_scene::{Camera, Environment, Integrator, Scene};
use holovol_volume::{Geometry, TransferFunction, TransferPoint, Volume, Voxels};

pub fn point(s: f64, sigma_t: f64, albedo: f64) -> TransferPoint {
    TransferPoint {
        s,
        sigma_t,
        albedo: [albedo; 3],
        emission: [0.0; 3],
        roughness: 0.5,
        specular: 0.0,
    }
}

pub fn transfer_function(points: Vec<TransferPoint>) -> TransferFunction {
    TransferFunction::new(points).expect("sorted points in range")
}

/// Values of a field over the unit cube at voxel centres.
pub fn values(dims: [u32; 3], field: impl Fn(DVec3) -> f64) -> Vec<f64> {
    let size = DVec3::from_array(dims.map(f64::from));
    let mut values = Vec::new();
    for k in 0..dims[2] {
        for j in 0..dims[1] {
            for i in 0..dims[0] {
                values.push(field(
                    (DVec3::new(i.into(), j.into(), k.into()) + 0.5) / size,
                ));
            }
        }
    }
    values
}

pub fn volume_of(voxels: Voxels, dims: [u32; 3], slope: f64, intercept: f64) -> Volume {
    let geometry = Geometry::from_spacing([1.0; 3]);
    Volume::new(voxels, dims, slope, intercept, geometry).expect("one value per voxel")
}

pub fn volume(dims: [u32; 3], field: impl Fn(DVec3) -> f64) -> Volume {
    let voxels = values(dims, field).into_iter().map(|v| v as f32).collect();
    volume_of(Voxels::F32(voxels), dims, 1.0, 0.0)
}

/// Two blobs of unequal size and a ripple: no symmetry, several cells, empty corners.
pub fn blobs(at: DVec3) -> f64 {
    let near = (at - DVec3::new(0.35, 0.4, 0.6)).length();
    let far = (at - DVec3::new(0.7, 0.65, 0.3)).length();
    let ripple = 1.0 + 0.3 * (11.0 * at.x + 7.0 * at.y - 5.0 * at.z).sin();
    ((1.0 - 2.6 * near).max(0.0) + 0.8 * (1.0 - 3.5 * far).max(0.0)) * ripple
}

/// A unit cube about the origin in uniform light of 1, seen through a beam along −z.
pub fn scene(volume: Volume, points: Vec<TransferPoint>) -> Scene {
    Scene {
        volume,
        window: [0.0, 1.0],
        world_from_unit_cube: DMat4::from_translation(DVec3::splat(-0.5)),
        transfer_function: transfer_function(points),
        phase_g: 0.0,
        gradient_factor: 0.0,
        clip_planes: Vec::new(),
        environment: uniform_light(1.0),
        camera: beam(DVec3::new(0.0, 0.0, 3.0), DVec3::ZERO),
        integrator: Integrator {
            max_scatters: Some(1),
        },
    }
}

/// The same everywhere.
pub fn homogeneous(sigma_t: f64, albedo: f64) -> Scene {
    scene(
        volume([1, 1, 1], |_| 0.5),
        vec![point(0.0, sigma_t, albedo)],
    )
}

/// [`blobs`] in uneven light, seen whole by 24 × 24 pixels.
pub fn blob_scene() -> Scene {
    let mut scene = scene(
        volume([19, 21, 18], blobs),
        vec![
            point(0.05, 0.0, 0.9),
            point(0.4, 6.0, 0.8),
            point(0.9, 14.0, 0.5),
        ],
    );
    scene.environment = uneven_light();
    scene.camera = Camera {
        fov_y: 0.42,
        width: 24,
        height: 24,
        ..beam(DVec3::new(1.1, 0.8, 2.4), DVec3::ZERO)
    };
    scene
}

pub fn uniform_light(radiance: f32) -> Environment {
    Environment {
        map: EnvironmentMap::constant([radiance; 3]),
        rotation_y: 0.0,
        scale: 1.0,
    }
}

/// A coloured gradient with a brighter patch, turned a little.
pub fn uneven_light() -> Environment {
    let (width, height) = (12usize, 6usize);
    let texel = |i: usize| {
        let (x, y) = ((i % width) as f32, (i / width) as f32);
        let level = 0.3 + 0.25 * (1.0 + (0.9 * x + 0.5 * y).sin()) + 0.1 * (5.0 - y);
        let patch = if i == 2 * width + 4 { 12.0 } else { 0.0 };
        [
            level + patch,
            0.8 * level + 0.03 * x + patch,
            0.5 * level + 0.1 * y,
        ]
    };
    Environment {
        map: EnvironmentMap::new(width, height, (0..width * height).map(texel).collect()),
        rotation_y: 0.5,
        scale: 0.7,
    }
}

/// 16 × 16 pixels that look along one line: 256 estimates of one number.
pub fn beam(eye: DVec3, target: DVec3) -> Camera {
    let is_vertical = (target - eye).normalize().cross(DVec3::Y).length() < 1e-3;
    Camera {
        eye,
        target,
        up: if is_vertical { DVec3::X } else { DVec3::Y },
        fov_y: 3e-4,
        width: 16,
        height: 16,
    }
}
