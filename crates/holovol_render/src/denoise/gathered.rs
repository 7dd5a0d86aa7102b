//! What a denoiser does with the light that samples have gathered, and what guides know of light.

use glam::DMat3;

use super::light::change_by_motion;
use super::{DenoiseFrame, Denoiser, kept_frames};
use crate::frame::Matter;
use crate::light_grid::LightGrid;
use crate::{FrameTracer, Medium, RenderError};

/// `sun` of common.wgsl, and x and y of `light`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LightGuide {
    pub(super) sun: [f32; 4],
    pub(super) made_of: [f32; 2],
}

/// Of what the grid keeps after a change: a dominant source's hard shadows move through its cells
/// faster than other light.
const KEPT_UNDER_A_SUN: f32 = 0.25;
/// T from which on light in the grid is another than before.
const OTHER_LIGHT: f32 = 0.5;

impl Denoiser {
    /// The tracer's, with the light grid if this denoiser wants one.
    pub(super) fn matter<'a>(&self, tracer: &'a FrameTracer) -> Matter<'a> {
        let mut matter = tracer.matter();
        matter.surroundings.light_grid &= self.settings.wants_light();
        matter
    }

    /// Has a light grid if the tracer gathers light for it and there is room, and none if not.
    pub(super) fn prepare_light(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        tracer: &FrameTracer,
    ) {
        let fresh = tracer.fresh_light().filter(|_| self.settings.wants_light());
        let fits = |grid: &LightGrid| fresh.is_some_and(|fresh| grid.fits(fresh));
        if !self.light.as_ref().is_some_and(fits) {
            self.light = None;
            self.light = fresh.and_then(|f| LightGrid::new(&self.gpu, f).ok());
        } else if let Some(grid) = &mut self.light
            && self.forgets_light
        {
            grid.forget(encoder);
        }
        self.forgets_light = false;
    }

    /// Takes what the tracer has found of light into the grid; it has changed by T.
    pub(super) fn settle_light(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        tracer: &FrameTracer,
        change: f32,
    ) -> Result<(), RenderError> {
        let kernel = self.passes.as_ref().and_then(|p| p.settle.as_ref());
        let (Some(grid), Some(fresh), Some(kernel)) =
            (&mut self.light, tracer.fresh_light(), kernel)
        else {
            return Ok(());
        };
        let before = self.before.as_ref();
        let has_sun = before.is_some_and(|before| before.light.made_of[0] > 0.0);
        let kept = if has_sun { KEPT_UNDER_A_SUN } else { 1.0 } * kept_frames(change);
        grid.record_settling(&self.gpu, encoder, kernel, fresh, kept)?;
        if let Some(before) = &mut self.before {
            before.is_other_light = change >= OTHER_LIGHT;
        }
        Ok(())
    }

    /// What guides know of light, by a march that reads the grid or doesn't.
    pub(super) fn light_guide(&self, tracer: &FrameTracer, reads_grid: bool) -> LightGuide {
        let is_known = self.light.as_ref().is_some_and(|grid| grid.is_known);
        let of_grid = if reads_grid && is_known { 1.0 } else { 0.0 };
        let Some(sun) = self.settings.sun(tracer) else {
            return LightGuide {
                sun: [0.0, 0.0, 0.0, of_grid],
                made_of: [0.0, of_grid],
            };
        };
        let turn = DMat3::from_rotation_y(tracer.medium().environment_rotation_y);
        LightGuide {
            sun: (turn * sun.direction).extend(1.0).as_vec4().to_array(),
            made_of: [1.0, of_grid / (sun.part as f32).max(0.25)],
        }
    }

    /// How much light has changed, as T, at places that go with the volume: light comes to them from
    /// elsewhere as it turns, and through other optical depths as it grows.
    pub(super) fn change_inside(&self, frame: &DenoiseFrame<'_>, medium: &Medium) -> f32 {
        self.change(frame, medium)
            .max(change_by_motion(self.moved(medium)))
    }
}
