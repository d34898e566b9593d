//! What nerfstudio writes beside its transforms.json: poses of `ns-export cameras`, camera paths of its viewer, and
//! the frame of a run.
//!
//! nerfstudio turns, moves and scales the poses of a data set before it trains. Splats that `ns-export` writes lie in
//! that frame, as do exported poses and camera paths. A run's dataparser_transforms.json has the similarity.

use std::collections::HashMap;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use glam::{DMat3, DQuat, DVec3};
use serde::Deserialize;
use serde_json::{Map, Value, json};

use super::colmap::ModelFiles;
use super::pose::rigid_pose;
use super::views::Views;
use super::world::Similarity;
use octobayes::geometry::Camera;
use octobayes::{Error, Result};

/// How the name of a file with a run's similarity ends.
const FRAME_OF_RUN: &str = "dataparser_transforms.json";
/// What goes with it.
const DATA_SET: &str = "the data set's transforms.json or COLMAP model beside it, or where config.yml beside it points";
/// The transform of `ns-process-data` from COLMAP's axes, before it wrote it as `applied_transform`.
const FROM_COLMAP: [[f64; 4]; 3] = [[0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0]];
/// Keys of a transforms.json that name its frames.
const LISTS: [&str; 5] = ["train_filenames", "val_filenames", "test_filenames", "test_frames", "n_frames"];

/// Whether a file has the name of a run's similarity.
pub(super) fn is_frame_of_run(path: &Path) -> bool {
    path.file_name().and_then(OsStr::to_str).is_some_and(|name| name.ends_with(FRAME_OF_RUN))
}

/// The file with a run's similarity beside the cameras of `path`, if it applies to these.
#[must_use]
pub fn frame_beside(path: &Path) -> Option<PathBuf> {
    let beside = if path.is_dir() { path.join(FRAME_OF_RUN) } else { path.with_file_name(FRAME_OF_RUN) };
    // Cameras that are no file's have no path.
    let is_there = path.exists() && !is_frame_of_run(path) && beside.is_file();
    // Other files, such as exported poses, may be in that frame already.
    let is_of_data_set = || !is_json(path) || data_set(&beside).as_deref() == Some(path);
    (is_there && is_of_data_set()).then_some(beside)
}

/// The camera file of the data set that a run's similarity applies to: in the same folder, or where the run's
/// config.yml names, seen from here or from a folder above the run.
pub(super) fn data_set(path: &Path) -> Option<PathBuf> {
    let cameras = |place: PathBuf| {
        let is_file = is_json(&place) && !is_frame_of_run(&place);
        let file = if is_file { place } else { place.join("transforms.json") };
        if file.is_file() {
            return Some(file);
        }
        let folder = file.parent()?.to_path_buf();
        (!ModelFiles::all(&folder).is_empty()).then_some(folder)
    };
    let folder = path.parent().unwrap_or(Path::new(""));
    cameras(folder.to_path_buf()).or_else(|| {
        let named = data_of_config(&octobayes::io::read_text(&folder.join("config.yml")).ok()?)?;
        let whole = std::path::absolute(folder).ok()?;
        [Path::new("")].into_iter().chain(whole.ancestors()).find_map(|above| cameras(above.join(&named)))
    })
}

/// The folder of the data in a config.yml: a path that YAML keeps as the list of its parts.
fn data_of_config(text: &str) -> Option<PathBuf> {
    let mut lines = text.lines().skip_while(|line| !line.starts_with("data:"));
    lines.next().filter(|line| line.contains("pathlib"))?;
    let part = |line: &str| line.strip_prefix("- ").map(|part| part.trim_matches(['\'', '"']).to_string());
    Some(lines.map_while(part).collect()).filter(|path: &PathBuf| !path.as_os_str().is_empty())
}

/// A run's similarity, which takes positions of the original data to those that it was trained in.
#[derive(Deserialize)]
struct FrameOfRun {
    transform: Vec<Vec<f64>>,
    scale: f64,
}

/// What was done to the original data before, by a transforms.json.
#[derive(Deserialize)]
struct Applied {
    applied_transform: Option<Vec<Vec<f64>>>,
    applied_scale: Option<f64>,
}

pub(super) fn is_json(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "json")
}

