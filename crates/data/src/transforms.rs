//! Camera files: transforms.json of the original NeRF, instant-ngp and nerfstudio; and the cameras.json of Gaussian
//! splatting and the cameras.xml of Metashape, which become one.
//!
//! A key that changes rays is applied or refused by name; unknown keys are listed in a note.
//! `docs/src/formats.md` has the table of all keys. `transform_matrix` is camera-to-world with OpenGL axes (x right, y
//! up, looking along −z).

mod keys;
mod write;

use std::collections::{BTreeSet, HashMap};
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use serde_json::Value;

use self::keys::{PERSPECTIVE, RawFile, RawFrame};
pub use self::write::{transforms_text, write_transforms};
use super::intrinsics::{Fault, Intrinsics};
use super::mask_folders::find_masks;
use super::pictures::{MaskFile, SMALLER, image_path, image_path_in, note_of_smaller};
use super::pose::rigid_pose;
use super::sizes::Head;
use super::split::Lists;
use super::views::{Frame, Purpose, ResolutionSource, Views};
use super::{inria, metashape, nerfstudio, other_kinds};
use octobayes::geometry::{Camera, MAX_PIXELS, MAX_SIDE};
use octobayes::{Error, Result};

/// Image size if nothing states it.
const ASSUMED: [u32; 2] = [400, 400];
/// [`MAX_SIDE`] and [`MAX_PIXELS`] in words.
pub(super) const SIZES: &str = "sides from 1 to 65536 and at most 1e8 pixels, or a smaller size by --resolution";

/// Focal lengths along x and y that differ by this factor are worth a note: no sensor's pixels do.
const MAX_FOCAL_RATIO: f64 = 1.5;
/// Numbers of poses that differ by less are those of one pose.
const SAME_POSE: f64 = 1e-6;

/// Checks the size of the images of a camera; the error is the size in words. It may have more than [`MAX_PIXELS`] if
/// the camera is requested at another size.
pub(super) fn size(w: f64, h: f64, is_resized: bool) -> std::result::Result<[u32; 2], String> {
    // BlenderNeRF writes a share of the resolution, which Blender rounds down.
    let [whole_w, whole_h] = [w, h].map(f64::floor);
    let side = |v: f64| (1.0..=MAX_SIDE).contains(&v);
    let fits = is_resized || whole_w * whole_h <= MAX_PIXELS;
    if side(whole_w) && side(whole_h) && fits {
        Ok([whole_w as u32, whole_h as u32])
    } else {
        Err(format!("{w} x {h}"))
    }
}

/// The size of a picture, if it is one.
fn image_size(path: &Path) -> Option<[u32; 2]> {
    Head::read(path).map(|head| head.size)
}

/// Where the pictures of a camera file are.
struct Pictures<'a> {
    /// The folder of the camera file.
    folder: &'a Path,
    /// The folder in it that takes the place of `images` in their names, if not `images`; or that they are below, as
    /// those of a cameras.json or of a folder that the user named may be.
    instead: Option<&'a str>,
    may_be_below: bool,
}

impl<'a> Pictures<'a> {
    /// Finds the pictures of these names: in the folder that the user `chose`, or where any is, `images` before its
    /// smaller copies.
    fn find(folder: &'a Path, chosen: Option<&'a str>, is_inria: bool, frames: &[RawFrame]) -> Self {
        let places = |instead| Self { folder, instead, may_be_below: is_inria || chosen.is_some() };
        if chosen.is_some() {
            return places(chosen);
        }
        let beside = is_inria.then_some("images");
        let others = beside.into_iter().chain(SMALLER).map(Some);
        let holds = |pictures: &Self| frames.iter().any(|frame| pictures.path(&frame.file_path).is_file());
        [None].into_iter().chain(others).map(places).find(holds).unwrap_or_else(|| places(None))
    }

    fn path(&self, name: &str) -> PathBuf {
        let other = self.instead.and_then(|instead| image_path_in(self.folder, instead, name, self.may_be_below));
        other.unwrap_or_else(|| image_path(self.folder, name))
    }
}

