//! Single scattering and emission by deterministic integration, to be compared with the tracer.
//!
//! It shares scene types with the tracer (field, transfer function, radiance map), and nothing
//! that draws, tracks, or transforms.

use std::f64::consts::{PI, TAU};

use glam::{DMat3, DMat4, DVec3};
use holovol_scene::Scene;
use holovol_volume::Material;
use rayon::prelude::*;

use super::scenes::*;
use crate::LightStrategy;

/// Nodes and weights of Gauss and Legendre's rule with three points on [0, 1].
const GAUSS: [(f64, f64); 3] = [
    (0.112_701_665_379_258_3, 5.0 / 18.0),
    (0.5, 4.0 / 9.0),
    (0.887_298_334_620_741_7, 5.0 / 18.0),
];

/// How finely to integrate.
#[derive(Clone, Copy)]
pub struct Fineness {
    /// Steps along the view ray.
    pub view: usize,
    /// Steps along each ray to the light.
    pub light: usize,
    /// Cells per bilinear patch of the environment and axis; each has 3 × 3 nodes.
    pub patch: usize,
}

impl Default for Fineness {
    fn default() -> Self {
        Self {
            view: 64,
            light: 32,
            patch: 1,
        }
    }
}

/// Cramer's rule for mᵀ x = b: x · (column i of m) = b[i].
fn solve_rows(m: DMat3, b: DVec3) -> DVec3 {
    let (a0, a1, a2) = (m.x_axis, m.y_axis, m.z_axis);
    let volume = a0.dot(a1.cross(a2));
    (a1.cross(a2) * b.x + a2.cross(a0) * b.y + a0.cross(a1) * b.z) / volume
}

struct Medium<'a> {
    scene: &'a Scene,
    axes: DMat3,
    corner: DVec3,
}

impl<'a> Medium<'a> {
    fn new(scene: &'a Scene) -> Self {
        let m = scene.world_from_unit_cube;
        Self {
            scene,
            axes: DMat3::from_mat4(m),
            corner: m.w_axis.truncate(),
        }
    }

    fn unit_cube(&self, world: DVec3) -> DVec3 {
        let offset = world - self.corner;
        let (a, b, c) = (self.axes.x_axis, self.axes.y_axis, self.axes.z_axis);
        let volume = a.dot(b.cross(c));
        DVec3::new(
            offset.dot(b.cross(c)),
            offset.dot(c.cross(a)),
            offset.dot(a.cross(b)),
        ) / volume
    }

    fn s(&self, unit_cube: DVec3) -> f64 {
        let [low, high] = self.scene.window;
        (self.scene.volume.sample(unit_cube) - low) / (high - low)
    }

    fn material(&self, world: DVec3) -> Material {
        self.scene
            .transfer_function
            .eval(self.s(self.unit_cube(world)))
    }

    fn gradient(&self, world: DVec3) -> DVec3 {
        let at = self.unit_cube(world);
        let dims = DVec3::from_array(self.scene.volume.dims().map(f64::from));
        let change = |axis: DVec3| 0.5 * (self.s(at + axis / dims) - self.s(at - axis / dims));
        let changes = DVec3::new(change(DVec3::X), change(DVec3::Y), change(DVec3::Z));
        solve_rows(self.axes * DMat3::from_diagonal(1.0 / dims), changes)
    }

    /// Distances between which a ray is in the volume.
    fn inside(&self, origin: DVec3, direction: DVec3) -> Option<(f64, f64)> {
        let start = self.unit_cube(origin);
        let step = self.unit_cube(origin + direction) - start;
        let (mut enter, mut leave) = (0.0f64, f64::INFINITY);
        for axis in 0..3 {
            if step[axis].abs() < 1e-14 {
                if !(0.0..=1.0).contains(&start[axis]) {
                    return None;
                }
                continue;
            }
            let ends = [-start[axis] / step[axis], (1.0 - start[axis]) / step[axis]];
            enter = enter.max(ends[0].min(ends[1]));
            leave = leave.min(ends[0].max(ends[1]));
        }
        (enter < leave).then_some((enter, leave))
    }