fn json(path: &Path, expected: &str) -> Result<Value> {
    serde_json::from_str(&octobayes::io::read_text(path)?)
        .map_err(|e| Error::malformed(path, "JSON", expected, e.to_string()))
}

/// The rigid motion and the scale that a transforms.json has taken the original poses by.
pub(super) fn applied(path: &Path) -> Result<(Similarity, f64)> {
    let expected = "`applied_transform` as rows of numbers, `applied_scale` as a number";
    let applied: Applied = serde_json::from_value(json(path, "a transforms.json")?)
        .map_err(|e| Error::malformed(path, "applied_transform", expected, e.to_string()))?;
    let is_old = || path.with_file_name("colmap").join("sparse/0").is_dir();
    let rows = applied.applied_transform.or_else(|| is_old().then(|| FROM_COLMAP.map(Vec::from).into()));
    let motion = rows.map_or(Ok(Similarity::IDENTITY), |rows| similarity(path, "applied_transform", &rows, 1.0))?;
    Ok((motion, positive(path, "applied_scale", applied.applied_scale.unwrap_or(1.0))?))
}

/// The frame that nerfstudio makes by default of these cameras, as its files have them: upright as cameras are on
/// average, around their mean, within a cube of edge 2.
pub(super) fn default_frame(cameras: &[Camera]) -> Similarity {
    let up = cameras.iter().map(|camera| camera.axes.y_axis).sum::<DVec3>().normalize_or(DVec3::Z);
    let rotation = DMat3::from_quat(DQuat::from_rotation_arc(up, DVec3::Z));
    let middle = cameras.iter().map(|camera| camera.position).sum::<DVec3>() / cameras.len() as f64;
    let turned = Similarity { rotation, translation: -(rotation * middle), scale: 1.0 };
    let farthest = cameras.iter().map(|camera| turned.point(camera.position).abs().max_element()).fold(0.0, f64::max);
    Similarity { scale: 1.0 / farthest, ..turned }
}

/// The cameras of a data set, moved to the frame of the run whose similarity is the file `path`.
pub(super) fn in_frame_of_run(path: &Path, requested: Option<[u32; 2]>) -> Result<Views> {
    let data = data_set(path).ok_or_else(|| Error::malformed(path, "cameras", DATA_SET, "neither"))?;
    let run: FrameOfRun = serde_json::from_value(json(path, "`transform` and `scale`")?)
        .map_err(|e| Error::malformed(path, "cameras", "`transform` and `scale`", e.to_string()))?;
    let of_run = similarity(path, "transform", &run.transform, run.scale)?;
    // Poses of a transforms.json are no longer the original ones; those of COLMAP are.
    let similarity = if is_json(&data) {
        let (before, scale) = applied(&data)?;
        let rotation = of_run.rotation * before.rotation.transpose();
        let translation = of_run.translation - rotation * before.translation;
        Similarity { rotation, translation, scale: of_run.scale / scale }
    } else {
        of_run
    };
    let mut views = Views::stated(&data, requested)?;
    views.frames.iter_mut().for_each(|frame| frame.camera = similarity.camera(&frame.camera));
    views.notes.push(format!(
        "the cameras of {}, moved to the frame that nerfstudio trained in; a length of the data set is {:.4} of these, \
         also in its depth maps",
        data.display(),
        similarity.scale
    ));
    Ok(Views { path: path.to_path_buf(), ..views })
}

fn positive(path: &Path, key: &str, value: f64) -> Result<f64> {
    let found = || Error::malformed(path, format!("`{key}`"), "a positive number", value.to_string());
    (value > 0.0 && value.is_finite()).then_some(value).ok_or_else(found)
}

fn similarity(path: &Path, key: &str, rows: &[Vec<f64>], scale: f64) -> Result<Similarity> {
    let scale = positive(path, "scale", scale)?;
    let (translation, rotation) = rigid_pose(rows)
        .map_err(|found| Error::malformed(path, format!("`{key}`"), "three rows of a rigid motion", found))?;
    let first = DVec3::new(rows[0][0], rows[1][0], rows[2][0]).length();
    if (first - 1.0).abs() > 1e-3 {
        let found = format!("a first column of length {first}");
        return Err(Error::malformed(path, format!("`{key}`"), "a rotation, beside its scale", found));
    }
    Ok(Similarity { rotation, translation, scale })
}

