//! Gaussian splats from file to file: `uncertainty`, `query`, `render`, `export`, and what they refuse.

use std::path::Path;

use glam::{DVec3, Quat, Vec3};
use octobayes::geometry::Camera;
use octobayes::monitor::Silent;
use octobayes::render::Renderer;
use octobayes::splats::{RenderMode, SplatRenderer, Splats};
use octobayes::uncertainty::{UncertaintyField, compare};

use crate::program::{good, run};

const RUN: &str = "uncertainty scene.ply --cameras transforms.json --background black --level 5 --rays 6000";

/// A ball of splats, each moved out by `away` of its number.
fn ball(away: impl Fn(usize) -> f32) -> Splats {
    let count = 900;
    let normal = |i: usize| {
        let z = 1.0 - (2.0 * i as f32 + 1.0) / count as f32;
        let (sin, cos) = (i as f32 * 2.399_963_2).sin_cos();
        Vec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z)
    };
    let splats = Splats::new(
        (0..count).map(|i| (0.7 + away(i)) * normal(i)).collect(),
        vec![Vec3::new(-3.0, -3.1, -4.6); count],
        (0..count).map(|i| Quat::from_rotation_arc(Vec3::Z, normal(i))).collect(),
        (0..count).map(|i| 1.0 + (i % 5) as f32).collect(),
        (0..12 * count).map(|k| ((k * 7) % 11) as f32 / 5.0 - 1.0).collect(),
        1,
        RenderMode::Classic,
    );
    splats.unwrap()
}

/// A ball of splats and four cameras on one side of it, in a folder.
pub fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    ball(|_| 0.0).write_ply(&folder.path().join("scene.ply"), &[], &[]).unwrap();
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
    let said = String::from_utf8(run(folder, &format!("{RUN} -o scene.oct")).stderr).unwrap();
    assert!(said.contains("of the surface that shows was never seen by a training ray"), "{said}");
    let field = UncertaintyField::read(&folder.join("scene.oct")).unwrap();
    // The box is what the cameras see, which the ball fills.
    let longest = field.lattice().domain().size().max_element();
    assert!((1.3..2.0).contains(&longest), "{longest}");

    good(folder, "export scene.ply scene.oct --cameras transforms.json -o scene-u.ply");
    let found = Splats::read(&folder.join("scene-u.ply")).unwrap();
    let column = |name: &str| found.extra(name).unwrap_or_else(|| panic!("column {name}"));
    assert!(found.extra_names().ends_with(&["uncertainty", "log10_uncertainty", "seen", "weight", "views"]));
    let [u, log10, seen, weight, views] = ["uncertainty", "log10_uncertainty", "seen", "weight", "views"].map(column);
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

    // `query` answers as the file does, and by where rays passed.
    let points: String = found.means().iter().map(|x| format!("{},{},{}\n", x.x, x.y, x.z)).collect();
    std::fs::write(folder.join("centres.csv"), points).unwrap();
    let answers = good(folder, "query scene.oct centres.csv");
    let rows: Vec<Vec<&str>> = answers.lines().skip(1).map(|row| row.split(',').collect()).collect();
    for (i, row) in rows.iter().enumerate() {
        assert_eq!((row[8] == "0", row[9] == "unseen"), (seen[i] == 0.0, seen[i] == 0.0), "{row:?}");
    }
    let unseen =
        |keep: &dyn Fn(f32) -> bool| mean(&seen.iter().map(|code| f64::from(*code == 0.0)).collect::<Vec<_>>(), keep);
    assert!(unseen(&|x| x > 0.4) == 0.0 && unseen(&|x| x < -0.4) > 0.7, "{}", unseen(&|x| x < -0.4));

    // The clean-up leaves out what is above its threshold and what was never seen; without cameras there are three
    // columns.
    good(folder, "export scene.ply scene.oct --threshold 80% -o cleaned.ply");
    let cleaned = Splats::read(&folder.join("cleaned.ply")).unwrap();
    assert!(cleaned.len() < found.len() && cleaned.len() > found.len() / 10, "{}", cleaned.len());
    assert!(cleaned.extra_names().ends_with(&["uncertainty", "log10_uncertainty", "seen"]));
    let most = cleaned.extra("log10_uncertainty").unwrap().into_iter().fold(f64::MIN, f64::max);
    assert!((0..found.len()).filter(|&i| log10[i] <= most && seen[i] > 0.0).count() == cleaned.len());

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
    good(folder, &format!("uncertainty samples.npz {bounds} --level 5 -o sums.oct"));
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
    assert_ne!(mip.record().model_checksum, classic.record().model_checksum);
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
        "--pooling auto",
        "--target-error 0.1",
        "--refine density",
    ] {
        refused(folder, &format!("{RUN} {option} -o x.oct"), &[option.split(' ').next().unwrap(), "splats"]);
    }
    refused(folder, "uncertainty scene.ply -o x.oct", &["--cameras", "brings no cameras"]);
    // Splats have no other derivatives than those that `auto` asks for.
    good(folder, &format!("{RUN} --gradient auto -o auto.oct"));
    good(folder, &format!("{RUN} -o scene.oct"));
    let bytes = ["auto.oct", "scene.oct"].map(|name| std::fs::read(folder.join(name)).unwrap());
    assert!(bytes[0] == bytes[1], "the same field");
    let cameras = "--cameras transforms.json";
    refused(
        folder,
        &format!("view scene.ply scene.oct {cameras} --cells 64 -o x.html"),
        &["--cells", "a volume", "64"],
    );
    refused(folder, "view scene.ply scene.oct -o x.png", &["x.png", "`.html`"]);
    refused(folder, "export scene.ply scene.oct --mesh -o x.ply", &["splats"]);
    refused(folder, &format!("export scene.ply scene.oct {cameras} --ellipsoids -o x.ply"), &["--ellipsoids"]);
    refused(folder, &format!("export scene.ply scene.oct {cameras} -o x.csv"), &["splats"]);
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
fn view_shows_splats_with_and_without_cameras() {
    let folder = folder();
    let folder = folder.path();
    good(folder, &format!("{RUN} -o scene.oct"));
    let view = |options: &str| {
        let output = run(folder, &format!("view scene.ply scene.oct {options} -o view.html"));
        let said = [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).to_string());
        assert!(output.status.success(), "{said:?}");
        (said.concat(), std::fs::read_to_string(folder.join("view.html")).unwrap())
    };
    let (said, page) = view("--cameras transforms.json");
    assert!(said.contains("900 of 900 splats") && page.contains("r_3"), "{said}");
    assert!(page.contains("splats-vertex") && !page.contains("id=\"march\""), "a page has one renderer");
    let (said, page) = view("");
    assert!(said.contains("no training cameras") && !page.contains("r_3"), "{said}");
}

