//! Takes the noise out of a few samples per pixel: across neighbours, frames and eyes.
//!
//! [`Denoiser::record`] follows [`FrameTracer::record`] in the same encoder; each frame's samples
//! must be that frame's alone ([`ViewFrame::restart`](crate::ViewFrame::restart)). Before that the
//! tracer is told to gather light if the denoiser wants it ([`FrameTracer::gather_light`]). Modes:
//! [`DenoiseMode::Holovol`] is consistent: a resting view converges to what the tracer converges
//! to; in motion it is biased. [`DenoiseMode::Paper`] is Cheng et al. 2023 as printed, biased
//! always. docs/denoising.md explains both and says what they cost.

mod buffers;
#[cfg(any(test, feature = "testing"))]
pub mod cpu;
mod edit;
mod gathered;
mod kernels;
mod light;
mod passes;
mod readback;
mod settings;
mod sun;
mod uniforms;

use std::sync::Arc;

use bytemuck::Zeroable;
use glam::DMat4;

use crate::light_grid::LightGrid;
use crate::shader::{ShaderFile, shader_file};
use crate::{FrameImage, FrameTracer, Gpu, Medium, RenderError, View};
use buffers::Buffers;
use edit::is_edit;
use gathered::LightGuide;
pub use kernels::DenoiseKernels;
use kernels::GuideKernel;
pub use light::{LightChange, environment_change};
use passes::Passes;
pub(crate) use passes::pass_defs;
#[cfg(test)]
pub(crate) use passes::{HOLOVOL, PAPER};
pub use settings::{DenoiseMode, DenoiseSettings, PaperSettings};
pub(crate) use sun::Sun;
use uniforms::{DenoiseUniform, EyeUniform, History, projection};

pub(crate) const GUIDES: ShaderFile = shader_file!("guides/guides.wgsl");

/// Pixels along a side of a tile: those of a workgroup.
const TILE: u32 = 8;
/// Frames after which the filter's weight at rest has fallen to a half at most.
const FADE_FRAMES: u32 = 512;
/// Vectors of `state` and of `lights` per pixel, words of `keys` and pairs of `counts`; vectors of a
/// tile.
const STATE: u64 = 2;
const LIGHTS: u64 = 3;
const KEYS: u64 = 3;
const COUNTS: u64 = 3;
const TILES: u64 = 17 + 6 * TILE as u64;
/// A change of light T leaves at most this · (1 − T)/T frames: 0.21 frames of 0.85. More would be
/// seen as a ghost.
const KEPT_FRAMES: f32 = 1.2;
/// What an edit of the medium counts for.
const EDIT: f32 = 0.85;

/// One frame to denoise.
#[derive(Clone, Copy, Debug)]
pub struct DenoiseFrame<'a> {
    /// Slots of the tracer: one, or the left and the right eye.
    pub slots: &'a [usize],
    /// Change of illumination T since the last frame, 0 … 1: 0 none, 1 another light;
    /// [`LightChange`] tells it. Edits of the medium are noticed without it.
    pub light_change: f32,
    /// Meshes at which paths end have changed.
    pub meshes_changed: bool,
    /// Factor from radiance to what is seen, 1 being white: darkness counts less.
    pub exposure: f32,
    /// Forget all frames before: after a camera cut.
    pub reset: bool,
}

/// What was there in the last frame.
#[derive(Clone, Debug)]
struct Before {
    views: Vec<View>,
    medium: Medium,
    light: LightGuide,
    /// The grid that it was of holds other light by now.
    is_other_light: bool,
}

/// Denoises the images of one [`FrameTracer`].
pub struct Denoiser {
    gpu: Gpu,
    kernels: Arc<DenoiseKernels>,
    settings: DenoiseSettings,
    passes: Option<Arc<Passes>>,
    buffers: Option<Buffers>,
    light: Option<LightGrid>,
    forgets_light: bool,
    before: Option<Before>,
    /// Samples of every pixel since something has changed.
    gathered: u32,
    half: u32,
    tile_half: u32,
}

impl Denoiser {
    /// A denoiser that has seen nothing; it needs no memory yet.
    pub fn new(gpu: &Gpu, kernels: Arc<DenoiseKernels>, settings: DenoiseSettings) -> Self {
        Self {
            gpu: gpu.clone(),
            kernels,
            settings,
            passes: None,
            buffers: None,
            light: None,
            forgets_light: false,
            before: None,
            gathered: 0,
            half: 0,
            tile_half: 0,
        }
    }

    /// As it was made.
    pub fn settings(&self) -> &DenoiseSettings {
        &self.settings
    }

