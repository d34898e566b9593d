//! Rankings of views from file to file: of a volume and of splats, and what is refused.

use glam::DVec3;
use octobayes::geometry::{Camera, opencv};
use octobayes_data::{Views, write_transforms};
use serde_json::Value;

use crate::program::Desk;
use crate::splats::desk;

const VOLUME: &str = "uncertainty scene:courtyard -o field.oct --level 5 --rays 4000 --resolution 32 --occupancy 32 \
                      --scale data --noise 0.05 --keep-sums";
const SPLATS: &str = "uncertainty scene.ply --cameras transforms.json -o scene.oct --level 5 --rays 6000 \
                      --scale data --noise 0.05 --keep-sums";
const RANK: &str = "next-view scene.ply scene.oct -o r.json";

/// The ranking that a command writes, but for times.
fn ranked(desk: &Desk, args: &str) -> Value {
    desk.good(args);
    let mut ranking: Value = serde_json::from_str(&desk.text("r.json")).unwrap();
    for step in ranking["steps"].as_array_mut().unwrap() {
        step.as_object_mut().unwrap().remove("seconds");
    }
    ranking
}

fn with_splats() -> Desk {
    let desk = desk();
    desk.good(SPLATS);
    desk
}

/// The cameras of a file, in another file after a change.
fn changed(desk: &Desk, to: &str, change: impl Fn(Camera) -> Camera) {
    let frames = Views::read(&desk.join("transforms.json"), None).unwrap().frames;
    let cameras: Vec<_> = frames.into_iter().map(|frame| (frame.name, change(frame.camera))).collect();
    write_transforms(&desk.join(to), &cameras).unwrap();
}

#[test]
fn a_resolution_is_that_of_the_candidates_too() {
    let desk = desk();
    desk.good(VOLUME);
    let rank = |cameras: &str| {
        ranked(&desk, &format!("next-view scene:courtyard field.oct --candidates {cameras} --take 2 -o r.json"))
    };
    let own = rank("transforms.json");
    let asked = rank("transforms.json --resolution 24x20 --chosen next.json");
    // The same cameras, from a file that has them at half of the size.
    changed(&desk, "small.json", |camera| camera.resized([24, 20]));
    assert_eq!(asked, rank("small.json"));
    assert_eq!(rank("transforms.json --resolution 24"), asked, "a width keeps the aspect ratio");
    let pixels = |ranking: &Value| {
        let step = &ranking["steps"][0];
        (step["gain"].as_f64().unwrap() / step["gain_per_pixel"].as_f64().unwrap()).round() as u64
    };
    assert_eq!((pixels(&own), pixels(&asked)), (48 * 40, 24 * 20));
    let chosen = Views::read(&desk.join("next.json"), None).unwrap();
    assert!(chosen.frames.len() == 2 && chosen.frames.iter().all(|frame| frame.camera.resolution == [24, 20]));
}

#[test]
fn views_of_splats_are_ranked_from_files_and_made() {
    let desk = with_splats();
    let rank = |options: &str| ranked(&desk, &format!("{RANK} --cameras transforms.json {options}"));
    let first = rank("--orbit 8 --take 3 --chosen next.json --map gain.png --threads 1");
    assert_eq!(first, rank("--orbit 8 --take 3 --map gain.exr --threads 2"));
    assert!(desk.join("gain.png").is_file() && desk.join("gain.exr").is_file());
    let gains: Vec<f64> = first["steps"].as_array().unwrap().iter().map(|s| s["gain"].as_f64().unwrap()).collect();
    assert!(gains.len() == 3 && gains[0] >= gains[1] && gains[1] >= gains[2] && gains[2] > 0.0, "{gains:?}");
    // The cameras stand at x > 0; the best view is of the other side.
    let chosen = Views::read(&desk.join("next.json"), None).unwrap();
    assert!(chosen.frames[0].camera.position.x < 0.0, "{:?}", chosen.frames[0].camera);
    // Chosen cameras are candidates of their own; the training cameras tell less than what was not seen.
    let again = rank("--candidates next.json");
    assert_eq!(again["candidates"][0]["gain"], first["steps"][0]["gain"]);
    assert!(rank("--candidates transforms.json")["steps"][0]["gain"].as_f64().unwrap() < gains[0]);
    // On a level circle, around the given axis if there is one.
    for (given, up) in [("", DVec3::Z), ("--up=0,3,-4", DVec3::new(0.0, 0.6, -0.8))] {
        rank(&format!("--orbit 8 {given} --take 8 --pixels 64 --chosen level.json"));
        let level = Views::read(&desk.join("level.json"), None).unwrap().cameras();
        let heights: Vec<f64> = level.iter().map(|camera| camera.position.dot(up)).collect();
        assert!(level.len() > 5 && heights.iter().all(|height| (height - heights[0]).abs() < 1e-9), "{heights:?}");
        assert!(level.iter().all(|camera| camera.axes.x_axis.dot(up).abs() < 1e-9), "{given}");
    }
    desk.refused(&format!("{RANK} --candidates next.json --up 0,0,1"), &["--up", "--candidates"]);
    let trace = rank("--sphere 12 --upper --gain trace --take 2");
    assert_eq!((&trace["gain"], trace["candidates"].as_array().unwrap().len()), (&"trace".into(), 12));
    let coverage = rank("--orbit 8 --gain coverage");
    assert!(coverage["steps"][0]["gain"].as_f64().unwrap() > 0.0);
    assert!(coverage["steps"][0]["unseen"].as_f64().unwrap() > 0.5);
}

