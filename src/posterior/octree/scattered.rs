//! Squares rays whose samples jump to and fro between the finest cells, as those of splats do.
//!
//! Rays of a batch of splats come from neighbouring pixels and touch the same cells, so the corners of each cell are
//! looked up once in a batch. [`walk`](super::walk) does the same on leaves of any size, ray by ray.

use std::ops::Range;

use multiversion::multiversion;
use rustc_hash::FxHashMap;

use super::key::{Contributions, VertexKey};
use super::squares::{SampleJacobian, VertexJacobian};
use crate::geometry::Lattice;
use crate::octree::{corners, morton, trilinear};
use crate::posterior::Sums;
use crate::render::RaySamples;

/// A vertex that rays of the batch touched.
struct Vertex {
    key: VertexKey,
    /// J of the current ray, if `is_touched`.
    jacobian: VertexJacobian,
    is_touched: bool,
}

/// Squares one ray after another.
pub struct Scattered<'a> {
    lattice: &'a Lattice,
    /// Indices of the corners of each cell, in the order of [`corners`], by its Morton code.
    cells: FxHashMap<u64, [u32; 8]>,
    index: FxHashMap<VertexKey, u32>,
    /// In the order of first contact.
    vertices: Vec<Vertex>,
    /// Those that the current ray touched.
    touched: Vec<u32>,
}

impl<'a> Scattered<'a> {
    /// Starts a batch.
    pub fn new(lattice: &'a Lattice) -> Self {
        let (cells, index) = Default::default();
        Self { lattice, cells, index, vertices: Vec::new(), touched: Vec::new() }
    }

    /// Appends a ray's contribution to every vertex that it touches, in the order of first contact.
    pub fn ray<S: Sums>(&mut self, batch: &RaySamples, samples: Range<usize>, out: &mut Contributions<S::Square>) {
        add_ray::<S>(self, batch, samples, out);
    }

    /// Indices of a cell's corners, which are added if they are new to the batch.
    fn corners_of(&mut self, cell: [u32; 3]) -> [u32; 8] {
        let Self { cells, index, vertices, .. } = self;
        *cells.entry(morton::encode(cell)).or_insert_with(|| {
            corners(cell, glam::DVec3::ZERO).map(|(point, _)| {
                let key = VertexKey::finest(morton::encode(point));
                *index.entry(key).or_insert_with(|| {
                    vertices.push(Vertex { key, jacobian: VertexJacobian::default(), is_touched: false });
                    (vertices.len() - 1) as u32
                })
            })
        })
    }
}

#[multiversion(targets("x86_64+avx2+fma"))]
fn add_ray<S: Sums>(
    all: &mut Scattered,
    batch: &RaySamples,
    samples: Range<usize>,
    out: &mut Contributions<S::Square>,
) {
    let mut last: Option<([u32; 3], [u32; 8])> = None;
    for i in samples {
        let Some(u) = all.lattice.coordinates(batch.positions[i]) else { continue };
        let (cell, offset) = all.lattice.cell(u);
        let corners = match last {
            Some((same, corners)) if same == cell => corners,
            _ => all.corners_of(cell),
        };
        last = Some((cell, corners));
        let jacobian = SampleJacobian::new(batch, i);
        for (v, weight) in corners.into_iter().zip(trilinear(offset)) {
            let vertex = &mut all.vertices[v as usize];
            if !vertex.is_touched {
                vertex.is_touched = true;
                all.touched.push(v);
            }
            vertex.jacobian.add(weight, &jacobian);
        }
    }
    for v in all.touched.drain(..) {
        let vertex = &mut all.vertices[v as usize];
        out.push(vertex.key, vertex.jacobian.squared::<S>());
        (vertex.jacobian, vertex.is_touched) = (VertexJacobian::default(), false);
    }
}
