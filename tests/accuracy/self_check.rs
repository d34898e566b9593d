//! The oracle against definitions: it must not be wrong in the same way as what it checks.

use glam::{DMat3, DVec3};
use octobayes::rays::PixelSample;

use crate::oracle::ground::Ground;
use crate::oracle::{Derivatives, Oracle, eigenvalues};
use crate::scenes;

/// ∂C/∂θ_v by the model itself: the vertex is displaced, and the ray composited again.
#[test]
fn jacobians_are_the_pixels_response_to_a_displaced_vertex() {
    for name in ["checker-coarse", "camera-inside", "thin-sheet", "saturated"] {
        let scene = scenes::by_name(name);
        let (cameras, ground) = (scene.cameras(), Ground::of(&scene.field));
        let oracle = Oracle {
            ground: &ground,
            cameras: &cameras,
            interval: 1.0 / 128.0,
            background: DVec3::ONE,
            derivatives: Derivatives::Exact,
            cells: 32,
        };
        let mut compared = 0;
        for (camera, pixel) in [(0, [31, 33]), (1, [25, 30]), (2, [36, 28])] {
            let pick = PixelSample { camera, pixel, jitter: 0.3 };
            let jacobians = oracle.vertex_jacobians(&pick).unwrap();
            let scale =
                jacobians.iter().map(|(_, j)| j.to_cols_array().into_iter().fold(0.0, |a: f64, b| a.max(b.abs())));
            let scale = scale.fold(0.0, f64::max);
            for (vertex, jacobian) in jacobians.into_iter().step_by(3) {
                let h = 1e-6;
                let column = |axis: usize| {
                    let [up, down] =
                        [h, -h].map(|h| oracle.color_with_displaced_vertex(&pick, vertex, h * DVec3::AXES[axis]));
                    (up - down) / (2.0 * h)
                };
                let brute = DMat3::from_cols(column(0), column(1), column(2));
                let off = (brute - jacobian).to_cols_array().into_iter().fold(0.0, |a: f64, b| a.max(b.abs()));
                // Rounding is 1e-16 / 1e-6. Truncation is h² times the third derivative: `1e-12 · (1 / 0.004)²` at
                // a sheet's ramp.
                assert!(off <= 1e-6 * scale + 1e-9, "{name}, vertex {vertex}: {jacobian} against {brute}");
                compared += 1;
            }
        }
        assert!(compared > 5, "{name}: {compared}");
    }
}

#[test]
fn eigenvalues_are_those_that_a_matrix_was_made_of() {
    for (a, b) in [(0.3, 1.1), (2.0, -0.7), (0.0, 0.5)] {
        let turn = DMat3::from_rotation_x(a) * DMat3::from_rotation_z(b);
        let made = [1e-10, 3e-4, 1e3];
        let mut found = eigenvalues(&(turn * DMat3::from_diagonal(DVec3::from(made)) * turn.transpose()));
        found.sort_by(f64::total_cmp);
        for (found, made) in found.into_iter().zip(made) {
            // Two products round by a few ulps of the largest.
            assert!((found - made).abs() <= 1e-14 * 1e3, "{found} for {made}");
        }
    }
}
