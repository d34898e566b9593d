use std::fmt::Write;

use glam::DVec3;

use super::*;
use crate::{Purpose, write_transforms};
use octobayes::geometry::Distortion;

/// Cameras that look at the origin from odd places, each with a lens of its own kind.
fn cameras() -> Vec<(String, Camera, Lens)> {
    (0..7_u8)
        .map(|i| {
            let (angle, kind) = (0.9 * f64::from(i) + 0.1, READ[i as usize % READ.len()]);
            let position = 4.0 * DVec3::new(angle.cos(), angle.sin(), 0.3 * angle.cos() - 0.2);
            let mut camera = Camera::look_at(position, DVec3::splat(0.1), DVec3::Z, 0.7, [60 + u32::from(i), 40]);
            camera.center = [29.25 + 0.1 * f64::from(i), 20.125];
            let ([k1, k2, k3], p) = ([0.05, -0.01, 0.03], [2e-3, -1e-3]);
            camera.distortion = match kind {
                0 | 1 => Distortion::default(),
                2 => Distortion { k: [k1, 0.0, 0.0, 0.0], p: [0.0; 2] },
                3 => Distortion { k: [k1, k2, 0.0, 0.0], p: [0.0; 2] },
                4 => Distortion { k: [k1, k2, 0.0, 0.0], p },
                _ => Distortion { k: [k1, k2, k3, 0.0], p },
            };
            if [1, 4, FULL_OPENCV].contains(&kind) {
                camera.focal[1] *= 1.01;
            }
            (format!("picture {i}.png"), camera, Lens(kind))
        })
        .collect()
}

fn parameters(camera: &Camera, lens: Lens) -> Vec<f64> {
    let ([fx, fy], [cx, cy], Distortion { k: [k1, k2, k3, _], p: [p1, p2] }) =
        (camera.focal, camera.center, camera.distortion);
    match lens.0 {
        0 => vec![fx, cx, cy],
        1 => vec![fx, fy, cx, cy],
        2 => vec![fx, cx, cy, k1],
        3 => vec![fx, cx, cy, k1, k2],
        4 => vec![fx, fy, cx, cy, k1, k2, p1, p2],
        _ => vec![fx, fy, cx, cy, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0],
    }
}

/// World to camera with OpenCV's axes: w, x, y, z and a translation.
fn world_to_camera(camera: &Camera) -> [f64; 7] {
    let axes = DMat3::from_cols(camera.axes.x_axis, -camera.axes.y_axis, -camera.axes.z_axis);
    let to_camera = axes.transpose();
    let q = DQuat::from_mat3(&to_camera);
    let t = -(to_camera * camera.position);
    [q.w, q.x, q.y, q.z, t.x, t.y, t.z]
}

/// Both text files, as COLMAP writes them.
fn as_text(cameras: &[(String, Camera, Lens)]) -> [String; 2] {
    let mut lenses =
        "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n".to_string();
    let mut images = "# Image list with two lines of data per image:\n".to_string();
    for (i, (name, camera, lens)) in cameras.iter().enumerate() {
        let numbers = |values: &[f64]| values.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
        let [w, h] = camera.resolution;
        writeln!(lenses, "{} {} {w} {h} {}", i + 5, lens.name(), numbers(&parameters(camera, *lens))).unwrap();
        writeln!(images, "{} {} {} {name}", i + 1, numbers(&world_to_camera(camera)), i + 5).unwrap();
        // Pictures without points have an empty line.
        writeln!(images, "{}", ["", "1.5 2.5 -1 7 8.25 4711"][i % 2]).unwrap();
    }
    [lenses, images]
}

/// Both binary files, as COLMAP writes them.
fn as_binary(cameras: &[(String, Camera, Lens)]) -> [Vec<u8>; 2] {
    let count = (cameras.len() as u64).to_le_bytes();
    let (mut lenses, mut images) = (count.to_vec(), count.to_vec());
    for (i, (name, camera, lens)) in cameras.iter().enumerate() {
        let floats = |values: &[f64]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        lenses.extend((i as u32 + 5).to_le_bytes());
        lenses.extend((lens.0 as i32).to_le_bytes());
        lenses.extend(camera.resolution.iter().flat_map(|&n| u64::from(n).to_le_bytes()));
        lenses.extend(floats(&parameters(camera, *lens)));
        images.extend((i as u32 + 1).to_le_bytes());
        images.extend(floats(&world_to_camera(camera)));
        images.extend((i as u32 + 5).to_le_bytes());
        images.extend(name.as_bytes());
        images.push(0);
        let points = (i % 3) as u64;
        images.extend(points.to_le_bytes());
        images.extend((0..24 * points).map(|b| b as u8));
    }
    [lenses, images]
}

