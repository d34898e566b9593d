//! Opens a model by the name the user gave.

use std::path::Path;

use crate::dataset::Views;
use crate::field::{ClosedForm, Coordinates, HashGrid, NerfMlp, Ppng, RadianceField, VoxelGrid, is_checkpoint};
use crate::{Error, Result, zoo};

/// Opens the field that `model` names.
///
/// `scene:NAME` is a built-in scene or one of the [zoo]. Anything else is a file, read by its extension:
/// `.safetensors` for a hash grid of `octobayes train` (its metadata says so) or an MLP NeRF, `.ckpt`, `.pt`, `.pth` or
/// `.tar` for an MLP NeRF as nerf-pytorch saves it, `.npz` for a voxel grid, `.ppng` for a Plenoptic PNG in the
/// coordinates of its file.
///
/// # Errors
/// If the scene or extension is unknown, or the file cannot be read as what its extension says.
pub fn open(model: &str) -> Result<Box<dyn RadianceField>> {
    open_in(model, None)
}

/// [`open`], with a choice of scene coordinates for a Plenoptic PNG.
///
/// # Errors
/// As [`open`]; if coordinates are given for any other kind of model.
pub fn open_in(model: &str, coordinates: Option<Coordinates>) -> Result<Box<dyn RadianceField>> {
    let path = Path::new(model);
    let extension = if model.starts_with("scene:") { None } else { path.extension().and_then(|e| e.to_str()) };
    if extension == Some("ppng") {
        return Ok(Box::new(Ppng::read(path, coordinates.unwrap_or_default())?));
    }
    if let Some(coordinates) = coordinates {
        let found = format!("`{}` for `{model}`", coordinates.name());
        return Err(Error::setting("coordinates", "a `.ppng` model: others have one kind only", found));
    }
    if let Some(scene) = model.strip_prefix("scene:") {
        return scene_named(scene);
    }
    match extension {
        Some("safetensors") if HashGrid::is_in(path)? => Ok(Box::new(HashGrid::read(path)?)),
        Some("safetensors") => Ok(Box::new(NerfMlp::read(path)?)),
        Some("npz") => Ok(Box::new(VoxelGrid::read(path)?)),
        _ if is_checkpoint(path) => Ok(Box::new(NerfMlp::read(path)?)),
        _ if is_of_colmap(path) => Err(Error::setting(
            format!("model `{model}`"),
            "a radiance field; `train` makes one from the pictures, and --cameras reads these",
            "cameras of COLMAP",
        )),
        _ => Err(Error::setting(
            format!("model `{model}`"),
            "`scene:NAME`, a `.safetensors` or `.ckpt` MLP NeRF, a `.ppng` Plenoptic PNG or an `.npz` voxel grid",
            "another extension",
        )),
    }
}

/// True for a COLMAP model, its points or its database.
fn is_of_colmap(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    Views::files(path) != [path] || ["points3D.bin", "points3D.txt", "points3D.ply", "database.db"].contains(&name)
}

/// Checksum of what [`open_in`] opens with these arguments.
///
/// It covers a file's content and coordinates, not its path. For a built-in scene it covers the name.
///
/// # Errors
/// If the file cannot be read.
pub fn checksum(model: &str, coordinates: Option<Coordinates>) -> Result<u32> {
    if model.starts_with("scene:") {
        return Ok(crc32fast::hash(model.as_bytes()));
    }
    let path = Path::new(model);
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&crate::io::read(path)?);
    if path.extension().is_some_and(|extension| extension == "ppng") {
        hasher.update(coordinates.unwrap_or_default().name().as_bytes());
    }
    Ok(hasher.finalize())
}

/// The zoo scene of that name, or else the built-in one.
fn scene_named(name: &str) -> Result<Box<dyn RadianceField>> {
    if let Ok(scene) = zoo::by_name(name) {
        return Ok(Box::new(scene.field));
    }
    Ok(Box::new(ClosedForm::named(name)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_is_its_content_and_coordinates_not_its_path() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, content: &[u8]| {
            let path = folder.path().join(name);
            std::fs::write(&path, content).unwrap();
            path.to_str().unwrap().to_string()
        };
        let (a, b, c) = (write("a.ppng", b"one"), write("b.ppng", b"one"), write("c.ppng", b"two"));
        let sum = |model: &str, coordinates| checksum(model, coordinates).unwrap();
        assert_eq!(sum(&a, None), sum(&b, Some(Coordinates::Ngp)));
        assert!(sum(&a, None) != sum(&c, None) && sum(&a, None) != sum(&a, Some(Coordinates::Blender)));
        assert!(sum("scene:ball", None) != sum("scene:city", None));
        assert!(checksum("none.npz", None).is_err());
    }
}
