//! Light from a 360° camera, estimated beside the app and taken in when it changed.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use bevy::log::warn;
use bevy::prelude::*;
use glam::DMat3;
use holovol_light::EnvironmentMap;
use holovol_light::chain::{LightChain, Update as LightUpdate};
use holovol_light::estimate::{Light, Prior, Rung};
use holovol_light::lens::{Calibration, FisheyePair, Stitcher};
use holovol_light::response::Response;

use super::{EnvironmentAsset, EnvironmentSource, VolumeEnvironment, light};

/// Frames that may wait: one per exposure of a bracket.
const WAITING_MAX: usize = 4;
/// Exposures nearer than this are the same setting, EV.
const SAME_EV: f64 = 0.5;
/// Longest time between frames that the filter is told of, s.
const GAP_MAX: f64 = 1.0;

/// Follows a camera's light: [`VolumeEnvironment`] is what the camera sees, brought back to full
/// dynamic range.
///
/// A thread of its own takes frames from [`LiveLight::camera`], and
/// [`LightChain`](holovol_light::chain::LightChain) makes light of them. The environment's asset is
/// replaced only when T (DESIGN §6) or a disc light says that the light changed; noise and the
/// camera's exposure don't. The first light becomes [`VolumeEnvironment::source`]; an app that sets
/// another then keeps that, and returns by [`LiveLight::map`]. Not in
/// [`HolovolPlugins`](crate::HolovolPlugins): add it after them.
#[derive(Clone, Debug)]
pub struct LiveLightPlugin {
    /// Texels across and down of the map; frames of other sizes are resampled.
    pub size: [usize; 2],
    /// The camera, for pictures of two fisheyes and for its response; without one, panoramas in
    /// sRGB are expected.
    pub calibration: Option<Calibration>,
    /// What clipped lights are believed to be.
    pub prior: Prior,
    /// How the camera stands in the world.
    pub world_from_camera: Quat,
}

impl Default for LiveLightPlugin {
    fn default() -> Self {
        Self {
            size: [512, 256],
            calibration: None,
            prior: Prior::default(),
            world_from_camera: Quat::IDENTITY,
        }
    }
}

impl Plugin for LiveLightPlugin {
    fn build(&self, app: &mut App) {
        let shared = Arc::new(Shared::default());
        let worker = Worker::new(self.clone(), Arc::clone(&shared));
        let thread = std::thread::Builder::new().name("live light".into());
        if let Err(error) = thread.spawn(move || worker.run()) {
            warn!("no live light: its thread can't be started: {error}");
        }
        app.insert_resource(LiveLight {
            shared,
            map: Handle::default(),
            light_change: 0.0,
            lights: Vec::new(),
            sigma_ev: 0.0,
            rung: None,
            frames: 0,
            uploads: 0,
            problem: None,
        })
        .add_systems(PostUpdate, take_in.before(light::update_map));
    }
}

/// The light of the room as it is now; see [`LiveLightPlugin`].
#[derive(Resource, Debug)]
pub struct LiveLight {
    shared: Arc<Shared>,
    map: Handle<EnvironmentAsset>,
    /// T between the light before and this one, 0 … 1: > 0 only in the frame in which the
    /// environment changed. Denoisers keep the less of their history the larger it is.
    pub light_change: f32,
    /// Small lights, the sun among them, in the map's frame. The map has them drawn in.
    pub lights: Vec<Light>,
    /// One standard deviation of all light, EV.
    pub sigma_ev: f64,
    /// What the estimate rests on; `None` before the first frame.
    pub rung: Option<Rung>,
    /// Frames that were looked at.
    pub frames: u64,
    /// How often the environment was replaced.
    pub uploads: u64,
    /// Why the last frame could not be used.
    pub problem: Option<String>,
}

impl LiveLight {
    /// The environment that follows the camera; without an asset before the first light.
    pub fn map(&self) -> &Handle<EnvironmentAsset> {
        &self.map
    }

    /// Where a camera's thread puts its frames.
    pub fn camera(&self) -> LiveCamera {
        LiveCamera(Arc::clone(&self.shared))
    }
}

impl Drop for LiveLight {
    fn drop(&mut self) {
        self.shared.lock().is_closed = true;
        self.shared.arrived.notify_all();
    }
}

/// Takes frames from any thread.
#[derive(Clone, Debug)]
pub struct LiveCamera(Arc<Shared>);

