use super::*;
use crate::field::ClosedForm;

fn read(json: &str) -> Result<Views> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("transforms.json");
    std::fs::write(&path, json).unwrap();
    Views::read(&path, None)
}

const POSE: &str = r#""transform_matrix": [[1,0,0,1],[0,1,0,2],[0,0,1,3],[0,0,0,1]]"#;

#[test]
fn written_cameras_are_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("transforms.json");
    let cameras: Vec<_> =
        ClosedForm::half_circle(5, [64, 48]).into_iter().enumerate().map(|(i, c)| (format!("r_{i}"), c)).collect();
    write_transforms(&path, &cameras).unwrap();
    let views = Views::read(&path, None).unwrap();
    assert_eq!(views.resolution_source, ResolutionSource::File);
    for ((name, camera), frame) in cameras.iter().zip(&views.frames) {
        assert_eq!(name, &frame.name);
        let [a, b] = [camera, &frame.camera].map(|c| c.ray(10.5, 3.5));
        assert!((a.origin - b.origin).length() < 1e-14 && (a.direction - b.direction).length() < 1e-14);
    }
}

#[test]
fn frames_override_the_file() {
    let json = format!(
        r#"{{"camera_angle_x": 1.0, "w": 100, "h": 50, "frames": [{{"file_path": "a", {POSE}}},
           {{"file_path": "b.jpg", "fl_x": 80, "cx": 49, {POSE}}}]}}"#
    );
    let views = read(&json).unwrap();
    assert!((views.frames[0].camera.focal[0] - 50.0 / 0.5_f64.tan()).abs() < 1e-12);
    assert_eq!(views.frames[0].camera.center, [50.0, 25.0]);
    assert_eq!((views.frames[1].camera.focal, views.frames[1].camera.center), ([80.0, 80.0], [49.0, 25.0]));
    assert!(views.frames[0].image.ends_with("a.png") && views.frames[1].image.ends_with("b.jpg"));
}

#[test]
fn perspective_cameras_of_any_name_are_read_with_their_distortion() {
    for name in PERSPECTIVE.into_iter().chain(["opencv"]) {
        let model = format!(r#""camera_model": "{name}""#);
        let json = format!(r#"{{"fl_x": 50, "k1": 0.1, {model}, "frames": [{{{model}, {POSE}}}]}}"#);
        assert_eq!(read(&json).expect(name).frames[0].camera.distortion.k, [0.1, 0.0]);
    }
    // A frame's own lens takes precedence over the file's.
    let json =
        format!(r#"{{"fl_x": 50, "camera_model": "FISHEYE624", "frames": [{{"camera_model": "PINHOLE", {POSE}}}]}}"#);
    assert!(read(&json).is_ok());
}

#[test]
fn what_is_wrong_is_said() {
    let cases = [
        ("{\"frames\": []}", "at least one frame"),
        ("{", "line 1"),
        (&format!("{{\"frames\": [{{{POSE}}}]}}"), "camera_angle_x"),
        (r#"{"camera_angle_x": 1, "frames": [{"transform_matrix": [[1,0,0,0],[1,0,0,0],[0,0,1,0]]}]}"#, "singular"),
        (
            r#"{"camera_angle_x": 1, "frames": [{"transform_matrix": [[1,0,0,0],[0.5,1,0,0],[0,0,1,0]]}]}"#,
            "no rotation",
        ),
        (r#"{"camera_angle_x": 1, "frames": [{"transform_matrix": [[1,0,0],[0,1,0],[0,0,1]]}]}"#, "rows of"),
        (&format!("{{\"fl_x\": -5, \"frames\": [{{{POSE}}}]}}"), "positive"),
        (
            r#"{"camera_angle_x": 1, "frames": [{"transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[1,2,3,1]]}]}"#,
            "[1.0, 2.0, 3.0, 1.0]",
        ),
        (&format!("{{\"camera_angle_x\": 40, \"frames\": [{{{POSE}}}]}}"), "radians"),
        (&format!("{{\"fl_x\": 9, \"camera_angle_y\": -0.5, \"frames\": [{{{POSE}}}]}}"), "radians"),
        (&format!("{{\"fl_x\": 5, \"is_fisheye\": true, \"frames\": [{{{POSE}}}]}}"), "fisheye"),
        (
            &format!("{{\"fl_x\": 5, \"camera_model\": \"EQUIRECTANGULAR\", \"frames\": [{{{POSE}}}]}}"),
            "frame 0 (``), `camera_model`: expected a perspective camera",
        ),
        (
            &format!("{{\"fl_x\": 5, \"frames\": [{{{POSE}}}, {{\"camera_model\": \"OPENCV_FISHEYE\", {POSE}}}]}}"),
            "frame 1 (``), `camera_model`: expected a perspective camera (PINHOLE, SIMPLE_PINHOLE, OPENCV, RADIAL, \
             SIMPLE_RADIAL), found `OPENCV_FISHEYE`",
        ),
        (&format!("{{\"fl_x\": 5, \"ftheta_p0\": 0.1, \"frames\": [{{{POSE}}}]}}"), "found `ftheta_p0`"),
        (&format!("{{\"fl_x\": 5, \"frames\": [{{\"latlong\": true, {POSE}}}]}}"), "found `latlong`"),
        (&format!("{{\"fl_x\": 5, \"w\": 0, \"h\": 3, \"frames\": [{{{POSE}}}]}}"), "whole numbers"),
    ];
    for (json, expected) in cases {
        let error = read(json).expect_err(json).to_string();
        assert!(error.contains(expected) && error.contains("transforms.json"), "{error}");
    }
}
