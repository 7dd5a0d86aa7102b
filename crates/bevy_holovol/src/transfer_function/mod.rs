//! Transfer functions: how a volume's values become matter.

mod loader;

use std::sync::Arc;

use bevy::prelude::*;
use holovol_volume::{TransferFunction, TransferFunctionFile, TransferPoint};

pub use loader::{TransferFunctionLoader, TransferFunctionLoaderError};

/// Transfer functions as assets, and the loader of `*.tf.json` files.
pub struct TransferFunctionPlugin;

impl Plugin for TransferFunctionPlugin {
    fn build(&self, app: &mut App) {
        app.init_asset::<TransferFunctionAsset>()
            .register_asset_reflect::<TransferFunctionAsset>()
            .init_asset_loader::<TransferFunctionLoader>();
        // Serves where no handle was given, as Bevy's default materials do.
        let mut assets = app
            .world_mut()
            .resource_mut::<Assets<TransferFunctionAsset>>();
        let inserted = assets.insert(&Handle::default(), TransferFunctionAsset::default());
        debug_assert!(inserted.is_ok(), "a default handle is never stale");
    }
}

/// The transfer function of a [`Volume3d`](crate::Volume3d).
///
/// Bevy's own materials are for meshes; this one says what a volume's values are made of. While
/// another handle's asset is being loaded the former is used. The default handle is a soft grey ramp.
#[derive(Component, Reflect, Clone, Debug, Default, PartialEq, Eq, Deref, DerefMut)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
pub struct VolumeMaterial3d(pub Handle<TransferFunctionAsset>);

/// Extinction, albedo, emission and surface over the window of a volume's values.
///
/// Loaded from `*.tf.json`, or made of points. By default a soft grey ramp that suits any scan.
#[derive(Asset, Reflect, Clone, Debug, PartialEq)]
#[reflect(opaque)]
#[reflect(Default, Clone, Debug, PartialEq)]
pub struct TransferFunctionAsset(Arc<TransferFunctionFile>);

impl TransferFunctionAsset {
    /// One of a `*.tf.json` file's contents.
    pub fn new(file: TransferFunctionFile) -> Self {
        Self(Arc::new(file))
    }

    /// Extinctions in 1/m, whatever the volume's size and window.
    pub fn from_function(transfer_function: TransferFunction) -> Self {
        Self::new(TransferFunctionFile {
            transfer_function,
            window: None,
            optical_depth_scale: None,
        })
    }

    /// What the file says.
    pub fn file(&self) -> &TransferFunctionFile {
        &self.0
    }
}

impl Default for TransferFunctionAsset {
    fn default() -> Self {
        /// Of the whole volume at s = 1.
        const OPTICAL_DEPTH: f64 = 60.0;
        let point = |s, sigma_t| TransferPoint {
            s,
            sigma_t,
            albedo: [0.85; 3],
            emission: [0.0; 3],
            roughness: 0.5,
            specular: 0.0,
        };
        let points = vec![point(0.2, 0.0), point(1.0, 1.0)];
        Self::new(TransferFunctionFile {
            transfer_function: TransferFunction::new(points).expect("points in order"),
            window: None,
            optical_depth_scale: Some(OPTICAL_DEPTH),
        })
    }
}
