//! The path tracer for apps that draw frame after frame.
//!
//! A [`FrameTracer`] keeps one volume's majorants, matter and images on a device that may be
//! somebody else's. Each frame [`FrameTracer::record`] puts what is to do into a command encoder of
//! the caller's, for up to [`MAX_VIEWS`] views in one dispatch, and never waits for the device.
//! A view that has not changed gathers further samples; one that has, or whose volume has, begins
//! anew; one that has as many as it wants costs nothing. Paths that outlive their dispatch go on in
//! a further one of the same frame; none is cut. A frame of many samples is split into dispatches
//! that a driver's watchdog lets pass.
//!
//! Uploading a volume ([`GpuVolume::new`]) waits for the device: do it on a worker.

mod kernels;
mod readback;
mod record;
mod report;
mod resume;
mod shares;
mod split;
mod view;

use std::sync::Arc;

pub(crate) use kernels::FrameKernels;
pub use kernels::Kernels;
use readback::Readback;
#[cfg(test)]
pub(crate) use resume::RESUME;
use resume::Resume;
use shares::Shares;
pub use shares::{SHARE_BLOCK, SampleShares};
use split::SAMPLES_PER_DISPATCH;
use view::Slot;
pub use view::{FrameImage, FrameWork, ViewFrame};

use crate::depth::MeshDepth;
use crate::light_grid::FreshLight;
use crate::trace::{
    Buffers, GpuCounters, PIXEL_BYTES, Surroundings, check_medium, check_options, layout,
    shader_defs,
};
use crate::{
    Counters, Gpu, GpuEnvironment, GpuVolume, MAX_VIEWS, MajorantGrid, Medium, RenderError,
    TraceOptions,
};

/// A volume on the device, and how the tracer's kernels are specialised for it.
pub(crate) struct Matter<'a> {
    pub(crate) volume: &'a GpuVolume,
    pub(crate) majorants: &'a MajorantGrid,
    pub(crate) buffers: &'a Buffers,
    pub(crate) options: &'a TraceOptions,
    pub(crate) surroundings: Surroundings,
    /// One texel of it while no mesh is in the way.
    pub(crate) mesh_depth: &'a wgpu::TextureView,
}

/// One volume in an app's frames.
pub struct FrameTracer {
    gpu: Gpu,
    kernels: Arc<Kernels>,
    options: TraceOptions,
    volume: Arc<GpuVolume>,
    majorants: MajorantGrid,
    environment: Arc<GpuEnvironment>,
    medium: Medium,
    layout: wgpu::BindGroupLayout,
    buffers: Buffers,
    /// Remade when what they hold has been replaced.
    bind_groups: Option<[wgpu::BindGroup; 2]>,
    bound_mesh_depth: Option<wgpu::TextureView>,
    shares: Shares,
    fresh_light: Option<FreshLight>,
    resume: Resume,
    slots: Vec<Slot>,
    readback: Readback,
    counters: Counters,
    /// Counts how often an image has begun anew.
    beginnings: u64,
    /// With what they were compiled for: mesh depth, shares of samples, the light grid.
    special_kernels: Option<([bool; 3], FrameKernels)>,
    /// What the parts of a frame that takes several dispatches are told, one after the other.
    parts: Option<wgpu::Buffer>,
    samples_per_dispatch: u64,
    /// For tests.
    general_only: bool,
}

