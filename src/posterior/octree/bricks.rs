//! Sums at sparse lattice points, stored in bricks.
//!
//! A vertex is keyed by its point on the lattice of its own level: `key` = coarseness · 2⁵⁷ + Morton code of
//! (point / 2^coarseness). Coarseness 0 is the finest lattice. The eight keys that differ only in their low three
//! bits form an aligned 2³ *brick*, which exists once one of its vertices has been touched. Eight bricks form a
//! *block*, which is found by hashing. (Bricks of 4³ took three times the memory where rays are sparse for the
//! lattice.) A hash also distributes blocks over partitions, and each partition is owned by one thread at a time.

use std::ops::AddAssign;

use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::key::{BlockCode, BrickCode, PARTITIONS, VertexKey};
use super::lists::{Contribution, Contributions};
use crate::posterior::VertexSums;

/// Sums at the eight vertices of a brick.
pub type Brick = [VertexSums; 8];

/// Slots of a block's bricks in the brick list of its partition.
#[derive(Debug, Clone, Copy)]
struct BlockSlots([u32; 8]);

impl BlockSlots {
    /// Marks a brick that does not exist.
    const NONE: u32 = u32::MAX;
    const EMPTY: Self = Self([Self::NONE; 8]);

    /// The slot of the brick that contains `key`.
    fn slot(&mut self, brick: BrickCode) -> &mut u32 {
        &mut self.0[brick.in_block()]
    }

    /// The slot of the brick that contains `key`, if it exists.
    fn find(&self, brick: BrickCode) -> Option<u32> {
        Some(self.0[brick.in_block()]).filter(|slot| *slot != Self::NONE)
    }

    /// The bricks that exist, with their number within the block.
    fn bricks(&self) -> impl Iterator<Item = (u64, u32)> {
        (0..8).zip(self.0).filter(|(_, slot)| *slot != Self::NONE)
    }
}

/// Bricks per chunk, which takes 56 KiB.
const CHUNK: usize = 128;

/// Consecutive bricks, of seven cache lines each.
#[derive(Debug, Clone)]
#[repr(align(64))]
struct Chunk([Brick; CHUNK]);

/// A list of bricks that grows without moving them and reserves at most one chunk.
#[derive(Debug, Clone, Default)]
struct BrickList {
    chunks: Vec<Box<Chunk>>,
    len: usize,
}

impl BrickList {
    /// Appends a brick of zeros and returns its slot.
    fn push(&mut self) -> u32 {
        if self.len == self.chunks.len() * CHUNK {
            self.chunks.push(Box::new(Chunk([Brick::default(); CHUNK])));
        }
        self.len += 1;
        (self.len - 1) as u32
    }

    fn get(&self, slot: u32) -> &Brick {
        &self.chunks[slot as usize / CHUNK].0[slot as usize % CHUNK]
    }

    fn get_mut(&mut self, slot: u32) -> &mut Brick {
        &mut self.chunks[slot as usize / CHUNK].0[slot as usize % CHUNK]
    }

    /// All bricks in order, chunk by chunk.
    fn slices(&self) -> impl Iterator<Item = &[Brick]> {
        let len = |chunk: usize| CHUNK.min(self.len - chunk * CHUNK);
        self.chunks.iter().enumerate().map(move |(i, chunk)| &chunk.0[..len(i)])
    }
}

/// Expected bytes per brick: its sums, its code in a list that doubles, and its part of the table of blocks.
///
/// A block has two to three bricks, and 41 bytes in a table that is two thirds full.
pub const BRICK_BYTES: f64 = (size_of::<Brick>() + 12 + 25) as f64;

/// Expected bytes of chunks that are not yet full: half a chunk in every partition.
pub const SPARE_BYTES: usize = PARTITIONS * size_of::<Chunk>() / 2;

/// Number of contributions whose slots are looked up before the first of them is added.
const AHEAD: usize = 32;

/// The blocks that hash to one partition.
#[derive(Debug, Clone, Default)]
struct Partition {
    /// Keyed by block code: the key without its low 6 bits.
    blocks: FxHashMap<BlockCode, BlockSlots>,
    /// Codes of bricks (keys without their low 3 bits), in the order in which rays first touched them.
    codes: Vec<BrickCode>,
    bricks: BrickList,
}

