//! Candidates that no file lists: around the box, looking at its middle, outside of matter.

use glam::DVec3;

use octobayes::estimate::Model;
use octobayes::geometry::{Camera, Domain, upright};
use octobayes::metrics::median;
use octobayes::{Error, Result};

/// Cameras around the middle of a domain, with the lens of one that there is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Around {
    /// What they look at, scene units.
    pub middle: DVec3,
    /// How far they are from it, scene units.
    pub distance: f64,
    /// What is up.
    pub up: DVec3,
    /// Sine of the elevation of an orbit.
    pub sine: f64,
    /// Whose lens they have.
    pub lens: Camera,
}

impl Around {
    /// Around the middle of `domain`, as `cameras` are: their first one's lens, their median distance and elevation,
    /// and their upright unless `up` is given.
    ///
    /// # Errors
    /// If there is no camera, all of them stand in the middle, or as [`upright`].
    pub fn like(cameras: &[Camera], domain: &Domain, up: Option<DVec3>) -> Result<Self> {
        let Some(&lens) = cameras.first() else {
            return Err(Error::setting("cameras", "at least one, whose lens the candidates get", "none"));
        };
        let middle = match domain {
            Domain::Box(bounds) => 0.5 * (bounds.min() + bounds.max()),
            Domain::Contracted { center, .. } => DVec3::from(*center),
        };
        let up = upright(cameras, up)?;
        let distance = median(cameras.iter().map(|camera| camera.position.distance(middle)));
        if !(distance > 0.0 && distance.is_finite()) {
            let found = format!("a median distance of {distance:e}");
            return Err(Error::setting("cameras", "cameras away from the middle of the box", found));
        }
        let sine = median(cameras.iter().map(|camera| (camera.position - middle).normalize_or_zero().dot(up)));
        Ok(Self { middle, distance, up, sine: sine.clamp(-0.95, 0.95), lens })
    }

    /// `count` cameras on a golden spiral over the sphere, or over its upper half.
    #[must_use]
    pub fn sphere(&self, count: u32, is_upper: bool) -> Vec<Camera> {
        let golden = 0.5 * (5.0_f64.sqrt() - 1.0);
        let low = if is_upper { 0.0 } else { -1.0 };
        let place = |n: u32| {
            let sine = low + (1.0 - low) * (f64::from(n) + 0.5) / f64::from(count);
            self.camera(sine, std::f64::consts::TAU * (f64::from(n) * golden).fract())
        };
        (0..count).map(place).collect()
    }

    /// `count` cameras on a level circle.
    #[must_use]
    pub fn orbit(&self, count: u32) -> Vec<Camera> {
        let place = |n: u32| self.camera(self.sine, std::f64::consts::TAU * f64::from(n) / f64::from(count));
        (0..count).map(place).collect()
    }

    fn camera(&self, sine: f64, azimuth: f64) -> Camera {
        let right = self.up.any_orthonormal_vector();
        let ahead = self.up.cross(right);
        let level = (1.0 - sine * sine).max(0.0).sqrt();
        let towards = level * (azimuth.cos() * right + azimuth.sin() * ahead) + sine * self.up;
        let eye = self.middle + self.distance * towards;
        let posed = Camera::look_at(eye, self.middle, self.up, 1.0, self.lens.resolution);
        Camera { position: posed.position, axes: posed.axes, ..self.lens }
    }
}

/// How candidates are made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Made {
    /// So many over a sphere, or over its upper half.
    Sphere {
        /// Their number.
        count: u32,
        /// Only the upper half.
        is_upper: bool,
    },
    /// So many on a level circle.
    Orbit {
        /// Their number.
        count: u32,
    },
}

impl Made {
    /// The kind, in one word.
    #[must_use]
    pub fn kind(self) -> &'static str {
        match self {
            Self::Sphere { .. } => "sphere",
            Self::Orbit { .. } => "orbit",
        }
    }

    /// The cameras that do not stand in matter of `model`, with their names, and how many do. Samples of a volume are
    /// `step` apart, or as it suggests.
    #[must_use]
    pub fn cameras(self, around: &Around, model: &dyn Model, step: Option<f64>) -> (Vec<String>, Vec<Camera>, usize) {
        let cameras = match self {
            Self::Sphere { count, is_upper } => around.sphere(count, is_upper),
            Self::Orbit { count } => around.orbit(count),
        };
        let eyes: Vec<DVec3> = cameras.iter().map(|camera| camera.position).collect();
        let is_buried = model.in_matter(step, &eyes);
        let free: Vec<Camera> =
            cameras.iter().zip(&is_buried).filter(|(_, is_buried)| !**is_buried).map(|(camera, _)| *camera).collect();
        let names = (0..free.len()).map(|k| format!("{} {k}", self.kind())).collect();
        let buried = cameras.len() - free.len();
        (names, free, buried)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use octobayes::geometry::Aabb;

    #[test]
    fn candidates_are_level_and_as_far_away_as_most_cameras_are() {
        let up = DVec3::new(0.0, -0.6, 0.8);
        let right = up.any_orthonormal_vector();
        let standing = |azimuth: f64, distance: f64| {
            let level = azimuth.cos() * right + azimuth.sin() * up.cross(right);
            let eye = distance * (0.8 * level + 0.6 * up);
            Camera::look_at(eye, DVec3::ZERO, up, 0.7, [8, 6])
        };
        // On one side, looking down; one of them far away.
        let cameras = [(0.0, 2.0), (0.4, 2.1), (0.8, 1.9), (1.2, 2.05), (1.6, 30.0)].map(|(a, d)| standing(a, d));
        let domain = Domain::Box(Aabb::centered_cube(1.0));
        let around = Around::like(&cameras, &domain, None).unwrap();
        assert!(around.up.angle_between(up).to_degrees() < 1e-6, "{around:?}");
        assert!((around.distance - 2.05).abs() < 1e-12 && (around.sine - 0.6).abs() < 1e-12, "{around:?}");
        for camera in around.orbit(7) {
            assert!((camera.position.dot(up) - 0.6 * 2.05).abs() < 1e-12, "at the height of the others");
            assert!(camera.axes.x_axis.dot(up).abs() < 1e-12 && camera.axes.y_axis.dot(up) > 0.0, "level");
        }
        assert!(around.sphere(60, true).iter().all(|camera| camera.position.dot(up) > 0.0), "the upper half");
        let other = Around::like(&cameras, &domain, Some(DVec3::new(0.0, 0.0, 3.0))).unwrap();
        assert_eq!(other.up, DVec3::Z);
        assert!(Around::like(&[], &domain, None).unwrap_err().to_string().starts_with("cameras"));
    }
}
