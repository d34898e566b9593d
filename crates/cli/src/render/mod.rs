//! `render`: pictures of a field and its uncertainty.

mod studio;

use std::path::{Path, PathBuf};

use self::studio::{Cleaned, Studio, StudioView};
use super::files::CommandFiles;
use super::opened::open_field;
use super::options::{
    CameraOptions, Frames, ModelArgument, choice, heading, parse_frames, parse_positive, parse_range,
};
use super::progress::Bars;
use super::streams::tell;
use octobayes::geometry::{Camera, MAX_PIXELS};
use octobayes::monitor::Monitor;
use octobayes::render::RayAverage;
use octobayes::uncertainty::{BakedField, UncertaintyField};
use octobayes::{Error, Result};
use octobayes_data::write_exr;
use octobayes_data::{Frame, Part};
use octobayes_depth::{DepthDeviation, TrainingViews};
use octobayes_evaluation::Reading;
use octobayes_session::memory::baked;
use octobayes_session::{OpenedModel, Threshold, image_settings, scaled};
use octobayes_show::picture::{is_own_sheet, write_sheet};

/// Default longer side of a picture, pixels. A photograph at its own size takes minutes.
const PREVIEW: u32 = 800;

/// Render colour, depth and uncertainty of one view
///
/// OUT.png shows labelled panels for viewing; what no training ray reached is hatched. OUT.exr holds channels for
/// tools: R, G, B, A, depth.Z (median distance from the camera), uncertainty.U (scene units), log10_uncertainty.U (both
/// NaN where A is 0.05 or less, and outside the field's box) and, with --depth-error, depth_error.Z (one standard
/// deviation, scene units), depth_confirmed.Z if the model stores its training cameras (1 where three of them see a
/// surface at that depth, else 0: do not rely on the deviation there) and, if the field is calibrated, depth_interval.Z
/// (half width of the interval).
#[derive(clap::Args)]
#[command(after_help = "Example: octobayes render lego.safetensors lego.oct --cameras transforms_test.json --frame 0 \
    -o view.png")]
pub struct Args {
    #[command(flatten)]
    model: ModelArgument,

    /// Uncertainty of the model
    #[arg(value_name = "FIELD.oct")]
    field: PathBuf,

    #[command(flatten)]
    cameras: CameraOptions,

    /// Frame of the camera file, or camera of the model, counted from 0; or frames A to B - 1: OUT is then a folder,
    /// and pictures are called after their frames
    #[arg(long, value_name = "K|A..B", default_value = "0", value_parser = parse_frames, help_heading = heading::INPUT)]
    frame: Frames,

    /// Size of the picture relative to the camera's image; 1 for its full size [default: 1, or less for a preview
    /// whose longer side has 800 pixels]
    // Scripts that call it `--scale` go on working, and the help has one meaning for that word.
    #[arg(
        long,
        alias = "scale",
        value_name = "FACTOR",
        value_parser = parse_positive,
        conflicts_with = "resolution",
        help_heading = heading::OUTPUT,
    )]
    resize: Option<f64>,

    /// Picture to write, `.png` or `.exr`
    #[arg(short, long, value_name = "OUT", help_heading = heading::OUTPUT)]
    output: PathBuf,

    /// Remove density where log10 U exceeds this (the paper's clean-up), or, as `99%`, what it exceeds on the most
    /// certain 99 percent of visible surfaces; PNG shows both views, EXR the cleaned one
    #[arg(
        long,
        value_name = "LOG10_U|PERCENT%",
        value_parser = Threshold::parse,
        allow_hyphen_values = true,
        help_heading = heading::OUTPUT,
    )]
    threshold: Option<Threshold>,

    /// Ends of the colour bar of log10 U; -3,6 in the official code [default: from the most certain percent of the
    /// visible surfaces to the prior]
    #[arg(
        long,
        value_name = "LOW,HIGH",
        value_parser = parse_range,
        allow_hyphen_values = true,
        help_heading = heading::OUTPUT,
        hide_short_help = true,
    )]
    range: Option<[f64; 2]>,

    /// How log10 U is averaged along a ray
    #[arg(
        long,
        value_parser = choice::<RayAverage>(),
        default_value = RayAverage::default().name(),
        help_heading = heading::OUTPUT,
        hide_short_help = true,
    )]
    ray_average: RayAverage,

    /// Show the standard deviation of depth, too, in scene units; the field must be one of `--scale data`. It follows
    /// from U and from how widely matter is spread along the ray; `depth` also compares the training images
    #[arg(long, help_heading = heading::OUTPUT)]
    depth_error: bool,

    /// Use the field even if it was computed for another model
    #[arg(long, help_heading = heading::INPUT, hide_short_help = true)]
    force: bool,
}

