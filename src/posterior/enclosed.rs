//! Which points of a block lie among vertices that moved.
//!
//! A point is *near* if it moved, or is next to one that did. It is *enclosed* if each of the up to eight finest cells
//! around it has a parent that touches a near point. These are the near points, and what lies in gaps between them. An
//! octree that is refined around the near points has finest leaves around all of them, because leaves come by eights.

use super::means::{BLOCK, HALO, SIDE};

/// Bits of the points along x, at every y and z of a block and of its halo.
type Rows = [[u32; SIDE as usize]; SIDE as usize];

/// The enclosed points of a block: a word for each z, with bit x + 8 y.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Enclosed([u64; BLOCK as usize]);

impl Enclosed {
    /// From the places that moved among those of a block and of its halo. The block starts at `origin`, and the lattice
    /// ends at {`last`}³.
    #[must_use]
    pub fn new(moved: impl IntoIterator<Item = [u32; 3]>, origin: [u32; 3], last: u32) -> Self {
        let mut rows: Rows = Default::default();
        moved.into_iter().for_each(|[x, y, z]| rows[z as usize][y as usize] |= 1 << x);
        // Cells have the place of their lower corner. What lies beyond the lattice encloses.
        let near = shifted(&shifted(&rows, -1, |a, b| a | b), 1, |a, b| a | b);
        let mut cells = siblings(&shifted(&near, 1, |a, b| a | b));
        let beyond = origin.map(|from| {
            let is_beyond = |i: u32| (from + i).checked_sub(HALO).is_none_or(|cell| cell >= last);
            (0..SIDE).filter(|i| is_beyond(*i)).fold(0_u32, |bits, i| bits | 1 << i)
        });
        for (z, plane) in cells.iter_mut().enumerate() {
            for (y, row) in plane.iter_mut().enumerate() {
                *row |= if (beyond[1] >> y | beyond[2] >> z) & 1 == 1 { u32::MAX } else { beyond[0] };
            }
        }
        let enclosed = shifted(&cells, -1, |a, b| a & b);
        let (low, edge) = (HALO as usize, BLOCK as usize);
        let words = std::array::from_fn(|z| {
            let plane = &enclosed[low + z][low..low + edge];
            plane.iter().rev().fold(0, |word, row| word << BLOCK | u64::from(row >> HALO & 0xff))
        });
        Self(words)
    }

    /// Whether a place in the block is enclosed.
    #[must_use]
    pub fn has(&self, [x, y, z]: [u32; 3]) -> bool {
        self.0[z as usize] >> (x + BLOCK * y) & 1 == 1
    }
}

/// Joins every cell with those of the same parent. A block and its halo begin with a parent.
fn siblings(cells: &Rows) -> Rows {
    let pairs = |row: u32| {
        let lower = (row | row >> 1) & 0x5555_5555;
        lower | lower << 1
    };
    let place = |z: usize, y: usize| pairs(cells[z][y]);
    std::array::from_fn(|z| {
        std::array::from_fn(|y| place(z, y) | place(z ^ 1, y) | place(z, y ^ 1) | place(z ^ 1, y ^ 1))
    })
}

/// Joins every point with the next (`step` 1) or the one before (−1) along each axis.
fn shifted(rows: &Rows, step: i32, join: fn(u32, u32) -> u32) -> Rows {
    let beside = |i: usize| i.checked_add_signed(step as isize).filter(|i| *i < SIDE as usize);
    let along_x = rows.map(|plane| plane.map(|row| join(row, if step > 0 { row >> 1 } else { row << 1 })));
    let along_y = along_x.map(|plane| std::array::from_fn(|y| join(plane[y], beside(y).map_or(0, |y| plane[y]))));
    let plane = |z: usize| beside(z).map_or([0; SIDE as usize], |z| along_y[z]);
    std::array::from_fn(|z| {
        let next: [u32; SIDE as usize] = plane(z);
        std::array::from_fn(|y| join(along_y[z][y], next[y]))
    })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;
    use crate::octree::{around, cells_around};

    proptest! {
        #[test]
        fn each_cell_around_an_enclosed_point_has_a_parent_that_touches_a_near_one(
            level in 1_u32..=5,
            number in proptest::array::uniform3(0_u32..4),
            moved in proptest::collection::vec(proptest::array::uniform3(0_u32..=32), 0..40),
        ) {
            let last = 1 << level;
            let number = number.map(|i| i.min(last / BLOCK));
            let origin = number.map(|i| i * BLOCK);
            let moved: BTreeSet<[u32; 3]> = moved.into_iter().map(|at| at.map(|i| i.min(last))).collect();
            let places = moved.iter().map(|at| [0, 1, 2].map(|axis| (at[axis] + HALO).wrapping_sub(origin[axis])));
            let found = Enclosed::new(places.filter(|at| at.iter().all(|i| *i < SIDE)), origin, last);

            let is_near = |point| around(point, last).any(|(near, _)| moved.contains(&near));
            let has_near_parent = |cell: [u32; 3]| {
                (0..27_u32).any(|c| is_near([0, 1, 2].map(|axis| cell[axis] / 2 * 2 + c / 3_u32.pow(axis as u32) % 3)))
            };
            for code in 0..BLOCK.pow(3) {
                let place = [code % BLOCK, code / BLOCK % BLOCK, code / BLOCK.pow(2)];
                let point: [u32; 3] = std::array::from_fn(|axis| origin[axis] + place[axis]);
                if point.iter().all(|i| *i <= last) {
                    let expected = cells_around(point, level as u8).all(has_near_parent);
                    prop_assert_eq!(found.has(place), expected, "{:?}", point);
                }
            }
        }
    }
}