/// Poses that `ns-export cameras` wrote, as a transforms.json: the data set's, which lies beside the file, with the
/// poses of its frames replaced.
///
/// # Errors
/// If it is not there, if a pose is of a picture that it does not have once, or if an entry is no pose.
pub(super) fn exported(path: &Path, list: &[Value]) -> Result<Value> {
    let data = path.with_file_name("transforms.json");
    if !data.is_file() || data == path {
        let expected = format!(
            "the data set's transforms.json beside them, which has the lenses; or pass the run's {FRAME_OF_RUN}, which \
             finds both"
        );
        return Err(Error::malformed(path, "cameras", expected, "poses of `ns-export cameras` alone"));
    }
    let mut file: Map<String, Value> = serde_json::from_str(&octobayes::io::read_text(&data)?)
        .map_err(|e| Error::malformed(&data, "JSON", "a transforms.json", e.to_string()))?;
    let name = |frame: &Value| Some(PathBuf::from(frame.get("file_path")?.as_str()?.replace('\\', "/")));
    let frames: Vec<Value> = file.get("frames").and_then(Value::as_array).cloned().unwrap_or_default();
    let names: Vec<PathBuf> = frames.iter().map(|frame| name(frame).unwrap_or_default()).collect();
    let mut of_stem: HashMap<&OsStr, Vec<usize>> = HashMap::new();
    for (i, stem) in names.iter().enumerate().filter_map(|(i, name)| Some((i, name.file_stem()?))) {
        of_stem.entry(stem).or_default().push(i);
    }
    let pose = |(i, entry): (usize, &Value)| {
        let wrong = |key: &str, expected: String, found: String| {
            Error::malformed(path, format!("camera {i}, `{key}`"), expected, found)
        };
        let named = name(entry).ok_or_else(|| wrong("file_path", "the path of a picture".into(), "none".into()))?;
        // Folders differ if smaller pictures were trained on, and by where the run was started.
        let alike = |k: &usize| {
            let parts = named.components().rev().skip(1).zip(names[*k].components().rev().skip(1));
            parts.take_while(|(a, b)| a == b).count()
        };
        let found = of_stem.get(named.file_stem().unwrap_or_default()).map_or(&[][..], Vec::as_slice);
        let most = found.iter().map(alike).max();
        let best: Vec<usize> = found.iter().copied().filter(|k| Some(alike(k)) == most).collect();
        let [k] = best[..] else {
            let expected = format!("a picture that is once in {}", data.display());
            return Err(wrong("file_path", expected, format!("`{}`, there {} times", named.display(), best.len())));
        };
        let mut frame = frames[k].clone();
        frame["transform_matrix"] = entry.get("transform").cloned().unwrap_or_default();
        Ok(frame)
    };
    let posed = list.iter().enumerate().map(pose).collect::<Result<Vec<Value>>>()?;
    file.retain(|key, _| !LISTS.contains(&key.as_str()));
    file.insert("frames".into(), posed.into());
    Ok(file.into())
}

