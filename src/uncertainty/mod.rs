//! The finished spatial uncertainty field U(x), in scene units.
//!
//! U(x) = Σ_v φ_v(x) σ_v is one standard deviation of the displacement at x that the training images would not
//! notice. The field lives on a dense grid or on an octree. Both are queried, stored and compared in the same way.

mod answers;
mod baked;
mod batch;
mod by_vertex;
mod compare;
mod correlation;
mod file;
mod layers;
mod matrices;
mod merge;
mod observability;
mod precision;
mod query;
mod recompute;
mod record;
mod shown;
mod threshold;
mod to_dense;

pub use answers::Answer;
pub use baked::BakedField;
pub use compare::{Comparison, Difference, Summary, compare};
pub use file::FORMAT_VERSION;
pub use layers::{ErrorBars, ErrorSummary};
pub use matrices::Matrices;
pub use merge::{Merging, merge};
pub use observability::Observability;
pub use query::Estimate;
pub use record::RunRecord;
pub use shown::{Unknown, shown_log10, unknowns};
pub use threshold::{NEARLY_ALL, ThresholdedField, is_certain, threshold_warning};

// What only the program, Python and the experiments name.
#[doc(hidden)]
pub use self::{
    by_vertex::{ByVertex, RayCounts, StandardDeviations, Stored},
    layers::Conformal,
    precision::{Added, Precision},
};

pub use crate::posterior::Support;

use self::layers::Layers;
use crate::Result;
use crate::geometry::Lattice;
use crate::octree::{MaxLevels, Octree, VertexId};
use crate::posterior::{DensePosterior, LocalSums, OctreePosterior, Posterior, Reading, Sums, VertexSums, deviations};

/// A vertex counts as moved if log10 U lies more than this many decades below the prior's.
///
/// Half a decade keeps vertices with hardly any information from outnumbering the rest where errors and rays are
/// counted.
pub const MOVED: f64 = 0.5;

/// Sums from which a field can be computed.
pub(crate) trait Finish: Posterior + Clone {
    /// The field at these vertices of the sums, made of a copy of them or straight from them.
    ///
    /// # Errors
    /// If sums that left memory cannot be read.
    fn field(
        self,
        record: RunRecord,
        lattice: Lattice,
        at: Self::Vertices,
        gathers_sums: bool,
    ) -> Result<UncertaintyField>;

    /// Number of these vertices.
    fn count(lattice: &Lattice, at: &Self::Vertices) -> usize;
}

impl Finish for DensePosterior {
    fn field(self, record: RunRecord, lattice: Lattice, (): (), _gathers_sums: bool) -> Result<UncertaintyField> {
        Ok(UncertaintyField::new(record, lattice, Support::Dense, self.into_sums()))
    }

    fn count(lattice: &Lattice, (): &()) -> usize {
        lattice.dense_vertices() as usize
    }
}

impl<S: Sums> Finish for OctreePosterior<S> {
    fn field(self, record: RunRecord, lattice: Lattice, at: Octree, gathers_sums: bool) -> Result<UncertaintyField> {
        UncertaintyField::on_octree(record, lattice, self, at, gathers_sums)
    }

    fn count(_lattice: &Lattice, at: &Octree) -> usize {
        at.vertex_count()
    }
}

/// A spatial uncertainty field.
#[derive(Debug, Clone, PartialEq)]
pub struct UncertaintyField {
    record: RunRecord,
    lattice: Lattice,
    support: Support,
    /// `[vertices]`: σ_v, scene units.
    deviations: StandardDeviations,
    /// `[vertices]`: number of rays that passed; empty if unknown.
    rays: RayCounts,
    /// All that it may have beside them.
    layers: Layers,
}

impl UncertaintyField {
    /// Computes the field from `sums` under `record`, one entry per vertex of `support`.
    ///
    /// # Panics
    /// If the number of entries differs from the number of vertices.
    #[must_use]
    pub fn new(record: RunRecord, lattice: Lattice, support: Support, sums: Vec<VertexSums>) -> Self {
        let vertices = support.vertices(&lattice);
        assert_eq!(sums.len() as u64, vertices, "one entry per vertex");
        let limits = MaxLevels::none(lattice.level());
        Self::on_leaves(record, lattice, support, limits, sums)
    }

    fn on_leaves(
        record: RunRecord,
        lattice: Lattice,
        support: Support,
        limits: MaxLevels,
        sums: Vec<VertexSums>,
    ) -> Self {
        let rays = sums.iter().map(|sums| sums.rays).collect();
        let mut field = Self::from_values(record, lattice, support, limits, (StandardDeviations::default(), rays));
        field.deviations = field.deviations_of(&field.record.reading(), &sums);
        field.layers.sums = Some(sums);
        field
    }

    fn from_values(
        record: RunRecord,
        lattice: Lattice,
        support: Support,
        limits: MaxLevels,
        (deviations, rays): (StandardDeviations, RayCounts),
    ) -> Self {
        let ray_sets = record.ray_set().map(|ray_set| vec![ray_set]);
        let limits = Some(limits).filter(|limits| !limits.is_unlimited());
        let layers = Layers { ray_sets, limits, ..Layers::default() };
        Self { record, lattice, support, deviations, rays, layers }
    }

