//! Camera files: transforms.json of the original NeRF, instant-ngp and nerfstudio.
//!
//! Intrinsics stand at top level or per frame: `fl_x fl_y cx cy w h` in pixels, or `camera_angle_x`
//! (`camera_angle_y`) in radians. `k1 k2 p1 p2` are OpenCV's lens distortion, applied for any perspective
//! `camera_model`. Fisheye lenses and panoramas are an error. `transform_matrix` is camera-to-world with OpenGL
//! axes (x right, y up, looking along −z).

use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};
use serde::Deserialize;
use serde::de::IgnoredAny;

use super::colmap::ModelFiles;
use crate::geometry::{Camera, Distortion, MAX_PIXELS, MAX_REACH, MAX_SIDE, MAX_SKEW, skew};
use crate::{Error, Result};

/// A camera with its image.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Pose and intrinsics.
    pub camera: Camera,
    /// `file_path` as written; used in messages and for the names of depth maps.
    pub name: String,
    /// Path of the image, with `.png` added unless it ends in a known extension; the image need not exist.
    pub image: PathBuf,
    /// The depth map that the camera file names for this frame (`depth_file_path`).
    pub depth: Option<PathBuf>,
    /// The mask that the camera file names for this frame (`mask_path`): black pixels were not trained on.
    pub mask: Option<PathBuf>,
}

impl Frame {
    /// A camera and its image, without depth map or mask.
    #[must_use]
    pub fn new(camera: Camera, name: impl Into<String>, image: impl Into<PathBuf>) -> Self {
        Self { camera, name: name.into(), image: image.into(), depth: None, mask: None }
    }
}

/// Origin of the image size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ResolutionSource {
    /// `w` and `h` in the file.
    File,
    /// The size of the first image found.
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
}

#[derive(Debug, Clone, Copy, Default, Deserialize)]
pub(super) struct Intrinsics {
    pub(super) camera_angle_x: Option<f64>,
    pub(super) camera_angle_y: Option<f64>,
    pub(super) fl_x: Option<f64>,
    pub(super) fl_y: Option<f64>,
    pub(super) cx: Option<f64>,
    pub(super) cy: Option<f64>,
    pub(super) w: Option<f64>,
    pub(super) h: Option<f64>,
    pub(super) k1: Option<f64>,
    pub(super) k2: Option<f64>,
    pub(super) k3: Option<f64>,
    pub(super) k4: Option<f64>,
    pub(super) p1: Option<f64>,
    pub(super) p2: Option<f64>,
    pub(super) is_fisheye: Option<bool>,
}

/// What a file says about the kind of lens.
#[derive(Debug, Default, Deserialize)]
struct LensKind {
    camera_model: Option<String>,
    /// instant-ngp's f-theta lens; the presence of the key is enough.
    ftheta_p0: Option<IgnoredAny>,
    /// instant-ngp's panorama, likewise.
    latlong: Option<IgnoredAny>,
}