    fn transmittance(&self, origin: DVec3, direction: DVec3, steps: usize) -> f64 {
        let Some((enter, leave)) = self.inside(origin, direction) else {
            return 1.0;
        };
        let length = (leave - enter) / steps as f64;
        let depth: f64 = (0..steps)
            .map(|i| {
                let t = enter + (i as f64 + 0.5) * length;
                self.material(origin + direction * t).sigma_t
            })
            .sum();
        (-depth * length).exp()
    }

    /// f of DESIGN §2, written down once more and in other terms.
    fn scattering(&self, at: DVec3, material: &Material, wo: DVec3, wi: DVec3) -> f64 {
        let g = self.scene.phase_g;
        let cosine = (-wo).dot(wi);
        let hg = (1.0 - g * g) / (4.0 * PI * (1.0 + g * g - 2.0 * g * cosine).powf(1.5));
        let k = self.scene.gradient_factor;
        let gradient = self.gradient(at);
        if k == 0.0 || gradient.length() == 0.0 {
            return hg;
        }
        let spacing = (0..3)
            .map(|a| self.axes.col(a).length() / f64::from(self.scene.volume.dims()[a]))
            .fold(f64::INFINITY, f64::min);
        let p = 1.0 - (-k * gradient.length() * spacing).exp();
        let mut n = gradient.normalize();
        n *= n.dot(wo).signum();
        let bracket = surface_term(n, wo, wi, material.roughness, material.specular);
        (1.0 - p) * hg + p * bracket
    }
}

/// The bracket of DESIGN §2.
pub fn surface_term(n: DVec3, wo: DVec3, wi: DVec3, roughness: f64, specular: f64) -> f64 {
    let (cos_o, cos_i) = (n.dot(wo), n.dot(wi));
    if cos_i <= 0.0 {
        return 0.0;
    }
    let fresnel = |c: f64| match specular {
        0.0 => 0.0,
        f0 => f0 + (1.0 - f0) * (1.0 - c).powf(5.0),
    };
    let alpha = roughness.powi(2).max(1e-3);
    let half = (wo + wi).normalize();
    let tan2 = |c: f64| (1.0 - c * c) / (c * c);
    let lambda = |c: f64| 0.5 * ((1.0 + alpha * alpha * tan2(c)).sqrt() - 1.0);
    let cos_h = n.dot(half);
    let d =
        1.0 / (PI * alpha.powi(2) * cos_h.powi(4) * (1.0 + tan2(cos_h) / alpha.powi(2)).powi(2));
    let shadowing = 1.0 / (1.0 + lambda(cos_o) + lambda(cos_i));
    (1.0 - fresnel(cos_o)) * cos_i / PI + d * shadowing * fresnel(half.dot(wo)) / (4.0 * cos_o)
}

/// World directions with their radiance × solid angle, over the environment.
fn light_nodes(scene: &Scene, per_patch: usize) -> Vec<(DVec3, DVec3)> {
    let environment = &scene.environment;
    let map = &environment.map;
    let (columns, rows) = (map.width() * per_patch, (map.height() + 1) * per_patch);
    let mut nodes = Vec::new();
    for row in 0..rows {
        // Patches lie between texel rows; the first and the last are half as high.
        let border = |index: usize| {
            let v = (index as f64 / per_patch as f64 - 0.5) / map.height() as f64;
            v.clamp(0.0, 1.0)
        };
        let (top, bottom) = (border(row), border(row + 1));
        for column in 0..columns {
            let left = (column as f64 / per_patch as f64 + 0.5) / map.width() as f64;
            let width = 1.0 / columns as f64;
            for (y, wy) in GAUSS {
                for (x, wx) in GAUSS {
                    let (u, v) = (left + x * width, top + y * (bottom - top));
                    let (theta, phi) = (v * PI, (u - 0.5) * TAU);
                    let solid_angle = wx * wy * (width * TAU) * ((bottom - top) * PI) * theta.sin();
                    // Centre of the image along −z, u toward +x, v = 0 up.
                    let own = DVec3::new(
                        theta.sin() * phi.sin(),
                        theta.cos(),
                        -theta.sin() * phi.cos(),
                    );
                    // Counter-clockwise from above turns +z to +x.
                    let (sin, cos) = environment.rotation_y.sin_cos();
                    let world =
                        DVec3::new(own.x * cos + own.z * sin, own.y, own.z * cos - own.x * sin);
                    let radiance = map.radiance_at_uv([u, v]).map(|c| c * environment.scale);
                    nodes.push((world, DVec3::from_array(radiance) * solid_angle));
                }
            }
        }
    }
    nodes
}

