//! A run, from its settings to a field: what is checked before its first ray, and which goal it has.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::builder::Builder;
use super::coarser::CoarserLeaves;
use super::draw::{Foreseen, Part, draw};
use super::estimation::{Estimation, Goal};
use super::mean_error;
use super::{
    Audit, CoverageCheck, ErrorBudget, FieldBuilder, FieldSource, GridKind, GridSettings, PositionCheck, RayError,
    SURFACE_POINTS, StepCheck,
};
use crate::geometry::{Lattice, kept_pixels};
use crate::io::memory::resident;
use crate::posterior::overflow::{Overflow, least_budget, room_for_sums};
use crate::posterior::{DensePosterior, DiagonalSums, Entries, OctreePosterior};
use crate::rays::{Pixels, Purpose, RayStream, RunProgress, Shard};
use crate::uncertainty::{Finish, UncertaintyField};
use crate::{Error, Result};

/// A finished run.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// The result.
    pub field: UncertaintyField,
    /// Counts of the rays that were summed.
    pub progress: RunProgress,
    /// Size of the sums in memory, bytes, when they were largest.
    pub sums_bytes: usize,
    /// Size of the sums that left memory, bytes.
    pub disk_bytes: u64,
    /// Time spent on summing rays and computing the field from the sums. The rest of the run's time is spent in
    /// the model.
    pub summing: Duration,
    /// How far log10 U is from its limit, as far as that was measured.
    pub errors: ErrorBudget,
}

/// A prepared run before its first ray; see [`Estimation::prepare`].
pub struct Run<'a> {
    pub(super) settings: Estimation<'a>,
    lattice: Lattice,
    pub(super) stream: RayStream<'a>,
    /// Bytes that sums may take in memory, if there is a budget.
    pub(super) room: Option<usize>,
    /// The leaves, if some stay coarser where rays are few.
    pub(super) coarser: Option<CoarserLeaves>,
    /// Points on visible surfaces, which the field keeps.
    surface: Vec<[f32; 3]>,
}

/// Calls a method for the kind of posterior of a run.
macro_rules! on_grid {
    ($run:expr, $method:ident($($argument:expr),*)) => {{
        let grid = &$run.settings.grid;
        match (grid.grid, grid.entries($run.settings.own_shard().of > 1)) {
            (GridKind::Dense, _) => $run.$method::<DensePosterior>($($argument),*),
            (GridKind::Octree, Entries::All) => $run.$method::<OctreePosterior>($($argument),*),
            (GridKind::Octree, Entries::Diagonal) => $run.$method::<OctreePosterior<DiagonalSums>>($($argument),*),
        }
    }};
}
pub(super) use on_grid;

/// Most rays that are traced in search of points on visible surfaces. In a sparse scene most rays miss all matter.
const MOST_SURFACE_RAYS: u64 = 1 << 16;

impl<'a> Estimation<'a> {
    /// Prepares everything that precedes the first ray: lattice, occupancy grid, and a pilot if rays limit the octree.
    ///
    /// # Errors
    /// If a setting is out of range, settings are incompatible, there is no camera, a checkpoint belongs to another
    /// run, the memory budget is too small, or the work was interrupted.
    pub fn prepare(self) -> Result<Run<'a>> {
        Run::new(self)
    }

    /// Prepares the run and finishes it.
    ///
    /// # Errors
    /// As [`Estimation::prepare`] and [`Run::finish`].
    pub fn run(self) -> Result<Outcome> {
        self.prepare()?.finish()
    }
}

impl<'a> Run<'a> {
    fn new(mut settings: Estimation<'a>) -> Result<Self> {
        if settings.rays.pixels == Pixels::Every {
            settings.rays.rays = kept_pixels(settings.cameras, settings.masks);
        }
        settings.check()?;
        let lattice = settings.grid.lattice(settings.domain)?;
        let stream = settings.stream(&settings.rays, &lattice)?;
        let room = settings.grid.memory.map(|budget| room_for_sums(budget, stream.source.memory()));
        let mut run = Self { settings, lattice, stream, room, coarser: None, surface: Vec::new() };
        run.check_budget()?;
        run.overflow(run.files()[0].as_deref()).map_or(Ok(()), |overflow| overflow.check())?;
        if run.settings.grid.is_limited() {
            let Estimation { grid, rays, monitor, .. } = &run.settings;
            run.coarser = Some(CoarserLeaves::new(grid, rays, &run.stream, lattice, *monitor)?);
        }
        Ok(run)
    }

