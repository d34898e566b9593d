//! Tests on pre-trained models, which the project does not ship. They read `$OCTOBAYES_DATA`; `.ci/run` sets it and runs them
//! with `--include-ignored`, where missing data is a failure. The README says where to get the data.

use std::path::PathBuf;

use glam::Vec3;
use octobayes::dataset::{PosedImage, Views};
use octobayes::estimate::RaySettings;
use octobayes::field::{NerfMlp, Radiance, RadianceField};
use octobayes::metrics::psnr;
use octobayes::monitor::Silent;
use octobayes::render::render_view;

fn data(path: &str) -> PathBuf {
    let root = std::env::var_os("OCTOBAYES_DATA").expect("OCTOBAYES_DATA must name the folder of the data");
    PathBuf::from(root).join(path)
}

#[test]
#[ignore = "needs OCTOBAYES_DATA/nerf-mlp-pretrained"]
fn mlp_models_return_the_published_check_values() {
    let text = std::fs::read_to_string(data("nerf-mlp-pretrained/check_values.json")).unwrap();
    let checks: serde_json::Value = serde_json::from_str(&text).unwrap();
    for scene in ["lego", "chair", "drums", "materials", "ship"] {
        let model = NerfMlp::read(&data(&format!("nerf-mlp-pretrained/{scene}.safetensors"))).unwrap();
        let check = &checks[scene];
        let vectors = |rows: &serde_json::Value| -> Vec<Vec3> {
            let rows = rows.as_array().unwrap();
            rows.iter().map(|v| Vec3::from_array(std::array::from_fn(|k| v[k].as_f64().unwrap() as f32))).collect()
        };
        let [positions, directions] = ["position", "unit_dir"].map(|key| vectors(&check[key]));
        let rgb = vectors(&check["fine"]["raw_rgb"]);
        let sigma = check["fine"]["raw_sigma"].as_array().unwrap();
        let sigma: Vec<f32> = sigma.iter().map(|v| v.as_f64().unwrap() as f32).collect();
        assert_eq!(positions.len(), 6);
        let mut out = vec![Radiance::default(); positions.len()];
        model.evaluate(&positions, &directions, &mut out);
        for (i, found) in out.iter().enumerate() {
            // The expected values are f64 evaluations of the f32 weights. Five layers of 128 f32 products, and sines of
            // arguments up to 512 · 1.5 whose f32 rounding is 3e-5: 1e-4 relative to the largest activations, which are
            // of the order of |σ|.
            let expected = sigma[i].max(0.0);
            assert!(
                (found.density - expected).abs() <= 2e-4 * sigma[i].abs().max(10.0),
                "{scene} {i}: {found:?}, {expected}"
            );
            let color = 1.0 / (1.0 + (-rgb[i]).exp());
            assert!((found.color - color).abs().max_element() <= 2e-4, "{scene} {i}: {found:?}, {color}");
        }
    }
}

#[test]
#[ignore = "needs OCTOBAYES_DATA/nerf-mlp-pretrained"]
fn the_forward_facing_model_is_refused_with_a_reason() {
    let error = NerfMlp::read(&data("nerf-mlp-pretrained/fern.safetensors")).unwrap_err().to_string();
    assert!(error.contains("fern.safetensors") && error.contains("NDC"), "{error}");
}

#[test]
#[ignore = "needs OCTOBAYES_DATA/nerf-mlp-pretrained and nerf-lego-400"]
fn lego_renders_reach_the_measured_quality() {
    let model = NerfMlp::read(&data("nerf-mlp-pretrained/lego.safetensors")).unwrap();
    let views = Views::read(&data("nerf-lego-400/transforms_test.json"), None).unwrap();
    let settings = RaySettings { cutoff: 1e-4, ..RaySettings::default() };
    let tracer = settings.tracer(&model, 0.0, &Silent).unwrap();
    // Measured with the original sampling (64 coarse + 64 fine) in NumPy, on every fifth pixel.
    for (name, expected) in [("./test/r_0", 27.5), ("./test/r_60", 27.8), ("./test/r_120", 27.3)] {
        let frame = views.frames.iter().find(|f| f.name == name).unwrap();
        let view = render_view(&tracer, &frame.camera, model.pixel_offset(), &[], &Silent).unwrap();
        let truth = PosedImage::read(&frame.image).unwrap();
        let colors: Vec<_> = view.pixels.iter().map(|p| p.color).collect();
        let true_colors: Vec<_> = (0..truth.len()).map(|i| truth.over(i, tracer.background())).collect();
        let found = psnr(&colors, &true_colors);
        assert!((found - expected).abs() <= 0.3, "{name}: {found:.2} dB, {expected} measured");
    }
}
