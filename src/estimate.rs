//! From a field and its training cameras to its uncertainty, in one call.
//!
//! [`RaySettings`] say which rays are drawn and how they are differentiated, [`GridSettings`] what their information is gathered
//! on. [`estimate`] joins the two; [`FieldBuilder`] is the second half alone, for samples that come from elsewhere.

use std::path::Path;

use glam::{DVec3, Vec3};

use crate::field::RadianceField;
use crate::geometry::{Camera, Domain, Lattice};
use crate::monitor::Monitor;
use crate::posterior::checkpoint::{self, AnyPosterior, RunKey};
use crate::posterior::{
    Covariance, DensePosterior, OctreePosterior, PixelSequence, Pixels, Posterior, RayStream, SURFACE_WEIGHT, Share,
    Tally,
};
use crate::render::{Differences, Marcher, Occupancy, RaySamples, Tracer};
use crate::uncertainty::{Protocol, Support, UncertaintyField};
use crate::{Error, Result};

/// What carries the field.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
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
            surface_points: 16_384,
        }
    }
}

/// Most samples along a ray: hundreds of rays are under way at once.
const MAX_STEPS: f64 = 65_536.0;
/// Highest level of a dense grid: 6.5 GB; the next needs 52 GB.
const MAX_DENSE_LEVEL: u8 = 9;

impl GridSettings {
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

/// Which rays are drawn, and how they are sampled and differentiated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RaySettings {
    /// R.
    pub rays: u64,
    /// How pixels are chosen.
    pub pixels: Pixels,
    /// Seed of pixels and jitter.
    pub seed: u64,
    /// Finite-difference step in edges of the finest lattice.
    ///
    /// Larger steps smooth the field's derivative and move log10 U, smaller ones drown in the rounding of f32. The curves of
    /// `experiments/approximations.md`: on a smooth scene mean |Δ log10 U| is lowest (2e-5) from 1/128 to 1/32 and grows to
    /// 4e-4 at 1/512 by rounding; a NeRF MLP, whose encoding oscillates once per lattice edge at level 8, still gains from
    /// 1/32 (0.04) to 1/128 (0.015) to 1/512 (0.005). 1/128 is safe for the first and good for the second.
    pub step: f64,
    /// Samples whose weight and sensitivity are certain to stay below this are left out; 0 leaves out nothing and takes a
    /// hundred times longer. `experiments/approximations.md` has what it costs.
    pub cutoff: f64,
    /// Distance between samples, scene units; `None` for the field's suggestion.
    pub march_step: Option<f64>,
    /// Colour behind the scene.
    pub background: Vec3,
    /// Where in a pixel rays go through; `None` for the field's own.
    pub pixel_offset: Option<f64>,
    /// Cells per axis of the occupancy grid.
    pub occupancy: usize,
}

impl Default for RaySettings {
    fn default() -> Self {
        Self {
            rays: 4_096_000,
            pixels: Pixels::default(),
            seed: 0,
            step: 1.0 / 128.0,
            cutoff: 1e-6,
            march_step: None,
            background: Vec3::ONE,
            pixel_offset: None,
            occupancy: Occupancy::DEFAULT_RESOLUTION,
        }
    }
}

