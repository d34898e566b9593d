//! Sums at sparse lattice points.
//!
//! A vertex is keyed by its point on the lattice of its own level: `key` = coarseness · 2⁵⁷ + Morton code of
//! (point / 2^coarseness). Coarseness 0 is the finest lattice. The eight keys that differ only in their low three bits
//! form an aligned 2³ *brick*, which stores the positions of its vertices' sums. A vertex has sums once a ray has
//! touched it. (Bricks that held the sums of all their vertices took twice the memory where rays are sparse for the
//! lattice.) Eight bricks form a *block*, which is found by hashing. (A table of bricks does not fit into the caches.)
//! A hash also distributes blocks over partitions, and each partition is owned by one thread at a time.

use std::hint::black_box;
use std::ops::AddAssign;

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::key::{BlockCode, Contribution, Contributions, PARTITIONS, VertexKey};
use super::pages::{PagedList, expected_spare};
use crate::Result;
use crate::posterior::Sums;

/// Where the eight parts of something are in a list of its partition: a block's bricks, or the sums of a brick's
/// vertices.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(transparent)]
struct Slots([u32; 8]);

impl Slots {
    /// Marks a part that does not exist.
    const NONE: u32 = u32::MAX;
    const EMPTY: Self = Self([Self::NONE; 8]);

    /// The parts that exist: number, slot.
    fn parts(self) -> impl Iterator<Item = (usize, u32)> {
        self.0.into_iter().enumerate().filter(|(_, slot)| *slot != Self::NONE)
    }

    /// The slot of a part, which `make` makes if it does not exist.
    #[inline]
    fn slot(&mut self, part: usize, make: impl FnOnce() -> u32) -> u32 {
        let slot = &mut self.0[part];
        if *slot == Self::NONE {
            *slot = make();
        }
        *slot
    }
}

/// Expected bytes that are not used yet beside those of so many sums, and of as many bricks at most.
pub fn spare_bytes(sums: f64) -> f64 {
    (2 * PARTITIONS * expected_spare((sums / PARTITIONS as f64) as usize)) as f64
}

/// Number of contributions whose slots are looked up before the first of them is added.
const LOOKAHEAD: usize = 32;

/// The blocks that hash to one partition.
#[derive(Debug, Clone)]
struct Partition<S: Sums> {
    blocks: FxHashMap<BlockCode, Slots>,
    bricks: PagedList<Slots>,
    /// In the order in which rays first touched their vertices.
    sums: PagedList<S>,
}

impl<S: Sums> Default for Partition<S> {
    fn default() -> Self {
        Self { blocks: FxHashMap::default(), bricks: PagedList::default(), sums: PagedList::default() }
    }
}

impl<S: Sums> Partition<S> {
    /// Adds contributions in order. Neighbours in the list are usually neighbours in space.
    fn add(&mut self, contributions: &[Contribution<S::Square>]) {
        let mut slots = [0; LOOKAHEAD];
        for some in contributions.chunks(LOOKAHEAD) {
            let slots = &mut slots[..some.len()];
            let mut next = slots.iter_mut();
            for run in some.chunk_by(|a, b| a.key.block() == b.key.block()) {
                let block = self.blocks.entry(run[0].key.block()).or_insert(Slots::EMPTY);
                for (c, slot) in run.iter().zip(&mut next) {
                    *slot = block.slot(c.key.brick_in_block(), || self.bricks.push(Slots::EMPTY));
                }
            }
            // Touches all of them first, here and below, so that their cache misses overlap.
            black_box(slots.iter().fold(0, |any, &slot| any | self.bricks.get(slot).0[0]));
            for (c, slot) in some.iter().zip(&mut *slots) {
                *slot = self.bricks.get_mut(*slot).slot(c.key.in_brick(), || self.sums.push(S::default()));
            }
            black_box(slots.iter().fold(0, |any, &slot| any | self.sums.get(slot).rays()));
            for (c, &slot) in some.iter().zip(&*slots) {
                *self.sums.get_mut(slot) += &S::of_ray(c.square);
            }
        }
    }

    /// The sums of a vertex, made if they are new.
    fn vertex(&mut self, key: VertexKey) -> &mut S {
        let block = self.blocks.entry(key.block()).or_insert(Slots::EMPTY);
        let brick = block.slot(key.brick_in_block(), || self.bricks.push(Slots::EMPTY));
        let slot = self.bricks.get_mut(brick).slot(key.in_brick(), || self.sums.push(S::default()));
        self.sums.get_mut(slot)
    }

