//! Draws the rays of a run, or of one group of it: saves their sums at intervals, and starts over where a plan fails.

use std::ops::ControlFlow;
use std::path::Path;
use std::time::{Duration, Instant};

use super::Summed;
use super::builder::{Builder, FieldSource, Finish};
use super::checkpoint::Saver;
use super::estimation::Estimation;
use super::limits::{COMPARED_AT, Limits};
use crate::rays::{End, RayStream, RunProgress, Shard};
use crate::{Error, Result};

/// Rays with separate sums: a whole run or one group.
pub(super) struct Part<'r> {
    pub stream: &'r RayStream<'r>,
    pub shard: Shard,
    pub file: Option<&'r Path>,
}

/// What was drawn.
pub(super) struct Drawn<P: Finish> {
    pub progress: RunProgress,
    /// Time spent on summing.
    pub summing: Duration,
    /// The vertices of the field, if they were found to see whether the field fits the budget.
    pub vertices: Option<P::Vertices>,
}

/// Draws the rays of `part` into `builder`, starting after its checkpoint.
///
/// If the budget is exhausted in spite of the plan, or would be by the field, or if the first rays show that much of it
/// would remain unused, the part starts over with a better plan. The outcome is that of a run with this plan from the
/// start.
pub(super) fn draw<P: Finish>(
    settings: &mut Estimation,
    limits: &mut Limits,
    part: &Part,
    builder: &mut Builder<P>,
) -> Result<Drawn<P>> {
    let Part { stream, shard, file } = *part;
    let (is_group, source) = (settings.goal.groups().is_some(), settings.key_source());
    let Estimation { rays, monitor, checkpoint, tap, .. } = settings;
    let key = |builder: &Builder<P>| builder.run_key(source.clone(), shard, stream, rays.occupancy);
    let mut saver = Saver::new(checkpoint.as_ref(), file);
    let mut from = saver.restore(builder, &key(builder))?;
    let mut summing = Duration::ZERO;
    let all = shard.own_rays() as f64;
    // The plan of a part must be that of the others, so it is not compared with the part's own sums.
    limits.is_compared |= shard.of > 1 || from.rays as f64 >= COMPARED_AT * all;
    loop {
        let end = stream.run_until(shard, from, *monitor, |batches, progress| {
            let start = Instant::now();
            builder.add(batches);
            summing += start.elapsed();
            let verdict = limits.verdict(progress.rays as f64 / all, builder.summed())?;
            if verdict.is_continue() {
                saver.save_if_due(builder, || key(builder), *progress)?;
                tap.as_mut().map_or(Ok(()), |tap| tap(batches))?;
            }
            Ok(verdict)
        })?;
        let plan = match end {
            End::Broken(plan) => plan,
            End::Stopped(progress) => {
                saver.save(builder, || key(builder), progress)?;
                return Err(Error::Interrupted);
            }
            End::Complete(progress) => {
                // How many vertices there will be is a rougher forecast than what sums take.
                let source = FieldSource { source: String::new(), progress, shard: Some(shard), stream: Some(stream) };
                let found = limits.budget.map(|_| builder.vertices(&source));
                let vertices = found.as_ref().map(|(_, count)| *count);
                match limits.verdict(1.0, Summed { vertices, ..builder.summed() })? {
                    ControlFlow::Break(plan) => plan,
                    ControlFlow::Continue(()) => {
                        // A completed group is not drawn again if a later one is interrupted.
                        if is_group {
                            saver.save(builder, || key(builder), progress)?;
                        }
                        return Ok(Drawn { progress, summing, vertices: found.map(|(vertices, _)| vertices) });
                    }
                }
            }
        };
        builder.limit(&plan);
        (limits.plan, limits.is_replanned, from) = (Some(plan), true, RunProgress::default());
    }
}