impl Partition {
    /// Adds contributions in order. Neighbours in the list are usually neighbours in space.
    fn add(&mut self, contributions: &[Contribution]) {
        let mut slots = [0; AHEAD];
        for some in contributions.chunks(AHEAD) {
            let mut next = slots.iter_mut();
            for run in some.chunk_by(|a, b| a.key.block() == b.key.block()) {
                let block = self.blocks.entry(run[0].key.block()).or_insert(BlockSlots::EMPTY);
                for (Contribution { key, .. }, found) in run.iter().zip(&mut next) {
                    let slot = block.slot(key.brick());
                    if *slot == BlockSlots::NONE {
                        *slot = self.bricks.push();
                        self.codes.push(key.brick());
                    }
                    *found = *slot;
                }
            }
            let places = || some.iter().zip(&slots).map(|(c, &slot)| (slot, c.key.in_brick()));
            // Touches all of them first, so that their cache misses overlap.
            std::hint::black_box(places().fold(0, |any, (slot, i)| any | self.bricks.get(slot)[i].rays));
            for (c, (slot, i)) in some.iter().zip(places()) {
                self.bricks.get_mut(slot)[i] += &c.sums;
            }
        }
    }

    /// The brick with the given code, created if it is new.
    fn brick(&mut self, code: BrickCode) -> &mut Brick {
        let slot = self.blocks.entry(code.block()).or_insert(BlockSlots::EMPTY).slot(code);
        if *slot == BlockSlots::NONE {
            *slot = self.bricks.push();
            self.codes.push(code);
        }
        self.bricks.get_mut(*slot)
    }

    /// All bricks with their codes.
    fn iter(&self) -> impl Iterator<Item = (BrickCode, &Brick)> {
        self.codes.iter().copied().zip(self.bricks.slices().flatten())
    }

    fn memory(&self) -> usize {
        // hashbrown has one control byte and one (code, BlockSlots) pair per bucket; one bucket in eight stays empty.
        self.bricks.chunks.len() * size_of::<Chunk>()
            + self.bricks.chunks.capacity() * 8
            + self.codes.capacity() * 8
            + self.blocks.capacity() * 8 / 7 * (1 + size_of::<(BlockCode, BlockSlots)>())
    }
}

/// The sums at all vertices.
#[derive(Debug, Clone)]
pub struct Bricks {
    partitions: Vec<Partition>,
}

impl Bricks {
    pub fn new() -> Self {
        Self { partitions: vec![Partition::default(); PARTITIONS] }
    }

    /// Adds lists of contributions, in order.
    pub fn add(&mut self, lists: &[Contributions]) {
        self.partitions.par_iter_mut().enumerate().for_each(|(s, partition)| {
            lists.iter().for_each(|list| partition.add(list.partition(s)));
        });
    }

    /// Adds `sums` to one vertex.
    pub fn add_one(&mut self, key: VertexKey, sums: &VertexSums) {
        self.partitions[key.partition()].brick(key.brick())[key.in_brick()] += sums;
    }

    /// The sums at a vertex, if its brick exists.
    pub fn get(&self, key: VertexKey) -> Option<&VertexSums> {
        let (block, bricks) = self.block(key)?;
        block.find(key.brick()).map(|slot| &bricks.get(slot)[key.in_brick()])
    }

    /// The block of a key, if it exists, and the bricks of its partition.
    fn block(&self, key: VertexKey) -> Option<(&BlockSlots, &BrickList)> {
        let partition = &self.partitions[key.partition()];
        Some((partition.blocks.get(&key.block())?, &partition.bricks))
    }

