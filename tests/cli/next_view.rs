//! Rankings of views from file to file: of a volume and of splats, and what is refused.

use glam::DVec3;
use octobayes::dataset::{Views, write_transforms};
use octobayes::geometry::Camera;
use serde_json::Value;

use crate::program::{good, run};
use crate::splats::{folder, refused};

const VOLUME: &str = "uncertainty scene:courtyard -o field.oct --level 5 --rays 4000 --resolution 32 --occupancy 32 \
                      --scale data --noise 0.05 --keep-sums";
const SPLATS: &str = "uncertainty scene.ply --cameras transforms.json -o scene.oct --level 5 --rays 6000 \
                      --scale data --noise 0.05 --keep-sums";

fn ranking(folder: &std::path::Path, name: &str) -> Value {
    serde_json::from_str(&std::fs::read_to_string(folder.join(name)).unwrap()).unwrap()
}

/// All but times.
fn figures(mut ranking: Value) -> Value {
    for step in ranking["steps"].as_array_mut().unwrap() {
        step.as_object_mut().unwrap().remove("seconds");
    }
    ranking
}

#[test]
fn a_resolution_is_that_of_the_candidates_too() {
    let folder = folder();
    let folder = folder.path();
    good(folder, VOLUME);
    let rank = |cameras: &str, output: &str| {
        good(folder, &format!("next-view scene:courtyard field.oct --candidates {cameras} --take 2 -o {output}"));
        figures(ranking(folder, output))
    };
    let own = rank("transforms.json", "own.json");
    let asked = rank("transforms.json --resolution 24x20 --chosen next.json", "asked.json");
    let half = rank("transforms.json --resolution 24", "half.json");
    // The same cameras, from a file that has them at half of the size.
    let views = Views::read(&folder.join("transforms.json"), None).unwrap();
    let small: Vec<(String, Camera)> =
        views.frames.iter().map(|frame| (frame.name.clone(), frame.camera.resized([24, 20]))).collect();
    write_transforms(&folder.join("small.json"), &small).unwrap();
    assert_eq!(asked, rank("small.json", "small.ranking.json"));
    assert_eq!(half, asked, "a width keeps the aspect ratio");
    let pixels = |ranking: &Value| {
        let step = &ranking["steps"][0];
        (step["gain"].as_f64().unwrap() / step["gain_per_pixel"].as_f64().unwrap()).round() as u64
    };
    assert_eq!((pixels(&own), pixels(&asked)), (48 * 40, 24 * 20));
    let chosen = Views::read(&folder.join("next.json"), None).unwrap();
    assert!(chosen.frames.len() == 2 && chosen.frames.iter().all(|frame| frame.camera.resolution == [24, 20]));
}

#[test]
fn views_of_splats_are_ranked_from_files_and_made() {
    let folder = folder();
    let folder = folder.path();
    good(folder, SPLATS);
    let rank = |options: &str| {
        good(folder, &format!("next-view scene.ply scene.oct --cameras transforms.json -o r.json {options}"));
        figures(ranking(folder, "r.json"))
    };
    let first = rank("--orbit 8 --take 3 --chosen next.json --map gain.png --threads 1");
    assert_eq!(first, rank("--orbit 8 --take 3 --map gain.exr --threads 2"));
    assert!(folder.join("gain.png").is_file() && folder.join("gain.exr").is_file());
    let gains: Vec<f64> = first["steps"].as_array().unwrap().iter().map(|s| s["gain"].as_f64().unwrap()).collect();
    assert!(gains.len() == 3 && gains[0] >= gains[1] && gains[1] >= gains[2] && gains[2] > 0.0, "{gains:?}");
    // The cameras stand at x > 0; the best view is of the other side.
    let chosen = Views::read(&folder.join("next.json"), None).unwrap();
    assert!(chosen.frames[0].camera.position.x < 0.0, "{:?}", chosen.frames[0].camera);
    // Chosen cameras are candidates of their own; the training cameras tell less than what was not seen.
    let again = rank("--candidates next.json");
    assert_eq!(again["candidates"][0]["gain"], first["steps"][0]["gain"]);
    assert!(rank("--candidates transforms.json")["steps"][0]["gain"].as_f64().unwrap() < gains[0]);
    // On a level circle, around the given axis if there is one.
    for (given, up) in [("", DVec3::Z), ("--up=0,3,-4", DVec3::new(0.0, 0.6, -0.8))] {
        rank(&format!("--orbit 8 {given} --take 8 --pixels 64 --chosen level.json"));
        let level = Views::read(&folder.join("level.json"), None).unwrap().cameras();
        let heights: Vec<f64> = level.iter().map(|camera| camera.position.dot(up)).collect();
        assert!(level.len() > 5 && heights.iter().all(|height| (height - heights[0]).abs() < 1e-9), "{heights:?}");
        assert!(level.iter().all(|camera| camera.axes.x_axis.dot(up).abs() < 1e-9), "{given}");
    }
    refused(
        folder,
        "next-view scene.ply scene.oct --candidates next.json --up 0,0,1 -o x.json",
        &["--up", "--candidates"],
    );
    let trace = rank("--sphere 12 --upper --gain trace --take 2");
    assert_eq!((&trace["gain"], trace["candidates"].as_array().unwrap().len()), (&"trace".into(), 12));
    let coverage = rank("--orbit 8 --gain coverage");
    assert!(coverage["steps"][0]["gain"].as_f64().unwrap() > 0.0);
    assert!(coverage["steps"][0]["unseen"].as_f64().unwrap() > 0.5);
}

