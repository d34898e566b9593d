//! `evaluate`: does the uncertainty rank the depth error?

use std::path::{Path, PathBuf};

use serde_json::json;

use super::options::{CameraFile, ModelOptions, parse_pair};
use super::progress::Bars;
use super::render::{BlendName, check_box};
use super::report;
use crate::dataset::{DepthEncoding, DepthKind, DepthMap, Frame, PosedImage};
use crate::geometry::Camera;
use crate::io::AtomicFile;
use crate::metrics::{ErrorKind, STEPS, Sparsification, psnr, sparsification};
use crate::monitor::{Monitor, check};
use crate::picture::{Curve, write_plot};
use crate::posterior::Covariance;
use crate::render::{Probe, RenderedView, render_view};
use crate::uncertainty::UncertaintyField;
use crate::{Error, Result};

/// Judge fields against true depth: AUSE, depth error, PSNR
///
/// Renders the test views and asks whether pixels of large uncertainty are pixels of large depth error (area under the
/// sparsification error, by the official code's procedure: 100 steps, both curves over their common maximum, trapezoid).
/// Several fields and covariances share the rendering. Depth is compared where the image is fully opaque (alpha 255; images
/// without alpha are opaque everywhere) and the true depth is known.
#[derive(clap::Args)]
#[command(
    after_help = "Example: octobayes evaluate lego.safetensors lego.oct --cameras transforms_test.json --depth test \
    --depth-encoding 8,-8 --plot ause.svg --csv ause.csv"
)]
pub struct Args {
    #[command(flatten)]
    model: ModelOptions,

    /// Fields to judge
    #[arg(value_name = "FIELD.oct", required = true)]
    fields: Vec<PathBuf>,

    #[command(flatten)]
    cameras: CameraFile,

    /// Folder of true depth maps
    #[arg(long, value_name = "DIR")]
    depth: PathBuf,

    /// Name of a frame's depth map; {} is the frame's file name without extension
    #[arg(long, value_name = "PATTERN", default_value = "{}_depth_0001.png")]
    depth_pattern: String,

    /// Depth in scene units = OFFSET + SCALE * p, p in [0, 1] from black to white; p = 0 is unknown
    #[arg(long, value_name = "OFFSET,SCALE", value_parser = parse_pair, allow_hyphen_values = true)]
    depth_encoding: [f64; 2],

    /// Depth maps hold depth along the viewing axis, not distance from the camera
    #[arg(long)]
    z_depth: bool,

    /// Covariances to judge, separated by commas [default: each field's own]
    #[arg(long, value_enum, value_delimiter = ',')]
    covariance: Vec<Covariance>,

    /// Blend log10 U over what the ray hits, or as the official code does (-3 for the part that hits nothing)
    #[arg(long, value_enum, default_value = "hit")]
    blend: BlendName,

    /// Use every Nth pixel along x and y
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    stride: u32,

    /// Use every Nth frame
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    every: u32,

    /// Write the sparsification curves (mean absolute error) as an SVG plot
    #[arg(long, value_name = "PLOT.svg")]
    plot: Option<PathBuf>,

