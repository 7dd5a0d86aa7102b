//! World lock: what was put down stays at its place in the room.
//!
//! Tracking space shifts while the headset learns the room. Where the runtime has spatial anchors
//! (`XR_MSFT_spatial_anchor`), one is set where a [`Graspable`] rests, and the thing goes where the
//! anchor is found from then on, until somebody moves it.

use std::collections::HashMap;

use bevy::math::Isometry3d;
use bevy::prelude::*;
use openxr::sys::Handle as _;
use openxr::{AnyGraphics, Posef, Session, Space, Time, raw, sys};

use super::MixedRealitySettings;
use super::cost::FrameCost;
use super::eyes::MixedRealityOrigin;
use super::input;
use super::pose::posef;
use super::session::{Connection, CurrentFrame};
use crate::interaction::{Graspable, HandTargets};

/// s that a thing rests before it gets an anchor.
const REST: f32 = 0.5;
/// s to the next attempt, where the runtime refused one.
const RETRY: f32 = 2.0;
/// m and radians: less is an anchor's tremor, or rounding. Seen from 0.5 m, 0.02°.
const TREMOR: f32 = 2e-4;

/// Who has anchors. Poses are in tracking space.
pub(crate) trait AnchorSource {
    /// Gives back what it has when dropped.
    type Anchor;

    /// An anchor there; `None` where the runtime can't, for now.
    fn set(&self, pose: Isometry3d) -> Option<Self::Anchor>;

    /// Where it is; `None` while that isn't known.
    fn find(&self, anchor: &Self::Anchor) -> Option<Isometry3d>;
}

/// The anchors of a session, by what they hold.
pub(crate) struct Anchors<A>(HashMap<Entity, Hold<A>>);

impl<A> Default for Anchors<A> {
    fn default() -> Self {
        Self(HashMap::new())
    }
}

/// What is known of a thing.
struct Hold<A> {
    /// Where it was last, in tracking space.
    pose: Isometry3d,
    /// s since somebody moved it.
    rest: f32,
    anchor: Option<A>,
    is_there: bool,
}

impl<A> Hold<A> {
    fn new(pose: Isometry3d) -> Self {
        Self {
            pose,
            rest: 0.0,
            anchor: None,
            is_there: true,
        }
    }

    /// A thing is seen there; returns where it has to go.
    fn follow(
        &mut self,
        source: &impl AnchorSource<Anchor = A>,
        seen: Isometry3d,
        is_held: bool,
        seconds: f32,
    ) -> Option<Isometry3d> {
        self.is_there = true;
        if is_held || !is_near(&seen, &self.pose) {
            *self = Self::new(seen);
            return None;
        }
        let Some(anchor) = &self.anchor else {
            self.rest += seconds;
            if self.rest >= REST {
                self.anchor = source.set(seen);
                self.rest = REST - RETRY;
                self.pose = seen;
            }
            return None;
        };
        let found = source.find(anchor)?;
        if is_near(&found, &self.pose) {
            return None;
        }
        self.pose = found;
        Some(found)
    }
}

fn is_near(a: &Isometry3d, b: &Isometry3d) -> bool {
    // By cosines, as `angle_between` does, nothing below 5e-4 can be told.
    let (a_turn, b_turn) = (a.rotation, b.rotation);
    let angle = 2.0 * (a_turn - b_turn).length().min((a_turn + b_turn).length());
    a.translation.distance(b.translation) < TREMOR && angle < TREMOR
}

impl<A> Anchors<A> {
    /// Goes on by a frame. `place` is the world from tracking space; things are in the world.
    fn update<'a>(
        &mut self,
        source: &impl AnchorSource<Anchor = A>,
        place: Isometry3d,
        seconds: f32,
        things: impl Iterator<Item = (Entity, bool, Mut<'a, Transform>)>,
    ) {
        for hold in self.0.values_mut() {
            hold.is_there = false;
        }
        let tracking_from_world = place.inverse();
        for (entity, is_held, mut transform) in things {
            let pose = Isometry3d::new(transform.translation, transform.rotation.normalize());
            let seen = tracking_from_world * pose;
            let hold = self.0.entry(entity).or_insert_with(|| Hold::new(seen));
            if let Some(found) = hold.follow(source, seen, is_held, seconds) {
                let pose = place * found;
                transform.translation = pose.translation.into();
                transform.rotation = pose.rotation;
            }
        }
        self.0.retain(|_, hold| hold.is_there);
    }
}

