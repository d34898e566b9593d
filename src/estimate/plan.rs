//! Predicts what a run will need, and limits it to fit.

use std::time::{Duration, Instant};

use super::{GridKind, GridSettings, RaySettings};
use crate::geometry::Lattice;
use crate::monitor::Monitor;
use crate::octree::MaxLevels;
use crate::posterior::{DensePosterior, OctreePosterior, PilotCounts, Posterior, VertexSums};
use crate::rays::{Purpose, RayStream, RunProgress, Shard};
use crate::{Error, Result};

/// Bytes per touched vertex while summing.
///
/// The sums take 56 bytes, in bricks that are about half full (the city at level 11: twice that per vertex).
/// Another half of that covers lists of rays in progress and the allocator's overhead.
pub const SUMMING: f64 = 3.0 * size_of::<VertexSums>() as f64;
/// Bytes per touched vertex of the finished field.
///
/// Sums, deviation, ray count and structure (56 + 4 + 1 + 1), times one and a half vertices, because the cells around
/// a touched vertex have others.
pub const FINISHED: f64 = 1.5 * (size_of::<VertexSums>() + 6) as f64;

/// The expected course of a run.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The maximal level of leaves, by region.
    pub limits: MaxLevels,
    /// Rays per vertex required by these limits; 0 without limits.
    pub rays_per_vertex: f64,
    /// Expected number of touched vertices.
    pub vertices: f64,
    /// Expected number of touched vertices without limits.
    pub vertices_unlimited: f64,
    /// Expected peak memory of the sums and the field, bytes; the model is extra.
    pub bytes: f64,
    /// Expected time.
    pub time: Duration,
    /// Fractions of all touches by the number of levels given up: 0, 1, 2, …
    pub given_up: Vec<f64>,
}

/// A pilot run, from which plans are made.
pub struct Planner {
    settings: GridSettings,
    survey: PilotCounts,
    /// Expected number of touched vertices without limits.
    vertices_unlimited: f64,
    /// Rays of the run per ray of the pilot.
    scale: f64,
    time: Duration,
}

impl Planner {
    /// Maximal number of rays of the pilot.
    pub const PILOT: u64 = 16_384;

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
        let pilot = Shard::whole(Self::PILOT.min(rays.rays));
        let start = Instant::now();
        let mut posterior = OctreePosterior::new(lattice);
        let stream = stream.for_purpose(Purpose::Pilot);
        stream.run(pilot, RunProgress::default(), monitor, |batches, _| {
            posterior.add(batches);
            Ok(())
        })?;
        let scale = rays.rays as f64 / pilot.rays as f64;
        let time = start.elapsed().mul_f64(shard.own_rays() as f64 / pilot.rays as f64);
        let survey = PilotCounts::from_pilot(&posterior);
        let vertices_unlimited = survey.vertices(scale, &MaxLevels::none(lattice.level()));
        Ok(Self { settings, survey, vertices_unlimited, scale, time })
    }

    /// The plan for limits with at least `rays_per_vertex` rays per vertex; 0 for no limits.
    #[must_use]
    pub fn with_rays_per_vertex(&self, lattice: &Lattice, rays_per_vertex: f64) -> Plan {
        let limits = if rays_per_vertex > 0.0 {
            self.survey.limits(self.scale, rays_per_vertex)
        } else {
            MaxLevels::none(lattice.level())
        };
        let vertices = self.survey.vertices(self.scale, &limits);
        let given_up = self.survey.shares(&limits);
        let bytes = match self.settings.grid {
            GridKind::Dense => {
                DensePosterior::required_memory(lattice) as f64 * (1.0 + 5.0 / size_of::<VertexSums>() as f64)
            }
            GridKind::Octree => vertices * (SUMMING + FINISHED),
        };
        let vertices_unlimited = self.vertices_unlimited;
        Plan { limits, rays_per_vertex, vertices, vertices_unlimited, bytes, time: self.time, given_up }
    }

    /// The finest plan that meets the settings' criteria and memory budget.
    ///
    /// Where memory is short, the refinement supported by the fewest rays is given up first.
    ///
    /// # Errors
    /// If not even the coarsest limits fit; the message says what would.
    pub fn plan(&self, lattice: &Lattice) -> Result<Plan> {
        let wanted = self.settings.rays_per_vertex();
        let mut plan = self.with_rays_per_vertex(lattice, wanted);
        let Some(budget) = self.settings.memory else { return Ok(plan) };
        while plan.bytes > budget as f64 {
            let tighter = self.tighter(lattice, &plan).ok_or_else(|| {
                let expected = format!("at least {:.0} MB, or a lower level, or fewer rays", plan.bytes / 1e6);
                Error::setting("memory budget", expected, format!("{:.0} MB", budget as f64 / 1e6))
            })?;
            plan = tighter;
        }
        Ok(plan)
    }

    /// The next coarser plan, if there is one.
    #[must_use]
    pub fn tighter(&self, lattice: &Lattice, plan: &Plan) -> Option<Plan> {
        // Beyond this, every region has given up all its levels.
        const MOST: f64 = 1e12;
        let mut rays_per_vertex = plan.rays_per_vertex;
        while self.settings.grid == GridKind::Octree && rays_per_vertex < MOST {
            rays_per_vertex = (1.25 * rays_per_vertex).max(1.0 / 64.0);
            let tighter = self.with_rays_per_vertex(lattice, rays_per_vertex);
            if tighter.vertices < plan.vertices {
                return Some(tighter);
            }
        }
        None
    }
}
