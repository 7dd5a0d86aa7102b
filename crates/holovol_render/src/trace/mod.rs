//! The path tracer: radiance and opacity of every pixel, sample by sample.
//!
//! [`Tracer::new`] uploads a scene and compiles the kernel for what the scene uses;
//! [`Tracer::accumulate`] adds samples in dispatches of a few tens of milliseconds;
//! [`Tracer::read_image`] gives the mean so far. The estimator is unbiased: RMSE falls as
//! 1/√samples without a floor. Paths that outlive a dispatch go on in the next one.

mod bands;
mod check;
pub(crate) use check::{medium as check_medium, options as check_options};
#[cfg(any(test, feature = "testing"))]
pub(crate) mod contract;
mod environment;
mod medium;
mod resources;
#[cfg(test)]
pub(crate) mod tests;
pub(crate) mod uniforms;
mod variant;
mod view;

use std::ops::Range;
use std::time::Instant;

use bytemuck::{Pod, Zeroable};
use holovol_scene::Scene;
use holovol_volume::CELL_SIZE;

use self::bands::{Band, rows_of_bands};
use crate::fetch::FETCH;
use crate::shader::ShaderDefs;
use crate::{Gpu, GpuVolume, MajorantGrid, RenderError};
pub use environment::GpuEnvironment;
pub use medium::Medium;
pub(crate) use medium::corners;
pub(crate) use resources::{Buffers, GUIDE_BYTES, PIXEL_BYTES, layout};
pub use uniforms::MAX_VIEWS;
pub(crate) use uniforms::{DispatchUniform, ViewUniform, kernel_seed};
use variant::PICKS;
pub(crate) use variant::{PATH, TRACE};
pub(crate) use variant::{QUEUE_CAPACITY, Surroundings, WORKGROUP_SIZE, shader_defs};
pub use view::View;

/// How values between voxel centres are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Interpolation {
    /// Trilinear in f32: the accuracy path.
    #[default]
    Exact,
    /// The texture unit's, with 8-bit weights on most GPUs: faster, biased by about 1/512 of the
    /// difference between neighbours.
    Hardware,
}

/// What a [`Tracer`] can be asked for besides the scene itself.
#[derive(Clone, Debug)]
pub struct TraceOptions {
    /// Exact or hardware interpolation.
    pub interpolation: Interpolation,
    /// Images of different seeds are independent; the same seed gives the same bits.
    pub seed: u64,
    /// Refuse a volume that the device can only hold reduced.
    pub exact_volume: bool,
    /// Also accumulate depth, albedo and gradient, see [`Tracer::read_guides`].
    pub guides: bool,
    /// Count lookups and cells (slower).
    pub statistics: bool,
    /// Side of a majorant cell in voxels; for comparisons.
    pub cell_size: u32,
    /// Plain random numbers instead of well-spread ones; for comparisons.
    pub white_noise: bool,
    /// Light candidates per scattering, from the environment and from the phase function;
    /// `None` chooses by scene.
    pub light_candidates: Option<[u32; 2]>,
    /// Collisions that a flight chooses to be lit, 1 to 4.
    pub picks: u32,
    /// Rounds that a path may take in one dispatch.
    pub budget: u32,
    /// Lets lanes wait for each other where the device has subgroups.
    pub subgroups: bool,
}

impl Default for TraceOptions {
    fn default() -> Self {
        Self {
            interpolation: Interpolation::Exact,
            seed: 0,
            exact_volume: false,
            guides: false,
            statistics: false,
            cell_size: CELL_SIZE,
            white_noise: false,
            light_candidates: None,
            picks: PICKS,
            budget: 16384,
            subgroups: true,
        }
    }
}