type Things<'w, 's> =
    Query<'w, 's, (Entity, &'static mut Transform), (With<Graspable>, Without<ChildOf>)>;

/// `First`, after the eyes: before hands move anything.
#[expect(
    clippy::too_many_arguments,
    reason = "all that a thing's place depends on"
)]
pub(crate) fn follow(
    mut connection: ResMut<Connection>,
    frame: Res<CurrentFrame>,
    time: Res<bevy::time::Time>,
    settings: Res<MixedRealitySettings>,
    targets: Res<HandTargets>,
    origin: Query<&GlobalTransform, With<MixedRealityOrigin>>,
    mut things: Things,
    cost: Res<FrameCost>,
) {
    let _counting = cost.count();
    let (Some(shared), Some(timing)) = (&frame.shared, frame.timing) else {
        return;
    };
    let Some(anchors) = connection.anchors() else {
        return;
    };
    if !settings.locks_to_world {
        anchors.0.clear();
        return;
    }
    let Some(functions) = functions(&shared.session) else {
        return;
    };
    let source = RuntimeAnchors {
        functions,
        session: &shared.session,
        space: &shared.space,
        time: timing.display_time,
    };
    let place = origin.single().map(GlobalTransform::to_isometry);
    let is_held = |entity: Entity| {
        let mut targets = targets.0.iter().flatten();
        targets.any(|target| target.is_held && target.entity == Some(entity))
    };
    let things = things
        .iter_mut()
        .map(|(entity, transform)| (entity, is_held(entity), transform));
    anchors.update(
        &source,
        place.unwrap_or_default(),
        time.delta_secs(),
        things,
    );
}

/// Those of the extension, where the runtime has it.
pub(crate) fn functions(session: &Session<AnyGraphics>) -> Option<&raw::SpatialAnchorMSFT> {
    session.instance().exts().msft_spatial_anchor.as_ref()
}

/// Anchors of the runtime, at a display time.
struct RuntimeAnchors<'a> {
    functions: &'a raw::SpatialAnchorMSFT,
    session: &'a Session<AnyGraphics>,
    space: &'a Space,
    time: Time,
}

/// The anchor goes with its space.
pub(crate) struct RuntimeAnchor {
    space: Space,
    _handle: Handle,
}

struct Handle {
    anchor: sys::SpatialAnchorMSFT,
    destroy: sys::pfn::DestroySpatialAnchorMSFT,
}

impl Drop for Handle {
    #[expect(unsafe_code, reason = "a call to the runtime")]
    fn drop(&mut self) {
        // SAFETY: it was made by the runtime and isn't used any more.
        unsafe { (self.destroy)(self.anchor) };
    }
}

impl AnchorSource for RuntimeAnchors<'_> {
    type Anchor = RuntimeAnchor;

    #[expect(unsafe_code, reason = "a handle of the runtime becomes a space")]
    fn set(&self, pose: Isometry3d) -> Option<RuntimeAnchor> {
        let (session, space) = (self.session.as_raw(), self.space.as_raw());
        // SAFETY: session and space live.
        let made = unsafe { set(self.functions, session, space, posef(&pose), self.time) };
        let (handle, space) = made
            .inspect_err(|result| debug!("no anchor: {result}"))
            .ok()?;
        // SAFETY: a space of this session, which nobody else has.
        let space = unsafe { Space::reference_from_raw(self.session.clone(), space) };
        Some(RuntimeAnchor {
            space,
            _handle: handle,
        })
    }

    fn find(&self, anchor: &RuntimeAnchor) -> Option<Isometry3d> {
        input::locate(&anchor.space, self.space, self.time).ok()?
    }
}

/// An anchor at a pose in a space, and a space about it.
///
/// # Safety
/// The handles must be alive, and the functions those of their runtime.
#[expect(
    unsafe_code,
    reason = "calls to the runtime that openxr has no methods for"
)]
unsafe fn set(
    functions: &raw::SpatialAnchorMSFT,
    session: sys::Session,
    space: sys::Space,
    pose: Posef,
    time: Time,
) -> openxr::Result<(Handle, sys::Space)> {
    let check = |result: sys::Result| {
        if result.into_raw() < 0 {
            Err(result)
        } else {
            Ok(())
        }
    };
    let info = sys::SpatialAnchorCreateInfoMSFT {
        ty: sys::SpatialAnchorCreateInfoMSFT::TYPE,
        next: std::ptr::null(),
        space,
        pose,
        time,
    };
    let mut anchor = sys::SpatialAnchorMSFT::NULL;
    // SAFETY: structures are of their type and live through the call.
    check(unsafe { (functions.create_spatial_anchor)(session, &info, &mut anchor) })?;
    let handle = Handle {
        anchor,
        destroy: functions.destroy_spatial_anchor,
    };
    let info = sys::SpatialAnchorSpaceCreateInfoMSFT {
        ty: sys::SpatialAnchorSpaceCreateInfoMSFT::TYPE,
        next: std::ptr::null(),
        anchor,
        pose_in_anchor_space: Posef::IDENTITY,
    };
    let mut space = sys::Space::NULL;
    // SAFETY: as before.
    check(unsafe { (functions.create_spatial_anchor_space)(session, &info, &mut space) })?;
    Ok((handle, space))
}

#[cfg(test)]
mod tests;
