//! The whole pipeline on a small mesh: exact data, an ensemble, its uncertainty, and the evaluation.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

use serde_json::Value;

use crate::program::{Desk, OCTAHEDRON, good};

/// A copy of [`MADE`] to work in.
fn desk() -> Desk {
    let desk = Desk::empty();
    let files = format!("{}/.", MADE.display());
    assert!(Command::new("cp").args(["-r", &files, "."]).current_dir(&*desk).status().unwrap().success());
    desk
}

/// An octahedron, and what a hundred steps of training make of it, twice: made once for all tests.
static MADE: LazyLock<PathBuf> = LazyLock::new(|| {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("evaluate");
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir(&folder).unwrap();
    std::fs::write(folder.join("mesh.obj"), OCTAHEDRON).unwrap();
    for args in [
        "synth mesh.obj -o set --count 6 --test-count 2 --resolution 24 --samples-per-pixel 4",
        "train set -o m.safetensors --steps 120 --members 2 --samples-per-step 4096 --log2-hashmap-size 12",
        "uncertainty m-0.safetensors --cameras set/transforms_train.json --level 5 --rays 1200 --gradient auto \
         --keep-sums -o m.oct",
    ] {
        good(&folder, args);
    }
    folder
});

const EVALUATE: &str = "evaluate m-0.safetensors m.oct --cameras set/transforms_test.json --depth set/depth \
    --depth-pattern {}.png --depth-encoding 0,6.5535 --ensemble m-0.safetensors m-1.safetensors";
const DATA: &str =
    "uncertainty m-0.safetensors --level 5 --rays 1200 --gradient auto --scale data --keep-sums -o data.oct";

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|value| value.as_f64().unwrap()).collect()
}

/// The entry of a list that has this name.
fn entry<'a>(list: &'a Value, name: &str) -> &'a Value {
    list.as_array().unwrap().iter().find(|entry| entry["name"] == name).unwrap_or_else(|| panic!("{name}: {list}"))
}

/// A channel of an EXR.
fn channel(path: &Path, name: &str) -> Option<Vec<f32>> {
    let image = exr::prelude::read_first_flat_layer_from_file(path).unwrap();
    let found = image.layer_data.channel_data.list.into_iter().find(|c| c.name.to_string() == name)?;
    Some(found.sample_data.values_as_f32().collect())
}

#[test]
#[ignore = "slow: whole runs as processes"]
fn depths_in_other_units_are_noticed() {
    let desk = desk();
    let encoded = |encoding: &str| EVALUATE.replace("0,6.5535", encoding);
    assert!(!desk.said(EVALUATE).contains("depths are off"));
    // Three quarters of the true depths, which are about 4 in a box of edge 2.
    let said = desk.said(&encoded("0,5"));
    assert!(said.contains("warning: half of the depths are off by more than "), "{said}");
    // Millimetres.
    desk.refused(&encoded("0,6553.5"), &["--depth-encoding"]);
}

/// PSNR, SSIM and coverage need no depth.
#[test]
#[ignore = "slow: whole runs as processes"]
fn photographs_alone_can_be_cleaned_up() {
    let desk = desk();
    let command = "evaluate m-0.safetensors m.oct --cameras set/transforms_test.json --clean-up sheet.png";
    let found = desk.json(command);
    assert_eq!((&found["depth_error"], &found["pixels"]), (&Value::Null, &0.into()));
    assert!(found["psnr"].as_f64().unwrap() > 10.0 && desk.bytes("sheet.png").len() > 1000);
    let with_depth = desk.json(&format!("{EVALUATE} --clean-up other.png"));
    assert_eq!(found["clean_up"], with_depth["clean_up"], "depth changes nothing in it");
    let text = desk.good(command);
    assert!(text.contains("surfaces kept") && !text.contains("AUSE"), "{text}");
}

