//! From a model and its cameras to its uncertainty.

use std::path::PathBuf;

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use octobayes::estimate::{self, Checkpoint, Goal};
use octobayes::geometry::{Camera, Mask};
use octobayes::glam::Vec3;
use octobayes::monitor::Message;
use octobayes_data::{Frame, MaskFile, Part, ResolutionSource, Views, camera_file, passed_over};
use octobayes_session::{CameraSource, OpenedModel, Session};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::json;

use crate::errors::{OrRaise, Said, said};
use crate::field::{Uncertainty, computed};
use crate::model::{Model, Volume};
use crate::options::{NUMBERS, Options, cameras, numbers};
use crate::pool::without_python;
use crate::splats::{OpenedSplats, Splats};
use crate::work::{Engine, PythonField, Traits, work};

/// A model of the library, or a field in Python.
pub enum Source {
    Rust(Volume),
    Splats(OpenedSplats),
    Python(Traits),
}

impl Source {
    /// The model, or what is known of the callable behind a gate.
    pub fn new(nerf: &Bound<'_, PyAny>) -> PyResult<Self> {
        if let Ok(model) = nerf.cast::<Model>() {
            return Ok(Self::Rust(model.get().0.clone()));
        }
        if let Ok(splats) = nerf.cast::<Splats>() {
            return Ok(Self::Splats(splats.get().0.clone()));
        }
        let traits = nerf.getattr("traits")?.cast_into::<PyDict>()?;
        let options = Options(&traits);
        let missing = |what: &str| PyValueError::new_err(format!("nerf: expected {what}, found none"));
        Ok(Self::Python(Traits {
            bounds: options.bounds()?.ok_or_else(|| missing("a box"))?,
            step: options.get("step")?.ok_or_else(|| missing("a step"))?,
            batch: options.get("batch")?.ok_or_else(|| missing("a batch"))?,
            pixel_offset: options.or("pixel_offset", 0.5)?,
            has_density: options.or("has_density", false)?,
            has_derivatives: options.or("has_derivatives", false)?,
            description: options.or("description", String::new())?,
        }))
    }

    /// Calls `job` with the model.
    pub fn with<T>(&self, engine: &Engine, job: impl FnOnce(&dyn estimate::Model) -> T) -> T {
        match self {
            Self::Rust(model) => job(&*model.opened.model),
            Self::Splats(splats) => job(&*splats.opened.model),
            Self::Python(traits) => {
                let field: PythonField = engine.field(traits.clone());
                job(&field)
            }
        }
    }

    /// The model of the library, if it is one.
    pub fn opened(&self) -> Option<&OpenedModel> {
        match self {
            Self::Rust(model) => Some(&model.opened),
            Self::Splats(splats) => Some(&splats.opened),
            Self::Python(_) => None,
        }
    }

    /// What there is in Python to ask.
    pub fn gate<'a, 'py>(&self, nerf: &'a Bound<'py, PyAny>) -> Option<&'a Bound<'py, PyAny>> {
        matches!(self, Self::Python(_)).then_some(nerf)
    }
}

/// Computes an uncertainty field, or says as JSON what that will need. Returns it with what a user should know.
#[pyfunction]
pub fn uncertainty(
    py: Python<'_>,
    nerf: &Bound<'_, PyAny>,
    rows: PyReadonlyArray2<'_, f64>,
    options: &Bound<'_, PyDict>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<(Option<Uncertainty>, Vec<Said>, String)> {
    let (source, cameras, options) = (Source::new(nerf)?, cameras(&rows)?, Options(options));
    let views = views(&options, &cameras)?;
    let chosen = source.opened().is_some_and(|opened| opened.coordinates.is_some());
    let checksum = source.opened().map(|opened| opened.checksum);
    let model_file = source.opened().map(|opened| PathBuf::from(&opened.name));
    let restart = options.or("restart", false)?;
    let checkpoint = options.get::<PathBuf>("checkpoint")?;
    let name = options.or("source", String::new())?;
    let session = without_python(py, || Session::new(views, name))?.or_raise()?;
    let session = match masks(&options, &cameras)? {
        Some(masks) => session.masks(masks),
        None => session,
    };
    let goal = Goal::of(options.get("target_error")?, options.get("shard")?, options.get("error_bars")?);
    let session = session
        .checksum(checksum)
        .domain(options.domain()?)
        .rays(options.rays()?)
        .background(options.get("background")?.map(Vec3::from_array))
        .model_file(model_file)
        .grid(options.grid()?)
        .choices(options.choices()?)
        .goal(goal)
        .checkpoint(checkpoint.map(|path| Checkpoint::new(path).restart(restart)))
        .scratch(options.get("scratch")?)
        .dump(options.get("dump_samples")?)
        .audit(options.or("audit", false)?)
        .force(options.or("force", false)?)
        .has_chosen_coordinates(chosen && options.or("is_file", false)?)
        .has_given_fov(options.or("has_fov", false)?);
    let (gate, is_dry) = (source.gate(nerf), options.or("dry_run", false)?);
    let (field, texts, needs) = work(py, gate, progress, move |engine| {
        source.with(engine, |model| {
            let mut texts = Vec::new();
            let mut tell = |remark| texts.push(said(remark));
            let prepared = session.prepare(model, engine.monitor(), &mut tell)?;
            if is_dry {
                let needs = prepared.needs()?;
                return Ok((None, texts, json!(needs).to_string()));
            }
            let finished = prepared.finish(&mut tell)?;
            // Whoever holds the result has nothing to resume.
            finished.remove_checkpoint()?;
            Ok((Some(computed(finished)), texts, String::new()))
        })
    })?;
    Ok((field.map(Uncertainty::of_run), texts, needs))
}

