//! Depths of a model from its training cameras, how far they may be off, and lengths between points.

use numpy::{PyArray1, PyArrayMethods, PyReadonlyArray2};
use octobayes::Result;
use octobayes::estimate::{Model, RaySettings};
use octobayes::glam::DVec3;
use octobayes::monitor::Message;
use octobayes::uncertainty::UncertaintyField;
use octobayes_data::{DepthKind, Frame};
use octobayes_depth::{Length, NINETY, SurfacePoint, SurveyedView, Surveyor};
use octobayes_session::Survey;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::json;

use crate::errors::{Said, said};
use crate::field::Uncertainty;
use crate::options::{Options, cameras};
use crate::run::{Source, views};
use crate::view::image_settings;
use crate::work::{Engine, work};

/// Looks at a model through its training cameras.
fn look<T>(
    model: &dyn Model,
    field: &UncertaintyField,
    frames: &[Frame],
    (options, pixels): (&LookOptions, u64),
    engine: &Engine,
    work: impl FnOnce(&Surveyor) -> Result<T>,
) -> Result<(T, Vec<Said>)> {
    let mut texts = Vec::new();
    let mut tell = |remark: Message| texts.push(said(remark));
    let LookOptions { settings, uses_images } = *options;
    let survey = Survey { model, field, frames, settings, uses_images };
    let found = survey.look(pixels, engine.monitor(), &mut tell, work)?;
    Ok((found, texts))
}

struct LookOptions {
    settings: RaySettings,
    uses_images: bool,
}

impl LookOptions {
    fn of(options: &Options) -> PyResult<Self> {
        Ok(Self { settings: image_settings(options)?, uses_images: options.or("images", true)? })
    }
}

/// What some training cameras see: a dictionary of arrays for each, and what a user should know.
#[pyfunction]
pub fn depth<'py>(
    py: Python<'py>,
    nerf: &Bound<'py, PyAny>,
    uncertainty: &Bound<'py, Uncertainty>,
    rows: PyReadonlyArray2<'py, f64>,
    options: &Bound<'py, PyDict>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Vec<Bound<'py, PyDict>>, Vec<Said>)> {
    let (source, cameras, options) = (Source::new(nerf)?, cameras(&rows)?, Options(options));
    let frames = views(&options, &cameras)?.frames;
    let chosen = options.or("photographs", Vec::<usize>::new())?;
    let strides = options.or("strides", Vec::<u32>::new())?;
    let kind = if options.or("z_depth", false)? { DepthKind::Z } else { DepthKind::Euclidean };
    let (look_options, field) = (LookOptions::of(&options)?, uncertainty.get().field.clone());
    let views = || chosen.iter().copied().zip(strides.iter().copied());
    let pixels = views().map(|(i, stride)| cameras[i].strided(stride, 0.5).pixels()).sum();
    let ((seen, offset), texts) = work(py, source.gate(nerf), progress, |engine| {
        source.with(engine, |model| {
            look(model, &field, &frames, (&look_options, pixels), engine, |surveyor| {
                let times = if surveyor.deviation.has_images() { 2 } else { 1 };
                let rows = views().map(|(i, stride)| times * u64::from(cameras[i].resolution[1].div_ceil(stride)));
                engine.monitor().begin("rows of photographs", rows.sum());
                let view = |(i, stride)| surveyor.view(i, stride, engine.monitor());
                let seen = views().map(view).collect::<Result<Vec<_>>>()?;
                engine.monitor().end();
                Ok((seen, surveyor.pixel_offset))
            })
        })
    })?;
    let maps = chosen.iter().zip(&seen).map(|(&i, view)| maps(py, view, offset, kind, (i, &frames[i].name)));
    Ok((maps.collect::<PyResult<_>>()?, texts))
}

/// The arrays of a view.
fn maps<'py>(
    py: Python<'py>,
    view: &SurveyedView,
    offset: f64,
    kind: DepthKind,
    (index, name): (usize, &str),
) -> PyResult<Bound<'py, PyDict>> {
    let [width, height] = view.rendered.resolution.map(|side| side as usize);
    let shown = |i: usize| view.rendered.pixels[i].opacity > 0.5;
    let stretch = |i: usize| {
        let [x, y] = [i % width, i / width].map(|n| n as f64 + offset);
        kind.stretch(&view.camera, x, y)
    };
    let map = |value: &dyn Fn(usize) -> f64| {
        let of = |i: usize| if shown(i) { (value(i) / stretch(i)) as f32 } else { f32::NAN };
        PyArray1::from_iter(py, (0..width * height).map(of)).reshape([height, width])
    };
    let out = PyDict::new(py);
    out.set_item("camera", index)?;
    out.set_item("name", name)?;
    out.set_item("depth", map(&|i| view.rendered.pixels[i].median_depth)?)?;
    out.set_item("sigma", map(&|i| view.sigma[i])?)?;
    let trust = PyArray1::from_iter(py, view.trust.iter().map(|trust| trust.grey()));
    out.set_item("trust", trust.reshape([height, width])?)?;
    Ok(out)
}

/// The length between two points as JSON, and what a user should know.
#[pyfunction]
pub fn measure<'py>(
    py: Python<'py>,
    nerf: &Bound<'py, PyAny>,
    uncertainty: &Bound<'py, Uncertainty>,
    rows: PyReadonlyArray2<'py, f64>,
    points: [[f64; 3]; 2],
    options: &Bound<'py, PyDict>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(String, Vec<Said>)> {
    let (source, cameras, options) = (Source::new(nerf)?, cameras(&rows)?, Options(options));
    let frames = views(&options, &cameras)?.frames;
    let (look_options, field) = (LookOptions::of(&options)?, uncertainty.get().field.clone());
    let name = |camera: usize| octobayes::error::printable(&frames[camera].name).to_string();
    let place = |x: DVec3| format!("({:.4}, {:.4}, {:.4})", x.x, x.y, x.z);
    let (found, texts) = work(py, source.gate(nerf), progress, |engine| {
        source.with(engine, |model| {
            look(model, &field, &frames, (&look_options, 20_000), engine, |surveyor| {
                let end = |k: usize| {
                    let x = DVec3::from(points[k]);
                    surveyor.snap(x)?.surface(["a", "b"][k], x, place, |v| format!("{v:.4}"), name)
                };
                let ends = [end(0)?, end(1)?];
                Ok((Length::between(&ends[0], &ends[1], &field)?, ends))
            })
        })
    })?;
    let (Length { length, deviation, correlation }, ends) = found;
    let end = |end: &SurfacePoint| {
        json!({
            "position": end.position.to_array(), "view": name(end.camera), "sigma": end.deviation,
            "trust": end.trust.name(),
        })
    };
    let report = json!({
        "length": length, "sigma": deviation,
        "interval_90": [length - NINETY * deviation, length + NINETY * deviation],
        "correlation": correlation, "points": ends.each_ref().map(end),
    });
    Ok((report.to_string(), texts))
}