    /// Refuses a budget that leaves too little room beside what the process already takes.
    fn check_budget(&self) -> Result<()> {
        let GridSettings { grid, memory: Some(budget), .. } = self.settings.grid else { return Ok(()) };
        let (model, taken) = (self.stream.source.memory(), resident().unwrap_or(0));
        let least = match grid {
            GridKind::Dense => {
                let sets = self.settings.goal.sets_of_sums(self.settings.grid.pooling);
                taken.saturating_add(DensePosterior::required_memory(&self.lattice).saturating_mul(sets.into()))
            }
            GridKind::Octree => least_budget(taken, model),
        };
        if budget >= least {
            return Ok(());
        }
        let expected = format!("at least {} MB", least.div_ceil(1_000_000));
        Err(Error::setting("memory budget", expected, format!("{} MB", budget / 1_000_000)))
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
        self.settings.own_shard().own_rays()
    }

    /// The folder of sums that leave memory; `None` without a budget.
    #[must_use]
    pub fn scratch(&self) -> Option<PathBuf> {
        Some(self.overflow(self.files()[0].as_deref())?.folder().to_path_buf())
    }

    /// Bytes that a budget leaves for pictures before the first ray; `None` without a budget.
    #[must_use]
    pub fn room_for_pictures(&self) -> Option<u64> {
        self.settings.grid.memory.map(|budget| budget.saturating_sub(resident().unwrap_or(0)))
    }

    /// Measures, on a few thousand rays, whether the cameras see anything of the field within its domain.
    ///
    /// # Errors
    /// [`Error::Interrupted`] only.
    pub fn sight(&self) -> Result<CoverageCheck> {
        CoverageCheck::measure(&self.stream, &self.settings.domain, self.settings.monitor)
    }

    /// Checks the finite-difference step; `None` if the field's own derivatives are used, or if there is nothing
    /// to see.
    ///
    /// # Errors
    /// [`Error::Interrupted`] only.
    pub fn check_step(&self) -> Result<Option<StepCheck>> {
        StepCheck::measure(&self.stream, &self.lattice, self.settings.grid.tolerance, self.settings.monitor)
    }

    /// Checks whether f32 holds positions finely enough.
    ///
    /// # Errors
    /// [`Error::Interrupted`] only.
    pub fn check_positions(&self) -> Result<PositionCheck> {
        PositionCheck::measure(&self.stream, &self.lattice, self.settings.grid.tolerance, self.settings.monitor)
    }

    /// Measures the cost of the run's approximations on a few of its own rays.
    ///
    /// # Errors
    /// As [`RayStream::run`].
    pub fn audit(&self) -> Result<Audit> {
        let Self { settings, stream, lattice, .. } = self;
        match settings.grid.grid {
            GridKind::Dense => Audit::measure::<DensePosterior>(settings, stream, lattice),
            GridKind::Octree => Audit::measure::<OctreePosterior>(settings, stream, lattice),
        }
    }

    /// Draws the rays and computes the field.
    ///
    /// Ctrl-C (through the monitor) leaves a checkpoint behind, if the run has one. So does a finished run, until
    /// the result is saved and [`Checkpoint::remove`](super::Checkpoint::remove) is called.
    ///
    /// # Errors
    /// If the field is not finite on too many rays, sums or a checkpoint cannot be read or written, a
    /// [tap](Estimation::tap) fails, or the work was interrupted.
    pub fn finish(self) -> Result<Outcome> {
        self.finish_watched(None)
    }

    pub(super) fn finish_watched(mut self, foreseen: Option<Foreseen>) -> Result<Outcome> {
        self.surface = self.surface_points()?;
        on_grid!(self, finish_with(foreseen))
    }

    /// Points on visible surfaces, along other rays than those that the field is computed from: U is lower where a ray
    /// of its own passes, by half a decade if rays are few. They are the same for all shards of a run.
    ///
    /// If every pixel is drawn, these are some of the same pixels. Then the rays are all that training shows, and those
    /// points are a fair sample of it.
    fn surface_points(&self) -> Result<Vec<[f32; 3]>> {
        let Estimation { rays, monitor, .. } = &self.settings;
        let (stream, lattice) = (self.stream.for_purpose(Purpose::Surface), &self.lattice);
        let is_inside = |x| lattice.coordinates(x).is_some();
        stream.surface_points_where(&is_inside, SURFACE_POINTS, rays.rays.min(MOST_SURFACE_RAYS), *monitor)
    }

