//! COLMAP's sparse models: cameras from `cameras` and `images`, points from `points3D`, as `.bin` or `.txt`.
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

use super::intrinsics::{Fault, Intrinsics};
use super::split::Lists;
use super::transforms::{SIZES, size};
use super::views::{Frame, ResolutionSource, Views};
use crate::mask_folders::find_masks;
use crate::pictures::{MaskFile, SMALLER, image_path, note_of_smaller, scene_of};
use octobayes::geometry::Camera;
use octobayes::{Error, Result};

/// Kinds of lenses by COLMAP's numbers (colmap/src/colmap/sensor/models.h), with their numbers of parameters.
const MODELS: [(&str, usize); 18] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4),
    ("DIVISION", 5),
    ("SIMPLE_FISHEYE", 3),
    ("FISHEYE", 4),
    ("EUCM", 6),
    ("EQUIRECTANGULAR", 2),
];

/// Kinds that are read; FULL_OPENCV only as long as it does not divide.
const READ: [usize; 6] = [0, 1, 2, 3, 4, FULL_OPENCV];

/// OpenCV's rational lens.
const FULL_OPENCV: usize = 6;

/// Folders of a project in which a model, or folders with models, may lie.
const FOLDERS: [&str; 2] = ["sparse", "colmap/sparse"];

/// Folders in which undistorted pictures are put, each set with a model of its own: in `sparse` below it, or below
/// folders of its own.
const UNDISTORTED: [&str; 2] = ["dense", "undistorted"];

/// A kind of lens: an index into [`MODELS`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Lens(usize);

impl Lens {
    /// The kind of this name; the error names what is expected.
    fn named(name: &str) -> std::result::Result<Self, Complaint> {
        let index = MODELS.iter().position(|(known, _)| *known == name);
        index.map(Self).ok_or_else(|| Self::unknown(name.to_string()))
    }

    /// The kind of COLMAP's number.
    fn numbered(number: i32) -> std::result::Result<Self, Complaint> {
        let index = usize::try_from(number).ok().filter(|&n| n < MODELS.len());
        index.map(Self).ok_or_else(|| Self::unknown(number.to_string()))
    }

    fn unknown(found: String) -> Complaint {
        let known = READ.map(|kind| MODELS[kind].0);
        let expected = format!("a perspective camera ({})", known.join(", "));
        Complaint { place: "camera model".into(), expected, found }
    }

    fn name(self) -> &'static str {
        MODELS[self.0].0
    }

    fn parameters(self) -> usize {
        MODELS[self.0].1
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

/// A point of the scene that several pictures show.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScenePoint {
    /// Scene units.
    pub position: DVec3,
    /// Red, green, blue.
    pub color: [u8; 3],
}

