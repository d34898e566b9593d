//! From sums to an octree: finds where its leaves must be as fine as the sums.

use rayon::prelude::*;

use super::OctreePosterior;
use super::key::VertexKey;
use crate::octree::{Cell, Leaves, Octree, Wanted, around, cells_around};
use crate::posterior::{Pooling, VertexSums, trace};

/// Whether a ray touched the vertex and its information exceeds `floor`.
fn moves(sums: &VertexSums, floor: f64) -> bool {
    sums.rays > 0 && trace(&sums.information) > floor
}

/// Says where an octree is refined.
#[derive(Debug, Clone, PartialEq)]
pub struct Refinement {
    /// Refine around touched vertices with more information (tr S) than this; `None` does not refine by sensitivity.
    pub floor: Option<f64>,
    /// Also refine around vertices whose pooled information exceeds the floor.
    pub pooling: Pooling,
    /// Cells that must exist for other reasons; limits apply to them too.
    pub wanted: Vec<Cell>,
}

impl Refinement {
    /// A floor below all information: refines around every vertex that a ray touched.
    pub const EVERYTHING: f64 = f64::NEG_INFINITY;
}

impl OctreePosterior {
    /// Builds the octree, and returns it with the sums at its vertices in the order of their ids.
    ///
    /// Around every vertex selected by `refinement`, its leaves are as fine as those of the sums. A floor of 0
    /// keeps every vertex that any ray moved. At vertices surrounded by leaves at their own limit, the sums are
    /// exact; on the finest lattice they equal those of the dense grid. At all other vertices the information is
    /// negligible with respect to the floor.
    #[must_use]
    pub fn into_octree(self, refinement: &Refinement) -> (Octree, Vec<VertexSums>) {
        let octree = self.octree(refinement);
        let sums = self.sums_at(&octree);
        (octree, sums)
    }

    /// The octree of [`OctreePosterior::into_octree`] alone.
    #[must_use]
    pub fn octree(&self, refinement: &Refinement) -> Octree {
        let finest = self.lattice.level();
        let mut wanted = refinement.floor.map_or_else(|| Wanted::new(finest), |floor| self.wanted(floor));
        if refinement.pooling.is_on() {
            // A key is a point on the lattice of its own level, so sorted unique keys are unique points.
            let mut moved: Vec<VertexKey> = match refinement.floor {
                Some(floor) => self.bricks.par_iter().filter(|(_, e)| moves(e, floor)).map(|(key, _)| key).collect(),
                None => Vec::new(),
            };
            moved.par_sort_unstable();
            for key in self.moved_by_pooling(&moved, refinement) {
                self.want_around(&mut wanted, key);
            }
        }
        for &cell in &refinement.wanted {
            let (origin, _) = cell.extent(finest);
            let limit = self.limits.leaf(origin);
            wanted.cell(if limit.level < cell.level { limit } else { cell });
        }
        Octree::from_wanted(wanted)
    }

    /// The sums at the vertices of an octree, in the order of their ids.
    #[must_use]
    pub fn sums_at(&self, octree: &Octree) -> Vec<VertexSums> {
        self.each_at(octree).map(|(_, sums)| sums).collect()
    }

    /// The vertices of an octree with their sums, in the order of their ids. Nothing is copied.
    pub(crate) fn each_at(&self, octree: &Octree) -> impl IndexedParallelIterator<Item = ([u32; 3], VertexSums)> {
        let points = octree.par_vertex_positions();
        points.map_init(
            || self.bricks.reader(),
            |reader, point| (point, reader.get(VertexKey::new(point, self.coarseness(point)))),
        )
    }

    /// The leaves around every vertex with more information than `floor`.
    #[must_use]
    pub fn wanted(&self, floor: f64) -> Wanted {
        let none = || Wanted::new(self.lattice.level());
        let masks = self.bricks.par_masks(|sums| moves(sums, floor));
        let each = masks.fold(none, |mut wanted, (code, moved)| {
            if self.limits.is_unlimited() {
                wanted.around_points(code.bits(), moved);
            } else {
                let members = (0..64_u64).filter(|i| moved >> i & 1 == 1);
                members.for_each(|i| self.want_around(&mut wanted, code.vertex(i)));
            }
            wanted
        });
        each.reduce(none, |a, b| a | b)
    }

    /// The leaves around one vertex.
    fn want_around(&self, wanted: &mut Wanted, key: VertexKey) {
        let around = cells_around(key.point(), self.lattice.level());
        around.for_each(|cell| wanted.cell(self.limits.leaf(cell)));
    }

    /// Vertices of the finest lattice next to `moved` (sorted keys) that move by pooling.
    fn moved_by_pooling(&self, moved: &[VertexKey], refinement: &Refinement) -> Vec<VertexKey> {
        let last = self.lattice.cells_per_axis();
        let is_finest = |key: &VertexKey| VertexKey::new(key.point(), 0) == *key;
        let mut beside: Vec<VertexKey> = moved
            .par_chunks(64)
            .flat_map_iter(|keys| {
                let near = keys.iter().filter(|key| is_finest(key)).flat_map(|&key| around(key.point(), last));
                let mut near: Vec<VertexKey> = near.map(|(point, _)| VertexKey::new(point, 0)).collect();
                near.sort_unstable();
                near.dedup();
                near.retain(|key| moved.binary_search(key).is_err() && self.coarseness(key.point()) == 0);
                near
            })
            .collect();
        beside.par_sort_unstable();
        beside.dedup();
        let floor = refinement.pooling.floor;
        let at = |point| self.bricks.get(VertexKey::new(point, 0)).copied();
        let is_moved = |key: &VertexKey| {
            let pooled = refinement.pooling.pooled(key.point(), last, at);
            trace(&pooled.information) > floor
        };
        beside.into_par_iter().filter(is_moved).collect()
    }
}
