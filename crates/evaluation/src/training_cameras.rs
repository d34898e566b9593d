//! The cameras that a model was trained on. Those of `train` store them. Others do not, but their field has the checksum
//! of its cameras, by which a camera file is recognised.

use std::path::{Path, PathBuf};

use octobayes::estimate::Model;
use octobayes::geometry::{Camera, NamedCamera};
use octobayes_data::{Frame, FrameSplit, Part, Selection, Views, read_masks};

/// The training cameras of `model`, called `name`: those that it stores, or those of the checksum that its
/// field was computed with, if a camera file has them: `views`, of the file `path`, or one beside that file or the
/// model, as it is or at the image size of `views`. None if they are unknown.
pub fn training_cameras(
    model: &dyn Model,
    name: &str,
    wanted: Option<u32>,
    path: &Path,
    views: &Views,
) -> Vec<NamedCamera> {
    if !model.training_cameras().is_empty() {
        return model.training_cameras().to_vec();
    }
    let Some(wanted) = wanted else { return Vec::new() };
    let mut files: Vec<PathBuf> = ["transforms_train.json", "transforms.json", "cameras.json"]
        .iter()
        .flat_map(|file| [path, Path::new(name)].map(|beside| beside.with_file_name(file)))
        .filter(|file| file != path && file.is_file())
        .collect();
    files.dedup();
    // A file that cannot be read does not have the cameras.
    let others = files.iter().filter_map(|file| Views::read(file, None).ok());
    let size = views.frames.first().map(|frame| frame.camera.resolution);
    std::iter::once(views.clone()).chain(others).find_map(|views| recognised(views, wanted, size)).unwrap_or_default()
}

/// The training frames of these views, or all frames, if their cameras have this checksum, as they are or at a size.
fn recognised(views: Views, wanted: u32, size: Option<[u32; 2]>) -> Option<Vec<NamedCamera>> {
    let split = FrameSplit::new(views);
    let parts = [Selection::All, Selection::BothParts].into_iter();
    let parts = parts.filter_map(|selection| split.select(Part::Training, &selection, |_| true).ok());
    let of = |frames: Vec<Frame>| {
        let at = |size: Option<[u32; 2]>| -> Vec<Camera> {
            frames.iter().map(|frame| size.map_or(frame.camera, |size| frame.camera.resized(size))).collect()
        };
        // A run may have left the file's masks out. Those that cannot be read are not its own.
        let is_wanted =
            |cameras: &Vec<Camera>| Camera::checksum(cameras) == wanted || with_masks(&frames, cameras) == Some(wanted);
        let cameras = [None, size].into_iter().map(at).find(is_wanted)?;
        Some(frames.iter().zip(cameras).map(|(frame, camera)| NamedCamera::new(&frame.name, camera)).collect())
    };
    parts.into_iter().find_map(of)
}

/// Checksum of these cameras with the masks of their frames; none if there are none, or if one cannot be read.
fn with_masks(frames: &[Frame], cameras: &[Camera]) -> Option<u32> {
    if frames.iter().all(|frame| frame.mask.is_none()) {
        return None;
    }
    let mut masks = read_masks(frames).ok()?;
    for (mask, camera) in masks.iter_mut().zip(cameras) {
        *mask = mask.as_ref().map(|mask| mask.resized(camera.resolution));
    }
    Some(Camera::checksum_with(cameras, &masks))
}
