//! `train`: from images to a model, or to an ensemble of models.

mod checks;
mod member;
mod splats;

use std::path::{Path, PathBuf};
use std::time::Duration;

use glam::{DVec3, Vec3};
use serde_json::json;

use self::checks::{check_framing, check_member, is_finished, note_box, warn_of_one_color};
use self::member::{Member, state_file};
use super::files::CommandFiles;
use super::given::Given;
use super::options::{
    count, heading, parse_background, parse_box, parse_contraction, parse_norm, parse_resolution, parse_time,
    parse_views,
};
use super::progress::Bars;
use octobayes::error::printable;
use octobayes::field::TrainedField;
use octobayes::geometry::{Aabb, Domain, Norm};
use octobayes::monitor::Monitor;
use octobayes::posterior::DataScale;
use octobayes::{Error, Result};
use octobayes_data::passed_over;
use octobayes_models::{HashGrid, HashGridConfig};
use octobayes_session::Resolution;
use octobayes_train::{
    Background, Budget, DatasetFiles, Finished, Quality, Run, Selection, Shot, TrainSettings, Trainer, Training,
    quality, quality_within,
};

/// Pixels of held-out images that are compared during training.
const LOOK_PIXELS: usize = 20_000;
/// Pixels of held-out images that are compared at the end, over all images together; with --time fewer, if these take
/// too long.
const TEST_PIXELS: usize = 200_000;

/// Train a model on posed images, on the CPU: a multiresolution hash grid (instant-ngp's design), or Gaussian splats
///
/// DATASET is a folder or a camera file, as `octobayes synth`, NeRF-synthetic, instant-ngp, nerfstudio and COLMAP
/// (images and sparse/0) write them. Beside a transforms_train.json, transforms_test.json is held out for measuring.
/// If the files do not list their training images, some are held out: every eighth of a COLMAP model, a tenth of
/// others. SCENE/images_4 means the cameras of SCENE with these pictures. `uncertainty`, `render`, `evaluate` and
/// `info` read the model.
///
/// With --splats the model is a .ply of Gaussian splats, and cameras.json (as the original code writes it) and
/// transforms.json are written beside it, with the cameras at the size of the images that were trained on.
///
/// With --steps the result is the same bit for bit on any number of threads. With --time it depends on how many
/// steps fit, hence on the machine.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  octobayes train nerf_synthetic/lego -o lego.safetensors --time 10m\n  \
    octobayes train lego -o few.safetensors --views 10 --steps 3000 --seed 1\n  \
    octobayes train fox -o fox.safetensors --contract linf:2.5,-2,0,3.6 --time 5m\n  \
    octobayes train lego -o splats/lego.ply --splats --resolution 200 --steps 4000\n  \
    octobayes train lego -o member.safetensors --views 10 --steps 3000 --members 10      # member-0 ... member-9\n\
    then: octobayes uncertainty lego.safetensors -o lego.oct      # the model stores its cameras")]
pub struct Args {
    /// Folder or camera file with images (PNG or JPEG)
    #[arg(value_name = "DATASET")]
    dataset: PathBuf,

    /// Model to write
    #[arg(short, long, value_name = "MODEL.safetensors|MODEL.ply", help_heading = heading::OUTPUT)]
    output: PathBuf,

    /// Train Gaussian splats: MODEL.ply, with cameras.json and transforms.json beside it. They begin at the visual hull
    /// if all images have transparent pixels, else at COLMAP's points, else anywhere in the box, and become up to three
    /// for eight pixels of an image
    #[arg(long, help_heading = heading::TRAINING)]
    splats: bool,

