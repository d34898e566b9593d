//! Axis-aligned boxes.

use glam::{DVec3, Vec3};

use super::Ray;
use crate::{Error, Result};

/// An axis-aligned box `[min, max]` in scene units, of positive finite size along every axis.
///
/// ```
/// use octobayes::geometry::Aabb;
/// use octobayes::glam::{DVec3, Vec3};
///
/// let cube = Aabb::new(DVec3::splat(-1.0), DVec3::splat(1.0))?;
/// assert_eq!(cube, Aabb::centered_cube(1.0));
/// assert!(cube.contains(Vec3::ZERO) && !cube.contains(Vec3::splat(1.5)));
/// assert!(Aabb::new(DVec3::ONE, DVec3::ONE).is_err(), "a box without volume is none");
/// # Ok::<(), octobayes::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Aabb {
    min: [f64; 3],
    max: [f64; 3],
}

impl Aabb {
    /// The box from `min` to `max`.
    ///
    /// # Errors
    /// If a coordinate is not finite or `min < max` fails along some axis.
    pub fn new(min: DVec3, max: DVec3) -> Result<Self> {
        if min.is_finite() && max.is_finite() && min.cmplt(max).all() && (max - min).is_finite() {
            Ok(Self { min: min.to_array(), max: max.to_array() })
        } else {
            Err(Error::setting("box", "finite min < max along x, y and z", format!("min {min}, max {max}")))
        }
    }

    /// The cube `[-half, half]³`, half edge in scene units.
    ///
    /// # Panics
    /// If `half` is not positive and finite.
    #[must_use]
    pub fn centered_cube(half: f64) -> Self {
        assert!(half > 0.0 && half.is_finite(), "half edge of a cube must be positive, got {half}");
        Self { min: [-half; 3], max: [half; 3] }
    }

    /// Lower corner.
    #[must_use]
    pub fn min(&self) -> DVec3 {
        DVec3::from_array(self.min)
    }

    /// Upper corner.
    #[must_use]
    pub fn max(&self) -> DVec3 {
        DVec3::from_array(self.max)
    }

    /// Edge lengths.
    #[must_use]
    pub fn size(&self) -> DVec3 {
        self.max() - self.min()
    }

    /// The longest of the three edges: the unit of length in which the prior is stated.
    #[must_use]
    pub fn longest_edge(&self) -> f64 {
        self.size().max_element()
    }

    /// Checks whether `x` lies in the closed box.
    #[must_use]
    pub fn contains(&self, x: Vec3) -> bool {
        let x = x.as_dvec3();
        x.cmpge(self.min()).all() && x.cmple(self.max()).all()
    }

    /// The point of the box nearest to `x`, rounded to `f32` so that it stays inside.
    #[must_use]
    #[inline]
    pub fn clamp(&self, x: Vec3) -> Vec3 {
        // Most points are inside already, and f64 holds every f32 exactly.
        if self.contains(x) {
            return x;
        }
        let mut nearest = x.as_dvec3().clamp(self.min(), self.max()).as_vec3();
        for axis in 0..3 {
            if f64::from(nearest[axis]) < self.min[axis] {
                nearest[axis] = nearest[axis].next_up();
            } else if f64::from(nearest[axis]) > self.max[axis] {
                nearest[axis] = nearest[axis].next_down();
            }
        }
        nearest
    }

    /// Ray parameters `(entry, exit)` of the part of the ray inside the box, with t ≥ 0; `None` if there is none.
    ///
    /// A ray inside a face counts as inside: slabs are closed. A ray parallel to a slab would give 0 · ∞; its
    /// origin decides instead.
    #[must_use]
    pub fn clip(&self, ray: &Ray) -> Option<(f64, f64)> {
        let (mut entry, mut exit) = (0.0_f64, f64::INFINITY);
        for axis in 0..3 {
            let (o, d) = (ray.origin[axis], ray.direction[axis]);
            if d == 0.0 {
                if o < self.min[axis] || o > self.max[axis] {
                    return None;
                }
                continue;
            }
            let (a, b) = ((self.min[axis] - o) / d, (self.max[axis] - o) / d);
            entry = entry.max(a.min(b));
            exit = exit.min(a.max(b));
        }
        (entry < exit).then_some((entry, exit))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_along_faces_and_past_corners() {
        let cube = Aabb::centered_cube(1.0);
        let along_face = Ray::new(DVec3::new(-3.0, 1.0, 0.0), DVec3::X);
        assert_eq!(cube.clip(&along_face), Some((2.0, 4.0)));
        let outside = Ray::new(DVec3::new(-3.0, 1.0 + 1e-12, 0.0), DVec3::X);
        assert_eq!(cube.clip(&outside), None);
        let from_inside = Ray::new(DVec3::ZERO, DVec3::Z);
        assert_eq!(cube.clip(&from_inside), Some((0.0, 1.0)));
        let behind = Ray::new(DVec3::new(3.0, 0.0, 0.0), DVec3::X);
        assert_eq!(cube.clip(&behind), None);
    }

    #[test]
    fn clamp_stays_inside_a_box_that_f32_cannot_represent() {
        let cube = Aabb::new(DVec3::splat(0.1), DVec3::splat(0.3)).unwrap();
        for x in [Vec3::splat(-1.0), Vec3::splat(1.0), Vec3::splat(0.2)] {
            assert!(cube.contains(cube.clamp(x)), "{x} clamps to {}", cube.clamp(x));
        }
    }

    #[test]
    fn empty_or_infinite_boxes_are_refused() {
        assert!(Aabb::new(DVec3::ZERO, DVec3::new(1.0, 0.0, 1.0)).is_err());
        assert!(Aabb::new(DVec3::ZERO, DVec3::splat(f64::INFINITY)).is_err());
        assert!(Aabb::new(DVec3::splat(f64::NAN), DVec3::ONE).is_err());
    }
}
