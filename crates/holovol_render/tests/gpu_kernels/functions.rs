//! Single functions of the kernels against their twins.

use glam::{IVec3, Vec3, Vec4};
use holovol_render::testing::majorants::{Majorants, cell_ranges};
use holovol_render::testing::twins::environment::Light;
use holovol_render::testing::twins::field::{Field, texels};
use holovol_render::testing::twins::phase_function::{phase_eval, phase_sample};
use holovol_render::testing::twins::random::{
    owen_scramble_reversed, pcg3d, sobol_pair, sobol_second_reversed, z_order,
};
use holovol_render::testing::twins::scattering::choose_light;
use holovol_render::testing::twins::surface::{Surface, scatter_eval, scatter_pdf, scatter_sample};
use holovol_render::testing::twins::transfer_function::Transfer;
use holovol_render::testing::twins::walk::{Event, Walk};
use holovol_render::testing::{Contract, Lane};
use holovol_render::{Gpu, TraceOptions};
use holovol_scene::Scene;
use holovol_volume::Voxels;

use super::scenes::{self, direction, numbers};

pub const LANES: u32 = 4096;
/// A few roundings of f32, and of functions that drivers may compute to 2 or 3 ulp.
const FEW_ULPS: f32 = 2e-6;
/// Sines and cosines, of which Vulkan asks 2^-11 and drivers give 2^-20 or better.
const TRIGONOMETRY: f32 = 4e-6;

/// Calls a function of the kernels for each input.
pub fn call(
    gpu: &Gpu,
    scene: &Scene,
    options: &TraceOptions,
    entry: &str,
    inputs: &[Lane],
) -> Result<Vec<Lane>, String> {
    Contract::new(gpu, scene, options, LANES)
        .and_then(|mut contract| contract.call(entry, inputs))
        .map_err(|error| error.to_string())
}

pub fn lanes(lane: impl Fn(u32) -> Lane) -> Vec<Lane> {
    (0..LANES).map(lane).collect()
}

pub fn vec4(v: Vec3, w: f32) -> [f32; 4] {
    v.extend(w).to_array()
}

pub fn xyz(v: [f32; 4]) -> Vec3 {
    Vec4::from(v).truncate()
}

/// Fails unless two numbers differ by at most `relative` of the larger, or by `absolute`.
fn close(
    what: &str,
    i: usize,
    gpu: f32,
    twin: f32,
    relative: f32,
    absolute: f32,
) -> Result<(), String> {
    let error = (gpu - twin).abs();
    if error <= absolute + relative * gpu.abs().max(twin.abs()) {
        Ok(())
    } else {
        Err(format!(
            "{what}, input {i}: {gpu} on the GPU, {twin} of the twin"
        ))
    }
}

fn close3(what: &str, i: usize, gpu: Vec3, twin: Vec3, tolerance: f32) -> Result<(), String> {
    let scale = twin.length().max(1e-30);
    if gpu.distance(twin) <= tolerance * scale {
        Ok(())
    } else {
        Err(format!(
            "{what}, input {i}: {gpu} on the GPU, {twin} of the twin"
        ))
    }
}

pub fn random_numbers(gpu: &Gpu) -> Result<(), String> {
    let key = |i: u32| match i {
        0 => [0, 0, 0],
        1 => [u32::MAX; 3],
        _ => pcg3d([i, i * i, !i]),
    };
    let inputs = lanes(|i| {
        let [x, y, z] = key(i).map(f32::from_bits);
        [[x, y, z, 0.0], [0.0; 4], [0.0; 4], [0.0; 4]]
    });
    let outputs = call(
        gpu,
        &scenes::scene(),
        &TraceOptions::default(),
        "random",
        &inputs,
    )?;
    for (i, out) in (0..).zip(&outputs) {
        let [x, y, z] = key(i);
        let words = out.map(|vector| vector.map(f32::to_bits));
        let [sx, sy] = sobol_pair(x, y).map(f32::to_bits);
        let hashed = pcg3d([x, y, z]);
        let expected = [
            [hashed[0], hashed[1], hashed[2], 0],
            [sx, sy, 0, 0],
            [
                owen_scramble_reversed(x, y),
                sobol_second_reversed(x),
                z_order([x, y]),
                0,
            ],
        ];
        if words[..3] != expected {
            return Err(format!(
                "key {:x?}: {:x?} not {expected:x?}",
                key(i),
                &words[..3]
            ));
        }
    }
    Ok(())
}