    /// Size of the images to train splats on: W or WxH, at most that of the pictures, whose pixels are averaged
    /// [default: the pictures' own; of more than 1600 columns, 1600]
    #[arg(
        long,
        value_name = "W|WxH",
        value_parser = parse_resolution,
        requires = "splats",
        help_heading = heading::INPUT,
    )]
    resolution: Option<Resolution>,

    /// Training images: how many, spread over the file's order; or their numbers in the file from 0, such as 0,7,31
    /// (`7,` for one); or `all`, including those held out. Frames without an image are left out [default: all that are
    /// not held out]
    #[arg(long, value_name = "N|I,J,...|all", value_parser = parse_views, help_heading = heading::INPUT)]
    views: Option<Selection>,

    /// Number of training steps; the result is reproducible
    #[arg(
        long,
        value_name = "N",
        value_parser = count::<u64>(1..),
        conflicts_with = "time",
        help_heading = heading::TRAINING,
    )]
    steps: Option<u64>,

    /// Time of training, such as 90s, 5min or 1h30m; before it images are loaded, and comparing the model with them
    /// takes up to three tenths of it, or 4 s, more. How many steps fit depends on the machine [default: 3m]
    #[arg(long, value_name = "TIME", value_parser = parse_time, help_heading = heading::TRAINING)]
    time: Option<Duration>,

    /// Seed of initial weights, rays and backgrounds
    #[arg(long, default_value_t = TrainSettings::default().seed, help_heading = heading::TRAINING)]
    seed: u64,

    /// Train this many models with seeds SEED, SEED + 1, ...: MODEL-0.safetensors, MODEL-1.safetensors, ...
    #[arg(
        long,
        value_name = "N",
        default_value_t = 1,
        value_parser = count::<u64>(1..=1000),
        help_heading = heading::TRAINING,
    )]
    members: u64,

    /// Start over and discard the state of an interrupted run, and the finished members of --members
    ///
    /// The state of a run, MODEL.state, is saved every minute and when it is stopped; the same command then goes on
    /// from there.
    #[arg(long, help_heading = heading::OUTPUT)]
    restart: bool,

    /// Colour behind transparent pixels: `random` takes another for every ray, so that the model learns to be
    /// transparent there; else the colour that images without alpha show: white, black or r,g,b in [0, 1]
    #[arg(
        long,
        value_name = "COLOR",
        default_value = "random",
        value_parser = parse_training_background,
        help_heading = heading::INPUT,
    )]
    background: Background,

    /// Box of the scene: x0,y0,z0,x1,y1,z1 in scene units; a hash grid models nothing outside,
    /// splats begin within [default: `aabb` of the
    /// camera file, else instant-ngp's cube: of edge 3.03 times `aabb_scale` around the origin, unless the file has
    /// `scale` and `offset`]
    #[arg(
        long = "box",
        value_name = "BOX",
        value_parser = parse_box,
        allow_hyphen_values = true,
        conflicts_with = "contract",
        help_heading = heading::GRID,
    )]
    bounds: Option<Aabb>,

    /// Contract space outside a ball as in mip-NeRF 360, for unbounded scenes; modelled up to 8 radii away. NORM is l2
    /// or linf, then come the ball's centre and radius in scene units [default ball: 0,0,0,1.515, instant-ngp's cube]
    #[arg(long, value_name = "NORM[:X,Y,Z,R]", value_parser = parse_model_contraction, help_heading = heading::GRID)]
    contract: Option<(Norm, Option<[f64; 4]>)>,

    /// Table entries per level, as a power of two; larger tables hold more detail and are slower
    #[arg(
        long,
        value_name = "LOG2",
        default_value_t = HashGridConfig::default().log2_hashmap_size,
        value_parser = count::<u32>(8..=22),
        help_heading = heading::ADVANCED,
        hide_short_help = true,
    )]
    log2_hashmap_size: u32,

    /// Approximate number of samples per step
    #[arg(
        long,
        value_name = "N",
        default_value_t = TrainSettings::default().samples_per_step,
        value_parser = count::<u64>(1024..=16_777_216),
        help_heading = heading::ADVANCED,
        hide_short_help = true,
    )]
    samples_per_step: u64,

    /// Print one JSON object
    #[arg(long, help_heading = heading::OUTPUT)]
    json: bool,
}

/// `l2` or `linf`, with a ball or without.
fn parse_model_contraction(text: &str) -> std::result::Result<(Norm, Option<[f64; 4]>), String> {
    if text.contains(':') {
        return parse_contraction(text).map(|(norm, ball)| (norm, Some(ball)));
    }
    parse_norm(text).map(|norm| (norm, None))
}

/// `random` or a colour.
fn parse_training_background(text: &str) -> std::result::Result<Background, String> {
    if text == "random" {
        return Ok(Background::Random);
    }
    parse_background(text).map(|color| Background::Fixed(color.to_array()))
}

