//! One model: its uncertainty, the errors of its depth on held-out views, and what everything said of them.

use std::path::Path;

use octobayes::estimate::{Estimation, GridSettings, RaySettings};
use octobayes::field::TrainedField;
use octobayes::geometry::Domain;
use octobayes::monitor::Silent;
use octobayes::posterior::{Covariance, DataScale, Scale};
use octobayes::render::{GradientMethod, RayAverage, Renderer, VolumeRenderer};
use octobayes::uncertainty::UncertaintyField;
use octobayes::{Error, Result};
use octobayes_depth::TrainingViews;
use octobayes_evaluation::metrics::{Detection, ErrorKind, sparsification, spearman};
use octobayes_evaluation::{DepthError, EvaluatedView, Evaluator, Measure, Reading};
use serde::{Deserialize, Serialize};

use crate::baselines::{Baselines, density_aware};
use crate::candidates::candidates;
use crate::parameters::ParameterPosteriors;
use crate::scene::{Data, Model, Scene};
use crate::warp::Warp;
use common::clock::Clock;
use common::table::mean;

/// Levels of the readings; the deviation of depth is that of the first.
pub const LEVELS: [u8; 3] = [7, 6, 5];
/// Every so many pixels of a held-out view are compared, along x and y.
pub const STRIDE: u32 = 2;

/// Baselines that are not the evaluator's, in the manner of what they are called after.
const BESIDE: [&str; 2] = ["warped depth (WarpRF)", "warped colour (WarpRF)"];

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

/// One model.
#[derive(Clone, Serialize, Deserialize)]
pub struct Row {
    pub psnr: f64,
    /// Median error of depth, scene units.
    pub error: f64,
    pub scored: Vec<Scored>,
    /// Processor seconds: training, uncertainty at the first level, evaluation; training the others of an ensemble.
    pub seconds: [f64; 4],
}

pub fn grid() -> GridSettings {
    GridSettings::default().level(LEVELS[0]).covariance(Covariance::Block).keep_sums(true)
}

pub fn rays() -> RaySettings {
    RaySettings::default().rays(480_000).gradient(GradientMethod::Auto)
}

/// Trains a scene's model and judges it, beside an ensemble of so many if it is more than one.
pub fn measure(scene: &Scene, seed: u64, ensemble: u64) -> Result<Row> {
    let folder = tempfile::tempdir().map_err(Error::io(Path::new("a temporary folder"), "cannot create"))?;
    let data = scene.data(folder.path())?;
    let clock = Clock::start();
    let model = scene.train(&data, seed)?;
    let trained = clock.elapsed().cpu;
    let clock = Clock::start();
    // No seed of another row.
    let others = (1..ensemble).map(|i| scene.train(&data, 1000 + 100 * seed + i)).collect::<Result<Vec<_>>>()?;
    let others_trained = clock.elapsed().cpu;
    let (fields, summed) = uncertainties(&data, &model.field, model.psnr, rays().seed(seed))?;
    let clock = Clock::start();
    let (offset, noise) = (model.field.pixel_offset(), DataScale::noise_of(model.psnr));
    let parameters = ParameterPosteriors::fit(&model.field, &data.cameras, offset, noise)?;
    let mut row = judge(&data, &model.field, Some(&parameters), &others, fields)?;
    row.seconds = [trained, summed, clock.elapsed().cpu, others_trained];
    Ok(row)
}

/// The uncertainty of a model of that PSNR on its training images, at all levels, and the processor seconds of the
/// first.
pub fn uncertainties(
    data: &Data,
    field: &dyn TrainedField,
    psnr: f64,
    rays: RaySettings,
) -> Result<(Vec<UncertaintyField>, f64)> {
    let domain = Domain::Box(field.bounds());
    let of_data = DataScale::from_cameras(&data.cameras, DataScale::noise_of(psnr), &domain)?;
    let mut fields = Vec::new();
    let mut summed = 0.0;
    for level in LEVELS {
        let clock = Clock::start();
        let grid = grid().level(level).scale(Scale::Data(of_data));
        fields.push(Estimation::new(&field, &data.cameras).rays(rays).grid(grid).run()?.field);
        if level == LEVELS[0] {
            summed = clock.elapsed().cpu;
        }
    }
    Ok((fields, summed))
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
    vec![RayAverage::USpread]
}

