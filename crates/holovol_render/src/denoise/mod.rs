//! Takes the noise out of a few samples per pixel: across neighbours, frames and eyes.
//!
//! [`Denoiser::record`] follows [`FrameTracer::record`] in the same encoder; each frame's samples
//! must be that frame's alone ([`ViewFrame::restart`](crate::ViewFrame::restart)). Modes:
//! [`DenoiseMode::Holovol`] is consistent: a resting view converges to what the tracer converges
//! to; in motion it is biased. [`DenoiseMode::Paper`] is Cheng et al. 2023 as printed, biased
//! always. docs/denoising.md explains both and says what they cost.

#[cfg(any(test, feature = "testing"))]
pub mod cpu;
mod passes;
mod settings;
mod uniforms;

use std::collections::HashMap;

use bytemuck::Zeroable;
use glam::DMat4;
use wgpu::BindingResource as Resource;
use wgpu::BufferUsages as Usage;

use crate::layout::{storage, texture_2d_array, texture_3d, uniform};
use crate::shader::{ShaderDefs, ShaderFile, shader_file};
use crate::trace::shader_defs;
use crate::{FrameImage, FrameTracer, Gpu, Interpolation, Medium, RenderError, View};
use passes::Passes;
pub(crate) use passes::pass_defs;
#[cfg(test)]
pub(crate) use passes::{HOLOVOL, PAPER};
pub use settings::{DenoiseMode, DenoiseSettings, PaperSettings};
use uniforms::{DenoiseUniform, EyeUniform, History, projection};

pub(crate) const GUIDES: ShaderFile = shader_file!("guides/guides.wgsl");

/// Pixels along a side of a tile: those of a workgroup.
const TILE: u32 = 8;
/// Frames after which the filter's weight at rest has fallen to a half at most.
const FADE_FRAMES: u32 = 512;
/// Vectors of `state` per pixel, words of `keys` and pairs of `counts`; vectors of a tile.
const STATE: u64 = 5;
const KEYS: u64 = 3;
const COUNTS: u64 = 3;
const TILES: u64 = 7 + 3 * TILE as u64;
/// A change of light T leaves at most this · (1 − T)/T frames: 0.28 frames of 0.85. More would be
/// seen as a ghost.
const KEPT_FRAMES: f32 = 1.6;
/// What an edit of the medium counts for.
const EDIT: f32 = 0.85;

/// One frame to denoise.
#[derive(Clone, Copy, Debug)]
pub struct DenoiseFrame<'a> {
    /// Slots of the tracer: one, or the left and the right eye.
    pub slots: &'a [usize],
    /// Change of illumination T since the last frame, 0 … 1: 0 none, 1 another light. Edits of the
    /// medium are noticed without it.
    pub light_change: f32,
    /// Forget all frames before: after a camera cut.
    pub reset: bool,
}

/// What was there in the last frame.
#[derive(Clone, Debug)]
struct Before {
    views: Vec<View>,
    medium: Medium,
}

/// Denoises the images of one [`FrameTracer`].
pub struct Denoiser {
    gpu: Gpu,
    settings: DenoiseSettings,
    passes: Passes,
    guides: HashMap<ShaderDefs, (wgpu::BindGroupLayout, wgpu::ComputePipeline)>,
    buffers: Option<Buffers>,
    before: Option<Before>,
    half: u32,
    tile_half: u32,
}

struct Buffers {
    sizes: Vec<[u32; 2]>,
    uniform: wgpu::Buffer,
    state: wgpu::Buffer,
    keys: wgpu::Buffer,
    counts: wgpu::Buffer,
    tiles: wgpu::Buffer,
    output: wgpu::Buffer,
}

impl Denoiser {
    /// Compiles the passes of a mode; that of the guides is compiled with the first frame.
    ///
    /// # Errors
    /// If the device fails.
    pub fn new(gpu: &Gpu, settings: DenoiseSettings) -> Result<Self, RenderError> {
        let passes = Passes::new(gpu, settings.mode, settings.pass_radius(), None)?;
        Ok(Self {
            gpu: gpu.clone(),
            settings,
            passes,
            guides: HashMap::new(),
            buffers: None,
            before: None,
            half: 0,
            tile_half: 0,
        })
    }

