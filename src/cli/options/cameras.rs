//! Where cameras come from: files, or the model.

use std::collections::BTreeSet;
use std::path::PathBuf;

use clap::Args;

use super::parse::{Resolution, parse_fov, parse_resolution, parse_views};
use crate::dataset::{Frame, FrameSplit, Part, ResolutionSource, Selection, Views, camera_file};
use crate::error::printable;
use crate::field::{Intrinsics, RadianceField};
use crate::{Error, Result};

/// A camera file.
#[derive(Args)]
pub struct CameraFile {
    /// transforms.json with intrinsics and camera-to-world poses (OpenGL axes), or a COLMAP model: its folder
    /// (cameras and images, .bin or .txt) or the folder with sparse/0; or a folder with transforms.json or
    /// transforms_test.json
    #[arg(long, value_name = "PATH")]
    pub cameras: PathBuf,

    /// Image size, WxH, or W alone to keep the aspect ratio [default: from the camera file, else from its first
    /// image, else 400x400]
    #[arg(long, value_name = "SIZE", value_parser = parse_resolution)]
    pub resolution: Option<Resolution>,
}

/// Which frames of a camera file to use.
#[derive(Args)]
pub struct FrameOptions {
    /// Frames of the camera file: how many, spread over its order; or their numbers in the file from 0, as in `render
    /// --frame`, such as 0,7,31 (`7,` for one); or `all`. Frames without an image are left out, unless there are no
    /// images at all. If the file does not list its training frames, every eighth frame with an image is held out, as
    /// in `train` [default: all training frames; in `evaluate`, all held-out frames]
    #[arg(long, value_name = "N|I,J,...|all", value_parser = parse_views, requires = "cameras")]
    pub views: Option<Selection>,
}

impl FrameOptions {
    /// Selects frames of a part. Says on stderr how many, and why the others are left out.
    fn select(&self, part: Part, views: Views) -> Result<Vec<Frame>> {
        let split = FrameSplit::new(views);
        let frames = split.select(part, &self.views.clone().unwrap_or_default(), |_| true)?;
        announce!("note: {}", split.describe(part, &frames));
        Ok(frames)
    }

    /// Frames to evaluate `model` on. Warns if it was trained on some of them.
    pub fn held_out(&self, views: Views, model: &dyn RadianceField) -> Result<Vec<Frame>> {
        let frames = self.select(Part::HeldOut, views)?;
        let known = matched(&frames, model).iter().flatten().count();
        if known > 0 {
            let n = frames.len();
            announce!(
                "warning: the model was trained on {known} of these {n} frames: it knows them better than others"
            );
        }
        Ok(frames)
    }
}

impl CameraFile {
    /// Of a folder, takes the file of held-out cameras.
    pub fn find(&mut self) {
        self.cameras = camera_file(&self.cameras, Part::HeldOut);
    }

    /// Reads the file. Says so if it has to assume the image size.
    pub fn read(&self) -> Result<Views> {
        let mut views = Views::read(&self.cameras, self.resolution.and_then(Resolution::size))?;
        for note in &views.notes {
            announce!("note: {}: {}", self.cameras.display(), printable(note));
        }
        if let Some(resolution) = self.resolution {
            views.frames.iter_mut().for_each(|frame| frame.camera = resolution.apply(&frame.camera));
            views.resolution_source = ResolutionSource::Requested;
        }
        if views.resolution_source == ResolutionSource::Assumed {
            let [w, h] = views.frames[0].camera.resolution;
            let path = self.cameras.display();
            announce!(
                "note: {path} states no image size and its images are not there: assuming {w} x {h} (--resolution)"
            );
        }
        Ok(views)
    }
}

/// A camera file, or the cameras that come with the model.
#[derive(Args)]
pub struct CameraOptions {
    /// transforms.json with intrinsics and camera-to-world poses (OpenGL axes), or a COLMAP model: its folder
    /// (cameras and images, .bin or .txt) or the folder with sparse/0; or a folder with transforms.json or
    /// transforms_train.json [default: the model's own cameras, if it has any]
    #[arg(long, value_name = "PATH")]
    pub cameras: Option<PathBuf>,

    /// Horizontal angle of view of the model's own cameras, degrees
    #[arg(long, value_name = "DEGREES", value_parser = parse_fov, conflicts_with = "cameras")]
    pub fov: Option<f64>,

