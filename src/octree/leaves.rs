//! The leaves of an octree as a function of position, and the constraint that makes interpolated functions
//! continuous.

use super::{Cell, CellTree, cells_around};

/// A complete, 2:1 balanced set of leaves, stored or not.
pub trait Leaves {
    /// The finest level.
    fn finest(&self) -> u8;

    /// The leaf that contains a finest cell.
    fn leaf(&self, cell: [u32; 3]) -> Cell;
}

impl Leaves for CellTree {
    fn finest(&self) -> u8 {
        Self::finest(self)
    }

    fn leaf(&self, cell: [u32; 3]) -> Cell {
        Self::leaf(self, cell)
    }
}

/// The free vertices that determine the value at a leaf's corner: lattice points with equal weights.
///
/// These are the corner itself, the two ends of the edge, or the four corners of the face of a larger leaf on
/// which it hangs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Masters {
    points: [[u32; 3]; 4],
    count: u8,
}

impl Masters {
    /// The points.
    #[must_use]
    pub fn points(&self) -> &[[u32; 3]] {
        &self.points[..usize::from(self.count)]
    }
}

/// Coarseness of a vertex at `point`: levels from the finest one to that of the finest leaf that touches it.
///
/// If that leaf does not have the point as a corner, this is the coarsest lattice that contains the point.
#[must_use]
#[inline]
pub fn coarseness(leaves: &impl Leaves, point: [u32; 3]) -> u8 {
    let finest = leaves.finest();
    let levels = cells_around(point, finest).map(|cell| finest - leaves.leaf(cell).level);
    let coarseness = levels.min().unwrap_or(0);
    point.iter().fold(coarseness, |c, i| c.min(i.trailing_zeros().min(32) as u8))
}

/// Volume of the leaves around a lattice point, in finest cells, averaged over its up to eight octants.
#[must_use]
pub fn mean_volume(leaves: &impl Leaves, point: [u32; 3]) -> f64 {
    let finest = leaves.finest();
    let (mut volume, mut octants) = (0.0, 0.0);
    for cell in cells_around(point, finest) {
        volume += f64::from(1_u32 << (finest - leaves.leaf(cell).level)).powi(3);
        octants += 1.0;
    }
    volume / octants
}

/// The leaf that touches `point` without having it as a corner, if there is one.
pub fn hanging_on(leaves: &impl Leaves, point: [u32; 3]) -> Option<Cell> {
    cells_around(point, leaves.finest()).map(|cell| leaves.leaf(cell)).find(|leaf| {
        let (_, edge) = leaf.extent(leaves.finest());
        point.iter().any(|i| !i.is_multiple_of(edge))
    })
}

/// Masters of a lattice point that is a corner of some leaf.
///
/// # Panics
/// If it is a corner of no leaf.
#[must_use]
pub fn masters(leaves: &impl Leaves, point: [u32; 3]) -> Masters {
    match hanging_on(leaves, point) {
        None => Masters { points: [point; 4], count: 1 },
        Some(larger) => ends(leaves.finest(), point, larger),
    }
}

/// The corners of `larger` half-way between which `point` lies.
pub fn ends(finest: u8, point: [u32; 3], larger: Cell) -> Masters {
    let (origin, edge) = larger.extent(finest);
    // Along an axis where the point is half-way between two corners of the larger leaf, both contribute.
    let halfway = |axis: usize| !(point[axis] - origin[axis]).is_multiple_of(edge);
    let axes = (0..3).filter(|&axis| halfway(axis)).count();
    assert!(axes == 1 || axes == 2, "point {point:?} is half-way along {axes} axes of leaf {larger:?}");
    let mut points = [point; 4];
    for (choice, end) in points.iter_mut().enumerate().take(1 << axes) {
        for (bit, axis) in (0..3).filter(|&axis| halfway(axis)).enumerate() {
            end[axis] = origin[axis] + edge * (choice as u32 >> bit & 1);
        }
    }
    Masters { points, count: 1 << axes }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octree::Octree;

    #[test]
    fn a_volume_is_the_mean_over_octants() {
        // One finest cell at the origin of a level-2 octree. Its siblings have the same size; all other leaves have
        // edge 2.
        let octree = Octree::refined(2, [Cell { level: 2, index: [0, 0, 0] }]);
        let volume = |point| mean_volume(octree.cells(), point);
        assert_eq!([volume([1, 1, 1]), volume([4, 4, 4])], [1.0, 8.0]);
        // Seven octants of volume 8 and one of volume 1.
        assert_eq!(volume([2, 2, 2]), 57.0 / 8.0);
    }
}
