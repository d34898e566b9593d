//! The cameras to choose from: of a file, made, or of photographs that exist but were not used.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use glam::DVec3;

use crate::options::{CameraOptions, count, heading, of_folder, parse_direction};
use crate::streams::tell;
use octobayes::geometry::{Camera, NamedCamera};
use octobayes::uncertainty::UncertaintyField;
use octobayes::{Error, Result};
use octobayes_data::{Frame, Part, Selection, Views};
use octobayes_next_view::{Around, Made};
use octobayes_session::{CameraSource, OpenedModel};

/// Most candidates and views.
pub const MAX_COUNT: u64 = 100_000;
/// Candidates if nothing is said of them.
const NEAR: u32 = 100;

/// Where candidates come from.
#[derive(clap::Args)]
pub struct CandidateOptions {
    /// Cameras to choose from: a camera file, or its folder, as for --cameras, or a camera path of nerfstudio's viewer.
    /// Their images need not exist [default: --near 100]
    #[arg(long, value_name = "PATH", help_heading = heading::INPUT)]
    candidates: Option<PathBuf>,

    /// Choose from N cameras on lines through places of the training cameras, which look at surfaces: where a
    /// photographer may stand who took the others
    #[arg(
        long,
        value_name = "N",
        value_parser = count::<u32>(1..=MAX_COUNT),
        conflicts_with_all = ["candidates", "sphere", "orbit", "unused"],
        help_heading = heading::INPUT,
    )]
    near: Option<u32>,

    /// Choose from N cameras spread over a sphere around the middle of the box, as far away as the training cameras
    /// are, and with their lens; those that stand in matter are left out
    #[arg(
        long,
        value_name = "N",
        value_parser = count::<u32>(1..=MAX_COUNT),
        conflicts_with_all = ["candidates", "unused"],
        help_heading = heading::INPUT,
    )]
    sphere: Option<u32>,

    /// Only the upper half of --sphere
    #[arg(long, requires = "sphere", conflicts_with = "orbit", help_heading = heading::INPUT)]
    upper: bool,

    /// Choose from N cameras on a circle at the training cameras' median height
    #[arg(
        long,
        value_name = "N",
        value_parser = count::<u32>(1..=MAX_COUNT),
        conflicts_with_all = ["candidates", "sphere", "unused"],
        help_heading = heading::INPUT,
    )]
    orbit: Option<u32>,

    /// Choose from photographs of --cameras that the training did not use: those of a folder, or those whose names stand
    /// in a text file, a line each
    #[arg(
        long,
        value_name = "DIR|LIST.txt",
        requires = "cameras",
        conflicts_with = "candidates",
        help_heading = heading::INPUT,
    )]
    unused: Option<PathBuf>,

    /// What is up for cameras that are made, and on the plan: a direction in scene units [default: as the training
    /// cameras were held]
    #[arg(
        long,
        value_name = "X,Y,Z",
        value_parser = parse_direction,
        allow_hyphen_values = true,
        conflicts_with = "candidates",
        help_heading = heading::INPUT,
        hide_short_help = true,
    )]
    pub up: Option<DVec3>,
}

/// Cameras to choose from, with their names.
pub struct Candidates {
    /// `[candidates]`
    pub names: Vec<String>,
    /// `[candidates]`
    pub cameras: Vec<Camera>,
    /// The images that no output may replace.
    pub views: Option<Views>,
}

impl CandidateOptions {
    /// Of a folder of candidates, takes the file of held-out cameras.
    pub fn find(&mut self) {
        self.candidates = self.candidates.take().map(|path| of_folder(&path, Part::HeldOut));
    }

    /// The camera file of the candidates, if there is one.
    pub fn file(&self) -> Option<&Path> {
        self.candidates.as_deref()
    }

    /// The list of photographs, if there is one.
    pub fn list(&self) -> Option<&Path> {
        self.unused.as_deref().filter(|path| path.is_file())
    }

    /// Whether they depend on the training cameras.
    pub fn are_made(&self) -> bool {
        self.candidates.is_none()
    }

    /// In words, for people.
    pub fn words(&self, count: usize) -> String {
        match (&self.candidates, &self.unused) {
            (Some(path), _) => format!("{count} cameras of {}", path.display()),
            (None, Some(_)) => format!("{count} photographs that were not used"),
            (None, None) => match self.made() {
                Made::Near { .. } => format!("{count} places near those of the photographs"),
                Made::Sphere { .. } => format!("{count} places on a sphere around the scene"),
                Made::Orbit { .. } => format!("{count} places on a circle around the scene"),
            },
        }
    }

