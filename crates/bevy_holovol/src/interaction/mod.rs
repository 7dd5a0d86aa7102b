//! Taking things in hand: what two hands, near or far, do to boxes. Plain logic over
//! [`Hands`]: no headset, no GPU; a mouse can feed it as well.
//!
//! - A pinch inside a box, or within [`REACH`] of it, takes it: it follows the hand with the offset
//!   that it had, smoothed.
//! - A pinch that points at a box from afar takes it along the ray.
//! - A second hand that takes the same box moves, scales and turns it about the middle between the
//!   hands (MRTK's conventions); letting go with one hands it over to the other without a jump.
//! - A corner scales about the opposite corner, an edge turns about its own direction.
//!
//! A hand whose tracking stops holds what it has for [`HOLD`] s.

mod cutting;
mod hands;
mod marks;
mod menu;
mod plugin;
mod pointer;
mod reach;
mod recording;
mod shape;
mod surface;

#[cfg(test)]
mod tests;

use bevy::math::{Isometry3d, Quat, Vec3};

pub use cutting::HandPlane;
pub use hands::{
    Hand, Hands, INDEX_KNUCKLE, INDEX_TIP, JOINT_COUNT, LITTLE_KNUCKLE, THUMB_TIP, WRIST,
};
pub use marks::{InteractionMarks, InteractionMarksPlugin, MenuFace};
pub use menu::{HandMenu, MENU_BUTTONS, MENU_HALF_SIZE};
pub use plugin::{
    CurrentInteraction, CurrentMenu, Graspable, HandTarget, HandTargets, InteractionPlugin,
    InteractionSystems, MenuPressed, TouchPanel, Viewer,
};
pub use pointer::{PointerHand, PointerHandPlugin};
pub use reach::Reached;
pub use recording::{HandData, HandFrame, HandRecorder, HandRecording, Joints, RecordingError};
pub use shape::{Handle, Placement};
pub use surface::{Surface, SurfaceTouch, Touching};

use reach::{pose_of, reach};

/// m around a box within which a pinch takes it.
pub const REACH: f32 = 0.05;
/// s for which a hand that isn't tracked keeps what it holds.
pub const HOLD: f32 = 0.3;
/// Squeezes that take, and that let go: between them nothing changes.
const TAKE: f32 = 0.8;
const LET_GO: f32 = 0.5;
/// m between hands, below which they say nothing about scale and rotation.
const LEAST_SPAN: f32 = 0.02;

/// Follows whether a hand is squeezed: what is between the thresholds changes nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Squeeze {
    is_squeezed: bool,
    has_begun: bool,
}

impl Squeeze {
    /// Takes in a frame; returns whether it is squeezed.
    fn update(&mut self, squeeze: f32) -> bool {
        let limit = if self.is_squeezed { LET_GO } else { TAKE };
        let is_squeezed = squeeze.is_finite() && squeeze >= limit;
        self.has_begun = is_squeezed && !self.is_squeezed;
        self.is_squeezed = is_squeezed;
        is_squeezed
    }

    /// Whether it began with the last frame.
    fn has_begun(&self) -> bool {
        self.has_begun
    }

    /// Takes in a frame; returns whether it begins with it.
    fn begins(&mut self, squeeze: f32) -> bool {
        self.update(squeeze);
        self.has_begun
    }
}

/// A box that can be taken in hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grabbable {
    /// Where it is.
    pub placement: Placement,
    /// m from its middle, in its own coordinates, to each side.
    pub half_size: Vec3,
    /// Whether its corners and edges are handles.
    pub has_handles: bool,
    /// Bounds of [`Placement::scale`].
    pub scale_limits: [f32; 2],
}

/// How things follow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InteractionSettings {
    /// s in which 63 % of a movement has arrived; 0.04 by default, 0 is at once.
    pub smoothing: f32,
    /// Whether two hands scale.
    pub scales: bool,
    /// Whether hands turn.
    pub turns: bool,
}

impl Default for InteractionSettings {
    fn default() -> Self {
        Self {
            smoothing: 0.04,
            scales: true,
            turns: true,
        }
    }
}

/// What a hand does to a box.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Grip {
    /// Moves it.
    Whole {
        /// From the box to the hand that holds it.
        hand_from_thing: Isometry3d,
    },
    Corner {
        /// The opposite corner, which stays where it is.
        anchor: Vec3,
        anchor_in_world: Vec3,
        span: f32,
        scale: f32,
    },
    Edge {
        axis: Vec3,
        /// Perpendicular to the axis, where the hand was.
        from: Vec3,
    },
}

/// A hand that holds something.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Held {
    thing: usize,
    handle: Option<Handle>,
    grip: Grip,
    /// By the ray; m to where it holds.
    far: Option<f32>,
    last: Isometry3d,
    untracked_for: f32,
}

