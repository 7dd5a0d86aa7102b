//! The denoiser: consistent at rest, the same for both eyes, and never stopped by what it is fed.

use std::sync::Arc;

use glam::DVec3;
use holovol_render::wgpu;
use holovol_render::{
    DenoiseFrame, DenoiseKernels, DenoiseMode, DenoiseSettings, Denoiser, FrameTracer, Gpu,
    GpuEnvironment, GpuVolume, Interpolation, Kernels, Medium, PaperSettings, TraceOptions, View,
    ViewFrame,
};
use holovol_scene::{Camera, Scene};
use holovol_volume::TransferFunction;

use super::scenes;

pub(super) type Images = Vec<Vec<[f32; 4]>>;

pub(super) fn text(error: impl std::fmt::Display) -> String {
    error.to_string()
}

fn settings(mode: DenoiseMode) -> DenoiseSettings {
    DenoiseSettings {
        mode,
        ..Default::default()
    }
}

fn modes() -> [DenoiseMode; 2] {
    [
        DenoiseMode::Holovol,
        DenoiseMode::Paper(PaperSettings::default()),
    ]
}

pub(super) struct Rig<'a> {
    gpu: &'a Gpu,
    pub(super) tracer: FrameTracer,
    pub(super) medium: Medium,
    /// For a denoiser in mode `holovol`.
    pub(super) gathers_light: bool,
    /// If not that of the images themselves.
    room: Option<[u32; 2]>,
}

impl<'a> Rig<'a> {
    fn new(gpu: &'a Gpu) -> Result<Self, String> {
        Self::of(gpu, &scenes::scene())
    }

    pub(super) fn of(gpu: &'a Gpu, scene: &Scene) -> Result<Self, String> {
        let kernels = Arc::new(Kernels::new(gpu).map_err(text)?);
        let volume =
            GpuVolume::new(gpu, &scene.volume, Interpolation::Exact, false).map_err(text)?;
        let environment = GpuEnvironment::new(gpu, &scene.environment.map).map_err(text)?;
        let medium = Medium {
            max_scatters: Some(1),
            ..Medium::from_scene(scene)
        };
        let tracer = FrameTracer::new(
            gpu,
            kernels,
            Arc::new(volume),
            Arc::new(environment),
            medium.clone(),
            TraceOptions::default(),
        )
        .map_err(text)?;
        Ok(Self {
            gpu,
            tracer,
            medium,
            gathers_light: true,
            room: None,
        })
    }

    fn denoiser(&self, mode: DenoiseMode) -> Result<Denoiser, String> {
        self.denoiser_of(settings(mode))
    }

    pub(super) fn denoiser_of(&self, settings: DenoiseSettings) -> Result<Denoiser, String> {
        let kernels = DenoiseKernels::new(self.gpu).map_err(text)?;
        Ok(Denoiser::new(self.gpu, Arc::new(kernels), settings))
    }

    fn submit(&self, encoder: wgpu::CommandEncoder) -> Result<(), String> {
        self.gpu.queue.submit([encoder.finish()]);
        let wait = wgpu::PollType::wait_indefinitely();
        self.gpu.device.poll(wait).map_err(text)?;
        Ok(())
    }

    pub(super) fn trace(&mut self, cameras: &[Camera], samples: u32) -> Result<(), String> {
        self.tracer.set_medium(&self.medium).map_err(text)?;
        self.tracer.gather_light(self.gathers_light).map_err(text)?;
        self.tracer.wait_for_kernels();
        let room = |c: &Camera| self.room.unwrap_or([c.width, c.height]);
        let rooms: Vec<_> = cameras.iter().map(room).collect();
        self.tracer.set_views(&rooms).map_err(text)?;
        let views: Vec<_> = cameras
            .iter()
            .enumerate()
            .map(|(slot, camera)| ViewFrame {
                slot,
                view: View::from_camera(camera),
                samples,
                max_samples: samples,
                restart: true,
                mesh_depth: None,
            })
            .collect();
        loop {
            let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
            let work = self
                .tracer
                .record(&mut encoder, &views, None)
                .map_err(text)?;
            self.submit(encoder)?;
            if !work.is_waiting {
                return Ok(());
            }
            self.tracer.wait_for_kernels();
        }
    }

