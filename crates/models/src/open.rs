//! Opens a model by the name the user gave.

use std::path::Path;
use std::sync::Arc;

use crate::HashGrid;
use crate::mlp::is_checkpoint;
use crate::{Coordinates, NerfMlp, Ppng, read_voxel_grid};
use octobayes::estimate::Model;
use octobayes::field::{ClosedForm, RadianceField, TrainedField};
use octobayes::{Error, Result};
use octobayes_data::Views;
use octobayes_splats::{RenderMode, Splats, refuse_checkpoint};

/// The volume, for what only volumes have. `name` is the model's.
///
/// # Errors
/// If it is none.
pub fn volume<'a>(model: &'a dyn Model, name: &str) -> Result<&'a dyn RadianceField> {
    model.field().ok_or_else(|| no_volume(name))
}

fn no_volume(name: &str) -> Error {
    let expected = "a volume, which has a density; the commands `uncertainty`, `evaluate`, `render`, `view` and \
                    `export` take splats";
    Error::setting(format!("model `{name}`"), expected, "Gaussian splats")
}

/// Opens the model that `name` names: what [`open`] opens, or a file of [`Splats`]. `mode` is how splats are drawn,
/// if not those of their file.
///
/// # Errors
/// As [`open`] and [`Splats::read`]; if a mode is given for a volume.
pub fn open_model(name: &str, coordinates: Option<Coordinates>, mode: Option<RenderMode>) -> Result<Arc<dyn Model>> {
    let path = Path::new(name);
    if !is_of_splats(name) {
        if let Some(mode) = mode {
            return Err(Error::setting("mode of splats", "a file of splats", format!("`{mode}` for `{name}`")));
        }
        return open_volume(name, coordinates).map(|field| Arc::new(field) as _);
    }
    if let Some(coordinates) = coordinates {
        let found = format!("`{}` for `{name}`", coordinates.name());
        return Err(Error::setting("coordinates", "a `.ppng` model: others have one kind only", found));
    }
    let splats = Splats::read(path)?;
    Ok(Arc::new(match mode {
        Some(mode) => splats.with_mode(mode),
        None => splats,
    }))
}

/// True for a file of splats, by its name.
#[must_use]
pub fn is_of_splats(model: &str) -> bool {
    let path = Path::new(model);
    !model.starts_with("scene:") && Splats::is_splat_file(path) && !is_of_colmap(path)
}

/// Opens the field that `model` names.
///
/// `scene:NAME` is a built-in scene. Anything else is a file, read by its extension:
/// `.safetensors` for a hash grid of `octobayes train` (by its metadata) or an MLP NeRF, `.ckpt`,
/// `.pt`, `.pth` or `.tar` for an MLP NeRF as nerf-pytorch saves it, `.npz` for a voxel grid, `.ppng` for a Plenoptic
/// PNG, in the coordinates of its file unless others are given.
///
/// # Errors
/// If the scene or extension is unknown, if the file is not of the kind of its extension, or if coordinates are given
/// for any other kind of model.
pub fn open(model: &str, coordinates: Option<Coordinates>) -> Result<Box<dyn TrainedField>> {
    if is_of_splats(model) { Err(no_volume(model)) } else { open_volume(model, coordinates) }
}

fn open_volume(model: &str, coordinates: Option<Coordinates>) -> Result<Box<dyn TrainedField>> {
    let path = Path::new(model);
    let extension = if model.starts_with("scene:") { None } else { path.extension().and_then(|e| e.to_str()) };
    if has_coordinates(model) {
        return Ok(Box::new(Ppng::read(path, coordinates.unwrap_or_default())?));
    }
    if let Some(coordinates) = coordinates {
        let found = format!("`{}` for `{model}`", coordinates.name());
        return Err(Error::setting("coordinates", "a `.ppng` model: others have one kind only", found));
    }
    if let Some(scene) = model.strip_prefix("scene:") {
        return Ok(Box::new(ClosedForm::named(scene)?));
    }
    if extension != Some("npz") {
        refuse_checkpoint(path)?;
    }
    match extension {
        Some("safetensors") if HashGrid::is_in(path)? => Ok(Box::new(HashGrid::read(path)?)),
        Some("safetensors") => Ok(Box::new(NerfMlp::read(path)?)),
        Some("npz") => Ok(Box::new(read_voxel_grid(path)?)),
        _ if is_checkpoint(path) => Ok(Box::new(NerfMlp::read(path)?)),
        Some("oct") => {
            Err(Error::setting("MODEL", "a model; where a field is given, too, the model comes before it", model))
        }
        _ if is_of_colmap(path) => Err(Error::setting(
            format!("model `{model}`"),
            "a radiance field; `train` makes one from the pictures, and --cameras reads these",
            "cameras of COLMAP",
        )),
        _ => Err(Error::setting(
            format!("model `{model}`"),
            "`scene:NAME`, a `.safetensors` hash grid or MLP NeRF, an MLP NeRF's `.ckpt`, a `.ppng` Plenoptic PNG, an \
             `.npz` voxel grid, or a `.ply`, `.compressed.ply`, `.spz` or `.splat` of splats (`info` reads fields, \
             `.oct`, too)",
            extension.map_or("none".into(), |found| format!("`.{found}`")),
        )),
    }
}

/// Refuses a model in place of a field, such as one that was given behind it.
///
/// # Errors
/// If `field` is a model by its name.
pub fn refuse_model(field: &Path) -> Result<()> {
    let name = field.to_string_lossy();
    let extension = field.extension().and_then(|extension| extension.to_str());
    let is_file = matches!(extension, Some("safetensors" | "npz" | "ppng")) || is_checkpoint(field);
    if is_file || name.starts_with("scene:") || Splats::is_splat_file(field) {
        let expected = "a field, `.oct`; where a model is given, too, the model comes before it";
        return Err(Error::setting("FIELD", expected, name));
    }
    Ok(())
}

/// True for a model whose scene coordinates are a choice: a Plenoptic PNG.
#[must_use]
pub fn has_coordinates(model: &str) -> bool {
    !model.starts_with("scene:") && Path::new(model).extension().is_some_and(|extension| extension == "ppng")
}

/// True for a COLMAP model, its points or its database.
fn is_of_colmap(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    Views::files(path) != [path] || ["points3D.bin", "points3D.txt", "points3D.ply", "database.db"].contains(&name)
}

/// Checksum of what [`open_model`] opens with these arguments.
///
/// It covers a file's content and coordinates, not its path. Splats in a given mode are another model than those in
/// their file's. For a built-in scene it covers the name.
///
/// # Errors
/// If the file cannot be read.
pub fn checksum(model: &str, coordinates: Option<Coordinates>, mode: Option<RenderMode>) -> Result<u32> {
    if model.starts_with("scene:") {
        return Ok(crc32fast::hash(model.as_bytes()));
    }
    let path = Path::new(model);
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&octobayes::io::read(path)?);
    if has_coordinates(model) {
        hasher.update(coordinates.unwrap_or_default().name().as_bytes());
    }
    mode.iter().for_each(|mode| hasher.update(mode.to_string().as_bytes()));
    Ok(hasher.finalize())
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
        let sum = |model: &str, coordinates| checksum(model, coordinates, None).unwrap();
        assert_eq!(sum(&a, None), sum(&b, Some(Coordinates::Ngp)));
        assert!(sum(&a, None) != sum(&c, None) && sum(&a, None) != sum(&a, Some(Coordinates::Blender)));
        assert!(sum("scene:ball", None) != sum("scene:city", None));
        assert!(checksum("none.npz", None, None).is_err());
    }
}
