//! The octree posterior: information only where rays were sensitive, in one pass, without a guess beforehand.
//!
//! Rays are summed on leaves that are as fine as [`MaxLevels`] allow: on the finest lattice, unless rays or memory cannot support it
//! somewhere. Only [bricks] of vertices that some sensitive sample touched exist. At the end the octree is refined around every
//! vertex that moved from the prior by more than the tolerance; everywhere else the field is the prior to within the tolerance,
//! and leaves stay as coarse as 2:1 balance lets them. Nothing is ever accumulated at a vertex that later turns out to need
//! splitting, so the outcome does not depend on the order in which space is discovered.
//!
//! On limited leaves a corner may hang on a larger leaf. Its share of J goes to the ends that it is interpolated from, before
//! squaring: J of a free vertex gathers what its hanging dependants would have received ([walk]).
//!
//! Threads: rays of a batch are squared ([squares], [walk]) in parallel into [lists] of contributions, one for each shard; then shards add theirs in
//! parallel, each in ray order. Every sum therefore sees its contributions in ray order, whatever the number of threads.

mod bricks;
mod lists;
mod pilot_counts;
mod refine;
mod squares;
mod walk;

pub use bricks::Brick;
pub use pilot_counts::PilotCounts;
pub use refine::Refinement;

use bricks::{Bricks, key};
use lists::Contributions;
use rayon::prelude::*;
use walk::Walk;

use super::{Posterior, VertexSums};
use crate::geometry::Lattice;
use crate::octree::{Leaves, MaxLevels, coarseness};
use crate::render::RaySamples;

/// Information summed in sparse bricks.
#[derive(Debug, Clone)]
pub struct OctreePosterior {
    lattice: Lattice,
    limits: MaxLevels,
    bricks: Bricks,
}

impl OctreePosterior {
    /// No information yet, and no limit but the lattice.
    #[must_use]
    pub fn new(lattice: Lattice) -> Self {
        Self::limited(lattice, MaxLevels::none(lattice.level()))
    }

    /// No information yet, to be gathered on the leaves of `limits`.
    ///
    /// # Panics
    /// If the limits are those of another level.
    #[must_use]
    pub fn limited(lattice: Lattice, limits: MaxLevels) -> Self {
        assert_eq!(limits.finest(), lattice.level(), "limits belong to the lattice's level");
        Self { lattice, limits, bricks: Bricks::new() }
    }

    /// How fine leaves may be.
    #[must_use]
    pub fn limits(&self) -> &MaxLevels {
        &self.limits
    }

    /// Brick codes, in the order in which [`OctreePosterior::slices`] returns their sums.
    pub(crate) fn brick_codes(&self) -> impl Iterator<Item = u64> + '_ {
        self.bricks.codes()
    }

    /// The sums, slice by slice.
    pub(crate) fn slices(&self) -> impl Iterator<Item = &[Brick]> {
        self.bricks.slices()
    }

    /// Puts back what [`OctreePosterior::brick_codes`] and [`OctreePosterior::slices`] gave, in the same order.
    ///
    /// `None` if a code lies outside the lattice or comes twice.
    pub(crate) fn restore(lattice: Lattice, limits: MaxLevels, codes: &[u64], bricks: Vec<Brick>) -> Option<Self> {
        let bricks = Bricks::restore(lattice.cells_per_axis(), codes, bricks)?;
        Some(Self { lattice, limits, bricks })
    }

    /// Adds evidence at a lattice point: a part of another run.
    pub fn add_sums_at(&mut self, point: [u32; 3], sums: &VertexSums) {
        self.bricks.add_one(key(point, self.coarseness(point)), sums);
    }

    /// Adds the sums over other rays on the same leaves, vertex by vertex.
    pub fn add_bricks(&mut self, other: &Self) {
        self.bricks.absorb(&other.bricks);
    }

    /// The evidence summed so far at a lattice point.
    #[must_use]
    pub fn sums(&self, point: [u32; 3]) -> VertexSums {
        self.bricks.get(key(point, self.coarseness(point))).copied().unwrap_or_default()
    }

    /// Every vertex that a ray touched, with its lattice point.
    #[must_use = "iterators are lazy"]
    pub fn touched(&self) -> impl ParallelIterator<Item = ([u32; 3], &VertexSums)> {
        self.bricks.par_iter().filter(|(_, e)| e.rays > 0).map(|(key, e)| (bricks::point(key), e))
    }

    /// Levels between the finest and that of the finest leaf which has `point` as a corner.
    ///
    /// A point that is a corner of no leaf of that level belongs to none: it has no evidence under any key.
    fn coarseness(&self, point: [u32; 3]) -> u8 {
        if self.limits.is_unlimited() {
            return 0;
        }
        coarseness(&self.limits, point)
    }

    /// Squares every ray of a batch.
    fn contributions(&self, batch: &RaySamples) -> Contributions {
        let finest = self.limits.is_unlimited();
        let (mut places, mut walk) = (Vec::new(), Walk::new(&self.lattice, &self.limits));
        let mut all = Contributions::new(8 * batch.positions.len());
        for (_, samples) in batch.iter() {
            if finest && squares::places(&self.lattice, batch, samples.clone(), &mut places) {
                squares::along(&places, batch, &mut all);
            } else {
                walk.ray(batch, samples, &mut all);
            }
        }
        all
    }
}

impl Posterior for OctreePosterior {
    fn add(&mut self, batches: &[RaySamples]) {
        let lists: Vec<_> = batches.par_iter().map(|batch| self.contributions(batch)).collect();
        self.bricks.add(&lists);
    }

    fn memory(&self) -> usize {
        self.bricks.memory()
    }
}

#[cfg(test)]
mod tests;
