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
mod dense;
mod deviations;
mod double_double;
mod enclosed;
mod factor;
mod means;
mod octree;
pub(crate) mod overflow;
mod pooling;
mod ray_coverage;
mod scale;
mod shrinkage;
mod sums;

pub use covariance::Covariance;
pub(crate) use covariance::negligible_information;
pub use dense::DensePosterior;
pub use deviations::Support;
pub(crate) use deviations::{LocalSums, deviations};
#[doc(hidden)]
pub use deviations::{Reading, comparable};
#[doc(hidden)]
pub use octree::Refinement;
pub use octree::{Criteria, Criterion, OctreePosterior};
pub(crate) use octree::{Touches, spare_bytes};
pub use pooling::Pooling;
pub use scale::{DataScale, Scale};
pub(crate) use sums::{DiagonalSums, Entries};
pub use sums::{Information, Sums, VertexSums, trace};

// What only the program, Python and the experiments name.
#[doc(hidden)]
pub use self::{factor::FactoredSums, ray_coverage::RayCoverage};

use std::ops::AddAssign;
use std::sync::Arc;

use crate::Result;
use crate::geometry::Lattice;
use crate::io::sorted::{Push, SortedFile};
use crate::octree::MaxLevels;
use crate::render::RaySamples;

/// What pushes sums with their keys, in the order of these.
#[doc(hidden)]
pub type Fill<'a, S> = &'a dyn Fn(Push<S>) -> Result<()>;

/// Sums of information over a stream of ray samples, on one kind of grid.
pub trait Posterior: Sized + Sync + for<'a> AddAssign<&'a Self> {
    /// The name of such a grid and of what it sums.
    const NAME: [&'static str; 2];
    /// What is summed at each vertex.
    type Sums: Sums;
    /// Where the vertices of a field of these sums are.
    type Vertices;

    /// No information yet. An octree is summed on the leaves of `limits`; a dense grid has none.
    fn empty(lattice: Lattice, limits: &MaxLevels) -> Self;

    /// Adds the rays of `batches`, in order. Samples outside the lattice's box are skipped.
    ///
    /// The result depends on the order of the rays, but not on how they are split into batches or on the number
    /// of threads.
    fn add(&mut self, batches: &[RaySamples]);

    /// Adds the sums over other rays at one vertex.
    fn add_sums(&mut self, point: [u32; 3], sums: &VertexSums);

    /// Current size on the heap, bytes.
    fn memory(&self) -> usize;

    /// Frees the memory of the sums so far, which `write` writes to a run, in the order of their keys. A dense grid
    /// keeps its own.
    ///
    /// # Errors
    /// What `write` returns.
    fn spill(&mut self, write: impl FnOnce(Fill<'_, Self::Sums>) -> Result<SortedFile<Self::Sums>>) -> Result<()>;

    /// Replaces all runs by one of their sums, which `write` writes.
    ///
    /// # Errors
    /// If a run cannot be read, or what `write` returns.
    fn merge_runs(&mut self, write: impl FnOnce(Fill<'_, Self::Sums>) -> Result<SortedFile<Self::Sums>>) -> Result<()>;

    /// The runs so far, the oldest first.
    fn runs(&self) -> &[Arc<SortedFile<Self::Sums>>];

    /// Adds the next run of a state that is [restored](Posterior::restore), unless it is not one of such a grid.
    /// Returns whether it is.
    ///
    /// # Errors
    /// If the run cannot be read.
    fn add_run(&mut self, run: SortedFile<Self::Sums>) -> Result<bool>;

    /// The vertices of the field of these sums. If any left memory, all have.
    ///
    /// # Errors
    /// If a run cannot be read.
    fn vertices(&self, refinement: &Refinement) -> Result<Self::Vertices>;

    /// `[vertices]`: what `read` makes of the number of a vertex of a field, its lattice point, and its sums in each of
    /// these `groups` of rays, on the same leaves.
    ///
    /// # Errors
    /// If a run cannot be read.
    ///
    /// # Panics
    /// If the vertices are those of the other kind of grid.
    fn read_groups<T: Clone + Default + Send>(
        groups: &[Self],
        support: &Support,
        read: impl Fn(usize, [u32; 3], &[Self::Sums]) -> T + Sync,
    ) -> Result<Vec<T>>;

    /// What `read` makes of the sums of this posterior and of another on the same leaves, at every vertex that rays
    /// touched in either, leaving out what is `None`. If any sums of the two left memory, all have.
    ///
    /// # Errors
    /// If a run cannot be read.
    fn paired<T: Send>(
        &self,
        other: &Self,
        read: impl Fn(VertexSums, VertexSums) -> Option<T> + Send + Sync,
    ) -> Result<Vec<T>>;

    /// For files: a key for each of the sums, in the order of [`Posterior::slices`]. None on a dense grid.
    fn keys(&self) -> Vec<u64>;

    /// The sums, slice by slice.
    fn slices(&self) -> impl Iterator<Item = &[Self::Sums]>;

    /// Restores what [`Posterior::keys`] and [`Posterior::slices`] returned, in the same order; `None` if they are not
    /// those of such a grid.
    fn restore(lattice: Lattice, limits: &MaxLevels, keys: &[u64], sums: Vec<Self::Sums>) -> Option<Self>;
}
