//! What the device holds of volumes, and what a frame wants of it.

use std::collections::HashMap;
use std::sync::Arc;

use bevy::core_pipeline::core_3d::CORE_3D_DEPTH_FORMAT;
use bevy::prelude::*;
use bevy::render::camera::ExtractedCamera;
use bevy::render::renderer::{RenderAdapterInfo, RenderDevice, RenderQueue};
use bevy::render::sync_world::MainEntity;
use bevy::render::view::ExtractedView;
use bevy::tasks::{AsyncComputeTaskPool, Task, futures::check_ready};
use holovol_light::EnvironmentMap;
use holovol_render::{
    CompositeTarget, Compositor, DenoiseKernels, FrameTracer, Gpu, GpuEnvironment, GpuVolume,
    Interpolation, Kernels, LightChange, MAX_VIEWS, Medium, MeshDepth, RenderError, TraceOptions,
    environment_change, wgpu,
};
use holovol_volume::Volume;

use super::denoise::Denoising;
use super::extract::{ExtractedScene, ExtractedVolume, ExtractedVolumeView};
use super::node::{DepthTarget, DepthTargetShape};
use super::plan::{PlannedDepth, PlannedView};
use super::{Statistics, VolumeRenderMode, VolumeStatistics};

/// Something that a worker makes of something else.
pub(super) struct Made<K, T> {
    of: Arc<K>,
    state: State<T>,
}

enum State<T> {
    Pending(Task<Result<T, RenderError>>),
    Ready(T),
    Failed(String),
}

impl<K, T: Send + 'static> Made<K, T> {
    fn begin(of: &Arc<K>, make: impl FnOnce() -> Result<T, RenderError> + Send + 'static) -> Self {
        let task = AsyncComputeTaskPool::get().spawn(async move { make() });
        Self {
            of: Arc::clone(of),
            state: State::Pending(task),
        }
    }

    fn is_of(&self, other: &Arc<K>) -> bool {
        Arc::ptr_eq(&self.of, other)
    }

    pub(super) fn ready(&self) -> Option<&T> {
        match &self.state {
            State::Ready(made) => Some(made),
            _ => None,
        }
    }

    /// Takes in what the worker has made.
    fn poll(&mut self) -> &mut State<T> {
        if let State::Pending(task) = &mut self.state
            && let Some(result) = check_ready(task)
        {
            self.state = match result {
                Ok(made) => State::Ready(made),
                Err(error) => {
                    error!("{error}");
                    State::Failed(error.to_string())
                }
            };
        }
        &mut self.state
    }
}

/// Light on the device.
struct UploadedLight {
    map: Arc<EnvironmentMap>,
    environment: Arc<GpuEnvironment>,
    /// Change of light T to it.
    change: f32,
}

/// A volume, and the number of scatterings that its views want.
pub(super) type TracerKey = (MainEntity, Option<u32>);

/// One volume for the views that want as many scatterings.
pub(super) struct Tracing {
    pub(super) made: Made<Volume, FrameTracer>,
    /// What it was begun with, to try again with another if that failed.
    begun_with: Medium,
    /// Cameras and the largest images that there is room for.
    slots: Vec<(MainEntity, [u32; 2])>,
    /// Per slot, what the meshes inside were like.
    pub(super) overlaps: Vec<Option<u64>>,
    pub(super) denoisings: Vec<Denoising>,
}

impl Tracing {
    pub(super) fn tracer(&self) -> Option<&FrameTracer> {
        self.made.ready()
    }

    pub(super) fn tracer_mut(&mut self) -> Option<(&mut FrameTracer, &mut Vec<Denoising>)> {
        match &mut self.made.state {
            State::Ready(tracer) => Some((tracer, &mut self.denoisings)),
            _ => None,
        }
    }

    /// The slot of a camera, if there is room for its image.
    pub(super) fn slot_of(&self, camera: MainEntity, size: [u32; 2]) -> Option<usize> {
        let fits = |&(other, room): &(MainEntity, [u32; 2])| {
            other == camera && size[0] <= room[0] && size[1] <= room[1]
        };
        self.slots.iter().position(fits)
    }

    fn update(
        &mut self,
        medium: &Medium,
        environment: Option<&Arc<GpuEnvironment>>,
    ) -> Result<(), RenderError> {
        let State::Ready(tracer) = &mut self.made.state else {
            return Ok(());
        };
        if let Some(environment) = environment {
            tracer.set_environment(environment)?;
        }
        tracer.set_medium(medium).map(|_| ())
    }

