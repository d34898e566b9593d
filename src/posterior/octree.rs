//! The octree posterior: information only where rays were sensitive, in one pass, without a guess beforehand.
//!
//! Information is summed on the finest lattice, but only in aligned 4³ bricks of lattice points that some sensitive sample
//! touched. At the end the octree is refined to the finest level around every vertex that moved from the prior by more than
//! the tolerance; everywhere else the field is the prior to within the tolerance, and leaves stay as coarse as 2:1 balance
//! lets them. Nothing is ever accumulated at a coarse vertex that later turns out to need splitting, so the outcome does not
//! depend on the order in which space is discovered.
//!
//! Threads: rays of a batch are squared in parallel into one list of contributions per shard (a shard owns the bricks that
//! hash to it); then shards add their lists in parallel, each in ray order. Every sum therefore sees its contributions in
//! ray order, whatever the number of threads.

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::covariance::negligible_information;
use super::{Evidence, Posterior, trace};
use crate::geometry::Lattice;
use crate::octree::{Cell, Octree, cells_around, morton, trilinear};
use crate::render::RaySamples;

/// Shards: enough to keep many cores busy, few enough that their lists stay long.
const SHARD_BITS: u32 = 6;
const SHARDS: usize = 1 << SHARD_BITS;

/// What one ray adds to one vertex.
#[derive(Clone, Copy)]
struct Contribution {
    /// Morton code of the lattice point.
    vertex: u64,
    sums: Evidence,
}

/// The bricks that hash to one shard.
#[derive(Debug, Clone, Default)]
struct Shard {
    /// Brick code (vertex code without its low 6 bits) to position in `bricks`.
    index: FxHashMap<u64, u32>,
    /// Brick codes, in the order in which rays first touched them.
    codes: Vec<u64>,
    /// Sums of the 64 lattice points of each brick, in Morton order.
    bricks: Vec<Brick>,
}

/// Sums of the lattice points of an aligned 4³ brick.
pub type Brick = [Evidence; 64];

impl Shard {
    /// The sum of a lattice point, zero if it is new.
    fn sum_mut(&mut self, vertex: u64) -> &mut Evidence {
        let next = self.bricks.len() as u32;
        let slot = *self.index.entry(vertex >> 6).or_insert(next);
        if slot == next {
            self.codes.push(vertex >> 6);
            self.bricks.push([Evidence::default(); 64]);
        }
        &mut self.bricks[slot as usize][(vertex & 63) as usize]
    }

    fn add(&mut self, contribution: &Contribution) {
        self.sum_mut(contribution.vertex).add(&contribution.sums);
    }

    fn get(&self, vertex: u64) -> Option<&Evidence> {
        let slot = *self.index.get(&(vertex >> 6))?;
        Some(&self.bricks[slot as usize][(vertex & 63) as usize])
    }

    fn memory(&self) -> usize {
        // hashbrown: one control byte and one (u64, u32) pair, padded to 16, per bucket.
        self.bricks.capacity() * size_of::<Brick>() + self.codes.capacity() * 8 + self.index.capacity() * 8 / 7 * 17
    }
}

fn shard_of(vertex: u64) -> usize {
    // Fibonacci hashing of the brick code (Knuth, TAOCP 3, 6.4).
    ((vertex >> 6).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> (64 - SHARD_BITS)) as usize
}

/// Information summed in sparse bricks of the finest lattice.
#[derive(Debug, Clone)]
pub struct OctreePosterior {
    lattice: Lattice,
    shards: Vec<Shard>,
}

impl OctreePosterior {
    /// No information yet.
    #[must_use]
    pub fn new(lattice: Lattice) -> Self {
        Self { lattice, shards: vec![Shard::default(); SHARDS] }
    }

