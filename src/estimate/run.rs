//! A prepared run, and how it draws its rays.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use glam::DVec3;

use super::checkpoint::Saver;
use super::derivatives;
use super::estimation::{Estimation, Goal, Tap};
use super::groups::{self, RayGroup};
use super::limits::{COMPARED_AT, Limits};
use super::mean_error;
use super::state;
use super::{
    Audit, FieldBuilder, GridKind, Plan, Planner, PositionCheck, Provenance, RaySettings, SamplingError, Sight,
    StepCheck, Summed,
};
use crate::geometry::{Aabb, Lattice};
use crate::octree::{Leaves, Octree};
use crate::posterior::Visits;
use crate::rays::{RayStream, RunProgress, Shard};
use crate::uncertainty::UncertaintyField;
use crate::{Error, Result};

/// The most vertices of a level relative to those of the next finer one: half, where rays are so few that they touch
/// vertices along lines. On surfaces it is a quarter, in fog an eighth.
const COARSER: f64 = 0.5;

/// A finished run.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// The result.
    pub field: UncertaintyField,
    /// Counts of the rays that were summed.
    pub progress: RunProgress,
    /// Size of the sums at the end, bytes.
    pub sums_bytes: usize,
    /// Time spent on summing rays and computing the field from the sums. The rest of the run's time is spent in
    /// the model.
    pub summing: Duration,
    /// The plan that the run ended with, if something limited it.
    pub plan: Option<Plan>,
    /// Whether the rays took more or less memory than planned, so that the run started over with another plan.
    pub is_replanned: bool,
    /// Estimated error of log10 U, if the run was to reach a mean error.
    pub sampling_error: Option<SamplingError>,
}

/// A prepared run before its first ray; see [`Estimation::prepare`].
pub struct Run<'a> {
    pub(super) estimation: Estimation<'a>,
    lattice: Lattice,
    pub(super) stream: RayStream<'a>,
    pub(super) limits: Limits,
}

/// Rays with separate sums: a whole run or one group.
struct Part<'r> {
    stream: &'r RayStream<'r>,
    shard: Shard,
    seed: u64,
    file: Option<&'r Path>,
}

/// What was drawn.
pub(super) struct Drawn {
    pub(super) progress: RunProgress,
    /// Time spent on summing.
    pub(super) summing: Duration,
    /// The octree of the field, if it was made to see whether the field fits the budget.
    pub(super) octree: Option<Octree>,
}

impl<'a> Run<'a> {
    pub(super) fn new(estimation: Estimation<'a>) -> Result<Self> {
        let Estimation { domain, rays, grid, .. } = &estimation;
        let lattice = grid.lattice(*domain)?;
        let stream = estimation.stream(rays, &lattice)?;
        let limits = Limits::within(grid.memory);
        let mut run = Self { estimation, lattice, stream, limits };
        if run.estimation.grid.needs_plan() {
            let planner = run.pilot(&run.stream)?;
            let mut plan = planner.plan()?;
            // The interrupted run's plan depends on its budget, and on what its process took beside.
            let files = run.files();
            if run.limits.budget.is_some()
                && let [Some(file)] = files.as_slice()
                && file.exists()
            {
                plan = planner.with_rays_per_vertex(state::rays_per_vertex(file)?);
            }
            run.estimation.grid.tile = planner.tile();
            (run.limits.planner, run.limits.plan) = (Some(planner), Some(plan));
        } else if run.estimation.grid.tile.is_some_and(|tile| !tile.is_cut()) {
            // Runs of different seeds are added up tile by tile, so where space is cut does not depend on the seed.
            let pixels = run.stream.with_pixels(run.stream.pixels.kind(), 0);
            match run.pilot(&pixels) {
                // Of the few rays of a pilot, too many may be at fault by chance. The tiles are equal boxes then.
                Err(Error::NonFinite { .. }) => {}
                planner => run.estimation.grid.tile = planner?.tile(),
            }
        }
        // The pilot and all that is measured see all of space; the rays of the run need only reach the tile.
        run.stream.reach = run.reach();
        Ok(run)
    }