    pub(super) fn denoise(
        &self,
        denoiser: &mut Denoiser,
        slots: &[usize],
    ) -> Result<Images, String> {
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        let frame = DenoiseFrame {
            slots,
            light_change: 0.0,
            meshes_changed: false,
            exposure: 1.0,
            reset: false,
        };
        denoiser.wait_for_kernels(&self.tracer).map_err(text)?;
        denoiser
            .record(&mut encoder, &self.tracer, &frame)
            .map_err(text)?;
        self.submit(encoder)?;
        denoiser.read_images().map_err(text)
    }
}

fn camera(width: u32, height: u32) -> Camera {
    Camera {
        width,
        height,
        ..scenes::scene().camera
    }
}

fn all_finite(images: &Images) -> Result<(), String> {
    let bad = images.iter().flatten().flatten().filter(|v| !v.is_finite());
    match bad.count() {
        0 => Ok(()),
        count => Err(format!("{count} values are not finite")),
    }
}

pub(super) fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for value in values {
        sum += value * value;
        count += 1.0;
    }
    f64::sqrt(sum / f64::max(count, 1.0))
}

/// After 4,096 frames at rest the output is the mean of the frames, to within half of the error
/// which that mean itself has: no bias stays behind.
pub fn resting_view_is_consistent(gpu: &Gpu) -> Result<(), String> {
    const FRAMES: u32 = 4096;
    let mut rig = Rig::new(gpu)?;
    let cameras = camera(12, 12).stereo(0.02);
    let mut denoiser = rig.denoiser(DenoiseMode::Holovol)?;
    let mut sum = vec![[0.0; 4]; 144];
    let mut squares = vec![[0.0; 4]; 144];
    let mut output = Images::new();
    for _ in 0..FRAMES {
        rig.trace(&cameras, 1)?;
        for ((sum, square), pixel) in sum
            .iter_mut()
            .zip(&mut squares)
            .zip(rig.tracer.read_image(0).map_err(text)?)
        {
            for c in 0..4 {
                sum[c] += f64::from(pixel[c]);
                square[c] += f64::from(pixel[c]).powi(2);
            }
        }
        output = rig.denoise(&mut denoiser, &[0, 1])?;
    }
    let n = f64::from(FRAMES);
    let pixels = || (0..144).flat_map(|i| (0..3).map(move |c| (i, c)));
    let off = rms(pixels().map(|(i, c)| f64::from(output[0][i][c]) - sum[i][c] / n));
    let noise = rms(pixels().map(|(i, c)| {
        let mean = sum[i][c] / n;
        ((squares[i][c] / n - mean * mean).max(0.0) / n).sqrt()
    }));
    if noise == 0.0 || off > 0.5 * noise {
        return Err(format!(
            "{off:e} off the mean, whose own error is {noise:e}"
        ));
    }
    Ok(())
}

/// What is not finite in one frame is not seen, in that frame or later, and the other pixels of its
/// surroundings go on.
pub fn wild_samples_are_lost(gpu: &Gpu) -> Result<(), String> {
    for mode in modes() {
        let mut rig = Rig::new(gpu)?;
        let cameras = camera(32, 24).stereo(0.02);
        let mut denoiser = rig.denoiser(mode)?;
        for frame in 0..6 {
            rig.trace(&cameras, 2)?;
            if frame == 0 || frame == 3 {
                for (pixel, value) in [
                    (0, f32::NAN),
                    (300, f32::INFINITY),
                    (400, f32::NEG_INFINITY),
                ] {
                    let bad = [[value; 4], [0.0; 4]];
                    let offset = 32 * (pixel + 32 * 24 * u64::from(frame == 3));
                    rig.gpu.queue.write_buffer(
                        rig.tracer.accumulators(),
                        offset,
                        &bad.iter()
                            .flatten()
                            .flat_map(|v| v.to_le_bytes())
                            .collect::<Vec<_>>(),
                    );
                }
            }
            let images = rig.denoise(&mut denoiser, &[0, 1])?;
            all_finite(&images).map_err(|e| format!("{mode:?}, frame {frame}: {e}"))?;
            let brightest = images
                .iter()
                .flatten()
                .flatten()
                .copied()
                .fold(0.0, f32::max);
            if brightest > 100.0 {
                return Err(format!(
                    "{mode:?}, frame {frame}: {brightest} of a dim scene"
                ));
            }
        }
    }
    Ok(())
}