#[test]
fn nothing_is_a_gain_of_zero_without_a_sign() {
    let folder = folder();
    let folder = folder.path();
    good(folder, VOLUME);
    let mut views = Views::read(&folder.join("transforms.json"), None).unwrap().cameras();
    views[0].position *= -1.0;
    let named: Vec<(String, Camera)> =
        views.into_iter().enumerate().map(|(i, view)| (format!("c_{i}"), view)).collect();
    write_transforms(&folder.join("away.json"), &named).unwrap();
    for gain in ["logdet", "trace", "coverage"] {
        good(
            folder,
            &format!(
                "next-view scene:courtyard field.oct --candidates away.json --gain {gain} --resolution 24 -o r.json"
            ),
        );
        let text = std::fs::read_to_string(folder.join("r.json")).unwrap();
        assert!(text.contains("\"gain\": 0.0") && !text.contains("-0.0"), "{gain}: {text}");
    }
}

#[test]
fn no_output_replaces_an_image_or_comes_before_a_refusal() {
    let folder = folder();
    let folder = folder.path();
    good(folder, SPLATS);
    std::fs::copy(folder.join("transforms.json"), folder.join("others.json")).unwrap();
    std::fs::write(folder.join("r_1.png"), "a photograph").unwrap();
    let rank = "next-view scene.ply scene.oct -o r.json";
    let cases = [
        ("--cameras transforms.json --orbit 4 --map r_1.png", "an image of --cameras"),
        ("--cameras transforms.json --orbit 4 --chosen r_1.png", "an image of --cameras"),
        ("--candidates transforms.json --map ./r_1.png", "an image of --candidates"),
        ("--cameras others.json --candidates transforms.json --map r_1.png", "an image of --"),
    ];
    for (options, named) in cases {
        refused(folder, &format!("{rank} {options}"), &["the same file as", named]);
    }
    let options = "--cameras transforms.json --orbit 4 --gain coverage --map gain.png";
    refused(folder, &format!("{rank} {options}"), &["map", "`coverage`"]);
    assert!(!folder.join("r.json").exists() && !folder.join("gain.png").exists());
    assert_eq!(std::fs::read_to_string(folder.join("r_1.png")).unwrap(), "a photograph");
}

