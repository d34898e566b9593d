//! `merge`: joins the parts of a run.

use std::path::PathBuf;

use serde_json::json;

use super::files::CommandFiles;
use super::options::check_field_name;
use super::report;
use octobayes::Result;
use octobayes::io::place::folder_of;
use octobayes::rays::MissingShards;
use octobayes::uncertainty::{Merging, UncertaintyField};

/// Join fields of the same box, level and record that were computed from different rays
///
/// The result is what one run over all the rays gives, up to the order of summation and the fields' tolerance. So
/// any scheduler can split a job over machines. Shards keep what this needs; whole runs do with `--keep-sums`. If
/// shards of a run are missing, a warning names them. Sums are read from the files and go to disk again, so that memory
/// holds the joined field and little else. Error bars of the parts are dropped.
#[derive(clap::Args)]
#[command(
    after_help = "Example: for i in 0 1 2 3; do octobayes uncertainty model.npz --cameras transforms.json --shard $i/4 \
    -o part$i.oct; done; octobayes merge part?.oct -o field.oct"
)]
pub struct Args {
    /// Fields to join
    #[arg(value_name = "FIELD.oct", required = true, num_args = 2..)]
    fields: Vec<PathBuf>,

    /// Where to write the joined field
    #[arg(short, long, value_name = "FIELD.oct")]
    output: PathBuf,

    /// Keep the 3x3 matrices in the joined field; always kept while shards are missing
    #[arg(long)]
    keep_sums: bool,

    /// Also store the sampling error of log10 U, by comparing the fields (delete-one jackknife)
    ///
    /// The fields must come from different seeds, or from independent rays computed elsewhere. The estimate
    /// improves with the number of fields: ten are many, two give half their difference.
    #[arg(long)]
    error_bars: bool,

    /// Folder for the sums that memory has no room for [default: that of the output]
    #[arg(long, value_name = "DIR")]
    scratch: Option<PathBuf>,

    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

impl Args {
    /// Runs the verb.
    pub fn run(self) -> Result<()> {
        CommandFiles::default().inputs("FIELD", &self.fields).output("--output", &self.output).check()?;
        check_field_name(&self.output)?;
        let scratch = self.scratch.clone().unwrap_or_else(|| folder_of(&self.output).to_path_buf());
        let merging = Merging::default().keep_sums(self.keep_sums).error_bars(self.error_bars).scratch(scratch);
        let field = merging.join(&self.fields)?;
        let mut parts = self.fields.iter().map(|path| UncertaintyField::has_error_bars(path));
        if !self.error_bars && parts.any(|has| matches!(has, Ok(true))) {
            announce!(
                "note: the fields' own error bars are not those of the whole, which has none; \
                 --error-bars compares the fields"
            );
        }
        let missing = MissingShards::beside(field.ray_sets());
        field.write(&self.output)?;
        for run in &missing {
            announce!("warning: the run over {} rays is not complete: {run} missing", run.rays);
        }
        if self.json {
            let mut value = octobayes::estimate::facts(&field);
            value["summary"] = json!(field.summary());
            value["missing_shards"] = json!(missing);
            return say!("{value}");
        }
        say!("record\n{}\nfield\n  {}", report::record(&field), report::summary(&field.summary()))
    }
}
