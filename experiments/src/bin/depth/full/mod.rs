//! The posterior of all vertices together: what [`OctreePosterior`](octobayes::posterior::OctreePosterior) and
//! [`DensePosterior`](octobayes::posterior::DensePosterior) leave out is that displacements of neighbours are
//! correlated, because the same rays see them (Goli et al. 2024, section 6).
//!
//! Letters: J = Jacobian of all rays' colours with respect to all displacements, `[3 rays][3 vertices]`; R = number of
//! rays drawn; N, s, τ as in [`DataScale`](octobayes::posterior::DataScale); P = (N / (R s²)) JᵀJ + I / τ², the
//! precision. The blocks of the other posteriors are the 3×3 blocks on the diagonal of P, each inverted by itself; here
//! P⁻¹ is [exact](ExactPosterior) where it fits into memory, and else that of [draws](DrawnPosterior).
//!
//! This is a reference to measure the blocks by: every row of J is kept.

mod drawn;
mod exact;
mod rows;
#[cfg(test)]
mod tests;

use glam::{DVec3, Vec3};
use octobayes::geometry::Lattice;
use octobayes::octree::corners;
use octobayes::posterior::DataScale;
use octobayes::render::{DepthSample, RaySamples};
use rustc_hash::FxHashMap;

pub use drawn::{DrawnPosterior, Draws};
pub use exact::ExactPosterior;
use rows::Rows;

/// The Jacobians of all rays, on the finest lattice.
#[derive(Debug, Clone)]
pub struct FullPosterior {
    vertices: Vertices,
    rows: Rows,
}

/// k = N / (R s²), by which JᵀJ of `rays` rays is weighed, 1 / colour².
fn share_of_a_ray(scale: &DataScale, rays: u64) -> f64 {
    scale.pixels as f64 / (rays as f64 * scale.noise * scale.noise)
}

/// Numbers of the lattice points that rays touched.
#[derive(Debug, Clone)]
struct Vertices {
    lattice: Lattice,
    /// In the order in which rays touched them.
    numbers: FxHashMap<[u32; 3], u32>,
}

impl FullPosterior {
    /// Creates a posterior without rays.
    pub fn new(lattice: Lattice) -> Self {
        Self { vertices: Vertices { lattice, numbers: FxHashMap::default() }, rows: Rows::default() }
    }

    /// Number of vertices that rays touched; each has three unknowns.
    pub fn vertices(&self) -> usize {
        self.vertices.numbers.len()
    }

    /// The lattice points of these vertices, sorted.
    pub fn points(&self) -> Vec<[u32; 3]> {
        let mut points: Vec<_> = self.vertices.numbers.keys().copied().collect();
        points.sort_unstable();
        points
    }

    /// Adds the rays of `batches`. Samples outside the lattice's box are skipped.
    pub fn add(&mut self, batches: &[RaySamples]) {
        let mut ray: FxHashMap<[u32; 3], [f64; 9]> = FxHashMap::default();
        for batch in batches {
            for (_, samples) in batch.iter() {
                ray.clear();
                for i in samples {
                    let Some(corners) = self.vertices.corners(batch.positions[i]) else { continue };
                    for (point, weight) in corners {
                        let j = ray.entry(point).or_default();
                        for (sum, &g) in j.iter_mut().zip(&batch.jacobians[i]) {
                            *sum += weight * f64::from(g);
                        }
                    }
                }
                // By their points, so that numbers do not depend on how a map is ordered.
                let mut sorted: Vec<_> = ray.drain().collect();
                sorted.sort_unstable_by_key(|(point, _)| *point);
                let numbers = &mut self.vertices.numbers;
                self.rows.push(sorted.into_iter().map(|(point, jacobian)| {
                    let next = numbers.len() as u32;
                    (*numbers.entry(point).or_insert(next), jacobian.map(|j| j as f32))
                }));
            }
        }
    }
}

impl Vertices {
    /// The corners of the cell around a scene point, with their trilinear weights; `None` outside the box.
    fn corners(&self, x: Vec3) -> Option<[([u32; 3], f64); 8]> {
        let (cell, offset) = self.lattice.cell(self.lattice.coordinates(x)?);
        Some(corners(cell, offset))
    }

    /// g_v of a ray's expected depth, for the vertices that training rays touched; and Σ |g|² over all others, where
    /// only the prior holds matter.
    fn gradients(&self, samples: &[DepthSample]) -> (Vec<(usize, DVec3)>, f64) {
        let mut gradients: FxHashMap<[u32; 3], DVec3> = FxHashMap::default();
        let mut untouched = 0.0;
        for DepthSample { position, gradient } in samples {
            match self.corners(*position) {
                Some(corners) => {
                    for (point, weight) in corners {
                        *gradients.entry(point).or_default() += weight * *gradient;
                    }
                }
                None => untouched += gradient.length_squared(),
            }
        }
        let mut touched = Vec::with_capacity(gradients.len());
        for (point, gradient) in gradients {
            match self.numbers.get(&point) {
                Some(&vertex) => touched.push((vertex as usize, gradient)),
                None => untouched += gradient.length_squared(),
            }
        }
        // In one order, so that sums are the same in every run.
        touched.sort_unstable_by_key(|(vertex, _)| *vertex);
        (touched, untouched)
    }
}
