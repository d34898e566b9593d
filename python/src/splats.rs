//! Gaussian splats as arrays, and as the model of a run.

use std::path::PathBuf;

use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray2};
use octobayes::{Error, Result};
use octobayes_clean::Evidence;
use octobayes_session::OpenedModel;
use octobayes_show::export::write_splats;
use octobayes_splats::{RenderMode, Splats as Gaussians};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::clean::front_shares;
use crate::errors::{OrRaise, Said, said};
use crate::field::Uncertainty;
use crate::options::{Options, cameras, choose};
use crate::pool::without_python;
use crate::view::image_settings;
use crate::work::work;

/// Splats, and the file that they are from.
#[derive(Clone)]
pub struct OpenedSplats {
    pub opened: OpenedModel,
}

impl OpenedSplats {
    /// The splats.
    pub fn splats(&self) -> &Gaussians {
        Gaussians::of(&*self.opened.model).expect("splats were opened")
    }
}

/// Gaussian splats in Rust.
#[pyclass(frozen, module = "octobayes._octobayes")]
pub struct Splats(pub OpenedSplats);

fn open(name: &str, mode: Option<RenderMode>) -> Result<OpenedSplats> {
    let opened = OpenedModel::open(name, None, mode)?;
    if Gaussians::of(&*opened.model).is_none() {
        return Err(Error::setting(format!("model `{name}`"), "Gaussian splats", opened.model.kind()));
    }
    Ok(OpenedSplats { opened })
}

impl Splats {
    fn triples<'py>(&self, py: Python<'py>, of: impl Fn(usize) -> [f32; 3]) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let n = self.0.splats().len();
        PyArray1::from_vec(py, (0..n).flat_map(of).collect()).reshape([n, 3])
    }
}

#[pymethods]
impl Splats {
    /// Opens a file of splats; `mode` is how they are drawn, if not as the file says.
    #[new]
    #[pyo3(signature = (name, mode = None))]
    fn new(py: Python<'_>, name: String, mode: Option<&str>) -> PyResult<Self> {
        let mode = mode.map(|found| choose("splat_mode", found)).transpose()?;
        without_python(py, || open(&name, mode))?.or_raise().map(Self)
    }

    /// Whether a file of this name is one of splats.
    #[staticmethod]
    fn is_file(name: PathBuf) -> bool {
        name.to_str().is_some_and(octobayes_models::is_of_splats)
    }

    /// What a user should know if a field, named `name`, does not belong to the splats.
    fn check(&self, field: &Bound<'_, Uncertainty>, name: PathBuf) -> PyResult<Vec<Said>> {
        let mut texts = Vec::new();
        self.0.opened.check(&field.get().field, &name, true, &mut |remark| texts.push(said(remark))).or_raise()?;
        Ok(texts)
    }

    /// Checksum of what was opened: content and mode.
    #[getter]
    fn checksum(&self) -> u32 {
        self.0.opened.checksum
    }

    fn __len__(&self) -> usize {
        self.0.splats().len()
    }

    /// Centres `[n, 3]`, scene units.
    #[getter]
    fn means<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        self.triples(py, |i| self.0.splats().mean(i).to_array())
    }

    /// Standard deviations along each splat's own axes `[n, 3]`, scene units.
    #[getter]
    fn scales<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        self.triples(py, |i| self.0.splats().scale(i).to_array())
    }

    /// Rotations from a splat's axes to the scene's `[n, 4]`: unit quaternions w, x, y, z.
    #[getter]
    fn rotations<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let n = self.0.splats().len();
        let of = |i: usize| {
            let [x, y, z, w] = self.0.splats().rotation(i).to_array();
            [w, x, y, z]
        };
        PyArray1::from_vec(py, (0..n).flat_map(of).collect()).reshape([n, 4])
    }

    /// Opacities at the centres `[n]`.
    #[getter]
    fn opacities<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f32>> {
        PyArray1::from_iter(py, (0..self.0.splats().len()).map(|i| self.0.splats().opacity(i)))
    }

    /// Spherical harmonics `[n, (degree + 1)², 3]`.
    #[getter]
    fn sh<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let (n, degree) = (self.0.splats().len(), usize::from(self.0.splats().degree()));
        let all = (0..n).flat_map(|i| self.0.splats().sh(i).to_vec()).collect();
        PyArray1::from_vec(py, all).reshape([n, (degree + 1) * (degree + 1), 3])
    }

    /// How small splats are drawn: "classic" or "mip".
    #[getter]
    fn mode(&self) -> String {
        self.0.splats().mode().to_string()
    }

    /// What a user should know of the file.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.0.splats().notes().to_vec()
    }

    /// Lower and upper corner of the box of all centres.
    #[getter]
    fn r#box(&self) -> [[f64; 3]; 2] {
        let bounds = self.0.splats().bounds();
        [bounds.min(), bounds.max()].map(|corner| corner.to_array())
    }

    /// The file.
    #[getter]
    fn name(&self) -> &str {
        &self.0.opened.name
    }

    /// The file with its checksum, and the mode if it was chosen.
    #[getter]
    fn source(&self) -> &str {
        &self.0.opened.source
    }

    /// One line: number, colours and mode.
    #[getter]
    fn description(&self) -> String {
        self.0.splats().describe()
    }
}

/// What some cameras show of each splat: sums of shares of pixels `[n]`, numbers of views `[n]`, and the part of these
/// shares that is in front of what the pixels show `[n]`.
type Seen<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<u32>>, Bound<'py, PyArray1<f64>>);

/// Looks at about `pixels` pixels of the cameras together.
#[pyfunction]
pub fn seen_splats<'py>(
    py: Python<'py>,
    splats: &Bound<'py, Splats>,
    rows: PyReadonlyArray2<'py, f64>,
    options: &Bound<'py, PyDict>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Seen<'py>> {
    let (splats, rows, options) = (splats.get().0.clone(), cameras(&rows)?, Options(options));
    let (settings, pixels) = (image_settings(&options)?, options.or("pixels", 0)?);
    let (seen, _) = work(py, None, progress, |engine| {
        let splats = splats.splats();
        Evidence::measure(splats, &rows, settings.offset_for(splats), pixels, engine.monitor())
    })?;
    let front = front_shares(&seen);
    let [weights, front] = [seen.weight, front].map(|values| PyArray1::from_vec(py, values));
    Ok((weights, PyArray1::from_vec(py, seen.views), front))
}

/// Writes the splats with their uncertainty; with cameras, what these show of them as well.
#[pyfunction]
pub fn export_splats(
    py: Python<'_>,
    splats: &Bound<'_, Splats>,
    field: &Bound<'_, Uncertainty>,
    path: PathBuf,
    rows: Option<PyReadonlyArray2<'_, f64>>,
    options: &Bound<'_, PyDict>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<()> {
    let (splats, field, options) = (splats.get().0.clone(), field.get().field.clone(), Options(options));
    let rows = rows.map(|rows| cameras(&rows)).transpose()?;
    let (settings, pixels) = (image_settings(&options)?, options.or("pixels", 0)?);
    let threshold = options.get::<f64>("threshold")?;
    work(py, None, progress, |engine| {
        let splats = splats.splats();
        let offset = settings.offset_for(splats);
        let measure = |rows: &Vec<_>| Evidence::measure(splats, rows, offset, pixels, engine.monitor());
        let seen = rows.as_ref().map(measure).transpose()?;
        write_splats(&path, splats, &field, seen.as_ref(), threshold).map(|_| ())
    })
}
