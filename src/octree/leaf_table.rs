//! The leaves of an octree, numbered so that the leaf around a point is found in a few steps.
//!
//! A table at a middle level saves the upper part of the way from the root. Below it, a split cell holds of each child
//! where the way goes on, and of children that are split into finest leaves where these begin.

use super::{Cell, CellTree};

/// Most levels that the table jumps over. It then takes 8 MB.
const MOST_JUMP: u8 = 7;

/// Where the way to a point goes on, in two bits for the kind and 30 for a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Step(u32);

impl Step {
    const KIND: u32 = 3 << 30;
    /// On to the split cell of this number.
    const NODE: u32 = 0;
    /// At the leaf of this number. In the table the level of the leaf stands above [`Step::LEVEL`].
    const LEAF: u32 = 1 << 30;
    /// In a split cell whose children are leaves of the finest level; the first has this number.
    const FINEST: u32 = 2 << 30;
    /// Leaves as large as a cell of the table, or larger, have the first numbers, fewer than 2^24.
    const LEVEL: u32 = 24;

    fn number(self) -> u32 {
        self.0 & !Self::KIND
    }

    fn kind(self) -> u32 {
        self.0 & Self::KIND
    }
}

/// Numbers of the leaves of an octree.
#[derive(Debug, Clone)]
pub struct LeafTable {
    finest: u8,
    /// Level of the table.
    jump: u8,
    /// `[8^jump]`, x fastest.
    table: Vec<Step>,
    /// The split cells above the second-finest level, with the ways to their children.
    nodes: Vec<[Step; 8]>,
    leaves: u32,
}

impl LeafTable {
    /// Largest number of leaves.
    pub const MAX_LEAVES: u64 = (1 << 30) - 1;

    /// Numbers the leaves, level by level from the coarsest, in Morton order.
    ///
    /// # Panics
    /// If there are more than [`LeafTable::MAX_LEAVES`].
    #[must_use]
    pub fn new(cells: &CellTree) -> Self {
        let (finest, split) = (cells.finest(), cells.split());
        let count = |number: usize| u32::try_from(number).ok().filter(|n| n & Step::KIND == 0).expect("below 2^30");
        let mut nodes = Vec::with_capacity(split.iter().rev().skip(1).map(Vec::len).sum());
        // The root may be a leaf, the only one.
        let mut leaves = usize::from(split[0].is_empty());
        for (level, pair) in (0_u8..).zip(split.windows(2)) {
            // Finest leaves follow all others, in the order of the cells that they are children of.
            let is_second_finest = level + 2 == finest;
            let first_below = nodes.len() + pair[0].len();
            let mut below = pair[1].iter().enumerate().peekable();
            let coarser = leaves + 8 * pair[0].len() - pair[1].len();
            for &code in &pair[0] {
                nodes.push(std::array::from_fn(|c| {
                    match below.next_if(|(_, child)| **child == code << 3 | c as u64) {
                        Some((i, _)) if is_second_finest => Step(Step::FINEST | count(coarser + 8 * i)),
                        Some((i, _)) => Step(Step::NODE | count(first_below + i)),
                        None => {
                            leaves += 1;
                            Step(Step::LEAF | count(leaves - 1))
                        }
                    }
                }));
            }
        }
        leaves += 8 * split.last().map_or(0, Vec::len);
        // The table has no more cells than there are leaves: 4 bytes for the 64 of a leaf's values.
        let jump = (leaves.ilog2() as u8 / 3).min(MOST_JUMP).min(finest.saturating_sub(2));
        let mut table = Self { finest, jump, table: Vec::new(), nodes, leaves: count(leaves) };
        let side = 1_u32 << jump;
        let corner = |i: u32| [i % side, i / side % side, i / side / side].map(|i| i << (finest - jump));
        table.table = (0..side.pow(3)).map(|i| table.descend(corner(i))).collect();
        table
    }

    /// Number of leaves.
    #[must_use]
    pub fn len(&self) -> usize {
        self.leaves as usize
    }

