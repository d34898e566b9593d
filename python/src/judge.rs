//! Held-out views of known depth: whether the uncertainty shows where the model is wrong, and by how much.

use std::path::PathBuf;
use std::sync::Arc;

use octobayes::dataset::{DepthKind, Frame, FrameSplit, Part, Selection, Views};
use octobayes::estimate::RaySettings;
use octobayes::evaluate::{
    DepthError, DepthFiles, DepthMeaning, EvaluatedView, Evaluator, HeldOut, Interval, Judged, Measure, Reading, Score,
};
use octobayes::field::RadianceField;
use octobayes::metrics::{ErrorKind, STEPS};
use octobayes::uncertainty::UncertaintyField;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::json;

use crate::errors::OrRaise;
use crate::field::Uncertainty;
use crate::options::Options;
use crate::pool::without_python;
use crate::run::Source;
use crate::view::image_settings;
use crate::work::{Engine, work};

/// Views of known depth, and how the model is rendered beside them.
struct Asked {
    cameras: PathBuf,
    depth: DepthFiles,
    size: Option<[u32; 2]>,
    stride: u32,
    every: usize,
    settings: RaySettings,
}

impl Asked {
    fn new(options: &Options) -> PyResult<Self> {
        let needed = |name: &str| PyValueError::new_err(format!("{name}: expected a value, found none"));
        let kind = if options.or("z_depth", false)? { DepthKind::Z } else { DepthKind::Euclidean };
        let pattern = options.or("depth_pattern", "{}_depth_0001.png".to_string())?;
        let (folder, scale) = (options.get("depth")?, options.get("depth_encoding")?);
        Ok(Self {
            cameras: options.get("cameras")?.ok_or_else(|| needed("cameras"))?,
            depth: DepthFiles { folder, pattern, scale, kind },
            size: options.get("resolution")?,
            stride: options.or("stride", 1)?,
            every: options.or("every", 1)?,
            settings: image_settings(options)?,
        })
    }

    /// Calls `judge` with the views as the model shows them and measures of its doubt, and the error of depth. Second,
    /// what ought to be known of the depth maps.
    fn with<T>(
        &self,
        engine: &Engine,
        model: &dyn RadianceField,
        readings: &[Reading],
        judge: impl FnOnce(&Evaluator, &Judged, &DepthError) -> octobayes::Result<T>,
    ) -> octobayes::Result<(T, Vec<String>)> {
        let (settings, monitor) = (&self.settings, engine.monitor());
        let views = Views::read(&self.cameras, self.size)?;
        let all = views.frames.clone();
        let frames = FrameSplit::new(views).select(Part::HeldOut, &Selection::All, |_| true)?;
        let frames: Vec<Frame> = frames.into_iter().step_by(self.every).collect();
        let found = self.depth.find(&self.cameras, &frames, &all)?;
        let lattice = readings.first().map(|reading| reading.field.lattice());
        let differentiation = lattice.map(|lattice| settings.differentiation(model, lattice)).transpose()?;
        let tracer = settings.tracer(model, 0.0, monitor)?;
        let evaluator = Evaluator { differentiation, ..Evaluator::new(tracer, readings) };
        let held_out = HeldOut {
            frames: &found.frames,
            depth: Some(DepthMeaning { encoding: found.encoding, bounds: model.bounds() }),
            background: settings.background.as_dvec3(),
            pixel_offset: settings.offset_for(model),
            stride: self.stride,
        };
        let judged = held_out.evaluate(&evaluator, &found.source, monitor, drop)?;
        let fit = judged.depth(model)?;
        let odd = [fit.notes, fit.warnings].concat();
        Ok((judge(&evaluator, &judged, &fit.error)?, odd))
    }
}