/// What three other cameras see of another ball, whose splats lie elsewhere: `transforms_test.json`, images, and depth
/// maps of 16 bits, 1e-4 scene units each.
fn write_held_out(folder: &Path) {
    let truth = ball(|i| if i % 3 == 0 { 0.04 } else { -0.01 });
    let renderer = SplatRenderer::new(&truth, Vec3::ZERO);
    std::fs::create_dir(folder.join("depth")).unwrap();
    let camera = |i: usize| {
        let (sin, cos) = (0.25 + 0.5 * i as f64).sin_cos();
        let eye = DVec3::new(2.2 * cos, 2.2 * sin, 0.4);
        (format!("t_{i}"), Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.8, [48, 40]))
    };
    let cameras: Vec<(String, Camera)> = (0..3).map(camera).collect();
    for (name, camera) in &cameras {
        let view = renderer.image(camera, 0.5, &[], &[], &Silent).unwrap();
        let pixel = |x: u32, y: u32| &view.pixels[(48 * y + x) as usize];
        let image = image::RgbaImage::from_fn(48, 40, |x, y| {
            let [r, g, b] = pixel(x, y).color.to_array().map(|v| (255.0 * v.min(1.0)).round() as u8);
            image::Rgba([r, g, b, if pixel(x, y).opacity > 0.9 { 255 } else { 0 }])
        });
        image.save(folder.join(format!("{name}.png"))).unwrap();
        let depth = |x, y| image::Luma([(1e4 * pixel(x, y).median_depth).round() as u16]);
        let depth: image::ImageBuffer<image::Luma<u16>, Vec<u16>> = image::ImageBuffer::from_fn(48, 40, depth);
        depth.save(folder.join(format!("depth/{name}.png"))).unwrap();
    }
    octobayes::dataset::write_transforms(&folder.join("transforms_test.json"), &cameras).unwrap();
}

const JUDGE: &str = "--cameras transforms_test.json --depth depth --depth-pattern {}.png --depth-encoding 0,6.5535";