    /// Forgets all frames.
    pub fn reset(&mut self) {
        self.before = None;
    }

    /// Records the passes for images that the tracer has recorded samples for in this encoder.
    ///
    /// Images that have changed their size, or another number of eyes, begin anew.
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
        let sizes: Vec<_> = images.iter().map(|image| image.size).collect();
        if self.buffers.as_ref().is_none_or(|b| b.sizes != sizes) {
            self.before = None;
            self.buffers = None;
            self.buffers = Some(Buffers::new(&self.gpu, &sizes)?);
        }
        if frame.reset {
            self.before = None;
        }
        let medium = tracer.medium();
        let same = self.is_same(&images, medium) && frame.light_change <= 0.0;
        if !same {
            self.half = 1 - self.half;
        }
        self.tile_half = 1 - self.tile_half;
        let uniform = self.uniform(&images, frame, medium, same);
        let guides = self.guides_pipeline(tracer)?;
        let Some(buffers) = &self.buffers else {
            return Ok(());
        };
        let bytes = bytemuck::bytes_of(&uniform);
        self.gpu.queue.write_buffer(&buffers.uniform, 0, bytes);
        self.before = Some(Before {
            views: images.iter().map(|image| image.view).collect(),
            medium: medium.clone(),
        });
        if same {
            return Ok(());
        }
        let (layout, pipeline) = guides;
        let matter = tracer.matter();
        let group = self.gpu.scoped("guides", 0, || {
            let resources = [
                (0, matter.buffers.scene.as_entire_binding()),
                (2, Resource::TextureView(&matter.volume.view)),
                (3, Resource::Sampler(&matter.buffers.field_sampler)),
                (4, Resource::TextureView(&matter.majorants.view)),
                (5, matter.majorants.occupied.as_entire_binding()),
                (6, matter.buffers.points.as_entire_binding()),
                (14, matter.buffers.views.as_entire_binding()),
                (16, buffers.uniform.as_entire_binding()),
                (17, buffers.state.as_entire_binding()),
                (18, buffers.keys.as_entire_binding()),
            ];
            self.gpu
                .numbered_group("holovol guides", &layout, resources)
        })?;
        let mut pass = compute_pass(encoder, "holovol guides");
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &group, &[]);
        let [x, y] = workgroups(&sizes);
        pass.dispatch_workgroups(x, y, sizes.len() as u32);
        Ok(())
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
        let Some(buffers) = &self.buffers else {
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
        ];
        self.passes
            .record(&self.gpu, encoder, &buffers.sizes, resources)
    }

    fn is_same(&self, images: &[FrameImage], medium: &Medium) -> bool {
        self.before.as_ref().is_some_and(|before| {
            before.medium == *medium
                && before.views.len() == images.len()
                && before.views.iter().zip(images).all(|(a, b)| *a == b.view)
        })
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
        let mut change = frame.light_change.clamp(0.0, 1.0);
        let mut moved = DMat4::IDENTITY;
        if let Some(before) = &self.before {
            moved = before.medium.world_from_unit_cube * medium.world_from_unit_cube.inverse();
            if is_edit(&before.medium, medium) {
                change = change.max(EDIT);
            }
        }
        let kept = if change > 0.0 {
            KEPT_FRAMES * (1.0 - change) / change
        } else {
            f32::INFINITY
        };
        let most = if same { f32::MAX } else { settings.max_frames };
        let (mut pixels, mut tiles) = (0, 0);
        for (i, image) in images.iter().enumerate() {
            let mut eye = EyeUniform::new(&image.view);
            let [width, height] = image.size;
            let before = self.before.as_ref().and_then(|before| before.views.get(i));
            let previous = before.and_then(|view| projection(&image.view, view, moved));
            let history = match previous {
                _ if same => History::Same,
                Some(_) => History::Moved,
                None => History::None,
            };
            eye.previous = previous.unwrap_or_default();
            eye.set_turn(moved);
            if let Some(other) = images.get(1 - i.min(1)).filter(|_| images.len() == 2) {
                let other = projection(&image.view, &other.view, DMat4::IDENTITY);
                // A place at depth 0 is nowhere.
                eye.other = other.unwrap_or_default();
            }
            let across = width.div_ceil(TILE);
            eye.image = [width, height, image.first_pixel, pixels];
            eye.frame = [image.samples, history as u32, tiles, across];
            eye.history = [most.min(kept), 1.0, change, 0.0];
            eye.place = [frame.slots[i] as u32, 0, 0, 0];
            uniform.eyes[i] = eye;
            pixels += width * height;
            tiles += across * height.div_ceil(TILE);
        }
        uniform.counts = [images.len() as u32, pixels, tiles, 0];
        let before = if same { self.half } else { 1 - self.half };
        uniform.halves = [self.half, before, self.tile_half, 0];
        settings.fill(&mut uniform);
        uniform
    }

    fn guides_pipeline(
        &mut self,
        tracer: &FrameTracer,
    ) -> Result<(wgpu::BindGroupLayout, wgpu::ComputePipeline), RenderError> {
        /// Definitions that change the march; others would compile it again for nothing.
        const USED: &[&str] = &[
            "CELL_SIZE",
            "TRANSFER_POINTS",
            "UNROLLED_POINTS",
            "HARDWARE_INTERPOLATION",
            "SLICES",
            "CLIP_PLANES",
            "CLIP_PLANES_MAX",
            "VIEWS_MAX",
        ];
        let matter = tracer.matter();
        let mut all = shader_defs(
            &self.gpu,
            tracer.medium(),
            matter.options,
            matter.surroundings,
        );
        let filtered = matter.options.interpolation == Interpolation::Hardware;
        let slices = matter.volume.slices;
        let key: ShaderDefs = all
            .iter()
            .copied()
            .filter(|(name, _)| USED.contains(name))
            .collect();
        if let Some(found) = self.guides.get(&key) {
            return Ok(found.clone());
        }
        all.extend(pass_defs(0));
        let sampler = if filtered {
            wgpu::SamplerBindingType::Filtering
        } else {
            wgpu::SamplerBindingType::NonFiltering
        };
        let field = if slices {
            texture_2d_array(false)
        } else {
            texture_3d(filtered)
        };
        let layout = self.gpu.numbered_layout(
            "holovol guides",
            &[
                (0, uniform()),
                (2, field),
                (3, wgpu::BindingType::Sampler(sampler)),
                (4, texture_3d(false)),
                (5, storage(true)),
                (6, storage(true)),
                (14, uniform()),
                (16, uniform()),
                (17, storage(false)),
                (18, storage(false)),
            ],
        )?;
        let pipeline = self.gpu.pipeline(&GUIDES, &all, "march", &layout)?;
        self.guides.insert(key, (layout.clone(), pipeline.clone()));
        Ok((layout, pipeline))
    }

    /// The denoised images, one after the other: premultiplied radiance and opacity, row by row.
    pub fn output(&self) -> Option<&wgpu::Buffer> {
        self.buffers.as_ref().map(|buffers| &buffers.output)
    }

    /// Reads the denoised images back and waits for them; empty before the first frame.
    ///
    /// # Errors
    /// If the device is lost.
    pub fn read_images(&self) -> Result<Vec<Vec<[f32; 4]>>, RenderError> {
        let Some(buffers) = &self.buffers else {
            return Ok(Vec::new());
        };
        let source = &buffers.output;
        let bytes = self
            .gpu
            .read_buffer("the denoised image", source, source.size())?;
        let mut pixels: &[[f32; 4]] = &bytemuck::pod_collect_to_vec(&bytes);
        let images = buffers.sizes.iter().map(|[width, height]| {
            let (image, rest) = pixels.split_at(*width as usize * *height as usize);
            pixels = rest;
            image.to_vec()
        });
        Ok(images.collect())
    }

    /// The guides of both eyes: depth along the eye's axis and its spread, metres; 0 where nothing
    /// was met.
    ///
    /// # Errors
    /// If the device is lost.
    #[doc(hidden)]
    pub fn read_depths(&self) -> Result<Vec<[f32; 2]>, RenderError> {
        let Some(buffers) = &self.buffers else {
            return Ok(Vec::new());
        };
        let bytes = self
            .gpu
            .read_buffer("the guides", &buffers.keys, buffers.keys.size())?;
        let keys: Vec<[u32; 4]> = bytemuck::pod_collect_to_vec(&bytes);
        let pixels = keys.len() / KEYS as usize;
        let now = self.half as usize * pixels;
        let depth = |words: &[u32; 4]| {
            let spread = half::f16::from_bits(words[3] as u16).to_f32();
            let depth = f32::from_bits(words[2]);
            if f32::from_bits(words[0]) > 0.0 {
                [depth, depth * spread]
            } else {
                [0.0; 2]
            }
        };
        Ok(keys[now..now + pixels].iter().map(depth).collect())
    }

    /// The guides of both eyes: albedo · opacity, and opacity.
    ///
    /// # Errors
    /// If the device is lost.
    #[doc(hidden)]
    pub fn read_albedo(&self) -> Result<Vec<[f32; 4]>, RenderError> {
        let Some(buffers) = &self.buffers else {
            return Ok(Vec::new());
        };
        let bytes = self
            .gpu
            .read_buffer("the guides", &buffers.state, buffers.state.size())?;
        let state: Vec<[f32; 4]> = bytemuck::pod_collect_to_vec(&bytes);
        let pixels = state.len() / STATE as usize;
        Ok(state[2 * pixels..3 * pixels].to_vec())
    }
}