/// The outputs of one command appear together or not at all.
#[test]
#[cfg(unix)]
#[ignore = "slow: whole runs as processes"]
fn a_disk_that_is_full_at_the_last_file_leaves_no_half_set() {
    let desk = desk();
    let names = ["sheet.png", "plot.svg", "curves.csv"];
    let outputs = "--clean-up sheet.png --plot plot.svg --csv curves.csv --ray-average u-spread,weighted-mean";
    desk.good(&format!("{EVALUATE} {outputs}"));
    let sizes = names.map(|name| desk.bytes(name).len() as u64);
    names.iter().for_each(|name| desk.write(name, "precious"));
    let before = desk.contents();
    // Blocks of 512 bytes: enough for the others, too few for the table, which is the last to be written.
    let blocks = sizes[..2].iter().max().unwrap().div_ceil(512);
    assert!(sizes[2] > 512 * blocks, "{sizes:?}");
    let program = env!("CARGO_BIN_EXE_octobayes");
    let script = format!("trap '' XFSZ; ulimit -f {blocks}; exec {program} {EVALUATE} {outputs}");
    let output = Command::new("sh").args(["-c", &script]).current_dir(&*desk).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && stderr.contains("curves.csv: cannot write"), "{stderr}");
    assert!(desk.contents() == before, "something is left or changed");
}

#[test]
#[ignore = "slow: whole runs as processes"]
fn all_measures_and_the_clean_up_are_in_the_tables() {
    let desk = desk();
    let files = "--clean-up sheet.png --plot plot.svg --csv curves.csv --ray-average weighted-mean,u-spread";
    let text = desk.good(&format!("{EVALUATE} {files} --json"));
    let json: Value = serde_json::from_str(&text).unwrap();
    let rows = ["readings", "baselines"].map(|key| json[key].as_array().unwrap().clone());
    // Three covariances in two averages, the four of one model, and one of the ensemble.
    assert_eq!([rows[0].len(), rows[1].len()], [6, 6]);
    for (row, kind) in rows.iter().flatten().flat_map(|row| ["mae", "mse", "rmse"].map(|kind| (row, kind))) {
        assert!((0.0..1.0).contains(&row["ause_pooled"][kind].as_f64().unwrap()), "{row}");
    }
    let cleaned = json["clean_up"].as_array().unwrap();
    assert_eq!(cleaned.len(), 11);
    assert!(cleaned[0]["threshold"].is_null() && cleaned[0]["coverage"].as_f64().unwrap() > 0.5, "{}", cleaned[0]);
    // Higher thresholds keep more.
    let coverage: Vec<f64> = cleaned[1..].iter().map(|c| c["coverage"].as_f64().unwrap()).collect();
    assert!(coverage.windows(2).all(|w| w[0] <= w[1] + 0.02) && coverage[0] < coverage[9], "{coverage:?}");
    assert!(["sheet.png", "plot.svg", "curves.csv"].iter().all(|file| desk.bytes(file).len() > 1000));
    // Results do not depend on the number of threads, and a person gets the same rows.
    assert_eq!(desk.good(&format!("--threads 1 {EVALUATE} {files} --json")), text);
    let table = desk.good(EVALUATE);
    for row in &rows[1] {
        assert!(table.contains(row["name"].as_str().unwrap()), "{row} is not in\n{table}");
    }
}