pub const ASYMMETRIES: [f32; 8] = [0.0, 0.2, -0.2, 0.6, 0.9, -0.9, 0.999, -0.999];

pub fn phase_function(gpu: &Gpu) -> Result<(), String> {
    let g = |i: u32| ASYMMETRIES[i as usize % ASYMMETRIES.len()];
    let inputs = lanes(|i| {
        let [x, y, _] = numbers(i, 12);
        let wi = direction(i, 11);
        [
            vec4(direction(i, 10), g(i)),
            [x, y, 0.0, 0.0],
            vec4(wi, 0.0),
            [0.0; 4],
        ]
    });
    let outputs = call(
        gpu,
        &scenes::scene(),
        &TraceOptions::default(),
        "phase",
        &inputs,
    )?;
    for (i, (input, out)) in inputs.iter().zip(&outputs).enumerate() {
        let (g, wo) = (input[0][3], xyz(input[0]));
        let drawn = phase_sample(g, wo, [input[1][0], input[1][1]]);
        close3("drawn direction", i, xyz(out[0]), drawn, TRIGONOMETRY)?;
        let twin = phase_eval(g, wo, xyz(out[0]));
        close("density of it", i, out[0][3], twin, FEW_ULPS, 0.0)?;
        let twin = phase_eval(g, wo, xyz(input[2]));
        close("density", i, out[1][0], twin, FEW_ULPS, 0.0)?;
    }
    Ok(())
}

/// Surfaces and directions, some of them extreme.
fn surface_input(i: u32) -> (Surface, Vec3, f32) {
    let pick = |values: &[f32], stream| {
        values[(numbers(i, stream)[0] * values.len() as f32) as usize % values.len()]
    };
    let normal = direction(i, 20);
    let wo = direction(i, 21);
    let surface = Surface {
        normal: if normal.dot(wo) < 0.0 {
            -normal
        } else {
            normal
        },
        probability: pick(&[0.0, 0.2, 0.9, 1.0], 22),
        specular: pick(&[0.0, 0.04, 0.5, 1.0], 23),
        alpha: pick(&[1e-3, 0.01, 0.2, 1.0], 24),
    };
    (surface, wo, pick(&[0.0, 0.5, -0.8], 25))
}

pub fn surface(gpu: &Gpu) -> Result<(), String> {
    let inputs = lanes(|i| {
        let (surface, wo, g) = surface_input(i);
        let wi = direction(i, 26);
        [
            vec4(surface.normal, surface.probability),
            vec4(wo, g),
            vec4(Vec3::from(numbers(i, 27)), surface.specular),
            vec4(wi, surface.alpha),
        ]
    });
    let outputs = call(
        gpu,
        &scenes::scene(),
        &TraceOptions::default(),
        "surface",
        &inputs,
    )?;
    for (i, (input, out)) in inputs.iter().zip(&outputs).enumerate() {
        let (surface, wo, g) = surface_input(i as u32);
        let [x, y, z, _] = input[2];
        let drawn = scatter_sample(g, &surface, wo, [x, y, z]);
        close3("drawn direction", i, xyz(out[0]), drawn, 4.0 * TRIGONOMETRY)?;
        // The lobe of a smooth surface is so narrow that rounding its half vector counts.
        let tolerance = FEW_ULPS.max(4e-6 / surface.alpha);
        let check = |what, gpu, twin| close(what, i, gpu, twin, tolerance, 1e-30);
        let (wi, given) = (xyz(out[0]), xyz(input[3]));
        check(
            "f of the draw",
            out[0][3],
            scatter_eval(g, &surface, wo, wi),
        )?;
        check(
            "density of the draw",
            out[1][0],
            scatter_pdf(g, &surface, wo, wi),
        )?;
        check("f", out[1][1], scatter_eval(g, &surface, wo, given))?;
        check("density", out[1][2], scatter_pdf(g, &surface, wo, given))?;
    }
    Ok(())
}

