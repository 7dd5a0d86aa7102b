//! Which assets volumes are shown with: the last that were there, while others are being loaded.

use std::collections::HashMap;

use bevy::asset::AssetEventSystems;
use bevy::prelude::*;

use crate::{TransferFunctionAsset, Volume3d, VolumeAsset, VolumeMaterial3d};

/// Of each volume.
#[derive(Resource, Default)]
pub(super) struct ShownAssets(HashMap<Entity, Shown>);

#[derive(Default)]
struct Shown {
    volume: Option<(AssetId<VolumeAsset>, VolumeAsset)>,
    function: Option<(AssetId<TransferFunctionAsset>, TransferFunctionAsset)>,
}

impl ShownAssets {
    pub(super) fn volume(&self, of: Entity) -> Option<&VolumeAsset> {
        self.0.get(&of)?.volume.as_ref().map(|(_, asset)| asset)
    }

    pub(super) fn function(&self, of: Entity) -> Option<&TransferFunctionAsset> {
        self.0.get(&of)?.function.as_ref().map(|(_, asset)| asset)
    }
}

/// Before what asks for them in `PostUpdate`.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct FollowAssets;

pub(super) fn build(app: &mut App) {
    app.init_resource::<ShownAssets>().add_systems(
        PostUpdate,
        follow_assets.in_set(FollowAssets).after(AssetEventSystems),
    );
}

fn follow_assets(
    mut shown: ResMut<ShownAssets>,
    volumes: Query<(Entity, &Volume3d, &VolumeMaterial3d)>,
    assets: Option<Res<Assets<VolumeAsset>>>,
    functions: Option<Res<Assets<TransferFunctionAsset>>>,
) {
    shown.0.retain(|entity, _| volumes.contains(*entity));
    for (entity, volume, material) in &volumes {
        let shown = shown.0.entry(entity).or_default();
        follow(&mut shown.volume, volume.id(), assets.as_deref());
        follow(&mut shown.function, material.id(), functions.as_deref());
    }
}

/// Another handle takes the place of the former once its asset is there. An asset that was removed,
/// and the default handle, are nothing to wait for.
fn follow<A: Asset + Clone>(
    shown: &mut Option<(AssetId<A>, A)>,
    id: AssetId<A>,
    assets: Option<&Assets<A>>,
) {
    let is_another = |shown: &(AssetId<A>, A)| shown.0 != id;
    match assets.and_then(|assets| assets.get(id)) {
        Some(asset) => *shown = Some((id, asset.clone())),
        None if id != AssetId::default() && shown.as_ref().is_some_and(is_another) => {}
        None => *shown = None,
    }
}
