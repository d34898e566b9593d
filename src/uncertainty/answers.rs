//! What a field answers at points, wherever it is stored.

use std::borrow::Cow;

use glam::Vec3;

use super::knowledge::at_shares;
use super::{Estimate, Knowledge, Protocol, Summary, Support, UncertaintyField};
use crate::Result;
use crate::geometry::Lattice;
use crate::octree::CellTree;
use crate::render::{Probed, ProbedField};

/// Fewer points than this are answered one by one: sorting them and waking threads would take longer.
const FEW: usize = 64;

/// All that a field knows of a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Answer {
    /// U and its circumstances.
    pub estimate: Estimate,
    /// Training rays that reached the space around the point with half of their light; `None` if unknown.
    pub visits: Option<u32>,
    /// What the training rays tell of the point; `None` if unknown.
    pub knowledge: Option<Knowledge>,
}

/// A field that answers at points. Along rays it is probed for log10 U and for the training rays behind it.
pub trait Answers: ProbedField {
    /// Everything that the numbers depend on.
    fn protocol(&self) -> &Protocol;

    /// Domain and finest level.
    fn lattice(&self) -> &Lattice;

    /// Whether answers may have errors of log10 U.
    fn has_error_bars(&self) -> bool;

    /// U at scene points, in their order.
    ///
    /// # Errors
    /// If a part of the field cannot be read.
    fn estimates(&self, points: &[Vec3]) -> Result<Vec<Estimate>>;

    /// U at scene points, in their order, and what rays tell of them.
    ///
    /// # Errors
    /// If a part of the field cannot be read.
    fn answers(&self, points: &[Vec3]) -> Result<Vec<Answer>>;

    /// `[n]`: points on visible surfaces.
    ///
    /// # Errors
    /// If a part of the field cannot be read.
    fn surface(&self) -> Result<Cow<'_, [[f32; 3]]>>;

    /// The cells of its octree; `None` on a dense grid.
    ///
    /// # Errors
    /// If a part of the field cannot be read.
    fn cells(&self) -> Result<Option<Cow<'_, CellTree>>>;

    /// Size and structure.
    ///
    /// # Errors
    /// If a part of the field cannot be read.
    fn summary(&self) -> Result<Summary>;
}

impl dyn Answers + '_ {
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
    fn protocol(&self) -> &Protocol {
        &self.protocol
    }

    fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    fn has_error_bars(&self) -> bool {
        self.error_bars.is_some()
    }

    fn estimates(&self, points: &[Vec3]) -> Result<Vec<Estimate>> {
        if points.len() < FEW {
            return Ok(points.iter().map(|&x| self.query(x)).collect());
        }
        Ok(self.query_all(points))
    }

    fn answers(&self, points: &[Vec3]) -> Result<Vec<Answer>> {
        Ok(self.answered(points, self.estimates(points)?))
    }

    fn surface(&self) -> Result<Cow<'_, [[f32; 3]]>> {
        Ok(Cow::Borrowed(&self.surface))
    }

    fn cells(&self) -> Result<Option<Cow<'_, CellTree>>> {
        Ok(match &self.support {
            Support::Dense => None,
            Support::Octree(octree) => Some(Cow::Borrowed(octree.cells())),
        })
    }

    fn summary(&self) -> Result<Summary> {
        Ok(UncertaintyField::summary(self))
    }
}

impl ProbedField for UncertaintyField {
    fn at(&self, points: &[Vec3]) -> Result<Vec<Probed>> {
        Ok(self.estimates(points)?.into_iter().map(Estimate::probed).collect())
    }

    fn over_levels(&self, points: &[Vec3], at: &[Probed]) -> Result<Vec<Probed>> {
        self.mean_over_levels(points, at)
    }
}

impl UncertaintyField {
    /// Adds to estimates at points what rays tell of them.
    pub(super) fn answered(&self, points: &[Vec3], estimates: Vec<Estimate>) -> Vec<Answer> {
        let answer = |(&x, estimate): (&Vec3, Estimate)| Answer {
            estimate,
            visits: self.visits.as_ref().map(|visits| visits.at(x).unwrap_or(0)),
            knowledge: self.knowledge(x, estimate.uncertainty),
        };
        points.iter().zip(estimates).map(answer).collect()
    }
}

impl Estimate {
    /// log10 U, and the rays that support it.
    pub(super) fn probed(self) -> Probed {
        let rays = if self.inside { self.rays.unwrap_or(f64::NAN) } else { 0.0 };
        Probed { value: self.uncertainty.log10(), rays }
    }
}
