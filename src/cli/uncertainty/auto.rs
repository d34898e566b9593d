//! `--rays auto`: as many rays as the tolerance takes.

use super::{Args, warn_of_dropped};
use crate::cli::progress::Bars;
use crate::estimate::{AutoRun, FieldBuilder, GridSettings, Provenance};
use crate::geometry::Domain;
use crate::rays::RayStream;
use crate::uncertainty::UncertaintyField;
use crate::{Error, Result};

impl Args {
    /// Draws rays until the error is within the tolerance, and says what was reached; returns the field and the bytes of its sums.
    pub(super) fn run_auto(
        &self,
        stream: &RayStream,
        grid: GridSettings,
        domain: Domain,
        source: String,
        bars: &Bars,
    ) -> Result<(UncertaintyField, usize)> {
        let others = [
            ("--shard", self.shard.is_some()),
            ("--checkpoint", self.checkpoint.is_some()),
            ("--dump-samples", self.dump_samples.is_some()),
        ];
        if let Some((name, _)) = others.into_iter().find(|(_, given)| *given) {
            return Err(Error::setting("--rays auto", "a run by itself, to its end", name));
        }
        if let Some(groups) = self.error_bars.filter(|&groups| groups != 2) {
            let expected = "--error-bars 2 with --rays auto, which compares two halves of the rays";
            return Err(Error::setting("--error-bars", expected, groups.to_string()));
        }
        let (halves, tallies, error) =
            AutoRun { tolerance: grid.tolerance, most: self.max_rays }.halves(stream, grid, domain, bars)?;
        let tally = tallies[0].with(&tallies[1]);
        let verdict = if error.vertices == 0 {
            "no ray constrains anything".into()
        } else {
            let within = if error.mean <= grid.tolerance { "within" } else { "not within" };
            format!(
                "log10 U is off by {:.3} in the mean, 95 % by at most {:.3} (two halves, {} vertices that rays moved): {within} {}",
                error.mean, error.percentile_95, error.vertices, grid.tolerance
            )
        };
        eprintln!("note: {} rays; {verdict}", tally.rays);
        warn_of_dropped(&tally);
        let posterior_bytes = halves.iter().map(FieldBuilder::memory).sum();
        // Two sequences of pixels: no part of a run that others could be added to.
        let provenance = Provenance { source, tally, share: None, stream: Some(stream) };
        let field = match self.error_bars {
            Some(_) => FieldBuilder::finish_groups(halves.into(), &tallies, &provenance)?,
            None => FieldBuilder::joined(halves, stream)?.finish(&provenance),
        };
        Ok((field.with_draws(AutoRun::draws(stream, &tallies)), posterior_bytes))
    }
}
