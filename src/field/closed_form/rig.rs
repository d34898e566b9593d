//! The cameras meant for a scene.

use std::f64::consts::PI;

use glam::DVec3;

use crate::field::Intrinsics;
use crate::geometry::Camera;
use crate::{Error, Result};

/// Viewpoints, and the lens that all of them share by default.
#[derive(Debug, Clone, PartialEq)]
pub struct Rig {
    /// Eye and look-at point, scene units; z is up.
    pub viewpoints: Vec<(DVec3, DVec3)>,
    /// Horizontal angle of view, radians.
    pub fov_x: f64,
    /// Width and height, pixels.
    pub resolution: [u32; 2],
}

impl Rig {
    /// `count` viewpoints at two heights on a half circle on the side x > 0.
    pub fn half_circle(count: u32, resolution: [u32; 2]) -> Self {
        let viewpoints = (0..count)
            .map(|i| {
                let azimuth = PI * ((f64::from(i) + 0.5) / f64::from(count) - 0.5);
                let height = if i % 2 == 0 { 0.9 } else { 1.7 };
                (DVec3::new(2.8 * azimuth.cos(), 2.8 * azimuth.sin(), height), DVec3::new(0.0, 0.0, -0.25))
            })
            .collect();
        Self { viewpoints, fov_x: 0.8, resolution }
    }

    /// One camera per viewpoint; `intrinsics` override the rig's own lens.
    ///
    /// # Errors
    /// If the angle of view is not between 0 and π.
    pub fn cameras(&self, intrinsics: &Intrinsics) -> Result<Vec<Camera>> {
        let fov_x = intrinsics.fov_x.unwrap_or(self.fov_x);
        if !(fov_x > 0.0 && fov_x < PI) {
            let found = format!("{} degrees", fov_x.to_degrees());
            return Err(Error::setting("angle of view", "above 0 and below 180 degrees", found));
        }
        Ok(self.with_lens(fov_x, intrinsics.resolution.unwrap_or(self.resolution)))
    }

    /// One camera per viewpoint, all with the given lens.
    pub fn with_lens(&self, fov_x: f64, resolution: [u32; 2]) -> Vec<Camera> {
        let camera = |&(eye, target): &(DVec3, DVec3)| Camera::look_at(eye, target, DVec3::Z, fov_x, resolution);
        self.viewpoints.iter().map(camera).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intrinsics_replace_the_lens_and_are_checked() {
        let rig = Rig::half_circle(3, [200, 100]);
        let own = rig.cameras(&Intrinsics::default()).unwrap();
        assert_eq!((own.len(), own[0].resolution), (3, [200, 100]));
        let right_angle = Intrinsics { fov_x: Some(0.5 * PI), resolution: Some([80, 60]) };
        let told = rig.cameras(&right_angle).unwrap();
        // tan 45° = 1, so the focal length is half the width.
        assert!((told[0].focal[0] - 40.0).abs() < 1e-12 && told[0].resolution == [80, 60]);
        assert_eq!(told[2].position, own[2].position);
        for fov_x in [0.0, PI, f64::NAN] {
            assert!(rig.cameras(&Intrinsics { fov_x: Some(fov_x), resolution: None }).is_err());
        }
    }
}
