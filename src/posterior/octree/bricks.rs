//! Sums of sparse lattice points, in bricks.
//!
//! A vertex is keyed by its point on the lattice of its own level: `key` = coarseness · 2⁵⁷ + Morton code of (point / 2^coarseness),
//! coarseness 0 being the finest lattice. The eight keys that differ in their low three bits make an aligned 2³ *brick*, which exists as
//! soon as one of its vertices was touched; eight bricks make a *block*, which is looked up by hash. (Bricks of 4³ took three times the memory
//! where rays are few for the lattice.) Blocks are spread over shards by hash, so that threads own them.

use rayon::prelude::*;
use rustc_hash::FxHashMap;

use crate::octree::morton;
use crate::posterior::Evidence;

/// Shards: enough to keep many cores busy, few enough that their lists stay long.
const SHARD_BITS: u32 = 6;
pub const SHARDS: usize = 1 << SHARD_BITS;
const COARSENESS_SHIFT: u32 = 57;

/// Sums of the eight vertices of a brick.
pub type Brick = [Evidence; 8];

/// Where the bricks of a block are among those of its shard.
#[derive(Debug, Clone, Copy)]
struct Block([u32; 8]);

impl Block {
    /// No brick yet.
    const NONE: u32 = u32::MAX;

    /// Place of the brick that has the given key.
    fn slot(&mut self, key: u64) -> &mut u32 {
        &mut self.0[(key >> 3 & 7) as usize]
    }

    /// Bricks that exist, by their number in the block.
    fn bricks(&self) -> impl Iterator<Item = (u64, usize)> {
        let slots = (0..8).zip(self.0).filter(|(_, slot)| *slot != Self::NONE);
        slots.map(|(i, slot)| (i, slot as usize))
    }
}

/// The key of the vertex at `point`, which must be a multiple of 2^`coarseness` along every axis.
pub fn key(point: [u32; 3], coarseness: u8) -> u64 {
    u64::from(coarseness) << COARSENESS_SHIFT | morton::encode(point.map(|i| i >> coarseness))
}

/// The point of a key.
pub fn point(key: u64) -> [u32; 3] {
    let coarseness = key >> COARSENESS_SHIFT;
    morton::decode(key & ((1 << COARSENESS_SHIFT) - 1)).map(|i| i << coarseness)
}

/// The shard that owns a vertex.
pub fn shard_of(key: u64) -> usize {
    // Fibonacci hashing of the block's code (Knuth, TAOCP 3, 6.4).
    ((key >> 6).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> (64 - SHARD_BITS)) as usize
}

/// What one ray adds to one vertex.
#[derive(Clone, Copy)]
pub struct Contribution {
    pub key: u64,
    pub sums: Evidence,
}

/// What the rays of a batch add, in ray order, and which shard takes what.
pub struct Contributions {
    all: Vec<Contribution>,
    /// Indices into `all` by shard, in ray order in each.
    order: Vec<u32>,
    /// Where each shard begins in `order`, and its end.
    starts: [u32; SHARDS + 1],
}

impl Contributions {
    pub fn new(all: Vec<Contribution>) -> Self {
        // A counting sort of indices: the contributions themselves are large.
        let shards: Vec<u8> = all.iter().map(|c| shard_of(c.key) as u8).collect();
        let mut starts = [0; SHARDS + 1];
        shards.iter().for_each(|&s| starts[usize::from(s) + 1] += 1);
        for s in 0..SHARDS {
            starts[s + 1] += starts[s];
        }
        let mut next = starts;
        let mut order = vec![0; all.len()];
        for (i, &s) in shards.iter().enumerate() {
            let at = &mut next[usize::from(s)];
            order[*at as usize] = i as u32;
            *at += 1;
        }
        Self { all, order, starts }
    }

    fn of_shard(&self, s: usize) -> impl Iterator<Item = &Contribution> {
        self.order[self.starts[s] as usize..self.starts[s + 1] as usize].iter().map(|&i| &self.all[i as usize])
    }
}