/// A camera path of the viewer as a transforms.json without pictures; `None` if the file is none.
///
/// # Errors
/// If it has no camera, one without a pose, or one that is not perspective.
pub(super) fn camera_path(path: &Path, file: &Map<String, Value>) -> Option<Result<Value>> {
    let list = file.get("camera_path")?.as_array()?;
    let wrong =
        |place: String, expected: &str, found: &Value| Error::malformed(path, place, expected, found.to_string());
    if let Some(other) = file.get("camera_type").filter(|kind| *kind != "perspective") {
        return Some(Err(wrong("`camera_type`".into(), "`perspective`", other)));
    }
    if list.is_empty() {
        return Some(Err(Error::malformed(path, "`camera_path`", "at least one camera", "none")));
    }
    let frame = |(i, camera): (usize, &Value)| {
        let pose = &camera["camera_to_world"];
        let numbers: Option<Vec<f64>> = pose.as_array().and_then(|list| list.iter().map(Value::as_f64).collect());
        let Some(numbers) = numbers.filter(|numbers| numbers.len() == 16) else {
            return Err(wrong(format!("camera {i}, `camera_to_world`"), "16 numbers, row by row", pose));
        };
        let Some(fov) = camera["fov"].as_f64() else {
            return Err(wrong(format!("camera {i}, `fov`"), "degrees from bottom to top", &camera["fov"]));
        };
        let rows: Vec<&[f64]> = numbers.chunks(4).collect();
        Ok(json!({ "transform_matrix": rows, "y_fov": fov }))
    };
    let frames: Result<Vec<Value>> = list.iter().enumerate().map(frame).collect();
    let size = |key: &str| file.get(key).cloned().unwrap_or_default();
    Some(frames.map(|frames| json!({ "frames": frames, "w": size("render_width"), "h": size("render_height") })))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::FrameSplit;
    use crate::views::Purpose;
    use crate::{Part, Selection};

    /// A folder with these files.
    fn folder(files: &[(&str, Value)]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for (name, json) in files {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, json.as_str().map_or_else(|| json.to_string(), str::to_string)).unwrap();
        }
        folder
    }

    fn read(folder: &tempfile::TempDir, name: &str) -> Result<Views> {
        Views::read(&folder.path().join(name), None)
    }

    /// Upright, at this place, looking along −z.
    fn pose(at: [f64; 3]) -> Value {
        json!([[1, 0, 0, at[0]], [0, 1, 0, at[1]], [0, 0, 1, at[2]], [0, 0, 0, 1]])
    }

    fn data(more: &[(&str, Value)]) -> Value {
        let frame = |i: u32| {
            json!({ "file_path": format!("images/{i}.png"), "transform_matrix": pose([f64::from(i), 2.0, 3.0]),
                "fl_x": 40 + i })
        };
        let mut file = json!({ "w": 40, "h": 30, "frames": [frame(0), frame(1), frame(2)] });
        more.iter().for_each(|(key, value)| file[key] = value.clone());
        file
    }

    /// A quarter turn about z, then (0, 0, 1), then half as large.
    fn of_run() -> Value {
        json!({ "transform": [[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 1]], "scale": 0.5 })
    }

    #[test]
    fn cameras_are_moved_to_the_frame_of_the_run() {
        let set = folder(&[("transforms.json", data(&[])), ("dataparser_transforms.json", of_run())]);
        let views = read(&set, "dataparser_transforms.json").unwrap();
        let camera = views.frames[1].camera;
        // (1, 2, 3) is turned to (−2, 1, 3) and moved to (−2, 1, 4).
        assert!(camera.position.distance(DVec3::new(-1.0, 0.5, 2.0)) < 1e-12, "{camera:?}");
        assert!(camera.axes.x_axis.distance(DVec3::Y) < 1e-12 && camera.focal == [41.0; 2], "{camera:?}");
        assert!(views.frames[1].image.ends_with("images/1.png"));
        assert!(views.notes.iter().any(|note| note.contains("is 0.5000 of these")), "{:?}", views.notes);
        assert_eq!(Views::files(&set.path().join("dataparser_transforms.json")).len(), 2);

        // What was applied to the original data before lies between: x = 2 (T · A⁻¹ of the saved pose) / 4.
        let swap = json!([[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0]]);
        let applied = [("applied_transform", swap), ("applied_scale", json!(4))];
        let set = folder(&[("transforms.json", data(&applied)), ("dataparser_transforms.json", of_run())]);
        let camera = read(&set, "dataparser_transforms.json").unwrap().frames[1].camera;
        // The saved (1, 2, 3) was (2, 1, −3), which is turned to (−1, 2, −3) and moved to (−1, 2, −2).
        assert!(camera.position.distance(DVec3::new(-1.0, 2.0, -2.0) / 8.0) < 1e-12, "{camera:?}");
    }

    #[test]
    fn the_data_set_of_a_run_is_found_by_its_config() {
        let config = "!!python/object:nerfstudio\n_target: x\ndata: &id1 !!python/object/apply:pathlib.PosixPath\n\
                      - data\n- 'poster'\nexperiment_name: poster\n";
        let set = folder(&[
            ("data/poster/transforms.json", data(&[])),
            ("outputs/poster/1/config.yml", config.into()),
            ("outputs/poster/1/dataparser_transforms.json", of_run()),
        ]);
        assert_eq!(read(&set, "outputs/poster/1/dataparser_transforms.json").unwrap().frames.len(), 3);
        // A config.yml that leads to the file itself leads nowhere.
        let itself = "data: !!python/object/apply:pathlib.PosixPath\n- dataparser_transforms.json\n";
        let alone = folder(&[("dataparser_transforms.json", of_run()), ("config.yml", itself.into())]);
        let error = read(&alone, "dataparser_transforms.json").unwrap_err().to_string();
        assert!(error.contains("COLMAP model beside it") && error.ends_with("found neither"), "{error}");
    }

    #[test]
    fn what_is_no_similarity_is_refused() {
        for (json, expected) in [
            (
                json!({ "transform": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], "scale": 0 }),
                "a positive number, found 0",
            ),
            (json!({ "transform": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0]], "scale": 1 }), "singular or mirrored"),
            (json!({ "transform": [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0]], "scale": 1 }), "column of length 2"),
            (json!({ "transform": 3, "scale": 1 }), "expected `transform` and `scale`"),
        ] {
            let set = folder(&[("transforms.json", data(&[])), ("dataparser_transforms.json", json)]);
            let error = read(&set, "dataparser_transforms.json").unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn exported_poses_have_the_lenses_of_the_data_set() {
        let list = json!([
            { "file_path": "/home/a/poster/images_2/2.jpg", "transform": [[1, 0, 0, 7], [0, 1, 0, 8], [0, 0, 1, 9]] },
            { "file_path": "images/0.png", "transform": pose([1.0, 0.0, 0.0]) },
        ]);
        let lists = [("train_filenames", json!(["images/1.png"]))];
        let set = folder(&[("transforms.json", data(&lists)), ("transforms_train.json", list.clone())]);
        let frames = read(&set, "transforms_train.json").unwrap().frames;
        assert_eq!(frames[0].camera.position, DVec3::new(7.0, 8.0, 9.0));
        assert_eq!((frames.len(), frames[0].camera.focal, frames[0].name.as_str()), (2, [42.0; 2], "images/2.png"));
        assert!(frames.iter().all(|frame| frame.purpose == Some(Purpose::Training)));

        let alone = folder(&[("transforms_train.json", list)]);
        let error = read(&alone, "transforms_train.json").unwrap_err().to_string();
        assert!(error.contains("transforms.json beside them") && error.contains("`ns-export cameras`"), "{error}");
        let other = json!([{ "file_path": "images/7.png", "transform": pose([1.0, 0.0, 0.0]) }]);
        let set = folder(&[("transforms.json", data(&[])), ("transforms_train.json", other)]);
        let error = read(&set, "transforms_train.json").unwrap_err().to_string();
        assert!(error.contains("camera 0, `file_path`") && error.contains("there 0 times"), "{error}");
    }

    #[test]
    fn a_camera_path_has_cameras_but_no_pictures() {
        let camera = |x: f64| json!({ "camera_to_world": [1, 0, 0, x, 0, 1, 0, 2, 0, 0, 1, 3, 0, 0, 0, 1], "fov": 90 });
        let path = json!({ "camera_type": "perspective", "render_height": 20, "render_width": 30,
            "camera_path": [camera(1.0), camera(4.0)] });
        let set = folder(&[("path.json", path.clone())]);
        let views = read(&set, "path.json").unwrap();
        let camera = views.frames[1].camera;
        assert_eq!((camera.position, camera.resolution), (DVec3::new(4.0, 2.0, 3.0), [30, 20]));
        // 90 degrees from bottom to top.
        assert!((camera.focal[1] - 10.0).abs() < 1e-12 && camera.focal[0] == camera.focal[1], "{camera:?}");
        let split = FrameSplit::new(views);
        for selection in [Selection::All, Selection::BothParts] {
            let error = split.select(Part::Training, &selection, |_| true).unwrap_err().to_string();
            assert!(error.contains("a camera path, along which no picture was taken"), "{error}");
        }
        for (key, value, expected) in [
            ("camera_type", json!("fisheye"), "`camera_type`: expected `perspective`"),
            ("camera_path", json!([]), "at least one camera"),
            ("camera_path", json!([{ "camera_to_world": [1], "fov": 40 }]), "16 numbers"),
            ("camera_path", json!([{ "fov": 40 }]), "camera 0, `camera_to_world`"),
        ] {
            let mut other = path.clone();
            other[key] = value;
            let error = read(&folder(&[("path.json", other)]), "path.json").unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
