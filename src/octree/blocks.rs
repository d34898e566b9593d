//! The vertices of finest leaves, in blocks of 8³ lattice points with what surrounds each.
//!
//! A block is 2³ bricks, and is seen with the bricks around it. Ids of vertices of finest leaves run in Morton
//! order, so that those of a block follow each other.

use std::ops::Range;

use super::set::BrickRank;
use super::{Octree, morton};

/// Points of a brick along an axis: those around a block reach so far beyond it.
pub const BRICK: u32 = 4;
/// Points of a block along an axis.
pub const BLOCK: u32 = 2 * BRICK;
/// Bricks along an axis in and around a block.
const BRICKS: u32 = BLOCK / BRICK + 2;

/// The vertices of finest leaves in a block and in the bricks around it.
pub struct FinestBlock {
    number: [u32; 3],
    /// The last lattice point along an axis.
    last: u32,
    /// The bricks in and around the block, x fastest.
    bricks: [Option<BrickRank>; BRICKS.pow(3) as usize],
}

impl Octree {
    /// The blocks that have vertices of finest leaves, as Morton codes of their numbers, each with the ids of its
    /// vertices. Every such vertex is in one of them, and ids increase.
    pub(crate) fn finest_blocks(&self) -> Vec<(u64, Range<usize>)> {
        let mut blocks: Vec<(u64, Range<usize>)> = Vec::new();
        for (brick, mask, first) in self.vertices.finest().bricks() {
            let (code, first) = (brick >> 3, first as usize);
            let end = first + mask.count_ones() as usize;
            match blocks.last_mut() {
                Some((last, ids)) if *last == code => ids.end = end,
                _ => blocks.push((code, first..end)),
            }
        }
        blocks
    }

    /// The block of this code.
    pub(crate) fn finest_block(&self, code: u64) -> FinestBlock {
        let (number, last) = (morton::decode(code), 1 << self.finest());
        let bricks = std::array::from_fn(|i| {
            let at = [0, 1, 2].map(|axis| i as u32 / BRICKS.pow(axis) % BRICKS);
            let mut brick = [0; 3];
            for axis in 0..3 {
                brick[axis] = (BLOCK / BRICK * number[axis] + at[axis]).checked_sub(1)?;
            }
            let is_inside = brick.iter().all(|i| BRICK * i <= last);
            is_inside.then(|| self.vertices.finest().brick(morton::encode(brick))).flatten()
        });
        FinestBlock { number, last, bricks }
    }
}

impl FinestBlock {
    /// The number of the block: its points over [`BLOCK`].
    #[must_use]
    pub fn number(&self) -> [u32; 3] {
        self.number
    }

    /// Lattice points and ids of the vertices in the block and around it.
    pub fn around(&self) -> impl Iterator<Item = ([u32; 3], usize)> + '_ {
        (0..self.bricks.len()).flat_map(|i| self.vertices_of(i))
    }

    /// Lattice points and ids of the block's own vertices, in the order of their ids.
    pub fn own(&self) -> impl Iterator<Item = ([u32; 3], usize)> + '_ {
        let at = |c: u32| [0, 1, 2].map(|axis| 1 + (c >> axis & 1));
        (0..8).map(at).flat_map(|[x, y, z]| self.vertices_of((x + BRICKS * (y + BRICKS * z)) as usize))
    }

    fn vertices_of(&self, i: usize) -> impl Iterator<Item = ([u32; 3], usize)> + '_ {
        let at = [0, 1, 2].map(|axis| i as u32 / BRICKS.pow(axis) % BRICKS);
        let members = self.bricks[i].into_iter().flat_map(BrickRank::members);
        members.map(move |(slot, id)| {
            let within = morton::decode(slot);
            let point = |axis: usize| BLOCK * self.number[axis] + BRICK * at[axis] - BRICK + within[axis];
            ([0, 1, 2].map(point), id as usize)
        })
    }

    /// [`Octree::is_surrounded_by_finest`] of a point of the block.
    ///
    /// A cell is split into finest leaves just where there is a vertex at its centre.
    #[must_use]
    pub fn is_surrounded(&self, point: [u32; 3]) -> bool {
        // Centres are odd along each axis.
        let along = |axis: usize| {
            let i = point[axis];
            let (lower, upper) = if i % 2 == 1 { (Some(i), None) } else { (i.checked_sub(1), Some(i + 1)) };
            [lower, upper.filter(|i| *i <= self.last)].into_iter().flatten()
        };
        along(0).all(|x| along(1).all(|y| along(2).all(|z| self.has([x, y, z]))))
    }

    /// Whether there is a vertex at a point of the block or beside it.
    fn has(&self, point: [u32; 3]) -> bool {
        let [x, y, z] = [0, 1, 2].map(|axis| (point[axis] + BRICK - BLOCK * self.number[axis]) / BRICK);
        let brick = self.bricks[(x + BRICKS * (y + BRICKS * z)) as usize];
        brick.is_some_and(|brick| brick.rank(morton::encode(point.map(|i| i % BRICK))).is_some())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::octree::arbitrary::octrees;
    use crate::octree::coarseness;

    proptest! {
        #[test]
        fn blocks_have_what_single_lookups_find(octree in octrees()) {
            let finest: Vec<([u32; 3], usize)> = octree
                .vertex_positions()
                .zip(0..)
                .filter(|(point, _)| coarseness(octree.cells(), *point) == 0)
                .collect();
            let (mut own, mut end) = (Vec::new(), 0);
            for (code, ids) in octree.finest_blocks() {
                let block = octree.finest_block(code);
                prop_assert_eq!(morton::encode(block.number()), code);
                prop_assert_eq!((ids.start, ids.len()), (end, block.own().count()));
                end = ids.end;
                let reaches = |point: [u32; 3]| {
                    (0..3).all(|axis| (0..16).contains(&(point[axis] + 4).wrapping_sub(8 * block.number()[axis])))
                };
                let mut around: Vec<_> = block.around().collect();
                around.sort_unstable_by_key(|(_, id)| *id);
                prop_assert_eq!(around, finest.iter().copied().filter(|(at, _)| reaches(*at)).collect::<Vec<_>>());
                for (point, id) in block.own() {
                    prop_assert_eq!(block.is_surrounded(point), octree.is_surrounded_by_finest(point));
                    own.push((point, id));
                }
            }
            prop_assert_eq!(own, finest);
        }
    }
}
