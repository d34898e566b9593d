//! `uncertainty`: from a model and its cameras to a field.

mod samples;

use std::path::PathBuf;

use super::files::CommandFiles;
use super::given::Given;
use super::options::{
    CameraOptions, DomainOptions, FrameOptions, GridOptions, ModelArgument, RayCount, TrainingOptions,
    check_field_name, choice, count, heading, parse_bytes, parse_positive, parse_share,
};
use super::progress::Bars;
use super::report;
use super::streams::tell;
use octobayes::Result;
use octobayes::choices::Choice;
use octobayes::estimate::{Checkpoint, Feature, Goal, GridSettings, RaySettings};
use octobayes::io::place::folder_of;
use octobayes::posterior::Criterion;
use octobayes::rays::Pixels;
use octobayes::render::{GradientMethod, Occupancy};
use octobayes_data::Part;
use octobayes_data::SamplesReader;
use octobayes_session::{Needs, OpenedModel, Session, given_up};

/// Compute the uncertainty of a trained field from its training cameras
///
/// Draws training rays, differentiates their pixels with respect to displacements of space, and sums the squares
/// at each deformation vertex. The cameras must be those that the model was trained on: a model of `train` stores
/// them, others need --cameras. `query`, `render`, `compare` and `evaluate` read the resulting field.
///
/// An .npz of ray samples whose Jacobians were computed elsewhere stands in place of MODEL: it needs --box or
/// --contract, and no cameras. It holds `positions` (f32, N x 3, scene units); `jacobian` (f32, N x 3 x 3, dC_c/dx_k,
/// rows colour, columns axis); `ray` (u64, N, the index of each sample's ray, never decreasing); and `rays_total`, the
/// number of rays drawn, including those that hit nothing. `weight` (f32, N, the sample's share of the pixel) is
/// optional, and `training_pixels` is for --scale data. The file may be larger than memory.
#[derive(clap::Args)]
#[command(after_help = "Examples (a model of `train` stores its cameras):\n  \
    octobayes uncertainty lego.safetensors -o lego.oct --rays 409600\n  \
    octobayes uncertainty lego.npz --cameras lego_train.json -o lego.oct --rays 409600\n  \
    octobayes uncertainty scene.ply --cameras cameras.json -o scene.oct")]
pub struct Args {
    #[command(flatten)]
    model: ModelArgument,

    #[command(flatten)]
    cameras: CameraOptions,

    #[command(flatten)]
    frames: FrameOptions,

    #[command(flatten)]
    training: TrainingOptions,

    #[command(flatten)]
    domain: DomainOptions,

    /// Memory limit of the whole process, e.g. 2GiB. Sums that do not fit go to disk; the field stays the same
    #[arg(long, value_name = "SIZE", value_parser = parse_bytes, help_heading = heading::GRID)]
    memory: Option<u64>,