    /// Forgets all frames.
    pub fn reset(&mut self) {
        self.before = None;
        self.gathered = 0;
        self.forgets_light = true;
    }

    /// Whether [`Denoiser::record`] would not have to wait for the compiler; asks for what is
    /// missing. A march that fits any medium serves until the right one is there.
    ///
    /// # Errors
    /// If something doesn't compile.
    pub fn is_ready(&mut self, tracer: &FrameTracer) -> Result<bool, RenderError> {
        Ok(self.compiled_passes()?.is_some() && self.compiled_guides(tracer)?.0.is_some())
    }

    /// Waits for the compiler, so that all frames are made by the same kernels: for tests and
    /// servers.
    ///
    /// # Errors
    /// If something doesn't compile.
    pub fn wait_for_kernels(&mut self, tracer: &FrameTracer) -> Result<(), RenderError> {
        self.compiled_passes()?;
        let matter = self.matter(tracer);
        self.kernels.guides(tracer.medium(), &matter, false)?;
        self.kernels.wait();
        self.compiled_passes().map(|_| ())
    }

    fn compiled_passes(&mut self) -> Result<Option<Arc<Passes>>, RenderError> {
        if self.passes.is_none() {
            self.passes = self.kernels.passes(&self.settings)?;
        }
        Ok(self.passes.clone())
    }

    /// The march, and whether it reads the light grid.
    fn compiled_guides(
        &self,
        tracer: &FrameTracer,
    ) -> Result<(Option<GuideKernel>, bool), RenderError> {
        let matter = self.matter(tracer);
        let general = || self.kernels.guides(tracer.medium(), &matter, true);
        match self.kernels.guides(tracer.medium(), &matter, false)? {
            None => Ok((general()?, false)),
            special => Ok((special, matter.surroundings.light_grid)),
        }
    }

    /// Records the passes for images that the tracer has recorded samples for in this encoder.
    /// Waits for the compiler unless [`Denoiser::is_ready`] has said that it need not.
    ///
    /// Images of another size than the last keep their history as long as they fit the tracer's
    /// room for them; another number of eyes begins anew.
    ///
    /// # Errors
    /// [`RenderError::Scene`] for no eye, more than two, or one without samples;
    /// [`RenderError::OutOfMemory`]; or if the device fails.
    pub fn record(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        tracer: &FrameTracer,
        frame: &DenoiseFrame<'_>,
    ) -> Result<(), RenderError> {
        self.record_guides(encoder, tracer, frame)?;
        self.record_filter(encoder, tracer)
    }

    /// The first part of [`Denoiser::record`], so that it can be timed: the march for guides.
    ///
    /// # Errors
    /// As [`Denoiser::record`].
    #[doc(hidden)]
    pub fn record_guides(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        tracer: &FrameTracer,
        frame: &DenoiseFrame<'_>,
    ) -> Result<(), RenderError> {
        let images = images(tracer, frame.slots)?;
        if !self.is_ready(tracer)? {
            self.wait_for_kernels(tracer)?;
        }
        let (guides, reads_grid) = self.compiled_guides(tracer)?;
        let sizes: Vec<_> = images.iter().map(|image| image.size).collect();
        let eyes = self.before.as_ref().map(|before| before.views.len());
        if frame.reset || eyes != Some(images.len()) {
            self.reset();
        }
        let rooms: Vec<_> = frame.slots.iter().map(|&slot| tracer.room(slot)).collect();
        match &mut self.buffers {
            Some(buffers) if buffers.fits(&sizes, &rooms) => buffers.sizes.clone_from(&sizes),
            _ => {
                // The old ones make room first.
                self.reset();
                self.buffers = None;
                self.buffers = Some(Buffers::new(&self.gpu, &sizes, &rooms)?);
            }
        }
        let medium = tracer.medium();
        let views: Vec<_> = images.iter().map(|image| image.view).collect();
        self.prepare_light(encoder, tracer);
        let light = self.light_guide(tracer, reads_grid);
        let before = self.before.as_ref();
        let is_same_guide = before
            .is_some_and(|before| before.light.made_of == light.made_of && !before.is_other_light);
        let same = self.is_same(&views, medium)
            && before.is_some_and(|before| before.light.sun[..3] == light.sun[..3])
            && frame.light_change <= 0.0
            && !frame.meshes_changed;
        if !same {
            self.half = 1 - self.half;
            self.gathered = 0;
        }
        self.tile_half = 1 - self.tile_half;
        let samples = images.iter().map(|image| image.samples).min();
        let before = self.gathered;
        self.gathered = before.saturating_add(samples.unwrap_or(0));
        // At rest guides stay, but for what the light grid has learnt each time that samples double.
        let has_learnt = light.made_of[1] > 0.0
            && (!is_same_guide || self.gathered.max(1).ilog2() != before.max(1).ilog2());
        let marches = !same || has_learnt;
        let mut uniform = self.uniform(&images, frame, medium, same);
        let [of_sun, of_grid] = light.made_of;
        let grid = self.light.as_ref();
        let texels_per_cell = grid.map_or(0.0, |grid| grid.texels_per_cell as f32);
        uniform.sun = light.sun;
        uniform.light = [of_sun, of_grid, f32::from(is_same_guide), texels_per_cell];
        uniform.halves[3] = u32::from(marches);
        let change_inside = self.change_inside(frame, medium);
        let (Some(buffers), Some(guides)) = (&self.buffers, guides) else {
            return Ok(());
        };
        let bytes = bytemuck::bytes_of(&uniform);
        self.gpu.queue.write_buffer(&buffers.uniform, 0, bytes);
        self.before = Some(Before {
            views,
            medium: medium.clone(),
            light,
            is_other_light: false,
        });
        if marches {
            let written = [&buffers.uniform, &buffers.lights, &buffers.keys];
            let light = self.light.as_ref().map(|grid| &grid.smoothed);
            let matter = self.matter(tracer);
            guides.record(&self.gpu, encoder, &matter, &sizes, written, light)?;
        }
        // Only now: the guide must not know this frame's noise.
        self.settle_light(encoder, tracer, change_inside)
    }

