//! Opens whatever the user calls a model.

use std::path::Path;

use super::{ClosedForm, NerfMlp, RadianceField, VoxelGrid};
use crate::{Error, Result};

/// The field that `model` names: `scene:NAME` for a built-in scene, else a file by its extension: `.safetensors` for an MLP
/// NeRF, `.npz` for a voxel grid.
///
/// # Errors
/// If the extension is unknown or the file cannot be read as what its extension says.
pub fn open(model: &str) -> Result<Box<dyn RadianceField>> {
    if let Some(scene) = model.strip_prefix("scene:") {
        return Ok(Box::new(ClosedForm::named(scene)?));
    }
    let path = Path::new(model);
    match path.extension().and_then(|e| e.to_str()) {
        Some("safetensors") => Ok(Box::new(NerfMlp::read(path)?)),
        Some("npz") => Ok(Box::new(VoxelGrid::read(path)?)),
        _ => Err(Error::setting(
            format!("model `{model}`"),
            "`scene:NAME`, a `.safetensors` MLP NeRF or an `.npz` voxel grid",
            "another extension",
        )),
    }
}