/// Radiance along the camera's view axis: what is scattered once, and what is emitted and not
/// scattered.
pub fn radiance(scene: &Scene, fineness: Fineness) -> [f64; 3] {
    let medium = Medium::new(scene);
    let origin = scene.camera.eye;
    let direction = (scene.camera.target - origin).normalize();
    let Some((enter, leave)) = medium.inside(origin, direction) else {
        return [0.0; 3];
    };
    let nodes = light_nodes(scene, fineness.patch);
    let length = (leave - enter) / fineness.view as f64;
    let at =
        |i: usize, fraction: f64| origin + direction * (enter + (i as f64 + fraction) * length);
    // Depth up to each step's middle, from quarter points.
    let mut depth = 0.0;
    let mut depths = Vec::new();
    for i in 0..fineness.view {
        let first = medium.material(at(i, 0.25)).sigma_t * 0.5 * length;
        depths.push(depth + first);
        depth += first + medium.material(at(i, 0.75)).sigma_t * 0.5 * length;
    }
    let sum: DVec3 = (0..fineness.view)
        .into_par_iter()
        .map(|i| {
            let place = at(i, 0.5);
            let material = medium.material(place);
            let collisions = material.sigma_t * length * (-depths[i]).exp();
            if collisions == 0.0 {
                return DVec3::ZERO;
            }
            let scattered: DVec3 = nodes
                .iter()
                .filter(|_| scene.integrator.max_scatters != Some(0))
                .map(|(wi, light)| {
                    let f = medium.scattering(place, &material, -direction, *wi);
                    *light * f * medium.transmittance(place, *wi, fineness.light)
                })
                .sum();
            let albedo = DVec3::from_array(material.albedo);
            collisions * (albedo * scattered + DVec3::from_array(material.emission))
        })
        .sum();
    sum.to_array()
}

/// Two materials with a smooth change between them.
pub fn two_tissues() -> Vec<holovol_volume::TransferPoint> {
    let mut points = vec![
        point(0.05, 0.0, 0.5),
        point(0.4, 5.0, 0.8),
        point(1.0, 2.0, 0.3),
    ];
    points[1].albedo = [0.9, 0.6, 0.3];
    points
}

#[test]
fn single_scattering_in_a_homogeneous_box_is_its_integral() {
    for g in [0.0, 0.5, -0.7] {
        let mut scene = homogeneous(2.0, 0.8);
        scene.phase_g = g;
        scene.environment = uneven_light();
        let expected = radiance(
            &scene,
            Fineness {
                patch: 2,
                ..Default::default()
            },
        );
        assert_mean("box", &film(&scene, 400), expected, 1e-3);
    }
}

#[test]
fn single_scattering_in_a_blob_is_its_integral_under_every_transform() {
    let turned = DMat4::from_euler(glam::EulerRot::XYZ, 0.4, -0.8, 1.9);
    let shear = DMat4::from_mat3(DMat3::from_cols(
        DVec3::new(1.0, 0.2, 0.0),
        DVec3::new(0.5, 0.9, -0.3),
        DVec3::new(0.0, 0.1, 1.2),
    ));
    let transforms = [
        ("anisotropic", DMat4::from_scale(DVec3::new(0.5, 2.0, 1.0))),
        ("turned", turned),
        ("sheared and turned", turned * shear),
        ("mirrored", DMat4::from_scale(DVec3::new(-1.0, 1.0, 0.8))),
    ];
    for (name, transform) in transforms {
        let mut scene = scene(volume([9, 7, 8], bump), two_tissues());
        scene.world_from_unit_cube = transform * scene.world_from_unit_cube;
        scene.environment = uneven_light();
        scene.phase_g = 0.4;
        scene.camera = beam(DVec3::new(0.9, 1.1, 3.0), DVec3::new(0.05, -0.02, 0.0));
        let expected = radiance(&scene, Fineness::default());
        assert_mean(name, &film(&scene, 300), expected, 3e-3);
    }
}

