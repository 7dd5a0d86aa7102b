//! Where the user stands: before the volume, at arm's length.

use bevy::camera::primitives::Aabb;
use bevy::prelude::*;
use bevy_holovol::prelude::*;
use bevy_holovol::xr::{EyeCamera, HeadPose, MixedRealityOrigin};

use super::actions::Action;

/// m; volumes that are much larger or smaller come as large as this.
const FITTING_SIZE: f32 = 0.35;
const SIZES_AS_THEY_ARE: std::ops::RangeInclusive<f32> = 0.1..=0.8;
/// m from the head to the volume's middle, for small ones.
const DISTANCE: f32 = 0.5;

pub(super) struct PlacePlugin;

impl Plugin for PlacePlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<Placed>()
            .add_systems(Update, (make_graspable, place_user, bring_back).chain());
    }
}

/// The volume before which the user was placed, and how it stood.
#[derive(Resource, Default)]
pub(super) struct Placed(pub(super) Option<(AssetId<VolumeAsset>, Transform)>);

fn make_graspable(
    mut commands: Commands,
    volumes: Query<Entity, (With<Volume3d>, Without<Graspable>)>,
) {
    for volume in &volumes {
        commands.entity(volume).insert(Graspable::default());
    }
}

/// From the head to the volume's middle, −z ahead.
fn from_head(size: f32) -> Vec3 {
    Vec3::new(0.0, -0.15 * DISTANCE, -(DISTANCE + 0.5 * size))
}

/// About +y, of what a head looks along.
pub(super) fn turn_of(head: Isometry3d) -> Quat {
    let ahead = head.rotation * Vec3::NEG_Z;
    Quat::from_rotation_y((-ahead.x).atan2(-ahead.z))
}

/// For each volume that is opened, as soon as it is known where the head is. The volume stays where
/// windows see it: the user comes to it.
fn place_user(
    head: Res<HeadPose>,
    mut volumes: Query<(&Volume3d, &mut Transform, &Aabb), Without<MixedRealityOrigin>>,
    mut origin: Single<&mut Transform, With<MixedRealityOrigin>>,
    eyes: Query<(), With<EyeCamera>>,
    mut placed: ResMut<Placed>,
) {
    let (Some(head), Ok((volume, mut transform, aabb))) = (head.0, volumes.single_mut()) else {
        return;
    };
    let is_placed = placed.0.is_some_and(|(id, _)| id == volume.id());
    if is_placed || eyes.is_empty() {
        return;
    }
    let size = 2.0 * aabb.half_extents.max_element();
    if !SIZES_AS_THEY_ARE.contains(&size) && size > 0.0 {
        transform.scale = Vec3::splat(FITTING_SIZE / size);
    }
    placed.0 = Some((volume.id(), *transform));
    let middle = transform.transform_point(aabb.center.into());
    let wanted = middle - from_head(size * transform.scale.x);
    // The world's head now, turned so that it looks along −z, and moved there.
    let turn = turn_of(head).inverse();
    let now = Vec3::from(head.translation);
    let in_tracking = origin.compute_affine().inverse().transform_point3(now);
    let rotation = (turn * origin.rotation).normalize();
    **origin = Transform {
        translation: wanted - rotation * in_tracking,
        rotation,
        ..**origin
    };
}

/// Before the user, upright and as large as at first: the user stays, since rooms do.
fn bring_back(
    mut actions: MessageReader<Action>,
    head: Res<HeadPose>,
    placed: Res<Placed>,
    mut volumes: Query<(&mut Transform, &Aabb), With<Volume3d>>,
) {
    let is_wanted = actions
        .read()
        .filter(|a| **a == Action::Reset)
        .last()
        .is_some();
    let (Some((_, first)), Some(head), Ok((mut transform, aabb))) =
        (placed.0, head.0, volumes.single_mut())
    else {
        return;
    };
    if is_wanted {
        *transform = brought(head, first, aabb);
    }
}

fn brought(head: Isometry3d, first: Transform, aabb: &Aabb) -> Transform {
    let turn = turn_of(head);
    let size = 2.0 * aabb.half_extents.max_element() * first.scale.x;
    let middle = Vec3::from(head.translation) + turn * from_head(size);
    let rotation = (turn * first.rotation).normalize();
    Transform {
        translation: middle - rotation * (first.scale * Vec3::from(aabb.center)),
        rotation,
        scale: first.scale,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_brought_back_stands_before_the_user_as_at_first() {
        let aabb = Aabb {
            center: Vec3::new(0.1, 0.0, 0.0).into(),
            half_extents: Vec3::new(0.1, 0.2, 0.1).into(),
        };
        let first = Transform::from_scale(Vec3::splat(0.5));
        let place = Vec3::new(1.0, 1.6, 2.0);
        // To the left, and down.
        let looking = Quat::from_rotation_y(1.2) * Quat::from_rotation_x(-0.5);
        let found = brought(Isometry3d::new(place, looking), first, &aabb);
        let ahead = Quat::from_rotation_y(1.2) * Vec3::NEG_Z;
        let expected = place + 0.6 * ahead - 0.075 * Vec3::Y;
        let middle = found.transform_point(aabb.center.into());
        assert!(middle.distance(expected) < 1e-5, "{middle} {expected}");
        // Its front is turned to the user.
        assert!((found.rotation * Vec3::Z + ahead).length() < 1e-5);
        assert_eq!(found.scale, first.scale);
    }
}