/// A camera file while it is read.
struct Reading<'a> {
    path: &'a Path,
    folder: &'a Path,
    pictures: &'a Pictures<'a>,
    requested: Option<[u32; 2]>,
    file: &'a RawFile,
    /// Size of the first picture that is there, for frames without one.
    any_image: Option<[u32; 2]>,
    source: ResolutionSource,
    /// The first frame whose own focal length differs from the file's.
    contradiction: Option<usize>,
    /// The first frame whose pixels are far from square, and its focal lengths.
    stretched: Option<(usize, [f64; 2])>,
}

impl Reading<'_> {
    /// The size of the images that the intrinsics of a frame refer to; `None` if nothing states it, and they need none.
    fn size(&mut self, stated: &Intrinsics, image: &Path, at: &dyn Fn(&str) -> String) -> Result<Option<[u32; 2]>> {
        let wrong = |found: String| Error::malformed(self.path, at("`w`, `h`"), SIZES, found);
        match (stated.w, stated.h) {
            (Some(w), Some(h)) => return size(w, h, self.requested.is_some()).map(Some).map_err(wrong),
            (Some(w), None) => return Err(wrong(format!("`w` {w} without `h`"))),
            (None, Some(h)) => return Err(wrong(format!("`h` {h} without `w`"))),
            (None, None) => {}
        }
        if let Some([w, h]) = image_size(image).or(self.any_image) {
            if self.requested.is_none() {
                self.source = ResolutionSource::Image;
            }
            let size = size(w.into(), h.into(), self.requested.is_some());
            return size.map(Some).map_err(|found| Error::malformed(image, "image size", SIZES, found));
        }
        let Some(key) = stated.in_pixels() else { return Ok(None) };
        let expected = "`w` and `h`, the size of the image to which pixels refer, or the image itself";
        let found = format!("neither these nor {}", image.display());
        Err(Error::malformed(self.path, at(&format!("`{key}`")), expected, found))
    }

    fn frame(&mut self, i: usize, raw: RawFrame) -> Result<Frame> {
        let (path, name) = (self.path, raw.file_path.clone());
        let at = |what: &str| format!("frame {i} (`{name}`), {what}");
        let fault = |fault: Fault| Error::malformed(path, at(fault.place), fault.expected, fault.found);
        if let Some(found) = raw.lens.other_than_perspective(&self.file.lens) {
            let expected = format!("a perspective camera ({})", PERSPECTIVE.join(", "));
            return Err(Error::malformed(path, at("`camera_model`"), expected, found));
        }
        let stated = raw.intrinsics.over(&self.file.intrinsics).map_err(fault)?;
        let image = self.pictures.path(&raw.file_path);
        let size = self.size(&stated, &image, &at)?;
        // Angles alone hold for images of any size.
        let reference = size.or(self.requested).unwrap_or(ASSUMED);
        if self.requested.is_none() && size.is_none() {
            self.source = ResolutionSource::Assumed;
        }
        let (focal, center) = stated.project(reference).map_err(fault)?;
        if (focal[0] / focal[1]).ln().abs() > MAX_FOCAL_RATIO.ln() {
            self.stretched = self.stretched.or(Some((i, focal)));
        }
        let of_file = Intrinsics::default().over(&self.file.intrinsics).and_then(|file| file.project(reference));
        if of_file.is_ok_and(|(f, _)| (f[0] - focal[0]).abs() > 1e-3 * focal[0]) {
            self.contradiction = self.contradiction.or(Some(i));
        }
        let distortion = stated.distortion(raw.lens.names_model(&self.file.lens)).map_err(fault)?;
        let matrix = raw.transform_matrix_start.as_ref().or(raw.transform_matrix.as_ref());
        if raw.transform_matrix_end.as_ref().is_some_and(|end| matrix != Some(end)) {
            let expected = "a camera at rest, with one pose";
            return Err(Error::malformed(path, at("`transform_matrix_end`"), expected, "a second pose"));
        }
        let pose = matrix.ok_or_else(|| "none".to_string()).and_then(|matrix| rigid_pose(matrix));
        let (position, axes) = pose
            .map_err(|found| Error::malformed(path, at("`transform_matrix`"), "a 4x4 camera-to-world pose", found))?;
        let camera = Camera { position, axes, focal, center, resolution: reference, distortion };
        if let Some(found) = camera.folds_over() {
            return Err(Error::malformed(path, at("lens"), "a lens that leaves every pixel its ray", found));
        }
        self.has_no_rays_of_its_own(&image)?;
        let below = |key: &str, stated: Option<String>| match stated {
            Some(stated) if stated.trim().is_empty() => {
                Err(Error::malformed(path, at(&format!("`{key}`")), "the path of an image", "an empty one"))
            }
            stated => Ok(stated.map(|stated| self.folder.join(stated.replace('\\', "/")))),
        };
        let mask = below("mask_path", raw.mask_path.filter(|_| self.file.has_mask != Some(false)))?;
        Ok(Frame {
            camera: self.requested.map_or(camera, |requested| camera.resized(requested)),
            index: i,
            size: reference,
            mask: mask.map(MaskFile::Kept).or_else(|| MaskFile::beside(&image)),
            depth: below("depth_file_path", raw.depth_file_path)?,
            object: below("object_mask_path", raw.object_mask_path)?,
            ..Frame::new(camera, name, image)
        })
    }

    /// Refuses instant-ngp's files of rays, which replace those of the camera.
    fn has_no_rays_of_its_own(&self, image: &Path) -> Result<()> {
        let mut name = OsString::from("rays_");
        name.push(image.file_stem().unwrap_or_default());
        name.push(".dat");
        let rays = image.with_file_name(name);
        if self.file.enable_ray_loading == Some(false) || !rays.is_file() {
            return Ok(());
        }
        let expected = "images whose rays follow from their cameras";
        Err(Error::malformed(&rays, "rays of a frame", expected, "rays of its own (instant-ngp)"))
    }
}

