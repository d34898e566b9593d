//! `depth`: where can depth be trusted, and how far may it be off?

mod points;
mod scene;
mod summary;
mod unit;
mod view;
mod worst;

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use serde_json::json;

use self::points::Cloud;
use self::summary::{announce_summary, write_quality};
use self::view::{DepthView, MapSettings, Quality, files};
use self::worst::Page;
use super::files::CommandFiles;
use super::options::{MAX_KEPT_COUNT, ModelArgument, count, heading, parse_positive, parse_views};
use super::progress::Bars;
use octobayes::error::counted;
use octobayes::monitor::Monitor;
use octobayes::{Error, Result};
use octobayes_data::{DepthKind, Frame, Selection};
use octobayes_show::export::write_depth_points;

pub use self::scene::{Look, SceneOptions};
pub use self::unit::{Unit, UnitOptions, figure};

/// Longest side of the maps unless --stride says otherwise, pixels.
const SIDE: u32 = 640;

/// Depth maps of the photographs, how far each depth may be off, and which of them can be trusted
///
/// Looks at the model through the training cameras. For each photograph NAME it writes into DIR
///
///   NAME.depth.png  depth, distance from the camera: 16 bits, in millimetres (or --unit); 0 where nothing is shown, 65535
///                   where it is farther and not trusted
///   NAME.sigma.png  its standard deviation, the same unit; 65535 is that or more. Within 1.64 of them lie 90 % of the
///                   errors
///   NAME.trust.png  255 trusted; 192 fewer than three cameras see a surface there; 128 most cameras that see the place
///                   see through it; 64 no other camera sees it; 0 nothing is shown
///
/// and of all quality.csv (a line for each), points.ply (trusted points with scalar_sigma, for CloudCompare),
/// report.html and field.oct, the field from which deviations are computed: `measure` takes it.
///
/// If the unit of the cameras is not known, all lengths are scene units: a step of a map is then a thousandth of one.
/// The images beside the cameras make deviations more precise; without them the field decides alone.
#[derive(clap::Args)]
#[command(
    verbatim_doc_comment,
    after_help = "Examples:\n  \
    octobayes depth fox.safetensors -o depth\n  \
    octobayes depth scene.ply --cameras sparse/0 --metres-per-unit 0.35 -o depth\n  \
    octobayes depth scene.ply depth/field.oct --cameras sparse/0 --known 0,0,0,1,0.2,0,1.5 -o metric"
)]
pub struct Args {
    #[command(flatten)]
    model: ModelArgument,

    /// A field of the model, of `uncertainty --for depth` or of `depth` before; without it, it is computed first
    #[arg(value_name = "FIELD.oct", help_heading = heading::INPUT)]
    field: Option<PathBuf>,

    #[command(flatten)]
    scene: SceneOptions,

    /// Photographs to write maps of: N of them, spread evenly, or a list such as 0,7,31, of the training cameras
    /// [default: all]
    #[arg(long, value_name = "N|I,J,...", value_parser = parse_views, help_heading = heading::OUTPUT)]
    photographs: Option<Selection>,

    /// Every N-th pixel of a photograph along x and y [default: so that the longest side is at most 640]
    #[arg(long, value_name = "N", value_parser = count::<u32>(1..=1024), help_heading = heading::OUTPUT)]
    stride: Option<u32>,

    #[command(flatten)]
    unit: UnitOptions,

    /// The length of a step of the 16-bit maps, in metres, or in scene units if metres are not known
    #[arg(
        long = "unit",
        value_name = "LENGTH",
        value_parser = parse_positive,
        default_value_t = 0.001,
        help_heading = heading::OUTPUT,
    )]
    step: f64,

    /// Write depths along the optical axis, instead of distances from the camera; σ likewise
    #[arg(long, help_heading = heading::OUTPUT)]
    z_depth: bool,

    /// Also write NAME.exr: depth and σ as floats, NaN where nothing is shown, and trust
    #[arg(long, help_heading = heading::OUTPUT)]
    exr: bool,

    /// Points of points.ply, of all photographs together
    #[arg(
        long,
        value_name = "N",
        default_value_t = 1_000_000,
        value_parser = count::<u64>(2..=MAX_KEPT_COUNT),
        help_heading = heading::OUTPUT,
        hide_short_help = true,
    )]
    points: u64,

    /// Folder for the results; it is created
    #[arg(short, long, value_name = "DIR", help_heading = heading::OUTPUT)]
    output: PathBuf,

    /// Print the figures of all photographs as one JSON object
    #[arg(long, help_heading = heading::OUTPUT)]
    json: bool,
}

/// Results of all photographs together.
const OF_ALL: [&str; 3] = ["quality.csv", "points.ply", "report.html"];
/// The field, if it is computed.
const FIELD: &str = "field.oct";