/// Left and right exchanged give the images exchanged, bit by bit.
pub fn swapped_eyes_swap_images(gpu: &Gpu) -> Result<(), String> {
    for mode in modes() {
        let mut rig = Rig::new(gpu)?;
        let mut forth = rig.denoiser(mode)?;
        let mut back = rig.denoiser(mode)?;
        for frame in 0..4 {
            let mut middle = camera(33, 21);
            middle.eye += DVec3::X * (0.01 * f64::from(frame));
            rig.trace(&middle.stereo(0.02), 2)?;
            let a = rig.denoise(&mut forth, &[0, 1])?;
            let b = rig.denoise(&mut back, &[1, 0])?;
            if a[0] != b[1] || a[1] != b[0] {
                return Err(format!("{mode:?}: images differ at frame {frame}"));
            }
        }
    }
    Ok(())
}

/// Eyes that see the same from the same place get the same image.
pub fn equal_eyes_get_equal_images(gpu: &Gpu) -> Result<(), String> {
    for mode in modes() {
        let mut rig = Rig::new(gpu)?;
        let mut denoiser = rig.denoiser(mode)?;
        let one = camera(24, 16);
        for frame in 0..4 {
            rig.trace(&[one, one], 2)?;
            // The tracer gives each eye noise of its own.
            let sums = rig.tracer.read_image(0).map_err(text)?;
            let bytes: Vec<u8> = sums
                .iter()
                .flat_map(|pixel| [pixel.map(|v| 2.0 * v), [0.0; 4]])
                .flatten()
                .flat_map(f32::to_le_bytes)
                .collect();
            let twice = [bytes.as_slice(), bytes.as_slice()].concat();
            rig.gpu
                .queue
                .write_buffer(rig.tracer.accumulators(), 0, &twice);
            let images = rig.denoise(&mut denoiser, &[0, 1])?;
            let largest = rms(images[0].iter().flatten().map(|&v| f64::from(v)));
            let pairs = images[0].iter().flatten().zip(images[1].iter().flatten());
            let off = rms(pairs.map(|(&a, &b)| f64::from(a - b)));
            if off > 1e-6 * largest {
                return Err(format!("{mode:?}: eyes differ by {off:e} at frame {frame}"));
            }
        }
    }
    Ok(())
}

/// A frame after some at three quarters of its resolution, or the other way round: nearer to the truth than a fresh start,
/// if the tracer has room for both.
pub fn resolutions_share_history(gpu: &Gpu) -> Result<(), String> {
    const RUNS: u32 = 3;
    let mut rig = Rig::new(gpu)?;
    let sizes = [camera(48, 36), camera(64, 48)];
    let mut truths = Vec::new();
    for camera in sizes {
        rig.trace(&[camera], 4096)?;
        truths.push(rig.tracer.read_image(0).map_err(text)?);
    }
    rig.room = Some([64, 48]);
    for to in [1, 0] {
        let mut errors = [0.0; 2];
        for (error, frames) in errors.iter_mut().zip([0, 12]) {
            for _ in 0..RUNS {
                let mut denoiser = rig.denoiser(DenoiseMode::Holovol)?;
                for _ in 0..frames {
                    rig.trace(&[sizes[1 - to]], 2)?;
                    rig.denoise(&mut denoiser, &[0])?;
                }
                rig.trace(&[sizes[to]], 2)?;
                let images = rig.denoise(&mut denoiser, &[0])?;
                all_finite(&images)?;
                let pairs = images[0].iter().zip(&truths[to]);
                let rgb = pairs.flat_map(|(a, b)| (0..3).map(move |c| a[c] - b[c]));
                *error += rms(rgb.map(f64::from)).powi(2) / f64::from(RUNS);
            }
        }
        let [fresh, kept] = errors;
        eprintln!("to size {to}: squared error {fresh:.2e} fresh, {kept:.2e} with history");
        if kept > 0.8 * fresh {
            return Err(format!(
                "to size {to}: {kept} with history, {fresh} without"
            ));
        }
    }
    Ok(())
}