    /// The leaf around a finest cell, and its number.
    #[must_use]
    #[inline(always)]
    pub fn find(&self, cell: [u32; 3]) -> (Cell, usize) {
        let [x, y, z] = cell.map(|i| (i >> (self.finest - self.jump)) as usize);
        let mut step = self.table[x + (y << self.jump) + (z << (2 * self.jump))];
        let (mut level, mut number) = (self.jump, step.number());
        if step.kind() == Step::LEAF {
            (level, number) = ((number >> Step::LEVEL) as u8, number & ((1 << Step::LEVEL) - 1));
        }
        while step.kind() == Step::NODE {
            level += 1;
            step = self.nodes[step.number() as usize][self.child(cell, level)];
            number = step.number();
        }
        if step.kind() == Step::FINEST {
            level = self.finest;
            number += self.child(cell, level) as u32;
        }
        (Cell { level, index: cell.map(|i| i >> (self.finest - level)) }, number as usize)
    }

    /// Which child the cell of some level around a finest cell is.
    #[inline]
    fn child(&self, cell: [u32; 3], level: u8) -> usize {
        let shift = self.finest - level;
        (cell[0] >> shift & 1 | (cell[1] >> shift & 1) << 1 | (cell[2] >> shift & 1) << 2) as usize
    }

    /// The way from the root to the table's level.
    fn descend(&self, cell: [u32; 3]) -> Step {
        let mut step = match (self.nodes.is_empty(), self.leaves) {
            (true, 1) => Step(Step::LEAF),
            (true, _) => Step(Step::FINEST),
            (false, _) => Step(Step::NODE),
        };
        for level in 1..=self.jump {
            if step.kind() != Step::NODE {
                break;
            }
            step = self.nodes[step.number() as usize][self.child(cell, level)];
            if step.kind() == Step::LEAF {
                assert!(step.number() >> Step::LEVEL == 0, "coarse leaves come first");
                step.0 |= u32::from(level) << Step::LEVEL;
                break;
            }
        }
        step
    }

    /// Bytes on the heap, spare capacity included.
    #[must_use]
    pub fn heap_bytes(&self) -> usize {
        self.table.capacity() * size_of::<Step>() + self.nodes.capacity() * size_of::<[Step; 8]>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octree::Octree;
    use crate::octree::arbitrary::octrees;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_cell_finds_its_leaf_and_every_leaf_has_its_number(octree in octrees()) {
            let (cells, finest) = (octree.cells(), octree.finest());
            let table = LeafTable::new(cells);
            let mut numbers = vec![None; table.len()];
            let side = 1_u32 << finest.min(4);
            let scale = 1_u32 << (finest - finest.min(4));
            for i in 0..side.pow(3) {
                let cell = [i % side, i / side % side, i / side / side].map(|i| i * scale);
                let (leaf, number) = table.find(cell);
                prop_assert_eq!(leaf, cells.leaf(cell));
                prop_assert_eq!(*numbers[number].get_or_insert(leaf), leaf);
            }
            let mut leaves = 0;
            cells.for_each_leaf(|_| leaves += 1);
            prop_assert_eq!(table.len(), leaves);
        }
    }

    #[test]
    fn an_octree_of_one_cell_has_one_leaf() {
        let octree = Octree::refined(3, []);
        let table = LeafTable::new(octree.cells());
        assert_eq!(table.len(), 1);
        assert_eq!(table.find([7, 0, 3]), (Cell { level: 0, index: [0; 3] }, 0));
    }

    #[test]
    fn leaves_below_the_table_are_found() {
        // One cell of level 9; its few leaves make a small table.
        let octree = Octree::refined(9, [Cell { level: 9, index: [300, 5, 511] }]);
        let table = LeafTable::new(octree.cells());
        let mut found = vec![false; table.len()];
        octree.cells().for_each_leaf(|leaf| {
            let (same, number) = table.find(leaf.extent(9).0);
            assert_eq!(same, leaf);
            assert!(!std::mem::replace(&mut found[number], true), "{leaf:?} has the number of another");
        });
        assert!(found.iter().all(|&found| found));
    }
}
