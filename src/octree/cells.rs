//! The cells of the octree: child masks in breadth-first order.
//!
//! A cell is *split* (it has eight children) or a leaf. Every split cell above the second-finest level has a
//! byte that marks which of its children are split too. The j-th set bit of the whole sequence belongs to the
//! (j + 1)-th split cell, so a rank over the bytes replaces all pointers. Split cells of the second-finest
//! level need no byte: their children are finest leaves.
//!
//! ```text
//!        6-------7      corner and child c: bit 0 of c is x, bit 1 is y, bit 2 is z
//!       /|      /|      cells are half-open, [lo, hi) along every axis; a point on the upper
//!      4-------5 |      face of the box belongs to the last cell
//!      | 2-----|-3
//!      |/      |/       z y
//!      0-------1        |/
//!                       o--x
//! ```

use super::balance::Split;

/// Number of masks that share a rank directory entry; together they fill a cache line.
const BLOCK: usize = 60;

/// Consecutive child masks with their rank.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(align(64))]
struct RankedMasks {
    /// Set bits in all earlier blocks.
    rank: u32,
    /// Masks, padded with zeros.
    masks: [u8; BLOCK],
}

/// A cell of the octree.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Cell {
    /// 0 is the whole box. A cell of level ℓ spans 2^(finest − ℓ) finest cells per axis.
    pub level: u8,
    /// Position among the 2^level cells per axis of this level.
    pub index: [u32; 3],
}

impl Cell {
    /// Lower corner and edge length, in units of the finest lattice.
    #[must_use]
    #[inline]
    pub fn extent(self, finest: u8) -> ([u32; 3], u32) {
        let shift = finest - self.level;
        (self.index.map(|i| i << shift), 1 << shift)
    }

    /// Child c, 0 to 7.
    #[must_use]
    pub fn child(self, c: u8) -> Self {
        let bit = |axis: u8| u32::from(c >> axis & 1);
        let [x, y, z] = self.index;
        Self { level: self.level + 1, index: [2 * x + bit(0), 2 * y + bit(1), 2 * z + bit(2)] }
    }
}

/// All cells of an octree, as child masks with ranks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CellTree {
    finest: u8,
    /// Whether the root is split; an octree of one cell has no masks.
    root_split: bool,
    /// Number of masks.
    count: usize,
    blocks: Vec<RankedMasks>,
}

impl CellTree {
    /// Builds the tree of the split cells of each level.
    ///
    /// # Panics
    /// If a split cell's parent is not split.
    #[must_use]
    pub fn from_split(split: &Split) -> Self {
        let mut masks = Vec::new();
        for level in 1..split.finest() {
            let (before, children) = (masks.len(), split.level(level));
            for (brick, members) in split.level(level - 1).sorted() {
                // Eight split cells have their children in one brick, each in a byte of its mask.
                for part in (0..8).filter(|part| members >> (8 * part) & 0xff != 0) {
                    let of_part = children.mask(brick << 3 | part).to_le_bytes();
                    let is_split = |i: &usize| members >> (8 * part) >> i & 1 == 1;
                    masks.extend((0..8).filter(is_split).map(|i| of_part[i]));
                }
            }
            let found: usize = masks[before..].iter().map(|mask: &u8| mask.count_ones() as usize).sum();
            assert_eq!(found, children.len(), "every split cell has a parent that is split");
        }
        Self::from_masks(split.finest(), split.level(0).len() > 0, &masks)
    }

    fn from_masks(finest: u8, root_split: bool, masks: &[u8]) -> Self {
        let mut rank = 0;
        let mut blocks = Vec::with_capacity(masks.len().div_ceil(BLOCK));
        blocks.extend(masks.chunks(BLOCK).map(|chunk| {
            let mut block = RankedMasks { rank, masks: [0; BLOCK] };
            block.masks[..chunk.len()].copy_from_slice(chunk);
            rank += chunk.iter().map(|m| m.count_ones()).sum::<u32>();
            block
        }));
        Self { finest, root_split, count: masks.len(), blocks }
    }

    /// The stored form: whether the root is split, and the masks.
    #[must_use]
    pub fn raw(&self) -> (bool, Vec<u8>) {
        let masks = self.blocks.iter().flat_map(|block| block.masks).take(self.count);
        (self.root_split, masks.collect())
    }

