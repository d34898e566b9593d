//! What a field answers at points, wherever it is stored.

use glam::Vec3;

use super::{Estimate, Knowledge, Protocol, UncertaintyField};
use crate::Result;

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

/// A field that answers at points.
pub trait Answers {
    /// Everything that the numbers depend on.
    fn protocol(&self) -> &Protocol;

    /// Whether answers may have errors of log10 U.
    fn has_error_bars(&self) -> bool;

    /// The answers at scene points, in their order.
    ///
    /// # Errors
    /// If a part of the field has to be read first, and cannot be.
    fn answers(&self, points: &[Vec3]) -> Result<Vec<Answer>>;
}

impl Answers for UncertaintyField {
    fn protocol(&self) -> &Protocol {
        &self.protocol
    }

    fn has_error_bars(&self) -> bool {
        self.error_bars.is_some()
    }

    fn answers(&self, points: &[Vec3]) -> Result<Vec<Answer>> {
        let answer = |(&x, estimate): (&Vec3, Estimate)| Answer {
            estimate,
            visits: self.visits.as_ref().map(|visits| visits.at(x).unwrap_or(0)),
            knowledge: self.knowledge(x, estimate.uncertainty),
        };
        Ok(points.iter().zip(self.query_all(points)).map(answer).collect())
    }
}