/// What the kernel counted since the tracer was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Lookups above their cell's majorant: 0, or the image is wrong.
    pub majorant_violations: u64,
    /// Samples left out because they were not finite: 0, or radiance overflows f32.
    pub nonfinite_samples: u64,
    /// Paths that went on in a further dispatch; none is ever cut.
    pub continued_paths: u64,
    /// Volume lookups of walks, with [`TraceOptions::statistics`].
    pub lookups: u64,
    /// Cells of the majorant grid entered by walks, with [`TraceOptions::statistics`].
    pub cells: u64,
    /// Samples whose flight met the volume, with [`TraceOptions::statistics`].
    pub covered_samples: u64,
}

/// Clean features of the first collision, means over the samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Guide {
    /// Metres from the camera.
    pub depth: f32,
    /// Standard deviation of the depth, metres.
    pub spread: f32,
    /// Single-scattering albedo.
    pub albedo: [f32; 3],
    /// |∇s|, 1/m.
    pub gradient_magnitude: f32,
    /// Mean unit gradient, world space; shorter than 1 where directions vary.
    pub gradient: [f32; 3],
    /// Opacity; 0 leaves the rest undefined (0).
    pub opacity: f32,
}

#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(crate) struct GpuCounters {
    pub(crate) saved_paths: u32,
    pub(crate) majorant_violations: u32,
    pub(crate) nonfinite_samples: u32,
    pub(crate) lookups: u32,
    pub(crate) cells: u32,
    pub(crate) covered_samples: u32,
    pub(crate) resumed_paths: u32,
    pub(crate) unlimited: u32,
}

impl GpuCounters {
    /// Where fields lie, in words.
    pub(crate) const SAVED_PATHS: u32 = (std::mem::offset_of!(Self, saved_paths) / 4) as u32;
    pub(crate) const RESUMED_PATHS: u32 = (std::mem::offset_of!(Self, resumed_paths) / 4) as u32;
    pub(crate) const UNLIMITED: u32 = (std::mem::offset_of!(Self, unlimited) / 4) as u32;
    /// Byte at which the two of them begin that steer the flow.
    pub(crate) const FLOW: u64 = 4 * Self::RESUMED_PATHS as u64;
}

/// Samples of a pixel in one dispatch, at most.
const SAMPLES_PER_LANE: u32 = 32;
/// A dispatch should take about this long: well under the watchdog of any driver.
const DISPATCH_SECONDS: f64 = 0.04;
/// Software has no watchdog, and its threads wait for each other at the end of each dispatch.
const SOFTWARE_DISPATCH_SECONDS: f64 = 0.2;

/// A scene on the device, and the samples made of it.
pub struct Tracer {
    gpu: Gpu,
    volume: GpuVolume,
    layout: wgpu::BindGroupLayout,
    resources: Buffers,
    bands: Vec<Band>,
    view: ViewUniform,
    defs: ShaderDefs,
    trace_pipeline: wgpu::ComputePipeline,
    /// Goes on with saved paths; compiled when there is one.
    resume_pipeline: Option<wgpu::ComputePipeline>,
    counters: Counters,
    image_size: [u32; 2],
    options: TraceOptions,
    samples: u32,
    samples_per_dispatch: f64,
    /// Lanes that keep the device busy.
    lanes_wanted: u32,
    dispatch_seconds: f64,
}

