//! Held-out views of known depth: whether the uncertainty shows where the model is wrong, and by how much.

use std::path::PathBuf;
use std::sync::Arc;

use octobayes::monitor::Message;
use octobayes::uncertainty::UncertaintyField;
use octobayes_data::{DepthKind, Part, camera_file, passed_over};
use octobayes_evaluation::{DepthFiles, Evaluation, Reading};
use octobayes_session::CameraSource;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::json;

use crate::errors::{OrRaise, Said, said};
use crate::field::Uncertainty;
use crate::options::Options;
use crate::pool::without_python;
use crate::run::Source;
use crate::view::image_settings;
use crate::work::work;

/// Judges fields on held-out views. Returns the report as JSON, what a user should know, and the first field with its
/// interval of depth, if it was calibrated.
#[pyfunction]
pub fn evaluate(
    py: Python<'_>,
    nerf: &Bound<'_, PyAny>,
    fields: Vec<(String, Bound<'_, Uncertainty>)>,
    ensemble: Vec<Bound<'_, PyAny>>,
    options: &Bound<'_, PyDict>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<(String, Vec<Said>, Option<Uncertainty>)> {
    let (source, options) = (Source::new(nerf)?, Options(options));
    let (covariances, averages) = (options.covariances()?, options.ray_averages()?);
    let fields: Vec<_> = fields.into_iter().map(|(name, field)| (name, field.get().field.clone())).collect();
    let read = |(name, field): &(String, Arc<UncertaintyField>)| {
        Reading::from_field(name, field, covariances.as_deref(), averages.as_deref())
    };
    let readings = without_python(py, || fields.iter().map(read).collect::<octobayes::Result<Vec<Vec<Reading>>>>())?;
    let readings = readings.or_raise()?.concat();
    let member = |member: &Bound<'_, PyAny>| Ok((member.getattr("name")?.extract::<String>()?, Source::new(member)?));
    let members: Vec<(String, Source)> = ensemble.iter().map(member).collect::<PyResult<_>>()?;
    let kind = if options.or("z_depth", false)? { DepthKind::Z } else { DepthKind::Euclidean };
    let pattern = options.or("depth_pattern", DepthFiles::PATTERN.to_string())?;
    let depth = DepthFiles { folder: options.get("depth")?, pattern, scale: options.get("depth_encoding")?, kind };
    let folder = options.or("cameras", PathBuf::new())?;
    let cameras = camera_file(&folder, Part::HeldOut);
    let (file, resolution) = (Some(cameras.clone()), options.resolution()?);
    let held_out = CameraSource { file, resolution, ..CameraSource::default() };
    let selection = options.selection()?;
    let (name, settings) = (options.or("source", String::new())?, image_settings(&options)?);
    let (stride, training_depth) = (options.or("stride", Evaluation::STRIDE)?, options.get("training_depth")?);
    let (object_masks, images) = (options.get("object_masks")?, options.get("images")?);
    let (calibrate, clean_up) = (options.get("probability")?, options.or("clean_up", false)?);
    let (report, texts) = work(py, source.gate(nerf), progress, |engine| {
        source.with(engine, |model| {
            let mut texts = Vec::new();
            let mut tell = |remark| texts.push(said(remark));
            passed_over(&folder, &cameras).into_iter().for_each(|text| tell(Message::Note(text)));
            let views = held_out.read(None, &mut tell)?;
            let evaluation = Evaluation {
                model,
                name,
                settings,
                readings: &readings,
                ensemble: members.iter().filter_map(|(name, of)| Some((name.clone(), &*of.opened()?.model))).collect(),
                cameras,
                selection,
                stride,
                depth,
                object_masks,
                training_depth,
                images,
                calibrate,
                clean_up,
                curves: false,
            };
            let prepared = evaluation.prepare(views)?;
            prepared.remarks.iter().cloned().for_each(&mut tell);
            let judged = prepared.judge(engine.monitor(), &mut tell)?;
            Ok((judged.report, texts))
        })
    })?;
    let calibrated = report.calibrated.zip(readings.into_iter().next());
    let calibrated = calibrated.map(|(interval, first)| first.field.with_conformal(interval.conformal));
    Ok((json!(report).to_string(), texts, calibrated.map(Uncertainty::from)))
}