fn write(folder: &Path, extension: &str, [cameras, images]: [&[u8]; 2]) {
    std::fs::create_dir_all(folder).unwrap();
    std::fs::write(folder.join(format!("cameras.{extension}")), cameras).unwrap();
    std::fs::write(folder.join(format!("images.{extension}")), images).unwrap();
}

#[test]
fn text_and_binary_are_the_cameras_of_a_transforms_json() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let cameras = cameras();
    let named: Vec<_> = cameras.iter().map(|(name, camera, _)| (name.clone(), *camera)).collect();
    write_transforms(&path("transforms.json"), &named).unwrap();
    let [lenses, images] = as_text(&cameras);
    write(&path("text"), "txt", [lenses.as_bytes(), images.as_bytes()]);
    let [lenses, images] = as_binary(&cameras);
    write(&path("project/sparse/0"), "bin", [&lenses, &images]);

    let expected = Views::read(&path("transforms.json"), None).unwrap();
    for name in
        ["text", "text/cameras.txt", "text/images.txt", "project", "project/sparse", "project/sparse/0/images.bin"]
    {
        let views = Views::read(&path(name), None).unwrap();
        assert_eq!((views.frames.len(), views.resolution_source), (7, ResolutionSource::File), "{name}");
        for (frame, other) in views.frames.iter().zip(&expected.frames) {
            assert_eq!((&frame.name, frame.camera.resolution), (&other.name, other.camera.resolution));
            // Rays through corners and middle: pose and lens in one. The distance of origins is at most 4.
            for pixel in [[0.0, 0.0], [60.0, 40.0], [31.5, 7.25]] {
                let [a, b] = [&frame.camera, &other.camera].map(|camera| camera.ray(pixel[0], pixel[1]));
                let off = (a.origin - b.origin).length().max((a.direction - b.direction).length());
                assert!(off < 1e-12, "{name}, {}: off by {off:e}", frame.name);
            }
        }
    }
    // Of another size: focal lengths and principal points are scaled, as for a transforms.json.
    let [a, b] = ["text", "transforms.json"].map(|name| Views::read(&path(name), Some([30, 20])).unwrap());
    for (a, b) in a.frames.iter().zip(&b.frames) {
        assert!((a.camera.focal[0] - b.camera.focal[0]).abs() < 1e-12 && a.camera.center == b.camera.center);
    }
}

#[test]
fn pictures_are_found_beside_the_model_or_above_it() {
    let desk = tempfile::tempdir().unwrap();
    let cameras = cameras();
    let [lenses, images] = as_binary(&cameras);
    for (model, pictures) in [("a/sparse/0", "a/images"), ("b/sparse", "b/images"), ("c", "c/images"), ("d", "d")] {
        write(&desk.path().join(model), "bin", [&lenses, &images]);
        std::fs::create_dir_all(desk.path().join(pictures)).unwrap();
        std::fs::write(desk.path().join(pictures).join("picture 3.png"), "").unwrap();
        let views = Views::read(&desk.path().join(model), None).unwrap();
        assert_eq!(views.frames[3].image, desk.path().join(pictures).join("picture 3.png"), "{model}");
    }
}

#[test]
fn smaller_copies_of_the_pictures_can_be_chosen_and_are_better_than_none() {
    let desk = tempfile::tempdir().unwrap();
    let scene = desk.path().join("scene");
    let cameras = cameras();
    let [lenses, images] = as_binary(&cameras);
    write(&scene.join("sparse/0"), "bin", [&lenses, &images]);
    let picture = |folder: &str, [w, h]: [u32; 2]| {
        std::fs::create_dir_all(scene.join(folder)).unwrap();
        image::GrayImage::new(w, h).save(scene.join(folder).join("picture 1.png")).unwrap();
    };
    let read = |path: &Path| {
        let views = Views::read(path, None).unwrap();
        let Frame { image, size, camera, .. } = views.frames[1].clone();
        assert_eq!(camera, {
            let (_, own, _) = &cameras[1];
            Camera { position: camera.position, axes: camera.axes, ..own.resized(size) }
        });
        (image.strip_prefix(&scene).unwrap().to_path_buf(), size, views.notes)
    };
    picture("images_4", [15, 10]);
    picture("images_2", [31, 20]);
    let resized = |size: &str| {
        format!("cameras are resized to their pictures (1 of 1): `picture 1.png` has {size} pixels, its camera 61 x 40")
    };
    let note = "no picture is in `images`; those in `images_2` are used".to_string();
    for path in [scene.clone(), scene.join("sparse/0")] {
        let expected = ("images_2/picture 1.png".into(), [31, 20], vec![note.clone(), resized("31 x 20")]);
        assert_eq!(read(&path), expected);
    }
    picture("images", [61, 40]);
    assert_eq!(read(&scene), ("images/picture 1.png".into(), [61, 40], Vec::new()));
    let chosen = scene.join("images_4");
    assert_eq!(read(&chosen), ("images_4/picture 1.png".into(), [15, 10], vec![resized("15 x 10")]));
    assert_eq!(read(&scene.join("images")), read(&scene));
    // The same files, so that nothing is written over them.
    assert_eq!(Views::files(&chosen), Views::files(&scene));
    // Another folder is none of pictures.
    std::fs::create_dir(scene.join("imagery")).unwrap();
    assert!(Views::read(&scene.join("imagery"), None).is_err());
}

