//! The same on other people's splats and images.

use glam::{DMat3, DVec3, Quat, Vec3};
use safetensors::SafeTensors;

use super::super::reference::{gaussians, shown};
use super::super::*;
use super::compare_derivatives;
use crate::RenderMode;
use octobayes::render::Renderer;

/// Reads one of brush's cases: splats, and gsplat's image of them (red, green, blue, alpha).
fn case(name: &str) -> (Splats, Vec<f32>) {
    let folder = std::env::var("OCTOBAYES_DATA").expect("OCTOBAYES_DATA names the folder of data");
    let bytes = std::fs::read(format!("{folder}/splats/{name}")).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let of = |name: &str| -> Vec<f32> {
        let bytes = file.tensor(name).unwrap().data();
        bytes.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect()
    };
    let vectors = |name: &str| -> Vec<Vec3> { of(name).chunks_exact(3).map(Vec3::from_slice).collect() };
    let rotations = of("quats").chunks_exact(4).map(|q| Quat::from_xyzw(q[1], q[2], q[3], q[0]).normalize()).collect();
    let (means, coefficients) = (vectors("means"), of("coeffs"));
    let degree = ((coefficients.len() / (3 * means.len())) as f64).sqrt() as u8 - 1;
    let splats =
        Splats::new(means, vectors("scales"), rotations, of("opacities"), coefficients, degree, RenderMode::Classic);
    (splats.unwrap(), of("out_img"))
}

/// The camera of brush's cases.
fn camera() -> Camera {
    Camera {
        position: DVec3::new(0.123, 0.456, -8.0),
        axes: DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)),
        focal: [61.5; 2],
        center: [61.5, 41.0],
        resolution: [123, 82],
        distortion: Distortion::default(),
    }
}

#[test]
#[ignore = "needs OCTOBAYES_DATA, the folder of data"]
fn images_are_those_of_gsplat_data() {
    for name in ["brush_tiny_case.safetensors", "brush_basic_case.safetensors"] {
        let (splats, expected) = case(name);
        let (camera, slow) = (camera(), gaussians(&splats));
        let view = SplatRenderer::new(&splats, Vec3::ZERO);
        let view = view.image(&camera, 0.5, &[], &octobayes::monitor::Silent).unwrap();
        let (mut fast_worst, mut slow_worst) = (0.0_f64, 0.0_f64);
        for (i, expected) in expected.chunks_exact(4).enumerate() {
            let at = [(i % 123) as f64 + 0.5, (i / 123) as f64 + 0.5];
            let reference = shown(&slow, RenderMode::Classic, &camera, [0.0; 3], at);
            let (fast, expected) = (view.pixels[i], expected.iter().map(|&v| f64::from(v)));
            let fast = [fast.color.x, fast.color.y, fast.color.z, fast.opacity];
            let [r, g, b] = reference.color;
            for (k, expected) in expected.enumerate() {
                fast_worst = fast_worst.max((fast[k] - expected).abs());
                slow_worst = slow_worst.max(([r, g, b, reference.opacity][k] - expected).abs());
            }
        }
        println!("{name}: fast {fast_worst:e}, reference {slow_worst:e}");
        assert!(slow_worst <= 2e-6 && fast_worst <= 1e-5, "{name}: {slow_worst:e}, {fast_worst:e}");
    }
}

#[test]
#[ignore = "needs OCTOBAYES_DATA, the folder of data"]
fn derivatives_on_gsplat_data() {
    for mode in RenderMode::ALL {
        let splats = case("brush_basic_case.safetensors").0.with_mode(mode);
        let color = compare_derivatives(&splats, &camera(), 37);
        println!("{mode}: {color:?}");
        assert!(color.entries > 200 && color.worst < 1e-6, "{color:?}");
    }
}
