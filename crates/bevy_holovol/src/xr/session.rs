//! The life of a session, in the main world: found, begun, ended, lost and found again.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use bevy::math::Isometry3d;
use bevy::prelude::*;
use bevy::render::renderer::RenderDevice;
use bevy::tasks::{IoTaskPool, Task, futures::check_ready};
use openxr::{
    AnyGraphics, EnvironmentBlendMode, Event, EventDataBuffer, FrameWaiter, Posef,
    ReferenceSpaceType, Session, SessionState, Space, Time, ViewStateFlags, sys,
};

use super::cost::FrameCost;
use super::graphics::{Frames, GraphicsApi};
use super::pose::{self, EyeHistory, EyeView, FieldOfView, RawView, TamperedViews};
use super::runtime::{Runtime, STEREO};
use super::sight::{self, HiddenParts};
use super::{
    HeadsetBlend, HeadsetError, HeadsetRequest, HeadsetState, HeadsetStatus, MixedRealitySettings,
};
use crate::interaction::Hands;

/// Between two looks for a runtime that is gone.
const RETRY_INTERVAL: Duration = Duration::from_secs(1);
/// A frame of an app whose headset wants none: keeps it from spinning.
const IDLE_FRAME: Duration = Duration::from_millis(10);

/// What both worlds have of a session.
pub(crate) struct SharedSession {
    pub(crate) session: Session<AnyGraphics>,
    pub(crate) space: Space,
    pub(crate) blend_mode: EnvironmentBlendMode,
    pub(crate) blend: HeadsetBlend,
    /// Waited for and not begun: a second wait would block for ever.
    is_waited: AtomicBool,
    failure: Mutex<Option<(&'static str, sys::Result)>>,
    histories: Mutex<[EyeHistory; 2]>,
    tamper: Option<TamperedViews>,
    /// What of their images the eyes can't see.
    hidden: Mutex<[HiddenParts; 2]>,
    /// 1/s, ascending; empty where they can't be chosen.
    pub(crate) refresh_rates: Vec<f32>,
    frames: Mutex<Box<dyn Frames>>,
}

impl SharedSession {
    pub(crate) fn frames(&self) -> MutexGuard<'_, Box<dyn Frames>> {
        self.frames.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn hidden(&self) -> [HiddenParts; 2] {
        let hidden = self.hidden.lock().unwrap_or_else(PoisonError::into_inner);
        hidden.clone()
    }

    /// Notes what ends the session; the first failure is the cause.
    pub(crate) fn fail(&self, call: &'static str, result: sys::Result) {
        let mut failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner);
        failure.get_or_insert((call, result));
    }

    /// Begins the frame that was waited for.
    pub(crate) fn begin(&self) -> bool {
        self.is_waited.store(false, Ordering::Relaxed);
        let result = self.frames().begin();
        // A frame that is discarded by this one was never ended: an error of ours, not a loss.
        result
            .map_err(|result| self.fail("xrBeginFrame", result))
            .is_ok()
    }

    /// The eyes at that time, as far as they are known; never what can't be drawn with.
    pub(crate) fn locate(&self, time: Time) -> Option<[EyeView; 2]> {
        let mut histories = self
            .histories
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        match locate_views(&self.session, time, &self.space) {
            Ok((flags, views)) => {
                for (history, view) in histories.iter_mut().zip(&views) {
                    let mut raw = raw_view(flags, view);
                    if let Some(TamperedViews(tamper)) = self.tamper {
                        tamper(time.as_nanos(), &mut raw);
                    }
                    history.update(&raw);
                }
            }
            Err(result) if is_loss(result) => self.fail("xrLocateViews", result),
            // A time or space that isn't known for a while: the eyes stay where they were.
            Err(_) => {}
        }
        let [left, right] = *histories;
        Some([left.view()?, right.view()?])
    }
}

