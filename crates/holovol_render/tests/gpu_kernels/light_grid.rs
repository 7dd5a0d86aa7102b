//! The light grid: what the tracer adds to it, what settles, and what guides make of it.

use glam::{DVec3, Mat3, UVec3, Vec3};
use holovol_render::testing::light_grid;
use holovol_render::{Denoiser, Gpu};
use holovol_scene::{Camera, Scene};
use holovol_volume::{TransferFunction, Voxels};

use super::denoise::{Rig, text};
use super::denoise_march::{Line, linear_scene, sigma_t_at};
use super::scenes::{self, numbers};

fn is_near(found: [f32; 2], expected: [f32; 2]) -> Result<(), String> {
    let off = [0, 1].map(|k| (found[k] - expected[k]).abs() / expected[k].max(1.0));
    if off.iter().all(|&off| off < 1e-5) {
        return Ok(());
    }
    Err(format!("{found:?}, not {expected:?}"))
}

/// Cells of all kinds, after nothing, a little and everything has changed.
pub fn settles_like_the_twin(gpu: &Gpu) -> Result<(), String> {
    const SIZE: [u32; 3] = [13, 7, 11];
    let cells = SIZE.iter().product();
    for (case, kept_frames) in (0..).zip([f32::INFINITY, 20.0, 0.21, 0.0]) {
        let cell = |i| {
            let [light, picks, kind] = numbers(i, case);
            let picks = match kind {
                ..0.2 => 0.0,
                ..0.6 => (9.0 * picks).floor(),
                _ => 1024.0 * picks,
            };
            [20.0 * light, picks]
        };
        let grid: Vec<[f32; 2]> = (0..cells).map(cell).collect();
        let frame = |i| {
            let [light, count, kind] = numbers(i, 100 + case);
            let count = match kind {
                ..0.3 => 0,
                ..0.9 => (12.0 * count) as u32,
                // More than a cell takes.
                _ => (200_000.0 * count) as u32,
            };
            [
                count,
                (128.0 * 10.0 * light * count.min(65536) as f32) as u32,
            ]
        };
        let fresh: Vec<[u32; 2]> = (0..cells).map(frame).collect();
        let [settled, smoothed] =
            light_grid::settle_on_device(gpu, SIZE, &grid, &fresh, kept_frames).map_err(text)?;
        for (i, found) in (0..).zip(smoothed) {
            let settle = light_grid::settle(grid[i], fresh[i], kept_frames);
            is_near(settled[i], settle)
                .map_err(|e| format!("{:?} and {:?}: {e}", grid[i], fresh[i]))?;
            let [x, y, _] = SIZE.map(|n| n as usize);
            let cell = UVec3::new((i % x) as u32, (i / x % y) as u32, (i / x / y) as u32);
            let smooth = light_grid::smooth(&settled, UVec3::from_array(SIZE), cell);
            is_near(found, smooth).map_err(|e| format!("smoothed {cell}: {e}"))?;
        }
    }
    Ok(())
}

/// A box that is everywhere as dense, under a sky with a bright side.
fn haze(dims: [u32; 3], sigma_t: f64, phase_g: f64) -> Result<Scene, String> {
    let count = dims.iter().product::<u32>() as usize;
    Ok(Scene {
        volume: scenes::volume(Voxels::U8(vec![7; count]), dims),
        window: [0.0, 255.0],
        transfer_function: TransferFunction::new(vec![scenes::point(0.5, sigma_t)])
            .map_err(text)?,
        phase_g,
        gradient_factor: 0.0,
        environment: scenes::environment(16, 8, |i, j| {
            1.0 + (0.4 * i as f32).cos() + 0.3 * j as f32
        }),
        camera: Camera {
            width: 96,
            height: 96,
            fov_y: 0.25,
            ..scenes::scene().camera
        },
        ..scenes::scene()
    })
}

/// Directions spread evenly over the sphere.
fn sphere(count: u32) -> impl Iterator<Item = DVec3> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    (0..count).map(move |i| {
        let z = 1.0 - 2.0 * (f64::from(i) + 0.5) / f64::from(count);
        let radius = (1.0 - z * z).sqrt();
        let (sin, cos) = (golden * f64::from(i)).sin_cos();
        DVec3::new(radius * cos, z, radius * sin)
    })
}

