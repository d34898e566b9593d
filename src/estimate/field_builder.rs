//! A field under construction, on either kind of grid.

use std::path::Path;

use super::builder::{Builder, FieldSource};
use super::checkpoint::RunKey;
use super::{GridKind, GridSettings};
use crate::geometry::{Domain, Lattice};
use crate::posterior::{DensePosterior, DiagonalSums, Entries, OctreePosterior};
use crate::rays::{RayStream, RunProgress};
use crate::render::RaySamples;
use crate::uncertainty::UncertaintyField;
use crate::{Error, Result};

/// Builds an uncertainty field from ray samples, on the grid that the settings ask for.
pub struct FieldBuilder(Kind);

/// Either kind of grid, and what an octree sums.
enum Kind {
    Dense(Builder<DensePosterior>),
    Octree(Builder<OctreePosterior>),
    Diagonal(Builder<OctreePosterior<DiagonalSums>>),
}

/// What a builder of any kind does.
macro_rules! either {
    ($kind:expr, $builder:ident => $call:expr) => {
        match $kind {
            Kind::Dense($builder) => $call,
            Kind::Octree($builder) => $call,
            Kind::Diagonal($builder) => $call,
        }
    };
}

impl FieldBuilder {
    /// Creates a builder without information.
    ///
    /// # Errors
    /// As [`GridSettings::lattice`], or if there is a memory budget.
    pub fn new(settings: GridSettings, domain: Domain) -> Result<Self> {
        if settings.memory.is_some() {
            return Err(Error::setting("memory budget", "a run that draws its rays", "samples from elsewhere"));
        }
        Ok(Self(match (settings.grid, settings.entries(false)) {
            (GridKind::Dense, _) => Kind::Dense(Builder::new(settings, domain, None)?),
            (GridKind::Octree, Entries::All) => Kind::Octree(Builder::new(settings, domain, None)?),
            (GridKind::Octree, Entries::Diagonal) => Kind::Diagonal(Builder::new(settings, domain, None)?),
        }))
    }

    /// Box and finest level.
    #[must_use]
    pub fn lattice(&self) -> &Lattice {
        either!(&self.0, builder => builder.lattice())
    }

    /// Adds refinement where there is density, if the settings ask for it.
    ///
    /// # Errors
    /// If there is no occupancy grid, or the number of cells exceeds what memory can hold.
    pub fn want_density(&mut self, stream: &RayStream) -> Result<()> {
        either!(&mut self.0, builder => builder.want_density(stream))
    }

    /// Adds rays.
    pub fn add(&mut self, batches: &[RaySamples]) {
        either!(&mut self.0, builder => builder.add(batches));
    }

    /// Current size of the sums, bytes.
    #[must_use]
    pub fn memory(&self) -> usize {
        either!(&self.0, builder => builder.memory())
    }

    /// Saves the state of the run `key` after the rays of `progress`.
    ///
    /// # Errors
    /// If the file cannot be written.
    #[doc(hidden)]
    pub fn save(&self, path: &Path, key: &RunKey, progress: RunProgress) -> Result<()> {
        either!(&self.0, builder => builder.save(path, key, progress))
    }

    /// Restores the state of the run `key` and returns its progress, from which the run continues.
    ///
    /// # Errors
    /// If the file is not the complete state of a run with the same description.
    #[doc(hidden)]
    pub fn restore(&mut self, path: &Path, key: &RunKey) -> Result<RunProgress> {
        either!(&mut self.0, builder => builder.restore(path, key))
    }

    /// Computes the field from the rays so far.
    ///
    /// # Errors
    /// If sums that left memory cannot be read, which those of this builder never do.
    ///
    /// # Panics
    /// If `source` is a part of a run, on an octree whose settings keep no sums.
    pub fn finish(self, source: &FieldSource) -> Result<UncertaintyField> {
        either!(self.0, builder => builder.finish(source))
    }
}
