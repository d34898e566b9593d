//! The finished spatial uncertainty field U(x), in scene units.
//!
//! U(x) = Σ_v φ_v(x) σ_v is one standard deviation of the displacement at x that the training images would not
//! notice. The field lives on a dense grid or on an octree. Both are queried, stored and compared in the same way.

mod answers;
mod baked;
mod batch;
mod coarser;
mod compare;
mod conformal;
mod correlations;
mod densify;
mod depth;
mod error_bars;
mod file;
mod from_sums;
mod knowledge;
mod matrices;
mod merge;
mod misfit;
mod official;
mod protocol;
mod query;
mod ray_counts;
mod reread;
mod shown;
mod standard_deviations;
mod threshold;
mod tiled;

pub use answers::{Answer, Answers};
pub use baked::BakedField;
pub use compare::{Comparison, Difference, Summary, compare};
pub use conformal::Conformal;
pub use correlations::Correlations;
pub use depth::DepthPosterior;
pub use error_bars::{ErrorBars, ErrorSummary, Jackknife};
pub use file::FORMAT_VERSION;
pub use knowledge::Knowledge;
pub use matrices::Matrices;
pub use merge::{finish_tiles, merge, merge_files, merge_files_with_error_bars, merge_with_error_bars};
pub use misfit::{Misfit, MisfitSums};
pub use official::OfficialGrid;
pub use protocol::{Origin, Protocol};
pub use query::Estimate;
pub use ray_counts::RayCounts;
pub use shown::{Unknown, shown_log10, unknowns};
pub use standard_deviations::StandardDeviations;
pub use threshold::{NEARLY_ALL, ThresholdedField, threshold_warning};
pub use tiled::TiledField;

use self::from_sums::{deviations_from_sums, values_without_sums};
use crate::geometry::Lattice;
use crate::octree::{Cell, MaxLevels, Octree, Tile, VertexId};
use crate::posterior::{OctreePosterior, VertexSums, Visits};
use crate::rays::Draw;

/// A vertex counts as moved if log10 U lies more than this many decades below the prior's.
///
/// Half a decade keeps vertices with hardly any information from outnumbering the rest where errors and rays are
/// counted.
pub const MOVED: f64 = 0.5;

/// The vertices that carry values.
#[derive(Debug, Clone, PartialEq)]
pub enum Support {
    /// All (M + 1)³ lattice points, x slowest.
    Dense,
    /// The free vertices of an octree.
    Octree(Octree),
}

/// A spatial uncertainty field.
#[derive(Debug, Clone, PartialEq)]
pub struct UncertaintyField {
    protocol: Protocol,
    lattice: Lattice,
    support: Support,
    /// Limits of the leaves on which rays were summed.
    limits: MaxLevels,
    /// `[vertices]`: σ_v, scene units.
    deviations: StandardDeviations,
    /// `[vertices]`: number of rays that passed; empty if unknown.
    rays: RayCounts,
    /// `[vertices]`: sums over the rays, if kept, from which other covariances can be computed.
    sums: Option<Vec<VertexSums>>,
    /// `[vertices]`: errors of log10 σ_v relative to its limit, if independent groups of rays were compared.
    error_bars: Option<ErrorBars>,
    /// `[n]`: points on visible surfaces, scene units, for comparisons.
    surface: Vec<[f32; 3]>,
    /// Rays that reached each part of space, if known.
    visits: Option<Visits>,
    /// The rays that were summed; empty if unknown.
    draws: Vec<Draw>,
    /// Displacements drawn together, if neighbours are not taken for independent in errors of depth.
    correlations: Option<Correlations>,
    /// What training left unexplained, if deviations of depth count it.
    misfit: Option<Misfit>,
    /// The same rays on coarser lattices, finest first; usually none.
    coarser: Vec<Self>,
    /// An interval of depth that was calibrated for these deviations.
    conformal: Option<Conformal>,
    /// The part of space whose vertices have sums, if not all. Elsewhere nothing is known.
    tile: Option<Tile>,
}

impl UncertaintyField {
    /// Computes the field from `sums` under `protocol`, one entry per vertex of `support`.
    ///
    /// # Panics
    /// If the number of entries differs from the number of vertices.
    #[must_use]
    pub fn new(protocol: Protocol, lattice: Lattice, support: Support, sums: Vec<VertexSums>) -> Self {
        let vertices = vertex_count(&lattice, &support);
        assert_eq!(sums.len() as u64, vertices, "one entry per vertex");
        let limits = MaxLevels::none(lattice.level());
        Self::on_leaves(protocol, lattice, support, limits, sums)
    }