    fn mask(&self, node: usize) -> u8 {
        self.blocks[node / BLOCK].masks[node % BLOCK]
    }

    /// Rebuilds the split cells of each level from the stored form, which may come from an untrusted file.
    ///
    /// # Errors
    /// If the number of masks does not follow from the masks themselves: a sentence that names what is wrong.
    pub fn split_from_raw(finest: u8, root_split: bool, masks: &[u8]) -> Result<Vec<Vec<u64>>, String> {
        let mut split = vec![Vec::new(); usize::from(finest)];
        if root_split {
            split[0].push(0);
        }
        let mut unread = masks;
        for level in 0..usize::from(finest) - 1 {
            let here = split[level].len();
            let Some((row, rest)) = unread.split_at_checked(here) else {
                return Err(format!(
                    "{} child masks end inside level {level}, which has {here} split cells",
                    masks.len()
                ));
            };
            unread = rest;
            let (above, below) = split.split_at_mut(level + 1);
            for (&code, &mask) in above[level].iter().zip(row) {
                below[0].extend((0..8_u64).filter(|c| mask >> c & 1 == 1).map(|c| code << 3 | c));
            }
        }
        if unread.is_empty() { Ok(split) } else { Err(format!("{} child masks are left over", unread.len())) }
    }

    /// The split cells of each level above the finest, as sorted Morton codes.
    #[must_use]
    pub fn split(&self) -> Vec<Vec<u64>> {
        Self::split_from_raw(self.finest, self.root_split, &self.raw().1).expect("a tree's own masks are consistent")
    }

    /// The finest level.
    #[must_use]
    pub fn finest(&self) -> u8 {
        self.finest
    }

    /// Number of set bits before mask `node`.
    fn rank(&self, node: usize) -> usize {
        let block = &self.blocks[node / BLOCK];
        let within: u32 = block.masks[..node % BLOCK].iter().map(|m| m.count_ones()).sum();
        block.rank as usize + within as usize
    }

    /// The leaf that contains the finest cell `cell`.
    #[must_use]
    pub fn leaf(&self, cell: [u32; 3]) -> Cell {
        let mut level = 0;
        let mut node = 0;
        let mut split = self.root_split;
        while split {
            level += 1;
            if level == self.finest {
                break;
            }
            let shift = self.finest - level;
            let c = cell[0] >> shift & 1 | (cell[1] >> shift & 1) << 1 | (cell[2] >> shift & 1) << 2;
            let mask = self.mask(node);
            split = mask >> c & 1 == 1;
            if split && level + 1 < self.finest {
                node = 1 + self.rank(node) + (mask & ((1 << c) - 1)).count_ones() as usize;
            }
        }
        let shift = self.finest - level;
        Cell { level, index: cell.map(|i| i >> shift) }
    }

    /// Calls `visit` for every leaf in Morton order.
    pub fn for_each_leaf(&self, mut visit: impl FnMut(Cell)) {
        self.descend(Cell { level: 0, index: [0; 3] }, (0, self.root_split), &mut visit);
    }

    fn descend(&self, cell: Cell, (node, split): (usize, bool), visit: &mut impl FnMut(Cell)) {
        if !split {
            return visit(cell);
        }
        if cell.level + 1 == self.finest {
            return (0..8).map(|c| cell.child(c)).for_each(visit);
        }
        let mask = self.mask(node);
        let deeper = cell.level + 2 < self.finest;
        let mut next = if deeper { 1 + self.rank(node) } else { 0 };
        for c in 0..8 {
            let child_split = mask >> c & 1 == 1;
            self.descend(cell.child(c), (next, child_split), visit);
            next += usize::from(child_split);
        }
    }

    /// Number of leaves of each level.
    #[must_use]
    pub fn leaves_per_level(&self) -> Vec<u64> {
        let mut leaves = vec![0; usize::from(self.finest) + 1];
        self.for_each_leaf(|leaf| leaves[usize::from(leaf.level)] += 1);
        leaves
    }

    /// Bytes on the heap, spare capacity included: the child masks, then their rank directory with padding.
    #[must_use]
    pub fn heap_bytes(&self) -> [usize; 2] {
        [self.count, self.blocks.capacity() * size_of::<RankedMasks>() - self.count]
    }
}
