//! What a tracer tells of its images, and what other kernels need of it.

use glam::DMat4;

use super::{FrameImage, FrameTracer, Matter};
use crate::light_grid::FreshLight;
use crate::trace::Surroundings;
use crate::{Counters, Medium, RenderError};

impl FrameTracer {
    /// What the kernels counted, a few frames ago.
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// The medium.
    pub fn medium(&self) -> &Medium {
        &self.medium
    }

    /// A view's image; `None` until it has samples. What was traced last stays until the next image
    /// begins.
    pub fn image(&self, slot: usize) -> Option<FrameImage> {
        let slot = self.slots.get(slot)?;
        let view = slot.view?;
        (slot.samples > 0).then_some(FrameImage {
            first_pixel: slot.first_pixel,
            size: view.size,
            samples: slot.samples,
            view,
        })
    }

    /// Whether a view's image is of the present medium and light; while kernels are compiled it may
    /// be of the former.
    pub fn is_current(&self, slot: usize) -> bool {
        self.slots.get(slot).is_some_and(|slot| !slot.is_stale)
    }

    /// Where the volume was when a view's image began: metres from unit-cube coordinates.
    pub fn image_placement(&self, slot: usize) -> DMat4 {
        let slot = self.slots.get(slot);
        slot.map_or(self.medium.world_from_unit_cube, |slot| {
            slot.world_from_unit_cube
        })
    }

    /// The largest image that a view may have; 0 × 0 where there is no such view.
    pub(crate) fn room(&self, slot: usize) -> [u32; 2] {
        self.slots.get(slot).map_or([0; 2], |slot| slot.room)
    }

    /// Sums of all images: two vectors per pixel of premultiplied radiance and opacity.
    pub fn accumulators(&self) -> &wgpu::Buffer {
        &self.buffers.accumulators
    }

    /// The environment's dominant light, in its map's frame.
    pub(crate) fn sun(&self) -> Option<crate::denoise::Sun> {
        self.environment.sun()
    }

    /// What this frame's samples have found of light.
    pub(crate) fn fresh_light(&self) -> Option<&FreshLight> {
        self.fresh_light.as_ref()
    }

    /// What other kernels need in order to look at the volume as the tracer does.
    pub(crate) fn matter(&self) -> Matter<'_> {
        Matter {
            volume: &self.volume,
            majorants: &self.majorants,
            buffers: &self.buffers,
            options: &self.options,
            surroundings: Surroundings {
                constant_environment: self.environment.is_constant(),
                has_density: self.environment.has_density(),
                slices: self.volume.slices,
                mesh_depth: self.slots.iter().any(|slot| slot.mesh_depth.is_some()),
                sample_shares: false,
                light_grid: self.fresh_light.is_some(),
            },
            mesh_depth: self.buffers.mesh_depth(self.bound_mesh_depth.as_ref()),
        }
    }

    /// Waits until its kernels are compiled: for tests and servers.
    pub fn wait_for_kernels(&self) {
        self.kernels.wait();
    }

    /// Traces with the variant that serves until the right one is compiled.
    #[cfg(any(test, feature = "testing"))]
    #[doc(hidden)]
    pub fn use_general_kernels(&mut self, only: bool) {
        self.general_only = only;
    }

    /// Splits frames into dispatches of about so many samples.
    #[cfg(any(test, feature = "testing"))]
    #[doc(hidden)]
    pub fn split_at(&mut self, samples: u64) {
        self.samples_per_dispatch = samples;
    }

    /// Reads a view's image back and waits for it: for tests and servers.
    ///
    /// # Errors
    /// If the device is lost.
    pub fn read_image(&self, slot: usize) -> Result<Vec<[f32; 4]>, RenderError> {
        let Some(image) = self.image(slot) else {
            return Ok(Vec::new());
        };
        let buffer = &self.buffers.accumulators;
        let bytes = self.gpu.read_buffer("the image", buffer, buffer.size())?;
        let sums: Vec<[[f32; 4]; 2]> = bytemuck::pod_collect_to_vec(&bytes);
        let count = f64::from(image.samples);
        let first = image.first_pixel as usize;
        let pixels = image.size[0] as usize * image.size[1] as usize;
        let mean = |[a, b]: &[[f32; 4]; 2]| {
            std::array::from_fn(|c| ((f64::from(a[c]) + f64::from(b[c])) / count) as f32)
        };
        Ok(sums[first..first + pixels].iter().map(mean).collect())
    }
}
