//! What a run will take, by its first rays: drawn for that, or the run's own.

use super::GridKind;
use super::draw::{Foreseen, Part, of_rays};
use super::estimation::{Estimation, Goal};
use super::plan::{Plan, Planner};
use super::run::{Outcome, Run, on_grid};
use crate::posterior::{DensePosterior, DiagonalSums, Entries, OctreePosterior};
use crate::rays::{RunProgress, Shard};
use crate::uncertainty::Finish;
use crate::{Error, Result};

impl Run<'_> {
    /// Foresees what the run will take, by its first rays: a sixteenth of them, or 16,384 if that is more, or as many
    /// as have sums in half of the room of a budget. Of a model whose views have to be prepared, they look through few
    /// of the cameras.
    ///
    /// # Errors
    /// As [`RayStream::run`](crate::rays::RayStream::run).
    pub fn forecast(&self) -> Result<Plan> {
        on_grid!(self, forecast_with())
    }

    fn forecast_with<P: Finish>(&self) -> Result<Plan> {
        let stream = self.stream.through_few_cameras();
        let mut planner = self.planner().through(&stream);
        let mut builder = self.builder::<P>()?;
        builder.want_density(&stream)?;
        let (shard, mut plan) = (Shard::whole(planner.first_rays()), None);
        let part = Part { stream: &stream, shard: self.settings.own_shard(), file: None };
        let drawn = stream.run(shard, RunProgress::default(), self.settings.monitor, |batches, progress| {
            builder.add(batches);
            plan = planner.watch(&mut builder, &of_rays(&part, *progress))?;
            // As after a request to stop: enough was seen.
            if plan.is_some() { Err(Error::Interrupted) } else { Ok(()) }
        });
        if plan.is_none() {
            drawn?;
        }
        Ok(plan.expect("the last of the first rays completes the plan"))
    }

    /// As [`Run::finish`]. If the run starts with its first ray and its plan is known
    /// [under way](Run::is_foreseen_under_way), `foreseen` receives that plan, and may end the run.
    ///
    /// # Errors
    /// As [`Run::finish`], or what `foreseen` returns.
    pub fn finish_foreseen(self, foreseen: Foreseen) -> Result<Outcome> {
        let is_foreseen = self.is_foreseen_under_way();
        self.finish_watched(Some(foreseen).filter(|_| is_foreseen))
    }

    /// Whether the first rays of the run stand for the others. Otherwise they all come from the first cameras, or their
    /// number is not known beforehand.
    #[must_use]
    pub fn is_foreseen_under_way(&self) -> bool {
        self.stream.source.marched().is_some() && !matches!(self.settings.goal, Goal::MeanError(_))
    }

    pub(super) fn planner(&self) -> Planner {
        let Estimation { grid, goal, picture, .. } = &self.settings;
        Planner::new(*grid, *goal, self.rays(), self.room, *picture).on_leaves(self.coarser.as_ref())
    }
}
