//! A field in the making.

use std::path::Path;

use super::{GridKind, GridSettings};
use crate::geometry::{Domain, Lattice};
use crate::octree::LevelLimits;
use crate::posterior::checkpoint::{self, AnyPosterior, RunKey};
use crate::posterior::{DensePosterior, OctreePosterior, Posterior, RayStream, SURFACE_WEIGHT, Share, Tally};
use crate::render::RaySamples;
use crate::uncertainty::{Protocol, Support, UncertaintyField};
use crate::{Error, Result};

/// What a field's numbers come from: the part of its protocol that the grid does not know.
#[derive(Clone, Default)]
pub struct Provenance<'a> {
    /// Model and cameras, or samples file.
    pub source: String,
    /// Rays drawn and dropped.
    pub tally: Tally,
    /// Which part of a run they are.
    pub share: Option<Share>,
    /// The stream that drew them, if it was this crate's.
    pub stream: Option<&'a RayStream<'a>>,
}

/// A field in the making.
pub struct FieldBuilder {
    settings: GridSettings,
    lattice: Lattice,
    limits: LevelLimits,
    posterior: AnyPosterior,
    surface: Vec<[f32; 3]>,
}

impl FieldBuilder {
    /// No information yet.
    ///
    /// # Errors
    /// As [`GridSettings::lattice`].
    pub fn new(settings: GridSettings, domain: Domain) -> Result<Self> {
        let lattice = settings.lattice(domain)?;
        let lambda = settings.lambda(&lattice);
        let prior = settings.covariance.prior(lambda);
        if !(prior as f32).is_normal() {
            let found = format!("{lambda:e}, whose prior deviation is {prior:e}");
            return Err(Error::setting("lambda", "a prior deviation that f32 can hold", found));
        }
        let posterior = match settings.grid {
            GridKind::Dense => AnyPosterior::Dense(DensePosterior::new(lattice)),
            GridKind::Octree => AnyPosterior::Octree(OctreePosterior::new(lattice)),
        };
        Ok(Self { settings, lattice, limits: LevelLimits::none(lattice.level()), posterior, surface: Vec::new() })
    }

    /// Box and finest level.
    #[must_use]
    pub fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// Adds rays.
    pub fn add(&mut self, batches: &[RaySamples]) {
        self.posterior_mut().add(batches);
        // The first ones of a random sequence are as good as any.
        let visible = batches.iter().flat_map(|batch| batch.positions.iter().zip(&batch.weights));
        let visible = visible.filter(|(_, weight)| **weight >= SURFACE_WEIGHT).map(|(x, _)| x.to_array());
        self.surface.extend(visible.take(self.settings.surface_points - self.surface.len()));
    }

    /// Writes the state of the run `key` after the rays of `tally`.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path, key: &RunKey, tally: Tally) -> Result<()> {
        checkpoint::save(path, key, tally, &self.posterior, &self.surface)
    }

    /// Takes up the state of the run `key`; returns the tally to go on from.
    ///
    /// # Errors
    /// If the file is not the complete state of a run with the same description.
    pub fn restore(&mut self, path: &Path, key: &RunKey) -> Result<Tally> {
        let state = checkpoint::load(path, key, &self.limits, self.settings.grid == GridKind::Dense)?;
        self.posterior = state.posterior;
        self.surface = state.surface;
        Ok(state.tally)
    }

    /// Bytes that the sums take now.
    #[must_use]
    pub fn memory(&self) -> usize {
        match &self.posterior {
            AnyPosterior::Dense(posterior) => posterior.memory(),
            AnyPosterior::Octree(posterior) => posterior.memory(),
        }
    }

    fn posterior_mut(&mut self) -> &mut dyn Posterior {
        match &mut self.posterior {
            AnyPosterior::Dense(posterior) => posterior,
            AnyPosterior::Octree(posterior) => posterior,
        }
    }

    /// The field that the rays so far give.
    #[must_use]
    pub fn finish(self, provenance: &Provenance) -> UncertaintyField {
        let Self { settings, lattice, posterior, surface, .. } = self;
        let stream = provenance.stream;
        let protocol = Protocol {
            version: env!("CARGO_PKG_VERSION").into(),
            source: provenance.source.clone(),
            rays: provenance.tally.rays,
            dropped: provenance.tally.dropped,
            pixels: stream.map(|s| s.pixels.kind()),
            seed: stream.map(|s| s.pixels.seed()),
            share: provenance.share,
            lambda: settings.lambda(&lattice),
            prior: settings.prior,
            min_rays: settings.min_rays,
            covariance: settings.covariance,
            // A dense grid leaves nothing out; but pooling asks which vertices moved.
            tolerance: if settings.grid == GridKind::Dense && settings.min_rays == 0.0 {
                0.0
            } else {
                settings.tolerance
            },
            march_step: stream.map(|s| s.tracer.marcher.step),
            difference_step: stream.map(|s| s.differences.step.to_array()),
            cutoff: stream.map(|s| s.tracer.marcher.cutoff),
            background: stream.map(|s| s.tracer.background.to_array()),
            pixel_offset: stream.map(|s| s.pixel_offset),
        };
        let field = match posterior {
            AnyPosterior::Dense(posterior) => {
                UncertaintyField::new(protocol, lattice, Support::Dense, posterior.into_sums())
            }
            AnyPosterior::Octree(posterior) => UncertaintyField::from_octree(protocol, lattice, posterior, Vec::new()),
        };
        field.with_surface(surface)
    }
}