impl RaySettings {
    /// A tracer through `field` whose occupancy holds within a distance `reach`, scene units.
    ///
    /// # Errors
    /// If the step is too small for the field's box, or [`Error::Interrupted`].
    pub fn tracer<'a>(&self, field: &'a dyn RadianceField, reach: f64, monitor: &dyn Monitor) -> Result<Tracer<'a>> {
        let occupancy =
            if self.cutoff > 0.0 { Some(Occupancy::build(field, self.occupancy, reach, monitor)?) } else { None };
        let step = self.march_step.unwrap_or_else(|| field.suggested_step());
        let steps = field.bounds().size().length() / step;
        if steps.is_nan() || steps > MAX_STEPS {
            let expected = format!("at most {MAX_STEPS} steps across the field's box (--march-step)");
            return Err(Error::setting("march step", expected, format!("{step:e} scene units, {steps:.0} steps")));
        }
        let marcher = Marcher { step, bounds: field.bounds(), occupancy, cutoff: self.cutoff };
        Ok(Tracer { field, marcher, background: self.background })
    }

    /// The description under which a run of `share` of these rays can be taken up again; `source` names model and cameras.
    #[must_use]
    pub fn run_key(
        &self,
        source: String,
        share: Share,
        stream: &RayStream,
        grid: &GridSettings,
        lattice: &Lattice,
    ) -> RunKey {
        RunKey {
            version: env!("CARGO_PKG_VERSION").into(),
            source,
            cameras: crc32fast::hash(format!("{:?}", stream.cameras).as_bytes()),
            lattice: *lattice,
            share,
            pixels: self.pixels,
            seed: self.seed,
            march_step: stream.tracer.marcher.step,
            difference_step: stream.differences.step.to_array(),
            cutoff: stream.tracer.marcher.cutoff,
            occupancy: self.occupancy as u64,
            background: stream.tracer.background.to_array(),
            pixel_offset: stream.pixel_offset,
            surface_points: grid.surface_points as u64,
        }
    }

    /// The stream of rays from `cameras` through `field`, differentiated for `lattice`.
    ///
    /// # Errors
    /// [`Error::Interrupted`] only.
    pub fn stream<'a>(
        &self,
        field: &'a dyn RadianceField,
        cameras: &'a [Camera],
        lattice: &Lattice,
        monitor: &dyn Monitor,
    ) -> Result<RayStream<'a>> {
        let differences = Differences { step: self.step * lattice.edge(), domain: *lattice.domain() };
        // h is largest in the corner of the field's box that is farthest from a contraction's centre.
        let bounds = field.bounds();
        let corner = |c: u8| {
            DVec3::from(std::array::from_fn(|axis| [bounds.min(), bounds.max()][usize::from(c >> axis & 1)][axis]))
        };
        let farthest = (0..8).map(|c| differences.at(corner(c).as_vec3())).fold(DVec3::ZERO, DVec3::max);
        Ok(RayStream {
            tracer: self.tracer(field, farthest.max_element(), monitor)?,
            differences,
            cameras,
            pixel_offset: self.pixel_offset.unwrap_or_else(|| field.pixel_offset()),
            pixels: PixelSequence::new(self.pixels, self.seed, cameras.iter().map(|c| c.resolution).collect()),
        })
    }
}

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
        let lambda = settings.lambda.unwrap_or_else(|| lattice.default_lambda());
        let prior = settings.covariance.prior(lambda);
        if !(prior as f32).is_normal() {
            let found = format!("{lambda:e}, whose prior deviation is {prior:e}");
            return Err(Error::setting("lambda", "a prior deviation that f32 can hold", found));
        }
        let posterior = match settings.grid {
            GridKind::Dense => AnyPosterior::Dense(DensePosterior::new(lattice)),
            GridKind::Octree => AnyPosterior::Octree(OctreePosterior::new(lattice)),
        };
        Ok(Self { settings, lattice, posterior, surface: Vec::new() })
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
        let state = checkpoint::load(path, key, self.settings.grid == GridKind::Dense)?;
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
        let Self { settings, lattice, posterior, surface } = self;
        let stream = provenance.stream;
        let protocol = Protocol {
            version: env!("CARGO_PKG_VERSION").into(),
            source: provenance.source.clone(),
            rays: provenance.tally.rays,
            dropped: provenance.tally.dropped,
            pixels: stream.map(|s| s.pixels.kind()),
            seed: stream.map(|s| s.pixels.seed()),
            share: provenance.share,
            lambda: settings.lambda.unwrap_or_else(|| lattice.default_lambda()),
            covariance: settings.covariance,
            tolerance: if settings.grid == GridKind::Dense { 0.0 } else { settings.tolerance },
            march_step: stream.map(|s| s.tracer.marcher.step),
            difference_step: stream.map(|s| s.differences.step.to_array()),
            cutoff: stream.map(|s| s.tracer.marcher.cutoff),
            background: stream.map(|s| s.tracer.background.to_array()),
            pixel_offset: stream.map(|s| s.pixel_offset),
        };
        let (support, evidence) = match posterior {
            AnyPosterior::Dense(posterior) => (Support::Dense, posterior.into_sums()),
            AnyPosterior::Octree(posterior) => {
                let (octree, sums) = posterior.into_octree(protocol.rays, protocol.lambda, protocol.tolerance);
                (Support::Octree(octree), sums)
            }
        };
        UncertaintyField::new(protocol, lattice, support, evidence).with_surface(surface)
    }
}

/// The uncertainty of `field` as seen by its training `cameras`, over the field's own box.
///
/// # Errors
/// If a setting is out of range, there is no camera, the field is not finite on too many rays, or the work was interrupted.
pub fn estimate(
    field: &dyn RadianceField,
    cameras: &[Camera],
    rays: &RaySettings,
    grid: &GridSettings,
    monitor: &dyn Monitor,
) -> Result<(UncertaintyField, Tally)> {
    if cameras.is_empty() {
        return Err(Error::setting("cameras", "at least one", "none"));
    }
    let mut builder = FieldBuilder::new(*grid, Domain::Box(field.bounds()))?;
    let stream = rays.stream(field, cameras, builder.lattice(), monitor)?;
    let tally = stream.run(Share::whole(rays.rays), Tally::default(), monitor, |batches, _| {
        builder.add(batches);
        Ok(())
    })?;
    let provenance =
        Provenance { source: field.describe(), tally, share: Some(Share::whole(rays.rays)), stream: Some(&stream) };
    Ok((builder.finish(&provenance), tally))
}

#[cfg(test)]
mod tests;
