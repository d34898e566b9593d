//! Foresees what a run will take, by its first rays.
//!
//! The peak of the process is the sum of three parts:
//!
//! - *outside*: program, model, cameras, occupancy grid, rays under way and their contributions. The operating system
//!   reports how much that is while the first rays are drawn.
//! - *summing*: sums of vertices, as they [grow](super::growth) with the rays.
//! - *finishing*: the field, made while the sums are still there, or once they have left memory.
//!
//! Pictures are decoded before there are sums, so that the larger of both counts.

use std::time::{Duration, Instant};

use super::builder::{Builder, FieldSource};
use super::coarser::CoarserLeaves;
use super::growth::{Growth, Mark};
use super::{Goal, GridKind, GridSettings, SURFACE_POINTS};
use crate::Result;
use crate::io::container::Item;
use crate::io::memory;
use crate::posterior::overflow::{MOST_RUNS, SAMPLES};
use crate::posterior::{FactoredSums, VertexSums, spare_bytes};
use crate::rays::RayStream;
use crate::render::Outputs;
use crate::uncertainty::Finish;

/// Bytes per vertex of deviation and ray count, in memory and in the file.
const VALUES: f64 = (size_of::<f32>() + size_of::<u8>()) as f64;
/// Bytes per vertex of the octree's structure, in memory and in the file. Measured: 0.4 to 2.1, 0.1 to 0.5.
const STRUCTURE: [f64; 2] = [2.0, 0.5];
/// Bytes per vertex that building the structure takes on the way: masks of split cells. The most that was found, with
/// few rays on a fine lattice.
const BUILDING: f64 = 1.5;
/// Bytes per vertex of error bars, in memory and in the file.
const BARS: f64 = size_of::<u16>() as f64;
/// Bytes of a part's sums in the file.
const EXACT: f64 = (6 * size_of::<f64>() + size_of::<u32>()) as f64;
/// Bytes of what a file has beside its vertices: record, points on surfaces, coverage of rays.
const RECORD: f64 = 12.0 * SURFACE_POINTS as f64 + 50e3;
/// Sums leave memory after the rays that filled their room: bytes on disk per byte that is due, and bytes in memory per
/// byte of a record of the up to eight vertices of each sample.
const OVERFULL: [f64; 2] = [1.05, 1.5];
/// Bytes that a process was found to need beyond what its first rays show, in what the allocator keeps.
const RESERVE: f64 = 9e6;
/// Time that reading the deviations of all vertices takes, or the sums of a group of rays, per time of finding these
/// vertices: what the longest of ten runs took, rounded up.
const READING: f64 = 3.0;
/// Seconds for a byte of sums that is written, and read when runs are merged. Measured: 6 to 9 ns.
const SECONDS_PER_BYTE: f64 = 1e-8;

/// The expected course of a run: upper bounds by its first rays.
#[derive(Debug, Clone, Default)]
#[non_exhaustive]
pub struct Plan {
    /// Rays per vertex below which leaves stay coarser; 0 without limits.
    pub rays_per_vertex: f64,
    /// Fractions of all touches by the number of levels given up: 0, 1, 2, …; empty without limits.
    pub given_up: Vec<f64>,
    /// Number of the field's vertices.
    pub vertices: f64,
    /// Largest size of the sums in memory, bytes.
    pub summing: f64,
    /// What finishing the field takes, bytes: beside the sums, or once they have left memory.
    pub finishing: f64,
    /// What the process holds beside sums and field, bytes.
    pub outside: f64,
    /// What decoding pictures takes before there are sums, bytes.
    pub picture: f64,
    /// Size of the sums that leave memory, bytes on disk; 0 if all fit.
    pub disk: f64,
    /// Size of the field's file, bytes.
    pub file: f64,
    /// Time of the run.
    pub time: Duration,
}

impl Plan {
    /// Peak memory of the process, bytes.
    #[must_use]
    pub fn peak(&self) -> f64 {
        // If any sums leave memory, the last do before the field is made.
        let run = if self.disk > 0.0 { self.summing.max(self.finishing) } else { self.summing + self.finishing };
        self.outside + self.picture.max(run)
    }
}

/// What it takes to prepare views, if they have to be: this does not grow with the number of rays.
#[derive(Debug, Clone, Copy, Default)]
struct Preparing {
    /// Time for one view.
    view: Duration,
    /// Number of views of the first rays, and of the whole run.
    at_first: u32,
    of_run: u32,
}