#[test]
fn splats_are_judged_like_volumes() {
    let folder = folder();
    let folder = folder.path();
    write_held_out(folder);
    good(folder, &format!("{RUN} --scale data --noise 0.03 --keep-sums --covariance block -o scene.oct"));
    let files = "--plot plot.svg --csv curves.csv --clean-up sheet.png --calibrate calibrated.oct --probability 0.8";
    let report = good(folder, &format!("evaluate scene.ply scene.oct {JUDGE} {files} --json"));
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    let names = |key: &str| -> Vec<String> {
        report[key].as_array().unwrap().iter().map(|row| row["name"].as_str().unwrap().to_string()).collect()
    };
    // Everything that a volume is measured by.
    let baselines = ["ray-weight variance", "weights' spread / sqrt(rays)", "weights' spread / rays", "random"];
    assert_eq!(names("baselines"), baselines);
    assert!(names("readings").contains(&"scene block, depth deviation".to_string()), "{:?}", names("readings"));
    let rows = ["readings", "baselines"].map(|key| report[key].as_array().unwrap().clone()).concat();
    assert!(rows.iter().all(|row| (0.0..1.0).contains(&number(&row["ause_pooled"]["mae"]))));
    // The splats lie 0.01 too far out, or 0.04 too far in.
    let error = number(&report["depth_error"]["median"]);
    assert!((0.003..0.04).contains(&error) && number(&report["psnr"]) > 15.0, "{error}, {}", report["psnr"]);
    for (name, magic) in [("plot.svg", "<svg"), ("curves.csv", "error,"), ("sheet.png", "PNG")] {
        let start = std::fs::read(folder.join(name)).unwrap();
        assert!(String::from_utf8_lossy(&start[..200.min(start.len())]).contains(magic), "{name}");
    }
    let cleaned = report["clean_up"].as_array().unwrap();
    assert!(cleaned.len() == 11 && number(&cleaned[10]["coverage"]) >= number(&cleaned[1]["coverage"]), "{cleaned:?}");

    // A calibrated interval holds what it was counted on: 80 %, to within a pixel.
    let conformal = *UncertaintyField::read(&folder.join("calibrated.oct")).unwrap().conformal().unwrap();
    assert!(conformal.factor > 0.0 && conformal.views == 3, "{conformal:?}");
    let again = good(folder, &format!("evaluate scene.ply calibrated.oct {JUDGE} --covariance block --json"));
    let again: serde_json::Value = serde_json::from_str(&again).unwrap();
    let inside = number(&again["conformal"][0]["share_inside"]);
    assert!((0.8..0.8 + 2.0 / conformal.pixels as f64).contains(&inside), "{inside}");
    // Every third pixel of the same images: neither larger splats nor other colours.
    let strided = good(folder, &format!("evaluate scene.ply scene.oct {JUDGE} --stride 3 --json"));
    let strided: serde_json::Value = serde_json::from_str(&strided).unwrap();
    let [all, some] = [&report, &strided].map(|report| number(&report["psnr"]));
    assert!((all - some).abs() < 1.0, "{all} and {some} dB");
    let output = run(folder, "render scene.ply calibrated.oct --cameras transforms_test.json --depth-error -o x.exr");
    let said = String::from_utf8_lossy(&output.stderr).to_string();
    assert!(output.status.success() && !said.contains("mostly the spread"), "{said}");

    // An ensemble of splats, and what is none.
    ball(|i| 0.002 * (i % 7) as f32).write_ply(&folder.join("other.ply"), &[], &[]).unwrap();
    let with = good(folder, &format!("evaluate scene.ply scene.oct {JUDGE} --ensemble scene.ply other.ply"));
    assert!(with.contains("ensemble depth variance"), "{with}");
    let judge = format!("evaluate scene.ply scene.oct {JUDGE}");
    refused(folder, &format!("{judge} --ensemble scene.ply scene:ball"), &["scene:ball", "splats"]);
    let far = ball(|i| 0.002 * (i % 7) as f32 + 3.0);
    far.write_ply(&folder.join("far.ply"), &[], &[]).unwrap();
    refused(folder, &format!("{judge} --ensemble scene.ply far.ply"), &["box of the member `far.ply`"]);

    // Without the training cameras: what needs them is left out, and named.
    std::fs::rename(folder.join("transforms.json"), folder.join("moved.json")).unwrap();
    let output = run(folder, &judge);
    let [out, said] = [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).to_string());
    assert!(output.status.success() && said.contains("training views confirm is left out"), "{said}");
    assert!(!out.contains("training views see a surface") && out.contains("ray-weight variance"), "{out}");
    refused(folder, &format!("{judge} --training-depth depth"), &["--training-depth", "training cameras"]);
}

