//! How far log10 U is from its limit, by source.

use super::{Audit, GridKind, GridSettings, SamplingError, StepCheck};
use crate::rays::Pixels;
use crate::uncertainty::{ErrorSummary, Support, UncertaintyField};

/// How far log10 U is from its limit, the value for ever more rays and without approximations: by source, in decades.
/// What was not measured is `None`.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct ErrorBudget {
    /// Largest change by leaves coarser than the level. Certain; 0 on a dense grid.
    pub coarse_leaves: f64,
    /// Whether memory or the number of rays kept some leaves coarser than that, which has no bound.
    pub is_limited: bool,
    /// What the number of rays leaves open.
    pub rays: Option<RayError>,
    /// What samples that were left out and the derivatives cost.
    pub audit: Option<Audit>,
    /// Error of the finite differences, and the best step.
    pub step: Option<StepCheck>,
}

/// What the number of rays leaves open, at the vertices that moved by more than half a decade from the prior.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
#[serde(tag = "from", rename_all = "kebab-case")]
pub enum RayError {
    /// From two halves of the rays, by a run to a mean error.
    Halves(SamplingError),
    /// From groups of rays: the field's error bars.
    Groups(ErrorSummary),
    /// Nothing: a ray passed through every training pixel. What positions of samples leave open is not measured.
    EveryPixel,
}

impl ErrorBudget {
    /// The errors that a finished field stores.
    #[must_use]
    pub fn of_field(field: &UncertaintyField) -> Self {
        let coarse_leaves = match field.support() {
            Support::Octree(_) => field.record().pooling.largest_change(field.record().tolerance),
            Support::Dense => 0.0,
        };
        let every = field.record().pixels == Some(Pixels::Every) && !field.is_part();
        let rays = field.error_summary().map(RayError::Groups).or(every.then_some(RayError::EveryPixel));
        Self { coarse_leaves, is_limited: !field.limits().is_unlimited(), rays, audit: None, step: None }
    }

    /// What is known of a run before its first ray.
    #[must_use]
    pub fn of_settings(grid: &GridSettings) -> Self {
        let coarse_leaves = match grid.grid {
            GridKind::Octree => grid.pooling.largest_change(grid.tolerance),
            GridKind::Dense => 0.0,
        };
        Self { coarse_leaves, is_limited: grid.is_limited(), rays: None, audit: None, step: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::{Estimation, RaySettings};
    use crate::field::ClosedForm;
    use crate::posterior::Criterion;

    #[test]
    #[ignore = "slow: several seconds"]
    fn a_budget_holds_what_was_measured_and_nothing_else() {
        let (scene, cameras) = (ClosedForm::courtyard(), ClosedForm::half_circle(4, [32, 32]));
        let run = |grid: GridSettings| {
            let rays = RaySettings::default().rays(4_000).occupancy(32);
            Estimation::new(&scene, &cameras).rays(rays).grid(grid.level(5))
        };
        let octree = GridSettings::default();
        let plain = run(octree).run().unwrap().errors;
        assert_eq!((plain.coarse_leaves, plain.is_limited, plain.rays), (0.01, false, None));
        let dense = run(octree.grid(GridKind::Dense)).error_bars(3).run().unwrap();
        assert_eq!(dense.errors.coarse_leaves, 0.0);
        assert_eq!(dense.errors.rays, dense.field.error_summary().map(RayError::Groups));
        let limited = run(octree.criteria([Criterion::RayCount].into_iter().collect())).run().unwrap();
        assert!(limited.errors.is_limited);
        let budget = run(octree).until_mean_error(1e-9).run().unwrap().errors;
        let Some(RayError::Halves(error)) = budget.rays else { panic!("{budget:?}") };
        assert!(error.vertices > 100 && error.mean > 0.0);

        let prepared = run(octree).prepare().unwrap();
        let (audit, step) = (Some(prepared.audit().unwrap()), prepared.check_step().unwrap());
        let whole = serde_json::to_value(ErrorBudget { audit, step, ..budget }).unwrap();
        assert_eq!((&whole["rays"]["from"], &whole["coarse_leaves"]), (&"halves".into(), &0.01.into()));
        assert!(whole["audit"]["cutoff"]["mean"].is_number() && whole["step"]["is_bad"] == false, "{whole}");
    }
}