    /// Folder for the sums that --memory has no room for [default: that of the output, or of the checkpoint]
    ///
    /// They take 36 bytes for every vertex that rays touched, or 60 where all of S is summed, once per file whose rays
    /// touched it; --dry-run foresees how much. The files have no names, so that none is left behind however the run
    /// ends. With --checkpoint they belong to it, and lie beside it.
    #[arg(
        long,
        value_name = "DIR",
        requires = "memory",
        conflicts_with = "checkpoint",
        help_heading = heading::GRID,
        hide_short_help = true,
    )]
    scratch: Option<PathBuf>,

    /// Where to refine the octree; several criteria are separated by commas
    #[arg(
        long,
        value_parser = choice::<Criterion>(),
        value_delimiter = ',',
        default_value = Criterion::Sensitivity.name(),
        help_heading = heading::GRID,
        hide_short_help = true,
    )]
    refine: Vec<Criterion>,

    #[command(flatten)]
    grid: GridOptions,

    /// Number of training rays, such as 400k or 1M, or `all` for every training pixel once; 4096000 is the paper's.
    /// Time is proportional to it
    #[arg(
        long,
        value_name = "N",
        default_value_t = RayCount::Drawn(RaySettings::default().rays),
        value_parser = RayCount::parse,
        help_heading = heading::RAYS,
    )]
    rays: RayCount,

    /// Stop once the estimated mean sampling error of log10 U is below this; never draw more than --rays
    ///
    /// Doubles the rays, from 65536, until two halves of them agree. Most scenes need tens of millions for 0.05.
    #[arg(
        long,
        value_name = "DECADES",
        value_parser = parse_positive,
        conflicts_with_all = ["shard", "error_bars", "dump_samples", "checkpoint", "dry_run"],
        help_heading = heading::RAYS,
    )]
    target_error: Option<f64>,

    /// How the model is differentiated: by differences of its outputs, or faster by its own derivatives, if it has
    /// them (analytic)
    #[arg(
        long,
        value_parser = choice::<GradientMethod>(),
        default_value = GradientMethod::default().name(),
        help_heading = heading::RAYS,
    )]
    gradient: GradientMethod,

    /// Seed of pixels and sample positions
    #[arg(long, default_value_t = RaySettings::default().seed, help_heading = heading::RAYS, hide_short_help = true)]
    seed: u64,

    /// Draw only part I of N of the rays (I from 0), one part a job on a cluster; `merge` joins the parts
    // Ray indices of a shard are those of the whole run, beyond the `rays_total` of a file of its own.
    #[arg(
        long,
        value_name = "I/N",
        value_parser = parse_shard,
        conflicts_with = "dump_samples",
        help_heading = heading::RAYS,
    )]
    shard: Option<[u64; 2]>,

    /// Also store the sampling error of log10 U, from this many independent groups of rays [without a number: 8]
    ///
    /// Each group draws pixels of its own. The field stores the root mean square error of log10 U (decades, by the
    /// delete-one-group jackknife; 2 is split half), and `query` returns it. Where fewer than two groups or
    /// four rays saw anything, the error is unknown and left empty. Summing takes GROUPS + 1 times the memory; with
    /// --memory, the sums of each group go to disk before the next is drawn. With --checkpoint every group has its own
    /// file, FILE.0, FILE.1, … On several machines, give each another --seed, then run `merge --error-bars`.
    #[arg(
        long,
        value_name = "GROUPS",
        num_args = 0..=1,
        default_missing_value = "8",
        value_parser = count::<u16>(2..=64),
        conflicts_with_all = ["dump_samples", "shard"],
        help_heading = heading::STATISTICS,
    )]
    error_bars: Option<u16>,

    /// Measure on a few rays what skipped samples and the derivatives cost, for the table of errors
    #[arg(long, help_heading = heading::STATISTICS, hide_short_help = true)]
    audit: bool,

    /// Where to write the field
    #[arg(short, long, value_name = "FIELD.oct", required_unless_present = "dry_run", help_heading = heading::OUTPUT)]
    output: Option<PathBuf>,

    /// Foresee time, memory and disk space by the first sixteenth of the rays, and write nothing
    #[arg(long, conflicts_with = "dump_samples", help_heading = heading::OUTPUT)]
    dry_run: bool,

    /// Save the state of the run in this file every minute and when it is stopped; the same command then goes on from
    /// there
    ///
    /// The run survives Ctrl-C, kill -9 and power cuts, and ends with the same bytes. The file is removed at the end.
    /// With --memory, the sums that left memory lie beside it: FILE.run0, FILE.run1, …; with --error-bars, FILE.0.run0
    #[arg(long, value_name = "FILE", conflicts_with = "dump_samples", help_heading = heading::OUTPUT)]
    checkpoint: Option<PathBuf>,

    /// Start over and discard the checkpoint, if there is one
    #[arg(long, requires = "checkpoint", help_heading = heading::OUTPUT, hide_short_help = true)]
    restart: bool,

    /// Also write the ray samples with their Jacobians, which this command reads in place of a model
    ///
    /// Samples whose Jacobian is zero are left out, so that weights do not add up to the opacity.
    #[arg(long, value_name = "SAMPLES.npz", help_heading = heading::OUTPUT, hide_short_help = true)]
    dump_samples: Option<PathBuf>,

    /// Print one JSON object
    #[arg(long, help_heading = heading::OUTPUT)]
    json: bool,

    /// Cells per axis of the occupancy grid that lets rays skip empty space
    #[arg(
        long,
        value_name = "N",
        default_value_t = Occupancy::DEFAULT_RESOLUTION as u16,
        value_parser = count::<u16>(4..=512),
        help_heading = heading::ADVANCED,
        hide_short_help = true,
    )]
    occupancy: u16,

    /// Do not differentiate samples whose weight, and whose density bound times |dC/dsigma|, are both below this;
    /// 0 skips none
    ///
    /// Rays end at this transmittance. The effect on log10 U is not part of --tolerance; --audit measures it.
    #[arg(
        long,
        value_name = "WEIGHT",
        default_value_t = RaySettings::default().cutoff,
        value_parser = parse_share,
        help_heading = heading::ADVANCED,
        hide_short_help = true,
    )]
    cutoff: f64,
}

/// Options that only rays that are marched have.
const OF_MARCH: [&str; 4] = ["--gradient", "--cutoff", "--occupancy", "--audit"];
/// Most shards of a run.
const MAX_SHARDS: u64 = 1 << 20;

/// `I/N` with I < N.
fn parse_shard(text: &str) -> std::result::Result<[u64; 2], String> {
    let parts = text.split_once('/').and_then(|(i, n)| Some([i.parse().ok()?, n.parse().ok()?]));
    match parts {
        Some([i, n]) if i < n && n <= MAX_SHARDS => Ok([i, n]),
        _ => Err(format!("expected I/N with 0 <= I < N <= {MAX_SHARDS}, as 0/4")),
    }
}