impl Args {
    /// Runs the verb.
    pub fn run(mut self, bars: &Bars) -> Result<()> {
        self.cameras.find(Part::Training);
        self.check_output()?;
        let files = CommandFiles::default()
            .input("MODEL", &self.model.model)
            .input("FIELD", &self.field)
            .cameras(self.cameras.cameras.as_deref())
            .outputs("--output", self.outputs());
        files.check()?;
        let field = open_field(&self.field)?;
        let opened = OpenedModel::of_field(&field, &self.field, &self.model.model, self.force, &mut tell)?;
        let settings = image_settings(&field);
        let views = self.cameras.read(Some(&*opened.model), &opened.name)?;
        files.images(&views).check()?;
        // A frame that is not there is refused before any work.
        let wanted = self.frame.numbers();
        let frames: Vec<&Frame> = wanted.clone().map(|k| views.frame(k)).collect::<Result<_>>()?;
        if self.depth_error {
            DepthDeviation::new(&BakedField::unbaked(&field), None)?;
        }

        Reading::check(&field, self.ray_average)?;
        let cameras: Vec<Camera> = frames.iter().map(|frame| self.sized(&frame.camera)).collect::<Result<_>>()?;
        let pictures = if self.threshold.is_some() { 2 } else { 1 };
        let baked = &baked(&field, pictures * cameras.iter().map(Camera::pixels).sum::<u64>());
        let threshold = self.threshold.map(|threshold| threshold.log10(baked, &mut tell)).transpose()?;
        let model = &*opened.model;
        let whole = model.for_images(&settings, bars)?;
        let part = match threshold.map(|threshold| model.certain_part(baked, threshold)).transpose()? {
            Some(None) => {
                return Err(Error::setting("--threshold", "a threshold that leaves a part of the model", "none left"));
            }
            part => part.flatten(),
        };
        let left = part.as_ref().map(|part| part.for_images(&settings, bars)).transpose()?;
        let offset = settings.offset_for(model);
        let known: Vec<Camera> = model.training_cameras().iter().map(|named| named.camera).collect();
        let is_told = self.depth_error && self.is_exr() && !known.is_empty();
        let shown = left.as_deref().unwrap_or(&*whole);
        let training = is_told.then(|| TrainingViews::render(shown, &known, offset, bars)).transpose()?;
        let cleaned = left.as_deref().zip(threshold).map(|(left, threshold)| Cleaned { left, threshold });
        let studio = Studio {
            field: &field,
            baked,
            whole: &*whole,
            cleaned,
            offset,
            average: self.ray_average,
            depth_error: self.depth_error,
            training,
            log10: bar_of(baked, self.range),
            bars,
        };
        bars.begin("rows", cameras.iter().map(|camera| pictures * u64::from(camera.resolution[1])).sum());
        let all = cameras.len();
        for (done, ((k, camera), path)) in wanted.zip(&cameras).zip(self.outputs()).enumerate() {
            self.picture(&studio, k, camera, &path).map_err(|error| match error {
                Error::Interrupted if done > 0 => Error::InterruptedAfter {
                    finished: format!("{} holds {done} of {all} frames", self.output.display()),
                },
                other => other,
            })?;
        }
        bars.end();
        say!("{}", self.output.display())
    }

    /// Checks the kind of the output, and makes the folder of several.
    fn check_output(&self) -> Result<()> {
        if self.frame.are_many() {
            if let Some(path) = self.outputs().into_iter().find(|path| path.exists() && !is_own_sheet(path)) {
                let expected = "a folder without frames of other programs, which those of `render` would replace";
                return Err(Error::setting("--output", expected, path.display().to_string()));
            }
            return std::fs::create_dir_all(&self.output).map_err(Error::io(&self.output, "cannot create the folder"));
        }
        let extension = self.output.extension().and_then(|e| e.to_str());
        if matches!(extension, Some("png" | "exr")) {
            if extension == Some("exr") && self.range.is_some() {
                let found = self.output.display().to_string();
                return Err(Error::setting("--range", "a picture with a colour bar, `.png`", found));
            }
            return Ok(());
        }
        Err(Error::extension(&self.output, "`.png` or `.exr`"))
    }

    /// The files to write, in the order of the frames.
    fn outputs(&self) -> Vec<PathBuf> {
        if self.frame.are_many() {
            return self.frame.numbers().map(|k| self.output.join(format!("frame_{k:04}.png"))).collect();
        }
        vec![self.output.clone()]
    }

    /// Whether the output holds channels for tools.
    fn is_exr(&self) -> bool {
        !self.frame.are_many() && self.output.extension().is_some_and(|extension| extension == "exr")
    }

