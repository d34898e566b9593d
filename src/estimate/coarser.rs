//! Leaves that stay coarser where rays are few, by a pilot.

use super::{GridSettings, RaySettings};
use crate::Result;
use crate::geometry::Lattice;
use crate::monitor::Monitor;
use crate::octree::MaxLevels;
use crate::posterior::Touches;
use crate::rays::{Purpose, RayStream, RunProgress, Shard};

/// Maximal number of rays of the pilot.
const PILOT: u64 = 16_384;

/// The leaves of a run.
#[derive(Debug, Clone)]
pub(super) struct CoarserLeaves {
    /// The maximal level of leaves, by region.
    pub limits: MaxLevels,
    /// Rays per vertex required by these limits.
    pub rays_per_vertex: f64,
    /// Fractions of all touches by the number of levels given up: 0, 1, 2, …
    pub given_up: Vec<f64>,
}

impl CoarserLeaves {
    /// By a pilot with the run's settings but another seed. All shards of a run use the same pilot.
    ///
    /// # Errors
    /// As [`RayStream::run`].
    pub fn new(
        settings: &GridSettings,
        rays: &RaySettings,
        stream: &RayStream,
        lattice: Lattice,
        monitor: &dyn Monitor,
    ) -> Result<Self> {
        let (pilot, mut touches) = (rays.rays.min(PILOT), Touches::new(lattice));
        let stream = stream.for_purpose(Purpose::Pilot);
        stream.run(Shard::whole(pilot), RunProgress::default(), monitor, |batches, _| {
            touches.add(batches);
            Ok(())
        })?;
        let (counts, rays_per_vertex) = (touches.counts(), settings.ray_count);
        let limits = counts.limits(rays.rays as f64 / pilot as f64, rays_per_vertex);
        Ok(Self { given_up: counts.shares(&limits), limits, rays_per_vertex })
    }
}