#[test]
fn what_is_wrong_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let [lenses, images] = as_text(&cameras()[..1]);
    let refused = |lenses: &str, images: &str| {
        write(folder.path(), "txt", [lenses.as_bytes(), images.as_bytes()]);
        Views::read(folder.path(), None).unwrap_err().to_string()
    };
    let perspective =
        "expected a perspective camera (SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV, FULL_OPENCV)";
    for (_, (name, parameters)) in MODELS.iter().enumerate().filter(|(kind, _)| !READ.contains(kind)) {
        let other = format!("5 {name} 60 40{}\n", " 0.5".repeat(*parameters));
        let error = refused(&other, &images);
        let expected = format!("cameras.txt: camera 5, model: {perspective}, found {name}");
        assert!(error.ends_with(&expected), "{error}");
        // It does no harm if no image was taken by it.
        let both = format!("{lenses}{}", other.replacen('5', "6", 1));
        write(folder.path(), "txt", [both.as_bytes(), images.as_bytes()]);
        assert_eq!(Views::read(folder.path(), None).unwrap().frames.len(), 1, "{name}");
    }
    let error = refused("5 FULL_OPENCV 60 40 80 80 30 20 0.1 0 0 0 0.2 0 0.3 0", &images);
    let expected = "cameras.txt: camera 5, parameters: expected FULL_OPENCV that does not divide, k4 = k5 = k6 = 0; \
                    `colmap image_undistorter` makes pinholes of others, found k4 0, k5 0.3, k6 0";
    assert!(error.ends_with(expected), "{error}");
    let error = refused(&lenses.replace("SIMPLE_PINHOLE", "PINHOLES"), &images);
    assert!(error.ends_with("found PINHOLES"), "{error}");
    let cases = [
        (lenses.replace(" 60 40 ", " 60 "), images.clone(), "cameras.txt: line 3"),
        (lenses.replace(" 60 40 ", " 0 40 "), images.clone(), "cameras.txt: camera 5, image size"),
        (lenses.replace(" 60 40 ", " 14204 10652 "), images.clone(), "image size: expected sides from 1 to 65536"),
        (lenses.replace(" 60 40 ", " 60 40 -"), images.clone(), "cameras.txt: camera 5, parameters"),
        (format!("{lenses}{lenses}"), images.clone(), "camera 5: expected a number of its own"),
        (lenses.replacen("\n5 ", "\n6 ", 1), images.clone(), "image `picture 0.png`, camera: expected a camera"),
        (lenses.clone(), String::new(), "images.txt: images: expected at least one image"),
        (lenses.clone(), images.replacen("\n1 ", "\n1 9", 1), "image `picture 0.png`, pose: expected a rotation"),
        (lenses.clone(), images.replace(" 5 picture 0.png", ""), "images.txt: line 2"),
        (lenses.clone(), images.replace("png\n", "png\n1 2\n"), "images.txt: line 3: expected the points"),
    ];
    for (lenses, images, expected) in cases {
        let error = refused(&lenses, &images);
        assert!(error.contains(expected), "{expected}: {error}");
    }
    let [lenses, images] = as_binary(&cameras());
    // A number that COLMAP does not have.
    let mut unknown = lenses.clone();
    unknown[12] = 99;
    let Err(complaint) = binary::cameras(&unknown) else { panic!("an unknown lens") };
    assert_eq!((complaint.place.as_str(), complaint.found.as_str()), ("camera 5, model", "99"));
    // Numbers that promise more than there is.
    let mut many = images.clone();
    many[..8].fill(0xff);
    let Err(complaint) = binary::images(&many) else { panic!("too many images") };
    assert!(complaint.found.contains("end of the file"), "{}", complaint.found);
    assert!(binary::images(&[&images[..], &[0]].concat()).is_err());
}

