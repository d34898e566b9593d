//! An adaptive octree of deformation vertices.
//!
//! The *lattice* is {0..M}³, M = 2^finest. A *leaf* of level ℓ has edge 2^(finest − ℓ) lattice units. A
//! lattice point that is a corner of every leaf touching it is a *free vertex* and carries a value. A corner
//! that lies inside a face or an edge of a larger leaf is *hanging* and carries none. Its value is the mean
//! of the four corners of that face or the two ends of that edge, which makes interpolated functions
//! continuous. Leaves that touch, even only at a corner, differ by at most one level (2:1 balance). Hence
//! these corners and ends are themselves free.
//!
//! This module does not depend on rays, colour or uncertainty.

mod balance;
mod blocks;
mod cells;
mod cursor;
mod free;
mod leaf_table;
mod leaves;
mod masks;
mod max_levels;
#[doc(hidden)]
pub mod morton;
mod nearby;
mod set;
mod validate;
mod vertices;

pub(crate) use balance::SplitSet;
pub(crate) use blocks::{BLOCK, BRICK};
pub use cells::Cell;
pub(crate) use cursor::Cursor;
pub(crate) use leaf_table::LeafTable;
pub use leaves::Leaves;
#[doc(hidden)]
pub use leaves::coarseness;
pub(crate) use leaves::{masters, mean_volume};
pub(crate) use masks::MaskSet;
pub(crate) use max_levels::DEPTH;
pub use max_levels::MaxLevels;
pub(crate) use nearby::Nearby;
pub(crate) use set::MortonSet;

// What only the program, Python and the experiments name.
#[doc(hidden)]
pub use cells::CellTree;
#[doc(hidden)]
pub use validate::{Defect, OctreeStats};

use free::free_vertices;
use glam::DVec3;
use leaves::hanging_on;
use rayon::iter::IndexedParallelIterator;
use vertices::{Finder, VertexTable};

/// Index of a free vertex. Ids run from the finest coarseness up, in Morton order within each.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct VertexId(pub u32);

/// Where the value at a leaf's corner comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[doc(hidden)]
pub enum Corner {
    /// The corner is a free vertex.
    Free(VertexId),
    /// The corner is the middle of an edge of a larger leaf: the mean of two vertices.
    OnEdge([VertexId; 2]),
    /// The corner is the middle of a face of a larger leaf: the mean of four vertices.
    OnFace([VertexId; 4]),
}

impl Corner {
    /// The free vertices that determine the value here, with equal weights.
    #[must_use]
    pub fn masters(&self) -> &[VertexId] {
        match self {
            Self::Free(v) => std::slice::from_ref(v),
            Self::OnEdge(v) => v,
            Self::OnFace(v) => v,
        }
    }
}

/// The leaf around a point, with everything needed to interpolate there.
#[cfg(test)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Located {
    /// The leaf that contains the point.
    pub leaf: Cell,
    /// Its eight corners. In the index of a corner, bit 0 is x, bit 1 y, bit 2 z.
    pub corners: [Corner; 8],
    /// Trilinear weights of the corners, ≥ 0, summing to 1.
    pub weights: [f64; 8],
}

/// Trilinear weights of the eight corners for an offset in `[0, 1]`³. In the index of a corner, bit 0 is x,
/// bit 1 y, bit 2 z.
#[must_use]
#[inline]
pub fn trilinear(offset: DVec3) -> [f64; 8] {
    std::array::from_fn(|c| {
        (0..3).map(|axis| if c >> axis & 1 == 1 { offset[axis] } else { 1.0 - offset[axis] }).product()
    })
}

/// The corners of a finest-level cell with their trilinear weights at an offset in `[0, 1]`³, in the order of
/// [`trilinear`].
#[must_use]
#[inline]
pub fn corners(cell: [u32; 3], offset: DVec3) -> [([u32; 3], f64); 8] {
    let weights = trilinear(offset);
    std::array::from_fn(|c| (std::array::from_fn(|axis| cell[axis] + (c as u32 >> axis & 1)), weights[c]))
}

