//! Files that people take for camera files: which kind one is, and what to pass instead.

use serde_json::{Map, Value};

/// A kind of file, and what to pass instead of it.
type Kind = (&'static str, &'static str);

const OF_DATA_SET: &str = "pass the transforms.json or the COLMAP model of the data set";
const AS_TRANSFORMS: &str = "write poses and lens as a transforms.json, with camera-to-world matrices in OpenGL's axes";
const OF_REALITY_SCAN: &str =
    "export the registration in COLMAP's text format, with undistorted images, and pass that folder";
const OF_RUN: &str = "name it dataparser_transforms.json, beside the data set's transforms.json or COLMAP model";

/// Recognises JSON that holds no cameras of a data set.
pub(super) fn json(value: &Value) -> Option<Kind> {
    match value {
        Value::Array(list) => {
            let Some(first) = list.first() else { return Some(("an empty list", OF_DATA_SET)) };
            first.as_object().map_or(Some(("a list of numbers or matrices, without lenses", AS_TRANSFORMS)), of_list)
        }
        Value::Object(file) => of_object(file),
        _ => None,
    }
}

fn of_list(first: &Map<String, Value>) -> Option<Kind> {
    let has = |keys: &[&str]| keys.iter().all(|key| first.contains_key(*key));
    if has(&["shots"]) {
        Some(("a reconstruction of OpenSfM or OpenDroneMap", "convert it with `ns-process-data odm`"))
    } else {
        None
    }
}

fn of_object(file: &Map<String, Value>) -> Option<Kind> {
    let has = |keys: &[&str]| keys.iter().all(|key| file.contains_key(*key));
    let lists = |key: &str| file.get(key).and_then(Value::as_array);
    let first_has = |key: &str, inner: &str| {
        lists(key).and_then(|list| list.first()).is_some_and(|first| first.get(inner).is_some())
    };
    if first_has("path", "R") {
        Some(("a camera path of instant-ngp, in the coordinates of its own viewer", AS_TRANSFORMS))
    } else if has(&["transform", "scale"]) && !has(&["frames"]) {
        Some(("nerfstudio's dataparser_transforms.json under another name", OF_RUN))
    } else if first_has("frames", "camtoworld") {
        Some(("the meta_data.json of sdfstudio", "pass the transforms.json that it was made from"))
    } else if has(&["poses", "K"]) {
        Some(("the metadata of Record3D", "convert it with `ns-process-data record3d`"))
    } else if has(&["t_00", "fx"]) {
        Some(("one camera of Polycam", "convert the capture with `ns-process-data polycam`"))
    } else if file.values().any(|camera| camera.get("projection_type").is_some()) {
        Some(("the cameras.json of OpenDroneMap, which holds no poses", "convert it with `ns-process-data odm`"))
    } else {
        None
    }
}

/// Recognises text that is no JSON, by its first lines.
pub(super) fn text(text: &str) -> Option<Kind> {
    let start = text.trim_start_matches('\u{feff}').trim_start();
    let starts: [(&str, Kind); 6] = [
        ("# Bundle file", ("the bundle.out of Bundler", AS_TRANSFORMS)),
        ("NVM_V3", ("the .nvm of VisualSFM", AS_TRANSFORMS)),
        ("!!python/object:nerfstudio", ("the config.yml of a nerfstudio run", OF_DATA_SET)),
        ("# Camera list", ("cameras.txt of COLMAP alone", "pass the folder of cameras.txt and images.txt")),
        ("# Image list", ("images.txt of COLMAP alone", "pass the folder of cameras.txt and images.txt")),
        ("# 3D point list", ("points3D.txt of COLMAP", "pass the folder of cameras.txt and images.txt")),
    ];
    if let Some((_, kind)) = starts.into_iter().find(|(known, _)| start.starts_with(known)) {
        return Some(kind);
    }
    if start.starts_with(['{', '[']) {
        return None;
    }
    let line = start.lines().map(str::trim).find(|line| !line.is_empty() && !line.starts_with('#'))?;
    let words: Vec<&str> = line.split_whitespace().collect();
    let are_numbers = words.iter().all(|word| word.parse::<f64>().is_ok());
    match words.len() {
        // KITTI has matrices of three rows.
        7 | 8 | 12 if are_numbers => Some(("a trajectory (TUM, KITTI?), without a lens", AS_TRANSFORMS)),
        _ if line.matches(',').count() >= 3 => Some(("a table (.csv of RealityScan?)", OF_REALITY_SCAN)),
        _ => None,
    }
}