fn radiance(scene: &Scene, direction: DVec3) -> DVec3 {
    let back = glam::DMat3::from_rotation_y(-scene.environment.rotation_y);
    DVec3::from_array(scene.environment.map.radiance(back * direction))
}

/// What is scattered once toward the eye at a place of the unit cube, per albedo and mean radiance.
fn scattered(scene: &Scene, place: DVec3, sigma_t: f64) -> f64 {
    const COUNT: u32 = 400;
    let world = scene.world_from_unit_cube.transform_point3(place);
    let wo = (scene.camera.eye - world).normalize();
    let g = scene.phase_g;
    let [mut sum, mut all] = [DVec3::ZERO; 2];
    for wi in sphere(COUNT) {
        let line = Line::new(scene, place, wi);
        // 4 pi of a phase function that scatters forward where g > 0.
        let cos = -wi.dot(wo);
        let phase = (1.0 - g * g) / (1.0 + g * g - 2.0 * g * cos).powf(1.5);
        let light = radiance(scene, wi);
        sum += phase * light * (-sigma_t * line.leaves).exp();
        all += light;
    }
    let albedo = DVec3::from_array(scene.transfer_function.points()[0].albedo);
    (albedo * sum).element_sum() / albedo.element_sum() / (all.element_sum() / 3.0)
}

/// Which half along x, y, z.
fn octant(scene: &Scene, place: DVec3) -> usize {
    let dims = scene.volume.dims();
    // A volume of one cell has no halves.
    let half = |axis: usize| usize::from(dims[axis] > 1 && place[axis] > 0.5) << axis;
    half(0) + half(1) + half(2)
}

/// Of the places that the camera sees, in the mean over each octant.
fn seen_light(scene: &Scene, sigma_t: f64) -> [f64; 8] {
    let mut sums = [[0.0; 2]; 8];
    let pixels = (0..96 * 96).step_by(9).map(|i| (i % 96, i / 96));
    for (x, y) in pixels {
        let line = Line::of_pixel(scene, x, y);
        let (depths, step) = line.steps(sigma_t as u32);
        for depth in depths {
            let place = line.at(depth);
            if step == 0.0 {
                continue;
            }
            let seen = (-sigma_t * line.metres * (depth - line.enters)).exp() * step * line.metres;
            let [sum, all] = &mut sums[octant(scene, place)];
            *sum += seen * scattered(scene, place, sigma_t);
            *all += seen;
        }
    }
    sums.map(|[sum, all]| sum / all)
}

/// What cells know of light, against quadrature over all directions and depths: by octants.
pub fn cells_know_the_light(gpu: &Gpu) -> Result<(), String> {
    // A volume of one cell takes more picks than it counts: those of the first rows.
    for (dims, sigma_t, samples, within) in [
        ([24, 12, 18], 15.0, 2, 0.02),
        ([48, 24, 36], 60.0, 2, 0.02),
        ([1, 1, 1], 15.0, 32, 0.08),
    ] {
        let scene = haze(dims, sigma_t, 0.4)?;
        let mut rig = Rig::of(gpu, &scene)?;
        // What is scattered again isn't a place's own light.
        rig.medium.max_scatters = Some(3);
        let mut denoiser = rig.denoiser_of(Default::default())?;
        for _ in 0..12 {
            rig.trace(&[scene.camera], samples)?;
            rig.denoise(&mut denoiser, &[0])?;
        }
        let grid = denoiser.read_light(false).map_err(text)?;
        let (per, size) = light_grid::cells(dims);
        if per != 1 || grid.len() != size.element_product() as usize {
            return Err(format!("{} cells of {per} texels for {dims:?}", grid.len()));
        }
        let mut octants = [[0.0; 2]; 8];
        for (i, [light, picks]) in (0..).zip(grid) {
            let cell = [i % dims[0], i / dims[0] % dims[1], i / dims[0] / dims[1]];
            let middle = |axis: usize| (f64::from(cell[axis]) + 0.5) / f64::from(dims[axis]);
            let place = DVec3::from_array([0, 1, 2].map(middle));
            let [sum, all] = &mut octants[octant(&scene, place)];
            if dims != [1; 3] && picks > 900.0 {
                return Err(format!(
                    "a cell has {picks} picks: its mean would count too little"
                ));
            }
            *sum += f64::from(picks * light);
            *all += f64::from(picks);
        }
        let expected = seen_light(&scene, sigma_t);
        let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
        for ([sum, picks], expected) in octants.into_iter().zip(expected) {
            if picks < if dims == [1; 3] { 1.0 } else { 1e4 } {
                continue;
            }
            let found = sum / picks;
            eprintln!("{dims:?}, {sigma_t}/m: {found:.3} of {picks} picks, expected {expected:.3}");
            least = least.min(expected);
            most = most.max(expected);
            let off = (found / expected - 1.0).abs();
            if off.is_nan() || off > within {
                return Err(format!(
                    "{dims:?}, {sigma_t}/m: {found} of {picks} picks, expected {expected}"
                ));
            }
        }
        if dims != [1; 3] && most < 1.2 * least {
            return Err(format!("{least} to {most} shows nothing"));
        }
    }
    Ok(())
}

