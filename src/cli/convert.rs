//! `convert`: to and from the official code's grid, and to a coarser octree.

use std::path::PathBuf;

use super::files::CommandFiles;
use super::options::{OfficialOptions, parse_positive};
use super::report;
use crate::uncertainty::Store;
use crate::{Error, Result};

/// Convert between `.oct` and the official code's `.npy`, or make an octree coarser
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

    /// Merge leaves of an octree while log10 U changes by at most this anywhere; keeps deviations only
    #[arg(long, value_name = "DECADES", value_parser = parse_positive)]
    coarsen: Option<f64>,

    /// How to store deviations; f16 keeps deviations only
    #[arg(long, value_enum, default_value = "f32")]
    store: Store,

    #[command(flatten)]
    official: OfficialOptions,
}

impl Args {
    /// Runs the verb.
    pub fn run(self) -> Result<()> {
        CommandFiles::default().input("INPUT", &self.input).output("OUTPUT", &self.output).check()?;
        let field = self.official.read(&self.input)?;
        let field = match (self.coarsen, self.store) {
            (Some(epsilon), store) => field.coarsened_in(store, epsilon)?,
            (None, Store::F16) => field.in_f16(),
            (None, Store::F32) => field,
        };
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
                say!("{}: {}", self.output.display(), report::summary(&field.summary()))
            }
            _ => Err(Error::malformed(&self.output, "file name", "`.npy` or `.oct`", "another extension")),
        }
    }
}
