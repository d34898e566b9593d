//! The limits of a run's memory: its plan, and how it is revised when rays or field take more or less than planned.

use std::ops::ControlFlow;

use super::{Plan, Planner, Summed};
use crate::{Error, Result};

/// Limits to the memory of a run.
#[derive(Default)]
pub(super) struct Limits {
    pub(super) planner: Option<Planner>,
    pub(super) plan: Option<Plan>,
    /// Maximal number of bytes that the process may take: the grid's budget, unless a test sets another.
    pub(super) budget: Option<u64>,
    pub(super) is_replanned: bool,
    /// Whether the plan was compared with what the first rays took.
    pub(super) is_compared: bool,
    /// How often the budget was exceeded.
    overflows: i32,
}

/// The fraction of the rays after which a plan is compared with what they took.
pub(super) const COMPARED_AT: f64 = 1.0 / 16.0;
/// The fraction of the budget that a run without all its refinement should come to.
const WELL_USED: f64 = 0.7;
/// The fraction of the budget that a second plan aims at, so that there is no third.
const TARGET_BUDGET_SHARE: f64 = 0.9;
/// The factor by which every further plan after an exceeded budget aims lower than the one before.
const LOWER: f64 = 0.8;

impl Limits {
    /// The limits before there is a plan.
    pub(super) fn within(budget: Option<u64>) -> Self {
        Self { budget, ..Self::default() }
    }

    /// Sets a budget for sums and field, as if the process took nothing beside. The plan stays as it is.
    #[cfg(test)]
    pub fn bound_without_process(&mut self, budget: u64) {
        self.budget = Some(budget);
        self.plan.iter_mut().for_each(|plan| plan.outside = 0.0);
        self.planner.iter_mut().for_each(Planner::forget_process);
    }

    /// Replaces the plan.
    #[cfg(test)]
    pub fn set_plan(&mut self, plan: Plan) {
        self.plan = Some(plan);
    }

    /// Whether a run whose sums came to `summed` after the fraction `done` of its rays goes on, or starts over with a
    /// better plan.
    ///
    /// # Errors
    /// If the budget is exceeded, and nothing is left to give up.
    pub(super) fn verdict(&mut self, done: f64, summed: Summed) -> Result<ControlFlow<Plan>> {
        if self.is_exceeded(summed) {
            return self.coarser(done, summed).map(ControlFlow::Break).ok_or_else(|| {
                let found = format!("{} MB, used up on the coarsest leaves", self.budget.unwrap_or(0) / 1_000_000);
                Error::setting("memory budget", "room for the field, or a lower level or fewer rays", found)
            });
        }
        let is_due = self.budget.is_some() && !self.is_compared && done >= COMPARED_AT;
        let better = if is_due { self.better(done, summed) } else { None };
        Ok(better.map_or(ControlFlow::Continue(()), ControlFlow::Break))
    }

    /// Whether a run whose sums came to `summed` would exceed the budget if it were finished now.
    fn is_exceeded(&self, summed: Summed) -> bool {
        self.budget.zip(self.plan.as_ref()).is_some_and(|(budget, plan)| plan.peak_of(summed) > budget as f64)
    }

    /// A better plan, if there is one, for a run whose sums came to `summed` after the fraction `done` of its
    /// rays. Another plan is only better than one within the budget if that leaves much of it unused.
    fn better(&mut self, done: f64, summed: Summed) -> Option<Plan> {
        let (planner, plan, budget) = (self.planner.as_mut()?, self.plan.as_ref()?, self.budget? as f64);
        self.is_compared = true;
        planner.correct(plan, done, summed);
        let other = planner.within(TARGET_BUDGET_SHARE * budget)?;
        let here = planner.with_rays_per_vertex(plan.rays_per_vertex).peak();
        let is_better = here > budget || here < WELL_USED * budget && other.rays_per_vertex < plan.rays_per_vertex;
        is_better.then_some(other)
    }

    /// A coarser plan, if there is one, for a run that exceeded its budget after the fraction `done` of its rays.
    fn coarser(&mut self, done: f64, summed: Summed) -> Option<Plan> {
        let (planner, plan, budget) = (self.planner.as_mut()?, self.plan.as_ref()?, self.budget? as f64);
        // Where leaves fill up early, the sums of the first rays foretell too little: every further plan aims lower.
        self.overflows += 1;
        let aims = (self.overflows..self.overflows + 8).map(|times| TARGET_BUDGET_SHARE * LOWER.powi(times - 1));
        planner.correct(plan, done, summed);
        let is_coarser = |other: &Plan| other.rays_per_vertex > plan.rays_per_vertex && other.limits != plan.limits;
        let found = aims.filter_map(|aim| planner.within(aim * budget)).find(is_coarser);
        found.or_else(|| Some(planner.coarsest()).filter(is_coarser))
    }
}
