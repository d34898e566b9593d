//! Lets the octree describe and check itself.

use std::collections::BTreeSet;
use std::fmt;

use super::leaves::hanging_on;
use super::{Cell, Corner, Octree, morton};

/// What a sound octree consists of.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
#[non_exhaustive]
pub struct OctreeStats {
    /// Leaves of each level, 0 to finest.
    pub leaves_per_level: Vec<u64>,
    /// Free vertices: those that carry values.
    pub free_vertices: u64,
    /// Distinct leaf corners that hang on a larger leaf.
    pub hanging_corners: u64,
}

impl OctreeStats {
    /// Number of leaves of all levels.
    #[must_use]
    pub fn leaves(&self) -> u64 {
        self.leaves_per_level.iter().sum()
    }
}

/// The first property that an octree lacks.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Defect {
    /// The leaves' volumes do not add up to the box: leaves are missing or overlap.
    NotComplete {
        /// Finest cells of the box.
        expected: u128,
        /// Finest cells of all leaves together.
        found: u128,
    },
    /// Looking up a leaf by its own position finds another one.
    NotFound {
        /// The leaf visited.
        leaf: Cell,
        /// The leaf found instead.
        found: Cell,
    },
    /// Two touching leaves differ by more than one level.
    NotBalanced {
        /// The smaller leaf.
        leaf: Cell,
        /// The larger leaf.
        neighbor: Cell,
    },
    /// A corner's status contradicts the leaves around it.
    WrongCorner {
        /// The leaf visited.
        leaf: Cell,
        /// Lattice position of the corner.
        point: [u32; 3],
        /// What is wrong.
        problem: &'static str,
    },
    /// The vertex table holds vertices that are corners of no leaf, or lacks some.
    WrongVertexCount {
        /// Free corners found by walking the leaves.
        expected: u64,
        /// Size of the vertex table.
        found: u64,
    },
}

impl fmt::Display for Defect {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::NotComplete { expected, found } => write!(f, "leaves cover {found} finest cells of {expected}"),
            Self::NotFound { leaf, found } => write!(f, "leaf {leaf:?} is found as {found:?}"),
            Self::NotBalanced { leaf, neighbor } => write!(f, "leaf {leaf:?} touches {neighbor:?}: not 2:1 balanced"),
            Self::WrongCorner { leaf, point, problem } => write!(f, "corner {point:?} of leaf {leaf:?}: {problem}"),
            Self::WrongVertexCount { expected, found } => {
                write!(f, "{found} vertices stored, {expected} free corners counted")
            }
        }
    }
}

impl std::error::Error for Defect {}

impl Octree {
    /// Checks that the octree is sound and counts what it consists of.
    ///
    /// Sound means: complete, without overlap, and 2:1 balanced over faces, edges and corners. Every leaf
    /// corner is either free or hangs on a leaf of the next coarser level with free ends. There are as many
    /// vertices as free corners.
    ///
    /// # Errors
    /// The first defect found.
    #[doc(hidden)]
    pub fn validate(&self) -> Result<OctreeStats, Defect> {
        let finest = self.finest();
        let mut leaves = Vec::new();
        self.cells().for_each_leaf(|leaf| leaves.push(leaf));

        let mut leaves_per_level = vec![0; usize::from(finest) + 1];
        let mut volume = 0_u128;
        let (mut free, mut hanging) = (BTreeSet::new(), BTreeSet::new());
        for &leaf in &leaves {
            let (origin, edge) = leaf.extent(finest);
            leaves_per_level[usize::from(leaf.level)] += 1;
            volume += u128::from(edge).pow(3);
            let found = self.cells().leaf(origin);
            if found != leaf {
                return Err(Defect::NotFound { leaf, found });
            }
            self.check_balance(leaf)?;
            for c in 0..8_u32 {
                let point: [u32; 3] = std::array::from_fn(|axis| origin[axis] + edge * (c >> axis & 1));
                if self.check_corner(leaf, point)? {
                    free.insert(morton::encode(point));
                } else {
                    hanging.insert(morton::encode(point));
                }
            }
        }
        let box_volume = 1_u128 << (3 * u32::from(finest));
        if volume != box_volume {
            return Err(Defect::NotComplete { expected: box_volume, found: volume });
        }
        if free.len() != self.vertex_count() {
            return Err(Defect::WrongVertexCount { expected: free.len() as u64, found: self.vertex_count() as u64 });
        }
        Ok(OctreeStats { leaves_per_level, free_vertices: free.len() as u64, hanging_corners: hanging.len() as u64 })
    }

    /// Checks that no leaf touching `leaf` is more than one level coarser.
    ///
    /// A larger leaf contains the whole neighbouring cell of `leaf`'s size, so 26 look-ups find them all.
    fn check_balance(&self, leaf: Cell) -> Result<(), Defect> {
        let per_axis = 1_i64 << leaf.level;
        let shift = self.finest() - leaf.level;
        for side in 0..27_i64 {
            let steps = [side % 3 - 1, side / 3 % 3 - 1, side / 9 - 1];
            let index: [i64; 3] = std::array::from_fn(|axis| i64::from(leaf.index[axis]) + steps[axis]);
            if index.iter().any(|i| !(0..per_axis).contains(i)) {
                continue;
            }
            let neighbor = self.cells().leaf(index.map(|i| (i as u32) << shift));
            if neighbor.level + 1 < leaf.level {
                return Err(Defect::NotBalanced { leaf, neighbor });
            }
        }
        Ok(())
    }

    /// Returns whether a corner is free; an error if its stored status contradicts the leaves around it.
    fn check_corner(&self, leaf: Cell, point: [u32; 3]) -> Result<bool, Defect> {
        let wrong = |problem| Defect::WrongCorner { leaf, point, problem };
        match (self.vertex(point), hanging_on(self.cells(), point)) {
            (Some(_), None) => Ok(true),
            (Some(_), Some(_)) => Err(wrong("stored as free, but hangs on a larger leaf")),
            (None, None) => Err(wrong("free, but not stored")),
            (None, Some(larger)) => {
                let (_, edge) = larger.extent(self.finest());
                if point.iter().any(|i| !i.is_multiple_of(edge / 2)) {
                    return Err(wrong("hangs at a place that is not half-way"));
                }
                match self.corner(point) {
                    Corner::Free(_) => Err(wrong("resolved as free")),
                    Corner::OnEdge(_) | Corner::OnFace(_) => Ok(false),
                }
            }
        }
    }
}
