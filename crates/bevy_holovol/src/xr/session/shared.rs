//! What both worlds have of a session, and where its eyes are.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use openxr::{AnyGraphics, EnvironmentBlendMode, Posef, Session, Space, Time, ViewStateFlags, sys};

use super::super::HeadsetBlend;
use super::super::graphics::{Exclusive, Frames};
use super::super::pose::{EyeHistory, EyeView, FieldOfView, RawView, TamperedViews};
use super::super::runtime::STEREO;
use super::super::sight::HiddenParts;

/// What both worlds have of a session.
pub(crate) struct SharedSession {
    pub(crate) session: Session<AnyGraphics>,
    pub(crate) space: Space,
    pub(crate) blend_mode: EnvironmentBlendMode,
    pub(crate) blend: HeadsetBlend,
    /// Waited for and not begun: a second wait would block for ever.
    pub(super) is_waited: AtomicBool,
    pub(super) failure: Mutex<Option<(&'static str, sys::Result)>>,
    pub(super) histories: Mutex<[EyeHistory; 2]>,
    pub(super) tamper: Option<TamperedViews>,
    /// What of their images the eyes can't see.
    pub(super) hidden: Mutex<[HiddenParts; 2]>,
    /// 1/s, ascending; empty where they can't be chosen.
    pub(crate) refresh_rates: Vec<f32>,
    pub(super) frames: Mutex<Box<dyn Frames>>,
    /// Dropped last: the session ends while no one else is at the queue, whoever has this last.
    pub(super) _keeps: Arc<Exclusive<Session<AnyGraphics>>>,
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
