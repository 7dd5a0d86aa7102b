use bytemuck::Zeroable;
use glam::DMat4;

use crate::View;
use crate::depth::DepthLayers;
use crate::trace::ViewUniform;

/// What a view wants of a frame.
#[derive(Clone, Copy, Debug)]
pub struct ViewFrame {
    /// Which of the images that [`FrameTracer::set_views`] made room for.
    pub slot: usize,
    /// From where; its size may be less than the room.
    pub view: View,
    /// Samples to add to every pixel.
    pub samples: u32,
    /// Samples at which the image is done. Up to 16 are spread over blocks of 16 × 16 pixels, so that
    /// a mean over neighbours, as a denoiser takes it, has less noise; more of them over each pixel.
    pub max_samples: u32,
    /// Begin anew though the view is the same: something else has changed.
    pub restart: bool,
    /// Where paths end at meshes, if any is in the way.
    pub mesh_depth: Option<DepthLayers>,
}

/// What a frame did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameWork {
    /// Dispatches that were recorded.
    pub dispatches: u32,
    /// Samples that were added: pixels times samples of each.
    pub samples: u64,
    /// The kernels were not compiled yet: nothing could be done.
    pub is_waiting: bool,
}

/// One view's image in [`FrameTracer::accumulators`].
#[derive(Clone, Copy, Debug)]
pub struct FrameImage {
    /// Its first pixel in the buffer.
    pub first_pixel: u32,
    /// Pixels across and down.
    pub size: [u32; 2],
    /// Samples of every pixel so far.
    pub samples: u32,
    /// What it was seen from.
    pub view: View,
}

/// What is kept of a view.
#[derive(Clone, Debug)]
pub(super) struct Slot {
    pub(super) first_pixel: u32,
    pub(super) room: [u32; 2],
    pub(super) view: Option<View>,
    /// Of what is no more: shown until the next image begins.
    pub(super) is_stale: bool,
    /// Where the volume was when the image began.
    pub(super) world_from_unit_cube: DMat4,
    pub(super) mesh_depth: Option<DepthLayers>,
    pub(super) samples: u32,
    pub(super) uniform: ViewUniform,
}

impl Slot {
    pub(super) fn empty(first_pixel: u32, room: [u32; 2]) -> Self {
        Self {
            first_pixel,
            room,
            view: None,
            is_stale: false,
            world_from_unit_cube: DMat4::IDENTITY,
            mesh_depth: None,
            samples: 0,
            uniform: ViewUniform::zeroed(),
        }
    }

    /// Whether a frame's image is another one than this.
    pub(super) fn begins_with(&self, frame: &ViewFrame) -> bool {
        frame.restart
            || self.is_stale
            || self.view != Some(frame.view)
            || self.mesh_depth.map(DepthLayers::shape) != frame.mesh_depth.map(DepthLayers::shape)
    }

    pub(super) fn is_traced(&self) -> bool {
        self.uniform.samples[1] > self.uniform.samples[0]
    }
}