impl Preparing {
    /// Of a run through all cameras, whose first rays come from fewer.
    fn measure(first: &RayStream) -> Self {
        if first.source.marched().is_some() {
            return Self::default();
        }
        let timed = |_| {
            let start = Instant::now();
            drop(first.source.view(&first.cameras[first.cameras.len() / 2], Outputs::Derivatives));
            start.elapsed()
        };
        // The first one finds nothing in the cache.
        let view = (0..2).map(timed).min().unwrap_or_default();
        Self { view, at_first: first.cameras_in_use() as u32, of_run: first.cameras.len() as u32 }
    }
}

/// Watches the first rays of a run until there are enough of them, or their sums take half of their room.
pub(super) struct Planner {
    settings: GridSettings,
    goal: Goal,
    is_part: bool,
    /// Number of rays of the run, and of those that are watched.
    rays: f64,
    first: u64,
    /// Bytes that sums may take in memory, if there is a budget.
    room: Option<f64>,
    picture: f64,
    rays_per_vertex: f64,
    given_up: Vec<f64>,
    preparing: Preparing,
    start: Instant,
    outside: f64,
    before: Option<Mark>,
    last: Option<Mark>,
    is_done: bool,
}

impl Planner {
    /// Rays of a run per ray that is watched, and the fewest rays that are: a field of so few is made at once.
    const FIRST: u64 = 16;
    const LEAST: u64 = 16_384;
    /// Rays at a mark per ray at the mark before. The octree of a mark takes time.
    const BETWEEN: f64 = 4.0;

    /// Of a run of so many rays, whose sums may take `room` bytes.
    pub fn new(settings: GridSettings, goal: Goal, rays: u64, room: Option<usize>, picture: u64) -> Self {
        Self {
            settings,
            goal,
            is_part: matches!(goal, Goal::Shard { of, .. } if of > 1),
            rays: rays as f64,
            // Those of one set at most.
            first: (rays / Self::FIRST).max(Self::LEAST).min(rays / u64::from(goal.sets_of_rays())).max(1),
            room: room.map(|room| room as f64),
            picture: picture as f64,
            rays_per_vertex: 0.0,
            given_up: Vec::new(),
            preparing: Preparing::default(),
            start: Instant::now(),
            outside: 0.0,
            before: None,
            last: None,
            is_done: false,
        }
    }

    /// The planner of a run on such leaves.
    pub fn on_leaves(mut self, coarser: Option<&CoarserLeaves>) -> Self {
        if let Some(CoarserLeaves { rays_per_vertex, given_up, .. }) = coarser {
            (self.rays_per_vertex, self.given_up) = (*rays_per_vertex, given_up.clone());
        }
        self
    }

    /// The planner of a run through all cameras, if the rays that it watches come from fewer.
    pub fn through(self, first: &RayStream) -> Self {
        Self { preparing: Preparing::measure(first), start: Instant::now(), ..self }
    }

    /// The planner of a run that watches its own rays. The octree of a mark takes time, so that these are few of a run
    /// that is short.
    pub fn under_way(self) -> Self {
        Self { first: self.first.min(self.rays as u64 / 4).max(1), ..self }
    }

    /// Number of rays that are watched.
    pub fn first_rays(&self) -> u64 {
        self.first
    }

    /// Looks at a builder after some of the first rays were summed. Returns the plan, once: after the last of them, or
    /// when their sums have taken half of their room. There is none if sums left memory before the first mark.
    ///
    /// # Errors
    /// As [`Builder::vertices`].
    pub fn watch<P: Finish>(&mut self, builder: &mut Builder<P>, source: &FieldSource) -> Result<Option<Plan>> {
        if self.is_done {
            return Ok(None);
        }
        let (drawing, memory) = (self.start.elapsed(), builder.size());
        let here = memory::resident().map_or(0.0, |bytes| bytes as f64 - memory as f64);
        self.outside = self.outside.max(here);
        let has_left = builder.disk_bytes() > 0;
        let (rays, enough) = (source.progress.rays as f64, self.first as f64);
        // The octree of a mark needs room beside the sums.
        let is_half_full = self.room.is_some_and(|room| memory as f64 >= 0.5 * room);
        self.is_done = has_left || rays >= enough || is_half_full;
        // Under a budget, the first rays may end before there were enough.
        let first = if self.room.is_some() { 0.0 } else { enough / Self::BETWEEN };
        let is_due = rays >= self.last.map_or(first, |last| Self::BETWEEN * last.rays);
        if !has_left && (is_due || self.is_done) {
            let start = Instant::now();
            let vertices = builder.count_vertices(source)? as f64;
            let refining = start.elapsed();
            // What this took is not the rays'.
            self.start += refining;
            let [sums, once] = builder.touched().map(|count| count as f64);
            self.before = self.last.filter(|last| 1.5 * last.rays < rays).or(self.before);
            self.last = Some(Mark { rays, sums, once, memory: memory as f64, vertices, drawing, refining });
        }
        let growth = self.last.filter(|_| self.is_done).map(|last| Growth::new(self.before, last));
        Ok(growth.map(|growth| self.plan(&growth)))
    }

