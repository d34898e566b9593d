//! `plan`: what a run will need, and how a cluster runs it.

mod forecast;
mod slurm;
mod words;

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde_json::json;

use self::forecast::Forecast;
use self::slurm::Script;
use self::words::Words;
use super::MOST_THREADS;
use super::files::CommandFiles;
use super::options::check_field_name;
use super::progress::Bars;
use super::report;
use super::uncertainty::{self, Inputs, Rays};
use crate::dataset::Part;
use crate::rays::Shard;
use crate::{Error, Result};

/// Say what `uncertainty` will need, or write the script that runs it on a cluster
///
/// Takes the arguments of `uncertainty`. A pilot of a few thousand rays tells how much memory, time and disk the run
/// takes. Nothing is written.
///
/// With --jobs and --slurm, writes a script that splits the run into shards: an array job, and a job that merges the
/// parts when all are there. Look at it, then submit it with `bash run.sbatch`; options behind that, such as
/// --partition=NAME, go to sbatch. A shard that is killed or runs out of time queues again and goes on from its
/// checkpoint. Submitted again, the script computes only parts that are missing. The parts are in a folder beside the
/// merged field, whose name stands for the run: other settings have another folder.
#[derive(clap::Args)]
#[group(id = "plan")]
#[command(
    after_help = "Examples (a model of `train` knows its cameras):\n  \
        octobayes plan lego.safetensors --level 9 --rays 16M\n  \
        octobayes plan lego.safetensors --level 9 --rays 16M --jobs 64 --slurm -o run.sbatch",
    mut_arg("output", |arg| arg.required(false).default_value(UNNAMED).hide_default_value(true).value_name("FILE")
        .help("With --slurm, where to write the script; else not used").long_help(None))
)]
pub struct Args {
    #[command(flatten)]
    run: Words<uncertainty::Args>,

    /// Number of shards, each a job of its own
    #[arg(long, value_name = "N", requires = "slurm", value_parser = clap::value_parser!(u64).range(2..=1 << 20))]
    jobs: Option<u64>,

    /// Write a script for Slurm
    #[arg(long, requires_all = ["jobs", "output"])]
    slurm: bool,

    /// Where the merged field goes [default: beside the script, under its name]
    #[arg(long, value_name = "FIELD.oct", requires = "slurm")]
    field: Option<PathBuf>,

    /// CPUs of each job, which runs as many threads
    #[arg(long, value_name = "N", requires = "slurm", default_value_t = 2,
          value_parser = clap::value_parser!(u16).range(1..=MOST_THREADS))]
    cpus: u16,
}

/// The output of a plan that has none.
const UNNAMED: &str = "field.oct";

impl Args {
    /// Runs the verb.
    pub fn run(mut self, bars: &Bars) -> Result<()> {
        self.check_options()?;
        self.run.options.cameras.find(Part::Training);
        self.check_files()?;
        let options = &self.run.options;
        let inputs = options.read()?;
        let start = Instant::now();
        let (estimation, grid) = options.estimation(&inputs, bars)?;
        let run = estimation.prepare()?;
        options.check_sight(&run.sight()?)?;
        options.check_images(&run, &inputs.views.frames, bars)?;
        run.check_positions()?.warning().iter().for_each(|text| announce!("warning: {text}"));
        run.check_step()?.iter().for_each(report::step);
        let (whole, plan) = Forecast::of(&run, start)?;
        run.time_with_own_derivatives()?.iter().for_each(|&ratio| report::own_derivatives(ratio));
        drop(run);
        let script = self.jobs.map(|shards| self.script(shards, &inputs, whole, bars)).transpose()?;
        if let Some(script) = &script {
            script.write(&options.grid.output)?;
        }

        let threads = rayon::current_num_threads();
        if options.grid.json {
            let mut value = whole.json();
            value["level"] = json!(grid.level);
            value["threads"] = json!(threads);
            value["rays_per_vertex"] = json!(plan.rays_per_vertex);
            value["slurm"] = json!(script.as_ref().map(Script::json));
            return say!("{value}");
        }
        let Forecast { rays, vertices, .. } = whole;
        say!("run     level {}, {rays} rays, about {vertices:.2e} vertices", grid.level)?;
        report::given_up(&plan).map_or(Ok(()), |given_up| say!("{given_up}"))?;
        say!("        {} on {threads} threads, a file of {}", whole.cost(), report::bytes(whole.file as usize))?;
        script.map_or(Ok(()), |script| {
            say!("{script}")?;
            say!("script  {}; submit it with `bash`", options.grid.output.display())
        })
    }

