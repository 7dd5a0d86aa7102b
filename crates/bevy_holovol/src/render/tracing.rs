//! Tracers of volumes, and what becomes of them when a volume's voxels are replaced.

use std::sync::Arc;

use bevy::prelude::*;
use bevy::render::sync_world::MainEntity;
use bevy::tasks::{AsyncComputeTaskPool, Task, futures::check_ready};
use holovol_render::{
    FrameTracer, Gpu, GpuEnvironment, GpuVolume, Kernels, Medium, RenderError, TraceOptions,
};
use holovol_volume::Volume;

use super::Statistics;
use super::denoise::Denoising;
use super::extract::ExtractedVolumeView;

/// Something that a worker makes of something else.
pub(super) struct Made<K, T> {
    pub(super) of: Arc<K>,
    pub(super) state: State<T>,
}

pub(super) enum State<T> {
    Pending(Task<Result<T, RenderError>>),
    Ready(T),
    Failed(Failure),
}

/// Why something could not be made.
#[derive(Clone)]
pub(super) struct Failure {
    pub(super) reason: String,
    /// The device had no room.
    pub(super) is_memory: bool,
}

impl<K, T: Send + 'static> Made<K, T> {
    pub(super) fn begin(
        of: &Arc<K>,
        make: impl FnOnce() -> Result<T, RenderError> + Send + 'static,
    ) -> Self {
        let task = AsyncComputeTaskPool::get().spawn(async move { make() });
        Self {
            of: Arc::clone(of),
            state: State::Pending(task),
        }
    }

    pub(super) fn is_of(&self, other: &Arc<K>) -> bool {
        Arc::ptr_eq(&self.of, other)
    }

    pub(super) fn is_pending(&self) -> bool {
        matches!(self.state, State::Pending(_))
    }

    pub(super) fn ready(&self) -> Option<&T> {
        match &self.state {
            State::Ready(made) => Some(made),
            _ => None,
        }
    }

    pub(super) fn failure(&self) -> Option<&Failure> {
        match &self.state {
            State::Failed(failure) => Some(failure),
            _ => None,
        }
    }

    /// Takes in what the worker has made.
    pub(super) fn poll(&mut self) -> &mut State<T> {
        if let State::Pending(task) = &mut self.state
            && let Some(result) = check_ready(task)
        {
            self.state = match result {
                Ok(made) => State::Ready(made),
                Err(error) => {
                    error!("{error}");
                    State::Failed(Failure {
                        is_memory: matches!(error, RenderError::OutOfMemory { .. }),
                        reason: error.to_string(),
                    })
                }
            };
        }
        &mut self.state
    }
}

/// What a volume is being brought to.
pub(super) struct Wanted<'a> {
    /// The voxels.
    pub(super) of: &'a Arc<Volume>,
    /// Those on the device, once they are there.
    pub(super) volume: Option<Arc<GpuVolume>>,
    pub(super) environment: Option<Arc<GpuEnvironment>>,
    pub(super) medium: Medium,
    /// Cameras and sizes of their images.
    pub(super) views: Vec<(MainEntity, [u32; 2])>,
}

/// A tracer, and the medium that it was begun with, to try again with another if that failed.
struct Tracer {
    made: Made<Volume, FrameTracer>,
    begun_with: Medium,
}

impl Tracer {
    fn begin(gpu: &Gpu, kernels: &Arc<Kernels>, wanted: &Wanted<'_>) -> Option<Self> {
        let volume = Arc::clone(wanted.volume.as_ref()?);
        let environment = Arc::clone(wanted.environment.as_ref()?);
        let (gpu, kernels, medium) = (gpu.clone(), Arc::clone(kernels), wanted.medium.clone());
        Some(Self {
            begun_with: medium.clone(),
            made: Made::begin(wanted.of, move || {
                let options = TraceOptions::default();
                FrameTracer::new(&gpu, kernels, volume, environment, medium, options)
            }),
        })
    }

    fn is_worth_another_try(&self, medium: &Medium) -> bool {
        self.made.failure().is_some() && self.begun_with != *medium
    }
}

/// One volume for the views that want as many scatterings.
pub(super) struct Tracing {
    shown: Tracer,
    /// One of other voxels, which takes the place of the one that is shown once it can trace.
    coming: Option<Tracer>,
    /// Cameras and the largest images that there is room for.
    slots: Vec<(MainEntity, [u32; 2])>,
    /// Per slot, what the meshes inside were like.
    pub(super) overlaps: Vec<Option<u64>>,
    pub(super) denoisings: Vec<Denoising>,
}

