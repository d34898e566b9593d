//! From ray samples whose Jacobians were computed elsewhere to a field.

use std::path::Path;

use super::Args;
use crate::files::CommandFiles;
use crate::given::Given;
use crate::options::check_field_name;
use crate::progress::Bars;
use crate::report;
use crate::streams::tell;
use octobayes::{Error, Result};
use octobayes_data::SamplesReader;
use octobayes_session::{Accumulation, TrainingPixels};

/// The options that samples leave open; all others are about a model and its rays.
const OPEN: [&str; 13] = [
    "--box",
    "--contract",
    "--for",
    "--level",
    "--grid",
    "--tolerance",
    "--covariance",
    "--scale",
    "--noise",
    "--pooling",
    "--keep-sums",
    "--output",
    "--json",
];

impl Args {
    /// Sums up the samples of a file.
    pub(super) fn of_samples(&self, given: &Given, bars: &Bars) -> Result<()> {
        let samples = Path::new(&self.model.model);
        let found = || format!("samples in {}", samples.display());
        given.refuse_all_but(&OPEN, "a model, whose rays are drawn", found())?;
        let Some(output) = &self.output else {
            return Err(Error::setting("--output", "a name for the field", "none"));
        };
        CommandFiles::default().input("MODEL", samples).output("--output", output).check()?;
        check_field_name(output)?;
        let neither = || Error::setting("--box", "the box of the field, or --contract", "neither");
        let domain = self.domain.chosen()?.ok_or_else(neither)?;
        let reader = SamplesReader::open(samples)?;
        let choices = self.grid.choices();
        let grid = choices.settle(self.grid.settings(), None, &mut tell)?;
        let training = TrainingPixels { pixels: reader.training_pixels(), noise: None };
        let scale = choices.scale().over(&domain, choices.noise, training)?;
        let accumulation = Accumulation::new(grid.scale(scale), domain)?;
        let finished = accumulation.read(&reader, bars, &mut tell)?;
        finished.save(output)?;
        report::finished(&finished, self.json)
    }
}