/// Two hands on one thing.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Pair {
    thing: usize,
    middle: Vec3,
    span: f32,
    axis: Option<Vec3>,
    turn: Quat,
    start: Placement,
}

/// What the hands are doing.
#[derive(Clone, Debug, Default)]
pub struct Interaction {
    /// How things follow.
    pub settings: InteractionSettings,
    held: [Option<Held>; 2],
    pair: Option<Pair>,
    was_squeezed: [bool; 2],
    /// Where things are going, while they are held or on their way.
    targets: Vec<Option<Placement>>,
}

impl Interaction {
    /// Goes on by `dt` s: takes, moves and lets go of `things`, which keep their order as long as any
    /// is held.
    pub fn update(&mut self, hands: &Hands, things: &mut [Grabbable], dt: f32) {
        let dt = if dt.is_finite() {
            dt.clamp(0.0, 0.25)
        } else {
            0.0
        };
        self.targets.resize(things.len(), None);
        for index in 0..2 {
            self.update_hand(index, &hands.0[index], things, dt);
        }
        self.update_pair(things);
        self.follow(things);
        self.smooth(things, dt);
    }

    /// The thing in a hand, 0 left, 1 right.
    pub fn held(&self, hand: usize) -> Option<usize> {
        self.held.get(hand)?.map(|held| held.thing)
    }

    /// What a hand has, as it was when it took it.
    pub fn grip(&self, hand: usize) -> Option<Reached> {
        let held = self.held.get(hand)?.as_ref()?;
        Some(Reached {
            thing: held.thing,
            handle: held.handle,
            far: held.far,
        })
    }

    /// What a hand would take.
    pub fn hovered(hand: &Hand, things: &[Grabbable]) -> Option<Reached> {
        reach(hand, things)
    }

    fn update_hand(&mut self, index: usize, hand: &Hand, things: &mut [Grabbable], dt: f32) {
        let squeeze = if hand.squeeze.is_finite() {
            hand.squeeze
        } else {
            0.0
        };
        let is_squeezed = squeeze
            >= if self.was_squeezed[index] {
                LET_GO
            } else {
                TAKE
            };
        if let Some(held) = &mut self.held[index] {
            let Some(pose) = pose_of(hand, held.far) else {
                held.untracked_for += dt;
                if held.untracked_for > HOLD || held.thing >= things.len() {
                    self.held[index] = None;
                }
                return;
            };
            held.untracked_for = 0.0;
            held.last = pose;
            if !is_squeezed || held.thing >= things.len() {
                self.held[index] = None;
            }
        } else if is_squeezed && !self.was_squeezed[index] {
            self.held[index] = self.take(hand, things);
        }
        // Squeezing first and touching then is no taking.
        if hand.grip.is_some() || hand.aim.is_some() {
            self.was_squeezed[index] = is_squeezed;
        }
    }

    fn take(&mut self, hand: &Hand, things: &[Grabbable]) -> Option<Held> {
        let Reached { thing, handle, far } = reach(hand, things)?;
        let pose = pose_of(hand, far)?;
        let grabbed = &things[thing];
        let target = self.targets[thing].unwrap_or(grabbed.placement);
        let place = Vec3::from(pose.translation);
        let grip = match handle {
            None => Grip::Whole {
                hand_from_thing: pose.inverse() * isometry(&target),
            },
            Some(corner @ Handle::Corner(_)) => {
                let anchor = -corner.place(grabbed.half_size);
                let anchor_in_world = target.to_world(anchor);
                Grip::Corner {
                    anchor,
                    anchor_in_world,
                    span: place.distance(anchor_in_world).max(LEAST_SPAN),
                    scale: target.scale,
                }
            }
            Some(Handle::Edge { axis, .. }) => {
                let axis = target.rotation * Vec3::AXES[usize::from(axis)];
                Grip::Edge {
                    axis,
                    from: (place - target.translation).reject_from(axis),
                }
            }
        };
        Some(Held {
            thing,
            handle,
            grip,
            far,
            last: pose,
            untracked_for: 0.0,
        })
    }

