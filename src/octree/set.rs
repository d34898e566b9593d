//! A succinct sorted set of Morton codes that maps each member to its rank.
//!
//! It is a 64-ary tree. Every node holds a 64-bit mask of its occupied children, and as its base the number
//! of children of all earlier nodes in its row. The child in slot s of node n is therefore node
//! `base[n] + popcount(mask[n] below s)` of the next row; in the last row this number is the member's rank.
//! A node takes 12 bytes. A node of the last row is an aligned 4³ brick of lattice points, of which surfaces
//! fill a third to a half. Compare the leaf nodes of OpenVDB (Museth 2013) and the rank/select structures of
//! succinct trees (Jacobson 1989).

/// A node: the two halves of its mask, and its base.
///
/// Its twelve bytes lie together, so that a look-up outside the cache waits only once.
type Node = [u32; 3];

fn mask([low, high, _]: Node) -> u64 {
    u64::from(high) << 32 | u64::from(low)
}

fn base([.., base]: Node) -> u32 {
    base
}

/// The members of one brick of a [`MortonSet`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BrickRank {
    mask: u64,
    base: u32,
}

impl BrickRank {
    /// The low six bits of every member's code, with its rank.
    pub fn members(self) -> impl Iterator<Item = (u64, u32)> {
        let mut rest = self.mask;
        (self.base..).map_while(move |rank| {
            let slot = (rest != 0).then(|| rest.trailing_zeros())?;
            rest &= rest - 1;
            Some((u64::from(slot), rank))
        })
    }

    /// The rank of `code`, which must belong to this brick; `None` if it is not a member.
    #[must_use]
    pub fn rank(&self, code: u64) -> Option<u32> {
        let slot = 1_u64 << (code & 63);
        (self.mask & slot != 0).then(|| self.base + (self.mask & (slot - 1)).count_ones())
    }
}

/// A sorted set of Morton codes below 2^(6·rows), with rank look-up in O(rows).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MortonSet {
    /// Rows of nodes, from the root (one node) to the bricks.
    rows: Vec<Vec<Node>>,
    len: u32,
}

impl MortonSet {
    /// Builds the set from `bricks`: strictly increasing codes without their low six bits, each with a mask
    /// that is not empty. All codes are below 2^`bits`.
    ///
    /// # Panics
    /// If bricks are empty, not strictly increasing or too large, or if there are more than 2³² − 1 members.
    #[must_use]
    pub fn from_bricks(bits: u32, bricks: impl IntoIterator<Item = (u64, u64)>) -> Self {
        let (mut codes, mut row, mut len) = (Vec::new(), Vec::new(), 0_u32);
        for (brick, mask) in bricks {
            assert!(codes.last().is_none_or(|&last| last < brick), "bricks must be strictly increasing");
            assert!(mask != 0, "a brick without members");
            codes.push(brick);
            row.push([mask as u32, (mask >> 32) as u32, len]);
            len = len.checked_add(mask.count_ones()).expect("a set holds at most 2^32 - 1 codes");
        }
        if let (Some(&brick), Some(&node)) = (codes.last(), row.last()) {
            let last = brick << 6 | u64::from(mask(node).ilog2());
            assert!(bits >= 64 || last >> bits == 0, "a code exceeds {bits} bits");
        }
        row.shrink_to_fit();
        let mut rows = vec![row];
        for _ in 1..bits.div_ceil(6) {
            let mut row: Vec<Node> = Vec::new();
            let mut parents = Vec::new();
            for (rank, &code) in (0_u32..).zip(&codes) {
                if parents.last() != Some(&(code >> 6)) {
                    parents.push(code >> 6);
                    row.push([0, 0, rank]);
                }
                if let Some(node) = row.last_mut() {
                    node[(code >> 5 & 1) as usize] |= 1 << (code & 31);
                }
            }
            row.shrink_to_fit();
            rows.push(row);
            codes = parents;
        }
        rows.reverse();
        Self { rows, len }
    }

    /// Number of members.
    #[must_use]
    pub fn len(&self) -> usize {
        self.len as usize
    }

    /// Number of members smaller than `code`, if `code` is a member.
    #[must_use]
    pub fn rank(&self, code: u64) -> Option<u32> {
        self.brick(code >> 6)?.rank(code)
    }

    /// The members with codes 64 · `brick` to 64 · `brick` + 63, if there are any. Neighbours often share a brick.
    #[must_use]
    pub fn brick(&self, brick: u64) -> Option<BrickRank> {
        let (last, above) = self.rows.split_last().filter(|_| self.len > 0)?;
        let mut shift = 6 * above.len();
        let mut node = 0_u32;
        for row in above {
            shift -= 6;
            let here = row[node as usize];
            let slot = 1_u64 << (brick >> shift & 63);
            if mask(here) & slot == 0 {
                return None;
            }
            node = base(here) + (mask(here) & (slot - 1)).count_ones();
        }
        let here = last[node as usize];
        Some(BrickRank { mask: mask(here), base: base(here) })
    }

