//! `evaluate`: checks whether the uncertainty shows where the model is wrong.

mod curves;
mod sheet;
mod table;

use std::path::PathBuf;

use super::files::CommandFiles;
use super::given::Given;
use super::opened::open_field;
use super::options::{
    CameraFile, DepthOptions, FrameOptions, ModelArgument, check_field_name, choice, count, heading, parse_probability,
};
use super::progress::Bars;
use super::streams::tell;
use octobayes::estimate::RaySettings;
use octobayes::io::AtomicFile;
use octobayes::posterior::Covariance;
use octobayes::render::RayAverage;
use octobayes::{Error, Result};
use octobayes_evaluation::{Evaluation, Judged, Reading};
use octobayes_models::{is_of_splats, open_model};
use octobayes_session::{OpenedModel, image_settings};
use octobayes_splats::Splats;

/// Evaluate fields against true depth: AUSE beside measures that need no Hessian, depth error, PSNR, clean-up
///
/// Renders the test views and checks whether pixels of large uncertainty are pixels of large depth error. AUSE is
/// the area under the sparsification error by the official code's procedure: 100 steps, both curves over their
/// common maximum, trapezoid rule. Only the order of pixels counts, so nothing is normalised per image.
///
/// Several fields, covariances and ray averages share the rendering. The table also lists baselines that need no
/// Hessian: the variance of the ray's weights, the distance from the camera, the weights' spread over the number of
/// training rays or its root, and chance. With --ensemble they are also ranked by the disagreement of several models.
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
    model: ModelArgument,

    /// Fields to evaluate
    #[arg(value_name = "FIELD.oct", required = true)]
    fields: Vec<PathBuf>,

    #[command(flatten)]
    cameras: CameraFile,

    #[command(flatten)]
    frames: FrameOptions,

    /// Folder of true depth maps [default: those that the camera file names, `depth_file_path`]. Not
    /// needed for --clean-up alone
    #[arg(long, value_name = "DIR", help_heading = heading::INPUT)]
    depth: Option<PathBuf>,

    #[command(flatten)]
    maps: DepthOptions,

    /// Folder of true depth maps of the training views, which the model must store, with names and values like those
    /// of --depth. Marks pixels whose surface no training view saw, and measures how well every measure detects them
    /// (AUROC, and AUPR). A pixel without depth counts as having seen all that is along its ray
    #[arg(long, value_name = "DIR", help_heading = heading::INPUT, hide_short_help = true)]
    training_depth: Option<PathBuf>,

    /// Folder from which the names of the training images start: deviations of depth then also count how well these
    /// agree on each surface. The model must store its training cameras, or a camera file have them
    #[arg(long, value_name = "DIR", help_heading = heading::INPUT)]
    images: Option<PathBuf>,

    /// Folder of masks in which the object is not black, `NAME.png` of each view [default: those that the camera file
    /// names, `object_mask_path`]. The object has figures of its own then, and the verdict is about it
    #[arg(long, value_name = "DIR", help_heading = heading::INPUT)]
    object_masks: Option<PathBuf>,

    /// Covariances to evaluate, separated by commas [default: all if a field keeps its sums, else its own]
    #[arg(long, value_parser = choice::<Covariance>(), value_delimiter = ',', help_heading = heading::STATISTICS)]
    covariance: Vec<Covariance>,

    /// How log10 U is averaged along a ray; several, separated by commas, are compared side by side [default:
    /// `u-spread-per-root-ray`, which ranked depth errors best (experiments/depth.md), or `u-spread` for a field that
    /// does not know its ray counts]
    #[arg(
        long,
        value_parser = choice::<RayAverage>(),
        value_delimiter = ',',
        help_heading = heading::STATISTICS,
        hide_short_help = true,
    )]
    ray_average: Vec<RayAverage>,

    /// Two or more models trained like MODEL with other seeds; MODEL may be among them. Evaluates the variance of
    /// their depth
    #[arg(long, value_name = "MODEL", num_args = 2.., help_heading = heading::STATISTICS)]
    ensemble: Vec<String>,

    /// Remove density, or splats, above ten thresholds of log10 U (the first field's first covariance), report how
    /// images change, and write this sheet of pictures before and after
    #[arg(long, value_name = "SHEET.png", help_heading = heading::OUTPUT)]
    clean_up: Option<PathBuf>,

    /// Use every Nth pixel along x and y
    #[arg(
        long,
        value_name = "N",
        default_value_t = Evaluation::STRIDE,
        value_parser = count::<u32>(1..),
        help_heading = heading::INPUT,
        hide_short_help = true,
    )]
    stride: u32,

    /// Calibrate the deviation of depth on these views, and write the field with its interval; for one field of
    /// `--scale data`
    ///
    /// Divides every error of depth by its deviation, and takes the quantile of these ratios that holds the share
    /// --probability of further ones (split conformal prediction). `render`, `query --ray` and `evaluate` then give the
    /// interval. Of pixels drawn like these (this scene, this model, views chosen as these were), it holds at least
    /// that share, whatever the errors' shape. It does not hold for other scenes, for views from other sides, or for a
    /// single pixel. Pixels of one image depend on each other, so views that were left out one by one show how far a
    /// single view may be off. The covariance is the field's own, or the first of --covariance.
    #[arg(long, value_name = "FIELD.oct", help_heading = heading::OUTPUT)]
    calibrate: Option<PathBuf>,

    /// Share of errors that the interval of --calibrate is to hold
    #[arg(
        long,
        value_name = "P",
        default_value_t = Evaluation::PROBABILITY,
        value_parser = parse_probability,
        requires = "calibrate",
        help_heading = heading::STATISTICS,
        hide_short_help = true,
    )]
    probability: f64,

    /// Draw the sparsification curves (mean absolute error) of the five best measures as SVG. Beside them, for fields
    /// of `--scale data`, the reliability of the deviations of depth: the share of errors within the interval that
    /// should hold each share
    #[arg(long, value_name = "PLOT.svg", help_heading = heading::OUTPUT)]
    plot: Option<PathBuf>,

    /// Write all sparsification curves as CSV
    #[arg(long, value_name = "CURVES.csv", help_heading = heading::OUTPUT, hide_short_help = true)]
    csv: Option<PathBuf>,

    /// Use the field even if it was computed for another model
    #[arg(long, help_heading = heading::INPUT, hide_short_help = true)]
    force: bool,

    /// Print one JSON object, with all settings
    #[arg(long, help_heading = heading::OUTPUT)]
    json: bool,
}

