//! A field under construction.

use std::collections::BTreeSet;
use std::ops::AddAssign;
use std::path::Path;

use rayon::prelude::*;

use super::checkpoint::{self, RunKey, State};
use super::coarser::CoarserLeaves;
use super::{GridKind, GridSettings};
use crate::geometry::{Camera, Domain, Lattice};
use crate::octree::{Cell, MaxLevels, morton};
use crate::posterior::overflow::{self, Overflow};
use crate::posterior::{RayCoverage, Refinement, Sums, VertexSums};
use crate::rays::{RaySet, RayStream, RunProgress, SURFACE_WEIGHT, Shard};
use crate::render::{RaySamples, VolumeRenderer};
use crate::uncertainty::{Finish, RunRecord, UncertaintyField};
use crate::{Error, Result};

/// The source of a field's numbers: the part of its record that does not depend on the grid.
#[derive(Clone, Default)]
pub struct FieldSource<'a> {
    /// Model and cameras, or the samples file.
    pub source: String,
    /// Counts of rays drawn and dropped.
    pub progress: RunProgress,
    /// The part of a run that drew them.
    pub shard: Option<Shard>,
    /// The stream that drew them, if it belongs to this crate.
    pub stream: Option<&'a RayStream<'a>>,
}

/// Number of points on visible surfaces that a field keeps, for comparisons and shares of surfaces: 197 kB.
///
/// [`RayStream::surface_points`] finds more, and [`UncertaintyField::with_surface`] keeps them.
pub const SURFACE_POINTS: usize = 16_384;

/// Maximal number of cells that criteria other than sensitivity may ask for: 3 GB of their keys.
const MAX_WANTED_CELLS: u64 = 1 << 27;

/// All finest cells.
fn every_cell(lattice: &Lattice) -> Result<Vec<Cell>> {
    let level = lattice.level();
    if 1_u64 << (3 * u32::from(level)) > MAX_WANTED_CELLS {
        return Err(Error::setting("criterion `uniform`", "a level up to 9", level.to_string()));
    }
    let cell = |code| Cell { level, index: morton::decode(code) };
    Ok((0..1_u64 << (3 * u32::from(level))).map(cell).collect())
}

/// A field under construction, on one kind of grid.
#[derive(Clone)]
pub(super) struct Builder<P> {
    settings: GridSettings,
    lattice: Lattice,
    limits: MaxLevels,
    /// Rays per vertex for which the limits were made; 0 without limits.
    rays_per_vertex: f64,
    /// Cells that must exist regardless of the rays.
    wanted: Vec<Cell>,
    posterior: P,
    surface: Vec<[f32; 3]>,
    /// Rays seen passing; `None` if it is not known where they passed.
    ray_coverage: Option<RayCoverage>,
    /// Where sums go that exceed the budget, if there is one.
    overflow: Option<Overflow>,
    /// Largest size of the sums in memory when any left it, bytes.
    most_memory: usize,
}

impl<P: Finish> Builder<P> {
    /// Creates a builder without information, on leaves that stay coarser where rays are few, if they do.
    ///
    /// # Errors
    /// As [`GridSettings::lattice`].
    pub fn new(settings: GridSettings, domain: Domain, coarser: Option<&CoarserLeaves>) -> Result<Self> {
        let lattice = settings.lattice(domain)?;
        let limits = coarser.map_or_else(|| MaxLevels::none(lattice.level()), |coarser| coarser.limits.clone());
        let posterior = P::empty(lattice, &limits);
        let wanted = if settings.criteria.uniform { every_cell(&lattice)? } else { Vec::new() };
        let rays_per_vertex = coarser.map_or(0.0, |coarser| coarser.rays_per_vertex);
        Ok(Self {
            settings,
            lattice,
            limits,
            rays_per_vertex,
            wanted,
            posterior,
            surface: Vec::new(),
            ray_coverage: None,
            overflow: None,
            most_memory: 0,
        })
    }

    /// The same builder, whose sums leave memory where they exceed a budget.
    pub fn with_overflow(self, overflow: Option<Overflow>) -> Self {
        Self { overflow, ..self }
    }

    /// Writes the last sums to a run, if others left memory: a field is made of all sums in memory, or of runs.
    ///
    /// # Errors
    /// If the run cannot be written.
    pub fn spill_rest(&mut self) -> Result<()> {
        self.overflow.as_ref().map_or(Ok(()), |overflow| overflow.spill_rest(&mut self.posterior))
    }

