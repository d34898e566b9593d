//! Predicts what a run will need.
//!
//! The peak of the process is the sum of three parts:
//!
//! - *outside*: program, model, cameras, occupancy grid, rays under way and their contributions. The operating system
//!   reports how much that is during the pilot, which draws rays as the run does.
//! - *summing*: sums of vertices, by the pilot's [`SpeciesEstimate`].
//! - *finishing*: the field, made while the sums are still there, or once they have left memory.
//!
//! Pictures are decoded before there are sums, so that the larger of both counts.

use std::time::{Duration, Instant};

use super::{Goal, GridKind, GridSettings, RaySettings, SURFACE_POINTS};
use crate::Result;
use crate::geometry::Lattice;
use crate::io::container::Item;
use crate::io::memory;
use crate::monitor::Monitor;
use crate::octree::MaxLevels;
use crate::posterior::{DensePosterior, FactoredSums, Needs, SpeciesEstimate, VertexSums, list_bytes};
use crate::rays::{Purpose, RayStream, RunProgress, Shard};
use crate::render::Outputs;

/// Bytes per vertex of deviation and ray count, in memory and in the file.
const VALUES: f64 = (size_of::<f32>() + size_of::<u8>()) as f64;
/// Bytes per vertex of the octree's structure, in memory and in the file. Measured: 0.4 to 2.1, 0.1 to 0.3.
const STRUCTURE: [f64; 2] = [1.0, 0.2];
/// Bytes per vertex that building the structure takes on the way, beyond what lists of rays leave free: masks of split
/// cells, and the points that their bricks own.
const BUILDING: f64 = 4.0;
/// Bytes per vertex of error bars, in memory and in the file.
const BARS: f64 = size_of::<u16>() as f64;
/// Bytes of a part's sums in the file.
const EXACT: f64 = (6 * size_of::<f64>() + size_of::<u32>()) as f64;
/// Bytes that every process needs beyond what the pilot shows, such as for ray coverage. Small scenes were found to
/// need up to 17 MB, in sums that grow and in what the allocator keeps.
const RESERVE: f64 = 18e6;
/// Contributions are kept in lists that double when they are full.
const LISTS: f64 = 1.5;
/// Maximal number of species in each of a census's samples, if they only predict.
const MAX_SPECIES: usize = 1 << 16;

/// The expected course of a run.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Plan {
    /// The maximal level of leaves, by region.
    pub limits: MaxLevels,
    /// Rays per vertex required by these limits; 0 without limits.
    pub rays_per_vertex: f64,
    /// Expected number of the field's vertices.
    pub vertices: f64,
    /// Expected number of the field's vertices without limits.
    pub vertices_unlimited: f64,
    /// Expected largest size of the sums in memory, bytes.
    pub summing: f64,
    /// Expected size of what finishing the field takes, bytes: beside the sums, or once they have left memory.
    pub finishing: f64,
    /// Expected room beside the sums that is taken and not used, bytes.
    pub spare: f64,
    /// What the process holds beside sums and field, bytes.
    pub outside: f64,
    /// What decoding pictures takes before there are sums, bytes.
    pub picture: f64,
    /// Expected size of the sums that leave memory, bytes on disk; 0 if all fit.
    pub disk: f64,
    /// Expected size of the field's file, bytes.
    pub file: f64,
    /// Expected time.
    pub time: Duration,
    /// Fractions of all touches by the number of levels given up: 0, 1, 2, …
    pub given_up: Vec<f64>,
}

impl Plan {
    /// Expected peak memory of the process, bytes.
    #[must_use]
    pub fn peak(&self) -> f64 {
        let sums = self.spare + self.summing;
        // If any sums leave memory, the last do before the field is made.
        let run = if self.disk > 0.0 { sums.max(self.finishing) } else { sums + self.finishing };
        self.outside + self.picture.max(run)
    }
}

/// What it takes to prepare views, if they have to be: this does not grow with the number of rays.
struct Preparing {
    /// Time for one view.
    view: Duration,
    /// Number of views that the pilot prepares, and that the run does.
    of_pilot: u32,
    of_run: u32,
}

