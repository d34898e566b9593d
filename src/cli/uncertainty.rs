//! `uncertainty`: from a model and its cameras to a field.

use std::path::PathBuf;
use std::time::Instant;

use super::accumulate::Gathering;
use super::options::{CameraOptions, GridKind, GridOptions, ModelOptions, parse_box, parse_non_negative, parse_positive};
use super::progress::Bars;
use super::report;
use crate::Result;
use crate::geometry::Aabb;
use crate::posterior::{RayStream, SamplesWriter};
use crate::render::Differences;
use crate::uncertainty::Protocol;

/// Compute the uncertainty of a trained field from its training cameras
///
/// Draws random training rays, differentiates their pixels with respect to displacements of space, and sums what they say about
/// each deformation vertex. The result is a field that `query`, `render`, `compare` and `evaluate` read.
#[derive(clap::Args)]
#[command(after_help = "Example: octobayes uncertainty lego.safetensors --cameras lego_train.json -o lego.oct --rays 409600")]
pub struct Args {
    #[command(flatten)]
    model: ModelOptions,

    #[command(flatten)]
    cameras: CameraOptions,

    #[command(flatten)]
    grid: GridOptions,

    /// Rays drawn; the paper uses 4096000
    #[arg(long, default_value_t = 4_096_000, value_parser = clap::value_parser!(u64).range(1..))]
    rays: u64,

    /// Seed of pixels and sample positions
    #[arg(long, default_value_t = 0)]
    seed: u64,

    /// Box of the field: x0,y0,z0,x1,y1,z1 in scene units [default: the model's]
    #[arg(long = "box", value_name = "BOX", value_parser = parse_box, allow_hyphen_values = true)]
    bounds: Option<Aabb>,

    /// Finite-difference step to both sides, in edges of the finest lattice
    #[arg(long, value_name = "EDGES", default_value_t = 0.5, value_parser = parse_positive)]
    step: f64,

    /// Leave out samples whose weight, and whose density bound times |dC/dsigma|, are both below this; 0 leaves out nothing
    #[arg(long, value_name = "WEIGHT", default_value_t = DEFAULT_CUTOFF, value_parser = parse_non_negative)]
    cutoff: f64,

    /// Also write the ray samples with their Jacobians, as `accumulate` reads them
    #[arg(long, value_name = "SAMPLES.npz")]
    dump_samples: Option<PathBuf>,
}

/// Chosen by measurement: `experiments/left_out.md`.
pub const DEFAULT_CUTOFF: f64 = 1e-6;

impl Args {
    /// Runs the verb.
    pub fn run(self, bars: &Bars) -> Result<()> {
        let field = self.model.open()?;
        let views = self.cameras.read()?;
        let lattice = self.grid.lattice(self.bounds.unwrap_or_else(|| field.bounds()))?;
        let mut gathering = Gathering::start(&self.grid, lattice)?;
        let mut dump = self.dump_samples.as_deref().map(SamplesWriter::create).transpose()?;

        let start = Instant::now();
        let differences = Differences { step: self.step * lattice.edge() };
        let reach = differences.step.max_element();
        let stream = RayStream {
            tracer: self.model.tracer(&*field, self.cutoff, reach, bars)?,
            differences,
            cameras: &views.cameras(),
            pixel_offset: self.model.pixel_offset(&*field),
            seed: self.seed,
        };
        let tally = stream.run(self.rays, bars, |batches| {
            gathering.add(batches);
            dump.as_mut().map_or(Ok(()), |dump| dump.add(batches))
        })?;
        if tally.dropped > 0 {
            let first = tally.first_invalid.unwrap_or_default();
            eprintln!("warning: {} rays dropped, the field is not finite; first at {first:?}", tally.dropped);
        }
        let protocol = Protocol {
            version: env!("CARGO_PKG_VERSION").into(),
            source: format!("{} seen by {}", self.model.model, self.cameras.cameras.display()),
            rays: tally.rays,
            dropped: tally.dropped,
            seed: Some(self.seed),
            lambda: self.grid.lambda.unwrap_or_else(|| lattice.default_lambda()),
            covariance: self.grid.covariance,
            tolerance: if self.grid.grid == GridKind::Dense { 0.0 } else { self.grid.tolerance },
            march_step: Some(stream.tracer.marcher.step),
            difference_step: Some(differences.step.to_array()),
            cutoff: Some(self.cutoff),
            background: Some(self.model.background.to_array()),
            pixel_offset: Some(stream.pixel_offset),
        };
        if let Some(dump) = dump {
            dump.finish(tally.rays)?;
        }
        let (field, posterior_bytes) = gathering.finish(protocol)?;
        report::finished(&field, &report::Cost { elapsed: start.elapsed(), posterior_bytes }, self.grid.json)
    }
}
