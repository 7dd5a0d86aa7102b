//! A session from its opening to its end.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bevy::prelude::*;
use holovol_render::wgpu;
use openxr::{
    AnyGraphics, Event, EventDataBuffer, FrameWaiter, Posef, ReferenceSpaceType, Session,
    SessionState, Time, sys,
};

use super::super::anchors::{self, Anchors, RuntimeAnchor};
use super::super::graphics::{Exclusive, GraphicsApi};
use super::super::input::Input;
use super::super::pose;
use super::super::runtime::{Runtime, STEREO};
use super::super::sight;
use super::super::{HeadsetBlend, HeadsetError, HeadsetState, HeadsetStatus, MixedRealitySettings};
use super::shared::SharedSession;
use super::{CurrentFrame, FrameTiming};

/// What the main world has of a session.
pub(crate) struct Live {
    waiter: FrameWaiter,
    pub(super) shared: Arc<SharedSession>,
    input: Input,
    pub(super) anchors: Anchors<RuntimeAnchor>,
    pub(super) is_begun: bool,
    /// Dropped last, here and in `shared`: what keeps the session until all else of it is gone.
    _session: Arc<Exclusive<Session<AnyGraphics>>>,
}

/// What ends a session.
pub(super) enum End {
    /// The session alone, by the user's will.
    Session,
    /// The connection to the runtime: all is looked for again, the headset too.
    Runtime(HeadsetError),
}

impl Live {
    /// Opens a session.
    pub(super) fn open(
        runtime: &Runtime,
        api: &GraphicsApi,
        device: &wgpu::Device,
        settings: &MixedRealitySettings,
        status: &mut HeadsetStatus,
    ) -> Result<Self, HeadsetError> {
        let size = runtime.eye_size(settings.eye_size, settings.resolution_factor())?;
        let wants_depth = settings.has_depth_layer && runtime.takes_depth;
        let opened = api.open_session(runtime, device, size, wants_depth)?;
        let offered = runtime.blend_modes()?;
        let choose = |offered: &[_]| {
            HeadsetBlend::choose(&settings.blend_preference, offered)
                .ok_or(HeadsetError::NoBlendMode)
        };
        let (blend, blend_mode) = choose(&offered)?;
        // As if it were the only one enumerated; the compositor is given one that it has.
        let blend = match settings.simulated_blend {
            Some(simulated) => choose(&[simulated.mode()])?.0,
            None => blend,
        };
        let keeps = Arc::new(opened.keeps);
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
        let input = Input::new(runtime, session);
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
        status.has_anchors = anchors::functions(session).is_some();
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
        Ok(Self {
            waiter: opened.waiter,
            input,
            anchors: Anchors::default(),
            is_begun: false,
            _session: Arc::clone(&keeps),
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
                _keeps: keeps,
            }),
        })
    }

    /// Takes in what has happened.
    pub(super) fn poll(
        &mut self,
        runtime: &Runtime,
        status: &mut HeadsetStatus,
    ) -> Result<(), End> {
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
                // Of a former run of it.
                self.shared.is_waited.store(false, Ordering::Relaxed);
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
            SessionState::EXITING => return Err(End::Session),
            SessionState::LOSS_PENDING => {
                return Err(End::of("xrPollEvent", sys::Result::ERROR_SESSION_LOST));
            }
            _ => status.state,
        };
        Ok(())
    }

    /// Waits for the time to begin a frame.
    pub(super) fn wait(&mut self, status: &mut HeadsetStatus) -> Result<CurrentFrame, End> {
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
        Self::Runtime(HeadsetError::Call { call, result })
    }
}
