//! Small scenes that use everything, and numbers to feed to single functions.

use glam::{DMat3, DMat4, DQuat, DVec3, Vec3, vec3};
use holovol_light::EnvironmentMap;
use holovol_render::testing::twins::random::{pcg3d, unit_float};
use holovol_scene::{Camera, Environment, Integrator, Scene};
use holovol_volume::{Geometry, TransferFunction, TransferPoint, Volume, Voxels};

/// Three numbers in [0, 1).
pub fn numbers(i: u32, stream: u32) -> [f32; 3] {
    pcg3d([i, stream, 0x3c6e_f372]).map(unit_float)
}

/// A direction, uniform over the sphere.
pub fn direction(i: u32, stream: u32) -> Vec3 {
    let [x, y, _] = numbers(i, stream);
    let z = 1.0 - 2.0 * x;
    let (sin, cos) = (std::f32::consts::TAU * y).sin_cos();
    let radius = (1.0 - z * z).max(0.0).sqrt();
    vec3(radius * cos, radius * sin, z).normalize()
}

pub fn volume(voxels: Voxels, dims: [u32; 3]) -> Volume {
    let geometry = Geometry::from_spacing([1e-3; 3]);
    Volume::new(voxels, dims, 1.0, 0.0, geometry).expect("a volume")
}

/// A volume of random voxels around ½.
pub fn random_volume(dims: [u32; 3], stream: u32, contrast: f32) -> Volume {
    let count = dims.iter().product();
    let voxels = (0..count).map(|i| 0.5 + contrast * (numbers(i, stream)[0] - 0.5));
    volume(Voxels::F32(voxels.collect()), dims)
}

pub fn point(s: f64, sigma_t: f64) -> TransferPoint {
    TransferPoint {
        s,
        sigma_t,
        albedo: [0.9, 0.5, 0.2],
        emission: [0.0; 3],
        roughness: 0.5,
        specular: 0.0,
    }
}

/// Points with a value of their own in each field, some of them coincident.
pub fn random_transfer_function(count: u32, stream: u32) -> TransferFunction {
    let mut s: Vec<_> = (0..count)
        .map(|i| (f64::from(numbers(i, stream)[0]) * 48.0).round() / 32.0 - 0.25)
        .collect();
    s.sort_by(f64::total_cmp);
    let points = s.into_iter().zip(0..).map(|(s, i)| {
        let triple = |k| numbers(i, stream + k).map(f64::from);
        TransferPoint {
            s,
            sigma_t: (300.0 * (triple(100)[0] - 0.4)).max(0.0),
            albedo: triple(101),
            emission: triple(102),
            roughness: triple(103)[0],
            specular: triple(103)[1],
        }
    });
    TransferFunction::new(points.collect()).expect("a transfer function")
}

/// A map of one number per texel, tinted.
pub fn environment(
    width: usize,
    height: usize,
    texel: impl Fn(usize, usize) -> f32,
) -> Environment {
    let texels = (0..width * height)
        .map(|i| texel(i % width, i / width))
        .map(|value| [value, 0.5 * value, 0.25 * value]);
    Environment {
        map: EnvironmentMap::new(width, height, texels.collect()),
        rotation_y: 0.7,
        scale: 1.5,
    }
}

/// Maps with a seam, poles, black rows, and a sun of one texel.
pub fn environments() -> Vec<Environment> {
    let noise = |i: usize, j: usize| numbers((i + 100 * j) as u32, 77)[0];
    vec![
        environment(2, 1, |i, _| i as f32),
        environment(1, 2, |_, j| 1.0 + j as f32),
        environment(5, 3, |_, j| if j == 1 { 0.0 } else { 1.0 }),
        environment(17, 9, noise),
        environment(
            64,
            32,
            |i, j| if (i, j) == (11, 9) { 1e9 } else { noise(i, j) },
        ),
    ]
}

/// Rotated, sheared, mirrored and stretched: about 0.1 m × 0.05 m × 0.2 m.
pub fn skewed() -> DMat4 {
    let rotation = DQuat::from_euler(glam::EulerRot::XYZ, 0.4, -0.9, 0.2);
    let stretch = DMat3::from_cols(
        DVec3::new(-0.1, 0.0, 0.0),
        DVec3::new(0.01, 0.05, 0.0),
        DVec3::new(0.0, 0.02, 0.2),
    );
    let edges = DMat3::from_quat(rotation) * stretch;
    let corner = -0.5 * (edges.x_axis + edges.y_axis + edges.z_axis);
    DMat4::from_mat3_translation(edges, corner)
}

/// Everything switched on.
pub fn scene() -> Scene {
    Scene {
        volume: random_volume([21, 9, 14], 1, 1.0),
        window: [0.1, 0.8],
        world_from_unit_cube: skewed(),
        transfer_function: random_transfer_function(6, 2),
        phase_g: 0.4,
        gradient_factor: 0.8,
        environment: environment(17, 9, |i, j| numbers((i + 100 * j) as u32, 77)[0]),
        camera: Camera {
            eye: DVec3::new(0.1, 0.1, 0.5),
            target: DVec3::ZERO,
            up: DVec3::Y,
            fov_y: 0.5,
            width: 24,
            height: 20,
        },
        clip_planes: Vec::new(),
        integrator: Integrator {
            max_scatters: Some(3),
        },
    }
}
