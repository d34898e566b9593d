//! What a scene would be better without.

use std::path::PathBuf;

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use octobayes::Error;
use octobayes::glam::Vec3;
use octobayes_clean::{Baking, Clean, Cleaned as Parts, CleanedVolume, Evidence, Removal, VolumeFile};
use octobayes_data::read_masks;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::model::Volume;
use crate::options::{Options, cameras, choose};
use crate::run::{Source, views};
use crate::splats::OpenedSplats;
use crate::work::work;

/// The parts of a model, and what goes of them.
#[pyclass(frozen, module = "octobayes._octobayes")]
pub struct Cleaned(Found);

enum Found {
    Splats { opened: OpenedSplats, parts: Box<Parts> },
    Volume(Box<FoundVolume>),
}

struct FoundVolume {
    volume: Volume,
    file: VolumeFile,
    eyes: Vec<Vec3>,
    found: CleanedVolume,
}

/// Looks at a model through its training cameras.
#[pyfunction]
pub fn clean(
    py: Python<'_>,
    nerf: &Bound<'_, PyAny>,
    rows: PyReadonlyArray2<'_, f64>,
    options: &Bound<'_, PyDict>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<Cleaned> {
    let (source, rows, options) = (Source::new(nerf)?, cameras(&rows)?, Options(options));
    let views = views(&options, &rows)?;
    let (pixel_offset, pixels) = (options.or("pixel_offset", 0.5)?, options.or("pixels", Clean::PIXELS)?);
    let points = options.or("points", Baking::POINTS)?;
    work(py, None, progress, move |engine| {
        let masks = read_masks(&views.frames)?;
        let clean = Clean::new(&rows).masks(&masks).pixel_offset(pixel_offset).pixels(pixels);
        let clean = clean.monitor(engine.monitor());
        match source {
            Source::Splats(opened) => {
                let parts = clean.splats(opened.splats())?;
                Ok(Cleaned(Found::Splats { opened, parts: Box::new(parts) }))
            }
            Source::Rust(volume) => {
                let (model, file) = (&*volume.opened.model, VolumeFile::of(&volume.opened.name)?);
                let found = clean.volume(model, file.cells(model, points)?)?;
                let eyes = rows.iter().map(|camera| camera.position.as_vec3()).collect();
                Ok(Cleaned(Found::Volume(Box::new(FoundVolume { volume, file, eyes, found }))))
            }
            Source::Python(_) => Err(Error::setting("nerf", "a model file, or open_model of one", "a callable")),
        }
    })
}

type Array2<'py> = Bound<'py, PyArray2<f32>>;

#[pymethods]
impl Cleaned {
    /// Where each part is, `[n, 3]`, and by name, `[n]`: why it goes (0 stays, else the number of its reason), at which
    /// strength (0 stays, else its number from 1), how far the views contradict it, and what they show of it.
    fn columns<'py>(&self, py: Python<'py>) -> PyResult<(Array2<'py>, Bound<'py, PyDict>)> {
        let (parts, positions) = match &self.0 {
            Found::Splats { opened, parts } => (&**parts, opened.splats().means().to_vec()),
            Found::Volume(of) => (&of.found.cleaned, of.found.centers()),
        };
        let of = |value: fn(&Removal) -> u8| -> Vec<u8> {
            parts.removals.iter().map(|removal| removal.as_ref().map_or(0, |removal| 1 + value(removal))).collect()
        };
        let columns = PyDict::new(py);
        columns.set_item("reason", PyArray1::from_vec(py, of(|removal| removal.reason as u8)))?;
        columns.set_item("strength", PyArray1::from_vec(py, of(|removal| removal.strength as u8)))?;
        columns.set_item("score", PyArray1::from_slice(py, &parts.scores))?;
        columns.set_item("front_share", PyArray1::from_vec(py, front_shares(&parts.evidence)))?;
        columns.set_item("weight", PyArray1::from_slice(py, &parts.evidence.weight))?;
        columns.set_item("views", PyArray1::from_slice(py, &parts.evidence.views))?;
        let numbers: Vec<f32> = positions.iter().flat_map(Vec3::to_array).collect();
        Ok((PyArray1::from_vec(py, numbers).reshape([positions.len(), 3])?, columns))
    }

    /// Writes what stays at a strength, in the format of the path's extension; `points` along the longest edge of a
    /// voxel grid that a volume becomes.
    fn write(
        &self,
        py: Python<'_>,
        path: PathBuf,
        strength: &str,
        points: u32,
        progress: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let strength = choose("strength", strength)?;
        work(py, None, progress, |engine| match &self.0 {
            Found::Splats { opened, parts } => {
                let kept: Vec<bool> = parts.removed(strength).iter().map(Option::is_none).collect();
                opened.splats().clone().keep(&kept)?.write(&path)
            }
            Found::Volume(of) => {
                let FoundVolume { volume, file, eyes, found } = &**of;
                let baking = Baking { model: &*volume.opened.model, points, eyes };
                file.write(found, strength, &path, &baking, engine.monitor())
            }
        })
    }
}

/// `[n]`: the part of each weight that is in front of what pixels show.
pub fn front_shares(of: &Evidence) -> Vec<f64> {
    (0..of.weight.len()).map(|i| of.front_share(i)).collect()
}
