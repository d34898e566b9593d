//! `merge`: parts of a run joined.

use std::path::PathBuf;

use super::report;
use crate::Result;
use crate::io::AtomicFile;
use crate::uncertainty::{UncertaintyField, merge};

/// Join fields of the same box, level and protocol that were computed from different rays
///
/// The result is what one run over all the rays gives, up to the order of summation and the fields' tolerance; so a job can be
/// split over machines by any scheduler. The fields must keep their Hessian (`--keep hessian`).
#[derive(clap::Args)]
#[command(
    after_help = "Example: for i in 0 1 2 3; do octobayes uncertainty model.npz --cameras transforms.json --shard $i/4 -o part$i.oct; \
    done; octobayes merge part?.oct -o field.oct"
)]
pub struct Args {
    /// Fields to join
    #[arg(value_name = "FIELD.oct", required = true, num_args = 2..)]
    fields: Vec<PathBuf>,

    /// Where the joined field is written
    #[arg(short, long, value_name = "FIELD.oct")]
    output: PathBuf,
}

impl Args {
    /// Runs the verb.
    pub fn run(self) -> Result<()> {
        drop(AtomicFile::create(&self.output)?);
        let parts = self.fields.iter().map(|path| UncertaintyField::read(path)).collect::<Result<Vec<_>>>()?;
        let field = merge(&parts)?;
        field.write(&self.output)?;
        say!("protocol\n{}\nfield\n  {}", report::protocol(&field), report::summary(&field.summary()))
    }
}
