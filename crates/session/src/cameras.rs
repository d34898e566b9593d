//! Where cameras come from: files, or the model.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::identity::unchanged;
use super::training_args::TrainingArgs;
use octobayes::error::{counted, printable};
use octobayes::estimate::{Model, known_cameras};
use octobayes::field::Intrinsics;
use octobayes::geometry::Camera;
use octobayes::monitor::Message;
use octobayes::{Error, Result};
use octobayes_data::{Frame, FrameSplit, Part, ResolutionSource, Selection, Views};

/// A requested image size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Resolution {
    /// This width; the height follows from the camera's own aspect ratio.
    Width(u32),
    /// Width and height.
    Size([u32; 2]),
}

impl Resolution {
    /// The size to ask for before any camera is known, if it is known.
    #[must_use]
    pub fn size(self) -> Option<[u32; 2]> {
        match self {
            Self::Width(_) => None,
            Self::Size(size) => Some(size),
        }
    }

    /// The camera at this size.
    #[must_use]
    pub fn apply(self, camera: &Camera) -> Camera {
        match self {
            Self::Width(width) => scaled(camera, f64::from(width) / f64::from(camera.resolution[0])),
            Self::Size(size) => camera.resized(size),
        }
    }
}

/// The camera with sides times `scale`, at least a pixel and at most what an image may have.
#[must_use]
pub fn scaled(camera: &Camera, scale: f64) -> Camera {
    let side = |side: u32| (f64::from(side) * scale).round().clamp(1.0, 65_536.0) as u32;
    camera.resized(camera.resolution.map(side))
}

/// Where cameras come from.
#[derive(Debug, Clone, Default)]
pub struct CameraSource {
    /// A camera file; `None` for the model's own cameras.
    pub file: Option<PathBuf>,
    /// Horizontal angle of view of the model's own cameras, degrees.
    pub fov: Option<f64>,
    /// Image size.
    pub resolution: Option<Resolution>,
    /// The file of a model that stores no cameras: beside it, or beside the camera file, the original code of Gaussian
    /// splatting writes whether frames were held out.
    pub model_file: Option<PathBuf>,
}

/// The cameras that a model was trained on.
#[derive(Debug, Clone)]
pub struct TrainingCameras {
    /// The cameras, with what lies beside them.
    pub views: Views,
    /// How many there are, and why these.
    pub used: String,
    /// The camera file with its checksum, or what the model's own cameras are, for people.
    pub source: String,
}

impl CameraSource {
    /// Reads the camera file, or else takes the model's own cameras; it has a name.
    ///
    /// # Errors
    /// As [`Views::read`] and [`Model::cameras`]; if there is neither a file nor a model with cameras.
    pub fn read(&self, model: Option<(&dyn Model, &str)>, tell: &mut dyn FnMut(Message)) -> Result<Views> {
        match (&self.file, model) {
            (Some(path), _) => self.read_file(path, tell),
            (None, Some((model, name))) => {
                if let Some(fov) = self.fov.filter(|fov| *fov <= std::f64::consts::PI) {
                    let degrees = fov.to_degrees();
                    tell(Message::Warning(format!(
                        "--fov is {fov} degrees; {fov} radians would be {degrees:.1} degrees"
                    )));
                }
                self.ask(model, name)
            }
            (None, None) => Err(none_for("this model")),
        }
    }

    fn read_file(&self, path: &Path, tell: &mut dyn FnMut(Message)) -> Result<Views> {
        let mut views = Views::read(path, self.resolution.and_then(Resolution::size))?;
        let mut note = |text: String| tell(Message::Note(text));
        views.notes.iter().for_each(|text| note(format!("{}: {}", path.display(), printable(text))));
        if let Some(resolution) = self.resolution {
            views.frames.iter_mut().for_each(|frame| frame.camera = resolution.apply(&frame.camera));
            views.resolution_source = ResolutionSource::Requested;
        }
        if views.resolution_source == ResolutionSource::Assumed {
            let [w, h] = views.frames[0].camera.resolution;
            let path = path.display();
            note(format!(
                "{path} states no image size and its images are not there: assuming {w} x {h} (--resolution)"
            ));
        }
        Ok(views)
    }