    fn made(&self) -> Made {
        match (self.sphere, self.orbit) {
            (Some(count), _) => Made::Sphere { count, is_upper: self.upper },
            (None, Some(count)) => Made::Orbit { count },
            (None, None) => Made::Near { count: self.near.unwrap_or(NEAR) },
        }
    }

    /// Reads or makes them; `training` are the frames of the training.
    pub fn read(
        &self,
        opened: &OpenedModel,
        field: &UncertaintyField,
        training: &[Frame],
        cameras: &CameraOptions,
    ) -> Result<Candidates> {
        if let Some(path) = &self.candidates {
            let (file, resolution) = (Some(path.clone()), cameras.resolution);
            let source = CameraSource { file, resolution, ..CameraSource::default() };
            let views = source.read(None, &mut tell)?;
            let named = views.frames.iter().map(|frame| (frame.name.clone(), frame.camera));
            let (names, cameras) = named.unzip();
            return Ok(Candidates { names, cameras, views: Some(views) });
        }
        if let Some(path) = &self.unused {
            let frames = unused(path, cameras.read(None, "the model")?, training, &*opened.model)?;
            let (names, cameras) = frames.into_iter().map(|frame| (frame.name, frame.camera)).unzip();
            return Ok(Candidates { names, cameras, views: None });
        }
        let of_training: Vec<Camera> = training.iter().map(|frame| frame.camera).collect();
        let around = Around::like(&of_training, field.lattice().domain(), self.up)?;
        let made = self.made();
        let (names, cameras, buried) =
            made.cameras(&around, field.surface(), &*opened.model, field.record().march_step);
        if buried > 0 {
            announce!("note: {buried} cameras of --{} stand in matter and are left out", made.kind());
        }
        Ok(Candidates { names, cameras, views: None })
    }
}

/// The frames of a camera file that lie in a folder or stand in a list, and whose cameras no training frame has.
fn unused(path: &Path, views: Views, training: &[Frame], model: &dyn octobayes::estimate::Model) -> Result<Vec<Frame>> {
    let length = model.main_box().longest_edge();
    let known: Vec<NamedCamera> = training.iter().map(|frame| NamedCamera::new(&frame.name, frame.camera)).collect();
    let source = views.path.clone();
    let frames = octobayes_data::FrameSplit::new(views).select(Part::HeldOut, &Selection::BothParts, |_| true)?;
    let is_unused = |frame: &Frame| !known.iter().any(|known| known.camera.is_like(&frame.camera, length));
    let wanted: Vec<Frame> = if path.is_dir() {
        let folder = path.canonicalize().map_err(Error::io(path, "cannot open"))?;
        let lies_there =
            |frame: &Frame| frame.image.canonicalize().is_ok_and(|image| image.parent() == Some(folder.as_path()));
        frames.into_iter().filter(lies_there).collect()
    } else {
        let bytes = octobayes::io::read(path)?;
        let text = String::from_utf8_lossy(&bytes);
        let names: Vec<&str> = text.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
        let is_called = |frame: &Frame, name: &str| {
            let file = frame.name.rsplit(['/', '\\']).next().unwrap_or(&frame.name);
            let stem = file.rsplit_once('.').map_or(file, |(stem, _)| stem);
            [frame.name.as_str(), file, stem].contains(&name)
        };
        if let Some(name) = names.iter().find(|name| !frames.iter().any(|frame| is_called(frame, name))) {
            let expected = format!("names of frames of {}, a line each", source.display());
            return Err(Error::malformed(path, "list", expected, octobayes::error::printable(name)));
        }
        let names: HashSet<&str> = names.into_iter().collect();
        frames.into_iter().filter(|frame| names.iter().any(|name| is_called(frame, name))).collect()
    };
    let all = wanted.len();
    let left: Vec<Frame> = wanted.into_iter().filter(is_unused).collect();
    if left.is_empty() {
        let expected = format!("photographs of {} that the training did not use", source.display());
        return Err(Error::setting(
            "--unused",
            expected,
            format!("none; it used {all} of those in {}", path.display()),
        ));
    }
    Ok(left)
}