    /// The box that every ray crosses which adds to the sums of the tile; `None` without a tile, or where rays are
    /// curved on the lattice.
    fn reach(&self) -> Option<Aabb> {
        let bounds = self.lattice.domain().bounds()?;
        // A sample adds to the corners of its leaf, and if one of them hangs, to those of the next larger leaf.
        let leaf = match self.limits.plan.as_ref().map(|plan| &plan.limits) {
            Some(limits) if !limits.is_unlimited() => 1 << (limits.finest() - limits.region_level()),
            _ => 1,
        };
        // One cell more than that, for what f32 positions are rounded.
        let beyond = f64::from(2 * leaf + 1);
        // Visits are counted in coarse cells, those that begin in the tile.
        let visited = f64::from(1_u32 << self.lattice.level().saturating_sub(Visits::LEVEL));
        let (low, high) = self.estimation.grid.tile?.extent(self.lattice.level());
        let [low, high] = [low, high].map(|corner| DVec3::from(corner.map(f64::from)));
        let scene = |u: DVec3| bounds.min() + u * self.lattice.edge();
        Aabb::new(scene(low - beyond), scene(high + beyond.max(visited))).ok()
    }

    /// Box and finest level.
    #[must_use]
    pub fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// The stream of rays.
    #[must_use]
    pub fn stream(&self) -> &RayStream<'a> {
        &self.stream
    }

    /// Maximal number of rays that the run will draw.
    #[must_use]
    pub fn rays(&self) -> u64 {
        self.estimation.own_shard().own_rays()
    }

    /// Predicts what the run will need: the plan that limits it or, if nothing does, the
    /// prediction of a pilot of 16,384 rays.
    ///
    /// # Errors
    /// As [`RayStream::run`].
    pub fn forecast(&self) -> Result<Plan> {
        let mut plan = match &self.limits.plan {
            Some(plan) => plan.clone(),
            None => self.pilot(&self.stream)?.plan()?,
        };
        // Every group has its own sums, and finishing needs one more.
        let sums = self.estimation.groups().map_or(1.0, |groups| f64::from(groups) + 1.0);
        let levels: f64 = (0..=self.estimation.coarser_levels).map(|below| COARSER.powi(below.into())).sum();
        let parts = sums * levels;
        (plan.summing, plan.spare, plan.finishing) = (parts * plan.summing, parts * plan.spare, parts * plan.finishing);
        plan.file *= levels;
        Ok(plan)
    }

    fn pilot(&self, stream: &RayStream) -> Result<Planner> {
        let Estimation { rays, grid, monitor, .. } = &self.estimation;
        Planner::new(*grid, rays, stream, self.estimation.own_shard(), self.lattice, *monitor)
    }

    /// Measures, on a few thousand rays, whether the cameras see anything of the field within its domain.
    ///
    /// # Errors
    /// [`Error::Interrupted`] only.
    pub fn sight(&self) -> Result<Sight> {
        Sight::measure(&self.stream, &self.estimation.domain, self.estimation.monitor)
    }

    /// Checks the finite-difference step; `None` if the field's own derivatives are used, or if there is nothing
    /// to see.
    ///
    /// # Errors
    /// [`Error::Interrupted`] only.
    pub fn check_step(&self) -> Result<Option<StepCheck>> {
        StepCheck::measure(&self.stream, &self.lattice, self.estimation.grid.tolerance, self.estimation.monitor)
    }

    /// Checks whether f32 holds positions finely enough.
    ///
    /// # Errors
    /// [`Error::Interrupted`] only.
    pub fn check_positions(&self) -> Result<PositionCheck> {
        PositionCheck::measure(&self.stream, &self.lattice, self.estimation.grid.tolerance, self.estimation.monitor)
    }

    /// The time of a few rays with the field's own derivatives, relative to that with the run's differences; `None` if
    /// the run does not use differences, the field has no derivatives, or too many rays meet values that are not
    /// finite.
    ///
    /// # Errors
    /// [`Error::Interrupted`] only.
    pub fn time_with_own_derivatives(&self) -> Result<Option<f64>> {
        derivatives::measure(&self.stream, self.rays(), self.estimation.monitor)
    }

    /// Measures the cost of the run's approximations on a few of its own rays.
    ///
    /// # Errors
    /// As [`RayStream::run`].
    pub fn audit(&self) -> Result<Audit> {
        Audit::measure(&self.estimation, &self.stream, &self.lattice)
    }

    /// Draws the rays and computes the field.
    ///
    /// Ctrl-C (through the monitor) leaves a checkpoint behind, if the run has one. So does a finished run, until
    /// the result is saved and [`Checkpoint::remove`](super::Checkpoint::remove) is called.
    ///
    /// # Errors
    /// If the field is not finite on too many rays, the memory budget does not hold the coarsest leaves, a
    /// checkpoint cannot be read or written, a [tap](Estimation::tap) fails, or the work was interrupted.
    pub fn finish(self) -> Result<Outcome> {
        match self.estimation.goal {
            Goal::Shard { .. } if self.estimation.coarser_levels > 0 => self.finish_levels(),
            Goal::Shard { .. } => self.finish_shard(),
            Goal::Groups(groups) => self.finish_groups(groups),
            Goal::MeanError(decades) => self.finish_mean_error(decades),
        }
    }

    fn finish_shard(mut self) -> Result<Outcome> {
        let (shard, seed) = (self.estimation.own_shard(), self.estimation.rays.seed);
        let mut builder = self.builder()?;
        builder.want_density(&self.stream)?;
        let files = self.files();
        let part = Part { stream: &self.stream, shard, seed, file: files[0].as_deref() };
        let drawn = draw(&mut self.estimation, &mut self.limits, &part, &mut builder)?;
        Ok(self.outcome(builder, drawn, Some(shard)))
    }

    fn finish_groups(mut self, count: u16) -> Result<Outcome> {
        let files = self.files();
        let (mut builders, mut progress, mut summing) = (Vec::new(), Vec::new(), Duration::ZERO);
        let groups = groups::ray_groups(&self.stream, count, self.estimation.rays.rays)?;
        for (group, file) in groups.iter().zip(&files) {
            let mut builder = self.builder()?;
            let part = Part { stream: &group.stream, shard: group.shard, seed: group.seed, file: file.as_deref() };
            let drawn = draw(&mut self.estimation, &mut self.limits, &part, &mut builder)?;
            progress.push(drawn.progress);
            summing += drawn.summing;
            builders.push(builder);
        }
        let sums_bytes = builders.iter().map(FieldBuilder::memory).sum();
        let whole = progress.iter().copied().sum();
        let start = Instant::now();
        let field = FieldBuilder::finish_groups(builders, &progress, &self.provenance(whole, None))?;
        let field = field.with_draws(groups.iter().map(RayGroup::draw).collect());
        let summing = summing + start.elapsed();
        Ok(Outcome { sums_bytes, ..self.outcome_of(field, whole, summing) })
    }

    fn finish_mean_error(self, decades: f64) -> Result<Outcome> {
        let Estimation { grid, domain, rays, monitor, .. } = &self.estimation;
        let start = Instant::now();
        let (halves, error) = mean_error::draw(&self.stream, *grid, *domain, decades, rays.rays, *monitor)?;
        let progress = halves.iter().map(|half| half.1).sum();
        let sums_bytes = halves.iter().map(|half| half.0.memory()).sum();
        let draws = mean_error::draws(&self.stream, &halves);
        let [(mut whole, _), (other, _)] = halves;
        whole += &other;
        whole.want_density(&self.stream)?;
        // Two sequences of pixels do not form a shard that others could be added to.
        let outcome = self.outcome(whole, Drawn { progress, summing: start.elapsed(), octree: None }, None);
        let field = outcome.field.with_draws(draws);
        Ok(Outcome { field, sums_bytes, sampling_error: Some(error), ..outcome })
    }

    /// Creates a builder on the plan's leaves.
    fn builder(&self) -> Result<FieldBuilder> {
        let mut builder = FieldBuilder::new(self.estimation.grid, self.estimation.domain)?;
        if let Some(plan) = &self.limits.plan {
            builder.limit(plan);
        }
        Ok(builder)
    }

    /// The checkpoint's files, one for each group; `[None]` without a checkpoint.
    fn files(&self) -> Vec<Option<PathBuf>> {
        let groups = self.estimation.groups();
        match &self.estimation.checkpoint {
            Some(checkpoint) => checkpoint.files(groups).into_iter().map(Some).collect(),
            None => vec![None; usize::from(groups.unwrap_or(1))],
        }
    }

    fn provenance(&self, progress: RunProgress, shard: Option<Shard>) -> Provenance<'_> {
        Provenance { source: self.estimation.source.clone(), progress, shard, stream: Some(&self.stream) }
    }

    pub(super) fn outcome(&self, builder: FieldBuilder, drawn: Drawn, shard: Option<Shard>) -> Outcome {
        let Drawn { progress, summing, octree } = drawn;
        let sums_bytes = builder.memory();
        let start = Instant::now();
        let field = builder.finish_on(octree, &self.provenance(progress, shard));
        Outcome { sums_bytes, ..self.outcome_of(field, progress, summing + start.elapsed()) }
    }

    fn outcome_of(&self, field: UncertaintyField, progress: RunProgress, summing: Duration) -> Outcome {
        let field = self.estimation.model.iter().fold(field, |field, &checksum| field.with_model(checksum));
        let plan = self.limits.plan.clone().filter(|_| self.estimation.grid.grid == GridKind::Octree);
        Outcome {
            field,
            progress,
            sums_bytes: 0,
            summing,
            plan,
            is_replanned: self.limits.is_replanned,
            sampling_error: None,
        }
    }
}