    /// The second part of [`Denoiser::record`].
    ///
    /// # Errors
    /// As [`Denoiser::record`].
    #[doc(hidden)]
    pub fn record_filter(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        tracer: &FrameTracer,
    ) -> Result<(), RenderError> {
        let (Some(buffers), Some(passes)) = (&self.buffers, &self.passes) else {
            return Ok(());
        };
        let resources = [
            &buffers.uniform,
            &buffers.state,
            &buffers.keys,
            &buffers.counts,
            &buffers.tiles,
            tracer.accumulators(),
            &buffers.output,
            &buffers.lights,
        ];
        passes.record(&self.gpu, encoder, &buffers.sizes, resources)
    }

    /// Samples of every pixel since images, medium, light or meshes have changed.
    pub fn samples(&self) -> u32 {
        self.gathered
    }

    /// [`Denoiser::samples`] if these are still the views and the medium; else 0. Light and meshes
    /// are the caller's to know.
    pub fn gathered(&self, views: &[View], medium: &Medium) -> u32 {
        if self.is_same(views, medium) {
            self.gathered
        } else {
            0
        }
    }

    fn is_same(&self, views: &[View], medium: &Medium) -> bool {
        self.before
            .as_ref()
            .is_some_and(|before| before.medium == *medium && before.views == views)
    }

    /// Where a place of this frame was in the last.
    fn moved(&self, medium: &Medium) -> DMat4 {
        let before = self.before.as_ref().map(|before| &before.medium);
        before.map_or(DMat4::IDENTITY, |before| {
            before.world_from_unit_cube * medium.world_from_unit_cube.inverse()
        })
    }

    /// How much light has changed since the last frame, as T.
    fn change(&self, frame: &DenoiseFrame<'_>, medium: &Medium) -> f32 {
        // What isn't a number is taken for any change.
        let change = match frame.light_change.is_nan() {
            true => 1.0,
            false => frame.light_change.clamp(0.0, 1.0),
        };
        let before = self.before.as_ref().map(|before| &before.medium);
        match before.is_some_and(|before| is_edit(before, medium)) {
            true => change.max(EDIT),
            false => change,
        }
    }

