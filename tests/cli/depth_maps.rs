//! Depth maps, from the command line: values that are no measurements, and which map belongs to which frame.

use std::path::Path;

use crate::program::{good, run};
use exr::image::IntoSample;
use exr::prelude::{Image, SpecificChannels, Vec2, WritableImage, f16};
use glam::{DVec3, Vec3};
use octobayes::dataset::write_transforms;
use octobayes::field::{ClosedForm, RadianceField};
use octobayes::geometry::Camera;
use octobayes::monitor::Silent;
use octobayes::render::{Marcher, Tracer, render_view};
use serde_json::Value;

const SIDE: u32 = 32;
/// Depth of white in PNG.
const WHITE: f64 = 6.0;
const UNCERTAINTY: &str = "uncertainty scene:ball --cameras cameras.json --views all --level 4 --rays 4000 \
    --occupancy 32 --scale data --noise 0.0316 --keep-sums";

/// How a folder of depth maps is stored, and the value where there is no measurement.
#[derive(Debug, Clone, Copy)]
enum Store {
    F32(f32),
    F16(f16),
    Png16(u16),
    Png8(u8),
}

fn write_exr<T: IntoSample>(path: &Path, depth: &[Option<f64>], stored: impl Fn(Option<f64>) -> T + Sync) {
    let side = SIDE as usize;
    let value = |at: Vec2<usize>| (stored(depth[at.1 * side + at.0]),);
    let channels = SpecificChannels::build().with_channel("Z").with_pixel_fn(value);
    Image::from_channels((side, side), channels).write().to_file(path).unwrap();
}

impl Store {
    /// Writes maps; `depth` has `None` where there is no measurement.
    fn write(self, folder: &Path, stem: &str, depth: &[Option<f64>]) {
        std::fs::create_dir_all(folder).unwrap();
        let exr = folder.join(format!("{stem}.exr"));
        let png = folder.join(format!("{stem}.png"));
        let share = |d: f64, steps: f64| (d / WHITE * steps).round();
        let at = |x: u32, y: u32| depth[(y * SIDE + x) as usize];
        match self {
            Self::F32(nothing) => write_exr(&exr, depth, |d| d.map_or(nothing, |d| d as f32)),
            Self::F16(nothing) => write_exr(&exr, depth, |d| d.map_or(nothing, f16::from_f64)),
            Self::Png16(nothing) => {
                let value = |x, y| image::Luma([at(x, y).map_or(nothing, |d| share(d, 65535.0) as u16)]);
                image::ImageBuffer::from_fn(SIDE, SIDE, value).save(png).unwrap();
            }
            Self::Png8(nothing) => {
                let value = |x, y| image::Luma([at(x, y).map_or(nothing, |d| share(d, 255.0) as u8)]);
                image::ImageBuffer::from_fn(SIDE, SIDE, value).save(png).unwrap();
            }
        }
    }

    /// The options with which maps are read.
    fn options(self) -> String {
        match self {
            Self::F32(_) | Self::F16(_) => "--depth-pattern {}.exr".into(),
            _ => format!("--depth-pattern {{}}.png --depth-encoding 0,{WHITE}"),
        }
    }
}

/// A view of the ball: its picture, and what a depth sensor measures, which is off and has gaps.
struct Shot {
    name: String,
    depth: Vec<Option<f64>>,
}

/// Cameras on a half circle around a ball with opaque pictures of these names; depth of the ball, from which a sensor
/// is off by up to 0.3. It measures nothing where there is no surface, nor in a stripe of the surface.
fn shots(folder: &Path, names: &[&str]) -> Vec<Shot> {
    let ball = ClosedForm::ball();
    let marcher = Marcher { step: 0.01, bounds: ball.bounds(), occupancy: None, cutoff: 0.0 };
    let tracer = Tracer { field: &ball, marcher, background: Vec3::ONE };
    let cameras = ClosedForm::half_circle(names.len() as u32, [SIDE; 2]);
    let named: Vec<(String, Camera)> = names.iter().map(|name| (*name).to_string()).zip(cameras).collect();
    write_transforms(&folder.join("cameras.json"), &named).unwrap();
    let shot = |(name, camera): &(String, Camera)| {
        let view = render_view(&tracer, camera, 0.5, &[], &Silent).unwrap();
        let color = |x, y| {
            let color: DVec3 = 255.0 * view.pixels[(y * SIDE + x) as usize].color;
            image::Rgb(color.to_array().map(|value| value.round() as u8))
        };
        let path = folder.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        image::RgbImage::from_fn(SIDE, SIDE, color).save(path).unwrap();
        let depth = |i: usize| {
            let (pixel, x) = (&view.pixels[i], i % SIDE as usize);
            let is_measured = pixel.opacity > 0.5 && !(14..17).contains(&x);
            is_measured.then_some(pixel.median_depth + 0.01 * (x as f64 - 2.0))
        };
        Shot { name: name.clone(), depth: (0..view.pixels.len()).map(depth).collect() }
    };
    named.iter().map(shot).collect()
}