/// As [`Session::locate_views`], which allocates.
#[expect(unsafe_code, reason = "a call to the runtime with room for two views")]
fn locate_views(
    session: &Session<AnyGraphics>,
    display_time: Time,
    space: &Space,
) -> Result<(ViewStateFlags, [sys::View; 2]), sys::Result> {
    let info = sys::ViewLocateInfo {
        ty: sys::ViewLocateInfo::TYPE,
        next: std::ptr::null(),
        view_configuration_type: STEREO,
        display_time,
        space: space.as_raw(),
    };
    let mut state = sys::ViewState {
        ty: sys::ViewState::TYPE,
        next: std::ptr::null_mut(),
        view_state_flags: ViewStateFlags::EMPTY,
    };
    let mut views = [sys::View {
        ty: sys::View::TYPE,
        next: std::ptr::null_mut(),
        pose: Posef::IDENTITY,
        fov: openxr::Fovf::default(),
    }; 2];
    let mut count = 0;
    let locate = session.instance().fp().locate_views;
    // SAFETY: all structures are of their type and live through the call; there is room for two
    // views, as that call is told.
    let result = unsafe {
        locate(
            session.as_raw(),
            &info,
            &mut state,
            2,
            &mut count,
            views.as_mut_ptr(),
        )
    };
    if result.into_raw() < 0 {
        Err(result)
    } else if count == 2 {
        Ok((state.view_state_flags, views))
    } else {
        Err(sys::Result::ERROR_VALIDATION_FAILURE)
    }
}

fn raw_view(flags: ViewStateFlags, view: &sys::View) -> RawView {
    let has = |flag| flags & flag == flag;
    let (q, p, fov) = (view.pose.orientation, view.pose.position, view.fov);
    RawView {
        orientation: has(ViewStateFlags::ORIENTATION_VALID).then_some([q.x, q.y, q.z, q.w]),
        position: has(ViewStateFlags::POSITION_VALID).then_some([p.x, p.y, p.z]),
        fov: FieldOfView {
            left: fov.angle_left,
            right: fov.angle_right,
            up: fov.angle_up,
            down: fov.angle_down,
        },
    }
}

fn is_loss(result: sys::Result) -> bool {
    matches!(
        result,
        sys::Result::ERROR_INSTANCE_LOST
            | sys::Result::ERROR_SESSION_LOST
            | sys::Result::ERROR_RUNTIME_FAILURE
            | sys::Result::ERROR_HANDLE_INVALID
    )
}

/// The frame that is being made; in the main world, copied to the render world.
#[derive(Resource, Clone, Default)]
pub(crate) struct CurrentFrame {
    pub(crate) shared: Option<Arc<SharedSession>>,
    /// `None` while the runtime paces no frames.
    pub(crate) timing: Option<FrameTiming>,
    /// As known at the frame's beginning; the render world asks once more.
    pub(crate) views: Option<[EyeView; 2]>,
    /// In tracking space.
    pub(crate) hands: Hands,
    /// Where the eyes look, −z, in tracking space.
    pub(crate) gaze: Option<Isometry3d>,
}

#[derive(Clone, Copy)]
pub(crate) struct FrameTiming {
    pub(crate) display_time: Time,
    pub(crate) should_render: bool,
}

/// Everything of the main world's.
#[derive(Resource)]
pub(crate) struct Connection {
    pub(crate) app_name: String,
    pub(crate) api: GraphicsApi,
    pub(crate) link: Link,
    /// After a stop that was wanted.
    pub(crate) has_ended: bool,
}

pub(crate) enum Link {
    /// There is no runtime, or it refused; the next look is at that time.
    Gone(Instant),
    Looking(Task<Result<Runtime, HeadsetError>>),
    Found(Runtime, Option<Box<Live>>),
}

pub(crate) struct Live {
    waiter: FrameWaiter,
    pub(crate) shared: Arc<SharedSession>,
    pub(crate) input: super::input::Input,
    is_begun: bool,
}

/// What ends a session.
enum End {
    /// The session alone, by the runtime's or the user's will.
    Session { again: bool },
    /// The connection to the runtime.
    Runtime(HeadsetError),
}

