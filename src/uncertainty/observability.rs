//! Constrained, free or never seen: U alone does not distinguish the last two.

use glam::Vec3;

use super::{Estimate, MOVED, UncertaintyField};
use crate::metrics::quantile;

/// Larger than any difference of log10 U that rounding to f32 causes.
const ROUNDING: f64 = 1e-6;

/// Whether training rays constrain a point, crossed it, or never reached it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Observability {
    /// Moving it changes some training pixel: there is as much information as lowers log10 U by [`MOVED`] below the
    /// prior's on the paper's scale with the default λ.
    Constrained,
    /// Rays passed and met nothing that a pixel would miss: visible free space.
    Free,
    /// No ray came here with half of its light.
    Unseen,
}

impl Observability {
    /// The name in tables and files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Constrained => "constrained",
            Self::Free => "free",
            Self::Unseen => "unseen",
        }
    }
}

impl UncertaintyField {
    /// log10 U at these shares of the field's points on visible surfaces, from the most certain; `None` without such
    /// points.
    #[must_use]
    pub fn surface_quantiles<const N: usize>(&self, shares: [f64; N]) -> Option<[f64; N]> {
        let points: Vec<Vec3> = self.surface().iter().copied().map(Vec3::from_array).collect();
        at_shares(&self.query_all(&points), shares)
    }

    /// How far log10 U lies below the prior's where there is as much information as lowers it by [`MOVED`] with the
    /// default λ: σ² falls in the ratio of 2λ to h + 2λ along an axis of information h.
    ///
    /// It is at least the tolerance, because U is not more accurate than that.
    fn margin(&self) -> f64 {
        let information = (10_f64.powf(2.0 * MOVED) - 1.0) * self.lattice.default_lambda();
        let margin = 0.5 * (1.0 + information / self.record.lambda).log10();
        margin.max(self.record.tolerance.clamp(ROUNDING, MOVED))
    }

    /// Whether a scene point with this U (`uncertainty`) is constrained, free or unseen; `None` if the field has no
    /// ray coverage.
    ///
    /// Outside the domain nothing was seen. Splats that no ray reached with half of its light are unseen, whatever
    /// their U: a pixel shows a little of those behind others, which lowers U and is no look at them.
    #[must_use]
    pub fn observability(&self, x: Vec3, uncertainty: f64) -> Option<Observability> {
        let ray_coverage = self.ray_coverage()?;
        let is_reached = ray_coverage.cell(x).is_some_and(|cell| ray_coverage.is_reached(cell));
        let is_constrained = uncertainty < self.prior() * 10_f64.powf(-self.margin());
        Some(match (is_reached, is_constrained) {
            (false, false) => Observability::Unseen,
            (false, true) if self.record.is_of_splats() => Observability::Unseen,
            (_, true) => Observability::Constrained,
            (true, false) => Observability::Free,
        })
    }
}

/// log10 U at these shares of estimates, from the most certain; `None` without any.
pub(super) fn at_shares<const N: usize>(estimates: &[Estimate], shares: [f64; N]) -> Option<[f64; N]> {
    let mut log10: Vec<f64> = estimates.iter().map(|found| found.uncertainty.log10()).collect();
    log10.sort_by(f64::total_cmp);
    (!log10.is_empty()).then(|| shares.map(|share| quantile(&log10, share)))
}
