//! Sample positions along a ray.
//!
//! Samples sit at t = entry + (k + jitter) · step, k = 0, 1, …, up to the exit from the box: each stands for an interval of
//! length `step`. Cells in which no sample could matter are passed over; the others keep their places, so skipping does not
//! move samples.

use super::Occupancy;
use crate::geometry::{Aabb, Ray};

/// Where to sample rays.
#[derive(Debug, Clone)]
pub struct Marcher {
    /// Distance between samples, scene units.
    pub step: f64,
    /// Part of space that is sampled.
    pub bounds: Aabb,
    /// Density bound; `None` samples everything.
    pub occupancy: Option<Occupancy>,
    /// Cells are passed over if all of them along a ray together are certain to stay below this optical depth, and a ray
    /// ends when its transmittance is below it.
    pub cutoff: f64,
}

impl Marcher {
    /// Appends the ray's sample distances to `t`; `jitter` in `[0, 1)` shifts all of them by that share of a step.
    pub fn distances(&self, ray: &Ray, jitter: f64, t: &mut Vec<f64>) {
        let Some((entry, exit)) = self.bounds.clip(ray) else { return };
        let steps = ((exit - entry) / self.step).ceil() as u64;
        let candidates = (0..steps).map(|k| entry + (k as f64 + jitter) * self.step).take_while(|&t| t < exit);
        match &self.occupancy {
            None => t.extend(candidates),
            Some(occupancy) => {
                // Thin fog adds up: no ray through the box is longer than its diagonal.
                let least = (self.cutoff / self.bounds.size().length()) as f32;
                t.extend(candidates.filter(|&t| occupancy.majorant(ray.at(t)) > least));
            }
        }
    }

    /// The density bound at a sample, ∞ without occupancy.
    #[must_use]
    pub fn majorant(&self, x: glam::DVec3) -> f64 {
        self.occupancy.as_ref().map_or(f64::INFINITY, |o| f64::from(o.majorant(x)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::{ClosedForm, RadianceField};
    use crate::monitor::Silent;
    use glam::DVec3;

    #[test]
    fn occupancy_removes_samples_but_moves_none() {
        let field = ClosedForm::ball();
        let all = Marcher { step: 0.01, bounds: field.bounds(), occupancy: None, cutoff: 0.0 };
        let occupancy = Occupancy::build(&field, 32, 0.0, &Silent).unwrap();
        let some = Marcher { occupancy: Some(occupancy), cutoff: 1e-4, ..all.clone() };
        let ray = Ray::new(DVec3::new(-3.0, 0.1, 0.2), DVec3::new(1.0, 0.05, -0.02));
        let (mut a, mut b) = (Vec::new(), Vec::new());
        all.distances(&ray, 0.3, &mut a);
        some.distances(&ray, 0.3, &mut b);
        assert!((198..=202).contains(&a.len()) && b.len() < a.len() && b.len() > 100, "{} of {}", b.len(), a.len());
        assert!(b.iter().all(|t| a.contains(t)));
    }
}
