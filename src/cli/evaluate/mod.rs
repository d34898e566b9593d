//! `evaluate`: checks whether the uncertainty shows where the model is wrong.

mod ranking;
mod sheet;
mod table;

use std::path::{Path, PathBuf};

use self::ranking::Ranking;
use self::table::Evaluation;
use super::belongs::read_field;
use super::files::CommandFiles;
use super::options::{CameraFile, DepthOptions, FrameOptions, ModelOptions, depth};
use super::progress::Bars;
use crate::dataset::Frame;
use crate::evaluate::{
    CleanUp, DepthError, DepthMeaning, Evaluator, FramesWithDepth, HeldOut, Judged, Reading, Score, THRESHOLDS,
    TrainingViews, TrueView, clean_up,
};
use crate::field::RadianceField;
use crate::geometry::{Aabb, Camera};
use crate::io::AtomicFile;
use crate::metrics::STEPS;
use crate::monitor::Monitor;
use crate::posterior::Covariance;
use crate::render::{RayAverage, Tracer};
use crate::{Error, Result};

/// Evaluate fields against true depth: AUSE beside measures that need no Hessian, depth error, PSNR, clean-up
///
/// Renders the test views and checks whether pixels of large uncertainty are pixels of large depth error. AUSE is
/// the area under the sparsification error by the official code's procedure: 100 steps, both curves over their
/// common maximum, trapezoid rule. Only the order of pixels counts, so nothing is normalised per image.
///
/// Several fields, covariances and ray averages share the rendering. The same pixels are ranked by what any field gives
/// for nothing: the variance and the entropy of the ray's weights, the weights' spread over the number of training
/// rays, 1 - opacity, the rays and visits themselves, and chance; and, if the model knows its training cameras, by how
/// many of them see the place, and from how near an angle. A field that knows its misfit (`uncertainty --images`) adds
/// that. With --ensemble they are also ranked by the disagreement of several models.
///
/// Depth is compared where the true depth is known and the image is fully opaque (alpha 255; images without alpha
/// are opaque everywhere).
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    octobayes evaluate lego.safetensors lego.oct --cameras transforms_test.json --depth test \
    --depth-encoding 8,-8 --plot ause.svg --csv ause.csv\n  \
    octobayes evaluate m-0.safetensors m.oct --ensemble m-0.safetensors m-1.safetensors m-2.safetensors \
    --cameras bunny/transforms_test.json --depth bunny/depth --depth-pattern {}.png \
    --depth-encoding 0,6.5535 --clean-up sheet.png")]
pub struct Args {
    #[command(flatten)]
    model: ModelOptions,

    /// Fields to evaluate
    #[arg(value_name = "FIELD.oct", required = true)]
    fields: Vec<PathBuf>,

    #[command(flatten)]
    cameras: CameraFile,

    #[command(flatten)]
    frames: FrameOptions,

    /// Folder of true depth maps [default: those that the camera file names, `depth_file_path`]. Only --clean-up does
    /// without
    #[arg(long, value_name = "DIR")]
    depth: Option<PathBuf>,

    #[command(flatten)]
    maps: DepthOptions,

    /// Folder of true depth maps of the training views, which the model must know, with names and values like those of
    /// --depth. Tells which pixels show what no training view saw, and how well every measure detects them (AUROC, and
    /// AUPR). Where a map knows no depth, its view counts as seeing all that is there
    #[arg(long, value_name = "DIR")]
    training_depth: Option<PathBuf>,

    /// Covariances to evaluate, separated by commas [default: all if a field keeps its sums, else its own]
    #[arg(long, value_enum, value_delimiter = ',')]
    covariance: Vec<Covariance>,

    /// How log10 U is averaged along a ray; several, separated by commas, are compared side by side [default:
    /// `u-spread-per-root-ray`, which ranked depth errors best (experiments/depth.md), or `u-spread` for a field that
    /// does not know its ray counts]
    #[arg(long, value_enum, value_delimiter = ',')]
    ray_average: Vec<RayAverage>,

    /// How the ranking is told
    #[arg(long, value_enum, default_value = "bayesrays")]
    protocol: Ranking,

    /// Two or more models trained like MODEL with other seeds; MODEL may be among them. Evaluates the variance of
    /// their depth, and the density-aware ensemble (Sünderhauf et al. 2023)
    #[arg(long, value_name = "MODEL", num_args = 2..)]
    ensemble: Vec<String>,

    /// Remove density above ten thresholds of log10 U (the first field's first covariance), report how images
    /// change, and write this sheet of pictures before and after
    #[arg(long, value_name = "SHEET.png")]
    clean_up: Option<PathBuf>,

    /// Use every Nth pixel along x and y
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    stride: u32,

    /// Use every Nth frame
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    every: u32,

    /// Draw the sparsification curves (mean absolute error) as SVG. Beside them, for fields of `--scale data`, the
    /// reliability of the deviations of depth: the share of errors within the interval that should hold each share
    #[arg(long, value_name = "PLOT.svg")]
    plot: Option<PathBuf>,

    /// Write all sparsification curves as CSV
    #[arg(long, value_name = "CURVES.csv")]
    csv: Option<PathBuf>,

