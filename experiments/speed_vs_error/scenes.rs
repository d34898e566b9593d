//! The scenes of the experiment.

use std::path::Path;

use glam::Vec3;
use octobayes::Result;
use octobayes::dataset::Views;
use octobayes::estimate::RaySettings;
use octobayes::field::{ClosedForm, Coordinates, Intrinsics, RadianceField};
use octobayes::geometry::Camera;
use octobayes::open::open_in;

/// A field with its training cameras.
pub struct Scene {
    pub name: &'static str,
    pub field: Box<dyn RadianceField>,
    pub cameras: Vec<Camera>,
    pub settings: RaySettings,
    /// Rays that this scene is studied with at most.
    pub rays: u64,
}

/// The trained lego, type 1, with the 100 training cameras of its data set at 400 × 400.
pub fn lego(data: &Path) -> Result<Scene> {
    let model = data.join("ppng-pretrained/NeRFSynthetic/ppng_1/lego.ppng");
    let field = open_in(&model.to_string_lossy(), Some(Coordinates::Blender))?;
    let cameras = Views::read(&data.join("nerf-mlp-pretrained/cameras/lego_train.json"), Some([400, 400]))?.cameras();
    Ok(Scene { name: "lego", field, cameras, settings: RaySettings::default(), rays: 4_096_000 })
}

/// The MLP lego with the same cameras.
pub fn lego_mlp(data: &Path) -> Result<Scene> {
    let model = data.join("nerf-mlp-pretrained/lego.safetensors");
    let field = open_in(&model.to_string_lossy(), None)?;
    Ok(Scene { name: "lego, MLP", field, ..lego(data)? })
}

/// A model with its own poses.
fn own_poses(data: &Path, file: &str, name: &'static str, fov: f64, background: Vec3) -> Result<Scene> {
    let field = open_in(&data.join("ppng-pretrained").join(file).to_string_lossy(), Some(Coordinates::Ngp))?;
    let intrinsics = Intrinsics { fov_x: Some(fov.to_radians()), resolution: Some([400, 300]) };
    let cameras = field.cameras(&intrinsics)?.unwrap_or_default();
    let settings = RaySettings::default().background(background);
    Ok(Scene { name, field, cameras, settings, rays: 409_600 })
}

/// A captured object: a statue filmed from around it.
pub fn ignatius(data: &Path) -> Result<Scene> {
    own_poses(data, "TanksAndTemple/ppng_1/Ignatius.ppng", "Ignatius (captured)", 50.0, Vec3::ONE)
}

/// An unbounded scene, in the model's own box.
pub fn garden(data: &Path) -> Result<Scene> {
    let garden = own_poses(data, "360_v2/ppng_1/garden.ppng", "garden (unbounded)", 60.0, Vec3::ZERO)?;
    // A ray meets matter nearly everywhere: it takes ten times as long as one of lego.
    Ok(Scene { rays: 204_800, ..garden })
}

/// The closed-form city with its drive.
pub fn city() -> Result<Scene> {
    let city = ClosedForm::named("city")?;
    let cameras = city.cameras(&Intrinsics::default())?.unwrap_or_default();
    let settings = RaySettings::default().occupancy(512);
    Ok(Scene { name: "city", field: Box::new(city), cameras, settings, rays: 204_800 })
}
