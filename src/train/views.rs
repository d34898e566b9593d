//! Images to train on and images held out, from a data set with camera files.

use std::path::{Path, PathBuf};

use glam::DVec3;
use serde::Deserialize;

use crate::dataset::{Frame, PosedImage, Views};
use crate::geometry::{Aabb, Camera};
use crate::monitor::{Monitor, check};
use crate::synth::Hemisphere;
use crate::{Error, Result};

/// Half edge of the cube that NeRF-synthetic scenes fit into, and of instant-ngp's unit cube: 0.5 / 0.33.
const HALF_EDGE: f64 = 0.5 / 0.33;
/// Of a camera file without a partner for tests, one image in this many is held out.
const HOLD_OUT: usize = 8;

/// A picture and the camera that took it.
#[derive(Debug, Clone)]
pub struct Shot {
    /// `file_path` in the camera file.
    pub name: String,
    /// Pose and intrinsics.
    pub camera: Camera,
    /// The picture, of the camera's resolution.
    pub image: PosedImage,
}

/// Which of the training images to use.
#[derive(Debug, Clone, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Selection {
    /// All.
    #[default]
    All,
    /// This many, spread evenly over the camera file's order.
    Count(usize),
    /// Those of these indices, from 0, in the camera file's order.
    Indices(Vec<usize>),
}

/// What a data set says about itself: camera files, which frames are for training, and where the scene is.
#[derive(Debug, Clone)]
pub struct DatasetFiles {
    /// The camera file for training.
    pub path: PathBuf,
    train: Vec<Frame>,
    held_out: Vec<Frame>,
    /// Frames whose image does not exist.
    pub missing: usize,
    /// The box that the camera file names, or instant-ngp's.
    pub bounds: Aabb,
}

#[derive(Deserialize)]
struct SceneBox {
    aabb: Option<[[f64; 3]; 2]>,
    aabb_scale: Option<f64>,
}

impl DatasetFiles {
    /// Reads the camera files of `dataset`: a folder with `transforms_train.json` (and `transforms_test.json`, which is held out) or
    /// `transforms.json`, or a camera file. Of a file without a partner every eighth image is held out. Frames without an image are left out, as in instant-ngp.
    ///
    /// # Errors
    /// If a file cannot be read, or no frame has an image.
    pub fn read(dataset: &Path) -> Result<Self> {
        let path = if dataset.is_dir() {
            let names = ["transforms_train.json", "transforms.json"];
            names.iter().map(|name| dataset.join(name)).find(|path| path.exists()).ok_or_else(|| {
                Error::malformed(dataset, "data set", "transforms_train.json or transforms.json", "neither")
            })?
        } else {
            dataset.to_path_buf()
        };
        let views = Views::read(&path, None)?;
        let all = views.frames.len();
        let mut train: Vec<Frame> = views.frames.into_iter().filter(|frame| frame.image.exists()).collect();
        let missing = all - train.len();
        if train.is_empty() {
            return Err(Error::malformed(&path, "`frames`", "images that exist", "none"));
        }
        let is_train = path.file_name().is_some_and(|name| name == "transforms_train.json");
        let partner = path.with_file_name("transforms_test.json");
        let held_out = if is_train && partner.exists() {
            Views::read(&partner, None)?.frames.into_iter().filter(|frame| frame.image.exists()).collect()
        } else {
            let mut index = 0;
            let mut is_held_out = |_: &mut Frame| {
                index += 1;
                // From the middle of the first eight: a single image is for training.
                index % HOLD_OUT == HOLD_OUT / 2
            };
            train.extract_if(.., &mut is_held_out).collect()
        };
        let bounds = scene_box(&path)?;
        Ok(Self { path, train, held_out, missing, bounds })
    }

    /// Keeps the training images of a selection, after those taken from one half of the scene (seen from the middle of the box).
    ///
    /// # Errors
    /// If there are no such images.
    pub fn select(&mut self, selection: &Selection, half: Option<Hemisphere>) -> Result<()> {
        let n = self.train.len();
        if let Selection::Indices(indices) = selection {
            if let Some(i) = indices.iter().find(|i| **i >= n) {
                let expected = format!("indices of training images from 0 to {}", n - 1);
                return Err(Error::setting("--views", expected, i.to_string()));
            }
            let mut index = 0..n;
            self.train.retain(|_| index.next().is_some_and(|i| indices.contains(&i)));
        }
        if let Some(half) = half {
            let middle = 0.5 * (self.bounds.min() + self.bounds.max());
            self.train.retain(|frame| is_in(half, frame.camera.position - middle));
        }
        let n = self.train.len();
        if let Selection::Count(count) = selection {
            if *count > n {
                return Err(Error::setting("--views", format!("at most {n} training images"), count.to_string()));
            }
            let kept: Vec<usize> = (0..*count).map(|i| (2 * i + 1) * n / (2 * count)).collect();
            let mut index = 0..n;
            self.train.retain(|_| index.next().is_some_and(|i| kept.contains(&i)));
        }
        if self.train.is_empty() {
            return Err(Error::setting("--hemisphere, --views", "some training images", "none"));
        }
        Ok(())
    }

    /// The cube that NeRF-synthetic scenes fit into, scene units.
    #[must_use]
    pub fn unit_cube() -> Aabb {
        Aabb::centered_cube(HALF_EDGE)
    }

    /// Names of the training images.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        self.train.iter().map(|frame| frame.name.clone()).collect()
    }

    /// Loads the images: for training, and held out.
    ///
    /// # Errors
    /// If an image is damaged or its size is not the camera's; [`Error::Interrupted`].
    pub fn load(&self, monitor: &dyn Monitor) -> Result<[Vec<Shot>; 2]> {
        monitor.begin("images", (self.train.len() + self.held_out.len()) as u64);
        let load = |frames: &[Frame]| {
            frames
                .iter()
                .map(|frame| {
                    check(monitor)?;
                    let image = PosedImage::read(&frame.image, frame.camera.resolution)?;
                    monitor.advance(1);
                    Ok(Shot { name: frame.name.clone(), camera: frame.camera, image })
                })
                .collect::<Result<Vec<_>>>()
        };
        let shots = [load(&self.train)?, load(&self.held_out)?];
        monitor.end();
        Ok(shots)
    }
}

fn is_in(half: Hemisphere, x: DVec3) -> bool {
    match half {
        Hemisphere::Left => x.x < 0.0,
        Hemisphere::Right => x.x > 0.0,
        Hemisphere::Front => x.y < 0.0,
        Hemisphere::Back => x.y > 0.0,
    }
}

/// `aabb` of the camera file, else instant-ngp's unit cube around the origin times `aabb_scale`.
fn scene_box(path: &Path) -> Result<Aabb> {
    let text = std::fs::read_to_string(path).map_err(Error::io(path, "cannot read"))?;
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
