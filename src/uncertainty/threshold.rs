//! Clean-up: removes the density that is too uncertain from a field (the paper, Sec. 5.2).

use glam::Vec3;

use super::UncertaintyField;
use crate::field::{Radiance, RadianceField};
use crate::geometry::Aabb;

/// A radiance field whose density is zero wherever log10 U exceeds a threshold.
pub struct ThresholdedField<'a> {
    /// The field to clean.
    pub field: &'a dyn RadianceField,
    /// Its uncertainty.
    pub uncertainty: &'a UncertaintyField,
    /// Largest log10 U that is kept.
    pub threshold: f64,
}

impl ThresholdedField<'_> {
    fn keeps(&self, x: Vec3) -> bool {
        self.uncertainty.log10(x) <= self.threshold
    }
}

impl RadianceField for ThresholdedField<'_> {
    fn bounds(&self) -> Aabb {
        self.field.bounds()
    }

    fn evaluate(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [Radiance]) {
        self.field.evaluate(positions, directions, out);
        for (out, &x) in out.iter_mut().zip(positions).filter(|(out, _)| out.density > 0.0) {
            if !self.keeps(x) {
                out.density = 0.0;
            }
        }
    }

    fn densities(&self, positions: &[Vec3], out: &mut [f32]) {
        self.field.densities(positions, out);
        for (out, &x) in out.iter_mut().zip(positions).filter(|(out, _)| **out > 0.0) {
            if !self.keeps(x) {
                *out = 0.0;
            }
        }
    }

    fn density_bound(&self, min: Vec3, max: Vec3) -> Option<f32> {
        self.field.density_bound(min, max)
    }

    fn suggested_step(&self) -> f64 {
        self.field.suggested_step()
    }

    fn pixel_offset(&self) -> f64 {
        self.field.pixel_offset()
    }

    fn batch(&self) -> usize {
        self.field.batch()
    }

    fn memory(&self) -> usize {
        self.field.memory()
    }

    fn describe(&self) -> String {
        format!("{}, cleaned at log10 U <= {}", self.field.describe(), self.threshold)
    }
}