    /// The vertices of a block: number in it, slot of their sums.
    fn members(&self, block: Slots) -> impl Iterator<Item = (usize, u32)> {
        block.parts().flat_map(|(b, brick)| self.bricks.get(brick).parts().map(move |(i, slot)| (8 * b + i, slot)))
    }

    /// All vertices with the slots of their sums, block by block.
    fn slots(&self) -> impl Iterator<Item = (VertexKey, u32)> {
        let blocks = self.blocks.iter();
        blocks.flat_map(|(&code, &block)| self.members(block).map(move |(i, slot)| (code.vertex(i as u64), slot)))
    }

    /// All vertices with their sums, block by block.
    fn iter(&self) -> impl Iterator<Item = (VertexKey, &S)> {
        self.slots().map(|(key, slot)| (key, self.sums.get(slot)))
    }

    /// The keys of all vertices, in the order of their sums.
    fn keys(&self) -> Vec<VertexKey> {
        let mut keys = vec![VertexKey::NONE; self.sums.len()];
        self.slots().for_each(|(key, slot)| keys[slot as usize] = key);
        keys
    }

    fn memory(&self) -> usize {
        // hashbrown has one control byte and one pair per bucket; one bucket in eight stays empty.
        self.sums.memory()
            + self.bricks.memory()
            + self.blocks.capacity() * 8 / 7 * (1 + size_of::<(BlockCode, Slots)>())
    }
}

/// The sums at all vertices that rays touched.
#[derive(Debug, Clone)]
pub struct SparseSums<S: Sums> {
    partitions: Vec<Partition<S>>,
}

impl<S: Sums> SparseSums<S> {
    pub fn new() -> Self {
        Self { partitions: vec![Partition::default(); PARTITIONS] }
    }

    /// Adds lists of contributions, in order.
    pub fn add(&mut self, lists: &[Contributions<S::Square>]) {
        self.partitions.par_iter_mut().enumerate().for_each(|(s, partition)| {
            lists.iter().for_each(|list| partition.add(list.partition(s)));
        });
    }

    /// Adds `sums` to one vertex.
    pub fn add_one(&mut self, key: VertexKey, sums: &S) {
        *self.partitions[key.partition()].vertex(key) += sums;
    }

    /// The sums at a vertex, if a ray touched it.
    pub fn get(&self, key: VertexKey) -> Option<&S> {
        self.reader().find(key)
    }