/// The cameras, with the names, images and masks that lie beside them.
pub fn views(options: &Options, cameras: &[Camera]) -> PyResult<Views> {
    let names = options.or("names", Vec::<String>::new())?.into_iter().chain(std::iter::repeat_with(String::new));
    let beside = options.or("beside", Vec::<Beside>::new())?.into_iter().map(Some).chain(std::iter::repeat(None));
    let frame = |((&camera, name), beside): ((&Camera, String), Option<Beside>)| {
        let Some((image, mask, size)) = beside else { return Frame::new(camera, name, "") };
        let mask = mask.map(|(path, keeps)| if keeps { MaskFile::Kept(path) } else { MaskFile::LeftOut(path) });
        Frame { mask, size, ..Frame::new(camera, name, image) }
    };
    let resolution_source =
        if options.or("is_assumed", false)? { ResolutionSource::Assumed } else { ResolutionSource::File };
    let frames = cameras.iter().zip(names).zip(beside).map(frame).collect();
    Ok(Views { path: "cameras".into(), frames, resolution_source, notes: Vec::new() })
}

/// Masks from arrays of bool `[H, W]`, if there are any.
fn masks(options: &Options, cameras: &[Camera]) -> PyResult<Option<Vec<Option<Mask>>>> {
    let Some(given) = options.get::<Vec<Option<PyReadonlyArray2<'_, bool>>>>("masks")? else { return Ok(None) };
    let mask = |(camera, given): (&Camera, Option<PyReadonlyArray2<'_, bool>>)| {
        let given = given?;
        let kept = given.as_array();
        Some(Mask::new(camera.resolution, |column, row| kept[[row as usize, column as usize]]))
    };
    Ok(Some(cameras.iter().zip(given).map(mask).collect()))
}

/// Path of a camera's image, which need not exist; path of its mask, if it has one, and whether that keeps what is not
/// black; and the size of both, pixels.
type Beside = (PathBuf, Option<(PathBuf, bool)>, [u32; 2]);

/// Rows of numbers, the frames' names, what lies beside the cameras, what they are, whether their size is assumed, and
/// what a user should know.
type Cameras<'py> = (Bound<'py, PyArray2<f64>>, Vec<String>, Vec<Beside>, String, bool, Vec<Said>);

/// The cameras that a model was trained on: of a file, of which `views` are taken ("all", a number of frames or their
/// numbers; all frames of either part without a model or a choice if `every_frame`), or else the model's own.
#[pyfunction]
pub fn read_cameras<'py>(
    py: Python<'py>,
    model: Option<&Bound<'py, Model>>,
    path: Option<PathBuf>,
    every_frame: bool,
    options: &Bound<'py, PyDict>,
) -> PyResult<Cameras<'py>> {
    let options = Options(options);
    // A folder means the same file as on the command line.
    let file = path.as_ref().map(|path| camera_file(path, Part::Training));
    let note = path.zip(file.as_ref()).and_then(|(path, file)| passed_over(&path, file));
    let (fov, resolution) = (options.get("fov")?, options.resolution()?);
    let from = CameraSource { file, fov, resolution, ..CameraSource::default() };
    let selection = options.selection()?;
    let model = model.map(|model| model.get().0.clone());
    let mut texts: Vec<Said> = note.map(Message::Note).map(said).into_iter().collect();
    let (views, source) = py
        .detach(|| {
            let mut tell = |remark| texts.push(said(remark));
            let model = model.as_ref().map(|model| (&*model.opened.model, &*model.opened.name));
            if every_frame {
                return Ok((from.read(model, &mut tell)?, String::new()));
            }
            from.training(&selection, model, &mut tell).map(|cameras| (cameras.views, cameras.source))
        })
        .or_raise()?;
    let (all, is_assumed) = (views.cameras(), views.resolution_source == ResolutionSource::Assumed);
    let beside = |frame: Frame| {
        let mask = frame.mask.map(|mask| (mask.path().to_path_buf(), matches!(mask, MaskFile::Kept(_))));
        (frame.name, (frame.image, mask, frame.size))
    };
    let (names, beside) = views.frames.into_iter().map(beside).unzip();
    let rows = PyArray1::from_vec(py, numbers(&all)).reshape([all.len(), NUMBERS])?;
    Ok((rows, names, beside, source, is_assumed, texts))
}
