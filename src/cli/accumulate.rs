//! `accumulate`: from ray samples of any origin to a field.

use std::path::PathBuf;
use std::time::Instant;

use super::options::{GridKind, GridOptions, Keep, parse_box};
use super::progress::Bars;
use super::report;
use crate::Result;
use crate::geometry::{Aabb, Lattice};
use crate::io::AtomicFile;
use crate::posterior::{DensePosterior, OctreePosterior, Posterior, SamplesReader};
use crate::render::RaySamples;
use crate::uncertainty::{Protocol, Support, UncertaintyField};

/// Sum up ray samples whose Jacobians were computed elsewhere
///
/// SAMPLES.npz holds `positions` f32 [N,3] in scene units, `jacobian` f32 [N,3,3] = dC_c/dx_k (rows colour, columns axis), `ray`
/// u32 or u64 [N], the non-decreasing index of the ray a sample belongs to, and `rays_total`, the number of rays drawn, with
/// those that hit nothing; optionally `weight` f32 [N], the sample's share of the pixel. The file may be larger than memory.
#[derive(clap::Args)]
#[command(after_help = "Example: octobayes accumulate samples.npz --box=-1.5,-1.5,-1.5,1.5,1.5,1.5 --level 8 -o field.oct")]
pub struct Args {
    /// Ray samples
    #[arg(value_name = "SAMPLES.npz")]
    samples: PathBuf,

    /// Box of the field: x0,y0,z0,x1,y1,z1 in scene units
    #[arg(long = "box", value_name = "BOX", value_parser = parse_box, allow_hyphen_values = true)]
    bounds: Aabb,

    #[command(flatten)]
    grid: GridOptions,
}

impl Args {
    /// Runs the verb.
    pub fn run(self, bars: &Bars) -> Result<()> {
        let reader = SamplesReader::open(&self.samples)?;
        let lattice = self.grid.lattice(self.bounds)?;
        let mut gathering = Gathering::start(&self.grid, lattice)?;
        let start = Instant::now();
        reader.run(bars, |batches| {
            gathering.add(batches);
            Ok(())
        })?;
        let protocol = Protocol {
            version: env!("CARGO_PKG_VERSION").into(),
            source: format!("samples {}", self.samples.display()),
            rays: reader.rays_total(),
            dropped: 0,
            seed: None,
            lambda: self.grid.lambda.unwrap_or_else(|| lattice.default_lambda()),
            covariance: self.grid.covariance,
            tolerance: if self.grid.grid == GridKind::Dense { 0.0 } else { self.grid.tolerance },
            march_step: None,
            difference_step: None,
            cutoff: None,
            background: None,
            pixel_offset: None,
        };
        let (field, posterior_bytes) = gathering.finish(protocol)?;
        report::finished(&field, &report::Cost { elapsed: start.elapsed(), posterior_bytes }, self.grid.json)
    }
}

/// Samples with at least this weight lie on a visible surface.
const SURFACE_WEIGHT: f32 = 0.05;

/// The posterior that was asked for.
enum AnyPosterior {
    Dense(DensePosterior),
    Octree(OctreePosterior),
}

/// A field in the making: what `uncertainty` and `accumulate` have in common.
pub struct Gathering<'a> {
    options: &'a GridOptions,
    lattice: Lattice,
    posterior: AnyPosterior,
    surface: Vec<[f32; 3]>,
}

impl<'a> Gathering<'a> {
    /// Makes sure, before any work, that the output can be written.
    pub fn start(options: &'a GridOptions, lattice: Lattice) -> Result<Self> {
        drop(AtomicFile::create(&options.output)?);
        let posterior = match options.grid {
            GridKind::Dense => AnyPosterior::Dense(DensePosterior::new(lattice)),
            GridKind::Octree => AnyPosterior::Octree(OctreePosterior::new(lattice)),
        };
        Ok(Self { options, lattice, posterior, surface: Vec::new() })
    }

    /// Adds rays.
    pub fn add(&mut self, batches: &[RaySamples]) {
        match &mut self.posterior {
            AnyPosterior::Dense(posterior) => posterior.add(batches),
            AnyPosterior::Octree(posterior) => posterior.add(batches),
        }
        // The first ones of a random sequence are as good as any.
        let visible = batches.iter().flat_map(|batch| batch.positions.iter().zip(&batch.weights));
        let visible = visible.filter(|(_, weight)| **weight >= SURFACE_WEIGHT).map(|(x, _)| x.to_array());
        self.surface.extend(visible.take(self.options.surface_points - self.surface.len()));
    }

    /// Writes the field; returns it with the bytes that the posterior held.
    pub fn finish(self, protocol: Protocol) -> Result<(UncertaintyField, usize)> {
        let Self { options, lattice, posterior, surface } = self;
        let (support, information, bytes) = match posterior {
            AnyPosterior::Dense(posterior) => {
                let bytes = posterior.memory();
                (Support::Dense, posterior.into_sums(), bytes)
            }
            AnyPosterior::Octree(posterior) => {
                let bytes = posterior.memory();
                let (octree, sums) = posterior.into_octree(protocol.rays, protocol.lambda, protocol.tolerance);
                (Support::Octree(octree), sums, bytes)
            }
        };
        let mut field = UncertaintyField::new(protocol, lattice, support, information).with_surface(surface);
        let keep = options.keep.unwrap_or(match options.grid {
            GridKind::Dense => Keep::Deviation,
            GridKind::Octree => Keep::Hessian,
        });
        if keep == Keep::Deviation {
            field = field.without_information();
        }
        field.write(&options.output)?;
        Ok((field, bytes))
    }
}
