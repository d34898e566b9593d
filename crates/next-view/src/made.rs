//! Candidates that no file lists: around the box, looking at its middle, outside of matter.

use glam::DVec3;

use octobayes::estimate::Model;
use octobayes::geometry::{Camera, Domain, upright};
use octobayes::metrics::{median, quantile};
use octobayes::{Error, Result};

/// How far cameras may stand beyond two others, as a share of their distance.
const BEYOND: f64 = 0.3;
/// Share of distances between cameras and surfaces below which no other camera is nearer.
const NEAREST: f64 = 0.1;
/// Cosine between a view and what is up at which it is too steep to be upright.
const STEEPEST: f64 = 0.98;
/// Places that are tried for each camera that is wanted.
const TRIES: u32 = 20;

/// Cameras around the middle of a domain, with the lens of one that there is.
#[derive(Debug, Clone, PartialEq)]
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
    /// Where the cameras stand that there are.
    pub places: Vec<DVec3>,
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
        let places = cameras.iter().map(|camera| camera.position).collect();
        Ok(Self { middle, distance, up, sine: sine.clamp(-0.95, 0.95), lens, places })
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

    /// At most `count` cameras where a photographer may stand who took the others: on lines through two places of
    /// theirs, or a little before the first and behind the second. They look at points of `targets`, from
    /// no nearer than most others do.
    #[must_use]
    pub fn near(&self, count: u32, targets: &[DVec3]) -> Vec<Camera> {
        let targets = if targets.is_empty() { std::slice::from_ref(&self.middle) } else { targets };
        let pick = |share: f64, n: usize| ((share * n as f64) as usize).min(n - 1);
        // The generalized golden ratio of four dimensions, whose powers fill a cube evenly.
        let share = |n: u32, k: i32| (0.5 + f64::from(n) * 1.167_303_978_261_418_7_f64.powi(-k)).fract();
        let mut distances: Vec<f64> = (0..1000)
            .map(|n| (pick(share(n, 1), self.places.len()), pick(share(n, 2), targets.len())))
            .map(|(place, target)| self.places[place].distance(targets[target]))
            .collect();
        distances.sort_unstable_by(f64::total_cmp);
        let nearest = quantile(&distances, NEAREST);
        let camera = |n: u32| {
            let [a, b] = [1, 2].map(|k| self.places[pick(share(n, k), self.places.len())]);
            let eye = a + ((1.0 + 2.0 * BEYOND) * share(n, 3) - BEYOND) * (b - a);
            let target = targets[pick(share(n, 4), targets.len())];
            let ahead = (target - eye).try_normalize()?;
            let is_sound = eye.distance(target) >= nearest && ahead.dot(self.up).abs() < STEEPEST;
            is_sound.then(|| self.looking(eye, target))
        };
        (0..TRIES * count).filter_map(camera).take(count as usize).collect()
    }

    fn looking(&self, eye: DVec3, target: DVec3) -> Camera {
        let posed = Camera::look_at(eye, target, self.up, 1.0, self.lens.resolution);
        Camera { position: posed.position, axes: posed.axes, ..self.lens }
    }

    fn camera(&self, sine: f64, azimuth: f64) -> Camera {
        let right = self.up.any_orthonormal_vector();
        let ahead = self.up.cross(right);
        let level = (1.0 - sine * sine).max(0.0).sqrt();
        let towards = level * (azimuth.cos() * right + azimuth.sin() * ahead) + sine * self.up;
        self.looking(self.middle + self.distance * towards, self.middle)
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
    /// So many where a photographer may stand who took the others.
    Near {
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
            Self::Near { .. } => "near",
        }
    }

    /// The cameras that do not stand in matter of `model`, with their names, and how many do. Samples of a volume are
    /// `step` apart, or as it suggests. `surface` has points on surfaces, at which those that are near look.
    #[must_use]
    pub fn cameras(
        self,
        around: &Around,
        surface: &[[f32; 3]],
        model: &dyn Model,
        step: Option<f64>,
    ) -> (Vec<String>, Vec<Camera>, usize) {
        let cameras = match self {
            Self::Sphere { count, is_upper } => around.sphere(count, is_upper),
            Self::Orbit { count } => around.orbit(count),
            Self::Near { count } => {
                let targets: Vec<DVec3> = surface.iter().map(|x| DVec3::from(x.map(f64::from))).collect();
                around.near(count, &targets)
            }
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
        let targets = [DVec3::new(0.1, 0.0, 0.0), DVec3::new(0.0, 0.2, 0.1)];
        let near = around.near(50, &targets);
        assert_eq!(near.len(), 50);
        for camera in &near {
            let ahead = -camera.axes.z_axis;
            let meets = |x: &DVec3| (*x - camera.position).normalize().dot(ahead) > 1.0 - 1e-9;
            assert!(targets.iter().any(meets) && camera.axes.x_axis.dot(up).abs() < 1e-9, "level, at a target");
            assert!(targets.iter().all(|x| x.distance(camera.position) > 1.0), "not nearer than most");
        }
        assert!(near.iter().any(|camera| camera.position.distance(near[0].position) > 1.0), "at different places");
        let other = Around::like(&cameras, &domain, Some(DVec3::new(0.0, 0.0, 3.0))).unwrap();
        assert_eq!(other.up, DVec3::Z);
        assert!(Around::like(&[], &domain, None).unwrap_err().to_string().starts_with("cameras"));
    }
}
