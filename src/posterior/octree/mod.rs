//! The octree posterior: information only where rays were sensitive, in one pass, without a guess beforehand.
//!
//! Rays are summed on leaves that are as fine as [`LevelLimits`] allow: on the finest lattice, unless rays or memory cannot support it
//! somewhere. Only [bricks] of vertices that some sensitive sample touched exist. At the end the octree is refined around every
//! vertex that moved from the prior by more than the tolerance; everywhere else the field is the prior to within the tolerance,
//! and leaves stay as coarse as 2:1 balance lets them. Nothing is ever accumulated at a vertex that later turns out to need
//! splitting, so the outcome does not depend on the order in which space is discovered.
//!
//! On limited leaves a corner may hang on a larger leaf. Its share of J goes to the ends that it is interpolated from, before
//! squaring: J of a free vertex gathers what its hanging dependants would have received.
//!
//! Threads: rays of a batch are [squared](squares) in parallel into one list of contributions; then shards add their lists in
//! parallel, each in ray order. Every sum therefore sees its contributions in ray order, whatever the number of threads.

mod bricks;
mod refine;
mod squares;
mod survey;

pub use bricks::Brick;
pub use refine::Refinement;
pub use survey::Survey;

use bricks::{Bricks, Contribution, Contributions, key};
use std::ops::Range;

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use squares::{Partial, Row};

use super::{Evidence, Posterior};
use crate::geometry::Lattice;
use crate::octree::{Leaves, LevelLimits, cells_around, masters, trilinear};
use crate::render::RaySamples;

/// Information summed in sparse bricks.
#[derive(Debug, Clone)]
pub struct OctreePosterior {
    lattice: Lattice,
    limits: LevelLimits,
    bricks: Bricks,
}

impl OctreePosterior {
    /// No information yet, and no limit but the lattice.
    #[must_use]
    pub fn new(lattice: Lattice) -> Self {
        Self::limited(lattice, LevelLimits::none(lattice.level()))
    }

    /// No information yet, to be gathered on the leaves of `limits`.
    ///
    /// # Panics
    /// If the limits are those of another level.
    #[must_use]
    pub fn limited(lattice: Lattice, limits: LevelLimits) -> Self {
        assert_eq!(limits.finest(), lattice.level(), "limits belong to the lattice's level");
        Self { lattice, limits, bricks: Bricks::new() }
    }

    /// How fine leaves may be.
    #[must_use]
    pub fn limits(&self) -> &LevelLimits {
        &self.limits
    }

