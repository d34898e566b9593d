//! The `cameras.json` that the original code of Gaussian splatting writes beside a model, as frames of a
//! transforms.json.
//!
//! `position` is the camera's centre and `rotation` its camera-to-world axes, row by row: x right, y down, z forward.
//! `width` and `height` are those of the original images, and focal lengths refer to them.

use std::path::Path;

use serde_json::{Map, Value, json};

use super::pose::rigid_pose;
use super::views::{Frame, Purpose};
use octobayes::geometry::Camera;
use octobayes::{Error, Result};

/// Keys that name a camera.
const KEYS: [&str; 3] = ["img_name", "rotation", "position"];
/// Largest difference of an axis's length from 1: programs store f32.
const UNIT: f64 = 1e-3;

/// The warning about a file whose order has no split.
const NOTE: &str = "a cameras.json does not mark which views were held out: a run with `--eval` lists them first";
/// Of the images in the order of their names, a run with `--eval` holds out one in this many, from the first on.
const HOLD_OUT: usize = 8;

/// Says what frames are for as far as their order does, and the rest in a note. A run lists its test views first, then
/// those for training, each by name. All of them were for training unless the order has a split.
pub(super) fn purposes(frames: &mut [Frame]) -> Option<String> {
    let mut sorted: Vec<&str> = frames.iter().map(|frame| frame.name.as_str()).collect();
    sorted.sort_unstable();
    let tests = sorted.len().div_ceil(HOLD_OUT);
    let first = sorted.iter().step_by(HOLD_OUT);
    let rest = sorted.iter().enumerate().filter(|(i, _)| i % HOLD_OUT != 0).map(|(_, name)| name);
    let listed = || frames.iter().map(|frame| frame.name.as_str());
    let (has_tests_first, is_sorted) = (first.chain(rest).copied().eq(listed()), listed().eq(sorted.iter().copied()));
    // With eight images or fewer both orders are the same.
    let held_out = if has_tests_first && !is_sorted { tests } else { 0 };
    for (i, frame) in frames.iter_mut().enumerate() {
        frame.purpose = Some(if i < held_out { Purpose::HeldOut } else { Purpose::Training });
    }
    match (held_out, is_sorted && frames.len() > HOLD_OUT) {
        (0, true) => None,
        (0, false) => Some(NOTE.into()),
        (n, _) => Some(format!(
            "the first {n} views are every eighth by name, as a run with `--eval` lists those that it holds out"
        )),
    }
}

/// The cameras of a file, if it is one of these.
pub(super) fn cameras(file: &Value) -> Option<&[Value]> {
    let Value::Array(cameras) = file else { return None };
    let Some(Value::Object(first)) = cameras.first() else { return None };
    KEYS.iter().all(|key| first.contains_key(*key)).then_some(cameras)
}

/// The same cameras as a transforms.json. Keys that are not of this format stay, to be read or named.
///
/// # Errors
/// If a camera lacks a key, if its pose is no rotation and centre, or if its size or focal length is not positive.
pub(super) fn as_transforms(path: &Path, cameras: &[Value]) -> Result<Value> {
    let frames: Result<Vec<Value>> = cameras.iter().enumerate().map(|(i, camera)| frame(path, i, camera)).collect();
    Ok(json!({ "frames": frames? }))
}

fn frame(path: &Path, i: usize, camera: &Value) -> Result<Value> {
    let Value::Object(camera) = camera else {
        return Err(Error::malformed(path, format!("camera {i}"), "an object", camera.to_string()));
    };
    let name = camera.get("img_name").and_then(Value::as_str).unwrap_or("?");
    let wrong = |key: &str, expected: &str, found: String| {
        Error::malformed(path, format!("camera {i} (`{name}`), `{key}`"), expected, found)
    };
    let of = |key: &str| camera.get(key).ok_or_else(|| wrong(key, "a value", "none".into()));
    let image = of("img_name")?;
    if !image.is_string() {
        return Err(wrong("img_name", "the name of an image", image.to_string()));
    }
    let mut frame: Map<String, Value> = camera.clone();
    frame.retain(|key, _| !KEYS.contains(&key.as_str()));
    frame.insert("file_path".into(), image.clone());
    frame.insert(
        "transform_matrix".into(),
        json!(pose(of("position")?, of("rotation")?).map_err(|(key, expected, found)| wrong(key, expected, found))?),
    );
    for (key, new) in [("width", "w"), ("height", "h"), ("fx", "fl_x"), ("fy", "fl_y")] {
        let value = of(key)?;
        if !value.as_f64().is_some_and(|v| v > 0.0) {
            return Err(wrong(key, "a positive number of pixels", value.to_string()));
        }
        frame.remove(key);
        frame.insert(new.into(), value.clone());
    }
    Ok(Value::Object(frame))
}

