//! Training images and held-out images of a data set with camera files.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use glam::DVec3;
use serde::Deserialize;

use octobayes::geometry::{Aabb, Camera, Mask, NamedCamera};
use octobayes::io::place::folder_of;
use octobayes::monitor::{Monitor, check};
use octobayes::{Error, Result};
use octobayes_data::Hemisphere;
use octobayes_data::NGP_SCALE;
use octobayes_data::{
    Frame, FrameSplit, Part, PosedImage, ScenePoint, Selection, Views, camera_file, check_masks, has_shape, read_masks,
    scene_points, test_partner,
};

/// Half edge of the cube around NeRF-synthetic scenes, and of instant-ngp's unit cube.
const HALF_EDGE: f64 = 0.5 / NGP_SCALE;

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
    /// Loads the pictures of frames, [shrunk](Self::shrunk) to the size that a camera is to have.
    ///
    /// # Errors
    /// As [`PosedImage::of`] and [`Shot::shrunk`], whose sizes are checked before the first image is read; and
    /// [`Error::Interrupted`].
    pub fn load(frames: &[Frame], size: impl Fn(&Camera) -> [u32; 2], monitor: &dyn Monitor) -> Result<Vec<Self>> {
        for frame in frames {
            check_size(&frame.name, &frame.camera, size(&frame.camera))?;
        }
        monitor.begin("images", frames.len() as u64);
        let masks = read_masks(frames)?;
        let shot = |(frame, mask): (&Frame, Option<Mask>)| {
            check(monitor)?;
            let image = PosedImage::of(frame)?;
            monitor.advance(1);
            let shot = Self { name: frame.name.clone(), camera: frame.camera, image, mask };
            shot.shrunk(size(&frame.camera))
        };
        let shots = frames.iter().zip(masks).map(shot).collect();
        monitor.end();
        shots
    }

    /// The camera with its name, without the picture.
    #[must_use]
    pub fn named_camera(&self) -> NamedCamera {
        NamedCamera { name: self.name.clone(), camera: self.camera, is_masked: self.mask.is_some() }
    }

    /// Checksum of pictures and masks, in their order.
    #[must_use]
    pub fn checksum(shots: &[Self]) -> u32 {
        let mut checksum = crc32fast::Hasher::new();
        for shot in shots {
            checksum.update(&shot.image.checksum().to_le_bytes());
            checksum.update(&shot.mask.as_ref().map_or(0, Mask::checksum).to_le_bytes());
        }
        checksum.finalize()
    }

    /// The same picture with fewer pixels, each the mean of what it covers; one that covers a masked pixel is masked.
    ///
    /// # Errors
    /// If the picture is smaller than `resolution`, or if its sides have another ratio.
    pub fn shrunk(self, resolution: [u32; 2]) -> Result<Self> {
        check_size(&self.name, &self.camera, resolution)?;
        let mask = self.mask.map(|mask| mask.shrunk(resolution));
        let (camera, image) = (self.camera.resized(resolution), self.image.shrunk(resolution));
        Ok(Self { name: self.name, camera, image, mask })
    }

    /// Returns true if pixel `i` is not masked.
    #[must_use]
    pub fn keeps(&self, i: usize) -> bool {
        let width = self.camera.resolution[0] as usize;
        self.mask.as_ref().is_none_or(|mask| mask.keeps((i % width) as u32, (i / width) as u32))
    }
}

/// Refuses a size to which a picture cannot be shrunk: a larger one, or one of another shape.
fn check_size(name: &str, camera: &Camera, resolution: [u32; 2]) -> Result<()> {
    let ([width, height], [w, h]) = (camera.resolution, resolution);
    if w <= width && h <= height && has_shape(camera.resolution, resolution) {
        return Ok(());
    }
    let expected = format!("at most the {width} x {height} pixels of `{name}`, and their ratio: a width alone has it");
    Err(Error::setting("--resolution", expected, format!("{w} x {h}")))
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
    /// What a user should know of the cameras, a sentence each.
    pub notes: Vec<String>,
}

/// Keys of instant-ngp for where the scene lies. Its cube, of edge `aabb_scale` around ½, holds `scale` x +
/// `offset`.
#[derive(Deserialize)]
struct SceneBox {
    aabb: Option<[[f64; 3]; 2]>,
    aabb_scale: Option<f64>,
    scale: Option<f64>,
    offset: Option<Offset>,
}