    fn uniform(
        &self,
        images: &[FrameImage],
        frame: &DenoiseFrame<'_>,
        medium: &Medium,
        same: bool,
    ) -> DenoiseUniform {
        let settings = &self.settings;
        let mut uniform = DenoiseUniform::zeroed();
        let change = self.change(frame, medium);
        let moved = self.moved(medium);
        let kept = kept_frames(change);
        let most = if same { f32::MAX } else { settings.max_frames };
        let before = self.before.as_ref().map_or(&[][..], |before| &before.views);
        let sizes_before: Vec<_> = before.iter().map(|view| view.size).collect();
        let is_resized = !images
            .iter()
            .map(|image| image.size)
            .eq(sizes_before.iter().copied());
        let (mut pixels, mut tiles, mut pixels_before) = (0, 0, 0);
        for (i, image) in images.iter().enumerate() {
            let mut eye = EyeUniform::new(&image.view);
            let [width, height] = image.size;
            let previous = before
                .get(i)
                .and_then(|view| projection(&image.view, view, moved));
            let history = match previous {
                _ if same => History::Same,
                Some(_) => History::Moved,
                None => History::None,
            };
            eye.previous = previous.unwrap_or_default();
            eye.set_turn(moved);
            if let Some(before) = before.get(i) {
                eye.set_before(&image.view, before, moved);
            }
            if let Some(other) = images.get(1 - i.min(1)).filter(|_| images.len() == 2) {
                let other = projection(&image.view, &other.view, DMat4::IDENTITY);
                // A place at depth 0 is nowhere.
                eye.other = other.unwrap_or_default();
            }
            let across = width.div_ceil(TILE);
            eye.image = [width, height, image.first_pixel, pixels];
            eye.frame = [image.samples, history as u32, tiles, across];
            let remembers = if is_resized { 0.0 } else { 1.0 };
            eye.history = [most.min(kept), 1.0, change, remembers];
            let [width_before, height_before] = sizes_before.get(i).copied().unwrap_or_default();
            let slot = frame.slots[i] as u32;
            eye.place = [slot, width_before, height_before, pixels_before];
            pixels_before += width_before * height_before;
            uniform.eyes[i] = eye;
            pixels += width * height;
            tiles += across * height.div_ceil(TILE);
        }
        let [pixels, tiles] = self.buffers.as_ref().map_or([0; 2], |b| b.room);
        uniform.counts = [images.len() as u32, pixels, tiles, 0];
        let before = if same { self.half } else { 1 - self.half };
        uniform.halves = [self.half, before, self.tile_half, 0];
        settings.fill(&mut uniform, frame.exposure);
        uniform
    }

    /// The denoised images, one after the other: premultiplied radiance and opacity, row by row.
    pub fn output(&self) -> Option<&wgpu::Buffer> {
        self.buffers.as_ref().map(|buffers| &buffers.output)
    }

    /// What the images are of; `None` before the first frame.
    pub fn medium(&self) -> Option<&Medium> {
        self.before.as_ref().map(|before| &before.medium)
    }

    /// An eye's image in [`Denoiser::output`]; `None` before the first frame.
    pub fn image(&self, eye: usize) -> Option<FrameImage> {
        let view = *self.before.as_ref()?.views.get(eye)?;
        let sizes = &self.buffers.as_ref()?.sizes;
        Some(FrameImage {
            first_pixel: sizes.iter().take(eye).map(|[w, h]| w * h).sum(),
            size: *sizes.get(eye)?,
            samples: 1,
            view,
        })
    }
}

/// Frames of history that a change of light T leaves.
fn kept_frames(change: f32) -> f32 {
    if change > 0.0 {
        KEPT_FRAMES * (1.0 - change) / change
    } else {
        f32::INFINITY
    }
}

fn images(tracer: &FrameTracer, slots: &[usize]) -> Result<Vec<FrameImage>, RenderError> {
    let refuse = |reason: String| RenderError::Scene {
        field: "camera",
        reason,
    };
    if !(1..=2).contains(&slots.len()) {
        return Err(refuse(format!(
            "{} eyes to denoise together: expected one or two",
            slots.len()
        )));
    }
    slots
        .iter()
        .map(|&slot| {
            tracer
                .image(slot)
                .filter(|_| tracer.is_current(slot))
                .ok_or_else(|| refuse(format!("view {slot} has no samples to denoise")))
        })
        .collect()
}

fn compute_pass<'a>(
    encoder: &'a mut wgpu::CommandEncoder,
    label: &'static str,
) -> wgpu::ComputePass<'a> {
    encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
        label: Some(label),
        timestamp_writes: None,
    })
}

/// Enough for the larger of the images.
fn workgroups(sizes: &[[u32; 2]]) -> [u32; 2] {
    [0, 1].map(|i| {
        let largest = sizes.iter().map(|size| size[i]).max().unwrap_or(0);
        largest.div_ceil(TILE)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_eyes_of_a_headset_fit_what_every_device_binds() {
        let pixels = 2 * 1440 * 936;
        let largest = (16 * STATE.max(LIGHTS).max(KEYS)).max(8 * COUNTS);
        let limit = wgpu::Limits::default().max_storage_buffer_binding_size;
        assert!(largest * pixels <= limit, "{largest} bytes of a pixel");
    }
}