/// Camera-to-world with axes right, up, back; or the key that is wrong, what it should be, and what it is.
fn pose(
    position: &Value,
    rotation: &Value,
) -> std::result::Result<Vec<Vec<f64>>, (&'static str, &'static str, String)> {
    let numbers = |list: &Value, count: usize| -> Option<Vec<f64>> {
        let numbers: Option<Vec<f64>> = list.as_array()?.iter().map(Value::as_f64).collect();
        numbers.filter(|numbers| numbers.len() == count)
    };
    let Some(centre) = numbers(position, 3) else {
        return Err(("position", "three numbers, the camera's centre", position.to_string()));
    };
    let rows: Option<Vec<Vec<f64>>> =
        rotation.as_array().and_then(|rows| rows.iter().map(|row| numbers(row, 3)).collect());
    let Some(rows) = rows.filter(|rows| rows.len() == 3) else {
        return Err(("rotation", "3 rows of 3 numbers", rotation.to_string()));
    };
    // The columns are right, down and forward.
    let mut matrix: Vec<Vec<f64>> = rows.iter().zip(centre).map(|(row, x)| vec![row[0], -row[1], -row[2], x]).collect();
    matrix.push(vec![0.0, 0.0, 0.0, 1.0]);
    let expected = "camera-to-world axes of length 1";
    rigid_pose(&matrix).map_err(|found| ("rotation", expected, found))?;
    let length = rows.iter().map(|row| row[0] * row[0]).sum::<f64>().sqrt();
    if (length - 1.0).abs() > UNIT {
        return Err(("rotation", expected, format!("a first axis of length {length}")));
    }
    Ok(matrix)
}

/// A file of cameras, each with the name of its image, as the original code writes it; cx and cy, which it does not
/// know, stand beside what it reads.
#[must_use]
pub fn inria_text(cameras: &[(String, Camera)]) -> String {
    let entry = |(i, (name, camera)): (usize, &(String, Camera))| {
        let [right, down, forward] = [camera.axes.x_axis, -camera.axes.y_axis, -camera.axes.z_axis];
        let row = |k: usize| [right[k], down[k], forward[k]];
        json!({
            "id": i, "img_name": name, "width": camera.resolution[0], "height": camera.resolution[1],
            "position": camera.position.to_array(), "rotation": [row(0), row(1), row(2)],
            "fx": camera.focal[0], "fy": camera.focal[1], "cx": camera.center[0], "cy": camera.center[1],
        })
    };
    Value::Array(cameras.iter().enumerate().map(entry).collect()).to_string()
}

#[cfg(test)]
mod tests {
    use glam::{DMat3, DVec3};

    use super::super::Views;
    use super::super::views::ResolutionSource;
    use super::*;

