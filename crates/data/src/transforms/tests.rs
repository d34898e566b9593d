use std::path::PathBuf;

use super::*;
use octobayes::field::ClosedForm;
use octobayes::geometry::Distortion;

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
fn a_frame_overrides_every_key_of_the_file() {
    let keys = ["fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2"];
    let [file, own] =
        [[80.0, 81.0, 40.0, 41.0, 0.01, 0.02, 0.001, 0.002], [90.0, 91.0, 42.0, 43.0, 0.03, 0.04, 0.003, 0.004]];
    let stated = |values: [f64; 8]| {
        let of: Vec<String> = keys.iter().zip(values).map(|(key, value)| format!(r#""{key}": {value}"#)).collect();
        of.join(", ")
    };
    let frames = format!(r#"[{{"file_path": "a", {POSE}}}, {{"file_path": "b", {}, {POSE}}}]"#, stated(own));
    let views = read(&format!(r#"{{"w": 80, "h": 80, {}, "frames": {frames}}}"#, stated(file))).unwrap();
    for (frame, [fx, fy, cx, cy, k1, k2, p1, p2]) in views.frames.iter().zip([file, own]) {
        let Camera { focal, center, distortion, .. } = frame.camera;
        assert_eq!((focal, center), ([fx, fy], [cx, cy]), "{}", frame.name);
        assert_eq!((distortion.k, distortion.p), ([k1, k2, 0.0, 0.0], [p1, p2]), "{}", frame.name);
    }
}

#[test]
fn perspective_cameras_of_any_name_are_read_with_their_distortion() {
    for name in PERSPECTIVE.into_iter().chain(["opencv"]) {
        let model = format!(r#""camera_model": "{name}""#);
        let json = format!(r#"{{"fl_x": 50, "w": 40, "h": 40, "k1": 0.1, {model}, "frames": [{{{model}, {POSE}}}]}}"#);
        assert_eq!(read(&json).expect(name).frames[0].camera.distortion.k, [0.1, 0.0, 0.0, 0.0]);
    }
    // A frame's own lens takes precedence over the file's.
    let json = format!(
        r#"{{"camera_angle_x": 1, "camera_model": "FISHEYE624", "frames": [{{"camera_model": "PINHOLE", {POSE}}}]}}"#
    );
    assert!(read(&json).is_ok());
}

/// A folder with a camera file and pictures of given sizes.
fn folder(json: &str, pictures: &[(&str, [u32; 2])]) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    for (name, [w, h]) in pictures {
        image::GrayImage::new(*w, *h).save(folder.path().join(name)).unwrap();
    }
    let path = folder.path().join("transforms.json");
    std::fs::write(&path, json).unwrap();
    (folder, path)
}

#[test]
fn pixels_refer_to_the_picture_of_their_frame_at_any_size() {
    let json = format!(
        r#"{{"fl_x": 100, "cx": 52, "frames": [{{"file_path": "a.png", {POSE}}}, {{"file_path": "b.png", {POSE}}}]}}"#
    );
    let (_folder, path) = folder(&json, &[("a.png", [100, 80]), ("b.png", [50, 40])]);
    let views = Views::read(&path, None).unwrap();
    assert_eq!(views.resolution_source, ResolutionSource::Image);
    assert_eq!(views.frames.iter().map(|f| f.size).collect::<Vec<_>>(), [[100, 80], [50, 40]]);
    for (requested, scales) in [([50, 40], [0.5, 1.0]), ([200, 160], [2.0, 4.0])] {
        let frames = Views::read(&path, Some(requested)).unwrap().frames;
        for (frame, scale) in frames.iter().zip(scales) {
            let camera = frame.camera;
            assert_eq!((camera.focal, camera.center[0]), ([100.0 * scale; 2], 52.0 * scale), "{requested:?}");
        }
    }
    // Without pictures the size is unknown; an angle is valid for any size.
    let (_folder, path) = folder(&json, &[]);
    for requested in [None, Some([50, 40])] {
        let error = Views::read(&path, requested).unwrap_err().to_string();
        assert!(error.contains("frame 0 (`a.png`), `fl_x`: expected `w` and `h`, the size"), "{error}");
    }
    let angle = json.replace(r#""fl_x": 100, "cx": 52"#, r#""camera_angle_x": 1"#);
    let (_folder, path) = folder(&angle, &[]);
    assert_eq!(Views::read(&path, Some([50, 40])).unwrap().frames[0].camera.resolution, [50, 40]);
    assert_eq!(Views::read(&path, None).unwrap().resolution_source, ResolutionSource::Assumed);
    // Blender rounds shares of its resolution down.
    let shares = read(&format!(r#"{{"fl_x": 100, "w": 33.6, "h": 20.2, "frames": [{{{POSE}}}]}}"#)).unwrap();
    assert_eq!(shares.frames[0].camera.resolution, [33, 20]);
}

#[test]
fn smaller_copies_of_the_pictures_can_be_chosen_and_are_better_than_none() {
    let json = format!(
        r#"{{"fl_x": 90, "cx": 52, "w": 101, "h": 67, "frames": [{{"file_path": "./images/a.png", {POSE}}},
           {{"file_path": "images\\b.png", {POSE}}}]}}"#
    );
    let (desk, path) = folder(&json, &[]);
    let picture = |folder: &str, name: &str, [w, h]: [u32; 2]| {
        std::fs::create_dir_all(desk.path().join(folder)).unwrap();
        image::GrayImage::new(w, h).save(desk.path().join(folder).join(name)).unwrap();
    };
    let read = |path: &Path| {
        let views = Views::read(path, None).unwrap();
        let folder = |frame: &Frame| frame.image.parent().unwrap().file_name().unwrap().to_str().unwrap().to_string();
        (views.frames.iter().map(|frame| (folder(frame), frame.camera.resolution)).collect::<Vec<_>>(), views)
    };
    let at = |folder: &str, a, b| vec![(folder.to_string(), a), (folder.to_string(), b)];
    let places = ["images/a.png", "images_2/a.png", "images_4/a.png", "images_8/a.png"];
    let places: Vec<PathBuf> = places.iter().map(|place| desk.path().join(place)).collect();
    let (found, views) = read(&path);
    assert_eq!((found, views.places()), (at("images", [101, 67], [101, 67]), places));
    picture("images_8", "a.png", [13, 8]);
    picture("images_4", "a.png", [25, 17]);
    let (found, views) = read(&path);
    assert_eq!(found, at("images_4", [25, 17], [101, 67]));
    assert!(views.notes[0].ends_with("those in `images_4` are used"), "{:?}", views.notes);
    let camera = views.frames[0].camera;
    assert!(
        (camera.focal[0] - 90.0 * 25.0 / 101.0).abs() < 1e-12 && (camera.focal[1] - 90.0 * 17.0 / 67.0).abs() < 1e-12
    );
    assert!((camera.center[0] - 52.0 * 25.0 / 101.0).abs() < 1e-12);
    // Pictures as large as the file states, and of two sizes.
    picture("images", "a.png", [101, 67]);
    picture("images", "b.png", [50, 33]);
    let (found, views) = read(&path);
    assert_eq!(found, at("images", [101, 67], [50, 33]));
    assert_eq!(views.frames.iter().map(|frame| frame.size).collect::<Vec<_>>(), [[101, 67], [50, 33]]);
    let chosen = desk.path().join("images_8");
    let (found, views) = read(&chosen);
    assert_eq!((found, &views.path), (at("images_8", [13, 8], [101, 67]), &path));
    assert_eq!(Views::files(&chosen), [path]);
}

#[test]
fn a_list_of_coefficients_bends_rays_as_single_keys_do() {
    let lens = |keys: &str| {
        let json = format!(r#"{{"fl_x": 60, "w": 100, "h": 80, {keys}, "frames": [{{{POSE}}}]}}"#);
        read(&json).unwrap().frames[0].camera
    };
    let list = lens(r#""distortion_params": [0.1, -0.02, 0.0, 0.0, 0.003, -0.004]"#);
    assert_eq!(list, lens(r#""k1": 0.1, "k2": -0.02, "p1": 0.003, "p2": -0.004"#));
    assert_eq!(list.distortion, Distortion { k: [0.1, -0.02, 0.0, 0.0], p: [0.003, -0.004] });
    // Higher ones as nerfstudio has them, beside its key for lenses.
    let model = r#""camera_model": "OPENCV""#;
    let list = lens(&format!(r#"{model}, "distortion_params": [0.1, -0.02, 0.05, -0.03, 0.003, -0.004]"#));
    let single = r#""k1": 0.1, "k2": -0.02, "k3": 0.05, "k4": -0.03, "p1": 0.003, "p2": -0.004"#;
    assert_eq!(list, lens(&format!("{model}, {single}")));
    assert_eq!(list.distortion, Distortion { k: [0.1, -0.02, 0.05, -0.03], p: [0.003, -0.004] });
    let of_frame = format!(r#"{{"fl_x": 60, "w": 100, "h": 80, "frames": [{{{model}, {single}, {POSE}}}]}}"#);
    assert_eq!(list, read(&of_frame).unwrap().frames[0].camera);
}

#[test]
fn the_first_of_two_poses_counts_if_the_camera_rests() {
    let start = POSE.replace("transform_matrix", "transform_matrix_start").replace("[1,0,0,1]", "[1,0,0,7]");
    let end = start.replace("_start", "_end");
    let frame = |keys: &str| read(&format!(r#"{{"camera_angle_x": 1, "frames": [{{{POSE}, {start}{keys}}}]}}"#));
    assert_eq!(frame("").unwrap().frames[0].camera.position.x, 7.0);
    assert_eq!(frame(&format!(", {end}")).unwrap().frames[0].camera.position.x, 7.0);
    let moved = end.replace("[1,0,0,7]", "[1,0,0,8]");
    assert!(frame(&format!(", {moved}")).unwrap_err().to_string().contains("`transform_matrix_end`"));
}

#[test]
fn what_a_frame_brings_along_is_kept() {
    let json = format!(
        r#"{{"camera_angle_x": 1, "frames": [{{"file_path": "a.png", "mask_path": "m\\a.png",
            "depth_file_path": "d/a.png", "time": 0, {POSE}}}, {{"file_path": "b.png", "time": 1, {POSE}}}]}}"#
    );
    let (folder, path) = folder(&json, &[("dynamic_mask_b.png", [4, 4])]);
    let views = Views::read(&path, None).unwrap();
    let below = |name: &str| folder.path().join(name);
    assert_eq!(views.frames[0].mask, Some(MaskFile::Kept(below("m/a.png"))));
    assert_eq!(views.frames[1].mask, Some(MaskFile::LeftOut(below("dynamic_mask_b.png"))));
    assert_eq!([&views.frames[0], &views.frames[1]].map(|f| f.depth.clone()), [Some(below("d/a.png")), None]);
    assert_eq!(views.notes, ["frames differ in `time`; the scene is taken to stand still"]);
    std::fs::write(&path, json.replace("{\"camera", "{\"has_mask\": false, \"camera")).unwrap();
    assert_eq!(Views::read(&path, None).unwrap().frames[0].mask, None);
    std::fs::write(below("rays_a.dat"), b"").unwrap();
    assert!(Views::read(&path, None).unwrap_err().to_string().contains("rays_a.dat: rays of a frame"));
}

#[test]
fn a_frame_that_contradicts_its_file_is_told() {
    let json =
        |fl: f64| format!(r#"{{"fl_x": 60, "w": 100, "h": 80, "frames": [{{{POSE}}}, {{"fl_x": {fl}, {POSE}}}]}}"#);
    assert_eq!(read(&json(60.01)).unwrap().notes, [""; 0]);
    let views = read(&json(66.0)).unwrap();
    assert_eq!(views.frames[1].camera.focal, [66.0; 2]);
    assert!(views.notes[0].starts_with("frame 1 states a focal length other than the file's"), "{:?}", views.notes);
    let stretched = r#"{"fl_x": 467, "fl_y": 12692, "w": 100, "h": 80, "frames": ["#;
    let views = read(&format!("{stretched}{{{POSE}}}]}}")).unwrap();
    assert_eq!(views.notes, ["frame 0 has focal lengths of 467 and 12692 pixels, as of pixels that are not square"]);
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
        (&format!("{{\"fl_x\": -5, \"w\": 4, \"h\": 4, \"frames\": [{{{POSE}}}]}}"), "positive"),
        (
            r#"{"camera_angle_x": 1, "frames": [{"transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[1,2,3,1]]}]}"#,
            "[1.0, 2.0, 3.0, 1.0]",
        ),
        (&format!("{{\"camera_angle_x\": 40, \"frames\": [{{{POSE}}}]}}"), "radians"),
        (
            &format!("{{\"fl_x\": 9, \"w\": 4, \"h\": 4, \"camera_angle_y\": -0.5, \"frames\": [{{{POSE}}}]}}"),
            "radians",
        ),
        (&format!("{{\"camera_angle_x\": 1, \"is_fisheye\": true, \"frames\": [{{{POSE}}}]}}"), "`is_fisheye`"),
        (
            &format!("{{\"camera_angle_x\": 1, \"camera_model\": \"EQUIRECTANGULAR\", \"frames\": [{{{POSE}}}]}}"),
            "frame 0 (``), `camera_model`: expected a perspective camera",
        ),
        (
            &format!(
                "{{\"camera_angle_x\": 1, \"frames\": [{{{POSE}}}, {{\"camera_model\": \"OPENCV_FISHEYE\", {POSE}}}]}}"
            ),
            "frame 1 (``), `camera_model`: expected a perspective camera (PINHOLE, SIMPLE_PINHOLE, OPENCV, RADIAL, \
             SIMPLE_RADIAL), found `OPENCV_FISHEYE`",
        ),
        (&format!("{{\"camera_angle_x\": 1, \"ftheta_p0\": 0.1, \"frames\": [{{{POSE}}}]}}"), "found `ftheta_p0`"),
        (&format!("{{\"camera_angle_x\": 1, \"frames\": [{{\"latlong\": true, {POSE}}}]}}"), "found `latlong`"),
        (&format!("{{\"camera_angle_x\": 1, \"w\": 0, \"h\": 3, \"frames\": [{{{POSE}}}]}}"), "found 0 x 3"),
        (&format!("{{\"fl_x\": 5, \"w\": 8, \"frames\": [{{{POSE}}}]}}"), "`w` 8 without `h`"),
        (
            &format!("{{\"camera_angle_x\": 1, \"equirectangular\": true, \"frames\": [{{{POSE}}}]}}"),
            "`equirectangular`",
        ),
        (&format!("{{\"camera_angle_x\": 1, \"orthographic\": false, \"frames\": [{{{POSE}}}]}}"), "`orthographic`"),
        (
            &format!("{{\"camera_angle_x\": 1, \"rolling_shutter\": [0, 0, 1], \"frames\": [{{{POSE}}}]}}"),
            "`rolling_sh",
        ),
        (&format!("{{\"camera_angle_x\": 1, \"from_na\": true, \"frames\": [{{{POSE}}}]}}"), "axes of NeuS2"),
        (&format!("{{\"camera_angle_x\": 1, \"from_mitsuba\": 1, \"frames\": [{{{POSE}}}]}}"), "axes of Mitsuba"),
        (
            &format!("{{\"camera_angle_x\": 1, \"sharpness_discard_threshold\": 0.5, \"frames\": [{{{POSE}}}]}}"),
            "frames that instant-ngp drops",
        ),
        (
            &format!("{{\"camera_angle_x\": 1, \"k1\": -5, \"frames\": [{{{POSE}}}]}}"),
            "expected a lens that leaves every pixel its ray, found k1 -5",
        ),
        (&format!("{{\"camera_angle_x\": 1, \"k3\": 0.1, \"frames\": [{{{POSE}}}]}}"), "found k3 0.1"),
        (
            &format!("{{\"camera_angle_x\": 1, \"camera_model\": \"OPENCV\", \"k5\": 0.1, \"frames\": [{{{POSE}}}]}}"),
            "found k5 0.1",
        ),
        ("[{\"file_path\": \"a\", \"transform\": []}]", "found poses of `ns-export cameras` alone"),
        ("{\"frames\": 3}", "line 1"),
        ("3", "as an object with a list `frames`"),
    ];
    for (json, expected) in cases {
        let error = read(json).expect_err(json).to_string();
        assert!(error.contains(expected) && error.contains("transforms.json"), "{error}");
    }
}

#[test]
fn an_image_that_is_listed_twice_is_told() {
    let frame = |name: &&str| format!(r#"{{"file_path": "{name}", {POSE}}}"#);
    let notes = |names: &[&str]| {
        let frames: Vec<String> = names.iter().map(frame).collect();
        let json = format!(r#"{{"camera_angle_x": 1.0, "w": 100, "h": 50, "frames": [{}]}}"#, frames.join(", "));
        read(&json).unwrap().notes
    };
    assert_eq!(notes(&["a", "b", "", ""]), [""; 0]);
    let said = "frames 0 and 2 are the same image, `a.png`; an image counts as often as it is listed (1 repeated)";
    assert_eq!(notes(&["a", "b", "a.png"]), [said]);
    let said = "frames 0 and 1 are the same image, `a`; an image counts as often as it is listed (2 repeated)";
    assert_eq!(notes(&["a", "a", "a"]), [said]);
}

#[test]
fn an_empty_path_of_a_mask_or_a_depth_map_is_refused() {
    for key in ["mask_path", "depth_file_path"] {
        let frame = format!(r#"{{"file_path": "a", "{key}": " ", {POSE}}}"#);
        let error = read(&format!(r#"{{"camera_angle_x": 1.0, "w": 100, "h": 50, "frames": [{frame}]}}"#)).unwrap_err();
        let said = format!("frame 0 (`a`), `{key}`: expected the path of an image, found an empty one");
        assert!(error.to_string().ends_with(&said), "{error}");
    }
}
