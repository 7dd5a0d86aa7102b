//! Where the user stands: before the volume, at arm's length.

use bevy::camera::primitives::Aabb;
use bevy::prelude::*;
use bevy_holovol::prelude::*;
use bevy_holovol::xr::{EyeCamera, HeadPose, MixedRealityOrigin};

/// m; volumes that are much larger or smaller come as large as this.
const FITTING_SIZE: f32 = 0.35;
const SIZES_AS_THEY_ARE: std::ops::RangeInclusive<f32> = 0.1..=0.8;
/// m from the head to the volume's middle, for small ones.
const DISTANCE: f32 = 0.5;

pub(super) struct PlacePlugin;

impl Plugin for PlacePlugin {
    fn build(&self, app: &mut App) {
        app.add_systems(Update, (make_graspable, place_user).chain());
    }
}

fn make_graspable(
    mut commands: Commands,
    volumes: Query<Entity, (With<Volume3d>, Without<Graspable>)>,
) {
    for volume in &volumes {
        commands.entity(volume).insert(Graspable::default());
    }
}

/// For each volume that is opened, as soon as it is known where the head is. The volume stays where
/// windows see it: the user comes to it.
fn place_user(
    head: Res<HeadPose>,
    mut volumes: Query<(&Volume3d, &mut Transform, &Aabb), Without<MixedRealityOrigin>>,
    mut origin: Single<&mut Transform, With<MixedRealityOrigin>>,
    eyes: Query<(), With<EyeCamera>>,
    mut placed: Local<Option<AssetId<VolumeAsset>>>,
) {
    let (Some(head), Ok((volume, mut transform, aabb))) = (head.0, volumes.single_mut()) else {
        return;
    };
    if *placed == Some(volume.id()) || eyes.is_empty() {
        return;
    }
    *placed = Some(volume.id());
    let size = 2.0 * aabb.half_extents.max_element();
    if !SIZES_AS_THEY_ARE.contains(&size) && size > 0.0 {
        transform.scale = Vec3::splat(FITTING_SIZE / size);
    }
    let middle = transform.transform_point(aabb.center.into());
    let size = size * transform.scale.x;
    let above = 0.15 * DISTANCE;
    let wanted = middle + Vec3::new(0.0, above, DISTANCE + 0.5 * size);
    // The world's head now, turned so that it looks along −z, and moved there.
    let ahead = head.rotation * Vec3::NEG_Z;
    let turn = Quat::from_rotation_y(ahead.x.atan2(-ahead.z));
    let now = Vec3::from(head.translation);
    let in_tracking = origin.compute_affine().inverse().transform_point3(now);
    let rotation = (turn * origin.rotation).normalize();
    **origin = Transform {
        translation: wanted - rotation * in_tracking,
        rotation,
        ..**origin
    };
}
