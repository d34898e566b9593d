//! Settings of the grid on which information is summed, and of its conversion to a field.

use crate::geometry::{Domain, Lattice};
use crate::posterior::{Covariance, Criteria, DensePosterior, Entries, Pooling, Scale};
use crate::{Error, Result};

choices! {
    /// The structure that carries the field.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
    #[non_exhaustive]
    pub enum GridKind {
        #[default]
        Octree = "octree", "Adaptive octree, finest where rays are sensitive";
        Dense = "dense", "The paper's uniform grid of (2^level + 1)^3 vertices: the reference";
    }
}

setters! {
    /// Settings of the grid on which information is summed, and of its conversion to a field.
    #[derive(Debug, Clone, Copy, PartialEq)]
    #[non_exhaustive]
    pub struct GridSettings {
        /// Dense grid or octree.
        pub grid: GridKind,
        /// Finest level: 2^level cells per axis of the box.
        pub level: u8,
        /// Definition of the standard deviation that is computed from the 3×3 matrices.
        pub covariance: Covariance,
        /// Prior precision λ, 1 / scene unit²; `None` for 1e-4 / M³ divided by the square of the box's longest edge.
        pub lambda: Option<f64> as into,
        /// What U is a deviation of. The scale of the training pixels determines λ.
        pub scale: Scale,
        /// Largest change of log10 U due to coarse leaves. Smaller values keep more vertices; 0 keeps all that any
        /// ray moved.
        pub tolerance: f64,
        /// Whether a vertex near few rays borrows from its neighbours; off by default, as on the dense grid of the
        /// paper.
        pub pooling: Pooling,
        /// Criteria for refining the octree.
        pub criteria: Criteria,
        /// With [`Criterion::RayCount`](crate::posterior::Criterion::RayCount), approximate number of rays per vertex
        /// below which leaves stay coarser.
        pub ray_count: f64,
        /// Maximal peak memory of the process, bytes; `None` for no limit. Sums that it has no room for go to files
        /// ([`Estimation::scratch`](super::Estimation::scratch)). The field is that of a run without a budget, but for
        /// the order in which sums are added.
        pub memory: Option<u64> as into,
        /// Whether the field keeps its sums, for other covariances and merging. Without them an octree takes half of
        /// the memory, or two thirds for [`Covariance::Block`]. A part of a run keeps them all the same.
        pub keep_sums: bool,
    }
}

impl Default for GridSettings {
    fn default() -> Self {
        Self {
            grid: GridKind::Octree,
            level: 8,
            covariance: Covariance::Diagonal,
            lambda: None,
            scale: Scale::Paper,
            tolerance: 0.01,
            pooling: Pooling::Off,
            criteria: Criteria::default(),
            ray_count: 4.0,
            memory: None,
            keep_sums: true,
        }
    }
}

/// Highest level of a dense grid, which takes 6.5 GB; the next would take 52 GB.
const MAX_DENSE_LEVEL: u8 = 9;

impl GridSettings {
    /// Rays per vertex below which leaves stay coarser; 0 for no such limit.
    #[must_use]
    pub fn rays_per_vertex(&self) -> f64 {
        if self.criteria.ray_count { self.ray_count } else { 0.0 }
    }

    /// Whether leaves stay coarser where rays are few.
    #[must_use]
    pub fn is_limited(&self) -> bool {
        self.criteria.ray_count
    }

    /// Whether the field is made of a copy of all sums at its vertices; so it is in any run that is a part of another.
    pub(super) fn gathers_sums(&self, is_part: bool) -> bool {
        self.pooling.gathers_sums(is_part, self.keep_sums)
    }

    /// What an octree sums of S: no more than is read.
    pub(super) fn entries(&self, is_part: bool) -> Entries {
        if self.gathers_sums(is_part) { Entries::All } else { self.covariance.entries() }
    }

    /// Prior precision λ over `lattice`, 1 / scene unit².
    #[must_use]
    pub fn prior_precision(&self, lattice: &Lattice) -> f64 {
        match self.scale {
            Scale::Paper => self.lambda.unwrap_or_else(|| lattice.default_lambda()),
            Scale::Data(data) => data.lambda(),
        }
    }

    /// The lattice over `domain`.
    ///
    /// # Errors
    /// If the level is out of range, or above 9 for a dense grid, or if f32 cannot hold the prior's deviation.
    pub fn lattice(&self, domain: Domain) -> Result<Lattice> {
        let lattice = Lattice::from_domain(domain, self.level)?;
        if self.grid == GridKind::Dense && self.level > MAX_DENSE_LEVEL {
            let gigabytes = DensePosterior::required_memory(&lattice) as f64 / 1e9;
            let found = format!("level {}, which needs {gigabytes:.0} GB (an octree does not)", self.level);
            return Err(Error::setting("dense grid", format!("a level up to {MAX_DENSE_LEVEL}"), found));
        }
        if self.grid == GridKind::Dense && self.criteria != Criteria::default() {
            let found = format!("{} on a dense grid", self.criteria);
            return Err(Error::setting("criteria", "an octree, which is refined by them", found));
        }
        if let (Scale::Data(data), Some(lambda)) = (self.scale, self.lambda) {
            let expected = format!("none: the scale of the training pixels has {:e}", data.lambda());
            return Err(Error::setting("lambda", expected, format!("{lambda:e}")));
        }
        let lambda = self.prior_precision(&lattice);
        let prior = self.covariance.prior(lambda);
        if !(prior as f32).is_normal() {
            let found = format!("{lambda:e}, whose prior deviation is {prior:e}");
            return Err(Error::setting("lambda", "a prior deviation that f32 can hold", found));
        }
        Ok(lattice)
    }
}