    /// Brick codes, in the order in which [`OctreePosterior::slices`] returns their sums.
    pub(super) fn brick_codes(&self) -> impl Iterator<Item = u64> + '_ {
        self.bricks.codes()
    }

    /// The sums, one slice per shard.
    pub(super) fn slices(&self) -> impl Iterator<Item = &[Brick]> {
        self.bricks.slices()
    }

    /// Puts back what [`OctreePosterior::brick_codes`] and [`OctreePosterior::slices`] gave, in the same order.
    ///
    /// `None` if a code lies outside the lattice or comes twice.
    pub(super) fn restore(lattice: Lattice, limits: LevelLimits, codes: &[u64], bricks: Vec<Brick>) -> Option<Self> {
        let bricks = Bricks::restore(lattice.cells_per_axis(), codes, bricks)?;
        Some(Self { lattice, limits, bricks })
    }

    /// Adds evidence at a lattice point: a part of another run.
    pub fn add_evidence(&mut self, point: [u32; 3], evidence: &Evidence) {
        self.bricks.add_one(key(point, self.coarseness(point)), evidence);
    }

    /// Adds the sums over other rays on the same leaves, vertex by vertex.
    pub fn add_bricks(&mut self, other: &Self) {
        self.bricks.absorb(&other.bricks);
    }

    /// The evidence summed so far at a lattice point.
    #[must_use]
    pub fn evidence(&self, point: [u32; 3]) -> Evidence {
        self.bricks.get(key(point, self.coarseness(point))).copied().unwrap_or_default()
    }

    /// Every vertex that a ray touched, with its lattice point.
    #[must_use = "iterators are lazy"]
    pub fn touched(&self) -> impl ParallelIterator<Item = ([u32; 3], &Evidence)> {
        self.bricks.par_iter().filter(|(_, e)| e.rays > 0).map(|(key, e)| (bricks::point(key), e))
    }

    /// Levels between the finest and that of the finest leaf which has `point` as a corner.
    ///
    /// A point that is a corner of no leaf of that level belongs to none: it has no evidence under any key.
    fn coarseness(&self, point: [u32; 3]) -> u8 {
        if self.limits.is_unlimited() {
            return 0;
        }
        let finest = self.limits.finest();
        let levels = cells_around(point, finest).map(|cell| finest - self.limits.leaf(cell).level);
        let coarseness = levels.min().unwrap_or(0);
        // A finer key than the point's leaves have would collide with none, a coarser one with another point.
        point.iter().fold(coarseness, |c, i| c.min(i.trailing_zeros().min(32) as u8))
    }

    /// The vertices that a sample touches with their weights: the corners of the leaf around it, hanging ones resolved.
    fn for_each_vertex(&self, x: Vec3, mut visit: impl FnMut(u64, f64)) {
        let Some(u) = self.lattice.coordinates(x) else { return };
        let (cell, offset) = self.lattice.cell(u);
        if self.limits.is_unlimited() {
            for (c, weight) in trilinear(offset).into_iter().enumerate() {
                visit(key(std::array::from_fn(|axis| cell[axis] + (c as u32 >> axis & 1)), 0), weight);
            }
            return;
        }
        let leaf = self.limits.leaf(cell);
        let (origin, edge) = leaf.extent(self.limits.finest());
        let offset = (u - DVec3::from(origin.map(f64::from))) / f64::from(edge);
        for (c, weight) in trilinear(offset).into_iter().enumerate() {
            let corner = std::array::from_fn(|axis| origin[axis] + edge * (c as u32 >> axis & 1));
            let masters = masters(&self.limits, corner);
            let weight = weight / masters.points().len() as f64;
            masters.points().iter().for_each(|&point| visit(key(point, self.coarseness(point)), weight));
        }
    }

    /// Squares every ray of a batch.
    fn contributions(&self, batch: &RaySamples) -> Contributions {
        let finest = self.limits.is_unlimited();
        let (mut places, mut touched) = (Vec::new(), Vec::new());
        let mut all: Vec<Contribution> = Vec::with_capacity(4 * batch.positions.len());
        for (_, samples) in batch.iter() {
            if finest && squares::places(&self.lattice, batch, samples.clone(), &mut places) {
                squares::along(&places, batch, &mut all);
            } else {
                self.gather(batch, samples, &mut touched, &mut all);
            }
        }
        Contributions::new(all)
    }

    /// Squares one ray on any leaves: what its samples touch is sorted by vertex.
    fn gather(&self, batch: &RaySamples, samples: Range<usize>, touched: &mut Vec<Touch>, out: &mut Vec<Contribution>) {
        touched.clear();
        for i in samples {
            self.for_each_vertex(batch.positions[i], |key, weight| touched.push((key, i as u32, weight)));
        }
        touched.sort_unstable_by(|a, b| (a.0, a.1).cmp(&(b.0, b.1)).then(a.2.total_cmp(&b.2)));
        for group in touched.chunk_by(|a, b| a.0 == b.0) {
            let mut partial = Partial::default();
            for &(_, sample, weight) in group {
                partial.add(weight, &Row::of(batch, sample as usize));
            }
            out.push(Contribution { key: group[0].0, sums: partial.squared() });
        }
    }
}

/// (vertex, sample's index, weight): sorting brings a vertex's samples together in ray order.
type Touch = (u64, u32, f64);

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
