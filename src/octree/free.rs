//! The free vertices of a balanced octree, 64 at once.
//!
//! The cells of level ℓ − 1 are called parents here; leaves of level ℓ are children of split parents. By 2:1
//! balance, no leaf that touches such a child is larger than a parent. A point of the lattice of level ℓ is
//! therefore a corner of all leaves that touch it, one of them of level ℓ, if
//!
//! - all its coordinates are even (it is a corner of parents), and one of the parents around it is split; or
//! - it lies inside a parent, or inside a face or an edge of parents, and all parents around it (one, two,
//!   four) are split;
//!
//! unless a child of level ℓ that touches it is split in turn: then it belongs to a finer level.

use rayon::prelude::*;

use super::balance::Split;
use super::masks::MaskSet;
use super::morton;
use super::set::MortonSet;

/// Bricks whose points are known at once: 80 bytes each.
const OWNERS_AT_ONCE: usize = 1 << 14;

/// Points owned by a brick of 4³ parents. Each parent owns its lower corner and the points inside its
/// half-open cube.
struct Owned {
    /// Lower corners of the 4³ parents that touch a split parent.
    touched: u64,
    /// 8³ points of the finer lattice in Morton order.
    points: [u64; 8],
}

impl Owned {
    fn new(split: &MaskSet, brick: u64, per_axis: u32) -> Self {
        let first = morton::decode(brick).map(|i| 4 * i);
        // For every parent P of the brick and every side: whether P − side is split, and whether it is split
        // or outside the box.
        let near: [u64; 8] = std::array::from_fn(|side| {
            rows(below(first.map(|i| i / 4), side).map_or(0, |at| split.mask(morton::encode(at))))
        });
        let is_split: [u64; 8] = std::array::from_fn(|side| shifted(&near, side));
        let allowed: [u64; 8] = std::array::from_fn(|side| is_split[side] | outside(first, side, per_axis));
        // A parent just beyond the upper faces owns points in these faces only. Parents further out own none.
        let inside: [u64; 3] = std::array::from_fn(|axis| along(axis, |i| first[axis] + i < per_axis));
        let there = (0..3).fold(!0, |mask, axis| mask & along(axis, |i| first[axis] + i <= per_axis));
        let mut owned = Self { touched: 0, points: [0; 8] };
        for c in 0..8_usize {
            let free = if c == 0 {
                is_split.iter().fold(0, |any, mask| any | mask)
            } else {
                // Along odd axes the point lies inside its own parent.
                let around = (0..8_usize).filter(|side| side & c == 0);
                let odd = (0..3).filter(|axis| c >> axis & 1 == 1);
                odd.fold(around.fold(!0, |all, side| all & allowed[side]), |free, axis| free & inside[axis])
            };
            let free = codes(free & there);
            if c == 0 {
                owned.touched = free;
            }
            for (part, points) in owned.points.iter_mut().enumerate() {
                *points |= apart(free >> (8 * part) & 0xff) << c;
            }
        }
        owned
    }
}

/// Rearranges a mask from Morton order into rows: bit x + 4 y + 16 z.
fn rows(mask: u64) -> u64 {
    // The bits of an index are (z1 y1 x1 z0 y0 x0) in Morton order and (z1 z0 y1 y0 x1 x0) in rows, three bit
    // exchanges apart.
    swapped::<3, 4>(swapped::<2, 3>(swapped::<1, 3>(mask)))
}

/// The inverse of [`rows`].
fn codes(mask: u64) -> u64 {
    swapped::<1, 3>(swapped::<2, 3>(swapped::<3, 4>(mask)))
}

/// Moves every bit of a mask to the index with bits A < B exchanged (a delta swap).
fn swapped<const A: u32, const B: u32>(mask: u64) -> u64 {
    let only_a = const { indices_with(1 << A, 1 << B) };
    let shift = (1 << B) - (1 << A);
    let t = (mask >> shift ^ mask) & only_a;
    mask ^ t ^ t << shift
}

/// Mask of the indices that have all bits of `ones` and none of `zeros`.
const fn indices_with(ones: u64, zeros: u64) -> u64 {
    let (mut mask, mut index) = (0, 0);
    while index < 64 {
        if index & ones == ones && index & zeros == 0 {
            mask |= 1 << index;
        }
        index += 1;
    }
    mask
}

/// Spreads the eight low bits eight places apart.
fn apart(bits: u64) -> u64 {
    let bits = (bits | bits << 28) & 0x0000_000f_0000_000f;
    let bits = (bits | bits << 14) & 0x0003_0003_0003_0003;
    (bits | bits << 7) & 0x0101_0101_0101_0101
}

/// Mask, in rows, of the places whose coordinate along an axis fulfils `condition`.
fn along(axis: usize, condition: impl Fn(u32) -> bool) -> u64 {
    let coordinate = [0x1111_1111_1111_1111, 0x000f_000f_000f_000f, 0xffff][axis];
    (0..4).filter(|&i| condition(i)).fold(0, |mask, i| mask | coordinate << (i << (2 * axis)))
}

