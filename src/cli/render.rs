//! `render`: pictures of a field and its uncertainty.

use std::path::PathBuf;

use super::belongs::check_model;
use super::files::CommandFiles;
use super::options::{CameraOptions, ModelOptions, Threshold, parse_positive, parse_range, scaled};
use super::panels::{Ranges, depth_range, error_range, unknown, view_panels};
use super::progress::Bars;
use super::report;
use crate::dataset::Part;
use crate::field::RadianceField;
use crate::geometry::{Aabb, Camera, MAX_PIXELS};
use crate::io::write_exr;
use crate::monitor::Monitor;
use crate::picture::write_sheet;
use crate::posterior::Covariance;
use crate::render::{DepthProbe, Probe, RayAverage, RenderedView, render_view, render_view_with_depth};
use crate::uncertainty::{ThresholdedField, UncertaintyField};
use crate::{Error, Result};

/// Longer side of a picture if nobody asks for another, pixels. A photograph at its own size takes minutes.
const PREVIEW: u32 = 800;

/// Render colour, depth and uncertainty of one view
///
/// OUT.png shows labelled panels for viewing; what no training ray reached is hatched. OUT.exr holds channels for
/// tools: R, G, B, A, depth.Z (median distance from the camera), uncertainty.U (scene units),
/// log10_uncertainty.U and, with --depth-error, depth_error.Z (one standard deviation, scene units).
#[derive(clap::Args)]
#[command(
    after_help = "Example: octobayes render lego.safetensors lego.oct --cameras transforms_test.json --frame 0 -o view.png"
)]
pub struct Args {
    #[command(flatten)]
    model: ModelOptions,

    /// Uncertainty of the model
    #[arg(value_name = "FIELD.oct")]
    field: PathBuf,

    #[command(flatten)]
    cameras: CameraOptions,

    /// Frame of the camera file, or camera of the model, counted from 0
    #[arg(long, value_name = "K", default_value_t = 0)]
    frame: usize,

    /// Size of the picture relative to the camera's image; 1 for its full size [default: 1, or less for a preview
    /// whose longer side has 800 pixels]
    #[arg(long, value_name = "FACTOR", value_parser = parse_positive, conflicts_with = "resolution")]
    scale: Option<f64>,

    /// Picture to write, `.png` or `.exr`
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,

    /// Remove density where log10 U exceeds this (the paper's clean-up), or, as `99%`, what it exceeds on the most
    /// certain 99 percent of visible surfaces; PNG shows both views, EXR the cleaned one
    #[arg(long, value_name = "LOG10_U|PERCENT%", value_parser = Threshold::parse, allow_hyphen_values = true)]
    threshold: Option<Threshold>,

    /// Ends of the colour bar of log10 U; -3,6 in the official code [default: from the most certain percent of the
    /// visible surfaces to the prior]
    #[arg(long, value_name = "LOW,HIGH", value_parser = parse_range, allow_hyphen_values = true)]
    range: Option<[f64; 2]>,

    /// How log10 U is averaged along a ray
    #[arg(long, value_enum, default_value = "weighted-mean")]
    ray_average: RayAverage,

    /// Read another covariance than the field's own; the field must keep its sums
    #[arg(long, value_enum)]
    covariance: Option<Covariance>,

    /// Show the standard deviation of depth, too, in scene units; the field must be one of `--scale data`. It joins
    /// what the training images leave open (matter that could be elsewhere) and how widely matter is spread along the
    /// ray
    #[arg(long)]
    depth_error: bool,

    /// Use the field even if it was computed for another model
    #[arg(long)]
    force: bool,

    /// Print the protocol of the field, too
    #[arg(long)]
    verbose: bool,
}

