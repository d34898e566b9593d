//! The cameras of a file, with their images.

use std::path::{Path, PathBuf};

use super::colmap::ModelFiles;
use super::pictures::{MaskFile, SMALLER, image_path_in, scene_of};
use super::sizes::follow_pictures;
use super::{nerfstudio, transforms};
use octobayes::geometry::Camera;
use octobayes::io::place::folder_of;
use octobayes::{Error, Result};

/// A camera with its image.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Pose and intrinsics.
    pub camera: Camera,
    /// `file_path` as written; used in messages and for the names of depth maps.
    pub name: String,
    /// Number of the frame, from 0, in the order of its file (COLMAP: sorted by name).
    pub index: usize,
    /// Width and height of the image, pixels; `camera` may be for another size.
    pub size: [u32; 2],
    /// Path of the image, which need not exist.
    pub image: PathBuf,
    /// The depth map that the camera file names for this frame (`depth_file_path`).
    pub depth: Option<PathBuf>,
    /// Path of a mask in which the object is not black (`object_mask_path`).
    pub object: Option<PathBuf>,
    /// Which of its pixels the model was trained on, if not all.
    pub mask: Option<MaskFile>,
    /// The frame's purpose as the camera file states it.
    pub purpose: Option<Purpose>,
}

/// A frame's purpose as a camera file states it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    /// The model was trained on it.
    Training,
    /// It was kept for evaluation.
    HeldOut,
    /// Neither.
    Unused,
    /// No image was taken: the camera is of a camera path.
    Planned,
}

/// The transforms.json of the scene, if `path` is a folder of its pictures.
fn transforms_beside(path: &Path) -> Option<PathBuf> {
    scene_of(path).map(|scene| scene.join("transforms.json")).filter(|file| file.is_file())
}

impl Frame {
    /// A camera and its image, the first of its file, without depth map, mask or purpose.
    #[must_use]
    pub fn new(camera: Camera, name: impl Into<String>, image: impl Into<PathBuf>) -> Self {
        let (name, image, size) = (name.into(), image.into(), camera.resolution);
        Self { camera, name, index: 0, size, image, depth: None, object: None, mask: None, purpose: None }
    }
}

/// Origin of the image size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ResolutionSource {
    /// `w` and `h` in the file.
    File,
    /// The size of the images.
    Image,
    /// The caller's request.
    Requested,
    /// None of these: 400 × 400 is assumed.
    Assumed,
}

/// All cameras of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct Views {
    /// Path of the file.
    pub path: PathBuf,
    /// The frames, at least one.
    pub frames: Vec<Frame>,
    /// Origin of the image size.
    pub resolution_source: ResolutionSource,
    /// Messages to the user about the file, a sentence each.
    pub notes: Vec<String>,
}

impl Views {
    /// Reads a camera file: a transforms.json, the cameras.json of Gaussian splatting, the cameras.xml of Metashape, a
    /// sparse model of COLMAP (one of its files, or its folder), or either in the frame of a run of nerfstudio, by its
    /// dataparser_transforms.json. A folder of pictures, such as `images` or `images_4`, means these pictures with the
    /// cameras beside it.
    ///
    /// Pixels of intrinsics refer to `w` and `h`, else to the frame's own image, else to the other images. The
    /// cameras' size is the `requested` one, else that of the frame's image if it is the same picture at another size,
    /// else that size, else 400 × 400.
    ///
    /// # Errors
    /// If the file is missing or is not JSON, has no frames or no focal length, if a matrix is not a finite rigid pose
    /// (a uniform scale is removed), if the size that pixels refer to is unknown, or if a key requires rays or frames
    /// that are not supported.
    pub fn read(path: &Path, requested: Option<[u32; 2]>) -> Result<Self> {
        let mut views = Self::stated(path, requested)?;
        follow_pictures(&mut views, requested.is_some());
        Ok(views)
    }

    /// The cameras as the file states them.
    pub(super) fn stated(path: &Path, requested: Option<[u32; 2]>) -> Result<Self> {
        if let Some(file) = transforms_beside(path) {
            return transforms::read(&file, path.file_name().and_then(|name| name.to_str()), requested);
        }
        if let Some(model) = ModelFiles::find(path)? {
            return model.read(path, requested);
        }
        if nerfstudio::is_frame_of_run(path) {
            return nerfstudio::in_frame_of_run(path, requested);
        }
        if path.extension().is_some_and(|extension| ["ckpt", "pt", "pth", "db"].iter().any(|e| extension == *e)) {
            let expected = "a transforms.json or a COLMAP model; a nerfstudio run's transforms.json is in its data set";
            return Err(Error::malformed(path, "cameras", expected, "a checkpoint or a database"));
        }
        if path.is_dir() {
            let expected =
                "a camera file: transforms.json, or the folder of a COLMAP model (cameras and images, .bin or .txt)";
            return Err(Error::malformed(path, "cameras", expected, "a folder without"));
        }
        transforms::read(path, None, requested)
    }

    /// The files that hold the cameras of `path`: itself, or those of the COLMAP models that it may mean; with the
    /// similarity of a run of nerfstudio those that it applies to.
    #[must_use]
    pub fn files(path: &Path) -> Vec<PathBuf> {
        if nerfstudio::is_frame_of_run(path) {
            let data = nerfstudio::data_set(path);
            return std::iter::once(path.into()).chain(data.iter().flat_map(|data| Self::files(data))).collect();
        }
        if let Some(file) = transforms_beside(path) {
            return vec![file];
        }
        let models = ModelFiles::all(path);
        if models.is_empty() {
            return vec![path.to_path_buf()];
        }
        models.into_iter().flat_map(|model| [model.cameras, model.images]).collect()
    }

    /// Where the image of the first frame is looked for.
    #[must_use]
    pub fn places(&self) -> Vec<PathBuf> {
        let Frame { name, image, .. } = &self.frames[0];
        if let Ok(Some(model)) = ModelFiles::find(&self.path) {
            return model.places(&self.path, name);
        }
        let folder = folder_of(&self.path);
        let smaller = SMALLER.iter().filter_map(|smaller| image_path_in(folder, smaller, name, false));
        [image.clone()].into_iter().chain(smaller).collect()
    }

    /// Cameras of all frames.
    #[must_use]
    pub fn cameras(&self) -> Vec<Camera> {
        self.frames.iter().map(|f| f.camera).collect()
    }

    /// Returns frame `k`.
    ///
    /// # Errors
    /// If there are not that many frames.
    pub fn frame(&self, k: usize) -> Result<&Frame> {
        self.frames.get(k).ok_or_else(|| {
            let place = format!("frame {k}");
            Error::malformed(&self.path, place, format!("a frame from 0 to {}", self.frames.len() - 1), "none")
        })
    }
}
