//! From a field and its training cameras to its uncertainty, in one call.
//!
//! [`RaySettings`] say which rays are drawn and how they are differentiated, [`GridSettings`] what their information is gathered
//! on. [`estimate`] joins the two; [`FieldBuilder`] is the second half alone, for samples that come from elsewhere.

mod audit;
mod auto;
mod builder;
mod grid;
mod groups;
mod plan;
mod rays;
mod run;
mod sight;
mod step;

pub use audit::Audit;
pub use auto::{AutoRun, SamplingError};
pub use builder::{FieldBuilder, Provenance};
pub use grid::{GridKind, GridSettings};
pub use groups::{RayGroup, ray_groups};
pub use plan::{Plan, Planner};
pub use rays::RaySettings;
pub use run::PlannedRun;
pub use sight::{Framing, Sight};
pub use step::StepCheck;

use crate::field::RadianceField;
use crate::geometry::{Camera, Domain};
use crate::monitor::Monitor;
use crate::rays::{RunProgress, Shard};
use crate::uncertainty::UncertaintyField;
use crate::{Error, Result};

/// The uncertainty of `field` as seen by its training `cameras`, over the field's own box.
///
/// # Errors
/// If a setting is out of range, there is no camera, the field is not finite on too many rays, or the work was interrupted.
pub fn estimate(
    field: &dyn RadianceField,
    cameras: &[Camera],
    rays: &RaySettings,
    grid: &GridSettings,
    monitor: &dyn Monitor,
) -> Result<(UncertaintyField, RunProgress)> {
    if cameras.is_empty() {
        return Err(Error::setting("cameras", "at least one", "none"));
    }
    let mut builder = FieldBuilder::new(*grid, Domain::Box(field.bounds()))?;
    let lattice = *builder.lattice();
    let stream = rays.stream(field, cameras, grid, &lattice, monitor)?;
    let share = Shard::whole(rays.rays);
    let planner =
        if grid.needs_plan() { Some(Planner::new(*grid, rays, &stream, share, lattice, monitor)?) } else { None };
    let plan = planner.as_ref().map(|planner| planner.plan(&lattice)).transpose()?;
    if let Some(plan) = &plan {
        builder.limit(plan);
    }
    builder.want_density(&stream)?;
    let run = PlannedRun { stream: &stream, share, planner: planner.as_ref(), memory: grid.memory };
    let (tally, _) = run.run(&mut builder, RunProgress::default(), plan, monitor, |_, _, _| Ok(()))?;
    let provenance = Provenance { source: field.describe(), tally, share: Some(share), stream: Some(&stream) };
    Ok((builder.finish(&provenance), tally))
}

/// As [`estimate`], from rays in `groups` independent groups, with error bars: how far log10 U is from its limit.
///
/// # Errors
/// As [`estimate`], or if there are fewer than two groups or fewer rays than groups, or a budget of memory, which is for one set of sums.
pub fn estimate_with_error_bars(
    field: &dyn RadianceField,
    cameras: &[Camera],
    rays: &RaySettings,
    grid: &GridSettings,
    groups: u16,
    monitor: &dyn Monitor,
) -> Result<(UncertaintyField, RunProgress)> {
    if cameras.is_empty() {
        return Err(Error::setting("cameras", "at least one", "none"));
    }
    if grid.needs_plan() {
        return Err(Error::setting(
            "error bars",
            "a grid without limits to its refinement",
            "--memory or --refine ray-count",
        ));
    }
    let domain = Domain::Box(field.bounds());
    let lattice = grid.lattice(domain)?;
    let stream = rays.stream(field, cameras, grid, &lattice, monitor)?;
    let (mut builders, mut tallies) = (Vec::new(), Vec::new());
    let groups = ray_groups(&stream, groups, rays.rays)?;
    for group in &groups {
        let mut builder = FieldBuilder::new(*grid, domain)?;
        tallies.push(group.stream.run(group.share, RunProgress::default(), monitor, |batches, _| {
            builder.add(batches);
            Ok(())
        })?);
        builders.push(builder);
    }
    let tally = tallies.iter().fold(RunProgress::default(), |sum, tally| sum.with(tally));
    let provenance = Provenance { source: field.describe(), tally, share: None, stream: Some(&stream) };
    let field = FieldBuilder::finish_groups(builders, &tallies, &provenance)?;
    Ok((field.with_draws(groups.iter().map(RayGroup::draw).collect()), tally))
}

#[cfg(test)]
mod tests;