fn stem(name: &str) -> &str {
    Path::new(name).file_stem().unwrap().to_str().unwrap()
}

fn desk() -> (tempfile::TempDir, Vec<Shot>) {
    let folder = tempfile::tempdir().unwrap();
    let shots = shots(folder.path(), &["a.png", "b.png", "c.png", "d.png"]);
    good(folder.path(), &format!("{UNCERTAINTY} -o f.oct"));
    (folder, shots)
}

fn evaluate(maps: &str, options: &str) -> String {
    format!("evaluate scene:ball f.oct --cameras cameras.json --views all --depth {maps} {options}")
}

fn calibrate(maps: &str, options: &str) -> String {
    format!("{} --calibrate cal.oct", evaluate(maps, options))
}

/// What the command finds, and what it says on stderr.
fn found(folder: &Path, args: &str) -> (Value, String) {
    let output = run(folder, &format!("{args} --json"));
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{args}: {said}");
    (serde_json::from_slice(&output.stdout).unwrap(), said)
}

/// What the command says when it is refused.
fn refused(folder: &Path, args: &str) -> String {
    let output = run(folder, args);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(2) && output.stdout.is_empty(), "{args}: {said}");
    said.lines().find_map(|line| line.strip_prefix("error: ")).unwrap_or(&said).to_string()
}

#[test]
fn values_that_are_no_measurements_change_no_figure() {
    let (desk, shots) = desk();
    let desk = desk.path();
    let f32s = [1e10, f32::MAX, 65504.0, 1000.0, f32::INFINITY, f32::NAN, -1.0].map(Store::F32).to_vec();
    let f16s = vec![Store::F16(f16::from_f32(1e10)), Store::F16(f16::MAX), Store::F16(f16::NAN)];
    let families = [
        (Store::F32(0.0), f32s),
        (Store::F16(f16::ZERO), f16s),
        (Store::Png16(0), vec![Store::Png16(u16::MAX)]),
        (Store::Png8(0), vec![Store::Png8(u8::MAX)]),
    ];
    let all: Vec<bool> = shots.iter().flat_map(|shot| &shot.depth).map(Option::is_some).collect();
    let share = 100.0 * all.iter().filter(|measured| !**measured).count() as f64 / all.len() as f64;
    let note = format!("note: {share:.1} % of depth readings are not measurements (");
    let mut number = 0;
    let mut judge = |store: Store| {
        number += 1;
        let maps = format!("maps{number}");
        for shot in &shots {
            store.write(&desk.join(&maps), stem(&shot.name), &shot.depth);
        }
        let (judged, said) = found(desk, &evaluate(&maps, &store.options()));
        assert_eq!(said.matches("not measurements").count(), 1, "{store:?}: {said}");
        assert!(said.contains(&note), "{store:?}: {said}, not {note}");
        let readings = &judged["depth_readings"];
        assert_eq!(readings["measured"], all.iter().filter(|measured| **measured).count(), "{store:?}: {readings}");
        let (calibrated, said) = found(desk, &calibrate(&maps, &store.options()));
        assert!(said.matches("not measurements").count() == 1 && said.contains(&note), "{store:?}: {said}");
        assert_eq!(&calibrated["depth_readings"], readings, "{store:?}");
        let figures = ["pixels", "depth_error", "readings", "baselines", "psnr"].map(|key| judged[key].clone());
        (figures, ["conformal", "views_left_out"].map(|key| calibrated["calibrated"][key].clone()))
    };
    for (zero, others) in families {
        let expected = judge(zero);
        assert!(expected.0[1]["median"].as_f64().unwrap() > 0.05, "{expected:?}");
        for store in others {
            assert_eq!(judge(store), expected, "{store:?}");
        }
    }
}

