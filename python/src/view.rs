//! Pictures of a model and its uncertainty, and whether it shows where the model is wrong.

use std::path::PathBuf;
use std::sync::Arc;

use numpy::{PyArray1, PyArrayMethods, PyReadonlyArray2};
use octobayes::Error;
use octobayes::dataset::{DepthEncoding, DepthKind, FrameSplit, Part, Selection, Views};
use octobayes::estimate::RaySettings;
use octobayes::evaluate::{DepthError, DepthFiles, EvaluatedView, Evaluator, Measure, Reading, Score, TrueView};
use octobayes::field::RadianceField;
use octobayes::metrics::{ErrorKind, STEPS};
use octobayes::render::{DepthProbe, Pixel, Probe, RayAverage, RenderedView, render_view, render_view_with_depth};
use octobayes::uncertainty::{ThresholdedField, UncertaintyField};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::json;

use crate::errors::OrRaise;
use crate::field::Uncertainty;
use crate::options::{Options, cameras};
use crate::run::Source;
use crate::work::work;

/// Settings of images.
fn image_settings(options: &Options) -> PyResult<RaySettings> {
    options.image(RaySettings::for_images())
}

/// Renders a camera's image: a dictionary of arrays.
#[pyfunction]
pub fn render<'py>(
    py: Python<'py>,
    nerf: &Bound<'py, PyAny>,
    uncertainty: Option<&Bound<'py, Uncertainty>>,
    rows: PyReadonlyArray2<'py, f64>,
    options: &Bound<'py, PyDict>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let (source, cameras, options) = (Source::new(nerf)?, cameras(&rows)?, Options(options));
    let [camera] = cameras[..] else { return Err(PyValueError::new_err("camera: expected one, found several")) };
    let settings = image_settings(&options)?;
    let field = uncertainty.map(|field| field.get().0.clone());
    let threshold = options.get::<f64>("threshold")?;
    let depth_error = options.or("depth_error", false)?;
    let averages = options.ray_averages()?.unwrap_or_else(|| vec![RayAverage::default()]);
    if let Some(field) = &field {
        averages.iter().try_for_each(|&average| Reading::check(field, average)).or_raise()?;
    }
    let view = work(py, source.gate(nerf), progress, |engine| {
        source.with(engine, |model| {
            let probes = field.as_deref().map(|field| Probe { field, averages: &averages });
            let probes = probes.as_slice();
            let cleaned = field.as_deref().zip(threshold);
            let cleaned = cleaned.map(|(field, threshold)| ThresholdedField::new(model, field, threshold));
            let shown: &dyn RadianceField = cleaned.as_ref().map_or(model, |cleaned| cleaned);
            let tracer = settings.tracer(shown, 0.0, engine.monitor())?;
            let offset = settings.pixel_offset.unwrap_or_else(|| model.pixel_offset());
            engine.monitor().begin("rows", u64::from(camera.resolution[1]));
            let Some(field) = field.as_deref().filter(|_| depth_error) else {
                return render_view(&tracer, &camera, offset, probes, engine.monitor());
            };
            let posterior = field.depth_posterior()?;
            let differentiation = settings.differentiation(shown, field.lattice())?;
            let depth = DepthProbe { differentiation, variances: &[&posterior] };
            render_view_with_depth(&tracer, &camera, offset, probes, &depth, engine.monitor())
        })
    })?;
    pictures(py, &view)
}

/// The arrays of a view, f32.
fn pictures<'py>(py: Python<'py>, view: &RenderedView) -> PyResult<Bound<'py, PyDict>> {
    let [width, height] = view.resolution.map(|side| side as usize);
    let picture = |of: &dyn Fn(&Pixel) -> f64| {
        PyArray1::from_iter(py, view.pixels.iter().map(|pixel| of(pixel) as f32)).reshape([height, width])
    };
    let color = view.pixels.iter().flat_map(|pixel| pixel.color.to_array()).map(|c| c as f32);
    let out = PyDict::new(py);
    out.set_item("color", PyArray1::from_iter(py, color).reshape([height, width, 3])?)?;
    out.set_item("depth", picture(&|pixel| pixel.median_depth)?)?;
    out.set_item("opacity", picture(&|pixel| pixel.opacity)?)?;
    for values in &view.log10_uncertainty {
        let values = PyArray1::from_iter(py, values.iter().map(|&u| u as f32));
        out.set_item("log10_uncertainty", values.reshape([height, width])?)?;
    }
    for deviations in &view.depth_deviation {
        let deviations = PyArray1::from_iter(py, deviations.iter().map(|&s| s as f32));
        out.set_item("depth_error", deviations.reshape([height, width])?)?;
    }
    Ok(out)
}