impl Args {
    /// Runs the verb.
    pub fn run(mut self, given: &Given, bars: &Bars) -> Result<()> {
        self.cameras.find();
        DepthOptions::check(given, self.depth.is_some() || self.training_depth.is_some())?;
        let files = CommandFiles::default()
            .input("MODEL", &self.model.model)
            .inputs("FIELD", &self.fields)
            .inputs("--ensemble", &self.ensemble)
            .cameras(Some(&self.cameras.cameras))
            .outputs("--plot", &self.plot)
            .outputs("--csv", &self.csv)
            .outputs("--clean-up", &self.clean_up)
            .outputs("--calibrate", &self.calibrate);
        files.check()?;
        let (opened, settings, readings) = self.open()?;
        // Splats of an ensemble are drawn like the model.
        let mode = Splats::of(&*opened.model).map(Splats::mode);
        let open = |name: &String| open_model(name, opened.coordinates, mode.filter(|_| is_of_splats(name)));
        let members = self.ensemble.iter().map(open);
        let members = members.collect::<Result<Vec<_>>>()?;
        let evaluation = Evaluation {
            model: &*opened.model,
            name: self.model.model.clone(),
            settings,
            readings: &readings,
            ensemble: self.ensemble.iter().cloned().zip(members.iter().map(|member| &**member)).collect(),
            cameras: self.cameras.cameras.clone(),
            selection: self.frames.views.clone().unwrap_or_default(),
            stride: self.stride,
            depth: self.maps.files(self.depth.clone()),
            object_masks: self.object_masks.clone(),
            training_depth: self.training_depth.clone(),
            images: self.images.clone(),
            calibrate: self.calibrate.as_ref().map(|_| self.probability),
            clean_up: self.clean_up.is_some(),
            curves: self.plot.is_some() || self.csv.is_some(),
        };
        if !evaluation.judges_depth() {
            given.refuse(&["--ray-average"], "true depth to rank by (--depth)", "--clean-up alone")?;
        }
        let prepared = evaluation.prepare(self.cameras.read()?)?;
        announce!("note: {}", prepared.used);
        prepared.remarks.iter().cloned().for_each(tell);
        files
            .inputs("an image of --cameras", prepared.frames().iter().map(|frame| &frame.image))
            .inputs("--depth", prepared.depth.iter().flat_map(|found| &found.files))
            .inputs("a mask of the object", prepared.frames().iter().filter_map(|frame| frame.object.as_ref()))
            .inputs("an image of --images", prepared.images.iter().flatten().map(|frame| &frame.image))
            .inputs("--training-depth", prepared.training_depth.iter().flat_map(|found| &found.files))
            .check()?;
        let Judged { report, truths, cleaned } = prepared.judge(bars, &mut tell)?;

        let sheet = self.clean_up.as_ref().map(|path| sheet::stage(path, &truths, &cleaned)).transpose()?;
        let plot = self.plot.as_ref().map(|path| curves::plot(&report, path)).transpose()?;
        let csv = self.csv.as_ref().map(|path| curves::csv(&report, path)).transpose()?;
        // All are on the disk before the first gets its name, so that no half set is left.
        let mut files: Vec<AtomicFile> = [sheet, plot, csv].into_iter().flatten().collect();
        files.iter_mut().try_for_each(AtomicFile::sync)?;
        files.into_iter().try_for_each(AtomicFile::commit)?;
        if let (Some(path), Some(interval)) = (&self.calibrate, report.calibrated) {
            readings[0].field.clone().with_conformal(interval.conformal).write(path)?;
        }
        self.print(&report, &readings[0].name)
    }

    /// Opens the fields and their model, and reads the fields in all ways that are requested.
    fn open(&self) -> Result<(OpenedModel, RaySettings, Vec<Reading>)> {
        if let Some(path) = &self.calibrate {
            check_field_name(path)?;
            if self.fields.len() > 1 {
                return Err(Error::setting("--calibrate", "one field", self.fields.len().to_string()));
            }
        }
        let covariances = Some(&self.covariance[..]).filter(|wanted| !wanted.is_empty());
        let averages = Some(&self.ray_average[..]).filter(|wanted| !wanted.is_empty());
        let (mut opened, mut readings) = (None, Vec::new());
        for path in &self.fields {
            let field = open_field(path)?;
            match &opened {
                None => {
                    let model = OpenedModel::of_field(&field, path, &self.model.model, self.force, &mut tell)?;
                    opened = Some((model, image_settings(&field)));
                }
                Some((model, _)) => model.check(&field, path, self.force, &mut tell)?,
            }
            let stem = path.file_stem().unwrap_or_default().to_string_lossy();
            readings.extend(Reading::from_field(&stem, &field, covariances, averages)?);
        }
        let (model, settings) = opened.ok_or_else(|| Error::setting("FIELD.oct", "at least one", "none"))?;
        Ok((model, settings, readings))
    }
}
