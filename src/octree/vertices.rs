//! The free vertices of an octree, numbered.
//!
//! A vertex is as coarse as the finest leaf that touches it: its *coarseness* is the number of levels from the finest one to that
//! leaf's. Vertices of one coarseness lie on one lattice, side by side along surfaces, and make one [`MortonSet`] of points of that
//! lattice. Ids run through the sets, the finest first, in Morton order within each.

use super::set::BrickRank;
use super::{MortonSet, morton};

/// Bricks that a search remembers: as many as the corners of a cell can lie in.
const RECENT: usize = 8;

/// A search that looks every brick up once; the plain way is [`VertexTable::find_at`].
pub struct Finder<'a> {
    table: &'a VertexTable,
    /// Coarseness, code and content of bricks looked up lately.
    recent: [Option<(u8, u64, Option<BrickRank>)>; RECENT],
    next: usize,
}

impl Finder<'_> {
    /// As [`VertexTable::find_at`].
    pub fn find_at(&mut self, point: [u32; 3], coarseness: u8) -> Option<u32> {
        if point.iter().any(|i| i.trailing_zeros() < u32::from(coarseness)) {
            return None;
        }
        let code = morton::encode(point.map(|i| i >> coarseness));
        let known = self.recent.iter().flatten().find(|(c, brick, _)| (*c, *brick) == (coarseness, code >> 6));
        let brick = match known {
            Some((.., brick)) => *brick,
            None => {
                let brick = self.table.sets.get(usize::from(coarseness))?.brick(code >> 6);
                self.recent[self.next % RECENT] = Some((coarseness, code >> 6, brick));
                self.next += 1;
                brick
            }
        };
        Some(self.table.offsets[usize::from(coarseness)] + brick?.rank(code)?)
    }
}

/// All free vertices.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct VertexTable {
    /// One set per coarseness, 0 first.
    sets: Vec<MortonSet>,
    /// Vertices of all sets before each.
    offsets: Vec<u32>,
}

impl VertexTable {
    /// The table of an octree with levels 0 to `finest`, from the vertices of each coarseness as Morton codes of their points on their
    /// own lattice, in any order and repeated or not.
    ///
    /// # Panics
    /// If there are more than 2³² − 1 vertices.
    #[must_use]
    pub fn new(finest: u8, codes: Vec<Vec<u64>>) -> Self {
        let mut offsets = Vec::with_capacity(codes.len());
        let mut before = 0_u32;
        let numbered = (0_u32..).zip(codes).map(|(coarseness, mut codes)| {
            codes.sort_unstable();
            codes.dedup();
            offsets.push(before);
            before =
                u32::try_from(codes.len()).ok().and_then(|n| before.checked_add(n)).expect("at most 2^32 - 1 vertices");
            MortonSet::from_sorted(3 * (u32::from(finest) - coarseness + 1), &codes)
        });
        let sets = numbered.collect();
        Self { sets, offsets }
    }

    /// Number of vertices.
    #[must_use]
    pub fn len(&self) -> usize {
        self.sets.iter().map(MortonSet::len).sum()
    }

    /// The number of the vertex at a lattice point that has the given coarseness, if there is one.
    #[must_use]
    pub fn find_at(&self, point: [u32; 3], coarseness: u8) -> Option<u32> {
        if point.iter().any(|i| i.trailing_zeros() < u32::from(coarseness)) {
            return None;
        }
        let rank = self.sets.get(usize::from(coarseness))?.rank(morton::encode(point.map(|i| i >> coarseness)))?;
        Some(self.offsets[usize::from(coarseness)] + rank)
    }

    /// A search for neighbouring vertices.
    #[must_use]
    pub fn finder(&self) -> Finder<'_> {
        Finder { table: self, recent: [None; RECENT], next: 0 }
    }

    /// The number of the vertex at a lattice point, if there is one.
    #[must_use]
    pub fn find(&self, point: [u32; 3]) -> Option<u32> {
        (0..self.sets.len() as u8).find_map(|coarseness| self.find_at(point, coarseness))
    }

    /// The points of all vertices, by number.
    pub fn points(&self) -> impl Iterator<Item = [u32; 3]> + '_ {
        let sets = (0_u32..).zip(&self.sets);
        sets.flat_map(|(coarseness, set)| set.iter().map(move |code| morton::decode(code).map(|i| i << coarseness)))
    }

    /// Bytes on the heap, spare capacity included.
    #[must_use]
    pub fn heap_bytes(&self) -> usize {
        let sets: usize = self.sets.iter().map(MortonSet::heap_bytes).sum();
        sets + self.sets.capacity() * size_of::<MortonSet>() + self.offsets.capacity() * 4
    }
}