/// Reads a transforms.json, with the pictures in a folder `chosen` beside it. See [`Views::read`].
pub(super) fn read(path: &Path, chosen: Option<&str>, requested: Option<[u32; 2]>) -> Result<Views> {
    let (mut file, origin) = parse(path)?;
    file.check(path)?;
    let mut raw = file.frames.take().unwrap_or_default();
    let listed = raw.len();
    raw.append(&mut file.test_frames);
    let folder = path.parent().unwrap_or(Path::new(""));
    let keys: BTreeSet<String> = raw.iter().flat_map(|frame| frame.unknown.keys().cloned()).collect();
    let mut notes = file.notes(&keys, &raw);
    let pictures = &Pictures::find(folder, chosen, matches!(origin, Origin::Splatting | Origin::Metashape(_)), &raw);
    if chosen.is_none() {
        notes.extend(pictures.instead.and_then(|instead| note_of_smaller(Path::new(instead))));
    }
    let any_image = raw.iter().find_map(|frame| image_size(&pictures.path(&frame.file_path)));
    let source = requested.map_or(ResolutionSource::File, |_| ResolutionSource::Requested);
    let mut reading = Reading {
        path,
        folder,
        pictures,
        requested,
        file: &file,
        any_image,
        source,
        contradiction: None,
        stretched: None,
    };
    let frames: Result<Vec<Frame>> = raw.into_iter().enumerate().map(|(i, raw)| reading.frame(i, raw)).collect();
    let mut frames = frames?;
    notes.extend(listed_twice(&frames));
    if file.has_mask != Some(false) {
        notes.extend(find_masks(folder, &mut frames));
    }
    if let Some(i) = reading.contradiction {
        notes.push(format!(
            "frame {i} states a focal length other than the file's; the frame's is used, as in instant-ngp \
             (nerfstudio uses the file's)"
        ));
    }
    if let Some((i, [fx, fy])) = reading.stretched {
        notes.push(format!(
            "frame {i} has focal lengths of {fx:.0} and {fy:.0} pixels, as of pixels that are not square"
        ));
    }
    let resolution_source = reading.source;
    let lists = Lists {
        training: file.train_filenames,
        held_out: file.test_filenames.or(file.val_filenames),
        first: file.n_frames,
        held_out_from: (frames.len() > listed).then_some(listed),
    };
    lists.apply(path, folder, &mut frames)?;
    match origin {
        Origin::Transforms => {}
        Origin::Metashape(note) => notes.extend(note),
        Origin::Splatting => notes.extend(inria::purposes(&mut frames)),
        Origin::Export => {
            let is_eval = path.file_name().is_some_and(|name| name.to_string_lossy().contains("eval"));
            let purpose = if is_eval { Purpose::HeldOut } else { Purpose::Training };
            frames.iter_mut().for_each(|frame| frame.purpose = Some(purpose));
        }
        Origin::CameraPath => frames.iter_mut().for_each(|frame| {
            (frame.purpose, frame.name) = (Some(Purpose::Planned), format!("camera path {}", frame.index));
        }),
    }
    Ok(Views { path: path.to_path_buf(), frames, resolution_source, notes })
}

