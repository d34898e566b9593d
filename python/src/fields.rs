//! Several fields, and samples from elsewhere.

use std::path::PathBuf;
use std::sync::Arc;

use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use octobayes::Error;
use octobayes::estimate::{FieldBuilder, Provenance};
use octobayes::geometry::Domain;
use octobayes::glam::Vec3;
use octobayes::rays::{MissingShards, RunProgress, SamplesReader};
use octobayes::render::{RaySample, RaySamples};
use octobayes::uncertainty::{self, UncertaintyField};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::errors::OrRaise;
use crate::field::{Uncertainty, json};
use crate::options::Options;
use crate::pool::without_python;
use crate::work::work;

/// Rays that are summed together.
const BATCH: usize = 512;

/// Compares a field with a reference; JSON.
#[pyfunction]
pub fn compare(
    py: Python<'_>,
    a: &Bound<'_, Uncertainty>,
    b: &Bound<'_, Uncertainty>,
    points: usize,
    seed: u64,
) -> PyResult<String> {
    let (a, b) = (a.get().0.clone(), b.get().0.clone());
    json(&without_python(py, || uncertainty::compare(&*a, &*b, points, seed))?.or_raise()?)
}

/// Joins fields of one box from different rays. Returns the field with its warnings.
#[pyfunction]
pub fn merge(
    py: Python<'_>,
    fields: Vec<Bound<'_, Uncertainty>>,
    error_bars: bool,
    keep_sums: bool,
) -> PyResult<(Uncertainty, Vec<String>)> {
    let parts: Vec<_> = fields.iter().map(|field| field.get().0.clone()).collect();
    let joined = without_python(py, || {
        let parts: Vec<UncertaintyField> = parts.iter().map(|part| (**part).clone()).collect();
        if error_bars { uncertainty::merge_with_error_bars(&parts) } else { uncertainty::merge(&parts) }
    })?;
    let field = joined.or_raise()?;
    let missing = MissingShards::beside(field.draws());
    let warnings =
        missing.iter().map(|run| format!("the run over {} rays is not complete: {run} missing", run.rays)).collect();
    let field = if keep_sums { field } else { without_python(py, || field.for_queries())? };
    Ok((Uncertainty(Arc::new(field)), warnings))
}

/// Arrays of samples: positions `[n, 3]`, Jacobians `[n, 9]`, ray of each, weight of each, rays in all.
type Arrays<'py> = (
    PyReadonlyArray2<'py, f32>,
    PyReadonlyArray2<'py, f32>,
    PyReadonlyArray1<'py, u64>,
    PyReadonlyArray1<'py, f32>,
    u64,
);

/// Samples, and how many of them lie in the field's box.
#[derive(Default)]
struct Inside {
    inside: usize,
    all: usize,
}

impl Inside {
    fn add(&mut self, builder: &FieldBuilder, batches: &[RaySamples]) {
        let positions = || batches.iter().flat_map(|batch| &batch.positions);
        self.inside += positions().filter(|x| builder.lattice().coordinates(**x).is_some()).count();
        self.all += positions().count();
    }

    /// Refuses samples that all lie outside the box; a warning if half of them do.
    fn check(&self) -> octobayes::Result<Option<String>> {
        let Self { inside, all } = self;
        let found = format!("{inside} of {all} samples");
        if *inside == 0 && *all > 0 {
            let expected = "positions inside the box; likely causes: box, units, or axes";
            return Err(Error::setting("samples", expected, found));
        }
        Ok((2 * inside < *all).then(|| format!("{found} lie in the box; likely causes: box, units, or axes")))
    }
}

/// Sums samples whose Jacobians were computed elsewhere: a file's, or arrays. Returns the field with a warning.
#[pyfunction]
pub fn accumulate(
    py: Python<'_>,
    samples: &Bound<'_, PyAny>,
    options: &Bound<'_, PyDict>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<(Uncertainty, Option<String>)> {
    let options = Options(options);
    let domain = match (options.contraction()?, options.bounds()?.map(Domain::Box)) {
        (Some(domain), _) | (None, Some(domain)) => domain,
        (None, None) => {
            return Err(PyValueError::new_err(
                "box: expected the box of the field, or contract and inner, found neither",
            ));
        }
    };
    let settings = options.grid()?;
    if settings.needs_plan() || settings.criteria.density {
        let expected = "`sensitivity`, and no memory: the rest needs the model and its rays";
        return Err(Error::setting("refine", expected, format!("{}", settings.criteria))).or_raise();
    }
    let mut builder = FieldBuilder::new(settings, domain).or_raise()?;
    let finish = |builder: FieldBuilder, source: String, rays: u64, samples: u64| {
        let progress = RunProgress { rays, samples, ..RunProgress::default() };
        builder.finish(&Provenance { source, progress, ..Provenance::default() })
    };
    let mut inside = Inside::default();
    let (field, warning) = if let Ok(path) = samples.extract::<PathBuf>() {
        work(py, None, progress, move |engine| {
            let reader = SamplesReader::open(&path)?;
            reader.run(engine.monitor(), |batches| {
                inside.add(&builder, batches);
                builder.add(batches);
                Ok(())
            })?;
            let (warning, source) = (inside.check()?, format!("samples {}", path.display()));
            Ok((finish(builder, source, reader.rays_total(), reader.samples()), warning))
        })?
    } else {
        let (positions, jacobians, rays, weights, total) = samples.extract::<Arrays>()?;
        let batches =
            batched(positions.as_slice()?, jacobians.as_slice()?, rays.as_slice()?, weights.as_slice()?, total)?;
        let count = rays.len()? as u64;
        work(py, None, progress, move |_| {
            inside.add(&builder, &batches);
            let warning = inside.check()?;
            builder.add(&batches);
            Ok((finish(builder, "samples from Python".into(), total, count), warning))
        })?
    };
    Ok((Uncertainty(Arc::new(field)), warning))
}

/// The samples in batches that are cut between rays.
fn batched(
    positions: &[f32],
    jacobians: &[f32],
    rays: &[u64],
    weights: &[f32],
    total: u64,
) -> PyResult<Vec<RaySamples>> {
    let mut batches = vec![RaySamples::default()];
    let mut previous = 0;
    let values = positions.as_chunks::<3>().0.iter().zip(jacobians.as_chunks::<9>().0);
    for (i, ((&ray, (position, &jacobian)), &weight)) in rays.iter().zip(values).zip(weights).enumerate() {
        if ray < previous || ray >= total {
            return Err(PyValueError::new_err(format!(
                "samples['ray'][{i}]: expected from {previous} (non-decreasing) to below \
                 rays_total = {total}, found {ray}"
            )));
        }
        let last = batches.len() - 1;
        if ray != previous && batches[last].rays.len() >= BATCH {
            batches.push(RaySamples::default());
        }
        previous = ray;
        let last = batches.len() - 1;
        batches[last].push(ray, RaySample { position: Vec3::from_array(*position), jacobian, weight });
    }
    Ok(batches)
}
