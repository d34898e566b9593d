//! Draws the rays of a run, or of one group of it, and saves their sums at intervals.

use std::path::Path;
use std::time::{Duration, Instant};

use super::FieldSource;
use super::builder::Builder;
use super::checkpoint::Saver;
use super::estimation::Estimation;
use super::plan::{Plan, Planner};
use crate::rays::{End, RayStream, RunProgress, Shard};
use crate::uncertainty::Finish;
use crate::{Error, Result};

/// Rays with separate sums: a whole run or one group.
pub(super) struct Part<'r> {
    pub stream: &'r RayStream<'r>,
    pub shard: Shard,
    pub file: Option<&'r Path>,
}

/// Receives the plan of a run. Its error ends the run.
pub type Foreseen<'f> = &'f mut dyn FnMut(&Plan) -> Result<()>;

/// What was drawn.
pub(super) struct Drawn {
    pub progress: RunProgress,
    /// Time spent on summing.
    pub summing: Duration,
}

/// Draws the rays of `part` into `builder`, starting after its checkpoint. If that is before the first ray, the planner
/// of `watch` looks at the first rays.
pub(super) fn draw(
    settings: &mut Estimation,
    part: &Part,
    builder: &mut Builder<impl Finish>,
    watch: Option<(Planner, Foreseen)>,
) -> Result<Drawn> {
    let Part { stream, shard, file } = *part;
    let (is_group, source) = (settings.goal.groups().is_some(), settings.key_source());
    let Estimation { rays, monitor, checkpoint, tap, .. } = settings;
    let key = |builder: &Builder<_>| builder.run_key(source.clone(), shard, stream, rays.occupancy);
    let mut saver = Saver::new(checkpoint.as_ref(), file);
    let from = saver.restore(builder, &key(builder))?;
    let mut summing = Duration::ZERO;
    let mut watch = watch.filter(|_| from.rays == 0);
    let end = stream.run_until(shard, from, *monitor, |batches, progress| {
        let start = Instant::now();
        let has_spilled = builder.add_within_budget(batches)?;
        summing += start.elapsed();
        if let Some((planner, foreseen)) = &mut watch
            && let Some(plan) = planner.watch(builder, &of_rays(part, *progress))?
        {
            foreseen(&plan)?;
        }
        if has_spilled {
            // What is saved now is small, and a resumed run need not write the run of sums again.
            saver.save(builder, || key(builder), *progress)?;
        } else {
            saver.save_if_due(builder, || key(builder), *progress)?;
        }
        tap.as_mut().map_or(Ok(()), |tap| tap(batches))
    })?;
    match end {
        End::Stopped(progress) => {
            saver.save(builder, || key(builder), progress)?;
            Err(Error::Interrupted)
        }
        End::Complete(progress) => {
            // A completed group is not drawn again if a later one is interrupted.
            if is_group {
                builder.spill_to_one()?;
                saver.save(builder, || key(builder), progress)?;
            }
            Ok(Drawn { progress, summing })
        }
    }
}

/// The source of the first rays of a part.
pub(super) fn of_rays<'r>(part: &Part<'r>, progress: RunProgress) -> FieldSource<'r> {
    FieldSource { progress, shard: Some(part.shard), stream: Some(part.stream), ..FieldSource::default() }
}
