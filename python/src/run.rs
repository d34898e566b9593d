//! From a model and its cameras to its uncertainty.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use octobayes::Error;
use octobayes::dataset::{
    Frame, FrameSplit, MaskFile, Part, ResolutionSource, Selection, Views, check_masks, kept_pixels, read_masks,
};
use octobayes::estimate::{Checkpoint, Estimation, GridSettings, Outcome, RaySettings, Run, Sight};
use octobayes::evaluate::{TrainingImages, check_images};
use octobayes::field::RadianceField;
use octobayes::geometry::{Camera, Domain, Mask};
use octobayes::monitor::Monitor;
use octobayes::posterior::{DataScale, Scale};
use octobayes::rays::SamplesWriter;
use octobayes::uncertainty::{Misfit, UncertaintyField};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::errors::OrRaise;
use crate::field::Uncertainty;
use crate::model::Model;
use crate::options::{NUMBERS, Options, cameras, numbers};
use crate::work::{Engine, PythonField, Traits, work};

/// A model of the library, or a field in Python.
pub enum Source {
    Rust(Arc<dyn RadianceField>),
    Python(Traits),
}

impl Source {
    /// The model, or what is known of the callable behind a gate.
    pub fn new(nerf: &Bound<'_, PyAny>) -> PyResult<Self> {
        if let Ok(model) = nerf.cast::<Model>() {
            return Ok(Self::Rust(model.get().field.clone()));
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

    /// Calls `job` with the field.
    pub fn with<T>(&self, engine: &Engine, job: impl FnOnce(&dyn RadianceField) -> T) -> T {
        match self {
            Self::Rust(model) => job(&**model),
            Self::Python(traits) => {
                let field: PythonField = engine.field(traits.clone());
                job(&field)
            }
        }
    }

    /// What there is in Python to ask.
    pub fn gate<'a, 'py>(&self, nerf: &'a Bound<'py, PyAny>) -> Option<&'a Bound<'py, PyAny>> {
        matches!(self, Self::Python(_)).then_some(nerf)
    }
}

/// What a run draws.
enum Goal {
    All,
    Shard(u64, u64),
    Groups(u16),
    MeanError,
}

/// A run, but for its field.
struct Job {
    domain: Option<Domain>,
    rays: RaySettings,
    grid: GridSettings,
    scale: Option<ScaleOfData>,
    goal: Goal,
    checkpoint: Option<Checkpoint>,
    error_bars: Option<u16>,
    coarser_levels: u8,
    images: Option<Images>,
    /// The cameras with the images beside them, if they come from a file.
    frames: Vec<Frame>,
    /// Which pixels of each camera the model was trained on, if not all.
    masks: Vec<Option<Mask>>,
    /// Whether cameras are taken whose images the model does not show.
    force: bool,
    dump: Option<PathBuf>,
    source: String,
    checksum: Option<u32>,
}

/// Computes an uncertainty field. Returns it with its warnings.
#[pyfunction]
pub fn uncertainty(
    py: Python<'_>,
    nerf: &Bound<'_, PyAny>,
    rows: PyReadonlyArray2<'_, f64>,
    options: &Bound<'_, PyDict>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<(Uncertainty, Vec<String>)> {
    let (source, cameras, options) = (Source::new(nerf)?, cameras(&rows)?, Options(options));
    let domain = match (options.contraction()?, options.bounds()?) {
        (Some(contracted), _) => Some(contracted),
        (None, bounds) => bounds.map(Domain::Box),
    };
    let error_bars = options.get("error_bars")?;
    let goal = match (options.or("auto", false)?, options.get::<[u64; 2]>("shard")?, error_bars) {
        (true, ..) => Goal::MeanError,
        (_, Some([index, of]), _) => Goal::Shard(index, of),
        (.., Some(groups)) => Goal::Groups(groups),
        _ => Goal::All,
    };
    let every = Duration::from_secs_f64(options.or("checkpoint_every", 60.0)?);
    let resume = options.or("resume", false)?;
    let checkpoint = options.get::<PathBuf>("checkpoint")?;
    let frames = beside(&options, &cameras)?;
    let job = Job {
        domain,
        rays: options.rays()?,
        grid: options.grid()?,
        scale: options.or("of_data", false)?.then(|| ScaleOfData::new(&options)).transpose()?,
        goal,
        checkpoint: checkpoint.map(|path| Checkpoint::new(path).every(every).resume(resume)),
        error_bars,
        coarser_levels: options.or("coarser_levels", 0)?,
        images: Images::new(&options, &cameras)?,
        masks: masks(&options, &cameras, &frames)?,
        frames,
        force: options.or("force", false)?,
        dump: options.get("dump_samples")?,
        source: options.or("source", String::new())?,
        checksum: nerf.cast::<Model>().ok().map(|model| model.get().checksum),
    };
    let (field, warnings) =
        work(py, source.gate(nerf), progress, |engine| source.with(engine, |field| job.run(engine, field, &cameras)))?;
    Ok((Uncertainty(Arc::new(field)), warnings))
}

/// The cameras of a file with the images beside them; none if they come from elsewhere.
fn beside(options: &Options, cameras: &[Camera]) -> PyResult<Vec<Frame>> {
    let beside = options.or("beside", Vec::<Beside>::new())?;
    let frame = |(&camera, (image, mask, size)): (&Camera, Beside)| {
        let mask = mask.map(|(path, keeps)| if keeps { MaskFile::Kept(path) } else { MaskFile::LeftOut(path) });
        Frame { mask, size, ..Frame::new(camera, "", image) }
    };
    Ok(cameras.iter().zip(beside).map(frame).collect())
}

/// Masks from arrays of bool `[H, W]`, or else those that a file names.
fn masks(options: &Options, cameras: &[Camera], frames: &[Frame]) -> PyResult<Vec<Option<Mask>>> {
    let masks = match options.0.get_item("masks")?.filter(|masks| !masks.is_none()) {
        None => read_masks(frames).or_raise()?,
        Some(given) => {
            let given: Vec<Option<PyReadonlyArray2<'_, bool>>> = given.extract()?;
            let mask = |(camera, given): (&Camera, Option<PyReadonlyArray2<'_, bool>>)| {
                let given = given?;
                let kept = given.as_array();
                Some(Mask::new(camera.resolution, |column, row| kept[[row as usize, column as usize]]))
            };
            cameras.iter().zip(given).map(mask).collect()
        }
    };
    check_masks(Path::new("cameras"), &masks).or_raise()?;
    Ok(masks)
}

/// The training images, and how the model is rendered beside them.
struct Images {
    images: TrainingImages,
    settings: RaySettings,
}

impl Images {
    /// If they were given: `frames` are names in the folder `images`, or files.
    fn new(options: &Options, cameras: &[Camera]) -> PyResult<Option<Self>> {
        let Some(names) = options.get::<Vec<String>>("frames")? else { return Ok(None) };
        let frame = |(name, &camera): (String, &Camera)| Frame::new(camera, name.clone(), name);
        let frames: Vec<Frame> = names.into_iter().zip(cameras).map(frame).collect();
        let images = match options.get::<PathBuf>("images")? {
            Some(folder) => TrainingImages::find(&folder, &frames).or_raise()?,
            None => TrainingImages::new(frames).or_raise()?,
        };
        Ok(Some(Self { images, settings: options.image(RaySettings::for_images())? }))
    }

    /// Compares the model with them.
    fn misfit(&self, field: &dyn RadianceField, run: &Run, monitor: &dyn Monitor) -> octobayes::Result<Misfit> {
        let tracer = self.settings.tracer(field, 0.0, monitor)?;
        let offset = self.settings.offset_for(field);
        self.images.misfit(&tracer, offset, run.lattice(), monitor)
    }
}

/// What a scale in scene units is made from, beside the cameras.
struct ScaleOfData {
    noise: Option<f64>,
    prior_deviation: Option<f64>,
}

impl ScaleOfData {
    fn new(options: &Options) -> PyResult<Self> {
        let psnr = options.get::<f64>("psnr")?.map(DataScale::noise_of);
        Ok(Self { noise: options.get("noise")?.or(psnr), prior_deviation: options.get("prior_deviation")? })
    }

    /// The scale of a run over `domain`.
    fn of(&self, field: &dyn RadianceField, pixels: u64, domain: &Domain) -> octobayes::Result<Scale> {
        let noise = self.noise.or_else(|| field.training_noise()).ok_or_else(|| {
            let expected = "the noise that training left, as noise or psnr";
            Error::setting("scale='data'", expected, "neither, nor a model that records it")
        })?;
        let prior = self.prior_deviation.unwrap_or_else(|| DataScale::default_prior_deviation(domain));
        DataScale::new(pixels, noise, prior).map(Scale::Data)
    }
}

impl Job {
    fn run(
        self,
        engine: &Engine,
        field: &dyn RadianceField,
        cameras: &[Camera],
    ) -> octobayes::Result<(UncertaintyField, Vec<String>)> {
        let mut warnings = Vec::new();
        let mut dump = self.dump.as_deref().map(SamplesWriter::create).transpose()?;
        let domain = self.domain.unwrap_or_else(|| field.natural_domain());
        let pixels = kept_pixels(cameras, &self.masks);
        let scale = self.scale.map(|scale| scale.of(field, pixels, &domain)).transpose()?.unwrap_or_default();
        let estimation = Estimation::new(field, cameras)
            .masks(&self.masks)
            .domain(domain)
            .rays(self.rays)
            .grid(self.grid.scale(scale))
            .coarser_levels(self.coarser_levels)
            .source(self.source)
            .monitor(engine.monitor());
        let estimation = self.checksum.into_iter().fold(estimation, Estimation::model);
        let estimation = match self.goal {
            Goal::All => estimation,
            Goal::Shard(index, of) => estimation.shard(index, of),
            Goal::Groups(groups) => estimation.error_bars(groups),
            Goal::MeanError => estimation.until_mean_error(self.grid.tolerance),
        };
        let estimation = self.checkpoint.iter().cloned().fold(estimation, Estimation::checkpoint);
        let estimation = match &mut dump {
            Some(dump) => estimation.tap(|batches| dump.add(batches)),
            None => estimation,
        };
        let run = estimation.prepare()?;
        let sight = run.sight()?;
        warnings.extend(looked_at(&sight)?);
        warnings.extend(run.check_positions()?.warning());
        if let Some(check) = run.check_step()?.filter(|check| check.is_bad) {
            let best = check.errors.best().step;
            warnings.push(format!(
                "the finite-difference step of 1/{:.0} of a cell suits this field badly: step={best:.2e} has the least \
                 error",
                1.0 / check.step
            ));
        }
        // Before the rays, so that a wrong image ends the work at once.
        let misfit = self.images.as_ref().map(|images| images.misfit(field, &run, engine.monitor())).transpose()?;
        let frames = self.images.as_ref().map_or(&*self.frames, |images| images.images.frames());
        let stream = run.stream();
        if let Some(found) = check_images(&stream.tracer, frames, stream.pixel_offset, engine.monitor())? {
            if !self.force {
                found.refuse()?;
            }
            warnings.extend(found.warnings());
        }
        if let Some(outside) = sight.cut_off().map(|share| 100.0 * share) {
            warnings.push(format!("{outside:.1} % of what the rays meet lies outside the box: U is the prior there"));
        }
        let Outcome { field, progress, is_replanned, .. } = run.finish()?;
        if is_replanned {
            warnings.push("the rays took more or less memory than planned; the run started again".into());
        }
        if let Some(first) = progress.first_invalid {
            let dropped = progress.dropped;
            warnings.push(format!("{dropped} rays dropped, the field is not finite; first at {first:?}"));
        }
        if let Some(dump) = dump {
            dump.finish(progress.rays)?;
        }
        let field = match misfit {
            Some(misfit) => field.with_misfit(misfit)?,
            None => field,
        };
        // Whoever holds the result has nothing to resume.
        self.checkpoint.map_or(Ok(()), |checkpoint| checkpoint.remove(self.error_bars))?;
        Ok((field, warnings))
    }
}

/// Refuses cameras that see nothing; a warning if they see little.
fn looked_at(sight: &Sight) -> octobayes::Result<Option<String>> {
    let Some(causes) = sight.causes() else { return Ok(None) };
    let measured = sight.measured();
    if sight.is_nothing() {
        let expected = format!("rays that meet matter in the field's domain; likely causes: {causes}");
        return Err(Error::setting("cameras", expected, format!("none: {measured}")));
    }
    Ok(Some(format!("the cameras see little of the model: {measured}; likely causes: {causes}")))
}

/// Path of a camera's image, which need not exist; path of its mask, if it has one, and whether that keeps what is not
/// black; and the size of both, pixels.
type Beside = (PathBuf, Option<(PathBuf, bool)>, [u32; 2]);

/// Rows of numbers, the frames' names, what a user should know, and what lies beside the cameras.
type CameraFile<'py> = (Bound<'py, PyArray2<f64>>, Vec<String>, Vec<String>, Vec<Beside>);

/// Reads the cameras of a file. `views` is "all", a number of frames or their indices; `part` is
/// "training", "held out" or "every frame".
#[pyfunction]
#[pyo3(signature = (path, part, views = None, width = None, height = None))]
pub fn read_cameras<'py>(
    py: Python<'py>,
    path: PathBuf,
    part: &str,
    views: Option<&Bound<'py, PyAny>>,
    width: Option<u32>,
    height: Option<u32>,
) -> PyResult<CameraFile<'py>> {
    let selection = match views {
        None => Selection::All,
        Some(views) => match (views.extract::<usize>(), views.extract::<Vec<usize>>()) {
            (Ok(count), _) => Selection::Count(count),
            (_, Ok(mut indices)) => {
                indices.sort_unstable();
                indices.dedup();
                Selection::Indices(indices)
            }
            _ => Selection::BothParts,
        },
    };
    let (frames, notes) = py.detach(|| read(&path, part, &selection, width, height)).or_raise()?;
    let all: Vec<Camera> = frames.iter().map(|frame| frame.camera).collect();
    let beside = |frame: Frame| {
        let mask = frame.mask.map(|mask| (mask.path().to_path_buf(), matches!(mask, MaskFile::Kept(_))));
        (frame.name, (frame.image, mask, frame.size))
    };
    let (names, beside) = frames.into_iter().map(beside).unzip();
    Ok((PyArray1::from_vec(py, numbers(&all)).reshape([all.len(), NUMBERS])?, names, notes, beside))
}

fn read(
    path: &Path,
    part: &str,
    selection: &Selection,
    width: Option<u32>,
    height: Option<u32>,
) -> octobayes::Result<(Vec<Frame>, Vec<String>)> {
    let mut views = Views::read(path, width.zip(height).map(Into::into))?;
    if let (Some(width), None) = (width, height) {
        for frame in &mut views.frames {
            let [w, h] = frame.camera.resolution;
            let height = (f64::from(width) * f64::from(h) / f64::from(w)).round().max(1.0) as u32;
            frame.camera = frame.camera.resized([width, height]);
        }
    }
    let mut notes: Vec<String> = views.notes.iter().map(|note| format!("{}: {note}", path.display())).collect();
    if width.is_none() && views.resolution_source == ResolutionSource::Assumed {
        let [w, h] = views.frames[0].camera.resolution;
        notes.push(format!(
            "{} states no image size and its images are not there: {w} x {h} is assumed (resolution=)",
            path.display()
        ));
    }
    let frames = match part {
        "every frame" => views.frames,
        _ => {
            let part = if part == "training" { Part::Training } else { Part::HeldOut };
            FrameSplit::new(views).select(part, selection, |_| true)?
        }
    };
    Ok((frames, notes))
}
