//! Images and guides read back from the device, for those who wait for them.

use super::{Denoiser, KEYS};
use crate::RenderError;

impl Denoiser {
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
        let depth = |words: &[u32; 4]| {
            let spread = half::f16::from_bits(words[3] as u16).to_f32();
            let depth = f32::from_bits(words[2]);
            if words[0] & 0xffff != 0 {
                [depth, depth * spread]
            } else {
                [0.0; 2]
            }
        };
        Ok(self.read_keys()?.iter().map(depth).collect())
    }

    /// The guides of both eyes: what light is expected to be, but for a factor; also of pixels that
    /// have their guides from those around.
    ///
    /// # Errors
    /// If the device is lost.
    #[doc(hidden)]
    pub fn read_sunlight(&self) -> Result<Vec<f32>, RenderError> {
        let light = |words: &[u32; 4]| half::f16::from_bits((words[0] >> 16) as u16).to_f32().abs();
        Ok(self.read_keys()?.iter().map(light).collect())
    }

    /// The light grid: mean light in the environment's mean radiance, and picks, x fastest; empty
    /// without one.
    ///
    /// # Errors
    /// If the device is lost.
    #[doc(hidden)]
    pub fn read_light(&self, smoothed: bool) -> Result<Vec<[f32; 2]>, RenderError> {
        let grid = self
            .light
            .as_ref()
            .map(|grid| grid.read(&self.gpu, smoothed));
        grid.unwrap_or(Ok(Vec::new()))
    }

    /// This frame's, as the passes pack them.
    fn read_keys(&self) -> Result<Vec<[u32; 4]>, RenderError> {
        let Some(buffers) = &self.buffers else {
            return Ok(Vec::new());
        };
        let bytes = self
            .gpu
            .read_buffer("the guides", &buffers.keys, buffers.keys.size())?;
        let keys: Vec<[u32; 4]> = bytemuck::pod_collect_to_vec(&bytes);
        let now = self.half as usize * (keys.len() / KEYS as usize);
        Ok(keys[now..now + buffers.pixels()].to_vec())
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
            .read_buffer("the guides", &buffers.lights, buffers.lights.size())?;
        let lights: Vec<[f32; 4]> = bytemuck::pod_collect_to_vec(&bytes);
        Ok(lights[..buffers.pixels()].to_vec())
    }
}