#[test]
fn depths_of_which_nearly_none_can_be_right_are_refused() {
    let (desk, shots) = desk();
    let desk = desk.path();
    let write = |maps: &str, nothing: f32, change: &dyn Fn(f64) -> f64| {
        for shot in &shots {
            let depth: Vec<Option<f64>> = shot.depth.iter().map(|depth| depth.map(change)).collect();
            Store::F32(nothing).write(&desk.join(maps), stem(&shot.name), &depth);
        }
    };
    write("millimetres", 0.0, &|depth| 1000.0 * depth);
    write("nothing", 1e10, &|_| 1e10);
    write("negative", -1.0, &|depth| -depth);
    // As far behind the ball as the box is wide and more, but not so far that no camera could see it.
    write("behind", 0.0, &|depth| depth + 2.5);
    for (maps, reason) in [
        ("millimetres", "100.0 % of depth readings are not measurements ("),
        ("nothing", "100.0 % of depth readings are not measurements ("),
        ("negative", "100.0 % of depth readings are not measurements ("),
        ("behind", "half of the depths are off by more than 2."),
    ] {
        let options = Store::F32(0.0).options();
        for command in [evaluate(maps, &options), calibrate(maps, &options)] {
            let said = refused(desk, &command);
            assert!(said.starts_with(&format!("{maps}: depth maps: expected ")), "{command}: {said}");
            assert!(said.contains(reason) && said.contains("--depth-encoding"), "{command}: {said}");
        }
    }
    assert!(!desk.join("cal.oct").exists());
}

/// Frames of one base name in two folders have two depth maps.
#[test]
fn maps_belong_to_frames_by_their_folders() {
    let folder = tempfile::tempdir().unwrap();
    let desk = folder.path();
    let names = ["images/front/0.png", "images/front/1.PNG", "images/back/0.png", "images/back/1.PNG"];
    let shots = shots(desk, &names);
    good(desk, &format!("{UNCERTAINTY} -o f.oct"));
    for (shot, alone) in shots.iter().zip(["0", "1", "2", "3"]) {
        let store = Store::F32(0.0);
        let below = Path::new(&shot.name).parent().unwrap();
        store.write(&desk.join("whole").join(below), stem(&shot.name), &shot.depth);
        store.write(&desk.join("depth").join(below.file_name().unwrap()), stem(&shot.name), &shot.depth);
        store.write(&desk.join("alone"), alone, &shot.depth);
    }
    let options = Store::F32(0.0).options();
    let figures = |maps: &str| found(desk, &evaluate(maps, &options)).0["depth_error"].clone();
    let found = figures("depth");
    assert_eq!(figures("whole"), found);
    // The same cameras, each with a name of its own.
    let file = std::fs::read_to_string(desk.join("cameras.json")).unwrap();
    let mut alone = file.clone();
    for (name, number) in names.iter().zip(0..) {
        std::fs::copy(desk.join(name), desk.join(format!("{number}.png"))).unwrap();
        alone = alone.replace(name, &format!("{number}.png"));
    }
    std::fs::write(desk.join("cameras.json"), alone).unwrap();
    assert_eq!(figures("alone"), found);
    std::fs::write(desk.join("cameras.json"), file).unwrap();

    let front = evaluate("depth/front", &options);
    let calibrated = calibrate("depth/front", &options);
    // Whether the other frame is judged, too, or not.
    let last = front.replace("--views all", "--views 3");
    for (command, name) in [(front, "0.png"), (last, "0.png"), (calibrated, "0.png")] {
        let said = refused(desk, &command);
        let both = &format!("`images/front/{name}` and `images/back/{name}`");
        assert!(said.starts_with("depth/front: depth maps: expected ") && said.contains(both), "{command}: {said}");
    }
    // A map that is nowhere.
    std::fs::remove_file(desk.join("depth/back/0.exr")).unwrap();
    let said = refused(desk, &evaluate("depth", &options));
    assert!(said.contains("images/back/0.png") && said.contains("back/0.exr"), "{said}");

    // Pictures, too, belong to one frame each.
    let renamed = std::fs::read_to_string(desk.join("cameras.json")).unwrap().replace("back/0.png", "front/0.png");
    std::fs::write(desk.join("cameras.json"), renamed).unwrap();
    let said = refused(desk, &format!("{UNCERTAINTY} --images . -o x.oct"));
    assert!(said.starts_with(".: training images: expected ") && said.contains("front/0.png"), "{said}");
}

/// The extension of a map may be written in capitals, in the pattern and on the disk.
#[test]
fn extensions_are_matched_in_any_case() {
    let (desk, shots) = desk();
    let desk = desk.path();
    for shot in &shots {
        Store::F32(0.0).write(&desk.join("maps"), stem(&shot.name), &shot.depth);
        std::fs::create_dir_all(desk.join("capitals")).unwrap();
        let [from, to] = ["maps/{}.exr", "capitals/{}.EXR"].map(|name| desk.join(name.replace("{}", stem(&shot.name))));
        std::fs::copy(from, to).unwrap();
    }
    let figures = |maps: &str, pattern: &str| {
        found(desk, &evaluate(maps, &format!("--depth-pattern {pattern}"))).0["depth_error"].clone()
    };
    let expected = figures("maps", "{}.exr");
    for (maps, pattern) in [("maps", "{}.EXR"), ("capitals", "{}.EXR"), ("capitals", "{}.exr")] {
        assert_eq!(figures(maps, pattern), expected, "{maps}/{pattern}");
    }
}

