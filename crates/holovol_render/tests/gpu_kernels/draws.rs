//! Directions that the GPU draws, against the densities that the twins evaluate.

use glam::{Vec3, vec3};
use holovol_render::testing::Contract;
use holovol_render::testing::sphere::SphereCells;
use holovol_render::testing::twins::environment::Light;
use holovol_render::testing::twins::phase_function::phase_eval;
use holovol_render::testing::twins::surface::{Surface, scatter_pdf};
use holovol_render::{Gpu, TraceOptions};
use holovol_scene::Scene;

use super::functions::{ASYMMETRIES, LANES, call, lanes, light_inputs, vec4, xyz};
use super::scenes::{self, numbers};

pub fn phase_function(gpu: &Gpu) -> Result<(), String> {
    let wo = vec3(0.3, -0.5, 0.8).normalize();
    for g in ASYMMETRIES {
        let inputs = lanes(|i| {
            let [x, y, _] = numbers(i, 80);
            [vec4(wo, g), [x, y, 0.0, 0.0], [0.0; 4], [0.0; 4]]
        });
        let outputs = call(
            gpu,
            &scenes::scene(),
            &TraceOptions::default(),
            "phase",
            &inputs,
        )?;
        let draws: Vec<_> = outputs.iter().map(|out| xyz(out[0])).collect();
        let peak = if g < 0.0 { wo } else { -wo };
        SphereCells::around(peak)
            .check(&draws, |wi| f64::from(phase_eval(g, wo, wi)), 2e-3)
            .map_err(|error| format!("g = {g}: {error}"))?;
        let cosine = |wi: &Vec3| f64::from((-wo).dot(*wi));
        let mean = draws.iter().map(cosine).sum::<f64>() / draws.len() as f64;
        // No distribution on [-1, 1] of mean g spreads more than this.
        let spread = ((1.0 - f64::from(g * g)) / draws.len() as f64).sqrt();
        if (mean - f64::from(g)).abs() > 6.0 * spread {
            return Err(format!("g = {g}: mean cosine {mean}"));
        }
    }
    Ok(())
}

pub fn surface(gpu: &Gpu) -> Result<(), String> {
    let normal = vec3(0.2, 0.9, -0.4).normalize();
    let side = normal.any_orthonormal_vector();
    let mut contract = Contract::new(gpu, &scenes::scene(), &TraceOptions::default(), LANES)
        .map_err(|error| error.to_string())?;
    for (alpha, n_o) in [
        (1e-3, 0.7),
        (1e-3, 0.05),
        (0.1, 0.3),
        (1.0, 0.7),
        (1.0, 1e-3),
    ] {
        for (probability, specular) in [(0.5, 0.04), (1.0, 0.6), (1.0, 0.0)] {
            let surface = Surface {
                normal,
                probability,
                specular,
                alpha,
            };
            let wo = (n_o * normal + (1.0 - n_o * n_o).sqrt() * side).normalize();
            let inputs = lanes(|i| {
                [
                    vec4(normal, probability),
                    vec4(wo, 0.3),
                    vec4(Vec3::from(numbers(i, 90)), specular),
                    vec4(wo, alpha),
                ]
            });
            let outputs = contract
                .call("surface", &inputs)
                .map_err(|error| error.to_string())?;
            let draws: Vec<_> = outputs.iter().map(|out| xyz(out[0])).collect();
            SphereCells::around(2.0 * normal.dot(wo) * normal - wo)
                .check(
                    &draws,
                    |wi| f64::from(scatter_pdf(0.3, &surface, wo, wi)),
                    0.01,
                )
                .map_err(|error| format!("{surface:?}, {wo}: {error}"))?;
        }
    }
    Ok(())
}

pub fn environment(gpu: &Gpu) -> Result<(), String> {
    for environment in scenes::environments() {
        // Cells lie in the map's own frame.
        let environment = holovol_scene::Environment {
            rotation_y: 0.0,
            ..environment
        };
        let light = Light::new(&environment).expect("a map with light");
        let (width, height) = (environment.map.width(), environment.map.height());
        let scene = Scene {
            environment,
            ..scenes::scene()
        };
        let outputs = call(
            gpu,
            &scene,
            &TraceOptions::default(),
            "light",
            &light_inputs(91),
        )?;
        let draws: Vec<_> = outputs.iter().map(|out| xyz(out[0])).collect();
        SphereCells::of_map(width, height)
            .check(&draws, |wi| f64::from(light.eval(wi).pdf), 0.01)
            .map_err(|error| format!("{width} × {height}: {error}"))?;
    }
    Ok(())
}