/// Time for comparing the model with training images, and for held-out images, after so much training.
fn measuring(time: Duration) -> Duration {
    time.mul_f64(0.1).max(Duration::from_secs(2))
}

impl Args {
    /// Runs the verb.
    pub fn run(self, given: &Given, bars: &Bars) -> Result<()> {
        if self.splats {
            return self.run_splats(given, bars);
        }
        if self.output.extension().is_none_or(|extension| extension != "safetensors") {
            let found = self.output.display().to_string();
            return Err(Error::setting("--output", "a name that ends in .safetensors", found));
        }
        self.command_files(&self.dataset).check()?;
        let mut files = DatasetFiles::read(&self.dataset)?;
        self.command_files(&files.path).input("DATASET", files.path.with_file_name("transforms_test.json")).check()?;
        files.select(&self.views.clone().unwrap_or_default(), None)?;
        self.announce_files(&files);
        let domain = self.domain(&files)?;
        if let Domain::Box(bounds) = domain {
            note_box(bounds, &files);
        }
        let [train, held_out] = files.load(bars)?;
        let members = (0..self.members).map(|k| self.member(k, &files, &train)).collect::<Result<Vec<_>>>()?;
        check_framing(&train, &domain)?;
        if self.members > 1 {
            members.iter().try_for_each(check_member)?;
        }
        let mut models = Vec::new();
        for member in &members {
            if self.members > 1 && !self.restart && is_finished(member) {
                announce!("note: {} is finished (--restart trains it again)", member.path.display());
                continue;
            }
            models.push(self.train(member, domain, &train, &held_out, bars)?);
        }
        if self.json { say!("{}", json!({ "models": models })) } else { Ok(()) }
    }

    fn announce_files(&self, files: &DatasetFiles) {
        passed_over(&self.dataset, &files.path).inspect(|text| announce!("note: {text}"));
        files.notes.iter().for_each(|text| announce!("note: {}: {}", files.path.display(), printable(text)));
        announce!("note: {}", files.describe());
    }

    fn domain(&self, files: &DatasetFiles) -> Result<Domain> {
        let Some((norm, ball)) = self.contract else { return Ok(Domain::Box(self.bounds.unwrap_or(files.bounds))) };
        let cube = DatasetFiles::unit_cube();
        let [x, y, z, radius] = ball.unwrap_or([0.0, 0.0, 0.0, 0.5 * cube.longest_edge()]);
        Domain::contracted(DVec3::new(x, y, z), radius, norm)
    }

    fn budget(&self) -> Budget {
        match (self.steps, self.time) {
            (Some(steps), _) => Budget::Steps(steps),
            (None, Some(time)) => Budget::Time(time),
            (None, None) => Budget::Time(Duration::from_secs(180)),
        }
    }

    /// What is read and written. A state is both by design.
    fn command_files(&self, dataset: &Path) -> CommandFiles {
        (0..self.members)
            .map(|k| self.member_file(k))
            .fold(CommandFiles::default(), |files, model| {
                files.output("--output", &model).output("the state of --output", state_file(&model))
            })
            .input("DATASET", dataset)
    }

    /// Trains one model and writes it, finished or not.
    fn train(
        &self,
        member: &Member,
        domain: Domain,
        train: &[Shot],
        held_out: &[Shot],
        bars: &Bars,
    ) -> Result<serde_json::Value> {
        let mut trainer = Trainer::new(member.settings, domain, train)?;
        let mut before = 0.0;
        if member.state.path.exists() && !self.restart {
            before = trainer.restore(&member.state.path, &member.state.key)?;
            announce!("note: going on after {} steps", trainer.steps());
        }
        let run =
            Run { budget: self.budget(), held_out, pixels: LOOK_PIXELS, looks: 10, state: Some(member.state.clone()) };
        let finished = self.follow(&run, &mut trainer, before, bars)?;
        let mut training = member.description.clone();
        training["steps"] = trainer.steps().into();
        training["rays"] = trainer.rays().into();
        let background = member.settings.background.for_images();
        let field = trainer.field(json!(null));
        let measure = |field: &HashGrid, shots, pixels| match run.budget {
            Budget::Time(time) => quality_within(field, shots, background, pixels, measuring(time)),
            // In the fog of the first steps, a ray takes a hundred times as long.
            _ => quality(field, shots, background, pixels.min(100 * trainer.steps().max(10) as usize)),
        };
        self.announce(finished.elapsed, bars);
        // What the images leave open of the model's colours, by which `uncertainty --scale data` weighs them.
        let shown = measure(&field, train, LOOK_PIXELS);
        let noise = shown.as_ref().map(|shown| DataScale::noise_of(shown.psnr));
        training["training_noise"] = json!(noise.filter(|noise| *noise > 0.0));
        let field = field.with_training(training);
        field.write(&member.path)?;
        if finished.interrupted {
            return Err(Error::Stopped { path: member.path.clone(), steps: trainer.steps() });
        }
        if member.state.path.exists() {
            std::fs::remove_file(&member.state.path).map_err(Error::io(&member.state.path, "cannot remove"))?;
        }
        let quality = measure(&field, held_out, TEST_PIXELS);
        warn_of_one_color([("training", train, shown), ("held-out", held_out, quality.clone())], background);
        self.report(member, &trainer, &field, finished, train.len(), quality.as_ref(), background)
    }