/// A field in the scale of its data gives depths a standard deviation; its coverage stands beside that of the ray's
/// weights, and beside that with the training images.
#[test]
#[ignore = "slow: whole runs as processes"]
fn deviations_of_depth_are_calibrated_beside_those_of_the_weights() {
    let desk = desk();
    desk.good(DATA);
    let command = EVALUATE.replace("m.oct", "data.oct --covariance block");
    let found = desk.json(&format!("{command} --plot both.svg"));
    let reading = entry(&found["readings"], "data block, depth deviation");
    let held = |of: &Value| -> Vec<f64> {
        let pairs = of["calibration"]["coverage"].as_array().unwrap().iter();
        pairs.map(|pair| pair[1].as_f64().unwrap()).collect()
    };
    // A model of 120 steps: calibrated it is not, but neither all within nor all outside.
    let of_field = held(reading);
    assert!((0.3..0.999).contains(&of_field[1]), "{of_field:?}");
    assert_eq!(held(entry(&found["baselines"], "ray-weight variance")).len(), of_field.len());
    assert!(["AUCE", "oracle"].iter().all(|curve| desk.text("both.svg").contains(curve)));
    // What it comes to stands first, to people and programs.
    assert_eq!(desk.good(&command).lines().next(), found["verdict"][0].as_str());
    // The training views confirm some depths.
    let share = reading["confirmed"]["share"].as_f64().unwrap();
    assert!((0.05..=1.0).contains(&share), "{}", reading["confirmed"]);
    // With the training images there is another deviation.
    let with_images = desk.json(&format!("{command} --images set"));
    let of_images = held(entry(&with_images["readings"], "data block, depth deviation with images"));
    assert!((0.3..0.999).contains(&of_images[1]) && of_images != of_field, "{of_images:?}");
    assert_eq!(held(entry(&with_images["readings"], "data block, depth deviation")), of_field);
    desk.refused(&format!("{command} --images ."), &["training images", "neither"]);
    // In the paper's scale there is no deviation that could count them.
    desk.refused(&format!("{EVALUATE} --images set"), &["--images", "--for depth"]);
    // The risk is the mean error left: at least the oracle's, and chance's is near the mean error.
    let figure = |name: &str, key: &str| entry(&found["baselines"], name)[key]["mae"].as_f64().unwrap();
    let least = figure("random", "least_risk");
    let mean = found["depth_error"]["mean"].as_f64().unwrap();
    assert!(least < figure("ray-weight variance", "risk") && (figure("random", "risk") / mean - 1.0).abs() < 0.3);
    assert!(figure("weights' spread / rays", "risk") >= least);
    // In the paper's scale there is nothing to calibrate.
    desk.good(&format!("{EVALUATE} --plot one.svg"));
    assert!(!desk.text("one.svg").contains("AUCE"));

    // Pictures, and the channels.
    let render = |more: &str, output: &str| {
        desk.good(&format!("render m-0.safetensors {more} --cameras set/transforms_test.json -o {output}"));
        desk.join(output)
    };
    let [with, without] = [("data.oct --depth-error", "with.png"), ("data.oct", "without.png")]
        .map(|(more, output)| image::image_dimensions(render(more, output)).unwrap().0);
    assert!(with > without, "one panel more");
    let view = render("data.oct --depth-error", "view.exr");
    let values = channel(&view, "depth_error.Z").unwrap();
    let known = values.iter().filter(|s| s.is_finite()).count();
    assert!(known > 50 && values.iter().all(|s| s.is_nan() || *s > 0.0), "{known} of {}", values.len());
    let told = channel(&view, "depth_confirmed.Z").unwrap();
    let count = told.iter().filter(|is| **is == 1.0).count();
    assert!(count > 20 && count < told.len() && told.iter().all(|is| [0.0, 1.0].contains(is)), "{count}");
    assert!(channel(&render("data.oct", "plain.exr"), "depth_confirmed.Z").is_none());
    let paper = "render m-0.safetensors m.oct --depth-error --cameras set/transforms_test.json -o no.png";
    desk.refused(paper, &["--scale data"]);
}

/// The interval that calibration gives holds what it should on the views that it was made on, to one pixel; it goes
/// with the file, and into every answer about depth.
#[test]
#[ignore = "slow: whole runs as processes"]
fn a_calibrated_interval_holds_its_share_and_goes_with_the_field() {
    let desk = desk();
    desk.good(DATA);
    let calibrate = "evaluate m-0.safetensors data.oct --cameras set/transforms_test.json --depth set/depth \
        --depth-pattern {}.png --depth-encoding 0,6.5535 --calibrate cal.oct";
    let found = desk.json(&format!("{calibrate} --probability 0.8"))["calibrated"].clone();
    let [factor, pixels] = ["factor", "pixels"].map(|key| found["conformal"][key].as_f64().unwrap());
    assert!(factor > 0.1 && pixels > 200.0 && found["conformal"]["views"] == 2, "{found}");
    let left_out = numbers(&found["views_left_out"]);
    assert!(left_out[0] <= left_out[2] && left_out.iter().all(|share| (0.3..=1.0).contains(share)), "{left_out:?}");

    let evaluate = EVALUATE.replace("m.oct", "cal.oct");
    let share =
        desk.json(&format!("{evaluate} --covariance diagonal"))["conformal"][0]["share_inside"].as_f64().unwrap();
    // ⌈(n + 1) p⌉ of n.
    assert!((share - ((pixels + 1.0) * 0.8).ceil() / pixels).abs() < 1e-12, "{share} of {pixels}");
    // Of another covariance the deviations are others.
    assert_eq!(desk.json(&format!("{evaluate} --covariance block"))["conformal"], serde_json::json!([]));

    // The same numbers along one ray as in the picture: the ray through the middle of a pixel.
    desk.good("render m-0.safetensors cal.oct --depth-error --cameras set/transforms_test.json -o view.exr");
    let frames: Value = serde_json::from_str(&desk.text("set/transforms_test.json")).unwrap();
    let pose: Vec<Vec<f64>> = serde_json::from_value(frames["frames"][0]["transform_matrix"].clone()).unwrap();
    // Pixel (12, 12) of 24: half a pixel right of the middle and below.
    let focal = 12.0 / (0.5 * frames["camera_angle_x"].as_f64().unwrap()).tan();
    let direction = |axis: usize| (0.5 * pose[axis][0] - 0.5 * pose[axis][1]) / focal - pose[axis][2];
    let ray: Vec<String> = (0..3).map(|k| pose[k][3]).chain((0..3).map(direction)).map(|v| v.to_string()).collect();
    let text = desk.good(&format!("query cal.oct --model m-0.safetensors --ray {}", ray.join(",")));
    let mut lines = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let (head, row) = (lines.next().unwrap(), lines.next().unwrap());
    let value = |name: &str| row[head.iter().position(|h| *h == name).unwrap()].parse::<f64>().unwrap();
    for (name, of_picture) in
        [("median_depth", "depth.Z"), ("depth_error", "depth_error.Z"), ("depth_interval", "depth_interval.Z")]
    {
        let expected = f64::from(channel(&desk.join("view.exr"), of_picture).unwrap()[12 * 24 + 12]);
        // Poses are written with all their digits, channels as f32.
        assert!((value(name) / expected - 1.0).abs() < 1e-4, "{name}: {} against {expected}", value(name));
    }
    assert!((value("depth_interval") / value("depth_error") - factor).abs() < 1e-9);

    // Too few pixels, the paper's scale, and a ray without a model.
    desk.refused(&format!("{calibrate} --probability 0.99999"), &["pixels"]);
    desk.refused(&calibrate.replace("data.oct", "m.oct"), &["--scale data"]);
    desk.refused("query cal.oct --ray 0,0,0,0,0,0 --model m-0.safetensors", &["direction"]);
    desk.refused("query cal.oct --ray 0,0,0,0,0,1", &["required arguments"]);
}