/// Masks belong to the cameras by which a field knows what its splats were trained on.
#[test]
fn training_cameras_with_masks_are_recognised() {
    let folder = folder();
    let folder = folder.path();
    write_held_out(folder);
    image::GrayImage::from_fn(48, 40, |x, _| image::Luma([if x < 6 { 0 } else { 255 }]))
        .save(folder.join("mask.png"))
        .unwrap();
    let cameras = folder.join("transforms.json");
    let mut file: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(&cameras).unwrap()).unwrap();
    good(folder, &format!("{RUN} -o plain.oct"));
    file["frames"][2]["mask_path"] = "mask.png".into();
    std::fs::write(&cameras, file.to_string()).unwrap();
    good(folder, &format!("{RUN} -o scene.oct"));
    let judge = format!("evaluate scene.ply scene.oct {JUDGE}");
    // The same cameras without the masks, too.
    for judge in [&judge, &judge.replace("scene.oct", "plain.oct")] {
        let out = good(folder, judge);
        assert!(out.contains("angle to a training view"), "{out}");
    }
    // With another mask they are other cameras.
    file["frames"][1]["mask_path"] = "mask.png".into();
    std::fs::write(&cameras, file.to_string()).unwrap();
    assert!(!good(folder, &judge).contains("angle to a training view"));
}

#[test]
fn splats_too_near_to_be_drawn_are_warned_of() {
    let folder = folder();
    let folder = folder.path();
    let said = |args: &str| String::from_utf8_lossy(&run(folder, args).stderr).to_string();
    assert!(!said(&format!("{RUN} -o scene.oct")).contains("not drawn"));
    // A tenth of the distances: the nearer half of the ball is at 0.15 scene units.
    let small = ball(|_| 0.0);
    let means = small.means().iter().map(|x| 0.1 * *x).collect();
    let scales = small.log_scales().iter().map(|x| *x + 0.1_f32.ln()).collect();
    let count = small.len();
    let rotations = (0..count).map(|i| small.rotation(i)).collect();
    let opacities = (0..count).map(|i| 1.0 + (i % 5) as f32).collect();
    let colors = vec![0.2; 3 * count];
    let small = Splats::new(means, scales, rotations, opacities, colors, 0, RenderMode::Classic).unwrap();
    small.write_ply(&folder.join("small.ply"), &[], &[]).unwrap();
    let cameras = octobayes::dataset::Views::read(&folder.join("transforms.json"), None).unwrap().frames;
    let nearer = |frame: octobayes::dataset::Frame| {
        let position = 0.1 * frame.camera.position;
        (frame.name, Camera { position, ..frame.camera })
    };
    let nearer: Vec<_> = cameras.into_iter().map(nearer).collect();
    octobayes::dataset::write_transforms(&folder.join("near.json"), &nearer).unwrap();
    let args = RUN.replace("scene.ply", "small.ply").replace("transforms.json", "near.json");
    let warning = said(&format!("{args} -o small.oct"));
    assert!(warning.contains("nearer than 0.2 scene units and not drawn"), "{warning}");
}

#[test]
fn cameras_that_see_a_small_part_of_the_splats_are_warned_of() {
    let folder = folder();
    let folder = folder.path();
    let around = |distance: f64, angle: f64| {
        let camera = |i: u32| {
            let (sin, cos) = (angle * f64::from(i)).sin_cos();
            let eye = distance * DVec3::new(cos, sin, 0.3 * cos);
            (format!("r_{i}"), Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.8, [48, 40]))
        };
        let cameras: Vec<_> = (0..12).map(camera).collect();
        octobayes::dataset::write_transforms(&folder.join("around.json"), &cameras).unwrap();
        let args = RUN.replace("transforms.json", "around.json");
        String::from_utf8_lossy(&run(folder, &format!("{args} -o scene.oct")).stderr).to_string()
    };
    let said = around(2.2, 0.5);
    assert!(!said.contains("of the opaque splats lie within"), "{said}");
    // Inside of the ball, where all of them see a part of the other side.
    let said = around(0.55, 0.05);
    assert!(said.contains("of the opaque splats lie within what the cameras see"), "{said}");
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