/// Whether light scattered in the old medium says little of the new one. Rotation and scale of the
/// environment are the caller's to judge, the volume's motion is followed.
fn is_edit(before: &Medium, now: &Medium) -> bool {
    let unmoved = Medium {
        world_from_unit_cube: before.world_from_unit_cube,
        environment_rotation_y: before.environment_rotation_y,
        environment_scale: before.environment_scale,
        ..now.clone()
    };
    unmoved != *before
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

impl Buffers {
    fn new(gpu: &Gpu, sizes: &[[u32; 2]]) -> Result<Self, RenderError> {
        let count = |side: u32| {
            let of = |[width, height]: &[u32; 2]| {
                u64::from(width.div_ceil(side)) * u64::from(height.div_ceil(side))
            };
            sizes.iter().map(of).sum::<u64>()
        };
        let (pixels, tiles) = (count(1), count(TILE));
        let bytes = pixels * (16 * (STATE + KEYS + 1) + 8 * COUNTS) + 16 * TILES * tiles;
        let limits = gpu.device.limits();
        let limit = limits
            .max_storage_buffer_binding_size
            .min(limits.max_buffer_size);
        if 16 * STATE * pixels > limit {
            return Err(RenderError::OutOfMemory {
                what: "denoising".into(),
                bytes,
            });
        }
        gpu.scoped("denoising", bytes, || {
            let usage = Usage::STORAGE | Usage::COPY_SRC;
            Self {
                sizes: sizes.to_vec(),
                uniform: gpu.empty(
                    "holovol denoise",
                    size_of::<DenoiseUniform>() as u64,
                    Usage::UNIFORM | Usage::COPY_DST,
                ),
                state: gpu.empty("holovol denoise state", 16 * STATE * pixels, usage),
                keys: gpu.empty("holovol denoise keys", 16 * KEYS * pixels, usage),
                counts: gpu.empty("holovol denoise counts", 8 * COUNTS * pixels, usage),
                tiles: gpu.empty("holovol denoise tiles", 16 * TILES * tiles, usage),
                output: gpu.empty("holovol denoised", 16 * pixels, usage),
            }
        })
    }
}