    /// Trains with bars and lines about how far it is, after `before` seconds of it.
    fn follow(&self, run: &Run, trainer: &mut impl Training, before: f64, bars: &Bars) -> Result<Finished> {
        let (unit, all, before_units) = match run.budget {
            Budget::Time(time) => ("seconds of training", time.as_secs_f64(), before),
            Budget::Steps(steps) => ("training steps", steps as f64, trainer.steps() as f64),
        };
        bars.begin(unit, (all - before_units).ceil().max(1.0) as u64);
        let mut done = 0;
        let finished = run.train(trainer, before, bars, |progress| {
            let now = (progress.share * all - before_units).max(0.0) as u64;
            // The message first: the line that `advance` may print shows it.
            let (loss, psnr, left) = (progress.loss, progress.train_psnr, progress.left.max(0.0));
            bars.message(format!("step {}, loss {loss:.5}, {psnr:.1} dB", progress.steps));
            bars.advance(now.saturating_sub(done));
            done = done.max(now);
            if let Some(Quality { psnr, views, .. }) = progress.held_out {
                let steps = progress.steps;
                bars.line(&format!(
                    "step {steps}: loss {loss:.5}, PSNR {psnr:.2} dB on {views} held-out images, {left:.0} s left"
                ));
            }
        });
        bars.end();
        // A run that has diverged would do so again.
        if let Err(Error::Setting { .. }) = finished {
            run.state.iter().for_each(|state| drop(std::fs::remove_file(&state.path)));
        }
        finished
    }

    /// Says on stderr that training is over, and what follows.
    fn announce(&self, elapsed: f64, bars: &Bars) {
        let most = match self.budget() {
            Budget::Time(time) => format!(", for at most about {:.0} s", 2.0 * measuring(time).as_secs_f64()),
            _ => String::new(),
        };
        bars.line(&format!("note: trained for {elapsed:.1} s; now the model is compared with its images{most}"));
    }

    #[allow(clippy::too_many_arguments, reason = "the lines of a report")]
    fn report(
        &self,
        member: &Member,
        trainer: &Trainer,
        field: &HashGrid,
        finished: Finished,
        images: usize,
        quality: Option<&Quality>,
        background: Vec3,
    ) -> Result<serde_json::Value> {
        let (steps, rays, elapsed) = (trainer.steps(), trainer.rays(), finished.elapsed);
        if !self.json {
            say!("{}: {}", member.path.display(), field.describe())?;
            say!(
                "  {images} images, {steps} steps, {rays} rays, {elapsed:.1} s, {:.1} steps/s, seed {}",
                steps as f64 / elapsed.max(1e-9),
                member.settings.seed
            )?;
            if let Some(Quality { psnr, views, pixels }) = quality {
                say!(
                    "  PSNR {psnr:.2} dB, mean over {views} held-out images, {pixels} pixels, background {background}"
                )?;
            }
        }
        Ok(json!({
            "model": member.path.to_string_lossy(), "images": images, "steps": steps, "rays": rays, "seconds": elapsed,
            "seed": member.settings.seed, "held_out": quality, "background": background.to_array(),
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_become_backgrounds() {
        assert_eq!(parse_training_background("random"), Ok(Background::Random));
        assert!(parse_training_background("red").is_err());
    }
}