    fn ask(&self, model: &dyn Model, name: &str) -> Result<Views> {
        let size = self.resolution.and_then(Resolution::size);
        let intrinsics = Intrinsics { fov_x: self.fov.map(f64::to_radians), resolution: size };
        let cameras = model.cameras(&intrinsics)?.ok_or_else(|| none_for(&format!("`{name}`")))?;
        let names = model.training_cameras();
        let name_of = |i: usize| names.get(i).map_or_else(|| format!("pose {i}"), |named| named.name.clone());
        let sized = |camera| self.resolution.map_or(camera, |resolution| resolution.apply(&camera));
        let frame = |(index, camera)| Frame { index, ..Frame::new(sized(camera), name_of(index), "") };
        Ok(Views {
            path: PathBuf::from(name),
            frames: cameras.into_iter().enumerate().map(frame).collect(),
            // Cameras that a model was trained on come with the size of their images; mere poses do not.
            resolution_source: match names {
                [_, ..] if self.resolution.is_none() => ResolutionSource::File,
                _ => ResolutionSource::Assumed,
            },
            notes: Vec::new(),
        })
    }

    /// The cameras that the model was trained on: its own, or the training frames of the camera file. Warns if they
    /// differ from those that the model stores.
    ///
    /// # Errors
    /// As [`CameraSource::read`] and [`FrameSplit::select`]; if the camera file changes meanwhile, or if the model has
    /// cameras with masks, which it does not store.
    pub fn training(
        &self,
        selection: &Selection,
        model: Option<(&dyn Model, &str)>,
        tell: &mut dyn FnMut(Message),
    ) -> Result<TrainingCameras> {
        let files = || self.file.iter().flat_map(|path| Views::files(path)).collect();
        let (views, files) = unchanged(files, || self.read(model, tell))?;
        let (None, Some((own, _))) = (&self.file, model) else {
            let args = TrainingArgs::beside(&[&self.model_file, &self.file].into_iter().flatten().collect::<Vec<_>>());
            // The original code trains splats: a model that stores its cameras was not trained by it.
            let stores = model.is_some_and(|(model, _)| model.stores_cameras());
            let all = args.filter(|args| !stores && args.is_evaluated() == Some(false));
            let (views, used) = chosen(views, selection, model.map(|(model, _)| model), all, tell)?;
            return Ok(TrainingCameras { views, used, source: files.join(" and ") });
        };
        let stored = own.training_cameras();
        let masked = stored.iter().filter(|named| named.is_masked).count();
        if masked > 0 {
            let expected = "the data set that the model was trained on: its masks are not stored in the model";
            return Err(Error::setting("--cameras", expected, format!("{masked} cameras with masks")));
        }
        let whose = if stored.is_empty() { "the model's own" } else { "stored in the model" };
        let ([w, h], n) = (views.frames[0].camera.resolution, views.frames.len());
        let fov = self.fov.map_or(String::new(), |fov| format!(", {fov} degrees"));
        let cameras = counted(n, "camera");
        let source = format!("its own {cameras} of {w} x {h}{fov}");
        Ok(TrainingCameras { views, used: format!("{cameras} ({whose})"), source })
    }
}