    /// Write all sparsification curves as CSV
    #[arg(long, value_name = "CURVES.csv")]
    csv: Option<PathBuf>,

    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// A field read through one covariance.
struct Reading {
    name: String,
    field: UncertaintyField,
}

/// Pixels of one view that have a true depth.
struct View {
    name: String,
    psnr: f64,
    absolute_error: Vec<f64>,
    /// `[readings][pixels]`: blended log10 U.
    log10_uncertainty: Vec<Vec<f64>>,
    /// Pixels with true depth where the field shows nothing.
    empty: usize,
}

/// Area of one reading, over all pixels together and as the mean over views.
struct Score {
    pooled: Sparsification,
    per_view_mean: f64,
}

impl Args {
    /// Runs the verb.
    pub fn run(self, bars: &Bars) -> Result<()> {
        let model = self.model.open()?;
        let readings = self.readings(&model.bounds())?;
        let views = self.cameras.read()?;
        for path in self.plot.iter().chain(&self.csv) {
            drop(AtomicFile::create(path)?);
        }
        let frames: Vec<&Frame> = views.frames.iter().step_by(self.every as usize).collect();
        let settings = self.model.image_settings();
        let tracer = settings.tracer(&*model, 0.0, bars)?;
        let offset = settings.pixel_offset.unwrap_or_else(|| model.pixel_offset());
        let probed: Vec<_> = readings.iter().map(|r| |x| r.field.log10(x)).collect();
        let probes: Vec<Probe> = probed.iter().map(|log10| Probe { log10, blend: self.blend.into() }).collect();

        let rows = frames.iter().map(|f| u64::from(f.camera.resolution[1].div_ceil(self.stride))).sum();
        bars.begin("rows", rows);
        let mut judged = Vec::new();
        for frame in frames {
            check(bars)?;
            let camera = frame.camera.strided(self.stride, offset);
            let rendered = render_view(&tracer, &camera, offset, &probes, bars)?;
            judged.push(self.judge(frame, &rendered, offset)?);
        }
        bars.end();
        let scores = self.scores(&readings, &judged)?;
        if let Some(path) = &self.plot {
            write_plot(
                path,
                "Mean depth error left, scene units",
                ["removed share of pixels", "mean absolute depth error"],
                &curves(&readings, &scores[0]),
            )?;
        }
        if let Some(path) = &self.csv {
            write_csv(path, &readings, &scores)?;
        }
        self.print(&readings, &judged, &scores)
    }

    fn readings(&self, bounds: &crate::geometry::Aabb) -> Result<Vec<Reading>> {
        let mut readings = Vec::new();
        for path in &self.fields {
            let field = UncertaintyField::read(path)?;
            check_box(&self.model.model, bounds, &field)?;
            let own = [field.protocol().covariance];
            let wanted = if self.covariance.is_empty() { &own[..] } else { &self.covariance };
            for &covariance in wanted {
                let stem = path.file_stem().unwrap_or_default().to_string_lossy();
                let name = format!("{stem} {}", covariance.name());
                readings.push(Reading { name, field: field.clone().with_covariance(covariance)? });
            }
        }
        Ok(readings)
    }

    /// Compares a rendered view with its image and depth map.
    fn judge(&self, frame: &Frame, rendered: &RenderedView, offset: f64) -> Result<View> {
        let image = PosedImage::read(&frame.image, frame.camera.resolution)?;
        let stem = Path::new(&frame.name).file_name().unwrap_or_default().to_string_lossy();
        let stem = [".png", ".jpg", ".jpeg"].iter().fold(&*stem, |s, e| s.trim_end_matches(e));
        let path = self.depth.join(self.depth_pattern.replace("{}", stem));
        let kind = if self.z_depth { DepthKind::Z } else { DepthKind::Euclidean };
        let encoding = DepthEncoding { offset: self.depth_encoding[0], scale: self.depth_encoding[1], kind };
        let truth = DepthMap::read(&path, encoding, &frame.camera, offset)?;

        let background = self.model.background.as_dvec3();
        let [width, _] = rendered.resolution.map(|n| n as usize);
        let full = |i: usize| {
            let stride = self.stride as usize;
            (i / width * stride) * frame.camera.resolution[0] as usize + i % width * stride
        };
        let colors: Vec<_> = rendered.pixels.iter().map(|p| p.color).collect();
        let true_colors: Vec<_> = (0..colors.len()).map(|i| image.over(full(i), background)).collect();
        let mut view = View {
            name: frame.name.clone(),
            psnr: psnr(&colors, &true_colors),
            absolute_error: Vec::new(),
            log10_uncertainty: vec![Vec::new(); rendered.log10_uncertainty.len()],
            empty: 0,
        };
        for (i, pixel) in rendered.pixels.iter().enumerate() {
            let Some(distance) = truth.distance[full(i)].filter(|_| image.is_opaque(full(i))) else { continue };
            if pixel.opacity <= 0.0 {
                view.empty += 1;
                continue;
            }
            view.absolute_error.push((pixel.median_depth - distance).abs());
            for (all, rendered) in view.log10_uncertainty.iter_mut().zip(&rendered.log10_uncertainty) {
                all.push(rendered[i]);
            }
        }
        Ok(view)
    }

