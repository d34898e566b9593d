//! Depth maps: the truth that rendered depths are evaluated against.

use std::path::Path;

use super::image::decode;
use crate::Result;
use crate::geometry::Camera;

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

/// A depth map, converted to distances from the camera's centre.
#[derive(Debug, Clone)]
pub struct DepthMap {
    /// Width and height in pixels.
    pub resolution: [u32; 2],
    /// `[height · width]`: Euclidean distance in scene units; `None` if unknown.
    pub distance: Vec<Option<f64>>,
}

impl DepthMap {
    /// Reads an 8- or 16-bit PNG; of a colour image, the first channel.
    ///
    /// # Errors
    /// If the file is missing or damaged, or its size differs from the camera's.
    pub fn read(path: &Path, encoding: DepthEncoding, camera: &Camera, pixel_offset: f64) -> Result<Self> {
        let resolution = camera.resolution;
        let image = decode(path, "depth map", resolution)?;
        let raw: Vec<f64> = match &image {
            image::DynamicImage::ImageLuma16(i) => i.pixels().map(|p| f64::from(p.0[0]) / 65535.0).collect(),
            image::DynamicImage::ImageLumaA16(i) => i.pixels().map(|p| f64::from(p.0[0]) / 65535.0).collect(),
            image::DynamicImage::ImageRgb16(i) => i.pixels().map(|p| f64::from(p.0[0]) / 65535.0).collect(),
            image::DynamicImage::ImageRgba16(i) => i.pixels().map(|p| f64::from(p.0[0]) / 65535.0).collect(),
            other => other.to_rgba8().pixels().map(|p| f64::from(p.0[0]) / 255.0).collect(),
        };
        let width = resolution[0] as usize;
        let distance = raw
            .iter()
            .enumerate()
            .map(|(i, &p)| {
                let depth = encoding.offset + encoding.scale * p;
                let stretch = match encoding.kind {
                    DepthKind::Euclidean => 1.0,
                    DepthKind::Z => {
                        let ray = camera.ray((i % width) as f64 + pixel_offset, (i / width) as f64 + pixel_offset);
                        1.0 / ray.direction.dot(-camera.axes.z_axis)
                    }
                };
                (p > 0.0).then_some(depth * stretch)
            })
            .collect();
        Ok(Self { resolution, distance })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

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