impl Tracer {
    /// Uploads a scene and compiles the kernel for it.
    ///
    /// # Errors
    /// If the scene can't be traced or doesn't fit the device, or the device fails.
    pub fn new(gpu: &Gpu, scene: &Scene, options: &TraceOptions) -> Result<Self, RenderError> {
        check::medium(&Medium::from_scene(scene), scene.volume.dims())?;
        check::camera(scene)?;
        check::options(options)?;
        let volume = GpuVolume::new(
            gpu,
            &scene.volume,
            options.interpolation,
            options.exact_volume,
        )?;
        let majorants = MajorantGrid::new(gpu, &volume, options.cell_size)?;
        let medium = Medium::from_scene(scene);
        let s_from_texel = volume.s_from_texel(medium.window);
        majorants.update(gpu, &medium.transfer_function, s_from_texel)?;
        let environment = GpuEnvironment::new(gpu, &scene.environment.map)?;
        let image_size = [scene.camera.width, scene.camera.height];
        let [width, height] = image_size.map(u64::from);
        let layout = layout(gpu, options.interpolation, volume.slices)?;
        let mut resources = Buffers::new(gpu, width * height, options)?;
        resources.set_medium(gpu, &medium, &volume, &majorants, &environment)?;
        let limit = gpu.device.limits().max_storage_buffer_binding_size;
        let bands = rows_of_bands(image_size, limit, options.guides)
            .map(|rows| {
                let [start, end] = [rows.start, rows.end].map(|y| u64::from(y) * width);
                let (majorants, light) = (&majorants, &environment);
                let bind_groups = resources.bind_groups(
                    gpu,
                    &layout,
                    &volume,
                    majorants,
                    light,
                    None,
                    None,
                    None,
                    start..end,
                )?;
                Ok(Band { rows, bind_groups })
            })
            .collect::<Result<_, RenderError>>()?;
        let surroundings = Surroundings {
            constant_environment: environment.is_constant(),
            has_density: environment.has_density(),
            slices: volume.slices,
            mesh_depth: false,
            sample_shares: false,
            light_grid: false,
        };
        let defs = shader_defs(gpu, &medium, options, surroundings);
        let trace_pipeline = gpu.pipeline(&TRACE, &defs, "trace", &layout)?;
        let software = gpu.info().device_type == wgpu::DeviceType::Cpu;
        let mut tracer = Self {
            gpu: gpu.clone(),
            view: ViewUniform::new(&View::from_camera(&scene.camera), &medium, &volume),
            volume,
            layout,
            resources,
            bands,
            defs,
            trace_pipeline,
            resume_pipeline: None,
            counters: Counters::default(),
            image_size,
            options: options.clone(),
            samples: 0,
            samples_per_dispatch: 65536.0,
            lanes_wanted: if software { 2048 } else { 1 << 18 },
            dispatch_seconds: if software {
                SOFTWARE_DISPATCH_SECONDS
            } else {
                DISPATCH_SECONDS
            },
        };
        // Some drivers compile at the first dispatch: an empty one, so that no sample waits for it.
        tracer.trace_tile(0, 0..0, [0, 0])?;
        Ok(tracer)
    }

    /// Adds `samples` samples to every pixel and waits for them.
    ///
    /// # Errors
    /// If the device is lost.
    pub fn accumulate(&mut self, samples: u32) -> Result<(), RenderError> {
        let end = self.samples.saturating_add(samples);
        while self.samples < end {
            let [width, height] = self.image_size;
            // Several samples of a pixel by one lane: while its neighbours finish long paths, it
            // goes on with the next sample.
            let lanes = f64::from(self.lanes_wanted).min(f64::from(width) * f64::from(height));
            let batch = (self.samples_per_dispatch / lanes) as u32;
            let batch = batch.clamp(1, (end - self.samples).min(SAMPLES_PER_LANE));
            let rows = (self.samples_per_dispatch / f64::from(width * batch)) as u32;
            let rows = rows.next_multiple_of(8).clamp(8, height.max(8));
            let tiles: Vec<_> = (0..self.bands.len())
                .flat_map(|band| {
                    let in_band = self.bands[band].rows.clone();
                    let end = in_band.end;
                    in_band
                        .step_by(rows as usize)
                        .map(move |y| (band, y..end.min(y + rows)))
                })
                .collect();
            for (band, tile) in tiles {
                let started = Instant::now();
                self.trace_tile(band, tile, [self.samples, self.samples + batch])?;
                let seconds = started.elapsed().as_secs_f64();
                let change = (self.dispatch_seconds / seconds.max(1e-6)).clamp(0.5, 2.0);
                self.samples_per_dispatch = (self.samples_per_dispatch * change).clamp(4096.0, 1e8);
            }
            self.samples += batch;
        }
        Ok(())
    }

