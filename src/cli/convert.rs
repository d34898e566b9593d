//! `convert`: to and from the official code's grid.

use std::path::PathBuf;

use super::files::CommandFiles;
use super::options::OfficialOptions;
use super::report;
use crate::{Error, Result};

/// Convert between `.oct` and the official code's `.npy`
///
/// The official file is a flat f32 array of (2^lod + 1)^3 sums of squared derivatives, in its own index order
/// (stride M, so vertices on upper faces share entries). The official viewer and evaluation read what this writes.
#[derive(clap::Args)]
#[command(after_help = "Example: octobayes convert lego.oct unc.npy")]
pub struct Args {
    /// File to read, `.oct` or `.npy`
    input: PathBuf,

    /// File to write, `.npy` or `.oct`
    output: PathBuf,

    /// Keep the 3x3 matrices of an `.oct` file; without this, only a shard's stay
    #[arg(long)]
    keep_sums: bool,

    #[command(flatten)]
    official: OfficialOptions,
}

impl Args {
    /// Runs the verb.
    pub fn run(self) -> Result<()> {
        CommandFiles::default().input("INPUT", &self.input).output("OUTPUT", &self.output).check()?;
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
                let field = if self.keep_sums { field } else { field.for_queries() };
                field.write(&self.output)?;
                say!("{}: {}", self.output.display(), report::summary(&field.summary()))
            }
            _ => Err(Error::malformed(&self.output, "file name", "`.npy` or `.oct`", "another extension")),
        }
    }
}
