//! Rays.

use glam::DVec3;

/// A half line `origin + t · direction`, t ≥ 0 in scene units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Start of the ray, scene units.
    pub origin: DVec3,
    /// Unit direction.
    pub direction: DVec3,
}

impl Ray {
    /// The ray from `origin` along `direction`, which is normalised here.
    ///
    /// # Panics
    /// If `direction` is zero or not finite.
    #[must_use]
    pub fn new(origin: DVec3, direction: DVec3) -> Self {
        let unit = direction.try_normalize();
        assert!(unit.is_some(), "a ray needs a direction, got {direction}");
        Self { origin, direction: unit.unwrap_or(DVec3::Z) }
    }

    /// The point at distance `t`.
    #[must_use]
    pub fn at(&self, t: f64) -> DVec3 {
        self.origin + t * self.direction
    }
}
