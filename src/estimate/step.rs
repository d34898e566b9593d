//! Whether the finite-difference step suits the field.

use glam::Vec3;

use crate::Result;
use crate::geometry::Lattice;
use crate::monitor::Monitor;
use crate::posterior::RayStream;
use crate::render::{DifferenceErrors, Differences};

/// Points on visible surfaces that are looked at.
const POINTS: usize = 256;
/// Rays that look for them: a batch.
const RAYS: u64 = 512;

/// A step, and what central differences over it and over others are off by.
#[derive(Debug, Clone, PartialEq)]
pub struct StepCheck {
    /// The run's step, lattice edges.
    pub step: f64,
    /// Errors of it and of others.
    pub errors: DifferenceErrors,
    /// Whether it is badly placed ([`DifferenceErrors::is_bad`]).
    pub is_bad: bool,
}

impl StepCheck {
    /// Looks at the surfaces that the first rays of `stream` see. `None` with derivatives of the field's own, or if there is nothing to see.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`] only.
    pub fn of(stream: &RayStream, lattice: &Lattice, tolerance: f64, monitor: &dyn Monitor) -> Result<Option<Self>> {
        if stream.differentiation.analytic.is_some() {
            return Ok(None);
        }
        let seen = stream.surface_points(usize::MAX, RAYS, monitor)?;
        let every = seen.len().div_ceil(POINTS).max(1);
        let points: Vec<Vec3> = seen.into_iter().step_by(every).map(Vec3::from_array).collect();
        let edges = Differences { step: lattice.edge(), domain: *lattice.domain() };
        let errors = DifferenceErrors::measure(stream.tracer.field, &points, &edges);
        let step = (stream.differentiation.differences.step / lattice.edge()).max_element();
        Ok(errors.map(|errors| Self { step, is_bad: errors.is_bad(step, tolerance), errors }))
    }
}