/// The points of the model that the cameras of `path` belong to; none if it is no model of COLMAP, or has none.
///
/// # Errors
/// If several models are there, or if the file of the points cannot be read, ends early or has a position that is not
/// finite.
pub fn scene_points(path: &Path) -> Result<Vec<ScenePoint>> {
    ModelFiles::find(path)?.map_or(Ok(Vec::new()), |model| model.points())
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
    /// The model that `path` means: one of its files, its folder, or the folder of a project with models in it.
    ///
    /// `None` if it is no such thing.
    ///
    /// # Errors
    /// If there are several models. Their cameras are not in one coordinate system, or those of the pictures as they
    /// were taken stand beside those of undistorted ones.
    pub fn find(path: &Path) -> Result<Option<Self>> {
        let mut models = Self::all(path);
        let counted: Vec<_> = models.iter().map(|model| model.images().map(|images| images.len()).ok()).collect();
        // Binary and text of one model: COLMAP prefers the binary.
        let is_same = |[a, b]: [&Self; 2]| a.images.parent() == b.images.parent();
        if models.len() < 2 || models.len() == 2 && is_same([&models[0], &models[1]]) && counted[0] == counted[1] {
            return Ok((!models.is_empty()).then(|| models.swap_remove(0)));
        }
        let describe = |(model, count): (&Self, &Option<usize>)| {
            let file = model.images.strip_prefix(path).unwrap_or(&model.images).display();
            count.map_or_else(|| format!("{file}, which cannot be read"), |count| format!("{file} with {count} images"))
        };
        let found: Vec<String> = models.iter().zip(&counted).map(describe).collect();
        let expected = "one COLMAP model; name the folder or the file of the one that the model was trained on";
        Err(Error::malformed(path, "cameras", expected, found.join("; ")))
    }

    /// All models that `path` may mean; binary files come before text files.
    #[must_use]
    pub fn all(path: &Path) -> Vec<Self> {
        let of = |folder: &Path, extension: &str| {
            let [cameras, images] = ["cameras", "images"].map(|name| folder.join(name).with_extension(extension));
            let is_there = cameras.is_file() && images.is_file();
            is_there.then_some(Self { cameras, images, is_binary: extension == "bin" })
        };
        let both = |folder: &Path| ["bin", "txt"].iter().filter_map(|extension| of(folder, extension)).collect();
        if path.is_dir() {
            let own: Vec<Self> = both(path);
            if !own.is_empty() {
                return own;
            }
            let with_folders = |folder: PathBuf| {
                let below = folders_below(&folder);
                [folder].into_iter().chain(below)
            };
            let numbered = folders_below(path).into_iter().filter(|folder| number(folder).is_some());
            let named = FOLDERS.iter().flat_map(|folder| with_folders(path.join(folder)));
            let undistorted = UNDISTORTED.iter().flat_map(|folder| with_folders(path.join(folder)));
            let below = numbered.chain(named).chain(undistorted.map(|folder| folder.join("sparse")));
            let models: Vec<Self> = below.flat_map(|folder| both(&folder)).collect();
            return match scene_of(path) {
                Some(scene) if models.is_empty() => Self::all(scene),
                _ => models,
            };
        }
        let (stem, extension) = (path.file_stem().and_then(|s| s.to_str()), path.extension().and_then(|e| e.to_str()));
        let (Some("cameras" | "images"), Some(extension @ ("bin" | "txt"))) = (stem, extension) else {
            return Vec::new();
        };
        path.parent().and_then(|folder| of(folder, extension)).into_iter().collect()
    }

    fn images(&self) -> Result<Vec<RawImage>> {
        self.parse(&self.images, binary::images, text::images)
    }

    fn points(&self) -> Result<Vec<ScenePoint>> {
        let path = self.images.with_file_name(if self.is_binary { "points3D.bin" } else { "points3D.txt" });
        if path.is_file() { self.parse(&path, binary::points, text::points) } else { Ok(Vec::new()) }
    }

    fn cameras(&self) -> Result<HashMap<u32, RawCamera>> {
        self.parse(&self.cameras, binary::cameras, text::cameras)
    }

    fn parse<T>(&self, path: &Path, binary: fn(&[u8]) -> Parsed<T>, text: fn(&str) -> Parsed<T>) -> Result<T> {
        let parsed =
            if self.is_binary { binary(&octobayes::io::read(path)?) } else { text(&octobayes::io::read_text(path)?) };
        parsed.map_err(|e| e.in_file(path))
    }

    /// Reads the cameras. Images are sorted by name.
    ///
    /// The image size is the `requested` one, else the camera's. `path` is what the user named: of a folder of pictures
    /// beside the model, these are taken.
    ///
    /// # Errors
    /// If a file cannot be read or ends early, if the lens of an image is not perspective, or if a camera or a pose
    /// makes no sense.
    pub fn read(&self, path: &Path, requested: Option<[u32; 2]>) -> Result<Views> {
        let (cameras, mut images) = (self.cameras()?, self.images()?);
        if images.is_empty() {
            return Err(Error::malformed(&self.images, "images", "at least one image", "none"));
        }
        images.sort_by(|a, b| a.name.cmp(&b.name));
        let folders = self.picture_folders(path);
        let holds = |folder: &&PathBuf| images.iter().any(|image| image_path(folder, &image.name).is_file());
        let folder = folders.iter().find(holds).unwrap_or(&folders[0]);
        let mut notes: Vec<String> = note_of_smaller(folder).filter(|_| folders.len() > 1).into_iter().collect();
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
            let [w, h] = raw.size.map(|side| side as u32);
            let file = image_path(folder, &image.name);
            Ok(Frame {
                size: [w, h],
                mask: MaskFile::beside(&file),
                ..Frame::new(Camera { position, axes, ..camera }, image.name, file)
            })
        };
        let mut frames = images.into_iter().map(frame).collect::<Result<Vec<Frame>>>()?;
        frames.iter_mut().enumerate().for_each(|(i, frame)| frame.index = i);
        let around = folder.parent().filter(|_| scene_of(folder).is_some());
        notes.extend(find_masks(around.unwrap_or(folder), &mut frames));
        lists_beside(folder)?.apply(path, Path::new(""), &mut frames)?;
        let resolution_source = requested.map_or(ResolutionSource::File, |_| ResolutionSource::Requested);
        Ok(Views { path: path.to_path_buf(), frames, resolution_source, notes })
    }

    /// The folders that may hold the pictures, best first: `images` beside the model or further up, the model's own, or
    /// smaller copies beside any `images`. The one that `path` is, if it is none with the model.
    fn picture_folders(&self, path: &Path) -> Vec<PathBuf> {
        if path.is_dir() && !self.images.starts_with(path) {
            return vec![path.to_path_buf()];
        }
        let own = self.images.parent().unwrap_or(Path::new(""));
        let mut beside = vec![own.to_path_buf()];
        let mut up = own.to_path_buf();
        for _ in 0..3 {
            up = if up.file_name().is_some() { up.parent().unwrap_or(Path::new("")).into() } else { up.join("..") };
            beside.push(up.clone());
        }
        let named = |name: &'static str| beside.iter().map(move |folder| folder.join(name));
        let smaller = SMALLER.iter().flat_map(|name| named(name));
        named("images").chain([own.to_path_buf()]).chain(smaller).collect()
    }

    /// Where the picture of this name is looked for.
    pub fn places(&self, path: &Path, name: &str) -> Vec<PathBuf> {
        self.picture_folders(path).iter().map(|folder| image_path(folder, name)).collect()
    }
}