impl Connection {
    /// Goes on by one frame.
    fn update(
        &mut self,
        device: &RenderDevice,
        settings: &MixedRealitySettings,
        requests: impl Iterator<Item = HeadsetRequest>,
        status: &mut HeadsetStatus,
    ) -> CurrentFrame {
        for request in requests {
            match request {
                HeadsetRequest::Start => self.has_ended = false,
                HeadsetRequest::Stop => self.stop(status),
            }
        }
        self.look(status);
        let Link::Found(runtime, live) = &mut self.link else {
            return CurrentFrame::default();
        };
        if live.is_none() && !self.has_ended {
            match open(runtime, &self.api, device, settings, status) {
                Ok(opened) => *live = Some(Box::new(opened)),
                Err(error) => {
                    self.lose(error, status);
                    return CurrentFrame::default();
                }
            }
        }
        let end = match live {
            Some(live) => match live.poll(runtime, status) {
                Ok(()) => match live.wait(status) {
                    Ok(frame) => return frame,
                    Err(end) => end,
                },
                Err(end) => end,
            },
            None => return CurrentFrame::default(),
        };
        match end {
            End::Session { again } => {
                *live = None;
                self.has_ended = !again;
                status.state = if again {
                    HeadsetState::Lost
                } else {
                    HeadsetState::Ended
                };
            }
            End::Runtime(error) => self.lose(error, status),
        }
        CurrentFrame::default()
    }

    /// Ends the session as soon as the runtime agrees.
    fn stop(&mut self, status: &mut HeadsetStatus) {
        match &self.link {
            Link::Found(_, Some(live)) if live.is_begun => {
                if let Err(result) = live.shared.session.request_exit() {
                    live.shared.fail("xrRequestExitSession", result);
                }
            }
            // Nothing runs that would have to agree.
            _ => {
                if let Link::Found(_, live) = &mut self.link {
                    *live = None;
                }
                self.has_ended = true;
                status.state = HeadsetState::Ended;
            }
        }
    }

    fn lose(&mut self, error: HeadsetError, status: &mut HeadsetStatus) {
        if status.state != HeadsetState::Lost || status.problem.is_none() {
            warn!("{error}");
        }
        status.state = HeadsetState::Lost;
        status.problem = Some(error.to_string());
        self.link = Link::Gone(Instant::now() + RETRY_INTERVAL);
    }

    /// Looks for a runtime that is gone, on a worker: some take their time to say no.
    fn look(&mut self, status: &mut HeadsetStatus) {
        if self.has_ended {
            return;
        }
        match &mut self.link {
            Link::Gone(retry_at) if Instant::now() >= *retry_at => {
                let name = self.app_name.clone();
                let task = IoTaskPool::get().spawn(async move { Runtime::find(&name) });
                self.link = Link::Looking(task);
            }
            Link::Looking(task) => match check_ready(task) {
                Some(Ok(runtime)) => {
                    info!("reconnected to {}", runtime.name);
                    status.reconnections += 1;
                    status.problem = None;
                    self.link = Link::Found(runtime, None);
                }
                Some(Err(error)) => self.lose(error, status),
                None => {}
            },
            _ => {}
        }
    }
}