#[test]
fn nothing_is_a_gain_of_zero_without_a_sign() {
    let desk = desk();
    desk.good(VOLUME);
    // One camera looks away from the other side.
    let turn = |camera: Camera| Camera { position: -camera.position, ..camera };
    changed(&desk, "away.json", |camera| if camera.position.y.abs() < 1e-9 { turn(camera) } else { camera });
    for gain in ["logdet", "trace", "coverage"] {
        let rank = "next-view scene:courtyard field.oct --candidates away.json --resolution 24 -o r.json";
        desk.good(&format!("{rank} --gain {gain}"));
        let text = desk.text("r.json");
        assert!(text.contains("\"gain\": 0.0") && !text.contains("-0.0"), "{gain}: {text}");
    }
}

#[test]
fn no_output_replaces_an_image_or_comes_before_a_refusal() {
    let desk = with_splats();
    std::fs::copy(desk.join("transforms.json"), desk.join("others.json")).unwrap();
    desk.write("r_01.png", "a photograph");
    for (options, named) in [
        ("--cameras transforms.json --orbit 4 --map r_01.png", "an image of --cameras"),
        ("--cameras transforms.json --orbit 4 --chosen r_01.png", "an image of --cameras"),
        ("--candidates transforms.json --map ./r_01.png", "an image of --candidates"),
        ("--cameras others.json --candidates transforms.json --map r_01.png", "an image of --"),
    ] {
        desk.refused(&format!("{RANK} {options}"), &["the same file as", named]);
    }
    let options = "--cameras transforms.json --orbit 4 --gain coverage --map gain.png";
    desk.refused(&format!("{RANK} {options}"), &["map", "`coverage`"]);
}

#[test]
fn what_splats_cannot_be_ranked_by_is_refused_by_name() {
    let desk = with_splats();
    desk.refused(&format!("{RANK} --orbit 4"), &["--cameras", "brings no cameras"]);
    desk.refused(&format!("{RANK} --candidates transforms.json --gain coverage"), &["--cameras", "brings no cameras"]);
    let mut bent: Value = serde_json::from_str(&desk.text("transforms.json")).unwrap();
    bent["frames"][1]["k1"] = 0.1.into();
    bent["k1"] = 0.1.into();
    desk.write("bent.json", bent.to_string());
    desk.refused(&format!("{RANK} --candidates bent.json"), &["cameras of splats", "no lens distortion"]);
    let run = "uncertainty scene.ply --cameras transforms.json --rays 6000 -o";
    desk.good(&format!("{run} paper.oct --level 5 --keep-sums"));
    desk.good(&format!("{run} bare.oct --scale data --noise 0.05"));
    let rank = |field: &str| format!("{} --candidates transforms.json", RANK.replace("scene.oct", field));
    desk.refused(&rank("paper.oct"), &["--scale data", "--for next-view"]);
    desk.refused(&rank("bare.oct"), &["--keep-sums", "--for next-view"]);
    // The preset that both name makes a field that can be ranked by, of splats at their own level.
    desk.refused(&format!("{run} made.oct --for next-view"), &["--noise", "10^(-PSNR/20)"]);
    desk.good(&format!("{run} made.oct --for next-view --noise 0.05"));
    desk.good(&rank("made.oct"));
}