/// For every place P of a brick, whether P − side has its bit set. The masks, in rows, are those of the brick
/// (0) and of the bricks below it.
fn shifted(near: &[u64; 8], side: usize) -> u64 {
    // Along each axis of `side`, places 1 to 3 look into the brick that has 0 there, place 0 into the brick below.
    let mut masks = *near;
    for axis in (0..3).filter(|axis| side >> axis & 1 == 1) {
        let step = 1_u32 << (2 * axis);
        let first = along(axis, |i| i == 0);
        for brick in (0..8).filter(|brick| brick >> axis & 1 == 0) {
            masks[brick] = masks[brick] << step & !first | masks[brick | 1 << axis] >> (3 * step) & first;
        }
    }
    masks[0]
}

/// Places P of a brick for which P − side is outside the box.
fn outside(first: [u32; 3], side: usize, per_axis: u32) -> u64 {
    let beyond = |axis: usize| {
        along(axis, |i| (first[axis] + i).checked_sub((side >> axis & 1) as u32).is_none_or(|i| i >= per_axis))
    };
    beyond(0) | beyond(1) | beyond(2)
}

/// The brick one step down along the axes whose bits are set in `side`.
fn below(brick: [u32; 3], side: usize) -> Option<[u32; 3]> {
    let mut near = brick;
    for (axis, i) in near.iter_mut().enumerate() {
        *i = i.checked_sub((side >> axis & 1) as u32)?;
    }
    Some(near)
}

/// Bricks that may hold a split cell or an upper neighbour of one. They own all points that touch a split cell.
fn owners(split: &MaskSet) -> Vec<u64> {
    let mut owners = Vec::new();
    for (brick, mask) in split.bricks() {
        let at = morton::decode(brick);
        // The bricks above own points of a member only if it lies in an upper face of this brick.
        let upper = [UPPER_X, UPPER_Y, UPPER_Z];
        for side in 0..8_usize {
            let reached = (0..3).fold(mask, |mask, axis| if side >> axis & 1 == 1 { mask & upper[axis] } else { mask });
            if reached != 0 {
                let above = std::array::from_fn(|axis| at[axis] + (side >> axis & 1) as u32);
                owners.push(morton::encode(above));
            }
        }
    }
    owners.par_sort_unstable();
    owners.dedup();
    owners
}

/// Members of a brick with coordinate 3 along one axis: both bits of that axis are set.
const UPPER_X: u64 = indices_with(0b001_001, 0);
const UPPER_Y: u64 = indices_with(0b010_010, 0);
const UPPER_Z: u64 = indices_with(0b100_100, 0);

/// The free vertices by coarseness, finest first. Each set holds points of its own level's lattice.
pub fn free_vertices(mut split: Split) -> Vec<MortonSet> {
    let bits = |level: u8| 3 * (u32::from(level) + 1);
    let mut sets = Vec::with_capacity(usize::from(split.finest()) + 1);
    // Points of the current level that touch a finer leaf: bricks with their masks, sorted.
    let mut taken = Vec::new();
    while let Some((above, parents)) = split.pop() {
        let mut touched = Vec::new();
        let mut others = taken.into_iter().peekable();
        let owners = owners(&parents);
        let bricks = owners.chunks(OWNERS_AT_ONCE).flat_map(|some| {
            let owned: Vec<Owned> = some.par_iter().map(|&brick| Owned::new(&parents, brick, 1 << above)).collect();
            touched.extend(some.iter().zip(&owned).map(|(&brick, owned)| (brick, owned.touched)));
            some.iter().zip(owned).flat_map(|(&brick, owned)| {
                (0_u64..).zip(owned.points).map(move |(part, points)| (brick << 3 | part, points))
            })
        });
        let free = bricks.map(|(brick, points)| {
            while others.next_if(|(other, _)| *other < brick).is_some() {}
            let taken: u64 = others.next_if(|(other, _)| *other == brick).map_or(0, |(_, points)| points);
            (brick, points & !taken)
        });
        sets.push(MortonSet::from_bricks(bits(above + 1), free.filter(|(_, points)| *points != 0)));
        taken = touched;
    }
    // Corners of the box itself, if it is a leaf.
    let is_leaf = taken.iter().all(|(_, points)| *points == 0);
    sets.push(MortonSet::from_bricks(bits(0), is_leaf.then_some((0, 0xff))));
    sets
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn rows_and_codes_are_the_same_places(mask: u64) {
            let slowly = (0..64).filter(|code| mask >> code & 1 == 1).fold(0, |all, code| {
                let [x, y, z] = morton::decode(code);
                all | 1_u64 << (x + 4 * y + 16 * z)
            });
            prop_assert_eq!(rows(mask), slowly);
            prop_assert_eq!(codes(slowly), mask);
        }

        #[test]
        fn looking_one_below_crosses_into_the_bricks_below(near: [u64; 8], side in 0_usize..8) {
            let slowly = (0..64_u32).filter(|i| {
                let (mut brick, mut index) = (0_usize, 0);
                for axis in 0..3 {
                    let at = i64::from(i >> (2 * axis) & 3) - (side >> axis & 1) as i64;
                    brick |= usize::from(at < 0) << axis;
                    index |= (at & 3) << (2 * axis);
                }
                near[brick] >> index & 1 == 1
            });
            prop_assert_eq!(shifted(&near, side), slowly.fold(0, |all, i| all | 1_u64 << i));
        }

        #[test]
        fn bits_go_eight_places_apart(bits in 0_u64..256) {
            prop_assert_eq!(apart(bits), (0..8).fold(0, |all, i| all | (bits >> i & 1) << (8 * i)));
        }
    }
}