impl Args {
    /// Runs the verb.
    pub fn run(mut self, given: &Given, bars: &Bars) -> Result<()> {
        if SamplesReader::is_samples(self.model.model.as_ref()) {
            return self.of_samples(given, bars);
        }
        self.cameras.find(Part::Training);
        self.command_files().check()?;
        let model =
            OpenedModel::for_cameras(&self.model.model, self.cameras.cameras.is_some(), self.training.splat_mode)?;
        if let Some(expected) = model.model.lacks(Feature::March) {
            // A model that is not marched has its own derivatives, which `auto` chooses.
            let marched = &OF_MARCH[usize::from(self.gradient == GradientMethod::Auto)..];
            given.refuse(marched, expected, model.model.kind())?;
        }
        let cameras = self.cameras.training(&self.frames, Some(&*model.model), &self.model.model)?;
        self.command_files().images(&cameras.views).check()?;
        self.output.as_deref().map_or(Ok(()), check_field_name)?;

        let session = Session::new(cameras.views, format!("{} seen by {}", model.source, cameras.source))?
            .checksum(Some(model.checksum))
            .domain(self.domain.chosen()?)
            .rays(self.ray_settings())
            .background(self.training.background)
            .model_file(Some(PathBuf::from(&model.name)))
            .grid(self.grid_settings())
            .choices(self.grid.choices())
            .goal(Goal::of(self.target_error, self.shard, self.error_bars))
            .checkpoint(self.checkpoint())
            .scratch(self.scratch_folder())
            .dump(self.dump_samples.clone())
            .audit(self.audit)
            .force(self.training.force)
            .has_chosen_coordinates(model.coordinates.is_some() && self.cameras.cameras.is_some())
            .has_given_fov(self.cameras.fov.is_some());
        let prepared = session.prepare(&*model.model, bars, &mut tell)?;
        let Some(output) = self.output.as_ref().filter(|_| !self.dry_run) else {
            return self.print(&prepared.needs()?);
        };
        let finished = prepared.finish(&mut tell)?;
        finished.save(output)?;
        report::finished(&finished, self.json)
    }

    fn ray_settings(&self) -> RaySettings {
        let (rays, pixels) = match self.rays {
            RayCount::Drawn(rays) => (rays, Pixels::default()),
            RayCount::All => (RaySettings::default().rays, Pixels::Every),
        };
        let settings = RaySettings::default().rays(rays).pixels(pixels).seed(self.seed).gradient(self.gradient);
        settings.cutoff(self.cutoff).occupancy(usize::from(self.occupancy))
    }

    fn grid_settings(&self) -> GridSettings {
        let criteria = self.refine.iter().copied().collect();
        self.grid.settings().memory(self.memory).criteria(criteria)
    }

    /// Prints what the run will need.
    fn print(&self, needs: &Needs) -> Result<()> {
        if self.json {
            return say!("{}", serde_json::json!(needs));
        }
        let Needs { rays, level, threads, plan, errors, .. } = needs;
        say!("run     level {level}, {rays} rays, at most {:.2e} vertices", plan.vertices)?;
        given_up(plan).map_or(Ok(()), |text| say!("        {text}"))?;
        let [peak, file] = [plan.peak(), plan.file].map(|size| report::bytes(size as usize));
        say!("        {peak} of memory, {:.0} s on {threads} threads, a file of {file}", needs.seconds.ceil())?;
        if plan.disk > 0.0 {
            say!("        {} of sums on disk during the run", report::bytes(plan.disk as usize))?;
        }
        say!("{}", report::errors(errors))
    }

    /// Where sums go that do not fit into memory: beside the result, unless a folder was chosen.
    fn scratch_folder(&self) -> Option<PathBuf> {
        let beside = || Some(folder_of(self.output.as_deref()?).to_path_buf());
        self.scratch.clone().or_else(beside)
    }

    /// What is read and written. A checkpoint is both by design.
    fn command_files(&self) -> CommandFiles {
        let files = CommandFiles::default()
            .input("MODEL", &self.model.model)
            .cameras(self.cameras.cameras.as_deref())
            .outputs("--output", &self.output)
            .outputs("--dump-samples", &self.dump_samples);
        let states = self.checkpoint().map_or(Vec::new(), |checkpoint| checkpoint.files(self.error_bars));
        match self.error_bars {
            None => files.outputs("--checkpoint", states),
            Some(_) => (0..)
                .zip(states)
                .fold(files, |files, (g, state)| files.output(format!("--checkpoint, group {g}"), state)),
        }
    }

    /// Where to save, if at all.
    fn checkpoint(&self) -> Option<Checkpoint> {
        let path = self.checkpoint.as_ref().filter(|_| !self.dry_run);
        path.map(|path| Checkpoint::new(path).restart(self.restart))
    }
}