#[test]
fn candidates_with_the_axes_of_opencv_are_told() {
    let desk = with_splats();
    let rank = |name: &str| format!("{RANK} --candidates {name}");
    changed(&desk, "away.json", |camera| opencv(&camera));
    desk.refused(&rank("away.json"), &["--candidates", "OpenCV's camera axes", "4 of 4", "looks past the box"]);
    // From the other side they see the model as well, as they do in a room, but upside down.
    changed(&desk, "across.json", |camera| Camera { position: -camera.position, ..opencv(&camera) });
    assert!(desk.said(&rank("across.json")).contains("warning: the candidates' up axes point down"));
    assert!(!desk.said(&rank("transforms.json")).contains("warning"));
}

#[test]
fn a_plan_is_a_page_and_what_is_missing_is_computed() {
    let desk = desk();
    let plan = "next-view scene.ply --cameras transforms.json --noise 0.05 --orbit 8 --take 2 --metres-per-unit 2";
    desk.good(&format!("{plan} -o plan.html --chosen next.json"));
    let page = desk.text("plan.html");
    assert_eq!((page.matches("<section>").count(), page.matches("<img ").count()), (2, 4));
    assert!(page.contains("chosen from 8 places on a circle") && page.contains(" m to the "), "words and metres");
    // The field lies beside it, and serves the ranking for programs.
    let ranking =
        ranked(&desk, &format!("{RANK} --cameras transforms.json --orbit 8 --take 2").replace("scene.oct", "plan.oct"));
    for step in ranking["steps"].as_array().unwrap() {
        assert!(page.contains(step["name"].as_str().unwrap()));
    }
    // The viewer shows the planned cameras, of the page as of the camera file.
    let planned = |file: &str| {
        desk.good(&format!("view scene.ply plan.oct --cameras transforms.json --plan {file} -o view.html"));
        let view = desk.text("view.html");
        let about = view.split_once("id=\"about\">").unwrap().1.split_once("</script>").unwrap().0;
        let about: Value = serde_json::from_str(about).unwrap();
        let planned = about["cameras"].as_array().unwrap().iter().filter(|camera| camera["isPlanned"] == true);
        planned.map(|camera| camera["position"].clone()).collect::<Vec<_>>()
    };
    let of_page = planned("plan.html");
    assert!(of_page.len() == 2 && of_page == planned("next.json"));
    desk.refused("view scene.ply plan.oct --plan view.html -o x.html", &["view.html", "next-view -o PLAN.html"]);
    desk.refused("next-view scene.ply plan.oct --noise 0.05 --candidates next.json -o x.json", &["--noise", "FIELD"]);
    desk.refused("next-view scene.ply plan.oct --candidates next.json -o x.txt", &[".html", ".json"]);
    desk.refused("next-view scene.ply plan.oct --candidates next.json -o x.html", &["--cameras", "brings no cameras"]);
}

#[test]
fn a_volume_s_own_cameras_are_enough_for_a_plan() {
    let desk = Desk::empty();
    desk.good("next-view scene:courtyard --resolution 32 --noise 0.05 --near 20 --pixels 256 --take 2 -o plan.html");
    let page = desk.text("plan.html");
    assert!(page.matches("<section>").count() == 2 && page.contains("near those of the photographs"));
    assert!(desk.join("plan.oct").is_file());
}

#[test]
fn only_the_object_counts() {
    let desk = with_splats();
    let rank = |options: &str| ranked(&desk, &format!("{RANK} --cameras transforms.json --orbit 8 {options}"));
    let all = rank("");
    assert_eq!(all, rank("--object=-9,-9,-9,9,9,9"), "a box around everything");
    let gains = |ranking: &Value| -> Vec<f64> {
        ranking["candidates"].as_array().unwrap().iter().map(|one| one["gain"].as_f64().unwrap()).collect()
    };
    let (of_all, lower) = (gains(&all), gains(&rank("--object=-1,-1,-1,1,1,-0.05")));
    assert!(lower.iter().zip(&of_all).all(|(a, b)| a < b) && lower.iter().sum::<f64>() > 0.0, "{lower:?} {of_all:?}");
    // Parts that share no vertex add up, as a vertex counts once.
    let upper = gains(&rank("--object=-1,-1,-0.05000001,1,1,1"));
    let sums = lower.iter().zip(&upper).zip(&of_all).map(|((a, b), all)| (a + b) / all);
    assert!(sums.into_iter().all(|share| (share - 1.0).abs() < 1e-9), "{upper:?}");
    // A mesh: what is near to its surface.
    desk.write("part.obj", "v 0.6 -0.2 -0.2\nv 0.6 0.2 -0.2\nv 0.6 0 0.2\nf 1 2 3\n");
    let near = gains(&rank("--object part.obj"));
    assert!(near.iter().zip(&of_all).all(|(a, b)| a < b) && near.iter().sum::<f64>() > 0.0, "{near:?}");
    let refused = |object: &str, words: &[&str]| {
        desk.refused(&format!("{RANK} --cameras transforms.json --orbit 8 --object {object}"), words);
    };
    desk.write("far.obj", "v 50 0 0\nv 50 1 0\nv 50 0 1\nf 1 2 3\n");
    refused("far.obj", &["far.obj", "in the field's domain"]);
    refused("none.obj", &["none.obj"]);
    // Nobody sees it.
    refused("5,5,5,6,6,6", &["candidates", "views that add something"]);
}

