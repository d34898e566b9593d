//! Gaussian splats from file to file: `uncertainty`, `query`, `render`, `export`, and what they refuse.

use std::path::Path;

use glam::{DVec3, Quat, Vec3};
use octobayes::geometry::Camera;
use octobayes::splats::{RenderMode, Splats};
use octobayes::uncertainty::{UncertaintyField, compare};

use crate::program::{good, run};

const RUN: &str = "uncertainty scene.ply --cameras transforms.json --background black --level 5 --rays 6000";

/// A ball of splats and four cameras on one side of it, in a folder.
pub fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let count = 900;
    let normal = |i: usize| {
        let z = 1.0 - (2.0 * i as f32 + 1.0) / count as f32;
        let (sin, cos) = (i as f32 * 2.399_963_2).sin_cos();
        Vec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z)
    };
    let splats = Splats::new(
        (0..count).map(|i| 0.7 * normal(i)).collect(),
        vec![Vec3::new(-3.0, -3.1, -4.6); count],
        (0..count).map(|i| Quat::from_rotation_arc(Vec3::Z, normal(i))).collect(),
        (0..count).map(|i| 1.0 + (i % 5) as f32).collect(),
        (0..12 * count).map(|k| ((k * 7) % 11) as f32 / 5.0 - 1.0).collect(),
        1,
        RenderMode::Classic,
    );
    splats.unwrap().write_ply(&folder.path().join("scene.ply"), &[], &[]).unwrap();
    let cameras: Vec<(String, Camera)> = (0..4)
        .map(|i| {
            let (sin, cos) = (0.5 * f64::from(i)).sin_cos();
            let eye = DVec3::new(2.2 * cos, 2.2 * sin, 0.5);
            (format!("r_{i}"), Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.8, [48, 40]))
        })
        .collect();
    octobayes::dataset::write_transforms(&folder.path().join("transforms.json"), &cameras).unwrap();
    folder
}

pub fn refused(folder: &Path, args: &str, words: &[&str]) {
    let output = run(folder, args);
    let said = String::from_utf8_lossy(&output.stderr).to_string();
    assert!(output.status.code() == Some(2), "{args}: {said}");
    words.iter().for_each(|word| assert!(said.contains(word), "{args}: {word} in {said}"));
}

#[test]
fn a_run_its_queries_its_pictures_and_the_file_with_columns() {
    let folder = folder();
    let folder = folder.path();
    good(folder, &format!("{RUN} -o scene.oct"));
    let field = UncertaintyField::read(&folder.join("scene.oct")).unwrap();
    // The box is what the cameras see, which the ball fills.
    let longest = field.lattice().domain().size().max_element();
    assert!((1.3..2.0).contains(&longest), "{longest}");

    good(folder, "export scene.ply scene.oct --cameras transforms.json -o scene-u.ply");
    let found = Splats::read(&folder.join("scene-u.ply")).unwrap();
    let column = |name: &str| found.extra(name).unwrap_or_else(|| panic!("column {name}"));
    assert!(found.extra_names().ends_with(&["uncertainty", "log10_uncertainty", "weight", "views"]));
    let [u, log10, weight, views] = ["uncertainty", "log10_uncertainty", "weight", "views"].map(column);
    for i in 0..found.len() {
        let expected = field.query(found.mean(i)).uncertainty;
        assert!((u[i] / expected - 1.0).abs() < 1e-6 && (log10[i] - expected.log10()).abs() < 1e-6);
    }
    // Towards the cameras splats were seen, away from them they were not.
    let towards = |i: &usize| found.mean(*i).dot(Vec3::new(0.7, 0.5, 0.2));
    let mean = |values: &[f64], keep: &dyn Fn(f32) -> bool| {
        let kept: Vec<f64> = (0..found.len()).filter(|i| keep(towards(i))).map(|i| values[i]).collect();
        kept.iter().sum::<f64>() / kept.len() as f64
    };
    let [front, back] = [mean(&weight, &|x| x > 0.4), mean(&weight, &|x| x < -0.4)];
    assert!(front > 20.0 * back, "{front} against {back}");
    assert!(mean(&views, &|x| x > 0.4) > 3.0 && mean(&views, &|x| x < -0.4) < 0.5);
    assert!(mean(&log10, &|x| x > 0.4) < mean(&log10, &|x| x < -0.4) - 0.5);
    let comments = found.comments().join("\n");
    assert!(comments.contains("larger is less certain") && comments.contains("training pixels"), "{comments}");

    // The clean-up leaves out what is above its threshold; without cameras there are two columns.
    good(folder, "export scene.ply scene.oct --threshold 80% -o cleaned.ply");
    let cleaned = Splats::read(&folder.join("cleaned.ply")).unwrap();
    assert!(cleaned.len() < found.len() && cleaned.len() > found.len() / 10, "{}", cleaned.len());
    assert!(cleaned.extra_names().ends_with(&["uncertainty", "log10_uncertainty"]));
    let most = cleaned.extra("log10_uncertainty").unwrap().into_iter().fold(f64::MIN, f64::max);
    assert!(log10.iter().filter(|&&value| value <= most).count() == cleaned.len());

    good(folder, "render scene.ply scene.oct --cameras transforms.json --threshold 80% -o view.png");
    good(folder, "render scene.ply scene.oct --cameras transforms.json --frame 1 -o view.exr");
    assert!(folder.join("view.png").is_file() && folder.join("view.exr").is_file());
    let x = found.mean(0);
    let answer = good(folder, &format!("query scene.oct {},{},{}", x.x, x.y, x.z));
    assert!(answer.contains("log10_uncertainty"), "{answer}");
}