    /// Use the field even if it was computed for another model
    #[arg(long)]
    force: bool,

    /// Print the protocol of every field and covariance, too
    #[arg(long)]
    verbose: bool,

    /// Print one JSON object, with all protocols
    #[arg(long)]
    json: bool,
}

impl Args {
    /// Runs the verb.
    pub fn run(mut self, bars: &Bars) -> Result<()> {
        self.cameras.find();
        let files = CommandFiles::default()
            .input("MODEL", &self.model.model)
            .inputs("FIELD", &self.fields)
            .inputs("--ensemble", &self.ensemble)
            .cameras(Some(&self.cameras.cameras))
            .outputs("--plot", &self.plot)
            .outputs("--csv", &self.csv)
            .outputs("--clean-up", &self.clean_up);
        files.check()?;
        let model = self.model.open()?;
        let readings = self.readings(&*model)?;
        let members = self.ensemble.iter().map(|name| self.member(name, &*model)).collect::<Result<Vec<_>>>()?;
        let views = self.cameras.read()?;
        let all = views.frames.clone();
        let judged = self.frames.held_out(views, &*model)?;
        let frames: Vec<Frame> = judged.iter().step_by(self.every as usize).cloned().collect();
        let is_judged = self.judges_depth(&frames);
        let maps = self.maps.files(self.depth.clone());
        let found = is_judged.then(|| maps.find(&self.cameras.cameras, &frames, &all)).transpose()?;
        let training_maps =
            self.training_depth.as_ref().map(|folder| self.training_maps(folder, &*model)).transpose()?;
        files
            .inputs("an image of --cameras", judged.iter().map(|frame| &frame.image))
            .inputs("--depth", found.iter().flat_map(|found| &found.files))
            .inputs("--training-depth", training_maps.iter().flat_map(|found| &found.files))
            .check()?;
        let settings = self.model.image_settings();
        let offset = settings.offset_for(&*model);
        let truly_seen = training_maps.map(|found| truly_seen(&found, &*model, offset, bars)).transpose()?;
        let tracer = settings.tracer(&*model, 0.0, bars)?;
        let training = if is_judged { training_views(&tracer, offset, bars)? } else { None };
        let differentiation =
            readings.first().map(|r| settings.differentiation(&*model, r.field.lattice())).transpose()?;
        let evaluator = Evaluator {
            differentiation,
            members: members.iter().map(|member| settings.tracer(&**member, 0.0, bars)).collect::<Result<_>>()?,
            training: training.as_ref(),
            truly_seen: truly_seen.as_ref(),
            ..Evaluator::new(tracer, &readings)
        };

        let source = found.as_ref().map_or_else(PathBuf::new, |found| found.source.clone());
        let held_out = HeldOut {
            frames: found.as_ref().map_or(&frames, |found| &found.frames),
            depth: found.as_ref().map(|f| DepthMeaning { encoding: f.encoding, bounds: model.bounds() }),
            background: self.model.rays.background.as_dvec3(),
            pixel_offset: offset,
            stride: self.stride,
        };
        // Whole images are large, and only the clean-up needs the true ones again.
        let mut truths = Vec::new();
        let keep = |truth| truths.extend(self.clean_up.is_some().then_some(truth));
        let judged = held_out.evaluate(&evaluator, &source, bars, keep)?;
        let measures = evaluator.measures();
        let ranked = is_judged.then(|| rank(&judged, measures.len(), &*model)).transpose()?;
        let (cleaned, sheet) = self.clean_up(&evaluator, &truths, bars)?.unzip();
        let cleaned = cleaned.unwrap_or_default();
        let calibrations = match &ranked {
            Some(_) => (0..measures.len()).map(|m| evaluator.calibration(&judged.views, m)).collect(),
            None => Vec::new(),
        };
        let detections = (0..measures.len()).map(|m| Evaluator::detection(&judged.views, m)).collect();
        let evaluation = Evaluation {
            args: &self,
            evaluator: &evaluator,
            measures,
            views: &judged.views,
            source: &source,
            readings: is_judged.then_some(judged.readings),
            ranked,
            calibrations,
            detections,
            cleaned,
        };
        let plot = self.plot.as_ref().map(|path| evaluation.plot(path)).transpose()?;
        let csv = self.csv.as_ref().map(|path| evaluation.csv(path)).transpose()?;
        // All are on the disk before the first gets its name, so that no half set is left.
        let mut files: Vec<AtomicFile> = [sheet, plot, csv].into_iter().flatten().collect();
        files.iter_mut().try_for_each(AtomicFile::sync)?;
        files.into_iter().try_for_each(AtomicFile::commit)?;
        evaluation.print()
    }

    /// Whether depth is judged: always, unless the clean-up alone is asked for. Says so if there would be maps.
    fn judges_depth(&self, frames: &[Frame]) -> bool {
        let needs_it = [self.depth.is_some(), self.training_depth.is_some(), self.plot.is_some(), self.csv.is_some()];
        if self.clean_up.is_none() || needs_it.contains(&true) || !self.ensemble.is_empty() || self.maps.are_given() {
            return true;
        }
        if frames.iter().any(|frame| frame.depth.is_some()) {
            announce!(
                "note: the depth maps that the camera file names are not evaluated: --clean-up alone does without \
                 (--depth-encoding, --z-depth or --plot use them)"
            );
        }
        false
    }

