//! The whole pipeline on a small mesh: exact data, an ensemble, its uncertainty, and the evaluation.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

use serde_json::Value;

use crate::program::{good, outcome, run};

/// A copy of [`MADE`] to work in.
fn desk() -> tempfile::TempDir {
    fn copy(from: &Path, to: &Path) {
        for entry in std::fs::read_dir(from).unwrap() {
            let (path, to) = entry.map(|entry| (entry.path(), to.join(entry.file_name()))).unwrap();
            if path.is_dir() {
                std::fs::create_dir(&to).unwrap();
                copy(&path, &to);
            } else {
                std::fs::copy(&path, &to).unwrap();
            }
        }
    }
    let folder = tempfile::tempdir().unwrap();
    copy(&MADE, folder.path());
    folder
}

/// An octahedron, and what a hundred steps of training make of it, twice: made once for all tests.
static MADE: LazyLock<PathBuf> = LazyLock::new(made);

fn made() -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("evaluate");
    if folder.exists() {
        std::fs::remove_dir_all(&folder).unwrap();
    }
    std::fs::create_dir(&folder).unwrap();
    let mut mesh = String::new();
    for v in ["1 0 0", "-1 0 0", "0 1 0", "0 -1 0", "0 0 1", "0 0 -1"] {
        mesh += &format!("v {v}\n");
    }
    for [a, b, c] in [[1, 3, 5], [3, 2, 5], [2, 4, 5], [4, 1, 5], [3, 1, 6], [2, 3, 6], [4, 2, 6], [1, 4, 6]] {
        mesh += &format!("f {a} {b} {c}\n");
    }
    std::fs::write(folder.join("mesh.obj"), mesh).unwrap();
    good(&folder, "synth mesh.obj -o set --count 6 --test-count 2 --resolution 24 --samples-per-pixel 4");
    good(
        &folder,
        "train set -o m.safetensors --steps 120 --members 2 --samples-per-step 4096 \
         --log2-hashmap-size 12",
    );
    good(
        &folder,
        "uncertainty m-0.safetensors --cameras set/transforms_train.json --level 5 --rays 1200 --gradient auto \
         --keep-sums -o m.oct",
    );
    folder
}

const EVALUATE: &str = "evaluate m-0.safetensors m.oct --cameras set/transforms_test.json --depth set/depth \
    --depth-pattern {}.png --depth-encoding 0,6.5535 --ensemble m-0.safetensors m-1.safetensors";

#[test]
#[ignore = "slow: whole runs as processes"]
fn depths_in_other_units_are_noticed() {
    let desk = desk();
    let run = |encoding: &str| {
        let args = EVALUATE.replace("0,6.5535", encoding);
        let (code, _, said) = outcome(desk.path(), &args);
        (code, said)
    };
    let (code, said) = run("0,6.5535");
    assert!(code == Some(0) && !said.contains("depths are off"), "{said}");
    // Three quarters of the true depths, which are about 4 in a box of edge 2.
    let (code, said) = run("0,5");
    assert!(code == Some(0) && said.contains("warning: half of the depths are off by more than "), "{said}");
    // Millimetres.
    let (code, said) = run("0,6553.5");
    assert!(code == Some(2) && said.contains("--depth-encoding"), "{said}");
}

/// PSNR, SSIM and coverage need no depth.
#[test]
#[ignore = "slow: whole runs as processes"]
fn photographs_alone_can_be_cleaned_up() {
    let desk = desk();
    let command = "evaluate m-0.safetensors m.oct --cameras set/transforms_test.json --clean-up";
    let json = good(desk.path(), &format!("{command} sheet.png --json"));
    let found: Value = serde_json::from_str(&json).unwrap();
    assert_eq!((&found["depth_error"], &found["pixels"]), (&Value::Null, &0.into()));
    assert!(found["psnr"].as_f64().unwrap() > 10.0);
    assert!(std::fs::metadata(desk.path().join("sheet.png")).unwrap().len() > 1000);
    let with_depth = good(desk.path(), &format!("{EVALUATE} --clean-up other.png --json"));
    let with_depth: Value = serde_json::from_str(&with_depth).unwrap();
    assert_eq!(found["clean_up"], with_depth["clean_up"], "depth changes nothing in it");
    let text = good(desk.path(), &format!("{command} sheet.png"));
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
    good(desk.path(), &format!("{EVALUATE} {outputs}"));
    let sizes = names.map(|name| std::fs::metadata(desk.path().join(name)).unwrap().len());
    for name in names {
        std::fs::write(desk.path().join(name), "precious").unwrap();
    }
    let count = || std::fs::read_dir(desk.path()).unwrap().count();
    let before = count();
    // Blocks of 512 bytes: enough for the others, too few for the table, which is the last to be written.
    let blocks = sizes[..2].iter().max().unwrap().div_ceil(512);
    assert!(sizes[2] > 512 * blocks, "{sizes:?}");
    let program = env!("CARGO_BIN_EXE_octobayes");
    let script = format!("trap '' XFSZ; ulimit -f {blocks}; exec {program} {EVALUATE} {outputs}");
    let output = Command::new("sh").args(["-c", &script]).current_dir(desk.path()).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && stderr.contains("curves.csv: cannot write"), "{stderr}");
    for name in names {
        assert_eq!(std::fs::read(desk.path().join(name)).unwrap(), b"precious", "{name}");
    }
    assert_eq!(count(), before, "nothing else is left");
}

