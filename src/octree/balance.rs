//! Finds the cells to split so that all wanted cells exist and the octree is 2:1 balanced.

use std::ops::BitOr;

use super::masks::{MaskSet, PARENTS_AROUND_POINT, PARENTS_OF_NEIGHBORS};
use super::{Cell, morton};

/// Cells that must exist in an octree.
#[derive(Debug, Clone)]
pub struct SplitSet {
    /// Cells that must be split, by level.
    split: Vec<MaskSet>,
}

impl SplitSet {
    /// Splits nothing, not even the box, in an octree of levels 0 to `finest`.
    #[must_use]
    pub fn new(finest: u8) -> Self {
        Self { split: vec![MaskSet::default(); usize::from(finest)] }
    }

    /// Adds `cell`, as a leaf or split further.
    pub fn cell(&mut self, cell: Cell) {
        if let Some(above) = cell.level.checked_sub(1) {
            self.split[usize::from(above)].insert(morton::encode(cell.index.map(|i| i / 2)));
        }
    }

    /// Adds the up to eight finest cells around each point of a brick of the finest lattice.
    pub fn around_points(&mut self, brick: u64, mask: u64) {
        let cells = 1 << (self.split.len().saturating_sub(1));
        if let Some(parents) = self.split.last_mut() {
            parents.insert_reached(brick, mask, &PARENTS_AROUND_POINT, cells);
        }
    }

    /// Splits as few cells as possible such that every wanted cell exists and the octree is 2:1 balanced over
    /// faces, edges and corners.
    ///
    /// The children of a split cell of level ℓ have level ℓ + 1 and may touch leaves of level ℓ or finer. So
    /// the 26 neighbours of the split cell must exist, which means that their parents are split. One sweep
    /// from the finest level up is enough, because it only adds cells to coarser levels.
    #[must_use]
    pub fn balanced(mut self) -> Split {
        for level in (1..self.split.len()).rev() {
            let (above, here) = self.split.split_at_mut(level);
            for (brick, mask) in here[0].bricks() {
                above[level - 1].insert_reached(brick, mask, &PARENTS_OF_NEIGHBORS, 1 << (level - 1));
            }
        }
        Split { levels: self.split }
    }
}

/// The split cells of a balanced octree, level by level.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Split {
    levels: Vec<MaskSet>,
}

impl Split {
    /// The finest level.
    #[must_use]
    pub fn finest(&self) -> u8 {
        self.levels.len() as u8
    }

    /// The split cells of one level.
    #[must_use]
    pub fn level(&self, level: u8) -> &MaskSet {
        &self.levels[usize::from(level)]
    }

    /// Removes the finest level that is left, with its split cells.
    pub fn pop(&mut self) -> Option<(u8, MaskSet)> {
        self.levels.pop().map(|cells| (self.finest(), cells))
    }
}

impl BitOr for SplitSet {
    type Output = Self;

    /// The union of both.
    fn bitor(mut self, other: Self) -> Self {
        self.split.iter_mut().zip(other.split).for_each(|(mine, theirs)| *mine |= theirs);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octree::{around, cells_around};
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    /// The balance rule, cell by cell.
    fn balanced_slowly(finest: u8, wanted: &[Cell]) -> Vec<Vec<u64>> {
        let mut split = vec![BTreeSet::new(); usize::from(finest)];
        for cell in wanted.iter().filter(|cell| cell.level > 0) {
            split[usize::from(cell.level) - 1].insert(morton::encode(cell.index.map(|i| i / 2)));
        }
        for level in (1..usize::from(finest)).rev() {
            let last = (1_u32 << level) - 1;
            let near = split[level].iter().flat_map(|&code| around(morton::decode(code), last));
            let parents: Vec<u64> = near.map(|(cell, _)| morton::encode(cell.map(|i| i / 2))).collect();
            split[level - 1].extend(parents);
        }
        split.into_iter().map(|level| level.into_iter().collect()).collect()
    }

    fn cells(finest: u8) -> impl Strategy<Value = Vec<Cell>> {
        let cell = (0..=finest).prop_flat_map(|level| {
            let n = 1_u32 << level;
            [0..n, 0..n, 0..n].prop_map(move |index| Cell { level, index })
        });
        proptest::collection::vec(cell, 0..12)
    }

    proptest! {
        #[test]
        fn bricks_at_once_give_what_the_rule_gives(
            (finest, cells) in (1_u8..=6).prop_flat_map(|f| (Just(f), cells(f))),
        ) {
            let mut halves = [SplitSet::new(finest), SplitSet::new(finest)];
            cells.iter().enumerate().for_each(|(i, &cell)| halves[i % 2].cell(cell));
            let [a, b] = halves;
            let codes: Vec<Vec<u64>> = (a | b).balanced().levels.iter().map(MaskSet::codes).collect();
            prop_assert_eq!(codes, balanced_slowly(finest, &cells));
        }

        #[test]
        fn cells_around_points_are_those_cells(
            finest in 1_u8..=5,
            points in proptest::collection::vec(proptest::array::uniform3(0_u32..=32), 1..9),
        ) {
            let points: Vec<[u32; 3]> = points.into_iter().map(|p| p.map(|i| i.min(1 << finest))).collect();
            let (mut together, mut each) = (SplitSet::new(finest), SplitSet::new(finest));
            for &point in &points {
                let code = morton::encode(point);
                together.around_points(code >> 6, 1 << (code & 63));
                cells_around(point, finest).for_each(|index| each.cell(Cell { level: finest, index }));
            }
            prop_assert_eq!(together.balanced(), each.balanced());
        }
    }
}