    /// Starts anew with another seed: no samples, counters at 0, nothing compiled or uploaded again.
    pub fn restart(&mut self, seed: u64) {
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        encoder.clear_buffer(&self.resources.accumulators, 0, None);
        encoder.clear_buffer(&self.resources.guides, 0, None);
        self.gpu.queue.submit([encoder.finish()]);
        self.options.seed = seed;
        self.samples = 0;
        self.counters = Counters::default();
    }

    /// Samples that every pixel has.
    pub fn samples_per_pixel(&self) -> u64 {
        u64::from(self.samples)
    }

    /// Width and height in pixels.
    pub fn image_size(&self) -> [u32; 2] {
        self.image_size
    }

    /// Means so far: premultiplied linear radiance and opacity, row by row from the top left.
    ///
    /// # Errors
    /// If the device is lost.
    pub fn read_image(&self) -> Result<Vec<[f32; 4]>, RenderError> {
        let bytes = self.gpu.read_buffer(
            "the image",
            &self.resources.accumulators,
            self.resources.accumulators.size(),
        )?;
        let sums: Vec<[[f32; 4]; 2]> = bytemuck::pod_collect_to_vec(&bytes);
        let count = f64::from(self.samples.max(1));
        let mean = |sum: &[[f32; 4]; 2]| {
            std::array::from_fn(|c| ((f64::from(sum[0][c]) + f64::from(sum[1][c])) / count) as f32)
        };
        Ok(sums.iter().map(mean).collect())
    }

    /// Features of the first collision, means so far; empty without [`TraceOptions::guides`].
    ///
    /// # Errors
    /// If the device is lost.
    pub fn read_guides(&self) -> Result<Vec<Guide>, RenderError> {
        if !self.options.guides {
            return Ok(Vec::new());
        }
        let bytes = self.gpu.read_buffer(
            "the guides",
            &self.resources.guides,
            self.resources.guides.size(),
        )?;
        let sums: Vec<[[f32; 4]; 3]> = bytemuck::pod_collect_to_vec(&bytes);
        Ok(sums.iter().map(|sums| self.guide(sums)).collect())
    }

    fn guide(&self, [depth, albedo, gradient]: &[[f32; 4]; 3]) -> Guide {
        let weight = depth[3];
        if weight <= 0.0 {
            return Guide::default();
        }
        let mean = |sum: f32| sum / weight;
        let variance = mean(depth[1]) - mean(depth[0]) * mean(depth[0]);
        Guide {
            depth: albedo[3] + mean(depth[0]),
            spread: variance.max(0.0).sqrt(),
            albedo: [albedo[0], albedo[1], albedo[2]].map(mean),
            gradient_magnitude: mean(depth[2]),
            gradient: [gradient[0], gradient[1], gradient[2]].map(mean),
            opacity: weight / self.samples.max(1) as f32,
        }
    }

    /// What the kernel counted so far.
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// What a user should know of how the scene was stored.
    pub fn notices(&self) -> &[String] {
        self.volume.notices()
    }

    /// The volume as the device holds it.
    pub fn volume(&self) -> &GpuVolume {
        &self.volume
    }

