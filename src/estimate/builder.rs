//! A field under construction.

use std::collections::BTreeSet;
use std::ops::AddAssign;
use std::path::Path;

use rayon::prelude::*;

use super::state::{self, AnyPosterior, RunKey};
use super::{GridKind, GridSettings, Plan, Summed};
use crate::geometry::{Domain, Lattice};
use crate::octree::{Cell, MaxLevels, Octree, morton};
use crate::posterior::{DensePosterior, OctreePosterior, Posterior, VertexSums, Visits};
use crate::rays::{RayStream, RunProgress, SURFACE_WEIGHT, Shard};
use crate::render::RaySamples;
use crate::uncertainty::{Origin, Protocol, Support, UncertaintyField};
use crate::{Error, Result};

/// The source of a field's numbers: the part of its protocol that the grid does not know.
#[derive(Clone, Default)]
pub struct Provenance<'a> {
    /// Model and cameras, or the samples file.
    pub source: String,
    /// Counts of rays drawn and dropped.
    pub progress: RunProgress,
    /// The part of a run that drew them.
    pub shard: Option<Shard>,
    /// The stream that drew them, if it belongs to this crate.
    pub stream: Option<&'a RayStream<'a>>,
}

/// Maximal number of cells that criteria other than sensitivity may ask for: 3 GB of their keys.
const MOST_WANTED: u64 = 1 << 27;

/// All finest cells.
fn every_cell(lattice: &Lattice) -> Result<Vec<Cell>> {
    let level = lattice.level();
    if 1_u64 << (3 * u32::from(level)) > MOST_WANTED {
        return Err(Error::setting("criterion `uniform`", "a level up to 9", level.to_string()));
    }
    let cell = |code| Cell { level, index: morton::decode(code) };
    Ok((0..1_u64 << (3 * u32::from(level))).map(cell).collect())
}

/// Builds an uncertainty field from ray samples.
pub struct FieldBuilder {
    settings: GridSettings,
    lattice: Lattice,
    limits: MaxLevels,
    /// Rays per vertex for which the limits were made.
    rays_per_vertex: f64,
    /// Cells that must exist regardless of the rays.
    wanted: Vec<Cell>,
    posterior: AnyPosterior,
    surface: Vec<[f32; 3]>,
    /// Rays seen passing; `None` if it is not known where they passed.
    visits: Option<Visits>,
}

impl FieldBuilder {
    /// Creates a builder without information.
    ///
    /// # Errors
    /// As [`GridSettings::lattice`].
    pub fn new(settings: GridSettings, domain: Domain) -> Result<Self> {
        let lattice = settings.lattice(domain)?;
        let posterior = match settings.grid {
            GridKind::Dense => AnyPosterior::Dense(DensePosterior::new(lattice)),
            GridKind::Octree => AnyPosterior::Octree(OctreePosterior::new(lattice).owning(settings.tile)),
        };
        let limits = MaxLevels::none(lattice.level());
        let wanted = if settings.criteria.uniform { every_cell(&lattice)? } else { Vec::new() };
        Ok(Self {
            settings,
            lattice,
            limits,
            rays_per_vertex: 0.0,
            wanted,
            posterior,
            surface: Vec::new(),
            visits: None,
        })
    }

    /// Starts over on the leaves of `plan`. No effect on a dense grid, whose leaves all have one size.
    pub fn limit(&mut self, plan: &Plan) {
        if self.settings.grid == GridKind::Octree {
            self.limits = plan.limits.clone();
            self.rays_per_vertex = plan.rays_per_vertex;
            self.posterior = self.empty_octree(plan.limits.clone());
            self.surface.clear();
            self.visits = None;
        }
    }

    /// Adds refinement where there is density, if the settings ask for it.
    ///
    /// The refined cells are those cells of the stream's occupancy grid in which a finest cell may
    /// have an optical depth above 0.01.
    ///
    /// # Errors
    /// If there is no occupancy grid, or the number of cells exceeds what memory can hold.
    pub fn want_density(&mut self, stream: &RayStream) -> Result<()> {
        if !self.settings.criteria.density || self.settings.grid == GridKind::Dense {
            return Ok(());
        }
        let Some(occupancy) = &stream.tracer.marcher.occupancy else {
            return Err(Error::setting("criterion `density`", "a cutoff above 0, which makes an occupancy grid", "0"));
        };
        let edge = self.lattice.edge().max_element();
        let level = self.lattice.level().min(occupancy.resolution().ilog2() as u8);
        let cells = occupancy.cells_above((0.01 / edge) as f32);
        let coarse: BTreeSet<u64> = cells
            .flat_map(|x| self.lattice.coordinates(x.as_vec3()))
            .map(|u| morton::encode(self.lattice.cell(u).0.map(|i| i >> (self.lattice.level() - level))))
            .collect();
        let depth = 3 * u32::from(self.lattice.level() - level);
        if coarse.len() as u64 >= MOST_WANTED >> depth {
            let found = format!("{:.1e} finest cells", coarse.len() as f64 * f64::from(depth).exp2());
            return Err(Error::setting("criterion `density`", format!("at most {MOST_WANTED} finest cells"), found));
        }
        let finest = coarse.iter().flat_map(|&code| (code << depth)..((code + 1) << depth));
        self.wanted.extend(finest.map(|code| Cell { level: self.lattice.level(), index: morton::decode(code) }));
        Ok(())
    }

