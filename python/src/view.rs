//! Pictures of a model and its uncertainty.

use numpy::{PyArray1, PyArrayMethods, PyReadonlyArray2};
use octobayes::estimate::{Model, RaySettings};
use octobayes::geometry::Camera;
use octobayes::monitor::Monitor;
use octobayes::render::{Pixel, Probe, RayAverage, RenderedView, Renderer};
use octobayes::uncertainty::{BakedField, shown_log10, unknowns};
use octobayes::{Error, Result};
use octobayes_depth::{DepthDeviation, TrainingViews};
use octobayes_evaluation::Reading;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::errors::OrRaise;
use crate::field::Uncertainty;
use crate::options::{Options, cameras};
use crate::run::Source;
use crate::work::work;

/// Settings of images.
pub fn image_settings(options: &Options) -> PyResult<RaySettings> {
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
    let field = uncertainty.map(|field| field.get().field.clone());
    let threshold = options.get::<f64>("threshold")?;
    let depth_error = options.or("depth_error", false)?;
    let confirm = options.or("confirm", false)?;
    let averages = options.ray_averages()?.unwrap_or_else(|| vec![RayAverage::default()]);
    if let Some(field) = &field {
        averages.iter().try_for_each(|&average| Reading::check(field, average)).or_raise()?;
    }
    let (view, confirmed, deviation) = work(py, source.gate(nerf), progress, |engine| {
        source.with(engine, |model| {
            let probes = field.as_deref().map(|field| Probe { field, averages: &averages });
            let probes = probes.as_slice();
            let unbaked = field.as_deref().map(BakedField::unbaked);
            let of_depth = unbaked.as_ref().filter(|_| depth_error);
            let of_depth = of_depth.map(|field| DepthDeviation::new(field, None)).transpose()?;
            let cut = unbaked.as_ref().zip(threshold);
            let part = cut.map(|(field, threshold)| model.certain_part(field, threshold)).transpose()?;
            let part = match part {
                Some(None) => {
                    return Err(Error::setting("threshold", "one that leaves a part of the model", "none left"));
                }
                part => part.flatten(),
            };
            let shown = part.as_deref().unwrap_or(model).for_images(&settings, engine.monitor())?;
            let offset = settings.offset_for(model);
            engine.monitor().begin("rows", u64::from(camera.resolution[1]));
            let mut view = shown.image(&camera, offset, probes, engine.monitor())?;
            let confirmed = if confirm {
                let training = training_views(model, &*shown, offset, engine.monitor())?;
                Some(training.confirmed(&camera, offset, &view))
            } else {
                None
            };
            let of_view = |of: &DepthDeviation| of.of_view(&*shown, &camera, offset, &view, engine.monitor());
            let deviation = of_depth.as_ref().map(of_view).transpose()?;
            let Some(unbaked) = &unbaked else { return Ok((view, confirmed, deviation)) };
            let unknowns = unknowns(unbaked, &camera, offset, &view);
            let shown = view.log10_uncertainty.iter().map(|log10| shown_log10(&view, log10, &unknowns));
            view.log10_uncertainty = shown.collect();
            Ok((view, confirmed, deviation))
        })
    })?;
    let factor = uncertainty.and_then(|field| field.get().field.conformal().map(|conformal| conformal.factor));
    let out = pictures(py, &view, deviation.as_deref(), factor)?;
    let [width, height] = view.resolution.map(|side| side as usize);
    if let Some(confirmed) = confirmed {
        out.set_item("depth_confirmed", PyArray1::from_vec(py, confirmed).reshape([height, width])?)?;
    }
    Ok(out)
}

/// What the cameras that a model stores see of what is shown of it.
fn training_views(
    model: &dyn Model,
    shown: &dyn Renderer,
    offset: f64,
    monitor: &dyn Monitor,
) -> Result<TrainingViews> {
    let cameras: Vec<Camera> = model.training_cameras().iter().map(|named| named.camera).collect();
    if cameras.is_empty() {
        return Err(Error::setting("confirm", "a model that stores its training cameras", "one that stores none"));
    }
    TrainingViews::render(shown, &cameras, offset, monitor)
}

/// The arrays of a view, f32; with deviations of depth, and the half width of a calibrated interval in deviations.
fn pictures<'py>(
    py: Python<'py>,
    view: &RenderedView,
    deviation: Option<&[f64]>,
    factor: Option<f64>,
) -> PyResult<Bound<'py, PyDict>> {
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
    if let Some(deviations) = deviation {
        let times = |factor: f64| {
            PyArray1::from_iter(py, deviations.iter().map(|s| (factor * s) as f32)).reshape([height, width])
        };
        out.set_item("depth_error", times(1.0)?)?;
        if let Some(factor) = factor {
            out.set_item("depth_interval", times(factor)?)?;
        }
    }
    Ok(out)
}
