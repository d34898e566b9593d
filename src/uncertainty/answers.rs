//! What a field answers at points, wherever it is stored.

use std::borrow::Cow;

use glam::Vec3;

use super::observability::at_shares;
use super::{Estimate, Observability, RunRecord, Summary, Support, UncertaintyField};
use crate::Result;
use crate::geometry::Lattice;
use crate::octree::CellTree;
use crate::render::{Probed, ProbedField};

/// Fewer points than this are answered one by one: sorting them and waking threads would take longer.
const MIN_SORTED_POINTS: usize = 64;

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

/// A field that can be queried at points, in memory or in files. Along rays it is probed for log10 U and for the
/// number of training rays that support it.
pub trait Answers: ProbedField {
    /// What does not depend on the place, such as the record and the box: the field, or one of its tiles.
    fn facts(&self) -> &UncertaintyField;

    /// U at scene points, in their order.
    ///
    /// # Errors
    /// If a part of the field cannot be read.
    fn estimates(&self, points: &[Vec3]) -> Result<Vec<Estimate>>;

    /// U, ray coverage and [`Observability`] at scene points, in their order.
    ///
    /// # Errors
    /// If a part of the field cannot be read.
    fn answers(&self, points: &[Vec3]) -> Result<Vec<Answer>> {
        let facts = self.facts();
        let answer = |(&x, estimate): (&Vec3, Estimate)| Answer {
            estimate,
            ray_coverage: facts.ray_coverage().map(|ray_coverage| ray_coverage.at(x).unwrap_or(0)),
            observability: facts.observability(x, estimate.uncertainty),
        };
        Ok(points.iter().zip(self.estimates(points)?).map(answer).collect())
    }

    /// Approximate number of points per efficient query; 0 if that does not matter.
    fn points_at_once(&self) -> usize {
        0
    }

    /// `[n]`: points on visible surfaces.
    ///
    /// # Errors
    /// If a part of the field cannot be read.
    fn surface(&self) -> Result<Cow<'_, [[f32; 3]]>> {
        Ok(Cow::Borrowed(self.facts().surface()))
    }

    /// The cells of its octree; `None` on a dense grid.
    ///
    /// # Errors
    /// If a part of the field cannot be read.
    fn cells(&self) -> Result<Option<Cow<'_, CellTree>>> {
        Ok(match &self.facts().support {
            Support::Dense => None,
            Support::Octree(octree) => Some(Cow::Borrowed(octree.cells())),
        })
    }

    /// Size and structure.
    ///
    /// # Errors
    /// If a part of the field cannot be read.
    fn summary(&self) -> Result<Summary> {
        Ok(self.facts().summary())
    }
}

impl<F: Answers + ?Sized> ProbedField for F {
    fn batch(&self) -> usize {
        self.points_at_once()
    }

    fn at(&self, points: &[Vec3]) -> Result<Vec<Probed>> {
        let probed = |found: Estimate| {
            let rays = if found.inside { found.rays.unwrap_or(f64::NAN) } else { 0.0 };
            Probed { value: found.uncertainty.log10(), rays }
        };
        Ok(self.estimates(points)?.into_iter().map(probed).collect())
    }
}

impl dyn Answers + '_ {
    /// Everything that the numbers depend on.
    #[must_use]
    pub fn record(&self) -> &RunRecord {
        self.facts().record()
    }

    /// Domain and finest level.
    #[must_use]
    pub fn lattice(&self) -> &Lattice {
        self.facts().lattice()
    }

    /// Whether answers may have errors of log10 U.
    #[must_use]
    pub fn has_error_bars(&self) -> bool {
        self.facts().error_bars().is_some()
    }

    /// log10 U at these shares of the points on visible surfaces, from the most certain; `None` without such points.
    ///
    /// # Errors
    /// If a part of the field cannot be read.
    pub fn surface_quantiles<const N: usize>(&self, shares: [f64; N]) -> Result<Option<[f64; N]>> {
        let points: Vec<Vec3> = self.surface()?.iter().copied().map(Vec3::from_array).collect();
        Ok(at_shares(&self.estimates(&points)?, shares))
    }
}

impl Answers for UncertaintyField {
    fn facts(&self) -> &UncertaintyField {
        self
    }

    fn estimates(&self, points: &[Vec3]) -> Result<Vec<Estimate>> {
        if points.len() < MIN_SORTED_POINTS {
            return Ok(points.iter().map(|&x| self.query(x)).collect());
        }
        Ok(self.query_all(points))
    }
}