    /// A reader for looking up neighbouring vertices.
    pub fn reader(&self) -> Reader<'_> {
        Reader { bricks: self, code: BlockCode::NONE, block: None }
    }

    /// For every block, its code and a mask of the members whose sums satisfy `condition`; in parallel.
    pub fn par_masks(
        &self,
        condition: impl Fn(&VertexSums) -> bool + Send + Sync,
    ) -> impl ParallelIterator<Item = (BlockCode, u64)> {
        let blocks = self
            .partitions
            .par_iter()
            .flat_map_iter(|partition| partition.blocks.iter().map(move |(&code, block)| (code, partition, block)));
        blocks.map(move |(code, partition, block)| {
            let members = block.bricks().flat_map(|(i, slot)| (8 * i..).zip(partition.bricks.get(slot)));
            let fulfilling = members.filter(|(_, sums)| condition(sums));
            (code, fulfilling.fold(0, |mask, (member, _)| mask | 1 << member))
        })
    }

    /// All vertices of all bricks with their keys, in parallel.
    pub fn par_iter(&self) -> impl ParallelIterator<Item = (VertexKey, &VertexSums)> {
        let bricks = self.partitions.par_iter().flat_map_iter(Partition::iter);
        bricks.flat_map_iter(|(code, brick)| (0..).zip(brick).map(move |(i, sums)| (code.vertex(i), sums)))
    }

    /// Brick codes, in the order in which [`Bricks::slices`] returns their sums.
    pub fn codes(&self) -> impl Iterator<Item = u64> + '_ {
        self.partitions.iter().flat_map(|partition| partition.codes.iter().map(|code| code.bits()))
    }

    /// The sums, slice by slice.
    pub fn slices(&self) -> impl Iterator<Item = &[Brick]> {
        self.partitions.iter().flat_map(|partition| partition.bricks.slices())
    }

    /// Restores what [`Bricks::codes`] and [`Bricks::slices`] returned, in the same order.
    ///
    /// `None` if a code occurs twice or lies outside the lattice with `cells` per axis.
    pub fn restore(cells: u32, codes: &[u64], bricks: Vec<Brick>) -> Option<Self> {
        let mut restored = Self::new();
        for (&code, brick) in codes.iter().zip(bricks) {
            let code = BrickCode::from_bits(code);
            if !code.is_within(cells) {
                return None;
            }
            let partition = &mut restored.partitions[code.partition()];
            let before = partition.codes.len();
            *partition.brick(code) = brick;
            if partition.codes.len() == before {
                return None;
            }
        }
        Some(restored)
    }

    /// Bytes on the heap.
    pub fn memory(&self) -> usize {
        self.partitions.iter().map(Partition::memory).sum()
    }
}

/// A reader that looks up each block once for consecutive vertices in it.
pub struct Reader<'a> {
    bricks: &'a Bricks,
    /// Code of the block that was looked up last.
    code: BlockCode,
    block: Option<(&'a BlockSlots, &'a BrickList)>,
}

impl Reader<'_> {
    /// The sums at a vertex; zero if its brick does not exist.
    pub fn get(&mut self, key: VertexKey) -> VertexSums {
        if key.block() != self.code {
            self.code = key.block();
            self.block = self.bricks.block(key);
        }
        let brick = self.block.and_then(|(block, bricks)| Some(bricks.get(block.find(key.brick())?)));
        brick.map_or_else(VertexSums::default, |brick| brick[key.in_brick()])
    }
}

impl AddAssign<&Self> for Bricks {
    /// Adds all sums of `other`.
    fn add_assign(&mut self, other: &Self) {
        self.partitions.par_iter_mut().zip(&other.partitions).for_each(|(partition, other)| {
            for (code, brick) in other.iter() {
                let mine = partition.brick(code);
                mine.iter_mut().zip(brick).for_each(|(sum, sums)| *sum += sums);
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    #[test]
    fn sums_of_many_chunks_are_those_of_a_map() {
        // Half a million additions in runs of neighbours, to some 30,000 bricks. Each partition needs several chunks,
        // all of them allocated on the way.
        let (mut bricks, mut map) = (Bricks::new(), BTreeMap::<VertexKey, VertexSums>::new());
        let mut state = 1_u64;
        for _ in 0..5 {
            let lists: Vec<Contributions> = (0..4)
                .map(|_| {
                    let mut list = Contributions::new(0);
                    for _ in 0..2500 {
                        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                        for i in 0..10 {
                            let key = VertexKey::finest((state >> 40) % (1 << 18) + 3 * i);
                            let value = (state >> 11) as f64 / (1_u64 << 53) as f64 + i as f64;
                            let sums = VertexSums { information: [value; 6], rays: 1 };
                            *map.entry(key).or_default() += &sums;
                            list.push(key, sums);
                        }
                    }
                    list
                })
                .collect();
            bricks.add(&lists);
        }
        assert!(bricks.slices().filter(|slice| slice.len() == CHUNK).count() > 2 * PARTITIONS);
        let found: BTreeMap<VertexKey, VertexSums> =
            bricks.par_iter().filter(|(_, e)| e.rays > 0).map(|(key, e)| (key, *e)).collect();
        assert_eq!(found, map);
        assert!(
            (0..1 << 18)
                .map(VertexKey::finest)
                .all(|key| bricks.get(key).copied().unwrap_or_default() == map.get(&key).copied().unwrap_or_default())
        );
        // Save and restore.
        let codes: Vec<u64> = bricks.codes().collect();
        let restored = Bricks::restore(1 << 7, &codes, bricks.slices().flatten().copied().collect()).unwrap();
        assert!(restored.codes().eq(codes) && restored.slices().flatten().eq(bricks.slices().flatten()));
    }

    #[test]
    fn a_brick_takes_seven_cache_lines() {
        assert_eq!((size_of::<Chunk>(), align_of::<Chunk>()), (CHUNK * 7 * 64, 64));
    }
}
