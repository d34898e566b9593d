//! Points of depth maps with their deviations, for CloudCompare and others.

use std::path::Path;

use glam::Vec3;
use octobayes::Result;

use super::ply::PlyWriter;

/// A point of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthPoint {
    /// Position.
    pub position: Vec3,
    /// Unit normal, towards the camera; zero if it is not known.
    pub normal: Vec3,
    /// In [0, 1].
    pub color: Vec3,
    /// Standard deviation along the view that shows it.
    pub sigma: f32,
    /// Number of training cameras that see a surface there.
    pub views: u16,
}

/// Writes points with their deviation and views as scalar fields. `unit` ends the name of the deviation's: `m`, or
/// nothing for scene units.
///
/// # Errors
/// If the file cannot be written.
pub fn write_depth_points(path: &Path, points: &[DepthPoint], unit: Option<&str>) -> Result<()> {
    let sigma = unit.map_or_else(|| "scalar_sigma".to_string(), |unit| format!("scalar_sigma_{unit}"));
    let floats = ["x", "y", "z", "nx", "ny", "nz"].map(|name| ("float", name));
    let colors = ["red", "green", "blue"].map(|name| ("uchar", name));
    let properties = [&floats[..], &colors, &[("float", &*sigma), ("float", "scalar_views")]].concat();
    let text = format!("coordinates and {sigma} in {}", unit.unwrap_or("scene units"));
    let mut ply = PlyWriter::create(path, &[text], &[("vertex", points.len(), &properties)])?;
    for point in points {
        ply.floats(point.position.to_array().into_iter().chain(point.normal.to_array()))?;
        ply.put(&point.color.to_array().map(|v| (255.0 * v.clamp(0.0, 1.0)).round() as u8))?;
        ply.floats([point.sigma, f32::from(point.views)])?;
    }
    ply.finish()
}
