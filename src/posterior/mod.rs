//! From ray samples to the information that the training images hold about each deformation vertex.
//!
//! Letters: `J` = Jacobian of a pixel with respect to a vertex displacement, J_v(r) = Σ_i φ_v(x_i) G_i, summed over the ray's
//! samples *before* squaring, 3×3, colour × axis, 1 / scene unit. `S_v` = Σ_r J_v(r)ᵀ J_v(r), symmetric 3×3, the vertex's
//! *information*. `R` rays drawn, those that hit nothing included. H_v = (2/R) S_v + 2λ I.
//!
//! Two posteriors sit side by side behind [`Posterior`]: [`DensePosterior`], plain and readable, over all (M + 1)³ lattice
//! points, and [`OctreePosterior`], which keeps only what rays touched and ends as an octree. They share no accumulation code:
//! each is the check of the other.

mod covariance;
mod criteria;
mod dense;
mod double_double;
mod octree;
mod pooling;
mod prior;
mod sums;

pub use covariance::{Covariance, negligible_information, negligible_jacobian};
pub use criteria::{Criteria, Criterion};
pub use dense::DensePosterior;
pub use octree::{Brick, OctreePosterior, PilotCounts, Refinement};
pub use pooling::Pooling;
pub use prior::Prior;
pub use sums::{Information, VertexSums, trace};

use crate::render::RaySamples;

/// Sums information from a stream of ray samples.
pub trait Posterior {
    /// Adds the rays of `batches`, in order. Samples outside the lattice's box say nothing and are passed over.
    ///
    /// The result depends on the order of rays, but not on how they are cut into batches or on the number of threads.
    fn add(&mut self, batches: &[RaySamples]);

    /// Bytes on the heap, now.
    fn memory(&self) -> usize;
}
