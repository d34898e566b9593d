//! Predicts what a run will need, and limits it to fit.
//!
//! The peak of the process is the sum of three parts:
//!
//! - *outside*: program, model, cameras, occupancy grid, rays under way and their contributions. The operating system
//!   says how much that is during the pilot, which draws rays as the run does.
//! - *summing*: sums of vertices, by the pilot's [`SpeciesEstimate`].
//! - *finishing*: the field, made while the sums are still there.
//!
//! Pictures are decoded before there are sums, so that the larger of both counts.

use std::time::{Duration, Instant};

use super::{GridKind, GridSettings, RaySettings, SURFACE_POINTS};
use crate::geometry::Lattice;
use crate::io::memory;
use crate::monitor::Monitor;
use crate::octree::MaxLevels;
use crate::posterior::{DensePosterior, FactoredSums, PilotCounts, SpeciesEstimate, VertexSums, list_bytes};
use crate::rays::{Purpose, RayStream, RunProgress, Shard};
use crate::render::Outputs;
use crate::{Error, Result};

/// Bytes per vertex of deviation and ray count, in memory and in the file.
const VALUES: f64 = (size_of::<f32>() + size_of::<u8>()) as f64;
/// Bytes per vertex of the octree's structure, in memory and in the file. Measured: 0.4 to 2.1, 0.1 to 0.3.
const STRUCTURE: [f64; 2] = [1.0, 0.2];
/// Bytes per vertex that building the structure takes on the way, beyond what lists of rays leave free: masks of split
/// cells, and the points that their bricks own.
const BUILDING: f64 = 4.0;
/// Bytes of a part's sums in the file.
const EXACT: f64 = (6 * size_of::<f64>() + size_of::<u32>()) as f64;
/// Bytes that every process needs beyond what the pilot shows, such as for ray coverage. Small scenes were found to
/// need up to 17 MB, in sums that grow and in what the allocator keeps.
const RESERVE: f64 = 18e6;
/// What the process holds is rounded up to multiples of this, so that runs on equal machines usually make the same plan
/// although no two processes are of exactly the same size.
const GRAIN: f64 = 16e6;
/// What the process of a part holds beside its model and its lists of rays: program, cameras, occupancy grid. All
/// parts of a run must have the same leaves, so theirs is not measured.
const OF_A_PART: f64 = 96e6;
/// The fraction of the budget that the plan of a part aims at. A part that exceeds its budget all the same plans
/// anew, and then no longer fits the others.
const TARGET_BUDGET_SHARE_OF_A_PART: f64 = 0.8;
/// Contributions are kept in lists that double when they are full.
const LISTS: f64 = 1.5;
/// Maximal number of species in each of a census's samples, if memory is short.
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
    /// Expected size of the sums when all rays are drawn, bytes.
    pub summing: f64,
    /// Expected size of what is added to the sums to finish the field, bytes.
    pub finishing: f64,
    /// Expected room beside the sums that is taken and not used, bytes.
    pub spare: f64,
    /// What the process holds beside sums and field, bytes.
    pub outside: f64,
    /// What decoding pictures takes before there are sums, bytes.
    pub picture: f64,
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
        self.outside + self.picture.max(self.spare + self.summing + self.finishing)
    }

    /// Expected peak memory of the process if its sums come to so much.
    #[must_use]
    pub fn peak_of(&self, Summed { used, spare, vertices }: Summed) -> f64 {
        let used = used as f64;
        let finishing = match vertices {
            Some(count) => count as f64 * self.finishing / self.vertices.max(1.0),
            None => used * self.finishing / self.summing.max(1.0),
        };
        self.outside + self.picture.max(spare as f64 + used + finishing)
    }
}

/// What sums came to.
#[derive(Debug, Clone, Copy)]
pub struct Summed {
    /// Sums, and what finds them, bytes.
    pub used: usize,
    /// Taken and not used, bytes.
    pub spare: usize,
    /// Vertices of the field that would be made of them, if they were counted.
    pub vertices: Option<usize>,
}