/// Ranks the depth error of held-out views; JSON.
#[pyfunction]
pub fn evaluate(
    py: Python<'_>,
    nerf: &Bound<'_, PyAny>,
    fields: Vec<(String, Bound<'_, Uncertainty>)>,
    options: &Bound<'_, PyDict>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<String> {
    let (source, options) = (Source::new(nerf)?, Options(options));
    let averages = options.ray_averages()?;
    let fields: Vec<_> = fields.into_iter().map(|(name, field)| (name, field.get().0.clone())).collect();
    let covariances = options.covariances()?;
    let read = |(name, field): &(String, Arc<UncertaintyField>)| {
        Reading::from_field(name, field, covariances.as_deref(), averages.as_deref())
    };
    let readings: Vec<Vec<Reading>> = fields.iter().map(read).collect::<octobayes::Result<_>>().or_raise()?;
    let readings = readings.concat();
    let settings = image_settings(&options)?;
    let needed = |name: &str| PyValueError::new_err(format!("{name}: expected a value, found none"));
    let kind = if options.or("z_depth", false)? { DepthKind::Z } else { DepthKind::Euclidean };
    let pattern = options.or("depth_pattern", "{}_depth_0001.png".to_string())?;
    let encoding = DepthEncoding::of_maps(&pattern, options.get("depth_encoding")?, kind).or_raise()?;
    let depth = DepthFiles { folder: options.get("depth")?.ok_or_else(|| needed("depth"))?, pattern, encoding };
    let path: PathBuf = options.get("cameras")?.ok_or_else(|| needed("cameras"))?;
    let size = options.get::<[u32; 2]>("resolution")?;
    let (stride, every) = (options.or("stride", 1_u32)?, options.or("every", 1_usize)?);
    let result = work(py, source.gate(nerf), progress, |engine| {
        source.with(engine, |model| {
            let frames = FrameSplit::new(Views::read(&path, size)?).select(Part::HeldOut, &Selection::All, |_| true)?;
            let monitor = engine.monitor();
            let differentiation =
                readings.first().map(|reading| settings.differentiation(model, reading.field.lattice())).transpose()?;
            let tracer = settings.tracer(model, 0.0, monitor)?;
            let evaluator = Evaluator { differentiation, ..Evaluator::new(tracer, &readings) };
            let offset = settings.pixel_offset.unwrap_or_else(|| model.pixel_offset());
            let frames: Vec<_> = frames.iter().step_by(every).collect();
            monitor.begin("rows", frames.iter().map(|f| u64::from(f.camera.resolution[1].div_ceil(stride))).sum());
            let mut views = Vec::new();
            for (seed, frame) in (0..).zip(frames) {
                let truth = TrueView::read(frame, Some(&depth), settings.background.as_dvec3(), offset, stride)?;
                let view = evaluator.evaluate(&truth, seed, monitor)?;
                views.push(EvaluatedView { rendered: RenderedView::default(), ..view });
            }
            scores(&evaluator, &views).ok_or_else(|| {
                let found = views.iter().map(|view| view.pixels.len()).sum::<usize>().to_string();
                let expected = format!("at least {STEPS} pixels with depth and some error");
                Error::malformed(&depth.folder, "depth maps", expected, found)
            })
        })
    })?;
    Ok(result.to_string())
}

/// Names and figures as the command line's `evaluate --json` has them; `None` if there is nothing to rank.
fn scores(evaluator: &Evaluator, views: &[EvaluatedView]) -> Option<serde_json::Value> {
    let depth = DepthError::new(views)?;
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
        "pixels_without_depth": views.iter().map(|view| view.empty).sum::<usize>(),
        "psnr": mean(&|view| view.psnr),
        "depth_error": { "median": depth.median, "mean": depth.mean, "percentile_95": depth.percentile_95 },
        "readings": readings,
        "baselines": baselines,
    }))
}