    fn finish_with<P: Finish>(self, foreseen: Option<Foreseen>) -> Result<Outcome> {
        match self.settings.goal {
            Goal::Shard { .. } => self.finish_shard::<P>(foreseen),
            Goal::Groups(groups) => self.finish_groups::<P>(groups, foreseen),
            Goal::MeanError(decades) => self.finish_mean_error::<P>(decades),
        }
    }

    fn finish_shard<P: Finish>(mut self, foreseen: Option<Foreseen>) -> Result<Outcome> {
        let watch = foreseen.map(|foreseen| (self.planner().under_way(), foreseen));
        let shard = self.settings.own_shard();
        let files = self.files();
        let mut builder = self.builder::<P>()?.with_overflow(self.overflow(files[0].as_deref()));
        builder.want_density(&self.stream)?;
        let part = Part { stream: &self.stream, shard, file: files[0].as_deref() };
        let drawn = draw(&mut self.settings, &part, &mut builder, watch)?;
        let start = Instant::now();
        builder.spill_rest()?;
        let (sums_bytes, disk_bytes) = (builder.memory(), builder.disk_bytes());
        let field = builder.finish(&self.source(drawn.progress, Some(shard)))?;
        let outcome = self.outcome(field, drawn.progress, sums_bytes, drawn.summing + start.elapsed());
        Ok(Outcome { disk_bytes, ..outcome })
    }

    /// Draws `count` groups of rays, whose sizes differ by at most one, each with its own sums and its own, independent
    /// pixels.
    ///
    /// (Parts of one low-discrepancy sequence complement each other, so their differences would overstate the error.)
    /// All groups together are slightly less accurate than the same number of rays from one sequence.
    fn finish_groups<P: Finish>(mut self, count: u16, foreseen: Option<Foreseen>) -> Result<Outcome> {
        let (groups, rays) = (u64::from(count), self.settings.rays.rays);
        if groups < 2 || rays < groups {
            let expected = format!("2 to {rays}, the number of rays");
            return Err(Error::setting("groups of rays", expected, groups.to_string()));
        }
        let (mut builders, mut ray_sets) = (Vec::new(), Vec::new());
        let mut watch = foreseen.map(|foreseen| (self.planner().under_way(), foreseen));
        let (mut progress, mut summing) = (Vec::new(), Duration::ZERO);
        for (group, file) in (0..count).zip(self.files()) {
            let mut builder = self.builder::<P>()?.with_overflow(self.overflow(file.as_deref()));
            let stream = self.stream.for_purpose(Purpose::Group(group));
            let shard = Shard::whole(rays / groups + u64::from(u64::from(group) < rays % groups));
            let part = Part { stream: &stream, shard, file: file.as_deref() };
            // The first group stands for the others.
            if watch.is_some() {
                builder.want_density(&self.stream)?;
            }
            let drawn = draw(&mut self.settings, &part, &mut builder, watch.take())?;
            progress.push(drawn.progress);
            summing += drawn.summing;
            ray_sets.push(stream.ray_set(shard));
            builders.push(builder);
        }
        let disk_bytes = builders.iter().map(Builder::disk_bytes).sum();
        // Those of each group have left before the next is drawn, or stay.
        let of_groups = builders.iter().map(Builder::memory);
        let sums_bytes = if disk_bytes > 0 { of_groups.max().unwrap_or(0) } else { of_groups.sum() };
        let whole = progress.iter().copied().sum();
        let start = Instant::now();
        let field = Builder::finish_groups(builders, ray_sets, &progress, &self.source(whole, None))?;
        let outcome = self.outcome(field, whole, sums_bytes, summing + start.elapsed());
        Ok(Outcome { disk_bytes, ..outcome })
    }

