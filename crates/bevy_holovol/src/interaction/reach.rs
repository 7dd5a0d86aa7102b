//! What hands touch and point at.

use bevy::math::{Isometry3d, Vec3};

use super::{Grabbable, Hand, Handle, REACH, shape};

/// m around a handle within which a pinch takes it.
const HANDLE_REACH: f32 = 0.03;
/// As an angle, for rays.
const HANDLE_ANGLE: f32 = 0.03;

/// Where a hand holds: itself, or the end of its ray.
pub(super) fn pose_of(hand: &Hand, far: Option<f32>) -> Option<Isometry3d> {
    let pose = match far {
        None => hand.grip?,
        Some(distance) => {
            let aim = hand.aim?;
            let end = Vec3::from(aim.translation) + aim.rotation * Vec3::new(0.0, 0.0, -distance);
            Isometry3d::new(end, aim.rotation)
        }
    };
    let is_pose = pose.translation.is_finite() && pose.rotation.is_finite();
    (is_pose && pose.rotation.is_normalized()).then_some(pose)
}

/// What a hand touches or points at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reached {
    /// The thing's number.
    pub thing: usize,
    /// Which of its handles.
    pub handle: Option<Handle>,
    /// m along the hand's ray; `None` if it is touched.
    pub far: Option<f32>,
}

/// The nearest thing that a hand touches, else the first that it points at.
pub(super) fn reach(hand: &Hand, things: &[Grabbable]) -> Option<Reached> {
    let valid = || {
        let things = things.iter().enumerate();
        things.filter(|(_, thing)| thing.placement.is_valid())
    };
    if let Some(grip) = pose_of(hand, None) {
        let place = Vec3::from(grip.translation);
        let near = valid()
            .map(|(index, thing)| {
                let local = thing.placement.to_local(place);
                let distance = shape::distance_to_box(local, thing.half_size);
                (index, distance * thing.placement.scale)
            })
            .filter(|(_, distance)| *distance <= REACH)
            .min_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((index, _)) = near {
            let thing = &things[index];
            let handle = nearest_handle(thing, |handle_place| {
                Some(handle_place.distance(place)).filter(|d| *d <= HANDLE_REACH)
            });
            return Some(Reached {
                thing: index,
                handle,
                far: None,
            });
        }
    }
    let aim = pose_of(hand, Some(0.0))?;
    let (origin, direction) = (Vec3::from(aim.translation), aim.rotation * Vec3::NEG_Z);
    let hits = valid().filter_map(|(index, thing)| {
        let placement = &thing.placement;
        let in_thing = placement.to_local(origin);
        // Lengths along the ray stay metres of the world.
        let ray = placement.rotation.inverse() * direction / placement.scale;
        // Handles stand out of the box.
        let margin = HANDLE_REACH / placement.scale;
        let entry = shape::ray_to_box(in_thing, ray, thing.half_size + margin)?;
        Some((index, entry))
    });
    let (index, entry) = hits.min_by(|a, b| a.1.total_cmp(&b.1))?;
    let thing = &things[index];
    let handle = nearest_handle(thing, |place| {
        let (along, distance) = shape::ray_to_point(origin, direction, place);
        let limit = HANDLE_REACH.max(HANDLE_ANGLE * along);
        // Those behind the box are hidden by it.
        let is_in_front = along <= entry + 2.0 * limit;
        (is_in_front && distance <= limit).then_some(distance)
    });
    Some(Reached {
        thing: index,
        handle,
        far: Some(entry),
    })
}

fn nearest_handle(thing: &Grabbable, distance: impl Fn(Vec3) -> Option<f32>) -> Option<Handle> {
    if !thing.has_handles {
        return None;
    }
    Handle::all()
        .filter_map(|handle| {
            let place = thing.placement.to_world(handle.place(thing.half_size));
            Some((handle, distance(place)?))
        })
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(handle, _)| handle)
}
