//! Guides of a dominant light: its shadows stay sharp, and they are found anew where it moves; and of
//! pixels beside silhouettes.

use std::sync::Arc;

use glam::{DMat4, DVec3};
use holovol_light::EnvironmentMap;
use holovol_render::{DenoiseMode, DenoiseSettings, Gpu, GpuEnvironment, PaperSettings};
use holovol_scene::{Camera, Scene};
use holovol_volume::{TransferFunction, Voxels};

use super::denoise::{Rig, rms, text};
use super::scenes;

const SIDE: u32 = 48;

/// Posts and a beam over a floor, opaque.
fn posts() -> Vec<f32> {
    let voxel = |i: u32| {
        let [x, y, z] = [i % SIDE, i / SIDE % SIDE, i / SIDE / SIDE];
        let is_post = [(12, 14), (30, 10), (34, 30)]
            .iter()
            .any(|&(a, b)| x.abs_diff(a) < 3 && z.abs_diff(b) < 3);
        let is_beam = y.abs_diff(28) < 2 && z.abs_diff(24) < 2;
        f32::from(u8::from(y < 6 || is_post && y < 40 || is_beam))
    };
    (0..SIDE.pow(3)).map(voxel).collect()
}

/// A sun of 1.5° at this column of 128, three quarters up.
pub(super) fn sky(column: usize) -> EnvironmentMap {
    let texel = |i: usize| {
        let is_sun = i % 128 == column && i / 128 == 20;
        [if is_sun { 4000.0 } else { 1.0 }; 3]
    };
    EnvironmentMap::new(128, 64, (0..128 * 64).map(texel).collect())
}

fn scene() -> Result<Scene, String> {
    let points = vec![scenes::point(0.4, 0.0), scenes::point(0.6, 1500.0)];
    let mut scene = scenes::scene();
    scene.environment.map = sky(90);
    scene.environment.rotation_y = 0.4;
    Ok(Scene {
        volume: scenes::volume(Voxels::F32(posts()), [SIDE; 3]),
        window: [0.0, 1.0],
        world_from_unit_cube: DMat4::from_scale(DVec3::splat(0.2))
            * DMat4::from_translation(DVec3::splat(-0.5)),
        transfer_function: TransferFunction::new(points).map_err(text)?,
        phase_g: 0.0,
        gradient_factor: 0.0,
        camera: Camera {
            eye: DVec3::new(0.2, 0.2, 0.4),
            target: DVec3::new(0.0, -0.03, 0.0),
            up: DVec3::Y,
            fov_y: 0.5,
            width: 64,
            height: 48,
        },
        ..scene
    })
}

/// One frame of two samples has at most 0.7 of the squared error that it has without the guide. Here
/// the guide alone says all, and cells are as small as pixels: what the light grid adds after eight
/// frames, seen by a head that moves, is its noise, a fifth of the error.
pub fn shadows_stay_sharp(gpu: &Gpu) -> Result<(), String> {
    let scene = scene()?;
    let mut rig = Rig::of(gpu, &scene)?;
    rig.trace(&[scene.camera], 2048)?;
    let truth = rig.tracer.read_image(0).map_err(text)?;
    let mut errors = [0.0; 4];
    let cases = [
        (1, false, 0.2),
        (1, false, f64::INFINITY),
        (8, true, 0.2),
        (8, false, 0.2),
    ];
    for (error, (frames, gathers_light, sun_share)) in errors.iter_mut().zip(cases) {
        rig.gathers_light = gathers_light;
        let settings = DenoiseSettings {
            sun_share,
            ..Default::default()
        };
        let mut denoiser = rig.denoiser_of(settings)?;
        let mut image = Vec::new();
        for back in (0..frames).rev() {
            let mut camera = scene.camera;
            camera.eye.x += 5e-4 * f64::from(back);
            rig.trace(&[camera], 2)?;
            image = rig.denoise(&mut denoiser, &[0])?.swap_remove(0);
        }
        let pairs = image.iter().zip(&truth);
        let rgb = pairs.flat_map(|(a, b)| (0..3).map(move |c| a[c] - b[c]));
        *error = rms(rgb.map(f64::from)).powi(2);
    }
    let [with, without, gathered, alone] = errors;
    let found = format!(
        "squared error {with:.2e} with the guide, {without:.2e} without; after eight frames \
         {alone:.2e}, {gathered:.2e} with the light grid"
    );
    eprintln!("{found}");
    let is_sharp = with <= 0.7 * without && gathered <= 1.3 * alone;
    if is_sharp { Ok(()) } else { Err(found) }
}

/// Pixels that are covered in part though the ray through their middle misses: in motion they have at
/// most 0.3 of the squared error of their samples. Without guides they had all of it.
pub fn pixels_beside_silhouettes_have_a_history(gpu: &Gpu) -> Result<(), String> {
    let scene = scene()?;
    let mut rig = Rig::of(gpu, &scene)?;
    rig.trace(&[scene.camera], 2048)?;
    let truth = rig.tracer.read_image(0).map_err(text)?;
    // The paper's mode has the march's guides and no others.
    let mut marched = rig.denoiser_of(DenoiseSettings {
        mode: DenoiseMode::Paper(PaperSettings::default()),
        ..Default::default()
    })?;
    rig.denoise(&mut marched, &[0])?;
    let guides = marched.read_albedo().map_err(text)?;
    let mut denoiser = rig.denoiser_of(DenoiseSettings::default())?;
    let mut image = Vec::new();
    for back in (0..8).rev() {
        let mut camera = scene.camera;
        camera.eye.x += 5e-4 * f64::from(back);
        rig.trace(&[camera], 2)?;
        image = rig.denoise(&mut denoiser, &[0])?.swap_remove(0);
    }
    let noisy = rig.tracer.read_image(0).map_err(text)?;
    let edges: Vec<_> = (0..truth.len())
        .filter(|&i| guides[i][3] == 0.0 && truth[i][3] > 0.02)
        .collect();
    let of = |image: &[[f32; 4]]| {
        let differences = edges.iter().flat_map(|&i| {
            let (a, b) = (image[i], truth[i]);
            (0..3).map(move |c| f64::from(a[c] - b[c]))
        });
        rms(differences).powi(2)
    };
    let (before, after) = (of(&noisy), of(&image));
    let count = edges.len();
    eprintln!("{count} pixels, squared error {before:.2e}, {after:.2e} denoised");
    if count < 30 || after.is_nan() || after > 0.3 * before {
        return Err(format!("{count} pixels: {before}, {after} denoised"));
    }
    Ok(())
}

/// A view at rest whose sun has moved is not at rest, whatever the caller says of the light.
pub fn another_sun_is_another_frame(gpu: &Gpu) -> Result<(), String> {
    let scene = scene()?;
    let mut rig = Rig::of(gpu, &scene)?;
    let mut denoiser = rig.denoiser_of(DenoiseSettings::default())?;
    for (column, expected) in [(90, 2), (90, 4), (40, 2), (40, 4)] {
        let environment = GpuEnvironment::new(gpu, &sky(column)).map_err(text)?;
        rig.tracer
            .set_environment(&Arc::new(environment))
            .map_err(text)?;
        rig.trace(&[scene.camera], 2)?;
        rig.denoise(&mut denoiser, &[0])?;
        let samples = denoiser.samples();
        if samples != expected {
            return Err(format!(
                "{samples} samples of the sun at {column}, not {expected}"
            ));
        }
    }
    Ok(())
}
