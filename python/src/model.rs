//! A model that the library reads.

use std::path::PathBuf;

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use octobayes::Error;
use octobayes::field::{Intrinsics, Radiance, RadianceField, RadianceJet};
use octobayes::glam::Vec3;
use octobayes_models::Coordinates;
use octobayes_session::OpenedModel;
use pyo3::prelude::*;
use rayon::prelude::*;

use crate::errors::{OrRaise, Said, said};
use crate::field::Uncertainty;
use crate::options::{choose, numbers};
use crate::pool::without_python;

/// Points that one thread evaluates at a time.
const CHUNK: usize = 4096;

/// A model of the library that is a volume.
#[derive(Clone)]
pub struct Volume {
    pub opened: OpenedModel,
}

impl Volume {
    /// Opens the model that `name` names.
    ///
    /// # Errors
    /// As [`OpenedModel::open`], or if the model is no volume.
    fn open(name: &str, coordinates: Option<Coordinates>) -> octobayes::Result<Self> {
        let opened = OpenedModel::open(name, coordinates, None)?;
        opened.volume()?;
        Ok(Self { opened })
    }

    /// The field.
    pub fn field(&self) -> &dyn RadianceField {
        self.opened.model.field().expect("a volume was opened")
    }
}

/// A radiance field in Rust.
#[pyclass(frozen, module = "octobayes._octobayes")]
pub struct Model(pub Volume);

/// Rows of an array `[n, 3]`.
fn triples<'a>(array: &'a PyReadonlyArray2<f32>) -> PyResult<&'a [[f32; 3]]> {
    Ok(array.as_slice()?.as_chunks::<3>().0)
}

fn vectors(triples: &[[f32; 3]]) -> Vec<Vec3> {
    triples.iter().copied().map(Vec3::from_array).collect()
}

/// Rows of an array `[n, 3]` as points.
pub fn points(array: &PyReadonlyArray2<f32>) -> PyResult<Vec<Vec3>> {
    triples(array).map(vectors)
}

type Array1<'py> = Bound<'py, PyArray1<f32>>;
type Array2<'py> = Bound<'py, PyArray2<f32>>;

