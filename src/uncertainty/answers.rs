//! What a field answers at points.

use glam::Vec3;

use super::{BakedField, Estimate, Observability, UncertaintyField};
use crate::render::{Probed, ProbedField};

/// The result of a query at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Answer {
    /// U and its circumstances.
    pub estimate: Estimate,
    /// Training rays that reached the space around the point with half of their light; `None` if unknown.
    pub ray_coverage: Option<u32>,
    /// Whether the point is constrained, free or unseen; `None` if unknown.
    pub observability: Option<Observability>,
}

impl UncertaintyField {
    /// U, ray coverage and [`Observability`] at scene points, in their order.
    #[must_use]
    pub fn answers(&self, points: &[Vec3]) -> Vec<Answer> {
        self.answers_with(points, self.query_all(points))
    }

    /// The same, with the estimates at these points.
    fn answers_with(&self, points: &[Vec3], estimates: Vec<Estimate>) -> Vec<Answer> {
        let answer = |(&x, estimate): (&Vec3, Estimate)| Answer {
            estimate,
            ray_coverage: self.ray_coverage().map(|ray_coverage| ray_coverage.at(x).unwrap_or(0)),
            observability: self.observability(x, estimate.uncertainty),
        };
        points.iter().zip(estimates).map(answer).collect()
    }
}

impl BakedField<'_> {
    /// U, ray coverage and [`Observability`] at scene points, in their order.
    #[must_use]
    pub fn answers(&self, points: &[Vec3]) -> Vec<Answer> {
        self.field().answers_with(points, self.query_all(points))
    }
}

/// log10 U and the number of training rays that support it.
fn probed(estimates: Vec<Estimate>) -> Vec<Probed> {
    let probed = |found: Estimate| {
        let rays = if found.inside { found.rays.unwrap_or(f64::NAN) } else { 0.0 };
        Probed { value: found.uncertainty.log10(), rays }
    };
    estimates.into_iter().map(probed).collect()
}

impl ProbedField for UncertaintyField {
    fn at(&self, points: &[Vec3]) -> Vec<Probed> {
        probed(self.query_all(points))
    }
}

impl ProbedField for BakedField<'_> {
    fn at(&self, points: &[Vec3]) -> Vec<Probed> {
        probed(self.query_all(points))
    }
}
