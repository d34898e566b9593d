//! What cameras see of real models, with correct and wrong settings. `OCTOBAYES_DATA` names the folder of the
//! data.

use glam::DMat3;
use octobayes::estimate::{CoverageCheck, Framing, GridSettings, RaySettings};
use octobayes::field::Intrinsics;
use octobayes::geometry::{Camera, Domain};
use octobayes::monitor::Silent;
use octobayes::render::GradientMethod;
use octobayes_data::Views;
use octobayes_models::Coordinates;
use octobayes_models::open;

use super::data;

fn mlp(scene: &str) -> (String, Vec<Camera>) {
    let model = data(&format!("nerf-mlp-pretrained/{scene}.safetensors"));
    let cameras = data(&format!("nerf-mlp-pretrained/cameras/{scene}_train.json"));
    (model.display().to_string(), Views::read(&cameras, Some([400, 400])).unwrap().cameras())
}

fn sight(model: &str, coordinates: Option<Coordinates>, cameras: Option<Vec<Camera>>) -> CoverageCheck {
    let field = open(model, coordinates).unwrap();
    // The angle of the NeRF-synthetic cameras; phones have about 60 degrees.
    let fov = if model.contains("NeRFSynthetic") { 0.691_111_2 } else { 1.0 };
    let intrinsics = Intrinsics { fov_x: Some(fov), resolution: Some([100, 100]) };
    let cameras = cameras.unwrap_or_else(|| field.cameras(&intrinsics).unwrap().unwrap());
    let grid = GridSettings::default().level(5);
    let domain = Domain::Box(field.bounds());
    let lattice = grid.lattice(domain).unwrap();
    let rays = RaySettings::default().occupancy(64).gradient(GradientMethod::Auto);
    let stream = rays.stream(&field, &cameras, &lattice, &Silent).unwrap();
    CoverageCheck::measure(&stream, &domain, &Silent).unwrap()
}

#[test]
#[ignore = "needs OCTOBAYES_DATA/nerf-mlp-pretrained and ppng-pretrained"]
fn right_settings_of_real_models_are_left_in_peace() {
    for scene in ["lego", "chair", "drums", "materials", "ship"] {
        let (model, cameras) = mlp(scene);
        let found = sight(&model, None, Some(cameras));
        assert!(!found.is_below_threshold(), "{scene}: {found:?}");
    }
    let models =
        ["NeRFSynthetic/ppng_1/lego", "NeRFSynthetic/ppng_1/ficus", "360_v2/ppng_1/garden", "360_v2/ppng_1/kitchen"];
    for name in
        models.iter().chain(&["360_v2/ppng_1/room", "TanksAndTemple/ppng_1/Truck", "Synthetic_NSVF/ppng_1/Toad"])
    {
        let found = sight(&data(&format!("ppng-pretrained/{name}.ppng")).display().to_string(), None, None);
        println!("{name}: {}", found.measured());
        assert!(!found.is_below_threshold(), "{name}: {found:?}");
    }
    let fox = Views::read(&data("fox/transforms.json"), None).unwrap().cameras();
    let framing = Framing::from_cameras(&fox, &octobayes::geometry::Aabb::centered_cube(0.5 / 0.33));
    assert!(!framing.is_below_threshold(), "{framing:?}");
}

#[test]
#[ignore = "needs OCTOBAYES_DATA/nerf-mlp-pretrained and ppng-pretrained"]
fn wrong_settings_of_real_models_are_noticed() {
    let (lego, cameras) = mlp("lego");
    let changed = |change: &dyn Fn(&mut Camera)| {
        let mut cameras = cameras.clone();
        cameras.iter_mut().for_each(change);
        cameras
    };
    let opencv = |c: &mut Camera| c.axes = DMat3::from_cols(c.axes.x_axis, -c.axes.y_axis, -c.axes.z_axis);
    let ppng = data("ppng-pretrained/NeRFSynthetic/ppng_1/lego.ppng").display().to_string();
    for (model, coordinates) in [(&lego, None), (&ppng, Some(Coordinates::Blender))] {
        assert!(sight(model, coordinates, Some(changed(&opencv))).is_empty());
        assert!(sight(model, coordinates, Some(changed(&|c| c.position *= 1e3))).is_empty());
        assert!(sight(model, coordinates, Some(changed(&|c| c.position *= 1e-3))).is_below_threshold());
    }
    assert!(
        sight(&ppng, None, Some(cameras)).is_below_threshold(),
        "NeRF-synthetic cameras, and a model in its file's coordinates"
    );
}