    /// Begins, goes on with, or ends what two hands do together.
    fn update_pair(&mut self, things: &[Grabbable]) {
        let both = match self.held {
            [Some(left), Some(right)] if left.thing == right.thing => Some((left, right)),
            _ => None,
        };
        let Some((left, right)) = both else {
            if self.pair.take().is_some() {
                self.hold_anew(things);
            }
            return;
        };
        let [a, b] = [left, right].map(|held| Vec3::from(held.last.translation));
        let (middle, axis) = ((a + b) / 2.0, b - a);
        let axis = (axis.length() >= LEAST_SPAN).then_some(axis);
        let thing = left.thing;
        let target = self.targets[thing].unwrap_or(things[thing].placement);
        let limits = things[thing].scale_limits;
        let pair = self.pair.get_or_insert(Pair {
            thing,
            middle,
            span: axis.map_or(LEAST_SPAN, Vec3::length),
            axis,
            turn: Quat::IDENTITY,
            start: target,
        });
        if let (Some(from), Some(to)) = (pair.axis, axis) {
            // In small steps, so that more than half a turn is one.
            let step = Quat::from_rotation_arc(from.normalize(), to.normalize());
            pair.turn = (step * pair.turn).normalize();
        }
        let growth = match axis {
            Some(axis) if self.settings.scales => axis.length() / pair.span,
            _ => self.targets[thing].map_or(1.0, |t| t.scale / pair.start.scale),
        };
        pair.axis = axis.or(pair.axis);
        let turn = if self.settings.turns {
            pair.turn
        } else {
            Quat::IDENTITY
        };
        let scale = clamp_scale(pair.start.scale * growth, limits);
        let growth = scale / pair.start.scale;
        let target = Placement {
            translation: middle + turn * ((pair.start.translation - pair.middle) * growth),
            rotation: (turn * pair.start.rotation).normalize(),
            scale,
        };
        self.targets[thing] = Some(target);
    }

    /// After the end of a pair the remaining hand goes on from where things are.
    fn hold_anew(&mut self, things: &[Grabbable]) {
        for held in self.held.iter_mut().flatten() {
            let Some(thing) = things.get(held.thing) else {
                continue;
            };
            let target = self.targets[held.thing].unwrap_or(thing.placement);
            held.handle = None;
            held.grip = Grip::Whole {
                hand_from_thing: held.last.inverse() * isometry(&target),
            };
        }
    }

    /// Things that single hands hold.
    fn follow(&mut self, things: &[Grabbable]) {
        for held in self.held.iter_mut().flatten() {
            if self.pair.is_some_and(|pair| pair.thing == held.thing) {
                continue;
            }
            let thing = &things[held.thing];
            let now = self.targets[held.thing].unwrap_or(thing.placement);
            let hand = Vec3::from(held.last.translation);
            let target = match &mut held.grip {
                Grip::Whole { hand_from_thing } => {
                    let world = held.last * *hand_from_thing;
                    Placement {
                        translation: world.translation.into(),
                        rotation: if self.settings.turns {
                            world.rotation.normalize()
                        } else {
                            now.rotation
                        },
                        ..now
                    }
                }
                Grip::Corner {
                    anchor,
                    anchor_in_world,
                    span,
                    scale,
                } => {
                    let growth = hand.distance(*anchor_in_world) / *span;
                    let scale = clamp_scale(*scale * growth, thing.scale_limits);
                    Placement {
                        translation: *anchor_in_world - now.rotation * (scale * *anchor),
                        scale,
                        ..now
                    }
                }
                Grip::Edge { axis, from } => {
                    let to = (hand - now.translation).reject_from(*axis);
                    let is_far = from.length() >= LEAST_SPAN && to.length() >= LEAST_SPAN;
                    let mut turned = now;
                    if is_far {
                        let angle = from.cross(to).dot(*axis).atan2(from.dot(to));
                        let turn = Quat::from_axis_angle(*axis, angle);
                        turned.rotation = (turn * now.rotation).normalize();
                    }
                    *from = to;
                    turned
                }
            };
            self.targets[held.thing] = Some(target);
        }
    }

    fn smooth(&mut self, things: &mut [Grabbable], dt: f32) {
        let part = if self.settings.smoothing > 0.0 {
            1.0 - (-dt / self.settings.smoothing).exp()
        } else {
            1.0
        };
        for (index, thing) in things.iter_mut().enumerate() {
            let Some(target) = self.targets[index].filter(Placement::is_valid) else {
                self.targets[index] = None;
                continue;
            };
            let is_held = self.held.iter().flatten().any(|held| held.thing == index);
            let now = &mut thing.placement;
            now.translation = now.translation.lerp(target.translation, part);
            now.rotation = now.rotation.slerp(target.rotation, part).normalize();
            now.scale *= (target.scale / now.scale).powf(part);
            let is_there = now.translation.distance(target.translation) < 1e-5
                && now.rotation.angle_between(target.rotation) < 1e-4
                && (now.scale / target.scale - 1.0).abs() < 1e-4;
            if !is_held && is_there {
                self.targets[index] = None;
            }
        }
    }
}

fn clamp_scale(scale: f32, [least, most]: [f32; 2]) -> f32 {
    let least = least.max(f32::MIN_POSITIVE);
    scale.max(least).min(most.max(least))
}

fn isometry(placement: &Placement) -> Isometry3d {
    Isometry3d::new(placement.translation, placement.rotation)
}
