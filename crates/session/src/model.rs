//! A model, and what names it in results.

use std::path::PathBuf;
use std::sync::Arc;

use super::identity::unchanged;
use octobayes::Result;
use octobayes::estimate::Model;
use octobayes::field::RadianceField;
use octobayes_models::Coordinates;
use octobayes_splats::RenderMode;

/// A model that was opened by its name.
#[derive(Clone)]
pub struct OpenedModel {
    /// Its name: a file or a built-in scene.
    pub name: String,
    /// The model.
    pub model: Arc<dyn Model>,
    /// Its coordinates, if it has a choice.
    pub coordinates: Option<Coordinates>,
    /// Checksum of its content, and of coordinates or mode.
    pub checksum: u32,
    /// Name, checksum of the file, and coordinates or mode, for people.
    pub source: String,
}

impl OpenedModel {
    /// Opens the model `name`, in a choice of scene coordinates, or of how splats are drawn.
    ///
    /// # Errors
    /// As [`octobayes_models::open_model`]; if the file changes meanwhile.
    pub fn open(name: &str, coordinates: Option<Coordinates>, mode: Option<RenderMode>) -> Result<Self> {
        let read = || octobayes_models::open_model(name, coordinates, mode);
        let (model, mut source) = unchanged(|| vec![PathBuf::from(name)], read)?;
        let mut source = source.swap_remove(0);
        if let Some(coordinates) = coordinates.filter(|coordinates| *coordinates != Coordinates::default()) {
            source = format!("{source} in {} coordinates", coordinates.name());
        }
        if let Some(mode) = mode {
            source = format!("{source} in {mode} mode");
        }
        let checksum = octobayes_models::checksum(name, coordinates, mode)?;
        Ok(Self { name: name.into(), model, coordinates, checksum, source })
    }

    /// The volume, for what only volumes have.
    ///
    /// # Errors
    /// If it is none.
    pub fn volume(&self) -> Result<&dyn RadianceField> {
        octobayes_models::volume(&*self.model, &self.name)
    }

    /// Opens the model `name` for a run: in the coordinates of its file with its own cameras, and in those of
    /// NeRF-synthetic with a camera file, which has these.
    ///
    /// # Errors
    /// As [`OpenedModel::open`].
    pub fn for_cameras(name: &str, has_camera_file: bool, mode: Option<RenderMode>) -> Result<Self> {
        let chosen = if has_camera_file { Coordinates::Blender } else { Coordinates::Ngp };
        Self::open(name, octobayes_models::has_coordinates(name).then_some(chosen), mode)
    }
}
