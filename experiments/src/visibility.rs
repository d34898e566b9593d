//! What a camera sees of a mesh.

use glam::DVec3;
use octobayes::geometry::{Camera, Ray};
use octobayes_synth::MeshScene;

/// What may stand before a point of the surface, by rounding, scene units.
pub const NEAR: f64 = 1e-3;

/// Whether a point is in a camera's image and nothing stands more than `slack` scene units before it.
#[must_use]
pub fn is_seen(mesh: &MeshScene, camera: &Camera, x: DVec3, slack: f64) -> bool {
    let distance = x.distance(camera.position);
    let ray = Ray::new(camera.position, x - camera.position);
    camera.project_inside(x).is_some() && mesh.nearest(&ray).is_none_or(|hit| hit.t > distance - slack)
}