#[test]
fn a_large_sensor_is_read_at_a_smaller_size() {
    let folder = tempfile::tempdir().unwrap();
    let [_, images] = as_text(&cameras()[..1]);
    write(folder.path(), "txt", [b"5 SIMPLE_PINHOLE 14204 10652 12000 7102 5326\n", images.as_bytes()]);
    let camera = Views::read(folder.path(), Some([1420, 1065])).unwrap().frames[0].camera;
    assert!((camera.focal[0] - 12000.0 * 1420.0 / 14204.0).abs() < 1e-9, "{camera:?}");
    assert_eq!((camera.center, camera.resolution), ([710.0, 532.5], [1420, 1065]));
}

#[test]
fn the_role_of_a_line_does_not_depend_on_how_many_words_it_has() {
    // A name with two spaces makes an image line of twelve words; so does a line of four points.
    let cameras: Vec<_> = cameras().into_iter().map(|(name, c, lens)| (format!("my own  {name}"), c, lens)).collect();
    let [lenses, images] = as_text(&cameras);
    let folder = tempfile::tempdir().unwrap();
    let is_image = |line: &&str| line.contains("my own");
    let without_points: String = images.lines().filter(is_image).map(|line| format!("{line}\n")).collect();
    for (images, ending) in [(&images, "\n"), (&without_points, "\n"), (&without_points, "\r\n")] {
        let images = images.replace('\n', ending);
        write(folder.path(), "txt", [lenses.as_bytes(), images.as_bytes()]);
        let frames = Views::read(folder.path(), None).unwrap().frames;
        let names: Vec<&str> = frames.iter().map(|frame| frame.name.as_str()).collect();
        assert_eq!(names, cameras.iter().map(|(name, ..)| name.as_str()).collect::<Vec<_>>());
        assert!(frames.iter().enumerate().all(|(i, frame)| frame.index == i));
    }
}

#[test]
fn models_of_undistorted_pictures_are_models_too() {
    for dense in ["dense/sparse", "dense/0/sparse", "undistorted/sparse"] {
        let folder = tempfile::tempdir().unwrap();
        let put = |name: &str, count: usize| {
            let [lenses, images] = as_binary(&cameras()[..count]);
            write(&folder.path().join(name), "bin", [&lenses, &images]);
        };
        put(dense, 5);
        assert_eq!(Views::read(folder.path(), None).unwrap().frames.len(), 5, "{dense}");
        // The lenses of the pictures as they were taken are others.
        put("sparse/0", 2);
        let error = Views::read(folder.path(), None).unwrap_err().to_string();
        let found = format!("sparse/0/images.bin with 2 images; {dense}/images.bin with 5 images");
        assert!(error.contains(&found), "{error}");
        assert_eq!(Views::read(&folder.path().join(dense), None).unwrap().frames.len(), 5, "{dense}");
    }
}

#[test]
fn several_models_are_refused_with_the_number_of_their_images() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let put = |name: &str, count: usize| {
        let [lenses, images] = as_binary(&cameras()[..count]);
        write(&path(name), "bin", [&lenses, &images]);
    };
    put("sparse/0", 2);
    assert_eq!(Views::read(folder.path(), None).unwrap().frames.len(), 2);
    put("sparse/1", 5);
    let error = Views::read(folder.path(), None).unwrap_err().to_string();
    assert!(error.contains("sparse/0/images.bin with 2 images; sparse/1/images.bin with 5 images"), "{error}");
    assert_eq!(Views::files(folder.path()).len(), 4);
    for (name, count) in [("sparse/1", 5), ("sparse/0/cameras.bin", 2)] {
        assert_eq!(Views::read(&path(name), None).unwrap().frames.len(), count, "{name}");
    }
    // Also models in folders with names.
    put("sparse/geo", 3);
    let error = Views::read(folder.path(), None).unwrap_err().to_string();
    assert!(error.contains("sparse/1/images.bin with 5 images; sparse/geo/images.bin with 3 images"), "{error}");
    std::fs::remove_dir_all(path("sparse/geo")).unwrap();
    // Text beside binary is one model, unless it has other images.
    let [lenses, images] = as_text(&cameras()[..5]);
    write(&path("sparse/1"), "txt", [lenses.as_bytes(), images.as_bytes()]);
    assert_eq!(Views::read(&path("sparse/1"), None).unwrap().frames.len(), 5);
    let [lenses, images] = as_text(&cameras()[..4]);
    write(&path("sparse/1"), "txt", [lenses.as_bytes(), images.as_bytes()]);
    let error = Views::read(&path("sparse/1"), None).unwrap_err().to_string();
    assert!(error.contains("images.bin with 5 images; images.txt with 4 images"), "{error}");
}