    /// Traces samples [start, end) of some rows of a band, and of their saved paths until none is
    /// left.
    fn trace_tile(
        &mut self,
        band: usize,
        rows: Range<u32>,
        [sample_start, sample_end]: [u32; 2],
    ) -> Result<(), RenderError> {
        let width = self.image_size[0];
        let tile_size = [width, rows.end - rows.start];
        let mut uniform = DispatchUniform {
            tile_origin: [0, rows.start],
            tile_size,
            seed: 0,
            budget: self.options.budget,
            resumed_paths: 0,
            queue_capacity: QUEUE_CAPACITY,
        };
        // Where the image would begin, counted from the band's first pixel; may be before it.
        self.view.image[2] = 0u32.wrapping_sub(self.bands[band].rows.start.wrapping_mul(width));
        self.view.image[3] = kernel_seed(self.options.seed);
        self.view.samples = [sample_start, sample_end, 0, 0];
        let view = bytemuck::bytes_of(&self.view);
        self.gpu.queue.write_buffer(&self.resources.views, 0, view);
        let groups = tile_size.map(|n| n.div_ceil(8).max(1));
        let pipeline = self.trace_pipeline.clone();
        let mut saved = self.submit(&uniform, &pipeline, (band, 0), groups)?;
        let mut queue = 1;
        while saved > 0 {
            self.counters.continued_paths += u64::from(saved);
            uniform.resumed_paths = saved;
            let groups = [saved.div_ceil(WORKGROUP_SIZE), 1];
            let pipeline = self.resume_pipeline()?;
            saved = self.submit(&uniform, &pipeline, (band, queue), groups)?;
            queue = 1 - queue;
        }
        Ok(())
    }

    fn resume_pipeline(&mut self) -> Result<wgpu::ComputePipeline, RenderError> {
        if let Some(pipeline) = &self.resume_pipeline {
            return Ok(pipeline.clone());
        }
        let layout = &self.layout;
        let pipeline = self.gpu.pipeline(&TRACE, &self.defs, "resume", layout)?;
        Ok(self.resume_pipeline.insert(pipeline).clone())
    }

    /// One dispatch; returns how many paths it saved.
    fn submit(
        &mut self,
        uniform: &DispatchUniform,
        pipeline: &wgpu::ComputePipeline,
        (band, queue): (usize, usize),
        [x, y]: [u32; 2],
    ) -> Result<u32, RenderError> {
        let gpu = &self.gpu;
        gpu.queue
            .write_buffer(&self.resources.dispatch, 0, bytemuck::bytes_of(uniform));
        gpu.scoped("tracing", 0, || {
            let mut encoder = gpu.device.create_command_encoder(&Default::default());
            encoder.clear_buffer(&self.resources.counters, 0, None);
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("holovol trace"),
                timestamp_writes: None,
            });
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, &self.bands[band].bind_groups[queue], &[]);
            pass.dispatch_workgroups(x, y, 1);
            drop(pass);
            gpu.queue.submit([encoder.finish()]);
        })?;
        let bytes = gpu.read_buffer(
            "counters",
            &self.resources.counters,
            size_of::<GpuCounters>() as u64,
        )?;
        let counted: GpuCounters = bytemuck::pod_read_unaligned(&bytes);
        self.count(counted);
        Ok(counted.saved_paths.min(QUEUE_CAPACITY))
    }
}

impl Tracer {
    /// Looks the field up at random places and nothing else; returns lookups per second.
    ///
    /// # Errors
    /// If the device is lost.
    pub fn fetch_rate(&mut self, lanes: u32, lookups_per_lane: u32) -> Result<f64, RenderError> {
        let uniform = DispatchUniform {
            budget: lookups_per_lane,
            ..DispatchUniform::zeroed()
        };
        let groups = lanes.div_ceil(WORKGROUP_SIZE);
        let layout = &self.layout;
        let pipeline = self.gpu.pipeline(&FETCH, &self.defs, "fetch", layout)?;
        // The first dispatch may compile.
        self.submit(&DispatchUniform::zeroed(), &pipeline, (0, 0), [1, 1])?;
        let started = Instant::now();
        self.submit(&uniform, &pipeline, (0, 0), [groups, 1])?;
        let lookups = f64::from(groups * WORKGROUP_SIZE) * f64::from(lookups_per_lane);
        Ok(lookups / started.elapsed().as_secs_f64())
    }

    fn count(&mut self, counted: GpuCounters) {
        let total = &mut self.counters;
        total.majorant_violations += u64::from(counted.majorant_violations);
        total.nonfinite_samples += u64::from(counted.nonfinite_samples);
        total.lookups += u64::from(counted.lookups);
        total.cells += u64::from(counted.cells);
        total.covered_samples += u64::from(counted.covered_samples);
    }
}
