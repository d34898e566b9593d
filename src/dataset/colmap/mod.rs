//! Cameras of COLMAP's sparse models: `cameras` and `images`, as `.bin` or `.txt`.
//!
//! A camera holds size and lens, an image the pose of one picture: a quaternion (w, x, y, z) and a translation that
//! take world to camera, with OpenCV's axes (x right, y down, looking along +z). Here poses are camera-to-world with
//! OpenGL's axes, so y and z turn round. World axes and units stay COLMAP's own. Both count pixels from the upper
//! left corner of the image.
//!
//! Files are untrusted: nothing is allocated by a number that stands in one.

mod binary;
mod text;

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use glam::{DMat3, DQuat, DVec3};

use super::transforms::{Intrinsics, SIZES};
use super::{Frame, ResolutionSource, Views};
use crate::geometry::Camera;
use crate::{Error, Result};

/// Kinds of lenses, by COLMAP's numbers.
const MODELS: [&str; 12] = [
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "OPENCV_FISHEYE",
    "FULL_OPENCV",
    "FOV",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "THIN_PRISM_FISHEYE",
    "RAD_TAN_THIN_PRISM_FISHEYE",
];

/// Number of parameters of the kinds that are read, the first of [`MODELS`].
const PARAMETERS: [usize; 5] = [3, 4, 4, 5, 8];

/// Where a model's files may lie in the folder of a project.
const FOLDERS: [&str; 6] = ["", "0", "sparse/0", "sparse", "colmap/sparse/0", "colmap/sparse"];

/// A kind of lens that is read: an index into [`PARAMETERS`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Lens(usize);

impl Lens {
    /// The kind of this name; the error says what is expected.
    fn named(name: &str) -> std::result::Result<Self, Complaint> {
        let index = MODELS[..PARAMETERS.len()].iter().position(|known| *known == name);
        index.map(Self).ok_or_else(|| Self::unknown(name.to_string()))
    }

    /// The kind of COLMAP's number.
    fn numbered(number: i32) -> std::result::Result<Self, Complaint> {
        match usize::try_from(number).ok().filter(|&n| n < PARAMETERS.len()) {
            Some(index) => Ok(Self(index)),
            None => {
                let name = usize::try_from(number).ok().and_then(|n| MODELS.get(n));
                Err(Self::unknown(name.map_or_else(|| number.to_string(), ToString::to_string)))
            }
        }
    }

    fn unknown(found: String) -> Complaint {
        let known = MODELS[..PARAMETERS.len()].join(", ");
        Complaint { place: "camera model".into(), expected: format!("a perspective camera ({known})"), found }
    }

    fn parameters(self) -> usize {
        PARAMETERS[self.0]
    }
}

/// Size and lens.
#[derive(Debug, Clone, PartialEq)]
struct RawCamera {
    lens: Lens,
    /// Width and height in pixels.
    size: [u64; 2],
    parameters: Vec<f64>,
}

/// Pose and name of a picture.
#[derive(Debug, Clone, PartialEq)]
struct RawImage {
    /// w, x, y, z.
    quaternion: [f64; 4],
    translation: [f64; 3],
    camera: u32,
    name: String,
}

/// What is wrong with a file, without its path.
struct Complaint {
    place: String,
    expected: String,
    found: String,
}

impl Complaint {
    fn new(place: impl Into<String>, expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self { place: place.into(), expected: expected.into(), found: found.into() }
    }

    fn in_file(self, path: &Path) -> Error {
        Error::malformed(path, self.place, self.expected, self.found)
    }
}

type Parsed<T> = std::result::Result<T, Complaint>;

/// The files of a model: `cameras` and `images`, both `.bin` or both `.txt`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ModelFiles {
    /// Sizes and lenses.
    pub cameras: PathBuf,
    /// Poses.
    pub images: PathBuf,
    is_binary: bool,
}

impl ModelFiles {
    /// The model that `path` means: one of its files, its folder, or the folder of a project with `sparse/0` in it.
    ///
    /// `None` if it is no such thing.
    #[must_use]
    pub fn find(path: &Path) -> Option<Self> {
        let of = |folder: &Path, extension: &str| {
            let [cameras, images] = ["cameras", "images"].map(|name| folder.join(name).with_extension(extension));
            let is_there = cameras.is_file() && images.is_file();
            is_there.then_some(Self { cameras, images, is_binary: extension == "bin" })
        };
        if path.is_dir() {
            let both = |folder: PathBuf| ["bin", "txt"].iter().find_map(|extension| of(&folder, extension));
            return FOLDERS.iter().find_map(|folder| both(path.join(folder)));
        }
        let stem = path.file_stem()?.to_str()?;
        let extension = path.extension()?.to_str()?;
        let is_part = ["cameras", "images"].contains(&stem) && ["bin", "txt"].contains(&extension);
        is_part.then(|| of(path.parent()?, extension)).flatten()
    }

