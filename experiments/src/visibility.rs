//! What a camera sees of a mesh.

use glam::DVec3;
use octobayes::geometry::{Camera, Ray};
use octobayes_synth::MeshScene;

/// What may stand before a point of the surface, by rounding, scene units.
pub const NEAR: f64 = 1e-3;

/// Whether a point is in a camera's image and nothing stands more than `slack` scene units before it.
pub fn is_seen(mesh: &MeshScene, camera: &Camera, x: DVec3, slack: f64) -> bool {
    let Some(([column, row], _)) = camera.project(x) else { return false };
    let [width, height] = camera.resolution.map(f64::from);
    let distance = x.distance(camera.position);
    let ray = Ray::new(camera.position, x - camera.position);
    (0.0..width).contains(&column)
        && (0.0..height).contains(&row)
        && mesh.nearest(&ray).is_none_or(|hit| hit.t > distance - slack)
}
