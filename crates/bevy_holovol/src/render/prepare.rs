//! What the device holds of volumes, and what a frame wants of it.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::Arc;

use bevy::core_pipeline::core_3d::CORE_3D_DEPTH_FORMAT;
use bevy::prelude::*;
use bevy::render::camera::ExtractedCamera;
use bevy::render::renderer::{RenderAdapterInfo, RenderDevice, RenderQueue};
use bevy::render::sync_world::MainEntity;
use bevy::render::view::ExtractedView;
use holovol_light::EnvironmentMap;
use holovol_render::{
    CompositeBinding, CompositeTarget, Compositor, DenoiseKernels, Gpu, GpuEnvironment, GpuVolume,
    Interpolation, Kernels, LightChange, MAX_VIEWS, Medium, MeshDepth, RenderError,
    environment_change, wgpu,
};
use holovol_volume::Volume;

use super::extract::{ExtractedScene, ExtractedVolume, ExtractedVolumeView};
use super::node::{DepthTarget, DepthTargetShape};
use super::plan::{PlannedDepth, PlannedView};
use super::tracing::{Made, State, Tracing, Wanted};
use super::{Statistics, VolumeRenderMode, VolumeStatistics};

/// Light on the device.
struct UploadedLight {
    map: Arc<EnvironmentMap>,
    environment: Arc<GpuEnvironment>,
    /// Change of light T to it.
    change: f32,
}

/// A volume, and the number of scatterings that its views want.
pub(super) type TracerKey = (MainEntity, Option<u32>);

/// Frames after which a device has surely given back what nobody holds any more.
const FRAMES_TO_FREE: u32 = 4;