/// The training frames of a camera file, and why these. `trained_on_all` are the settings of a training that held out
/// no frame, if it is known to be one.
fn chosen(
    views: Views,
    selection: &Selection,
    model: Option<&dyn Model>,
    trained_on_all: Option<TrainingArgs>,
    tell: &mut dyn FnMut(Message),
) -> Result<(Views, String)> {
    let (path, resolution_source) = (views.path.clone(), views.resolution_source);
    let model = model.filter(|model| !model.training_cameras().is_empty());
    let mut split = FrameSplit::new(views);
    if let Some(model) = model {
        let all = split.matching(Part::Training, &Selection::BothParts, |_| true)?;
        let matches = known_cameras(model, all.iter().map(|frame| &frame.camera));
        let known: BTreeSet<usize> = matches.iter().flatten().copied().collect();
        if known.len() == model.training_cameras().len() {
            let trained: BTreeSet<usize> =
                all.iter().zip(matches).filter_map(|(frame, known)| known.map(|_| frame.index)).collect();
            split = split.by_model(|frame| trained.contains(&frame.index));
        }
    }
    if let Some(args) = trained_on_all {
        let before = split.matching(Part::Training, &Selection::All, |_| true)?.len();
        split = split.by_model(|_| true);
        if split.matching(Part::Training, &Selection::All, |_| true)?.len() > before {
            tell(Message::Note(format!(
                "{}: the splats were trained on all frames (`eval=False`)",
                args.path.display()
            )));
        }
    }
    let frames = split.select(Part::Training, selection, |_| true)?;
    split.without_training().into_iter().for_each(|text| tell(Message::Warning(text)));
    if let Some(model) = model {
        let stored = model.training_cameras().len();
        let matches = known_cameras(model, frames.iter().map(|frame| &frame.camera));
        let known: BTreeSet<usize> = matches.iter().flatten().copied().collect();
        let (others, absent) = (matches.iter().filter(|m| m.is_none()).count(), stored - known.len());
        if others + absent > 0 {
            tell(Message::Warning(format!(
                "these are not the cameras that the model was trained on: {others} of these {} are others, {absent} of \
                 its {stored} are not among these; without --cameras those stored in the model are used",
                frames.len()
            )));
        }
    }
    let used = split.describe(Part::Training, &frames);
    Ok((Views { path, frames, resolution_source, notes: Vec::new() }, used))
}

fn none_for(model: &str) -> Error {
    let expected = "a transforms.json, COLMAP model or cameras.json, as this model brings no cameras";
    Error::setting("--cameras", expected, format!("none for {model}"))
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Vec3};

    use super::*;
    use octobayes::field::{ClosedForm, VoxelGrid};

    #[test]
    fn a_model_without_cameras_needs_a_camera_file() {
        let scene = VoxelGrid::bake(&ClosedForm::ball(), [2; 3], Vec3::Z);
        let read = |model| CameraSource::default().training(&Selection::All, model, &mut |_| ());
        let error = read(Some((&scene, "ball.npz"))).unwrap_err().to_string();
        assert!(error.contains("--cameras") && error.contains("`ball.npz`"), "{error}");
        assert!(read(None).unwrap_err().to_string().contains("brings no cameras"));
    }

    #[test]
    fn settings_of_splats_do_not_decide_which_frames_a_volume_was_trained_on() {
        let folder = tempfile::tempdir().unwrap();
        let cameras = ClosedForm::half_circle(12, [2, 2]).into_iter().enumerate();
        let named: Vec<_> = cameras.map(|(i, camera)| (format!("r_{i:02}"), camera)).collect();
        let file = folder.path().join("transforms.json");
        octobayes_data::write_transforms(&file, &named).unwrap();
        for (name, _) in &named {
            image::RgbImage::new(2, 2).save(folder.path().join(format!("{name}.png"))).unwrap();
        }
        std::fs::write(folder.path().join("cfg_args"), "Namespace(eval=False)").unwrap();
        let source = CameraSource { file: Some(file), ..CameraSource::default() };
        let scene = ClosedForm::ball();
        let trained = |model: Option<(&dyn Model, &str)>| {
            source.training(&Selection::All, model, &mut |_| ()).unwrap().views.frames.len()
        };
        assert_eq!((trained(None), trained(Some((&scene, "ball")))), (12, 11));
    }

    #[test]
    fn radians_in_place_of_degrees_are_warned_of() {
        let warned = |fov: f64| {
            let (source, mut said) = (CameraSource { fov: Some(fov), ..CameraSource::default() }, 0);
            drop(source.read(Some((&ClosedForm::ball(), "ball")), &mut |_| said += 1));
            said > 0
        };
        assert!(warned(0.7) && warned(3.0) && !warned(40.0));
    }

    #[test]
    fn a_width_alone_keeps_the_aspect_ratio() {
        let camera = Camera::look_at(DVec3::X, DVec3::ZERO, DVec3::Z, 0.7, [1080, 1920]);
        let small = Resolution::Width(200).apply(&camera);
        assert_eq!(small.resolution, [200, 356]);
        // 355.6 is rounded, and the pixels with it: they stay square to within that.
        assert!((small.focal[0] / small.focal[1] - 1.0).abs() < 0.5 / 356.0);
        assert_eq!(Resolution::Size([30, 20]).apply(&camera).resolution, [30, 20]);
        assert_eq!(scaled(&camera, 1e-9).resolution, [1, 1]);
    }
}