    const CAMERA: &str = r#"{"id": 0, "img_name": "a", "width": 40, "height": 30, "position": [1, 2, 3],
        "rotation": [[1, 0, 0], [0, 0, 1], [0, -1, 0]], "fx": 50, "fy": 51}"#;

    fn read(json: &str) -> Result<Views> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cameras.json");
        std::fs::write(&path, json).unwrap();
        Views::read(&path, None)
    }

    #[test]
    fn cameras_that_are_written_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cameras.json");
        let mut camera = Camera::look_at(DVec3::new(3.0, -1.0, 2.0), DVec3::X, DVec3::Z, 0.7, [40, 30]);
        camera.center = [19.0, 16.5];
        std::fs::write(&path, inria_text(&[("a/r_0".into(), camera), ("b".into(), camera)])).unwrap();
        let frames = Views::read(&path, None).unwrap().frames;
        assert_eq!((frames.len(), frames[0].name.as_str()), (2, "a/r_0"));
        assert!(frames[1].camera.is_like(&camera, 1.0), "{:?}", frames[1].camera);
        assert_eq!(frames[1].camera.center, camera.center);
    }

    #[test]
    fn cameras_look_along_their_third_axis() {
        let views = read(&format!("[{CAMERA}]")).unwrap();
        let frame = &views.frames[0];
        assert_eq!((frame.name.as_str(), frame.index, views.resolution_source), ("a", 0, ResolutionSource::File));
        let camera = frame.camera;
        assert_eq!((camera.focal, camera.center, camera.resolution), ([50.0, 51.0], [20.0, 15.0], [40, 30]));
        assert_eq!(camera.position, DVec3::new(1.0, 2.0, 3.0));
        // Right is x, down is −z, forward is y.
        assert_eq!(camera.axes, DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y));
        let ray = camera.ray(20.0, 15.0);
        assert_eq!(ray.direction, DVec3::Y);
        assert!(camera.ray(20.0, 20.0).direction.z < 0.0, "lower in the image is lower in the scene");
        assert_eq!(views.notes, [NOTE]);
    }

    /// Which frames are held out of those with these names, and whether a note doubts it.
    fn held_out(names: &[String]) -> (Vec<String>, bool) {
        let cameras: Vec<String> = names.iter().map(|n| CAMERA.replace("\"a\"", &format!("\"{n}\""))).collect();
        let views = read(&format!("[{}]", cameras.join(", "))).unwrap();
        let is_test = |frame: &&Frame| frame.purpose == Some(Purpose::HeldOut);
        (views.frames.iter().filter(is_test).map(|f| f.name.clone()).collect(), views.notes == [NOTE])
    }

    #[test]
    fn a_run_with_eval_is_known_by_the_order_of_its_views() {
        let sorted: Vec<String> = (0..18).map(|i| format!("{i:04}")).collect();
        let is_test = |name: &&String| ["0000", "0008", "0016"].contains(&name.as_str());
        let (tests, others): (Vec<_>, Vec<_>) = sorted.iter().partition(is_test);
        let of_run: Vec<String> = tests.iter().chain(&others).map(ToString::to_string).collect();
        assert_eq!(held_out(&of_run), (vec!["0000".into(), "0008".into(), "0016".into()], false));
        assert_eq!(held_out(&sorted), (vec![], false), "without --eval all are listed by name");
        let backwards: Vec<String> = sorted.iter().rev().cloned().collect();
        assert_eq!(held_out(&backwards), (vec![], true), "of another program");
        assert_eq!(held_out(&sorted[..8]), (vec![], true), "both runs would list these so");
    }

    /// The original code writes names without folders, so that the cameras of a rig have the same ones.
    #[test]
    fn repeats_have_names_and_poses_in_common() {
        let moved = CAMERA.replace("[1, 2, 3]", "[1, 2, 3.5]");
        let repeated = |list: &str| read(list).unwrap().notes.iter().any(|note| note.contains("the same image"));
        assert!(!repeated(&format!("[{CAMERA}, {moved}]")));
        assert!(repeated(&format!("[{CAMERA}, {moved}, {CAMERA}]")));
        assert!(!repeated(&format!("[{CAMERA}, {}]", CAMERA.replace("\"a\"", "\"b\""))));
    }

    #[test]
    fn pictures_are_found_beside_the_file_or_in_images() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cameras.json");
        std::fs::write(&path, format!("[{CAMERA}]")).unwrap();
        for (picture, size) in [("images_2/a.png", [20, 15]), ("images/a.jpg", [39, 29]), ("a.png", [10, 8])] {
            let picture = folder.path().join(picture);
            std::fs::create_dir_all(picture.parent().unwrap()).unwrap();
            image::GrayImage::new(size[0], size[1]).save(&picture).unwrap();
            let frame = Views::read(&path, None).unwrap().frames.remove(0);
            assert_eq!((&frame.image, frame.camera.resolution), (&picture, size));
            assert!((frame.camera.focal[1] - 51.0 * f64::from(size[1]) / 30.0).abs() < 1e-12);
        }
    }

    #[test]
    fn keys_of_other_programs_are_read_or_named() {
        let more =
            CAMERA.replace("\"a\"", "\"b\"").replace("\"fx\"", "\"cx\": 21, \"cy\": 14, \"depth_params\": 3, \"fx\"");
        let views = read(&format!("[{CAMERA}, {more}]")).unwrap();
        assert_eq!(views.frames[1].camera.center, [21.0, 14.0]);
        assert_eq!(views.notes, ["keys that are not read: `depth_params` (of frames)", NOTE]);
    }

    #[test]
    fn what_is_no_camera_is_refused_by_its_key() {
        for (from, to, expected) in [
            ("\"fx\": 50", "\"fx\": 0", "`fx`: expected a positive number of pixels, found 0"),
            ("\"height\": 30, ", "", "`height`: expected a value, found none"),
            ("\"a\"", "7", "camera 1 (`?`), `img_name`: expected the name of an image, found 7"),
            ("[1, 2, 3]", "[1, 2]", "`position`: expected three numbers, the camera's centre, found [1,2]"),
            ("[0, 0, 1], ", "", "`rotation`: expected 3 rows of 3 numbers, found [[1,0,0],[0,-1,0]]"),
            ("[1, 0, 0]", "[-1, 0, 0]", "`rotation`: expected camera-to-world axes of length 1, found a singular or"),
            (
                "[[1, 0, 0], [0, 0, 1], [0, -1, 0]]",
                "[[2, 0, 0], [0, 0, 2], [0, -2, 0]]",
                "`rotation`: expected camera-to-world axes of length 1, found a first axis of length 2",
            ),
            (CAMERA, "3", "camera 1: expected an object, found 3"),
        ] {
            let error = read(&format!("[{CAMERA}, {}]", CAMERA.replacen(from, to, 1))).unwrap_err().to_string();
            assert!(error.contains("cameras.json: camera 1") && error.contains(expected), "{to}: {error}");
        }
    }
}
