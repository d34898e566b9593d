//! `merge`: joins the parts of a run.

use std::path::{Path, PathBuf};

use serde_json::json;

use super::files::CommandFiles;
use super::options::check_field_name;
use super::report;
use crate::rays::MissingShards;
use crate::uncertainty::{TiledField, UncertaintyField, finish_tiles, merge, merge_with_error_bars};
use crate::{Error, Result};

/// Join fields of the same box, level and record that were computed from different rays
///
/// The result is what one run over all the rays gives, up to the order of summation and the fields' tolerance. So
/// any scheduler can split a job over machines. Shards keep what this needs; whole runs do with `--keep-sums`. If
/// shards of a run are missing, a warning names them. Tiles (`uncertainty --tile`) become one field of all of space;
/// all of them are needed. One part at a time is in memory. Error bars of the parts are dropped.
#[derive(clap::Args)]
#[command(
    after_help = "Example: for i in 0 1 2 3; do octobayes uncertainty model.npz --cameras transforms.json --shard $i/4 \
    -o part$i.oct; done; octobayes merge part?.oct -o field.oct"
)]
pub struct Args {
    /// Fields to join
    #[arg(value_name = "FIELD.oct", required = true, num_args = 2..)]
    fields: Vec<PathBuf>,

    /// Where to write the joined field; for tiles also a folder, in which they stay apart and can be queried although
    /// they do not fit into memory together
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

    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

impl Args {
    /// Runs the verb.
    pub fn run(self) -> Result<()> {
        let files = CommandFiles::default().inputs("FIELD", &self.fields);
        let extension = self.output.extension();
        if self.output.is_dir() && extension.is_none_or(|extension| extension != "oct") {
            files.check()?;
            return self.finish_tiles();
        }
        // A name without an extension means a folder, if there are tiles to put into it.
        if extension.is_none() && !self.output.exists() && TiledField::is_tile(&self.fields[0])? {
            files.check()?;
            std::fs::create_dir_all(&self.output).map_err(Error::io(&self.output, "cannot create the folder"))?;
            // Goes if nothing was put into it.
            return self.finish_tiles().inspect_err(|_| std::fs::remove_dir(&self.output).unwrap_or_default());
        }
        files.output("--output", &self.output).check()?;
        check_field_name(&self.output)?;
        let field = if self.error_bars { merge_with_error_bars(&self.fields) } else { merge(&self.fields) }?;
        let mut parts = self.fields.iter().map(|path| UncertaintyField::has_error_bars(path));
        if !self.error_bars && parts.any(|has| matches!(has, Ok(true))) {
            announce!(
                "note: the fields' own error bars are not those of the whole, which has none; \
                 --error-bars compares the fields"
            );
        }
        let field = if self.keep_sums { field } else { field.for_queries() };
        let missing = MissingShards::beside(field.ray_sets());
        field.write(&self.output)?;
        for run in &missing {
            announce!("warning: the run over {} rays is not complete: {run} missing", run.rays);
        }
        if self.json {
            let mut value = crate::estimate::facts(&field);
            value["summary"] = json!(field.summary());
            value["missing_shards"] = json!(missing);
            return say!("{value}");
        }
        say!("record\n{}\nfield\n  {}", report::record(&field), report::summary(&field.summary()))
    }

    /// Leaves the tiles apart.
    fn finish_tiles(&self) -> Result<()> {
        if self.keep_sums || self.error_bars {
            let expected = "a file `.oct`, for --keep-sums and --error-bars";
            return Err(Error::malformed(&self.output, "file name", expected, "a folder"));
        }
        // Finished tiles beside unfinished ones, under the same names, would replace them.
        let folder = |path: &Path| path.canonicalize().ok();
        let parent = |part: &Path| part.canonicalize().ok()?.parent().map(Path::to_path_buf);
        if let Some(part) = self.fields.iter().find(|part| parent(part) == folder(&self.output)) {
            let found = format!("the folder of {}", part.display());
            return Err(Error::malformed(&self.output, "folder", "another than that of the parts", found));
        }
        finish_tiles(&self.fields, &self.output)?;
        let tiles = TiledField::open(&self.output, 0)?;
        if self.json {
            return say!("{}", json!({ "tiles": tiles.tiles() }));
        }
        say!("{} tiles in {}, for `query`, `render`, `export` and `compare`", tiles.tiles(), self.output.display())
    }
}