    /// Makes room for these views, unless there is.
    fn make_room(
        &mut self,
        wanted: &[(MainEntity, [u32; 2])],
        cameras: &[ExtractedVolumeView],
    ) -> Result<(), RenderError> {
        let fits = wanted.iter().all(|(camera, size)| {
            self.slots
                .iter()
                .any(|(other, room)| other == camera && room[0] >= size[0] && room[1] >= size[1])
        });
        let is_left = |(camera, _): &(MainEntity, _)| cameras.iter().all(|c| c.entity != *camera);
        if fits && !self.slots.iter().any(is_left) {
            return Ok(());
        }
        let rooms: Vec<_> = wanted.iter().map(|&(_, size)| size).collect();
        let State::Ready(tracer) = &mut self.made.state else {
            return Ok(());
        };
        tracer.set_views(&rooms)?;
        self.slots = wanted.to_vec();
        self.overlaps = vec![None; wanted.len()];
        Ok(())
    }
}

/// Everything of ours on the device; made anew when that is.
#[derive(Resource)]
pub(crate) struct VolumeGpu(pub(super) Option<Inner>);

pub(crate) struct Inner {
    pub(super) gpu: Gpu,
    kernels: Arc<Kernels>,
    pub(super) compositor: Compositor,
    pub(super) mesh_depth: MeshDepth,
    /// Drawn into for views of these shapes, one after the other.
    pub(super) depth_targets: Vec<DepthTarget>,
    volumes: Vec<Made<Volume, Arc<GpuVolume>>>,
    environment: Option<UploadedLight>,
    /// The next one: one at a time, so that light which changes in every frame arrives as fast as
    /// it can be uploaded.
    coming: Option<Made<EnvironmentMap, (Arc<GpuEnvironment>, f32)>>,
    light: LightChange,
    /// T since the last frame.
    pub(super) light_change: f32,
    /// Once a view is denoised.
    pub(super) denoise_kernels: Option<Arc<DenoiseKernels>>,
    pub(super) tracings: HashMap<TracerKey, Tracing>,
    pub(super) plan: Vec<PlannedView>,
    pub(super) depth_plan: Vec<PlannedDepth>,
}

impl FromWorld for VolumeGpu {
    fn from_world(world: &mut World) -> Self {
        let device = world.resource::<RenderDevice>();
        let queue: &wgpu::Queue = &world.resource::<RenderQueue>().0;
        let info: &wgpu::AdapterInfo = &world.resource::<RenderAdapterInfo>().0;
        let limits = device.limits();
        /// As many does the tracer bind.
        const STORAGE_BUFFERS: u32 = 7;
        if limits.max_storage_buffers_per_shader_stage < STORAGE_BUFFERS {
            warn!(
                "volumes are not drawn: this device binds {} storage buffers to a shader, {} are \
                 needed",
                limits.max_storage_buffers_per_shader_stage, STORAGE_BUFFERS
            );
            return Self(None);
        }
        let gpu = Gpu::from_device(device.wgpu_device().clone(), queue.clone(), info.clone());
        match Inner::new(gpu) {
            Ok(inner) => Self(Some(inner)),
            Err(error) => {
                error!("volumes are not drawn: {error}");
                Self(None)
            }
        }
    }
}

impl Inner {
    fn new(gpu: Gpu) -> Result<Self, RenderError> {
        Ok(Self {
            kernels: Arc::new(Kernels::new(&gpu)?),
            compositor: Compositor::new(&gpu)?,
            mesh_depth: MeshDepth::new(&gpu)?,
            depth_targets: Vec::new(),
            gpu,
            volumes: Vec::new(),
            environment: None,
            coming: None,
            light: LightChange::default(),
            light_change: 0.0,
            denoise_kernels: None,
            tracings: HashMap::new(),
            plan: Vec::new(),
            depth_plan: Vec::new(),
        })
    }

