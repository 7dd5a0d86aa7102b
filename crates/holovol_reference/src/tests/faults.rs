//! Each of the classical mistakes is noticed by the comparison that should notice it.

use glam::{DMat3, DMat4, DVec3};
use holovol_scene::Scene;

use super::Fault;
use super::quadrature::{Fineness, radiance, two_tissues};
use super::scenes::*;
use crate::{LightStrategy, Settings};

fn p_with(scene: &Scene, light_strategy: LightStrategy, spp: u32, fault: Fault) -> f64 {
    let expected = radiance(
        scene,
        Fineness {
            patch: 2,
            ..Default::default()
        },
    );
    let settings = Settings {
        light_strategy,
        ..settings(spp)
    };
    p_of_mean(&faulty_film(scene, &settings, fault), expected, 3e-3)
}

fn assert_noticed(scene: &Scene, light_strategy: LightStrategy, spp: u32, fault: Fault) {
    let right = p_with(scene, light_strategy, spp, Fault::None);
    assert!(right >= 1e-6, "without a fault: p = {right:e}");
    let wrong = p_with(scene, light_strategy, spp, fault);
    assert!(wrong < 1e-6, "{fault:?} goes unnoticed: p = {wrong:e}");
}

fn blob() -> Scene {
    let mut scene = scene(volume([9, 7, 8], bump), two_tissues());
    scene.environment = uneven_light();
    scene.phase_g = 0.5;
    scene
}

#[test]
fn five_percent_of_the_environment_density_is_noticed() {
    assert_noticed(
        &blob(),
        LightStrategy::Environment,
        600,
        Fault::EnvironmentPdf,
    );
}

#[test]
fn five_percent_of_the_sine_is_noticed() {
    assert_noticed(&blob(), LightStrategy::Environment, 600, Fault::SinTheta);
}

#[test]
fn wrong_sign_of_g_is_noticed() {
    assert_noticed(&blob(), LightStrategy::Both, 300, Fault::SignOfG);
}

fn glossy() -> Scene {
    let mut points = two_tissues();
    for point in &mut points {
        point.specular = 0.95;
        point.roughness = 0.8;
    }
    let mut scene = blob();
    scene.transfer_function = transfer_function(points);
    scene.gradient_factor = 40.0;
    scene
}

#[test]
fn five_percent_of_the_mirror_jacobian_is_noticed() {
    assert_noticed(
        &glossy(),
        LightStrategy::Phase,
        1000,
        Fault::HalfVectorJacobian,
    );
}

#[test]
fn gradient_turned_like_a_direction_is_noticed() {
    let mut scene = glossy();
    scene.world_from_unit_cube = DMat4::from_mat3(DMat3::from_cols(
        DVec3::new(1.0, 0.2, 0.0),
        DVec3::new(0.5, 0.6, -0.3),
        DVec3::new(0.0, 0.1, 1.8),
    )) * scene.world_from_unit_cube;
    assert_noticed(&scene, LightStrategy::Both, 300, Fault::NormalTransform);
}