    /// Box and finest level.
    #[must_use]
    pub fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// Adds rays.
    pub fn add(&mut self, batches: &[RaySamples]) {
        self.posterior_mut().add(batches);
        if batches.iter().any(|batch| !batch.sight.is_empty()) {
            self.visits.get_or_insert_with(|| Visits::new(&self.lattice)).add(batches);
        }
        // In a random sequence the first points are as good as any.
        let visible = batches.iter().flat_map(|batch| batch.positions.iter().zip(&batch.weights));
        let lattice = self.lattice;
        // Matter outside the domain has no U of its own.
        let tile = self.settings.tile;
        let is_own = |x| {
            let cell = lattice.coordinates(x).map(|u| lattice.cell(u).0);
            cell.is_some_and(|cell| tile.is_none_or(|tile| tile.owns(lattice.level(), cell)))
        };
        let visible = visible.filter(|(x, weight)| **weight >= SURFACE_WEIGHT && is_own(**x));
        self.keep_surface(visible.map(|(x, _)| x.to_array()));
    }

    /// Sums on the leaves of `limits`, in the tile, if there is one.
    fn empty_octree(&self, limits: MaxLevels) -> AnyPosterior {
        AnyPosterior::Octree(OctreePosterior::limited(self.lattice, limits).owning(self.settings.tile))
    }

    /// Keeps as many of these points as there is room for.
    fn keep_surface(&mut self, points: impl Iterator<Item = [f32; 3]>) {
        let room = self.settings.surface_points - self.surface.len();
        self.surface.extend(points.take(room));
    }

