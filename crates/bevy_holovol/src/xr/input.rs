//! Hands and controllers, as the runtime gives them.

use bevy::math::{Isometry3d, Vec3};
use openxr::{
    Action, ActionSet, AnyGraphics, Binding, HandTracker, Instance, Path, Posef, Session, Space,
    SpaceLocationFlags, Time, sys,
};

use super::pose::{place, rotation};
use super::runtime::Runtime;
use crate::interaction::{Hand, Hands, JOINT_COUNT};

const HANDS: [&str; 2] = ["/user/hand/left", "/user/hand/right"];
const POKE_REACH: Vec3 = Vec3::new(0.0, 0.0, -0.03);

/// An interaction profile and, within a hand, what is asked of it.
struct Profile {
    path: &'static str,
    grip: &'static str,
    aim: &'static str,
    /// What takes things, the firmest first.
    squeezes: &'static [&'static str],
}

const EYES: &str = "/user/eyes_ext";
const GAZE_PROFILE: &str = "/interaction_profiles/ext/eye_gaze_interaction";

/// Runtimes choose the one that fits what is there; those they don't know are passed over.
const PROFILES: [Profile; 6] = [
    Profile {
        path: "/interaction_profiles/ext/hand_interaction_ext",
        grip: "input/grip/pose",
        aim: "input/aim/pose",
        squeezes: &["input/pinch_ext/value", "input/grasp_ext/value"],
    },
    Profile {
        path: "/interaction_profiles/microsoft/hand_interaction",
        grip: "input/grip/pose",
        aim: "input/aim/pose",
        squeezes: &["input/select/value", "input/squeeze/value"],
    },
    Profile {
        path: "/interaction_profiles/oculus/touch_controller",
        grip: "input/grip/pose",
        aim: "input/aim/pose",
        squeezes: &["input/trigger/value", "input/squeeze/value"],
    },
    Profile {
        path: "/interaction_profiles/valve/index_controller",
        grip: "input/grip/pose",
        aim: "input/aim/pose",
        squeezes: &["input/trigger/value", "input/squeeze/value"],
    },
    Profile {
        path: "/interaction_profiles/microsoft/motion_controller",
        grip: "input/grip/pose",
        aim: "input/aim/pose",
        squeezes: &["input/trigger/value", "input/squeeze/click"],
    },
    Profile {
        path: "/interaction_profiles/khr/simple_controller",
        grip: "input/grip/pose",
        aim: "input/aim/pose",
        squeezes: &["input/select/click"],
    },
];

/// What is asked of the runtime in every frame. Whatever fails is no hand.
pub(crate) struct Input {
    actions: Option<Actions>,
    /// Left and right.
    trackers: [Option<HandTracker>; 2],
}

struct Actions {
    set: ActionSet,
    /// One for each entry of [`Profile::squeezes`].
    squeezes: [Action<f32>; 2],
    hands: [HandSpaces; 2],
    /// Where the eyes look: along −z.
    gaze: Option<Space>,
}

struct HandSpaces {
    path: Path,
    grip: Space,
    aim: Space,
}

impl Input {
    pub(crate) fn new(runtime: &Runtime, session: &Session<AnyGraphics>) -> Self {
        let trackers = [sys::HandEXT::LEFT, sys::HandEXT::RIGHT].map(|hand| {
            let is_there = runtime.has_hand_tracking;
            is_there.then(|| session.create_hand_tracker(hand).ok())?
        });
        Self {
            actions: Actions::new(&runtime.instance, session, runtime.has_gaze)
                .inspect_err(|result| bevy::log::warn!("there are no controllers: {result}"))
                .ok(),
            trackers,
        }
    }

    /// Where the eyes look, in tracking space, as of the last [`Self::locate`].
    pub(crate) fn gaze(&self, space: &Space, time: Time) -> Option<Isometry3d> {
        let gaze = self.actions.as_ref()?.gaze.as_ref()?;
        locate(gaze, space, time).ok().flatten()
    }

    /// In tracking space.
    pub(crate) fn locate(
        &self,
        session: &Session<AnyGraphics>,
        space: &Space,
        time: Time,
        head: Option<Vec3>,
    ) -> Hands {
        let controllers = match &self.actions {
            Some(actions) => actions.locate(session, space, time).unwrap_or_default(),
            None => Hands::default(),
        };
        Hands([0, 1].map(|index: usize| {
            let tracker = self.trackers[index].as_ref();
            let joints = tracker.and_then(|tracker| joints(tracker, space, time));
            let hand = joints.map_or_else(Hand::default, |j| Hand::from_joints(&j, head));
            if hand.grip.is_some() {
                hand
            } else {
                controllers.0[index]
            }
        }))
    }
}

