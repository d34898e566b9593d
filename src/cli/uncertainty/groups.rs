//! `--error-bars`: rays in independent groups, one after the other.

use super::{Args, warn_of_dropped};
use crate::cli::progress::Bars;
use crate::estimate::{FieldBuilder, GridSettings, Plan, Provenance, RayGroup, RaySettings, ray_groups};
use crate::geometry::Domain;
use crate::rays::{RayStream, RunProgress};
use crate::uncertainty::UncertaintyField;
use crate::{Error, Result};

/// A run in groups.
pub(super) struct Groups<'a> {
    pub count: u16,
    pub settings: RaySettings,
    pub stream: &'a RayStream<'a>,
    pub grid: GridSettings,
    pub domain: Domain,
    pub plan: Option<&'a Plan>,
    /// What a state to go on from must be of.
    pub identity: &'a str,
}

impl Args {
    /// Draws rays in groups; returns the field with error bars and the bytes of the groups' sums.
    pub(super) fn run_groups(&self, run: &Groups, source: &str, bars: &Bars) -> Result<(UncertaintyField, usize)> {
        let (mut builders, mut tallies) = (Vec::new(), Vec::new());
        let groups = ray_groups(run.stream, run.count, run.settings.rays)?;
        for (g, group) in (0..).zip(&groups) {
            let mut builder = FieldBuilder::new(run.grid, run.domain)?;
            if let Some(plan) = run.plan.filter(|_| run.grid.needs_plan()) {
                builder.limit(plan);
            }
            let settings = RaySettings { seed: group.seed, ..run.settings };
            let key = settings.run_key(run.identity.into(), group.share, &group.stream, &run.grid, &builder);
            let mut checkpoint = self.checkpoint(Some(g), self.resume)?;
            let mut so_far = match &checkpoint {
                Some(checkpoint) => checkpoint.restore(&mut builder, &key)?,
                None => RunProgress::default(),
            };
            let result = group.stream.run(group.share, so_far, bars, |batches, tally| {
                builder.add(batches);
                so_far = *tally;
                match checkpoint.as_mut().filter(|c| c.is_due()) {
                    Some(checkpoint) => checkpoint.save(&builder, &key, so_far),
                    None => Ok(()),
                }
            });
            if let Some(checkpoint) = &mut checkpoint {
                match &result {
                    Err(Error::Interrupted) => checkpoint.save_interrupted(&builder, &key, so_far, group.share)?,
                    // Not drawn again if a later group is interrupted.
                    Ok(tally) => checkpoint.save(&builder, &key, *tally)?,
                    Err(_) => {}
                }
            }
            tallies.push(result?);
            builders.push(builder);
        }
        let tally = tallies.iter().fold(RunProgress::default(), |sum, tally| sum.with(tally));
        warn_of_dropped(&tally);
        let bytes = builders.iter().map(FieldBuilder::memory).sum();
        let provenance = Provenance { source: source.into(), tally, share: None, stream: Some(run.stream) };
        let field = FieldBuilder::finish_groups(builders, &tallies, &provenance)?;
        Ok((field.with_draws(groups.iter().map(RayGroup::draw).collect()), bytes))
    }
}
