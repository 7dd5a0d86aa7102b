//! Which assets volumes are shown with: the last that were there, while others are being loaded.

use std::collections::HashMap;

use bevy::asset::{AssetEventSystems, LoadState};
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
    server: Option<Res<AssetServer>>,
) {
    let server = server.as_deref();
    shown.0.retain(|entity, _| volumes.contains(*entity));
    for (entity, volume, material) in &volumes {
        let shown = shown.0.entry(entity).or_default();
        follow(&mut shown.volume, volume.id(), assets.as_deref(), server);
        follow(
            &mut shown.function,
            material.id(),
            functions.as_deref(),
            server,
        );
    }
}

/// Another handle takes the place of the former once its asset is there. An asset that was removed
/// or can't be loaded, and the default handle, are nothing to wait for.
fn follow<A: Asset + Clone>(
    shown: &mut Option<(AssetId<A>, A)>,
    id: AssetId<A>,
    assets: Option<&Assets<A>>,
    server: Option<&AssetServer>,
) {
    let may_come = |shown: &(AssetId<A>, A)| {
        let state = server.and_then(|server| server.get_load_state(id));
        shown.0 != id && id != AssetId::default() && !matches!(state, Some(LoadState::Failed(_)))
    };
    match assets.and_then(|assets| assets.get(id)) {
        Some(asset) => *shown = Some((id, asset.clone())),
        None if shown.as_ref().is_some_and(may_come) => {}
        None => *shown = None,
    }
}