    /// Image size, WxH, or W alone to keep the aspect ratio [default: from the camera file, else from its first
    /// image, else 400x400]
    #[arg(long, value_name = "SIZE", value_parser = parse_resolution)]
    pub resolution: Option<Resolution>,
}

impl CameraOptions {
    /// Of a folder, takes the file of a part.
    pub fn find(&mut self, part: Part) {
        self.cameras = self.cameras.take().map(|path| camera_file(&path, part));
    }

    /// Reads the camera file, or else asks the model `name`.
    pub fn read(&self, model: &dyn RadianceField, name: &str) -> Result<Views> {
        if let Some(cameras) = &self.cameras {
            return CameraFile { cameras: cameras.clone(), resolution: self.resolution }.read();
        }
        let size = self.resolution.and_then(Resolution::size);
        let intrinsics = Intrinsics { fov_x: self.fov.map(f64::to_radians), resolution: size };
        let cameras = model.cameras(&intrinsics)?.ok_or_else(|| {
            Error::setting(
                "--cameras",
                "a transforms.json, as this model brings no cameras",
                format!("none for `{name}`"),
            )
        })?;
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

    /// The cameras that the model was trained on: its own, or the training frames of the camera file. Says on
    /// stderr which. Warns if they differ from those that the model knows.
    pub fn training(&self, options: &FrameOptions, model: &dyn RadianceField, name: &str) -> Result<Views> {
        let views = self.read(model, name)?;
        if self.cameras.is_none() {
            let whose = if model.training_cameras().is_empty() { "the model's own" } else { "stored in the model" };
            let masked = model.training_cameras().iter().filter(|named| named.is_masked).count();
            if masked > 0 {
                let expected = "the data set that the model was trained on: its masks are not stored in the model";
                return Err(Error::setting("--cameras", expected, format!("{masked} cameras with masks")));
            }
            announce!("note: {} cameras ({whose})", views.frames.len());
            return Ok(views);
        }
        let (path, resolution_source) = (views.path.clone(), views.resolution_source);
        let frames = options.select(Part::Training, views)?;
        let stored = model.training_cameras().len();
        let matches = matched(&frames, model);
        let known: BTreeSet<usize> = matches.iter().flatten().copied().collect();
        let (others, absent) = (matches.iter().filter(|m| m.is_none()).count(), stored - known.len());
        if stored > 0 && others + absent > 0 {
            announce!(
                "warning: these are not the cameras that the model was trained on: {others} of these {} are others, \
                 {absent} of its {stored} are not among these; without --cameras those stored in the model are used",
                frames.len()
            );
        }
        Ok(Views { path, frames, resolution_source, notes: Vec::new() })
    }
}

/// Warns if the number of training pixels, by which `--scale data` weighs them, follows from an image size that nobody
/// knows.
pub fn warn_of_pixels(views: &Views, pixels: u64) {
    if views.resolution_source == ResolutionSource::Assumed {
        let [w, h] = views.frames[0].camera.resolution;
        announce!(
            "warning: --scale data counts {pixels} training pixels, of images of {w} x {h} that neither model nor \
             cameras vouch for; with sides k times as long, U of what images constrain would be k times as small"
        );
    }
}

/// For each frame, the index of the same camera among those that the model was trained on ([`Camera::is_like`],
/// seen from the far side of the model's box).
///
/// [`Camera::is_like`]: crate::geometry::Camera::is_like
fn matched(frames: &[Frame], model: &dyn RadianceField) -> Vec<Option<usize>> {
    let (stored, length) = (model.training_cameras(), model.bounds().longest_edge());
    frames.iter().map(|frame| stored.iter().position(|known| known.camera.is_like(&frame.camera, length))).collect()
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::field::Coordinates;

    #[test]
    fn a_model_without_cameras_needs_a_camera_file() {
        let options = CameraOptions { cameras: None, fov: None, resolution: None };
        let scene = crate::field::VoxelGrid::bake(&crate::field::ClosedForm::ball(), [2; 3], Vec3::Z);
        let error = options.read(&scene, "ball.npz").unwrap_err().to_string();
        assert!(error.contains("--cameras") && error.contains("ball.npz"), "{error}");
        let error = crate::open::open_in("scene:ball", Some(Coordinates::Blender)).err().unwrap().to_string();
        assert!(error.contains("coordinates") && error.contains("scene:ball"), "{error}");
    }
}
