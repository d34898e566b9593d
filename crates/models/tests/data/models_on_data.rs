//! Tests on pre-trained models, which the project does not ship. They read `$OCTOBAYES_DATA`, which `.ci/run` sets;
//! there, missing data is a failure. The book's page `data.md` says where to get the data.

use glam::Vec3;
use octobayes::estimate::{Estimation, GridSettings, Outcome, RaySettings, StepCheck};
use octobayes::field::{Intrinsics, Radiance, RadianceField, TrainedField};
use octobayes::geometry::Domain;
use octobayes::metrics::psnr;
use octobayes::monitor::Silent;
use octobayes::render::{GradientMethod, render_view};
use octobayes_data::{PosedImage, Views};
use octobayes_models::{Coordinates, NerfMlp, Ppng};

use super::data;

/// Rows of three numbers.
fn vectors(rows: &serde_json::Value) -> Vec<Vec3> {
    let rows = rows.as_array().unwrap();
    rows.iter().map(|v| Vec3::from_array(std::array::from_fn(|k| v[k].as_f64().unwrap() as f32))).collect()
}

/// Renders test views of lego and compares their PSNR with what was measured, to within 0.3 dB, over every
/// `stride`th pixel along x and y.
fn check_lego_renders(model: &dyn TrainedField, stride: usize, measured: [f64; 3]) {
    let views = Views::read(&data("nerf-lego-400/transforms_test.json"), None).unwrap();
    let settings = RaySettings::default().cutoff(1e-4);
    let tracer = settings.tracer(model, 0.0, &Silent).unwrap();
    for (name, expected) in ["./test/r_0", "./test/r_60", "./test/r_120"].into_iter().zip(measured) {
        let frame = views.frames.iter().find(|f| f.name == name).unwrap();
        let view = render_view(&tracer, &frame.camera, model.pixel_offset(), &[], &Silent).unwrap();
        let truth = PosedImage::read(&frame.image, frame.camera.resolution).unwrap();
        let width = view.resolution[0] as usize;
        let compared = || (0..truth.len()).filter(|i| [i % width, i / width].iter().all(|k| k.is_multiple_of(stride)));
        let colors: Vec<_> = compared().map(|i| view.pixels[i].color).collect();
        let true_colors: Vec<_> = compared().map(|i| truth.over(i, tracer.background())).collect();
        let found = psnr(&colors, &true_colors);
        assert!((found - expected).abs() <= 0.3, "{name}: {found:.2} dB, {expected} measured");
    }
}