    fn plan(&self, growth: &Growth) -> Plan {
        let (settings, last) = (&self.settings, growth.last());
        let is_dense = settings.grid == GridKind::Dense;
        let vertices = growth.at(self.rays, |mark| mark.vertices);
        let (summing, disk) = self.sums(growth);
        let [structure, stored] = if is_dense { [0.0; 2] } else { STRUCTURE };
        let gathers_sums = !is_dense && settings.gathers_sums(self.is_part);
        let gathered = if gathers_sums { size_of::<VertexSums>() as f64 } else { 0.0 };
        let building = if is_dense { 0.0 } else { gathered.max(BUILDING) };
        let in_file = match (self.is_part, settings.keep_sums) {
            (true, _) => EXACT,
            (false, true) => size_of::<FactoredSums>() as f64,
            (false, false) => 0.0,
        };
        let groups = self.goal.groups();
        let bars = if groups.is_some() { BARS } else { 0.0 };
        // Pooled deviations without each group are made of all sums around a vertex, and kept until the last.
        let pooled = groups.filter(|_| settings.pooling.is_on());
        let deleted = pooled.map_or(0.0, |groups| size_of::<VertexSums>() as f64 + 8.0 * f64::from(groups));
        let outside = self.outside + RESERVE;
        // A picture that a budget has no room for is not decoded.
        let has_room = settings.memory.is_none_or(|budget| self.picture <= budget as f64 - outside);
        let read = 1.0 + groups.map_or(0.0, f64::from);
        let finding = last.refining.mul_f64(vertices / last.vertices.max(1.0));
        Plan {
            rays_per_vertex: self.rays_per_vertex,
            given_up: self.given_up.clone(),
            vertices,
            summing,
            finishing: vertices * (VALUES + structure + bars + deleted + building),
            outside,
            picture: if has_room { self.picture } else { 0.0 },
            disk,
            file: vertices * (VALUES + stored + bars + in_file) + RECORD,
            time: self.drawing(last)
                + finding.mul_f64(1.0 + read * READING)
                + Duration::from_secs_f64(SECONDS_PER_BYTE * disk),
        }
    }

    /// Time of all rays.
    fn drawing(&self, last: &Mark) -> Duration {
        let Preparing { view, at_first, of_run } = self.preparing;
        let rays = last.drawing.saturating_sub(view * at_first);
        rays.mul_f64(self.rays / last.rays) + view * of_run
    }

    /// Largest size of the sums in memory, and their size on disk, bytes.
    fn sums(&self, growth: &Growth) -> (f64, f64) {
        let (last, is_grouped) = (growth.last(), self.goal.groups().is_some());
        let record = self.settings.entries(self.is_part).record_bytes() as f64;
        let used = (last.memory - spare_bytes(last.sums)).max(record * last.sums);
        let taken = |sums: f64| used * sums / last.sums.max(1.0) + spare_bytes(sums);
        let count = |rays: f64| growth.at(rays, |mark| mark.sums);
        let sets: f64 = self.goal.sets_of_rays().into();
        let (of_set, all) = (count(self.rays / sets), count(self.rays));
        let copies: f64 = self.goal.sets_of_sums(self.settings.pooling).into();
        let in_memory = if is_grouped { sets * taken(of_set) + taken(all) } else { copies * taken(of_set) };
        // Halves are drawn side by side, groups one after the other.
        let together = if is_grouped { 1.0 } else { sets };
        let is_copied = copies > sets;
        let room = self.room.map(|room| room / together).filter(|room| is_copied || taken(of_set) > *room);
        let Some(room) = room.filter(|_| self.settings.grid == GridKind::Octree) else { return (in_memory, 0.0) };
        // Runs that each take all the room, and the last one.
        let per_byte = last.sums / used.max(1.0);
        let of_run = (per_byte * (room - spare_bytes(per_byte * room))).max(0.5 * per_byte * room).min(of_set).max(1.0);
        let runs = self.rays / sets / growth.rays_with(of_run);
        let of_runs = runs.floor() * of_run + count(runs.fract() * self.rays / sets / runs);
        // The sums of a group are merged into one run, which is there beside those that it is made of; so are more runs
        // than can be read.
        let merged = if runs > MOST_RUNS as f64 || is_grouped && runs > 1.0 { of_set } else { 0.0 };
        let records = if is_grouped { (sets - 1.0) * of_set + of_runs + merged } else { sets * (of_runs + merged) };
        let most = room + OVERFULL[1] * record * 8.0 * SAMPLES as f64;
        (together * taken(of_set).min(most), OVERFULL[0] * records * (u64::SIZE as f64 + record))
    }
}