fn rows<const N: usize>(py: Python<'_>, values: Vec<[f32; N]>) -> PyResult<Array2<'_>> {
    let n = values.len();
    PyArray1::from_vec(py, values.into_flattened()).reshape([n, N])
}

#[pymethods]
impl Model {
    /// Opens the model that `name` names.
    #[new]
    #[pyo3(signature = (name, coordinates = None))]
    fn new(py: Python<'_>, name: String, coordinates: Option<&str>) -> PyResult<Self> {
        let coordinates = coordinates.map(|found| choose("coordinates", found)).transpose()?;
        without_python(py, || Volume::open(&name, coordinates))?.or_raise().map(Self)
    }

    /// What a user should know if a field, named `name`, does not belong to the model.
    fn check(&self, field: &Bound<'_, Uncertainty>, name: PathBuf) -> PyResult<Vec<Said>> {
        let mut texts = Vec::new();
        self.0.opened.check(&field.get().field, &name, true, &mut |remark| texts.push(said(remark))).or_raise()?;
        Ok(texts)
    }

    /// Checksum of what was opened: content and coordinates.
    #[getter]
    fn checksum(&self) -> u32 {
        self.0.opened.checksum
    }

    /// Density `[n]` and colour `[n, 3]` at `x` `[n, 3]`, seen along `d` `[n, 3]`.
    fn radiance<'py>(
        &self,
        py: Python<'py>,
        x: PyReadonlyArray2<'py, f32>,
        d: PyReadonlyArray2<'py, f32>,
    ) -> PyResult<(Array1<'py>, Array2<'py>)> {
        let (x, d) = (triples(&x)?, triples(&d)?);
        let (mut density, mut color) = (vec![0.0; x.len()], vec![[0.0; 3]; x.len()]);
        without_python(py, || {
            let parts = x.par_chunks(CHUNK).zip(d.par_chunks(CHUNK));
            let parts = parts.zip(density.par_chunks_mut(CHUNK).zip(color.par_chunks_mut(CHUNK)));
            parts.for_each(|((x, d), (density, color))| {
                let mut radiance = vec![Radiance::default(); x.len()];
                self.0.field().evaluate(&vectors(x), &vectors(d), &mut radiance);
                for ((density, color), r) in density.iter_mut().zip(color).zip(radiance) {
                    (*density, *color) = (r.density, r.color.to_array());
                }
            });
        })?;
        Ok((PyArray1::from_vec(py, density), rows(py, color)?))
    }

    /// Density `[n]` at `x` `[n, 3]`.
    fn density<'py>(&self, py: Python<'py>, x: PyReadonlyArray2<'py, f32>) -> PyResult<Array1<'py>> {
        let x = triples(&x)?;
        let mut density = vec![0.0; x.len()];
        without_python(py, || {
            let parts = x.par_chunks(CHUNK).zip(density.par_chunks_mut(CHUNK));
            parts.for_each(|(x, out)| self.0.field().densities(&vectors(x), out));
        })?;
        Ok(PyArray1::from_vec(py, density))
    }

    /// Density `[n]`, colour `[n, 3]`, ∇ density `[n, 3]` and ∇ colour `[n, 9]` (channel, then axis).
    fn derivatives<'py>(
        &self,
        py: Python<'py>,
        x: PyReadonlyArray2<'py, f32>,
        d: PyReadonlyArray2<'py, f32>,
    ) -> PyResult<(Array1<'py>, Array2<'py>, Array2<'py>, Array2<'py>)> {
        let field = self.0.field().differentiable().ok_or_else(|| {
            let found = format!("one that does not: {}", self.0.opened.model.describe());
            Error::setting("derivatives", "a model that differentiates itself", found)
        });
        let (field, x, d) = (field.or_raise()?, triples(&x)?, triples(&d)?);
        let (mut density, mut color) = (vec![0.0; x.len()], vec![[0.0; 3]; x.len()]);
        let (mut slope, mut color_gradient) = (vec![[0.0; 3]; x.len()], vec![[0.0; 9]; x.len()]);
        without_python(py, || {
            let parts = x.par_chunks(CHUNK).zip(d.par_chunks(CHUNK));
            let values = density.par_chunks_mut(CHUNK).zip(color.par_chunks_mut(CHUNK));
            let slopes = slope.par_chunks_mut(CHUNK).zip(color_gradient.par_chunks_mut(CHUNK));
            parts.zip(values.zip(slopes)).for_each(|((x, d), ((density, color), (slope, color_gradient)))| {
                let mut jets = vec![RadianceJet::default(); x.len()];
                field.jets(&vectors(x), &vectors(d), &mut jets);
                for (i, jet) in jets.iter().enumerate() {
                    (density[i], color[i]) = (jet.value.density, jet.value.color.to_array());
                    slope[i] = jet.density_gradient.to_array();
                    // A jet has one colour for each axis; Python's rows are channels.
                    color_gradient[i] = std::array::from_fn(|k| jet.color_gradients[k % 3][k / 3]);
                }
            });
        })?;
        Ok((PyArray1::from_vec(py, density), rows(py, color)?, rows(py, slope)?, rows(py, color_gradient)?))
    }

    /// Rows of numbers of the model's cameras, `[cameras, 26]`; `None` if it has none. `fov` in degrees.
    #[pyo3(signature = (fov = None, resolution = None))]
    fn cameras<'py>(
        &self,
        py: Python<'py>,
        fov: Option<f64>,
        resolution: Option<[u32; 2]>,
    ) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        let intrinsics = Intrinsics { fov_x: fov.map(f64::to_radians), resolution };
        let cameras = self.0.opened.model.cameras(&intrinsics).or_raise()?;
        cameras
            .map(|all| PyArray1::from_vec(py, numbers(&all)).reshape([all.len(), crate::options::NUMBERS]))
            .transpose()
    }

    /// True if the model computes its own derivatives.
    #[getter]
    fn is_differentiable(&self) -> bool {
        self.0.field().differentiable().is_some()
    }

    /// Lower and upper corner of the box outside which the density is zero.
    #[getter]
    fn r#box(&self) -> [[f64; 3]; 2] {
        let bounds = self.0.field().bounds();
        [bounds.min(), bounds.max()].map(|corner| corner.to_array())
    }

    /// Distance between samples along a ray that resolves the model, scene units.
    #[getter]
    fn step(&self) -> f64 {
        self.0.field().suggested_step()
    }

    /// Where in a pixel the training rays went.
    #[getter]
    fn pixel_offset(&self) -> f64 {
        self.0.opened.model.pixel_offset()
    }

    /// The name or file.
    #[getter]
    fn name(&self) -> &str {
        &self.0.opened.name
    }

    /// The name, with the checksum of the file and the coordinates.
    #[getter]
    fn source(&self) -> &str {
        &self.0.opened.source
    }

    /// One line: architecture and size.
    #[getter]
    fn description(&self) -> String {
        self.0.opened.model.describe()
    }
}
