//! What information is gathered on, and how it becomes a field.

use crate::geometry::{Domain, Lattice};
use crate::posterior::{Covariance, Criteria, DensePosterior, Prior};
use crate::uncertainty::SAMPLES_SHARE;
use crate::{Error, Result};

/// What carries the field.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum GridKind {
    /// Adaptive octree, finest where rays are sensitive
    #[default]
    Octree,
    /// The paper's uniform grid of (2^level + 1)^3 vertices: the reference
    Dense,
}

/// What information is gathered on, and how it becomes a field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridSettings {
    /// Dense grid or octree.
    pub grid: GridKind,
    /// Finest level: 2^level cells per axis of the box.
    pub level: u8,
    /// Scalar read off the 3×3 matrices.
    pub covariance: Covariance,
    /// λ, 1 / scene unit²; `None` for 1e-4 / M³ per squared longest edge of the box.
    pub lambda: Option<f64>,
    /// Largest change of log10 U by coarse leaves. Smaller keeps more vertices; 0 keeps all that any ray moved.
    pub tolerance: f64,
    /// How λ depends on the size of cells.
    pub prior: Prior,
    /// Vertices with fewer rays around them than about this borrow from their neighbours ([`crate::posterior::Pooling`]); 0 leaves each by itself, as
    /// the dense grid of the paper.
    pub min_rays: f64,
    /// Where the octree is refined.
    pub criteria: Criteria,
    /// Most bytes for sums and field; `None` for as many as it takes.
    pub memory: Option<u64>,
    /// Points on visible surfaces to keep, for comparisons.
    pub surface_points: usize,
}

impl Default for GridSettings {
    fn default() -> Self {
        Self {
            grid: GridKind::Octree,
            level: 8,
            covariance: Covariance::Diagonal,
            lambda: None,
            tolerance: 0.01,
            prior: Prior::Uniform,
            min_rays: 0.0,
            criteria: Criteria::default(),
            memory: None,
            surface_points: 16_384,
        }
    }
}

/// Highest level of a dense grid: 6.5 GB; the next needs 52 GB.
const MAX_DENSE_LEVEL: u8 = 9;

impl GridSettings {
    /// Rays per vertex below which leaves stay coarser; 0 for no such limit.
    #[must_use]
    pub fn rays_per_vertex(&self) -> f64 {
        match (self.criteria.ray_count, self.min_rays) {
            (false, _) => 0.0,
            (true, 0.0) => 4.0,
            (true, min_rays) => min_rays,
        }
    }

    /// Whether a run has to be planned before it can be run.
    #[must_use]
    pub fn needs_plan(&self) -> bool {
        self.memory.is_some() || self.criteria.ray_count
    }

    /// Largest change of log10 U by samples that are left out as negligible.
    ///
    /// A dense grid, which is the reference, leaves none out. `normal` neither: H and with it U along any fixed direction would change by no more than
    /// this, but the mean gradient that is its direction may be that of small samples alone.
    #[must_use]
    pub fn samples_tolerance(&self) -> f64 {
        match (self.grid, self.covariance) {
            (GridKind::Dense, _) | (_, Covariance::Normal) => 0.0,
            _ => SAMPLES_SHARE * self.tolerance,
        }
    }

    /// λ over `lattice`, 1 / scene unit².
    #[must_use]
    pub fn lambda(&self, lattice: &Lattice) -> f64 {
        self.lambda.unwrap_or_else(|| lattice.default_lambda())
    }

    /// The lattice over `domain`.
    ///
    /// # Errors
    /// If the level is out of range, or above 9 for a dense grid.
    pub fn lattice(&self, domain: Domain) -> Result<Lattice> {
        let lattice = Lattice::of_domain(domain, self.level)?;
        if self.grid == GridKind::Dense && self.level > MAX_DENSE_LEVEL {
            let gigabytes = DensePosterior::required_memory(&lattice) as f64 / 1e9;
            let found = format!("level {}, which needs {gigabytes:.0} GB (an octree does not)", self.level);
            return Err(Error::setting("dense grid", format!("a level up to {MAX_DENSE_LEVEL}"), found));
        }
        Ok(lattice)
    }
}