    /// Writes all sums to one run if there is a budget: those of other groups of rays need its room.
    ///
    /// # Errors
    /// If the run cannot be written.
    pub fn spill_to_one(&mut self) -> Result<()> {
        self.overflow.as_ref().map_or(Ok(()), |overflow| overflow.spill_to_one(&mut self.posterior))
    }

    /// Writes the last sums of two builders to runs if those of either left memory, or a copy of them is to be made
    /// within a budget.
    ///
    /// # Errors
    /// If a run cannot be written.
    pub fn spill_both(builders: [&mut Self; 2], is_copied: bool) -> Result<()> {
        let have_left = builders.iter().any(|builder| !builder.posterior.runs().is_empty());
        for builder in builders {
            if let Some(overflow) = builder.overflow.as_ref().filter(|_| have_left || is_copied) {
                overflow.spill(&mut builder.posterior)?;
            }
        }
        Ok(())
    }

    /// Size of the sums that left memory, bytes.
    pub fn disk_bytes(&self) -> u64 {
        self.posterior.runs().iter().map(|run| run.bytes()).sum()
    }

    /// Adds refinement where there is density, if the settings ask for it and no other cells are refined already.
    ///
    /// The refined cells are those cells of the stream's occupancy grid in which a finest cell may
    /// have an optical depth above 0.01.
    ///
    /// # Errors
    /// If there is no occupancy grid, or the number of cells exceeds what memory can hold.
    pub fn want_density(&mut self, stream: &RayStream) -> Result<()> {
        if !self.settings.criteria.density || !self.wanted.is_empty() {
            return Ok(());
        }
        let Some(VolumeRenderer { tracer, .. }) = stream.source.marched() else {
            return Err(Error::setting("criterion `density`", "a volume, which has a density", "another model"));
        };
        let Some(occupancy) = &tracer.marcher.occupancy else {
            return Err(Error::setting("criterion `density`", "a cutoff above 0, which makes an occupancy grid", "0"));
        };
        let edge = self.lattice.edge().max_element();
        let level = self.lattice.level().min(occupancy.resolution().ilog2() as u8);
        let cells = occupancy.cells_above((0.01 / edge) as f32);
        let coarse: BTreeSet<u64> = cells
            .flat_map(|x| self.lattice.coordinates(x.as_vec3()))
            .map(|u| morton::encode(self.lattice.cell(u).0.map(|i| i >> (self.lattice.level() - level))))
            .collect();
        let depth = 3 * u32::from(self.lattice.level() - level);
        if coarse.len() as u64 >= MAX_WANTED_CELLS >> depth {
            let found = format!("{:.1e} finest cells", coarse.len() as f64 * f64::from(depth).exp2());
            return Err(Error::setting(
                "criterion `density`",
                format!("at most {MAX_WANTED_CELLS} finest cells"),
                found,
            ));
        }
        let finest = coarse.iter().flat_map(|&code| (code << depth)..((code + 1) << depth));
        self.wanted.extend(finest.map(|code| Cell { level: self.lattice.level(), index: morton::decode(code) }));
        Ok(())
    }

    /// Box and finest level.
    pub fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// Adds rays, and writes sums to runs whenever they have no room left. Returns whether they had none.
    ///
    /// # Errors
    /// If a run cannot be written.
    pub fn add_within_budget(&mut self, batches: &[RaySamples]) -> Result<bool> {
        let Some(overflow) = &self.overflow else {
            self.add(batches);
            return Ok(false);
        };
        let mut has_spilled = false;
        for some in overflow::portions(batches) {
            self.posterior.add(some);
            self.most_memory = self.most_memory.max(self.posterior.memory());
            has_spilled |= overflow.spill_if_full(&mut self.posterior)?;
        }
        self.add_beside(batches);
        Ok(has_spilled)
    }

    /// Adds rays.
    pub fn add(&mut self, batches: &[RaySamples]) {
        self.posterior.add(batches);
        self.add_beside(batches);
    }

    /// Adds what a field has beside its sums.
    fn add_beside(&mut self, batches: &[RaySamples]) {
        if batches.iter().any(|batch| !batch.sight.is_empty()) {
            self.ray_coverage.get_or_insert_with(|| RayCoverage::new(&self.lattice)).add(batches);
        }
        // In a random sequence the first points are as good as any. A run that traces rays itself replaces them.
        let lattice = self.lattice;
        let visible = batches.iter().flat_map(|batch| batch.positions.iter().zip(&batch.weights));
        let visible = visible.filter(|(x, weight)| **weight >= SURFACE_WEIGHT && lattice.coordinates(**x).is_some());
        self.keep_surface(visible.map(|(x, _)| x.to_array()));
    }