pub fn light_inputs(stream: u32) -> Vec<Lane> {
    lanes(|i| {
        let bits = f32::from_bits(pcg3d([i, stream, 31])[0]);
        let wi = direction(i, 33);
        [
            vec4(Vec3::from(numbers(i, 32)), bits),
            vec4(wi, numbers(i, 34)[0]),
            [0.0; 4],
            [0.0; 4],
        ]
    })
}

pub fn environment(gpu: &Gpu) -> Result<(), String> {
    for (case, environment) in (0..).zip(scenes::environments()) {
        let light = Light::new(&environment).expect("a map with light");
        let scene = Scene {
            environment,
            ..scenes::scene()
        };
        let inputs = light_inputs(case);
        let outputs = call(gpu, &scene, &TraceOptions::default(), "light", &inputs)?;
        // Beside a sun, rounding the direction moves along a steep slope.
        let brightest = outputs.iter().map(|out| out[0][3]).fold(0.0, f32::max);
        let slack = 1e-5 * brightest;
        let mut strays = Vec::new();
        for (i, (input, out)) in inputs.iter().zip(&outputs).enumerate() {
            let [x, y, z, bits] = input[0];
            let drawn = light.sample(bits.to_bits(), input[1][3], [x, y, z]);
            close3(
                "drawn direction",
                i,
                xyz(out[0]),
                drawn.wi,
                5.0 * TRIGONOMETRY,
            )?;
            close("its density", i, out[0][3], drawn.pdf, 1e-3, 0.0)?;
            // The density steps from strip to strip: a direction on a border may round across.
            let again = close("evaluated", i, out[1][3], drawn.pdf, 1e-3, slack);
            strays.extend(again.err());
            close3("its radiance", i, xyz(out[1]), drawn.radiance, 1e-3)?;
            let given = light.eval(xyz(input[1]));
            let radiance_slack = slack * drawn.radiance.length() / drawn.pdf;
            let error = xyz(out[2]).distance(given.radiance);
            if error > 1e-3 * given.radiance.length() + radiance_slack {
                let twin = given.radiance;
                return Err(format!("radiance, input {i}: {} not {twin}", xyz(out[2])));
            }
            close("density", i, out[2][3], given.pdf, 1e-3, slack)?;
        }
        if strays.len() > outputs.len() / 1000 {
            return Err(format!(
                "map {case}: {} draws, such as {}",
                strays.len(),
                strays[0]
            ));
        }
    }
    Ok(())
}

pub fn light_choice(gpu: &Gpu) -> Result<(), String> {
    let scene = scenes::scene();
    let light = Light::new(&scene.environment).expect("a map with light");
    let inputs = lanes(|i| {
        let (surface, wo, g) = surface_input(i);
        let [x, y, _] = numbers(i, 41);
        let alpha = surface.alpha.max(0.2);
        let [a, b, c] = pcg3d([i, 1, 2]).map(f32::from_bits);
        [
            vec4(surface.normal, surface.probability),
            vec4(wo, g),
            [x, y, surface.specular, alpha],
            [a, b, c, 0.0],
        ]
    });
    for candidates in [[1, 0], [0, 1], [1, 1], [3, 2]] {
        let options = TraceOptions {
            light_candidates: Some(candidates),
            ..Default::default()
        };
        let outputs = call(gpu, &scene, &options, "choice", &inputs)?;
        let mut other = 0;
        for (i, (input, out)) in inputs.iter().zip(&outputs).enumerate() {
            let (mut surface, wo, g) = surface_input(i as u32);
            surface.alpha = input[2][3];
            let key = [input[3][0], input[3][1], input[3][2]].map(f32::to_bits);
            let first = [input[2][0], input[2][1]];
            let (wi, weight) = choose_light(&light, candidates, (g, &surface, wo), first, key);
            // A draw within rounding of a decision may fall to the other side.
            if xyz(out[0]).distance(wi) > 1e-3 {
                other += 1;
                continue;
            }
            close3("weight", i, xyz(out[1]), weight, 5e-3)?;
        }
        if other > outputs.len() / 500 {
            return Err(format!("{candidates:?}: {other} of {LANES} choices differ"));
        }
    }
    Ok(())
}

