//! One ray's squares: J of every vertex that it touches, from the samples in its cells.
//!
//! A straight ray meets the cells of the lattice in an order that never turns back along any axis (a contracted one most often does
//! not either). The eight cells around a vertex
//! are two along each axis, so the ray is among them once, for a while: when it comes to a cell that does not have the vertex as a corner, the
//! vertex is done. J of the eight corners of one cell is therefore all that has to be kept.

use std::ops::Range;

use glam::DVec3;
use multiversion::multiversion;

use super::bricks::{Contribution, key};
use crate::geometry::Lattice;
use crate::octree::trilinear;
use crate::posterior::{Evidence, Information};
use crate::render::RaySamples;

/// What a sample brings: ∂C_c/∂x_k at 3·c + k, then ‖∂C/∂σ‖ ∇σ.
pub struct Row([f64; 12]);

impl Row {
    #[inline(always)]
    pub fn of(batch: &RaySamples, sample: usize) -> Self {
        let (jacobian, gradient) = (&batch.jacobians[sample], &batch.gradients[sample]);
        Self(std::array::from_fn(|i| f64::from(if i < 9 { jacobian[i] } else { gradient[i - 9] })))
    }
}

/// A vertex's weighted sum of rows over one ray.
#[derive(Clone, Copy, Default)]
pub struct Partial([f64; 12]);

impl Partial {
    #[inline(always)]
    pub fn add(&mut self, weight: f64, row: &Row) {
        for (sum, value) in self.0.iter_mut().zip(&row.0) {
            *sum += weight * value;
        }
    }

    /// JᵀJ and what else is known of the vertex from this ray.
    #[inline(always)]
    pub fn squared(&self) -> Evidence {
        let gradient = [self.0[9] as f32, self.0[10] as f32, self.0[11] as f32];
        Evidence { information: gram(&self.0), gradient, rays: 1 }
    }
}

/// JᵀJ of a 3×3 Jacobian given row by row: xx, xy, xz, yy, yz, zz.
#[inline(always)]
pub fn gram(j: &[f64]) -> Information {
    let dot = |a: usize, b: usize| j[a] * j[b] + j[3 + a] * j[3 + b] + j[6 + a] * j[6 + b];
    [dot(0, 0), dot(0, 1), dot(0, 2), dot(1, 1), dot(1, 2), dot(2, 2)]
}

/// Where a sample is.
pub struct Place {
    sample: u32,
    cell: [u32; 3],
    /// In the cell, 0 to 1.
    offset: DVec3,
}

/// The places of a ray's samples on the lattice. False if it turns back along an axis, as a contracted ray may, or rounded positions of
/// one in a lattice plane.
pub fn places(lattice: &Lattice, batch: &RaySamples, samples: Range<usize>, places: &mut Vec<Place>) -> bool {
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
        places.push(Place { sample: i as u32, cell, offset });
    }
    true
}

/// Appends what a ray that never turns back adds to every vertex that it touches, in the order in which they are done.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn along(places: &[Place], batch: &RaySamples, out: &mut Vec<Contribution>) {
    let Some(first) = places.first() else { return };
    let mut cell = first.cell;
    let mut corners = [Partial::default(); 8];
    for place in places {
        if place.cell != cell {
            corners = moved(&corners, cell, place.cell, out);
            cell = place.cell;
        }
        let row = Row::of(batch, place.sample as usize);
        for (corner, weight) in corners.iter_mut().zip(trilinear(place.offset)) {
            corner.add(weight, &row);
        }
    }
    for (c, corner) in corners.iter().enumerate() {
        out.push(Contribution { key: vertex(cell, c), sums: corner.squared() });
    }
}

/// Corner `c` of a cell.
#[inline(always)]
fn vertex(cell: [u32; 3], c: usize) -> u64 {
    key(std::array::from_fn(|axis| cell[axis] + (c as u32 >> axis & 1)), 0)
}

/// The corners of cell `to`: those that cell `from` shares keep their sums, the others of `from` are done.
#[inline(always)]
fn moved(corners: &[Partial; 8], from: [u32; 3], to: [u32; 3], out: &mut Vec<Contribution>) -> [Partial; 8] {
    let mut next = [Partial::default(); 8];
    for (c, corner) in corners.iter().enumerate() {
        let bit = |axis: usize| i64::from(from[axis]) + (c as i64 >> axis & 1) - i64::from(to[axis]);
        let bits = [bit(0), bit(1), bit(2)];
        if bits.iter().all(|b| (0..=1).contains(b)) {
            next[(bits[0] | bits[1] << 1 | bits[2] << 2) as usize] = *corner;
        } else {
            out.push(Contribution { key: vertex(from, c), sums: corner.squared() });
        }
    }
    next
}
