//! Names of vertices and of blocks, where their sums are found, and the contributions of rays to these sums: in one
//! list per partition, which that partition reads from beginning to end.
//!
//! The bits of a vertex's key, from the lowest: its number in its brick (3), the brick's number in its block (3), the
//! rest of the Morton code of its point on the lattice of its own level, and from bit 57 on how much coarser than the
//! finest lattice that level is.

use crate::octree::morton;

/// Partitions: enough to keep many cores busy, few enough that their lists stay long.
const PARTITION_BITS: u32 = 6;
pub const PARTITIONS: usize = 1 << PARTITION_BITS;
const COARSENESS_SHIFT: u32 = 57;

/// A vertex: a lattice point and the level of its leaves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct VertexKey(u64);

/// An aligned 2³ block of bricks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BlockCode(u64);

impl VertexKey {
    /// No vertex has this key.
    pub const NONE: Self = Self(u64::MAX);

    /// The vertex at `point`, which must be a multiple of 2^`coarseness` along every axis.
    #[inline]
    pub fn new(point: [u32; 3], coarseness: u8) -> Self {
        Self(u64::from(coarseness) << COARSENESS_SHIFT | morton::encode(point.map(|i| i >> coarseness)))
    }

    /// A key from [`VertexKey::bits`], or from an untrusted file.
    pub fn from_bits(bits: u64) -> Self {
        Self(bits)
    }

    /// For files.
    pub fn bits(self) -> u64 {
        self.0
    }

    /// Whether its point lies on a lattice with `cells` per axis.
    pub fn is_within(self, cells: u32) -> bool {
        // Each level of coarseness halves the lattice until one cell remains.
        let coarseness = self.coarseness();
        coarseness <= u64::from(cells.ilog2())
            && morton::decode(self.0 & ((1 << COARSENESS_SHIFT) - 1)).iter().all(|&i| i <= cells >> coarseness)
    }

    /// The vertex of the finest leaves at the point with this Morton code.
    #[inline]
    pub fn finest(code: u64) -> Self {
        Self(code)
    }

    /// Its point on the finest lattice.
    pub fn point(self) -> [u32; 3] {
        morton::decode(self.0 & ((1 << COARSENESS_SHIFT) - 1)).map(|i| i << self.coarseness())
    }

    /// Levels between its leaves and the finest lattice.
    pub fn coarseness(self) -> u64 {
        self.0 >> COARSENESS_SHIFT
    }

    /// Its number in its brick, 0 to 7.
    #[inline]
    pub fn in_brick(self) -> usize {
        (self.0 & 7) as usize
    }

    /// The number of its brick in its block, 0 to 7.
    #[inline]
    pub fn brick_in_block(self) -> usize {
        (self.0 >> 3 & 7) as usize
    }

    /// The block that holds its brick.
    #[inline]
    pub fn block(self) -> BlockCode {
        BlockCode(self.0 >> 6)
    }

    /// The partition that owns it.
    #[inline]
    pub fn partition(self) -> usize {
        // Fibonacci hashing of the block's code (Knuth, TAOCP 3, 6.4).
        ((self.0 >> 6).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> (64 - PARTITION_BITS)) as usize
    }
}

impl BlockCode {
    /// The bits: of finest vertices, those of a Morton code without its lowest six.
    pub fn bits(self) -> u64 {
        self.0
    }

    /// The block with these bits; those of finest vertices are a part of a Morton code.
    pub fn of(bits: u64) -> Self {
        Self(bits)
    }

    /// Whether its vertices are those of the finest leaves.
    pub fn is_finest(self) -> bool {
        self.vertex(0).coarseness() == 0
    }

    /// One of its 64 vertices.
    pub fn vertex(self, in_block: u64) -> VertexKey {
        VertexKey(self.0 << 6 | in_block)
    }
}

/// The contribution of one ray to one vertex: `square` has entries of JᵀJ.
#[derive(Debug, Clone, Copy)]
pub struct Contribution<T> {
    pub key: VertexKey,
    pub square: T,
}

/// The contributions of a batch of rays, by partition, each in ray order.
#[derive(Debug)]
pub struct Contributions<T>(Vec<Vec<Contribution<T>>>);

impl<T> Default for Contributions<T> {
    fn default() -> Self {
        Self((0..PARTITIONS).map(|_| Vec::new()).collect())
    }
}

impl<T> Contributions<T> {
    /// Empties the lists; their room stays.
    pub fn clear(&mut self) {
        self.0.iter_mut().for_each(Vec::clear);
    }

    /// Appends a contribution of the current ray or the next one.
    #[inline(always)]
    pub fn push(&mut self, key: VertexKey, square: T) {
        self.0[key.partition()].push(Contribution { key, square });
    }

    /// All of them, partition by partition.
    pub fn iter(&self) -> impl Iterator<Item = &Contribution<T>> {
        self.0.iter().flatten()
    }

    /// The list of one partition.
    pub fn partition(&self, s: usize) -> &[Contribution<T>] {
        &self.0[s]
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
            let key = VertexKey::new(at, coarseness);
            prop_assert_eq!((key.point(), key.coarseness()), (at, u64::from(coarseness)));
            prop_assert_eq!(key.block().vertex((8 * key.brick_in_block() + key.in_brick()) as u64), key);
            prop_assert_eq!(VertexKey::from_bits(key.bits()), key);
            prop_assert!(key.is_within(1 << 16) && key.partition() < PARTITIONS);
        }
    }
}
