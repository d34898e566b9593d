//! `next-view`: which photograph should be taken next?

use std::io::Write;
use std::path::{Path, PathBuf};

use glam::DVec3;
use serde_json::{Value, json};

use super::files::CommandFiles;
use super::opened::open_field;
use super::options::{CameraOptions, FrameOptions, ModelArgument, choice, count, heading, of_folder, parse_direction};
use super::progress::Bars;
use super::streams::tell;
use octobayes::geometry::Camera;
use octobayes::io::AtomicFile;
use octobayes::monitor::Message;
use octobayes::uncertainty::UncertaintyField;
use octobayes::{Error, Result};
use octobayes_data::write_exr;
use octobayes_data::{Part, Views, write_transforms};
use octobayes_next_view::{Around, Gain, GainMap, Made, NextView, Ranking, Report, Settings};
use octobayes_session::{self, CameraSource, OpenedModel};
use octobayes_show::picture::{Bar, scalar_panel, write_sheet};

/// Most candidates and views.
const MAX_COUNT: u64 = 100_000;

/// Rank candidate cameras by how much their images would reduce the uncertainty
///
/// Takes the candidate whose pixels most constrain the displacements that the training images leave free, adds it, takes
/// the best one beside it, and so on. The gain is the sum over vertices of 1/2 log det(I + P^-1 dP), nats, where
/// P is the precision by `--scale data` and dP what the candidate's pixels add to it through the model. No image is
/// needed.
///
/// Only matter is displaced: space behind opaque matter, where the model shows nothing, attracts no view, though no ray
/// was there. FIELD is one of `uncertainty --for next-view`.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    octobayes next-view lego.safetensors lego.oct --candidates transforms_test.json --take 10 -o ranking.json\n  \
    octobayes next-view lego.safetensors lego.oct --sphere 200 --upper --chosen next.json -o ranking.json")]
pub struct Args {
    #[command(flatten)]
    model: ModelArgument,

    /// The field of its uncertainty, of `uncertainty --for next-view` (or --scale data --keep-sums)
    #[arg(value_name = "FIELD.oct")]
    field: PathBuf,

    /// Cameras to choose from: a camera file, or its folder, as for --cameras, or a camera path of nerfstudio's viewer.
    /// Their images need not exist
    #[arg(
        long,
        value_name = "PATH",
        required_unless_present_any = ["sphere", "orbit"],
        help_heading = heading::INPUT,
    )]
    candidates: Option<PathBuf>,

    /// Choose from N cameras spread over a sphere around the middle of the box, as far away as the training cameras
    /// are, and with their lens; those that stand in matter are left out
    #[arg(
        long,
        value_name = "N",
        value_parser = count::<u32>(1..=MAX_COUNT),
        conflicts_with = "candidates",
        help_heading = heading::INPUT,
    )]
    sphere: Option<u32>,

    /// Only the upper half of --sphere
    #[arg(long, requires = "sphere", conflicts_with = "orbit", help_heading = heading::INPUT)]
    upper: bool,

    /// Choose from N cameras on a circle at the training cameras' median height
    #[arg(
        long,
        value_name = "N",
        value_parser = count::<u32>(1..=MAX_COUNT),
        conflicts_with_all = ["candidates", "sphere"],
        help_heading = heading::INPUT,
    )]
    orbit: Option<u32>,

    /// What is up for --orbit and --sphere, a direction in scene units [default: as the training cameras were held]
    #[arg(
        long,
        value_name = "X,Y,Z",
        value_parser = parse_direction,
        allow_hyphen_values = true,
        conflicts_with = "candidates",
        help_heading = heading::INPUT,
        hide_short_help = true,
    )]
    up: Option<DVec3>,

    #[command(flatten)]
    cameras: CameraOptions,

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

    /// Use the field even if it was computed for another model
    #[arg(long, help_heading = heading::INPUT, hide_short_help = true)]
    force: bool,

    /// Where to write the ranking
    #[arg(short, long, value_name = "RANKING.json", help_heading = heading::OUTPUT)]
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

/// Cameras to choose from, with their names.
struct Candidates {
    names: Vec<String>,
    cameras: Vec<Camera>,
}