impl Preparing {
    fn measure(pilot: &RayStream) -> Option<Self> {
        if pilot.source.marched().is_some() {
            return None;
        }
        let timed = |_| {
            let start = Instant::now();
            drop(pilot.source.view(&pilot.cameras[pilot.cameras.len() / 2], Outputs::Derivatives));
            start.elapsed()
        };
        // The first one finds nothing in the cache.
        let (view, of_run) = ((0..2).map(timed).min()?, pilot.cameras.len() as u32);
        Some(Self { view, of_pilot: pilot.cameras_in_use() as u32, of_run })
    }
}

/// A pilot run, from which plans are made.
pub struct Planner {
    settings: GridSettings,
    lattice: Lattice,
    census: SpeciesEstimate,
    /// Rays of the whole run, and of this part of it, per ray of the pilot.
    scale: f64,
    own_scale: f64,
    is_part: bool,
    outside: f64,
    picture: f64,
    /// Bytes that sums may take in memory, if there is a budget.
    room: Option<f64>,
    goal: Goal,
    time: Duration,
}

impl Planner {
    /// Maximal number of rays of the pilot.
    pub const PILOT: u64 = 16_384;
    /// Rays of the run per ray of a pilot that only predicts.
    pub const CHEAP: u64 = 32;
    /// Least number of its rays. Of a few dozen, the vertices of a run on a fine lattice were foreseen to be a third.
    const LEAST: u64 = 1024;

    /// Runs a pilot with the run's settings but another seed. All shards of a run use the same pilot.
    ///
    /// # Errors
    /// As [`RayStream::run`].
    pub fn new(
        settings: GridSettings,
        rays: &RaySettings,
        stream: &RayStream,
        shard: Shard,
        lattice: Lattice,
        monitor: &dyn Monitor,
    ) -> Result<Self> {
        // Limits would be too uncertain from few rays.
        let is_limited = settings.is_limited();
        let pilot =
            if is_limited { rays.rays } else { rays.rays.div_ceil(Self::CHEAP).max(Self::LEAST).min(rays.rays) };
        let pilot = Shard::whole(Self::PILOT.min(pilot));
        let mut census = SpeciesEstimate::new(lattice, if is_limited { usize::MAX } else { MAX_SPECIES }, is_limited);
        let mut outside = 0.0_f64;
        let mut stream = stream.for_purpose(Purpose::Pilot);
        if !is_limited {
            // Only a forecast depends on these rays.
            stream = stream.through_few_cameras();
        }
        let preparing = Preparing::measure(&stream);
        let start = Instant::now();
        stream.run(pilot, RunProgress::default(), monitor, |batches, _| {
            let here = memory::resident().map_or(0.0, |bytes| bytes as f64 - census.memory() as f64);
            outside = outside.max(here);
            census.add(batches);
            Ok(())
        })?;
        let is_part = shard.of > 1;
        let lists = LISTS * list_bytes(settings.entries(is_part), census.longest_batch()) as f64;
        let scale = rays.rays as f64 / pilot.rays as f64;
        let own_scale = scale / shard.of as f64;
        Ok(Self {
            settings,
            lattice,
            census,
            scale,
            own_scale,
            is_part,
            // No more than is expected: the reserve is what the neediest scenes took.
            outside: outside + lists + 0.5 * RESERVE,
            picture: 0.0,
            room: None,
            goal: Goal::default(),
            time: match preparing {
                None => start.elapsed().mul_f64(own_scale),
                Some(Preparing { view, of_pilot, of_run }) => {
                    start.elapsed().saturating_sub(view * of_pilot).mul_f64(own_scale) + view * of_run
                }
            },
        })
    }

    /// The planner of a run that decodes a picture of so many bytes, unless the budget has no room for it.
    #[must_use]
    pub fn with_picture(self, bytes: u64) -> Self {
        let room = self.settings.memory.map_or(f64::INFINITY, |budget| budget as f64 - self.outside);
        Self { picture: Some(bytes as f64).filter(|&bytes| bytes <= room).unwrap_or(0.0), ..self }
    }

    /// The planner of a run whose sums may take so many bytes in memory.
    #[must_use]
    pub fn with_room(self, room: Option<usize>) -> Self {
        Self { room: room.map(|room| room as f64), ..self }
    }

    /// The planner of a run with this goal.
    #[must_use]
    pub fn with_goal(self, goal: Goal) -> Self {
        Self { goal, ..self }
    }