    fn finish_mean_error<P: Finish>(self, decades: f64) -> Result<Outcome> {
        let Estimation { grid, domain, rays, monitor, .. } = &self.settings;
        let start = Instant::now();
        // Each half of the rays has half of the room.
        let overflow = self.overflow(None).map(Overflow::halved);
        let half = || Ok(Builder::<P>::new(*grid, *domain, None)?.with_overflow(overflow.clone()));
        let (halves, error) = mean_error::draw([half()?, half()?], &self.stream, decades, rays.rays, *monitor)?;
        let progress = halves.iter().map(|half| half.1).sum();
        let sums_bytes = halves.iter().map(|half| half.0.memory()).sum();
        let ray_sets = mean_error::ray_sets(&self.stream, &halves);
        let disk_bytes = halves.iter().map(|half| half.0.disk_bytes()).sum();
        let [(mut whole, _), (other, _)] = halves;
        whole += &other;
        whole.want_density(&self.stream)?;
        // Two sequences of pixels do not form a shard that others could be added to.
        let field = whole.finish(&self.source(progress, None))?.with_ray_sets(ray_sets);
        let outcome = self.outcome(field, progress, sums_bytes, start.elapsed());
        let errors = ErrorBudget { rays: Some(RayError::Halves(error)), ..outcome.errors };
        Ok(Outcome { errors, disk_bytes, ..outcome })
    }

    /// Draws the rays once and computes a field on each of `grids` from them, for exact comparisons between
    /// grids, levels and covariances.
    ///
    /// All fields cover the run's domain. The run's own grid determines how rays are differentiated.
    ///
    /// # Errors
    /// As [`Run::finish`], or if the run's goal is not all rays in one group, or a grid needs a pilot.
    pub fn finish_on(mut self, grids: &[GridSettings]) -> Result<Vec<Outcome>> {
        let Estimation { goal, checkpoint, domain, .. } = &self.settings;
        let is_limited = checkpoint.is_some() || grids.iter().any(|grid| grid.is_limited() || grid.memory.is_some());
        if !matches!(goal, Goal::Shard { .. }) || is_limited {
            let expected = "all rays, on grids without limits, without a checkpoint";
            return Err(Error::setting("several grids", expected, "others"));
        }
        let mut builders = Vec::new();
        for grid in grids {
            // A part of a run has all sums.
            let grid = grid.keep_sums(grid.keep_sums || self.settings.own_shard().of > 1);
            let mut builder = FieldBuilder::new(grid, *domain)?;
            builder.want_density(&self.stream)?;
            builders.push((builder, Duration::ZERO));
        }
        self.surface = self.surface_points()?;
        let shard = self.settings.own_shard();
        let progress = self.stream.run(shard, RunProgress::default(), self.settings.monitor, |batches, _| {
            for (builder, summing) in &mut builders {
                let start = Instant::now();
                builder.add(batches);
                *summing += start.elapsed();
            }
            self.settings.tap.as_mut().map_or(Ok(()), |tap| tap(batches))
        })?;
        let outcome = |(builder, summing): (FieldBuilder, Duration)| {
            let (sums_bytes, start) = (builder.memory(), Instant::now());
            let field = builder.finish(&self.source(progress, Some(shard)))?;
            Ok(self.outcome(field, progress, sums_bytes, summing + start.elapsed()))
        };
        builders.into_iter().map(outcome).collect()
    }

    /// Creates a builder on the run's leaves.
    pub(super) fn builder<P: Finish>(&self) -> Result<Builder<P>> {
        Builder::new(self.settings.grid, self.settings.domain, self.coarser.as_ref())
    }

    /// Where sums go that the budget has no room for, if there is one. The run's state is kept in `file`.
    fn overflow(&self, file: Option<&Path>) -> Option<Overflow> {
        // A dense grid is as large from its first ray on.
        let room = self.room.filter(|_| self.settings.grid.grid == GridKind::Octree);
        room.map(|room| Overflow::new(room, &self.settings.scratch, file))
    }

    /// The checkpoint's files, one for each group; `[None]` without a checkpoint.
    fn files(&self) -> Vec<Option<PathBuf>> {
        let groups = self.settings.goal.groups();
        match &self.settings.checkpoint {
            Some(checkpoint) => checkpoint.files(groups).into_iter().map(Some).collect(),
            None => vec![None; usize::from(groups.unwrap_or(1))],
        }
    }

    fn source(&self, progress: RunProgress, shard: Option<Shard>) -> FieldSource<'_> {
        FieldSource { source: self.settings.source.clone(), progress, shard, stream: Some(&self.stream) }
    }

    fn outcome(&self, field: UncertaintyField, progress: RunProgress, sums_bytes: usize, summing: Duration) -> Outcome {
        let field = field.with_surface(self.surface.clone());
        let field = self.settings.checksum.iter().fold(field, |field, &checksum| field.with_model(checksum));
        let errors = ErrorBudget::of_field(&field);
        Outcome { field, progress, sums_bytes, disk_bytes: 0, summing, errors }
    }
}
