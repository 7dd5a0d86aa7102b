//! Denoised views: which images belong together, and what has changed since the last.

use std::sync::Arc;

use bevy::prelude::*;
use bevy::render::sync_world::MainEntity;
use holovol_render::{
    DenoiseFrame, DenoiseKernels, DenoiseMode, DenoiseSettings, Denoiser, FrameTracer, Gpu,
    PaperSettings, RenderError, wgpu,
};

use super::extract::ExtractedVolumeView;
use super::plan::PlannedView;
use super::prepare::{Inner, TracerKey};
use super::{Statistics, VolumeDenoiser, VolumeRenderMode};

/// What a planned view has to tell its denoiser.
#[derive(Clone, Copy, Debug)]
pub(super) struct WantedDenoising {
    pub(super) denoiser: VolumeDenoiser,
    pub(super) left_eye: Option<MainEntity>,
    pub(super) meshes_changed: bool,
    pub(super) reset: bool,
    pub(super) exposure: f32,
}

/// What has happened since the last denoised frame.
#[derive(Clone, Copy, Debug, Default)]
struct Changes {
    light: f32,
    meshes: bool,
    reset: bool,
}

/// The history of one view of a volume, or of both eyes'.
pub(super) struct Denoising {
    /// One, or the left and the right eye.
    cameras: Vec<MainEntity>,
    which: VolumeDenoiser,
    denoiser: Denoiser,
    changes: Changes,
    exposure: f32,
    /// Slots of the tracer to be denoised in this frame.
    slots: Vec<usize>,
}

impl Denoising {
    fn new(
        gpu: &Gpu,
        kernels: &Arc<DenoiseKernels>,
        cameras: Vec<MainEntity>,
        which: VolumeDenoiser,
    ) -> Self {
        let mode = match which {
            VolumeDenoiser::Holovol => DenoiseMode::Holovol,
            VolumeDenoiser::Paper => DenoiseMode::Paper(PaperSettings::default()),
        };
        let settings = DenoiseSettings { mode, ..default() };
        Self {
            cameras,
            which,
            denoiser: Denoiser::new(gpu, Arc::clone(kernels), settings),
            changes: Changes::default(),
            exposure: 1.0,
            slots: Vec::new(),
        }
    }

    /// The volume is another one.
    pub(super) fn forget(&mut self) {
        self.changes.reset = true;
    }

    fn eye(&self, camera: MainEntity) -> Option<usize> {
        self.cameras.iter().position(|&other| other == camera)
    }

    /// A camera's image, once there is one.
    pub(super) fn image(&self, camera: MainEntity) -> Option<(&Denoiser, usize)> {
        let eye = self.eye(camera)?;
        self.denoiser.image(eye).map(|_| (&self.denoiser, eye))
    }

    /// Samples of each pixel that are in a camera's image since something has changed.
    pub(super) fn samples(&self, camera: MainEntity) -> Option<u32> {
        let (denoiser, _) = self.image(camera)?;
        Some(denoiser.samples())
    }

    /// Gives the eyes' frames the samples that their images still want.
    fn plan(
        &mut self,
        tracer: &FrameTracer,
        plan: &mut [PlannedView],
        eyes: &[usize],
        statistics: &mut Statistics,
    ) {
        match self.denoiser.is_ready(tracer) {
            Ok(true) => {}
            Ok(false) => {
                // Until then samples gather.
                statistics.is_waiting = true;
                return;
            }
            Err(error) => {
                statistics.errors.push(error.to_string());
                return;
            }
        }
        for wanted in eyes.iter().filter_map(|&eye| plan[eye].denoising) {
            self.changes.meshes |= wanted.meshes_changed;
            self.changes.reset |= wanted.reset;
            self.exposure = wanted.exposure;
        }
        let frame = |eye: usize| &plan[eye].frame;
        let views: Vec<_> = eyes.iter().map(|&eye| frame(eye).view).collect();
        let is_same = self.changes.light <= 0.0 && !self.changes.meshes && !self.changes.reset;
        let gathered = if is_same {
            self.denoiser.gathered(&views, tracer.medium())
        } else {
            0
        };
        let left = |eye: usize| {
            let frame = frame(eye);
            frame
                .samples
                .min(frame.max_samples.saturating_sub(gathered))
        };
        // Eyes go together.
        let samples = eyes.iter().map(|&eye| left(eye)).max().unwrap_or(0);
        for &eye in eyes {
            let frame = &mut plan[eye].frame;
            frame.samples = samples;
            frame.max_samples = samples;
            frame.restart = samples > 0;
        }
        if samples > 0 {
            self.slots = eyes.iter().map(|&eye| plan[eye].frame.slot).collect();
        }
    }

