//! `calibrate`: an interval of depth that holds by counting.

use std::path::PathBuf;

use serde_json::json;

use super::belongs::read_field;
use super::files::CommandFiles;
use super::options::{CameraFile, DepthOptions, FrameOptions, ModelOptions, check_field_name, parse_probability};
use super::progress::Bars;
use crate::evaluate::{DepthError, EvaluatedView, Evaluator, Interval, Reading, TrueView};
use crate::monitor::Monitor;
use crate::render::RenderedView;
use crate::{Error, Result};

/// Calibrate the deviation of depth on held-out views of known depth
///
/// Renders the views, divides every error of depth by its deviation, and takes the quantile of these ratios that holds
/// the share --probability of further ones (split conformal prediction). OUT.oct is the field with this factor;
/// `render --depth-error`, `query --ray` and `evaluate` then give the interval.
///
/// What this promises: of pixels drawn like these (this scene, this model, views chosen as these were), the interval
/// holds at least that share, whatever the errors' shape. What it does not: anything of other scenes or of views from
/// other sides, or of a single pixel. Pixels of one image depend on each other, so views that were left out one by one
/// show how far a single view may be off.
#[derive(clap::Args)]
#[command(
    after_help = "Example: octobayes calibrate bunny.safetensors bunny.oct --cameras bunny/transforms_test.json \
    --depth bunny/depth --depth-pattern {}.png --depth-encoding 0,6.5535 --every 2 -o calibrated.oct"
)]
pub struct Args {
    #[command(flatten)]
    model: ModelOptions,

    /// A field of `--scale data`
    #[arg(value_name = "FIELD.oct")]
    field: PathBuf,

    #[command(flatten)]
    cameras: CameraFile,

    #[command(flatten)]
    frames: FrameOptions,

    /// Folder of true depth maps
    #[arg(long, value_name = "DIR")]
    depth: PathBuf,

    #[command(flatten)]
    maps: DepthOptions,

    /// Share of errors that the interval is to hold
    #[arg(long, value_name = "P", default_value = "0.9", value_parser = parse_probability)]
    probability: f64,

    /// Use every Nth pixel along x and y
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..))]
    stride: u32,

    /// Use every Nth frame
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    every: u32,

    /// The calibrated field
    #[arg(short, long, value_name = "OUT.oct")]
    output: PathBuf,

    /// Use the field even if it was computed for another model
    #[arg(long)]
    force: bool,

    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

impl Args {
    /// Runs the verb.
    pub fn run(mut self, bars: &Bars) -> Result<()> {
        self.cameras.find();
        check_field_name(&self.output)?;
        let files = CommandFiles::default()
            .input("MODEL", &self.model.model)
            .input("FIELD", &self.field)
            .cameras(Some(&self.cameras.cameras))
            .output("--output", &self.output);
        files.check()?;
        let model = self.model.open()?;
        let field = read_field(&self.field, &self.model, &*model, self.force)?;
        field.depth_posterior()?;
        let frames = self.cameras.held_out(&self.frames, &*model)?;
        let maps = self.maps.files(self.depth.clone())?;
        let images = frames.iter().map(|frame| &frame.image);
        files
            .inputs("an image of --cameras", images)
            .inputs("--depth", frames.iter().map(|f| maps.path(&f.name)))
            .check()?;

        let settings = self.model.image_settings();
        let differentiation = Some(settings.differentiation(&*model, field.lattice())?);
        let readings = [Reading { name: "field".into(), field, averages: Vec::new() }];
        let evaluator =
            Evaluator { differentiation, ..Evaluator::new(settings.tracer(&*model, 0.0, bars)?, &readings) };
        let offset = settings.offset_for(&*model);
        let frames: Vec<_> = frames.iter().step_by(self.every as usize).collect();
        bars.begin("rows", frames.iter().map(|f| u64::from(f.camera.resolution[1].div_ceil(self.stride))).sum());
        let (mut views, mut otherwise) = (Vec::new(), Vec::new());
        for (seed, frame) in (0..).zip(frames) {
            let truth = TrueView::read(frame, Some(&maps), self.model.rays.background.as_dvec3(), offset, self.stride)?;
            let view = evaluator.evaluate(&truth, seed, bars)?;
            let other = truth.distance_if_not(self.maps.kind());
            let error = |&i: &usize| Some((view.rendered.pixels[i].median_depth - other[i]?).abs());
            otherwise.extend(view.pixels.iter().filter_map(error));
            views.push(EvaluatedView { rendered: RenderedView::default(), ..view });
        }
        bars.end();
        if let Some(depth) = DepthError::new(&views) {
            self.maps.note_kind(&depth, otherwise);
        }
        let interval = Interval::calibrate(&evaluator, &views, self.probability).ok_or_else(|| {
            let pixels: usize = views.iter().map(|view| view.absolute_error.len()).sum();
            let expected = format!("more pixels of known depth, to hold {}", self.probability);
            Error::malformed(&self.depth, "depth maps", expected, format!("{pixels} pixels of {} views", views.len()))
        })?;
        let [reading] = readings;
        reading.field.with_conformal(interval.conformal).write(&self.output)?;
        self.print(&interval)
    }

    fn print(&self, interval: &Interval) -> Result<()> {
        let Interval { conformal, predicted, left_out } = interval;
        if self.json {
            return say!(
                "{}",
                json!({
                    "output": self.output.to_string_lossy(), "conformal": conformal,
                    "predicted_factor": predicted, "views_left_out": left_out,
                })
            );
        }
        let percent = 100.0 * conformal.probability;
        say!("{}", self.output.display())?;
        say!(
            "{percent:.0} % of depth errors are below {:.3} deviations: {} pixels of {} views",
            conformal.factor,
            conformal.pixels,
            conformal.views
        )?;
        say!("without calibration, as Student's t with five degrees of freedom: {predicted:.3} deviations")?;
        let [least, middle, most] = left_out.map(|share| 100.0 * share);
        if conformal.views > 1 {
            say!(
                "a view, calibrated on the others: {least:.1} to {most:.1} % lie within, in the middle {middle:.1} %"
            )?;
        }
        Ok(())
    }
}
