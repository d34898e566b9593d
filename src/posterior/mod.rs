//! From ray samples to the information that the training images hold about each deformation vertex.
//!
//! Letters: `J` = Jacobian of a pixel with respect to a vertex displacement, J_v(r) = Σ_i φ_v(x_i) G_i, summed over
//! the ray's samples *before* squaring, 3×3, colour × axis, 1 / scene unit. `S_v` = Σ_r J_v(r)ᵀ J_v(r), symmetric 3×3,
//! the vertex's *information*. `R` = number of rays drawn, including those that hit nothing. H_v = (2/R) S_v + 2λ I.
//!
//! [`Posterior`] has two implementations. [`DensePosterior`] is plain and readable and covers all (M + 1)³
//! lattice points. [`OctreePosterior`] keeps only what rays touched and ends as an octree. They share no
//! accumulation code, so each is a check of the other.

mod covariance;
mod criteria;
mod dense;
mod double_double;
mod factor;
#[cfg(feature = "correlations")]
mod full;
mod octree;
mod pooling;
mod prior;
mod scale;
mod sums;
mod visits;

pub use covariance::{Covariance, negligible_information};
pub use criteria::{Criteria, Criterion};
pub use dense::DensePosterior;
pub use factor::FactoredSums;
#[cfg(feature = "correlations")]
pub use full::{DrawnPosterior, Draws, ExactPosterior, FullPosterior};
pub(crate) use octree::{AT_ONCE, CONTRIBUTION_BYTES, TOGETHER, spare_bytes};
pub use octree::{Census, Needs, OctreePosterior, PilotCounts, Refinement};
pub use pooling::Pooling;
pub use prior::Prior;
pub use scale::{DataScale, Scale};
pub use sums::{Information, VertexSums, trace};
pub use visits::Visits;

use crate::render::RaySamples;

/// Sums information over a stream of ray samples.
pub trait Posterior {
    /// Adds the rays of `batches`, in order. Samples outside the lattice's box are skipped.
    ///
    /// The result depends on the order of the rays, but not on how they are split into batches or on the number
    /// of threads.
    fn add(&mut self, batches: &[RaySamples]);

    /// Current size on the heap, bytes.
    fn memory(&self) -> usize;
}
