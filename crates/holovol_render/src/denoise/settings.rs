//! What can be set, and how the passes are told.

use super::Sun;
use super::uniforms::DenoiseUniform;
use crate::FrameTracer;

/// How noise is taken out.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum DenoiseMode {
    /// This project's.
    #[default]
    Holovol,
    /// Cheng et al. 2023, as printed.
    Paper(PaperSettings),
}

/// What the paper leaves open; the defaults are from the search in docs/benchmarks/denoise.md.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PaperSettings {
    /// Pixels to each side, 0 to 8.
    pub radius: u32,
    /// Standard deviation of the spatial filter, pixels.
    pub sigma: f32,
    /// How fast weights fall with squared difference of albedo · opacity.
    pub albedo: f32,
    /// How fast weights fall with 1 − cosine between gradients.
    pub gradient: f32,
    /// How fast weights fall with squared difference of depth, in spreads and pixels.
    pub depth: f32,
}

impl Default for PaperSettings {
    fn default() -> Self {
        Self {
            radius: 3,
            sigma: 1.5,
            albedo: 40.0,
            gradient: 0.5,
            depth: 0.05,
        }
    }
}

/// Settings of [`DenoiseMode::Holovol`]; "bias" is a squared relative change of the estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DenoiseSettings {
    /// Which denoiser.
    pub mode: DenoiseMode,
    /// Pixels to each side of the last filter, 0 to 8.
    pub radius: u32,
    /// Frames (of two samples) of history in motion, at most.
    pub max_frames: f32,
    /// Bias expected of a pixel's distance.
    pub distance_bias: f32,
    /// Bias expected of normals at a right angle.
    pub normal_bias: f32,
    /// Bias expected of depths apart by their spreads.
    pub depth_bias: f32,
    /// Bias expected of opacities, one of them 0.
    pub opacity_bias: f32,
    /// Bias expected of light that differed as much in the last frame's filtered image.
    pub light_bias: f32,
    /// Bias expected of light that differs as much in this frame's own, by more than its noise.
    pub near_bias: f32,
    /// Bias expected of light that differs as much by what guides know of it.
    pub sun_bias: f32,
    /// Share of the irradiance that the dominant source needs for guides to know of it: up to
    /// four shadow rays for each pixel.
    pub sun_share: f64,
    /// Bias expected of the other eye.
    pub eye_bias: f32,
    /// How much guides of the last frame, of the other eye, must agree.
    pub strictness: [f32; 2],
    /// Factor on the first of these for each radian by which the direction to a place has turned in
    /// the volume's space; 1 at least.
    pub turn_strictness: f32,
    /// Relative variance of two samples before it is measured.
    pub first_variance: f32,
    /// Signal-to-noise (squared, less 1) of a lag at which half of it is corrected.
    pub correction: f32,
    /// How much a correction shortens the history.
    pub shortening: f32,
    /// Radiance times exposure below which errors count absolutely.
    pub dark: f32,
    /// Memory of the filter's weight, per frame.
    pub memory: f32,
}

impl Default for DenoiseSettings {
    fn default() -> Self {
        Self {
            mode: DenoiseMode::Holovol,
            radius: 3,
            max_frames: 32.0,
            distance_bias: 0.0035,
            normal_bias: 0.04,
            depth_bias: 0.003,
            opacity_bias: 0.12,
            light_bias: 4.0,
            near_bias: 4.0,
            sun_bias: 1.0,
            sun_share: 0.2,
            eye_bias: 0.012,
            strictness: [30.0, 60.0],
            turn_strictness: 95.0,
            first_variance: 0.1,
            correction: 3.0,
            shortening: 1.0,
            dark: 0.1,
            memory: 0.8,
        }
    }
}

impl DenoiseSettings {
    /// Whether the tracer should gather light for such a denoiser ([`FrameTracer::gather_light`]):
    /// it works without, less well.
    pub fn wants_light(&self) -> bool {
        !self.is_paper()
    }

    /// The dominant source, if guides are to know of it.
    pub(super) fn sun(&self, tracer: &FrameTracer) -> Option<Sun> {
        let dominates = |sun: &Sun| sun.share >= self.sun_share && !self.is_paper();
        tracer.sun().filter(dominates)
    }

    /// Pixels to each side of the filter over neighbours.
    pub(super) fn pass_radius(&self) -> u32 {
        match self.mode {
            DenoiseMode::Holovol => self.radius,
            DenoiseMode::Paper(paper) => paper.radius,
        }
    }

    pub(super) fn is_paper(&self) -> bool {
        matches!(self.mode, DenoiseMode::Paper(_))
    }

    pub(super) fn fill(&self, uniform: &mut DenoiseUniform, exposure: f32) {
        let dark = self.dark / exposure.clamp(1e-15, 1e15);
        uniform.bias = match self.mode {
            DenoiseMode::Holovol => [
                self.distance_bias,
                self.normal_bias,
                self.depth_bias,
                self.opacity_bias,
            ],
            DenoiseMode::Paper(paper) => [paper.sigma, paper.albedo, paper.gradient, paper.depth],
        };
        let [frames, eyes] = self.strictness;
        uniform.across = [frames, eyes, self.eye_bias, self.first_variance];
        uniform.tiles = [self.correction, self.shortening, dark * dark, self.memory];
        uniform.edges = [
            self.light_bias,
            self.near_bias,
            self.turn_strictness,
            self.sun_bias,
        ];
    }
}
