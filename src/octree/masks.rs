//! Sets of cells or points of one lattice, as 64-bit masks of aligned 4³ bricks.
//!
//! Masks let the neighbourhoods of 64 members be processed at once. A brick's code is the Morton code of its
//! members without the low six bits, which give a member's place in the mask.

use std::ops::BitOrAssign;

use rustc_hash::FxHashMap;

use super::morton;

/// Places along an axis around a halved brick: two in the brick, one on either side.
const AROUND: usize = 4;

/// For each member of a brick, which cells of the lattice half as fine it reaches, as a mask: the 2:1 rule of balance.
///
/// Bit x + 4 y + 16 z stands for the place 2 b − 1 + (x, y, z), where b are the coordinates of the brick.
pub type Reach = [u64; 64];

/// The reach of a member at (i, j, k) in its brick: the product of three sets of places along the axes.
const fn reach(along: [u64; 4]) -> Reach {
    let mut all = [0; 64];
    let mut member = 0;
    while member < 64 {
        let (mut at, mut bit) = ([0; 3], 0);
        while bit < 6 {
            at[bit % 3] |= (member >> bit & 1) << (bit / 3);
            bit += 1;
        }
        let mut place = 0;
        while place < 64 {
            let reached = along[at[0]] >> (place & 3) & along[at[1]] >> (place >> 2 & 3) & along[at[2]] >> (place >> 4);
            all[member] |= (reached & 1) << place;
            place += 1;
        }
        member += 1;
    }
    all
}

/// Reaches the parents of a cell and of its 26 neighbours.
pub const PARENTS_OF_NEIGHBORS: Reach = reach([0b0011, 0b0110, 0b0110, 0b1100]);
/// Reaches the parents of the eight cells around a point.
pub const PARENTS_AROUND_POINT: Reach = reach([0b0011, 0b0010, 0b0110, 0b0100]);

/// The members of a brick at each of its four places along each axis.
const PLACES: [[u64; 4]; 3] = {
    let mut places = [[0; 4]; 3];
    let mut member = 0;
    while member < 64 {
        let mut axis = 0;
        while axis < 3 {
            places[axis][(member >> axis & 1 | (member >> (axis + 3) & 1) << 1) as usize] |= 1 << member;
            axis += 1;
        }
        member += 1;
    }
    places
};

/// A set of cells or points of one lattice.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct MaskSet {
    /// Masks by brick; none is empty.
    bricks: FxHashMap<u64, u64>,
}

impl MaskSet {
    /// Adds one member.
    pub fn insert(&mut self, code: u64) {
        self.insert_mask(code >> 6, 1 << (code & 63));
    }

    /// Adds the members of `mask` to one brick.
    pub fn insert_mask(&mut self, brick: u64, mask: u64) {
        if mask != 0 {
            *self.bricks.entry(brick).or_default() |= mask;
        }
    }

    /// Adds the cells reached by members of a brick of the lattice twice as fine. This lattice has `cells` per axis.
    pub fn insert_reached(&mut self, brick: u64, mask: u64, reach: &Reach, cells: u32) {
        let mut places = 0;
        let mut members = mask;
        while members != 0 {
            places |= reach[members.trailing_zeros() as usize];
            members &= members - 1;
        }
        // Four places along an axis lie in at most two bricks.
        let first = morton::decode(brick).map(|b| 2 * i64::from(b) - 1);
        let mut masks = [0_u64; 8];
        while places != 0 {
            let place = places.trailing_zeros() as usize;
            places &= places - 1;
            let cell: [i64; 3] = std::array::from_fn(|axis| first[axis] + (place >> (2 * axis) & (AROUND - 1)) as i64);
            if cell.iter().any(|i| !(0..i64::from(cells)).contains(i)) {
                continue;
            }
            let which = (0..3).fold(0, |which, axis| which | ((cell[axis] >> 2) - (first[axis] >> 2)) << axis);
            masks[which as usize] |= 1 << morton::encode(cell.map(|i| i as u32 & 3));
        }
        for (which, mask) in masks.into_iter().enumerate().filter(|(_, mask)| *mask != 0) {
            let at = std::array::from_fn(|axis| ((first[axis] >> 2) + (which as i64 >> axis & 1)) as u32);
            self.insert_mask(morton::encode(at), mask);
        }
    }

    /// The members and their neighbours, up to 26 of each, on the lattice {0..`last`}³.
    #[must_use]
    pub fn dilated(&self, last: u32) -> Self {
        (0..3).fold(self.clone(), |set, axis| set.dilated_along(axis, last))
    }