/// The guide of light is what a ray sees of the grid: in small volumes, and in large ones whose
/// cells are two texels wide.
pub fn guides_see_the_grid(gpu: &Gpu) -> Result<(), String> {
    // Cells of two texels are averages over more.
    for (dims, within) in [([24; 3], 0.002), ([120, 100, 90], 0.006)] {
        let mut scene = linear_scene(40.0, dims)?;
        scene.environment = haze([1; 3], 1.0, 0.0)?.environment;
        let mut rig = Rig::of(gpu, &scene)?;
        let mut denoiser = rig.denoiser_of(Default::default())?;
        for _ in 0..40 {
            rig.trace(&[scene.camera], 16)?;
            rig.denoise(&mut denoiser, &[0])?;
            // The march is not repeated for a view at rest.
            scene.camera.fov_y *= 1.0001;
        }
        let grid = denoiser.read_light(true).map_err(text)?;
        let lights = denoiser.read_sunlight().map_err(text)?;
        let (per, size) = light_grid::cells(dims);
        if per != if dims[0] > 102 { 2 } else { 1 } {
            return Err(format!("cells of {per} texels for {dims:?}"));
        }
        let per_unit = Vec3::from_array(dims.map(|n| n as f32)) / per as f32;
        let to_cells = Mat3::from_diagonal(per_unit);
        let (mut met, mut sum, mut least, mut most) = (0, 0.0, f64::INFINITY, 0.0_f64);
        for (i, light) in (0..).zip(lights).step_by(7) {
            let [x, y] = [i % scene.camera.width, i / scene.camera.width];
            let line = Line::of_pixel(&scene, x, y);
            let (depths, step) = line.steps(1000);
            let [mut transmittance, mut all, mut known] = [1.0, 0.0, 0.0];
            let (mut albedo, mut opacity) = (0.0, 0.0);
            for depth in depths {
                let place = line.at(depth);
                let tau = sigma_t_at(&scene, place) * step * line.metres;
                let taken = transmittance * (1.0 - f64::exp(-tau));
                transmittance -= taken;
                let here = super::denoise_march::albedo_at(&scene, place).element_sum() / 3.0;
                opacity += taken;
                albedo += taken * here;
                let [light, weight] = light_grid::light_at(&grid, size, to_cells * place.as_vec3());
                if weight > 0.0 {
                    known += taken * here;
                    all += taken * here * f64::from(light);
                }
            }
            if opacity.is_nan() || opacity < 0.2 {
                continue;
            }
            let expected = all / known * albedo / (albedo + 0.5);
            let off = (f64::from(light) - expected).abs();
            met += 1;
            sum += off;
            least = least.min(expected);
            most = most.max(expected);
            if off.is_nan() || off > 0.05 {
                return Err(format!(
                    "{dims:?}, pixel {x}, {y}: {light}, expected {expected}"
                ));
            }
        }
        let mean = sum / f64::from(met);
        eprintln!(
            "{dims:?}: {met} pixels of {least:.3} to {most:.3}, off by {mean:.4} in the mean"
        );
        if met < 40 || most < least + 0.1 || mean > within {
            return Err(format!(
                "{dims:?}: {met} pixels of {least} to {most} are off by {mean} in the mean"
            ));
        }
    }
    Ok(())
}