    /// Keeps as many of these points as there is room for.
    fn keep_surface(&mut self, points: impl Iterator<Item = [f32; 3]>) {
        let room = SURFACE_POINTS - self.surface.len();
        self.surface.extend(points.take(room));
    }

    /// The description of a run of `shard` of the rays of `stream`, which a resumed run must match. `source` names the
    /// model, whatever its path; `occupancy` are the cells per axis of the occupancy grid.
    pub fn run_key(&self, source: String, shard: Shard, stream: &RayStream, occupancy: usize) -> RunKey {
        let marcher = stream.source.marched().map(|volume| &volume.tracer.marcher);
        RunKey {
            version: env!("CARGO_PKG_VERSION").into(),
            source,
            cameras: stream.cameras_checksum(),
            lattice: self.lattice,
            shard,
            pixels: stream.pixels.kind(),
            seed: stream.pixels.seed(),
            march_step: marcher.map_or(0.0, |marcher| marcher.step),
            gradient: stream.source.method(),
            difference_step: stream.source.marched().map_or([0.0; 3], |volume| volume.difference_step().to_array()),
            cutoff: marcher.map_or(0.0, |marcher| marcher.cutoff),
            occupancy: occupancy as u64,
            background: stream.source.background().as_vec3().to_array(),
            pixel_offset: stream.pixel_offset,
            rays_per_vertex: self.rays_per_vertex,
            limits: crc32fast::hash(format!("{:?}", self.limits.packed()).as_bytes()),
        }
    }