#[test]
#[ignore = "slow: whole runs as processes"]
fn all_measures_and_the_clean_up_are_in_the_tables() {
    let desk = desk();
    let run = |more: &str| good(desk.path(), &format!("{EVALUATE} {more}"));
    let text = run("--clean-up sheet.png --json --plot plot.svg --csv curves.csv --ray-average weighted-mean,u-spread");
    let json: Value = serde_json::from_str(&text).unwrap();
    let names = |key: &str| -> Vec<String> {
        json[key].as_array().unwrap().iter().map(|e| e["name"].as_str().unwrap().to_string()).collect()
    };
    let readings = ["diagonal", "trace", "block"];
    let expected: Vec<String> =
        readings.iter().flat_map(|r| [format!("m {r}, weighted-mean"), format!("m {r}, u-spread")]).collect();
    assert_eq!(names("readings"), expected);
    let baselines = [
        "ray-weight variance",
        "weights' spread / sqrt(rays)",
        "weights' spread / rays",
        "random",
        "ensemble depth variance",
    ];
    assert_eq!(names("baselines"), baselines);
    for entry in json["readings"].as_array().unwrap().iter().chain(json["baselines"].as_array().unwrap()) {
        for kind in ["mae", "mse", "rmse"] {
            let area = entry["ause_pooled"][kind].as_f64().unwrap();
            assert!((0.0..1.0).contains(&area), "{entry}");
        }
    }
    let cleaned = json["clean_up"].as_array().unwrap();
    assert_eq!(cleaned.len(), 11);
    assert!(cleaned[0]["threshold"].is_null() && cleaned[0]["coverage"].as_f64().unwrap() > 0.5, "{}", cleaned[0]);
    // Higher thresholds keep more.
    let coverage: Vec<f64> = cleaned[1..].iter().map(|c| c["coverage"].as_f64().unwrap()).collect();
    assert!(coverage.windows(2).all(|w| w[0] <= w[1] + 0.02) && coverage[0] < coverage[9], "{coverage:?}");
    for file in ["sheet.png", "plot.svg", "curves.csv"] {
        assert!(std::fs::metadata(desk.path().join(file)).unwrap().len() > 1000, "{file}");
    }
    // Results do not depend on the number of threads.
    let one = good(
        desk.path(),
        &format!("--threads 1 {EVALUATE} --ray-average weighted-mean,u-spread --clean-up sheet.png --json"),
    );
    assert_eq!(text, one);
    // The same, human-readable.
    let table = run("");
    for name in baselines.iter().chain(&["m diagonal", "m block", "without a Hessian"]) {
        assert!(table.contains(name), "{name} is not in\n{table}");
    }
}