/// A complete, 2:1 balanced octree with its free vertices.
///
/// ```
/// use octobayes::octree::{Cell, Octree};
///
/// // One cell of level 3 is wanted; balance and completeness bring the others.
/// let octree = Octree::refined(3, [Cell { level: 3, index: [0, 0, 0] }]);
/// assert!(octree.validate().is_ok());
/// // Far fewer vertices than the 9³ of the uniform grid.
/// assert!(octree.vertex_count() < 100);
/// // The wanted cell's corners are vertices; the middle of a coarse cell is none.
/// assert!(octree.vertex([1, 1, 1]).is_some() && octree.vertex([6, 6, 6]).is_none());
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Octree {
    cells: CellTree,
    vertices: VertexTable,
}

impl Octree {
    /// The coarsest balanced octree in which every cell of `wanted` exists, as a leaf or split further.
    #[must_use]
    pub fn refined(finest: u8, wanted: impl IntoIterator<Item = Cell>) -> Self {
        let mut all = SplitSet::new(finest);
        wanted.into_iter().for_each(|cell| all.cell(cell));
        Self::from_split_set(all)
    }

    /// The coarsest balanced octree in which every wanted cell exists, as a leaf or split further.
    #[must_use]
    pub fn from_split_set(wanted: SplitSet) -> Self {
        let split = wanted.balanced();
        let cells = CellTree::from_split(&split);
        Self { cells, vertices: VertexTable::new(free_vertices(split)) }
    }

    /// The octree of a stored sequence of child masks, which may come from an untrusted file.
    ///
    /// # Errors
    /// If the masks are inconsistent or the tree is not 2:1 balanced: a sentence that names what is wrong.
    pub fn from_raw(finest: u8, root_split: bool, masks: &[u8]) -> Result<Self, String> {
        let mut wanted = SplitSet::new(finest);
        for (level, codes) in (0..finest).zip(CellTree::split_from_raw(finest, root_split, masks)?) {
            codes.into_iter().for_each(|code| wanted.cell(Cell { level, index: morton::decode(code) }.child(0)));
        }
        let split = wanted.balanced();
        let cells = CellTree::from_split(&split);
        let (own_root_split, own_masks) = cells.raw();
        if own_root_split != root_split || own_masks != masks {
            return Err("the child masks describe an octree that is not 2:1 balanced".into());
        }
        Ok(Self { cells, vertices: VertexTable::new(free_vertices(split)) })
    }

    /// The tree of cells.
    #[must_use]
    pub fn cells(&self) -> &CellTree {
        &self.cells
    }

    /// The finest level.
    #[must_use]
    pub fn finest(&self) -> u8 {
        self.cells.finest()
    }

    /// Number of free vertices.
    #[must_use]
    pub fn vertex_count(&self) -> usize {
        self.vertices.len()
    }

    /// The free vertex at a lattice point, if there is one.
    #[must_use]
    pub fn vertex(&self, point: [u32; 3]) -> Option<VertexId> {
        self.vertices.find(point).map(VertexId)
    }