    /// Whether its images are to be denoised in this frame.
    pub(super) fn is_planned(&self) -> bool {
        !self.slots.is_empty()
    }

    /// Records what was planned; gives how many images it were.
    pub(super) fn record(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        tracer: &FrameTracer,
    ) -> Result<u64, RenderError> {
        let slots = std::mem::take(&mut self.slots);
        let frame = DenoiseFrame {
            slots: &slots,
            light_change: self.changes.light,
            meshes_changed: self.changes.meshes,
            exposure: self.exposure,
            reset: self.changes.reset,
        };
        self.denoiser.record(encoder, tracer, &frame)?;
        self.changes = Changes::default();
        Ok(slots.len() as u64)
    }
}

/// Puts the eyes of a frame's plan together and decides what they want.
pub(super) fn plan(inner: &mut Inner, views: &[ExtractedVolumeView], statistics: &mut Statistics) {
    let light_change = inner.light_change;
    for (key, tracing) in &mut inner.tracings {
        let lives = |camera: &MainEntity, which| {
            views.iter().any(|view| {
                view.entity == *camera
                    && view.settings.mode == VolumeRenderMode::Denoised
                    && view.settings.denoiser == which
            })
        };
        let denoisings = &mut tracing.denoisings;
        denoisings.retain(|d| d.cameras.iter().all(|camera| lives(camera, d.which)));
        for denoising in denoisings.iter_mut() {
            denoising.slots.clear();
            denoising.changes.light = (denoising.changes.light + light_change).min(1.0);
        }
        let Some((tracer, denoisings)) = tracing.tracer_mut() else {
            continue;
        };
        let groups = groups(&inner.plan, *key);
        for (eyes, cameras) in &groups {
            let Some(wanted) = inner.plan[eyes[0]].denoising else {
                continue;
            };
            // Eyes that have been put together, or parted, begin anew.
            denoisings.retain(|d| {
                d.cameras == *cameras || cameras.iter().all(|&camera| d.eye(camera).is_none())
            });
            if denoisings.iter().all(|d| d.cameras != *cameras) {
                let kernels = match &inner.denoise_kernels {
                    Some(kernels) => Arc::clone(kernels),
                    None => match DenoiseKernels::new(&inner.gpu) {
                        Ok(kernels) => Arc::clone(inner.denoise_kernels.insert(Arc::new(kernels))),
                        Err(error) => {
                            statistics.errors.push(error.to_string());
                            continue;
                        }
                    },
                };
                let new = Denoising::new(&inner.gpu, &kernels, cameras.clone(), wanted.denoiser);
                denoisings.push(new);
            }
        }
        let gathers = denoisings
            .iter()
            .any(|d| d.denoiser.settings().wants_light());
        if let Err(error) = tracer.gather_light(gathers) {
            statistics.errors.push(error.to_string());
        }
        for (eyes, cameras) in &groups {
            let found = denoisings.iter_mut().find(|d| d.cameras == *cameras);
            if let Some(denoising) = found {
                denoising.plan(tracer, &mut inner.plan, eyes, statistics);
            }
        }
    }
}

/// Planned views of a volume that are denoised: alone, or the left and the right eye; and their
/// cameras.
fn groups(plan: &[PlannedView], key: TracerKey) -> Vec<(Vec<usize>, Vec<MainEntity>)> {
    let denoised = |&i: &usize| plan[i].key == key && plan[i].denoising.is_some();
    let views: Vec<usize> = (0..plan.len()).filter(denoised).collect();
    let left_of = |right: usize| {
        let camera = plan[right].denoising?.left_eye?;
        views
            .iter()
            .copied()
            .find(|&left| plan[left].camera == camera)
    };
    let pairs: Vec<_> = views
        .iter()
        .filter_map(|&right| Some(vec![left_of(right)?, right]))
        .collect();
    let alone: Vec<_> = views
        .iter()
        .filter(|view| !pairs.iter().flatten().any(|eye| eye == *view))
        .collect();
    let alone = alone.into_iter().map(|&view| vec![view]);
    let with_cameras = |eyes: Vec<usize>| {
        let cameras = eyes.iter().map(|&eye| plan[eye].camera).collect();
        (eyes, cameras)
    };
    pairs.into_iter().chain(alone).map(with_cameras).collect()
}