    /// A reader for looking up neighbouring vertices.
    pub fn reader(&self) -> Reader<'_, S> {
        Reader { sums: self, code: None, block: Slots::EMPTY, partition: &self.partitions[0] }
    }

    /// For every block, its code and a mask of the vertices whose sums satisfy `condition`; in parallel, a list for
    /// each partition.
    pub fn par_masks(
        &self,
        condition: impl Fn(&S) -> bool + Send + Sync,
    ) -> impl ParallelIterator<Item = Vec<(BlockCode, u64)>> {
        self.partitions.par_iter().map(move |partition| {
            // The sums in the order of memory, blocks in that of their table.
            let fulfils: Vec<bool> = partition.sums.slices().flatten().map(&condition).collect();
            let mask = |(&code, &block)| {
                let fulfilling = partition.members(block).filter(|(_, slot)| fulfils[*slot as usize]);
                (code, fulfilling.fold(0, |mask, (i, _)| mask | 1 << i))
            };
            partition.blocks.iter().map(mask).collect()
        })
    }

    /// Calls `write` with every vertex, in the order of their keys.
    pub fn in_order(&self, mut write: impl FnMut(VertexKey, S) -> Result<()>) -> Result<()> {
        let of = |(n, partition): (usize, &Partition<S>)| {
            partition.blocks.keys().map(move |code| (*code, n as u8)).collect::<Vec<_>>()
        };
        let mut blocks: Vec<(BlockCode, u8)> = self.partitions.iter().enumerate().flat_map(of).collect();
        blocks.par_sort_unstable();
        for (code, n) in blocks {
            let partition = &self.partitions[usize::from(n)];
            for (i, slot) in partition.members(partition.blocks[&code]) {
                write(code.vertex(i as u64), *partition.sums.get(slot))?;
            }
        }
        Ok(())
    }

    /// All vertices with their keys, in parallel.
    pub fn par_iter(&self) -> impl ParallelIterator<Item = (VertexKey, &S)> {
        self.partitions.par_iter().flat_map_iter(Partition::iter)
    }

    /// Keys of vertices, in the order in which [`SparseSums::slices`] returns their sums.
    pub fn keys(&self) -> impl Iterator<Item = VertexKey> + '_ {
        self.partitions.iter().flat_map(Partition::keys)
    }

    /// The sums, slice by slice.
    pub fn slices(&self) -> impl Iterator<Item = &[S]> {
        self.partitions.iter().flat_map(|partition| partition.sums.slices())
    }

    /// Restores what [`SparseSums::keys`] and [`SparseSums::slices`] returned, in the same order.
    ///
    /// `None` if a key occurs twice or lies outside the lattice with `cells` per axis.
    pub fn restore(cells: u32, keys: &[u64], sums: Vec<S>) -> Option<Self> {
        let mut restored = Self::new();
        for (&key, sums) in keys.iter().zip(sums) {
            let key = VertexKey::from_bits(key);
            if !key.is_within(cells) {
                return None;
            }
            let partition = &mut restored.partitions[key.partition()];
            let before = partition.sums.len();
            *partition.vertex(key) = sums;
            if partition.sums.len() == before {
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
pub struct Reader<'a, S: Sums> {
    sums: &'a SparseSums<S>,
    /// Code of the block that was looked up last.
    code: Option<BlockCode>,
    block: Slots,
    partition: &'a Partition<S>,
}

impl<'a, S: Sums> Reader<'a, S> {
    /// The sums at a vertex, if a ray touched it.
    pub fn find(&mut self, key: VertexKey) -> Option<&'a S> {
        if self.code != Some(key.block()) {
            self.partition = &self.sums.partitions[key.partition()];
            self.code = Some(key.block());
            self.block = self.partition.blocks.get(&key.block()).copied().unwrap_or(Slots::EMPTY);
        }
        let brick = self.block.0[key.brick_in_block()];
        if brick == Slots::NONE {
            return None;
        }
        let slot = self.partition.bricks.get(brick).0[key.in_brick()];
        (slot != Slots::NONE).then(|| self.partition.sums.get(slot))
    }
}

impl<S: Sums> AddAssign<&Self> for SparseSums<S> {
    /// Adds all sums of `other`.
    fn add_assign(&mut self, other: &Self) {
        self.partitions.par_iter_mut().zip(&other.partitions).for_each(|(partition, other)| {
            for (key, sums) in other.iter() {
                *partition.vertex(key) += sums;
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use rand::rngs::ChaCha8Rng;
    use rand::{RngExt, SeedableRng};

    use super::*;
    use crate::posterior::{DiagonalSums, VertexSums};

    #[test]
    fn sums_are_those_of_a_map() {
        are_those_of_a_map::<VertexSums>(|value| [value; 6]);
        are_those_of_a_map::<DiagonalSums>(|value| [value; 3]);
    }

    fn are_those_of_a_map<S: Sums>(square: impl Fn(f64) -> S::Square) {
        // Half a million additions in runs of neighbours, to some 200,000 vertices. Each partition needs many pages.
        let (mut sparse, mut map) = (SparseSums::<S>::new(), BTreeMap::<VertexKey, S>::new());
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for _ in 0..5 {
            let lists: Vec<Contributions<_>> = (0..4)
                .map(|_| {
                    let mut list = Contributions::default();
                    for _ in 0..2500 {
                        let state: u64 = rng.random();
                        for i in 0..10 {
                            let key = VertexKey::from_bits((state >> 40) % (1 << 18) + 3 * i);
                            let value = (state >> 11) as f64 / (1_u64 << 53) as f64 + i as f64;
                            *map.entry(key).or_default() += &S::of_ray(square(value));
                            list.push(key, square(value));
                        }
                    }
                    list
                })
                .collect();
            sparse.add(&lists);
        }
        assert!(sparse.slices().count() == PARTITIONS && sparse.slices().all(|sums| size_of_val(sums) > 16 << 12));
        let found: BTreeMap<VertexKey, S> = sparse.par_iter().map(|(key, e)| (key, *e)).collect();
        assert_eq!(found, map);
        let mut reader = sparse.reader();
        for key in (0..1 << 18).map(VertexKey::from_bits) {
            assert_eq!(reader.find(key), map.get(&key));
            assert_eq!(sparse.get(key), map.get(&key));
        }
        // Save and restore.
        let keys: Vec<u64> = sparse.keys().map(VertexKey::bits).collect();
        let sums = || sparse.slices().flatten().copied().collect::<Vec<_>>();
        let restored = SparseSums::restore(1 << 7, &keys, sums()).unwrap();
        assert!(restored.keys().map(VertexKey::bits).eq(keys.iter().copied()));
        assert!(restored.slices().eq(sparse.slices()));
        let twice = [&keys[..1], &keys[..]].concat();
        assert!(SparseSums::restore(1 << 7, &twice, [&sums()[..1], &sums()].concat()).is_none());
        assert!(SparseSums::restore(1 << 3, &keys, sums()).is_none(), "outside");
    }
}
