//! From sums to an octree: where its leaves must be as fine as the sums.

use rayon::prelude::*;

use super::{OctreePosterior, bricks};
use crate::octree::{Cell, Leaves, Octree, around, cells_around, morton};
use crate::posterior::{Evidence, Pooling, trace};

/// Where an octree is refined.
#[derive(Debug, Clone, PartialEq)]
pub struct Refinement {
    /// Refine around vertices with more information (tr S) than this; `None` does not refine by sensitivity.
    pub floor: Option<f64>,
    /// Also around vertices that have it after pooling.
    pub pooling: Pooling,
    /// Cells that must exist for other reasons; limits hold for them too.
    pub wanted: Vec<Cell>,
}

impl OctreePosterior {
    /// The octree whose leaves are as fine as the sums around every vertex that `refinement` asks for, with the evidence of its
    /// vertices in the order of their ids.
    ///
    /// A floor of 0 keeps every vertex that any ray moved. At vertices surrounded by leaves of their own limit the evidence is
    /// exact (that of the dense grid, on the finest lattice); at all others the information is negligible in the sense of the
    /// floor.
    #[must_use]
    pub fn into_octree(self, refinement: &Refinement) -> (Octree, Vec<Evidence>) {
        let finest = self.lattice.level();
        // Keys are points of their own level's lattice: sorted and unique they are points in any order.
        let mut moved: Vec<u64> = match refinement.floor {
            Some(floor) => {
                self.bricks.par_iter().filter(|(_, e)| trace(&e.information) > floor).map(|(key, _)| key).collect()
            }
            None => Vec::new(),
        };
        moved.par_sort_unstable();
        if refinement.pooling.is_on() {
            let more = self.moved_by_pooling(&moved, refinement);
            moved.extend(more);
        }
        let mut leaves: Vec<(u8, u64)> = moved
            .par_chunks(64)
            .flat_map_iter(|keys| {
                let around = keys.iter().flat_map(|&key| cells_around(bricks::point(key), finest));
                let mut leaves: Vec<(u8, u64)> = around.map(|cell| self.leaf_code(cell)).collect();
                leaves.sort_unstable();
                leaves.dedup();
                leaves
            })
            .collect();
        drop(moved);
        leaves.extend(refinement.wanted.iter().map(|&cell| {
            let (origin, _) = cell.extent(finest);
            let limit = self.limits.leaf(origin);
            let wanted = if limit.level < cell.level { limit } else { cell };
            (wanted.level, morton::encode(wanted.index))
        }));
        leaves.par_sort_unstable();
        leaves.dedup();
        let wanted = leaves.iter().map(|&(level, code)| Cell { level, index: morton::decode(code) });
        let octree = Octree::refined(finest, wanted);
        drop(leaves);
        let positions: Vec<[u32; 3]> = octree.vertex_positions().collect();
        let sums = positions.par_iter().map(|&point| self.evidence(point)).collect();
        (octree, sums)
    }

    fn leaf_code(&self, cell: [u32; 3]) -> (u8, u64) {
        let leaf = self.limits.leaf(cell);
        (leaf.level, morton::encode(leaf.index))
    }

    /// Vertices of the finest lattice beside `moved` (sorted keys) that pooling moves.
    fn moved_by_pooling(&self, moved: &[u64], refinement: &Refinement) -> Vec<u64> {
        let last = self.lattice.cells_per_axis();
        let is_finest = |key: &u64| bricks::key(bricks::point(*key), 0) == *key;
        let mut beside: Vec<u64> = moved
            .par_chunks(64)
            .flat_map_iter(|keys| {
                let near = keys.iter().filter(|key| is_finest(key)).flat_map(|&key| around(bricks::point(key), last));
                let mut near: Vec<u64> = near.map(|(point, _)| bricks::key(point, 0)).collect();
                near.sort_unstable();
                near.dedup();
                near.retain(|key| moved.binary_search(key).is_err() && self.coarseness(bricks::point(*key)) == 0);
                near
            })
            .collect();
        beside.par_sort_unstable();
        beside.dedup();
        let floor = refinement.pooling.floor;
        let at = |point| self.bricks.get(bricks::key(point, 0)).copied();
        let is_moved = |key: &u64| {
            let pooled = refinement.pooling.pooled(bricks::point(*key), last, at);
            trace(&pooled.information) > floor
        };
        beside.into_par_iter().filter(is_moved).collect()
    }
}
