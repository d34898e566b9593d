//! `next-view`: which photograph should be taken next?

mod candidates;
mod object;
mod plan;

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use self::candidates::{CandidateOptions, Candidates, MAX_COUNT};
use self::object::Object;
use self::plan::{Planner, check_training};
use super::depth::UnitOptions;
use super::files::CommandFiles;
use super::opened::{compute_field, open_field};
use super::options::{CameraOptions, FrameOptions, ModelArgument, RunOptions, choice, count, heading};
use super::progress::Bars;
use super::streams::tell;
use octobayes::geometry::Camera;
use octobayes::io::AtomicFile;
use octobayes::monitor::Message;
use octobayes::uncertainty::UncertaintyField;
use octobayes::{Error, Result};
use octobayes_data::write_exr;
use octobayes_data::{Frame, Part, Views, write_transforms};
use octobayes_next_view::{Gain, GainMap, NextView, Ranking, Region, Report, Settings};
use octobayes_session::{self, OpenedModel, Session, TrainingCameras, image_settings};
use octobayes_show::picture::{Bar, scalar_panel, write_sheet};

/// Which photographs to add: cameras ranked by how much their images would reduce the uncertainty
///
/// Takes the candidate whose pixels most constrain the displacements that the training images leave free, adds it, takes
/// the best one beside it, and so on. The gain is the sum over vertices of 1/2 log det(I + P^-1 dP), nats, where
/// P is the precision by `--scale data` and dP what the candidate's pixels add to it through the model. No image is
/// needed.
///
/// An output that ends in .html is a plan for people: a map, what each photograph would see, and how to get there from
/// the nearest that there is. One that ends in .json is the ranking for programs.
///
/// Only matter is displaced: space behind opaque matter, where the model shows nothing, attracts no view, though no ray
/// was there.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    octobayes next-view lego.safetensors --take 5 -o plan.html\n  \
    octobayes next-view scene.ply --cameras sparse/0 --metres-per-unit 0.35 --take 5 -o plan.html\n  \
    octobayes next-view lego.safetensors lego.oct --candidates transforms_test.json --take 10 -o ranking.json\n  \
    octobayes next-view lego.safetensors lego.oct --sphere 200 --upper --chosen next.json -o ranking.json")]
pub struct Args {
    #[command(flatten)]
    model: ModelArgument,

    /// The field of its uncertainty, of `uncertainty --for next-view` (or --scale data --keep-sums); without it, it is
    /// computed first, and written beside the output
    #[arg(value_name = "FIELD.oct")]
    field: Option<PathBuf>,

    #[command(flatten)]
    candidates: CandidateOptions,

    #[command(flatten)]
    cameras: CameraOptions,

    #[command(flatten)]
    run: RunOptions,

    #[command(flatten)]
    unit: UnitOptions,

    /// The part of the scene that matters: a box X0,Y0,Z0,X1,Y1,Z1, or a mesh near to its surface, in scene units
    #[arg(
        long,
        value_name = "BOX|MESH.obj",
        allow_hyphen_values = true,
        help_heading = heading::STATISTICS,
    )]
    object: Option<Object>,

    /// Number of views to take
    #[arg(
        long,
        value_name = "N",
        default_value_t = 1,
        value_parser = count::<u32>(1..=MAX_COUNT),
        help_heading = heading::STATISTICS,
    )]
    take: u32,

    /// What a view is worth
    #[arg(
        long,
        value_parser = choice::<Gain>(),
        default_value = Gain::default().name(),
        help_heading = heading::STATISTICS,
    )]
    gain: Gain,

    /// Pixels of a candidate whose rays are traced; they are scaled to all of its pixels
    #[arg(
        long,
        value_name = "N",
        default_value_t = 4096,
        value_parser = count::<u64>(1..=100_000_000),
        help_heading = heading::RAYS,
    )]
    pixels: u64,

    /// Seed of the pixels
    #[arg(long, value_name = "N", default_value_t = 0, help_heading = heading::RAYS, hide_short_help = true)]
    seed: u64,

    /// Where to write the plan for people (.html), or the ranking (.json)
    #[arg(short, long, value_name = "PLAN.html|RANKING.json", help_heading = heading::OUTPUT)]
    output: PathBuf,

    /// Write the cameras that were taken as a camera file
    #[arg(long, value_name = "CAMERAS.json", help_heading = heading::OUTPUT)]
    chosen: Option<PathBuf>,

    /// Draw how much each pixel of the first view would add by itself, as .png or .exr; at most 256 pixels a side
    #[arg(long, value_name = "GAIN.exr|png", help_heading = heading::OUTPUT)]
    map: Option<PathBuf>,

    /// Print the ranking as one JSON object
    #[arg(long, help_heading = heading::OUTPUT)]
    json: bool,
}