    /// All bricks in increasing order: code without the low six bits, mask, and rank of the lowest member.
    pub fn bricks(&self) -> impl Iterator<Item = (u64, u64, u32)> + '_ {
        self.bricks_from(0)
    }

    /// From the brick of the member with this rank on, all bricks in increasing order: code without the low six bits,
    /// mask, and rank of the lowest member.
    fn bricks_from(&self, rank: u32) -> impl Iterator<Item = (u64, u64, u32)> + '_ {
        // A depth-first walk.
        let mut stack = self.way_to(rank);
        std::iter::from_fn(move || {
            loop {
                let &(row, node, prefix, pending) = stack.last()?;
                let here = self.rows[row][node as usize];
                if row + 1 == self.rows.len() {
                    stack.pop();
                    return Some((prefix, mask(here), base(here)));
                }
                if pending == 0 {
                    stack.pop();
                    continue;
                }
                if let Some(top) = stack.last_mut() {
                    top.3 &= pending - 1;
                }
                let slot = pending.trailing_zeros();
                let child = base(here) + (mask(here) & ((1_u64 << slot) - 1)).count_ones();
                let below = mask(self.rows[row + 1][child as usize]);
                stack.push((row + 1, child, prefix << 6 | u64::from(slot), below));
            }
        })
    }

    /// The nodes from the root to the brick of the member with this rank, if there is one: row, number in the row,
    /// prefix of the codes, and the slots behind the way.
    fn way_to(&self, rank: u32) -> Vec<(usize, u32, u64, u64)> {
        if rank >= self.len {
            return Vec::new();
        }
        // Nodes of a row are sorted by their base.
        let mut numbers = vec![rank];
        for row in self.rows.iter().rev() {
            let child = numbers[numbers.len() - 1];
            numbers.push((row.partition_point(|&node| base(node) <= child) - 1) as u32);
        }
        numbers.reverse();
        let (mut way, mut prefix) = (Vec::with_capacity(self.rows.len()), 0);
        for (row, step) in numbers.windows(2).enumerate() {
            let here = self.rows[row][step[0] as usize];
            let mut pending = mask(here);
            if row + 1 < self.rows.len() {
                (base(here)..step[1]).for_each(|_| pending &= pending - 1);
                let slot = u64::from(pending.trailing_zeros());
                way.push((row, step[0], prefix, pending & (pending - 1)));
                prefix = prefix << 6 | slot;
            } else {
                way.push((row, step[0], prefix, pending));
            }
        }
        way
    }

    /// The members from this rank on, in increasing order.
    pub fn iter_from(&self, rank: u32) -> impl Iterator<Item = u64> + '_ {
        let bricks = self.bricks_from(rank);
        let members = bricks.flat_map(|(brick, mask, base)| {
            BrickRank { mask, base }.members().map(move |(slot, rank)| (brick << 6 | slot, rank))
        });
        members.skip_while(move |(_, at)| *at < rank).map(|(code, _)| code)
    }

    /// Bytes on the heap, spare capacity included.
    #[must_use]
    pub fn heap_bytes(&self) -> usize {
        let rows: usize = self.rows.iter().map(|row| row.capacity() * size_of::<Node>()).sum();
        rows + self.rows.capacity() * size_of::<Vec<Node>>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    /// The set of the given codes, which increase.
    fn set_of(bits: u32, codes: &[u64]) -> MortonSet {
        let bricks = codes.chunk_by(|a, b| a >> 6 == b >> 6);
        let mask = |codes: &[u64]| codes.iter().fold(0, |mask, code| mask | 1 << (code & 63));
        MortonSet::from_bricks(bits, bricks.map(|codes| (codes[0] >> 6, mask(codes))))
    }

    #[test]
    fn the_empty_set_has_no_members() {
        let set = set_of(27, &[]);
        assert!(set.len() == 0 && set.rank(0).is_none() && set.iter_from(0).next().is_none());
    }

    proptest! {
        #[test]
        fn rank_is_the_position_in_the_sorted_list(codes in proptest::collection::btree_set(0u64..1 << 20, 0..300),
                                                   probes in proptest::collection::vec(0u64..1 << 20, 50)) {
            // An off-by-one error would show at neighbours of members.
            let sorted: Vec<u64> = codes.iter().copied().collect();
            let set = set_of(20, &sorted);
            let near: BTreeSet<u64> = sorted.iter().flat_map(|&c| [c.saturating_sub(1), c, c + 1]).collect();
            for code in probes.into_iter().chain(near) {
                prop_assert_eq!(set.rank(code), sorted.binary_search(&code).ok().map(|r| r as u32));
            }
            for rank in 0..=sorted.len() {
                prop_assert_eq!(set.iter_from(rank as u32).collect::<Vec<_>>(), &sorted[rank..]);
            }
        }
    }
}