    /// The codes of all bricks, in the order in which [`OctreePosterior::bricks`] returns their sums.
    pub(super) fn brick_codes(&self) -> impl Iterator<Item = u64> + '_ {
        self.shards.iter().flat_map(|shard| shard.codes.iter().copied())
    }

    /// The sums, one slice per shard.
    pub(super) fn bricks(&self) -> impl Iterator<Item = &[Brick]> {
        self.shards.iter().map(|shard| shard.bricks.as_slice())
    }

    /// Puts back what [`OctreePosterior::brick_codes`] and [`OctreePosterior::bricks`] gave, in the same order.
    ///
    /// `None` if a code lies outside the lattice or comes twice.
    pub(super) fn restore(lattice: Lattice, codes: &[u64], bricks: Vec<Brick>) -> Option<Self> {
        let mut posterior = Self::new(lattice);
        let last = lattice.cells_per_axis() / 4;
        for (&code, brick) in codes.iter().zip(bricks) {
            let shard = &mut posterior.shards[shard_of(code << 6)];
            let inside = code >> 57 == 0 && morton::decode(code).iter().all(|&i| i <= last);
            if !inside || shard.index.insert(code, shard.bricks.len() as u32).is_some() {
                return None;
            }
            shard.codes.push(code);
            shard.bricks.push(brick);
        }
        Some(posterior)
    }

    /// Adds evidence at a lattice point: a part of another run.
    pub fn add_evidence(&mut self, point: [u32; 3], evidence: &Evidence) {
        let vertex = morton::encode(point);
        self.shards[shard_of(vertex)].sum_mut(vertex).add(evidence);
    }

    /// The evidence summed so far at a lattice point.
    #[must_use]
    pub fn evidence(&self, point: [u32; 3]) -> Evidence {
        let code = morton::encode(point);
        self.shards[shard_of(code)].get(code).copied().unwrap_or_default()
    }

    /// Squares every ray of a batch: one list per shard, in ray order.
    fn contributions(&self, batch: &RaySamples) -> Vec<Vec<Contribution>> {
        let mut lists = vec![Vec::new(); SHARDS];
        // (vertex, sample's place in the ray, trilinear weight): sorting brings a vertex's samples together in ray order.
        let mut touched: Vec<(u64, u32, f64)> = Vec::new();
        for (_, samples) in batch.iter() {
            touched.clear();
            for i in samples {
                let Some(u) = self.lattice.coordinates(batch.positions[i]) else { continue };
                let (cell, offset) = self.lattice.cell(u);
                for (c, weight) in trilinear(offset).into_iter().enumerate() {
                    let point = std::array::from_fn(|axis| cell[axis] + (c as u32 >> axis & 1));
                    touched.push((morton::encode(point), i as u32, weight));
                }
            }
            touched.sort_unstable_by_key(|&(vertex, sample, _)| (vertex, sample));
            for group in touched.chunk_by(|a, b| a.0 == b.0) {
                let (mut j, mut gradient) = ([0.0; 9], DVec3::ZERO);
                for &(_, sample, weight) in group {
                    for (j, &g) in j.iter_mut().zip(&batch.jacobians[sample as usize]) {
                        *j += weight * f64::from(g);
                    }
                    gradient += weight * Vec3::from_array(batch.gradients[sample as usize]).as_dvec3();
                }
                let vertex = group[0].0;
                let sums = Evidence { information: gram(&j), gradient: gradient.as_vec3().to_array(), rays: 1 };
                lists[shard_of(vertex)].push(Contribution { vertex, sums });
            }
        }
        lists
    }

    /// The octree that is finest around every vertex whose information exceeds what `tolerance` (in log10 U) allows to
    /// neglect, with the evidence of its vertices in the order of their ids.
    ///
    /// `tolerance` 0 keeps every vertex that any ray moved. At vertices surrounded by finest leaves the information is that of
    /// the dense grid; at all others it is negligible in the same sense.
    #[must_use]
    pub fn into_octree(self, rays: u64, lambda: f64, tolerance: f64) -> (Octree, Vec<Evidence>) {
        let negligible = negligible_information(tolerance, rays, lambda);
        let level = self.lattice.level();
        let mut finest: Vec<u64> = self
            .shards
            .par_iter()
            .flat_map_iter(|shard| shard.index.iter().map(move |(&brick, &slot)| (brick, &shard.bricks[slot as usize])))
            .flat_map_iter(|(brick, sums)| {
                let moved = (0..64_u64)
                    .filter(|&i| trace(&sums[i as usize].information) > negligible)
                    .map(move |i| brick << 6 | i);
                let around = moved.flat_map(|vertex| cells_around(morton::decode(vertex), level));
                let mut cells: Vec<u64> = around.map(morton::encode).collect();
                cells.sort_unstable();
                cells.dedup();
                cells
            })
            .collect();
        finest.par_sort_unstable();
        finest.dedup();
        let wanted = finest.iter().map(|&code| Cell { level, index: morton::decode(code) });
        let octree = Octree::refined(level, wanted);
        let positions: Vec<[u32; 3]> = octree.vertex_positions().collect();
        let sums = positions.par_iter().map(|&point| self.evidence(point)).collect();
        (octree, sums)
    }
}

/// JᵀJ of a 3×3 Jacobian given row by row: xx, xy, xz, yy, yz, zz.
fn gram(j: &[f64; 9]) -> super::Information {
    let dot = |a: usize, b: usize| j[a] * j[b] + j[3 + a] * j[3 + b] + j[6 + a] * j[6 + b];
    [dot(0, 0), dot(0, 1), dot(0, 2), dot(1, 1), dot(1, 2), dot(2, 2)]
}

impl Posterior for OctreePosterior {
    fn add(&mut self, batches: &[RaySamples]) {
        let contributions: Vec<_> = batches.par_iter().map(|batch| self.contributions(batch)).collect();
        self.shards.par_iter_mut().enumerate().for_each(|(s, shard)| {
            contributions.iter().flat_map(|lists| &lists[s]).for_each(|contribution| shard.add(contribution));
        });
    }

    fn memory(&self) -> usize {
        self.shards.iter().map(Shard::memory).sum()
    }
}

#[cfg(test)]
mod tests;
