//! The keys of a transforms.json: those that are read, those that are refused, and those that change no ray.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde::Deserialize;
use serde::de::IgnoredAny;

use crate::NGP_SCALE;
use crate::intrinsics::Intrinsics;
use octobayes::{Error, Result};

/// Keys that make a lens other than perspective, or move it during the exposure, by their presence.
#[derive(Debug, Default, Deserialize)]
pub struct LensKind {
    camera_model: Option<String>,
    is_fisheye: Option<bool>,
    ftheta_p0: Option<IgnoredAny>,
    latlong: Option<IgnoredAny>,
    equirectangular: Option<IgnoredAny>,
    orthographic: Option<IgnoredAny>,
    rolling_shutter: Option<Vec<f64>>,
}

/// Names of perspective cameras in COLMAP and nerfstudio. All are [`Distortion`](octobayes::geometry::Distortion) with
/// some coefficients zero.
pub const PERSPECTIVE: [&str; 5] = ["PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "RADIAL", "SIMPLE_RADIAL"];

impl LensKind {
    /// Whether the frame or the file names a camera model.
    pub fn names_model(&self, file: &Self) -> bool {
        self.camera_model.is_some() || file.camera_model.is_some()
    }

    /// Names what makes the lens other than perspective. The frame's keys take precedence over the file's.
    pub fn other_than_perspective(&self, file: &Self) -> Option<String> {
        let model = self.camera_model.as_ref().or(file.camera_model.as_ref());
        let other = model.filter(|name| !PERSPECTIVE.iter().any(|known| known.eq_ignore_ascii_case(name)));
        let moves = self.rolling_shutter.as_ref().or(file.rolling_shutter.as_ref());
        let keys = [
            ("is_fisheye", self.is_fisheye.or(file.is_fisheye) == Some(true)),
            ("ftheta_p0", self.ftheta_p0.or(file.ftheta_p0).is_some()),
            ("latlong", self.latlong.or(file.latlong).is_some()),
            ("equirectangular", self.equirectangular.or(file.equirectangular).is_some()),
            ("orthographic", self.orthographic.or(file.orthographic).is_some()),
            ("rolling_shutter", moves.is_some_and(|times| times.iter().any(|time| *time != 0.0))),
        ];
        let key = keys.into_iter().find_map(|(key, there)| there.then(|| format!("`{key}`")));
        other.map(|name| format!("`{name}`")).or(key)
    }
}

/// Keys of a frame that change no ray, for the note of unknown keys.
const HARMLESS_IN_FRAMES: [&str; 15] = [
    "sharpness",
    "colmap_im_id",
    "rotation",
    "depth_path",
    "timestamp",
    "is_bad",
    "driver_parameters",
    "id",
    "blur_score",
    "fovx",
    "fovy",
    "original_fn",
    "semantics_path",
    "normal_file_path",
    "image_id",
]; // fmt: skip
/// instant-ngp's usual `offset`, the middle of its cube.
const NGP_OFFSET: f64 = 0.5;
/// Keys of a file that change no ray.
const HARMLESS_IN_FILES: [&str; 22] = [
    "aabb_scale",
    "aabb",
    "render_aabb",
    "up",
    "envmap",
    "sharpen",
    "importance_sampling",
    "fix_premult",
    "white_transparent",
    "black_transparent",
    "n_extra_learnable_dims",
    "enable_depth_loading",
    "integer_depth_scale",
    "orientation_override",
    "applied_transform",
    "applied_scale",
    "ply_file_path",
    "fisheye_crop_radius",
    "camera_label",
    "id",
    "version",
    "frame_rate",
]; // fmt: skip

#[derive(Debug, Deserialize)]
#[serde(expecting = "a frame, as an object with `transform_matrix`")]
pub struct RawFrame {
    #[serde(default)]
    pub file_path: String,
    pub transform_matrix: Option<Vec<Vec<f64>>>,
    pub transform_matrix_start: Option<Vec<Vec<f64>>>,
    pub transform_matrix_end: Option<Vec<Vec<f64>>>,
    pub mask_path: Option<String>,
    pub depth_file_path: Option<String>,
    pub object_mask_path: Option<String>,
    pub time: Option<f64>,
    #[serde(flatten)]
    pub intrinsics: Intrinsics,
    #[serde(flatten)]
    pub lens: LensKind,
    #[serde(flatten)]
    pub unknown: BTreeMap<String, IgnoredAny>,
}

#[derive(Debug, Deserialize)]
#[serde(expecting = "a transforms.json, as an object with a list `frames`")]
pub struct RawFile {
    pub frames: Option<Vec<RawFrame>>,
    /// ScanNet++: frames that were held out.
    #[serde(default)]
    pub test_frames: Vec<RawFrame>,
    pub train_filenames: Option<Vec<String>>,
    pub val_filenames: Option<Vec<String>>,
    pub test_filenames: Option<Vec<String>>,
    pub n_frames: Option<usize>,
    pub sharpness_discard_threshold: Option<f64>,
    pub has_mask: Option<bool>,
    pub enable_ray_loading: Option<bool>,
    /// Axes other than OpenGL's.
    pub from_na: Option<serde_json::Value>,
    pub from_mitsuba: Option<serde_json::Value>,
    pub normal_mts_args: Option<IgnoredAny>,
    pub scale: Option<serde_json::Value>,
    pub offset: Option<serde_json::Value>,
    #[serde(flatten)]
    pub intrinsics: Intrinsics,
    #[serde(flatten)]
    pub lens: LensKind,
    #[serde(flatten)]
    pub unknown: BTreeMap<String, IgnoredAny>,
}

impl RawFile {
    /// Refuses what changes rays or frames and is not applied.
    pub fn check(&self, path: &Path) -> Result<()> {
        let refused = |key: &str, expected: &str, found: String| Err(Error::malformed(path, key, expected, found));
        let is_set = |value: &Option<serde_json::Value>| {
            value.as_ref().is_some_and(|value| *value != serde_json::Value::Bool(false) && !value.is_null())
        };
        let axes = "camera-to-world poses with OpenGL axes";
        if is_set(&self.from_na) {
            return refused("`from_na`", axes, "poses with the axes of NeuS2".into());
        }
        if is_set(&self.from_mitsuba) || self.normal_mts_args.is_some() {
            return refused("`from_mitsuba`", axes, "poses with the axes of Mitsuba".into());
        }
        match self.sharpness_discard_threshold {
            Some(threshold) if threshold > 0.0 => refused(
                "`sharpness_discard_threshold`",
                "no frames that instant-ngp drops for their blur; list those it keeps in `train_filenames`",
                threshold.to_string(),
            ),
            _ => Ok(()),
        }
    }

    /// Sentences about keys that are not read (`keys` are the unknown ones of frames), and about scenes that move.
    pub fn notes(&self, keys: &BTreeSet<String>, frames: &[RawFrame]) -> Vec<String> {
        let mut notes = Vec::new();
        let unknown = |keys: &mut dyn Iterator<Item = &String>, harmless: &[&str]| {
            let keys: Vec<String> =
                keys.filter(|key| !harmless.contains(&key.as_str())).map(|key| format!("`{key}`")).collect();
            keys.join(", ")
        };
        let of_file = unknown(&mut self.unknown.keys(), &HARMLESS_IN_FILES);
        let of_frames = unknown(&mut keys.iter(), &HARMLESS_IN_FRAMES);
        let parts = [(of_file, ""), (of_frames, " (of frames)")];
        let named: Vec<String> =
            parts.into_iter().filter(|(keys, _)| !keys.is_empty()).map(|(keys, of)| keys + of).collect();
        if !named.is_empty() {
            notes.push(format!("keys that are not read: {}", named.join(", ")));
        }
        let is_other = |value: &Option<serde_json::Value>, usual: f64| {
            value.as_ref().is_some_and(|value| *value != usual && *value != serde_json::Value::from(vec![usual; 3]))
        };
        if is_other(&self.scale, NGP_SCALE) || is_other(&self.offset, NGP_OFFSET) {
            notes.push(format!(
                "`scale` and `offset` are not instant-ngp's {NGP_SCALE} and {NGP_OFFSET}, but Plenoptic PNGs are read \
                 with these"
            ));
        }
        if frames.iter().any(|frame| frame.time != frames[0].time) {
            notes.push("frames differ in `time`; the scene is taken to stand still".into());
        }
        notes
    }
}
