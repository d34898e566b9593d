//! Occupancy of a field that bounds its density.

use glam::DVec3;
use rayon::prelude::*;

use super::pyramid::{BRICK, CELLS, EDGE, blocks};
use crate::field::RadianceField;
use crate::geometry::Aabb;
use crate::monitor::Monitor;

/// Queries `field` for the bound of each of `cells`³ cells, grown by `pad`.
///
/// Coarse boxes come first; an empty one is not subdivided. Blocks are `low..low + size` cells, clipped to the grid.
pub struct Bounder<'a> {
    pub field: &'a dyn RadianceField,
    pub bounds: Aabb,
    pub cells: usize,
    /// Distance by which boxes are grown, in scene units.
    pub pad: f64,
    /// Advances by one per brick.
    pub monitor: &'a dyn Monitor,
}

impl Bounder<'_> {
    /// The bricks that are not empty, in the order of the Z-curve: their indices (x slowest) and cells. Meaningless
    /// if the monitor was interrupted.
    pub fn bricks(&self) -> Vec<(usize, [f32; CELLS])> {
        self.bricks_in([0; 3], self.cells.next_power_of_two().max(EDGE))
    }

    fn bricks_in(&self, low: [usize; 3], size: usize) -> Vec<(usize, [f32; CELLS])> {
        if self.monitor.interrupted() || low.iter().any(|&i| i >= self.cells) {
            return Vec::new();
        }
        let empty = self.bound(low, size) == 0.0;
        if empty || size == EDGE {
            let bricks = low.map(|i| blocks((i + size).min(self.cells) - i, BRICK) as u64);
            self.monitor.advance(bricks.iter().product());
        }
        if empty {
            Vec::new()
        } else if size == EDGE {
            let mut brick = [0.0; CELLS];
            self.fill(low, EDGE, &mut brick);
            let n = blocks(self.cells, BRICK);
            let [x, y, z] = low.map(|i| i / EDGE);
            vec![((x * n + y) * n + z, brick)]
        } else {
            (0..8).into_par_iter().flat_map_iter(|child| self.bricks_in(octant(low, size, child), size / 2)).collect()
        }
    }

    /// Sets the cells of a non-empty block in its brick.
    fn fill(&self, low: [usize; 3], size: usize, brick: &mut [f32; CELLS]) {
        for child in (0..8).map(|child| octant(low, size, child)) {
            if child.iter().any(|&i| i >= self.cells) {
                continue;
            }
            let bound = self.bound(child, size / 2);
            if size == 2 {
                let [x, y, z] = child.map(|i| i % EDGE);
                brick[(x * EDGE + y) * EDGE + z] = bound;
            } else if bound > 0.0 {
                self.fill(child, size / 2, brick);
            }
        }
    }

    /// Bound of the field's density in a block and within `pad` of it; ∞ if it is NaN or unknown.
    fn bound(&self, low: [usize; 3], size: usize) -> f32 {
        let corner = |index: [usize; 3]| {
            let index = DVec3::from(index.map(|i| i.min(self.cells) as f64));
            self.bounds.min() + index / self.cells as f64 * self.bounds.size()
        };
        let (min, max) = (corner(low) - self.pad, corner(low.map(|i| i + size)) + self.pad);
        let bound = self.field.density_bound(min.as_vec3(), max.as_vec3());
        bound.filter(|bound| !bound.is_nan()).unwrap_or(f32::INFINITY)
    }
}

/// Lower corner of one of the eight octants of a block.
fn octant(low: [usize; 3], size: usize, child: usize) -> [usize; 3] {
    std::array::from_fn(|axis| low[axis] + (child >> axis & 1) * (size / 2))
}