impl FrameTracer {
    /// Prepares a volume; no image yet. Compiles its small kernels here and the tracer on the
    /// worker of `kernels`.
    ///
    /// # Errors
    /// If the medium can't be traced or the device fails.
    pub fn new(
        gpu: &Gpu,
        kernels: Arc<Kernels>,
        volume: Arc<GpuVolume>,
        environment: Arc<GpuEnvironment>,
        medium: Medium,
        options: TraceOptions,
    ) -> Result<Self, RenderError> {
        check_medium(&medium, volume.dims())?;
        check_options(&options)?;
        let majorants = MajorantGrid::new(gpu, &volume, options.cell_size)?;
        let s_from_texel = volume.s_from_texel(medium.window);
        majorants.update(gpu, &medium.transfer_function, s_from_texel)?;
        let layout = layout(gpu, options.interpolation, volume.slices)?;
        let mut buffers = Buffers::new(gpu, 0, &options)?;
        buffers.set_medium(gpu, &medium, &volume, &majorants, &environment)?;
        let resume = Resume::new(gpu, &buffers)?;
        let mut tracer = Self {
            gpu: gpu.clone(),
            kernels,
            options,
            volume,
            majorants,
            environment,
            medium,
            layout,
            buffers,
            bind_groups: None,
            bound_mesh_depth: None,
            shares: Shares::default(),
            fresh_light: None,
            resume,
            slots: Vec::new(),
            readback: Readback::new(gpu, size_of::<GpuCounters>() as u64)?,
            counters: Counters::default(),
            beginnings: 0,
            special_kernels: None,
            parts: None,
            samples_per_dispatch: SAMPLES_PER_DISPATCH,
            general_only: false,
        };
        tracer.kernels(false)?;
        Ok(tracer)
    }

    /// Takes another medium; true if it differs. Majorants are found anew only if extinctions or
    /// window changed.
    ///
    /// # Errors
    /// If it can't be traced (the old one stays) or the device fails.
    pub fn set_medium(&mut self, medium: &Medium) -> Result<bool, RenderError> {
        if *medium == self.medium {
            return Ok(false);
        }
        check_medium(medium, self.volume.dims())?;
        let needs_majorants = medium.window != self.medium.window
            || medium.transfer_function != self.medium.transfer_function;
        if needs_majorants {
            let s_from_texel = self.volume.s_from_texel(medium.window);
            self.majorants
                .update(&self.gpu, &medium.transfer_function, s_from_texel)?;
        }
        self.medium = medium.clone();
        self.upload_medium()?;
        Ok(true)
    }

    /// Takes other light; true if it is another map.
    ///
    /// # Errors
    /// If the device fails.
    pub fn set_environment(
        &mut self,
        environment: &Arc<GpuEnvironment>,
    ) -> Result<bool, RenderError> {
        if Arc::ptr_eq(environment, &self.environment) {
            return Ok(false);
        }
        self.environment = Arc::clone(environment);
        self.upload_medium()?;
        Ok(true)
    }

    fn upload_medium(&mut self) -> Result<(), RenderError> {
        self.bind_groups = None;
        self.special_kernels = None;
        for slot in &mut self.slots {
            slot.is_stale = true;
        }
        self.buffers.set_medium(
            &self.gpu,
            &self.medium,
            &self.volume,
            &self.majorants,
            &self.environment,
        )
    }

    /// Makes room for images of these sizes; all begin anew if the room has to change.
    ///
    /// # Errors
    /// [`RenderError::Scene`] for more than [`MAX_VIEWS`] views or images beyond the device's
    /// buffers, [`RenderError::OutOfMemory`].
    pub fn set_views(&mut self, rooms: &[[u32; 2]]) -> Result<(), RenderError> {
        if self
            .slots
            .iter()
            .map(|slot| slot.room)
            .eq(rooms.iter().copied())
        {
            return Ok(());
        }
        let pixels = |[width, height]: [u32; 2]| u64::from(width) * u64::from(height);
        let total: u64 = rooms.iter().copied().map(pixels).sum();
        let limits = self.gpu.device.limits();
        let limit = limits
            .max_storage_buffer_binding_size
            .min(limits.max_buffer_size);
        if rooms.len() > MAX_VIEWS || PIXEL_BYTES * total > limit {
            return Err(RenderError::Scene {
                field: "camera",
                reason: format!(
                    "{} views of {total} pixels in all: this device takes at most {MAX_VIEWS} \
                     views and {} pixels; lower the resolution scale",
                    rooms.len(),
                    limit / PIXEL_BYTES
                ),
            });
        }
        let buffers = Buffers::new(&self.gpu, total, &self.options)?;
        self.resume.set_buffers(&self.gpu, &buffers)?;
        // Samples of what was drawn go with the buffers; so do paths that were saved.
        self.slots.clear();
        self.buffers = buffers;
        self.upload_medium()?;
        self.shares.set_slots(rooms.len());
        let mut first_pixel = 0;
        self.slots = rooms
            .iter()
            .map(|&room| {
                let slot = Slot::empty(first_pixel, room);
                first_pixel += pixels(room) as u32;
                slot
            })
            .collect();
        Ok(())
    }

