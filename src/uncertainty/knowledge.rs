//! Constrained, free or never seen: what U alone does not tell.

use glam::Vec3;

use super::{Estimate, MOVED, UncertaintyField};
use crate::metrics::quantile;
use crate::posterior::Visits;

/// Differences of log10 U that rounding to f32 does not make.
const ROUNDING: f64 = 1e-6;

/// What the training rays tell of a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Knowledge {
    /// Moving it changes some training pixel: there is as much information as lowers log10 U by [`MOVED`] below the
    /// prior's on the paper's scale with the default λ.
    Constrained,
    /// Rays passed and met nothing that a pixel would miss: visible free space.
    Free,
    /// No ray came here with half of its light.
    Unseen,
}

impl Knowledge {
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
    /// The same field with the rays that reached each part of space.
    ///
    /// They are kept as finely as the number of rays allows ([`Visits::level_of`]), and as finely as can be in a part
    /// of a run.
    #[must_use]
    pub fn with_visits(self, visits: Option<Visits>) -> Self {
        let level = if self.is_to_be_merged() { Visits::LEVEL } else { Visits::level_of(self.protocol.rays) };
        Self { visits: visits.map(|visits| visits.coarsened(level)), ..self }
    }

    /// Rays that reached each part of space; `None` if unknown.
    #[must_use]
    pub fn visits(&self) -> Option<&Visits> {
        self.visits.as_ref()
    }

    /// log10 U at these shares of the field's points on visible surfaces, from the most certain; `None` without such
    /// points.
    #[must_use]
    pub fn surface_quantiles<const N: usize>(&self, shares: [f64; N]) -> Option<[f64; N]> {
        let points: Vec<Vec3> = self.surface.iter().copied().map(Vec3::from_array).collect();
        at_shares(&self.query_all(&points), shares)
    }

    /// How far log10 U lies below the prior's where there is as much information as lowers it by [`MOVED`] with the
    /// default λ: σ² falls in the ratio of 2λ to h + 2λ along an axis of information h.
    ///
    /// It is not below the tolerance, to which U is known at most.
    fn margin(&self) -> f64 {
        let information = (10_f64.powf(2.0 * MOVED) - 1.0) * self.lattice.default_lambda();
        let margin = 0.5 * (1.0 + information / self.protocol.lambda).log10();
        margin.max(self.protocol.tolerance.clamp(ROUNDING, MOVED))
    }

    /// What the training rays tell of a scene point where U is `uncertainty`; `None` if it is not known where they
    /// passed.
    ///
    /// Outside the domain nothing was seen.
    #[must_use]
    pub fn knowledge(&self, x: Vec3, uncertainty: f64) -> Option<Knowledge> {
        let visits = self.visits.as_ref()?.at(x).unwrap_or(0);
        Some(if uncertainty < self.prior() * 10_f64.powf(-self.margin()) {
            Knowledge::Constrained
        } else if visits > 0 {
            Knowledge::Free
        } else {
            Knowledge::Unseen
        })
    }
}

/// log10 U at these shares of estimates, from the most certain; `None` without any.
pub(super) fn at_shares<const N: usize>(estimates: &[Estimate], shares: [f64; N]) -> Option<[f64; N]> {
    let mut log10: Vec<f64> = estimates.iter().map(|found| found.uncertainty.log10()).collect();
    log10.sort_by(f64::total_cmp);
    (!log10.is_empty()).then(|| shares.map(|share| quantile(&log10, share)))
}