    /// A volume on the device, once it is uploaded.
    fn volume(
        &mut self,
        volume: &Arc<Volume>,
        statistics: &mut Statistics,
    ) -> Option<Arc<GpuVolume>> {
        if !self.volumes.iter().any(|made| made.is_of(volume)) {
            let (gpu, source) = (self.gpu.clone(), Arc::clone(volume));
            statistics.uploads += 1;
            self.volumes.push(Made::begin(volume, move || {
                GpuVolume::new(&gpu, &source, Interpolation::Exact, false).map(Arc::new)
            }));
        }
        let made = self.volumes.iter_mut().find(|made| made.is_of(volume))?;
        match made.poll() {
            State::Ready(volume) => Some(Arc::clone(volume)),
            State::Pending(_) => {
                statistics.is_waiting = true;
                None
            }
            State::Failed(reason) => {
                statistics.errors.push(reason.clone());
                None
            }
        }
    }

    pub(super) fn depth_target(
        &mut self,
        shape: DepthTargetShape,
    ) -> Result<DepthTarget, RenderError> {
        if let Some(target) = self.depth_targets.iter().find(|t| t.shape() == shape) {
            return Ok(target.clone());
        }
        let target = DepthTarget::new(&self.gpu, shape)?;
        self.depth_targets.push(target.clone());
        Ok(target)
    }

    /// Takes in the light that was uploaded, and begins with the next. While another is being
    /// uploaded, the former stays.
    fn update_environment(
        &mut self,
        map: &Arc<EnvironmentMap>,
        is_denoised: bool,
        statistics: &mut Statistics,
    ) {
        let mut is_there = false;
        if let Some(coming) = &mut self.coming {
            let map = Arc::clone(&coming.of);
            if let State::Ready((environment, change)) = coming.poll() {
                self.environment = Some(UploadedLight {
                    map,
                    environment: Arc::clone(environment),
                    change: *change,
                });
                is_there = true;
            }
        }
        if is_there {
            self.coming = None;
        }
        let is_current = |light: &UploadedLight| Arc::ptr_eq(&light.map, map);
        if self.environment.as_ref().is_some_and(is_current) {
            return;
        }
        let is_free = match &self.coming {
            None => true,
            Some(coming) => matches!(coming.state, State::Failed(_)) && !coming.is_of(map),
        };
        if is_free {
            let (gpu, source) = (self.gpu.clone(), Arc::clone(map));
            statistics.uploads += 1;
            let before = self.environment.as_ref().filter(|_| is_denoised);
            let before = before.map(|light| Arc::clone(&light.map));
            self.coming = Some(Made::begin(map, move || {
                let environment = GpuEnvironment::new(&gpu, &source)?;
                // Nobody asks by how much the first differs.
                let change = before.map_or(1.0, |before| environment_change(&before, &source));
                Ok((Arc::new(environment), change))
            }));
        }
        match self.coming.as_ref().map(|coming| &coming.state) {
            Some(State::Failed(reason)) => statistics.errors.push(reason.clone()),
            _ => statistics.is_waiting = true,
        }
    }
}

/// Uploads what is new and brings tracers to the extracted scene.
pub(super) fn prepare_volumes(
    mut gpu: ResMut<VolumeGpu>,
    scene: Res<ExtractedScene>,
    cameras: Query<(&MainEntity, &ExtractedView, &Msaa), With<ExtractedCamera>>,
    statistics: Res<VolumeStatistics>,
) {
    let Some(inner) = &mut gpu.0 else {
        return;
    };
    statistics.update(|statistics| {
        statistics.is_waiting = false;
        let before = std::mem::take(&mut statistics.errors);
        prepare(inner, &scene, &cameras, statistics);
        for error in &statistics.errors {
            if !before.contains(error) {
                warn!("{error}");
            }
        }
    });
}

