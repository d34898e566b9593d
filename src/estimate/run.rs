//! Drawing the rays of a run into a builder, within a budget of memory.

use super::{FieldBuilder, Plan, Planner};
use crate::monitor::Monitor;
use crate::rays::{RayStream, RunProgress, Shard};
use crate::render::RaySamples;
use crate::{Error, Result};

/// A planned run.
pub struct PlannedRun<'a> {
    /// The rays.
    pub stream: &'a RayStream<'a>,
    /// Which of them.
    pub share: Shard,
    /// Where plans come from; `None` if nothing limits the run.
    pub planner: Option<&'a Planner>,
    /// Most bytes for sums and field.
    pub memory: Option<u64>,
}

impl PlannedRun<'_> {
    /// Draws the rays behind `from` into `builder`; `sink` sees every group of batches after the builder has,
    /// with the tally that includes it. If the budget is used up in
    /// spite of the plan, the next tighter plan is made and the run starts again from its first ray (`sink`
    /// is told by an empty group and tally), so that the outcome is that of a run which had been planned so. Returns the last plan too.
    ///
    /// # Errors
    /// As [`RayStream::run`], what `sink` returns, or if no tighter plan is left.
    pub fn run(
        &self,
        builder: &mut FieldBuilder,
        from: RunProgress,
        mut plan: Option<Plan>,
        monitor: &dyn Monitor,
        mut sink: impl FnMut(&FieldBuilder, &[RaySamples], &RunProgress) -> Result<()>,
    ) -> Result<(RunProgress, Option<Plan>)> {
        let mut from = from;
        loop {
            let mut over = false;
            let result = self.stream.run(self.share, from, monitor, |batches, tally| {
                builder.add(batches);
                over = self.memory.is_some_and(|budget| builder.expected_peak() > budget);
                // Ends the stream; told from Ctrl-C by `over`.
                if over { Err(Error::Interrupted) } else { sink(builder, batches, tally) }
            });
            if !over {
                return Ok((result?, plan));
            }
            let lattice = *builder.lattice();
            let tighter = plan.as_ref().zip(self.planner).and_then(|(plan, planner)| planner.tighter(&lattice, plan));
            let Some(tighter) = tighter else {
                let found = format!("{} MB, used up on the coarsest leaves", self.memory.unwrap_or(0) / 1_000_000);
                return Err(Error::setting(
                    "--memory",
                    "room for the field, or a lower --level or fewer --rays",
                    found,
                ));
            };
            builder.limit(&tighter);
            plan = Some(tighter);
            from = RunProgress::default();
            // What the sink remembers of the rays so far is void: an interrupt may come before the next batch.
            sink(builder, &[], &from)?;
        }
    }
}
