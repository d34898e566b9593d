//! `evaluate`: checks whether the uncertainty shows where the model is wrong.

mod ranking;
mod sheet;
mod table;

use std::path::{Path, PathBuf};

use self::ranking::Ranking;
use self::table::Evaluation;
use super::belongs::read_field;
use super::files::CommandFiles;
use super::options::{CameraFile, DepthOptions, FrameOptions, ModelOptions};
use super::progress::Bars;
use crate::dataset::Frame;
use crate::evaluate::{
    CleanUp, DepthError, DepthFiles, EvaluatedView, Evaluator, Reading, Score, THRESHOLDS, TrainingViews, TrueView,
    clean_up,
};
use crate::field::RadianceField;
use crate::geometry::{Aabb, Camera, Domain};
use crate::io::AtomicFile;
use crate::metrics::STEPS;
use crate::monitor::Monitor;
use crate::posterior::Covariance;
use crate::render::{RayAverage, RenderedView, Tracer};
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

    /// Folder of true depth maps. Only --clean-up does without
    #[arg(long, value_name = "DIR", required_unless_present = "clean_up")]
    depth: Option<PathBuf>,

    #[command(flatten)]
    maps: DepthOptions,

    /// Folder of true depth maps of the training views, which the model must know, with names and values like those of
    /// --depth. Tells which pixels show what no training view saw, and how well every measure detects them (AUROC, and
    /// AUPR). Where a map knows no depth, its view counts as seeing all that is there
    #[arg(long, value_name = "DIR", requires = "depth")]
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
    #[arg(long, value_name = "MODEL", num_args = 2.., requires = "depth")]
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
    #[arg(long, value_name = "PLOT.svg", requires = "depth")]
    plot: Option<PathBuf>,

    /// Write all sparsification curves as CSV
    #[arg(long, value_name = "CURVES.csv", requires = "depth")]
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
        let judged = self.cameras.held_out(&self.frames, &*model)?;
        let depth_files = self.depth.clone().map(|folder| self.maps.files(folder)).transpose()?;
        let images = judged.iter().map(|frame| &frame.image);
        let maps = judged.iter().flat_map(|frame| depth_files.iter().map(|files| files.path(&frame.name)));
        let training_files = self.training_depth.clone().map(|folder| self.maps.files(folder)).transpose()?;
        let training_maps = |files: &DepthFiles| model.training_cameras().iter().map(|c| files.path(&c.name)).collect();
        let training_maps: Vec<PathBuf> = training_files.as_ref().map_or_else(Vec::new, training_maps);
        files
            .inputs("an image of --cameras", images)
            .inputs("--depth", maps)
            .inputs("--training-depth", training_maps)
            .check()?;
        let frames: Vec<&Frame> = judged.iter().step_by(self.every as usize).collect();
        let settings = self.model.image_settings();
        let offset = settings.offset_for(&*model);
        let truly_seen = training_files.map(|files| truly_seen(&files, &*model, offset, bars)).transpose()?;
        let tracer = settings.tracer(&*model, 0.0, bars)?;
        let training = self.training_views(&tracer, offset, bars)?;
        let differentiation =
            readings.first().map(|r| settings.differentiation(&*model, r.field.lattice())).transpose()?;
        let evaluator = Evaluator {
            differentiation,
            members: members.iter().map(|member| settings.tracer(&**member, 0.0, bars)).collect::<Result<_>>()?,
            training: training.as_ref(),
            truly_seen: truly_seen.as_ref(),
            ..Evaluator::new(tracer, &readings)
        };

        let rows = frames.iter().map(|f| u64::from(f.camera.resolution[1].div_ceil(self.stride))).sum::<u64>();
        bars.begin("rows", rows * (1 + members.len() as u64));
        let (mut truths, mut judged, mut otherwise) = (Vec::new(), Vec::new(), Vec::new());
        for (seed, frame) in (0..).zip(frames) {
            let background = self.model.rays.background.as_dvec3();
            let truth = TrueView::read(frame, depth_files.as_ref(), background, offset, self.stride)?;
            let view = evaluator.evaluate(&truth, seed, bars)?;
            let other = truth.distance_if_not(self.maps.kind());
            let error = |&i: &usize| Some((view.rendered.pixels[i].median_depth - other[i]?).abs());
            otherwise.extend(view.pixels.iter().filter_map(error));
            // Whole images are large, and only the clean-up needs the true ones again.
            judged.push(EvaluatedView { rendered: RenderedView::default(), ..view });
            truths.extend(self.clean_up.is_some().then_some(truth));
        }
        bars.end();
        let measures = evaluator.measures();
        let ranked = self.depth.as_ref().map(|folder| rank(folder, &judged, measures.len(), &*model)).transpose()?;
        if let Some((_, depth)) = &ranked {
            self.maps.note_kind(depth, otherwise);
        }
        let (cleaned, sheet) = self.clean_up(&evaluator, &truths, bars)?.unzip();
        let cleaned = cleaned.unwrap_or_default();
        let calibrations = match &ranked {
            Some(_) => (0..measures.len()).map(|m| evaluator.calibration(&judged, m)).collect(),
            None => Vec::new(),
        };
        let detections = (0..measures.len()).map(|m| Evaluator::detection(&judged, m)).collect();
        let evaluation = Evaluation {
            args: &self,
            evaluator: &evaluator,
            measures,
            views: &judged,
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

    /// What the cameras see that the model was trained on, if it knows them.
    fn training_views(&self, tracer: &Tracer, offset: f64, bars: &Bars) -> Result<Option<TrainingViews>> {
        let cameras: Vec<Camera> = tracer.field.training_cameras().iter().map(|named| named.camera).collect();
        if cameras.is_empty() || self.depth.is_none() {
            return Ok(None);
        }
        bars.begin("rows of training views", TrainingViews::rows(&cameras));
        let views = TrainingViews::render(tracer, &cameras, offset, bars)?;
        bars.end();
        Ok(Some(views))
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

/// What the cameras truly saw that the model was trained on.
fn truly_seen(files: &DepthFiles, model: &dyn RadianceField, offset: f64, bars: &Bars) -> Result<TrainingViews> {
    let cameras = model.training_cameras();
    if cameras.is_empty() {
        let expected = "a model that knows its training cameras, such as those of `train`";
        return Err(Error::setting("--training-depth", expected, model.describe()));
    }
    bars.begin("training depth maps", cameras.len() as u64);
    let seen = TrainingViews::from_depth_maps(cameras, files, offset, bars)?;
    bars.end();
    Ok(seen)
}

/// Scores every measure against the depth error, and says how large that error is.
fn rank(
    folder: &Path,
    views: &[EvaluatedView],
    measures: usize,
    model: &dyn RadianceField,
) -> Result<(Vec<Score>, DepthError)> {
    let scores: Option<Vec<Score>> = (0..measures).map(|m| Score::new(views, m)).collect();
    let (scores, depth) = scores.zip(DepthError::new(views)).ok_or_else(|| {
        let found = views.iter().map(|view| view.pixels.len()).sum::<usize>().to_string();
        let expected = format!("at least {STEPS} pixels with depth and some error");
        Error::malformed(folder, "depth maps", expected, found)
    })?;
    check_depth(folder, &depth, model)?;
    Ok((scores, depth))
}

/// Refuses depths that no error of a model explains. Warns of those that hardly any does.
///
/// Models trained from five views are off by a hundredth of their box in the median, a wrong encoding by the
/// distance of the cameras.
fn check_depth(folder: &Path, depth: &DepthError, model: &dyn RadianceField) -> Result<()> {
    let (size, is_bounded) = match model.natural_domain() {
        Domain::Box(bounds) => (bounds.longest_edge(), true),
        Domain::Contracted { radius, .. } => (2.0 * radius, false),
    };
    let causes = "likely causes: --depth-encoding, --z-depth, or units of the cameras";
    let found = format!("half of the depths are off by more than {:.4} scene units", depth.median);
    if is_bounded && depth.median > size {
        let expected = format!("depths within the model's box, {size:.4} across; {causes}");
        return Err(Error::malformed(folder, "depth maps", expected, found));
    }
    if depth.median > 0.1 * size {
        eprintln!("warning: {found}, and the model is {size:.4} across; {causes}");
    }
    Ok(())
}