/// The blocks that hash to one shard.
#[derive(Debug, Clone, Default)]
struct Shard {
    /// Block code (key without its low 6 bits) to position in `blocks`.
    index: FxHashMap<u64, u32>,
    blocks: Vec<Block>,
    /// Codes of bricks (keys without their low 3 bits), in the order in which rays first touched them.
    codes: Vec<u64>,
    bricks: Vec<Brick>,
}

impl Shard {
    /// Position of the block with the given code, which is made if it is new.
    fn block(&mut self, code: u64) -> usize {
        let next = self.blocks.len() as u32;
        let block = *self.index.entry(code).or_insert(next);
        if block == next {
            self.blocks.push(Block([Block::NONE; 8]));
        }
        block as usize
    }

    /// The brick of a key in its block, which is made if it is new.
    fn brick(&mut self, block: usize, key: u64) -> &mut Brick {
        let slot = self.blocks[block].slot(key);
        if *slot == Block::NONE {
            *slot = self.bricks.len() as u32;
            self.codes.push(key >> 3);
            self.bricks.push(Brick::default());
        }
        &mut self.bricks[*slot as usize]
    }

    /// Adds contributions in order. Neighbours in the list are most often neighbours in space.
    fn add<'a>(&mut self, contributions: impl Iterator<Item = (u64, &'a Evidence)>) {
        let (mut code, mut block) = (u64::MAX, 0);
        for (key, sums) in contributions {
            if key >> 6 != code {
                code = key >> 6;
                block = self.block(code);
            }
            self.brick(block, key)[(key & 7) as usize].add(sums);
        }
    }

    fn memory(&self) -> usize {
        // hashbrown: one control byte and one (u64, u32) pair, padded to 16, per bucket.
        self.bricks.capacity() * size_of::<Brick>()
            + self.codes.capacity() * 8
            + self.blocks.capacity() * size_of::<Block>()
            + self.index.capacity() * 8 / 7 * 17
    }
}

/// All sums.
#[derive(Debug, Clone)]
pub struct Bricks {
    shards: Vec<Shard>,
}

impl Bricks {
    pub fn new() -> Self {
        Self { shards: vec![Shard::default(); SHARDS] }
    }

    /// Adds lists of contributions, in order.
    pub fn add(&mut self, lists: &[Contributions]) {
        self.shards.par_iter_mut().enumerate().for_each(|(s, shard)| {
            shard.add(lists.iter().flat_map(|list| list.of_shard(s)).map(|c| (c.key, &c.sums)));
        });
    }

    /// Adds all sums of `other`.
    pub fn absorb(&mut self, other: &Self) {
        self.shards.par_iter_mut().zip(&other.shards).for_each(|(shard, other)| {
            for (&code, brick) in other.codes.iter().zip(&other.bricks) {
                let block = shard.block(code >> 3);
                let mine = shard.brick(block, code << 3);
                mine.iter_mut().zip(brick).for_each(|(sum, sums)| sum.add(sums));
            }
        });
    }

    /// Adds to one vertex.
    pub fn add_one(&mut self, key: u64, sums: &Evidence) {
        self.shards[shard_of(key)].add(std::iter::once((key, sums)));
    }

    /// The sums of a vertex, if its brick exists.
    pub fn get(&self, key: u64) -> Option<&Evidence> {
        let (mut block, bricks) = self.block(key)?;
        Some(&bricks.get(*block.slot(key) as usize)?[(key & 7) as usize])
    }

    /// The block of a key, if it exists, and its shard's bricks.
    fn block(&self, key: u64) -> Option<(Block, &[Brick])> {
        let shard = &self.shards[shard_of(key)];
        let block = *shard.index.get(&(key >> 6))?;
        Some((shard.blocks[block as usize], &shard.bricks))
    }