/// An offset along each axis, or the same along all.
#[derive(Deserialize)]
#[serde(untagged)]
enum Offset {
    Same(f64),
    Each([f64; 3]),
}

impl DatasetFiles {
    /// Reads the camera files of `dataset`.
    ///
    /// `dataset` is a camera file, or a folder as [`camera_file`] reads it: with `transforms_train.json` (and
    /// `transforms_test.json`, which is held out), `transforms.json`, or a COLMAP model. Without a partner file frames
    /// are held out by the rule of [`FrameSplit`]. Frames without an image are left out, as in instant-ngp.
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
        let mut views = Views::read(&path, None)?;
        let places = views.places();
        let (path, notes) = (views.path.clone(), std::mem::take(&mut views.notes));
        let split = FrameSplit::new(views);
        if !split.has_images() {
            let folder = if path.is_dir() { &path } else { folder_of(&path) };
            let below = |place: &PathBuf| place.strip_prefix(folder).unwrap_or(place).display().to_string();
            let tried: Vec<String> = places.iter().map(below).collect();
            let found = format!("none of {}", tried.join(", "));
            return Err(Error::malformed(&path, "`frames`", "images that exist", found));
        }
        let all = &Selection::All;
        let train = split.select(Part::Training, all, |_| true)?;
        let held_out = match test_partner(&path) {
            Some(partner) => FrameSplit::new(Views::read(&partner, None)?).matching(Part::HeldOut, all, has_image)?,
            // A file of one part has nothing to spare.
            None => split.matching(Part::HeldOut, all, other_than(&train))?,
        };
        let (bounds, missing) = (scene_box(&path)?, split.missing());
        Ok(Self { path, split, train, held_out, missing, bounds, notes })
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
        self.train = self.split.matching(Part::Training, selection, keep)?;
        if self.train.is_empty() {
            let expected = "indices of images taken from that half";
            return Err(Error::setting("training views", expected, "none of them"));
        }
        self.held_out.retain(other_than(&self.train));
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

    /// The cameras of the images for training, then of those held out.
    pub fn cameras(&self) -> impl Iterator<Item = &Camera> {
        self.train.iter().chain(&self.held_out).map(|frame| &frame.camera)
    }

    /// Loads the images: those for training, then those held out.
    ///
    /// # Errors
    /// If an image is damaged or its size differs from the camera's, and [`Error::Interrupted`].
    pub fn load(&self, monitor: &dyn Monitor) -> Result<[Vec<Shot>; 2]> {
        self.load_at(|camera| camera.resolution, monitor)
    }

    /// Loads the images [shrunk](Shot::shrunk) to the size that a camera is to have.
    ///
    /// # Errors
    /// As [`DatasetFiles::load`] and [`Shot::shrunk`]; sizes are checked before an image is read.
    pub fn load_at(&self, size: impl Fn(&Camera) -> [u32; 2], monitor: &dyn Monitor) -> Result<[Vec<Shot>; 2]> {
        let (frames, train) = ([&self.train[..], &self.held_out].concat(), self.train.len());
        let mut shots = Shot::load(&frames, size, monitor)?;
        let held_out = shots.split_off(train);
        let masks: Vec<Option<Mask>> = shots.iter().map(|shot| shot.mask.clone()).collect();
        check_masks(&self.path, &masks)?;
        Ok([shots, held_out])
    }
}

fn has_image(frame: &Frame) -> bool {
    frame.image.exists()
}

/// Whether a frame has another image than all of these.
fn other_than(frames: &[Frame]) -> impl Fn(&Frame) -> bool + use<> {
    let images: HashSet<PathBuf> = frames.iter().map(|frame| frame.image.clone()).collect();
    move |frame| !images.contains(&frame.image)
}