impl Args {
    /// Runs the verb.
    pub fn run(mut self, bars: &Bars) -> Result<()> {
        self.cameras.find(Part::Training);
        self.candidates.find();
        self.run.check(self.field.is_some())?;
        let is_plan = is_html(&self.output)?;
        // Where the field goes if it is computed.
        let save = self.field.is_none().then(|| self.output.with_extension("oct"));
        let files = CommandFiles::default()
            .input("MODEL", &self.model.model)
            .inputs("FIELD", &self.field)
            .cameras(self.cameras.cameras.as_deref())
            .inputs("--candidates", self.candidates.file().iter().flat_map(|path| Views::files(path)))
            .inputs("--unused", self.candidates.list())
            .inputs("--object", self.object.as_ref().and_then(Object::file))
            .output("--output", &self.output)
            .outputs("the field beside --output", &save)
            .outputs("the field beside --output", save.as_ref().map(|path| path.with_extension("checkpoint")))
            .outputs("--chosen", &self.chosen)
            .outputs("--map", &self.map);
        files.check()?;
        if let Some(path) = &self.map {
            is_exr(path)?;
            self.gain.check_map()?;
        }
        let known = self.field.as_deref().map(|path| Ok::<_, Error>((path, open_field(path)?))).transpose()?;
        let model = &self.model.model;
        let opened = match &known {
            Some((path, field)) => OpenedModel::of_field(field, path, model, self.run.training.force, &mut tell)?,
            None => OpenedModel::for_cameras(model, self.cameras.cameras.is_some(), self.run.training.splat_mode)?,
        };
        // Cameras that are given are read even if they do not count, for the images that no output may replace.
        let counts = self.candidates.are_made() || self.gain == Gain::Coverage || self.cameras.cameras.is_some();
        let training = (counts || is_plan || known.is_none()).then(|| self.training(&opened, &files)).transpose()?;
        let field = match (known, &training) {
            (Some((_, field)), _) => field,
            (None, Some(training)) => {
                let cameras = (&self.cameras, training);
                compute_field(&opened, cameras, &self.run, Session::for_next_view, save.as_deref(), bars)?
            }
            (None, None) => unreachable!("without a field, the training cameras are read"),
        };
        let frames = training.as_ref().map_or(&[][..], |training| &training.views.frames);
        if is_plan {
            check_training(frames)?;
        }
        let candidates = self.candidates.read(&opened, &field, frames, &self.cameras)?;
        if let Some(views) = &candidates.views {
            files.images_of("--candidates", views).check()?;
        }
        self.rank(&opened, &field, frames, &candidates, bars)
    }

