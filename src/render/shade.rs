//! Colours of the samples that make up a pixel.

use glam::Vec3;

use super::trace::TracedRays;
use super::{CompositingWeights, Tracer};
use crate::field::Radiance;
use crate::geometry::Ray;

impl Tracer<'_> {
    /// Colours of all samples of `traced`, `[n]`.
    ///
    /// The field's colour where a sample's share of its pixel exceeds the marcher's cutoff, black elsewhere. NaN
    /// where the field's colour is not finite.
    #[must_use]
    #[doc(hidden)]
    pub fn visible_colors(&self, rays: &[Ray], traced: &TracedRays, quadrature: &CompositingWeights) -> Vec<Vec3> {
        let (mut which, mut positions, mut directions) = (Vec::new(), Vec::new(), Vec::new());
        for (r, ray) in rays.iter().enumerate() {
            for i in traced.samples(r).filter(|&i| quadrature.weights[i] > self.marcher.cutoff) {
                which.push(i);
                positions.push(traced.positions[i]);
                directions.push(ray.direction.as_vec3());
            }
        }
        let mut radiance = vec![Radiance::default(); which.len()];
        self.field.evaluate(&positions, &directions, &mut radiance);
        let mut colors = vec![Vec3::ZERO; traced.positions.len()];
        for (i, radiance) in which.into_iter().zip(radiance) {
            colors[i] = if radiance.color.is_finite() { radiance.color } else { Vec3::NAN };
        }
        colors
    }
}