impl Tracing {
    /// `None` while voxels or light aren't on the device.
    pub(super) fn begin(gpu: &Gpu, kernels: &Arc<Kernels>, wanted: &Wanted<'_>) -> Option<Self> {
        Some(Self {
            shown: Tracer::begin(gpu, kernels, wanted)?,
            coming: None,
            slots: Vec::new(),
            overlaps: Vec::new(),
            denoisings: Vec::new(),
        })
    }

    pub(super) fn tracer(&self) -> Option<&FrameTracer> {
        self.shown.made.ready()
    }

    pub(super) fn tracer_mut(&mut self) -> Option<(&mut FrameTracer, &mut Vec<Denoising>)> {
        match &mut self.shown.made.state {
            State::Ready(tracer) => Some((tracer, &mut self.denoisings)),
            _ => None,
        }
    }

    /// Takes in what workers have made.
    pub(super) fn poll(&mut self) {
        self.shown.made.poll();
        if let Some(coming) = &mut self.coming {
            coming.made.poll();
        }
    }

    /// Whether something is on its way to the screen.
    pub(super) fn is_busy(&self) -> bool {
        let is_coming = |coming: &Tracer| coming.made.failure().is_none();
        self.shown.made.is_pending() || self.coming.as_ref().is_some_and(is_coming)
    }

    /// Shows these voxels.
    pub(super) fn shows(&self, voxels: &Arc<Volume>) -> bool {
        self.tracer().is_some() && self.shown.made.is_of(voxels)
    }

    /// Shows other voxels than these.
    pub(super) fn shows_other_than(&self, voxels: &Arc<Volume>) -> bool {
        self.tracer().is_some() && !self.shown.made.is_of(voxels)
    }

    /// Whether the device had no room for another tracer beside the one that is shown.
    pub(super) fn lacks_memory(&self) -> bool {
        let failure = |tracer: &Tracer| tracer.made.failure().cloned();
        let failure = self.coming.as_ref().and_then(failure);
        failure.is_some_and(|failure| failure.is_memory)
    }

    pub(super) fn cameras(&self) -> impl Iterator<Item = MainEntity> {
        self.slots.iter().map(|(camera, _)| *camera)
    }

    /// The slot of a camera, if there is room for its image.
    pub(super) fn slot_of(&self, camera: MainEntity, size: [u32; 2]) -> Option<usize> {
        let fits = |&(other, room): &(MainEntity, [u32; 2])| {
            other == camera && size[0] <= room[0] && size[1] <= room[1]
        };
        self.slots.iter().position(fits)
    }

    /// Brings it to what is wanted, as far as that is there.
    pub(super) fn update(
        &mut self,
        gpu: &Gpu,
        kernels: &Arc<Kernels>,
        wanted: &Wanted<'_>,
        cameras: &[ExtractedVolumeView],
        statistics: &mut Statistics,
    ) {
        if let Err(error) = self.update_tracers(gpu, kernels, wanted, statistics) {
            statistics.errors.push(error.to_string());
        }
        match self.make_room(&wanted.views, cameras) {
            Ok(is_another) => statistics.resizes += u64::from(is_another),
            Err(error) => statistics.errors.push(error.to_string()),
        }
    }

    fn update_tracers(
        &mut self,
        gpu: &Gpu,
        kernels: &Arc<Kernels>,
        wanted: &Wanted<'_>,
        statistics: &mut Statistics,
    ) -> Result<(), RenderError> {
        if self.shown.made.is_of(wanted.of) {
            self.coming = None;
            if self.shown.is_worth_another_try(&wanted.medium)
                && let Some(again) = Tracer::begin(gpu, kernels, wanted)
            {
                self.shown = again;
            }
        } else {
            self.bring_other_voxels(gpu, kernels, wanted)?;
            match &self.coming {
                Some(Tracer { made, .. }) if made.failure().is_some() => {
                    let reason = made.failure().map(|failure| failure.reason.clone());
                    statistics.errors.extend(reason);
                }
                // Their volume's upload speaks for itself.
                None if wanted.volume.is_none() => {}
                Some(_) | None => statistics.is_waiting |= !self.shown.made.is_of(wanted.of),
            }
        }
        let is_current = self.shown.made.is_of(wanted.of);
        match &mut self.shown.made.state {
            State::Ready(tracer) => {
                if let Some(environment) = &wanted.environment {
                    tracer.set_environment(environment)?;
                }
                // What is wanted of other voxels isn't wanted of these.
                if is_current {
                    tracer.set_medium(&wanted.medium)?;
                }
            }
            State::Pending(_) => statistics.is_waiting = true,
            State::Failed(failure) => statistics.errors.push(failure.reason.clone()),
        }
        Ok(())
    }

