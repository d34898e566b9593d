//! Several fields, and samples from elsewhere.

use std::path::{Path, PathBuf};

use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use octobayes::glam::Vec3;
use octobayes::rays::{Gathered, MissingShards};
use octobayes::render::{RaySample, RaySamples};
use octobayes::uncertainty::{self, Merging, UncertaintyField};
use octobayes_data::SamplesReader;
use octobayes_session::{Accumulation, TrainingPixels, check_fields};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::errors::{OrRaise, Said, said};
use crate::field::{Uncertainty, computed, json};
use crate::options::Options;
use crate::pool::without_python;
use crate::work::work;

/// Compares a field with a reference; JSON, and what a user should know.
#[pyfunction]
pub fn compare(
    py: Python<'_>,
    a: &Bound<'_, Uncertainty>,
    b: &Bound<'_, Uncertainty>,
    points: usize,
    seed: u64,
) -> PyResult<(String, Vec<Said>)> {
    let (a, b) = (a.get().field.clone(), b.get().field.clone());
    let mut texts = Vec::new();
    let pair = [(Path::new("a"), &*a), (Path::new("b"), &*b)];
    check_fields(pair, true, &mut |remark| texts.push(said(remark))).or_raise()?;
    Ok((json(&without_python(py, || uncertainty::compare(&a, &b, points, seed))?.or_raise()?)?, texts))
}

/// Joins fields of one box from different rays. Returns the field with its warnings.
#[pyfunction]
#[pyo3(signature = (fields, error_bars, keep_sums, scratch=None))]
pub fn merge(
    py: Python<'_>,
    fields: Vec<Bound<'_, Uncertainty>>,
    error_bars: bool,
    keep_sums: bool,
    scratch: Option<PathBuf>,
) -> PyResult<(Uncertainty, Vec<Said>)> {
    let parts: Vec<_> = fields.iter().map(|field| field.get().field.clone()).collect();
    let joined = without_python(py, || {
        let parts: Vec<&UncertaintyField> = parts.iter().map(|part| &**part).collect();
        let merging = Merging::default().keep_sums(keep_sums).error_bars(error_bars);
        scratch.into_iter().fold(merging, Merging::scratch).join(&parts)
    })?;
    let field = joined.or_raise()?;
    let missing = MissingShards::beside(field.ray_sets());
    let warning =
        |run: &MissingShards| (format!("the run over {} rays is not complete: {run} missing", run.rays), false);
    let warnings = missing.iter().map(warning).collect();
    Ok((field.into(), warnings))
}

/// Arrays of samples: positions `[n, 3]`, Jacobians `[n, 9]`, ray of each, weight of each, rays in all.
type Arrays<'py> = (
    PyReadonlyArray2<'py, f32>,
    PyReadonlyArray2<'py, f32>,
    PyReadonlyArray1<'py, u64>,
    PyReadonlyArray1<'py, f32>,
    u64,
);

/// Sums samples whose Jacobians were computed elsewhere: a file's, or arrays. Returns the field with what a user should
/// know.
#[pyfunction]
pub fn accumulate(
    py: Python<'_>,
    samples: &Bound<'_, PyAny>,
    options: &Bound<'_, PyDict>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<(Uncertainty, Vec<Said>)> {
    let options = Options(options);
    let none = || PyValueError::new_err("box: expected the box of the field, or contract, found neither");
    let domain = options.domain()?.ok_or_else(none)?;
    let path = samples.extract::<PathBuf>().ok();
    let reader = path.map(|path| SamplesReader::open(&path)).transpose().or_raise()?;
    let stated = reader.as_ref().and_then(SamplesReader::training_pixels);
    let training = TrainingPixels { pixels: options.get("training_pixels")?.or(stated), noise: None };
    let mut texts = Vec::new();
    let mut tell = |remark| texts.push(said(remark));
    let choices = options.choices()?;
    let grid = choices.settle(options.grid()?, None, &mut tell).or_raise()?;
    let scale = choices.scale().over(&domain, choices.noise, training).or_raise()?;
    let mut accumulation = Accumulation::new(grid.scale(scale), domain).or_raise()?;
    let finished = if let Some(reader) = reader {
        work(py, None, progress, |engine| accumulation.read(&reader, engine.monitor(), &mut tell).map(computed))?
    } else {
        let (positions, jacobians, rays, weights, total) = samples.extract::<Arrays>()?;
        let batches =
            batched(positions.as_slice()?, jacobians.as_slice()?, rays.as_slice()?, weights.as_slice()?, total)?;
        work(py, None, progress, |_| {
            accumulation.add(&batches);
            accumulation.finish("samples".as_ref(), "samples from Python", total, &mut tell).map(computed)
        })?
    };
    Ok((Uncertainty::of_run(finished), texts))
}

/// The samples in batches that are cut between rays.
fn batched(
    positions: &[f32],
    jacobians: &[f32],
    rays: &[u64],
    weights: &[f32],
    total: u64,
) -> PyResult<Vec<RaySamples>> {
    let mut gathered = Gathered::new(total);
    let values = positions.as_chunks::<3>().0.iter().zip(jacobians.as_chunks::<9>().0);
    for (i, ((&ray, (position, &jacobian)), &weight)) in rays.iter().zip(values).zip(weights).enumerate() {
        let sample = RaySample { position: Vec3::from_array(*position), jacobian, weight };
        gathered.push(ray, sample).map_err(|(expected, found)| {
            PyValueError::new_err(format!("samples['ray'][{i}]: expected {expected}, found {found}"))
        })?;
    }
    Ok(gathered.finish())
}
