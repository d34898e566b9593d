//! `uncertainty`: from a model and its cameras to a field.

mod auto;
mod groups;
mod sight;

use std::path::{Path, PathBuf};
use std::time::Instant;

use self::groups::Groups;
use super::checkpoint::Checkpoint;
use super::files::CommandFiles;
use super::options::{
    CameraOptions, DomainOptions, FrameOptions, GridOptions, ModelOptions, parse_non_negative, parse_positive,
};
use super::progress::Bars;
use super::report::{self, Cost};
use crate::estimate::{Audit, FieldBuilder, GridSettings, PlannedRun, Planner, Provenance, RaySettings, StepCheck};
use crate::geometry::{Camera, Lattice};
use crate::posterior::checkpoint;
use crate::rays::{Pixels, RayStream, RunProgress, SamplesWriter, Shard};
use crate::render::GradientMethod;
use crate::{Error, Result};

/// Compute the uncertainty of a trained field from its training cameras
///
/// Draws random training rays, differentiates their pixels with respect to displacements of space, and sums what they say about
/// each deformation vertex. The cameras must be those that the model was trained on: a model of `train` has stored
/// them, others need --cameras. The result is a field that `query`, `render`, `compare` and `evaluate` read.
#[derive(clap::Args)]
#[command(after_help = "Examples (a model of `train` knows its cameras):\n  \
    octobayes uncertainty lego.safetensors -o lego.oct --rays 409600\n  \
    octobayes uncertainty lego.npz --cameras lego_train.json -o lego.oct --rays 409600")]
pub struct Args {
    #[command(flatten)]
    model: ModelOptions,

    #[command(flatten)]
    cameras: CameraOptions,

    #[command(flatten)]
    frames: FrameOptions,

    #[command(flatten)]
    grid: GridOptions,

    /// Rays drawn (the paper uses 4096000), or `auto`: as many as bring the estimated mean error of log10 U within --tolerance
    ///
    /// `auto` doubles the rays, from 65536, until two halves of them agree. Most scenes take tens of millions for 0.05.
    #[arg(long, value_name = "N|auto", default_value = "4096000", value_parser = parse_rays)]
    rays: Rays,

    /// Most rays that `--rays auto` draws
    #[arg(long, value_name = "N", default_value_t = 32_768_000, value_parser = clap::value_parser!(u64).range(1..))]
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

    /// Finite-difference step to both sides, in edges of the finest lattice [default: 1/512, more where f32 positions need it]
    ///
    /// A few hundred points tell how noisy the field is; a step at which noise or truncation moves log10 U by more than --tolerance, and more than
    /// three times as much as at another step, is warned of.
    #[arg(long, value_name = "EDGES", value_parser = parse_positive)]
    step: Option<f64>,

    /// Do not differentiate samples whose weight, and whose density bound times |dC/dsigma|, are both below this; 0 leaves out nothing
    ///
    /// Rays end at this transmittance. What it does to log10 U is not part of --tolerance; --audit measures it.
    #[arg(long, value_name = "WEIGHT", default_value_t = RaySettings::default().cutoff, value_parser = parse_non_negative)]
    cutoff: f64,

    /// Measure on a few rays what leaving samples out and the derivatives cost, and print the error budget
    #[arg(long)]
    audit: bool,