    /// Forgets a view's image: what is drawn there next is of somebody else.
    pub fn forget_view(&mut self, slot: usize) {
        if let Some(slot) = self.slots.get_mut(slot) {
            *slot = Slot::empty(slot.first_pixel, slot.room);
        }
    }

    /// Takes how many of its samples each part of a view's image gets; without, each gets all. They
    /// hold for images of their size. Where pixels appear or disappear by it, the view begins anew.
    ///
    /// # Errors
    /// If the device has no room.
    pub fn set_shares(
        &mut self,
        slot: usize,
        shares: Option<&Arc<SampleShares>>,
    ) -> Result<(), RenderError> {
        let view = self.shares.view().cloned();
        if self.shares.set(&self.gpu, slot, shares)?
            && let Some(slot) = self.slots.get_mut(slot)
        {
            slot.is_stale = true;
        }
        if self.shares.view() != view.as_ref() {
            self.bind_groups = None;
        }
        Ok(())
    }

    /// Whether samples also gather light at places of the volume, for denoisers that want it
    /// ([`DenoiseSettings::wants_light`](crate::DenoiseSettings::wants_light)). Costs nothing where
    /// that is so already.
    ///
    /// # Errors
    /// If the device has no room, or the kernels don't compile.
    pub fn gather_light(&mut self, wanted: bool) -> Result<(), RenderError> {
        if wanted != self.fresh_light.is_some() {
            self.fresh_light = None;
            self.bind_groups = None;
            if wanted {
                self.fresh_light = Some(FreshLight::new(&self.gpu, self.volume.texels())?);
                // Begins to compile.
                self.kernels(self.bound_mesh_depth.is_some())?;
            }
        }
        Ok(())
    }

    /// Records a frame's work. Views that are done, and all if nothing is left to do, cost nothing.
    ///
    /// # Errors
    /// If the device fails, or the kernels don't compile.
    ///
    /// # Panics
    /// If a slot doesn't exist, or its view is larger than its room.
    pub fn record(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        views: &[ViewFrame],
        mesh_depth: Option<&MeshDepth>,
    ) -> Result<FrameWork, RenderError> {
        self.poll();
        let mesh_depth = mesh_depth.and_then(MeshDepth::view);
        let ends_at_meshes = mesh_depth.is_some() && views.iter().any(|v| v.mesh_depth.is_some());
        let Some(kernels) = self.kernels(ends_at_meshes)? else {
            self.pass_over(views);
            return Ok(FrameWork {
                is_waiting: true,
                ..Default::default()
            });
        };
        for slot in &mut self.slots {
            slot.uniform.samples = [0; 4];
        }
        for frame in views {
            self.prepare_view(encoder, frame);
        }
        let traces = self.slots.iter().any(Slot::is_traced);
        if !traces {
            return Ok(FrameWork::default());
        }
        if let Some(fresh) = &mut self.fresh_light {
            fresh.clear(encoder);
        }
        let recorded = self.bind(mesh_depth);
        let recorded = recorded.and_then(|()| self.record_dispatches(encoder, &kernels));
        if recorded.is_err() {
            // Samples were counted that nobody made.
            for slot in self.slots.iter_mut().filter(|slot| slot.is_traced()) {
                slot.is_stale = true;
            }
        }
        recorded
    }

