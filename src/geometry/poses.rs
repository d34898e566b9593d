//! The cameras that were meant, if poses follow another convention than ours: camera-to-world with OpenGL's axes.

use glam::{DMat3, DVec3};

use super::Camera;

/// OpenCV's axes in place of OpenGL's, in a camera's own: y and z turn round.
const OPENCV: DMat3 = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));

/// The camera that was meant if its pose has OpenCV's axes (y down, looking along +z).
#[must_use]
pub fn opencv(camera: &Camera) -> Camera {
    Camera { axes: camera.axes * OPENCV, ..*camera }
}

/// The camera that was meant if its pose is world-to-camera, with OpenGL's axes and with OpenCV's.
#[must_use]
pub fn inverted(camera: &Camera) -> [Camera; 2] {
    let to_world = camera.axes.transpose();
    [to_world, to_world * OPENCV].map(|axes| Camera { position: -(to_world * camera.position), axes, ..*camera })
}
