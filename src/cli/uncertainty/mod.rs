//! `uncertainty`: from a model and its cameras to a field.

mod correlations;
mod images;
mod inputs;
mod sight;

pub use inputs::Inputs;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use self::correlations::Together;
use super::files::CommandFiles;
use super::options::{
    CameraOptions, DomainOptions, FrameOptions, GridOptions, MOST, ModelOptions, count, parse_interval, parse_positive,
    parse_share,
};
use super::progress::Bars;
use super::report::{self, Cost};
use crate::dataset::Part;
use crate::estimate::{Checkpoint, Estimation, GridSettings, Outcome, Planner, RaySettings, Run};
use crate::evaluate::TrainingImages;
use crate::io::memory::{available, resident};
use crate::rays::{Pixels, RunProgress, SamplesWriter};
use crate::render::GradientMethod;
use crate::uncertainty::UncertaintyField;
use crate::{Error, Result};

/// Compute the uncertainty of a trained field from its training cameras
///
/// Draws training rays, differentiates their pixels with respect to displacements of space, and sums the squares
/// at each deformation vertex. The cameras must be those that the model was trained on: a model of `train` stores
/// them, others need --cameras. `query`, `render`, `compare` and `evaluate` read the resulting field.
#[derive(clap::Args)]
#[command(after_help = "Examples (a model of `train` knows its cameras):\n  \
    octobayes uncertainty lego.safetensors -o lego.oct --rays 409600\n  \
    octobayes uncertainty lego.npz --cameras lego_train.json -o lego.oct --rays 409600")]
pub struct Args {
    #[command(flatten)]
    pub(super) model: ModelOptions,

    #[command(flatten)]
    pub(super) cameras: CameraOptions,

    #[command(flatten)]
    frames: FrameOptions,

    #[command(flatten)]
    pub(super) grid: GridOptions,

    /// Rays to draw, such as 400k or 1M (the paper uses 4096000), or `auto` for as many as bring the estimated mean
    /// error of log10 U within --tolerance
    ///
    /// `auto` doubles the rays, from 65536, until two halves of them agree. Most scenes need tens of millions for
    /// 0.05.
    #[arg(long, value_name = "N|auto", default_value = "4096000", value_parser = parse_rays)]
    pub(super) rays: Rays,

    /// Most rays that `--rays auto` draws
    #[arg(long, value_name = "N", default_value_t = 32_768_000, value_parser = count::<u64>(1..=MOST))]
    max_rays: u64,

    /// How pixels are chosen
    #[arg(long, value_enum, default_value = "sobol")]
    pixels: Pixels,

    /// Seed of pixels and sample positions
    #[arg(long, default_value_t = 0)]
    seed: u64,

    #[command(flatten)]
    domain: DomainOptions,

    /// Where the field's derivatives come from
    #[arg(long, value_enum, default_value_t)]
    gradient: GradientMethod,

    /// Finite-difference step h, in edges of the finest lattice [default: 1/512, or 1/2048 for forward differences,
    /// which reach 2h to one side; larger where f32 positions need it]
    ///
    /// A few hundred points show how noisy the field is. A warning says if noise or truncation at this step moves
    /// log10 U by more than --tolerance, and by more than three times as much as at another step.
    #[arg(long, value_name = "EDGES", value_parser = parse_positive)]
    step: Option<f64>,

