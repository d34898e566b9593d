//! Squares one ray: computes J of every vertex that it touches from the samples in the adjacent cells.
//!
//! A straight ray visits the cells of the lattice without turning back along any axis. Contracted rays usually do
//! not turn back either. The eight cells around a vertex are two along each axis, so the ray visits them in one
//! stretch. A vertex is done when the ray enters a cell that does not have it as a corner. It is therefore enough
//! to keep J of the eight corners of one cell.

use std::ops::Range;

use glam::DVec3;
use multiversion::multiversion;

use super::key::{Contributions, VertexKey};
use crate::geometry::Lattice;
use crate::octree::morton;
use crate::posterior::Sums;
use crate::render::RaySamples;

/// Derivatives of a sample: ∂C_c/∂x_k at 3·c + k.
pub struct SampleJacobian([f64; 9]);

impl SampleJacobian {
    #[inline(always)]
    pub fn new(batch: &RaySamples, sample: usize) -> Self {
        Self(batch.jacobians[sample].map(f64::from))
    }
}

/// A vertex's weighted sum of samples' Jacobians over one ray.
#[derive(Clone, Copy, Default)]
pub struct VertexJacobian([f64; 9]);

impl VertexJacobian {
    #[inline(always)]
    pub fn add(&mut self, weight: f64, jacobian: &SampleJacobian) {
        for (sum, value) in self.0.iter_mut().zip(&jacobian.0) {
            *sum += weight * value;
        }
    }

    /// The contribution of this ray to the vertex: JᵀJ.
    #[inline(always)]
    pub fn squared<S: Sums>(&self) -> S::Square {
        S::square(&self.0)
    }
}

/// The location of a sample.
pub struct LocatedSample {
    sample: u32,
    cell: [u32; 3],
    /// Position within the cell, 0 to 1.
    offset: DVec3,
}

/// Locates a ray's samples on the lattice.
///
/// Returns false if the ray turns back along an axis. A contracted ray may do so, and so may the rounded
/// positions of a ray within a lattice plane. Samples of splats are centres beside the ray, and usually do.
pub fn locate(lattice: &Lattice, batch: &RaySamples, samples: Range<usize>, places: &mut Vec<LocatedSample>) -> bool {
    places.clear();
    let mut direction = [0_i64; 3];
    for i in samples {
        let Some(u) = lattice.coordinates(batch.positions[i]) else { continue };
        let (cell, offset) = lattice.cell(u);
        if let Some(last) = places.last() {
            for axis in 0..3 {
                let step = i64::from(cell[axis]) - i64::from(last.cell[axis]);
                if step * direction[axis] < 0 {
                    return false;
                }
                if step != 0 {
                    direction[axis] = step;
                }
            }
        }
        places.push(LocatedSample { sample: i as u32, cell, offset });
    }
    true
}

/// J of the eight corners of a cell.
///
/// A corner is stored at the parities of its coordinates (bit 0 x, bit 1 y, bit 2 z). It stays there when the ray
/// moves to another cell with the same corner.
struct Corners {
    cell: [u32; 3],
    sums: [VertexJacobian; 8],
}

impl Corners {
    /// The even and the odd corner coordinate of a cell along an axis.
    #[inline(always)]
    fn coordinates(cell: u32) -> [u32; 2] {
        [cell + (cell & 1), cell | 1]
    }

    /// Adds a sample at the given offset in the cell.
    #[inline(always)]
    fn add(&mut self, offset: DVec3, jacobian: &SampleJacobian) {
        let mut along = [[0.0; 2]; 3];
        for axis in 0..3 {
            let lower = (self.cell[axis] & 1) as usize;
            along[axis][lower] = 1.0 - offset[axis];
            along[axis][lower ^ 1] = offset[axis];
        }
        for (s, sum) in self.sums.iter_mut().enumerate() {
            sum.add(along[0][s & 1] * along[1][s >> 1 & 1] * along[2][s >> 2], jacobian);
        }
    }

    /// Moves to another cell and finishes the corners that it does not have.
    #[inline(always)]
    fn move_to<S: Sums>(&mut self, cell: [u32; 3], out: &mut Contributions<S::Square>) {
        let mut stays = [[true; 2]; 3];
        for axis in 0..3 {
            let (from, to) = (Self::coordinates(self.cell[axis]), Self::coordinates(cell[axis]));
            stays[axis] = [from[0] == to[0], from[1] == to[1]];
        }
        self.finish::<S>(out, |s| !(stays[0][s & 1] && stays[1][s >> 1 & 1] && stays[2][s >> 2]));
        self.cell = cell;
    }

    /// Squares and empties the corners that are done.
    #[inline(always)]
    fn finish<S: Sums>(&mut self, out: &mut Contributions<S::Square>, done: impl Fn(usize) -> bool) {
        // The Morton code of a point combines those of its coordinates.
        let mut codes = [[0; 2]; 3];
        for axis in 0..3 {
            for (code, coordinate) in codes[axis].iter_mut().zip(Self::coordinates(self.cell[axis])) {
                let mut point = [0; 3];
                point[axis] = coordinate;
                *code = morton::encode(point);
            }
        }
        for (s, sum) in self.sums.iter_mut().enumerate() {
            if done(s) {
                let code = codes[0][s & 1] | codes[1][s >> 1 & 1] | codes[2][s >> 2];
                out.push(VertexKey::finest(code), sum.squared::<S>());
                *sum = VertexJacobian::default();
            }
        }
    }
}

/// Appends the contribution of a ray that never turns back to every vertex that it touches, in the
/// order in which vertices are done.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn along<S: Sums>(places: &[LocatedSample], batch: &RaySamples, out: &mut Contributions<S::Square>) {
    let Some(first) = places.first() else { return };
    let mut corners = Corners { cell: first.cell, sums: [VertexJacobian::default(); 8] };
    for place in places {
        if place.cell != corners.cell {
            corners.move_to::<S>(place.cell, out);
        }
        corners.add(place.offset, &SampleJacobian::new(batch, place.sample as usize));
    }
    corners.finish::<S>(out, |_| true);
}