/// What was found, per unit that was expected.
#[derive(Debug, Clone, Copy)]
struct Correction {
    sums: f64,
    vertices: f64,
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
    counts: PilotCounts,
    /// Expected number of the field's vertices without limits.
    vertices_unlimited: f64,
    /// Rays of the whole run, and of this part of it, per ray of the pilot.
    scale: f64,
    own_scale: f64,
    is_part: bool,
    outside: f64,
    picture: f64,
    /// What earlier attempts took.
    correction: Correction,
    time: Duration,
}

impl Planner {
    /// Maximal number of rays of the pilot.
    pub const PILOT: u64 = 16_384;
    /// Rays of the run per ray of a pilot that only predicts.
    pub const CHEAP: u64 = 32;

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
        let most = if settings.needs_plan() { rays.rays } else { rays.rays.div_ceil(Self::CHEAP) };
        let pilot = Shard::whole(Self::PILOT.min(most));
        // Limits by ray count alone are exact.
        let is_exact = settings.memory.is_none() && settings.rays_per_vertex() > 0.0;
        let mut census =
            SpeciesEstimate::new(lattice, if is_exact { usize::MAX } else { MAX_SPECIES }, settings.needs_plan());
        let mut outside = 0.0_f64;
        let mut stream = stream.for_purpose(Purpose::Pilot);
        if !settings.needs_plan() {
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
        // All parts of a run expect the same.
        let own_scale = scale / shard.of as f64;
        let counts = census.counts();
        let vertices_unlimited = census.needs(own_scale, &MaxLevels::none(lattice.level())).vertices;
        let outside = match shard.of {
            1 if settings.needs_plan() => ((outside + lists + RESERVE) / GRAIN).ceil() * GRAIN,
            // Where nothing is bounded, no more than is expected: the reserve is what the neediest scenes took.
            1 => outside + lists + 0.5 * RESERVE,
            _ => OF_A_PART + stream.source.memory() as f64 + lists,
        };
        Ok(Self {
            settings,
            lattice,
            counts,
            census,
            vertices_unlimited,
            scale,
            own_scale,
            is_part,
            outside,
            picture: 0.0,
            correction: Correction { sums: 1.0, vertices: 1.0 },
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

    /// The plan for limits with at least `rays_per_vertex` rays per vertex; 0 for no limits.
    #[must_use]
    pub fn with_rays_per_vertex(&self, rays_per_vertex: f64) -> Plan {
        let limits = if rays_per_vertex > 0.0 && self.settings.grid == GridKind::Octree {
            // Where memory is short, no criterion says where to stop.
            let is_short = self.settings.memory.is_some() && rays_per_vertex > self.settings.rays_per_vertex();
            let limits = if is_short { PilotCounts::spread_limits } else { PilotCounts::limits };
            limits(&self.counts, self.scale, rays_per_vertex)
        } else {
            MaxLevels::none(self.lattice.level())
        };
        let (vertices, summing, spare) = match self.settings.grid {
            GridKind::Dense => {
                (self.lattice.dense_vertices() as f64, DensePosterior::required_memory(&self.lattice) as f64, 0.0)
            }
            GridKind::Octree => {
                let needs = self.census.needs(self.own_scale, &limits);
                let Correction { sums, vertices } = self.correction;
                (
                    vertices * needs.vertices,
                    sums * needs.summing(self.settings.entries(self.is_part)),
                    needs.spare(sums),
                )
            }
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
        let given_up = self.counts.shares(&limits);
        // Limits are made in a table twice as large.
        let outside = self.outside + 3.0 * limits.heap_bytes() as f64;
        Plan {
            limits,
            rays_per_vertex,
            vertices,
            vertices_unlimited: self.correction.vertices * self.vertices_unlimited,
            summing,
            finishing: vertices * (VALUES + structure + f64::max(building, gathered as f64)),
            spare,
            outside,
            picture: self.picture,
            file: vertices * (VALUES + stored + in_file) + 12.0 * SURFACE_POINTS as f64,
            time: self.time,
            given_up,
        }
    }

    /// The finest plan that meets the settings' criteria and memory budget.
    ///
    /// Where memory is short, the refinement supported by the fewest rays is given up first.
    ///
    /// # Errors
    /// If not even the coarsest limits fit; the message says what would.
    pub fn plan(&self) -> Result<Plan> {
        let wanted = self.with_rays_per_vertex(self.settings.rays_per_vertex());
        let Some(budget) = self.settings.memory.map(|bytes| bytes as f64) else { return Ok(wanted) };
        let share = if self.is_part { TARGET_BUDGET_SHARE_OF_A_PART } else { 1.0 };
        let least = match self.settings.grid {
            GridKind::Dense => wanted.peak() / share,
            GridKind::Octree => {
                // On the coarsest leaves nothing is left to give up if the plan is wrong.
                let coarsest = self.coarsest();
                let doubled = coarsest.outside + coarsest.spare + 2.0 * (coarsest.summing + coarsest.finishing);
                doubled.max(coarsest.peak() / share)
            }
        };
        let is_safe = |plan: &Plan| budget >= least || plan.rays_per_vertex == wanted.rays_per_vertex;
        self.within(share * budget).filter(is_safe).ok_or_else(|| {
            // Enough for the next process, too, which may be just large enough to be rounded up to one grain more.
            let enough = ((least + GRAIN) / 1e6).ceil();
            let expected = format!("at least {enough} MB, or a lower level, or fewer rays");
            Error::setting("memory budget", expected, format!("{:.0} MB", budget / 1e6))
        })
    }

    /// The finest plan whose peak is within `budget` bytes, if there is one.
    pub(super) fn within(&self, budget: f64) -> Option<Plan> {
        let fits = |plan: &Plan| plan.peak() <= budget;
        let least = self.settings.rays_per_vertex();
        let finest = self.with_rays_per_vertex(least);
        if fits(&finest) || self.settings.grid == GridKind::Dense {
            return Some(finest).filter(fits);
        }
        let mut best = Some(self.coarsest()).filter(fits)?;
        // A region drops a level when its rays per vertex fall below the bound, so the peak falls with the bound.
        let (mut low, mut high) = (least.max(MIN_RATE).log2(), MAX_RATE.log2());
        while high - low > 0.02 {
            let middle = 0.5 * (low + high);
            let plan = self.with_rays_per_vertex(middle.exp2());
            if fits(&plan) {
                (best, high) = (plan, middle);
            } else {
                low = middle;
            }
        }
        Some(best)
    }

    /// The plan with the coarsest leaves.
    pub(super) fn coarsest(&self) -> Plan {
        self.with_rays_per_vertex(MAX_RATE)
    }

    /// Plans as if the process took nothing beside sums and field.
    #[cfg(test)]
    pub(super) fn forget_process(&mut self) {
        self.outside = 0.0;
    }

    /// Makes all further plans expect as much more, or less, as was found: the sums came to `summed` after the fraction
    /// `done` of the rays of `plan`.
    pub(super) fn correct(&mut self, plan: &Plan, done: f64, summed: Summed) {
        let needs = self.census.needs(done * self.own_scale, &plan.limits);
        let sums = summed.used as f64 / needs.summing(self.settings.entries(self.is_part)).max(1.0);
        // Where nobody counted, there are as many more vertices as sums.
        let counted = summed.vertices.map(|count| count as f64 / needs.vertices.max(1.0));
        self.correction = Correction { sums, vertices: counted.unwrap_or(sums) };
    }
}

/// Bounds on rays per vertex: below the first no region gives up anything, beyond the second every region has given up
/// all its levels.
const MIN_RATE: f64 = 1e-6;
const MAX_RATE: f64 = 1e12;