impl Args {
    /// Runs the verb.
    pub fn run(mut self, bars: &Bars) -> Result<()> {
        self.cameras.find(Part::Training);
        self.candidates = self.candidates.take().map(|path| of_folder(&path, Part::HeldOut));
        let files = CommandFiles::default()
            .input("MODEL", &self.model.model)
            .input("FIELD", &self.field)
            .cameras(self.cameras.cameras.as_deref())
            .inputs("--candidates", self.candidates.iter().flat_map(|path| Views::files(path)))
            .output("--output", &self.output)
            .outputs("--chosen", &self.chosen)
            .outputs("--map", &self.map);
        files.check()?;
        if let Some(path) = &self.map {
            is_exr(path)?;
            self.gain.check_map()?;
        }
        let field = open_field(&self.field)?;
        let opened = OpenedModel::of_field(&field, &self.field, &self.model.model, self.force, &mut tell)?;
        // Cameras that are given are read even if they do not count, for the images that no output may replace.
        let counts = self.candidates.is_none() || self.gain == Gain::Coverage || self.cameras.cameras.is_some();
        let training = if counts { self.training(&opened, &files)? } else { Vec::new() };
        let candidates = self.candidates(&opened, &field, &training, &files)?;
        let settings = Settings::default().take(self.take as usize).gain(self.gain);
        let settings = settings.pixels(self.pixels).seed(self.seed);
        let next = NextView::new(&*opened.model, &field, &candidates.cameras)
            .training(&training)
            .settings(settings)
            .monitor(bars);
        let ranking = next.run()?;
        let asked = octobayes_session::Candidates {
            model: &*opened.model,
            model_name: &opened.name,
            field: &field,
            file: self.candidates.as_deref(),
            names: &candidates.names,
            cameras: &candidates.cameras,
            training: &training,
        };
        asked.remark(&ranking, &mut tell)?;
        if let Some(doubt) = ranking.doubt() {
            tell(Message::Note(doubt));
        }
        let value = self.facts(&candidates, &settings, &ranking);
        self.write(&value, &candidates, &ranking)?;
        self.print(&value, &candidates, &ranking)?;
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
    fn training(&self, opened: &OpenedModel, files: &CommandFiles) -> Result<Vec<Camera>> {
        let cameras = self.cameras.training(&FrameOptions { views: None }, Some(&*opened.model), &opened.name)?;
        files.clone().images(&cameras.views).check()?;
        Ok(cameras.views.cameras())
    }

    fn candidates(
        &self,
        opened: &OpenedModel,
        field: &UncertaintyField,
        training: &[Camera],
        files: &CommandFiles,
    ) -> Result<Candidates> {
        let made = match (&self.candidates, self.sphere, self.orbit) {
            (Some(path), ..) => {
                let (file, resolution) = (Some(path.clone()), self.cameras.resolution);
                let source = CameraSource { file, resolution, ..CameraSource::default() };
                let views = source.read(None, &mut tell)?;
                files.clone().images_of("--candidates", &views).check()?;
                let (names, cameras) = views.frames.into_iter().map(|frame| (frame.name, frame.camera)).unzip();
                return Ok(Candidates { names, cameras });
            }
            (None, Some(count), _) => Made::Sphere { count, is_upper: self.upper },
            (None, None, count) => Made::Orbit { count: count.unwrap_or(1) },
        };
        let around = Around::like(training, field.lattice().domain(), self.up)?;
        let (names, cameras, buried) = made.cameras(&around, &*opened.model, field.record().march_step);
        if buried > 0 {
            announce!("note: {buried} cameras of --{} stand in matter and are left out", made.kind());
        }
        Ok(Candidates { names, cameras })
    }

    /// What `ranking.json` holds.
    fn facts(&self, candidates: &Candidates, settings: &Settings, ranking: &Ranking) -> Value {
        let mut value = json!(Report::new(settings, ranking, &candidates.names));
        value["version"] = json!(env!("CARGO_PKG_VERSION"));
        value["model"] = json!(self.model.model);
        value["field"] = json!(self.field.to_string_lossy());
        value
    }

    fn write(&self, value: &Value, candidates: &Candidates, ranking: &Ranking) -> Result<()> {
        let mut file = AtomicFile::create(&self.output)?;
        let text = format!("{value:#}\n");
        file.write_all(text.as_bytes()).map_err(Error::io(&self.output, "cannot write"))?;
        file.commit()?;
        let Some(path) = &self.chosen else { return Ok(()) };
        let taken = ranking.steps.iter().map(|step| step.index);
        let taken: Vec<_> = taken.map(|k| (candidates.names[k].clone(), candidates.cameras[k])).collect();
        write_transforms(path, &taken)
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
