//! Files for other people's tools.

use std::path::PathBuf;

use numpy::PyReadonlyArray2;
use octobayes::Error;
use octobayes::estimate::{Model, RaySettings};
use octobayes::geometry::Camera;
use octobayes::uncertainty::{BakedField, UncertaintyField};
use octobayes_data::write_official;
use octobayes_show::export::{
    MeshSettings, Surfaces, surfaces, write_hyper_tree, write_leaves, write_mesh, write_points, write_report,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::errors::OrRaise;
use crate::field::Uncertainty;
use crate::options::{Options, cameras};
use crate::pool::without_python;
use crate::run::Source;
use crate::work::{Engine, work};

/// Writes what needs the field alone; `kind` is "official", "leaves" or "hyper tree".
#[pyfunction]
pub fn export_field(py: Python<'_>, field: &Bound<'_, Uncertainty>, path: PathBuf, kind: &str) -> PyResult<()> {
    let field = field.get().field.clone();
    without_python(py, || match kind {
        "leaves" => {
            let matrices = field.sums().map(|_| field.matrices(field.record().covariance)).transpose()?;
            write_leaves(&path, &field, matrices.as_ref())
        }
        "hyper tree" => write_hyper_tree(&path, &field),
        _ => write_official(&field, &path),
    })?
    .or_raise()
}

/// What is written of a model's surfaces.
enum Kind {
    Points { ellipsoids: bool },
    Mesh(MeshSettings),
    Report { names: Vec<String> },
}

/// A file of a model's surfaces, but for the model.
struct Job<'a> {
    path: PathBuf,
    kind: Kind,
    settings: RaySettings,
    threshold: Option<f64>,
    pixels: u64,
    cameras: &'a [Camera],
}

/// Writes what needs the model, too. `names` are those of the cameras; `kind` is "points", "mesh" or "report".
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "one call from Python, by position")]
pub fn export_surfaces(
    py: Python<'_>,
    nerf: &Bound<'_, PyAny>,
    field: &Bound<'_, Uncertainty>,
    path: PathBuf,
    rows: PyReadonlyArray2<'_, f64>,
    names: Vec<String>,
    options: &Bound<'_, PyDict>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<()> {
    let (source, cameras, options) = (Source::new(nerf)?, cameras(&rows)?, Options(options));
    let kind = match options.or("kind", String::new())?.as_str() {
        "mesh" => {
            let resolution = options.or("cells", MeshSettings::default().resolution)?;
            Kind::Mesh(MeshSettings { resolution, density: options.get("density")? })
        }
        "report" => Kind::Report { names },
        _ => Kind::Points { ellipsoids: options.or("ellipsoids", false)? },
    };
    let job = Job {
        path,
        kind,
        settings: options.image(RaySettings::for_images())?,
        threshold: options.get("threshold")?,
        pixels: options.or("pixels", Surfaces::PIXELS)?,
        cameras: &cameras,
    };
    let field = field.get().field.clone();
    work(py, source.gate(nerf), progress, |engine| source.with(engine, |model| job.write(engine, model, &field)))
}

impl Job<'_> {
    fn write(self, engine: &Engine, model: &dyn Model, uncertainty: &UncertaintyField) -> octobayes::Result<()> {
        let unbaked = BakedField::unbaked(uncertainty);
        let part = self.threshold.map(|threshold| model.certain_part(&unbaked, threshold)).transpose()?.flatten();
        let shown = part.as_deref().unwrap_or(model);
        if let Kind::Mesh(settings) = self.kind {
            let refused = || Error::setting("mesh", "a volume, which has a density", model.kind());
            let volume = shown.field().ok_or_else(refused)?;
            return write_mesh(&self.path, volume, uncertainty, settings, engine.monitor()).map(|_| ());
        }
        let renderer = shown.for_images(&self.settings, engine.monitor())?;
        let offset = self.settings.offset_for(shown);
        let found = surfaces(&*renderer, self.cameras, offset, self.pixels, engine.monitor())?;
        match self.kind {
            Kind::Report { names } => write_report(&self.path, &found, &names, uncertainty),
            Kind::Points { ellipsoids } => {
                let covariance = uncertainty.record().covariance;
                let matrices = ellipsoids.then(|| uncertainty.matrices(covariance)).transpose()?;
                write_points(&self.path, &found, uncertainty, matrices.as_ref())
            }
            Kind::Mesh(_) => Ok(()),
        }
    }
}