/// Names of perspective cameras in COLMAP and nerfstudio. All are [`Distortion`] with some coefficients zero.
const PERSPECTIVE: [&str; 5] = ["PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "RADIAL", "SIMPLE_RADIAL"];

impl LensKind {
    /// Names the lens if it is not perspective. What the frame says takes precedence over the file.
    fn other_than_perspective(&self, file: &Self) -> Option<String> {
        let model = self.camera_model.as_ref().or(file.camera_model.as_ref());
        let other = model.filter(|name| !PERSPECTIVE.iter().any(|known| known.eq_ignore_ascii_case(name)));
        let keys = [("ftheta_p0", self.ftheta_p0.or(file.ftheta_p0)), ("latlong", self.latlong.or(file.latlong))];
        let key = keys.into_iter().find_map(|(key, there)| there.map(|_| format!("`{key}`")));
        other.map(|name| format!("`{name}`")).or(key)
    }
}

#[derive(Debug, Deserialize)]
struct RawFrame {
    #[serde(default)]
    file_path: String,
    transform_matrix: Option<Vec<Vec<f64>>>,
    #[serde(flatten)]
    intrinsics: Intrinsics,
    #[serde(flatten)]
    lens: LensKind,
}

#[derive(Debug, Deserialize)]
struct RawFile {
    frames: Option<Vec<RawFrame>>,
    #[serde(flatten)]
    intrinsics: Intrinsics,
    #[serde(flatten)]
    lens: LensKind,
}

/// Image size if nothing states it.
const ASSUMED: [u32; 2] = [400, 400];
/// [`MAX_SIDE`] and [`MAX_PIXELS`] in words.
pub(super) const SIZES: &str = "whole numbers from 1 to 65536, at most 1e8 pixels";

/// Checks an image size for a camera; the error is the size in words.
fn size(w: f64, h: f64) -> std::result::Result<[u32; 2], String> {
    let side = |v: f64| (1.0..=MAX_SIDE).contains(&v) && v.fract() == 0.0;
    if side(w) && side(h) && w * h <= MAX_PIXELS { Ok([w as u32, h as u32]) } else { Err(format!("{w} x {h}")) }
}

impl Intrinsics {
    /// The frame's own values where it has them, else those of the file.
    fn over(self, file: Self) -> Self {
        Self {
            camera_angle_x: self.camera_angle_x.or(file.camera_angle_x),
            camera_angle_y: self.camera_angle_y.or(file.camera_angle_y),
            fl_x: self.fl_x.or(file.fl_x),
            fl_y: self.fl_y.or(file.fl_y),
            cx: self.cx.or(file.cx),
            cy: self.cy.or(file.cy),
            w: self.w.or(file.w),
            h: self.h.or(file.h),
            k1: self.k1.or(file.k1),
            k2: self.k2.or(file.k2),
            k3: self.k3.or(file.k3),
            k4: self.k4.or(file.k4),
            p1: self.p1.or(file.p1),
            p2: self.p2.or(file.p2),
            is_fisheye: self.is_fisheye.or(file.is_fisheye),
        }
    }

    /// w and h as an image size; `None` if absent.
    pub(super) fn resolution(&self) -> Option<std::result::Result<[u32; 2], String>> {
        let (w, h) = (self.w?, self.h?);
        Some(size(w, h))
    }

    /// The lens distortion; the error says what is wrong with it.
    pub(super) fn distortion(&self) -> std::result::Result<Distortion, String> {
        let value = |v: Option<f64>| v.unwrap_or(0.0);
        let distortion = Distortion { k: [self.k1, self.k2].map(value), p: [self.p1, self.p2].map(value) };
        if self.is_fisheye == Some(true) {
            Err("a fisheye lens".into())
        } else if [self.k3, self.k4].map(value) != [0.0; 2] {
            Err(format!("k3 {}, k4 {}", value(self.k3), value(self.k4)))
        } else if distortion.k.iter().chain(&distortion.p).all(|c| c.is_finite()) {
            Ok(distortion)
        } else {
            Err(format!("{distortion:?}"))
        }
    }

    /// Focal lengths and principal point in pixels, for an image of `resolution` pixels.
    ///
    /// `fl_x` refers to the `w` × `h` that the file states and is scaled to images of another size.
    pub(super) fn project(&self, resolution: [u32; 2]) -> std::result::Result<([f64; 2], [f64; 2]), String> {
        let [w, h] = resolution.map(f64::from);
        let scale = [self.w.map_or(1.0, |stated| w / stated), self.h.map_or(1.0, |stated| h / stated)];
        // An angle in degrees, 40 say, would also give a positive tangent.
        for (name, angle) in [("camera_angle_x", self.camera_angle_x), ("camera_angle_y", self.camera_angle_y)] {
            if let Some(angle) = angle.filter(|angle| !(*angle > 0.0 && *angle < std::f64::consts::PI)) {
                return Err(format!("`{name}` {angle}"));
            }
        }
        let from_angle = |angle: f64, side: f64| 0.5 * side / (0.5 * angle).tan();
        let fx = match (self.fl_x, self.camera_angle_x) {
            (Some(f), _) => f * scale[0],
            (None, Some(angle)) => from_angle(angle, w),
            (None, None) => return Err("neither".into()),
        };
        let fy = match (self.fl_y, self.camera_angle_y, self.fl_x) {
            (Some(f), _, _) => f * scale[1],
            (None, Some(angle), None) => from_angle(angle, h),
            // Square pixels.
            _ => fx * scale[1] / scale[0],
        };
        let center = [self.cx.map_or(0.5 * w, |c| c * scale[0]), self.cy.map_or(0.5 * h, |c| c * scale[1])];
        // Corners of the image on the plane at depth 1.
        let reach = [0, 1].map(|k| center[k].abs().max((f64::from(resolution[k]) - center[k]).abs()) / [fx, fy][k]);
        if [fx, fy].iter().all(|f| *f > 0.0 && f.is_finite()) && reach.iter().all(|r| *r < MAX_REACH) {
            Ok(([fx, fy], center))
        } else {
            Err(format!("focal lengths {fx}, {fy}, principal point {center:?}"))
        }
    }
}

impl Views {
    /// Reads a camera file: a transforms.json, or a sparse model of COLMAP (one of its files, or its folder).
    ///
    /// The image size is the `requested` one, else `w` and `h` of the file, else that of the first image that
    /// exists, else 400 × 400.
    ///
    /// # Errors
    /// If the file is missing or is not JSON, has no frames or no focal length, or if a matrix is not a finite
    /// rigid pose (a uniform scale is removed).
    pub fn read(path: &Path, requested: Option<[u32; 2]>) -> Result<Self> {
        if let Some(model) = ModelFiles::find(path) {
            return model.read(path, requested);
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
        let text = crate::io::read_text(path)?;
        let file: RawFile = serde_json::from_str(&text).map_err(|e| {
            Error::malformed(
                path,
                format!("line {}, column {}", e.line(), e.column()),
                "a transforms.json",
                e.to_string(),
            )
        })?;
        let raw = file.frames.unwrap_or_default();
        if raw.is_empty() {
            return Err(Error::malformed(path, "`frames`", "at least one frame", "none"));
        }
        let folder = path.parent().unwrap_or(Path::new(""));
        let images: Vec<PathBuf> = raw.iter().map(|frame| image_path(folder, &frame.file_path)).collect();
        let from_image = || images.iter().find_map(|image| Some((image, image::image_dimensions(image).ok()?)));
        let mut fallback = None;

        let mut frames = Vec::with_capacity(raw.len());
        let mut source = ResolutionSource::File;
        for (i, (raw, image)) in raw.into_iter().zip(images.iter()).enumerate() {
            let place = |what: &str| format!("frame {i} (`{}`), {what}", raw.file_path);
            if let Some(found) = raw.lens.other_than_perspective(&file.lens) {
                let expected = format!("a perspective camera ({})", PERSPECTIVE.join(", "));
                return Err(Error::malformed(path, place("`camera_model`"), expected, found));
            }
            let intrinsics = raw.intrinsics.over(file.intrinsics);
            let resolution = match (requested, intrinsics.resolution()) {
                (Some(resolution), _) => {
                    source = ResolutionSource::Requested;
                    resolution
                }
                (None, Some(resolution)) => {
                    resolution.map_err(|found| Error::malformed(path, place("`w`, `h`"), SIZES, found))?
                }
                (None, None) => {
                    let (resolution, from) = match fallback {
                        Some(known) => known,
                        None => match from_image() {
                            Some((image, (w, h))) => {
                                let resolution = size(w.into(), h.into())
                                    .map_err(|found| Error::malformed(image, "image size", SIZES, found))?;
                                (resolution, ResolutionSource::Image)
                            }
                            None => (ASSUMED, ResolutionSource::Assumed),
                        },
                    };
                    fallback = Some((resolution, from));
                    source = from;
                    resolution
                }
            };
            let (focal, center) = intrinsics.project(resolution).map_err(|found| {
                Error::malformed(
                    path,
                    place("intrinsics"),
                    "positive `fl_x` (pixels) or `camera_angle_x` (radians, below pi)",
                    found,
                )
            })?;
            let pose = raw.transform_matrix.as_deref().ok_or_else(|| "none".to_string()).and_then(rigid_pose);
            let (position, axes) = pose.map_err(|found| {
                Error::malformed(path, place("`transform_matrix`"), "a 4x4 camera-to-world pose", found)
            })?;
            let distortion = intrinsics.distortion().map_err(|found| {
                Error::malformed(path, place("lens"), "a perspective lens with OpenCV's k1, k2, p1, p2", found)
            })?;
            let camera = Camera { position, axes, focal, center, resolution, distortion };
            frames.push(Frame::new(camera, raw.file_path, image));
        }
        Ok(Self { path: path.to_path_buf(), frames, resolution_source: source })
    }

    /// The files that hold the cameras of `path`: itself, or those of the COLMAP model that it means.
    #[must_use]
    pub fn files(path: &Path) -> Vec<PathBuf> {
        ModelFiles::find(path).map_or_else(|| vec![path.to_path_buf()], |model| vec![model.cameras, model.images])
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

/// The image of a frame named `file_path` in a camera file of `folder`: `.png` is added unless the name ends in a known
/// extension.
#[must_use]
pub fn image_path(folder: &Path, file_path: &str) -> PathBuf {
    let path = folder.join(file_path);
    let known = path
        .extension()
        .and_then(|e| e.to_str())
        .is_some_and(|e| ["png", "jpg", "jpeg"].contains(&e.to_ascii_lowercase().as_str()));
    if known { path } else { PathBuf::from(format!("{}.png", path.display())) }
}

/// Position and rotation of a camera-to-world matrix of 3 or 4 rows, from which a uniform scale is removed; the error
/// says what is wrong with it.
///
/// # Errors
/// If the matrix is not a finite rigid pose times a positive scale.
pub fn rigid_pose(matrix: &[Vec<f64>]) -> std::result::Result<(DVec3, DMat3), String> {
    if !(3..=4).contains(&matrix.len()) || matrix.iter().any(|row| row.len() != 4) {
        return Err(format!("rows of {:?} numbers", matrix.iter().map(Vec::len).collect::<Vec<_>>()));
    }
    let column = |k: usize| DVec3::new(matrix[0][k], matrix[1][k], matrix[2][k]);
    let (linear, position) = (DMat3::from_cols(column(0), column(1), column(2)), column(3));
    if !linear.is_finite() || !position.is_finite() {
        return Err("numbers that are not finite".into());
    }
    // A transposed matrix also has a rotation, but its position stands here.
    let homogeneous = |row: &[f64]| row.iter().zip([0.0, 0.0, 0.0, 1.0]).all(|(a, b)| (a - b).abs() < 1e-6);
    if let Some(last) = matrix.get(3).filter(|row| !homogeneous(row)) {
        return Err(format!("a last row of {last:?} instead of [0, 0, 0, 1]"));
    }
    let determinant = linear.determinant();
    let scale = determinant.cbrt();
    if scale <= 1e-12 {
        return Err(format!("a singular or mirrored matrix (determinant {determinant:e})"));
    }
    let axes = DMat3::from_cols(linear.x_axis / scale, linear.y_axis / scale, linear.z_axis / scale);
    let largest = skew(axes);
    if largest > MAX_SKEW {
        return Err(format!("a matrix that is no rotation (off by {largest:.3})"));
    }
    Ok((position, axes))
}

/// Writes cameras, each with the `file_path` of its frame, as a transforms.json for [`Views::read`] and other tools.
///
/// # Errors
/// If the file cannot be written.
pub fn write_transforms(path: &Path, cameras: &[(String, Camera)]) -> Result<()> {
    let frames: Vec<_> = cameras
        .iter()
        .map(|(name, camera)| {
            let [x, y, z] = [camera.axes.x_axis, camera.axes.y_axis, camera.axes.z_axis];
            let row = |k: usize| [x[k], y[k], z[k], camera.position[k]];
            serde_json::json!({
                "file_path": name,
                "fl_x": camera.focal[0], "fl_y": camera.focal[1], "cx": camera.center[0], "cy": camera.center[1],
                "w": camera.resolution[0], "h": camera.resolution[1],
                "k1": camera.distortion.k[0], "k2": camera.distortion.k[1],
                "p1": camera.distortion.p[0], "p2": camera.distortion.p[1],
                "transform_matrix": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
            })
        })
        .collect();
    let mut file = crate::io::AtomicFile::create(path)?;
    serde_json::to_writer_pretty(&mut file, &serde_json::json!({ "frames": frames }))
        .map_err(|e| Error::io(path, "cannot write")(e.into()))?;
    file.commit()
}

#[cfg(test)]
mod tests;