    /// Begins with a tracer of other voxels, or exchanges the one that is shown for it.
    fn bring_other_voxels(
        &mut self,
        gpu: &Gpu,
        kernels: &Arc<Kernels>,
        wanted: &Wanted<'_>,
    ) -> Result<(), RenderError> {
        let is_useless = |coming: &Tracer| {
            !coming.made.is_of(wanted.of) || coming.is_worth_another_try(&wanted.medium)
        };
        if self.coming.as_ref().is_none_or(is_useless) {
            self.coming = Tracer::begin(gpu, kernels, wanted);
        }
        let Some(coming) = &mut self.coming else {
            return Ok(());
        };
        let State::Ready(tracer) = &mut coming.made.state else {
            return Ok(());
        };
        if let Some(environment) = &wanted.environment {
            tracer.set_environment(environment)?;
        }
        tracer.set_medium(&wanted.medium)?;
        let ends_at_meshes = self.overlaps.iter().any(Option::is_some);
        // Nothing is lost where nothing is shown.
        if self.shown.made.ready().is_some() && !tracer.is_ready(ends_at_meshes)? {
            return Ok(());
        }
        if let Some(coming) = self.coming.take() {
            self.shown = coming;
            self.slots.clear();
            for denoising in &mut self.denoisings {
                denoising.forget();
            }
        }
        Ok(())
    }

    /// Makes room for these views, unless there is; true if so.
    fn make_room(
        &mut self,
        wanted: &[(MainEntity, [u32; 2])],
        cameras: &[ExtractedVolumeView],
    ) -> Result<bool, RenderError> {
        let State::Ready(tracer) = &mut self.shown.made.state else {
            return Ok(false);
        };
        let room_of = |camera: MainEntity| {
            let slot = self.slots.iter().find(|(other, _)| *other == camera);
            slot.map(|(_, room)| *room)
        };
        let fits = wanted.iter().all(|&(camera, size)| {
            room_of(camera).is_some_and(|room| room[0] >= size[0] && room[1] >= size[1])
        });
        let is_left = |(camera, _): &(MainEntity, _)| cameras.iter().all(|c| c.entity != *camera);
        if fits && !self.slots.iter().any(is_left) {
            return Ok(false);
        }
        let with_headroom: Vec<_> = wanted
            .iter()
            .map(|&(camera, size)| (camera, grown(room_of(camera), size)))
            .collect();
        let sizes = |slots: &[(MainEntity, _)]| slots.iter().map(|(_, size)| *size).collect();
        let rooms: Vec<[u32; 2]> = sizes(&with_headroom);
        let slots = if tracer.set_views(&rooms).is_ok() {
            with_headroom
        } else {
            let rooms: Vec<[u32; 2]> = sizes(wanted);
            tracer.set_views(&rooms)?;
            wanted.to_vec()
        };
        for (slot, (camera, _)) in slots.iter().enumerate() {
            // Where there was room already, there may be another's image.
            if self.slots.get(slot).map(|(former, _)| former) != Some(camera) {
                tracer.forget_view(slot);
            }
        }
        self.slots = slots;
        self.overlaps = vec![None; wanted.len()];
        Ok(true)
    }
}

/// Room for an image that may have had some: where it has grown, it will grow on, as windows do that
/// are being resized.
fn grown(room: Option<[u32; 2]>, size: [u32; 2]) -> [u32; 2] {
    /// Pixels, so that small windows don't ask again and again.
    const STEP: u32 = 64;
    let Some(room) = room else {
        return size;
    };
    [0, 1].map(|i| match size[i] <= room[i] {
        true => room[i],
        false => (size[i] + size[i] / 8).next_multiple_of(STEP),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_first_room_is_as_large_as_its_image() {
        assert_eq!(grown(None, [1920, 1080]), [1920, 1080]);
    }

    #[test]
    fn a_window_that_is_dragged_larger_seldom_needs_other_room() {
        let (mut room, mut times) = ([800, 600], 0);
        for step in 0..=400 {
            let size = [800 + 2 * step, 600 + step];
            if size[0] > room[0] || size[1] > room[1] {
                room = grown(Some(room), size);
                times += 1;
                assert!(room[0] >= size[0] && room[1] >= size[1]);
                assert!(
                    room[0] <= size[0] + size[0] / 8 + 64,
                    "{room:?} for {size:?}"
                );
            }
        }
        assert!(times <= 10, "{times} times");
    }
}
