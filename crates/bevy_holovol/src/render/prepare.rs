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
    CompositeTarget, Compositor, FrameTracer, Gpu, GpuEnvironment, GpuVolume, Interpolation,
    Kernels, MAX_VIEWS, Medium, MeshDepth, RenderError, TraceOptions, wgpu,
};
use holovol_volume::Volume;

use super::extract::{ExtractedScene, ExtractedVolumeView};
use super::node::{DepthTarget, DepthTargetShape};
use super::plan::{PlannedDepth, PlannedView};
use super::{Statistics, VolumeStatistics};

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

/// A volume, and the number of scatterings that its views want.
pub(super) type TracerKey = (MainEntity, Option<u32>);

/// One volume for the views that want as many scatterings.
pub(super) struct Tracing {
    made: Made<Volume, FrameTracer>,
    /// Cameras and the largest images that there is room for.
    slots: Vec<(MainEntity, [u32; 2])>,
    /// Per slot, what the meshes inside were like.
    pub(super) overlaps: Vec<Option<u64>>,
}

impl Tracing {
    pub(super) fn tracer(&self) -> Option<&FrameTracer> {
        match &self.made.state {
            State::Ready(tracer) => Some(tracer),
            _ => None,
        }
    }

    pub(super) fn tracer_mut(&mut self) -> Option<&mut FrameTracer> {
        match &mut self.made.state {
            State::Ready(tracer) => Some(tracer),
            _ => None,
        }
    }

    pub(super) fn slot_of(&self, camera: MainEntity) -> Option<usize> {
        self.slots.iter().position(|slot| slot.0 == camera)
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
    environment: Option<Made<EnvironmentMap, Arc<GpuEnvironment>>>,
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

    /// The light on the device. While another is being uploaded, the former stays.
    fn environment(
        &mut self,
        map: &Arc<EnvironmentMap>,
        statistics: &mut Statistics,
    ) -> Option<Arc<GpuEnvironment>> {
        if !self
            .environment
            .as_ref()
            .is_some_and(|made| made.is_of(map))
        {
            let (gpu, source) = (self.gpu.clone(), Arc::clone(map));
            statistics.uploads += 1;
            // A small table and texture: its upload doesn't wait.
            self.environment = Some(Made::begin(map, move || {
                GpuEnvironment::new(&gpu, &source).map(Arc::new)
            }));
        }
        match self.environment.as_mut()?.poll() {
            State::Ready(environment) => Some(Arc::clone(environment)),
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
        statistics.errors.clear();
        statistics.is_waiting = false;
        if let Err(error) = prepare(inner, &scene, &cameras, statistics) {
            statistics.errors.push(error.to_string());
        }
        for error in &statistics.errors {
            warn_once!("{error}");
        }
    });
}

fn prepare(
    inner: &mut Inner,
    scene: &ExtractedScene,
    cameras: &Query<(&MainEntity, &ExtractedView, &Msaa), With<ExtractedCamera>>,
    statistics: &mut Statistics,
) -> Result<(), RenderError> {
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
        return Ok(());
    };
    let environment = inner.environment(map, statistics);
    let views: HashMap<_, _> = cameras
        .iter()
        .map(|(entity, v, msaa)| (*entity, (v, msaa)))
        .collect();
    for (view, msaa) in views.values() {
        let target = composite_target(view, msaa);
        inner.compositor.prepare(target)?;
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
            if !inner.tracings.contains_key(&key) {
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
                State::Ready(tracer) => {
                    tracer.set_medium(&medium)?;
                    if let Some(environment) = &environment {
                        tracer.set_environment(environment)?;
                    }
                    tracing.make_room(&wanted, &scene.views)?;
                }
                State::Pending(_) => statistics.is_waiting = true,
                State::Failed(reason) => statistics.errors.push(reason.clone()),
            }
        }
    }
    Ok(())
}

impl Tracing {
    fn begin(
        inner: &Inner,
        extracted: &super::extract::ExtractedVolume,
        volume: &Arc<GpuVolume>,
        environment: Arc<GpuEnvironment>,
        medium: Medium,
    ) -> Self {
        let (gpu, kernels) = (inner.gpu.clone(), Arc::clone(&inner.kernels));
        let volume = Arc::clone(volume);
        Self {
            made: Made::begin(&extracted.volume, move || {
                let options = TraceOptions::default();
                FrameTracer::new(&gpu, kernels, volume, environment, medium, options)
            }),
            slots: Vec::new(),
            overlaps: Vec::new(),
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