impl LiveCamera {
    /// Hands over a frame and never waits: an older one of the same exposure that nobody has looked
    /// at is dropped. `false` when the app has ended.
    pub fn send(&self, frame: LiveFrame) -> bool {
        let mut state = self.0.lock();
        let is_same = |other: &LiveFrame| match (other.ev, frame.ev) {
            (Some(a), Some(b)) => (a - b).abs() < SAME_EV,
            (None, None) => true,
            _ => false,
        };
        state.waiting.retain(|other| !is_same(other));
        if state.waiting.len() >= WAITING_MAX {
            state.waiting.pop_front();
        }
        state.waiting.push_back(frame);
        self.0.arrived.notify_all();
        !state.is_closed
    }
}

/// What a camera took.
#[derive(Clone, Debug)]
pub struct LiveFrame {
    /// The picture.
    pub picture: LivePicture,
    /// Exposure, EV above one that stays the same: −6 lets through 1/64 of the light. `None` if
    /// the camera doesn't tell: then what most of the picture does is taken for it.
    pub ev: Option<f64>,
    /// When it was taken.
    pub captured: Instant,
}

/// Pixels as cameras give them.
#[derive(Clone, Debug)]
pub enum LivePicture {
    /// A latitude–longitude panorama, row by row.
    Panorama {
        /// Pixels across and down.
        size: [usize; 2],
        /// RGB codes.
        pixels: Vec<[u8; 3]>,
    },
    /// Two fisheyes, in the order and of the sizes of the calibration.
    Fisheyes {
        /// RGB codes, row by row.
        pictures: [Vec<[u8; 3]>; 2],
    },
}

/// Between the app, the camera and the worker.
#[derive(Debug, Default)]
struct Shared {
    state: Mutex<State>,
    arrived: Condvar,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        // A thread that panicked leaves queues as good as any.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[derive(Debug, Default)]
struct State {
    waiting: VecDeque<LiveFrame>,
    news: News,
    is_closed: bool,
}

/// What the worker found since the app last looked.
#[derive(Debug, Default)]
struct News {
    published: Option<Published>,
    last: Option<LightUpdate>,
    frames: u64,
    problem: Option<String>,
}

#[derive(Debug)]
struct Published {
    map: EnvironmentMap,
    lights: Vec<Light>,
    change: f64,
}

/// Takes in what the worker found.
fn take_in(
    mut live: ResMut<LiveLight>,
    mut environment: ResMut<VolumeEnvironment>,
    mut assets: ResMut<Assets<EnvironmentAsset>>,
) {
    let shared = Arc::clone(&live.shared);
    let news = std::mem::take(&mut shared.lock().news);
    if live.light_change != 0.0 {
        live.light_change = 0.0;
    }
    if news.frames == 0 {
        return;
    }
    live.frames += news.frames;
    if let Some(problem) = &news.problem
        && live.problem.as_ref() != Some(problem)
    {
        warn!("a frame gives no light: {problem}");
    }
    live.problem = news.problem;
    if let Some(update) = news.last {
        live.sigma_ev = update.sigma_ev;
        live.rung = Some(update.rung);
    }
    let Some(published) = news.published else {
        return;
    };
    live.light_change = published.change as f32;
    live.lights = published.lights;
    live.uploads += 1;
    let asset = EnvironmentAsset::new(published.map);
    if let Some(mut old) = assets.get_mut(&live.map) {
        *old = asset;
    } else {
        live.map = assets.add(asset);
        environment.source = EnvironmentSource::Map(live.map.clone());
    }
}

/// The thread's own.
struct Worker {
    plugin: LiveLightPlugin,
    shared: Arc<Shared>,
    chain: LightChain,
    stitcher: Option<Stitcher>,
    table: [[f32; 256]; 3],
    linear: Vec<[f32; 3]>,
    last: Option<Instant>,
}

impl Worker {
    fn new(plugin: LiveLightPlugin, shared: Arc<Shared>) -> Self {
        let [width, height] = plugin.size.map(|n| n.max(1));
        let response = plugin.calibration.as_ref().map(|c| c.response.clone());
        Self {
            chain: LightChain::new(width, height, plugin.prior),
            stitcher: None,
            table: response.unwrap_or(Response::Srgb).table(),
            linear: vec![[0.0; 3]; width * height],
            last: None,
            plugin: LiveLightPlugin {
                size: [width, height],
                ..plugin
            },
            shared,
        }
    }

