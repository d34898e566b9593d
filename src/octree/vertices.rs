//! The numbered free vertices of an octree.
//!
//! A vertex is as coarse as the finest leaf that touches it: its *coarseness* is the number of levels from
//! the finest one to that of this leaf. Vertices of one coarseness lie on one lattice, side by side along
//! surfaces, and form one [`MortonSet`] of points of that lattice. Ids run through the sets from the finest,
//! in Morton order within each.

use rayon::prelude::*;

use super::set::BrickRank;
use super::{MortonSet, morton};

/// Number of coarsenesses whose bricks a search caches separately.
const KEPT: usize = 4;

/// A search that looks up a brick once for all its vertices in a row. [`VertexTable::find_at`] is the plain way.
pub struct Finder<'a> {
    table: &'a VertexTable,
    /// Bricks looked up recently: key and content, by coarseness and the low bits of the code. These bits
    /// distinguish the eight bricks around a point.
    recent: [(u64, Option<BrickRank>); 8 * KEPT],
}

impl Finder<'_> {
    /// A key that no brick has.
    const NONE: u64 = u64::MAX;

    /// As [`VertexTable::find_at`].
    pub fn find_at(&mut self, point: [u32; 3], coarseness: u8) -> Option<u32> {
        if (point[0] | point[1] | point[2]).trailing_zeros() < u32::from(coarseness) {
            return None;
        }
        let code = morton::encode(point.map(|i| i >> coarseness));
        let key = u64::from(coarseness) << 58 | code >> 6;
        let recent = &mut self.recent[usize::from(coarseness) % KEPT * 8 + (code >> 6 & 7) as usize];
        if recent.0 != key {
            *recent = (key, self.table.sets.get(usize::from(coarseness))?.brick(code >> 6));
        }
        Some(self.table.offsets[usize::from(coarseness)] + recent.1?.rank(code)?)
    }
}

/// All free vertices.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct VertexTable {
    /// One set per coarseness, 0 first.
    sets: Vec<MortonSet>,
    /// Number of vertices before each set.
    offsets: Vec<u32>,
}

impl VertexTable {
    /// Builds the table from the vertices of each coarseness, 0 first, as points of their own lattice.
    ///
    /// # Panics
    /// If there are more than 2³² − 1 vertices.
    #[must_use]
    pub fn new(sets: Vec<MortonSet>) -> Self {
        let mut before = 0_u32;
        let mut offset = |set: &MortonSet| {
            let offset = before;
            before =
                u32::try_from(set.len()).ok().and_then(|n| before.checked_add(n)).expect("at most 2^32 - 1 vertices");
            offset
        };
        let offsets = sets.iter().map(&mut offset).collect();
        Self { sets, offsets }
    }

    /// The vertices of finest leaves, whose numbers are their ranks.
    #[must_use]
    pub fn finest(&self) -> &MortonSet {
        &self.sets[0]
    }

    /// Number of vertices.
    #[must_use]
    pub fn len(&self) -> usize {
        self.sets.iter().map(MortonSet::len).sum()
    }

    /// The number of the vertex of the given coarseness at a lattice point, if there is one.
    #[must_use]
    pub fn find_at(&self, point: [u32; 3], coarseness: u8) -> Option<u32> {
        if point.iter().any(|i| i.trailing_zeros() < u32::from(coarseness)) {
            return None;
        }
        let rank = self.sets.get(usize::from(coarseness))?.rank(morton::encode(point.map(|i| i >> coarseness)))?;
        Some(self.offsets[usize::from(coarseness)] + rank)
    }

    /// A search for vertices that are near each other.
    #[must_use]
    pub fn finder(&self) -> Finder<'_> {
        Finder { table: self, recent: [(Finder::NONE, None); 8 * KEPT] }
    }

    /// The number of the vertex at a lattice point, if there is one.
    #[must_use]
    pub fn find(&self, point: [u32; 3]) -> Option<u32> {
        (0..self.sets.len() as u8).find_map(|coarseness| self.find_at(point, coarseness))
    }

    /// The points of all vertices, by number.
    pub fn points(&self) -> impl Iterator<Item = [u32; 3]> + '_ {
        self.points_from(0)
    }

    /// The points of the vertices from this number on.
    fn points_from(&self, number: u32) -> impl Iterator<Item = [u32; 3]> + '_ {
        let first = self.offsets.partition_point(|&offset| offset <= number) - 1;
        let rest = (0_u32..).zip(&self.sets).zip(&self.offsets).skip(first);
        rest.flat_map(move |((coarseness, set), &offset)| {
            set.iter_from(number.saturating_sub(offset)).map(move |code| morton::decode(code).map(|i| i << coarseness))
        })
    }

    /// [`VertexTable::points`] in parallel.
    pub fn par_points(&self) -> impl IndexedParallelIterator<Item = [u32; 3]> + '_ {
        let nowhere = || None;
        (0..self.len() as u32).into_par_iter().map_init(nowhere, |at, number| {
            // Consecutive numbers mostly follow each other on the same thread.
            let (next, points) = match at {
                Some((next, points)) if *next == number => (next, points),
                _ => {
                    let (next, points) = at.insert((number, self.points_from(number)));
                    (next, points)
                }
            };
            *next += 1;
            points.next().expect("a point of every number")
        })
    }

    /// Bytes on the heap, spare capacity included.
    #[must_use]
    pub fn heap_bytes(&self) -> usize {
        let sets: usize = self.sets.iter().map(MortonSet::heap_bytes).sum();
        sets + self.sets.capacity() * size_of::<MortonSet>() + self.offsets.capacity() * 4
    }
}
