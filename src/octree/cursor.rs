//! A place in an octree that moves from point to point and looks up only what has changed.

use glam::DVec3;

use super::vertices::Finder;
use super::{Cell, Corner, Octree, VertexId, trilinear};

/// A place in an octree.
pub struct Cursor<'a> {
    octree: &'a Octree,
    finder: Finder<'a>,
    leaf: Cell,
    /// Lower corner of the leaf, in lattice units.
    origin: [u32; 3],
    edge: u32,
    corners: [Corner; 8],
}

impl<'a> Cursor<'a> {
    pub(super) fn new(octree: &'a Octree) -> Self {
        // Starts nowhere: a leaf of edge 0 contains no cell.
        let (leaf, corners) = (Cell { level: 0, index: [0; 3] }, [Corner::Free(VertexId(0)); 8]);
        Self { octree, finder: octree.vertices.finder(), leaf, origin: [0; 3], edge: 0, corners }
    }

    /// Moves to the leaf around lattice coordinates `u` in `[0, M]`³; returns whether it is a different one.
    pub fn seek(&mut self, u: DVec3) -> bool {
        let last = (1_u32 << self.octree.finest()) - 1;
        let cell = [0, 1, 2].map(|axis| (u[axis] as u32).min(last));
        if (0..3).all(|axis| cell[axis].wrapping_sub(self.origin[axis]) < self.edge) {
            return false;
        }
        self.leaf = self.leaf_at(cell);
        (self.origin, self.edge) = self.leaf.extent(self.octree.finest());
        self.corners = std::array::from_fn(|c| {
            let point = std::array::from_fn(|axis| self.origin[axis] + self.edge * (c as u32 >> axis & 1));
            self.octree.corner_of(self.leaf, point, &mut self.finder)
        });
        true
    }

    /// The leaf that contains a finest cell.
    fn leaf_at(&mut self, cell: [u32; 3]) -> Cell {
        // The middle of a split cell of the second-finest level is a corner of its eight children and of
        // nothing else. Finding it among the finest vertices, where the corners are looked up next, saves the
        // descent from the root.
        let level = self.octree.finest();
        let middle = cell.map(|i| i | 1);
        match level > 0 && self.finder.find_at(middle, 0).is_some() {
            true => Cell { level, index: cell },
            false => self.octree.cells.leaf(cell),
        }
    }

    /// The current leaf.
    #[must_use]
    pub fn leaf(&self) -> Cell {
        self.leaf
    }

    /// Corners of the current leaf, in the order of children.
    #[must_use]
    pub fn corners(&self) -> &[Corner; 8] {
        &self.corners
    }

    /// Trilinear weights of the corners at lattice coordinates `u` in the leaf.
    #[must_use]
    pub fn weights(&self, u: DVec3) -> [f64; 8] {
        trilinear((u - DVec3::from(self.origin.map(f64::from))) / f64::from(self.edge))
    }
}