impl Args {
    /// Runs the verb.
    pub fn run(mut self, bars: &Bars) -> Result<()> {
        self.cameras.find(Part::Training);
        let as_exr = match self.output.extension().and_then(|e| e.to_str()) {
            Some("png") => false,
            Some("exr") => true,
            _ => return Err(Error::malformed(&self.output, "file name", "`.png` or `.exr`", "another extension")),
        };
        let files = CommandFiles::default()
            .input("MODEL", &self.model.model)
            .input("FIELD", &self.field)
            .cameras(self.cameras.cameras.as_deref())
            .output("--output", &self.output);
        files.check()?;
        let model = self.model.open()?;
        let mut field = UncertaintyField::read(&self.field)?;
        if let Some(covariance) = self.covariance {
            field = field.with_covariance(covariance)?;
        }
        check_box(&self.model.model, &model.bounds(), &field)?;
        check_model(&self.model, &self.field, &field, self.force)?;
        let views = self.cameras.read(&*model, &self.model.model)?;
        files.images(&views).check()?;
        let camera = self.sized(&views.frame(self.frame)?.camera)?;

        let uncertainty = &field;
        let log10 = |x| field.log10(x);
        let probes = [Probe { value: &log10, averages: &[self.ray_average] }];
        let settings = self.model.image_settings();
        let offset = settings.pixel_offset.unwrap_or_else(|| model.pixel_offset());
        let posterior = self.depth_error.then(|| field.depth_posterior()).transpose()?;
        let picture = |field: &dyn RadianceField| -> Result<RenderedView> {
            let tracer = settings.tracer(field, 0.0, bars)?;
            bars.begin("rows", u64::from(camera.resolution[1]));
            let view = if let Some(posterior) = &posterior {
                let differentiation = settings.differentiation(tracer.field, uncertainty.lattice())?;
                let depth = DepthProbe { differentiation, variances: &[posterior] };
                render_view_with_depth(&tracer, &camera, offset, &probes, &depth, bars)?
            } else {
                render_view(&tracer, &camera, offset, &probes, bars)?
            };
            bars.end();
            Ok(view)
        };
        let threshold = self.threshold.map(|threshold| threshold.log10(&field)).transpose()?;
        let cleaned = match threshold {
            Some(threshold) => Some(picture(&ThresholdedField { field: &*model, uncertainty: &field, threshold })?),
            None => None,
        };
        // An EXR holds the cleaned view only, but what a share takes is told by both.
        let is_shown = !as_exr || !matches!(self.threshold, Some(Threshold::Log10(_)));
        let view = is_shown.then(|| picture(&*model)).transpose()?;
        if let (Some(threshold), Some(view), Some(cleaned)) = (self.threshold, &view, &cleaned) {
            threshold.note_pixels(view, cleaned);
        }
        if as_exr {
            let view = cleaned.or(view).expect("one of them is rendered");
            write_exr(&self.output, view.resolution, channels(&view))?;
        } else if let Some(view) = view {
            let unknown = |view: &RenderedView, i: usize| unknown(&field, &camera, offset, view, i);
            let depth = depth_range([&view].into_iter().chain(&cleaned));
            let prior = field.prior().log10();
            let log10 = bar_of(&field, self.range);
            let error = error_range([&view].into_iter().chain(&cleaned));
            let ranges = Ranges { depth, error, log10, prior, quantity: field.protocol().scale.quantity() };
            let mut rows = vec![view_panels(&view, &format!("frame {}", self.frame), ranges, &|i| unknown(&view, i))];
            if let (Some(cleaned), Some(threshold)) = (&cleaned, threshold) {
                rows.push(view_panels(cleaned, &format!("log10 U <= {threshold:.3}"), ranges, &|i| {
                    unknown(cleaned, i)
                }));
            }
            write_sheet(&self.output, &rows)?;
        }
        say!("{}", self.output.display())?;
        if self.verbose {
            say!("protocol of the field\n{}{}", report::protocol(&field), report::surfaces(&field))?;
        }
        Ok(())
    }
}

impl Args {
    /// The camera at the size of the picture. Says so on stderr if that is a preview.
    fn sized(&self, camera: &Camera) -> Result<Camera> {
        let longest = camera.resolution.into_iter().max().unwrap_or(1);
        let shown = match self.scale {
            Some(scale) => scaled(camera, scale),
            None if self.cameras.resolution.is_none() && longest > PREVIEW => {
                scaled(camera, f64::from(PREVIEW) / f64::from(longest))
            }
            None => return Ok(*camera),
        };
        let [[w, h], [full_w, full_h]] = [shown.resolution, camera.resolution];
        let pixels = f64::from(w) * f64::from(h);
        if pixels > MAX_PIXELS {
            return Err(Error::setting("--scale", format!("at most {MAX_PIXELS:e} pixels"), format!("{w} x {h}")));
        }
        if self.scale.is_none() {
            eprintln!("note: a preview of {w} x {h} pixels; --scale 1 renders all {full_w} x {full_h}");
        }
        Ok(shown)
    }
}

/// Ends of the colour bar of log10 U: those that are asked for, or from the most certain percent of the visible surfaces to
/// the prior.
pub fn bar_of(field: &UncertaintyField, range: Option<[f64; 2]>) -> [f64; 2] {
    range.unwrap_or_else(|| {
        let prior = field.prior().log10();
        let [low] = field.surface_quantiles([0.01]).unwrap_or([-3.0]);
        [low.min(prior - 0.5), prior]
    })
}

/// Refuses a field whose box does not lie in the model's.
pub fn check_box(name: &str, model: &Aabb, field: &UncertaintyField) -> Result<()> {
    // A contracted field covers all of space.
    let Some(bounds) = field.lattice().domain().bounds() else { return Ok(()) };
    // Some files store boxes as f32.
    let slack = 1e-5 * model.longest_edge();
    let inside =
        (bounds.min() - model.min()).min_element() >= -slack && (model.max() - bounds.max()).min_element() >= -slack;
    if inside {
        return Ok(());
    }
    let text = |b: &Aabb| format!("{} to {}", b.min(), b.max());
    Err(Error::setting(
        format!("box of the field for `{name}`"),
        format!("inside the model's, {}", text(model)),
        text(bounds),
    ))
}

/// The channels of the EXR.
fn channels(view: &RenderedView) -> Vec<(&'static str, Vec<f32>)> {
    let of_pixel = |value: &dyn Fn(&crate::render::Pixel) -> f64| view.pixels.iter().map(|p| value(p) as f32).collect();
    let log10 = &view.log10_uncertainty[0];
    let mut channels = vec![
        ("R", of_pixel(&|p| p.color.x)),
        ("G", of_pixel(&|p| p.color.y)),
        ("B", of_pixel(&|p| p.color.z)),
        ("A", of_pixel(&|p| p.opacity)),
        ("depth.Z", of_pixel(&|p| p.median_depth)),
        ("uncertainty.U", log10.iter().map(|&u| 10_f64.powf(u) as f32).collect()),
        ("log10_uncertainty.U", log10.iter().map(|&u| u as f32).collect()),
    ];
    let errors = view.depth_deviation.iter().map(|of_pixels| of_pixels.iter().map(|&s| s as f32).collect());
    channels.extend(errors.map(|errors| ("depth_error.Z", errors)));
    channels
}