/// Saves what the cameras see of the ball in front of a grey of this shade.
fn photograph(folder: &Path, shade: f32) {
    let (ball, frames) =
        (ball(|_| 0.0), octobayes::dataset::Views::read(&folder.join("transforms.json"), None).unwrap());
    let renderer = SplatRenderer::new(&ball, Vec3::splat(shade));
    for frame in frames.frames {
        let view = renderer.image(&frame.camera, 0.5, &[], &[], &Silent).unwrap();
        let color = |x: u32, y: u32| view.pixels[(48 * y + x) as usize].color.to_array();
        let byte = |v: f64| (255.0 * v.clamp(0.0, 1.0)).round() as u8;
        let image = image::RgbImage::from_fn(48, 40, |x, y| image::Rgb(color(x, y).map(byte)));
        image.save(folder.join(format!("{}.png", frame.name))).unwrap();
    }
}

#[test]
fn what_lay_behind_splats_is_stated_or_shown_by_images_or_assumed_with_a_note() {
    let folder = folder();
    let folder = folder.path();
    let said = |args: &str| {
        let run_args = "uncertainty scene.ply --cameras transforms.json --views all --level 4 --rays 2000 -o x.oct";
        let output = run(folder, &format!("{run_args} {args}"));
        assert!(output.status.success(), "{output:?}");
        let background = UncertaintyField::read(&folder.join("x.oct")).unwrap().record().background.unwrap();
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).to_string();
        (background, text(&output.stderr), text(&output.stdout))
    };
    let (background, notes, report) = said("--json");
    assert!(background == [1.0; 3] && notes.contains("white is assumed"), "{notes}");
    assert!(report.contains("\"images\":null"), "{report}");
    for (shade, name) in [(0.0, "black"), (1.0, "white")] {
        photograph(folder, shade);
        let (background, notes, report) = said("--json");
        assert_eq!(background, [shade; 3], "{notes}");
        assert!(notes.contains(&format!("{name} lay behind the splats by the images")), "{notes}");
        assert!(notes.contains("note: the splats show the images beside the cameras with"), "{notes}");
        let report: serde_json::Value = serde_json::from_str(&report).unwrap();
        assert!(report["images"]["psnr"].as_f64().unwrap() > 30.0, "{report}");
    }
    // Who states a background is believed, and so is the file of the original code; both together are warned of.
    let (background, notes, _) = said("--background 0.5,0.5,0.5 --force");
    assert!(background == [0.5; 3] && !notes.contains("lay behind"), "{notes}");
    photograph(folder, 0.0);
    std::fs::write(folder.join("cfg_args"), "Namespace(sh_degree=3, white_background=False, eval=True)").unwrap();
    let (background, notes, _) = said("");
    assert!(
        background == [0.0; 3] && notes.contains("cfg_args: black lay behind the splats (--background)"),
        "{notes}"
    );
    let (background, notes, _) = said("--background white --force");
    assert!(background == [1.0; 3] && notes.contains("warning: "), "{notes}");
    assert!(notes.contains("cfg_args: black lay behind the splats in training, but not by --background"), "{notes}");
}

/// The original code writes the size of its images and whether it held out frames.
#[test]
fn cfg_args_say_which_frames_were_trained_on_and_at_which_size() {
    let folder = folder();
    let folder = folder.path();
    let frames = (0..12).map(|i| {
        let (sin, cos) = (0.5 * f64::from(i)).sin_cos();
        let eye = DVec3::new(2.2 * cos, 2.2 * sin, 0.5);
        (format!("r_{i:02}"), Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.8, [48, 40]))
    });
    octobayes::dataset::write_transforms(&folder.join("transforms.json"), &frames.collect::<Vec<_>>()).unwrap();
    photograph(folder, 0.0);
    let said = |settings: &str, args: &str| {
        std::fs::write(folder.join("cfg_args"), format!("Namespace({settings}, white_background=False)")).unwrap();
        let output = run(folder, &format!("{RUN} -o x.oct {args}"));
        assert!(output.status.success(), "{output:?}");
        String::from_utf8_lossy(&output.stderr).to_string()
    };
    let notes = said("eval=True, resolution=-1", "");
    assert!(notes.contains("is held out") && !notes.contains("cfg_args: the splats"), "{notes}");
    let notes = said("eval=False, resolution=1", "");
    assert!(notes.contains("cfg_args: the splats were trained on all frames"), "{notes}");
    assert!(notes.contains("12 cameras of 12 frames") && !notes.contains("held out"), "{notes}");
    let notes = said("resolution=2", "");
    assert!(notes.contains("trained at 24 x 20, but the cameras have 48 x 40 pixels"), "{notes}");
    assert!(notes.contains("--resolution 24x20"), "{notes}");
    let notes = said("resolution=2", "--resolution 24x20");
    assert!(!notes.contains("trained at"), "{notes}");
}