/// A field in the scale of its data gives depths a standard deviation; its coverage stands beside that of the ray's
/// weights, which know nothing of the training images.
#[test]
#[ignore = "slow: whole runs as processes"]
fn deviations_of_depth_are_calibrated_beside_those_of_the_weights() {
    let desk = desk();
    good(
        desk.path(),
        "uncertainty m-0.safetensors --level 5 --rays 1200 --gradient auto --scale data --keep-sums -o data.oct",
    );
    let command = EVALUATE.replace("m.oct", "data.oct --covariance block");
    let found: Value = serde_json::from_str(&good(desk.path(), &format!("{command} --json --plot both.svg"))).unwrap();
    let calibration = |part: &str, name: &str| {
        let entries = found[part].as_array().unwrap();
        entries.iter().find(|entry| entry["name"] == name).unwrap()["calibration"].clone()
    };
    let posterior = calibration("readings", "data block, depth deviation");
    let weights = calibration("baselines", "ray-weight variance");
    let held = |of: &Value| {
        of["densities"][2]["coverage"].as_array().unwrap().iter().map(|p| p[1].as_f64().unwrap()).collect::<Vec<_>>()
    };
    // √(Var + s²) is wider than s, for every pixel.
    let (posterior, weights) = (held(&posterior), held(&weights));
    assert!(posterior.iter().zip(&weights).all(|(wide, narrow)| wide >= narrow), "{posterior:?} and {weights:?}");
    // A model of 120 steps: calibrated it is not, but neither all within nor all outside.
    assert!((0.3..0.999).contains(&posterior[1]), "{posterior:?}");
    let both = std::fs::read_to_string(desk.path().join("both.svg")).unwrap();
    for curve in ["depth deviation (AUCE 0.", "depth deviation (AUSE 0.", "oracle", "what it should be"] {
        assert!(both.contains(curve), "{curve}");
    }
    let text = good(desk.path(), &command);
    // What it comes to stands first: two views are too few.
    assert!(text.starts_with("No verdict: "), "{text}");
    assert_eq!(text.lines().next(), found["verdict"][0].as_str());
    assert!(text.contains("errors of depth within") && text.contains("deviation of the ray's weights"), "{text}");
    // The training views confirm some depths. Their line has the coverage of the JSON.
    let entries = found["readings"].as_array().unwrap();
    let confirmed = &entries.iter().find(|entry| entry["name"] == "data block, depth deviation").unwrap()["confirmed"];
    let share = confirmed["share"].as_f64().unwrap();
    assert!((0.05..=1.0).contains(&share), "{confirmed}");
    let mut lines = text.lines().skip_while(|line| !line.contains("where 3 training views see a surface"));
    assert!(lines.next().unwrap().contains(&format!("{:.1} % of the pixels", 100.0 * share)), "{text}");
    let of_them = held(&confirmed["calibration"]);
    let line = lines.next().unwrap();
    assert!(of_them.iter().all(|p| line.contains(&format!("{:.1} %", 100.0 * p))), "{line}, {of_them:?}");
    // With images, the part on whose colour they agree has its line, too.
    let with_images = "uncertainty m-0.safetensors --level 5 --rays 1200 --gradient auto --scale data --images set \
        -o images.oct";
    good(desk.path(), with_images);
    let command = EVALUATE.replace("m.oct", "images.oct");
    let shown: Value = serde_json::from_str(&good(desk.path(), &format!("{command} --json"))).unwrap();
    let entries = shown["readings"].as_array().unwrap();
    let of_images = entries.iter().find(|entry| entry["name"] == "images diagonal, depth deviation").unwrap();
    let [seen, agreed] = ["confirmed", "photo_consistent"].map(|part| of_images[part]["share"].as_f64().unwrap());
    assert!((0.0..=seen).contains(&agreed) && seen == share, "{agreed} of {seen}, {share}");
    assert!(found["readings"].as_array().unwrap().iter().all(|entry| entry.get("photo_consistent").is_none()));
    let text_of_images = good(desk.path(), &command);
    let mut lines = text_of_images.lines().skip_while(|line| !line.contains("and training images agree on its colour"));
    assert!(lines.next().unwrap().contains(&format!("{:.1} % of the pixels", 100.0 * agreed)), "{text_of_images}");
    // The risk is the mean error left: at least the oracle's, and chance's is near the mean error.
    let figures = |part: &str, key: &str| -> Vec<(String, f64)> {
        let entries = found[part].as_array().unwrap().iter();
        entries.map(|e| (e["name"].as_str().unwrap().into(), e[key]["mae"].as_f64().unwrap())).collect()
    };
    let risks = figures("baselines", "risk");
    let least = figures("baselines", "least_risk")[0].1;
    let risk = |name: &str| risks.iter().find(|(found, _)| found == name).unwrap().1;
    let mean = found["depth_error"]["mean"].as_f64().unwrap();
    assert!(least < risk("ray-weight variance") && (risk("random") / mean - 1.0).abs() < 0.3, "{risks:?}, {mean}");
    assert!(risk("weights' spread / rays") >= least, "{risks:?}");
    let row = text.lines().find(|line| line.trim_start().starts_with("random")).unwrap();
    assert!(row.contains(&format!(" {:.5} ", risk("random"))) && text.contains(&format!(" {least:.5} ")), "{text}");
    // In the paper's scale there is nothing to calibrate.
    assert!(!good(desk.path(), &format!("{EVALUATE} --plot one.svg")).contains("errors of depth within"));
    assert!(!std::fs::read_to_string(desk.path().join("one.svg")).unwrap().contains("AUCE"));

    // Pictures, and the channel.
    let render = |more: &str| {
        let args = format!("render m-0.safetensors {more} --cameras set/transforms_test.json");
        run(desk.path(), &args)
    };
    assert!(render("data.oct --depth-error -o view.exr").status.success());
    assert!(render("data.oct --depth-error -o with.png").status.success());
    assert!(render("data.oct -o without.png").status.success());
    let image = exr::prelude::read_first_flat_layer_from_file(desk.path().join("view.exr")).unwrap();
    let channel = image.layer_data.channel_data.list.iter().find(|c| c.name.to_string() == "depth_error.Z").unwrap();
    let values: Vec<f32> = channel.sample_data.values_as_f32().collect();
    let known = values.iter().filter(|s| s.is_finite()).count();
    assert!(known > 50 && values.iter().all(|s| s.is_nan() || *s > 0.0), "{known} of {}", values.len());
    let channel = |file: &str, name: &str| -> Option<Vec<f32>> {
        let image = exr::prelude::read_first_flat_layer_from_file(desk.path().join(file)).unwrap();
        let found = image.layer_data.channel_data.list.into_iter().find(|c| c.name.to_string() == name)?;
        Some(found.sample_data.values_as_f32().collect())
    };
    let confirmed = |file: &str| channel(file, "depth_confirmed.Z");
    // The same pixels as the evaluation counts, of one view; none without the deviation.
    let told = confirmed("view.exr").unwrap();
    let count = told.iter().filter(|is| **is == 1.0).count();
    assert!(count > 20 && count < told.len() && told.iter().all(|is| [0.0, 1.0].contains(is)), "{count}");
    assert!(render("data.oct -o plain.exr").status.success() && confirmed("plain.exr").is_none());
    // How differently images show what is shown, with the deviation and of fields that know it.
    assert!(channel("view.exr", "color_spread.V").is_none());
    assert!(render("images.oct -o plain.exr").status.success() && channel("plain.exr", "color_spread.V").is_none());
    assert!(render("images.oct --depth-error -o images.exr").status.success());
    let [spread, opacity] = ["color_spread.V", "A"].map(|name| channel("images.exr", name).unwrap());
    assert!(spread.iter().filter(|v| !v.is_nan()).count() > 20, "{spread:?}");
    assert!(spread.iter().zip(&opacity).all(|(v, a)| v.is_nan() || *a > 0.0 && (0.0..=1.0).contains(v)));
    let width = |name: &str| image::image_dimensions(desk.path().join(name)).unwrap().0;
    assert!(width("with.png") > width("without.png"), "one panel more");
    let refused = render("m.oct --depth-error -o no.png");
    let said = String::from_utf8(refused.stderr).unwrap();
    assert!(
        refused.status.code() == Some(2) && said.contains("--scale data: expected a field computed with it"),
        "{said}"
    );
}