#[test]
fn lists_of_training_images_beside_the_pictures_count() {
    let folder = tempfile::tempdir().unwrap();
    let [lenses, images] = as_binary(&cameras());
    write(&folder.path().join("sparse/0"), "bin", [&lenses, &images]);
    std::fs::create_dir(folder.path().join("images")).unwrap();
    std::fs::write(folder.path().join("images/picture 3.png"), "").unwrap();
    std::fs::write(folder.path().join("train_list.txt"), "picture 0.png\npicture 4.png\n").unwrap();
    let frames = Views::read(folder.path(), None).unwrap().frames;
    let training: Vec<usize> =
        frames.iter().filter(|frame| frame.purpose == Some(Purpose::Training)).map(|frame| frame.index).collect();
    assert_eq!(training, [0, 4]);
}

/// Points of a model, the file that has them as text, and as binary.
fn points() -> (Vec<ScenePoint>, String, Vec<u8>) {
    let points: Vec<ScenePoint> = (0..5_u8)
        .map(|i| ScenePoint { position: DVec3::new(0.1, -7.5, 1e4) * f64::from(i), color: [i, 255 - i, 128] })
        .collect();
    let (mut text, mut binary) = ("# 3D point list\n".to_string(), 5_u64.to_le_bytes().to_vec());
    for (i, ScenePoint { position: p, color: [r, g, b] }) in points.iter().enumerate() {
        // As many images as the point's index show it.
        let track = (0..i).map(|k| format!(" {k} {}", 7 * k)).collect::<String>();
        writeln!(text, "{} {} {} {} {r} {g} {b} 0.75{track}", 100 * i, p.x, p.y, p.z).unwrap();
        binary.extend((100 * i as u64).to_le_bytes());
        binary.extend(p.to_array().iter().flat_map(|v| v.to_le_bytes()));
        binary.extend([*r, *g, *b]);
        binary.extend(0.75_f64.to_le_bytes());
        binary.extend((i as u64).to_le_bytes());
        binary.extend((0..2 * i as u32).flat_map(u32::to_le_bytes));
    }
    (points, text, binary)
}

#[test]
fn points_are_read_from_text_and_binary() {
    let folder = tempfile::tempdir().unwrap();
    let (expected, text, binary) = points();
    let [lenses, images] = as_text(&cameras());
    write(&folder.path().join("text"), "txt", [lenses.as_bytes(), images.as_bytes()]);
    let [lenses, images] = as_binary(&cameras());
    write(&folder.path().join("p/sparse/0"), "bin", [&lenses, &images]);
    for name in ["text", "text/images.txt", "p", "p/sparse/0/cameras.bin"] {
        assert_eq!(scene_points(&folder.path().join(name)).unwrap(), [], "{name}");
    }
    std::fs::write(folder.path().join("text/points3D.txt"), &text).unwrap();
    std::fs::write(folder.path().join("p/sparse/0/points3D.bin"), &binary).unwrap();
    for name in ["text", "text/images.txt", "p", "p/sparse/0/cameras.bin"] {
        assert_eq!(scene_points(&folder.path().join(name)).unwrap(), expected, "{name}");
    }
    assert_eq!(scene_points(&folder.path().join("transforms.json")).unwrap(), []);
}

#[test]
fn damaged_points_are_refused_with_their_place() {
    let (_, text, binary) = points();
    for end in 0..binary.len() {
        assert!(binary::points(&binary[..end]).is_err(), "{end}");
    }
    let mut many = binary.clone();
    many[0] = 255;
    // The number of images of the first point.
    many[59 - 8..59].fill(255);
    for (file, place) in [(&many, "point at index 0"), (&[&binary[..], &[0]].concat(), "end")] {
        assert_eq!(binary::points(file).unwrap_err().place, place);
    }
    let mut infinite = binary.clone();
    infinite[16..24].copy_from_slice(&f64::NAN.to_le_bytes());
    assert_eq!(binary::points(&infinite).unwrap_err().expected, "a finite position");
    for (from, to) in [("0.75", ""), ("255", "256"), ("-7.5", "inf"), ("100 ", "x ")] {
        let found = text::points(&text.replacen(from, to, 1));
        // What stands behind the colour is not read.
        assert_eq!(found.is_err(), from != "0.75", "{from}");
    }
    assert_eq!(text::points(&text.replacen("-7.5", "inf", 1)).unwrap_err().place, "line 3");
}
