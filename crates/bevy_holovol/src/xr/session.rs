//! The life of sessions, in the main world: found, begun, ended, lost and found again.

mod live;
mod shared;
mod successor;

use std::sync::Arc;
use std::time::{Duration, Instant};

use bevy::math::Isometry3d;
use bevy::prelude::*;
use bevy::render::error_handler::RenderErrorHandler;
use bevy::render::renderer::RenderDevice;
use bevy::tasks::{IoTaskPool, Task, futures::check_ready};
use holovol_render::wgpu;
use openxr::Time;

use super::anchors::{Anchors, RuntimeAnchor};
use super::cost::FrameCost;
use super::graphics::{DeviceParts, GraphicsApi};
use super::pose::EyeView;
use super::runtime::Runtime;
use super::{
    HeadsetError, HeadsetRequest, HeadsetState, HeadsetStatus, MixedRealitySettings, RefusedDevices,
};
use crate::interaction::Hands;
use live::{End, Live};
use shared::SharedSession;
pub(crate) use successor::Successor;

/// Between two looks for a runtime that is gone.
const RETRY_INTERVAL: Duration = Duration::from_secs(1);
/// Devices opened for a runtime that shows nothing with them: Bevy begins anew with each.
const MOST_DEVICE_TRIES: u8 = 3;
/// A frame of an app whose headset wants none: keeps it from spinning.
const IDLE_FRAME: Duration = Duration::from_millis(10);

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
    /// That of the `api`, which lives as long as this.
    pub(crate) device: wgpu::Device,
    /// Bevy renders with it.
    pub(crate) is_in_use: bool,
    /// It was opened for the runtime in use; else for one that is gone.
    pub(crate) is_device_of_runtime: bool,
    /// Opened since a frame was paced.
    pub(crate) device_tries: u8,
    /// After it was gone, and no session has opened since.
    pub(crate) is_found_again: bool,
    pub(crate) link: Link,
    /// After a stop that was wanted.
    pub(crate) has_ended: bool,
}

pub(crate) enum Link {
    /// There is no runtime, or it refused; the next look is at that time.
    Gone(Instant),
    Looking(Task<Result<Runtime, HeadsetError>>),
    Found(Runtime, Option<Box<Live>>),
    /// The device that the runtime wants is opened.
    Opening(
        Runtime,
        Task<Result<(GraphicsApi, DeviceParts), HeadsetError>>,
    ),
    /// Bevy is to go on with it.
    HandingOver(Runtime),
}

/// What else of the app a connection has to do with.
struct Surroundings<'a> {
    /// Bevy's.
    device: Res<'a, RenderDevice>,
    settings: &'a MixedRealitySettings,
    successor: &'a mut Successor,
}

impl Connection {
    /// Goes on by one frame.
    fn update(
        &mut self,
        around: &mut Surroundings<'_>,
        requests: impl Iterator<Item = HeadsetRequest>,
        status: &mut HeadsetStatus,
    ) -> CurrentFrame {
        for request in requests {
            match request {
                HeadsetRequest::Start => {
                    self.has_ended = false;
                    self.device_tries = 0;
                }
                HeadsetRequest::Stop => self.stop(status),
            }
        }
        self.look(status);
        self.change_device(around, status);
        let Link::Found(runtime, live) = &mut self.link else {
            return CurrentFrame::default();
        };
        if live.is_none() && !self.has_ended {
            let is_refused = match around.settings.refused_devices {
                RefusedDevices::None => false,
                RefusedDevices::OfFormerRuntimes => !self.is_device_of_runtime,
                RefusedDevices::All => true,
            };
            let opened = if is_refused {
                Err(HeadsetError::OtherDevice)
            } else {
                Live::open(runtime, &self.api, &self.device, around.settings, status)
            };
            match opened {
                Ok(opened) => {
                    *live = Some(Box::new(opened));
                    if std::mem::take(&mut self.is_found_again) {
                        info!("reconnected to {}", runtime.name);
                        status.reconnections += 1;
                    }
                }
                Err(HeadsetError::OtherDevice)
                    if around.settings.may_replace_device
                        && !self.is_device_of_runtime
                        && self.device_tries < MOST_DEVICE_TRIES =>
                {
                    self.open_device();
                    return CurrentFrame::default();
                }
                Err(error) => {
                    self.lose(error, status);
                    return CurrentFrame::default();
                }
            }
        }
        let end = match live {
            Some(live) => match live.poll(runtime, status) {
                Ok(()) => match live.wait(status) {
                    Ok(frame) => {
                        if frame.timing.is_some() {
                            self.device_tries = 0;
                        }
                        return frame;
                    }
                    Err(end) => end,
                },
                Err(end) => end,
            },
            None => return CurrentFrame::default(),
        };
        match end {
            End::Session => {
                *live = None;
                self.has_ended = true;
                status.state = HeadsetState::Ended;
            }
            End::Runtime(error) => self.lose(error, status),
        }
        CurrentFrame::default()
    }