    /// What the run will need.
    #[must_use]
    pub fn plan(&self) -> Plan {
        let rays_per_vertex = self.settings.rays_per_vertex();
        let (counts, unlimited) = (self.census.counts(), MaxLevels::none(self.lattice.level()));
        let limits = if rays_per_vertex > 0.0 && self.settings.grid == GridKind::Octree {
            counts.limits(self.scale, rays_per_vertex)
        } else {
            unlimited.clone()
        };
        let (vertices, summing, spare, disk) = match self.settings.grid {
            GridKind::Dense => {
                let summing = self.sets() * DensePosterior::required_memory(&self.lattice) as f64;
                (self.lattice.dense_vertices() as f64, summing, 0.0, 0.0)
            }
            GridKind::Octree => self.of_octree(&limits),
        };
        let [structure, stored] = if self.settings.grid == GridKind::Dense { [0.0; 2] } else { STRUCTURE };
        let building = if self.settings.grid == GridKind::Dense { 0.0 } else { BUILDING };
        let keeps_sums = self.settings.gathers_sums(self.is_part);
        let gathered = if keeps_sums && self.settings.grid == GridKind::Octree { size_of::<VertexSums>() } else { 0 };
        let in_file = match (self.is_part, self.settings.keep_sums) {
            (true, _) => EXACT,
            (false, true) => size_of::<FactoredSums>() as f64,
            (false, false) => 0.0,
        };
        let groups = self.goal.groups();
        let bars = if groups.is_some() { BARS } else { 0.0 };
        // Pooled deviations without each group are made of all sums around a vertex, and kept until the last.
        let pooled = groups.filter(|_| self.settings.pooling.is_on());
        let deleted = pooled.map_or(0.0, |groups| size_of::<VertexSums>() as f64 + 8.0 * f64::from(groups));
        Plan {
            given_up: counts.shares(&limits),
            // Limits are made in a table twice as large.
            outside: self.outside + 3.0 * limits.heap_bytes() as f64,
            limits,
            rays_per_vertex,
            vertices,
            vertices_unlimited: self.census.needs(self.own_scale, &unlimited).vertices,
            summing,
            finishing: vertices * (VALUES + structure + bars + deleted + f64::max(building, gathered as f64)),
            spare,
            disk,
            picture: self.picture,
            file: vertices * (VALUES + stored + bars + in_file) + 12.0 * SURFACE_POINTS as f64,
            time: self.time,
        }
    }

    /// Number of sets of sums in memory at the end.
    fn sets(&self) -> f64 {
        self.goal.sets_of_sums(self.settings.pooling).into()
    }

    /// Vertices of the field on an octree; bytes of the sums in memory, room beside them that nothing uses, and bytes
    /// of their runs on disk.
    fn of_octree(&self, limits: &MaxLevels) -> (f64, f64, f64, f64) {
        let entries = self.settings.entries(self.is_part);
        let needs = |parts: f64| self.census.needs(self.own_scale / parts, limits);
        let taken = |needs: &Needs| needs.summing(entries) + needs.spare();
        let (all, groups) = (needs(1.0), self.goal.groups());
        let of_group = needs(groups.unwrap_or(1).into());
        let Some(room) = self.room.filter(|room| groups.is_some() || taken(&all) > *room) else {
            let others = self.sets() - 1.0;
            let summing = all.summing(entries) + others * of_group.summing(entries);
            return (all.vertices, summing, all.spare() + others * of_group.spare(), 0.0);
        };
        // The fewest runs of equal numbers of rays that each fit, and their sums.
        let parts = f64::from(groups.unwrap_or(1));
        let fits = |runs: &f64| taken(&needs(parts * runs)) <= room || *runs > 1e6;
        let runs = (0..).map(|power| f64::from(power).exp2()).find(fits).unwrap_or(1.0);
        let of_runs = runs * needs(parts * runs).sums;
        // Those of a group are merged while they are still there.
        let merged = if runs > 1.0 { of_runs } else { 0.0 };
        let sums = groups.map_or(of_runs, |_| parts * of_group.sums + merged);
        let record = (u64::SIZE + entries.record_bytes()) as f64;
        (all.vertices, taken(&of_group).min(room), 0.0, sums * record)
    }
}