    /// A frame goes by without [`Self::record`]: images that it wants anew stay as they are until
    /// they begin, but get no further samples.
    pub fn pass_over(&mut self, views: &[ViewFrame]) {
        for frame in views.iter().filter(|frame| frame.restart) {
            if let Some(slot) = self.slots.get_mut(frame.slot) {
                slot.is_stale = true;
            }
        }
    }

    /// Whether [`Self::record`] would not have to wait for the compiler; asks for what is missing.
    /// `mesh_depth` says whether paths are to end at meshes.
    ///
    /// # Errors
    /// If the kernels don't compile.
    pub fn is_ready(&mut self, mesh_depth: bool) -> Result<bool, RenderError> {
        self.kernels(mesh_depth).map(|kernels| kernels.is_some())
    }

    /// Whether a view would be given samples.
    pub fn wants(&self, frame: &ViewFrame) -> bool {
        let Some(slot) = self.slots.get(frame.slot) else {
            return false;
        };
        let samples = if slot.begins_with(frame) {
            0
        } else {
            slot.samples
        };
        frame.samples > 0 && samples < frame.max_samples
    }

    /// The variant for the present medium, or one that serves until it is compiled: it gathers no
    /// light.
    fn kernels(&mut self, mesh_depth: bool) -> Result<Option<FrameKernels>, RenderError> {
        let sample_shares = self.shares.are_there();
        let light_grid = self.fresh_light.is_some();
        let wanted = [mesh_depth, sample_shares, light_grid];
        let of = |special: &Option<([bool; 3], FrameKernels)>, wanted| {
            let special = special.as_ref().filter(|_| !self.general_only);
            let (_, kernels) = special.filter(|(compiled_for, _)| *compiled_for == wanted)?;
            Some(kernels.clone())
        };
        if let Some(kernels) = of(&self.special_kernels, wanted) {
            return Ok(Some(kernels));
        }
        let surroundings = Surroundings {
            constant_environment: self.environment.is_constant(),
            has_density: self.environment.has_density(),
            slices: self.volume.slices,
            mesh_depth,
            sample_shares,
            light_grid,
        };
        let get = |medium: &Medium, surroundings| {
            let defs = shader_defs(&self.gpu, medium, &self.options, surroundings);
            self.kernels
                .get(&defs, self.options.interpolation, self.volume.slices)
        };
        let special = get(&self.medium, surroundings)?;
        if let Some(kernels) = special
            && !self.general_only
        {
            self.special_kernels = Some((wanted, kernels.clone()));
            return Ok(Some(kernels));
        }
        if let Some(kernels) = of(&self.special_kernels, [mesh_depth, sample_shares, false]) {
            return Ok(Some(kernels));
        }
        get(
            &Medium::general(),
            Surroundings {
                mesh_depth: true,
                light_grid: false,
                ..surroundings
            },
        )
    }

    /// Takes in what the device has counted.
    fn poll(&mut self) {
        let Some(bytes) = self.readback.poll() else {
            return;
        };
        let counted: GpuCounters = bytemuck::pod_read_unaligned(&bytes);
        self.counters = Counters {
            majorant_violations: u64::from(counted.majorant_violations),
            nonfinite_samples: u64::from(counted.nonfinite_samples),
            continued_paths: 0,
            lookups: u64::from(counted.lookups),
            cells: u64::from(counted.cells),
            covered_samples: u64::from(counted.covered_samples),
        };
    }
}

/// Images of up to so many samples spread them over neighbours, too.
const SPREAD_SAMPLES: u32 = 16;

/// Another for every beginning, so that noise neither repeats in time nor between eyes.
pub(crate) fn beginning_seed(seed: u64, beginning: u64) -> u64 {
    // The golden ratio's bits: multiples of it are far apart.
    seed.wrapping_add(beginning.wrapping_mul(0x9e37_79b9_7f4a_7c15))
}