/// The interval that calibration gives holds what it should on the views that it was made on, to one pixel; it goes
/// with the file, and into every answer about depth.
#[test]
#[ignore = "slow: whole runs as processes"]
fn a_calibrated_interval_holds_its_share_and_goes_with_the_field() {
    let desk = desk();
    let run = |args: &str| run(desk.path(), args);
    good(
        desk.path(),
        "uncertainty m-0.safetensors --level 5 --rays 1200 --gradient auto --scale data --keep-sums -o data.oct",
    );
    let calibrate = "evaluate m-0.safetensors data.oct --cameras set/transforms_test.json --depth set/depth \
        --depth-pattern {}.png --depth-encoding 0,6.5535 --calibrate cal.oct";
    let found: Value =
        serde_json::from_str(&good(desk.path(), &format!("{calibrate} --probability 0.8 --json"))).unwrap();
    let found = &found["calibrated"];
    let (factor, pixels) =
        (found["conformal"]["factor"].as_f64().unwrap(), found["conformal"]["pixels"].as_f64().unwrap());
    assert!(factor > 0.1 && pixels > 200.0 && found["conformal"]["views"] == 2, "{found}");
    let left_out: Vec<f64> =
        found["views_left_out"].as_array().unwrap().iter().map(|share| share.as_f64().unwrap()).collect();
    assert!(left_out[0] <= left_out[2] && left_out.iter().all(|share| (0.3..=1.0).contains(share)), "{left_out:?}");

    let evaluate = EVALUATE.replace("m.oct", "cal.oct");
    let json: Value =
        serde_json::from_str(&good(desk.path(), &format!("{evaluate} --covariance diagonal --json"))).unwrap();
    let share = json["conformal"][0]["share_inside"].as_f64().unwrap();
    // ⌈(n + 1) p⌉ of n.
    assert!((share - ((pixels + 1.0) * 0.8).ceil() / pixels).abs() < 1e-12, "{share} of {pixels}");
    // Of another covariance the deviations are others.
    let other: Value =
        serde_json::from_str(&good(desk.path(), &format!("{evaluate} --covariance block --json"))).unwrap();
    assert_eq!(other["conformal"].as_array().unwrap().len(), 0);
    let said = good(desk.path(), "info cal.oct");
    assert!(said.contains("80 % of depth errors below"), "{said}");

    // The same numbers along one ray as in the picture: the ray through the middle of a pixel.
    assert!(
        run("render m-0.safetensors cal.oct --depth-error --cameras set/transforms_test.json -o view.exr")
            .status
            .success()
    );
    let image = exr::prelude::read_first_flat_layer_from_file(desk.path().join("view.exr")).unwrap();
    let channel = |name: &str| -> Vec<f64> {
        let channel = image.layer_data.channel_data.list.iter().find(|c| c.name.to_string() == name).unwrap();
        channel.sample_data.values_as_f32().map(f64::from).collect()
    };
    let frames: Value =
        serde_json::from_slice(&std::fs::read(desk.path().join("set/transforms_test.json")).unwrap()).unwrap();
    let pose: Vec<Vec<f64>> = serde_json::from_value(frames["frames"][0]["transform_matrix"].clone()).unwrap();
    // Pixel (12, 12) of 24: half a pixel right of the middle and below.
    let focal = 12.0 / (0.5 * frames["camera_angle_x"].as_f64().unwrap()).tan();
    let ray: Vec<String> = (0..3)
        .map(|axis| pose[axis][3].to_string())
        .chain((0..3).map(|axis| ((0.5 * pose[axis][0] - 0.5 * pose[axis][1]) / focal - pose[axis][2]).to_string()))
        .collect();
    let text = good(desk.path(), &format!("query cal.oct --model m-0.safetensors --ray {}", ray.join(",")));
    let mut lines = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let (head, row) = (lines.next().unwrap(), lines.next().unwrap());
    let value = |name: &str| row[head.iter().position(|h| *h == name).unwrap()].parse::<f64>().unwrap();
    for (name, channel_name) in
        [("median_depth", "depth.Z"), ("depth_error", "depth_error.Z"), ("depth_interval", "depth_interval.Z")]
    {
        let expected = channel(channel_name)[12 * 24 + 12];
        // Poses are written with all their digits, channels as f32.
        assert!((value(name) / expected - 1.0).abs() < 1e-4, "{name}: {} against {expected}", value(name));
    }
    assert!((value("depth_interval") / value("depth_error") - factor).abs() < 1e-9);

    // Too few pixels, the paper's scale, and a ray without a model.
    for (args, says) in [
        (format!("{calibrate} --probability 0.99999"), "more pixels of known depth"),
        (calibrate.replace("data.oct", "m.oct"), "--scale data: expected a field computed with it"),
        ("query cal.oct --ray 0,0,0,0,0,0 --model m-0.safetensors".into(), "a direction that is not zero"),
        ("query cal.oct --ray 0,0,0,0,0,1".into(), "--model"),
        ("query cal.oct 0,0,0 --model m-0.safetensors".into(), "cannot be used with"),
    ] {
        let refused = run(&args);
        let said = String::from_utf8(refused.stderr).unwrap();
        assert!(refused.status.code() == Some(2) && said.contains(says), "{args}: {said}");
    }
}