/// The folders in a folder: those named by numbers in their order, then the others by their names.
fn folders_below(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut folders: Vec<PathBuf> = entries.filter(|path| path.is_dir()).collect();
    folders.sort_by_cached_key(|path| (number(path).is_none(), number(path), path.clone()));
    folders
}

/// The number that a folder is named by.
fn number(folder: &Path) -> Option<u32> {
    folder.file_name()?.to_str()?.parse().ok()
}

/// nerfstudio's lists of training and test images, beside the folder of the pictures.
fn lists_beside(pictures: &Path) -> Result<Lists> {
    let read = |name: &str| {
        let path = pictures.with_file_name(name);
        let lines = |text: String| text.lines().map(str::trim).filter(|l| !l.is_empty()).map(str::to_string).collect();
        path.is_file().then(|| octobayes::io::read_text(&path).map(lines)).transpose()
    };
    Ok(Lists { training: read("train_list.txt")?, held_out: read("test_list.txt")?, ..Lists::default() })
}

/// A position that is a number along each axis.
fn finite(position: DVec3, place: &str) -> Parsed<DVec3> {
    if position.is_finite() {
        return Ok(position);
    }
    Err(Complaint::new(place, "a finite position", position.to_string()))
}

/// A camera without its pose.
fn lens(raw: &RawCamera, requested: Option<[u32; 2]>) -> Parsed<Camera> {
    let [w, h] = raw.size.map(|n| n as f64);
    let one = |f: f64, cx: f64, cy: f64| Intrinsics {
        fl_x: Some(f),
        fl_y: Some(f),
        cx: Some(cx),
        cy: Some(cy),
        ..Intrinsics::default()
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
        (FULL_OPENCV, &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6]) => {
            if [k4, k5, k6].iter().any(|divisor| *divisor != 0.0) {
                let expected = "FULL_OPENCV that does not divide, k4 = k5 = k6 = 0; `colmap image_undistorter` makes \
                                pinholes of others";
                return Err(Complaint::new("parameters", expected, format!("k4 {k4}, k5 {k5}, k6 {k6}")));
            }
            let lens = Intrinsics { k1: Some(k1), k2: Some(k2), k3: Some(k3), ..one(fx, cx, cy) };
            Intrinsics { fl_y: Some(fy), p1: Some(p1), p2: Some(p2), ..lens }
        }
        _ => {
            let unknown = Lens::unknown(raw.lens.name().to_string());
            return Err(Complaint { place: "model".into(), ..unknown });
        }
    };
    let resolution = size(w, h, requested.is_some()).map_err(|found| Complaint::new("image size", SIZES, found))?;
    let wrong = |Fault { expected, found, .. }: Fault| Complaint::new("parameters", expected, found);
    let (focal, center) = intrinsics.project(resolution).map_err(|fault| {
        let expected = "positive focal lengths and a principal point near the image".into();
        wrong(Fault { expected, ..fault })
    })?;
    let distortion = intrinsics.distortion(true).map_err(wrong)?;
    let camera = Camera { position: DVec3::ZERO, axes: DMat3::IDENTITY, focal, center, resolution, distortion };
    if let Some(found) = camera.folds_over() {
        return Err(Complaint::new("parameters", "a lens that leaves every pixel its ray", found));
    }
    Ok(requested.map_or(camera, |requested| camera.resized(requested)))
}

/// Position and axes, camera-to-world with OpenGL's axes; the error names what was found.
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
