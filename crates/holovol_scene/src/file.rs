use std::path::Path;

use holovol_volume::Progress;

use crate::Scene;

/// TODO
pub struct SceneFile;

/// TODO
#[derive(Debug, thiserror::Error)]
pub enum SceneError {}

/// TODO
pub fn load(_path: &Path, _progress: &mut dyn FnMut(Progress)) -> Result<Scene, SceneError> {
    todo!()
}