/// What has been found goes with what it was found for: reset, turned volumes, other transfer
/// functions; not with a look from elsewhere, nor is a frame counted twice.
pub fn the_grid_forgets(gpu: &Gpu) -> Result<(), String> {
    let scene = haze([12, 6, 9], 15.0, 0.4)?;
    let mut rig = Rig::of(gpu, &scene)?;
    let mut denoiser = rig.denoiser_of(Default::default())?;
    let mut camera = Camera {
        width: 24,
        height: 24,
        ..scene.camera
    };
    let mut frame = |rig: &mut Rig<'_>, denoiser: &mut Denoiser, traces: bool| {
        camera.eye.x += 0.001;
        if traces {
            rig.trace(&[camera], 1)?;
        }
        rig.denoise(denoiser, &[0])?;
        let grid = denoiser.read_light(false).map_err(text)?;
        Ok::<_, String>(grid.iter().map(|[_, picks]| f64::from(*picks)).sum::<f64>())
    };
    let one = frame(&mut rig, &mut denoiser, true)?;
    let mut all = frame(&mut rig, &mut denoiser, true)?;
    let again = frame(&mut rig, &mut denoiser, false)?;
    if again != all {
        return Err(format!("{all} picks became {again} without a sample"));
    }
    for _ in 2..12 {
        all = frame(&mut rig, &mut denoiser, true)?;
    }
    type Change = fn(&mut Rig<'_>, &mut Denoiser);
    let changes: [(&str, Change); 3] = [
        ("reset", |_, denoiser| denoiser.reset()),
        ("a turn", |rig, _| {
            let turn = glam::DMat4::from_rotation_z(0.5);
            rig.medium.world_from_unit_cube = turn * rig.medium.world_from_unit_cube;
        }),
        ("another transfer function", |rig, _| {
            let points = vec![scenes::point(0.5, 16.0)];
            rig.medium.transfer_function = TransferFunction::new(points).expect("a point");
        }),
    ];
    for (what, change) in changes {
        for _ in 0..12 {
            all = frame(&mut rig, &mut denoiser, true)?;
        }
        change(&mut rig, &mut denoiser);
        let left = frame(&mut rig, &mut denoiser, true)?;
        eprintln!("{all} picks; {left} after {what}, {one} of the first frame");
        if all < 6.0 * one || left > 3.0 * one {
            return Err(format!(
                "{all} picks; {left} after {what}, {one} of the first frame"
            ));
        }
    }
    Ok(())
}

/// Gathering changes no image, and neither do the parts that a frame is traced in change the grid.
pub fn gathering_changes_no_image(gpu: &Gpu) -> Result<(), String> {
    let scene = scenes::scene();
    let found = [(false, None), (true, None), (true, Some(700))].map(|(gathers, split)| {
        let mut rig = Rig::of(gpu, &scene)?;
        rig.gathers_light = gathers;
        if let Some(samples) = split {
            rig.tracer.split_at(samples);
        }
        let mut denoiser = rig.denoiser_of(Default::default())?;
        rig.trace(&[scene.camera], 8)?;
        rig.denoise(&mut denoiser, &[0])?;
        let image = rig.tracer.read_image(0).map_err(text)?;
        let bits: Vec<_> = image.iter().map(|pixel| pixel.map(f32::to_bits)).collect();
        Ok::<_, String>((bits, denoiser.read_light(false).map_err(text)?))
    });
    let [(without, none), (with, whole), (_, parts)] = match found {
        [Ok(a), Ok(b), Ok(c)] => [a, b, c],
        [a, b, c] => return Err(format!("{:?}", [a.err(), b.err(), c.err()])),
    };
    if with != without {
        return Err("the image is another with gathering".into());
    }
    let picks: f32 = whole.iter().map(|[_, picks]| picks).sum();
    if !none.is_empty() || picks < 1000.0 || whole != parts {
        return Err(format!(
            "{} cells without gathering, {picks} picks with it",
            none.len()
        ));
    }
    Ok(())
}