    /// Of the session, if there is one.
    pub(crate) fn anchors(&mut self) -> Option<&mut Anchors<RuntimeAnchor>> {
        match &mut self.link {
            Link::Found(_, Some(live)) => Some(&mut live.anchors),
            _ => None,
        }
    }

    /// Ends the session as soon as the runtime agrees.
    fn stop(&mut self, status: &mut HeadsetStatus) {
        match &self.link {
            Link::Found(_, Some(live)) if live.is_begun => {
                if let Err(result) = live.shared.session.request_exit() {
                    live.shared.fail("xrRequestExitSession", result);
                    self.has_ended = true;
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

    /// Opens the device that the runtime wants, on a worker: drivers take their time.
    fn open_device(&mut self) {
        if let Link::Found(runtime, _) = &self.link {
            let runtime = runtime.clone();
            let wanted = runtime.clone();
            let task = IoTaskPool::get().spawn(async move { GraphicsApi::open_device(&wanted) });
            self.link = Link::Opening(runtime, task);
            self.device_tries = self.device_tries.saturating_add(1);
        }
    }

    /// Sees that Bevy renders with the device that the runtime has.
    fn change_device(&mut self, around: &mut Surroundings<'_>, status: &mut HeadsetStatus) {
        if around.device.is_changed() {
            self.is_in_use = self.api.is_of(around.device.wgpu_device());
        }
        if self.has_ended
            && let Link::Opening(runtime, _) = &self.link
        {
            self.link = Link::Found(runtime.clone(), None);
        }
        let may_replace =
            around.settings.may_replace_device && self.device_tries < MOST_DEVICE_TRIES;
        match &mut self.link {
            // Bevy has lost the device and got another one, by the app's will.
            Link::Found(_, live) if !self.is_in_use && !self.has_ended => {
                *live = None;
                status.state = HeadsetState::Lost;
                if may_replace {
                    self.open_device();
                } else {
                    self.lose(HeadsetError::OtherDevice, status);
                }
            }
            Link::Opening(runtime, task) => match check_ready(task) {
                Some(Ok((api, parts))) => {
                    self.api = api;
                    self.device = parts.device.clone();
                    self.is_in_use = false;
                    self.link = Link::HandingOver(runtime.clone());
                    around.successor.announce(parts, &around.device);
                }
                Some(Err(error)) => self.lose(error, status),
                None => {}
            },
            Link::HandingOver(runtime) if self.is_in_use => {
                around.successor.arrive();
                info!("Bevy goes on with the graphics device of {}", runtime.name);
                status.device_changes += 1;
                self.is_device_of_runtime = true;
                self.link = Link::Found(runtime.clone(), None);
            }
            // Bevy has lost the one before it as well, and got another one by the app's will.
            Link::HandingOver(_) if around.device.is_changed() => {
                around.successor.take_away(&around.device);
            }
            _ => {}
        }
    }

    fn lose(&mut self, error: HeadsetError, status: &mut HeadsetStatus) {
        let problem = error.to_string();
        // Once, not at every look.
        if status.problem.as_ref() != Some(&problem) {
            warn!("{problem}");
        }
        status.state = if self.has_ended {
            HeadsetState::Ended
        } else {
            HeadsetState::Lost
        };
        status.problem = Some(problem);
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
                    self.is_device_of_runtime = false;
                    self.is_found_again = true;
                    self.link = Link::Found(runtime, None);
                }
                Some(Err(error)) => self.lose(error, status),
                None => {}
            },
            _ => {}
        }
    }
}

/// `Last`, so that a handler that the app inserts in a frame is not asked about our change of device in
/// that one.
pub(crate) fn listen(mut successor: ResMut<Successor>, mut handler: ResMut<RenderErrorHandler>) {
    // In most frames nothing has changed, and isn't marked so.
    if Successor::is_bypassed(&handler) {
        successor.listen(&mut handler);
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
    mut successor: ResMut<Successor>,
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
    let mut around = Surroundings {
        device,
        settings: &settings,
        successor: &mut successor,
    };
    *frame = connection.update(&mut around, requests.read().copied(), &mut status);
    if let Some(timing) = &frame.timing {
        status.last_display_time = timing.display_time.as_nanos();
        status.is_tracked = frame.views.is_some();
        status.has_gaze = frame.gaze.is_some();
    } else {
        (status.is_tracked, status.has_gaze) = (false, false);
        std::thread::sleep(IDLE_FRAME);
    }
    if status.state == HeadsetState::Ended && !had_ended && settings.exits_app {
        exit.write(AppExit::Success);
    }
}
