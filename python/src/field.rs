//! A finished uncertainty field.

use std::path::PathBuf;
use std::sync::Arc;

use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray2};
use octobayes::geometry::Domain;
use octobayes::posterior::Covariance;
use octobayes::uncertainty::{BakedField, Observability, UncertaintyField};
use octobayes_data::OfficialGrid;
use octobayes_models::refuse_model;
use octobayes_session::{Finished, Threshold, described};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::errors::{OrRaise, Said, said};
use crate::model::points;
use crate::options::{Options, choose};
use crate::pool::without_python;

/// U(x), the standard deviation of displacements that the training images allow, in scene units.
#[pyclass(frozen, module = "octobayes._octobayes")]
pub struct Uncertainty {
    pub field: Arc<UncertaintyField>,
    /// What the run reported that computed it, as JSON.
    report: Option<String>,
}

impl From<UncertaintyField> for Uncertainty {
    fn from(field: UncertaintyField) -> Self {
        Self { field: Arc::new(field), report: None }
    }
}

impl Uncertainty {
    /// The field of a run, with its report.
    pub fn of_run((field, report): Computed) -> Self {
        Self { report: Some(report), ..field.into() }
    }
}

/// What a run computed, and its report as JSON.
pub type Computed = (UncertaintyField, String);

/// The field of a run and its report, which is parallel work.
pub fn computed(finished: Finished) -> Computed {
    let report = finished.report().to_string();
    (finished.field, report)
}

/// U, errors of log10 U (NaN if unknown), rays (NaN if unknown), levels, and whether a point is inside.
type Estimates<'py> = (
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<u8>>,
    Bound<'py, PyArray1<bool>>,
);

/// `constrained`, `free` or `unseen` for each point, and ray coverage.
type Seen<'py> = (Vec<&'static str>, Bound<'py, PyArray1<u32>>);

fn covariance(name: &str) -> PyResult<Covariance> {
    choose("covariance", name)
}

/// Reads a field: `.oct`, or the official code's `.npy` with the space that it covers and its number of rays.
#[pyfunction]
#[pyo3(signature = (path, options, rays = None))]
pub fn load(py: Python<'_>, path: PathBuf, options: &Bound<'_, PyDict>, rays: Option<u64>) -> PyResult<Uncertainty> {
    let options = Options(options);
    let domain = options.domain()?;
    let read = || match domain {
        Some(domain) => {
            let rays = rays.unwrap_or(OfficialGrid::DEFAULT_RAYS);
            OfficialGrid { domain, rays, lambda: None }.read(&path)
        }
        None => refuse_model(&path).and_then(|()| UncertaintyField::read(&path)),
    };
    without_python(py, read)?.or_raise().map(Uncertainty::from)
}

#[pymethods]
impl Uncertainty {
    /// Estimates at points `[n, 3]`.
    fn query<'py>(&self, py: Python<'py>, x: PyReadonlyArray2<'py, f32>) -> PyResult<Estimates<'py>> {
        let x = points(&x)?;
        let found = without_python(py, || self.field.query_all(&x))?;
        let numbers = |of: &dyn Fn(usize) -> f64| PyArray1::from_iter(py, (0..found.len()).map(of));
        Ok((
            numbers(&|i| found[i].uncertainty),
            numbers(&|i| found[i].log10_error.unwrap_or(f64::NAN)),
            numbers(&|i| found[i].rays.unwrap_or(f64::NAN)),
            PyArray1::from_iter(py, found.iter().map(|estimate| estimate.level)),
            PyArray1::from_iter(py, found.iter().map(|estimate| estimate.inside)),
        ))
    }

    /// `constrained`, `free` or `unseen` for points `[n, 3]`, and ray coverage; `None` if unknown.
    fn seen<'py>(&self, py: Python<'py>, x: PyReadonlyArray2<'py, f32>) -> PyResult<Option<Seen<'py>>> {
        let x = points(&x)?;
        let Some(ray_coverage) = self.field.ray_coverage() else { return Ok(None) };
        let (names, counts) = without_python(py, || {
            let found = self.field.query_all(&x);
            let observability = x.iter().zip(&found).map(|(&x, found)| self.field.observability(x, found.uncertainty));
            let names: Vec<&str> = observability.map(|seen| seen.map_or("", Observability::name)).collect();
            let counts: Vec<u32> = x.iter().map(|&x| ray_coverage.at(x).unwrap_or(0)).collect();
            (names, counts)
        })?;
        Ok(Some((names, PyArray1::from_vec(py, counts))))
    }