    /// Also store how far log10 U is from its limit of ever more rays: compares this many independent groups of rays [without a number: 8]
    ///
    /// The rays are drawn in groups with pixels of their own; the root mean square error of log10 U (decades, by the delete-one-group
    /// jackknife; 2 is split half) goes into the field, and `query` answers with it. Where fewer than two groups saw anything it is not known,
    /// and left empty. While summing this takes GROUPS + 1 times the memory. With --checkpoint every group has its own file, FILE.0, FILE.1, …
    /// On several machines: other --seed for each, then `merge --error-bars`.
    #[arg(long, value_name = "GROUPS", num_args = 0..=1, default_missing_value = "8", value_parser = clap::value_parser!(u16).range(2..=64),
          conflicts_with_all = ["dump_samples", "shard", "memory", "coarsen"])]
    error_bars: Option<u16>,

    /// Also write the ray samples with their Jacobians, as `accumulate` reads them
    // A run that starts again would dump its first rays twice.
    #[arg(long, value_name = "SAMPLES.npz", conflicts_with = "memory")]
    dump_samples: Option<PathBuf>,

    /// Compute only part I of N of the rays (I from 0); `merge` joins the parts
    // Ray indices of a part are those of the whole run, beyond the `rays_total` of its own dump.
    #[arg(long, value_name = "I/N", value_parser = parse_shard, conflicts_with = "dump_samples")]
    shard: Option<[u64; 2]>,

    /// Keep the state of the run in this file, so that it survives Ctrl-C, kill -9 and power cuts
    #[arg(long, value_name = "FILE", conflicts_with = "dump_samples")]
    checkpoint: Option<PathBuf>,

    /// Seconds between two checkpoints
    #[arg(long, value_name = "SECONDS", default_value_t = 60.0, value_parser = parse_non_negative)]
    checkpoint_every: f64,

    /// Go on from the checkpoint, if there is one
    #[arg(long, requires = "checkpoint")]
    resume: bool,
}

/// How many rays.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Rays {
    Count(u64),
    Auto,
}

/// A number of rays, or `auto`.
fn parse_rays(text: &str) -> std::result::Result<Rays, String> {
    match text.parse() {
        _ if text == "auto" => Ok(Rays::Auto),
        Ok(rays) if rays > 0 => Ok(Rays::Count(rays)),
        _ => Err("expected a whole number above 0, or `auto`".into()),
    }
}

/// `I/N` with I < N.
fn parse_shard(text: &str) -> std::result::Result<[u64; 2], String> {
    let parts = text.split_once('/').and_then(|(i, n)| Some([i.parse().ok()?, n.parse().ok()?]));
    match parts {
        Some([i, n]) if i < n => Ok([i, n]),
        _ => Err("expected I/N with 0 <= I < N, as 0/4".into()),
    }
}

/// A file's name and checksum; a built-in scene has its name alone.
fn identity(file: &str) -> Result<String> {
    if file.starts_with("scene:") {
        return Ok(file.into());
    }
    let bytes = std::fs::read(file).map_err(Error::io(Path::new(file), "cannot read"))?;
    Ok(format!("{file} ({:08x})", crc32fast::hash(&bytes)))
}

fn warn_of_dropped(tally: &RunProgress) {
    if let Some(first) = tally.first_invalid {
        eprintln!("warning: {} rays dropped, the field is not finite; first at {first:?}", tally.dropped);
    }
}

