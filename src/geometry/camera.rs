//! Pinhole cameras in the OpenGL convention.
//!
//! Camera axes: x right, y up, looking along −z. Pixel (column i, row j) with row 0 at the top.

use glam::{DMat3, DVec3};

use super::{Distortion, Ray};

/// A pinhole camera: pose and intrinsics in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Optical centre, scene units.
    pub position: DVec3,
    /// Camera-to-world: columns right, up, back.
    pub axes: DMat3,
    /// Focal lengths along x and y, pixels.
    pub focal: [f64; 2],
    /// Principal point, pixels from the top left corner of the image.
    pub center: [f64; 2],
    /// Width and height, pixels.
    pub resolution: [u32; 2],
    /// What the lens does to ideal image coordinates.
    pub distortion: Distortion,
}

impl Camera {
    /// A camera at `eye` that looks at `target`, with the principal point in the middle.
    ///
    /// `fov_x` is the horizontal angle of view in radians; `up` must not be parallel to the view direction.
    #[must_use]
    pub fn look_at(eye: DVec3, target: DVec3, up: DVec3, fov_x: f64, resolution: [u32; 2]) -> Self {
        let back = (eye - target).normalize();
        let right = up.cross(back).normalize();
        let focal = 0.5 * f64::from(resolution[0]) / (0.5 * fov_x).tan();
        Self {
            position: eye,
            axes: DMat3::from_cols(right, back.cross(right), back),
            focal: [focal; 2],
            center: [0.5 * f64::from(resolution[0]), 0.5 * f64::from(resolution[1])],
            resolution,
            distortion: Distortion::default(),
        }
    }

    /// The ray through image coordinates `(x, y)` in pixels; the centre of pixel (i, j) is `(i + ½, j + ½)`.
    #[must_use]
    pub fn ray(&self, x: f64, y: f64) -> Ray {
        let seen = [(x - self.center[0]) / self.focal[0], (y - self.center[1]) / self.focal[1]];
        let [x, y] = self.distortion.undistort(seen);
        let direction = DVec3::new(x, -y, -1.0);
        Ray::new(self.position, self.axes * direction)
    }

    /// Number of pixels.
    #[must_use]
    pub fn pixels(&self) -> u64 {
        u64::from(self.resolution[0]) * u64::from(self.resolution[1])
    }

    /// Image coordinates and depth along the view axis of a scene point; `None` behind the camera.
    #[must_use]
    pub fn project(&self, x: DVec3) -> Option<([f64; 2], f64)> {
        let p = self.axes.transpose() * (x - self.position);
        let depth = -p.z;
        (depth > 0.0).then(|| {
            let [x, y] = self.distortion.distort([p.x / depth, -p.y / depth]);
            ([self.center[0] + self.focal[0] * x, self.center[1] + self.focal[1] * y], depth)
        })
    }

    /// The camera whose pixel (i, j) has the ray of this one's pixel (i · stride, j · stride), both at `offset`.
    #[must_use]
    pub fn strided(&self, stride: u32, offset: f64) -> Self {
        let s = f64::from(stride);
        Self {
            focal: self.focal.map(|f| f / s),
            center: self.center.map(|c| offset + (c - offset) / s),
            resolution: self.resolution.map(|n| n.div_ceil(stride)),
            ..*self
        }
    }

    /// The same camera with an image of another size that shows the same scene.
    #[must_use]
    pub fn resized(&self, resolution: [u32; 2]) -> Self {
        let scale = [0, 1].map(|k| f64::from(resolution[k]) / f64::from(self.resolution[k]));
        Self {
            focal: [self.focal[0] * scale[0], self.focal[1] * scale[1]],
            center: [self.center[0] * scale[0], self.center[1] * scale[1]],
            resolution,
            ..*self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PIXELS: [[f64; 2]; 4] = [[0.5, 0.5], [20.0, 15.0], [39.5, 0.5], [3.25, 29.0]];

    #[test]
    fn rays_project_back_to_their_pixel() {
        let pinhole = Camera::look_at(DVec3::new(3.0, -2.0, 1.5), DVec3::ZERO, DVec3::Z, 0.7, [40, 30]);
        let distortion = Distortion { k: [0.0578, -0.0805], p: [-9.8e-4, 1.6e-4] };
        for (camera, pixel) in
            [pinhole, Camera { distortion, ..pinhole }].into_iter().flat_map(|c| PIXELS.map(|p| (c, p)))
        {
            let ray = camera.ray(pixel[0], pixel[1]);
            let (found, depth) = camera.project(ray.at(2.0)).unwrap();
            assert!(depth > 0.0 && depth <= 2.0);
            for k in 0..2 {
                // Two rotations and a division in f64 on numbers below 100: 1e-12 is 70 ulps.
                assert!((found[k] - pixel[k]).abs() < 1e-12 * 100.0, "{found:?} for {pixel:?}");
            }
        }
        assert!(pinhole.project(pinhole.position + pinhole.axes.z_axis).is_none());
    }

    #[test]
    fn up_is_up_and_rows_grow_downwards() {
        let camera = Camera::look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z, 0.7, [40, 40]);
        assert!(camera.ray(20.0, 0.0).direction.z > 0.0, "the top row looks up");
        assert!(camera.ray(40.0, 20.0).direction.x > 0.0, "the right column looks right");
    }
}