    /// The frames that the model was trained on, with their depth maps.
    fn training_maps(&self, folder: &Path, model: &dyn RadianceField) -> Result<FramesWithDepth> {
        let cameras = model.training_cameras();
        if cameras.is_empty() {
            let expected = "a model that knows its training cameras, such as those of `train`";
            return Err(Error::setting("--training-depth", expected, model.describe()));
        }
        let frames: Vec<Frame> = cameras.iter().map(|named| Frame::new(named.camera, &named.name, "")).collect();
        self.maps.files(Some(folder.into())).find(folder, &frames, &frames)
    }

    fn readings(&self, model: &dyn RadianceField) -> Result<Vec<Reading>> {
        let mut readings = Vec::new();
        for path in &self.fields {
            let field = read_field(path, &self.model, model, self.force)?;
            let stem = path.file_stem().unwrap_or_default().to_string_lossy();
            let covariances = Some(&self.covariance[..]).filter(|wanted| !wanted.is_empty());
            let averages = Some(&self.ray_average[..]).filter(|wanted| !wanted.is_empty());
            readings.extend(Reading::from_field(&stem, &field, covariances, averages)?);
        }
        Ok(readings)
    }

    /// Opens a member of the ensemble. It must cover the same box as the model.
    fn member(&self, name: &str, model: &dyn RadianceField) -> Result<Box<dyn RadianceField>> {
        let member = crate::open::open_in(name, self.model.rays.coordinates)?;
        let text = |b: Aabb| format!("{} to {}", b.min(), b.max());
        let [expected, found] = [model.bounds(), member.bounds()];
        let same = [expected.min() - found.min(), expected.max() - found.max()];
        if same.iter().any(|d| d.abs().max_element() > 1e-5 * expected.longest_edge()) {
            return Err(Error::setting(
                format!("box of the member `{name}`"),
                format!("the model's, {}", text(expected)),
                text(found),
            ));
        }
        Ok(member)
    }

    /// Sweeps the thresholds and draws the sheet, if asked to.
    fn clean_up(
        &self,
        evaluator: &Evaluator,
        truths: &[TrueView],
        bars: &Bars,
    ) -> Result<Option<(Vec<CleanUp>, AtomicFile)>> {
        let Some(path) = &self.clean_up else { return Ok(None) };
        let rows: u64 = truths.iter().map(|truth| u64::from(truth.camera.resolution[1])).sum();
        bars.begin("rows, cleaned", rows * (1 + THRESHOLDS.len() as u64));
        let cleaned = clean_up(&evaluator.tracer, &evaluator.baked[0], truths, &THRESHOLDS, bars)?;
        bars.end();
        let sheet = sheet::stage(path, truths, &cleaned)?;
        Ok(Some((cleaned.into_iter().map(|(cleaned, _)| cleaned).collect(), sheet)))
    }
}

/// What the cameras see that the model was trained on, if it knows them.
fn training_views(tracer: &Tracer, offset: f64, bars: &Bars) -> Result<Option<TrainingViews>> {
    let cameras: Vec<Camera> = tracer.field.training_cameras().iter().map(|named| named.camera).collect();
    if cameras.is_empty() {
        return Ok(None);
    }
    bars.begin("rows of training views", TrainingViews::rows(&cameras));
    let views = TrainingViews::render(tracer, &cameras, offset, bars)?;
    bars.end();
    Ok(Some(views))
}

/// What the cameras truly saw that the model was trained on. Says what their depth maps lack.
fn truly_seen(maps: &FramesWithDepth, model: &dyn RadianceField, offset: f64, bars: &Bars) -> Result<TrainingViews> {
    let depth = DepthMeaning { encoding: maps.encoding, bounds: model.bounds() };
    bars.begin("training depth maps", maps.frames.len() as u64);
    let (seen, readings) = TrainingViews::from_depth_maps(&maps.frames, &depth, offset, bars)?;
    bars.end();
    if readings.are_nearly_all_unmeasured() {
        let expected = "depths of what the model shows in at least 1 % of the pixels (--depth-encoding)";
        return Err(Error::malformed(&maps.source, "depth maps of training views", expected, readings.to_string()));
    }
    if readings.measured < readings.total() {
        announce!("note: training views: {readings}; such pixels count as seeing all that is there");
    }
    Ok(seen)
}

/// Scores every measure against the depth error, and says how large that error is. Says what is odd about the maps.
fn rank(judged: &Judged, measures: usize, model: &dyn RadianceField) -> Result<(Vec<Score>, DepthError)> {
    let fit = judged.depth(model)?;
    depth::tell(&fit);
    let scores: Option<Vec<Score>> = (0..measures).map(|m| Score::new(&judged.views, m)).collect();
    let few = || judged.too_few(&format!("at least {STEPS} pixels with depth and some error"));
    Ok((scores.ok_or_else(few)?, fit.error))
}