/// Names from a camera file may hold anything. None of it reaches the terminal as a command, nor a spreadsheet.
#[test]
#[cfg(unix)]
fn names_of_frames_are_text_on_terminals_and_in_spreadsheets() {
    let folder = tempfile::tempdir().unwrap();
    let desk = folder.path();
    let names = ["=a\u{1b}[2J\u{1b}]0;x\u{7}\n.png", "+b\r.png", "-c\u{9b}1m.png", "@d.png"];
    let shots = shots(desk, &names);
    good(desk, &format!("{UNCERTAINTY} -o =f.oct"));
    let options = Store::F32(0.0).options();
    let is_plain = |text: &str| !text.chars().any(|c| c.is_control() && c != '\n');
    let shown = |args: &str| {
        let output = run(desk, &args.replace(" f.oct", " =f.oct"));
        let [out, err] = [output.stdout, output.stderr].map(|text| String::from_utf8(text).unwrap());
        assert!(is_plain(&out) && is_plain(&err), "{args}: {out:?} and {err:?}");
        (output.status.code(), out, err)
    };
    std::fs::create_dir(desk.join("empty")).unwrap();
    for args in [evaluate("empty", &options), calibrate("empty", &options)] {
        let (code, _, err) = shown(&args);
        let lines: Vec<&str> = err.lines().filter(|line| !line.starts_with("note: ")).collect();
        assert!(code == Some(2) && lines.len() == 1 && lines[0].contains("=a\\u{1b}[2J"), "{err}");
    }
    for shot in &shots {
        Store::F32(0.0).write(&desk.join("maps"), stem(&shot.name), &shot.depth);
    }
    assert_eq!(shown(&evaluate("maps", &options)).0, Some(0));
    let (code, json, _) = shown(&evaluate("maps", &format!("{options} --csv curves.csv --json")));
    // JSON has the names as they are.
    let json: Value = serde_json::from_str(&json).unwrap();
    assert!(code == Some(0) && json["views"][0]["name"] == names[0], "{}", json["views"]);
    assert_eq!(shown(&calibrate("maps", &options)).0, Some(0));

    let cells = |file: &str| -> Vec<Vec<String>> {
        let records = csv::ReaderBuilder::new().has_headers(false).from_path(desk.join(file)).unwrap().into_records();
        records.map(|record| record.unwrap().iter().map(String::from).collect()).collect()
    };
    let is_formula =
        |cell: &&String| cell.starts_with(['=', '+', '-', '@', '\t', '\r']) && cell.parse::<f64>().is_err();
    let curves = cells("curves.csv");
    assert_eq!(curves[0].iter().find(is_formula), None);
    assert!(curves[0].iter().any(|name| name.starts_with("'=f ")), "{:?}", curves[0]);
    good(desk, "export scene:ball =f.oct --cameras cameras.json -o report.csv");
    let report = cells("report.csv");
    assert_eq!(report.iter().flatten().find(is_formula), None);
    let cameras: Vec<&str> = report.iter().filter(|row| row[0] == "camera").map(|row| &*row[1]).collect();
    assert_eq!(cameras, names.map(|name| format!("'{name}")));
}

/// A covariance that is asked for is the one that is calibrated and kept.
#[test]
fn calibration_reads_the_covariance_that_it_is_told() {
    let (desk, shots) = desk();
    let desk = desk.path();
    for shot in &shots {
        Store::F32(0.0).write(&desk.join("maps"), stem(&shot.name), &shot.depth);
    }
    let calibrated = |field: &str, more: &str| {
        let args = calibrate("maps", &Store::F32(0.0).options()).replace("f.oct", field);
        found(desk, &format!("{args}{more}")).0["calibrated"]["conformal"].clone()
    };
    let covariance = || -> Value {
        let info = good(desk, "info cal.oct --json");
        serde_json::from_str::<Value>(&info).unwrap()["record"]["covariance"].clone()
    };
    let own = calibrated("f.oct", "");
    let expected = covariance();
    good(desk, &format!("{UNCERTAINTY} --covariance block -o block.oct"));
    let block = calibrated("block.oct", "");
    assert!(own != block && covariance() != expected, "{own} and {block}");
    assert_eq!(calibrated("f.oct", " --covariance block"), block);
    assert_ne!(covariance(), expected);
    // Without its sums a field has one covariance.
    good(desk, "export f.oct -o bare.oct");
    let args = calibrate("maps", &Store::F32(0.0).options()).replace("f.oct", "bare.oct");
    let said = refused(desk, &format!("{args} --covariance block"));
    assert!(said.contains("expected a field that keeps its sums"), "{said}");
}