/// Judges a model beside the others of its ensemble, if there are any, and posteriors over its parameters, if they are
/// known.
pub fn judge(
    data: &Data,
    field: &dyn TrainedField,
    parameters: Option<&ParameterPosteriors>,
    others: &[Model],
    fields: Vec<UncertaintyField>,
) -> Result<Row> {
    let settings = RaySettings::for_images();
    let pixel_offset = field.pixel_offset();
    let tracer = settings.tracer(field, 0.0, &Silent)?;
    let cameras = data.strided_cameras(pixel_offset);
    let model = VolumeRenderer { tracer: tracer.clone(), differentiation: None };
    let training = TrainingViews::render(&model, &cameras, pixel_offset, &Silent)?;
    let warp = Warp::render(&tracer, &cameras, pixel_offset)?;
    let readings = readings(fields)?;
    let tracers = others.iter().map(|other| settings.tracer(&other.field, 0.0, &Silent));
    let members = tracers.map(|tracer| Ok(VolumeRenderer { tracer: tracer?, differentiation: None }));
    let members = members.collect::<Result<Vec<_>>>()?;
    let mut evaluator = Evaluator { training: Some(&training), ..Evaluator::new(&model, &readings) };
    let baselines = Baselines { tracer: &tracer, field: &readings[0].field, training: &training };
    if !members.is_empty() {
        evaluator.members = members.iter().chain([&model]).map(|member| member as &dyn Renderer).collect();
    }
    let (mut views, mut unseen) = (Vec::new(), Vec::new());
    let empty = |names: &[&str]| names.iter().map(|name| ((*name).to_owned(), Vec::new())).collect::<Vec<_>>();
    let mut beside = empty(&BESIDE);
    beside.extend(parameters.iter().flat_map(|_| empty(&ParameterPosteriors::NAMES)));
    let mut own = empty(&Baselines::NAMES);
    own.extend((!members.is_empty()).then(|| ("density-aware ensemble".to_owned(), Vec::new())));
    for (seed, truth) in (0..).zip(data.held_out(pixel_offset, STRIDE)?) {
        let view = evaluator.evaluate(&truth, seed, &Silent)?;
        let width = truth.camera.resolution[0] as usize;
        let at = |i: usize, t: f64| {
            let [x, y] = [i % width, i / width].map(|n| n as f64 + pixel_offset);
            truth.camera.ray(x, y).at(t)
        };
        let never_seen = |&i: &usize| truth.distance[i].is_some_and(|t| data.is_unseen(at(i, t)));
        unseen.extend(view.pixels.iter().map(never_seen));
        for &i in &view.pixels {
            let pixel = &view.rendered.pixels[i];
            let warped = warp.at(at(i, pixel.median_depth), pixel.color);
            beside[0].1.push(warped.depth);
            beside[1].1.push(warped.color);
        }
        let found = baselines.of(&truth, &view);
        own.iter_mut().zip(found).for_each(|((_, all), values)| all.extend(values));
        if !members.is_empty() {
            own[Baselines::NAMES.len()].1.extend(density_aware(&evaluator.members, &truth, &view.pixels)?);
        }
        if let Some(parameters) = parameters {
            for ((_, all), values) in beside[BESIDE.len()..].iter_mut().zip(parameters.of(&truth, &view)) {
                all.extend(values);
            }
        }
        views.push(view);
    }
    beside.extend(own);
    row(&evaluator, &views, beside, &unseen)
        .ok_or_else(|| Error::malformed(&data.folder, "views", "errors of depth, and finite deviations", "none"))
}

fn row(
    evaluator: &Evaluator,
    views: &[EvaluatedView],
    beside: Vec<(String, Vec<f64>)>,
    unseen: &[bool],
) -> Option<Row> {
    let measures = evaluator.measures();
    let errors: Vec<f64> = views.iter().flat_map(|view| &view.absolute_error).copied().collect();
    let pooled = |m: usize| -> Vec<f64> { views.iter().flat_map(|view| &view.measures[m]).copied().collect() };
    let weights: Vec<f64> = views.iter().flat_map(|view| &view.spread).map(|spread| spread * spread).collect();
    let mut all = Vec::new();
    for (m, &measure) in measures.iter().enumerate() {
        let (name, values) = (evaluator.name(measure), pooled(m));
        if let Measure::Reading(i, average) = measure {
            let alone = values.iter().zip(&weights).map(|(v, w)| v - 0.5 * w.log10()).collect();
            all.push((format!("{}, at-expected", evaluator.readings[i].name), alone));
            all.push((format!("{name}, {}", average.name()), values));
        } else {
            all.push((name, values));
        }
    }
    all.extend(beside);
    candidates(&mut all, &weights);
    let counts: Vec<usize> = views.iter().map(|view| view.absolute_error.len()).collect();
    let scored = all.iter().map(|(name, values)| score(name, values, &errors, &counts, unseen));
    Some(Row {
        psnr: mean(&views.iter().map(|view| view.psnr).collect::<Vec<_>>()),
        error: DepthError::new(views)?.median,
        scored: scored.collect::<Option<_>>()?,
        seconds: [0.0; 4],
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
