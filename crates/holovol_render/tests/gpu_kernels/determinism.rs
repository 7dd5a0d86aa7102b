//! The same seed gives the same bits, however the work is cut.

use holovol_render::{Counters, Gpu, TraceOptions, Tracer};
use holovol_scene::Scene;

use super::scenes;

fn render(
    gpu: &Gpu,
    scene: &Scene,
    options: &TraceOptions,
    batches: &[u32],
) -> Result<(Vec<[u32; 4]>, Counters), String> {
    let mut tracer = Tracer::new(gpu, scene, options).map_err(|error| error.to_string())?;
    for &samples in batches {
        tracer
            .accumulate(samples)
            .map_err(|error| error.to_string())?;
    }
    let image = tracer.read_image().map_err(|error| error.to_string())?;
    let bits = image.iter().map(|pixel| pixel.map(f32::to_bits));
    Ok((bits.collect(), tracer.counters()))
}

pub fn same_bits(gpu: &Gpu) -> Result<(), String> {
    let mut scene = scenes::scene();
    scene.camera.width = 41;
    scene.camera.height = 67;
    let options = TraceOptions {
        seed: 5,
        ..Default::default()
    };
    let (whole, counters) = render(gpu, &scene, &options, &[7])?;
    if counters.majorant_violations != 0 || counters.nonfinite_samples != 0 {
        return Err(format!("{counters:?}"));
    }
    if whole.iter().all(|pixel| *pixel == whole[0]) {
        return Err("the image is empty".into());
    }
    if render(gpu, &scene, &options, &[3, 4])?.0 != whole {
        return Err("7 samples are not 3 and 4".into());
    }
    if render(gpu, &scene, &options, &[1; 7])?.0 != whole {
        return Err("7 samples are not 7 times one: tiles differ".into());
    }
    let (hurried, counters) = render(
        gpu,
        &scene,
        &TraceOptions {
            budget: 9,
            ..options.clone()
        },
        &[7],
    )?;
    if counters.continued_paths == 0 {
        return Err("a budget of 9 rounds cuts no path".into());
    }
    if hurried != whole {
        let differ = hurried.iter().zip(&whole).filter(|(a, b)| a != b).count();
        return Err(format!("{differ} pixels change with the budget"));
    }
    if render(
        gpu,
        &scene,
        &TraceOptions {
            subgroups: false,
            ..options.clone()
        },
        &[7],
    )?
    .0 != whole
    {
        return Err("waiting for other lanes changes the image".into());
    }
    if render(gpu, &scene, &TraceOptions { seed: 6, ..options }, &[7])?.0 == whole {
        return Err("another seed gives the same image".into());
    }
    Ok(())
}