pub fn transfer_function(gpu: &Gpu) -> Result<(), String> {
    for count in [1, 2, 6, 16, 17, 1000] {
        let function = scenes::random_transfer_function(count, 50);
        let twin = Transfer::new(&function);
        let scene = Scene {
            transfer_function: function.clone(),
            ..scenes::scene()
        };
        // Anywhere, and exactly at points, where of several the last holds.
        let s_at = |i: u32| match i % 2 {
            0 => 3.0 * numbers(i, 51)[0] - 1.0,
            _ => function.points()[(i / 2 % count) as usize].s as f32,
        };
        let inputs = lanes(|i| [[s_at(i), 0.0, 0.0, 0.0], [0.0; 4], [0.0; 4], [0.0; 4]]);
        let outputs = call(gpu, &scene, &TraceOptions::default(), "transfer", &inputs)?;
        for (i, (input, out)) in inputs.iter().zip(&outputs).enumerate() {
            let s = input[0][0];
            let check = |what, gpu, twin| close(what, i, gpu, twin, 8e-6, 1e-4);
            let exact = function.eval(f64::from(s));
            let material = twin.material(s);
            check("sigma_t of the twin", twin.sigma_t(s), exact.sigma_t as f32)?;
            check("sigma_t", out[0][0], exact.sigma_t as f32)?;
            check("roughness", out[1][3], exact.roughness as f32)?;
            check("specular", out[2][3], exact.specular as f32)?;
            check(
                "roughness of the twin",
                material.roughness,
                exact.roughness as f32,
            )?;
            check(
                "specular of the twin",
                material.specular,
                exact.specular as f32,
            )?;
            for c in 0..3 {
                check(
                    "emission by itself",
                    out[0][1 + c],
                    exact.emission[c] as f32,
                )?;
                check("albedo", out[1][c], exact.albedo[c] as f32)?;
                check("emission", out[2][c], exact.emission[c] as f32)?;
                check(
                    "albedo of the twin",
                    material.albedo[c],
                    exact.albedo[c] as f32,
                )?;
                check(
                    "emission of the twin",
                    material.emission[c],
                    exact.emission[c] as f32,
                )?;
            }
        }
    }
    Ok(())
}

/// The same field in every type of voxel.
fn voxel_types(dims: [u32; 3]) -> Vec<Voxels> {
    let count = dims.iter().product();
    let number = |i| numbers(i, 61)[0];
    vec![
        Voxels::U8((0..count).map(|i| (255.0 * number(i)) as u8).collect()),
        Voxels::I8(
            (0..count)
                .map(|i| (255.0 * number(i) - 128.0) as i8)
                .collect(),
        ),
        Voxels::U16((0..count).map(|i| (65535.0 * number(i)) as u16).collect()),
        Voxels::I16(
            (0..count)
                .map(|i| (65535.0 * number(i) - 32768.0) as i16)
                .collect(),
        ),
        Voxels::F32((0..count).map(|i| 2000.0 * number(i) - 1000.0).collect()),
    ]
}

