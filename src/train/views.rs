//! Training images and held-out images of a data set with camera files.

use std::path::{Path, PathBuf};

use glam::DVec3;
use serde::Deserialize;

use crate::dataset::Hemisphere;
use crate::dataset::{
    Frame, FrameSplit, Part, PosedImage, ScenePoint, Selection, Views, camera_file, check_masks, read_masks,
    scene_points, test_partner,
};
use crate::geometry::{Aabb, Camera, Mask, NamedCamera};
use crate::monitor::{Monitor, check};
use crate::{Error, Result};

/// Half edge of the cube around NeRF-synthetic scenes, and of instant-ngp's unit cube: 0.5 / 0.33.
const HALF_EDGE: f64 = 0.5 / 0.33;

/// A picture and the camera that took it.
#[derive(Debug, Clone)]
pub struct Shot {
    /// `file_path` in the camera file.
    pub name: String,
    /// Pose and intrinsics.
    pub camera: Camera,
    /// The picture, at the camera's resolution.
    pub image: PosedImage,
    /// The pixels to train on, if not all.
    pub mask: Option<Mask>,
}

impl Shot {
    /// The camera with its name, without the picture.
    #[must_use]
    pub fn named_camera(&self) -> NamedCamera {
        NamedCamera { name: self.name.clone(), camera: self.camera, is_masked: self.mask.is_some() }
    }

    /// The same picture with fewer pixels, each the mean of as many as it covers.
    ///
    /// # Errors
    /// If the picture's size is no whole multiple of `resolution`, or if it has a mask.
    pub fn shrunk(self, resolution: [u32; 2]) -> Result<Self> {
        let [[width, height], [w, h]] = [self.camera.resolution, resolution];
        if self.mask.is_some() {
            let found = format!("a mask of `{}`", self.name);
            return Err(Error::setting("--resolution", "pictures without masks, which have no means", found));
        }
        let times = width / w.max(1);
        if times == 0 || [w * times, h * times] != [width, height] {
            let expected = format!("a whole fraction of the {width} x {height} pixels of `{}`", self.name);
            return Err(Error::setting("--resolution", expected, format!("{w} x {h}")));
        }
        let mean = |i: u32| {
            let (left, top) = (i % w * times, i / w * times);
            let (mut color, mut alpha) = (DVec3::ZERO, 0.0);
            for y in top..top + times {
                for pixel in (left..left + times).map(|x| (y * width + x) as usize) {
                    color += self.image.over(pixel, DVec3::ZERO);
                    alpha += self.image.alpha(pixel);
                }
            }
            let straight = if alpha > 0.0 { color / alpha } else { color };
            let byte = |v: f64| (255.0 * v).round().clamp(0.0, 255.0) as u8;
            let [red, green, blue] = straight.to_array().map(byte);
            [red, green, blue, byte(alpha / f64::from(times * times))]
        };
        let image = PosedImage::new(resolution, (0..w * h).map(mean).collect());
        Ok(Self { name: self.name, camera: self.camera.resized(resolution), image, mask: None })
    }

    /// Returns true if pixel `i` is not masked.
    #[must_use]
    pub fn keeps(&self, i: usize) -> bool {
        let width = self.camera.resolution[0] as usize;
        self.mask.as_ref().is_none_or(|mask| mask.keeps((i % width) as u32, (i / width) as u32))
    }
}

/// A data set as described by its files: the camera file, the split of its frames, and the scene box.
#[derive(Debug, Clone)]
pub struct DatasetFiles {
    /// Path of the camera file for training.
    pub path: PathBuf,
    split: FrameSplit,
    train: Vec<Frame>,
    held_out: Vec<Frame>,
    /// Number of frames whose image does not exist.
    pub missing: usize,
    /// The box that the camera file states, or else instant-ngp's.
    pub bounds: Aabb,
}

#[derive(Deserialize)]
struct SceneBox {
    aabb: Option<[[f64; 3]; 2]>,
    aabb_scale: Option<f64>,
}

impl DatasetFiles {
    /// Reads the camera files of `dataset`.
    ///
    /// `dataset` is a camera file, or a folder as [`camera_file`] reads it: with `transforms_train.json` (and
    /// `transforms_test.json`, which is held out), `transforms.json`, or a COLMAP model. Without a partner file every
    /// eighth image is held out. Frames without an image are left out, as in instant-ngp.
    ///
    /// # Errors
    /// If a file cannot be read, or no frame has an image.
    pub fn read(dataset: &Path) -> Result<Self> {
        let path = camera_file(dataset, Part::Training);
        // A model of COLMAP is a folder itself.
        if path.is_dir() && Views::files(&path) == [path.as_path()] {
            let expected = "transforms.json, a COLMAP model in sparse/0, or transforms_train.json";
            return Err(Error::malformed(dataset, "data set", expected, "none of them"));
        }
        let split = FrameSplit::new(Views::read(&path, None)?);
        if !split.has_images() {
            return Err(Error::malformed(&path, "`frames`", "images that exist", "none"));
        }
        let all = &Selection::All;
        let train = split.select(Part::Training, all, |_| true)?;
        let held_out = match test_partner(&path) {
            Some(partner) => FrameSplit::new(Views::read(&partner, None)?).select(Part::HeldOut, all, has_image)?,
            // A file of one part has nothing to spare.
            None => split.select(Part::HeldOut, all, |frame| !train.contains(frame))?,
        };
        let (bounds, missing) = (scene_box(&path)?, split.missing());
        Ok(Self { path, split, train, held_out, missing, bounds })
    }