    /// Do not differentiate samples whose weight, and whose density bound times |dC/dsigma|, are both below this;
    /// 0 skips none
    ///
    /// Rays end at this transmittance. The effect on log10 U is not part of --tolerance; --audit measures it.
    #[arg(
        long,
        value_name = "WEIGHT",
        default_value_t = RaySettings::default().cutoff,
        value_parser = parse_share,
    )]
    cutoff: f64,

    /// Measure on a few rays what skipped samples and the derivatives cost, and print the error budget
    #[arg(long)]
    pub(super) audit: bool,

    /// Also store how far log10 U is from its limit for ever more rays, by comparing this many independent groups
    /// of rays [without a number: 8]
    ///
    /// Each group draws pixels of its own. The field stores the root mean square error of log10 U (decades, by the
    /// delete-one-group jackknife; 2 is split half), and `query` returns it. Where fewer than two groups or
    /// four rays saw anything, the error is unknown and left empty. Summing takes GROUPS + 1 times the memory. With
    /// --checkpoint every group has its own file, FILE.0, FILE.1, … On several machines, give each another --seed,
    /// then run `merge --error-bars`.
    #[arg(
        long,
        value_name = "GROUPS",
        num_args = 0..=1,
        default_missing_value = "8",
        value_parser = clap::value_parser!(u16).range(2..=64),
        conflicts_with_all = ["dump_samples", "shard", "memory"],
    )]
    pub(super) error_bars: Option<u16>,

    /// Also draw displacements of all vertices together, this many times, so that deviations of depth know that
    /// neighbours move together [without a number: 32]
    ///
    /// For --level 6 and less and some 100k rays: every row of the Jacobian is kept, and solving takes minutes. At
    /// level 6 depth errors rank better, and their deviations hold more of them (experiments/depth.md); U stays as it
    /// is. Variances have a relative error of sqrt(2/DRAWS), a vertex takes 12 DRAWS bytes. Needs --scale data.
    #[arg(
        long,
        value_name = "DRAWS",
        num_args = 0..=1,
        default_missing_value = "32",
        value_parser = clap::value_parser!(u16).range(2..=1024),
        conflicts_with_all = ["error_bars", "dump_samples", "shard", "tile", "memory", "checkpoint"],
    )]
    pub(super) correlations: Option<u16>,

    /// Also compare the model with its training images in this folder, so that deviations of depth count what it
    /// cannot show
    ///
    /// The names of the training images start from DIR: it is the data set that the model was trained on, or the
    /// folder of the camera file. They have the size of the cameras' pictures. Their residuals are kept at the points
    /// of a lattice of at most 64 cells a side, and the deviation of depth becomes
    /// sqrt(Var + s^2 + (c residual)^2), where c is a 10th of the longest edge of the field's box, for all scenes (in
    /// contracted space, of the part that is not). U stays as it is. Of fields to merge, one that has them is enough.
    /// Needs --scale data.
    #[arg(long, value_name = "DIR", conflicts_with = "tile")]
    pub(super) images: Option<PathBuf>,

    /// Also sum the same rays on this many coarser levels, so that no level has to be chosen for ranking pixels
    /// [without a number: 2]
    ///
    /// `u-spread` and `u-spread-per-root-ray`, by which `evaluate` ranks, then read the mean of log10 U over all
    /// levels, which ranks depth errors about as well as the best of them does (experiments/depth.md). U and deviations
    /// of depth stay as they are. Fields that are merged lose their coarser levels.
    #[arg(
        long,
        value_name = "N",
        num_args = 0..=1,
        default_missing_value = "2",
        value_parser = clap::value_parser!(u8).range(1..=UncertaintyField::MOST_COARSER as i64),
        conflicts_with_all = ["error_bars", "shard", "tile", "memory", "checkpoint"],
    )]
    pub(super) coarser_levels: Option<u8>,

    /// Also write the ray samples with their Jacobians, in the format that `accumulate` reads
    ///
    /// Samples whose Jacobian is zero are left out, so that weights do not add up to the opacity.
    // Under a memory budget a run may start again, and would write its first rays twice.
    #[arg(long, value_name = "SAMPLES.npz", conflicts_with = "memory")]
    pub(super) dump_samples: Option<PathBuf>,

    /// Draw only part I of N of the rays (I from 0); `merge` joins the parts
    // Ray indices of a shard are those of the whole run, beyond the `rays_total` of a file of its own.
    #[arg(long, value_name = "I/N", value_parser = parse_shard, conflicts_with = "dump_samples")]
    pub(super) shard: Option<[u64; 2]>,

    /// Save the state of the run in this file, so that it survives Ctrl-C, kill -9 and power cuts
    #[arg(long, value_name = "FILE", conflicts_with = "dump_samples")]
    pub(super) checkpoint: Option<PathBuf>,

    /// Time between checkpoints, such as 90s, 5min or 1h30m
    #[arg(long, value_name = "TIME", default_value = "60s", value_parser = parse_interval)]
    checkpoint_every: Duration,

    /// Continue from the checkpoint, if there is one
    #[arg(long, requires = "checkpoint")]
    resume: bool,

    /// Use the cameras even if the model does not show the images that lie beside them
    ///
    /// Before the run, a few hundred pixels of at most 8 of these images are compared with the model: below 15 dB a
    /// warning names likely causes, such as cameras of another scene or another background; below 8 dB the cameras are
    /// refused.
    #[arg(long)]
    force: bool,
}

/// A file of this many bytes is announced before the run.
const LARGE_FILE: f64 = 5e7;

/// How many rays to draw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Rays {
    Count(u64),
    Auto,
}

/// A number of rays, or `auto`.
fn parse_rays(text: &str) -> std::result::Result<Rays, String> {
    if text == "auto" {
        return Ok(Rays::Auto);
    }
    count(1..=MOST)(text).map(Rays::Count).map_err(|expected| format!("{expected}; or `auto`"))
}

/// Most shards of a run.
const MOST_SHARDS: u64 = 1 << 20;

/// `I/N` with I < N.
fn parse_shard(text: &str) -> std::result::Result<[u64; 2], String> {
    let parts = text.split_once('/').and_then(|(i, n)| Some([i.parse().ok()?, n.parse().ok()?]));
    match parts {
        Some([i, n]) if i < n && n <= MOST_SHARDS => Ok([i, n]),
        _ => Err(format!("expected I/N with 0 <= I < N <= {MOST_SHARDS}, as 0/4")),
    }
}

fn warn_of_dropped(progress: &RunProgress) {
    if let Some(first) = progress.first_invalid {
        announce!("warning: {} rays dropped, the field is not finite; first at {first:?}", progress.dropped);
    }
}