impl Args {
    /// Runs the verb.
    pub fn run(self, bars: &Bars) -> Result<()> {
        self.command_files().check()?;
        let files = self.files();
        let field = self.model.open()?;
        let views = self.cameras.training(&self.frames, &*field, &self.model.model)?;
        self.command_files().images(&views).check()?;
        // The readers know better what is wrong with a file than that it has no checksum.
        let files = files?;
        // The result names these files by their checksums: it must be true.
        let now = self.files()?;
        if let Some((before, now)) = files.iter().zip(&now).find(|(before, now)| before != now) {
            return Err(Error::setting("an input file", format!("{before}, as before it was read"), now));
        }
        let domain = self.domain.domain(Some(field.natural_domain()))?;
        let checksum = crate::open::checksum(&self.model.model, self.model.coordinates)?;
        // Of contents, not of paths: the run is the same if files have moved.
        let identity = format!("model {checksum:08x}");
        let grid = self.grid.settings(&domain)?;
        let mut builder = FieldBuilder::new(grid, domain)?;
        self.grid.check_coarsening()?;
        let mut dump = self.dump_samples.as_deref().map(SamplesWriter::create).transpose()?;

        let start = Instant::now();
        let settings = self.model.ray_settings(RaySettings {
            rays: self.most_rays(),
            pixels: self.pixels,
            seed: self.seed,
            gradient: self.gradient,
            step: self.step,
            cutoff: self.cutoff,
            ..RaySettings::default()
        });
        let cameras = views.cameras();
        let lattice = *builder.lattice();
        let share = self.share()?;
        // A state that must not be overwritten is found before any work.
        (0..self.error_bars.unwrap_or(1))
            .try_for_each(|g| self.checkpoint(self.error_bars.map(|_| g), self.resume).map(drop))?;
        let stream = settings.stream(&*field, &cameras, &grid, &lattice, bars)?;
        self.check_sight(&stream, &domain, bars)?;
        let source = self.source(&files, &cameras);
        let step = StepCheck::of(&stream, &lattice, grid.tolerance, bars)?;
        step.iter().for_each(report::step);
        if self.audit {
            let samples = if stream.negligible > 0.0 { grid.samples_tolerance() } else { 0.0 };
            report::audit(&Audit::of(&*field, &cameras, &settings, &grid, domain, bars)?, &grid, samples);
        }
        if self.rays == Rays::Auto {
            let (field, posterior_bytes) = self.run_auto(&stream, grid, domain, source, bars)?;
            return self
                .grid
                .write(field.of_model(checksum), &Cost { elapsed: start.elapsed(), posterior_bytes, step });
        }
        let planner = self.planner(grid, &settings, &stream, share, lattice, bars)?;
        let mut plan = planner.as_ref().map(|planner| planner.plan(&lattice)).transpose()?;
        if let Some(groups) = self.error_bars {
            if let Some(plan) = &mut plan {
                plan.bytes *= f64::from(groups) + 1.0;
                report::plan(plan, &grid);
            }
            let (plan, identity) = (plan.as_ref(), identity.as_str());
            let run = Groups { count: groups, settings, stream: &stream, grid, domain, plan, identity };
            let (field, posterior_bytes) = self.run_groups(&run, &source, bars)?;
            self.grid.write(field.of_model(checksum), &Cost { elapsed: start.elapsed(), posterior_bytes, step })?;
            return (0..groups).try_for_each(|g| self.checkpoint(Some(g), true)?.map_or(Ok(()), |file| file.remove()));
        }
        let mut checkpoint = self.checkpoint(None, self.resume)?;
        if let (Some(planner), Some(checkpoint)) = (&planner, checkpoint.as_ref().filter(|c| c.path.exists())) {
            // The budget may have made the interrupted run give up more than was planned.
            let rays_per_vertex = checkpoint::rays_per_vertex(&checkpoint.path)?;
            while let Some(tighter) = plan.as_ref().filter(|p| p.rays_per_vertex < rays_per_vertex) {
                plan = planner.tighter(&lattice, tighter);
            }
        }
        if let Some(plan) = &plan {
            report::plan(plan, &grid);
            if grid.needs_plan() {
                builder.limit(plan);
            }
        }
        builder.want_density(&stream)?;
        let key = |builder: &FieldBuilder| settings.run_key(identity.clone(), share, &stream, &grid, builder);
        let mut so_far = match &checkpoint {
            Some(checkpoint) => {
                let key = key(&builder);
                checkpoint.restore(&mut builder, &key)?
            }
            None => RunProgress::default(),
        };
        let planned = plan.as_ref().map(|plan| plan.rays_per_vertex);
        let run = PlannedRun { stream: &stream, share, planner: planner.as_ref(), memory: grid.memory };
        let result = run.run(&mut builder, so_far, plan, bars, |builder, batches, tally| {
            so_far = *tally;
            if let Some(checkpoint) = checkpoint.as_mut().filter(|c| c.is_due()) {
                checkpoint.save(builder, &key(builder), so_far)?;
            }
            dump.as_mut().map_or(Ok(()), |dump| dump.add(batches))
        });
        if let (Err(Error::Interrupted), Some(checkpoint)) = (&result, &mut checkpoint) {
            checkpoint.save_interrupted(&builder, &key(&builder), so_far, share)?;
        }
        let (tally, plan) = result?;
        if let Some(plan) = plan.filter(|plan| Some(plan.rays_per_vertex) != planned) {
            eprintln!("note: memory ran out under way; the run started again with less:");
            report::plan(&plan, &grid);
        }
        warn_of_dropped(&tally);
        if let Some(dump) = dump {
            dump.finish(tally.rays)?;
        }
        let posterior_bytes = builder.memory();
        let field = builder.finish(&Provenance { source, tally, share: Some(share), stream: Some(&stream) });
        self.grid.write(field.of_model(checksum), &Cost { elapsed: start.elapsed(), posterior_bytes, step })?;
        checkpoint.map_or(Ok(()), |checkpoint| checkpoint.remove())
    }