    /// Reads the cameras. Images are sorted by name.
    ///
    /// The image size is the `requested` one, else the camera's. `path` is what the user named.
    ///
    /// # Errors
    /// If a file cannot be read or ends early, if a lens is not perspective, or if a camera or a pose makes no
    /// sense.
    pub fn read(&self, path: &Path, requested: Option<[u32; 2]>) -> Result<Views> {
        let bytes = |path: &Path| crate::io::read(path);
        let (cameras, mut images) = if self.is_binary {
            let cameras = binary::cameras(&bytes(&self.cameras)?).map_err(|e| e.in_file(&self.cameras))?;
            (cameras, binary::images(&bytes(&self.images)?).map_err(|e| e.in_file(&self.images))?)
        } else {
            let cameras = text::cameras(&crate::io::read_text(&self.cameras)?).map_err(|e| e.in_file(&self.cameras))?;
            (cameras, text::images(&crate::io::read_text(&self.images)?).map_err(|e| e.in_file(&self.images))?)
        };
        if images.is_empty() {
            return Err(Error::malformed(&self.images, "images", "at least one image", "none"));
        }
        images.sort_by(|a, b| a.name.cmp(&b.name));
        let folder = self.picture_folder(&images);
        let frame = |image: RawImage| {
            let at = |what: &str| format!("image `{}`, {what}", image.name);
            let raw = cameras.get(&image.camera).ok_or_else(|| {
                let found = format!("no camera {}", image.camera);
                Complaint::new(at("camera"), "a camera of the model", found).in_file(&self.images)
            })?;
            let camera = lens(raw, requested).map_err(|mut complaint| {
                complaint.place = format!("camera {}, {}", image.camera, complaint.place);
                complaint.in_file(&self.cameras)
            })?;
            let (position, axes) = pose(&image).map_err(|found| {
                let expected = "a rotation (quaternion of length 1) and a finite translation";
                Complaint::new(at("pose"), expected, found).in_file(&self.images)
            })?;
            let file = folder.join(&image.name);
            Ok(Frame::new(Camera { position, axes, ..camera }, image.name, file))
        };
        let frames = images.into_iter().map(frame).collect::<Result<_>>()?;
        let resolution_source = requested.map_or(ResolutionSource::File, |_| ResolutionSource::Requested);
        Ok(Views { path: path.to_path_buf(), frames, resolution_source })
    }

    /// The folder that holds the pictures: `images` beside the model or further up, or else the model's own.
    fn picture_folder(&self, images: &[RawImage]) -> PathBuf {
        let own = self.images.parent().unwrap_or(Path::new(""));
        let mut candidates = vec![own.join("images")];
        let mut up = own.to_path_buf();
        for _ in 0..3 {
            up = if up.file_name().is_some() { up.parent().unwrap_or(Path::new("")).into() } else { up.join("..") };
            candidates.push(up.join("images"));
        }
        candidates.push(own.to_path_buf());
        let holds = |folder: &&PathBuf| images.iter().any(|image| folder.join(&image.name).is_file());
        candidates.iter().find(holds).unwrap_or(&candidates[0]).clone()
    }
}

/// A camera without its pose.
fn lens(raw: &RawCamera, requested: Option<[u32; 2]>) -> Parsed<Camera> {
    let [w, h] = raw.size.map(|n| n as f64);
    let intrinsics = Intrinsics { w: Some(w), h: Some(h), ..Intrinsics::default() };
    let one = |f: f64, cx: f64, cy: f64| Intrinsics {
        fl_x: Some(f),
        fl_y: Some(f),
        cx: Some(cx),
        cy: Some(cy),
        ..intrinsics
    };
    let intrinsics = match (raw.lens.0, raw.parameters.as_slice()) {
        (0, &[f, cx, cy]) => one(f, cx, cy),
        (1, &[fx, fy, cx, cy]) => Intrinsics { fl_y: Some(fy), ..one(fx, cx, cy) },
        (2, &[f, cx, cy, k]) => Intrinsics { k1: Some(k), ..one(f, cx, cy) },
        (3, &[f, cx, cy, k1, k2]) => Intrinsics { k1: Some(k1), k2: Some(k2), ..one(f, cx, cy) },
        (4, &[fx, fy, cx, cy, k1, k2, p1, p2]) => {
            let lens = Intrinsics { k1: Some(k1), k2: Some(k2), p1: Some(p1), p2: Some(p2), ..one(fx, cx, cy) };
            Intrinsics { fl_y: Some(fy), ..lens }
        }
        (lens, parameters) => {
            let expected = format!("{} numbers for {}", PARAMETERS[lens], MODELS[lens]);
            return Err(Complaint::new("parameters", expected, parameters.len().to_string()));
        }
    };
    let stated = intrinsics.resolution().unwrap_or_else(|| Err("none".into()));
    let stated = stated.map_err(|found| Complaint::new("image size", SIZES, found))?;
    let resolution = requested.unwrap_or(stated);
    let (focal, center) = intrinsics.project(resolution).map_err(|found| {
        Complaint::new("parameters", "positive focal lengths and a principal point near the image", found)
    })?;
    let distortion = intrinsics
        .distortion()
        .map_err(|found| Complaint::new("parameters", "finite coefficients of distortion", found))?;
    Ok(Camera { position: DVec3::ZERO, axes: DMat3::IDENTITY, focal, center, resolution, distortion })
}

/// Position and axes, camera-to-world with OpenGL's axes; the error says what was found.
fn pose(image: &RawImage) -> std::result::Result<(DVec3, DMat3), String> {
    let [w, x, y, z] = image.quaternion;
    let (quaternion, translation) = (DQuat::from_xyzw(x, y, z, w), DVec3::from(image.translation));
    let length = quaternion.length();
    // Rounded in text, it is still 1 to within a few digits.
    if !((length - 1.0).abs() < 1e-2 && translation.is_finite()) {
        return Err(format!("quaternion {:?}, translation {:?}", image.quaternion, image.translation));
    }
    let to_world = DMat3::from_quat(quaternion.normalize()).transpose();
    let axes = DMat3::from_cols(to_world.x_axis, -to_world.y_axis, -to_world.z_axis);
    Ok((-(to_world * translation), axes))
}

/// Adds a camera; numbers must not repeat.
fn insert(cameras: &mut HashMap<u32, RawCamera>, number: u32, camera: RawCamera) -> Parsed<()> {
    match cameras.insert(number, camera) {
        None => Ok(()),
        Some(_) => Err(Complaint::new(format!("camera {number}"), "a number of its own", "two cameras")),
    }
}

#[cfg(test)]
mod tests;
