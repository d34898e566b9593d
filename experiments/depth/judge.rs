//! One model: its uncertainty, the errors of its depth on held-out views, and what everything said of them.

use std::path::Path;

use glam::DVec3;
use octobayes::dataset::{DepthEncoding, DepthKind, Frame, Views};
use octobayes::estimate::{Estimation, GridSettings, RaySettings};
use octobayes::evaluate::{
    Baseline, DepthError, DepthFiles, EvaluatedView, Evaluator, Measure, Misfit, Reading, TrainingViews, TrueView,
};
use octobayes::field::RadianceField;
use octobayes::geometry::Lattice;
use octobayes::metrics::{Calibration, Detection, ErrorDensity, ErrorKind, PROBABILITIES, sparsification, spearman};
use octobayes::monitor::Silent;
use octobayes::posterior::{Covariance, DataScale, Scale};
use octobayes::render::{GradientMethod, RayAverage};
use octobayes::synth::DEPTH_PNG_SCALE;
use octobayes::uncertainty::UncertaintyField;
use octobayes::{Error, Result};
use serde::{Deserialize, Serialize};

use crate::candidates::candidates;
use crate::common::clock::Clock;
use crate::common::table::mean;
use crate::scene::{Model, Scene};

/// Levels of the readings; the deviation of depth is that of the first.
pub const LEVELS: [u8; 3] = [7, 6, 5];
/// Level of the vertices that residuals of training images are spread to.
const MISFIT_LEVEL: u8 = 6;
/// Every so many pixels of a held-out view are compared, along x and y.
pub const STRIDE: u32 = 2;
/// About so many pixels are kept of each model, for fits over scenes.
const KEPT: usize = 4000;

/// What is known of a pixel.
#[derive(Clone, Copy, Serialize, Deserialize)]
pub struct Kept {
    /// Absolute error of depth, scene units.
    pub error: f32,
    /// Variance of the ray's weights, and that of the posterior, squared scene units.
    pub weights: f32,
    pub posterior: f32,
    /// Residual of training images there, colours from 0 to 1.
    pub misfit: f32,
}

/// How well a measure ranks errors, and tells what was never seen.
#[derive(Clone, Serialize, Deserialize)]
pub struct Scored {
    pub name: String,
    /// AUSE by mean absolute and by root mean square error, of all pixels together.
    pub mae: f64,
    pub rmse: f64,
    /// Rank correlation with the error: of all pixels together, and the mean over views.
    pub spearman: [f64; 2],
    pub never_seen: Option<Detection>,
}

/// One deviation of depth, by one density of errors.
#[derive(Clone, Serialize, Deserialize)]
pub struct Bar {
    /// Shares of errors within the intervals of [`PROBABILITIES`].
    pub held: [f64; PROBABILITIES.len()],
    pub auce: f64,
    /// With the deviations as they are, and with the best common scale.
    pub nll: [f64; 2],
}

/// One model.
#[derive(Clone, Serialize, Deserialize)]
pub struct Row {
    pub psnr: f64,
    /// Median error of depth, scene units.
    pub error: f64,
    /// By [`ErrorDensity::PREDICTIVE`] and as if errors were normal; then the ray's weights alone, by the former.
    pub bars: [Bar; 3],
    pub scored: Vec<Scored>,
    pub kept: Vec<Kept>,
    /// Processor seconds: training, uncertainty at the first level, evaluation.
    pub seconds: [f64; 3],
}

pub fn grid() -> GridSettings {
    GridSettings::default().level(LEVELS[0]).covariance(Covariance::Block).keep_sums(true)
}

pub fn rays() -> RaySettings {
    RaySettings::default().rays(480_000).gradient(GradientMethod::Auto)
}

/// Trains a scene's model and judges it.
pub fn measure(scene: &Scene, seed: u64) -> Result<Row> {
    let folder = tempfile::tempdir().map_err(Error::io(Path::new("a temporary folder"), "cannot create"))?;
    let clock = Clock::start();
    let model = scene.train(folder.path(), seed)?;
    let trained = clock.elapsed().cpu;
    let data = DataScale::from_cameras(&model.cameras, DataScale::noise_of(model.psnr), &model.domain)?;
    let mut fields = Vec::new();
    let mut summed = 0.0;
    for level in LEVELS {
        let clock = Clock::start();
        let grid = grid().level(level).scale(Scale::Data(data));
        let estimation = Estimation::new(&model.field, &model.cameras).rays(rays().seed(seed)).grid(grid);
        fields.push(estimation.run()?.field);
        if level == LEVELS[0] {
            summed = clock.elapsed().cpu;
        }
    }
    let clock = Clock::start();
    let mut row = judge(&model, fields)?;
    row.seconds = [trained, summed, clock.elapsed().cpu];
    Ok(row)
}

/// The readings of the levels by `block`, and the first by `diagonal`.
fn readings(fields: Vec<UncertaintyField>) -> Result<Vec<Reading>> {
    let mut readings = Vec::new();
    let diagonal = fields[0].clone().with_covariance(Covariance::Diagonal)?;
    for (field, level) in fields.into_iter().zip(LEVELS) {
        readings.push(Reading { name: format!("block {level}"), field, averages: averages() });
    }
    readings.push(Reading { name: format!("diagonal {}", LEVELS[0]), field: diagonal, averages: averages() });
    Ok(readings)
}

fn averages() -> Vec<RayAverage> {
    vec![RayAverage::Spread, RayAverage::AtExpected]
}