#[test]
fn what_splats_cannot_be_ranked_by_is_refused_by_name() {
    let folder = folder();
    let folder = folder.path();
    good(folder, SPLATS);
    let rank = "next-view scene.ply scene.oct -o r.json";
    refused(folder, &format!("{rank} --orbit 4"), &["--cameras", "brings no cameras"]);
    refused(
        folder,
        &format!("{rank} --candidates transforms.json --gain coverage"),
        &["--cameras", "brings no cameras"],
    );
    let text = std::fs::read_to_string(folder.join("transforms.json")).unwrap();
    let mut bent: Value = serde_json::from_str(&text).unwrap();
    bent["frames"][1]["k1"] = 0.1.into();
    bent["k1"] = 0.1.into();
    std::fs::write(folder.join("bent.json"), bent.to_string()).unwrap();
    refused(folder, &format!("{rank} --candidates bent.json"), &["cameras of splats", "no lens distortion"]);
    good(folder, "uncertainty scene.ply --cameras transforms.json -o paper.oct --level 5 --rays 6000 --keep-sums");
    let rank = "next-view scene.ply paper.oct --candidates transforms.json -o r.json";
    refused(folder, rank, &["--scale data", "--for next-view"]);
    good(folder, "uncertainty scene.ply --cameras transforms.json -o bare.oct --rays 6000 --scale data --noise 0.05");
    refused(folder, &rank.replace("paper", "bare"), &["--keep-sums", "--for next-view"]);
    // The preset that both name makes a field that can be ranked by, of splats at their own level.
    let preset = "uncertainty scene.ply --cameras transforms.json -o made.oct --rays 6000 --for next-view";
    refused(folder, preset, &["--noise", "10^(-PSNR/20)"]);
    good(folder, &format!("{preset} --noise 0.05"));
    good(folder, &rank.replace("paper", "made").replace("r.json", "ranked.json"));
    assert!(!folder.join("r.json").exists());
}

#[test]
fn candidates_with_the_axes_of_opencv_are_told() {
    let folder = folder();
    let folder = folder.path();
    good(folder, SPLATS);
    let frames = Views::read(&folder.join("transforms.json"), None).unwrap().frames;
    let write = |name: &str, sign: f64| {
        let opencv =
            |camera: Camera| Camera { position: sign * camera.position, ..octobayes::geometry::opencv(&camera) };
        let cameras: Vec<_> = frames.iter().map(|frame| (frame.name.clone(), opencv(frame.camera))).collect();
        write_transforms(&folder.join(name), &cameras).unwrap();
    };
    let rank = |name: &str| format!("next-view scene.ply scene.oct --candidates {name} -o r.json");
    write("away.json", 1.0);
    let expected = [
        "error: --candidates: expected views that tell something; ",
        "OpenCV's camera axes instead of OpenGL's: turned, ",
        "found 4 of 4 candidates: gain 0, looks past the box (r_0, r_1, r_2, …)",
    ];
    refused(folder, &rank("away.json"), &expected);
    assert!(!folder.join("r.json").exists());
    // From the other side they see the model as well, as they do in a room, but upside down.
    write("across.json", -1.0);
    let said = |name: &str| String::from_utf8(run(folder, &rank(name)).stderr).unwrap();
    assert!(said("across.json").contains("warning: the candidates' up axes point down"), "{}", said("across.json"));
    assert!(!said("transforms.json").contains("warning"), "{}", said("transforms.json"));
}

#[test]
fn a_camera_path_serves_as_candidates() {
    let folder = folder();
    let folder = folder.path();
    good(folder, SPLATS);
    let frames = Views::read(&folder.join("transforms.json"), None).unwrap().frames;
    let camera = |frame: &octobayes::dataset::Frame| {
        let Camera { position, axes, focal, resolution, .. } = frame.camera;
        let row = |k: usize| [axes.x_axis[k], axes.y_axis[k], axes.z_axis[k], position[k]];
        let pose: Vec<f64> = [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]].concat();
        let fov = 2.0 * (0.5 * f64::from(resolution[1]) / focal[1]).atan().to_degrees();
        serde_json::json!({ "camera_to_world": pose, "fov": fov, "aspect": 1 })
    };
    let list: Vec<Value> = frames.iter().map(camera).collect();
    let file = serde_json::json!({ "camera_type": "perspective", "render_width": 48, "render_height": 40,
        "camera_path": list });
    std::fs::write(folder.join("camera_path.json"), file.to_string()).unwrap();
    let gains = |name: &str| -> Vec<f64> {
        good(folder, &format!("next-view scene.ply scene.oct --candidates {name} -o r.json"));
        let candidates = ranking(folder, "r.json")["candidates"].as_array().unwrap().clone();
        candidates.iter().map(|candidate| candidate["gain"].as_f64().unwrap()).collect()
    };
    let (path, own) = (gains("camera_path.json"), gains("transforms.json"));
    assert!(path.len() == 4 && path.iter().zip(&own).all(|(a, b)| (a / b - 1.0).abs() < 1e-6), "{path:?} {own:?}");
    refused(folder, "uncertainty scene.ply --cameras camera_path.json --level 4 -o x.oct", &["a camera path, along"]);
}