/// What a volume is being brought to. While voxels are on their way to the screen no others follow,
/// so that those which change in every frame arrive as fast as they can be uploaded.
struct Target {
    volume: Arc<Volume>,
    medium: Medium,
    /// What was asked for in the last frame.
    asked: Arc<Volume>,
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
    targets: HashMap<MainEntity, Target>,
    /// Frames until voxels that had no room are uploaded again; 0 for never.
    retry_in: u32,
    pub(super) tracings: HashMap<TracerKey, Tracing>,
    /// Kept from frame to frame: what images are laid over views with.
    pub(super) bindings: HashMap<(MainEntity, TracerKey), CompositeBinding>,
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
        const STORAGE_BUFFERS: u32 = 8;
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
            targets: HashMap::new(),
            retry_in: 0,
            tracings: HashMap::new(),
            bindings: HashMap::new(),
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
            State::Failed(failure) if failure.is_memory && self.retry_in > 0 => {
                statistics.is_waiting = true;
                None
            }
            State::Failed(failure) => {
                statistics.errors.push(failure.reason.clone());
                None
            }
        }
    }

    /// Follows the scene: which voxels and tracers there are to be.
    fn retarget(&mut self, scene: &ExtractedScene) {
        for tracing in self.tracings.values_mut() {
            tracing.poll();
        }
        for volume in &mut self.volumes {
            volume.poll();
        }
        let lives = |entity: &MainEntity| scene.volumes.iter().any(|v| v.entity == *entity);
        self.targets.retain(|entity, _| lives(entity));
        // Tracers of views that look elsewhere get on only once they are seen again.
        let is_seen = |key: &TracerKey| {
            let mut views = scene.views.iter();
            views.any(|view| {
                view.settings.max_scatters == key.1 && view.volumes.iter().any(|v| v.0 == key.0)
            })
        };
        for extracted in &scene.volumes {
            let mut is_asked_again = false;
            if let Some(target) = self.targets.get_mut(&extracted.entity) {
                is_asked_again = Arc::ptr_eq(&target.asked, &extracted.volume);
                target.asked = Arc::clone(&extracted.volume);
            }
            let target = self.targets.get(&extracted.entity);
            let is_other = |target: &&Target| !Arc::ptr_eq(&target.volume, &extracted.volume);
            if let Some(target) = target.filter(is_other) {
                let uploads =
                    |made: &Made<Volume, _>| made.is_of(&target.volume) && made.is_pending();
                let of_volume = |(key, _): &(&TracerKey, &Tracing)| key.0 == extracted.entity;
                let own = || self.tracings.iter().filter(of_volume);
                let is_busy = own().any(|(key, t)| is_seen(key) && t.is_busy());
                // Going back to what is shown waits for nothing; but where every frame has other
                // voxels, what is coming is not given up for what comes around again.
                let goes_back = is_asked_again
                    && own().next().is_some()
                    && own().all(|(_, t)| t.shows(&extracted.volume));
                if !goes_back && (is_busy || self.volumes.iter().any(uploads)) {
                    continue;
                }
            }
            let target = Target {
                volume: Arc::clone(&extracted.volume),
                medium: extracted.medium.clone(),
                asked: Arc::clone(&extracted.volume),
            };
            self.targets.insert(extracted.entity, target);
        }
        self.make_room_for_targets();
        self.rename_tracings(scene);
        // What nobody uses any more goes first: it makes room.
        let targets = &self.targets;
        let tracings = &self.tracings;
        let is_used = |made: &mut Made<Volume, _>| {
            targets.values().any(|t| made.is_of(&t.volume))
                || tracings.values().any(|tracing| tracing.shows(&made.of))
        };
        self.volumes.retain_mut(is_used);
        let wants = |key: &TracerKey| scene.views.iter().any(|v| v.settings.max_scatters == key.1);
        self.tracings
            .retain(|key, _| targets.contains_key(&key.0) && wants(key));
    }

    /// Where new voxels don't fit beside those that are shown, the latter go, and it is tried again.
    fn make_room_for_targets(&mut self) {
        for (entity, target) in &self.targets {
            let failed = |made: &Made<Volume, _>| {
                made.is_of(&target.volume) && made.failure().is_some_and(|f| f.is_memory)
            };
            let has_failed = self.volumes.iter().any(failed);
            let before = self.tracings.len();
            self.tracings.retain(|key, tracing| {
                let gives_way = tracing.shows_other_than(&target.volume)
                    && (has_failed || tracing.lacks_memory());
                key.0 != *entity || !gives_way
            });
            if self.tracings.len() < before {
                self.retry_in = FRAMES_TO_FREE;
            }
        }
        if self.retry_in > 0 {
            self.retry_in -= 1;
            if self.retry_in == 0 {
                let failed = |made: &Made<Volume, _>| {
                    made.failure().is_some_and(|failure| failure.is_memory)
                };
                self.volumes.retain(|made| !failed(made));
            }
        }
    }

    /// A tracer goes on for views that want another number of scatterings than before: its voxels
    /// and majorants are the same.
    fn rename_tracings(&mut self, scene: &ExtractedScene) {
        for view in &scene.views {
            for &(volume, _) in &view.volumes {
                let key = (volume, view.settings.max_scatters);
                if self.tracings.contains_key(&key) {
                    continue;
                }
                let wants = |max_scatters| {
                    let mut views = scene.views.iter();
                    views.any(|view| view.settings.max_scatters == max_scatters)
                };
                let is_left = |(other, tracing): &(&TracerKey, &Tracing)| {
                    let mut cameras = tracing.cameras();
                    other.0 == volume && !wants(other.1) && cameras.any(|c| c == view.entity)
                };
                let former = self.tracings.iter().find(is_left).map(|(key, _)| *key);
                if let Some(tracing) = former.and_then(|former| self.tracings.remove(&former)) {
                    self.tracings.insert(key, tracing);
                }
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
            Some(coming) => coming.failure().is_some() && !coming.is_of(map),
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
            Some(State::Failed(failure)) => statistics.errors.push(failure.reason.clone()),
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
    inner.retarget(scene);
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
        let Some(Target {
            volume: of, medium, ..
        }) = inner.targets.get(&extracted.entity)
        else {
            continue;
        };
        let (of, medium) = (Arc::clone(of), medium.clone());
        let volume = inner.volume(&of, statistics);
        for (max_scatters, views) in views_of(extracted.entity, scene, &views) {
            let key = (extracted.entity, max_scatters);
            let wanted = Wanted {
                of: &of,
                volume: volume.clone(),
                environment: environment.clone(),
                medium: Medium {
                    max_scatters,
                    ..medium.clone()
                },
                views,
            };
            let (gpu, kernels) = (&inner.gpu, &inner.kernels);
            let tracing = match inner.tracings.entry(key) {
                Entry::Occupied(tracing) => tracing.into_mut(),
                Entry::Vacant(_) if inner.retry_in > 0 => {
                    statistics.is_waiting = true;
                    continue;
                }
                Entry::Vacant(place) => {
                    let Some(tracing) = Tracing::begin(gpu, kernels, &wanted) else {
                        continue;
                    };
                    place.insert(tracing)
                }
            };
            // What is wrong with one volume concerns no other.
            tracing.update(gpu, kernels, &wanted, &scene.views, statistics);
        }
    }
}

/// Cameras that see a volume with the sizes of their images, by the scatterings that they want.
fn views_of(
    volume: MainEntity,
    scene: &ExtractedScene,
    views: &HashMap<MainEntity, (&ExtractedView, &Msaa)>,
) -> HashMap<Option<u32>, Vec<(MainEntity, [u32; 2])>> {
    let mut wanted: HashMap<_, Vec<_>> = HashMap::new();
    for view in &scene.views {
        let sees = view.volumes.iter().any(|(other, _)| *other == volume);
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
    wanted
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
