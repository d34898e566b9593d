//! The level limits around one region, looked up once for all its leaves.

use super::max_levels::MaxLevels;
use super::{Cell, Leaves, morton};

/// The leaves of a region and of the regions that touch it.
#[derive(Debug, Clone)]
pub struct Nearby {
    finest: u8,
    /// Levels between a region and the finest cells in it.
    depth: u8,
    /// The lowest of the 3³ regions along every axis; wraps at the lower faces of the box.
    before: [u32; 3],
    /// Limits of the 3³ regions, x first. Regions outside the box are never used.
    levels: [u8; 27],
    is_uniform: bool,
}

impl Nearby {
    /// Looks up the limits around the region of a finest cell.
    #[must_use]
    pub fn new(limits: &MaxLevels, cell: [u32; 3]) -> Self {
        let finest = limits.finest();
        let depth = finest - limits.region_level();
        let before = cell.map(|i| (i >> depth).wrapping_sub(1));
        let mut near = Self { finest, depth, before, levels: [finest; 27], is_uniform: true };
        if limits.is_unlimited() {
            return near;
        }
        let here = limits.level(limits.region_of(cell));
        let last = (1_u32 << limits.region_level()) - 1;
        for (i, level) in (0..27_u32).zip(&mut near.levels) {
            let region = [i % 3, i / 3 % 3, i / 9];
            let region: [u32; 3] = std::array::from_fn(|axis| before[axis].wrapping_add(region[axis]));
            let is_inside = region.iter().all(|&i| i <= last);
            *level = if is_inside { limits.level(morton::encode(region)) } else { here };
            near.is_uniform &= *level == here;
        }
        near
    }

    /// Checks whether a finest cell lies in the central region.
    #[must_use]
    pub fn is_around(&self, cell: [u32; 3]) -> bool {
        (0..3).all(|axis| (cell[axis] >> self.depth).wrapping_sub(self.before[axis]) == 1)
    }

    /// Checks whether all leaves that touch `point` have one size, which makes it a free vertex of that size.
    ///
    /// The point must lie in the central region or on its boundary.
    #[must_use]
    #[inline]
    pub fn is_inside(&self, point: [u32; 3]) -> bool {
        self.is_uniform || point.iter().all(|i| i & ((1 << self.depth) - 1) != 0)
    }
}

impl Leaves for Nearby {
    fn finest(&self) -> u8 {
        self.finest
    }

    #[inline]
    fn leaf(&self, cell: [u32; 3]) -> Cell {
        let at = |axis: usize| (cell[axis] >> self.depth).wrapping_sub(self.before[axis]);
        let level = self.levels[(at(0) + 3 * at(1) + 9 * at(2)) as usize];
        Cell { level, index: cell.map(|i| i >> (self.finest - level)) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octree::{cells_around, coarseness, masters};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn leaves_and_vertices_near_a_region_are_those_of_the_limits(
            wanted in proptest::collection::vec((0_u64..64, 2_u8..=7), 0..8),
            cells in proptest::collection::vec(proptest::array::uniform3(0_u32..128), 20),
        ) {
            // 4³ regions of 32³ finest cells.
            let limits = MaxLevels::balanced(7, wanted);
            for cell in cells {
                let near = Nearby::new(&limits, cell);
                prop_assert!(near.is_around(cell));
                let leaf = limits.leaf(cell);
                prop_assert_eq!(near.leaf(cell), leaf);
                let (origin, edge) = leaf.extent(7);
                for c in 0..8_u32 {
                    let corner: [u32; 3] = std::array::from_fn(|axis| origin[axis] + edge * (c >> axis & 1));
                    for cell in cells_around(corner, 7) {
                        prop_assert_eq!(near.leaf(cell), limits.leaf(cell));
                        prop_assert_eq!(near.is_around(cell), limits.region_of(cell) == limits.region_of(origin));
                    }
                    let masters = masters(&limits, corner);
                    prop_assert_eq!(masters, crate::octree::masters(&near, corner));
                    // The masters touch no region farther away either.
                    for &point in masters.points() {
                        prop_assert_eq!(coarseness(&near, point), coarseness(&limits, point));
                    }
                    if near.is_inside(corner) {
                        prop_assert_eq!(masters.points(), &[corner]);
                        prop_assert_eq!(coarseness(&limits, corner), 7 - leaf.level);
                    }
                }
            }
        }
    }
}