/// Ranks the depth error of held-out views; JSON. Second, what ought to be known of the depth maps.
#[pyfunction]
pub fn evaluate(
    py: Python<'_>,
    nerf: &Bound<'_, PyAny>,
    fields: Vec<(String, Bound<'_, Uncertainty>)>,
    options: &Bound<'_, PyDict>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<(String, Vec<String>)> {
    let (source, options) = (Source::new(nerf)?, Options(options));
    let averages = options.ray_averages()?;
    let fields: Vec<_> = fields.into_iter().map(|(name, field)| (name, field.get().0.clone())).collect();
    let covariances = options.covariances()?;
    let read = |(name, field): &(String, Arc<UncertaintyField>)| {
        Reading::from_field(name, field, covariances.as_deref(), averages.as_deref())
    };
    let readings = without_python(py, || fields.iter().map(read).collect::<octobayes::Result<Vec<Vec<Reading>>>>())?;
    let readings = readings.or_raise()?.concat();
    let asked = Asked::new(&options)?;
    let (result, notes) = work(py, source.gate(nerf), progress, |engine| {
        source.with(engine, |model| {
            asked.with(engine, model, &readings, |evaluator, judged, depth| {
                let few = || judged.too_few(&format!("at least {STEPS} pixels with depth and some error"));
                scores(evaluator, judged, depth).ok_or_else(few)
            })
        })
    })?;
    Ok((result.to_string(), notes))
}

/// The field with an interval of depth that holds a share of the errors of held-out views, and what it is; JSON. Third,
/// what ought to be known of the depth maps.
#[pyfunction]
pub fn calibrate(
    py: Python<'_>,
    nerf: &Bound<'_, PyAny>,
    uncertainty: &Bound<'_, Uncertainty>,
    options: &Bound<'_, PyDict>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<(Uncertainty, String, Vec<String>)> {
    let (source, options) = (Source::new(nerf)?, Options(options));
    let mut field = UncertaintyField::clone(&uncertainty.get().0);
    if let Some(covariance) = options.covariance()? {
        field = field.with_covariance(covariance).or_raise()?;
    }
    field.depth_posterior().or_raise()?;
    let readings = [Reading { name: "field".into(), field, averages: Vec::new() }];
    let asked = Asked::new(&options)?;
    let probability = options.or("probability", 0.9)?;
    let ((interval, counts), notes) = work(py, source.gate(nerf), progress, |engine| {
        source.with(engine, |model| {
            asked.with(engine, model, &readings, |evaluator, judged, _| {
                let few = || judged.too_few(&format!("more pixels of known depth, to hold {probability}"));
                let interval = Interval::calibrate(evaluator, &judged.views, probability).ok_or_else(few)?;
                Ok((interval, judged.readings))
            })
        })
    })?;
    let Interval { conformal, predicted, left_out } = interval;
    let said = json!({
        "conformal": conformal, "predicted_factor": predicted, "views_left_out": left_out, "depth_readings": counts,
    });
    let [reading] = readings;
    Ok((Uncertainty(Arc::new(reading.field.with_conformal(conformal))), said.to_string(), notes))
}

/// Names and figures as the command line's `evaluate --json` has them; `None` if there is nothing to rank.
fn scores(evaluator: &Evaluator, judged: &Judged, depth: &DepthError) -> Option<serde_json::Value> {
    let views = &judged.views[..];
    let by_kind = |values: &dyn Fn(usize) -> f64| -> serde_json::Value {
        ErrorKind::ALL
            .iter()
            .enumerate()
            .map(|(e, kind)| (format!("{kind:?}").to_lowercase(), json!(values(e))))
            .collect()
    };
    let (mut readings, mut baselines) = (Vec::new(), Vec::new());
    for (m, measure) in evaluator.measures().into_iter().enumerate() {
        let score = Score::new(views, m)?;
        let mut entry = json!({
            "name": evaluator.name(measure),
            "ause_pooled": by_kind(&|e| score.pooled[e].area),
            "ause_mean_over_views": by_kind(&|e| score.per_view_mean[e]),
        });
        if let Some(calibration) = evaluator.calibration(views, m) {
            entry["calibration"] = json!(calibration);
        }
        match measure {
            Measure::Reading(_, average) => {
                entry["ray_average"] = json!(average);
                readings.push(entry);
            }
            Measure::DepthDeviation(_) => readings.push(entry),
            _ => baselines.push(entry),
        }
    }
    let mean = |of: &dyn Fn(&EvaluatedView) -> f64| views.iter().map(of).sum::<f64>() / views.len() as f64;
    let each = |v: &EvaluatedView| json!({ "name": v.name, "psnr": v.psnr, "pixels": v.pixels.len() });
    Some(json!({
        "views": views.iter().map(each).collect::<Vec<_>>(),
        "pixels": depth.pixels,
        "depth_readings": judged.readings,
        "pixels_without_depth": views.iter().map(|view| view.empty).sum::<usize>(),
        "psnr": mean(&|view| view.psnr),
        "depth_error": { "median": depth.median, "mean": depth.mean, "percentile_95": depth.percentile_95 },
        "readings": readings,
        "baselines": baselines,
    }))
}