    /// The members and their neighbours along one axis.
    fn dilated_along(&self, axis: usize, last: u32) -> Self {
        // Places 0 and 1, and 2 and 3, differ in the lower bit of this axis; from 1 to 2 the upper one changes as well,
        // and from 3 both, together with the brick.
        let (in_pair, between, beyond) = (1 << axis, 7 << axis, 9 << axis);
        let [a, b, c, d] = PLACES[axis];
        let mut all = Self::default();
        for (brick, mask) in self.bricks() {
            let at = morton::decode(brick);
            let places = (last - 4 * at[axis]).min(3) as usize;
            let within = PLACES[axis][..=places].iter().fold(0, |all, place| all | place);
            let up = (mask & (a | c)) << in_pair | (mask & b) << between;
            let down = (mask & (b | d)) >> in_pair | (mask & c) >> between;
            all.insert_mask(brick, (mask | up | down) & within);
            let next_to = |i: u32| morton::encode(std::array::from_fn(|k| if k == axis { i } else { at[k] }));
            if let Some(before) = at[axis].checked_sub(1) {
                all.insert_mask(next_to(before), (mask & a) << beyond);
            }
            if 4 * at[axis] + 4 <= last {
                all.insert_mask(next_to(at[axis] + 1), (mask & d) >> beyond);
            }
        }
        all
    }

    /// Number of members.
    #[must_use]
    pub fn len(&self) -> usize {
        self.bricks.values().map(|mask| mask.count_ones() as usize).sum()
    }

    /// The members of a brick, as a mask.
    #[must_use]
    pub fn mask(&self, brick: u64) -> u64 {
        self.bricks.get(&brick).copied().unwrap_or(0)
    }

    /// Codes and masks of all bricks with members, in no particular order.
    pub fn bricks(&self) -> impl Iterator<Item = (u64, u64)> + '_ {
        self.bricks.iter().map(|(&brick, &mask)| (brick, mask))
    }

    /// Codes and masks of all bricks with members, sorted by code.
    #[must_use]
    pub fn sorted(&self) -> Vec<(u64, u64)> {
        let mut bricks: Vec<(u64, u64)> = self.bricks().collect();
        bricks.sort_unstable();
        bricks
    }

    /// All members, sorted.
    #[cfg(test)]
    pub fn codes(&self) -> Vec<u64> {
        let members =
            |(brick, mask): (u64, u64)| (0..64_u64).filter(move |i| mask >> i & 1 == 1).map(move |i| brick << 6 | i);
        self.sorted().into_iter().flat_map(members).collect()
    }
}

impl BitOrAssign for MaskSet {
    /// Adds all members of another set.
    fn bitor_assign(&mut self, other: Self) {
        for (brick, mask) in other.bricks {
            self.insert_mask(brick, mask);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octree::around;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    proptest! {
        #[test]
        fn what_members_reach_is_what_each_of_them_reaches(mask: u64, brick in proptest::array::uniform3(0_u32..4)) {
            // 16 cells or points per axis become 8 when halved. Some bricks lie at the faces.
            let members = || {
                (0..64_u64).filter(|m| mask >> m & 1 == 1).map(|m| morton::decode(morton::encode(brick) << 6 | m))
            };
            for (reach, from, to) in [(&PARENTS_OF_NEIGHBORS, -1..=1_i64, 16), (&PARENTS_AROUND_POINT, -1..=0, 16)] {
                let mut expected = BTreeSet::new();
                for member in members() {
                    for step in 0..27_i64 {
                        let steps = [step % 3 - 1, step / 3 % 3 - 1, step / 9 - 1];
                        let near: [i64; 3] = std::array::from_fn(|axis| i64::from(member[axis]) + steps[axis]);
                        if steps.iter().all(|s| from.contains(s)) && near.iter().all(|i| (0..to).contains(i)) {
                            expected.insert(morton::encode(near.map(|i| i as u32 / 2)));
                        }
                    }
                }
                let mut set = MaskSet::default();
                set.insert_reached(morton::encode(brick), mask, reach, 8);
                prop_assert_eq!(set.codes(), expected.into_iter().collect::<Vec<_>>());
            }
        }

        #[test]
        fn neighbours_of_all_are_those_of_each(
            last in 1_u32..=16,
            points in proptest::collection::vec(proptest::array::uniform3(0_u32..=16), 0..9),
        ) {
            let points: Vec<[u32; 3]> = points.into_iter().map(|point| point.map(|i| i.min(last))).collect();
            let mut set = MaskSet::default();
            points.iter().for_each(|&point| set.insert(morton::encode(point)));
            let near = points.iter().flat_map(|&point| around(point, last));
            let expected: BTreeSet<u64> = near.map(|(point, _)| morton::encode(point)).collect();
            prop_assert_eq!(set.dilated(last).codes(), expected.into_iter().collect::<Vec<_>>());
        }

        #[test]
        fn members_come_back_sorted_and_once(codes in proptest::collection::vec(0_u64..1 << 12, 0..200)) {
            let (mut a, mut b) = (MaskSet::default(), MaskSet::default());
            codes.iter().enumerate().for_each(|(i, &code)| if i % 3 == 0 { a.insert(code) } else { b.insert(code) });
            a |= b;
            let sorted: BTreeSet<u64> = codes.into_iter().collect();
            prop_assert_eq!(a.codes(), sorted.into_iter().collect::<Vec<_>>());
        }
    }
}