    /// Lattice positions of all free vertices, in the order of their ids.
    pub fn vertex_positions(&self) -> impl Iterator<Item = [u32; 3]> + '_ {
        self.vertices.points()
    }

    /// [`Octree::vertex_positions`] in parallel.
    #[must_use]
    pub fn par_vertex_positions(&self) -> impl IndexedParallelIterator<Item = [u32; 3]> + '_ {
        self.vertices.par_points()
    }

    /// Checks whether all (up to eight) finest cells around a lattice point are leaves.
    #[must_use]
    pub fn is_surrounded_by_finest(&self, point: [u32; 3]) -> bool {
        cells_around(point, self.finest()).all(|cell| self.cells.leaf(cell).level == self.finest())
    }

    /// The leaf, corners and weights at lattice coordinates `u` in `[0, M]`³.
    #[must_use]
    #[cfg(test)]
    pub fn locate(&self, u: DVec3) -> Located {
        let mut cursor = self.cursor();
        cursor.seek(u);
        Located { leaf: cursor.leaf(), corners: *cursor.corners(), weights: cursor.weights(u) }
    }

    /// A cursor for interpolation from point to point.
    #[must_use]
    pub fn cursor(&self) -> Cursor<'_> {
        Cursor::new(self)
    }

    /// Where the value at a lattice point comes from. The point must be a corner of some leaf.
    ///
    /// # Panics
    /// If it is a corner of no leaf.
    #[must_use]
    #[doc(hidden)]
    pub fn corner(&self, point: [u32; 3]) -> Corner {
        match self.vertex(point) {
            Some(vertex) => Corner::Free(vertex),
            None => self.hanging(point, |end| self.vertex(end)),
        }
    }

    /// As [`Octree::corner`], for a corner of `leaf`.
    ///
    /// Leaves that touch it are at most one level finer, so its vertices are searched among two coarsenesses.
    fn corner_of(&self, leaf: Cell, point: [u32; 3], finder: &mut Finder) -> Corner {
        let coarseness = self.finest() - leaf.level;
        let mut find = |point, coarseness: u8| {
            let vertex = finder.find_at(point, coarseness);
            vertex.or_else(|| finder.find_at(point, coarseness.checked_sub(1)?)).map(VertexId)
        };
        match find(point, coarseness) {
            Some(vertex) => Corner::Free(vertex),
            // The masters are corners of a leaf one level coarser.
            None => self.hanging(point, |end| find(end, coarseness + 1)),
        }
    }

    /// A corner that hangs on a larger leaf. `vertex` finds that leaf's corners.
    fn hanging(&self, point: [u32; 3], mut vertex: impl FnMut([u32; 3]) -> Option<VertexId>) -> Corner {
        let larger = hanging_on(&self.cells, point).expect("a leaf corner is free or hangs on a larger leaf");
        let masters = leaves::ends(self.finest(), point, larger);
        let mut vertex = |point| vertex(point).expect("2:1 balance makes the ends of a hanging corner free");
        match *masters.points() {
            [a, b] => Corner::OnEdge([a, b].map(&mut vertex)),
            [a, b, c, d] => Corner::OnFace([a, b, c, d].map(&mut vertex)),
            _ => unreachable!("a hanging corner has two or four masters"),
        }
    }

    /// Bytes on the heap by part, spare capacity included.
    #[must_use]
    pub fn memory(&self) -> Vec<(&'static str, usize)> {
        let [masks, ranks] = self.cells.heap_bytes();
        vec![("child masks", masks), ("mask ranks", ranks), ("vertex bricks", self.vertices.heap_bytes())]
    }
}

/// The up to eight finest cells around a lattice point, clipped to the box.
pub fn cells_around(point: [u32; 3], finest: u8) -> impl Iterator<Item = [u32; 3]> {
    let m = 1_u32 << finest;
    (0..8_u32).filter_map(move |c| {
        let mut cell = point;
        for (axis, i) in cell.iter_mut().enumerate() {
            *i = i.checked_sub(1 - (c >> axis & 1))?;
            if *i >= m {
                return None;
            }
        }
        Some(cell)
    })
}

/// The points of {0..`last`}³ at most 1 away from `center` along every axis, itself included, with tent
/// weights 1, ½, ¼ or ⅛.
pub fn around(center: [u32; 3], last: u32) -> impl Iterator<Item = ([u32; 3], f64)> {
    (0..27_u32).filter_map(move |k| {
        let off = [k % 3, k / 3 % 3, k / 9];
        let mut tent = 1.0;
        let mut point = [0; 3];
        for axis in 0..3 {
            point[axis] = (center[axis] + off[axis]).checked_sub(1).filter(|&i| i <= last)?;
            tent *= if off[axis] == 1 { 1.0 } else { 0.5 };
        }
        Some((point, tent))
    })
}

#[cfg(test)]
pub(crate) mod arbitrary;
#[cfg(test)]
mod tests;