fn prepare(
    inner: &mut Inner,
    scene: &ExtractedScene,
    cameras: &Query<(&MainEntity, &ExtractedView, &Msaa), With<ExtractedCamera>>,
    statistics: &mut Statistics,
) {
    inner.light_change = 0.0;
    // What nobody uses any more goes first: it makes room.
    let is_used = |made: &Made<Volume, _>| scene.volumes.iter().any(|v| made.is_of(&v.volume));
    inner.volumes.retain(is_used);
    let lives = |key: &TracerKey, tracing: &Tracing| {
        let volume = scene.volumes.iter().find(|v| v.entity == key.0);
        volume.is_some_and(|v| tracing.made.is_of(&v.volume))
            && scene.views.iter().any(|v| v.settings.max_scatters == key.1)
    };
    inner.tracings.retain(|key, tracing| lives(key, tracing));
    let Some(map) = &scene.environment else {
        statistics.is_waiting |= !scene.volumes.is_empty();
        return;
    };
    let is_denoised = |view: &ExtractedVolumeView| view.settings.mode == VolumeRenderMode::Denoised;
    let is_denoised = scene.views.iter().any(is_denoised);
    inner.update_environment(map, is_denoised, statistics);
    let environment = inner
        .environment
        .as_ref()
        .map(|light| Arc::clone(&light.environment));
    // One light for all volumes.
    if let (Some(light), Some(ExtractedVolume { medium, .. })) =
        (&inner.environment, scene.volumes.first())
    {
        let (rotation_y, scale) = (medium.environment_rotation_y, medium.environment_scale);
        let exchanged = |_: &EnvironmentMap| light.change;
        inner.light_change = inner.light.update(&light.map, rotation_y, scale, exchanged);
    }
    let views: HashMap<_, _> = cameras
        .iter()
        .map(|(entity, v, msaa)| (*entity, (v, msaa)))
        .collect();
    for (view, msaa) in views.values() {
        let target = composite_target(view, msaa);
        if let Err(error) = inner.compositor.prepare(target) {
            statistics.errors.push(error.to_string());
        }
    }
    for extracted in &scene.volumes {
        let Some(volume) = inner.volume(&extracted.volume, statistics) else {
            continue;
        };
        let mut wanted: HashMap<Option<u32>, Vec<_>> = HashMap::new();
        for view in &scene.views {
            let sees = view
                .volumes
                .iter()
                .any(|(volume, _)| *volume == extracted.entity);
            if let (true, Some((extracted_view, _))) = (sees, views.get(&view.entity)) {
                let viewport = viewport_size(extracted_view);
                let size = view.settings.image_size(viewport);
                let room = [0, 1].map(|i| size[i].max(viewport[i]));
                let group = wanted.entry(view.settings.max_scatters).or_default();
                if group.len() < MAX_VIEWS {
                    group.push((view.entity, room));
                } else {
                    warn_once!("more than {MAX_VIEWS} cameras see a volume: the others don't");
                }
            }
        }
        for (max_scatters, wanted) in wanted {
            let key = (extracted.entity, max_scatters);
            let medium = Medium {
                max_scatters,
                ..extracted.medium.clone()
            };
            let failed = |tracing: &Tracing| {
                matches!(tracing.made.state, State::Failed(_)) && tracing.begun_with != medium
            };
            if inner.tracings.get(&key).is_none_or(failed) {
                let Some(environment) = environment.clone() else {
                    continue;
                };
                let tracing =
                    Tracing::begin(inner, extracted, &volume, environment, medium.clone());
                inner.tracings.insert(key, tracing);
            }
            let Some(tracing) = inner.tracings.get_mut(&key) else {
                continue;
            };
            match tracing.made.poll() {
                // What is wrong with one volume concerns no other.
                State::Ready(_) => {
                    let updated = tracing.update(&medium, environment.as_ref());
                    let updated = updated.and(tracing.make_room(&wanted, &scene.views));
                    if let Err(error) = updated {
                        statistics.errors.push(error.to_string());
                    }
                }
                State::Pending(_) => statistics.is_waiting = true,
                State::Failed(reason) => statistics.errors.push(reason.clone()),
            }
        }
    }
}

impl Tracing {
    fn begin(
        inner: &Inner,
        extracted: &ExtractedVolume,
        volume: &Arc<GpuVolume>,
        environment: Arc<GpuEnvironment>,
        medium: Medium,
    ) -> Self {
        let (gpu, kernels) = (inner.gpu.clone(), Arc::clone(&inner.kernels));
        let volume = Arc::clone(volume);
        Self {
            begun_with: medium.clone(),
            made: Made::begin(&extracted.volume, move || {
                let options = TraceOptions::default();
                FrameTracer::new(&gpu, kernels, volume, environment, medium, options)
            }),
            slots: Vec::new(),
            overlaps: Vec::new(),
            denoisings: Vec::new(),
        }
    }
}

pub(super) fn viewport_size(view: &ExtractedView) -> [u32; 2] {
    [view.viewport.z, view.viewport.w]
}

pub(super) fn composite_target(view: &ExtractedView, msaa: &Msaa) -> CompositeTarget {
    CompositeTarget {
        format: view.target_format,
        samples: msaa.samples(),
        depth_format: Some(CORE_3D_DEPTH_FORMAT),
    }
}