    fn rank(
        &self,
        opened: &OpenedModel,
        field: &UncertaintyField,
        frames: &[Frame],
        candidates: &Candidates,
        bars: &Bars,
    ) -> Result<()> {
        let training: Vec<Camera> = frames.iter().map(|frame| frame.camera).collect();
        let settings = Settings::default().take(self.take as usize).gain(self.gain);
        let settings = settings.pixels(self.pixels).seed(self.seed);
        let places = self.object.as_ref().map(|object| object.places(field.lattice())).transpose()?;
        let contains = places.as_ref().map(|places| |x| places.contains(x));
        let next = NextView::new(&*opened.model, field, &candidates.cameras)
            .training(&training)
            .settings(settings)
            .region(contains.as_ref().map(|contains| -> Region { contains }))
            .monitor(bars);
        let ranking = next.run()?;
        let asked = octobayes_session::Candidates {
            model: &*opened.model,
            model_name: &opened.name,
            field,
            file: self.candidates.file(),
            names: &candidates.names,
            cameras: &candidates.cameras,
            training: &training,
        };
        asked.remark(&ranking, &mut tell)?;
        if let Some(doubt) = ranking.doubt() {
            tell(Message::Note(doubt));
        }
        let value = self.facts(candidates, &settings, &ranking);
        if is_html(&self.output)? {
            let images = image_settings(field);
            let renderer = opened.model.for_images(&images, bars)?;
            let planner = Planner {
                renderer: &*renderer,
                pixel_offset: images.offset_for(&*opened.model),
                training: frames,
                unit: self.unit.unit(),
                up: self.candidates.up,
                gain: self.gain,
                bars,
            };
            let of_what = self.candidates.words(candidates.names.len());
            planner.write(&self.output, &opened.name, &of_what, &next, candidates, &ranking)?;
        } else {
            AtomicFile::write(&self.output, format!("{value:#}\n").as_bytes())?;
        }
        if let Some(path) = &self.chosen {
            let taken = ranking.steps.iter().map(|step| step.index);
            let taken: Vec<_> = taken.map(|k| (candidates.names[k].clone(), candidates.cameras[k])).collect();
            write_transforms(path, &taken)?;
        }
        self.print(&value, candidates, &ranking)?;
        if !ranking.complete {
            let finished = format!("{} holds {} of {} views", self.output.display(), ranking.steps.len(), self.take);
            return Err(Error::InterruptedAfter { finished });
        }
        if let (Some(path), Some(first)) = (&self.map, ranking.steps.first()) {
            write_map(path, &next.map(&candidates.cameras[first.index])?)?;
        }
        Ok(())
    }

    /// The training cameras, of --cameras or the model's own.
    fn training(&self, opened: &OpenedModel, files: &CommandFiles) -> Result<TrainingCameras> {
        let cameras = self.cameras.training(&FrameOptions { views: None }, Some(&*opened.model), &opened.name)?;
        files.clone().images(&cameras.views).check()?;
        Ok(cameras)
    }

    /// What `ranking.json` holds.
    fn facts(&self, candidates: &Candidates, settings: &Settings, ranking: &Ranking) -> Value {
        let mut value = json!(Report::new(settings, ranking, &candidates.names));
        value["version"] = json!(env!("CARGO_PKG_VERSION"));
        value["model"] = json!(self.model.model);
        let save = self.output.with_extension("oct");
        value["field"] = json!(self.field.as_ref().unwrap_or(&save).to_string_lossy());
        value
    }

    fn print(&self, value: &Value, candidates: &Candidates, ranking: &Ranking) -> Result<()> {
        if self.json {
            return say!("{value}");
        }
        say!("view  gain, nats  nats/pixel  never seen, %  seconds  name")?;
        for (n, step) in ranking.steps.iter().enumerate() {
            let unseen = step.unseen.map_or("unknown".into(), |share| format!("{:.1}", 100.0 * share));
            let (gain, each, seconds) = (step.gain, step.gain_per_pixel, step.seconds);
            let name = octobayes::error::printable(&candidates.names[step.index]);
            say!("{:>4}  {gain:>10.1}  {each:>10.4}  {unseen:>13}  {seconds:>7.2}  {name}", n + 1)?;
        }
        if ranking.complete && ranking.steps.len() < self.take as usize {
            announce!("note: no other candidate adds information to these {}", ranking.steps.len());
        }
        Ok(())
    }
}

/// Whether the output is to be a page; refuses all but HTML and JSON.
fn is_html(path: &Path) -> Result<bool> {
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("html") => Ok(true),
        Some("json") => Ok(false),
        _ => Err(Error::extension(path, "`.html` for a plan, or `.json` for a ranking")),
    }
}

/// Whether the file is to be an EXR; refuses all but PNG and EXR.
fn is_exr(path: &Path) -> Result<bool> {
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("exr") => Ok(true),
        Some("png") => Ok(false),
        _ => Err(Error::setting("--map", "a name that ends in .png or .exr", path.display().to_string())),
    }
}

fn write_map(path: &Path, map: &GainMap) -> Result<()> {
    if is_exr(path)? {
        return write_exr(path, map.resolution, vec![("gain", map.gains.clone())]);
    }
    let largest = map.gains.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
    let bar = Bar::new([0.0, f64::from(largest)], colorous::VIRIDIS);
    let gains = map.gains.iter().map(|gain| f64::from(*gain));
    write_sheet(path, &[vec![scalar_panel("gain of each pixel, nats", map.resolution, gains, bar)]])
}
