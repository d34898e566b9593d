//! `accumulate`: from ray samples of any origin to a field.

use std::path::PathBuf;

use super::files::CommandFiles;
use super::options::{DomainOptions, GridOptions, ScaleOptions, check_field_name, count, heading};
use super::progress::Bars;
use super::report;
use super::streams::tell;
use crate::session::{Accumulation, ScaleKind, TrainingPixels};
use crate::{Error, Result};

/// Sum up ray samples whose Jacobians were computed elsewhere
///
/// SAMPLES.npz holds `positions` (f32, N x 3, scene units); `jacobian` (f32, N x 3 x 3, dC_c/dx_k, rows colour,
/// columns axis); `ray` (u64, N, the index of each sample's ray, never decreasing); and `rays_total`, the
/// number of rays drawn, including those that hit nothing. `weight` (f32, N, the sample's share of the pixel) is
/// optional. Other types of floats and integers are converted. The file may be larger than memory.
#[derive(clap::Args)]
#[command(
    after_help = "Example: octobayes accumulate samples.npz --box=-1.5,-1.5,-1.5,1.5,1.5,1.5 --level 8 -o field.oct"
)]
pub struct Args {
    /// Ray samples
    #[arg(value_name = "SAMPLES.npz")]
    samples: PathBuf,

    #[command(flatten)]
    domain: DomainOptions,

    #[command(flatten)]
    grid: GridOptions,

    /// Number of training pixels, for --scale data
    #[arg(long, value_name = "N", value_parser = count::<u64>(1..), help_heading = heading::STATISTICS)]
    training_pixels: Option<u64>,

    /// Where to write the field
    #[arg(short, long, value_name = "FIELD.oct", help_heading = heading::OUTPUT)]
    output: PathBuf,

    /// Print one JSON object
    #[arg(long, help_heading = heading::OUTPUT)]
    json: bool,
}

impl Args {
    /// Runs the verb.
    pub fn run(self, bars: &Bars) -> Result<()> {
        CommandFiles::default().input("SAMPLES", &self.samples).output("--output", &self.output).check()?;
        check_field_name(&self.output)?;
        let neither = || Error::setting("--box", "the box of the field, or --contract", "neither");
        let domain = self.domain.chosen()?.ok_or_else(neither)?;
        let ScaleOptions { scale, noise } = self.grid.scale;
        if scale == ScaleKind::Paper && self.training_pixels.is_some() {
            return Err(Error::setting("--training-pixels", "--scale data beside it", "--scale paper"));
        }
        let scale = scale.over(&domain, noise, TrainingPixels { pixels: self.training_pixels, noise: None })?;
        let accumulation = Accumulation::new(self.grid.settings().scale(scale), domain)?;
        let finished = accumulation.read(&self.samples, bars, &mut tell)?;
        finished.save(&self.output)?;
        report::finished(&finished, self.json)
    }
}