#[test]
fn gradient_surface_is_its_integral_under_shear() {
    let mut points = two_tissues();
    for (i, point) in points.iter_mut().enumerate() {
        point.specular = [0.0, 0.5, 0.9][i];
        point.roughness = [0.9, 0.8, 0.7][i];
    }
    let mut scene = scene(volume([9, 7, 8], bump), points);
    scene.world_from_unit_cube = DMat4::from_mat3(DMat3::from_cols(
        DVec3::new(1.0, 0.2, 0.0),
        DVec3::new(0.5, 0.9, -0.3),
        DVec3::new(0.0, 0.1, 1.5),
    )) * scene.world_from_unit_cube;
    scene.environment = uneven_light();
    scene.gradient_factor = 4.0;
    scene.phase_g = -0.3;
    scene.camera = beam(DVec3::new(1.4, 0.3, 2.6), DVec3::new(0.0, 0.1, 0.0));
    let expected = radiance(
        &scene,
        Fineness {
            patch: 2,
            view: 96,
            ..Default::default()
        },
    );
    assert_mean("surface", &film(&scene, 400), expected, 3e-3);
}

#[test]
fn emission_of_a_blob_is_its_integral() {
    let mut points = two_tissues();
    points[1].emission = [0.3, 2.0, 0.0];
    points[2].emission = [1.0, 0.1, 0.5];
    let mut scene = scene(volume([9, 7, 8], bump), points);
    scene.integrator.max_scatters = Some(0);
    scene.environment = uneven_light();
    let fine = Fineness {
        view: 4000,
        ..Default::default()
    };
    assert_mean("glow", &film(&scene, 400), radiance(&scene, fine), 1e-5);
}

#[test]
fn light_phase_and_both_agree_with_the_integral() {
    let mut points = two_tissues();
    points[2].specular = 0.6;
    let mut scene = scene(volume([9, 7, 8], bump), points);
    scene.environment = uneven_light();
    scene.gradient_factor = 1.5;
    scene.phase_g = 0.3;
    let expected = radiance(
        &scene,
        Fineness {
            patch: 2,
            view: 96,
            ..Default::default()
        },
    );
    for light_strategy in [
        LightStrategy::Both,
        LightStrategy::Environment,
        LightStrategy::Phase,
    ] {
        let settings = crate::Settings {
            light_strategy,
            ..settings(400)
        };
        let film = faulty_film(&scene, &settings, super::Fault::None);
        assert_mean(&format!("{light_strategy:?}"), &film, expected, 3e-3);
    }
}

#[test]
fn camera_inside_sees_what_lies_ahead() {
    let mut scene = scene(volume([9, 7, 8], bump), two_tissues());
    scene.environment = uneven_light();
    for eye in [
        DVec3::new(0.05, 0.0, 0.1),
        // On a face and on an edge.
        DVec3::new(0.1, 0.05, 0.5),
        DVec3::new(0.5, 0.0, 0.5),
    ] {
        scene.camera = beam(eye, DVec3::new(-0.1, 0.02, -0.2));
        let expected = radiance(&scene, Fineness::default());
        assert_mean("inside", &film(&scene, 400), expected, 3e-3);
    }
}

#[test]
fn a_sun_is_found_wherever_it_is_turned_to() {
    let (width, height) = (16, 8);
    let mut texels = vec![[0.3, 0.4, 0.5]; width * height];
    texels[2 * width + 11] = [1e9, 8e8, 6e8];
    let mut scene = scene(volume([9, 7, 8], bump), two_tissues());
    scene.environment.map = holovol_light::EnvironmentMap::new(width, height, texels);
    let fine = Fineness {
        patch: 2,
        ..Default::default()
    };
    for degrees in [0.0, 30.0, -140.0] {
        scene.environment.rotation_y = f64::to_radians(degrees);
        let film = film(&scene, 100);
        assert_mean("sun", &film, radiance(&scene, fine), 3e-3);
        // A table that looks elsewhere is unbiased too, but finds the sun by luck only.
        let [(mean, variance), ..] = mean_and_variance(&film);
        let noise = variance.sqrt() / mean;
        assert!(noise < 0.015, "{degrees}°: relative noise {noise}");
    }
}
