//! Files that people take for camera files: which kind one is, and what to pass instead.

use serde_json::{Map, Value};

/// A kind of file, and what to pass instead of it.
type Kind = (&'static str, &'static str);

const OF_DATA_SET: &str = "pass the transforms.json or the COLMAP model of the data set";

/// Recognises JSON that holds no cameras of a data set.
pub(super) fn json(value: &Value) -> Option<Kind> {
    match value {
        Value::Array(list) => {
            let Some(Value::Object(first)) = list.first() else { return Some(("an empty list", OF_DATA_SET)) };
            of_list(first)
        }
        Value::Object(file) => of_object(file),
        _ => None,
    }
}

fn of_list(first: &Map<String, Value>) -> Option<Kind> {
    let has = |keys: &[&str]| keys.iter().all(|key| first.contains_key(*key));
    if has(&["file_path", "transform"]) {
        let instead = "its poses are in the trainer's coordinates, without lenses: pass the data set's transforms.json";
        Some(("poses exported by `ns-export cameras`", instead))
    } else if has(&["shots"]) {
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
    if has(&["camera_path"]) {
        Some(("a camera path of nerfstudio's viewer, which no image was taken from", OF_DATA_SET))
    } else if first_has("path", "R") {
        Some(("a camera path of instant-ngp, which no image was taken from", OF_DATA_SET))
    } else if has(&["transform", "scale"]) && !has(&["frames"]) {
        Some(("nerfstudio's dataparser_transforms.json, which holds no cameras", OF_DATA_SET))
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
            (r#"[{"file_path": "a.png", "transform": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]}]"#, "ns-export"),
            (r#"[{"cameras": {}, "shots": {}, "points": {}}]"#, "OpenSfM"),
            ("[]", "an empty list"),
            (r#"{"camera_path": [], "render_height": 4}"#, "nerfstudio's viewer"),
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
        assert_eq!(json(&serde_json::from_str(r#"{"fl_x": 4, "frames": []}"#).unwrap()), None);
        assert_eq!(json(&Value::from(3)), None);
    }
}