pub fn field(gpu: &Gpu) -> Result<(), String> {
    for dims in [[21, 9, 14], [1, 1, 5], [1, 1, 1]] {
        for voxels in voxel_types(dims) {
            let volume = scenes::volume(voxels, dims);
            let [low, high] = volume.range();
            // Reversed, and not the whole range.
            let window = [high + 1.0, low + 0.1 * (high - low)];
            let scene = Scene {
                volume,
                window,
                ..scenes::scene()
            };
            let inputs = lanes(|i| {
                // Around the volume too: the border is clamped.
                let extent = Vec3::from(dims.map(|n| n as f32));
                let texel = (Vec3::from(numbers(i, 60)) * 1.4 - 0.2) * extent;
                let texel = if i % 4 == 0 {
                    texel.floor() + 0.5
                } else {
                    texel
                };
                [vec4(texel, 0.0), [0.0; 4], [0.0; 4], [0.0; 4]]
            });
            let mut contract = Contract::new(gpu, &scene, &TraceOptions::default(), LANES)
                .map_err(|error| error.to_string())?;
            let format = contract.tracer().volume().format();
            let twin = Field::new(&scene, format);
            let outputs = contract
                .call("field", &inputs)
                .map_err(|error| error.to_string())?;
            for (i, (input, out)) in inputs.iter().zip(&outputs).enumerate() {
                let texel = xyz(input[0]);
                close("s", i, out[0][3], twin.at(texel), 1e-6, 4e-6)?;
                let unit_cube = texel / Vec3::from(dims.map(|n| n as f32));
                let value = scene.volume.sample(unit_cube.as_dvec3());
                let exact = scene.s_from_value(value) as f32;
                close("s of the volume", i, out[0][3], exact, 1e-5, 1e-5)?;
                let gradient = twin.gradient(texel);
                let error = xyz(out[0]).distance(gradient);
                if error > 1e-5 * gradient.length() + 2e-2 {
                    return Err(format!(
                        "gradient, input {i}: {} not {gradient}",
                        xyz(out[0])
                    ));
                }
            }
        }
    }
    Ok(())
}

pub fn walks(gpu: &Gpu) -> Result<(), String> {
    let scene = scenes::scene();
    let dims = scene.volume.dims();
    let inputs = lanes(|i| {
        let centre = 0.5 * Vec3::from(dims.map(|n| n as f32));
        let mut direction = direction(i, 71) * (10.0 + 500.0 * numbers(i, 72)[0]);
        if i % 5 == 0 {
            // Parallel to two of the axes.
            direction *= Vec3::AXES[i as usize / 5 % 3];
        }
        let target = centre + 12.0 * (Vec3::from(numbers(i, 73)) - 0.5);
        let origin = target - 0.1 * numbers(i, 74)[0] * direction;
        let tau = -(1.0 - numbers(i, 75)[0]).ln() * 6.0;
        [vec4(origin, tau), vec4(direction, 0.0), [0.0; 4], [0.0; 4]]
    });
    let mut contract = Contract::new(gpu, &scene, &TraceOptions::default(), LANES)
        .map_err(|error| error.to_string())?;
    let (texels, _, _) = texels(&scene.volume, contract.tracer().volume().format());
    let [low, high] = scene.window;
    let s_from_texel = [low as f32, (1.0 / (high - low)) as f32];
    let ranges = cell_ranges(&texels, dims, 8);
    let grid = Majorants::new(&ranges, dims, 8, &scene.transfer_function, s_from_texel);
    let outputs = contract
        .call("walk", &inputs)
        .map_err(|error| error.to_string())?;
    let (mut events, mut other) = ([0; 4], 0);
    for (i, (input, out)) in inputs.iter().zip(&outputs).enumerate() {
        let mut walk = Walk::start(&grid, xyz(input[0]), xyz(input[1]), 0.0, input[0][3]);
        let event = if walk.misses() {
            3
        } else {
            walk.advance(100_000) as usize
        };
        events[event] += 1;
        if event as f32 != out[0][0] {
            // A ray along a border, or one that ends just there.
            other += 1;
            continue;
        }
        if event == Event::Collision as usize {
            close("distance", i, out[0][1], walk.distance(), 1e-4, 1e-6)?;
            let cell = xyz(out[1]).as_ivec3();
            if (cell - walk.cell).abs().max_element() > 0 {
                other += 1;
            }
        }
        if event < 3 {
            close("end", i, out[0][3], walk.t_end, 1e-5, 1e-7)?;
        }
    }
    if other > 4 || events[1] < 500 || events[2] < 500 || events[3] < 50 {
        return Err(format!(
            "{other} of {LANES} walks end otherwise; twins' events {events:?}"
        ));
    }
    if grid.occupied == [IVec3::MAX, IVec3::ZERO] {
        return Err("nothing to walk through".into());
    }
    Ok(())
}