/// Opens a session.
fn open(
    runtime: &Runtime,
    api: &GraphicsApi,
    device: &RenderDevice,
    settings: &MixedRealitySettings,
    status: &mut HeadsetStatus,
) -> Result<Live, HeadsetError> {
    let size = runtime.eye_size(settings.eye_size, settings.resolution_factor())?;
    let wants_depth = settings.has_depth_layer && runtime.takes_depth;
    let opened = api.open_session(runtime, device.wgpu_device(), size, wants_depth)?;
    let offered = runtime.blend_modes()?;
    let (blend, blend_mode) = HeadsetBlend::choose(&settings.blend_preference, &offered)
        .ok_or(HeadsetError::NoBlendMode)?;
    let blend = settings.simulated_blend.unwrap_or(blend);
    let session = &opened.session;
    let spaces = session
        .enumerate_reference_spaces()
        .map_err(HeadsetError::of("xrEnumerateReferenceSpaces"))?;
    // The floor's middle, which recentering leaves alone; else where the head was.
    let space = if spaces.contains(&ReferenceSpaceType::STAGE) {
        ReferenceSpaceType::STAGE
    } else {
        ReferenceSpaceType::LOCAL
    };
    let space = session
        .create_reference_space(space, Posef::IDENTITY)
        .map_err(HeadsetError::of("xrCreateReferenceSpace"))?;
    let input = super::input::Input::new(runtime, session);
    let hidden = [0, 1].map(|eye| sight::hidden_parts(runtime, session, eye));
    let refresh_rates = if runtime.has_refresh_rates {
        session
            .enumerate_display_refresh_rates()
            .unwrap_or_default()
    } else {
        Vec::new()
    };
    status.state = HeadsetState::Idle;
    status.runtime.clone_from(&runtime.name);
    status.headset.clone_from(&runtime.system_name);
    status.blend = blend;
    status.eye_size = UVec2::from(opened.size);
    status.has_depth_layer = opened.depth_format.is_some();
    status.sessions += 1;
    status.problem = None;
    info!(
        "{} on {}: {} × {} pixels per eye, {blend:?}, {:?}, depth: {:?}",
        runtime.system_name,
        runtime.name,
        opened.size[0],
        opened.size[1],
        opened.format,
        opened.depth_format
    );
    Ok(Live {
        waiter: opened.waiter,
        input,
        is_begun: false,
        shared: Arc::new(SharedSession {
            session: opened.session,
            space,
            blend_mode,
            blend,
            is_waited: AtomicBool::new(false),
            failure: Mutex::default(),
            histories: Mutex::default(),
            tamper: settings.tampered_views,
            hidden: Mutex::new(hidden),
            refresh_rates,
            frames: Mutex::new(opened.frames),
        }),
    })
}

impl Live {
    /// Takes in what has happened.
    fn poll(&mut self, runtime: &Runtime, status: &mut HeadsetStatus) -> Result<(), End> {
        let failure = self
            .shared
            .failure
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        if let Some((call, result)) = failure {
            return Err(End::of(call, result));
        }
        let mut buffer = EventDataBuffer::new();
        loop {
            match runtime.instance.poll_event(&mut buffer) {
                Ok(Some(event)) => self.take_in(&event, runtime, status)?,
                Ok(None) => return Ok(()),
                Err(result) => return Err(End::of("xrPollEvent", result)),
            }
        }
    }