    /// Saves the state of the run `key` after the rays of `progress`.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path, key: &RunKey, progress: RunProgress) -> Result<()> {
        state::save(path, key, progress, &self.posterior, &self.surface, self.visits.as_ref())
    }

    /// Restores the state of the run `key` and returns its progress, from which the run continues.
    ///
    /// # Errors
    /// If the file is not the complete state of a run with the same description.
    pub fn restore(&mut self, path: &Path, key: &RunKey) -> Result<RunProgress> {
        let state = state::load(path, key, &self.limits, self.settings.grid == GridKind::Dense)?;
        self.posterior = match state.posterior {
            AnyPosterior::Octree(posterior) => AnyPosterior::Octree(posterior.owning(self.settings.tile)),
            dense @ AnyPosterior::Dense(_) => dense,
        };
        self.surface = state.surface;
        self.visits = state.visits;
        Ok(state.progress)
    }

    /// Current size of the sums, bytes.
    #[must_use]
    pub fn memory(&self) -> usize {
        match &self.posterior {
            AnyPosterior::Dense(posterior) => posterior.memory(),
            AnyPosterior::Octree(posterior) => posterior.memory(),
        }
    }

    /// The same, apart from what is taken and not used.
    pub(super) fn summed(&self) -> Summed {
        let spare = match &self.posterior {
            AnyPosterior::Dense(_) => 0,
            AnyPosterior::Octree(posterior) => posterior.spare(),
        };
        Summed { used: self.memory() - spare, spare, vertices: None }
    }

    /// The limits of the leaves on which rays are summed.
    #[must_use]
    pub fn limits(&self) -> &MaxLevels {
        &self.limits
    }

    /// The settings.
    pub(super) fn settings(&self) -> &GridSettings {
        &self.settings
    }

    /// The sums of this builder and of another on the same lattice, at every vertex that rays touched in
    /// either. Neither may have limits.
    pub(super) fn paired(&self, other: &Self) -> Vec<(VertexSums, VertexSums)> {
        match (&self.posterior, &other.posterior) {
            (AnyPosterior::Dense(mine), AnyPosterior::Dense(theirs)) => {
                let pairs = mine.sums().iter().zip(theirs.sums());
                pairs.filter(|(a, b)| a.rays > 0 || b.rays > 0).map(|(a, b)| (*a, *b)).collect()
            }
            (AnyPosterior::Octree(mine), AnyPosterior::Octree(theirs)) => {
                let both = mine.touched().map(|(point, sums)| (*sums, theirs.sums(point)));
                let new = theirs.touched().filter(|(point, _)| mine.sums(*point).rays == 0);
                both.chain(new.map(|(_, sums)| (VertexSums::default(), *sums))).collect()
            }
            _ => unreachable!("both have the same settings"),
        }
    }

    /// An empty builder with the same settings and limits.
    pub(super) fn emptied(&self) -> Self {
        let posterior = match self.settings.grid {
            GridKind::Dense => AnyPosterior::Dense(DensePosterior::new(self.lattice)),
            GridKind::Octree => self.empty_octree(self.limits.clone()),
        };
        let (limits, wanted) = (self.limits.clone(), self.wanted.clone());
        Self { limits, wanted, posterior, surface: Vec::new(), visits: None, ..*self }
    }

    /// The sums at the vertices of `support`, in their order.
    pub(super) fn sums_at(self, support: &Support) -> Vec<VertexSums> {
        match (self.posterior, support) {
            (AnyPosterior::Dense(posterior), _) => posterior.into_sums(),
            (AnyPosterior::Octree(posterior), Support::Octree(octree)) => posterior.sums_at(octree),
            (AnyPosterior::Octree(_), Support::Dense) => unreachable!("an octree's sums become an octree"),
        }
    }

    /// Rays per vertex for which the limits were made; 0 without limits.
    #[must_use]
    pub fn rays_per_vertex(&self) -> f64 {
        self.rays_per_vertex
    }

    fn posterior_mut(&mut self) -> &mut dyn Posterior {
        match &mut self.posterior {
            AnyPosterior::Dense(posterior) => posterior,
            AnyPosterior::Octree(posterior) => posterior,
        }
    }

    /// How the rays so far were drawn and summed.
    fn protocol(&self, provenance: &Provenance) -> Protocol {
        let (settings, stream) = (&self.settings, provenance.stream);
        Protocol {
            version: env!("CARGO_PKG_VERSION").into(),
            source: provenance.source.clone(),
            origin: Origin { model: None, cameras: stream.map(RayStream::cameras_checksum) },
            rays: provenance.progress.rays,
            dropped: provenance.progress.dropped,
            pixels: stream.map(|s| s.pixels.kind()),
            seed: stream.map(|s| s.pixels.seed()),
            shard: provenance.shard,
            lambda: settings.prior_precision(&self.lattice),
            scale: settings.scale,
            prior: settings.prior,
            min_rays: settings.min_rays,
            criteria: settings.criteria,
            covariance: settings.covariance,
            // A dense grid leaves nothing out, but pooling needs to know which vertices moved.
            tolerance: if settings.grid == GridKind::Dense && settings.min_rays == 0.0 {
                0.0
            } else {
                settings.tolerance
            },
            march_step: stream.map(|s| s.tracer.marcher.step),
            gradient: stream.map(|s| s.differentiation.method()),
            difference_step: stream.and_then(|s| s.differentiation.difference_step()),
            cutoff: stream.map(|s| s.tracer.marcher.cutoff),
            background: stream.map(|s| s.tracer.background.to_array()),
            pixel_offset: stream.map(|s| s.pixel_offset),
        }
    }

    /// The octree of the field that the rays so far would give; none on a dense grid.
    pub(super) fn octree(&mut self, provenance: &Provenance) -> Option<Octree> {
        let protocol = self.protocol(provenance);
        let AnyPosterior::Octree(posterior) = &self.posterior else { return None };
        // There may be gigabytes of wanted cells.
        let refinement = protocol.refinement(posterior, std::mem::take(&mut self.wanted));
        let octree = posterior.octree(&refinement);
        self.wanted = refinement.wanted;
        Some(octree)
    }

    /// Computes the field from the rays so far.
    #[must_use]
    pub fn finish(self, provenance: &Provenance) -> UncertaintyField {
        self.finish_on(None, provenance)
    }

    /// [`FieldBuilder::finish`] with the [octree](FieldBuilder::octree) that was `made` for it, if it was.
    pub(super) fn finish_on(mut self, made: Option<Octree>, provenance: &Provenance) -> UncertaintyField {
        let octree = made.or_else(|| self.octree(provenance));
        let protocol = self.protocol(provenance);
        let Self { settings, lattice, posterior, surface, visits, wanted, .. } = self;
        drop(wanted);
        let field = match (posterior, octree) {
            (AnyPosterior::Dense(posterior), _) => {
                UncertaintyField::new(protocol, lattice, Support::Dense, posterior.into_sums())
            }
            (AnyPosterior::Octree(posterior), Some(octree)) => {
                UncertaintyField::on_octree(protocol, lattice, posterior, octree, settings.keep_sums)
            }
            (AnyPosterior::Octree(_), None) => unreachable!("an octree was made of an octree's sums"),
        };
        let field = if settings.keep_sums { field } else { field.for_queries() };
        let visits = visits.map(|visits| visits.within(settings.tile, lattice.level()));
        field.with_surface(surface).with_visits(visits)
    }
}

impl AddAssign<&Self> for FieldBuilder {
    /// Adds the sums of another builder with the same settings and limits, vertex by vertex.
    fn add_assign(&mut self, other: &Self) {
        match (&mut self.posterior, &other.posterior) {
            (AnyPosterior::Dense(mine), AnyPosterior::Dense(theirs)) => *mine += theirs,
            (AnyPosterior::Octree(mine), AnyPosterior::Octree(theirs)) => *mine += theirs,
            _ => unreachable!("both have the same settings"),
        }
        self.keep_surface(other.surface.iter().copied());
        match (&mut self.visits, &other.visits) {
            (Some(mine), Some(theirs)) => *mine += theirs,
            (mine @ None, theirs) => mine.clone_from(theirs),
            (Some(_), None) => {}
        }
    }
}
