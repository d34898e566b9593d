//! What a camera sees of a mesh.

use glam::DVec3;
use octobayes::geometry::{Camera, Ray};
use octobayes::synth::MeshScene;

/// A camera sees a point if nothing stands this much nearer on the way, scene units.
const NEAR: f64 = 1e-3;

/// Whether a point of the surface is in a camera's image and nothing stands before it.
pub fn is_seen(mesh: &MeshScene, camera: &Camera, x: DVec3) -> bool {
    let Some(([column, row], _)) = camera.project(x) else { return false };
    let [width, height] = camera.resolution.map(f64::from);
    let distance = x.distance(camera.position);
    let ray = Ray::new(camera.position, x - camera.position);
    (0.0..width).contains(&column)
        && (0.0..height).contains(&row)
        && mesh.nearest(&ray).is_none_or(|hit| hit.t > distance - NEAR)
}