/// Draws the rays of `part` into `builder`, starting after its checkpoint.
///
/// If the budget is exhausted in spite of the plan, or would be by the field, or if the first rays show that much of it
/// would remain unused, the part starts over with a better plan. The outcome is that of a run with this plan from the
/// start.
fn draw(estimation: &mut Estimation, limits: &mut Limits, part: &Part, builder: &mut FieldBuilder) -> Result<Drawn> {
    let is_group = estimation.groups().is_some();
    let key_source = estimation.key_source();
    let Estimation { rays, grid, monitor, checkpoint, tap, .. } = estimation;
    let rays = RaySettings { seed: part.seed, ..*rays };
    let key = |builder: &FieldBuilder| rays.run_key(key_source.clone(), part.shard, part.stream, grid, builder);
    let mut saver = Saver::new(checkpoint.as_ref(), part.file);
    let mut progress = saver.restore(builder, &key(builder))?;
    let mut summing = Duration::ZERO;
    let all = part.shard.own_rays() as f64;
    // The plan of a part must be that of the others, so it is not compared with the part's own sums.
    limits.is_compared |= part.shard.of > 1 || progress.rays as f64 >= COMPARED_AT * all;
    loop {
        let mut next = None;
        let mut is_over = false;
        let result = part.stream.run(part.shard, progress, *monitor, |batches, so_far| {
            let start = Instant::now();
            builder.add(batches);
            summing += start.elapsed();
            let (done, summed) = (so_far.rays as f64 / all, builder.summed());
            if limits.is_exceeded(summed) {
                (is_over, next) = (true, limits.coarser(done, summed));
            } else if limits.is_due(done) {
                next = limits.better(done, summed);
            }
            if is_over || next.is_some() {
                // Ends the stream; these two distinguish this from Ctrl-C.
                return Err(Error::Interrupted);
            }
            progress = *so_far;
            saver.save_if_due(builder, || key(builder), progress)?;
            tap.as_mut().map_or(Ok(()), |tap: &mut Tap| tap(batches))
        });
        let mut made = None;
        if let Ok(progress) = result
            && limits.budget.is_some()
        {
            // How many vertices there will be is a rougher forecast than what sums take.
            let (shard, stream) = (Some(part.shard), Some(part.stream));
            made = builder.octree(&Provenance { source: String::new(), progress, shard, stream });
            let vertices = made.as_ref().map(Octree::vertex_count);
            let summed = Summed { vertices, ..builder.summed() };
            if limits.is_exceeded(summed) {
                (is_over, next) = (true, limits.coarser(1.0, summed));
            }
        }
        if !is_over && next.is_none() {
            // A completed group is not drawn again if a later one is interrupted.
            if matches!(result, Err(Error::Interrupted)) || is_group && result.is_ok() {
                saver.save(builder, || key(builder), progress)?;
            }
            return result.map(|progress| Drawn { progress, summing, octree: made });
        }
        let Some(next) = next else {
            let found = format!("{} MB, used up on the coarsest leaves", limits.budget.unwrap_or(0) / 1_000_000);
            return Err(Error::setting("memory budget", "room for the field, or a lower level or fewer rays", found));
        };
        builder.limit(&next);
        (limits.plan, limits.is_replanned, progress) = (Some(next), true, RunProgress::default());
    }
}