fn judge(model: &Model, fields: Vec<UncertaintyField>) -> Result<Row> {
    let settings = RaySettings::for_images();
    let field = &model.field;
    let differentiation = settings.differentiation(field, fields[0].lattice())?;
    let tracer = settings.tracer(field, 0.0, &Silent)?;
    let training = TrainingViews::render(&tracer, &model.cameras, field.pixel_offset(), &Silent)?;
    let lattice = Lattice::new(field.bounds(), MISFIT_LEVEL)?;
    let misfit = Misfit::new(&tracer, &model.images, lattice, &Silent)?;
    let readings = readings(fields)?;
    let evaluator = Evaluator {
        differentiation: Some(differentiation),
        training: Some(&training),
        misfit: Some(&misfit),
        ..Evaluator::new(tracer, &readings)
    };
    let encoding = DepthEncoding { offset: 0.0, scale: DEPTH_PNG_SCALE, kind: DepthKind::Euclidean };
    let depth = DepthFiles { folder: model.folder.join("depth"), pattern: "{}.png".into(), encoding };
    let frames: Vec<Frame> = Views::read(&model.folder.join("transforms_test.json"), None)?.frames;
    let (mut views, mut unseen) = (Vec::new(), Vec::new());
    for (seed, frame) in (0..).zip(&frames) {
        let truth = TrueView::read(frame, Some(&depth), DVec3::ONE, field.pixel_offset(), STRIDE)?;
        let view = evaluator.evaluate(&truth, seed, &Silent)?;
        let width = truth.camera.resolution[0] as usize;
        let never_seen = |&i: &usize| {
            let [x, y] = [i % width, i / width].map(|n| n as f64 + truth.pixel_offset);
            truth.distance[i].is_some_and(|t| !model.was_seen(truth.camera.ray(x, y).at(t)))
        };
        unseen.extend(view.pixels.iter().map(never_seen));
        views.push(view);
    }
    row(&evaluator, &views, &unseen)
        .ok_or_else(|| Error::malformed(&model.folder, "views", "errors of depth, and finite deviations", "none"))
}

fn row(evaluator: &Evaluator, views: &[EvaluatedView], unseen: &[bool]) -> Option<Row> {
    let measures = evaluator.measures();
    let index = |measure| measures.iter().position(|found| *found == measure);
    let errors: Vec<f64> = views.iter().flat_map(|view| &view.absolute_error).copied().collect();
    let pooled = |m: usize| -> Vec<f64> { views.iter().flat_map(|view| &view.measures[m]).copied().collect() };
    let least = evaluator.tracer.marcher.step.powi(2) / 12.0;
    let weights: Vec<f64> =
        pooled(index(Measure::Baseline(Baseline::RayVariance))?).iter().map(|v| v + least).collect();
    let deviation = pooled(index(Measure::DepthDeviation(0))?);
    let posterior: Vec<f64> = deviation.iter().zip(&weights).map(|(d, w)| (d * d - w).max(0.0)).collect();
    let misfit = pooled(index(Measure::Baseline(Baseline::Misfit))?);
    let named = measures.iter().map(|&measure| evaluator.name(measure)).zip((0..).map(pooled));
    let mut all: Vec<(String, Vec<f64>)> = named.take(measures.len()).collect();
    candidates(&mut all, &weights, &posterior);
    let counts: Vec<usize> = views.iter().map(|view| view.absolute_error.len()).collect();
    let scored = all.iter().map(|(name, values)| score(name, values, &errors, &counts, unseen));
    let every = errors.len().div_ceil(KEPT);
    let kept = |i: usize| Kept {
        error: errors[i] as f32,
        weights: weights[i] as f32,
        posterior: posterior[i] as f32,
        misfit: misfit[i] as f32,
    };
    let full = Calibration::new(&errors, &deviation)?;
    let alone = Calibration::new(&errors, &weights.iter().map(|w| w.sqrt()).collect::<Vec<_>>())?;
    let bar = |calibration: &Calibration, density| {
        let found = calibration.of(density);
        let nll = [found.nll, found.nll_best_scale];
        Bar { held: found.coverage.map(|[_, share]| share), auce: found.auce, nll }
    };
    Some(Row {
        psnr: mean(&views.iter().map(|view| view.psnr).collect::<Vec<_>>()),
        error: DepthError::new(views)?.median,
        bars: [
            bar(&full, ErrorDensity::PREDICTIVE),
            bar(&full, ErrorDensity::Gauss),
            bar(&alone, ErrorDensity::PREDICTIVE),
        ],
        scored: scored.collect::<Option<_>>()?,
        kept: (0..errors.len()).step_by(every).map(kept).collect(),
        seconds: [0.0; 3],
    })
}

fn score(name: &str, values: &[f64], errors: &[f64], counts: &[usize], unseen: &[bool]) -> Option<Scored> {
    let area = |kind| sparsification(values, errors, kind).map(|found| found.area);
    let (mut per_view, mut start) = (Vec::new(), 0);
    for count in counts {
        per_view.extend(spearman(&values[start..start + count], &errors[start..start + count]));
        start += count;
    }
    Some(Scored {
        name: name.into(),
        mae: area(ErrorKind::Mae)?,
        rmse: area(ErrorKind::Rmse)?,
        spearman: [spearman(values, errors).unwrap_or(0.0), mean(&per_view)],
        never_seen: Detection::new(values, unseen),
    })
}