    /// The field on an octree that was made of the sums. σ is read straight from the posterior, which saves a copy, or
    /// the field gathers the sums. It must if they are kept, a part of others, or pooled.
    ///
    /// # Errors
    /// If sums that left memory cannot be read.
    ///
    /// # Panics
    /// If it gathers them, and has not all of S, or must and does not.
    #[doc(hidden)]
    pub fn on_octree<S: Sums>(
        record: RunRecord,
        lattice: Lattice,
        posterior: OctreePosterior<S>,
        octree: Octree,
        gathers_sums: bool,
    ) -> Result<Self> {
        let limits = posterior.limits().clone();
        let must = record.pooling.gathers_sums(record.is_part(), false);
        assert!(if gathers_sums { S::IS_WHOLE } else { !must }, "a part of a run, or a pooled one, needs all sums");
        Ok(if gathers_sums {
            let sums = posterior.sums_at(&octree)?;
            drop(posterior);
            Self::on_leaves(record, lattice, Support::Octree(octree), limits, sums)
        } else {
            let (deviations, rays) = posterior.values(&record.reading(), &octree, by_vertex::encode)?;
            let values = (deviations.into(), rays.into());
            Self::from_values(record, lattice, Support::Octree(octree), limits, values)
        })
    }

    /// Whether this is only a part of a run, whose other shards are missing.
    #[must_use]
    pub fn is_part(&self) -> bool {
        self.layers.is_part(&self.record)
    }

    /// Whether other shards are still to be added: its sums and counts are exact.
    pub(crate) fn is_to_be_merged(&self) -> bool {
        self.is_part() && self.layers.sums.is_some()
    }

    /// The same field with a checksum of the model that it was computed from.
    #[must_use]
    pub fn with_model(mut self, checksum: u32) -> Self {
        self.record.model_checksum = Some(checksum);
        self
    }

    /// Everything that the numbers depend on.
    #[must_use]
    pub fn record(&self) -> &RunRecord {
        &self.record
    }

    /// Box and finest level.
    #[must_use]
    pub fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// Dense grid or octree.
    #[must_use]
    pub fn support(&self) -> &Support {
        &self.support
    }

    /// `[vertices]`: number of rays that passed; empty if unknown.
    #[must_use]
    pub fn rays(&self) -> &RayCounts {
        &self.rays
    }

    /// Median number of rays over the vertices that moved by more than half a decade from the prior. `None` if
    /// there are no such vertices or their rays are unknown.
    #[must_use]
    pub fn median_rays(&self) -> Option<u64> {
        let moved = self.prior() * 10_f64.powf(-MOVED);
        let seen = self.deviations.iter().zip(&self.rays.0).filter(|(sigma, _)| *sigma < moved);
        let mut codes: Vec<u8> = seen.map(|(_, &code)| code).collect();
        let middle = codes.len() / 2;
        // Codes have the order of the counts.
        (!codes.is_empty()).then(|| by_vertex::decode(*codes.select_nth_unstable(middle).1))
    }

    /// `[vertices]`: σ_v, scene units.
    #[must_use]
    pub fn deviations(&self) -> &StandardDeviations {
        &self.deviations
    }

    /// U where nothing was seen, scene units.
    #[must_use]
    pub fn prior(&self) -> f64 {
        self.record.reading().prior()
    }

    /// σ_v of `sums`, one entry per vertex, under `reading`.
    fn deviations_of(&self, reading: &Reading, sums: &[VertexSums]) -> StandardDeviations {
        deviations(reading, &self.lattice, &self.support, &self.limits(), sums).into()
    }

    /// What `reading` reads off each vertex, if the field keeps its sums.
    fn local_sums(&self, reading: &Reading) -> Option<LocalSums<'_>> {
        Some(LocalSums::new(reading, &self.lattice, &self.support, &self.limits(), self.sums()?))
    }

    /// The vertex at a lattice point. An octree has none where the information is negligible.
    #[doc(hidden)]
    #[must_use]
    pub fn vertex_at(&self, point: [u32; 3]) -> Option<usize> {
        match &self.support {
            Support::Dense => Some(self.lattice.dense_index(point)),
            Support::Octree(octree) => octree.vertex(point).map(|VertexId(v)| v as usize),
        }
    }

    /// Bytes on the heap by part, spare capacity included.
    #[must_use]
    pub fn memory(&self) -> Vec<(&'static str, usize)> {
        let mut parts = vec![("deviations", self.deviations.memory()), ("ray counts", self.rays.memory())];
        if let Support::Octree(octree) = &self.support {
            parts.extend(octree.memory());
        }
        parts.extend(self.layers.memory());
        parts
    }

    /// The name of every layer, and one line on what the field has of it; an error if it has none.
    #[must_use]
    pub fn layers(&self) -> Vec<(&'static str, std::result::Result<String, &'static str>)> {
        self.layers.info()
    }

    /// Bytes needed for queries: deviation and ray count of every vertex, and the structure.
    #[must_use]
    pub fn query_memory(&self) -> usize {
        self.deviations.memory() + self.rays.memory() + self.structure_memory()
    }

    /// Bytes of the octree alone.
    fn structure_memory(&self) -> usize {
        match &self.support {
            Support::Dense => 0,
            Support::Octree(octree) => octree.memory().iter().map(|part| part.1).sum(),
        }
    }
}

impl Layers {
    /// Whether a field with this record is only a part of a run.
    fn is_part(&self, record: &RunRecord) -> bool {
        record.is_part_by(self.ray_sets.as_deref().unwrap_or_default())
    }
}

#[cfg(test)]
mod tests;