    fn on_leaves(
        protocol: Protocol,
        lattice: Lattice,
        support: Support,
        limits: MaxLevels,
        sums: Vec<VertexSums>,
    ) -> Self {
        let deviations = deviations_from_sums(&protocol, &lattice, &support, &limits, &sums);
        let rays = sums.iter().map(|sums| sums.rays).collect();
        Self { sums: Some(sums), ..Self::from_values(protocol, lattice, support, limits, (deviations, rays)) }
    }

    fn from_values(
        protocol: Protocol,
        lattice: Lattice,
        support: Support,
        limits: MaxLevels,
        (deviations, rays): (StandardDeviations, RayCounts),
    ) -> Self {
        let draws = protocol.draw().into_iter().collect();
        Self {
            protocol,
            lattice,
            support,
            limits,
            deviations,
            rays,
            sums: None,
            error_bars: None,
            surface: Vec::new(),
            visits: None,
            draws,
            correlations: None,
            misfit: None,
            coarser: Vec::new(),
            conformal: None,
            tile: None,
        }
    }

    /// Computes the field of an octree posterior.
    ///
    /// The octree is refined according to the protocol's criteria and tolerance, and contains the cells `wanted`.
    /// A part of a run ([`Protocol::is_part`]) is refined wherever a ray passed, because what is negligible for
    /// the run is known only when all parts are present.
    #[must_use]
    pub fn from_octree(protocol: Protocol, lattice: Lattice, posterior: OctreePosterior, wanted: Vec<Cell>) -> Self {
        let octree = posterior.octree(&protocol.refinement(&posterior, wanted));
        Self::on_octree(protocol, lattice, posterior, octree, true)
    }

    /// The field on an octree that was made of the sums. Sums that are neither to be kept nor needed for others are not
    /// gathered a second time, which takes less memory.
    pub(crate) fn on_octree(
        protocol: Protocol,
        lattice: Lattice,
        posterior: OctreePosterior,
        octree: Octree,
        keep_sums: bool,
    ) -> Self {
        let (limits, tile) = (posterior.limits().clone(), posterior.tile());
        if keep_sums || protocol.is_part() || protocol.pooling().is_on() || tile.is_some() {
            let sums = posterior.sums_at(&octree);
            drop(posterior);
            return Self { tile, ..Self::on_leaves(protocol, lattice, Support::Octree(octree), limits, sums) };
        }
        let values = values_without_sums(&protocol, &octree, &posterior);
        Self::from_values(protocol, lattice, Support::Octree(octree), limits, values)
    }

    /// The same field without its sums: a tenth of the memory, but the covariance is fixed.
    #[must_use]
    pub fn without_sums(self) -> Self {
        // Without the matrices deviations of depth are others, so an interval for those would be wrong.
        let conformal = self.conformal.filter(|_| self.sums.is_none() || self.correlations.is_some());
        let coarser = self.coarser.into_iter().map(Self::without_sums).collect();
        Self { sums: None, coarser, conformal, ..self }
    }

    /// The same field without what queries do not need. A part of a run keeps its sums: it is of no use without
    /// the other parts.
    #[must_use]
    pub fn for_queries(self) -> Self {
        if self.is_part() { self } else { self.without_sums() }
    }

    /// Whether this is only a part of a run, whose other shards or tiles are missing.
    #[must_use]
    pub fn is_part(&self) -> bool {
        self.tile.is_some() || self.protocol.is_part() || self.draws.iter().any(Draw::is_part)
    }

    /// Whether other shards or tiles are still to be added: its sums and counts are exact.
    pub(crate) fn is_to_be_merged(&self) -> bool {
        self.is_part() && self.sums.is_some()
    }

    /// The part of space that the sums are of, or that a finished tile answers for; `None` if all.
    #[must_use]
    pub fn tile(&self) -> Option<Tile> {
        self.tile
    }

    /// The same field with the [checksum](crate::open::checksum) of the model that it was computed from.
    #[must_use]
    pub fn with_model(mut self, checksum: u32) -> Self {
        self.protocol.origin.model = Some(checksum);
        self.coarser = self.coarser.into_iter().map(|field| field.with_model(checksum)).collect();
        self
    }

    /// The same field with the given points on visible surfaces.
    #[must_use]
    pub fn with_surface(self, surface: Vec<[f32; 3]>) -> Self {
        Self { surface, ..self }
    }