/// The note that frames have the same image at the same pose. Its pixels count as often as it is listed, as they do in
/// training. A name alone is no sign: cameras of a rig count their pictures alike.
fn listed_twice(frames: &[Frame]) -> Option<String> {
    let mut last = HashMap::new();
    let pose = |Camera { position, axes, .. }: &Camera| {
        [*position, axes.x_axis, axes.y_axis].map(|v| (v / SAME_POSE).round().to_array().map(|x| x as i64))
    };
    let named = frames.iter().filter(|frame| !frame.name.is_empty());
    let mut again =
        named.filter_map(|frame| Some((last.insert((&frame.image, pose(&frame.camera)), frame.index)?, frame)));
    let (earlier, Frame { index, name, .. }) = again.next()?;
    let count = 1 + again.count();
    Some(format!(
        "frames {earlier} and {index} are the same image, `{name}`; an image counts as often as it is listed \
         ({count} repeated)"
    ))
}

/// What a transforms.json was made of.
enum Origin {
    Transforms,
    /// The cameras.json of Gaussian splatting.
    Splatting,
    /// Poses of `ns-export cameras`.
    Export,
    /// A camera path of nerfstudio's viewer.
    CameraPath,
    /// The cameras.xml of Metashape, with a note on cameras that it does not place.
    Metashape(Option<String>),
}

/// Other files as a transforms.json, as far as they hold cameras.
fn converted(path: &Path, value: &Value) -> Option<(Result<Value>, Origin)> {
    if let Some(cameras) = inria::cameras(value) {
        return Some((inria::as_transforms(path, cameras), Origin::Splatting));
    }
    match value {
        Value::Array(list) if list.first()?.get("file_path").and(list[0].get("transform")).is_some() => {
            Some((nerfstudio::exported(path, list), Origin::Export))
        }
        Value::Object(file) => nerfstudio::camera_path(path, file).map(|file| (file, Origin::CameraPath)),
        _ => None,
    }
}

/// Parses the JSON of a camera file with at least one frame. The message names other known kinds of files.
fn parse(path: &Path) -> Result<(RawFile, Origin)> {
    let bytes = octobayes::io::read(path)?;
    let other = |(kind, instead): (&str, &str)| {
        Error::malformed(path, "cameras", format!("a transforms.json or a COLMAP model; {instead}"), kind)
    };
    if let Some(kind) = other_kinds::bytes(&bytes) {
        return Err(other(kind));
    }
    let text = octobayes::io::text_of(path, bytes)?;
    if metashape::is_xml(&text) {
        let (file, note) = metashape::as_transforms(path, &text)?;
        let file = serde_json::from_value(file);
        let file = file.map_err(|e| Error::malformed(path, "cameras", "a cameras.xml of Metashape", e.to_string()))?;
        return Ok((file, Origin::Metashape(note)));
    }
    let parsed: std::result::Result<RawFile, _> = serde_json::from_str(&text);
    let parsed = match parsed {
        Ok(file) if file.frames.as_ref().is_some_and(|frames| !frames.is_empty()) => {
            return Ok((file, Origin::Transforms));
        }
        other => other,
    };
    if let Ok(value) = serde_json::from_str(&text) {
        if let Some((file, origin)) = converted(path, &value) {
            let expected = match origin {
                Origin::Splatting => "a cameras.json",
                _ => "poses with lenses",
            };
            let file = serde_json::from_value(file?);
            return file
                .map(|file| (file, origin))
                .map_err(|e| Error::malformed(path, "cameras", expected, e.to_string()));
        }
        if let Some(kind) = other_kinds::json(&value) {
            return Err(other(kind));
        }
    }
    if let Some(kind) = other_kinds::text(&text) {
        return Err(other(kind));
    }
    Err(match parsed {
        Ok(_) => Error::malformed(path, "`frames`", "at least one frame", "none"),
        Err(e) => {
            let place = format!("line {}, column {}", e.line(), e.column());
            Error::malformed(path, place, "a transforms.json", e.to_string())
        }
    })
}

#[cfg(test)]
mod tests;