#[test]
#[ignore = "slow: whole runs as processes"]
fn the_object_is_judged_apart_and_alone_in_the_verdict() {
    let desk = desk();
    let run = "evaluate m-0.safetensors m.oct --cameras set/transforms_test.json --training-depth set/depth \
               --depth set/depth --depth-pattern {}.exr --json";
    let report = |options: &str| -> Value { serde_json::from_str(&desk.good(&format!("{run}{options}"))).unwrap() };
    let kinds = |report: &Value| -> Vec<String> {
        report["kinds"].as_array().unwrap().iter().map(|of| of["kind"].as_str().unwrap().to_string()).collect()
    };
    let found = report("");
    let names = kinds(&found);
    assert_eq!(names[..2], ["object", "around"]);
    // All that is shown was seen: that kind has no pixels.
    assert!(names.contains(&"silhouette".to_string()) && !names.contains(&"never seen".to_string()), "{names:?}");
    assert_eq!(found["object_masks"], "set/transforms_test.json");
    // Too few pixels for a verdict, but it is about those of the object.
    let verdict = found["verdict"][0].as_str().unwrap();
    assert!(verdict.contains("pixels of the object"), "{verdict}");
    let text = desk.good(&run.replace(" --json", ""));
    assert!(text.contains("where pixels are") && text.contains("  object "), "{text}");

    // Masks of a folder: here all is object.
    let folder = desk.join("masks");
    std::fs::create_dir(&folder).unwrap();
    for name in ["test_0000", "test_0001"] {
        image::GrayImage::from_pixel(24, 24, image::Luma([255])).save(folder.join(format!("{name}.png"))).unwrap();
    }
    let found = report(" --object-masks masks");
    assert_eq!((&kinds(&found)[0], found["kinds"][0]["share"].as_f64()), (&"object".to_string(), Some(1.0)));
    assert_ne!(kinds(&found)[1], "around");
    std::fs::remove_file(folder.join("test_0001.png")).unwrap();
    desk.refused(
        &format!("{run} --object-masks masks"),
        &["masks of the object: expected a PNG with the name of frame"],
    );
    // All frames have one, or none.
    let cameras = desk.join("set/transforms_test.json");
    let text = std::fs::read_to_string(&cameras).unwrap();
    let line = |line: &&str| !line.contains("objects/test_0001.png");
    std::fs::write(&cameras, text.lines().filter(line).collect::<Vec<_>>().join("\n")).unwrap();
    desk.refused(run, &["frame `images/test_0001.png`: expected a mask of the object for every frame"]);
}