impl Args {
    /// Runs the verb.
    pub fn run(mut self, bars: &Bars) -> Result<()> {
        let unit = self.unit.unit();
        let kind = if self.z_depth { DepthKind::Z } else { DepthKind::Euclidean };
        let settings = MapSettings { unit, step: self.step, kind, exr: self.exr };
        let read = self.scene.files(&self.model.model, self.field.as_deref())?;
        read.check()?;
        std::fs::create_dir_all(&self.output).map_err(Error::io(&self.output, "cannot create the folder"))?;
        let field = self.output.join(FIELD);
        let save = self.field.is_none().then_some(&field);
        let checkpoint = save.map(|path| path.with_extension("checkpoint"));
        let written = read
            .outputs("--output", save)
            .outputs("--output", checkpoint)
            .outputs("--output", OF_ALL.map(|name| self.output.join(name)));
        let (mut chosen, mut stems) = (Vec::new(), Vec::new());
        let check = |frames: &[Frame], files: CommandFiles| {
            chosen = self.chosen(frames)?;
            stems = self.stems(frames, &chosen);
            self.check_maps(&stems, files)
        };
        let save = save.map(PathBuf::as_path);
        let scene = self.scene.open(&self.model.model, self.field.as_deref(), &written, check, save, bars)?;
        let pixels =
            chosen.iter().map(|&i| scene.frames()[i].camera.strided(self.stride(&scene.frames()[i]), 0.5).pixels());
        let pixels: u64 = pixels.sum();
        scene.look(pixels, bars, |look| self.write(look, &chosen, &stems, &settings))
    }

    fn write(&self, look: &Look, chosen: &[usize], stems: &[PathBuf], settings: &MapSettings) -> Result<()> {
        let offset = look.surveyor.pixel_offset;
        let of_images = if look.surveyor.deviation.has_images() { 2 } else { 1 };
        let rows = |i: &usize| {
            let frame = &look.frames[*i];
            of_images * u64::from(frame.camera.strided(self.stride(frame), offset).resolution[1])
        };
        look.bars.begin("rows of photographs", chosen.iter().map(rows).sum());
        let mut cloud = Cloud::new(self.points as usize, settings.unit);
        let (mut rows, mut page) = (Vec::new(), Page::new(settings.unit));
        for (done, (&i, stem)) in chosen.iter().zip(stems).enumerate() {
            let mut one = || -> Result<Quality> {
                let view = DepthView::new(look, i, self.stride(&look.frames[i]))?;
                view.write(stem, offset, settings)?;
                cloud.add(&view, look);
                page.add(&view, look);
                Ok(view.quality(offset, settings))
            };
            rows.push(one().map_err(|error| match error {
                Error::Interrupted if done > 0 => Error::InterruptedAfter {
                    finished: format!("{} holds {done} of {} photographs", self.output.display(), chosen.len()),
                },
                other => other,
            })?);
        }
        look.bars.end();
        write_quality(&self.output.join(OF_ALL[0]), &rows, settings)?;
        write_depth_points(&self.output.join(OF_ALL[1]), cloud.points(), settings.unit.is_known.then_some("m"))?;
        page.write(&self.output.join(OF_ALL[2]), &rows, &self.model.model, look)?;
        announce_summary(&rows, settings.unit);
        if self.json {
            let unit = settings.unit.name();
            let uses_images = look.surveyor.deviation.has_images();
            let factor = settings.unit.factor;
            return say!(
                "{}",
                json!({
                    "unit": unit, "units_per_scene_unit": factor, "step": settings.step, "images": uses_images,
                    "photographs": rows,
                })
            );
        }
        say!("{}", self.output.display())
    }

    /// The numbers of the photographs.
    fn chosen(&self, frames: &[Frame]) -> Result<Vec<usize>> {
        let n = frames.len();
        match &self.photographs {
            None | Some(Selection::All | Selection::BothParts) => Ok((0..n).collect()),
            Some(Selection::Count(count)) => {
                let count = (*count).min(n);
                Ok((0..count).map(|k| (2 * k + 1) * n / (2 * count)).collect())
            }
            Some(Selection::Indices(indices)) => match indices.iter().find(|&&i| i >= n) {
                None => Ok(indices.clone()),
                Some(i) => {
                    let expected = format!("numbers from 0 to {}, of {}", n - 1, counted(n, "training camera"));
                    Err(Error::setting("--photographs", expected, i.to_string()))
                }
            },
        }
    }

    /// The path of each photograph's maps without what ends their names.
    fn stems(&self, frames: &[Frame], chosen: &[usize]) -> Vec<PathBuf> {
        let short = |frame: &Frame| {
            let name = frame.name.replace('\\', "/");
            let name = name.rsplit('/').next().unwrap_or_default().to_string();
            let stem = Path::new(&name).file_stem().map_or(name.clone(), |stem| stem.to_string_lossy().into_owned());
            if stem.is_empty() || stem.starts_with('.') { format!("frame{stem}") } else { stem }
        };
        let names: Vec<String> = frames.iter().map(short).collect();
        // Photographs of several folders may have one name, and disks may not tell capitals apart.
        let distinct: HashSet<String> = names.iter().map(|name| name.to_lowercase()).collect();
        let is_unique = distinct.len() == names.len();
        let stem =
            |&i: &usize| self.output.join(if is_unique { names[i].clone() } else { format!("{i:04}_{}", names[i]) });
        chosen.iter().map(stem).collect()
    }

    /// Checks that all maps can be written, and that none replaces a file of another program.
    fn check_maps(&self, stems: &[PathBuf], written: CommandFiles) -> Result<()> {
        let maps: Vec<PathBuf> = stems.iter().flat_map(|stem| files(stem, self.exr)).collect();
        let is_own = self.output.join(OF_ALL[0]).exists() || self.output.join(OF_ALL[2]).exists();
        if let Some(path) = maps.iter().find(|path| path.exists() && !is_own) {
            let expected = "a folder without maps of other programs, which those of `depth` would replace";
            return Err(Error::setting("--output", expected, path.display().to_string()));
        }
        written.outputs("--output", maps).check()
    }

    fn stride(&self, frame: &Frame) -> u32 {
        let [width, height] = frame.camera.resolution;
        self.stride.unwrap_or_else(|| width.max(height).div_ceil(SIDE))
    }
}