    /// Refuses options that have no meaning here.
    fn check_options(&self) -> Result<()> {
        let options = &self.run.options;
        if options.rays == Rays::Auto {
            return Err(Error::setting("--rays", "a number of rays to plan for", "auto"));
        }
        let meaningless = [
            ("--audit", options.audit, "it looks at one run"),
            ("--checkpoint", options.checkpoint.is_some(), "every shard has a checkpoint of its own"),
            ("--dump-samples", options.dump_samples.is_some(), "shards write no samples"),
            ("--error-bars", options.error_bars.is_some(), "shards of one seed are not independent"),
            ("--correlations", options.correlations.is_some(), "draws need all rays in one place"),
            ("--coarser-levels", options.coarser_levels.is_some(), "a merge would lose them"),
            (
                "--images",
                options.images.is_some(),
                "every job would compare them all; merge the whole with one more run that has them",
            ),
            ("--shard", options.shard.is_some(), "every job is a shard"),
        ];
        match meaningless.into_iter().find(|(_, is_given, _)| self.slurm && *is_given) {
            Some((flag, _, why)) => Err(Error::setting(flag, format!("none beside --jobs: {why}"), "one")),
            None => Ok(()),
        }
    }

    /// Checks names and folders of what is written.
    fn check_files(&self) -> Result<()> {
        let grid = &self.run.options.grid;
        if !self.slurm {
            return grid.check_output();
        }
        if grid.output.extension().is_some_and(|extension| extension == "oct") {
            let expected = "a script's, such as `run.sbatch` (--field names the field)";
            return Err(Error::malformed(&grid.output, "file name", expected, "a field's"));
        }
        let field = self.field();
        check_field_name(&field)?;
        let files = CommandFiles::default().input("MODEL", &self.run.options.model.model);
        let files = files.cameras(self.run.options.cameras.cameras.as_deref());
        files.output("--output", &grid.output).output("--field", &field).check()
    }

    /// The merged field.
    fn field(&self) -> PathBuf {
        self.field.clone().unwrap_or_else(|| self.run.options.grid.output.with_extension("oct"))
    }

    /// The script for that many shards.
    fn script(&self, shards: u64, inputs: &Inputs, whole: Forecast, bars: &Bars) -> Result<Script> {
        let options = &self.run.options;
        let seen = (0..shards).filter(|&index| Shard::new(whole.rays, index, shards).own_rays() > 0).count() as u64;
        if seen < shards {
            let expected = format!("at most {seen}: {} rays are dealt out in batches of 512", whole.rays);
            return Err(Error::setting("--jobs", expected, shards.to_string()));
        }
        let start = Instant::now();
        let run = options.estimation(inputs, bars)?.0.shard(0, shards).prepare()?;
        let shard = Forecast::of(&run, start)?.0.on(self.cpus);
        let run = self.run.without(&["output", "json"]);
        let field = self.field();
        let keep_sums = options.grid.keep_sums.then_some("--keep-sums");
        Ok(Script {
            shards,
            cpus: self.cpus,
            parts: parts_folder(&field, &run, inputs, shards),
            run,
            merge: ["merge"].into_iter().chain(keep_sums).map(OsString::from).collect(),
            field,
            forecasts: [shard, slurm::merge(shards, &shard, whole)],
        })
    }
}

/// The folder for the parts of this run and of no other: its name stands for the settings and the files' contents.
fn parts_folder(field: &Path, run: &[OsString], inputs: &Inputs, shards: u64) -> PathBuf {
    let of_run = format!("{} {run:?} {:?} {shards}", env!("CARGO_PKG_VERSION"), inputs.files);
    let mut name = field.file_stem().unwrap_or_default().to_os_string();
    name.push(format!(".parts-{:08x}", crc32fast::hash(of_run.as_bytes())));
    field.with_file_name(name)
}
