//! A named camera as this crate stores it in files: numbers as they are, so that every bit comes back.

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

use super::{Camera, Distortion};

/// A camera and the name of its picture.
///
/// Deserialising refuses cameras that no picture can have ([`Camera::defect`]).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(into = "Stored", try_from = "Stored")]
pub struct NamedCamera {
    /// `file_path` in the camera file.
    pub name: String,
    /// Pose and intrinsics.
    pub camera: Camera,
    /// True if some of its pixels were masked in training. The mask itself is not stored.
    pub is_masked: bool,
}

impl NamedCamera {
    /// A camera without a mask.
    #[must_use]
    pub fn new(name: impl Into<String>, camera: Camera) -> Self {
        Self { name: name.into(), camera, is_masked: false }
    }
}

#[derive(Serialize, Deserialize)]
struct Stored {
    name: String,
    position: [f64; 3],
    /// Columns right, up, back.
    axes: [[f64; 3]; 3],
    focal: [f64; 2],
    center: [f64; 2],
    resolution: [u32; 2],
    k: [f64; 4],
    p: [f64; 2],
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    masked: bool,
}

impl From<NamedCamera> for Stored {
    fn from(NamedCamera { name, camera, is_masked: masked }: NamedCamera) -> Self {
        let Camera { position, axes, focal, center, resolution, distortion: Distortion { k, p } } = camera;
        let (position, axes) = (position.to_array(), axes.to_cols_array_2d());
        Self { name, position, axes, focal, center, resolution, k, p, masked }
    }
}

impl TryFrom<Stored> for NamedCamera {
    type Error = String;

    fn try_from(stored: Stored) -> Result<Self, String> {
        let Stored { name, position, axes, focal, center, resolution, k, p, masked } = stored;
        let (position, axes) = (DVec3::from(position), DMat3::from_cols_array_2d(&axes));
        let camera = Camera { position, axes, focal, center, resolution, distortion: Distortion { k, p } };
        match camera.defect() {
            None => Ok(Self { name, camera, is_masked: masked }),
            Some(defect) => Err(format!("camera `{name}` has {defect}")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    type Change<'a> = &'a dyn Fn(&mut Camera);

    fn named() -> NamedCamera {
        let mut camera = Camera::look_at(DVec3::new(3.0, -2.0, 1.0 / 3.0), DVec3::ZERO, DVec3::Z, 0.7, [40, 30]);
        camera.distortion = Distortion { k: [0.1, -1.0 / 7.0, 1.0 / 11.0, -0.3], p: [1e-3, 2e-3] };
        NamedCamera { is_masked: true, ..NamedCamera::new("r_0", camera) }
    }

    #[test]
    fn every_bit_comes_back() {
        let text = serde_json::to_string(&named()).unwrap();
        assert_eq!(serde_json::from_str::<NamedCamera>(&text).unwrap(), named());
    }

    #[test]
    fn impossible_cameras_are_refused() {
        let changes: [(Change, &str); 6] = [
            (&|c| c.resolution = [0, 30], "0 x 30 pixels"),
            (&|c| c.resolution = [60_000; 2], "60000 x 60000"),
            (&|c| c.focal[1] = -1.0, "focal lengths"),
            (&|c| c.focal = [1e-9; 2], "focal lengths"),
            (&|c| c.axes.x_axis = -c.axes.x_axis, "no rotation"),
            (&|c| c.axes.x_axis *= 1.1, "no rotation"),
        ];
        for (change, expected) in changes {
            let mut other = named();
            change(&mut other.camera);
            let text = serde_json::to_string(&other).unwrap();
            let error = serde_json::from_str::<NamedCamera>(&text).unwrap_err().to_string();
            assert!(error.contains(expected) && error.contains("`r_0`"), "{error}");
        }
        let endless = serde_json::to_string(&named()).unwrap().replace("0.1", "1e999");
        assert!(serde_json::from_str::<NamedCamera>(&endless).is_err());
        let mut other = named().camera;
        other.distortion.p[1] = f64::NAN;
        assert!(other.defect().is_some_and(|defect| defect.contains("not finite")));
    }
}