#[test]
fn a_run_equals_the_sums_of_its_dumped_samples() {
    let folder = folder();
    let folder = folder.path();
    let bounds = "--box=-0.8,-0.8,-0.8,0.8,0.8,0.8";
    good(folder, &format!("{RUN} {bounds} --dump-samples samples.npz -o run.oct"));
    good(folder, &format!("accumulate samples.npz {bounds} --level 5 -o sums.oct"));
    let [run, sums] = ["run.oct", "sums.oct"].map(|name| UncertaintyField::read(&folder.join(name)).unwrap());
    let compared = compare(&run, &sums, 5000, 1).unwrap();
    // Both may leave leaves coarser within the tolerance; the sums are the same.
    assert!(compared.in_box.clone().unwrap().max < 1e-5, "{compared:?}");
}

#[test]
fn the_mode_is_part_of_the_model() {
    let folder = folder();
    let folder = folder.path();
    good(folder, &format!("{RUN} --splat-mode mip -o mip.oct"));
    good(folder, &format!("{RUN} -o classic.oct"));
    let [mip, classic] = ["mip.oct", "classic.oct"].map(|name| UncertaintyField::read(&folder.join(name)).unwrap());
    assert_ne!(mip.protocol().origin.model, classic.protocol().origin.model);
    // Each is drawn as it was computed.
    for field in ["mip", "classic"] {
        good(folder, &format!("render scene.ply {field}.oct --cameras transforms.json -o {field}.exr"));
    }
    let [a, b] = ["mip.exr", "classic.exr"].map(|name| std::fs::read(folder.join(name)).unwrap());
    assert_ne!(a, b);
    refused(folder, "uncertainty scene:ball --splat-mode mip -o x.oct --dry-run", &["mode of splats", "scene:ball"]);
}

#[test]
fn what_splats_do_not_have_is_refused_by_name() {
    let folder = folder();
    let folder = folder.path();
    for option in [
        "--gradient finite-difference",
        "--cutoff 1e-6",
        "--occupancy 64",
        "--audit",
        "--memory 1GiB",
        "--target-error 0.1",
        "--refine density",
    ] {
        refused(folder, &format!("{RUN} {option} -o x.oct"), &[option.split(' ').next().unwrap(), "splats"]);
    }
    refused(folder, "uncertainty scene.ply -o x.oct", &["--cameras", "brings no cameras"]);
    good(folder, &format!("{RUN} -o scene.oct"));
    let cameras = "--cameras transforms.json";
    refused(folder, &format!("view scene.ply scene.oct {cameras} -o x.html"), &["scene.ply", "splats"]);
    refused(folder, "export scene.ply scene.oct --mesh -o x.ply", &["splats"]);
    refused(folder, &format!("export scene.ply scene.oct {cameras} --ellipsoids -o x.ply"), &["--ellipsoids"]);
    refused(folder, &format!("export scene.ply scene.oct {cameras} -o x.csv"), &["splats"]);
    refused(folder, &format!("evaluate scene.ply scene.oct {cameras}"), &["scene.ply", "splats"]);
    // Cameras that look away: the likely causes of splats are named.
    let text = std::fs::read_to_string(folder.join("transforms.json")).unwrap();
    let mut value: serde_json::Value = serde_json::from_str(&text).unwrap();
    for frame in value["frames"].as_array_mut().unwrap() {
        for row in frame["transform_matrix"].as_array_mut().unwrap().iter_mut().take(3) {
            for column in [1, 2] {
                row[column] = (-row[column].as_f64().unwrap()).into();
            }
        }
    }
    std::fs::write(folder.join("turned.json"), value.to_string()).unwrap();
    let turned = RUN.replace("transforms.json", "turned.json");
    refused(folder, &format!("{turned} -o x.oct"), &["OpenCV", "normalised", "glTF"]);
    // A field of other splats.
    std::fs::copy(folder.join("scene.ply"), folder.join("other.ply")).unwrap();
    let splats = Splats::read(&folder.join("scene.ply")).unwrap();
    let mut kept = vec![true; splats.len()];
    kept[0] = false;
    splats.keep(&kept).unwrap().write_ply(&folder.join("other.ply"), &[], &[]).unwrap();
    refused(folder, "export other.ply scene.oct -o x.ply", &["checksum", "--force"]);
}

#[test]
fn images_beside_the_cameras_are_compared_with_the_splats() {
    let folder = folder();
    let folder = folder.path();
    good(folder, &format!("{RUN} -o scene.oct"));
    // Pictures of another scene: grey noise.
    let text = std::fs::read_to_string(folder.join("transforms.json")).unwrap();
    for i in 0..4 {
        let noise = image::RgbImage::from_fn(48, 40, |x, y| image::Rgb([((x * 37 + y * 91 + i * 13) % 251) as u8; 3]));
        noise.save(folder.join(format!("r_{i}.png"))).unwrap();
    }
    assert!(text.contains("r_0"), "{text}");
    let output = run(folder, &format!("{RUN} --force -o noisy.oct"));
    let said = String::from_utf8_lossy(&output.stderr).to_string();
    assert!(output.status.success() && said.contains("20 dB would be fair"), "{said}");
    assert!(said.contains("another image size") || said.contains("background"), "{said}");
}