/// `aabb` of the camera file, else instant-ngp's cube: of edge `aabb_scale`, in its coordinates `scale` x + `offset`. A
/// COLMAP model and a list of cameras have none of these keys.
fn scene_box(path: &Path) -> Result<Aabb> {
    if Views::files(path) != [path] {
        return Ok(Aabb::centered_cube(HALF_EDGE));
    }
    let text = octobayes::io::read_text(path)?;
    if text.trim_start().starts_with('[') {
        return Ok(Aabb::centered_cube(HALF_EDGE));
    }
    let place = "`aabb`, `aabb_scale`, `scale`, `offset`";
    let found: SceneBox = serde_json::from_str(&text)
        .map_err(|e| Error::malformed(path, place, "corners, numbers and a position", e.to_string()))?;
    if let Some([min, max]) = found.aabb {
        return Aabb::new(min.into(), max.into())
            .map_err(|e| Error::malformed(path, "`aabb`", "min < max", e.to_string()));
    }
    let within = |key: &str, value: f64, [least, most]: [f64; 2]| {
        let found = || Error::malformed(path, key, format!("{least} to {most}"), value.to_string());
        (value >= least && value <= most).then_some(value).ok_or_else(found)
    };
    let edge = within("`aabb_scale`", found.aabb_scale.unwrap_or(1.0), [1e-6, 1024.0])?;
    let scale = within("`scale`", found.scale.unwrap_or(NGP_SCALE), [1e-6, 1e6])?;
    let offset = match found.offset {
        None => DVec3::splat(0.5),
        Some(Offset::Same(offset)) => DVec3::splat(offset),
        Some(Offset::Each(offset)) => offset.into(),
    };
    let (middle, half) = ((0.5 - offset) / scale, 0.5 * edge / scale);
    Aabb::new(middle - half, middle + half)
        .map_err(|e| Error::malformed(path, "`offset`", "a finite position", e.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> std::result::Result<[DVec3; 2], String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cameras.json");
        std::fs::write(&path, text).unwrap();
        scene_box(&path).map(|found| [found.min(), found.max()]).map_err(|e| e.to_string())
    }

    #[test]
    fn other_pixels_masks_and_orders_have_other_checksums() {
        let camera = octobayes::field::ClosedForm::half_circle(1, [2, 2])[0];
        let shot = |gray: u8, mask: Option<Mask>| {
            let image = PosedImage::new([2, 2], vec![[gray, gray, gray, 255]; 4]);
            Shot { name: "r".into(), camera, image, mask }
        };
        let half = || Some(Mask::new([2, 2], |column, _| column == 0));
        let sets = [
            vec![shot(1, None), shot(2, None)],
            vec![shot(2, None), shot(1, None)],
            vec![shot(1, None), shot(3, None)],
            vec![shot(1, half()), shot(2, None)],
            vec![shot(1, None), shot(2, half())],
            vec![shot(1, None)],
        ];
        let sums: HashSet<u32> = sets.iter().map(|shots| Shot::checksum(shots)).collect();
        assert_eq!(sums.len(), sets.len());
        assert_eq!(Shot::checksum(&sets[3]), Shot::checksum(&[shot(1, half()), shot(2, None)]));
    }

    /// instant-ngp's cube holds `scale` x + `offset`: its corners are found by solving for x.
    #[test]
    fn the_box_is_where_instant_ngp_has_it() {
        let near = |text: &str, expected: [DVec3; 2]| {
            let found = read(text).unwrap();
            let off = found.iter().zip(expected).map(|(a, b)| (*a - b).abs().max_element()).fold(0.0, f64::max);
            assert!(off < 1e-12, "{text}: {found:?}");
        };
        let cube = |half: f64| [DVec3::splat(-half), DVec3::splat(half)];
        near("{}", cube(0.5 / 0.33));
        near("[{\"id\": 0}]", cube(0.5 / 0.33));
        near(r#"{"aabb_scale": 4}"#, cube(2.0 / 0.33));
        near(r#"{"scale": 0.1}"#, cube(5.0));
        near(r#"{"scale": 0.1, "aabb_scale": 2, "offset": 0.5}"#, cube(10.0));
        near(r#"{"scale": 0.5, "offset": [0.5, 0.5, 0.2]}"#, [DVec3::new(-1.0, -1.0, -0.4), DVec3::new(1.0, 1.0, 1.6)]);
        near(
            r#"{"aabb": [[-1, -2, -3], [1, 2, 3]], "scale": 0.1}"#,
            [DVec3::new(-1.0, -2.0, -3.0), DVec3::new(1.0, 2.0, 3.0)],
        );
        for (text, words) in [
            (r#"{"scale": 0}"#, "`scale`: expected 0.000001 to 1000000"),
            (r#"{"aabb_scale": -1}"#, "`aabb_scale`: expected 0.000001 to 1024"),
            (r#"{"offset": "left"}"#, "`offset`: expected corners"),
        ] {
            let error = read(text).unwrap_err();
            assert!(error.contains(words), "{error}");
        }
    }
}
