//! Depth of what a view sees, for headsets' compositors.

use bevy::prelude::*;
use bevy::render::sync_world::MainEntity;
use holovol_render::{RenderError, ViewDepth, ViewDepthTarget, wgpu};

use super::prepare::VolumeGpu;

/// Draws it, once it is asked for; made anew with the device.
#[derive(Resource, Default)]
pub(crate) struct ViewDepths(Option<ViewDepth>);

impl ViewDepths {
    /// A frame begins.
    pub(crate) fn begin_frame(&mut self) {
        if let Some(drawer) = &mut self.0 {
            drawer.begin_frame();
        }
    }

    /// Draws the depth of a view as it was traced in this frame; false if there is nothing to draw
    /// with. `meshes` is the depth of its opaque meshes.
    pub(crate) fn draw(
        &mut self,
        gpu: &VolumeGpu,
        encoder: &mut wgpu::CommandEncoder,
        camera: MainEntity,
        meshes: Option<&wgpu::TextureView>,
        target: &ViewDepthTarget<'_>,
    ) -> Result<bool, RenderError> {
        let Some(inner) = &gpu.0 else {
            return Ok(false);
        };
        let drawer = match &mut self.0 {
            Some(drawer) => drawer,
            empty => empty.insert(ViewDepth::new(&inner.gpu)?),
        };
        let planned = inner.plan.iter().filter(|planned| planned.camera == camera);
        let volumes = planned.filter_map(|planned| {
            let tracer = inner.tracings.get(&planned.key)?.tracer()?;
            let slot = planned.frame.slot;
            // Until the kernels are there, its rays are those of an earlier frame.
            let image = tracer.image(slot)?;
            let is_of_frame = image.view == planned.frame.view && tracer.is_current(slot);
            is_of_frame.then_some((tracer, slot))
        });
        drawer.record(encoder, target, meshes, volumes)?;
        Ok(true)
    }
}
