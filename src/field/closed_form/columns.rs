//! Finds the few of many primitives that have density at a point: lists on a horizontal grid of columns.

use std::ops::Range;

use glam::{Vec2, Vec3};

use super::Primitive;
use crate::geometry::Aabb;

/// A grid of square columns over the whole height of a box. Each lists the primitives with density in it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Columns {
    min: Vec2,
    edge: f32,
    /// Number of columns along x and y.
    count: [usize; 2],
    /// Where each column's list begins in `members`: `[x · y + 1]`, y fastest.
    offsets: Vec<u32>,
    /// Indices of primitives, increasing within a column, so that densities are added in the same order
    /// everywhere.
    members: Vec<u32>,
}

impl Columns {
    /// Sorts `primitives` into columns of width `edge` (scene units).
    pub fn new(primitives: &[Primitive], bounds: &Aabb, edge: f32) -> Self {
        let (low, high) = (bounds.min().as_vec3(), bounds.max().as_vec3());
        let count = [0, 1].map(|axis| ((high[axis] - low[axis]) / edge).ceil().max(1.0) as usize);
        let mut columns = Self { min: low.truncate(), edge, count, offsets: vec![0], members: Vec::new() };
        for column in 0..count[0] * count[1] {
            let corner = columns.corner(column);
            // Rounding may put a point into a column that it misses by an ulp.
            let slack = 1e-3 * edge;
            let (min, max) = ((corner - slack).extend(low.z), (corner + edge + slack).extend(high.z));
            let felt = primitives.iter().enumerate().filter(|(_, p)| p.density_bound(min, max) > 0.0);
            columns.members.extend(felt.map(|(i, _)| i as u32));
            columns.offsets.push(columns.members.len() as u32);
        }
        columns
    }

    /// Lower corner of a column.
    fn corner(&self, column: usize) -> Vec2 {
        let index = Vec2::new((column / self.count[1]) as f32, (column % self.count[1]) as f32);
        self.min + index * self.edge
    }

    /// Index of the column of a coordinate along `axis`. The outermost columns take what is outside.
    fn index(&self, x: f32, axis: usize) -> usize {
        (((x - self.min[axis]) / self.edge) as usize).min(self.count[axis] - 1)
    }

    /// The primitives that can have density at `x`.
    pub fn at(&self, x: Vec3) -> &[u32] {
        self.members(self.index(x.x, 0) * self.count[1] + self.index(x.y, 1))
    }

    /// The lists of all columns that contain points from `min` to `max`.
    pub fn between(&self, min: Vec3, max: Vec3) -> impl Iterator<Item = &[u32]> {
        let range = |axis: usize| -> Range<usize> { self.index(min[axis], axis)..self.index(max[axis], axis) + 1 };
        let ys = range(1);
        range(0).flat_map(move |x| ys.clone().map(move |y| self.members(x * self.count[1] + y)))
    }

    fn members(&self, column: usize) -> &[u32] {
        &self.members[self.offsets[column] as usize..self.offsets[column + 1] as usize]
    }

    /// Bytes on the heap.
    pub fn memory(&self) -> usize {
        size_of_val(self.offsets.as_slice()) + size_of_val(self.members.as_slice())
    }
}
