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
mod pooling;
mod ray_coverage;
mod scale;
mod shrinkage;

pub use covariance::Covariance;
pub(crate) use covariance::negligible_information;
pub use dense::DensePosterior;
pub(crate) use deviations::Reading;
pub use deviations::Support;
pub(crate) use deviations::{LocalSums, comparable, deviations};
pub(crate) use octree::{AT_ONCE, CONTRIBUTION_BYTES, spare_bytes};
pub use octree::{Criteria, Criterion, OctreePosterior};
pub(crate) use octree::{Needs, PilotCounts, Refinement, SpeciesEstimate};
pub use pooling::Pooling;
pub use scale::{DataScale, Scale};

// What only the program, Python and the experiments name.
#[doc(hidden)]
pub use self::{factor::FactoredSums, ray_coverage::RayCoverage};

use std::ops::AddAssign;

use bytemuck::{Pod, Zeroable};

use crate::geometry::Lattice;
use crate::io::container::Item;
use crate::octree::{MaxLevels, Tile};
use crate::render::RaySamples;

/// Sums of information over a stream of ray samples, on one kind of grid.
pub trait Posterior: Sized + for<'a> AddAssign<&'a Self> {
    /// Whether every lattice point has sums.
    const IS_DENSE: bool;
    /// Where the vertices of a field of these sums are.
    type Vertices;

    /// No information yet. An octree is summed on the leaves of `limits` and in `tile` alone; a dense grid has neither.
    fn empty(lattice: Lattice, limits: &MaxLevels, tile: Option<Tile>) -> Self;

    /// Adds the rays of `batches`, in order. Samples outside the lattice's box are skipped.
    ///
    /// The result depends on the order of the rays, but not on how they are split into batches or on the number
    /// of threads.
    fn add(&mut self, batches: &[RaySamples]);

    /// Current size on the heap, bytes.
    fn memory(&self) -> usize;

    /// The part of [`Posterior::memory`] that no sums use yet, bytes.
    fn spare(&self) -> usize;

    /// The vertices of the field of these sums.
    fn vertices(&self, refinement: &Refinement) -> Self::Vertices;

    /// How many vertices these are.
    fn count(&self, vertices: &Self::Vertices) -> usize;

    /// The sums at these vertices, in their order.
    fn gathered(self, vertices: &Self::Vertices) -> Vec<VertexSums>;

    /// The sums of this posterior and of another on the same leaves, at every vertex that rays touched in either.
    fn paired(&self, other: &Self) -> Vec<(VertexSums, VertexSums)>;

    /// For files: a key for each of the sums, in the order of [`Posterior::slices`]. None on a dense grid.
    fn keys(&self) -> Vec<u64>;

    /// The sums, slice by slice.
    fn slices(&self) -> impl Iterator<Item = &[VertexSums]>;

    /// Restores what [`Posterior::keys`] and [`Posterior::slices`] returned, in the same order; `None` if they are not
    /// those of such a grid.
    fn restore(
        lattice: Lattice,
        limits: &MaxLevels,
        tile: Option<Tile>,
        keys: &[u64],
        sums: Vec<VertexSums>,
    ) -> Option<Self>;
}

/// S = Σ_r JᵀJ of one vertex, summed over rays and colour channels: xx, xy, xz, yy, yz, zz, in 1 / scene unit².
pub type Information = [f64; 6];

/// tr S.
#[must_use]
pub fn trace(s: &Information) -> f64 {
    s[0] + s[3] + s[5]
}

/// Sums over the rays that touched a vertex; 56 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct VertexSums {
    /// S.
    pub information: Information,
    /// Number of rays with a sample in one of the vertex's cells.
    pub rays: u32,
    /// Fills the last bytes, so that sums can lie in memory that is mapped.
    unused: u32,
}

impl VertexSums {
    /// Sums over so many rays.
    #[must_use]
    #[inline]
    pub fn new(information: Information, rays: u32) -> Self {
        Self { information, rays, unused: 0 }
    }

    /// Checks whether rays can have produced these sums.
    ///
    /// All numbers are finite, the diagonal of the information is not negative, and its other entries are not
    /// larger than a sum of squares allows (Cauchy-Schwarz).
    #[must_use]
    pub fn is_valid(&self) -> bool {
        let [xx, xy, xz, yy, yz, zz] = self.information;
        // Each of at most 2³² terms is rounded by 2⁻⁵³ of its bound. Subnormal numbers have no bounded relative
        // rounding.
        let bounded = |product: f64, a: f64, b: f64| {
            product.abs() <= a.sqrt() * b.sqrt() * (1.0 + 1e-6) + f64::MIN_POSITIVE.sqrt()
        };
        trace(&self.information).is_finite()
            && xx.min(yy).min(zz) >= 0.0
            && bounded(xy, xx, yy)
            && bounded(xz, xx, zz)
            && bounded(yz, yy, zz)
    }
}

impl AddAssign<&Self> for VertexSums {
    /// Adds the sums over other rays.
    #[inline]
    fn add_assign(&mut self, other: &Self) {
        self.information.iter_mut().zip(other.information).for_each(|(s, o)| *s += o);
        self.rays = self.rays.saturating_add(other.rays);
    }
}

impl Item for VertexSums {
    const SIZE: usize = Information::SIZE + u32::SIZE;

    fn put(self, out: &mut Vec<u8>) {
        self.information.put(out);
        self.rays.put(out);
    }

    fn take(bytes: &[u8]) -> Self {
        let (information, rays) = bytes.split_at(Information::SIZE);
        Self::new(Item::take(information), Item::take(rays))
    }
}