    /// The same field with the rays of several draws. A protocol alone names only one. Coarser levels go: they are of
    /// the rays that it had.
    ///
    /// # Panics
    /// If two of them may have rays in common.
    #[must_use]
    pub fn with_draws(self, draws: Vec<Draw>) -> Self {
        assert!(Draw::are_disjoint(draws.iter().copied()), "a ray is counted once");
        Self { draws, coarser: Vec::new(), ..self }
    }

    /// The rays that were summed, by sequence of pixels.
    ///
    /// Empty if they are unknown. That is so if they come from a samples file or another program, or from several
    /// sequences by a version of this crate that did not record them.
    #[must_use]
    pub fn draws(&self) -> &[Draw] {
        &self.draws
    }

    /// Everything that the numbers depend on.
    #[must_use]
    pub fn protocol(&self) -> &Protocol {
        &self.protocol
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

    /// Limits of the leaves on which rays were summed.
    #[must_use]
    pub fn limits(&self) -> &MaxLevels {
        &self.limits
    }

    /// `[vertices]`: number of rays that passed; empty if unknown.
    #[must_use]
    pub fn rays(&self) -> &RayCounts {
        &self.rays
    }

    /// `[vertices]`: sums over the rays, if kept.
    #[must_use]
    pub fn sums(&self) -> Option<&[VertexSums]> {
        self.sums.as_deref()
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
        (!codes.is_empty()).then(|| ray_counts::decode(*codes.select_nth_unstable(middle).1))
    }

    /// `[vertices]`: σ_v, scene units.
    #[must_use]
    pub fn deviations(&self) -> &StandardDeviations {
        &self.deviations
    }

    /// `[n]`: points on visible surfaces.
    #[must_use]
    pub fn surface(&self) -> &[[f32; 3]] {
        &self.surface
    }

    /// U where nothing was seen, scene units.
    #[must_use]
    pub fn prior(&self) -> f64 {
        self.protocol.prior_deviation()
    }

    /// tr S at a lattice point: exact at a vertex, 0 elsewhere, where it is negligible; `None` if the sums were
    /// not kept.
    #[must_use]
    pub fn trace_at(&self, point: [u32; 3]) -> Option<f64> {
        let sums = self.sums.as_ref()?;
        Some(self.vertex_at(point).map_or(0.0, |v| crate::posterior::trace(&sums[v].information)))
    }

    /// The vertex at a lattice point. An octree has none where the information is negligible.
    fn vertex_at(&self, point: [u32; 3]) -> Option<usize> {
        match &self.support {
            Support::Dense => Some(self.lattice.dense_index(point)),
            Support::Octree(octree) => octree.vertex(point).map(|VertexId(v)| v as usize),
        }
    }

    /// Bytes on the heap by part, spare capacity included.
    #[must_use]
    pub fn memory(&self) -> Vec<(&'static str, usize)> {
        let mut parts = vec![("deviations", self.deviations.memory()), ("ray counts", self.rays.memory())];
        if let Some(sums) = &self.sums {
            parts.push(("sums", sums.capacity() * size_of::<VertexSums>()));
        }
        if let Some(error_bars) = &self.error_bars {
            parts.push(("error bars", error_bars.memory()));
        }
        if let Some(correlations) = &self.correlations {
            parts.push(("correlations", correlations.memory()));
        }
        if let Some(misfit) = &self.misfit {
            parts.push(("misfit", misfit.memory()));
        }
        if !self.coarser.is_empty() {
            let of_coarser = self.coarser.iter().flat_map(Self::memory).map(|part| part.1).sum();
            parts.push(("coarser levels", of_coarser));
        }
        if let Support::Octree(octree) = &self.support {
            parts.extend(octree.memory());
        }
        if let Some(visits) = &self.visits {
            parts.push(("visits", visits.memory()));
        }
        parts.push(("surface points", self.surface.capacity() * size_of::<[f32; 3]>()));
        parts
    }

    /// Bytes needed for queries: deviation and ray count of every vertex, and the structure; coarser levels included.
    #[must_use]
    pub fn query_memory(&self) -> usize {
        let coarser: usize = self.coarser.iter().map(Self::query_memory).sum();
        self.deviations.memory() + self.rays.memory() + self.structure_memory() + coarser
    }

    /// Bytes of the octree alone.
    fn structure_memory(&self) -> usize {
        match &self.support {
            Support::Dense => 0,
            Support::Octree(octree) => octree.memory().iter().map(|part| part.1).sum(),
        }
    }
}

fn vertex_count(lattice: &Lattice, support: &Support) -> u64 {
    match support {
        Support::Dense => lattice.dense_vertices(),
        Support::Octree(octree) => octree.vertex_count() as u64,
    }
}

#[cfg(test)]
mod tests;