#[test]
fn photographs_that_were_not_used_are_candidates() {
    let desk = with_splats();
    let mut file: Value = serde_json::from_str(&desk.text("transforms.json")).unwrap();
    for (k, frame) in file["frames"].as_array_mut().unwrap().iter_mut().enumerate() {
        frame["file_path"] = format!("{}/r_{k}.png", if k == 3 { "left" } else { "images" }).into();
    }
    file["train_filenames"] = serde_json::json!(["images/r_0.png", "images/r_1.png"]);
    file["test_filenames"] = serde_json::json!(["images/r_2.png", "left/r_3.png"]);
    desk.write("split.json", file.to_string());
    for folder in ["images", "left"] {
        std::fs::create_dir(desk.join(folder)).unwrap();
    }
    let image = image::RgbImage::new(48, 40);
    for name in ["images/r_0", "images/r_1", "images/r_2", "left/r_3"] {
        image.save(desk.join(format!("{name}.png"))).unwrap();
    }
    desk.write("all.txt", "r_0\nr_2.png\n\nleft/r_3.png\n");
    let rank = "next-view scene.ply scene.oct --cameras split.json -o r.json";
    let names = |unused: &str| -> Vec<String> {
        let ranking = ranked(&desk, &format!("{rank} --unused {unused} --take 4"));
        ranking["candidates"].as_array().unwrap().iter().map(|one| one["name"].as_str().unwrap().into()).collect()
    };
    assert_eq!(names("all.txt"), ["images/r_2.png", "left/r_3.png"], "those of the training are left out");
    assert_eq!(names("left"), ["left/r_3.png"]);
    assert_eq!(names("images"), ["images/r_2.png"]);
    desk.write("wrong.txt", "r_2\nr_9\n");
    desk.refused(&format!("{rank} --unused wrong.txt"), &["wrong.txt", "r_9"]);
    desk.write("used.txt", "r_0\n");
    desk.refused(&format!("{rank} --unused used.txt"), &["--unused", "it used 1 of those"]);
}

#[test]
fn a_camera_path_serves_as_candidates() {
    let desk = with_splats();
    let frames = Views::read(&desk.join("transforms.json"), None).unwrap().frames;
    let camera = |frame: &octobayes_data::Frame| {
        let Camera { position, axes, focal, resolution, .. } = frame.camera;
        let row = |k: usize| [axes.x_axis[k], axes.y_axis[k], axes.z_axis[k], position[k]];
        let pose: Vec<f64> = [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]].concat();
        let fov = 2.0 * (0.5 * f64::from(resolution[1]) / focal[1]).atan().to_degrees();
        serde_json::json!({ "camera_to_world": pose, "fov": fov, "aspect": 1 })
    };
    let list: Vec<Value> = frames.iter().map(camera).collect();
    let file = serde_json::json!({ "camera_type": "perspective", "render_width": 48, "render_height": 40,
        "camera_path": list });
    desk.write("camera_path.json", file.to_string());
    let gains = |name: &str| -> Vec<f64> {
        let ranking = ranked(&desk, &format!("{RANK} --candidates {name}"));
        let candidates = ranking["candidates"].as_array().unwrap().iter();
        candidates.map(|candidate| candidate["gain"].as_f64().unwrap()).collect()
    };
    let (path, own) = (gains("camera_path.json"), gains("transforms.json"));
    assert!(path.len() == 4 && path.iter().zip(&own).all(|(a, b)| (a / b - 1.0).abs() < 1e-6), "{path:?} {own:?}");
    desk.refused("uncertainty scene.ply --cameras camera_path.json --level 4 -o x.oct", &["a camera path"]);
}