#[test]
#[ignore = "needs OCTOBAYES_DATA/nerf-mlp-pretrained"]
fn mlp_models_return_the_published_check_values() {
    let text = std::fs::read_to_string(data("nerf-mlp-pretrained/check_values.json")).unwrap();
    let checks: serde_json::Value = serde_json::from_str(&text).unwrap();
    for scene in ["lego", "chair", "drums", "materials", "ship"] {
        let model = NerfMlp::read(&data(&format!("nerf-mlp-pretrained/{scene}.safetensors"))).unwrap();
        let check = &checks[scene];
        let [positions, directions] = ["position", "unit_dir"].map(|key| vectors(&check[key]));
        let rgb = vectors(&check["fine"]["raw_rgb"]);
        let sigma = check["fine"]["raw_sigma"].as_array().unwrap();
        let sigma: Vec<f32> = sigma.iter().map(|v| v.as_f64().unwrap() as f32).collect();
        assert_eq!(positions.len(), 6);
        let mut out = vec![Radiance::default(); positions.len()];
        model.evaluate(&positions, &directions, &mut out);
        for (i, found) in out.iter().enumerate() {
            // The expected values are f64 evaluations of the f32 weights. The network has five layers of 128 f32
            // products, and sines of arguments up to 512 · 1.5, whose f32 rounding is 3e-5. That gives 1e-4
            // relative to the largest activations, which are of the order of |σ|.
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
fn a_checkpoint_of_pytorch_holds_the_same_bits_as_its_conversion() {
    let names = ["lego.original.ckpt", "lego.safetensors"];
    let models = names.map(|name| NerfMlp::read(&data(&format!("nerf-mlp-pretrained/{name}"))).unwrap());
    let positions: Vec<Vec3> =
        (0..4096).map(|i| Vec3::new((i % 16) as f32, (i / 16 % 16) as f32, (i / 256) as f32) / 8.0 - 0.9).collect();
    let directions = vec![Vec3::new(0.6, 0.0, 0.8); positions.len()];
    let [checkpoint, converted] = models.map(|model| {
        let mut out = vec![Radiance::default(); positions.len()];
        model.evaluate(&positions, &directions, &mut out);
        out
    });
    assert_eq!(checkpoint, converted);
    assert!(converted.iter().any(|r| r.density > 10.0));
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
    // Measured in NumPy with the original sampling (64 coarse + 64 fine), on every fifth pixel.
    check_lego_renders(&model, 1, [27.5, 27.8, 27.3]);
}

#[test]
#[ignore = "needs OCTOBAYES_DATA/ppng-pretrained"]
fn ppng_models_return_the_check_values() {
    let text = std::fs::read_to_string(data("ppng-pretrained/check_values.json")).unwrap();
    let checks: serde_json::Value = serde_json::from_str(&text).unwrap();
    let checks = checks.as_object().unwrap();
    assert_eq!(checks.len(), 5);
    for (name, check) in checks {
        let model = Ppng::read(&data(&format!("ppng-pretrained/{name}.ppng")), Coordinates::Ngp).unwrap();
        let cells: Vec<u64> = check["occupied_cells"].as_array().unwrap().iter().map(|n| n.as_u64().unwrap()).collect();
        assert_eq!(model.occupied_cells(), cells, "{name}");
        let [positions, directions, rgb] = ["pos_unit_box", "unit_dir", "rgb"].map(|key| vectors(&check[key]));
        // Positions are those of the unit box, as the tables have them.
        let side = model.bounds().longest_edge() as f32;
        let positions: Vec<Vec3> = positions.iter().map(|q| (q - 0.5) * side + 0.5).collect();
        let mut out = vec![Radiance::default(); 6];
        model.evaluate(&positions, &directions, &mut out);
        for (i, found) in out.iter().enumerate() {
            let expected = check["sigma"][i].as_f64().unwrap();
            let error = f64::from(found.density).ln() - expected.ln();
            // The printed positions have 6 digits: 5e-7 of the box, times slopes of log σ of the order of 1e3. The
            // largest error seen is 2.5e-4.
            assert!(error.abs() < 1e-3, "{name} {i}: {found:?}, {expected}");
            assert!((found.color - rgb[i]).abs().max_element() < 1e-3, "{name} {i}: {found:?}, {}", rgb[i]);
        }
    }
}

#[test]
#[ignore = "needs OCTOBAYES_DATA/ppng-pretrained and nerf-lego-400"]
fn ppng_lego_renders_reach_the_measured_quality() {
    // Measured in NumPy with the model's own sampling of occupied cells, on the same pixels. Over all pixels r_60
    // is 0.35 dB lower. A model whose occupancy grid is ignored loses 0.5 to 1.2 dB at type 2.
    for (kind, measured) in [(1, [29.8, 32.4, 30.4]), (2, [31.7, 35.1, 32.5])] {
        let file = data(&format!("ppng-pretrained/NeRFSynthetic/ppng_{kind}/lego.ppng"));
        check_lego_renders(&Ppng::read(&file, Coordinates::Blender).unwrap(), 5, measured);
    }
}

#[test]
#[ignore = "needs OCTOBAYES_DATA/ppng-pretrained and nerf-lego-400"]
fn ppng_poses_are_the_training_cameras() {
    let model = Ppng::read(&data("ppng-pretrained/NeRFSynthetic/ppng_1/lego.ppng"), Coordinates::Blender).unwrap();
    let views = Views::read(&data("nerf-lego-400/transforms_train.json"), Some([400, 400])).unwrap();
    let intrinsics = Intrinsics { fov_x: Some(0.691_111_2), resolution: None };
    let found = model.cameras(&intrinsics).unwrap().unwrap();
    assert_eq!(found.len(), 100);
    for (found, frame) in found.iter().zip(&views.frames) {
        // The file's poses are f32, and positions reach 2 units of 1/0.33.
        assert!(found.position.abs_diff_eq(frame.camera.position, 2e-6), "{found:?}, {:?}", frame.camera);
        assert!(found.axes.abs_diff_eq(frame.camera.axes, 2e-6), "{found:?}, {:?}", frame.camera);
        assert!((found.focal[0] - frame.camera.focal[0]).abs() < 1e-4);
    }
}

#[test]
#[ignore = "needs OCTOBAYES_DATA/ppng-pretrained"]
fn all_ppng_models_open() {
    let mut models = 0;
    for set in ["360_v2", "BlendedMVS", "NeRFSynthetic", "Synthetic_NSVF", "TanksAndTemple"] {
        for kind in ["ppng_1", "ppng_2"] {
            let Ok(folder) = std::fs::read_dir(data(&format!("ppng-pretrained/{set}/{kind}"))) else { continue };
            for file in folder {
                let path = file.unwrap().path();
                let model = Ppng::read(&path, Coordinates::Ngp).unwrap_or_else(|e| panic!("{e}"));
                let side = if set == "360_v2" { 8.0 } else { 1.0 };
                assert_eq!(model.bounds().longest_edge(), side, "{}", path.display());
                assert!(model.occupied_cells().iter().all(|&n| n > 1000), "{}", path.display());
                assert!(
                    model.cameras(&Intrinsics { fov_x: Some(1.0), resolution: None }).unwrap().unwrap().len() >= 50
                );
                models += 1;
            }
        }
    }
    assert_eq!(models, 36);
}

#[test]
#[ignore = "needs OCTOBAYES_DATA/nerf-mlp-pretrained"]
fn advice_on_the_step_of_an_mlp_can_be_obeyed() {
    let field = NerfMlp::read(&data("nerf-mlp-pretrained/lego.safetensors")).unwrap();
    let cameras = data("nerf-mlp-pretrained/cameras/lego_train.json");
    let cameras = Views::read(&cameras, Some([400, 400])).unwrap().cameras();
    let grid = GridSettings::default().level(4);
    let domain = Domain::Box(field.bounds());
    let lattice = grid.lattice(domain).unwrap();
    let base = RaySettings::default().rays(4_000);
    let stream = base.stream(&field, &cameras, &lattice, &Silent).unwrap();
    let check = StepCheck::measure(&stream, &lattice, grid.tolerance, &Silent).unwrap().unwrap();
    assert!(check.is_bad && check.knows_derivatives);
    let log10 = |rays: RaySettings| {
        let Outcome { field, .. } = Estimation::new(&field, &cameras).rays(rays).grid(grid).run().unwrap();
        let points = (0..17 * 17 * 17).map(|i| [i / 289, i / 17 % 17, i % 17].map(f64::from));
        let at = |u: [f64; 3]| field.query(domain.to_scene(glam::DVec3::from(u) / 16.0).as_vec3()).uncertainty.log10();
        points.map(at).collect::<Vec<f64>>()
    };
    let exact = log10(base.gradient(GradientMethod::Analytic));
    let error = |step: f64| {
        let found = log10(base.step(Some(step)));
        found.iter().zip(&exact).map(|(a, b)| (a - b).abs()).sum::<f64>() / exact.len() as f64
    };
    let best = check.errors.best().step;
    let [before, after] = [check.step, best].map(error);
    println!("{before:.4} with {}, {after:.4} with {best}", check.step);
    assert!(after < before, "{before}, {after} with {best}");
}
