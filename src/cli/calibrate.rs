//! `calibrate`: an interval of depth that holds by counting.

use std::path::PathBuf;

use serde_json::json;

use super::belongs::read_field;
use super::files::CommandFiles;
use super::options::{
    CameraFile, DepthOptions, FrameOptions, ModelOptions, check_field_name, depth, parse_probability,
};
use super::progress::Bars;
use crate::Result;
use crate::dataset::{DepthReadings, Frame};
use crate::evaluate::{DepthMeaning, Evaluator, HeldOut, Interval, Reading};
use crate::posterior::Covariance;

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

    /// Folder of true depth maps [default: those that the camera file names, `depth_file_path`]
    #[arg(long, value_name = "DIR")]
    depth: Option<PathBuf>,

    #[command(flatten)]
    maps: DepthOptions,

    /// Covariance by which depths have their deviations, and that the calibrated field has [default: the field's own]
    #[arg(long, value_enum)]
    covariance: Option<Covariance>,

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
        let field = match self.covariance {
            Some(covariance) => field.with_covariance(covariance)?,
            None => field,
        };
        field.depth_posterior()?;
        let views = self.cameras.read()?;
        let all = views.frames.clone();
        let judged = self.frames.held_out(views, &*model)?;
        let frames: Vec<Frame> = judged.iter().step_by(self.every as usize).cloned().collect();
        let found = self.maps.files(self.depth.clone()).find(&self.cameras.cameras, &frames, &all)?;
        let images = judged.iter().map(|frame| &frame.image);
        files.inputs("an image of --cameras", images).inputs("--depth", &found.files).check()?;

        let settings = self.model.image_settings();
        let differentiation = Some(settings.differentiation(&*model, field.lattice())?);
        let readings = [Reading { name: "field".into(), field, averages: Vec::new() }];
        let evaluator =
            Evaluator { differentiation, ..Evaluator::new(settings.tracer(&*model, 0.0, bars)?, &readings) };
        let held_out = HeldOut {
            frames: &found.frames,
            depth: Some(DepthMeaning { encoding: found.encoding, bounds: model.bounds() }),
            background: self.model.rays.background.as_dvec3(),
            pixel_offset: settings.offset_for(&*model),
            stride: self.stride,
        };
        let judged = held_out.evaluate(&evaluator, &found.source, bars, drop)?;
        depth::tell(&judged.depth(&*model)?);
        let few = || judged.too_few(&format!("more pixels of known depth, to hold {}", self.probability));
        let interval = Interval::calibrate(&evaluator, &judged.views, self.probability).ok_or_else(few)?;
        let [reading] = readings;
        reading.field.with_conformal(interval.conformal).write(&self.output)?;
        self.print(&interval, judged.readings)
    }

    fn print(&self, interval: &Interval, readings: DepthReadings) -> Result<()> {
        let Interval { conformal, predicted, left_out } = interval;
        if self.json {
            return say!(
                "{}",
                json!({
                    "output": self.output.to_string_lossy(), "conformal": conformal,
                    "predicted_factor": predicted, "views_left_out": left_out,
                    "depth_readings": readings,
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