/// Cuts, teleports, other sizes, one eye or two, and media that vanish: always finite.
pub fn upheavals_leave_no_trace(gpu: &Gpu) -> Result<(), String> {
    for mode in modes() {
        let mut rig = Rig::new(gpu)?;
        let full = rig.medium.clone();
        let mut empty = full.clone();
        empty.transfer_function =
            TransferFunction::new(vec![scenes::point(0.0, 0.0)]).map_err(text)?;
        let mut denoiser = rig.denoiser(mode)?;
        let mut seen = 0;
        for frame in 0..36u32 {
            let [x, y, z] = scenes::numbers(frame, 7).map(|v| f64::from(v) - 0.5);
            // Each size and number of eyes stays for four frames: small moves, a leap, nothing.
            let mut middle = match frame / 4 % 3 {
                0 => camera(24, 16),
                1 => camera(17, 33),
                _ => camera(1, 1),
            };
            let far = if frame % 4 == 2 { 0.5 } else { 0.02 };
            middle.eye += DVec3::new(x, y, z) * far;
            let is_empty = frame % 4 == 3;
            rig.medium = if is_empty { &empty } else { &full }.clone();
            let eyes = middle.stereo(if frame == 17 { 10.0 } else { 0.02 });
            let eyes = if frame / 12 == 2 {
                &eyes[..1]
            } else {
                &eyes[..]
            };
            rig.trace(eyes, 2)?;
            let slots = [0, 1];
            let images = rig.denoise(&mut denoiser, &slots[..eyes.len()])?;
            all_finite(&images).map_err(|e| format!("{mode:?}, frame {frame}: {e}"))?;
            let expected: Vec<_> = eyes.iter().map(|c| (c.width * c.height) as usize).collect();
            if images.iter().map(Vec::len).ne(expected) {
                return Err(format!("{mode:?}: images of a wrong size at frame {frame}"));
            }
            let is_black = images.iter().flatten().flatten().all(|&v| v == 0.0);
            seen += u32::from(!is_black);
            if is_empty && !is_black && mode == DenoiseMode::Holovol {
                return Err(format!(
                    "{mode:?}: an empty volume is seen at frame {frame}"
                ));
            }
        }
        // Images of nothing would pass.
        if seen < 18 {
            return Err(format!("{mode:?}: only {seen} of 36 frames show anything"));
        }
    }
    Ok(())
}

/// The mean over the image is that of the samples, within 1 %.
pub fn the_mean_is_kept(gpu: &Gpu) -> Result<(), String> {
    let mut rig = Rig::new(gpu)?;
    let mut denoiser = rig.denoiser(DenoiseMode::Holovol)?;
    let cameras = camera(48, 48).stereo(0.02);
    let mut noisy = 0.0;
    let mut denoised = 0.0;
    for _ in 0..16 {
        rig.trace(&cameras, 2)?;
        let mean = |image: &[[f32; 4]]| {
            image
                .iter()
                .map(|p| f64::from(p[0] + p[1] + p[2]))
                .sum::<f64>()
                / image.len() as f64
        };
        noisy += mean(&rig.tracer.read_image(0).map_err(text)?) / 16.0;
        denoised = mean(&rig.denoise(&mut denoiser, &[0, 1])?[0]);
    }
    let off = (denoised / noisy - 1.0).abs();
    if off.is_nan() || off > 0.01 {
        return Err(format!("mean {denoised} instead of {noisy}"));
    }
    Ok(())
}

/// More than two eyes, none, or one that was not traced is refused in words.
pub fn wrong_eyes_are_refused(gpu: &Gpu) -> Result<(), String> {
    let mut rig = Rig::new(gpu)?;
    rig.trace(&[camera(8, 8)], 1)?;
    let mut denoiser = rig.denoiser(DenoiseMode::Holovol)?;
    for slots in [&[][..], &[0, 0, 0], &[1]] {
        if rig.denoise(&mut denoiser, slots).is_ok() {
            return Err(format!("slots {slots:?} were taken"));
        }
    }
    Ok(())
}