    /// `[error kinds][readings]`.
    fn scores(&self, readings: &[Reading], views: &[View]) -> Result<Vec<Vec<Score>>> {
        let errors: Vec<f64> = views.iter().flat_map(|v| &v.absolute_error).copied().collect();
        let score = |kind, reading: usize| {
            let log10: Vec<f64> = views.iter().flat_map(|v| &v.log10_uncertainty[reading]).copied().collect();
            let pooled = sparsification(&log10, &errors, kind)?;
            let areas: Vec<f64> = views
                .iter()
                .filter_map(|v| Some(sparsification(&v.log10_uncertainty[reading], &v.absolute_error, kind)?.area))
                .collect();
            Some(Score { pooled, per_view_mean: areas.iter().sum::<f64>() / areas.len() as f64 })
        };
        let all: Option<Vec<Vec<Score>>> =
            ErrorKind::ALL.iter().map(|&kind| (0..readings.len()).map(|r| score(kind, r)).collect()).collect();
        all.ok_or_else(|| {
            let found = format!("{}", errors.len());
            Error::malformed(
                &self.depth,
                "depth maps",
                format!("at least {STEPS} pixels with depth and some error"),
                found,
            )
        })
    }

    fn print(&self, readings: &[Reading], views: &[View], scores: &[Vec<Score>]) -> Result<()> {
        let mut errors: Vec<f64> = views.iter().flat_map(|v| &v.absolute_error).copied().collect();
        errors.sort_unstable_by(f64::total_cmp);
        let n = errors.len();
        let mean = errors.iter().sum::<f64>() / n as f64;
        let percentile = |share: f64| errors[((share * n as f64) as usize).min(n - 1)];
        let psnr = views.iter().map(|v| v.psnr).sum::<f64>() / views.len() as f64;
        let empty: usize = views.iter().map(|v| v.empty).sum();
        if self.json {
            let scored: Vec<_> = readings
                .iter()
                .enumerate()
                .map(|(r, reading)| {
                    let of = |pick: &dyn Fn(&Score) -> f64| -> serde_json::Value {
                        let named = ErrorKind::ALL.iter().zip(scores);
                        named.map(|(kind, s)| (format!("{kind:?}").to_lowercase(), json!(pick(&s[r])))).collect()
                    };
                    json!({
                        "name": reading.name,
                        "ause_pooled": of(&|s| s.pooled.area),
                        "ause_mean_over_views": of(&|s| s.per_view_mean),
                        "field": report::protocol_json(&reading.field),
                    })
                })
                .collect();
            let value = json!({
                "model": self.model.model, "cameras": self.cameras.cameras, "depth": self.depth,
                "depth_kind": if self.z_depth { "z" } else { "euclidean" }, "stride": self.stride,
                "mask": "alpha 255 and known depth", "alignment": "none", "blend": format!("{:?}", self.blend).to_lowercase(),
                "background": self.model.background.to_array(),
                "views": views.iter().map(|v| json!({ "name": v.name, "psnr": v.psnr, "pixels": v.absolute_error.len() })).collect::<Vec<_>>(),
                "pixels": n, "pixels_without_depth": empty, "psnr": psnr,
                "depth_error": { "median": percentile(0.5), "mean": mean, "percentile_95": percentile(0.95) },
                "readings": scored,
            });
            return say!("{value}");
        }
        for reading in readings {
            say!("{}\n{}", reading.name, report::protocol(&reading.field))?;
        }
        say!("protocol of the evaluation")?;
        say!(
            "  views        {} of {}, every {}. pixel along x and y",
            views.len(),
            self.cameras.cameras.display(),
            self.stride
        )?;
        let kind = if self.z_depth { "along the viewing axis" } else { "Euclidean" };
        say!("  depth        median of the ray's weights, against {kind} depth of {}", self.depth.display())?;
        say!("  mask         alpha 255 and known depth; {empty} pixels left out where the field shows nothing")?;
        say!("  alignment    none")?;
        say!("  U per pixel  log10 U blended `{}`", format!("{:?}", self.blend).to_lowercase())?;
        say!("  AUSE         100 steps, both curves over their common maximum, trapezoid")?;
        say!("PSNR {psnr:.2} dB (mean over views)")?;
        say!(
            "depth error over {n} pixels: median {:.4}, mean {mean:.4}, 95 % {:.4} scene units",
            percentile(0.5),
            percentile(0.95)
        )?;
        say!("AUSE, all pixels together         mae     mse    rmse   | mean over views   mae     mse    rmse")?;
        for (r, reading) in readings.iter().enumerate() {
            let [a, b, c] = [0, 1, 2].map(|k| scores[k][r].pooled.area);
            let [d, e, f] = [0, 1, 2].map(|k| scores[k][r].per_view_mean);
            say!("  {:<28} {a:>7.4} {b:>7.4} {c:>7.4}   |              {d:>7.4} {e:>7.4} {f:>7.4}", reading.name)?;
        }
        Ok(())
    }
}

/// The curves of mean absolute error, in scene units.
fn curves(readings: &[Reading], scores: &[Score]) -> Vec<Curve> {
    let points =
        |s: &Sparsification, values: &[f64]| s.removed.iter().zip(values).map(|(&r, &v)| (r, v * s.largest)).collect();
    let mut curves: Vec<Curve> = readings
        .iter()
        .zip(scores)
        .map(|(reading, score)| Curve {
            name: format!("{} (AUSE {:.3})", reading.name, score.pooled.area),
            points: points(&score.pooled, &score.pooled.by_uncertainty),
            reference: false,
        })
        .collect();
    if let Some(score) = scores.first() {
        let oracle = points(&score.pooled, &score.pooled.by_error);
        curves.push(Curve { name: "oracle: largest errors removed first".into(), points: oracle, reference: true });
    }
    curves
}

/// One row per error kind and removed share; values in scene units.
fn write_csv(path: &Path, readings: &[Reading], scores: &[Vec<Score>]) -> Result<()> {
    let mut file = AtomicFile::create(path)?;
    let mut write = || -> csv::Result<()> {
        let mut csv = csv::Writer::from_writer(&mut file);
        csv.write_record(["error", "removed", "oracle"].into_iter().chain(readings.iter().map(|r| &*r.name)))?;
        for (kind, scores) in ErrorKind::ALL.iter().zip(scores) {
            for k in 0..STEPS {
                let value = |s: &Sparsification, values: &[f64]| (values[k] * s.largest).to_string();
                let first = &scores[0].pooled;
                let head =
                    [format!("{kind:?}").to_lowercase(), first.removed[k].to_string(), value(first, &first.by_error)];
                csv.write_record(
                    head.into_iter().chain(scores.iter().map(|s| value(&s.pooled, &s.pooled.by_uncertainty))),
                )?;
            }
        }
        csv.flush()?;
        Ok(())
    };
    write().map_err(|e| Error::io(path, "cannot write")(e.into()))?;
    file.commit()
}

impl Camera {
    /// The camera whose pixel (i, j) has the ray of this one's pixel (i · stride, j · stride), both at `offset`.
    fn strided(&self, stride: u32, offset: f64) -> Self {
        let s = f64::from(stride);
        Self {
            focal: self.focal.map(|f| f / s),
            center: self.center.map(|c| offset + (c - offset) / s),
            resolution: self.resolution.map(|n| n.div_ceil(stride)),
            ..*self
        }
    }
}