/// Recognises a file by its first bytes.
pub(super) fn bytes(start: &[u8]) -> Option<Kind> {
    let kinds: [(&[u8], Kind); 9] = [
        (b"\x93NUMPY", ("a NumPy array (poses_bounds.npy of LLFF?)", OF_DATA_SET)),
        (b"PK", ("a ZIP archive (cameras_sphere.npz of NeuS, a checkpoint?)", OF_DATA_SET)),
        (b"\x89PNG", ("a PNG image", OF_DATA_SET)),
        (b"\xff\xd8\xff", ("a JPEG image", OF_DATA_SET)),
        (b"SQLite format 3", ("a database of COLMAP", "pass the folder with its sparse model")),
        (b"ply", ("a PLY file of points or splats", OF_DATA_SET)),
        (b"\x1f\x8b", ("a gzip archive", OF_DATA_SET)),
        (b"OCTOBAY", ("a field of octobayes", OF_DATA_SET)),
        (b"\xff\xfe", ("text in UTF-16", "save it as UTF-8")),
    ];
    kinds.into_iter().find_map(|(magic, kind)| start.starts_with(magic).then_some(kind))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_other_programs_are_named() {
        for (text, name) in [
            ("[[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]]", "matrices"),
            (r#"[{"cameras": {}, "shots": {}, "points": {}}]"#, "OpenSfM"),
            ("[]", "an empty list"),
            (r#"{"path": [{"R": [1, 0, 0, 0], "T": [0, 0, 0]}], "time": 0}"#, "instant-ngp"),
            (r#"{"transform": [[1, 0, 0, 0]], "scale": 0.3}"#, "dataparser_transforms.json"),
            (r#"{"camera_model": "OPENCV", "frames": [{"rgb_path": "a.png", "camtoworld": []}]}"#, "sdfstudio"),
            (r#"{"w": 4, "h": 4, "K": [1], "poses": [[0]]}"#, "Record3D"),
            (r#"{"t_00": 1, "fx": 4}"#, "Polycam"),
            (r#"{"v2 dji": {"projection_type": "brown", "width": 4}}"#, "OpenDroneMap"),
        ] {
            let (kind, instead) = json(&serde_json::from_str(text).unwrap()).expect(text);
            assert!(kind.contains(name) && !instead.is_empty(), "{text}: {kind}");
        }
        for (lines, name) in [
            ("# Bundle file v0.3\n3 10\n", "Bundler"),
            ("NVM_V3\n\n3\n", "VisualSFM"),
            ("!!python/object:nerfstudio.engine.trainer.TrainerConfig\n", "config.yml"),
            ("# Image list with two lines of data per image:\n", "images.txt"),
            ("# timestamp tx ty tz qx qy qz qw\n1305031102.1 1.3 0.6 1.6 0.65 0.61 -0.3 -0.29\n", "TUM"),
            ("1 0 0 0 0 1 0 0 0 0 1 0\n", "KITTI"),
            ("#name,x,y,alt,heading,pitch,roll\nDSC1.jpg,1,2,3,4,5,6\n", ".csv"),
        ] {
            let (kind, instead) = text(lines).expect(lines);
            assert!(kind.contains(name) && !instead.is_empty(), "{lines}: {kind}");
        }
        for lines in ["", "{", "[1, 2, 3, 4, 5]", "nonsense", "1 2 3"] {
            assert_eq!(text(lines), None, "{lines}");
        }
        assert_eq!(json(&serde_json::from_str(r#"{"fl_x": 4, "frames": []}"#).unwrap()), None);
        assert_eq!(json(&Value::from(3)), None);
    }
}