    /// Saves the state of the run `key` after the rays of `progress`.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path, key: &RunKey, progress: RunProgress) -> Result<()> {
        checkpoint::save(path, key, progress, &self.posterior, &self.surface, self.ray_coverage.as_ref())
    }

    /// Restores the state of the run `key` and returns its progress, from which the run continues.
    ///
    /// # Errors
    /// If the file is not the complete state of a run with the same description.
    pub fn restore(&mut self, path: &Path, key: &RunKey) -> Result<RunProgress> {
        let State { posterior, progress, surface, ray_coverage } =
            checkpoint::load(path, key, &self.limits, self.overflow.as_ref())?;
        (self.posterior, self.surface, self.ray_coverage) = (posterior, surface, ray_coverage);
        Ok(progress)
    }

    /// Present size of the sums in memory, bytes.
    pub fn size(&self) -> usize {
        self.posterior.memory()
    }

    /// Number of vertices that have sums in memory, and of those that a single ray touched.
    pub fn touched(&self) -> [usize; 2] {
        let slices: Vec<&[P::Sums]> = self.posterior.slices().collect();
        let is_once = |sums: &&P::Sums| sums.rays() == 1;
        let once = slices.par_iter().map(|slice| slice.iter().filter(is_once).count()).sum();
        [slices.iter().map(|slice| slice.len()).sum(), once]
    }

    /// Largest size of the sums in memory so far, bytes.
    pub fn memory(&self) -> usize {
        self.most_memory.max(self.posterior.memory())
    }

    /// The settings.
    pub fn settings(&self) -> &GridSettings {
        &self.settings
    }

    /// As [`paired`](crate::posterior::Posterior::paired).
    pub fn paired<T: Send>(
        &self,
        other: &Self,
        read: impl Fn(VertexSums, VertexSums) -> Option<T> + Send + Sync,
    ) -> Result<Vec<T>> {
        self.posterior.paired(&other.posterior, read)
    }

    /// An empty builder with the same settings and limits.
    fn emptied(&self) -> Self {
        let posterior = P::empty(self.lattice, &self.limits);
        let (limits, wanted) = (self.limits.clone(), self.wanted.clone());
        Self { limits, wanted, posterior, surface: Vec::new(), ray_coverage: None, overflow: None, ..*self }
    }

    /// How the rays so far were drawn and summed.
    fn record(&self, source: &FieldSource) -> RunRecord {
        let (settings, stream) = (&self.settings, source.stream);
        let volume = stream.and_then(|stream| stream.source.marched());
        RunRecord {
            version: env!("CARGO_PKG_VERSION").into(),
            source: source.source.clone(),
            model_checksum: None,
            cameras_checksum: stream.map(RayStream::cameras_checksum),
            rays: source.progress.rays,
            dropped: source.progress.dropped,
            pixels: stream.map(|s| s.pixels.kind()),
            seed: stream.map(|s| s.pixels.seed()),
            shard: source.shard,
            lambda: settings.prior_precision(&self.lattice),
            scale: settings.scale,
            pooling: settings.pooling,
            criteria: settings.criteria,
            covariance: settings.covariance,
            // A dense grid leaves nothing out.
            tolerance: if settings.grid == GridKind::Dense { 0.0 } else { settings.tolerance },
            march_step: volume.map(|volume| volume.tracer.marcher.step),
            gradient: stream.map(|s| s.source.method()),
            difference_step: volume.and_then(|volume| volume.differentiation?.difference_step()),
            cutoff: volume.map(|volume| volume.tracer.marcher.cutoff),
            background: stream.map(|s| s.source.background().as_vec3().to_array()),
            pixel_offset: stream.map(|s| s.pixel_offset),
            pixel_angle: stream.and_then(|s| Camera::pixel_angle(s.cameras)),
        }
    }

    /// The vertices of the field of the rays so far.
    fn vertices(&mut self, source: &FieldSource) -> Result<P::Vertices> {
        let reading = self.record(source).reading();
        // Of a part of a run, no vertex is negligible: the others may add to it.
        let is_part = source.shard.is_some_and(|shard| shard.of > 1);
        let floor = if is_part { Refinement::EVERYTHING } else { reading.floor() };
        // There may be gigabytes of wanted cells.
        let wanted = std::mem::take(&mut self.wanted);
        let refinement = Refinement::above(floor, &reading, self.settings.criteria, wanted);
        let vertices = self.posterior.vertices(&refinement)?;
        self.wanted = refinement.wanted;
        Ok(vertices)
    }

    /// Number of vertices of the field of the rays so far.
    ///
    /// # Errors
    /// If sums that left memory cannot be read.
    pub fn count_vertices(&mut self, source: &FieldSource) -> Result<usize> {
        let vertices = self.vertices(source)?;
        Ok(P::count(&self.lattice, &vertices))
    }

    /// Computes the field from the rays so far.
    ///
    /// # Errors
    /// If sums that left memory cannot be read.
    pub fn finish(mut self, source: &FieldSource) -> Result<UncertaintyField> {
        let (vertices, record) = (self.vertices(source)?, self.record(source));
        let Self { settings, lattice, posterior, surface, ray_coverage, wanted, .. } = self;
        drop(wanted);
        let gathers_sums = settings.gathers_sums(record.is_part());
        let field = posterior.field(record, lattice, vertices, gathers_sums)?;
        let field = if settings.keep_sums { field } else { field.for_queries() };
        Ok(field.with_surface(surface).with_ray_coverage(ray_coverage))
    }

    /// Computes the field of all groups of rays, whose disagreement gives error bars.
    ///
    /// Each builder holds the sums of one group, all on the same leaves; the `ray_sets` are theirs, and `progress` is
    /// that of each. This takes the memory of one more group, unless their sums left memory.
    ///
    /// # Errors
    /// As [`Builder::want_density`], or if sums that left memory cannot be read.
    pub fn finish_groups(
        groups: Vec<Self>,
        ray_sets: Vec<RaySet>,
        progress: &[RunProgress],
        source: &FieldSource,
    ) -> Result<UncertaintyField> {
        let mut whole = groups[0].emptied();
        groups.iter().for_each(|group| whole += group);
        if let Some(stream) = source.stream {
            whole.want_density(stream)?;
        }
        let groups: Vec<P> = groups.into_iter().map(|group| group.posterior).collect();
        let rays: Vec<u64> = progress.iter().map(|p| p.rays).collect();
        Ok(whole.finish(source)?.with_error_bars(&groups, &rays)?.with_ray_sets(ray_sets))
    }
}

impl<P: Finish> AddAssign<&Self> for Builder<P> {
    /// Adds the sums of another builder with the same settings and limits, vertex by vertex.
    fn add_assign(&mut self, other: &Self) {
        self.posterior += &other.posterior;
        self.keep_surface(other.surface.iter().copied());
        match (&mut self.ray_coverage, &other.ray_coverage) {
            (Some(mine), Some(theirs)) => *mine += theirs,
            (mine @ None, theirs) => mine.clone_from(theirs),
            (Some(_), None) => {}
        }
    }
}