    fn take_in(
        &mut self,
        event: &Event<'_>,
        runtime: &Runtime,
        status: &mut HeadsetStatus,
    ) -> Result<(), End> {
        match event {
            Event::SessionStateChanged(change) => self.enter(change.state(), status),
            Event::InstanceLossPending(_) => {
                Err(End::of("xrPollEvent", sys::Result::ERROR_INSTANCE_LOST))
            }
            Event::ReferenceSpaceChangePending(_) => {
                status.recenterings += 1;
                Ok(())
            }
            Event::VisibilityMaskChangedKHR(change) => {
                let shared = &self.shared;
                let mut hidden = shared.hidden.lock().unwrap_or_else(PoisonError::into_inner);
                let eye = change.view_index();
                if let Some(parts) = hidden.get_mut(eye as usize) {
                    *parts = sight::hidden_parts(runtime, &shared.session, eye);
                }
                Ok(())
            }
            Event::EventsLost(lost) => {
                warn!(
                    "the headset's runtime lost {} events",
                    lost.lost_event_count()
                );
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn enter(&mut self, state: SessionState, status: &mut HeadsetStatus) -> Result<(), End> {
        let session = &self.shared.session;
        status.state = match state {
            SessionState::IDLE => HeadsetState::Idle,
            SessionState::READY => {
                session
                    .begin(STEREO)
                    .map_err(|result| End::of("xrBeginSession", result))?;
                self.is_begun = true;
                HeadsetState::Starting
            }
            SessionState::SYNCHRONIZED => HeadsetState::Synchronized,
            SessionState::VISIBLE => HeadsetState::Visible,
            SessionState::FOCUSED => HeadsetState::Focused,
            SessionState::STOPPING => {
                self.is_begun = false;
                session
                    .end()
                    .map_err(|result| End::of("xrEndSession", result))?;
                HeadsetState::Stopping
            }
            SessionState::EXITING => return Err(End::Session { again: false }),
            SessionState::LOSS_PENDING => return Err(End::Session { again: true }),
            _ => status.state,
        };
        Ok(())
    }

    /// Waits for the time to begin a frame.
    fn wait(&mut self, status: &mut HeadsetStatus) -> Result<CurrentFrame, End> {
        let mut frame = CurrentFrame {
            shared: Some(Arc::clone(&self.shared)),
            ..default()
        };
        if !self.is_begun {
            return Ok(frame);
        }
        if self.shared.is_waited.load(Ordering::Relaxed) {
            // The render world did not come to it.
            self.shared.begin();
            frame.abandon_last(status);
        }
        let state = self
            .waiter
            .wait()
            .map_err(|result| End::of("xrWaitFrame", result))?;
        self.shared.is_waited.store(true, Ordering::Relaxed);
        status.frames += 1;
        status.period =
            Duration::from_nanos(state.predicted_display_period.as_nanos().max(0) as u64);
        frame.timing = Some(FrameTiming {
            display_time: state.predicted_display_time,
            should_render: state.should_render,
        });
        frame.views = self.shared.locate(state.predicted_display_time);
        if status.state == HeadsetState::Focused {
            let shared = &self.shared;
            let head = frame
                .views
                .as_ref()
                .map(|views| pose::head(views).translation.into());
            let time = state.predicted_display_time;
            frame.hands = self
                .input
                .locate(&shared.session, &shared.space, time, head);
            frame.gaze = self.input.gaze(&shared.space, time);
        }
        Ok(frame)
    }
}

impl CurrentFrame {
    /// Ends a frame that nobody has drawn.
    fn abandon_last(&self, status: &mut HeadsetStatus) {
        if let Some(shared) = &self.shared {
            let time = Time::from_nanos(status.last_display_time);
            if let Err(result) = shared.frames().end(time, shared.blend_mode, None) {
                shared.fail("xrEndFrame", result);
            }
        }
    }
}

impl End {
    fn of(call: &'static str, result: sys::Result) -> Self {
        match result {
            sys::Result::ERROR_SESSION_LOST => Self::Session { again: true },
            _ => Self::Runtime(HeadsetError::Call { call, result }),
        }
    }
}

/// `First`: everything between two frames, and the wait for the next.
#[expect(
    clippy::too_many_arguments,
    reason = "all that a session has to do with"
)]
pub(crate) fn update(
    mut connection: ResMut<Connection>,
    device: Res<RenderDevice>,
    settings: Res<MixedRealitySettings>,
    mut requests: MessageReader<HeadsetRequest>,
    mut status: ResMut<HeadsetStatus>,
    mut frame: ResMut<CurrentFrame>,
    mut exit: MessageWriter<AppExit>,
    cost: Res<FrameCost>,
) {
    let _counting = cost.count();
    let had_ended = status.state == HeadsetState::Ended;
    // The former frame's hold on a session ends here, so that a lost one can go.
    *frame = CurrentFrame::default();
    *frame = connection.update(&device, &settings, requests.read().copied(), &mut status);
    if let Some(timing) = &frame.timing {
        status.last_display_time = timing.display_time.as_nanos();
        status.is_tracked = frame.views.is_some();
        status.has_gaze = frame.gaze.is_some();
    } else {
        std::thread::sleep(IDLE_FRAME);
    }
    if status.state == HeadsetState::Ended && !had_ended && settings.exits_app {
        exit.write(AppExit::Success);
    }
}
