//! The real-time pipeline without a window: a few samples per pixel and frame, then the denoiser.

use std::sync::Arc;
use std::time::Instant;

use holovol_render::{
    Counters, DenoiseFrame, DenoiseKernels, DenoiseSettings, Denoiser, FrameTracer, Gpu,
    GpuEnvironment, GpuVolume, Interpolation, Kernels, LightChange, Medium, RenderError,
    TraceOptions, View, ViewFrame, environment_change, wgpu,
};
use holovol_scene::{Camera, Scene};

use crate::{Exit, Failure};

/// Seconds of a frame's stages, each waited for: of processor time on a software adapter on
/// Linux, else by the clock.
#[derive(Clone, Copy, Debug, Default, serde::Serialize)]
pub(crate) struct Seconds {
    pub(crate) trace: f64,
    pub(crate) guides: f64,
    pub(crate) filter: f64,
}

/// One volume's frames.
pub(crate) struct Live {
    gpu: Gpu,
    tracer: FrameTracer,
    environment: (*const [f32; 3], Arc<GpuEnvironment>),
    light: LightChange,
    denoise_kernels: Arc<DenoiseKernels>,
    /// Since a denoiser wants it.
    gathers_light: bool,
}

impl Live {
    /// Uploads a scene and compiles what it needs.
    pub(crate) fn new(
        gpu: &Gpu,
        scene: &Scene,
        interpolation: Interpolation,
        seed: u64,
    ) -> Result<Self, Failure> {
        let kernels = Arc::new(Kernels::new(gpu)?);
        let volume = Arc::new(GpuVolume::new(gpu, &scene.volume, interpolation, false)?);
        let map = &scene.environment.map;
        let environment = Arc::new(GpuEnvironment::new(gpu, map)?);
        let options = TraceOptions {
            interpolation,
            seed,
            ..Default::default()
        };
        let tracer = FrameTracer::new(
            gpu,
            kernels,
            volume,
            Arc::clone(&environment),
            Medium::from_scene(scene),
            options,
        )?;
        Ok(Self {
            gpu: gpu.clone(),
            tracer,
            environment: (map.texels().as_ptr(), environment),
            light: LightChange::default(),
            denoise_kernels: Arc::new(DenoiseKernels::new(gpu)?),
            gathers_light: false,
        })
    }

    /// Traces one frame of a scene, whose volume stays the same; gives seconds and the change of
    /// illumination T since the last frame.
    pub(crate) fn trace(
        &mut self,
        scene: &Scene,
        cameras: &[Camera],
        spp: u32,
    ) -> Result<(f64, f32), Failure> {
        let map = &scene.environment.map;
        if self.environment.0 != map.texels().as_ptr() {
            let environment = Arc::new(GpuEnvironment::new(&self.gpu, map)?);
            self.environment = (map.texels().as_ptr(), environment);
        }
        self.tracer.set_environment(&self.environment.1)?;
        self.tracer.set_medium(&Medium::from_scene(scene))?;
        let sizes: Vec<_> = cameras.iter().map(|c| [c.width, c.height]).collect();
        self.tracer.set_views(&sizes)?;
        self.tracer.gather_light(self.gathers_light)?;
        self.tracer.wait_for_kernels();
        let views: Vec<_> = cameras
            .iter()
            .enumerate()
            .map(|(slot, camera)| ViewFrame {
                slot,
                view: View::from_camera(camera),
                samples: spp,
                max_samples: spp,
                restart: true,
                mesh_depth: None,
            })
            .collect();
        let mut seconds =
            self.timed(|live, encoder| Ok(live.tracer.record(encoder, &views, None)?.is_waiting))?;
        if seconds.1 {
            self.tracer.wait_for_kernels();
            seconds = self
                .timed(|live, encoder| Ok(live.tracer.record(encoder, &views, None)?.is_waiting))?;
        }
        if seconds.1 {
            return Err(Failure::new(
                Exit::Internal,
                "the tracer's kernels are not ready",
            ));
        }
        let (rotation_y, scale) = (scene.environment.rotation_y, scene.environment.scale);
        let change = self.light.update(map, rotation_y, scale, |before| {
            environment_change(before, map)
        });
        Ok((seconds.0, change))
    }

    /// Denoises the frame that was traced last.
    pub(crate) fn denoise(
        &mut self,
        denoiser: &mut Denoiser,
        eyes: usize,
        light_change: f32,
    ) -> Result<Seconds, Failure> {
        let slots: Vec<_> = (0..eyes).collect();
        let frame = DenoiseFrame {
            slots: &slots,
            light_change,
            meshes_changed: false,
            exposure: 1.0,
            reset: false,
        };
        denoiser.wait_for_kernels(&self.tracer)?;
        let (guides, ()) =
            self.timed(|live, encoder| denoiser.record_guides(encoder, &live.tracer, &frame))?;
        let (filter, ()) =
            self.timed(|live, encoder| denoiser.record_filter(encoder, &live.tracer))?;
        Ok(Seconds {
            trace: 0.0,
            guides,
            filter,
        })
    }

    /// A denoiser for these frames.
    pub(crate) fn denoiser(&mut self, settings: DenoiseSettings) -> Denoiser {
        self.gathers_light |= settings.wants_light();
        Denoiser::new(&self.gpu, Arc::clone(&self.denoise_kernels), settings)
    }

    /// The frame as it was traced.
    pub(crate) fn noisy(&self, slot: usize) -> Result<Vec<[f32; 4]>, Failure> {
        Ok(self.tracer.read_image(slot)?)
    }

    /// What the tracer counted, a few frames ago.
    pub(crate) fn counters(&self) -> Counters {
        self.tracer.counters()
    }

    fn timed<T>(
        &mut self,
        record: impl FnOnce(&mut Self, &mut wgpu::CommandEncoder) -> Result<T, RenderError>,
    ) -> Result<(f64, T), Failure> {
        let is_software = self.gpu.info().device_type == wgpu::DeviceType::Cpu;
        let before = processor_seconds().filter(|_| is_software);
        let started = Instant::now();
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        let value = record(self, &mut encoder)?;
        self.gpu.queue.submit([encoder.finish()]);
        self.gpu
            .device
            .poll(wgpu::PollType::wait_indefinitely())
            .map_err(|error| {
                Failure::new(
                    Exit::Device,
                    format!("the device was lost in a frame: {error}"),
                )
            })?;
        let seconds = match (before, processor_seconds()) {
            (Some(before), Some(after)) => after - before,
            _ => started.elapsed().as_secs_f64(),
        };
        Ok((seconds, value))
    }
}

/// Processor time of all threads so far, where the system tells it.
#[cfg(target_os = "linux")]
fn processor_seconds() -> Option<f64> {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    Some(time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64)
}

#[cfg(not(target_os = "linux"))]
fn processor_seconds() -> Option<f64> {
    None
}