    fn run(mut self) {
        while let Some(frame) = self.next() {
            let result = self.light_of(&frame);
            let mut state = self.shared.lock();
            let news = &mut state.news;
            news.frames += 1;
            match result {
                Ok((update, published)) => {
                    news.problem = None;
                    news.last = Some(update);
                    if let Some(mut published) = published {
                        // The app has not seen the one in between, but its change.
                        if let Some(missed) = &news.published {
                            published.change = published.change.max(missed.change);
                        }
                        news.published = Some(published);
                    }
                }
                Err(problem) => news.problem = Some(problem),
            }
        }
    }

    /// Waits for a frame; `None` at the end.
    fn next(&self) -> Option<LiveFrame> {
        let mut state = self.shared.lock();
        loop {
            if state.is_closed {
                return None;
            }
            if let Some(frame) = state.waiting.pop_front() {
                return Some(frame);
            }
            let waited = self.shared.arrived.wait(state);
            state = waited.unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn light_of(&mut self, frame: &LiveFrame) -> Result<(LightUpdate, Option<Published>), String> {
        self.linearise(&frame.picture)?;
        let since = |last: Instant| frame.captured.saturating_duration_since(last).as_secs_f64();
        let seconds = self.last.map_or(0.0, since).min(GAP_MAX);
        self.last = Some(frame.captured);
        let update = match frame.ev {
            Some(ev) if ev.is_finite() => self.chain.update(&self.linear, ev, seconds, None),
            _ => self.chain.update_untagged(&self.linear, seconds, None),
        };
        let published = self.chain.published().filter(|_| update.published);
        let published = published.map(|light| Published {
            map: light.whole_map(),
            lights: light.discs.clone(),
            change: update.change_since_published,
        });
        Ok((update, published))
    }

    /// Into `linear`, turned to the world.
    fn linearise(&mut self, picture: &LivePicture) -> Result<(), String> {
        let [width, height] = self.plugin.size;
        let world_from_camera = DMat3::from_quat(self.plugin.world_from_camera.as_dquat());
        match picture {
            LivePicture::Fisheyes { pictures } => {
                if self.stitcher.is_none() {
                    let calibration = self.plugin.calibration.as_ref();
                    let calibration =
                        calibration.ok_or("pictures of two fisheyes need a calibration")?;
                    let stitcher = Stitcher::new(calibration, width, height, world_from_camera);
                    self.stitcher = Some(stitcher.map_err(|error| error.to_string())?);
                }
                let pictures = pictures.each_ref().map(Vec::as_slice);
                match &mut self.stitcher {
                    Some(stitcher) => stitcher
                        .stitch(&FisheyePair { pictures }, &mut self.linear)
                        .map_err(|error| error.to_string()),
                    None => Ok(()),
                }
            }
            LivePicture::Panorama { size, pixels } => {
                let [across, down] = *size;
                if across == 0 || down == 0 || pixels.len() != across * down {
                    return Err(format!(
                        "a panorama of {across} × {down} with {} pixels",
                        pixels.len()
                    ));
                }
                let is_level = self.plugin.world_from_camera == Quat::IDENTITY;
                if is_level && size == &self.plugin.size {
                    for (out, code) in self.linear.iter_mut().zip(pixels) {
                        *out = decode(&self.table, *code);
                    }
                    return Ok(());
                }
                self.resample(*size, pixels, world_from_camera.transpose());
                Ok(())
            }
        }
    }

    /// The mean of 3 × 3 places in each texel.
    fn resample(&mut self, [across, down]: [usize; 2], pixels: &[[u8; 3]], turn: DMat3) {
        const SIDE: usize = 3;
        let [width, height] = self.plugin.size;
        for i in 0..self.linear.len() {
            let mut sum = [0.0; 3];
            for s in 0..SIDE * SIDE {
                let place = |k: usize| (k as f64 + 0.5) / SIDE as f64;
                let uv = [
                    ((i % width) as f64 + place(s % SIDE)) / width as f64,
                    ((i / width) as f64 + place(s / SIDE)) / height as f64,
                ];
                let seen = turn * EnvironmentMap::direction_from_uv(uv);
                let [u, v] = EnvironmentMap::uv_from_direction(seen);
                let at = |t: f64, n: usize| ((t * n as f64) as usize).min(n - 1);
                let texel = decode(&self.table, pixels[at(u, across) + across * at(v, down)]);
                for c in 0..3 {
                    sum[c] += texel[c] / (SIDE * SIDE) as f32;
                }
            }
            self.linear[i] = sum;
        }
    }
}

fn decode(table: &[[f32; 256]; 3], code: [u8; 3]) -> [f32; 3] {
    std::array::from_fn(|c| table[c][usize::from(code[c])])
}
