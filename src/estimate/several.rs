//! Fields on several grids from the same rays.

use std::time::{Duration, Instant};

use super::estimation::Goal;
use super::run::{Drawn, Run};
use super::{Estimation, FieldBuilder, GridSettings, Outcome};
use crate::rays::RunProgress;
use crate::{Error, Result};

impl Run<'_> {
    /// Draws the rays once and computes a field on each of `grids` from them, for exact comparisons between
    /// grids, levels and covariances.
    ///
    /// All fields cover the run's domain. The run's own grid determines how rays are differentiated.
    ///
    /// # Errors
    /// As [`Run::finish`], or if the run's goal is not all rays in one group, or a grid needs a plan.
    pub fn finish_on(self, grids: &[GridSettings]) -> Result<Vec<Outcome>> {
        let Estimation { goal, checkpoint, coarser_levels, .. } = &self.estimation;
        let is_limited = checkpoint.is_some() || grids.iter().any(GridSettings::needs_plan);
        if !matches!(goal, Goal::Shard { .. }) || is_limited || *coarser_levels > 0 {
            let expected = "all rays, on grids without limits, without a checkpoint or coarser levels";
            return Err(Error::setting("several grids", expected, "others"));
        }
        self.sum_on(grids)
    }

    /// Draws the rays once and sums them on each of `grids`.
    fn sum_on(mut self, grids: &[GridSettings]) -> Result<Vec<Outcome>> {
        let domain = self.estimation.domain;
        let mut builders = Vec::new();
        for grid in grids {
            let mut builder = FieldBuilder::new(*grid, domain)?;
            builder.want_density(&self.stream)?;
            builders.push((builder, Duration::ZERO));
        }
        let shard = self.estimation.own_shard();
        let progress = self.stream.run(shard, RunProgress::default(), self.estimation.monitor, |batches, _| {
            for (builder, summing) in &mut builders {
                let start = Instant::now();
                builder.add(batches);
                *summing += start.elapsed();
            }
            self.estimation.tap.as_mut().map_or(Ok(()), |tap| tap(batches))
        })?;
        let outcome =
            |(builder, summing)| self.outcome(builder, Drawn { progress, summing, octree: None }, Some(shard));
        Ok(builders.into_iter().map(outcome).collect())
    }

    /// Sums the same rays on the grid and on coarser ones.
    pub(super) fn finish_levels(self) -> Result<Outcome> {
        let own = self.estimation.grid;
        // Surfaces are those of the rays, whatever the level.
        let coarser = |below| GridSettings { level: own.level - below, surface_points: 0, ..own };
        let grids: Vec<_> = std::iter::once(own).chain((1..=self.estimation.coarser_levels).map(coarser)).collect();
        let mut outcomes = self.sum_on(&grids)?;
        let sums_bytes = outcomes.iter().map(|outcome| outcome.sums_bytes).sum();
        let summing = outcomes.iter().map(|outcome| outcome.summing).sum();
        let own = outcomes.remove(0);
        let field = own.field.with_coarser(outcomes.into_iter().map(|outcome| outcome.field).collect())?;
        Ok(Outcome { field, sums_bytes, summing, ..own })
    }
}