impl Actions {
    fn new(
        instance: &Instance,
        session: &Session<AnyGraphics>,
        has_gaze: bool,
    ) -> openxr::Result<Self> {
        let set = instance.create_action_set("holovol", "Volumes", 0)?;
        let paths = [
            instance.string_to_path(HANDS[0])?,
            instance.string_to_path(HANDS[1])?,
        ];
        let grip = set.create_action::<Posef>("grip", "Where the hand is", &paths)?;
        let aim = set.create_action::<Posef>("aim", "Where the hand points", &paths)?;
        let squeezes = [
            set.create_action::<f32>("take", "Take", &paths)?,
            set.create_action::<f32>("grasp", "Grasp", &paths)?,
        ];
        for profile in PROFILES {
            let bindings = profile.bindings(instance, &grip, &aim, &squeezes)?;
            let Ok(path) = instance.string_to_path(profile.path) else {
                continue;
            };
            // Unknown to this runtime, mostly.
            let _ = instance.suggest_interaction_profile_bindings(path, &bindings);
        }
        let gaze = has_gaze.then(|| gaze_action(instance, &set).ok()).flatten();
        session.attach_action_sets(&[&set])?;
        let spaces = |path: Path| -> openxr::Result<HandSpaces> {
            Ok(HandSpaces {
                path,
                grip: grip.create_space(session, path, Posef::IDENTITY)?,
                aim: aim.create_space(session, path, Posef::IDENTITY)?,
            })
        };
        Ok(Self {
            hands: [spaces(paths[0])?, spaces(paths[1])?],
            gaze: gaze.and_then(|(action, eyes)| {
                action.create_space(session, eyes, Posef::IDENTITY).ok()
            }),
            set,
            squeezes,
        })
    }

    fn locate(
        &self,
        session: &Session<AnyGraphics>,
        space: &Space,
        time: Time,
    ) -> openxr::Result<Hands> {
        sync(session, &self.set)?;
        let hand = |spaces: &HandSpaces| -> openxr::Result<Hand> {
            let squeezes = self.squeezes.iter().filter_map(|action| {
                let state = action.state(session, spaces.path).ok()?;
                (state.is_active && state.current_state.is_finite()).then_some(state.current_state)
            });
            let grip = locate(&spaces.grip, space, time)?;
            Ok(Hand {
                grip,
                aim: locate(&spaces.aim, space, time)?,
                squeeze: squeezes.fold(0.0, f32::max),
                poke: grip.map(|grip| grip * POKE_REACH),
            })
        };
        Ok(Hands([hand(&self.hands[0])?, hand(&self.hands[1])?]))
    }
}

/// The action that follows the eyes, and whose they are.
fn gaze_action(instance: &Instance, set: &ActionSet) -> openxr::Result<(Action<Posef>, Path)> {
    let eyes = instance.string_to_path(EYES)?;
    let action = set.create_action::<Posef>("gaze", "Where the eyes look", &[eyes])?;
    let pose = instance.string_to_path(&format!("{EYES}/input/gaze_ext/pose"))?;
    let profile = instance.string_to_path(GAZE_PROFILE)?;
    instance.suggest_interaction_profile_bindings(profile, &[Binding::new(&action, pose)])?;
    Ok((action, eyes))
}

/// As [`Session::sync_actions`], which allocates.
#[expect(unsafe_code, reason = "a call to the runtime with one action set")]
fn sync(session: &Session<AnyGraphics>, set: &ActionSet) -> openxr::Result<()> {
    let active = sys::ActiveActionSet {
        action_set: set.as_raw(),
        subaction_path: Path::NULL,
    };
    let info = sys::ActionsSyncInfo {
        ty: sys::ActionsSyncInfo::TYPE,
        next: std::ptr::null(),
        count_active_action_sets: 1,
        active_action_sets: &active,
    };
    let sync_actions = session.instance().fp().sync_actions;
    // SAFETY: the structures are of their type and live through the call.
    let result = unsafe { sync_actions(session.as_raw(), &info) };
    if result.into_raw() < 0 {
        return Err(result);
    }
    Ok(())
}

impl Profile {
    fn bindings<'a>(
        &self,
        instance: &Instance,
        grip: &'a Action<Posef>,
        aim: &'a Action<Posef>,
        squeezes: &'a [Action<f32>; 2],
    ) -> openxr::Result<Vec<Binding<'a>>> {
        let mut bindings = Vec::new();
        for hand in HANDS {
            let path = |input: &str| instance.string_to_path(&format!("{hand}/{input}"));
            bindings.push(Binding::new(grip, path(self.grip)?));
            bindings.push(Binding::new(aim, path(self.aim)?));
            for (action, input) in squeezes.iter().zip(self.squeezes) {
                bindings.push(Binding::new(action, path(input)?));
            }
        }
        Ok(bindings)
    }
}

/// Where a space is; `None` while it isn't tracked.
pub(crate) fn locate(
    space: &Space,
    base: &Space,
    time: Time,
) -> openxr::Result<Option<Isometry3d>> {
    let location = space.locate(base, time)?;
    Ok(isometry(location.location_flags, &location.pose))
}

fn isometry(flags: SpaceLocationFlags, pose: &Posef) -> Option<Isometry3d> {
    let valid = SpaceLocationFlags::ORIENTATION_VALID | SpaceLocationFlags::POSITION_VALID;
    if !flags.contains(valid) {
        return None;
    }
    let (q, p) = (pose.orientation, pose.position);
    let rotation = rotation([q.x, q.y, q.z, q.w])?;
    Some(Isometry3d::new(place([p.x, p.y, p.z])?, rotation))
}

fn joints(
    tracker: &HandTracker,
    space: &Space,
    time: Time,
) -> Option<[Option<Isometry3d>; JOINT_COUNT]> {
    let locations = space.locate_hand_joints(tracker, time).ok()??;
    Some(locations.map(|joint| isometry(joint.location_flags, &joint.pose)))
}