impl Args {
    /// Runs the verb.
    pub fn run(mut self, bars: &Bars) -> Result<()> {
        self.cameras.find(Part::Training);
        self.command_files().check()?;
        let inputs = self.read()?;
        let start = Instant::now();
        let (estimation, grid) = self.estimation(&inputs, bars)?;
        let images = images::find(&self, &inputs, &grid)?;
        let files = self.command_files().images(&inputs.views);
        files.inputs("an image of --images", images.iter().flat_map(TrainingImages::paths)).check()?;
        self.grid.check_output()?;
        let mut dump = self.dump_samples.as_deref().map(SamplesWriter::create).transpose()?;

        let checkpoint = self.checkpoint();
        let estimation = checkpoint.iter().cloned().fold(estimation, Estimation::checkpoint);
        let mut together = Together::new(&self, &grid, inputs.domain())?;
        let estimation = match (&mut dump, &mut together) {
            (Some(dump), _) => estimation.tap(|batches| dump.add(batches)),
            (None, Some(together)) => estimation.tap(|batches| together.add(batches)),
            (None, None) => estimation,
        };

        let run = estimation.prepare()?;
        self.check_sight(&run.sight()?)?;
        run.check_positions()?.warning().iter().for_each(|text| announce!("warning: {text}"));
        let step = run.check_step()?;
        step.iter().for_each(report::step);
        if self.audit {
            report::audit(&run.audit()?, &grid);
        }
        self.forecast(&run, &grid)?;
        // Before the rays, so that a wrong image ends the work at once.
        let misfit = images.as_ref().map(|images| images::misfit(images, &self, &inputs, run.lattice(), bars));
        let misfit = misfit.transpose()?;
        self.check_images(&run, images.as_ref().map_or(&inputs.views.frames, TrainingImages::frames), bars)?;
        let rays = run.rays();
        let Outcome { field, progress, sums_bytes, plan, is_replanned, sampling_error, .. } =
            run.finish().inspect_err(|error| {
                if let (Error::Interrupted, Some(checkpoint)) = (error, &checkpoint) {
                    let (path, drawn) = (
                        self.checkpoint.iter().next().map_or("".into(), |p| p.display().to_string()),
                        checkpoint.rays(self.error_bars),
                    );
                    announce!("note: {path} holds {drawn} of {rays} rays; --resume goes on");
                }
            })?;
        if let Some(error) = &sampling_error {
            report::sampling_error(error, progress.rays, grid.tolerance);
        }
        if let Some(plan) = plan.filter(|_| is_replanned) {
            announce!("note: the rays took more or less memory than planned; the run started again with this plan:");
            report::plan(&plan, &grid);
        }
        warn_of_dropped(&progress);
        if let Some(dump) = dump {
            dump.finish(progress.rays)?;
        }
        let field = match together {
            Some(together) => together.join(field, progress.rays, bars)?,
            None => field,
        };
        let field = match misfit {
            Some(misfit) => field.with_misfit(misfit)?,
            None => field,
        };
        self.grid.write(&field, &Cost { elapsed: start.elapsed(), sums_bytes, step })?;
        checkpoint.map_or(Ok(()), |checkpoint| checkpoint.remove(self.error_bars))
    }

    /// Says on stderr what the run will need, if it is long, has limits or makes a large file. Refuses a run that needs
    /// more memory than there is.
    fn forecast(&self, run: &Run, grid: &GridSettings) -> Result<()> {
        if self.rays == Rays::Auto {
            return Ok(());
        }
        let plan = match run.forecast() {
            // Of the few rays of a pilot, too many may be at fault by chance; the run will tell.
            Err(Error::NonFinite { .. }) => return Ok(()),
            plan => plan?,
        };
        let left = available().zip(resident()).map(|(available, resident)| (available + resident) as f64);
        if let Some(left) = left.filter(|left| plan.peak() > *left) {
            let expected = format!(
                "{}, the peak of the process by a pilot of the run; --memory bounds it, a lower --level or \
                 --refine ray-count need less",
                report::bytes(plan.peak() as usize)
            );
            return Err(Error::setting("memory", expected, format!("{} free", report::bytes(left as usize))));
        }
        if grid.needs_plan() || run.rays() >= Planner::CHEAP * Planner::PILOT || plan.file > LARGE_FILE {
            report::plan(&plan, grid);
            run.time_with_own_derivatives()?.iter().for_each(|&ratio| report::own_derivatives(ratio));
        }
        Ok(())
    }

    /// What is read and written. A checkpoint is both by design.
    fn command_files(&self) -> CommandFiles {
        let files = CommandFiles::default()
            .input("MODEL", &self.model.model)
            .cameras(self.cameras.cameras.as_deref())
            .output("--output", &self.grid.output)
            .outputs("--dump-samples", &self.dump_samples);
        let states = self.checkpoint().map_or(Vec::new(), |checkpoint| checkpoint.files(self.error_bars));
        match self.error_bars {
            None => files.outputs("--checkpoint", states),
            Some(_) => (0..)
                .zip(states)
                .fold(files, |files, (g, state)| files.output(format!("--checkpoint, group {g}"), state)),
        }
    }

    /// Where and how often to save, if at all.
    fn checkpoint(&self) -> Option<Checkpoint> {
        self.checkpoint.as_ref().map(|path| Checkpoint::new(path).every(self.checkpoint_every).resume(self.resume))
    }
}