    /// Covariance matrices `[n, 3, 3]` at points `[n, 3]`, of a kind or the field's own.
    #[pyo3(signature = (x, kind = None))]
    fn covariance<'py>(
        &self,
        py: Python<'py>,
        x: PyReadonlyArray2<'py, f32>,
        kind: Option<&str>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let x = points(&x)?;
        let kind = kind.map(covariance).transpose()?.unwrap_or(self.field.record().covariance);
        let found = without_python(py, || self.field.covariances(&x, kind))?.or_raise()?;
        let full = found.iter().flat_map(|[xx, xy, xz, yy, yz, zz]| [xx, xy, xz, xy, yy, yz, xz, yz, zz]).copied();
        PyArray1::from_iter(py, full).reshape([x.len(), 3, 3])
    }

    /// Counts of rays that reached each cell of a coarse grid, x slowest; `None` if unknown.
    #[getter]
    fn ray_coverage<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray3<u32>>>> {
        let Some(ray_coverage) = self.field.ray_coverage() else { return Ok(None) };
        let counts = ray_coverage.counts();
        let side = (counts.len() as f64).cbrt().round() as usize;
        PyArray1::from_slice(py, counts).reshape([side; 3]).map(Some)
    }

    /// Points on visible surfaces, `[n, 3]`.
    #[getter]
    fn surface<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let points = self.field.surface();
        PyArray1::from_iter(py, points.iter().flatten().copied()).reshape([points.len(), 3])
    }

    /// The same field read with another covariance.
    fn with_covariance(&self, py: Python<'_>, kind: &str) -> PyResult<Self> {
        let kind = covariance(kind)?;
        let field = without_python(py, || (*self.field).clone().with_covariance(kind))?.or_raise()?;
        Ok(field.into())
    }

    /// Writes an `.oct` file.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        without_python(py, || self.field.write(&path))?.or_raise()
    }

    /// The field without what only merging needs.
    fn for_queries(&self, py: Python<'_>) -> PyResult<Self> {
        without_python(py, || (*self.field).clone().for_queries()).map(Self::from)
    }

    /// log10 U that the most certain `share` of visible surfaces does not exceed; `None` without such points.
    fn surface_quantile(&self, py: Python<'_>, share: f64) -> PyResult<Option<f64>> {
        without_python(py, || self.field.surface_quantiles([share]).map(|[log10]| log10))
    }

    /// log10 U of a threshold, a number or a text, and what a user should know.
    fn threshold(&self, py: Python<'_>, threshold: &Bound<'_, PyAny>) -> PyResult<(f64, Vec<Said>)> {
        let threshold = match threshold.extract::<String>() {
            Err(_) => Threshold::Log10(threshold.extract()?),
            Ok(text) => Threshold::parse(&text)
                .map_err(|expected| PyValueError::new_err(format!("threshold: {expected}, found {text}")))?,
        };
        let mut texts = Vec::new();
        let log10 = without_python(py, || {
            threshold.log10(&BakedField::unbaked(&self.field), &mut |remark| texts.push(said(remark)))
        })?;
        Ok((log10.or_raise()?, texts))
    }

    /// U where nothing was seen, scene units.
    #[getter]
    fn prior(&self) -> f64 {
        self.field.prior()
    }

    /// The finest level.
    #[getter]
    fn level(&self) -> u8 {
        self.field.lattice().level()
    }

    /// Corners of the box; `None` if all of space is covered, contracted.
    #[getter]
    fn r#box(&self) -> Option<[[f64; 3]; 2]> {
        let Domain::Box(bounds) = self.field.lattice().domain() else { return None };
        Some([bounds.min().to_array(), bounds.max().to_array()])
    }

    /// The space that is covered, in words.
    #[getter]
    fn domain(&self) -> String {
        self.field.lattice().domain().to_string()
    }

    /// True if the sums are kept, from which other covariances can be read.
    #[getter]
    fn keeps_sums(&self) -> bool {
        self.field.sums().is_some()
    }

    /// True if there are error bars.
    #[getter]
    fn has_error_bars(&self) -> bool {
        self.field.error_bars().is_some()
    }

    /// The calibrated interval of depth; JSON, or none.
    fn conformal(&self) -> Option<String> {
        self.field.conformal().map(|conformal| serde_json::json!(conformal).to_string())
    }

    /// True if these are only some of the rays of a run.
    #[getter]
    fn is_part(&self) -> bool {
        self.field.is_part()
    }

    /// Everything that the numbers depend on, as JSON.
    fn record(&self) -> PyResult<String> {
        json(self.field.record())
    }

    /// What the run reported that computed it, or else what a field knows of itself, as JSON.
    fn report(&self, py: Python<'_>) -> PyResult<String> {
        match &self.report {
            Some(report) => Ok(report.clone()),
            None => json(&without_python(py, || described(&self.field))?),
        }
    }

    /// Size and structure, as JSON.
    fn summary(&self, py: Python<'_>) -> PyResult<String> {
        json(&without_python(py, || self.field.summary())?)
    }
}

/// A value as JSON.
pub fn json(value: &impl serde::Serialize) -> PyResult<String> {
    serde_json::to_string(value).map_err(|e| PyValueError::new_err(e.to_string()))
}
