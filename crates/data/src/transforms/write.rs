//! Writing camera files.

use std::path::Path;

use octobayes::Result;
use octobayes::geometry::Camera;
use octobayes::io::AtomicFile;

/// Writes cameras, each with the `file_path` of its frame, as a transforms.json for
/// [`Views::read`](crate::Views::read) and other tools.
///
/// # Errors
/// If the file cannot be written.
pub fn write_transforms(path: &Path, cameras: &[(String, Camera)]) -> Result<()> {
    AtomicFile::write(path, transforms_text(cameras).as_bytes())
}

/// What [`write_transforms`] writes.
#[must_use]
pub fn transforms_text(cameras: &[(String, Camera)]) -> String {
    let frames: Vec<_> = cameras
        .iter()
        .map(|(name, camera)| {
            let [x, y, z] = [camera.axes.x_axis, camera.axes.y_axis, camera.axes.z_axis];
            let row = |k: usize| [x[k], y[k], z[k], camera.position[k]];
            serde_json::json!({
                "file_path": name,
                "fl_x": camera.focal[0], "fl_y": camera.focal[1], "cx": camera.center[0], "cy": camera.center[1],
                "w": camera.resolution[0], "h": camera.resolution[1],
                "k1": camera.distortion.k[0], "k2": camera.distortion.k[1],
                "k3": camera.distortion.k[2], "k4": camera.distortion.k[3],
                "p1": camera.distortion.p[0], "p2": camera.distortion.p[1],
                "transform_matrix": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
            })
        })
        .collect();
    format!("{:#}", serde_json::json!({ "camera_model": "OPENCV", "frames": frames }))
}
