//! `uncertainty`: from a model and its cameras to a field.

use std::path::PathBuf;
use std::time::Instant;

use super::options::{CameraOptions, GridOptions, ModelOptions, parse_box, parse_non_negative, parse_positive};
use super::progress::Bars;
use super::report::Cost;
use crate::Result;
use crate::estimate::{FieldBuilder, Provenance, RaySettings};
use crate::geometry::Aabb;
use crate::posterior::SamplesWriter;

/// Compute the uncertainty of a trained field from its training cameras
///
/// Draws random training rays, differentiates their pixels with respect to displacements of space, and sums what they say about
/// each deformation vertex. The result is a field that `query`, `render`, `compare` and `evaluate` read.
#[derive(clap::Args)]
#[command(
    after_help = "Example: octobayes uncertainty lego.safetensors --cameras lego_train.json -o lego.oct --rays 409600"
)]
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
    #[arg(long, value_name = "EDGES", default_value_t = RaySettings::default().step, value_parser = parse_positive)]
    step: f64,

    /// Leave out samples whose weight, and whose density bound times |dC/dsigma|, are both below this; 0 leaves out nothing
    #[arg(long, value_name = "WEIGHT", default_value_t = RaySettings::default().cutoff, value_parser = parse_non_negative)]
    cutoff: f64,

    /// Also write the ray samples with their Jacobians, as `accumulate` reads them
    #[arg(long, value_name = "SAMPLES.npz")]
    dump_samples: Option<PathBuf>,
}

impl Args {
    /// Runs the verb.
    pub fn run(self, bars: &Bars) -> Result<()> {
        let field = self.model.open()?;
        let views = self.cameras.read()?;
        let mut builder = FieldBuilder::new(self.grid.settings(), self.bounds.unwrap_or_else(|| field.bounds()))?;
        self.grid.check_output()?;
        let mut dump = self.dump_samples.as_deref().map(SamplesWriter::create).transpose()?;

        let start = Instant::now();
        let settings = RaySettings {
            rays: self.rays,
            seed: self.seed,
            step: self.step,
            cutoff: self.cutoff,
            ..RaySettings::default()
        };
        let cameras = views.cameras();
        let stream = self.model.ray_settings(settings).stream(&*field, &cameras, builder.lattice(), bars)?;
        let tally = stream.run(self.rays, bars, |batches| {
            builder.add(batches);
            dump.as_mut().map_or(Ok(()), |dump| dump.add(batches))
        })?;
        if let Some(first) = tally.first_invalid {
            eprintln!("warning: {} rays dropped, the field is not finite; first at {first:?}", tally.dropped);
        }
        if let Some(dump) = dump {
            dump.finish(tally.rays)?;
        }
        let posterior_bytes = builder.memory();
        let source = format!("{} seen by {}", self.model.model, self.cameras.cameras.display());
        let field = builder.finish(&Provenance { source, tally, stream: Some(&stream) });
        self.grid.write(field, &Cost { elapsed: start.elapsed(), posterior_bytes })
    }
}
