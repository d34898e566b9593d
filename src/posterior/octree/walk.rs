//! Squares one ray on leaves of any size, along any path.
//!
//! J of every touched vertex is kept until the end of the ray. A vertex can recur, because a corner that hangs on
//! a larger leaf passes its weight to the corners of that leaf. What does not depend on a sample's position
//! within the leaf is computed once per leaf, and limits are looked up once per region.

use std::ops::Range;

use glam::DVec3;
use multiversion::multiversion;
use rustc_hash::FxHashMap;

use super::key::{Contributions, VertexKey};
use super::squares::{SampleJacobian, VertexJacobian};
use crate::geometry::Lattice;
use crate::octree::{Leaves, MaxLevels, Nearby, coarseness, masters, trilinear};
use crate::posterior::Sums;
use crate::render::RaySamples;

/// The contribution of a leaf's corner to a vertex.
struct Term {
    corner: u8,
    /// Fraction of the corner's weight: 1, ½ or ¼.
    share: f64,
    /// Index of the vertex among those of the ray.
    vertex: u32,
}

/// The vertices that one ray touched.
struct Touched {
    /// Index in the lists below, by key.
    index: FxHashMap<VertexKey, u32>,
    keys: Vec<VertexKey>,
    sums: Vec<VertexJacobian>,
    /// Vertices looked up last, by the low bits of their keys, which distinguish the corners of a leaf. Half
    /// of them recur in the next leaf.
    recent: [(VertexKey, u32); 8],
}

impl Touched {
    /// A key that no vertex has.
    const NONE: VertexKey = VertexKey::NONE;

    fn none() -> Self {
        Self { index: FxHashMap::default(), keys: Vec::new(), sums: Vec::new(), recent: [(Self::NONE, 0); 8] }
    }

    /// Index of the vertex with the given key, which is added if it is new to the ray.
    fn index(&mut self, key: VertexKey) -> u32 {
        let recent = &mut self.recent[key.in_brick()];
        if recent.0 != key {
            let index = *self.index.entry(key).or_insert_with(|| {
                self.keys.push(key);
                self.sums.push(VertexJacobian::default());
                (self.keys.len() - 1) as u32
            });
            *recent = (key, index);
        }
        recent.1
    }

    fn clear(&mut self) {
        self.index.clear();
        self.keys.clear();
        self.sums.clear();
        self.recent = [(Self::NONE, 0); 8];
    }
}

/// The leaf that contains the current sample.
#[derive(Default)]
struct Leaf {
    origin: [u32; 3],
    /// Edge length in finest cells; 0 before the first leaf.
    edge: u32,
    terms: Vec<Term>,
}

impl Leaf {
    fn contains(&self, cell: [u32; 3]) -> bool {
        (0..3).all(|axis| cell[axis].wrapping_sub(self.origin[axis]) < self.edge)
    }

    /// Moves to the leaf around a finest cell.
    fn move_to(&mut self, cell: [u32; 3], near: &Nearby, touched: &mut Touched) {
        let leaf = near.leaf(cell);
        (self.origin, self.edge) = leaf.extent(near.finest());
        self.terms.clear();
        for corner in 0..8_u8 {
            let point = std::array::from_fn(|axis| self.origin[axis] + self.edge * u32::from(corner >> axis & 1));
            if near.is_inside(point) {
                let vertex = touched.index(VertexKey::new(point, near.finest() - leaf.level));
                self.terms.push(Term { corner, share: 1.0, vertex });
                continue;
            }
            let masters = masters(near, point);
            let share = 1.0 / masters.points().len() as f64;
            for &point in masters.points() {
                let vertex = touched.index(VertexKey::new(point, coarseness(near, point)));
                self.terms.push(Term { corner, share, vertex });
            }
        }
    }
}

/// Squares one ray after another.
pub struct LeafWalk<'a> {
    lattice: &'a Lattice,
    limits: &'a MaxLevels,
    near: Option<Nearby>,
    leaf: Leaf,
    touched: Touched,
}

impl<'a> LeafWalk<'a> {
    /// Creates a walk on the leaves of `limits`.
    pub fn new(lattice: &'a Lattice, limits: &'a MaxLevels) -> Self {
        Self { lattice, limits, near: None, leaf: Leaf::default(), touched: Touched::none() }
    }

    /// Appends a ray's contribution to every vertex that it touches, in the order of first contact.
    pub fn ray<S: Sums>(&mut self, batch: &RaySamples, samples: Range<usize>, out: &mut Contributions<S::Square>) {
        walk::<S>(self, batch, samples, out);
    }

    /// Moves to the leaf around a finest cell.
    fn move_to(&mut self, cell: [u32; 3]) {
        let near = match self.near.take() {
            Some(near) if near.is_around(cell) => near,
            _ => Nearby::new(self.limits, cell),
        };
        self.leaf.move_to(cell, &near, &mut self.touched);
        self.near = Some(near);
    }
}

#[multiversion(targets("x86_64+avx2+fma"))]
fn walk<S: Sums>(walk: &mut LeafWalk, batch: &RaySamples, samples: Range<usize>, out: &mut Contributions<S::Square>) {
    for i in samples {
        let Some(u) = walk.lattice.coordinates(batch.positions[i]) else { continue };
        let (cell, _) = walk.lattice.cell(u);
        if !walk.leaf.contains(cell) {
            walk.move_to(cell);
        }
        let leaf = &walk.leaf;
        let weights = trilinear((u - DVec3::from(leaf.origin.map(f64::from))) / f64::from(leaf.edge));
        let jacobian = SampleJacobian::new(batch, i);
        for term in &leaf.terms {
            // Multiplication by ½ or ¼ is exact.
            walk.touched.sums[term.vertex as usize].add(weights[usize::from(term.corner)] * term.share, &jacobian);
        }
    }
    for (&key, sum) in walk.touched.keys.iter().zip(&walk.touched.sums) {
        out.push(key, sum.squared::<S>());
    }
    walk.leaf.edge = 0;
    walk.touched.clear();
}
