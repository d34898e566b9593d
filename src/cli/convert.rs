//! `convert`: to and from the official code's grid.

use std::path::PathBuf;

use super::options::OfficialOptions;
use crate::posterior::Covariance;
use crate::{Error, Result};

/// Convert between `.oct` and the official code's `.npy`
///
/// The official file is a flat f32 array of (2^lod + 1)^3 sums of squared derivatives in its own index order (stride M, so
/// vertices on upper faces share entries); its viewer and evaluation read what this writes.
#[derive(clap::Args)]
#[command(after_help = "Example: octobayes convert lego.oct unc.npy")]
pub struct Args {
    /// `.oct` or `.npy`
    input: PathBuf,

    /// `.npy` or `.oct`
    output: PathBuf,

    #[command(flatten)]
    official: OfficialOptions,
}

impl Args {
    /// Runs the verb.
    pub fn run(self) -> Result<()> {
        let field = self.official.read(&self.input)?;
        match self.output.extension().and_then(|e| e.to_str()) {
            Some("npy") => {
                field.write_official(&self.output)?;
                let (rays, lambda) = (field.protocol().rays, field.protocol().lambda);
                say!(
                    "{}: Σ tr(JᵀJ) of {rays} rays; uncertainty there is log10 of sqrt(1 / (Σ/{rays} + {lambda:e}))",
                    self.output.display()
                )?;
                Ok(())
            }
            Some("oct") => {
                field.write(&self.output)?;
                say!("{}: covariance `{}`", self.output.display(), Covariance::Trace.name())?;
                Ok(())
            }
            _ => Err(Error::malformed(&self.output, "file name", "`.npy` or `.oct`", "another extension")),
        }
    }
}
