//! Depth maps: the truth that rendered depths are evaluated against.

use std::path::Path;

use super::image::decode;
use crate::geometry::Camera;
use crate::{Error, Result};

/// Quantity that a depth map measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum DepthKind {
    /// Distance from the camera's centre.
    #[default]
    Euclidean,
    /// Distance along the camera's viewing axis.
    Z,
}

impl DepthKind {
    /// Distance from the camera's centre per depth of this kind, along the ray through image coordinates `(x, y)`.
    #[must_use]
    pub fn stretch(self, camera: &Camera, x: f64, y: f64) -> f64 {
        match self {
            Self::Euclidean => 1.0,
            Self::Z => 1.0 / camera.ray(x, y).direction.dot(-camera.axes.z_axis),
        }
    }

    /// The other kind, for which this one may have been taken.
    #[must_use]
    pub fn other(self) -> Self {
        match self {
            Self::Euclidean => Self::Z,
            Self::Z => Self::Euclidean,
        }
    }
}

/// Encoding of a depth map: depth = offset + scale · p in scene units, with p = value / largest
/// value of the integer type.
///
/// Value 0 means "unknown".
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct DepthEncoding {
    /// Depth at p = 0.
    pub offset: f64,
    /// Depth at p = 1, minus the offset.
    pub scale: f64,
    /// Quantity that is measured.
    pub kind: DepthKind,
}

impl DepthEncoding {
    /// The encoding of depth maps whose names follow `pattern`, from an offset and scale for those that need one.
    ///
    /// # Errors
    /// If maps in .exr, which are in scene units, are given an offset and scale, or others none.
    pub fn of_maps(pattern: &str, given: Option<[f64; 2]>, kind: DepthKind) -> Result<Self> {
        let refused = |expected: &str, found: String| Err(Error::setting("depth encoding", expected, found));
        match (given, is_exact(Path::new(pattern))) {
            (Some([offset, scale]), false) => Ok(Self { offset, scale, kind }),
            (None, true) => Ok(Self { offset: 0.0, scale: 1.0, kind }),
            (None, false) => {
                refused("offset and scale of the depth maps (those in .exr are in scene units)", "none".into())
            }
            (Some([offset, scale]), true) => {
                refused("none, as depth maps in .exr are in scene units", format!("{offset},{scale}"))
            }
        }
    }
}

/// A depth map, converted to distances from the camera's centre.
#[derive(Debug, Clone)]
pub struct DepthMap {
    /// Width and height in pixels.
    pub resolution: [u32; 2],
    /// `[height · width]`: Euclidean distance in scene units; `None` if unknown.
    pub distance: Vec<Option<f64>>,
}

impl DepthMap {
    /// Reads an 8- or 16-bit PNG (of a colour image, the first channel), or the depth channel of an EXR, which is in
    /// scene units whatever the encoding's offset and scale. There, unknown depths are 0, or not finite.
    ///
    /// # Errors
    /// If the file is missing or damaged, or its size differs from the camera's.
    pub fn read(path: &Path, encoding: DepthEncoding, camera: &Camera, pixel_offset: f64) -> Result<Self> {
        let resolution = camera.resolution;
        let depths = if is_exact(path) { exact(path, resolution)? } else { steps(path, encoding, resolution)? };
        let width = resolution[0] as usize;
        let distance = depths.into_iter().enumerate().map(|(i, depth)| {
            let [x, y] = [i % width, i / width].map(|n| n as f64 + pixel_offset);
            Some(depth? * encoding.kind.stretch(camera, x, y))
        });
        Ok(Self { resolution, distance: distance.collect() })
    }
}

/// Whether a depth map of this name holds scene units.
fn is_exact(name: &Path) -> bool {
    name.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr"))
}

/// The depths of an EXR.
#[cfg(feature = "exr")]
fn exact(path: &Path, resolution: [u32; 2]) -> Result<Vec<Option<f64>>> {
    let depths = crate::io::read_exr_depth(path, resolution)?.into_iter().map(f64::from);
    Ok(depths.map(|depth| (depth > 0.0 && depth.is_finite()).then_some(depth)).collect())
}

#[cfg(not(feature = "exr"))]
fn exact(path: &Path, _: [u32; 2]) -> Result<Vec<Option<f64>>> {
    Err(Error::malformed(path, "depth map", "a PNG or JPEG, as the feature `exr` is off", "an EXR image"))
}

/// The depths of a PNG.
fn steps(path: &Path, encoding: DepthEncoding, resolution: [u32; 2]) -> Result<Vec<Option<f64>>> {
    let raw: Vec<f64> = match &decode(path, "depth map", resolution)? {
        image::DynamicImage::ImageLuma16(i) => i.pixels().map(|p| f64::from(p.0[0]) / 65535.0).collect(),
        image::DynamicImage::ImageLumaA16(i) => i.pixels().map(|p| f64::from(p.0[0]) / 65535.0).collect(),
        image::DynamicImage::ImageRgb16(i) => i.pixels().map(|p| f64::from(p.0[0]) / 65535.0).collect(),
        image::DynamicImage::ImageRgba16(i) => i.pixels().map(|p| f64::from(p.0[0]) / 65535.0).collect(),
        other => other.to_rgba8().pixels().map(|p| f64::from(p.0[0]) / 255.0).collect(),
    };
    Ok(raw.into_iter().map(|p| (p > 0.0).then_some(encoding.offset + encoding.scale * p)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[cfg(not(feature = "exr"))]
    #[test]
    fn without_its_feature_exr_is_refused() {
        let camera = Camera::look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z, 0.7, [4, 4]);
        let encoding = DepthEncoding { offset: 0.0, scale: 1.0, kind: DepthKind::Euclidean };
        let said = DepthMap::read(Path::new("depth.EXR"), encoding, &camera, 0.5).unwrap_err().to_string();
        assert_eq!(
            said,
            "depth.EXR: depth map: expected a PNG or JPEG, as the feature `exr` is off, found an EXR image"
        );
    }

    #[test]
    fn z_depth_becomes_distance_and_zero_is_unknown() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("depth.png");
        let mut image = image::ImageBuffer::<image::Luma<u16>, _>::from_pixel(4, 4, image::Luma([32768_u16]));
        image.put_pixel(0, 0, image::Luma([0]));
        image.save(&path).unwrap();
        let camera = Camera::look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z, 0.7, [4, 4]);
        let encoding = DepthEncoding { offset: 0.0, scale: 65.535, kind: DepthKind::Z };
        let map = DepthMap::read(&path, encoding, &camera, 0.5).unwrap();
        assert_eq!(map.distance[0], None);
        // The point at that distance along the pixel's ray has z-depth 32.768.
        let point = camera.ray(3.5, 1.5).at(map.distance[7].unwrap());
        assert!((camera.project(point).unwrap().1 - 32.768).abs() < 1e-9);
    }
}