    /// Rays of the run, or the most that it may take.
    fn most_rays(&self) -> u64 {
        match self.rays {
            Rays::Count(rays) => rays,
            Rays::Auto => self.max_rays,
        }
    }

    /// What is read and written. A checkpoint is both, that is its point.
    fn command_files(&self) -> CommandFiles {
        let files = CommandFiles::default()
            .input("MODEL", &self.model.model)
            .inputs("--cameras", &self.cameras.cameras)
            .output("--output", &self.grid.output)
            .outputs("--dump-samples", &self.dump_samples);
        match self.error_bars {
            None => files.outputs("--checkpoint", self.checkpoint_file(None)),
            Some(groups) => (0..groups).fold(files, |files, g| {
                files.outputs(&format!("--checkpoint, group {g}"), self.checkpoint_file(Some(g)))
            }),
        }
    }

    /// Model and camera file, if there is one, with their checksums.
    fn files(&self) -> Result<Vec<String>> {
        let cameras = self.cameras.cameras.as_ref().map(|file| file.to_string_lossy());
        [Some(self.model.model.as_str()), cameras.as_deref()].into_iter().flatten().map(identity).collect()
    }

    /// What was computed from what: the run's identity.
    fn source(&self, files: &[String], cameras: &[Camera]) -> String {
        let mut model = files[0].clone();
        if let Some(coordinates) = self.model.coordinates {
            model = format!("{model} in {} coordinates", coordinates.name());
        }
        let seen_by = files.get(1).cloned().unwrap_or_else(|| {
            let [w, h] = cameras[0].resolution;
            let fov = self.cameras.fov.map_or(String::new(), |fov| format!(", {fov} degrees"));
            format!("its own {} cameras of {w} x {h}{fov}", cameras.len())
        });
        format!("{model} seen by {seen_by}")
    }

    /// Runs a pilot, if it costs little beside the run or something has to be planned.
    fn planner(
        &self,
        grid: GridSettings,
        settings: &RaySettings,
        stream: &RayStream,
        share: Shard,
        lattice: Lattice,
        bars: &Bars,
    ) -> Result<Option<Planner>> {
        let is_cheap = share.own_rays() >= 32 * Planner::PILOT;
        let wanted = grid.needs_plan() || is_cheap;
        if wanted { Planner::new(grid, settings, stream, share, lattice, bars).map(Some) } else { Ok(None) }
    }

    fn share(&self) -> Result<Shard> {
        let [index, of] = self.shard.unwrap_or([0, 1]);
        let share = Shard { rays: self.most_rays(), index, of };
        if share.own_rays() == 0 {
            let found = format!("part {index} of {of} of {} rays, which is empty", self.most_rays());
            return Err(Error::setting("--shard", "fewer parts than batches of 512 rays", found));
        }
        Ok(share)
    }

    /// Where and how often to save, if anywhere: each of several groups in a file of its own.
    fn checkpoint(&self, group: Option<u16>, resume: bool) -> Result<Option<Checkpoint>> {
        let file = self.checkpoint_file(group);
        file.map(|path| Checkpoint::new(&path, self.checkpoint_every, resume)).transpose()
    }

    /// The file of a checkpoint, if there is to be one: each of several groups has its own.
    fn checkpoint_file(&self, group: Option<u16>) -> Option<PathBuf> {
        let mut path = self.checkpoint.clone()?;
        if let Some(group) = group {
            path.as_mut_os_string().push(format!(".{group}"));
        }
        Some(path)
    }
}
