//! Scenes with their cameras.

use std::path::PathBuf;

use octobayes::Result;
use octobayes::dataset::Views;
use octobayes::field::{ClosedForm, Coordinates, Intrinsics, RadianceField};
use octobayes::geometry::Camera;
use octobayes::open::open_in;

/// A field with its training cameras, and how it is studied.
pub struct Scene {
    pub name: &'static str,
    pub field: Box<dyn RadianceField>,
    pub cameras: Vec<Camera>,
    pub level: u8,
    pub rays: u64,
}

/// The data folder; says so if there is none.
pub fn data() -> Option<PathBuf> {
    let data = std::env::var_os("OCTOBAYES_DATA").map(PathBuf::from);
    if data.is_none() {
        println!("\n(OCTOBAYES_DATA is not set: no real models)");
    }
    data
}

/// Built-in scenes, and lego if its files are there.
pub fn scenes() -> Result<Vec<Scene>> {
    let mut scenes = Vec::new();
    for (name, level, rays) in [("courtyard", 6, 102_400), ("wall", 6, 51_200), ("floater", 6, 51_200)] {
        let field = ClosedForm::named(name)?;
        let cameras = field.cameras(&Intrinsics::default())?.unwrap_or_default();
        scenes.push(Scene { name, field: Box::new(field), cameras, level, rays });
    }
    if let Some(data) = data() {
        scenes.push(Scene { level: 7, ..lego(&data)? });
    }
    Ok(scenes)
}

/// The trained lego (a Plenoptic PNG) with the cameras of its data set.
pub fn lego(data: &std::path::Path) -> Result<Scene> {
    let model = data.join("ppng-pretrained/NeRFSynthetic/ppng_1/lego.ppng");
    let field = open_in(&model.to_string_lossy(), Some(Coordinates::Blender))?;
    let cameras = Views::read(&data.join("nerf-mlp-pretrained/cameras/lego_train.json"), Some([400, 400]))?.cameras();
    Ok(Scene { name: "lego", field, cameras, level: 8, rays: 204_800 })
}

/// The MLP lego with the same cameras.
pub fn lego_mlp(data: &std::path::Path) -> Result<Scene> {
    let model = data.join("nerf-mlp-pretrained/lego.safetensors");
    let field = open_in(&model.to_string_lossy(), None)?;
    Ok(Scene { name: "lego, MLP", field, ..lego(data)? })
}