    /// A search for neighbouring vertices.
    pub fn reader(&self) -> Reader<'_> {
        Reader { bricks: self, code: u64::MAX, block: None }
    }

    /// For every block its code and the members whose sums fulfil `condition`, as a mask; in parallel.
    pub fn par_masks(
        &self,
        condition: impl Fn(&Evidence) -> bool + Send + Sync,
    ) -> impl ParallelIterator<Item = (u64, u64)> {
        let blocks = self.shards.par_iter().flat_map_iter(|shard| {
            shard.index.iter().map(move |(&code, &block)| (code, shard, &shard.blocks[block as usize]))
        });
        blocks.map(move |(code, shard, block)| {
            let members = block.bricks().flat_map(|(i, slot)| (8 * i..).zip(&shard.bricks[slot]));
            let fulfilling = members.filter(|(_, sums)| condition(sums));
            (code, fulfilling.fold(0, |mask, (member, _)| mask | 1 << member))
        })
    }

    /// All vertices of all bricks, in parallel, with their keys.
    pub fn par_iter(&self) -> impl ParallelIterator<Item = (u64, &Evidence)> {
        let bricks = self.shards.par_iter().flat_map_iter(|shard| shard.codes.iter().zip(&shard.bricks));
        bricks.flat_map_iter(|(&code, brick)| (0_u64..).zip(brick).map(move |(i, sums)| (code << 3 | i, sums)))
    }

    /// Brick codes, in the order in which [`Bricks::slices`] returns their sums.
    pub fn codes(&self) -> impl Iterator<Item = u64> + '_ {
        self.shards.iter().flat_map(|shard| shard.codes.iter().copied())
    }

    /// The sums, one slice per shard.
    pub fn slices(&self) -> impl Iterator<Item = &[Brick]> {
        self.shards.iter().map(|shard| shard.bricks.as_slice())
    }

    /// Puts back what [`Bricks::codes`] and [`Bricks::slices`] gave, in the same order.
    ///
    /// `None` if a code comes twice, or lies outside the lattice with `cells` per axis.
    pub fn restore(cells: u32, codes: &[u64], bricks: Vec<Brick>) -> Option<Self> {
        let mut restored = Self::new();
        for (&code, brick) in codes.iter().zip(bricks) {
            // Every level of coarseness halves the lattice, until one cell is left.
            let coarseness = code >> (COARSENESS_SHIFT - 3);
            if coarseness > u64::from(cells.ilog2()) {
                return None;
            }
            let first = morton::decode(code << 3 & ((1 << COARSENESS_SHIFT) - 1));
            if first.iter().any(|&i| i > cells >> coarseness) {
                return None;
            }
            let shard = &mut restored.shards[shard_of(code << 3)];
            let (before, block) = (shard.bricks.len(), shard.block(code >> 3));
            *shard.brick(block, code << 3) = brick;
            if shard.bricks.len() == before {
                return None;
            }
        }
        Some(restored)
    }

    /// Bytes on the heap.
    pub fn memory(&self) -> usize {
        self.shards.iter().map(Shard::memory).sum()
    }
}

/// A search that looks a block up once for all its vertices in a row.
pub struct Reader<'a> {
    bricks: &'a Bricks,
    /// Of the block looked up last.
    code: u64,
    block: Option<(Block, &'a [Brick])>,
}

impl Reader<'_> {
    /// The sums of a vertex; none if its brick does not exist.
    pub fn get(&mut self, key: u64) -> Evidence {
        if key >> 6 != self.code {
            self.code = key >> 6;
            self.block = self.bricks.block(key);
        }
        let brick = self.block.as_mut().and_then(|(block, bricks)| bricks.get(*block.slot(key) as usize));
        brick.map_or_else(Evidence::default, |brick| brick[(key & 7) as usize])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_key_holds_its_point(index in proptest::array::uniform3(0_u32..=1 << 11), coarseness in 0_u8..=5) {
            let at = index.map(|i| i << coarseness);
            prop_assert_eq!(point(key(at, coarseness)), at);
            prop_assert_eq!(key(at, coarseness) >> COARSENESS_SHIFT, u64::from(coarseness));
        }
    }
}