    /// Keeps the training images of a selection, taken from one half of the scene (as seen from the middle of the
    /// box). Indices count before this filter, a count after it. Images trained on are not held out.
    ///
    /// # Errors
    /// If there are no such images.
    pub fn select(&mut self, selection: &Selection, half: Option<Hemisphere>) -> Result<()> {
        let middle = 0.5 * (self.bounds.min() + self.bounds.max());
        let keep = |frame: &Frame| half.is_none_or(|half| half.contains(frame.camera.position - middle));
        if !self.train.iter().any(keep) {
            return Err(Error::setting(
                "half of the scene",
                "a half that some training images were taken from",
                "none",
            ));
        }
        self.train = self.split.select(Part::Training, selection, keep)?;
        if self.train.is_empty() {
            let expected = "indices of images taken from that half";
            return Err(Error::setting("training views", expected, "none of them"));
        }
        let train = &self.train;
        self.held_out.retain(|frame| !train.contains(frame));
        Ok(())
    }

    /// The points that COLMAP found, if it made the cameras.
    ///
    /// # Errors
    /// If their file cannot be read.
    pub fn points(&self) -> Result<Vec<ScenePoint>> {
        scene_points(&self.path)
    }

    /// Describes in a sentence how many frames are trained on, and why the others of the file are not.
    #[must_use]
    pub fn describe(&self) -> String {
        self.split.describe(Part::Training, &self.train)
    }

    /// The cube around NeRF-synthetic scenes, in scene units.
    #[must_use]
    pub fn unit_cube() -> Aabb {
        Aabb::centered_cube(HALF_EDGE)
    }

    /// Names of the training images.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        self.train.iter().map(|frame| frame.name.clone()).collect()
    }

    /// Loads the images: those for training, then those held out.
    ///
    /// # Errors
    /// If an image is damaged or its size differs from the camera's, and [`Error::Interrupted`].
    pub fn load(&self, monitor: &dyn Monitor) -> Result<[Vec<Shot>; 2]> {
        monitor.begin("images", (self.train.len() + self.held_out.len()) as u64);
        let load = |frames: &[Frame]| {
            let masks = read_masks(frames)?;
            let shot = |(frame, mask): (&Frame, Option<Mask>)| {
                check(monitor)?;
                let image = PosedImage::read(&frame.image, frame.camera.resolution)?;
                monitor.advance(1);
                Ok(Shot { name: frame.name.clone(), camera: frame.camera, image, mask })
            };
            frames.iter().zip(masks).map(shot).collect::<Result<Vec<_>>>()
        };
        let shots = [load(&self.train)?, load(&self.held_out)?];
        let masks: Vec<Option<Mask>> = shots[0].iter().map(|shot| shot.mask.clone()).collect();
        check_masks(&self.path, &masks)?;
        monitor.end();
        Ok(shots)
    }
}

fn has_image(frame: &Frame) -> bool {
    frame.image.exists()
}

/// `aabb` of the camera file (a COLMAP model has none), else instant-ngp's unit cube around the origin times
/// `aabb_scale`.
fn scene_box(path: &Path) -> Result<Aabb> {
    if Views::files(path) != [path] {
        return Ok(Aabb::centered_cube(HALF_EDGE));
    }
    let text = crate::io::read_text(path)?;
    let found: SceneBox = serde_json::from_str(&text)
        .map_err(|e| Error::malformed(path, "`aabb`, `aabb_scale`", "corners and a number", e.to_string()))?;
    if let Some([min, max]) = found.aabb {
        return Aabb::new(min.into(), max.into())
            .map_err(|e| Error::malformed(path, "`aabb`", "min < max", e.to_string()));
    }
    let scale = found.aabb_scale.unwrap_or(1.0);
    if !(scale > 0.0 && scale <= 1024.0) {
        return Err(Error::malformed(path, "`aabb_scale`", "above 0 and at most 1024", scale.to_string()));
    }
    Ok(Aabb::centered_cube(HALF_EDGE * scale))
}