    /// Writes the picture of one camera.
    fn picture(&self, studio: &Studio, k: usize, camera: &Camera, path: &Path) -> Result<()> {
        let write = |view: &StudioView| {
            let rendered = &view.rendered;
            let (log10, confirmed) = (studio.shown_log10(camera, rendered), studio.confirmed(camera, rendered));
            write_exr(path, rendered.resolution, channels(view, &log10, confirmed.as_deref(), studio.field))
        };
        if let (true, Some(Threshold::Log10(_))) = (self.is_exr(), self.threshold) {
            // An EXR holds the cleaned view only; to count what the threshold removes takes both views.
            let view = studio.cleaned_view(camera)?.unwrap_or_default();
            if view.rendered.pixels.iter().all(|pixel| pixel.opacity <= 0.5) {
                self.note_pixels(studio, &(studio.whole_view(camera)?, Some(view.clone())));
            }
            return write(&view);
        }
        let views = studio.views(camera)?;
        self.note_pixels(studio, &views);
        if !self.is_exr() {
            return write_sheet(path, &studio.rows(&format!("frame {k}"), camera, &views));
        }
        let (view, cleaned) = views;
        write(&cleaned.unwrap_or(view))
    }
}

impl Args {
    /// Says on stderr if the clean-up takes many more of a view's pixels than it seems to.
    fn note_pixels(&self, studio: &Studio, views: &(StudioView, Option<StudioView>)) {
        if let (Some(threshold), (view, Some(cleaned))) = (self.threshold, views) {
            threshold.note_pixels(&view.rendered, &cleaned.rendered, studio.baked, &mut tell);
        }
    }

    /// The camera at the size of the picture. Says so on stderr if that is a preview.
    fn sized(&self, camera: &Camera) -> Result<Camera> {
        let longest = camera.resolution.into_iter().max().unwrap_or(1);
        let shown = match self.resize {
            Some(factor) => scaled(camera, factor),
            None if self.cameras.resolution.is_none() && longest > PREVIEW => {
                scaled(camera, f64::from(PREVIEW) / f64::from(longest))
            }
            None => return Ok(*camera),
        };
        let [[w, h], [full_w, full_h]] = [shown.resolution, camera.resolution];
        let pixels = f64::from(w) * f64::from(h);
        if pixels > MAX_PIXELS {
            return Err(Error::setting("--resize", format!("at most {MAX_PIXELS:e} pixels"), format!("{w} x {h}")));
        }
        if self.resize.is_none() {
            announce!("note: a preview of {w} x {h} pixels; --resize 1 renders all {full_w} x {full_h}");
        }
        Ok(shown)
    }
}

/// Ends of the colour bar of log10 U: those given, or from the most certain percent of the visible
/// surfaces to the prior.
pub fn bar_of(field: &BakedField, range: Option<[f64; 2]>) -> [f64; 2] {
    range.unwrap_or_else(|| {
        let prior = field.field().prior().log10();
        let [low] = field.surface_quantiles([0.01]).unwrap_or([-3.0]);
        [low.min(prior - 0.5), prior]
    })
}

/// The channels of the EXR, with `log10` of U, and whether depths are confirmed.
fn channels(
    StudioView { rendered, deviation }: &StudioView,
    log10: &[f64],
    confirmed: Option<&[bool]>,
    field: &UncertaintyField,
) -> Vec<(&'static str, Vec<f32>)> {
    let of_pixel =
        |value: &dyn Fn(&octobayes::render::Pixel) -> f64| rendered.pixels.iter().map(|p| value(p) as f32).collect();
    let mut channels = vec![
        ("R", of_pixel(&|p| p.color.x)),
        ("G", of_pixel(&|p| p.color.y)),
        ("B", of_pixel(&|p| p.color.z)),
        ("A", of_pixel(&|p| p.opacity)),
        ("depth.Z", of_pixel(&|p| p.median_depth)),
        ("uncertainty.U", log10.iter().map(|&u| 10_f64.powf(u) as f32).collect()),
        ("log10_uncertainty.U", log10.iter().map(|&u| u as f32).collect()),
    ];
    let times = |factor: f64| deviation.as_ref().map(|all| all.iter().map(|s| (factor * s) as f32).collect());
    channels.extend(times(1.0).map(|errors| ("depth_error.Z", errors)));
    let confirmed = confirmed.map(|all| all.iter().map(|is| f32::from(u8::from(*is))).collect());
    channels.extend(confirmed.map(|confirmed| ("depth_confirmed.Z", confirmed)));
    let interval = field.conformal().and_then(|conformal| times(conformal.factor));
    channels.extend(interval.map(|interval| ("depth_interval.Z", interval)));
    channels
}
